"""Sea: the water's surface as a sum of Gerstner waves, from arrays to arrays.

The formulas and the solver are in `gerstner`; here are the public classes, their
checks and their units.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.gerstner import (
    AMPLITUDE,
    COMPONENT_COLUMNS,
    DIRECTION_X,
    DIRECTION_Y,
    FREQUENCY,
    JET_HEIGHT,
    JET_LABEL_X,
    JET_ROWS,
    JET_X,
    JET_XX,
    JET_XY,
    JET_Y,
    JET_YY,
    LABEL_X,
    LABEL_Y,
    PLAIN_STEPS,
    RESIDUAL,
    RISE_1,
    RISE_2,
    RISE_3,
    SCRATCH_ROWS,
    TURNS,
    TURNS_X,
    TURNS_Y,
    WAVENUMBER,
    newton_update,
    solve_heights,
    solve_jets,
    wave_sums,
)
from sim.spectrum import WIDEST_SPREAD, equal_energy_frequencies, equal_share_angles

Array = NDArray[np.float64]

SAMPLES = 2048
"""Particles on which numbers are found that have no useful bound, such as how many Newton steps it
takes: where many waves would have to conspire, bounds are several times too careful."""

ELEVATION_ERROR = 1e-13
"""Error [m] that the solver leaves in an elevation, apart from the round-off of the position. It
sets the residual at which a point counts as solved (`Sea.residual_tolerance`)."""


DEFAULT_SPREAD = np.radians(25.0)
"""Standard deviation [rad] of the headings of a wind sea: 10 as the exponent in cos^2q."""


@dataclass(frozen=True)
class Wave:
    """One Gerstner wave on deep water.

    amplitude [m]; wavelength [m], crest to crest; heading [rad], the direction it travels in, from
    +x towards +y; phase [rad] at the origin at time 0. Raises ValueError.
    """

    amplitude: float
    wavelength: float
    heading: float = 0.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        for name in ("amplitude", "wavelength", "heading", "phase"):
            value = getattr(self, name)
            if not np.isfinite(value):
                raise ValueError(f"wave {name} is {value}; it must be a finite number")
        if self.amplitude < 0:
            raise ValueError(
                f"wave amplitude is {self.amplitude} m; it must be 0 or more "
                "(to turn a wave upside down add pi to its phase)"
            )
        if self.wavelength <= 0:
            raise ValueError(f"wavelength is {self.wavelength} m; it must be above 0")

    @property
    def wavenumber(self) -> float:
        """k = 2 pi / wavelength [rad/m]."""
        return 2.0 * np.pi / self.wavelength

    @property
    def steepness(self) -> float:
        """k a; the wave breaks at 1."""
        return self.wavenumber * self.amplitude


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

    waves: any number, none for flat water; density [kg/m^3]; gravity [m/s^2], downwards.
    Positions are world coordinates [m], times [s]; x, y and time broadcast. Immutable.
    Raises ValueError for waves that fold (sum of k a at 1 or above) and unusable numbers.

    steepness: sum of k a over the waves, the surface is a graph below 1; amplitude [m]: sum of
    the amplitudes, no crest rises and no trough falls further from the level.
    """

    waves: tuple[Wave, ...] = ()
    density: float = 1025.0
    gravity: float = 9.81
    level: float = 0.0
    components: Array = field(init=False, repr=False, compare=False)
    steepness: float = field(init=False, repr=False, compare=False)
    amplitude: float = field(init=False, repr=False, compare=False)
    residual_tolerance: float = field(init=False, repr=False, compare=False)

    def __init__(
        self,
        waves: Iterable[Wave] = (),
        density: float = 1025.0,
        gravity: float = 9.81,
        level: float = 0.0,
    ) -> None:
        for name, value in (("density", density), ("gravity", gravity)):
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"water {name} is {value}; it must be finite and above 0")
        if not np.isfinite(level):
            raise ValueError(f"water level is {level}; it must be a finite number")
        values = {"waves": tuple(waves), "density": density, "gravity": gravity, "level": level}
        for name, value in values.items():
            object.__setattr__(self, name, value if name == "waves" else float(value))
        object.__setattr__(self, "steepness", float(sum(w.steepness for w in self.waves)))
        object.__setattr__(self, "amplitude", float(sum(w.amplitude for w in self.waves)))
        if self.steepness >= 1.0:
            raise ValueError(
                f"the waves fold: the sum of k a over {len(self.waves)} waves is "
                f"{self.steepness:.3f} and must stay below 1; scale all amplitudes by less than "
                f"{1.0 / self.steepness:.3f} or lengthen the waves"
            )
        components = np.array([self._component(wave) for wave in self.waves])
        components = components.reshape(-1, COMPONENT_COLUMNS)
        components.setflags(write=False)
        object.__setattr__(self, "components", components)
        object.__setattr__(self, "residual_tolerance", self._residual_tolerance())

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
        density: float = 1025.0,
        gravity: float = 9.81,
        level: float = 0.0,
    ) -> "Sea":
        """An irregular sea with the JONSWAP spectrum (see `spectrum`).

        significant_height [m], 4 sqrt(m0); peak_period [s]; gamma: peak enhancement, 1 for a
        fully developed sea; heading [rad]: the mean one; spread [rad]: standard deviation of the
        headings, 0 for long crests; waves: how many, all of the same amplitude, each for one of
        as many bands of equal energy; seed: of their phases and of which wave goes where.
        Raises ValueError for numbers that cannot be and for waves that fold.
        """
        _check_jonswap(significant_height, peak_period, gamma, heading, spread, waves, seed)
        rng = np.random.default_rng(int(seed))
        count = int(waves)
        frequencies = equal_energy_frequencies(peak_period, gamma, count)
        headings = heading + rng.permutation(equal_share_angles(spread, count))
        phases = rng.uniform(0.0, 2.0 * np.pi, count)
        amplitude = significant_height * np.sqrt(1.0 / (8.0 * count))
        lengths = 2.0 * np.pi * gravity / frequencies**2
        steepness = float((2.0 * np.pi / lengths).sum() * amplitude)
        if steepness >= 1.0:
            raise ValueError(
                f"the waves of this JONSWAP sea fold: the sum of k a over {count} waves is "
                f"{steepness:.3f} and must stay below 1; lower the significant height below "
                f"{significant_height / steepness:.3g} m, raise the peak period above "
                f"{peak_period * np.sqrt(steepness):.3g} s, or take some "
                f"{max(1, int(0.9 * count / steepness**2))} waves"
            )
        components = zip(lengths, headings, phases, strict=True)
        return cls([Wave(amplitude, *numbers) for numbers in components], density, gravity, level)

    def _component(self, wave: Wave) -> tuple[float, ...]:
        direction_x, direction_y = np.cos(wave.heading), np.sin(wave.heading)
        frequency = np.sqrt(self.gravity * wave.wavenumber) / (2.0 * np.pi)
        return (
            direction_x / wave.wavelength,
            direction_y / wave.wavelength,
            wave.phase / (2.0 * np.pi),
            frequency,
            wave.amplitude,
            wave.wavenumber,
            direction_x,
            direction_y,
            *(wave.wavenumber**power * wave.amplitude for power in (1, 2, 3)),
        )

    def _residual_tolerance(self) -> float:
        """Residual [m] that leaves ELEVATION_ERROR once its first-order effect is made up for: a
        residual r then costs r^2/2 times the curvature."""
        curvature = self.curvature_bound
        return float(np.sqrt(2.0 * ELEVATION_ERROR / curvature)) if curvature > 0.0 else np.inf

    @property
    def significant_height(self) -> float:
        """4 sqrt(m0) [m] with m0 = sum a^2 / 2, the variance of the elevation to first order."""
        return float(4.0 * np.sqrt(sum(0.5 * wave.amplitude**2 for wave in self.waves)))

    @property
    def curvature_bound(self) -> float:
        """Bound [1/m] on the elevation's second derivatives, everywhere and in any direction.

        In the formula of H (see `gerstner.curvatures_from_sums`) each factor J^-1 is at most
        1 / (1 - sum k a) and the sum, as |G| <= sum k a / (1 - sum k a), at most
        sum k^2 a / (1 - sum k a).
        """
        total = sum(w.wavenumber**2 * w.amplitude for w in self.waves)
        return float(total / (1.0 - self.steepness) ** 3)

    def economised(self, radius: float) -> Array:
        """Components whose jets are economised: cubics that fit best over a disc of a radius [m]
        instead of Taylor's, which are best in its centre and several times worse at its rim.

        Along its direction each wave is replaced by the cubic next to it in the mean square over
        the disc. With s the place over the radius and u = k radius that is

            cos(u s) ~ b0 + b2 (4 s^2 - 1),        sin(u s) ~ 2 b1 s + b3 (8 s^3 - 4 s),

        Chebyshev's polynomials of the second kind, whose weight is that of a disc seen from the
        side; value and derivatives in the centre follow. (Lanczos 1938 for economised series.)
        Products of waves stay Taylor's. Slopes and offsets are changed so much alike that a
        label's Newton steps still shrink the residual, by a third or more, in any sea.
        """
        components = self.components.copy()
        u = components[:, [WAVENUMBER]] * radius
        count = 32 + 2 * int(u.max(initial=0.0))  # enough to resolve the shortest wave
        angles = np.pi * np.arange(1, count) / count
        s, weights = np.cos(angles), 2.0 / count * np.sin(angles)
        b0, b2 = (np.cos(u * s) @ (weights * np.sin(n * angles)) for n in (1, 3))
        b1, b3 = (np.sin(u * s) @ (weights * np.sin(n * angles)) for n in (2, 4))
        amplitude = self.components[:, AMPLITUDE]
        components[:, AMPLITUDE] = amplitude * (b0 - b2)
        components[:, RISE_1] = amplitude * (2.0 * b1 - 4.0 * b3) / radius
        components[:, RISE_2] = amplitude * -8.0 * b2 / radius**2
        components[:, RISE_3] = amplitude * -48.0 * b3 / radius**3
        components.setflags(write=False)  # as the sea's own, or kernels would be compiled for both
        return components

    def sample_places(self) -> tuple[Array, Array]:
        """Places x, y (SAMPLES,) [m] at time 0 of particles whose labels are spread over many
        wavelengths: all phases alike, and most of them where particles crowd, at the crests."""
        return tuple(self.particles(self._sample_labels(), 0.0)[:, :2].T.copy())

    def newton_steps(self, error: float) -> tuple[int, float]:
        """Newton steps, from the place itself, that bring the labels of all samples within an
        error [m] of the true ones, and the largest residual [m] that was left before the last of
        them. Taking as many everywhere leaves a smooth function of the place."""
        labels, (x, y) = self._sample_labels(), self.sample_places()
        heights, scratch = np.empty(SAMPLES), np.empty((SCRATCH_ROWS, SAMPLES))
        scratch[LABEL_X], scratch[LABEL_Y] = x, y
        steps, missed = 0, np.inf
        while missed > error and steps < PLAIN_STEPS:
            wave_sums(SAMPLES, self.components, 0.0, scratch)
            newton_update(x, y, heights, scratch)
            missed = np.hypot(*(scratch[LABEL_X : LABEL_Y + 1] - labels.T)).max()
            steps += 1
        return steps, float(np.sqrt(scratch[RESIDUAL].max()))

    def _sample_labels(self) -> Array:
        span = 1000.0 * max((wave.wavelength for wave in self.waves), default=1.0)
        return np.random.default_rng(0).uniform(-span, span, (SAMPLES, 2))

    def elevation(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Height z of the surface [m] above the points (x, y) at a time.

        Solved to ELEVATION_ERROR at any steepness the sea can have, plus the round-off of the
        position itself; NaN where an input is not finite.
        """

        def solve(x: Array, y: Array, time: float) -> Array:
            heights = np.empty(x.size)
            solve_heights(x, y, self.components, time, self.residual_tolerance, heights)
            return heights + self.level

        return _per_time(solve, x, y, time)

    def surface(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Surface:
        """Elevation, gradient, Hessian and the water's velocity, all from one solve."""
        jets = self._jets(x, y, time)
        hessian = jets[..., [JET_XX, JET_XY, JET_XY, JET_YY]].reshape((*jets.shape[:-1], 2, 2))
        theta = self._angles(jets[..., JET_LABEL_X:], np.asarray(time, dtype=float))
        speed = 2.0 * np.pi * self.components[:, FREQUENCY] * self.components[:, AMPLITUDE]
        directions = self.components[:, [DIRECTION_X, DIRECTION_Y]]
        across = (speed * np.sin(theta)) @ directions
        up = -np.cos(theta) @ speed
        return Surface(
            jets[..., JET_HEIGHT] + self.level,
            jets[..., JET_X : JET_Y + 1],
            hessian,
            np.concatenate([across, up[..., None]], axis=-1),
        )

    def gradient(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Slope (..., 2) of the elevation."""
        return self.surface(x, y, time).gradient

    def hessian(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Second derivatives (..., 2, 2) of the elevation [1/m]."""
        return self.surface(x, y, time).hessian

    def velocity(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Velocity (..., 3) [m/s] of the water particle at the surface above (x, y)."""
        return self.surface(x, y, time).velocity

    def labels(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Labels alpha (..., 2) [m] of the surface particles above (x, y): `particles` inverted."""
        return self._jets(x, y, time)[..., JET_LABEL_X:]

    def particles(self, labels: ArrayLike, time: float) -> Array:
        """Positions (..., 3) [m] of the surface particles with labels (..., 2) [m]."""
        labels = np.asarray(labels, dtype=float)
        theta = self._angles(labels, np.asarray(time, dtype=float))
        amplitude = self.components[:, AMPLITUDE]
        directions = self.components[:, [DIRECTION_X, DIRECTION_Y]]
        x = labels + (amplitude * np.cos(theta)) @ directions
        z = self.level + np.sin(theta) @ amplitude
        return np.concatenate([x, z[..., None]], axis=-1)

    def particle_grid(self, x: ArrayLike, y: ArrayLike, time: float) -> Array:
        """Positions (I, J, 3) [m] of the particles with labels (x_i, y_j), x: (I,) and y: (J,) [m].

        `particles` on a grid, at the price of its sides: exp(i theta) is a product of one
        factor for each x and one for each y, and summing over the waves a product of matrices.
        """
        columns = self.components.T
        turns_x = np.outer(x, columns[TURNS_X])
        turns_y = np.outer(y, columns[TURNS_Y]) + columns[TURNS] - columns[FREQUENCY] * time
        along_x = np.exp(2j * np.pi * (turns_x - np.round(turns_x)))
        along_y = columns[AMPLITUDE] * np.exp(2j * np.pi * (turns_y - np.round(turns_y)))
        positions = np.empty((len(along_x), len(along_y), 3))
        for axis, direction in enumerate((DIRECTION_X, DIRECTION_Y)):
            positions[..., axis] = ((along_x * columns[direction]) @ along_y.T).real
        positions[..., 0] += np.reshape(x, (-1, 1))
        positions[..., 1] += y
        positions[..., 2] = self.level + (along_x @ along_y.T).imag
        return positions

    def _angles(self, labels: Array, time: Array) -> Array:
        """theta (..., waves) [rad], within half a turn of 0, of all waves at labels (..., 2)."""
        turns = (
            labels @ self.components[:, [TURNS_X, TURNS_Y]].T
            + self.components[:, TURNS]
            - self.components[:, FREQUENCY] * time[..., None]
        )
        return 2.0 * np.pi * (turns - np.round(turns))

    def _jets(self, x: ArrayLike, y: ArrayLike, time: ArrayLike) -> Array:
        """Jets (..., JET_ROWS) at the points."""

        def solve(x: Array, y: Array, time: float) -> Array:
            jets = np.empty((JET_ROWS, x.size))
            solve_jets(x, y, self.components, time, self.residual_tolerance, 0, jets)
            return jets.T

        return _per_time(solve, x, y, time)


def _check_jonswap(
    height: float, period: float, gamma: float, heading: float, spread: float, waves: int, seed: int
) -> None:
    for name, value, unit in (("significant height", height, "m"), ("peak period", period, "s")):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"the {name} is {value} {unit}; it must be finite and above 0")
    if not (np.isfinite(gamma) and gamma >= 1.0):
        raise ValueError(f"gamma is {gamma}; it must be finite and 1 or more (3.3 is usual)")
    if not np.isfinite(heading):
        raise ValueError(f"the heading is {heading}; it must be a finite number")
    if not 0.0 <= spread < WIDEST_SPREAD:
        raise ValueError(
            f"the spread of the headings is {np.degrees(spread):g} degrees; it must be 0 or more "
            f"and below {np.degrees(WIDEST_SPREAD):.0f}"
        )
    for name, value, least in (("number of waves", waves, 1), ("seed", seed, 0)):
        if not (np.isfinite(value) and value == int(value) and value >= least):
            raise ValueError(f"the {name} is {value:g}; it must be a whole number from {least} on")


def _per_time(
    solve: Callable[[Array, Array, float], Array], x: ArrayLike, y: ArrayLike, time: ArrayLike
) -> Array:
    """Broadcast x, y and time, call solve(x, y, t) with flat x, y once for every distinct
    time (the kernels keep the time out of their inner loops) and put the result in shape."""
    x, y, time = (np.asarray(v, dtype=float) for v in (x, y, time))
    is_one_time = time.size == 1
    if not (time.ndim == 0 and x.shape == y.shape):
        x, y, time = np.broadcast_arrays(x, y, time)
    shape = x.shape
    x, y = np.ravel(x), np.ravel(y)
    if is_one_time:  # the usual case: sorting the times would cost more than solving
        result = solve(x, y, float(time.flat[0]) if time.size else 0.0)
    else:
        times, which = np.unique(time, return_inverse=True)
        which = np.ravel(which)
        result = np.empty((x.size, *solve(x[:0], y[:0], 0.0).shape[1:]))
        for i, t in enumerate(times):
            result[which == i] = solve(x[which == i], y[which == i], float(t))
    return result.reshape(shape + result.shape[1:])
