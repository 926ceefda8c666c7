"""Sea: the public class of the water, a sum of Gerstner waves, with its checks and units.

The formulas and the solver are in `gerstner`, `head` and `jets`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.kernels import read_only, record
from sim.water.gerstner import (
    MOST_TIDES,
    SUMS,
    WATER,
    chunk_rows,
    label_chunks,
    level_and_rise,
    solve_heights,
    wave_sums,
)
from sim.water.head import PRESSURES, solve_heads
from sim.water.jets import JET, near_particles, solve_jets
from sim.water.motion import MOTION, VELOCITY, water_motion
from sim.water.spectrum import DEFAULT_SPREAD, jonswap
from sim.water.wave import PLAIN_SUM_WAVES, Wave, largest_sum, tanh_at, wave_table

Array = NDArray[np.float64]
Table = NDArray[np.void]

DEFAULT_PRESSURE = "froude-krylov"

ELEVATION_ERROR = 1e-13
"""Error [m] of an elevation from the solver, besides the round-off of the position. It sets the
residual at which the solver stops."""


MOVING_JET = record(jet=JET, velocity=("f8", 3))
"""The surface above a point, and the velocity [m/s] of the water there."""


class Surface(NamedTuple):
    """The surface above given points: elevation (...) [m], gradient (..., 2), Hessian
    (..., 2, 2) [1/m], and the water's velocity there (..., 3) [m/s], all in world axes."""

    elevation: Array
    gradient: Array
    hessian: Array
    velocity: Array


@dataclass(frozen=True)
class Sea:
    """A sum of Gerstner waves over still water at `level` [m].

    waves: none for flat water. density [kg/m^3]. gravity [m/s^2], downwards. pressure:
    "froude-krylov", in which the pressure of the waves decays with depth, or "hydrostatic" (see
    `head`). current: velocity of all of the water, 2 or 3 numbers [m/s]; the waves travel on it.
    ramp [s]: time in which the waves grow smoothly from nothing, from time 0. tide: pairs of a time
    [s] and a level [m] in rising order, linear in between, instead of one level. depth: of the
    bottom below `level` [m], inf for deep water; a tide changes the level, but not the waves.
    stokes: whether the water's velocity, and so drag, includes the waves' Stokes drift (see
    `motion`).

    `level` is the mean height of the particles. Crests are narrow, so the mean height of the
    surface over places, and the level that deep bodies feel, lie sum k a^2 / 2 below it (sum k a^2
    / (2 tanh(k depth)) above a bottom). Positions are world coordinates [m], times are in seconds;
    x, y, z and time broadcast. A sea is immutable. Raises ValueError for waves that fold and for
    unusable numbers.

    steepness: sum of k a / tanh(k depth) over the waves. worst_steepness: that sum, or
    `wave.SIGMAS` standard deviations of it if that is less; the surface is a graph below 1.
    amplitude [m]: likewise for the amplitudes; no crest or trough lies further from the level.
    components, water: tables for kernels (`gerstner.WAVE`, `gerstner.WATER`).
    """

    waves: tuple[Wave, ...] = ()
    density: float = 1025.0
    gravity: float = 9.81
    level: float = 0.0
    pressure: str = DEFAULT_PRESSURE
    current: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp: float = 0.0
    tide: tuple[tuple[float, float], ...] = ()
    depth: float = np.inf
    stokes: bool = False
    steepness: float = field(init=False, repr=False, compare=False)
    worst_steepness: float = field(init=False, repr=False, compare=False)
    amplitude: float = field(init=False, repr=False, compare=False)
    components: Table = field(init=False, repr=False, compare=False)
    water: Table = field(init=False, repr=False, compare=False)

    def __init__(
        self,
        waves: Iterable[Wave] = (),
        density: float = 1025.0,
        gravity: float = 9.81,
        level: float = 0.0,
        pressure: str = DEFAULT_PRESSURE,
        current: Sequence[float] = (0.0, 0.0, 0.0),
        ramp: float = 0.0,
        tide: Sequence[tuple[float, float]] | Array = (),
        depth: float = np.inf,
        stokes: bool = False,
    ) -> None:
        if pressure not in PRESSURES:
            raise ValueError(f"water pressure is '{pressure}'; expected {' or '.join(PRESSURES)}")
        for name, value in (("density", density), ("gravity", gravity)):
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"water {name} is {value}; it must be finite and above 0")
        if not np.isfinite(level):
            raise ValueError(f"water level is {level}; it must be a finite number")
        tide = checked_tide(tide)
        waves, level = tuple(waves), tide[0][1] if tide else level
        self._set(waves=waves, density=float(density), gravity=float(gravity), level=float(level))
        self._set(pressure=pressure, current=checked_current(current), tide=tide)
        if not (np.isfinite(ramp) and ramp >= 0.0):
            raise ValueError(f"the water's ramp is {ramp} s; it must be finite and 0 or more")
        self._set(ramp=float(ramp))
        if not depth > 0.0:
            raise ValueError(f"the water's depth is {depth} m; it must be above 0, or inf")
        self._set(depth=float(depth), stokes=bool(stokes))
        parts = [w.steepness / float(tanh_at(w.wavenumber, self.depth)) for w in waves]
        self._set(steepness=float(sum(parts)), worst_steepness=largest_sum(parts))
        self._set(amplitude=largest_sum([w.amplitude for w in waves]))
        self._check_folding()
        table = wave_table(waves, self.gravity, self.current, self.ramp, self.depth)
        self._set(components=table)
        self._set(water=self._water())

    def _check_folding(self) -> None:
        """Raise ValueError for waves that fold."""
        if self.worst_steepness < 1.0:
            return
        is_deep = self.depth == np.inf
        terms = "k a" if is_deep else "k a / tanh(k depth)"
        remedy = "lengthen the waves" if is_deep else "use deeper water"
        raise ValueError(
            f"the waves fold: the sum of {terms} over {len(self.waves)} waves is "
            f"{self.worst_steepness:.4g}"
            f"{' as waves meet' if len(self.waves) > PLAIN_SUM_WAVES else ''} and "
            "must stay below 1; scale all amplitudes by less than "
            f"{1.0 / self.worst_steepness:.3g} or {remedy}"
        )

    def _water(self) -> Table:
        """The WATER table: everything that kernels need besides the waves."""
        water = np.zeros(1, WATER)
        row = water[0]
        row["level"], row["amplitude"] = self.level, self.amplitude
        row["tolerance"] = self._residual_tolerance()
        row["scale"] = -self.density * self.gravity
        row["decays"] = self.pressure != "hydrostatic"
        row["drifts"] = self.stokes
        row["current"], row["tides"] = self.current, len(self.tide)
        for i, (time, level) in enumerate(self.tide):
            row["tide_time"][i], row["tide_level"][i] = time, level
        return read_only(water)

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the tables of pickles and deep copies read-only, too."""
        self.__dict__.update(state)
        read_only(self.components)
        read_only(self.water)

    @classmethod
    def jonswap(
        cls,
        significant_height: float,
        peak_period: float,
        gamma: float = 3.3,
        heading: float = 0.0,
        spread: float = DEFAULT_SPREAD,
        waves: int = 40,
        seed: int = 0,
        *,
        gravity: float = 9.81,
        depth: float = np.inf,
        **water: Any,
    ) -> "Sea":
        """An irregular sea with the JONSWAP spectrum (see `spectrum`).

        significant_height [m]: 4 sqrt(m0). peak_period [s]. gamma: peak enhancement, 1 for a fully
        developed sea. heading, spread [rad], waves, seed: how the spectrum is divided into waves
        (see `Spectrum.waves`). gravity [m/s^2], depth [m] and others: as for Sea. Raises ValueError
        for numbers out of bounds and for waves that fold.
        """
        spectrum = jonswap(significant_height, peak_period, gamma)
        parts = spectrum.waves(heading, spread, waves, seed, gravity, depth)
        return cls(parts, gravity=gravity, depth=depth, **water)

    def _residual_tolerance(self) -> float:
        """The residual [m] that causes ELEVATION_ERROR. Its first-order effect is corrected, so a
        residual r costs r^2/2 times the curvature."""
        curvature = self.curvature_bound
        return float(np.sqrt(2.0 * ELEVATION_ERROR / curvature)) if curvature > 0.0 else np.inf

    def level_at(self, time: ArrayLike) -> Array:
        """The still level [m] at times [s]."""
        if not self.tide:
            return np.full(np.shape(time), self.level)
        water = self.water.view(np.recarray)[0]
        found = [level_and_rise.py_func(water, each)[0] for each in np.ravel(time)]
        return np.reshape(found, np.shape(time))

    @property
    def significant_height(self) -> float:
        """4 sqrt(m0) [m] with m0 = sum a^2 / 2, the variance of the elevation to first order."""
        return float(4.0 * np.sqrt(sum(0.5 * wave.amplitude**2 for wave in self.waves)))

    @property
    def curvature_bound(self) -> float:
        """Bound [1/m] on the elevation's second derivatives, everywhere and in any direction.

        In the formula of H (see `jets`) each factor J^-1 is at most 1 / (1 - sum k a / T) and M, as
        |G| <= sum k a / (1 - sum k a / T), at most sum (k^2 a / T) / (1 - sum k a / T).
        """
        total = largest_sum(
            [w.wavenumber**2 * w.amplitude / float(tanh_at(w.wavenumber, self.depth))
             for w in self.waves]
        )  # fmt: skip
        return total / (1.0 - self.worst_steepness) ** 3

    def elevation(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Height z of the surface [m] above the points (x, y) at a time.

        The error is ELEVATION_ERROR at any possible steepness, plus the round-off of the position.
        An input that is not finite gives NaN.
        """

        def solve(time: float, x: Array, y: Array) -> Array:
            heights = np.empty(x.size)
            solve_heights(x, y, self.components, time, float(self.water["tolerance"][0]), heights)
            return heights + self.level_at(time)

        return _per_time(solve, time, x, y)

    @property
    def hydrostatic(self) -> "Sea":
        """The same sea with hydrostatic pressure, whose heads are depths below the surface."""
        return self.with_pressure("hydrostatic")

    def with_pressure(self, pressure: str) -> "Sea":
        """The same sea with another pressure. Raises ValueError."""
        if pressure == self.pressure:
            return self
        return replace(self, pressure=pressure)

    def head(self, x: ArrayLike, y: ArrayLike, z: ArrayLike, time: ArrayLike) -> Array:
        """Head [m], the pressure over density * gravity, at points (x, y, z) at a time: positive
        below the surface, zero on it, negative above. Its error is that of an elevation."""

        def solve(time: float, x: Array, y: Array, z: Array) -> Array:
            heads = np.empty(x.size)
            solve_heads(x, y, z, self.components, self.water, time, heads)
            return heads

        return _per_time(solve, time, x, y, z)

    def surface(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Surface:
        """Elevation, gradient, Hessian and velocity of the water at the surface, from one solve."""

        def solve(time: float, x: Array, y: Array) -> Table:
            found, tolerance = np.empty(x.size, MOVING_JET), float(self.water["tolerance"][0])
            near = near_particles(x, y, self.components, time, 1, tolerance)
            jets = np.empty(x.size, JET)
            solve_jets(x, y, near, self.components, time, tolerance, 0.0, jets)
            found["jet"], motion = jets, np.empty(1, MOTION)
            labels = np.stack([jets["label_x"], jets["label_y"]], axis=1)
            for chunk, at, count in label_chunks(labels):
                depths = np.zeros(count)
                water_motion(VELOCITY, depths, self.components, self.water, time, at, motion)
                found["velocity"][chunk] = chunk_rows(motion, "xyz", labels[chunk].shape[0])
            return found

        found = _per_time(solve, time, x, y)
        jets = found["jet"]
        hessian = [jets["z_xx"], jets["z_xy"], jets["z_xy"], jets["z_yy"]]
        return Surface(
            jets["z"] + self.level_at(time),
            np.stack([jets["z_x"], jets["z_y"]], axis=-1),
            np.stack(hessian, axis=-1).reshape((*jets.shape, 2, 2)),
            found["velocity"],
        )

    def hessian(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Second derivatives (..., 2, 2) of the elevation [1/m]."""
        return self.surface(x, y, time).hessian

    def particles(self, labels: ArrayLike, time: float) -> Array:
        """Positions (..., 3) [m] of the surface particles with labels (..., 2) [m]."""
        labels, sums = np.asarray(labels, dtype=float), np.empty(1, SUMS)
        positions = np.empty((*labels.shape[:-1], 3))
        flat, of = positions.reshape(-1, 3), labels.reshape(-1, 2)
        for chunk, at, count in label_chunks(of):
            wave_sums(count, self.components, float(time), at, sums)
            flat[chunk] = chunk_rows(sums, "xyz", len(of[chunk]))
        positions[..., :2] += labels
        positions[..., 2] += self.level_at(time)
        return positions


def checked_current(current: Sequence[float]) -> tuple[float, float, float]:
    """A velocity of 2 or 3 numbers [m/s] as 3 numbers. Raises ValueError."""
    values = np.asarray(current, dtype=float)
    if values.shape not in ((2,), (3,)) or not np.isfinite(values).all():
        raise ValueError(f"the current is {current}; expected 2 or 3 finite numbers [m/s]")
    return tuple(np.resize([*values, 0.0], 3).tolist())


def checked_tide(tide: Sequence[tuple[float, float]] | Array) -> tuple[tuple[float, float], ...]:
    """A tide as pairs of a time [s] and a level [m]. Raises ValueError."""
    pairs = np.asarray(tide, dtype=float).reshape(-1, 2)
    if len(pairs) == 1 or len(pairs) > MOST_TIDES:
        raise ValueError(f"the tide has {len(pairs)} levels; expected 2 to {MOST_TIDES} pairs")
    if not np.isfinite(pairs).all() or not (np.diff(pairs[:, 0]) > 0.0).all():
        raise ValueError("the tide's times must rise, and all of its numbers must be finite")
    with np.errstate(over="ignore"):
        rates = np.diff(pairs[:, 1]) / np.diff(pairs[:, 0])
    if not np.isfinite(rates).all():
        raise ValueError("the tide's times are too close for its levels; expected at least 1e-9 s")
    return tuple((float(time), float(level)) for time, level in pairs)


def _per_time(solve: Callable[..., Array | Table], time: ArrayLike, *places: ArrayLike) -> Any:
    """Broadcast points and times, call solve(t, *points) with flat arrays once for every distinct
    time, because kernels take one time, and reshape the result."""
    at, *points = (np.asarray(v, dtype=float) for v in (time, *places))
    is_one_time = at.size == 1
    if not (at.ndim == 0 and all(v.shape == points[0].shape for v in points)):
        at, *points = np.broadcast_arrays(at, *points)
    shape = points[0].shape
    points = [np.ravel(v) for v in points]
    if is_one_time:  # the usual case: sorting the times would cost more than solving
        return solve(float(at.flat[0]) if at.size else 0.0, *points).reshape(shape)
    times, which = np.unique(at, return_inverse=True)
    which = np.ravel(which)
    result = np.empty(points[0].size, solve(0.0, *(v[:0] for v in points)).dtype)
    for i, t in enumerate(times):
        chosen = which == i
        result[chosen] = solve(float(t), *(v[chosen] for v in points))
    return result.reshape(shape)
