"""Gerstner waves: the compiled kernels that a Sea is made of.

A surface particle with label alpha (the 2-vector it is named after) is at

    x = alpha + sum d a cos(theta),    z = level + sum a sin(theta),
    theta = k d . alpha - omega t + phase,    omega^2 = g k.

Seen from above the surface is a graph while sum k a < 1, so an elevation above
a given x exists; finding it means inverting the first relation for alpha. The
residual r = x - x(alpha) has the symmetric Jacobian -J with

    J = I - sum d d^T k a sin(theta),    1 - sum k a <= J <= 1 + sum k a,

so Newton's step J^-1 r exists everywhere and always points downhill in |r|: halved until
|r| falls, it converges from any starting point. Plain steps do for almost all points
and are taken many points at a time; those few that they miss get the safeguard.

Phases are kept in turns, not radians: the nearest integer is then subtracted without
error, so a phase is as precise as the double that holds it, far from the origin too.

Sources: Gerstner 1802; Tessendorf 2001 for sums of such waves; Dennis and Schnabel 1983,
chapter 6, for the safeguarded Newton iteration.
"""

import numpy as np
from numba import njit

PLAIN_STEPS = 8
"""Newton steps taken without a safeguard; more would only delay the points that need one."""

SAFEGUARDED_STEPS = 200
"""Evaluations after which a point is given up and becomes NaN. Even at a steepness sum of 0.95
some 20 suffice, so only a position that is not finite gets there."""

ROUND_OFF = 1e-15
"""Relative to the distance from the origin: a residual below this is noise, so a point that far
out is closed there."""

CHUNK = 248
"""Points solved together: their scratch (`SCRATCH_ROWS` rows) fits the second-level cache. Not a
power of two, because rows a power of two apart would fight for the same lines of the first."""

# Columns of the components of a sea, one row a wave (see Sea.components): RISE_1 to RISE_3 are
# k a, k^2 a and k^3 a, what a wave adds to derivatives of that order.
TURNS_X, TURNS_Y, TURNS, FREQUENCY, AMPLITUDE, WAVENUMBER, DIRECTION_X, DIRECTION_Y = range(8)
RISE_1, RISE_2, RISE_3 = range(8, 11)
COMPONENT_COLUMNS = 11

LANES = 8
"""Chunks are filled up to a multiple of this: what is left of a loop after its vectors would be
done point by point, at eight times the cost."""

# Rows of the scratch of one chunk: the wave sums at the labels, the labels, the residual squared,
# the sine and cosine of one wave, and the sums that only curvature and its gradient need.
OFFSET_X, OFFSET_Y, HEIGHT, SLOPE_X, SLOPE_Y, STRAIN_XX, STRAIN_XY, STRAIN_YY = range(8)
LABEL_X, LABEL_Y, RESIDUAL, SINES, COSINES = range(8, 13)
BEND_XX, BEND_XY, BEND_YY, TWIST_XXX, TWIST_XXY, TWIST_XYY, TWIST_YYY = range(13, 20)
KINK_XXX, KINK_XXY, KINK_XYY, KINK_YYY = range(20, 24)
SWIRL_XXXX, SWIRL_XXXY, SWIRL_XXYY, SWIRL_XYYY, SWIRL_YYYY = range(24, 29)
SCRATCH_ROWS = 29

# Rows of a jet: the surface's height above the level, its first, second and third derivatives at a
# point, and the label of the particle there.
JET_HEIGHT, JET_X, JET_Y, JET_XX, JET_XY, JET_YY, JET_XXX, JET_XXY, JET_XYY, JET_YYY = range(10)
JET_LABEL_X, JET_LABEL_Y = range(10, 12)
JET_ROWS = 12

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

# Contraction (fused multiply-add) is the only liberty the compiler gets: full fastmath would
# break the range reduction below and make isnan(nan) false.
kernel = njit(cache=True, fastmath={"contract"}, error_model="numpy")

# Long sums are another matter: only in any order do they vectorise.
summing_kernel = njit(cache=True, fastmath={"contract", "reassoc"}, error_model="numpy")


@njit(inline="always")
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


@njit(inline="always")
def add_wave(i, s, c, a, ka, dx, dy, scratch):
    """Add one wave to the sums at point i: the particle's offset, its height, the slopes
    dz/dalpha and the strains I - J."""
    scratch[OFFSET_X, i] += dx * a * c
    scratch[OFFSET_Y, i] += dy * a * c
    scratch[HEIGHT, i] += a * s
    scratch[SLOPE_X, i] += dx * ka * c
    scratch[SLOPE_Y, i] += dy * ka * c
    scratch[STRAIN_XX, i] += dx * dx * ka * s
    scratch[STRAIN_XY, i] += dx * dy * ka * s
    scratch[STRAIN_YY, i] += dy * dy * ka * s


@kernel
def wave_sums(count, components, time, scratch):
    """Sum over the waves at the first `count` labels, as of `add_wave`. The wave loop is outermost
    so that the loop over points vectorises."""
    scratch[OFFSET_X : STRAIN_YY + 1, :count] = 0.0
    for w in range(components.shape[0]):
        wave = components[w]
        turns = wave[TURNS] - wave[FREQUENCY] * time
        a, dx, dy = wave[AMPLITUDE], wave[DIRECTION_X], wave[DIRECTION_Y]
        ka = wave[RISE_1]
        for i in range(count):
            s, c = sine_cosine(
                wave[TURNS_X] * scratch[LABEL_X, i] + wave[TURNS_Y] * scratch[LABEL_Y, i] + turns
            )
            add_wave(i, s, c, a, ka, dx, dy, scratch)


@kernel
def jet_sums(count, components, time, scratch):
    """All sums over the waves at the first `count` labels: those of `wave_sums` and BEND,
    d d^T k^2 a sin(theta), TWIST, d d d k^2 a cos(theta), KINK, d d d k^3 a cos(theta), and SWIRL,
    d d d d k^3 a sin(theta). Loops with few rows each, which the compiler vectorises."""
    scratch[OFFSET_X : STRAIN_YY + 1, :count] = 0.0
    scratch[BEND_XX : SWIRL_YYYY + 1, :count] = 0.0
    for w in range(components.shape[0]):
        wave = components[w]
        turns = wave[TURNS] - wave[FREQUENCY] * time
        a, dx, dy = wave[AMPLITUDE], wave[DIRECTION_X], wave[DIRECTION_Y]
        ka, kka, kkka = wave[RISE_1], wave[RISE_2], wave[RISE_3]
        for i in range(count):
            s, c = sine_cosine(
                wave[TURNS_X] * scratch[LABEL_X, i] + wave[TURNS_Y] * scratch[LABEL_Y, i] + turns
            )
            scratch[SINES, i], scratch[COSINES, i] = s, c
        for i in range(count):
            add_wave(i, scratch[SINES, i], scratch[COSINES, i], a, ka, dx, dy, scratch)
        xx, xy, yy = dx * dx, dx * dy, dy * dy
        for i in range(count):
            s, c = kka * scratch[SINES, i], kka * scratch[COSINES, i]
            scratch[BEND_XX, i] += xx * s
            scratch[BEND_XY, i] += xy * s
            scratch[BEND_YY, i] += yy * s
            scratch[TWIST_XXX, i] += dx * xx * c
            scratch[TWIST_XXY, i] += dy * xx * c
            scratch[TWIST_XYY, i] += dx * yy * c
            scratch[TWIST_YYY, i] += dy * yy * c
        for i in range(count):
            s, c = kkka * scratch[SINES, i], kkka * scratch[COSINES, i]
            scratch[KINK_XXX, i] += dx * xx * c
            scratch[KINK_XXY, i] += dy * xx * c
            scratch[KINK_XYY, i] += dx * yy * c
            scratch[KINK_YYY, i] += dy * yy * c
            scratch[SWIRL_XXXX, i] += xx * xx * s
            scratch[SWIRL_XXXY, i] += xx * xy * s
            scratch[SWIRL_XXYY, i] += xx * yy * s
            scratch[SWIRL_XYYY, i] += xy * yy * s
            scratch[SWIRL_YYYY, i] += yy * yy * s


@njit(inline="always")
def newton_step(i, rx, ry, scratch):
    """J^-1 r at point i of the scratch."""
    jxx, jyy = 1.0 - scratch[STRAIN_XX, i], 1.0 - scratch[STRAIN_YY, i]
    jxy = -scratch[STRAIN_XY, i]
    scale = 1.0 / (jxx * jyy - jxy * jxy)
    return scale * (jyy * rx - jxy * ry), scale * (jxx * ry - jxy * rx)


@kernel
def newton_update(x, y, heights, scratch):
    """One plain Newton step of every label of a chunk. The heights follow the step along the
    surface's slope, so that what is left of the residual enters them in second order only."""
    for i in range(x.size):
        rx = x[i] - scratch[LABEL_X, i] - scratch[OFFSET_X, i]
        ry = y[i] - scratch[LABEL_Y, i] - scratch[OFFSET_Y, i]
        step_x, step_y = newton_step(i, rx, ry, scratch)
        scratch[RESIDUAL, i] = rx * rx + ry * ry
        scratch[LABEL_X, i] += step_x
        scratch[LABEL_Y, i] += step_y
        slope_rise = scratch[SLOPE_X, i] * step_x + scratch[SLOPE_Y, i] * step_y
        heights[i] = scratch[HEIGHT, i] + slope_rise


@njit(inline="always")
def is_solved(x, y, residual_squared, tolerance):
    """Whether a point's residual is below the tolerance [m] or lost in round-off."""
    limit = tolerance + ROUND_OFF * (abs(x) + abs(y))
    return residual_squared < limit * limit


@kernel
def solve_point(x, y, components, time, tolerance, scratch):
    """Safeguarded Newton for one point, starting from the label in the scratch's only column: a
    step is kept only if the residual falls, and halved until it does. Leaves the label there
    and returns the height; both are NaN when SAFEGUARDED_STEPS were not enough."""
    best = np.inf
    label_x, label_y, step_x, step_y = 0.0, 0.0, 0.0, 0.0
    for _ in range(SAFEGUARDED_STEPS):
        wave_sums(scratch.shape[1], components, time, scratch)
        rx = x - scratch[LABEL_X, 0] - scratch[OFFSET_X, 0]
        ry = y - scratch[LABEL_Y, 0] - scratch[OFFSET_Y, 0]
        residual = rx * rx + ry * ry
        if residual < best:
            best = residual
            label_x, label_y = scratch[LABEL_X, 0], scratch[LABEL_Y, 0]
            step_x, step_y = newton_step(0, rx, ry, scratch)
        else:
            step_x, step_y = 0.5 * step_x, 0.5 * step_y
        scratch[LABEL_X, 0] = label_x + step_x
        scratch[LABEL_Y, 0] = label_y + step_y
        if is_solved(x, y, residual, tolerance):
            slope_rise = scratch[SLOPE_X, 0] * step_x + scratch[SLOPE_Y, 0] * step_y
            return scratch[HEIGHT, 0] + slope_rise
    scratch[LABEL_X : LABEL_Y + 1, 0] = np.nan
    return np.nan


@njit(inline="always")
def fill_up(count, scratch):
    """Repeat the first label until a multiple of LANES is reached; returns that."""
    filled = -(-count // LANES) * LANES
    scratch[LABEL_X, count:filled] = scratch[LABEL_X, 0]
    scratch[LABEL_Y, count:filled] = scratch[LABEL_Y, 0]
    return filled


@kernel
def solve_chunk(x, y, components, time, tolerance, at_least, heights, scratch):
    """Invert the Gerstner map for up to CHUNK points, starting from the labels in the scratch,
    which has room for whole LANES; leaves the labels there and the heights above the level [m]
    in `heights`. Takes `at_least` so many plain steps, then until the residuals are below the
    tolerance [m]."""
    count, filled = x.size, fill_up(x.size, scratch)
    for step in range(1, PLAIN_STEPS + 1):
        wave_sums(filled, components, time, scratch)
        newton_update(x, y, heights, scratch)
        if step < at_least:
            continue
        unsolved = 0
        for i in range(count):
            unsolved += not is_solved(x[i], y[i], scratch[RESIDUAL, i], tolerance)
        if unsolved == 0:
            return
    single = np.empty((SCRATCH_ROWS, 1))
    for i in range(count):
        if not is_solved(x[i], y[i], scratch[RESIDUAL, i], tolerance):
            single[LABEL_X, 0], single[LABEL_Y, 0] = x[i], y[i]
            heights[i] = solve_point(x[i], y[i], components, time, tolerance, single)
            scratch[LABEL_X : LABEL_Y + 1, i] = single[LABEL_X : LABEL_Y + 1, 0]


@kernel
def solve_heights(x, y, components, time, tolerance, heights):
    """Height of the surface above the level [m] at the points x, y: (N,) [m]."""
    scratch = np.empty((SCRATCH_ROWS, CHUNK))
    for start in range(0, x.size, CHUNK):
        end = min(start + CHUNK, x.size)
        scratch[LABEL_X, : end - start] = x[start:end]
        scratch[LABEL_Y, : end - start] = y[start:end]
        chunk = slice(start, end)
        solve_chunk(x[chunk], y[chunk], components, time, tolerance, 1, heights[chunk], scratch)


@kernel
def slopes_from_sums(count, scratch):
    """Gradients G = J^-1 sum d k a cos(theta) into the SLOPE rows, and into the BEND rows

    M = - sum d d^T k^2 a (sin(theta) - (G . d) cos(theta)).
    """
    for i in range(count):
        gx, gy = newton_step(i, scratch[SLOPE_X, i], scratch[SLOPE_Y, i], scratch)
        scratch[BEND_XX, i] = (
            gx * scratch[TWIST_XXX, i] + gy * scratch[TWIST_XXY, i] - scratch[BEND_XX, i]
        )
        scratch[BEND_XY, i] = (
            gx * scratch[TWIST_XXY, i] + gy * scratch[TWIST_XYY, i] - scratch[BEND_XY, i]
        )
        scratch[BEND_YY, i] = (
            gx * scratch[TWIST_XYY, i] + gy * scratch[TWIST_YYY, i] - scratch[BEND_YY, i]
        )
        scratch[SLOPE_X, i], scratch[SLOPE_Y, i] = gx, gy


@kernel
def third_from_sums(count, scratch):
    """Third derivatives into the KINK rows: with E = J^-1 M, the TWIST T, KINK K and SWIRL U,

        N_jkm = T_ijk E_im + T_ijm E_ik + T_ikm E_ij - K_jkm - G_i U_ijkm,

    each of whose three indices J^-1 then multiplies. (The third derivative of z(x(alpha)) by the
    chain rule, solved for that of the surface.)
    """
    for i in range(count):
        gx, gy = scratch[SLOPE_X, i], scratch[SLOPE_Y, i]
        scratch[KINK_XXX, i] += gx * scratch[SWIRL_XXXX, i] + gy * scratch[SWIRL_XXXY, i]
        scratch[KINK_XXY, i] += gx * scratch[SWIRL_XXXY, i] + gy * scratch[SWIRL_XXYY, i]
        scratch[KINK_XYY, i] += gx * scratch[SWIRL_XXYY, i] + gy * scratch[SWIRL_XYYY, i]
        scratch[KINK_YYY, i] += gx * scratch[SWIRL_XYYY, i] + gy * scratch[SWIRL_YYYY, i]
    for i in range(count):
        exx, eyx = newton_step(i, scratch[BEND_XX, i], scratch[BEND_XY, i], scratch)
        exy, eyy = newton_step(i, scratch[BEND_XY, i], scratch[BEND_YY, i], scratch)
        xxx, xxy = scratch[TWIST_XXX, i], scratch[TWIST_XXY, i]
        xyy, yyy = scratch[TWIST_XYY, i], scratch[TWIST_YYY, i]
        scratch[KINK_XXX, i] = 3.0 * (xxx * exx + xxy * eyx) - scratch[KINK_XXX, i]
        scratch[KINK_XXY, i] = (
            xxx * exy + xxy * eyy + 2.0 * (xxy * exx + xyy * eyx) - scratch[KINK_XXY, i]
        )
        scratch[KINK_XYY, i] = (
            2.0 * (xxy * exy + xyy * eyy) + xyy * exx + yyy * eyx - scratch[KINK_XYY, i]
        )
        scratch[KINK_YYY, i] = 3.0 * (xyy * exy + yyy * eyy) - scratch[KINK_YYY, i]
    for i in range(count):
        ax, bx = newton_step(i, scratch[KINK_XXX, i], scratch[KINK_XXY, i], scratch)
        ay, by = newton_step(i, scratch[KINK_XXY, i], scratch[KINK_XYY, i], scratch)
        az, bz = newton_step(i, scratch[KINK_XYY, i], scratch[KINK_YYY, i], scratch)
        xxx, xyx = newton_step(i, ax, ay, scratch)
        xxy, xyy = newton_step(i, ay, az, scratch)
        yyx = newton_step(i, bx, by, scratch)[1]
        yyy = newton_step(i, by, bz, scratch)[1]
        scratch[KINK_XXX, i], scratch[KINK_XXY, i] = newton_step(i, xxx, xxy, scratch)
        scratch[KINK_XYY, i] = newton_step(i, xyx, xyy, scratch)[1]
        scratch[KINK_YYY, i] = newton_step(i, yyx, yyy, scratch)[1]


@kernel
def curvatures_from_sums(count, scratch):
    """Hessians H = J^-1 M J^-1 into the BEND rows, in place."""
    for i in range(count):
        px, py = newton_step(i, scratch[BEND_XX, i], scratch[BEND_XY, i], scratch)
        qx, qy = newton_step(i, scratch[BEND_XY, i], scratch[BEND_YY, i], scratch)
        scratch[BEND_XX, i], scratch[BEND_XY, i] = newton_step(i, px, qx, scratch)
        scratch[BEND_YY, i] = newton_step(i, py, qy, scratch)[1]


@kernel
def carry_jets(x, y, scratch):
    """Carry the jets from their particles to the points x, y: what is left of the residual r
    enters the height in fourth order, the gradient in third. Moves the labels in first."""
    for i in range(x.size):
        rx = x[i] - scratch[LABEL_X, i] - scratch[OFFSET_X, i]
        ry = y[i] - scratch[LABEL_Y, i] - scratch[OFFSET_Y, i]
        step_x, step_y = newton_step(i, rx, ry, scratch)
        scratch[LABEL_X, i] += step_x
        scratch[LABEL_Y, i] += step_y
        scratch[OFFSET_X, i], scratch[OFFSET_Y, i] = rx, ry
    for i in range(x.size):
        rx, ry = scratch[OFFSET_X, i], scratch[OFFSET_Y, i]
        turn_xx = scratch[KINK_XXX, i] * rx + scratch[KINK_XXY, i] * ry
        turn_xy = scratch[KINK_XXY, i] * rx + scratch[KINK_XYY, i] * ry
        turn_yy = scratch[KINK_XYY, i] * rx + scratch[KINK_YYY, i] * ry
        bend_xx = scratch[BEND_XX, i] + turn_xx / 3.0
        bend_xy = scratch[BEND_XY, i] + turn_xy / 3.0
        bend_yy = scratch[BEND_YY, i] + turn_yy / 3.0
        rise_x = scratch[SLOPE_X, i] + 0.5 * (bend_xx * rx + bend_xy * ry)
        rise_y = scratch[SLOPE_Y, i] + 0.5 * (bend_xy * rx + bend_yy * ry)
        scratch[HEIGHT, i] += rise_x * rx + rise_y * ry
    for i in range(x.size):
        rx, ry = scratch[OFFSET_X, i], scratch[OFFSET_Y, i]
        turn_xx = scratch[KINK_XXX, i] * rx + scratch[KINK_XXY, i] * ry
        turn_xy = scratch[KINK_XXY, i] * rx + scratch[KINK_XYY, i] * ry
        turn_yy = scratch[KINK_XYY, i] * rx + scratch[KINK_YYY, i] * ry
        bend_xx = scratch[BEND_XX, i] + 0.5 * turn_xx
        bend_xy = scratch[BEND_XY, i] + 0.5 * turn_xy
        bend_yy = scratch[BEND_YY, i] + 0.5 * turn_yy
        scratch[SLOPE_X, i] += bend_xx * rx + bend_xy * ry
        scratch[SLOPE_Y, i] += bend_xy * rx + bend_yy * ry
        scratch[BEND_XX, i] += turn_xx
        scratch[BEND_XY, i] += turn_xy
        scratch[BEND_YY, i] += turn_yy


@njit(inline="always")
def largest_residual(x, y, scratch):
    """Largest residual squared [m^2] of the points x, y at the labels that the sums are of."""
    largest = 0.0
    for i in range(x.size):
        rx = x[i] - scratch[LABEL_X, i] - scratch[OFFSET_X, i]
        ry = y[i] - scratch[LABEL_Y, i] - scratch[OFFSET_Y, i]
        largest = max(largest, rx * rx + ry * ry)
    return largest


@kernel
def solve_jets(x, y, components, time, tolerance, steps, jets):
    """Jets (JET_ROWS, N) of the surface at the points x, y: (N,), from one solve.

    Takes `steps` plain Newton steps from the points to the labels. Where that leaves a residual
    above the tolerance [m] the labels are solved further, so as long as the steps suffice, jets
    are smooth functions of the point however loose the tolerance is.
    """
    heights, scratch = np.empty(CHUNK), np.empty((SCRATCH_ROWS, CHUNK))
    for start in range(0, x.size, CHUNK):
        end = min(start + CHUNK, x.size)
        count = end - start
        px, py = x[start:end], y[start:end]
        scratch[LABEL_X, :count] = px
        scratch[LABEL_Y, :count] = py
        filled = fill_up(count, scratch)
        for _ in range(steps):
            wave_sums(filled, components, time, scratch)
            newton_update(px, py, heights, scratch)
        jet_sums(filled, components, time, scratch)
        if not largest_residual(px, py, scratch) <= tolerance * tolerance:
            solve_chunk(px, py, components, time, tolerance, 1, heights[:count], scratch)
            jet_sums(filled, components, time, scratch)
        slopes_from_sums(filled, scratch)
        third_from_sums(filled, scratch)
        curvatures_from_sums(filled, scratch)
        carry_jets(px, py, scratch)
        jets[JET_HEIGHT : JET_Y + 1, start:end] = scratch[HEIGHT : SLOPE_Y + 1, :count]
        jets[JET_XX : JET_YY + 1, start:end] = scratch[BEND_XX : BEND_YY + 1, :count]
        jets[JET_XXX : JET_YYY + 1, start:end] = scratch[KINK_XXX : KINK_YYY + 1, :count]
        jets[JET_LABEL_X : JET_LABEL_Y + 1, start:end] = scratch[LABEL_X : LABEL_Y + 1, :count]
