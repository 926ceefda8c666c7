"""Spectrum: spectra of irregular seas, and waves with their energy.

With peak angular frequency p, x = omega / p and significant height H, the variance density of the
elevation is

    S(omega) = (H^2 / 16) / p * shape(x) / integral of shape,
    shape(x) = x^-5 exp(-5/4 x^-4) gamma^exp(-(x - 1)^2 / (2 s^2)),

where s is 0.07 below the peak and 0.09 above. This is the JONSWAP spectrum. With gamma 1 it is the
Pierson-Moskowitz spectrum of a fully developed sea, which Bretschneider and the ISSC use with any
height and period. The Ochi-Hubble spectrum has a swell and a wind sea, each with a height, a period
and a sharpness q:

    S(omega) ~ sum of H^2 x^-(4q + 1) exp(-(q + 1/4) x^-4), each with the variance H^2 / 16.

The integral is computed, not taken from the usual fit 1 - 0.287 ln(gamma), so that the zeroth
moment is H^2 / 16 for any gamma. Headings are distributed as cos^2q of half the angle from the mean
heading. Their standard deviation is sqrt(2 / (1 + q)).

Sources: Hasselmann et al. 1973 (JONSWAP); DNV-RP-C205, section 3.5, for the form above; Pierson and
Moskowitz 1964; Bretschneider 1959; Ochi and Hubble 1976; Longuet-Higgins, Cartwright and Smith 1963
and Mitsuyasu et al. 1975 for the spreading.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.water.wave import PLAIN_SUM_WAVES, Wave, largest_sum, shortening

Array = NDArray[np.float64]

FREQUENCIES = np.geomspace(0.3, 30.0, 20_001)
"""Frequencies at which the spectrum is tabulated, as multiples of the peak frequency. Less than
2e-6 of its energy lies outside, all of it in ripples."""

WIDEST_SPREAD = np.sqrt(2.0)
"""Standard deviation [rad] of headings that are uniform over all directions."""

SMALLEST_NUMBER = 1e-9
"""Bound of heights [m] and periods [s] above 0. Squares of much smaller ones are lost."""

NARROWEST_SPREAD = 1e-5
"""Standard deviation [rad] of headings below which all headings are the same. Crests are then more
than 10,000 wavelengths long."""

MOST_WAVES, LARGEST_SEED = 5_000, 2**53
"""Maximum number of waves of a sea, each of which adds to the cost of every step; and the largest
seed, above which the doubles of a custom numeric cannot tell consecutive integers apart."""

DEFAULT_SPREAD = np.radians(25.0)
"""Standard deviation [rad] of the headings of a wind sea, with the exponent 10 in cos^2q."""


@dataclass(frozen=True)
class Spectrum:
    """The distribution of the variance of a sea's elevation over frequencies.

    significant_height [m], 4 sqrt(m0); frequencies (N,) [rad/s], rising; density (N,): variance
    density at the frequencies, up to a factor.
    """

    significant_height: float
    frequencies: Array
    density: Array

    def waves(
        self,
        heading: float = 0.0,
        spread: float = DEFAULT_SPREAD,
        waves: int = 40,
        seed: int = 0,
        gravity: float = 9.81,
        depth: float = np.inf,
    ) -> tuple[Wave, ...]:
        """Waves of equal amplitude, one for each of `waves` bands of equal energy.

        heading [rad]: mean heading; spread [rad]: standard deviation of the headings, 0 for long
        crests; seed: of the random phases and of the assignment of headings to waves; gravity
        [m/s^2]; depth [m] of the water, in which waves of the same periods are shorter. Raises
        ValueError for invalid numbers and for waves that fold.
        """
        _check_directions(heading, spread)
        _check_counts(waves, seed)
        rng, count = np.random.default_rng(int(seed)), int(waves)
        chosen = equal_energy_frequencies(self.frequencies, self.density, count)
        headings = heading + rng.permutation(equal_share_angles(spread, count))
        phases = rng.uniform(0.0, 2.0 * np.pi, count)
        amplitude = self.significant_height * np.sqrt(1.0 / (8.0 * count))
        shorter = shortening(chosen**2 / gravity, depth)  # tanh(k depth)
        lengths = 2.0 * np.pi * gravity / chosen**2 * shorter
        parts = 2.0 * np.pi / lengths * amplitude / shorter
        _check_folding(parts, self.significant_height, depth)
        return tuple(Wave(amplitude, *w) for w in zip(lengths, headings, phases, strict=True))


def jonswap(significant_height: float, peak_period: float, gamma: float = 3.3) -> Spectrum:
    """Spectrum of a growing sea. significant_height [m]; peak_period [s]; gamma: peak enhancement.
    Raises ValueError for invalid numbers."""
    _check_height(significant_height, peak_period)
    if not (np.isfinite(gamma) and gamma >= 1.0):
        raise ValueError(f"gamma is {gamma}; it must be finite and 1 or more (3.3 is usual)")
    peak = 2.0 * np.pi / peak_period
    return Spectrum(significant_height, FREQUENCIES * peak, _shape(FREQUENCIES, gamma))


def bretschneider(significant_height: float, peak_period: float) -> Spectrum:
    """Spectrum of a sea without peak enhancement, as the ISSC uses it. significant_height [m];
    peak_period [s]. Raises ValueError for invalid numbers."""
    return jonswap(significant_height, peak_period, gamma=1.0)


def pierson_moskowitz(significant_height: float, gravity: float = 9.81) -> Spectrum:
    """Spectrum of a fully developed sea with a significant height [m]. Its peak is at 0.877 g / U
    rad/s and its height is 0.2092 U^2 / g for a wind speed U at 19.5 m. gravity [m/s^2]. Raises
    ValueError for invalid numbers."""
    _check_height(significant_height, 1.0)
    wind = np.sqrt(significant_height * gravity / 0.2092)
    return bretschneider(significant_height, float(2.0 * np.pi * wind / (0.877 * gravity)))


def ochi_hubble(
    swell_height: float,
    swell_period: float,
    swell_sharpness: float,
    wind_sea_height: float,
    wind_sea_period: float,
    wind_sea_sharpness: float,
) -> Spectrum:
    """Spectrum with two peaks. Each has a significant height [m], a peak period [s] and a
    sharpness: 1 as in Pierson-Moskowitz, higher for narrower peaks. Raises ValueError for invalid
    numbers."""
    parts = (
        (swell_height, swell_period, swell_sharpness),
        (wind_sea_height, wind_sea_period, wind_sea_sharpness),
    )
    for height, period, sharpness in parts:
        _check_height(height, period)
        if not 0.5 <= sharpness <= 30.0:
            raise ValueError(f"the sharpness of a peak is {sharpness}; it must be 0.5 to 30")
    peaks = [2.0 * np.pi / period for _, period, _ in parts]
    frequencies = np.geomspace(FREQUENCIES[0] * min(peaks), FREQUENCIES[-1] * max(peaks), 40_001)
    density = np.zeros_like(frequencies)
    for (height, _, sharpness), peak in zip(parts, peaks, strict=True):
        x = frequencies / peak
        part = x ** -(4.0 * sharpness + 1.0) * np.exp(-(sharpness + 0.25) * (x**-4.0 - 1.0))
        density += height**2 * part / np.trapezoid(part, frequencies)
    return Spectrum(float(np.hypot(swell_height, wind_sea_height)), frequencies, density)


def _shape(x: Array, gamma: float) -> Array:
    width = np.where(x <= 1.0, 0.07, 0.09)
    peakedness = gamma ** np.exp(-0.5 * ((x - 1.0) / width) ** 2)
    return x**-5.0 * np.exp(-1.25 * x**-4.0) * peakedness


def equal_energy_frequencies(frequencies: Array, density: Array, count: int) -> Array:
    """Angular frequencies (N,) [rad/s], rising: the energy medians of `count` bands of equal
    energy. They are densest at the peak and have no simple ratios, so a sum of such waves repeats
    itself only after a very long time."""
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(frequencies)
    energy = np.concatenate([[0.0], np.cumsum(steps)])
    middles = (np.arange(count) + 0.5) / count
    return np.interp(middles, energy / energy[-1], frequencies)


def equal_share_angles(spread: float, count: int) -> Array:
    """Angles (N,) [rad] from the mean heading, rising, with equal shares of the energy. spread
    [rad]: their standard deviation, below WIDEST_SPREAD."""
    if spread < NARROWEST_SPREAD:
        return np.zeros(count)
    exponent = 2.0 / spread**2 - 1.0
    widest = min(np.pi, 40.0 * spread)
    angles = np.linspace(-widest, widest, 20_001)
    shares = np.cumsum(np.cos(0.5 * angles) ** (2.0 * exponent))
    middles = (np.arange(count) + 0.5) / count
    return np.interp(middles, (shares - 0.5 * shares[0]) / shares[-1], angles)


def _check_folding(parts: Array, height: float, depth: float) -> None:
    """Raise ValueError for waves of steepnesses (N,) that fold in water of a depth [m], with
    changes that would avoid it. A longer period is no remedy in shallow water."""
    steepness, count = largest_sum(parts), len(parts)
    if steepness < 1.0:
        return
    met = " as waves meet" if count > PLAIN_SUM_WAVES else ""
    is_deep = depth == np.inf
    longer = f"make the period {np.sqrt(steepness):.3g} times as long, " if is_deep else ""
    raise ValueError(
        f"the waves of this sea fold: the sum of k a {'' if is_deep else '/ tanh(k depth) '}over "
        f"{count} waves is {steepness:.4g}{met} "
        f"and must stay below 1; lower the significant height below {height / steepness:.3g} m, "
        f"{longer}or use about "
        f"{max(1, int(0.9 * count / parts.sum() ** 2))} waves"
    )


def _check_height(height: float, period: float) -> None:
    for name, value, unit in (("significant height", height, "m"), ("peak period", period, "s")):
        if not SMALLEST_NUMBER < value < np.inf:
            raise ValueError(
                f"the {name} is {value} {unit}; it must be finite and above {SMALLEST_NUMBER:g}"
            )


def _check_directions(heading: float, spread: float) -> None:
    if not np.isfinite(heading):
        raise ValueError(f"the heading is {heading}; it must be a finite number")
    if not 0.0 <= spread < WIDEST_SPREAD:
        raise ValueError(
            f"the spread of the headings is {np.degrees(spread):g} degrees; it must be 0 or more "
            f"and below {np.degrees(WIDEST_SPREAD):.0f}"
        )


def _check_counts(waves: int, seed: int) -> None:
    for name, value, least, most in (
        ("number of waves", waves, 1, MOST_WAVES), ("seed", seed, 0, LARGEST_SEED)
    ):  # fmt: skip
        if not (least <= value <= most and value == int(value)):
            raise ValueError(
                f"the {name} is {value:g}; it must be a whole number from {least} to {most}"
            )
