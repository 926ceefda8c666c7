"""Many waves: the sums of jets with the waves as lanes, for seas of hundreds of waves.

`jets` and `head_jets` take the points of a chunk as lanes, one wave after the other, and load and
store all sums for each wave. That is best for a few waves. Here the waves are the lanes, one point
after the other: the sums of a point stay in registers, and the factors of a tile of waves in the
cache. `speed_vs_error.py --ship` prints what a wrench then costs.

The sums are in single precision, each accurate to 1e-6 of its largest values. Phases are reduced to
a fraction of a turn in double precision, so this holds anywhere and at any time.
"""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from sim.kernels import inline, kernel, record, scratch, summing_kernel, workspace
from sim.precision import in_single
from sim.water.gerstner import (
    CHUNK,
    LABELS,
    ONE,
    SUMS,
    clear_sums,
    decay,
    growth,
    newton_labels,
    set_labels,
    sine_cosine,
    solve_labels,
    take_labels,
)
from sim.water.head_jets import DECAYED, clear_decayed, finish_head_jets, set_depths, set_ups
from sim.water.jets import (
    HIGHER_SUMS,
    Near,
    clear_higher,
    finish_jets,
    keep_labels,
    set_rests,
)

Array = NDArray[np.float64]

MANY_WAVES = 24
"""Number of waves from which this is faster."""

TILE = 200
"""Number of waves whose factors are in the first-level cache together. Each tile adds its sums up
across the lanes once for every point, so a few large ones are faster than many small ones. It is
not a power of two (see `gerstner.CHUNK`)."""

WIDTH = 8
"""Tiles are filled up to a multiple of this number of waves, which fill a vector register."""

ROW, DOUBLES = ("f4", TILE), ("f8", TILE)

FACTORS = record(
    turns_x=DOUBLES, turns_y=DOUBLES, turns=DOUBLES,
    x=ROW, y=ROW, z=ROW, z_x=ROW, z_y=ROW, x_x=ROW, x_y=ROW, y_y=ROW,
    z_xx=ROW, z_xy=ROW, z_yy=ROW, x_xx=ROW, x_xy=ROW, x_yy=ROW, y_yy=ROW,
    z_xxx=ROW, z_xxy=ROW, z_xyy=ROW, z_yyy=ROW,
    x_xxx=ROW, x_xxy=ROW, x_xyy=ROW, x_yyy=ROW, y_yyy=ROW,
    k=ROW, bed=ROW, tanh=ROW, half=ROW, ka=ROW, xs=ROW, ys=ROW, xxs=ROW, xys=ROW, yys=ROW,
    lost=ROW, s_1=ROW, s_2=ROW, s_3=ROW, feel_bed="i8",
)  # fmt: skip
"""Workspace: what each wave of a tile has to be multiplied by.

turns_x, turns_y, turns: its phase now [turns]; factors of its sine or cosine in SUMS and
HIGHER_SUMS, and in DECAYED where they differ; lost, s_1, s_2, s_3: of the second sum of a head; k,
tanh: as in a WAVE; bed: as there, but NO_BED on deep water; half: (1 + tanh) / 2; feel_bed: whether
any of the waves is not on deep water.
"""

PHASES = record(sine=ROW, cosine=ROW, down=ROW, up=ROW)
"""Workspace: sines and cosines of a tile's waves at a point, and their C and S (see `head`), which
both are the decay e^(-k d) on deep water."""

NO_BED = 1e9
"""Twice k H of a wave that does not feel the bottom."""

ZERO, HALF, UNIT, TWO, EIGHT = map(np.float32, (0.0, 0.5, 1.0, 2.0, 8.0))
LOG2_E, MOST_HALVINGS = np.float32(np.log2(np.e)), np.float32(120.0)


def _power_series(
    function: Callable[[Array], Array], degree: int, end: float
) -> tuple[np.float32, ...]:
    """Coefficients of the polynomial that meets a function at Chebyshev's nodes from 0 to an
    end."""
    found = Chebyshev.interpolate(function, degree, [0.0, end])
    return tuple(map(np.float32, found.convert(kind=Polynomial).coef))


# of sin(2 pi u) / u and cos(2 pi u) by u^2, for |u| <= 1/4, and of 2^-f for 0 <= f <= 1
SINE = _power_series(lambda q: 2.0 * np.pi * np.sinc(2.0 * np.sqrt(np.abs(q))), 5, 1.0 / 16.0)
COSINE = _power_series(lambda q: np.cos(2.0 * np.pi * np.sqrt(np.abs(q))), 5, 1.0 / 16.0)
HALVING = _power_series(lambda f: 2.0**-f, 5, 1.0)


@in_single(sine_cosine)
@inline
def single_sine_cosine(u):
    """Sine and cosine of an angle from -1/2 to 1/2 turns, to 2e-7."""
    half_turns = np.floor(TWO * u + HALF)
    u = u - HALF * half_turns
    sign = UNIT - TWO * half_turns * half_turns
    q = u * u
    s, c = SINE[5], COSINE[5]
    s, c = s * q + SINE[4], c * q + COSINE[4]
    s, c = s * q + SINE[3], c * q + COSINE[3]
    s, c = s * q + SINE[2], c * q + COSINE[2]
    s, c = s * q + SINE[1], c * q + COSINE[1]
    s, c = s * q + SINE[0], c * q + COSINE[0]
    return sign * s * u, sign * c


@in_single(decay)
@inline
def single_decay(x):
    """exp(-x) for x >= 0, to 2e-7: a power of 2 times 2^-f."""
    y = min(x * LOG2_E, MOST_HALVINGS)
    halvings = np.floor(y)
    f = y - halvings
    rest = HALVING[5]
    rest = rest * f + HALVING[4]
    rest = rest * f + HALVING[3]
    rest = rest * f + HALVING[2]
    rest = rest * f + HALVING[1]
    rest = rest * f + HALVING[0]
    exponent = np.int32(127) - np.int32(halvings)  # of a float with bits 23 to 30
    return rest * np.int32(exponent << 23).view(np.float32)


@kernel
def set_label_factors(waves, time, factors_out):
    """Set those FACTORS of a tile of waves at a time that SUMS take. Return their number, filled up
    to WIDTH with waves without height."""
    q = factors_out[0]
    filled = -(-waves.size // WIDTH) * WIDTH
    for w in range(filled):
        wave = waves[min(w, waves.size - 1)]
        part = growth(wave, time) if w < waves.size else 0.0
        a, ka, dx, dy = (
            part * wave.amplitude, part * wave.ka, wave.direction_x, wave.direction_y
        )  # fmt: skip
        wide_x, wide_y = wave.stretch * dx, wave.stretch * dy
        q.turns_x[w], q.turns_y[w] = wave.turns_x, wave.turns_y
        q.turns[w] = wave.turns - wave.frequency * time
        q.x[w], q.y[w], q.z[w], q.z_x[w], q.z_y[w] = wide_x * a, wide_y * a, a, dx * ka, dy * ka
        q.x_x[w], q.x_y[w], q.y_y[w] = wide_x * dx * ka, wide_x * dy * ka, wide_y * dy * ka
    return filled


@kernel
def set_factors(waves, time, factors_out):
    """Set all FACTORS of a tile of waves at a time. Return their number, as `set_label_factors`
    does."""
    q, filled = factors_out[0], set_label_factors(waves, time, factors_out)
    q.feel_bed = 0
    for w in range(filled):
        wave = waves[min(w, waves.size - 1)]
        part = growth(wave, time) if w < waves.size else 0.0
        a, ka, kka, kkka = (
            part * wave.amplitude, part * wave.ka, part * wave.kka, part * wave.kkka
        )  # fmt: skip
        k, dx, dy = wave.wavenumber, wave.direction_x, wave.direction_y
        wide_x, wide_y, xx, xy, yy = wave.stretch * dx, wave.stretch * dy, dx * dx, dx * dy, dy * dy
        second = 0.5 * ka * ka * wave.stretch
        q.z_xx[w], q.z_xy[w], q.z_yy[w] = xx * kka, xy * kka, yy * kka
        q.x_xx[w], q.x_xy[w] = wide_x * xx * kka, wide_y * xx * kka
        q.x_yy[w], q.y_yy[w] = wide_x * yy * kka, wide_y * yy * kka
        q.z_xxx[w], q.z_xxy[w] = dx * xx * kkka, dy * xx * kkka
        q.z_xyy[w], q.z_yyy[w] = dx * yy * kkka, dy * yy * kkka
        q.x_xxx[w], q.x_xxy[w] = wide_x * dx * xx * kkka, wide_x * dx * xy * kkka
        q.x_xyy[w], q.x_yyy[w] = wide_x * dx * yy * kkka, wide_x * dy * yy * kkka
        q.y_yyy[w] = wide_y * dy * yy * kkka
        q.feel_bed |= wave.bed > 0.0
        q.bed[w] = wave.bed if wave.bed > 0.0 else NO_BED
        q.k[w], q.tanh[w], q.half[w] = k, wave.tanh, 0.5 * (1.0 + wave.tanh)
        q.ka[w], q.xs[w], q.ys[w] = ka, dx * kka, dy * kka
        q.xxs[w], q.xys[w], q.yys[w] = xx * kkka, xy * kkka, yy * kkka
        q.lost[w], q.s_1[w] = 0.5 * a * ka * wave.stretch, second
        q.s_2[w], q.s_3[w] = k * second, k * k * second
    return filled


@kernel
def set_phases(count, factors, x, y, phases_out):
    """Set the sines and cosines of the first `count` waves of a tile at a label x, y [m]."""
    q, p = factors[0], phases_out[0]
    for w in range(count):
        turns = q.turns_x[w] * x + q.turns_y[w] * y + q.turns[w]
        p.cosine[w] = turns - np.floor(turns + 0.5)
    for w in range(count):
        p.sine[w], p.cosine[w] = single_sine_cosine(p.cosine[w])


@kernel
def set_decays(count, factors, depth, phases_out):
    """Set C and S of the first `count` waves of a tile at a depth [m] below the surface."""
    q, p, d = factors[0], phases_out[0], np.float32(depth)
    for w in range(count):
        e = single_decay(q.k[w] * d)
        p.down[w], p.up[w] = e, e
    if q.feel_bed:
        for w in range(count):
            down, up = p.down[w], single_decay(max(q.bed[w] - q.k[w] * d, ZERO))
            p.down[w], p.up[w] = q.half[w] * (down + up), q.half[w] * (down - up)


@summing_kernel
def add_label_sums(count, factors, phases, i, sums_out):
    """Add the first `count` waves of a tile to the SUMS of point i."""
    q, p, to = factors[0], phases[0], sums_out[0]
    z, x_x, x_y, y_y, x, y, z_x, z_y = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for w in range(count):
        s, c = p.sine[w], p.cosine[w]
        z += q.z[w] * s
        x_x += q.x_x[w] * s
        x_y += q.x_y[w] * s
        y_y += q.y_y[w] * s
        x += q.x[w] * c
        y += q.y[w] * c
        z_x += q.z_x[w] * c
        z_y += q.z_y[w] * c
    to.x[i] += x
    to.y[i] += y
    to.z[i] += z
    to.z_x[i] += z_x
    to.z_y[i] += z_y
    to.x_x[i] -= x_x
    to.x_y[i] -= x_y
    to.y_y[i] -= y_y


@summing_kernel
def add_sines(count, factors, phases, i, higher_out):
    """Add what goes with sines in the first `count` waves of a tile to the HIGHER_SUMS of point
    i."""
    q, p, to = factors[0], phases[0], higher_out[0]
    xx, xy, yy, xxx, xxy, xyy, yyx, yyy = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for w in range(count):
        s = p.sine[w]
        xx += q.z_xx[w] * s
        xy += q.z_xy[w] * s
        yy += q.z_yy[w] * s
        xxx += q.x_xxx[w] * s
        xxy += q.x_xxy[w] * s
        xyy += q.x_xyy[w] * s
        yyx += q.x_yyy[w] * s
        yyy += q.y_yyy[w] * s
    to.z_xx[i] -= xx
    to.z_xy[i] -= xy
    to.z_yy[i] -= yy
    to.x_xxx[i] += xxx
    to.x_xxy[i] += xxy
    to.x_xyy[i] += xyy
    to.x_yyy[i] += yyx
    to.y_yyy[i] += yyy


@summing_kernel
def add_cosines(count, factors, phases, i, higher_out):
    """Add what goes with cosines, as in `add_sines`."""
    q, p, to = factors[0], phases[0], higher_out[0]
    xx, xy, yx, yy, xxx, xxy, xyy, yyy = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for w in range(count):
        c = p.cosine[w]
        xx += q.x_xx[w] * c
        xy += q.x_xy[w] * c
        yx += q.x_yy[w] * c
        yy += q.y_yy[w] * c
        xxx += q.z_xxx[w] * c
        xxy += q.z_xxy[w] * c
        xyy += q.z_xyy[w] * c
        yyy += q.z_yyy[w] * c
    to.x_xx[i] -= xx
    to.x_xy[i] -= xy
    to.x_yy[i] -= yx
    to.y_yy[i] -= yy
    to.z_xxx[i] -= xxx
    to.z_xxy[i] -= xxy
    to.z_xyy[i] -= xyy
    to.z_yyy[i] -= yyy


@summing_kernel
def add_firsts(count, factors, phases, i, decayed_out):
    """Add the first `count` waves of a tile to the lost head of point i, to the first derivatives,
    and to the derivatives of the second sum, all DECAYED."""
    q, p, to = factors[0], phases[0], decayed_out[0]
    lost, x, y, first, second, third = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for w in range(count):
        s, c, e, v, t = p.sine[w], p.cosine[w], p.down[w], p.up[w], q.tanh[w]
        gone, both = UNIT - e, e * v
        lost += q.z[w] * gone * s + q.lost[w] * (gone + v * (v - t))
        x += q.z_x[w] * (e * c)
        y += q.z_y[w] * (e * c)
        first += q.ka[w] * (v * s) + q.s_1[w] * (v - TWO * both + t * e)
        second += q.s_2[w] * (e - TWO * (e * e + v * v) + t * v)
        third += q.s_3[w] * (v - EIGHT * both + t * e)
    to.lost[i] += lost
    to.x[i] += x
    to.y[i] += y
    to.s_1[i] += first
    to.s_2[i] += second
    to.s_3[i] += third


@summing_kernel
def add_decayed_sines(count, factors, phases, i, decayed_out):
    """Add what goes with decayed sines to the DECAYED of point i."""
    q, p, to = factors[0], phases[0], decayed_out[0]
    xx, xy, yy, xxs, xys, yys = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for w in range(count):
        s, up = p.down[w] * p.sine[w], p.up[w] * p.sine[w]
        xx += q.z_xx[w] * s
        xy += q.z_xy[w] * s
        yy += q.z_yy[w] * s
        xxs += q.xxs[w] * up
        xys += q.xys[w] * up
        yys += q.yys[w] * up
    to.xx[i] -= xx
    to.xy[i] -= xy
    to.yy[i] -= yy
    to.xxs[i] -= xxs
    to.xys[i] -= xys
    to.yys[i] -= yys


@summing_kernel
def add_decayed_cosines(count, factors, phases, i, decayed_out):
    """Add what goes with decayed cosines to the DECAYED of point i."""
    q, p, to = factors[0], phases[0], decayed_out[0]
    xxx, xxy, xyy, yyy, xs, ys = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    for w in range(count):
        c, up = p.down[w] * p.cosine[w], p.up[w] * p.cosine[w]
        xxx += q.z_xxx[w] * c
        xxy += q.z_xxy[w] * c
        xyy += q.z_xyy[w] * c
        yyy += q.z_yyy[w] * c
        xs += q.xs[w] * up
        ys += q.ys[w] * up
    to.xxx[i] -= xxx
    to.xxy[i] -= xxy
    to.xyy[i] -= xyy
    to.yyy[i] -= yyy
    to.xs[i] += xs
    to.ys[i] += ys


@kernel
def many_wave_sums(count, waves, time, labels, sums_out):
    """Compute the SUMS at the first `count` LABELS, as `gerstner.wave_sums` does."""
    factors, phases, at = workspace(FACTORS), workspace(PHASES), labels[0]
    clear_sums(sums_out[0], count)
    for first in range(0, waves.size, TILE):
        tile = set_label_factors(waves[first : min(first + TILE, waves.size)], time, factors)
        for i in range(count):
            set_phases(tile, factors, at.x[i], at.y[i], phases)
            add_label_sums(tile, factors, phases, i, sums_out)


@kernel
def many_jet_sums(count, waves, time, labels, sums_out, higher_out):
    """Compute the SUMS and HIGHER_SUMS at the first `count` LABELS, as `jets.jet_sums` does."""
    factors, phases, at = workspace(FACTORS), workspace(PHASES), labels[0]
    clear_sums(sums_out[0], count)
    clear_higher(higher_out[0], count)
    for first in range(0, waves.size, TILE):
        tile = set_factors(waves[first : min(first + TILE, waves.size)], time, factors)
        for i in range(count):
            set_phases(tile, factors, at.x[i], at.y[i], phases)
            add_label_sums(tile, factors, phases, i, sums_out)
            add_sines(tile, factors, phases, i, higher_out)
            add_cosines(tile, factors, phases, i, higher_out)


@kernel
def many_head_sums(count, waves, time, labels, sums_out, higher_out, decayed_out):
    """Compute SUMS, HIGHER_SUMS and DECAYED at the first `count` LABELS, as `head_jets.head_sums`
    does."""
    factors, phases, at, d = workspace(FACTORS), workspace(PHASES), labels[0], decayed_out[0]
    clear_sums(sums_out[0], count)
    clear_higher(higher_out[0], count)
    clear_decayed(d, count)
    for first in range(0, waves.size, TILE):
        tile = set_factors(waves[first : min(first + TILE, waves.size)], time, factors)
        for i in range(count):
            set_phases(tile, factors, at.x[i], at.y[i], phases)
            add_label_sums(tile, factors, phases, i, sums_out)
            add_sines(tile, factors, phases, i, higher_out)
            add_cosines(tile, factors, phases, i, higher_out)
            set_decays(tile, factors, -d.s[i], phases)
            add_firsts(tile, factors, phases, i, decayed_out)
            add_decayed_sines(tile, factors, phases, i, decayed_out)
            add_decayed_cosines(tile, factors, phases, i, decayed_out)


@kernel
def find_many_near(x, y, waves, time, steps, near_out):
    """Find the particles Near the points x, y: (N,) [m], as `jets.find_near` does, after fewer than
    PLAIN_STEPS steps."""
    labels, nearer, sums = workspace(LABELS), workspace(LABELS), workspace(SUMS)
    for start in range(0, x.size, CHUNK):
        end = min(start + CHUNK, x.size)
        px, py, heights = x[start:end], y[start:end], near_out.height[start:end]
        set_labels(px, py, labels)
        for _ in range(max(steps, 1)):
            many_wave_sums(px.size, waves, time, labels, sums)
            newton_labels(px, py, labels, sums, heights, nearer)
            take_labels(px.size, nearer, labels)
        keep_labels(labels, near_out.label_x[start:end], near_out.label_y[start:end])


@kernel
def solve_many_jets(x, y, near, waves, time, tolerance, squeeze, jets_out):
    """Jets (N,) of the surface, as from `jets.solve_jets`."""
    labels, sums, higher = workspace(LABELS), workspace(SUMS), workspace(HIGHER_SUMS)
    nearer, found = workspace(LABELS), scratch(CHUNK)
    for start in range(0, x.size, CHUNK):
        end = min(start + CHUNK, x.size)
        px, py = x[start:end], y[start:end]
        filled = set_labels(near.label_x[start:end], near.label_y[start:end], labels)
        many_jet_sums(filled, waves, time, labels, sums, higher)
        if not set_rests(px, py, filled, labels, sums) <= tolerance * tolerance:
            solve_labels(px, py, labels, waves, time, tolerance, ONE, found[: px.size], nearer)
            take_labels(filled, nearer, labels)
            many_jet_sums(filled, waves, time, labels, sums, higher)
            set_rests(px, py, filled, labels, sums)
        finish_jets(squeeze, labels, sums, higher, jets_out[start:end])


@kernel
def solve_many_head_jets(x, y, above, near, waves, time, tolerance, squeeze, jets_out):
    """HEAD_JETS, as from `head_jets.solve_head_jets`."""
    labels, sums, higher = workspace(LABELS), workspace(SUMS), workspace(HIGHER_SUMS)
    nearer, decayed, found = workspace(LABELS), workspace(DECAYED), scratch(CHUNK)
    for chunk in range(jets_out.size):
        start, end = chunk * CHUNK, min((chunk + 1) * CHUNK, x.size)
        px, py, places, heights = x[start:end], y[start:end], above[start:end], found[: end - start]
        filled = set_labels(near.label_x[start:end], near.label_y[start:end], labels)
        set_depths(filled, places, near.height[start:end], decayed)
        many_head_sums(filled, waves, time, labels, sums, higher, decayed)
        if not set_rests(px, py, filled, labels, sums) <= tolerance * tolerance:
            solve_labels(px, py, labels, waves, time, tolerance, ONE, heights, nearer)
            take_labels(filled, nearer, labels)
            set_depths(filled, places, heights, decayed)
            many_head_sums(filled, waves, time, labels, sums, higher, decayed)
            set_rests(px, py, filled, labels, sums)
        set_ups(filled, places, sums, decayed)
        finish_head_jets(filled, squeeze, sums, higher, decayed, jets_out[chunk : chunk + 1])


@summing_kernel
def lost_head(count, factors, phases):
    """The head [m] that the first `count` waves of a tile lose by their decay at a point."""
    q, p, lost = factors[0], phases[0], ZERO
    for w in range(count):
        s, e, v = p.sine[w], p.down[w], p.up[w]
        gone = UNIT - e
        lost += q.z[w] * gone * s + q.lost[w] * (gone + v * (v - q.tanh[w]))
    return lost


@kernel
def solve_many_heads(x, y, above, waves, time, steps, heads_out):
    """Heads (N,) [m] of decaying pressure at the points x, y with heights `above` the level, all
    (N,) [m], after fewer than PLAIN_STEPS Newton steps. Above the surface, a height with the right
    sign."""
    rows = np.empty((3, x.size))
    near = Near(rows[0], rows[1], rows[2])
    find_many_near(x, y, waves, time, steps, near)
    factors, phases = workspace(FACTORS), workspace(PHASES)
    for i in range(x.size):
        heads_out[i] = near.height[i] - above[i]
    for first in range(0, waves.size, TILE):
        tile = set_factors(waves[first : min(first + TILE, waves.size)], time, factors)
        for i in range(x.size):
            depth = near.height[i] - above[i]
            if depth > 0.0:
                set_phases(tile, factors, near.label_x[i], near.label_y[i], phases)
                set_decays(tile, factors, depth, phases)
                heads_out[i] -= lost_head(tile, factors, phases)
