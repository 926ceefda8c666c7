"""Gerstner waves: the kernels that a Sea is made of.

A surface particle with label alpha (the 2-vector it is named after) is at

    x = alpha + sum d a cos(theta),    z = level + sum a sin(theta),
    theta = k d . alpha - omega t + phase,    omega^2 = g k.

Seen from above the surface is a graph while sum k a < 1, so an elevation above
a given x exists; finding it means inverting the first relation for alpha. The
residual r = x - x(alpha) has the symmetric Jacobian -J with

    J = dx/dalpha = I - sum d d^T k a sin(theta),    1 - sum k a <= J <= 1 + sum k a,

so Newton's step J^-1 r exists everywhere and always points downhill in |r|: halved until
|r| falls, it converges from any starting point. Plain steps do for almost all points
and are taken many points at a time; those few that they miss get the safeguard. (Our own, because
a library's solver takes one point at a time, by calls back into Python.)

Phases are kept in turns, not radians: the nearest integer is then subtracted without
error, so a phase is as precise as the double that holds it, far from the origin too.

Sources: Gerstner 1802; Tessendorf 2001 for sums of such waves; Dennis and Schnabel 1983,
chapter 6, for the safeguarded Newton iteration.
"""

from math import factorial

import numpy as np

from sim.kernels import inline, kernel, record

PLAIN_STEPS = 8
"""Newton steps taken without a safeguard; more would only delay the points that need one."""

SAFEGUARDED_STEPS = 200
"""Evaluations after which a point is given up: NaN, or the nearest label where waves fold. Even at
a steepness sum of 0.95 some 20 suffice, so only a position that is not finite gets there, or one
where many waves meet as they are taken never to."""

ROUND_OFF = 1e-15
"""Relative to the distance from the origin: a residual below this is noise, so a point that far
out is closed there."""

CHUNK = 248
"""Points solved together: their workspaces fit the second-level cache. Not a power of two, because
fields a power of two apart would fight for the same lines of the first."""

LANES = 8
"""Chunks are filled up to a multiple of this: what is left of a loop after its vectors would be
done point by point, at eight times the cost."""

ROW = ("f8", CHUNK)

ONE = np.int64(1)
"""For kernels that take a count: they would be compiled once more for Python's 1."""

WAVE = record(
    turns_x="f8", turns_y="f8", turns="f8", frequency="f8",
    amplitude="f8", wavenumber="f8", direction_x="f8", direction_y="f8",
    ka="f8", kka="f8", kkka="f8", rate="f8", rise="f8",
)  # fmt: skip
"""A wave as kernels read it: wavenumber vector [turns/m], phase [turns] and frequency [turns/s] at
a place that stays; amplitude a [m], wavenumber k [rad/m] and unit direction; k a, k^2 a and k^3 a,
what it adds to derivatives of that order; the rate [rad/s] at which the water turns, which does not
see the current; and one over the time [s] in which it grows, 0 for a wave that was always there."""

MOST_TIDES = 16
"""Times at which a sea may have levels of its own."""

WATER = record(
    level="f8", amplitude="f8", tolerance="f8", scale="f8", decays="i8", current=("f8", 3),
    tides="i8", tide_time=("f8", MOST_TIDES), tide_level=("f8", MOST_TIDES),
)  # fmt: skip
"""What kernels know of a sea besides its waves: the still level [m] at the start, how far
crests rise above it [m], the residual [m] at which a label counts as found, - density gravity
[N/m^3], whether the waves' pressure decays with depth; the current [m/s]; and how many times [s]
have levels [m] of their own."""

LABELS = record(x=ROW, y=ROW, residual=ROW)
"""Workspace: labels of a chunk's points, and the residual squared [m^2] that a step began with."""

SUMS = record(x=ROW, y=ROW, z=ROW, z_x=ROW, z_y=ROW, x_x=ROW, x_y=ROW, y_y=ROW)
"""Workspace: a chunk's particles as sums over the waves: offset x, y from the label and height z
above the level, and their derivatives by the label."""

# sin(2 pi u) = u * sum SINE[i] u^2i and cos(2 pi u) = sum COSINE[i] u^2i on |u| <= 1/4, fitted
# in Chebyshev nodes with 60 digits; the fit's own error is below 4e-18.
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
"""Of the exponential."""


@inline
def sine_cosine(turns):
    """Sine and cosine of an angle in turns, to 2.2e-16.

    libm's pair costs some 25 ns a point and stays scalar; this one is branch-free, so loops
    over it vectorise to about 1 ns.
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
    """exp(-x) for x >= 0, to 4e-16: (exp(-x / 64))^64 by Taylor's polynomial of degree 9, held at
    3e-20 where that would end. Without a call in it, a loop over it vectorises."""
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
def smooth_step(u):
    """From 0 at u = 0 to 1 at u = 1 and beyond, level at both ends."""
    v = min(max(u, 0.0), 1.0)
    return v * v * (3.0 - 2.0 * v)


@inline
def growth(wave, time):
    """Which part of its height a wave has at a time."""
    return 1.0 if wave.rise == 0.0 else smooth_step(wave.rise * time)


@inline
def level_and_rise(water, time):
    """The still level [m] at a time, and how fast it rises [m/s]: along straight lines between the
    times that have one of their own."""
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
    """Set the first `count` of all sums to 0."""
    for i in range(count):
        p.x[i], p.y[i], p.z[i], p.z_x[i], p.z_y[i] = 0.0, 0.0, 0.0, 0.0, 0.0
        p.x_x[i], p.x_y[i], p.y_y[i] = 0.0, 0.0, 0.0


@inline
def add_wave(p, i, s, c, a, ka, dx, dy):
    """Add one wave, of phase sine s and cosine c, to the sums at point i."""
    p.x[i] += dx * a * c
    p.y[i] += dy * a * c
    p.z[i] += a * s
    p.z_x[i] += dx * ka * c
    p.z_y[i] += dy * ka * c
    p.x_x[i] -= dx * dx * ka * s
    p.x_y[i] -= dx * dy * ka * s
    p.y_y[i] -= dy * dy * ka * s


@kernel
def wave_sums(count, waves, time, labels, sums_out):
    """The SUMS at the first `count` LABELS. The wave loop is outermost so that the loop over points
    vectorises."""
    at, p = labels[0], sums_out[0]
    clear_sums(p, count)
    for w in range(waves.size):
        wave = waves[w]
        turns_x, turns_y = wave.turns_x, wave.turns_y
        turns = wave.turns - wave.frequency * time
        part = growth(wave, time)
        a, ka, dx, dy = part * wave.amplitude, part * wave.ka, wave.direction_x, wave.direction_y
        for i in range(count):
            s, c = sine_cosine(turns_x * at.x[i] + turns_y * at.y[i] + turns)
            add_wave(p, i, s, c, a, ka, dx, dy)


@inline
def solved(p, i, rx, ry):
    """J^-1 r at point i of the sums."""
    jxx, jxy, jyy = 1.0 + p.x_x[i], p.x_y[i], 1.0 + p.y_y[i]
    scale = 1.0 / (jxx * jyy - jxy * jxy)
    return scale * (jyy * rx - jxy * ry), scale * (jxx * ry - jxy * rx)


@kernel
def newton_labels(x, y, labels, sums, heights_out, labels_out):
    """Labels one plain Newton step nearer to the points x, y: (N,) [m]. The heights [m] follow the
    step along the surface's slope, so that what is left of the residual enters them in second
    order only."""
    at, p, to = labels[0], sums[0], labels_out[0]
    for i in range(x.size):
        rx, ry = x[i] - at.x[i] - p.x[i], y[i] - at.y[i] - p.y[i]
        step_x, step_y = solved(p, i, rx, ry)
        to.residual[i] = rx * rx + ry * ry
        to.x[i], to.y[i] = at.x[i] + step_x, at.y[i] + step_y
        heights_out[i] = p.z[i] + (p.z_x[i] * step_x + p.z_y[i] * step_y)


@inline
def is_solved(x, y, residual_squared, tolerance):
    """Whether a point's residual is below the tolerance [m] or lost in round-off."""
    limit = tolerance + ROUND_OFF * (abs(x) + abs(y))
    return residual_squared < limit * limit


@kernel
def solve_point(x, y, guess_x, guess_y, waves, time, tolerance, labels, sums):
    """Safeguarded Newton for one point from a guess of its label: a step is kept only if the
    residual falls, and halved until it does. Returns label x, y and height, all NaN for points
    that are not finite. Works in LABELS and SUMS."""
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
            if not step_x * step_x + step_y * step_y < 1e16 * residual:  # a fold: downhill will do
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
    """The points x, y: (N,) [m] themselves as labels, and as many more as fill the LANES; returns
    how many there are then."""
    to, count = labels_out[0], x.size
    filled = -(-count // LANES) * LANES
    for i in range(count):
        to.x[i], to.y[i] = x[i], y[i]
    for i in range(count, filled):
        to.x[i], to.y[i] = x[0], y[0]
    return filled


@kernel
def copy_labels(count, labels, labels_out):
    """The first `count` labels, and as many more as fill the LANES; returns how many those are."""
    at = labels[0]
    return set_labels(at.x[:count], at.y[:count], labels_out)


@kernel
def unsolved_points(x, y, labels, tolerance):
    """How many of the points x, y: (N,) [m] are not solved."""
    at, unsolved = labels[0], 0
    for i in range(x.size):
        unsolved += not is_solved(x[i], y[i], at.residual[i], tolerance)
    return unsolved


@kernel
def solve_others(x, y, labels, waves, time, tolerance, work, sums, heights_out, labels_out):
    """Labels and heights of those points x, y: (N,) [m] that are not solved, one by one. Works in
    LABELS and SUMS."""
    at, to = labels[0], labels_out[0]
    for i in range(x.size):
        if not is_solved(x[i], y[i], at.residual[i], tolerance):
            to.x[i], to.y[i], heights_out[i] = solve_point(
                x[i], y[i], x[i], y[i], waves, time, tolerance, work, sums
            )


@kernel
def solve_labels(x, y, guess, waves, time, tolerance, at_least, heights_out, labels_out):
    """Invert the Gerstner map for up to CHUNK points x, y: (N,) [m], from guesses of their labels:
    the LABELS, and the heights (N,) [m] above the level. Takes `at_least` so many plain steps,
    then until the residuals are below the tolerance [m]."""
    here, there, sums = np.empty(1, LABELS), np.empty(1, LABELS), np.empty(1, SUMS)
    filled = copy_labels(x.size, guess, here)
    copy_labels(x.size, guess, there)
    unsolved = x.size
    for step in range(1, PLAIN_STEPS + 1):
        wave_sums(filled, waves, time, here, sums)
        newton_labels(x, y, here, sums, heights_out, there)
        here, there = there, here
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
    guess, labels = np.empty(1, LABELS), np.empty(1, LABELS)
    for start in range(0, x.size, CHUNK):
        chunk = slice(start, min(start + CHUNK, x.size))
        set_labels(x[chunk], y[chunk], guess)
        heights = heights_out[chunk]
        solve_labels(x[chunk], y[chunk], guess, waves, time, tolerance, ONE, heights, labels)
