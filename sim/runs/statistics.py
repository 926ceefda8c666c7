"""Statistics: means of series whose samples remember their predecessors, and their errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FEWEST_BATCHES = 16
"""Batches below which their scatter tells the error of a mean to no better than a fifth."""


SEGMENTS = 8
"""Lengths of a segment in a series whose spectrum is wanted: more are smoother and less sharp."""

LATEST_START = 1e4
"""Seconds of the sea's time within which runs begin."""


def start_times(count: int, seed: int = 0) -> list[float]:
    """Times [s] of the sea at which runs begin: 0 and seeded random ones. The scene starts as it
    does, but meets other phases of the waves."""
    return [0.0, *np.random.default_rng(seed).uniform(0.0, LATEST_START, count - 1).tolist()]


@dataclass(frozen=True)
class Heights:
    """Heights from trough to crest of a series between its upcrossings of the mean: of the highest
    third, the largest, and the mean time between upcrossings [s]; NaN where there are none."""

    significant: float
    largest: float
    period: float


def heights(times: ArrayLike, values: ArrayLike) -> Heights:
    """The heights of a series (N,) at times (N,) [s]."""
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
    """Frequencies [Hz] and one-sided spectral densities (M,) [unit^2 / Hz] of series (N,) at even
    times (N,) [s], by Welch's averages over halves that overlap (1967), under Hann's window."""
    times = np.asarray(times, dtype=float)
    step = float(np.median(np.diff(times)))
    length = max(len(times) // SEGMENTS, min(len(times), 16))
    window = np.hanning(length + 1)[:-1]
    scale = 2.0 * step / float(window @ window)
    found = []
    for values in series:
        values = np.asarray(values, dtype=float) - np.mean(values)
        starts = range(0, len(values) - length + 1, length // 2)
        parts = [np.fft.rfft(window * values[start : start + length]) for start in starts]
        found.append(scale * np.mean(np.abs(parts) ** 2, axis=0))
    return np.fft.rfftfreq(length, step), found


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
