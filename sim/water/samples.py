"""Samples: estimates over particles of all phases, for properties of a sea that have no useful
bound."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim.kernels import read_only
from sim.water.gerstner import (
    CHUNK,
    LABELS,
    PLAIN_STEPS,
    SUMS,
    chunk_rows,
    label_chunks,
    newton_labels,
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


@lru_cache(maxsize=2)
def sample_places(sea: Sea) -> tuple[Array, Array]:
    """Positions x, y (SAMPLES,) [m] of the samples, most of them where particles crowd, at the
    crests."""
    labels, waves = sample_labels(sea), sea.components
    turns = labels @ np.stack([waves["turns_x"], waves["turns_y"]])
    turns = turns + waves["turns"] - waves["frequency"] * sea.ramp
    rest = turns - np.round(turns)
    offsets = waves["amplitude"] * waves["stretch"] * np.cos(2.0 * np.pi * rest)
    directions = np.stack([waves["direction_x"], waves["direction_y"]], axis=1)
    x, y = (labels + offsets @ directions).T.copy()
    return read_only(x), read_only(y)


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
    sums, found, heights = np.empty(1, SUMS), np.empty(1, LABELS), np.empty(CHUNK)
    stepped, largest = np.empty_like(labels), 0.0
    for chunk, guess, filled in label_chunks(labels):
        wave_sums(filled, sea.components, sea.ramp, guess, sums)
        newton_labels(x[chunk], y[chunk], guess, sums, heights, found)
        rows = chunk_rows(found, ("x", "y", "residual"), len(x[chunk]))
        stepped[chunk], largest = rows[:, :2], max(largest, float(rows[:, 2].max()))
    return stepped, float(np.sqrt(largest))
