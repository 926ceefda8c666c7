"""Spectrum: the JONSWAP spectrum of a wind sea, and waves that have its energy.

With peak angular frequency p, x = omega / p and significant height H the density of
the elevation's variance is

    S(omega) = (H^2 / 16) / p * shape(x) / integral of shape,
    shape(x) = x^-5 exp(-5/4 x^-4) gamma^exp(-(x - 1)^2 / (2 s^2)),

where s is 0.07 below the peak and 0.09 above.

The integral is computed, not taken from the usual fit 1 - 0.287 ln(gamma), so that the
zeroth moment is H^2 / 16 for any gamma. Headings spread as cos^2q of half their angle from the mean
one, whose standard deviation is sqrt(2 / (1 + q)).

Sources: Hasselmann et al. 1973 (JONSWAP); DNV-RP-C205, section 3.5, for the form above;
Longuet-Higgins, Cartwright and Smith 1963 and Mitsuyasu et al. 1975 for the spreading.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FREQUENCIES = np.geomspace(0.3, 30.0, 20_001)
"""Frequencies in peaks at which the spectrum is tabulated. Outside of them lies less than 2e-6 of
its energy, all of it in ripples."""

WIDEST_SPREAD = np.sqrt(2.0)
"""Standard deviation [rad] of headings that come from everywhere alike."""


def density(frequencies: ArrayLike, height: float, period: float, gamma: float) -> Array:
    """Variance density S (...) [m^2 s] of the elevation at angular frequencies [rad/s], for a
    significant height [m], a peak period [s] and a peak enhancement gamma."""
    peak = 2.0 * np.pi / period
    total = np.trapezoid(_shape(FREQUENCIES, gamma), FREQUENCIES)
    shape = _shape(np.asarray(frequencies, dtype=float) / peak, gamma)
    return height**2 / 16.0 / peak * shape / total


def _shape(x: Array, gamma: float) -> Array:
    width = np.where(x <= 1.0, 0.07, 0.09)
    peakedness = gamma ** np.exp(-0.5 * ((x - 1.0) / width) ** 2)
    return x**-5.0 * np.exp(-1.25 * x**-4.0) * peakedness


def equal_energy_frequencies(period: float, gamma: float, count: int) -> Array:
    """Angular frequencies (N,) [rad/s], rising: the middles, by energy, of `count` bands of equal
    energy. They stand closest at the peak and in no ratio to one another, so a sum of such
    waves repeats itself only after a very long time."""
    shape = _shape(FREQUENCIES, gamma)
    steps = 0.5 * (shape[1:] + shape[:-1]) * np.diff(FREQUENCIES)
    energy = np.concatenate([[0.0], np.cumsum(steps)])
    middles = (np.arange(count) + 0.5) / count
    return np.interp(middles, energy / energy[-1], FREQUENCIES) * 2.0 * np.pi / period


def equal_share_angles(spread: float, count: int) -> Array:
    """Angles (N,) [rad] from the mean heading, rising, each for an equal share of the energy;
    spread [rad], their standard deviation, below WIDEST_SPREAD."""
    if spread == 0.0:
        return np.zeros(count)
    exponent = 2.0 / spread**2 - 1.0
    angles = np.linspace(-np.pi, np.pi, 20_001)
    shares = np.cumsum(np.cos(0.5 * angles) ** (2.0 * exponent))
    middles = (np.arange(count) + 0.5) / count
    return np.interp(middles, (shares - 0.5 * shares[0]) / shares[-1], angles)
