"""Gerstner waves: the kernels that a Sea is built on.

A surface particle with label alpha, its rest position (2,), is at

    x = alpha + sum d a cos(theta),    z = level + sum a sin(theta),
    theta = k d . alpha - omega t + phase,    omega^2 = g k.

In water of depth H the circles become ellipses, which are 1 / T wider than they are high, and the
waves are slower: with T = tanh(k H),

    x = alpha + sum d (a / T) cos(theta),    omega^2 = g k T.

Seen from above, the surface is a graph while sum k a / T < 1, so every x has one elevation. To find
it, the first relation is inverted for alpha. The residual r = x - x(alpha) has the symmetric
Jacobian -J with

    J = dx/dalpha = I - sum d d^T (k a / T) sin(theta),    1 - sum k a / T <= J <= 1 + sum k a / T,

so Newton's step J^-1 r exists everywhere and always reduces |r| if it is short enough. Halved until
|r| falls, it converges from any starting point. Plain steps suffice for almost all points and are
taken for many points at a time. The few points that they do not solve get the safeguarded
iteration. (Library solvers take one point at a time and call back into Python.)

Phases are kept in turns, not radians. The nearest integer can then be subtracted without error, so
a phase is as precise as the double that holds it, even far from the origin.

Sources: Gerstner 1802; Tessendorf 2001 for sums of such waves; Dennis and Schnabel 1983, chapter 6,
for the safeguarded Newton iteration.
"""

from collections.abc import Iterable, Iterator
from math import factorial

import numpy as np
from numpy.typing import NDArray

from sim.kernels import inline, kernel, record, workspace
from sim.precision import real

Array = NDArray[np.float64]
Table = NDArray[np.void]

PLAIN_STEPS = 8
"""Maximum number of Newton steps without a safeguard. More steps only delay the points that need
one."""

SAFEGUARDED_STEPS = 200
"""Maximum number of evaluations in the safeguarded iteration. About 20 suffice even at a steepness
sum of 0.95. Only two kinds of points use all of them: positions that are not finite, which give
NaN, and points where so many waves meet that the surface folds, which give the nearest label."""

ROUND_OFF = 1e-15
"""Round-off of a residual, as a share of the distance from the origin. Smaller residuals are noise,
so a point counts as solved there."""

CHUNK = 248
"""Number of points solved together. Their workspaces fit the second-level cache. It is not a power
of two, because fields a power of two apart would compete for the same lines of the first-level
cache."""

LANES = 8
"""Chunks are filled up to a multiple of this number of points. The remainder of a vectorised loop
would run point by point, at eight times the cost."""

ROW, REALS = ("f8", CHUNK), ("real", CHUNK)

ONE = np.int64(1)
"""For kernels that take a count: they would be compiled once more for Python's 1."""

WAVE = record(
    turns_x="f8", turns_y="f8", turns="f8", frequency="f8",
    amplitude="real", wavenumber="real", direction_x="real", direction_y="real",
    ka="real", kka="real", kkka="real", rate="real", rise="f8", tanh="real", stretch="real",
    bed="real",
)  # fmt: skip
"""A wave as kernels read it.

turns_x, turns_y: wavenumber vector [turns/m]; turns: phase [turns]; frequency [turns/s], as seen
from a fixed position; amplitude a [m]; wavenumber k [rad/m]; direction_x, direction_y: unit vector;
ka, kka, kkka: k a, k^2 a and k^3 a, the wave's contributions to derivatives of those orders; rate:
angular frequency [rad/s] of the particles, which does not depend on the current; rise: one over the
time [s] in which the wave grows, 0 for a wave without a ramp; tanh, stretch: T = tanh(k H) and
1 / T, both 1 on deep water; bed: 2 k H, 0 on deep water.
"""

MOST_TIDES = 16
"""Maximum number of times at which a sea can have given levels."""

WATER = record(
    level="f8", amplitude="f8", tolerance="f8", scale="f8", decays="i8", drifts="i8",
    current=("f8", 3),
    tides="i8", tide_time=("f8", MOST_TIDES), tide_level=("f8", MOST_TIDES),
)  # fmt: skip
"""The properties of a sea besides its waves, as kernels read them.

level: still level [m] at the start; amplitude: height [m] of the highest crest above it; tolerance:
residual [m] at which a label counts as found; scale: - density gravity [N/m^3]; decays: whether the
waves' pressure decays with depth; drifts: whether the water drifts as Stokes found; current [m/s];
tides: number of pairs of tide_time [s] and
tide_level [m].
"""

LABELS = record(x=ROW, y=ROW, residual=ROW)
"""Workspace: labels of a chunk's points, and the squared residual [m^2] before the last step."""

SUMS = record(
    x=REALS, y=REALS, z=REALS, z_x=REALS, z_y=REALS, x_x=REALS, x_y=REALS, y_y=REALS,
    rest_x=REALS, rest_y=REALS, phase=REALS, sine=REALS, cosine=REALS,
)  # fmt: skip
"""Workspace: sums over the waves at a chunk's labels. x, y: offset of the particle from its label;
z: its height above the level; z_x to y_y: derivatives of these by the label; rest_x, rest_y: from
the particle to the point that it was solved for; phase: of one wave [turns], from -1/2 to 1/2;
sine, cosine: of this phase."""

# sin(2 pi u) = u * sum SINE[i] u^2i and cos(2 pi u) = sum COSINE[i] u^2i on |u| <= 1/4, fitted
# at Chebyshev nodes with 60 digits; the error of the fit is below 4e-18.
SINE = (
    6.283185307179586,
    -41.341702240399755,
    81.60524927607362,
    -76.70585975282492,
    42.058693925428685,
    -15.0946416761179,
    3.8199280942271643,
    -0.7177337921413454,
    0.10089695501646812,
)
COSINE = (
    1.0,
    -19.739208802178705,
    64.93939402266395,
    -85.45681720598061,
    60.24464131316041,
    -26.426254066690255,
    7.903462492085097,
    -1.7132184107005932,
    0.2719458494999813,
)

TAYLOR = tuple(1.0 / factorial(n) for n in range(10))
"""Taylor coefficients of the exponential."""


@inline
def sine_cosine(turns):
    """Sine and cosine of an angle in turns, to 2.2e-16.

    The pair from libm takes about 25 ns a point and does not vectorise. This one has no branches,
    so loops over it vectorise and take about 1 ns a point.
    """
    half_turns = np.floor(2.0 * turns + 0.5)
    u = turns - 0.5 * half_turns  # exact
    sign = 1.0 - 2.0 * (half_turns - 2.0 * np.floor(0.5 * half_turns))
    q = u * u
    s = SINE[8]
    c = COSINE[8]
    s, c = s * q + SINE[7], c * q + COSINE[7]
    s, c = s * q + SINE[6], c * q + COSINE[6]
    s, c = s * q + SINE[5], c * q + COSINE[5]
    s, c = s * q + SINE[4], c * q + COSINE[4]
    s, c = s * q + SINE[3], c * q + COSINE[3]
    s, c = s * q + SINE[2], c * q + COSINE[2]
    s, c = s * q + SINE[1], c * q + COSINE[1]
    s, c = s * q + SINE[0], c * q + COSINE[0]
    return sign * s * u, sign * c


@inline
def decay(x):
    """exp(-x) for x >= 0, to 4e-16: (exp(-x / 64))^64 by a Taylor polynomial of degree 9, held at
    3e-20 for large x. It makes no call, so loops over it vectorise."""
    y = min(x * 0.015625, 0.7)
    power = TAYLOR[9]
    power = TAYLOR[8] - y * power
    power = TAYLOR[7] - y * power
    power = TAYLOR[6] - y * power
    power = TAYLOR[5] - y * power
    power = TAYLOR[4] - y * power
    power = TAYLOR[3] - y * power
    power = TAYLOR[2] - y * power
    power = 1.0 - y * power
    power = 1.0 - y * power
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * power


@inline
def bed_decays(phase, bed, tanh):
    """C = cosh(k (H - d)) / cosh(k H) and S = sinh(k (H - d)) / cosh(k H) at a depth d in water of
    depth H, from phase = k d >= 0, bed = 2 k H and tanh = tanh(k H). Both continue smoothly below
    the bottom, down to d = 2 H."""
    down, up = decay(phase), decay(max(bed - phase, 0.0))
    half = 0.5 * (1.0 + tanh)
    return half * (down + up), half * (down - up)


def smooth(u):
    """From 0 at u = 0 to 1 at u = 1, level at both ends."""
    return u * u * (3.0 - 2.0 * u)


smooth_step = inline(smooth)


@inline
def growth(wave, time):
    """The share of its amplitude that a wave has at a time."""
    return real(1.0 if wave.rise == 0.0 else smooth_step(min(max(wave.rise * time, 0.0), 1.0)))


@inline
def level_and_rise(water, time):
    """The still level [m] at a time and its rate of rise [m/s]; linear between the times of the
    tide."""
    level, rise = water.level, 0.0
    for i in range(water.tides):
        last = i == water.tides - 1
        if time >= water.tide_time[i]:
            level, rise = water.tide_level[i], 0.0
            if not last:
                rise = water.tide_level[i + 1] - water.tide_level[i]
                rise /= water.tide_time[i + 1] - water.tide_time[i]
                level += rise * (time - water.tide_time[i])
    return level, rise


@inline
def clear_sums(p, count):
    """Set the first `count` entries of all sums to 0."""
    for i in range(count):
        p.x[i], p.y[i], p.z[i], p.z_x[i], p.z_y[i] = 0.0, 0.0, 0.0, 0.0, 0.0
        p.x_x[i], p.x_y[i], p.y_y[i] = 0.0, 0.0, 0.0


@inline
def add_wave(p, i, s, c, a, ka, dx, dy, wide_x, wide_y):
    """Add one wave, with sine s and cosine c of its phase, to the sums at point i. wide_x, wide_y:
    its direction over T."""
    p.x[i] += wide_x * a * c
    p.y[i] += wide_y * a * c
    p.z[i] += a * s
    p.z_x[i] += dx * ka * c
    p.z_y[i] += dy * ka * c
    p.x_x[i] -= wide_x * dx * ka * s
    p.x_y[i] -= wide_x * dy * ka * s
    p.y_y[i] -= wide_y * dy * ka * s


@inline
def set_phases(p, count, turns_x, turns_y, turns, at):
    """Set the phases of a wave at the first `count` labels. Without whole turns they may be
    single."""
    for i in range(count):
        phase = turns_x * at.x[i] + turns_y * at.y[i] + turns
        p.phase[i] = phase - np.floor(phase + 0.5)


@kernel
def wave_sums(count, waves, time, labels, sums_out):
    """Compute the SUMS at the first `count` LABELS. The loop over waves is the outer one, so that
    the loop over points vectorises."""
    at, p = labels[0], sums_out[0]
    clear_sums(p, count)
    for w in range(waves.size):
        wave = waves[w]
        turns_x, turns_y = wave.turns_x, wave.turns_y
        turns = wave.turns - wave.frequency * time
        part = growth(wave, time)
        a, ka, dx, dy = part * wave.amplitude, part * wave.ka, wave.direction_x, wave.direction_y
        wide_x, wide_y = wave.stretch * dx, wave.stretch * dy
        set_phases(p, count, turns_x, turns_y, turns, at)
        for i in range(count):
            s, c = sine_cosine(p.phase[i])
            add_wave(p, i, s, c, a, ka, dx, dy, wide_x, wide_y)


@inline
def solved(p, i, rx, ry):
    """J^-1 r at point i of the sums."""
    jxx, jxy, jyy = 1.0 + p.x_x[i], p.x_y[i], 1.0 + p.y_y[i]
    scale = 1.0 / (jxx * jyy - jxy * jxy)
    return scale * (jyy * rx - jxy * ry), scale * (jxx * ry - jxy * rx)


@kernel
def newton_labels(x, y, labels, sums, heights_out, labels_out):
    """Take one plain Newton step towards the points x, y: (N,) [m]. The heights [m] follow the step
    along the surface's slope, so that the remaining residual changes them in second order only."""
    at, p, to = labels[0], sums[0], labels_out[0]
    for i in range(x.size):
        rx, ry = x[i] - at.x[i] - p.x[i], y[i] - at.y[i] - p.y[i]
        step_x, step_y = solved(p, i, rx, ry)
        to.residual[i] = rx * rx + ry * ry
        to.x[i], to.y[i] = at.x[i] + step_x, at.y[i] + step_y
        heights_out[i] = p.z[i] + (p.z_x[i] * step_x + p.z_y[i] * step_y)


@inline
def is_solved(x, y, residual_squared, tolerance):
    """Whether a point's residual is below the tolerance [m] or below round-off."""
    limit = tolerance + ROUND_OFF * (abs(x) + abs(y))
    return residual_squared < limit * limit


@kernel
def solve_point(x, y, guess_x, guess_y, waves, time, tolerance, labels, sums):
    """Solve one point by safeguarded Newton steps from a guess of its label. A step is halved until
    the residual falls. Return label x, label y and height, all NaN for a point that is not finite.
    The workspaces are LABELS and SUMS."""
    at, p = labels[0], sums[0]
    at.x[0], at.y[0] = guess_x, guess_y
    best = np.inf
    label_x, label_y, step_x, step_y = 0.0, 0.0, 0.0, 0.0
    for _ in range(SAFEGUARDED_STEPS):
        wave_sums(ONE, waves, time, labels, sums)
        rx, ry = x - at.x[0] - p.x[0], y - at.y[0] - p.y[0]
        residual = rx * rx + ry * ry
        if residual < best:
            best = residual
            label_x, label_y = at.x[0], at.y[0]
            step_x, step_y = solved(p, 0, rx, ry)
            if not step_x * step_x + step_y * step_y < 1e16 * residual:  # J is singular at a fold
                step_x, step_y = rx, ry
        else:
            step_x, step_y = 0.5 * step_x, 0.5 * step_y
        at.x[0], at.y[0] = label_x + step_x, label_y + step_y
        if is_solved(x, y, residual, tolerance):
            return at.x[0], at.y[0], p.z[0] + (p.z_x[0] * step_x + p.z_y[0] * step_y)
    if best == np.inf:
        return np.nan, np.nan, np.nan
    at.x[0], at.y[0] = label_x, label_y  # in a fold no step may help: what came nearest
    wave_sums(ONE, waves, time, labels, sums)
    return label_x, label_y, p.z[0]


@kernel
def set_labels(x, y, labels_out):
    """Copy the points x, y: (N,) [m] into labels, and repeat the first one up to a multiple of
    LANES. Return the number of labels."""
    to, count = labels_out[0], x.size
    filled = -(-count // LANES) * LANES
    for i in range(count):
        to.x[i], to.y[i] = x[i], y[i]
    for i in range(count, filled):
        to.x[i], to.y[i] = x[0], y[0]
    return filled


def label_chunks(labels: Array) -> Iterator[tuple[slice, Table, int]]:
    """Labels (N, 2) [m] as kernels take them, by chunks: which labels, LABELS with them, and the
    number of these, filled up to LANES."""
    for start in range(0, len(labels), CHUNK):
        chunk, found = slice(start, start + CHUNK), np.empty(1, LABELS)
        x, y = labels[chunk].T.copy()
        yield chunk, found, set_labels(x, y, found)


def chunk_rows(workspace: Table, names: Iterable[str], count: int) -> Array:
    """Fields of the first points (count, len(names)) in a workspace."""
    return np.stack([workspace[name][0, :count] for name in names], axis=1)


@kernel
def copy_labels(count, labels, labels_out):
    """Copy the first `count` labels and fill up to a multiple of LANES. Return the number of
    labels."""
    at = labels[0]
    return set_labels(at.x[:count], at.y[:count], labels_out)


@inline
def take_labels(count, labels, labels_out):
    """Copy the first `count` labels with their residuals."""
    at, to = labels[0], labels_out[0]
    for i in range(count):
        to.x[i], to.y[i], to.residual[i] = at.x[i], at.y[i], at.residual[i]


@kernel
def unsolved_points(x, y, labels, tolerance):
    """Number of points x, y: (N,) [m] that are not solved."""
    at, unsolved = labels[0], 0
    for i in range(x.size):
        unsolved += not is_solved(x[i], y[i], at.residual[i], tolerance)
    return unsolved


@kernel
def solve_others(x, y, labels, waves, time, tolerance, work, sums, heights_out, labels_out):
    """Solve the points x, y: (N,) [m] that are not solved yet, one by one, for labels and heights.
    The workspaces are LABELS and SUMS."""
    at, to = labels[0], labels_out[0]
    for i in range(x.size):
        if not is_solved(x[i], y[i], at.residual[i], tolerance):
            to.x[i], to.y[i], heights_out[i] = solve_point(
                x[i], y[i], x[i], y[i], waves, time, tolerance, work, sums
            )


@kernel
def solve_labels(x, y, guess, waves, time, tolerance, at_least, heights_out, labels_out):
    """Invert the Gerstner map for up to CHUNK points x, y: (N,) [m], from guesses of their labels.

    Write the LABELS and the heights (N,) [m] above the level. Take at least `at_least` plain steps,
    and more until all residuals are below the tolerance [m].
    """
    here, there, sums = workspace(LABELS), workspace(LABELS), workspace(SUMS)
    filled = copy_labels(x.size, guess, here)
    unsolved = x.size
    for step in range(1, PLAIN_STEPS + 1):
        wave_sums(filled, waves, time, here, sums)
        newton_labels(x, y, here, sums, heights_out, there)
        take_labels(x.size, there, here)
        if step >= at_least:
            unsolved = unsolved_points(x, y, here, tolerance)
            if unsolved == 0:
                break
    copy_labels(x.size, here, labels_out)
    if unsolved > 0:
        solve_others(x, y, here, waves, time, tolerance, there, sums, heights_out, labels_out)


@kernel
def solve_heights(x, y, waves, time, tolerance, heights_out):
    """Height (N,) [m] of the surface above the level at the points x, y: (N,) [m]."""
    guess, labels = workspace(LABELS), workspace(LABELS)
    for start in range(0, x.size, CHUNK):
        chunk = slice(start, min(start + CHUNK, x.size))
        set_labels(x[chunk], y[chunk], guess)
        heights = heights_out[chunk]
        solve_labels(x[chunk], y[chunk], guess, waves, time, tolerance, ONE, heights, labels)
