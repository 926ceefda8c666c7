"""Head: the pressure of the water over density * gravity, in metres.

This is the only definition of the pressure. Kernels call `solve_heads`, and the rest of the package
calls `Sea.head`, which uses it. The cubic of the head over a patch comes from the same sums
(`head_jets`).

With the depth d = eta - (z - level) below the surface directly above, and the phases theta at the
label of the surface particle there, the Froude-Krylov pressure is

    below (d >= 0):   h = d - sum a m (sin(theta) + k a m / 2),    m = 1 - e^(-k d)
    above (d < 0):    h = d (1 - sum k a sin(theta)),

and the hydrostatic one is h = d everywhere. In water of depth H, the Froude-Krylov pressure is

    below:   h = d - sum a (1 - C) sin(theta) - sum (k a^2 / 2) (1 - C + S^2 - T S) / T,
    above:   h = d (1 - sum k a T sin(theta)),

with T = tanh(k H), C = cosh(k (H - d)) / cosh(k H) and S = sinh(k (H - d)) / cosh(k H). On deep
water T = 1 and C = S = e^(-k d), which gives the formulas above.

The pressure of a wave decays with depth: deep down, h is the depth below the mean level, which lies
sum k a^2 / 2 below `level`. For one wave on deep water, h equals Gerstner's exact pressure to
second order (within 0.08 (k a)^2 a everywhere); for several waves, to first order. In shallow water
the waves themselves hold to first order only: where k H is below 1, steep crests are too round (19
% too low against a Fourier solution at half of the height at which they break). It is zero exactly
on the drawn surface. Its gradient there matches the particles' acceleration, exactly for waves of
one heading. Bodies do not change it: there is no diffraction and no radiation.
"""

from sim.kernels import inline, kernel, record, scratch, workspace
from sim.water.gerstner import (
    CHUNK,
    LABELS,
    ONE,
    ROW,
    bed_decays,
    decay,
    growth,
    level_and_rise,
    set_labels,
    sine_cosine,
    solve_labels,
)

PRESSURES = ("froude-krylov", "hydrostatic")
"""Names of the pressures that a sea can have."""

DYNAMIC = record(lost=ROW, strain=ROW)
"""Workspace: the head [m] lost by the decay with depth, and sum k a sin(theta)."""


def hydrostatic(height, above):
    """Depth [m] below the surface: positive under water, zero on the surface. height: of the
    surface; above: of the point, both above the still level [m]."""
    return height - above


depth = inline(hydrostatic)


@inline
def add_deep_losses(d, i, s, x, a, ka):
    """Add one wave on deep water, with sine s of its phase, to DYNAMIC at k times the depth = x."""
    m = 1.0 - decay(x)
    d.lost[i] += a * m * (s + 0.5 * ka * m)
    d.strain[i] += ka * s


@inline
def add_bed_losses(d, i, s, x, a, ka, wave):
    """Add one wave above a bottom, as in `add_deep_losses`."""
    c, v = bed_decays(x, wave.bed, wave.tanh)
    second = (1.0 - c + v * (v - wave.tanh)) * wave.stretch
    d.lost[i] += a * ((1.0 - c) * s + 0.5 * ka * second)
    d.strain[i] += ka * wave.tanh * s


@kernel
def wave_losses(depths, waves, time, labels, dynamic_out):
    """Compute DYNAMIC at the depths (N,) [m] below the first N LABELS; N is filled up to LANES."""
    at, d = labels[0], dynamic_out[0]
    for i in range(depths.size):
        d.lost[i], d.strain[i] = 0.0, 0.0
    for w in range(waves.size):
        wave = waves[w]
        turns_x, turns_y = wave.turns_x, wave.turns_y
        turns = wave.turns - wave.frequency * time
        part = growth(wave, time)
        a, ka, k = part * wave.amplitude, part * wave.ka, wave.wavenumber
        if wave.bed == 0.0:
            for i in range(depths.size):
                s, _ = sine_cosine(turns_x * at.x[i] + turns_y * at.y[i] + turns)
                add_deep_losses(d, i, s, k * max(depths[i], 0.0), a, ka)
        else:
            for i in range(depths.size):
                s, _ = sine_cosine(turns_x * at.x[i] + turns_y * at.y[i] + turns)
                add_bed_losses(d, i, s, k * max(depths[i], 0.0), a, ka, wave)


@kernel
def take_losses(depths, dynamic, heads_out):
    """Heads (N,) [m] from at least N depths."""
    d = dynamic[0]
    for i in range(heads_out.size):
        here = depths[i]
        heads_out[i] = here - d.lost[i] if here >= 0.0 else here * (1.0 - d.strain[i])


@kernel
def solve_heads(x, y, z, waves, water, time, heads_out):
    """Heads (N,) [m] at the points x, y, z: (N,) [m], from one solve each."""
    guess, labels = workspace(LABELS), workspace(LABELS)
    dynamic, depths = workspace(DYNAMIC), scratch(CHUNK)
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
