"""Wave: one Gerstner wave as users describe it, and a table of waves as kernels read them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.kernels import read_only
from sim.water.gerstner import WAVE

SIGMAS = 7.0
"""Bound on sums of waves (in J, the head's slope and heights), in standard deviations. Sums of
sines have thinner tails than the normal distribution, in which one crest in 4e10 exceeds seven
standard deviations. A hull of ten by ten wavelengths meets 5e4 crests an hour."""

PLAIN_SUM_WAVES = 25
"""Number of equally steep waves up to which their plain sum is the smaller bound. For more waves,
SIGMAS standard deviations are less."""


DEEP_PHASE = 20.0
"""k H from which a wave counts as one on deep water. There, tanh(k H) is 1 to the last bit, and
2e-9 of the wave's motion is left at the bottom."""

DISPERSION_STEPS = 12
"""Number of Newton steps for the dispersion relation. Five reach round-off at any depth."""


@dataclass(frozen=True)
class Wave:
    """One Gerstner wave.

    amplitude [m]; wavelength [m], crest to crest; heading [rad]: direction of travel, from +x
    towards +y; phase [rad] at the origin at time 0. Raises ValueError for invalid numbers.
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
                "(to turn a wave upside down, add pi to its phase)"
            )
        if self.wavelength <= 0:
            raise ValueError(f"wavelength is {self.wavelength} m; it must be above 0")

    @property
    def wavenumber(self) -> float:
        """k = 2 pi / wavelength [rad/m]."""
        return 2.0 * np.pi / self.wavelength

    @property
    def steepness(self) -> float:
        """k a; on deep water the wave breaks at 1."""
        return self.wavenumber * self.amplitude


def largest_sum(parts: Sequence[float] | NDArray[np.float64]) -> float:
    """The largest value of a sum of sines with the amplitudes `parts`: all of them at once, or
    SIGMAS standard deviations where that is less."""
    return float(min(np.sum(parts), SIGMAS * np.sqrt(0.5 * np.sum(np.square(parts)))))


def tanh_at(wavenumbers: NDArray[np.float64] | float, depth: float) -> NDArray[np.float64]:
    """T = tanh(k H) of waves with wavenumbers (N,) [rad/m] in water of a depth H [m], inf for deep
    water."""
    return np.tanh(np.multiply(wavenumbers, depth))


def shortening(deep_wavenumbers: NDArray[np.float64], depth: float) -> NDArray[np.float64]:
    """Lengths (N,) of waves in water of a depth [m] over the lengths of the waves with the same
    periods on deep water, whose wavenumbers (N,) [rad/m] are given.

    With y = k H this is T = tanh(y), where y T = y0 = deep wavenumber * H. Newton's method starts
    from y0 / sqrt(tanh(y0)) (Eckart 1952), which is within 5 % and exact at both ends.
    """
    if depth == np.inf:
        return np.ones_like(deep_wavenumbers)
    wanted = np.minimum(deep_wavenumbers * depth, DEEP_PHASE)
    y = wanted / np.sqrt(np.tanh(wanted))
    for _ in range(DISPERSION_STEPS):
        t = np.tanh(y)
        y = y - (y * t - wanted) / (t + y * (1.0 - t * t))
    return np.tanh(y)


def wave_table(
    waves: Sequence[Wave],
    gravity: float,
    current: Sequence[float] = (0.0, 0.0),
    ramp: float = 0.0,
    depth: float = np.inf,
) -> NDArray[np.void]:
    """WAVE records (N,), read-only. gravity [m/s^2]; current [m/s]: velocity of the water that
    carries the waves; ramp [s]: time in which they grow; depth [m] of the water."""
    table = np.zeros(len(waves), WAVE)
    for row, wave in zip(table, waves, strict=True):
        k, amplitude = wave.wavenumber, wave.amplitude
        direction_x, direction_y = np.cos(wave.heading), np.sin(wave.heading)
        row["turns_x"], row["turns_y"] = (
            direction_x / wave.wavelength,
            direction_y / wave.wavelength,
        )
        row["turns"] = wave.phase / (2.0 * np.pi)
        row["tanh"] = tanh_at(k, depth)
        row["stretch"] = 1.0 / row["tanh"]
        row["bed"] = 2.0 * k * depth if k * depth < DEEP_PHASE else 0.0
        row["rate"] = np.sqrt(gravity * k * row["tanh"])
        row["frequency"] = row["rate"] / (2.0 * np.pi)
        row["frequency"] += row["turns_x"] * current[0] + row["turns_y"] * current[1]
        row["amplitude"], row["wavenumber"] = amplitude, k
        row["direction_x"], row["direction_y"] = direction_x, direction_y
        row["ka"], row["kka"], row["kkka"] = k * amplitude, k**2 * amplitude, k**3 * amplitude
        row["rise"] = min(1.0 / ramp, np.finfo(float).max) if ramp > 0.0 else 0.0
    return read_only(table)
