"""Accuracy: what reports are made of: errors and timings of methods, means of correlated series.

Errors are taken against `Reference`, forces relative to density * gravity * volume and torques to
that times the hull's longest side, over seeded poses in which the water cuts the hull. Times are of
methods taken in turns, so that whatever else the machine does slows all of them alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from types import SimpleNamespace

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from sim.geometry import random_rotation
from sim.hull import Hull
from sim.methods import Method
from sim.triangle import clipped, wet_triangles_wrench
from sim.water.gerstner import WAVE
from sim.water.head import hydrostatic
from sim.water.sea import Sea
from sim.water.wave import Wave

Array = NDArray[np.float64]
Pose = tuple[Array, Array, float]
"""Position (3,) [m], rotation (3, 3) hull -> world, time [s]."""

FEWEST_ROUNDS = 3
"""Rounds of timing below which a minimum and a median mean nothing."""

IN_A_ROW = 3
"""Times that a pose is computed at once, the fastest of which counts: a simulation's next pose is
nearly the same too, so what the last one needed is still in the caches."""

FEWEST_BATCHES = 16
"""Batches below which their scatter tells the error of a mean to no better than a fifth."""


def steepened(waves: Sequence[Wave], steepness: float) -> Sea:
    """The sea of these waves with all amplitudes scaled to a sum of k a."""
    scale = steepness / sum(w.steepness for w in waves)
    return Sea([Wave(scale * w.amplitude, w.wavelength, w.heading, w.phase) for w in waves])


def _crossing_waves() -> Sea:
    """The three waves of the scenes."""
    shape = [(0.10, 4.0, 0.0, 0.0), (0.06, 2.4, 55.0, 40.0), (0.03, 1.4, -65.0, 110.0)]
    return steepened([Wave(a, w, *np.radians([h, p])) for a, w, h, p in shape], 0.43)


def _chop(seed: int = 2) -> Sea:
    """Six waves as long as a side of a coarse mesh's triangles, from all sides."""
    rng = np.random.default_rng(seed)
    lengths = np.geomspace(0.25, 0.8, 6)
    return steepened([Wave(w, w, *rng.uniform(0.0, 2.0 * np.pi, 2)) for w in lengths], 0.43)


def _spectrum(count: int = 40, peak: float = 4.0, seed: int = 3) -> Sea:
    """Waves of a wind sea: frequencies from 0.7 to 3 of the peak's, energies after Pierson and
    Moskowitz (1964), headings within 90 degrees of the wind's by the cosine."""
    rng = np.random.default_rng(seed)
    ratio = np.linspace(0.7, 3.0, count) + rng.uniform(-0.02, 0.02, count)
    energy = ratio**-5 * np.exp(-1.25 * ratio**-4)
    headings = np.arcsin(rng.uniform(-1.0, 1.0, count))
    phases = rng.uniform(0.0, 2.0 * np.pi, count)
    amplitudes, lengths = np.sqrt(energy), peak / ratio**2
    return steepened(
        [Wave(*w) for w in zip(amplitudes, lengths, headings, phases, strict=True)], 0.72
    )


SEAS: dict[str, Sea] = {
    "swell": Sea([Wave(0.5, 20.0, 0.3)]),
    "three": _crossing_waves(),
    "chop": _chop(),
    "forty": _spectrum(),
}
"""Seas for hulls about 1 m long: a long swell, three crossing waves, chop, forty waves."""


def longest_side(hull: Hull) -> float:
    """Longest side [m] of the hull's box."""
    return float(np.ptp(hull.bounds, axis=0).max())


def waterline_poses(hull: Hull, sea: Sea, count: int, seed: int = 0) -> list[Pose]:
    """Seeded poses in which the water cuts the hull: any rotation, within 10 m and 20 s of the
    origin, 10 to 90 % of the hull's height below the elevation at its origin."""
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        rotation = random_rotation(rng)
        heights = hull.vertices @ rotation[2]
        x, y = rng.uniform(-10.0, 10.0, 2)
        time = float(rng.uniform(0.0, 20.0))
        cut = heights.min() + rng.uniform(0.1, 0.9) * np.ptp(heights)
        poses.append((np.array([x, y, float(sea.elevation(x, y, time)) - cut]), rotation, time))
    return poses


def wrenches(method: Method, poses: Sequence[Pose]) -> Array:
    """Wrenches (N, 6) [N, N m] of a method at poses."""
    return np.array([method.wrench(*pose) for pose in poses])


@dataclass(frozen=True)
class Errors:
    """Errors over poses: largest and root mean square of the force, of its horizontal and vertical
    parts (of density * gravity * volume) and of the torque (of that times the longest side);
    bias: mean error of the vertical force, upwards, and the standard error of that mean."""

    force_max: float
    force_rms: float
    horizontal_max: float
    horizontal_rms: float
    vertical_max: float
    vertical_rms: float
    torque_max: float
    torque_rms: float
    bias: float
    bias_error: float


def errors(found: Array, truth: Array, method: Method) -> Errors:
    """Errors of wrenches (N, 6) of a method against the true ones."""
    sea, hull = method.sea, method.hull
    force = (found - truth) / (sea.density * sea.gravity * hull.volume)
    parts = {
        "force": force[:, :3],
        "horizontal": force[:, :2],
        "vertical": force[:, 2:3],
        "torque": force[:, 3:] / longest_side(hull),
    }
    figures = {}
    for name, part in parts.items():
        size = np.linalg.norm(part, axis=1)
        figures[f"{name}_max"] = float(size.max())
        figures[f"{name}_rms"] = float(np.sqrt(np.mean(size**2)))
    vertical = force[:, 2]
    scatter = float(vertical.std(ddof=1) / np.sqrt(len(vertical))) if len(vertical) > 1 else np.nan
    return Errors(**figures, bias=float(vertical.mean()), bias_error=scatter)


def time_in_turns(
    methods: Sequence[Method], poses: Sequence[Pose], seconds: float, most_rounds: int = 50
) -> Array:
    """Seconds a wrench, (rounds, methods, poses).

    A round takes every method over all poses, IN_A_ROW times each, one method after the other;
    rounds go on for about so many seconds, at least FEWEST_ROUNDS of them. A first call compiles
    the kernels.
    """
    for method in methods:
        method.wrench(*poses[0])
    rounds: list[list[list[float]]] = []
    begin = perf_counter()
    while len(rounds) < FEWEST_ROUNDS or (
        len(rounds) < most_rounds and perf_counter() - begin < seconds
    ):
        rounds.append([])
        for method in methods:
            rounds[-1].append([_fastest(method, pose) for pose in poses])
    return np.array(rounds)


def _fastest(method: Method, pose: Pose) -> float:
    """Seconds of the fastest of IN_A_ROW calls."""
    seconds = []
    for _ in range(IN_A_ROW):
        started = perf_counter()
        method.wrench(*pose)
        seconds.append(perf_counter() - started)
    return min(seconds)


class Customary(Method):
    """Linear as it is customarily computed: a fixed number of Newton steps for an elevation, from
    the point itself as the label, and numbers as short as `dtype`. For the table of
    error sources: with many steps or in double precision it leaves just the other error.

    In single precision positions, heads, phases and elevations are rounded; only the sums over
    triangles stay in double precision.
    """

    def __init__(
        self, hull: Hull, sea: Sea, newton_steps: int = 2, dtype: DTypeLike = np.float64
    ) -> None:
        super().__init__(hull, sea)
        self.newton_steps = newton_steps
        self.dtype = np.dtype(dtype)
        self._vertices = hull.vertices.astype(self.dtype)
        columns = [(name, sea.components[name].astype(self.dtype)) for name in WAVE.names]
        self._waves = SimpleNamespace(**dict(columns))

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        """Force [N] and torque [N m] about the position, world axes: (6,)."""
        turn = np.asarray(rotation, dtype=self.dtype).reshape(3, 3)
        place = np.asarray(position, dtype=self.dtype)
        points = self._vertices @ turn.T + place
        level = self.dtype.type(self.sea.level)
        heights = self.heights(points[:, 0], points[:, 1], time)
        heads = hydrostatic(heights, points[:, 2] - level)
        arms = (self._vertices @ turn.T).astype(float)
        faces, sea = self.hull.faces, self.sea
        corners, wet_heads = clipped(arms[faces], heads.astype(float)[faces])
        return wet_triangles_wrench(corners, wet_heads, sea.density, sea.gravity)

    def heights(self, x: NDArray, y: NDArray, time: float) -> NDArray:
        """Heights [m] of the surface above the level at the points (N,), (N,) [m], as precise as
        all that is said above."""
        wave = self._waves
        dx, dy, a = wave.direction_x, wave.direction_y, wave.amplitude
        label_x, label_y = x.copy(), y.copy()
        for _ in range(self.newton_steps):
            s, c = self._phases(label_x, label_y, time)
            strain = s * (wave.wavenumber * a)
            jxx, jxy, jyy = 1 - strain @ (dx * dx), -strain @ (dx * dy), 1 - strain @ (dy * dy)
            rx, ry = x - label_x - c @ (dx * a), y - label_y - c @ (dy * a)
            scale = 1 / (jxx * jyy - jxy * jxy)
            label_x = label_x + scale * (jyy * rx - jxy * ry)
            label_y = label_y + scale * (jxx * ry - jxy * rx)
        s, _ = self._phases(label_x, label_y, time)
        return s @ a

    def _phases(self, x: NDArray, y: NDArray, time: float) -> tuple[NDArray, NDArray]:
        """Sines and cosines (N, W) of the waves' phases at labels."""
        wave = self._waves
        turns = np.multiply.outer(x, wave.turns_x) + np.multiply.outer(y, wave.turns_y)
        turns += wave.turns - wave.frequency * self.dtype.type(time)
        angle = turns * self.dtype.type(2.0 * np.pi)
        return np.sin(angle), np.cos(angle)


@dataclass(frozen=True)
class Mean:
    """Mean with its standard error, which comes from the scatter of so many batches of so many
    samples each. settled: whether batches of that length and longer were found uncorrelated; if
    not, the series is too short for its memory and the error is too small."""

    value: float
    error: float
    batches: int
    batch: int
    settled: bool


def mean_of_runs(runs: Sequence[Array]) -> Mean:
    """Mean over independent runs (N,) of equal length: one batch each."""
    means = np.array([np.mean(run) for run in runs])
    error = means.std(ddof=1) / np.sqrt(len(means))
    return Mean(float(means.mean()), float(error), len(means), len(runs[0]), settled=True)


def mean_of_correlated(series: ArrayLike) -> Mean:
    """Mean of a stationary series (N,) whose samples remember their predecessors, by batch means
    (Conway 1963).

    Means over batches long against the memory are independent, so their scatter tells the error of
    the whole mean. The length comes from the series: it is doubled, while at least
    FEWEST_BATCHES are left, and the shortest is taken from which on no length shows a correlation
    between neighbouring batches beyond its noise of 1 / sqrt(batches), twice. Where no length does,
    the longest is taken and `settled` is false. Raises ValueError for fewer samples than that.
    """
    series = np.asarray(series, dtype=float)
    if series.size < FEWEST_BATCHES:
        raise ValueError(
            f"the series has {series.size} samples; its mean's error needs {FEWEST_BATCHES} or more"
        )
    chosen, settled = None, False
    length = 1
    while series.size // length >= FEWEST_BATCHES:
        count = series.size // length
        means = series[series.size - count * length :].reshape(count, length).mean(axis=1)
        off = means - means.mean()
        spread = float(off @ off)
        correlation = float(off[1:] @ off[:-1]) / spread if spread > 0.0 else 0.0
        quiet = abs(correlation) <= 2.0 / count**0.5
        if chosen is None or not (settled and quiet):
            error = np.sqrt(spread / (count - 1) / count)
            chosen = (float(error), count, length)
        settled = quiet
        length *= 2
    return Mean(float(series.mean()), *chosen, settled=settled)
