"""Seas for the benchmarks, for hulls about 1 m long, and poses of hulls at their surface."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.geometry import random_rotation
from sim.hulls.hull import Hull
from sim.water.sea import Sea
from sim.water.wave import Wave

Array = NDArray[np.float64]
Pose = tuple[Array, Array, float]
"""Position (3,) [m], rotation (3, 3) hull -> world, time [s]."""


def steepened(waves: Sequence[Wave], steepness: float) -> Sea:
    """The sea of these waves, with all amplitudes scaled so that the sum of k a is `steepness`."""
    scale = steepness / sum(w.steepness for w in waves)
    return Sea([Wave(scale * w.amplitude, w.wavelength, w.heading, w.phase) for w in waves])


def _crossing_waves() -> Sea:
    """The three crossing waves of the scenes."""
    shape = [(0.10, 4.0, 0.0, 0.0), (0.06, 2.4, 55.0, 40.0), (0.03, 1.4, -65.0, 110.0)]
    return steepened([Wave(a, w, *np.radians([h, p])) for a, w, h, p in shape], 0.43)


def _chop(seed: int = 2) -> Sea:
    """Six waves from all directions, as short as the edges of a coarse mesh."""
    rng = np.random.default_rng(seed)
    lengths = np.geomspace(0.25, 0.8, 6)
    return steepened([Wave(w, w, *rng.uniform(0.0, 2.0 * np.pi, 2)) for w in lengths], 0.43)


def _spectrum(count: int = 40, peak: float = 4.0, seed: int = 3) -> Sea:
    """Waves of a wind sea. Frequencies: 0.7 to 3 times the peak's. Energies: Pierson and Moskowitz
    (1964). Headings: within 90 degrees of the wind's, with a density like the cosine."""
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
"""A long swell, three crossing waves, chop, and forty waves."""


def waterline_poses(hull: Hull, sea: Sea, count: int, seed: int = 0) -> list[Pose]:
    """Seeded random poses in which the water cuts the hull: any rotation, x and y within 10 m of
    the origin, times up to 20 s, and 10 to 90 % of the hull's height below the elevation there."""
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
