"""Samples: estimates over particles of all phases, for properties of a sea that have no useful
bound."""

import numpy as np
from numpy.typing import NDArray

from sim.water.gerstner import (
    CHUNK,
    LABELS,
    PLAIN_STEPS,
    SUMS,
    newton_labels,
    set_labels,
    wave_sums,
)
from sim.water.sea import Sea

Array = NDArray[np.float64]

SAMPLES = 2048
"""Number of sampled particles."""

SAFETY = 1.5
"""Factor by which the worst point of the sea may exceed the worst sample."""


def still(sea: Sea) -> float:
    """The level [m] at the time of all samples, when the waves have grown."""
    return float(sea.level_at(sea.ramp))


def sample_labels(sea: Sea) -> Array:
    """Labels (SAMPLES, 2) [m] of the samples, spread over many wavelengths."""
    span = 1000.0 * max((wave.wavelength for wave in sea.waves), default=1.0)
    return np.random.default_rng(0).uniform(-span, span, (SAMPLES, 2))


def sample_places(sea: Sea) -> tuple[Array, Array]:
    """Positions x, y (SAMPLES,) [m] of the samples, most of them where particles crowd, at the
    crests."""
    return tuple(sea.particles(sample_labels(sea), sea.ramp)[:, :2].T.copy())


def newton_steps(sea: Sea, error: float) -> tuple[int, float]:
    """Number of Newton steps, from the points themselves, that bring the labels of all samples
    within an error [m] of the true ones, and the largest residual [m] before the last step. A fixed
    number of steps everywhere makes the result a smooth function of the position."""
    truth, (x, y) = sample_labels(sea), sample_places(sea)
    labels = np.column_stack([x, y])
    steps, missed, residual = 0, np.inf, 0.0
    while missed > error and steps < PLAIN_STEPS:
        labels, residual = _stepped(sea, x, y, labels)
        missed = np.hypot(*(labels - truth).T).max()
        steps += 1
    return steps, residual


def _stepped(sea: Sea, x: Array, y: Array, labels: Array) -> tuple[Array, float]:
    """Labels (N, 2) after one more Newton step, and the largest residual [m] before it."""
    guess, sums, found = np.empty(1, LABELS), np.empty(1, SUMS), np.empty(1, LABELS)
    stepped, heights, largest = np.empty_like(labels), np.empty(CHUNK), 0.0
    for start in range(0, len(labels), CHUNK):
        chunk = slice(start, min(start + CHUNK, len(labels)))
        count = chunk.stop - start
        filled = set_labels(labels[chunk, 0].copy(), labels[chunk, 1].copy(), guess)
        wave_sums(filled, sea.components, sea.ramp, guess, sums)
        newton_labels(x[chunk], y[chunk], guess, sums, heights, found)
        stepped[chunk] = np.column_stack([found["x"][0, :count], found["y"][0, :count]])
        largest = max(largest, float(found["residual"][0, :count].max()))
    return stepped, float(np.sqrt(largest))
