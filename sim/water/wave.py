"""Wave: one Gerstner wave as people give it, and a table of many as kernels read it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.kernels import read_only
from sim.water.gerstner import WAVE


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


def wave_table(waves: Sequence[Wave], gravity: float) -> NDArray[np.void]:
    """WAVE records (N,), read-only."""
    table = np.zeros(len(waves), WAVE)
    for row, wave in zip(table, waves, strict=True):
        k, amplitude = wave.wavenumber, wave.amplitude
        direction_x, direction_y = np.cos(wave.heading), np.sin(wave.heading)
        row["turns_x"], row["turns_y"] = (
            direction_x / wave.wavelength,
            direction_y / wave.wavelength,
        )
        row["turns"] = wave.phase / (2.0 * np.pi)
        row["frequency"] = np.sqrt(gravity * k) / (2.0 * np.pi)
        row["amplitude"], row["wavenumber"] = amplitude, k
        row["direction_x"], row["direction_y"] = direction_x, direction_y
        row["ka"], row["kka"], row["kkka"] = k * amplitude, k**2 * amplitude, k**3 * amplitude
    return read_only(table)
