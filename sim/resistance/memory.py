"""Memory: the states of the waves that a moving body has made (see `hydrodynamics` for the model).

A column with a0, a1 > 0 and a row l (6,) has two states, driven by u = l . nu:

    x1' = - a1 x1 - a0 x2 + u,    x2' = x1.

Over a step they are advanced by the exact solution for a u that is linear in time: the particular
solution x2 = alpha + beta t, x1 = beta, with beta = u' / a0 and alpha = (u - a1 beta) / a0, plus a
decaying oscillation with e^(- a1 t / 2) and the frequency sqrt(a0 - a1^2 / 4). So the states are
stable at any timestep, and those of a body at rest decay exactly.

A body that leaves the water makes fewer waves. Velocity in and force out are therefore both scaled
by the same number, sqrt(share). The power that the states take from the body is then what they
receive, whatever the share does, and the memory makes no energy.
"""

import numpy as np

from sim.kernels import kernel, record

COLUMN = record(stiffness="f8", damping="f8", column=("f8", 6))
"""A column of the memory: a0 [1/s^2], a1 [1/s] and l."""

SERIES_BOUND = 1e-6
"""Squared angle below which sine and cosine are replaced by their series, to 1e-16. The formulas
divide by the angle."""


@kernel
def free_decay(stiffness, damping, span):
    """How a free column with a0 and a1 decays over a time [s]: C and S [s], where x2 becomes
    x2 (C + a1 S / 2) + x1 S, and x1 becomes x1 (C - a1 S / 2) - a0 x2 S."""
    half = 0.5 * damping
    square = stiffness - half * half
    angle = abs(square) * span * span
    if angle < SERIES_BOUND:
        sign = square * span * span
        fade = np.exp(-half * span)
        return fade * (1.0 - sign * (0.5 - sign / 24.0)), fade * span * (1.0 - sign / 6.0)
    root = np.sqrt(abs(square))
    if square > 0.0:
        fade = np.exp(-half * span)
        return fade * np.cos(root * span), fade * np.sin(root * span) / root
    slow, fast = np.exp(-stiffness / (half + root) * span), np.exp(-(half + root) * span)
    return 0.5 * (slow + fast), 0.5 * (slow - fast) / root


@kernel
def advanced(column, first, second, before, after, span):
    """The states x1, x2 of a COLUMN after a time `span` [s], in which u went from `before` to
    `after`."""
    if span == 0.0:
        return first, second
    a0, a1 = column.stiffness, column.damping
    slope = (after - before) / (span * a0)
    start = (before - a1 * slope) / a0
    cosine, sine = free_decay(a0, a1, span)
    x1, x2 = first - slope, second - start
    half = 0.5 * a1 * sine
    return (
        slope + x1 * (cosine - half) - a0 * x2 * sine,
        start + slope * span + x2 * (cosine + half) + x1 * sine,
    )


@kernel
def remember(columns, span, share, is_kept, is_linear, velocity, states_out, force_out):
    """Advance the states of columns by a time `span` [s] and add their force (6,).

    share: how much of the response acts, from 0 to 1. velocity (6,): of the body. states_out: the
    scaled velocity (6,) at the last kept time, then x1 and x2 of each column. is_kept: whether the
    new states are stored. is_linear: whether the velocity changed linearly since then; otherwise it
    has had its present value, as in the step of all integrators but RK4, which move a body by
    the velocity at the end of the step.
    """
    root = np.sqrt(share)
    for c in range(columns.size):
        before, after = 0.0, 0.0
        for j in range(6):
            after += root * columns[c].column[j] * velocity[j]
            before += columns[c].column[j] * states_out[j]
        if not is_linear:
            before = after
        at = 6 + 2 * c
        x1, x2 = advanced(columns[c], states_out[at], states_out[at + 1], before, after, span)
        for j in range(6):
            force_out[j] -= root * columns[c].column[j] * x1
        if is_kept:
            states_out[at], states_out[at + 1] = x1, x2
    if is_kept:
        for j in range(6):
            states_out[j] = root * velocity[j]
