"""Records: seas from files that list wave components or record the elevation at one point.

A list is a CSV file with a header: amplitude [m], wavelength [m] or period [s], heading [deg] and
phase [deg], in any order. The last two are optional. A record has time [s] and elevation [m]. Units
in brackets after the names are ignored.

A record becomes the components of its Fourier series. Their sum is only close to the elevation at a
fixed point, because particles move to and fro there. The difference is therefore added to the
components until it vanishes. The sea then reproduces the record without its mean, and repeats
itself slightly later than the record's length.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.water.gerstner import smooth
from sim.water.sea import Sea
from sim.water.spectrum import MOST_WAVES
from sim.water.wave import Wave, shortening

Array = NDArray[np.float64]

KEPT_ENERGY_SHARE = 0.99995
"""Share of a record's energy in its band that is kept. The smallest components are dropped."""

CORRECTION_ROUNDS = 12
"""Number of corrections of the components. Each reduces the difference to a share of about k a."""

MOST_NAMES = 12
"""Largest number of names of columns that an error lists."""

COMPONENT_NAMES = ("amplitude", "wavelength", "period", "heading", "phase")


def read_components(path: Path, gravity: float, depth: float = np.inf) -> tuple[Wave, ...]:
    """Read waves from a list of components. gravity [m/s^2]; depth [m] of the water, inf for deep
    water. Raises ValueError, OSError."""
    table = read_table(path, COMPONENT_NAMES)
    lengths = [name for name in ("wavelength", "period") if name in table]
    if "amplitude" not in table or len(lengths) != 1:
        raise ValueError(
            f"{path} has the columns {', '.join(table)}; expected amplitude, wavelength or period, "
            "and optionally heading and phase"
        )
    count = len(table["amplitude"])
    if count > MOST_WAVES:
        raise ValueError(f"{path} has {count} components; expected at most {MOST_WAVES}")
    sizes = table[lengths[0]]
    if lengths[0] == "period":
        sizes = gravity * sizes**2 / (2.0 * np.pi)
        sizes = sizes * shortening(2.0 * np.pi / sizes, depth)
    angles = [np.radians(table.get(name, np.zeros(count))) for name in ("heading", "phase")]
    waves = []
    for line, wave in enumerate(zip(table["amplitude"], sizes, *angles, strict=True), start=2):
        try:
            waves.append(Wave(*map(float, wave)))
        except ValueError as error:
            raise ValueError(f"{path}, line {line}: {error}") from None
    return tuple(waves)


def read_record(
    path: Path,
    gravity: float,
    heading: float = 0.0,
    periods: tuple[float, float] = (1.0, 60.0),
    place: tuple[float, float] = (0.0, 0.0),
    depth: float = np.inf,
) -> tuple[Wave, ...]:
    """Read waves of one heading whose elevation at a point follows a record without its mean.

    heading [rad]; periods [s]: the band of periods; place: the point (x, y) [m]; gravity [m/s^2];
    depth [m] of the water, inf for deep water. Raises ValueError, OSError.
    """
    table = read_table(path, ("time", "elevation"))
    if set(table) != {"time", "elevation"}:
        raise ValueError(f"{path} has the columns {', '.join(table)}; expected time and elevation")
    times, elevations = table["time"], table["elevation"]
    if len(times) < 8 or not (np.diff(times) > 0.0).all():
        raise ValueError(f"{path}: expected 8 or more times in rising order")
    count = len(times)
    even = np.linspace(times[0], times[-1] + (times[-1] - times[0]) / (count - 1), count, False)
    wanted = np.interp(even, times, elevations)
    bridged = _bridged(wanted - wanted.mean())
    even = even[0] + (even[1] - even[0]) * np.arange(len(bridged))
    series = _Series(even, gravity, heading, periods, place, depth)
    return series.waves_of(bridged, len(wanted), path)


def _bridged(values: Array) -> Array:
    """Values (N,) and a tenth more, which lead smoothly from the end back to the beginning. The
    series is periodic, and a step there would cause ringing all through it."""
    count = max(len(values) // 10, 4)
    onwards, before = values[-2 : -2 - count : -1], values[count:0:-1]
    u = (np.arange(count) + 1.0) / (count + 1.0)
    share = smooth(u)
    return np.concatenate([values, (1.0 - share) * onwards + share * before])


class _Series:
    """Fourier components of a record at evenly spaced times (N,) [s], as waves."""

    def __init__(
        self,
        times: Array,
        gravity: float,
        heading: float,
        periods: tuple[float, float],
        place: tuple[float, float],
        depth: float,
    ) -> None:
        self.times, self.gravity, self.heading, self.place = times, gravity, heading, place
        self.depth = depth
        step = times[1] - times[0]
        self.omega = 2.0 * np.pi * np.fft.rfftfreq(len(times), step)
        low, high = (2.0 * np.pi / period for period in reversed(periods))
        self.is_in_band = (self.omega >= low) & (self.omega <= high) & (self.omega > 0.0)

    def waves_of(self, wanted: Array, count: int, path: Path) -> tuple[Wave, ...]:
        """Waves whose elevation at the point matches `wanted` (N,) [m] at the first `count` times.
        Later values are not matched."""
        parts = np.where(self.is_in_band, np.fft.rfft(wanted), 0.0)
        self._keep_largest(parts)
        if not self.is_in_band.any() or np.count_nonzero(self.is_in_band) > MOST_WAVES:
            raise ValueError(
                f"{path}: {np.count_nonzero(self.is_in_band)} components lie within the band; "
                f"expected 1 to {MOST_WAVES}; change the band's periods"
            )
        parts[~self.is_in_band] = 0.0
        for _ in range(CORRECTION_ROUNDS):
            sea = Sea(self._waves(parts), gravity=self.gravity, depth=self.depth)
            found = sea.elevation(*self.place, self.times)
            missed = wanted - (found - found[:count].mean())
            missed[count:] = 0.0
            parts[self.is_in_band] += np.fft.rfft(missed)[self.is_in_band]
        return self._waves(parts)

    def _keep_largest(self, parts: Array) -> None:
        """Keep only the largest components in the band, with KEPT_ENERGY_SHARE of its energy."""
        energy = np.abs(parts) ** 2
        order = np.argsort(-energy, kind="stable")
        before = np.concatenate([[0.0], np.cumsum(energy[order])[:-1]])
        self.is_in_band[order[before >= KEPT_ENERGY_SHARE * energy.sum()]] = False

    def _waves(self, parts: Array) -> tuple[Wave, ...]:
        """Waves of the chosen components. A component's cos(omega t + angle) equals the wave's sine
        with the phase pi / 2 - angle at the point."""
        chosen = np.flatnonzero(self.is_in_band)
        omega, part = self.omega[chosen], parts[chosen]
        wavenumbers = omega**2 / self.gravity
        wavenumbers = wavenumbers / shortening(wavenumbers, self.depth)
        along = self.place[0] * np.cos(self.heading) + self.place[1] * np.sin(self.heading)
        phases = 0.5 * np.pi - np.angle(part) + omega * self.times[0] - wavenumbers * along
        amplitudes = 2.0 * np.abs(part) / len(self.times)
        return tuple(
            Wave(float(a), float(2.0 * np.pi / k), self.heading, float(p % (2.0 * np.pi)))
            for a, k, p in zip(amplitudes, wavenumbers, phases, strict=True)
        )


def read_table(path: Path, known: Sequence[str]) -> dict[str, Array]:
    """Columns of a CSV file by name. Its header has known names, which units may follow. Raises
    ValueError, OSError."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not a text file; expected a CSV file with a header") from None
    names = [cell.split("[")[0].split("(")[0].strip().lower() for cell in rows[0]] if rows else []
    unknown = [name for name in names if name not in known]
    if unknown or len(set(names)) < len(names) or len(rows) < 2:
        listed = ", ".join(known[:MOST_NAMES]) + ", ..." * (len(known) > MOST_NAMES)
        raise ValueError(
            f"{path} begins with '{','.join(rows[0])[:60] if rows else ''}'; expected a header "
            f"with names from {listed}, each at most once, then lines of numbers"
        )
    columns: list[list[float]] = []
    for line, row in enumerate(rows[1:], start=2):
        try:
            values = [float(cell) for cell in row]
        except ValueError:
            values = []
        if len(values) != len(names) or not np.isfinite(values).all():
            raise ValueError(f"{path}, line {line}: expected {len(names)} finite numbers")
        columns.append(values)
    return dict(zip(names, np.transpose(columns), strict=True))
