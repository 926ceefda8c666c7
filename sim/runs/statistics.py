"""Statistics of series: means with errors for correlated samples, wave heights, and spectra."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FEWEST_BATCHES = 16
"""Least number of batches. With fewer, their scatter gives the error of a mean to no better than a
fifth."""

SEGMENTS_PER_SERIES = 8
"""Length of a series over that of a segment in `spectra`. More segments give a smoother spectrum
with a coarser resolution."""

LATEST_START_TIME = 1e4
"""Latest time [s] of the sea at which a run begins."""


def start_times(count: int, seed: int = 0) -> list[float]:
    """Times [s] of the sea at which runs begin: 0 and `count` - 1 seeded random times.

    The scene's initial state stays the same, but the phases of the waves differ.
    """
    return [0.0, *np.random.default_rng(seed).uniform(0.0, LATEST_START_TIME, count - 1).tolist()]


@dataclass(frozen=True)
class Heights:
    """Heights from trough to crest of a series, between successive upcrossings of its mean.

    significant: mean of the highest third. largest: the largest height. period: mean time between
    upcrossings [s]. All are NaN if there are fewer than two upcrossings.
    """

    significant: float
    largest: float
    period: float


def heights(times: ArrayLike, values: ArrayLike) -> Heights:
    """The `Heights` of a series (N,) at times (N,) [s]."""
    times, values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    off = values - values.mean()
    ups = np.flatnonzero((off[:-1] < 0.0) & (off[1:] >= 0.0)) + 1
    if len(ups) < 2:
        return Heights(np.nan, np.nan, np.nan)
    found = [np.ptp(values[a : b + 1]) for a, b in pairwise(ups)]
    highest = np.sort(found)[::-1][: -(-len(found) // 3)]
    period = (times[ups[-1]] - times[ups[0]]) / (len(ups) - 1)
    return Heights(float(highest.mean()), float(highest[0]), float(period))


def spectra(times: ArrayLike, *series: ArrayLike) -> tuple[Array, list[Array]]:
    """Frequencies (M,) [Hz] and one-sided spectral densities (M,) [unit^2 / Hz] of series (N,).

    The times (N,) [s] must be equidistant. The densities are averages over segments that overlap by
    half (Welch 1967), with a Hann window.
    """
    times = np.asarray(times, dtype=float)
    step = float(np.median(np.diff(times)))
    length = max(len(times) // SEGMENTS_PER_SERIES, min(len(times), 16))
    window = np.hanning(length + 1)[:-1]
    scale = 2.0 * step / float(window @ window)
    found = []
    for values in series:
        numbers = np.asarray(values, dtype=float)
        numbers = numbers - numbers.mean()
        starts = range(0, len(numbers) - length + 1, length // 2)
        segments = [np.fft.rfft(window * numbers[start : start + length]) for start in starts]
        found.append(scale * np.mean(np.abs(segments) ** 2, axis=0))
    return np.asarray(np.fft.rfftfreq(length, step), dtype=float), found


@dataclass(frozen=True)
class Mean:
    """A mean and its standard error, from the scatter of `batches` batches of `batch` samples each.

    settled: whether batches of this length and longer are uncorrelated. If they are not, the series
    is too short compared with its correlation time, and the error is too small.
    """

    value: float
    error: float
    batches: int
    batch: int
    settled: bool


def mean_of_runs(runs: Sequence[Array]) -> Mean:
    """Mean over independent runs (N,) of equal length; each run is one batch."""
    means = np.array([np.mean(run) for run in runs])
    error = means.std(ddof=1) / np.sqrt(len(means))
    return Mean(float(means.mean()), float(error), len(means), len(runs[0]), settled=True)


def mean_of_correlated(series: ArrayLike) -> Mean:
    """Mean of a stationary series (N,) of correlated samples, by batch means (Conway 1963).

    Means over batches much longer than the correlation time are independent, so their scatter gives
    the error of the whole mean. The batch length is doubled as long as at least FEWEST_BATCHES
    batches remain. A length is quiet if the correlation between neighbouring batches is within
    twice its noise of 1 / sqrt(batches). The shortest length is chosen from which on all lengths
    are quiet. If the longest is not quiet, it is chosen and `settled` is false. Raises ValueError
    for fewer than FEWEST_BATCHES samples.
    """
    series = np.asarray(series, dtype=float)
    if series.size < FEWEST_BATCHES:
        raise ValueError(
            f"the series has {series.size} samples; the error of its mean needs {FEWEST_BATCHES}"
        )
    chosen: tuple[float, int, int] | None = None
    settled = False
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
    assert chosen is not None  # the first length has FEWEST_BATCHES batches or more
    return Mean(float(series.mean()), *chosen, settled=settled)
