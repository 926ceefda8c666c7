"""Head: the pressure of the water over density * gravity, in metres; the one definition of it.

Everything that needs a pressure asks here: kernels by `solve_heads`, the rest of the package by
`Sea.head`, which does the same. The patches' cubic of the head is made from the same sums
(`jets`).

With the depth d = eta - (z - level) below the surface right above, and the phases theta at the
label of the surface particle there, the pressure of Froude and Krylov is

    below (d >= 0):   h = d - sum a m (sin(theta) + k a m / 2),    m = 1 - e^(-k d)
    above (d < 0):    h = d (1 - sum k a sin(theta)),

the hydrostatic one h = d everywhere. A wave's pressure dies out with depth: deep down h is the
depth below the mean level, which is sum k a^2 / 2 below `level`. Of one wave h is Gerstner's exact
pressure to second order (within 0.07 (k a)^2 a everywhere), of several to first; it is zero just on
the drawn surface, where its gradient is what the particles' acceleration asks for, exactly for
waves of one heading. Bodies do not change it: no diffraction, no radiated waves.
"""

import numpy as np

from sim.kernels import inline, kernel, record
from sim.water.gerstner import (
    CHUNK,
    LABELS,
    ONE,
    ROW,
    decay,
    growth,
    level_and_rise,
    set_labels,
    sine_cosine,
    solve_labels,
)

PRESSURES = ("froude-krylov", "hydrostatic")
"""What a sea's pressure may be called."""

DYNAMIC = record(lost=ROW, strain=ROW)
"""Workspace: what the decay takes of the head [m], and sum k a sin(theta)."""


def hydrostatic(height, above):
    """Depth [m] of a place so far above the still level [m] below the surface, which is at a height
    [m] above it: positive under water, zero on the surface."""
    return height - above


depth = inline(hydrostatic)


@kernel
def wave_losses(depths, waves, time, labels, dynamic_out):
    """DYNAMIC at the depths (N,) [m] below the first LABELS, filled up to LANES."""
    at, d = labels[0], dynamic_out[0]
    for i in range(depths.size):
        d.lost[i], d.strain[i] = 0.0, 0.0
    for w in range(waves.size):
        wave = waves[w]
        turns_x, turns_y = wave.turns_x, wave.turns_y
        turns = wave.turns - wave.frequency * time
        part = growth(wave, time)
        a, ka, k = part * wave.amplitude, part * wave.ka, wave.wavenumber
        for i in range(depths.size):
            s, _ = sine_cosine(turns_x * at.x[i] + turns_y * at.y[i] + turns)
            m = 1.0 - decay(k * max(depths[i], 0.0))
            d.lost[i] += a * m * (s + 0.5 * ka * m)
            d.strain[i] += ka * s


@kernel
def take_losses(depths, dynamic, heads_out):
    """Heads (N,) [m] from depths, of which there may be more."""
    d = dynamic[0]
    for i in range(heads_out.size):
        here = depths[i]
        heads_out[i] = here - d.lost[i] if here >= 0.0 else here * (1.0 - d.strain[i])


@kernel
def solve_heads(x, y, z, waves, water, time, heads_out):
    """Heads (N,) [m] at the points x, y, z: (N,) [m], from one solve each."""
    guess, labels = np.empty(1, LABELS), np.empty(1, LABELS)
    dynamic, depths = np.empty(1, DYNAMIC), np.empty(CHUNK)
    level, _ = level_and_rise(water[0], time)
    decays = water[0].decays and waves.size > 0
    for start in range(0, x.size, CHUNK):
        end = min(start + CHUNK, x.size)
        px, py, heads = x[start:end], y[start:end], heads_out[start:end]
        filled = set_labels(px, py, guess)
        solve_labels(px, py, guess, waves, time, water[0].tolerance, ONE, heads, labels)
        for i in range(end - start):  # until here these are the heights
            heads[i] = depth(heads[i], z[start + i] - level)
            depths[i] = heads[i]
        if decays:
            depths[end - start : filled] = 0.0
            wave_losses(depths[:filled], waves, time, labels, dynamic)
            take_losses(depths, dynamic, heads)
