"""Polynomials: the head over a patch as a cubic in the body frame.

In the body frame the head at d from a patch's centre is

    head(d) = h + G . d + d . Q d / 2 + C(d, d, d) / 6,

a sum over twenty monomials. This module makes such polynomials from jets, rotates them, evaluates
them and moves their origin.
"""

from math import comb, prod

import numpy as np
from numpy.typing import NDArray

from sim.kernels import inline, kernel, record, workspace
from sim.water.gerstner import CHUNK, LANES, REALS
from sim.water.head import depth

Array = NDArray[np.float64]

LINEAR, BENDING = 4, 16
"""Numbers of monomials in two groups: 1, x, y, z; and xx, xy, xz, yy, yz, zz, xxx, xxy, xxz, xyy,
xyz, xzz, yyy, yyz, yzz, zzz. The second group matters only in waves and is small there, so its
moments are kept in single precision: the time of a step depends mostly on memory traffic."""

MONOMIALS = LINEAR + BENDING

QUADRATICS = 6
"""Number of quadratic coefficients."""

POLYNOMIAL = record(c=("real", MONOMIALS), bound_2="real", bound_3="real", head="f8", fills="f8")
"""Coefficients of a head in the body frame around a patch's centre, and bounds on its second-order
terms over the distance squared and its third-order terms over the distance cubed. head [m]: the
first coefficient, with all digits. fills: fills the last cache line in double precision."""

TURNING = record(
    turns=("real", (9, CHUNK)), c=("real", (MONOMIALS, CHUNK)), bound_2=REALS, bound_3=REALS
)
"""Workspace: the rotations of the poses of a chunk's jets, and their POLYNOMIALs in the body
frame."""


def monomials(d: Array) -> Array:
    """The monomials (..., MONOMIALS) at points (..., 3)."""
    x, y, z = np.moveaxis(d, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    second = xx, x * y, x * z, yy, y * z, zz
    third = x * xx, y * xx, z * xx, x * yy, x * y * z, x * zz, y * yy, z * yy, y * zz, z * zz
    return np.stack([np.ones_like(x), x, y, z, *second, *third], axis=-1)


EXPONENTS = [
    (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0),
    (0, 1, 1), (0, 0, 2), (3, 0, 0), (2, 1, 0), (2, 0, 1), (1, 2, 0), (1, 1, 1), (1, 0, 2),
    (0, 3, 0), (0, 2, 1), (0, 1, 2), (0, 0, 3),
]  # fmt: skip
"""Exponents of x, y and z in the monomials."""

BINOMIALS = [
    (i, j, prod(map(comb, of, to)), *np.subtract(of, to))
    for i, of in enumerate(EXPONENTS)
    for j, to in enumerate(EXPONENTS)
    if all(m <= n for m, n in zip(to, of, strict=True))
]
"""The terms of monomial i at d + offset: the monomial j at d, a factor, and the exponents of the
offset."""


def moved_monomials(offsets: Array) -> Array:
    """Matrices (N, MONOMIALS, MONOMIALS) that map the monomials at d to those at d + offset, for
    offsets (N, 3), by the binomial theorem."""
    i, j, ways, *exponents = np.array(BINOMIALS).T
    powers = offsets[:, :, None] ** np.arange(4)
    found = np.zeros((len(offsets), MONOMIALS, MONOMIALS))
    found[:, i, j] = ways
    for axis, exponent in enumerate(exponents):
        found[:, i, j] *= powers[:, axis, exponent]
    return found


def local_quadratic(places: Array) -> Array:
    """Matrices (N, 6, BENDING) that map a polynomial's bending coefficients to the quadratic
    coefficients of the same polynomial around the points (N, 3)."""
    x, y, z = places.T
    found = np.zeros((len(places), 6, BENDING))
    found[:, range(6), range(6)] = 1.0
    for row, column, factor, at in (
        (0, 6, 3, x), (0, 7, 1, y), (0, 8, 1, z), (1, 7, 2, x), (1, 9, 2, y), (1, 10, 1, z),
        (2, 8, 2, x), (2, 10, 1, y), (2, 11, 2, z), (3, 9, 1, x), (3, 12, 3, y), (3, 13, 1, z),
        (4, 10, 1, x), (4, 13, 2, y), (4, 14, 2, z), (5, 11, 1, x), (5, 14, 1, y), (5, 15, 3, z),
    ):  # fmt: skip
        found[:, row, column] = factor * at
    return found


@inline
def squared(x, y, z):
    """Coefficients of xx, xy, xz, yy, yz, zz in the square of a linear form."""
    return x * x, 2.0 * x * y, 2.0 * x * z, y * y, 2.0 * y * z, z * z


@kernel
def head_polynomials(jets, above, chosen, rotations, polynomials_out):
    """Polynomials (N,) of the heads around the chosen patches' centres, from their JETs. above (N,)
    [m]: heights of the centres above the level; rotations (P, 9): body -> world, one for each
    pose."""
    for i in range(above.size):
        jet, r, q = jets[i], rotations[chosen[i].pose], polynomials_out[i].c
        gx, gy = jet.z_x, jet.z_y
        # the horizontal coordinates are the linear forms a . d and b . d
        ax, ay, az, bx, by, bz = r[0], r[1], r[2], r[3], r[4], r[5]
        polynomials_out[i].head = depth(jet.z, above[i])
        q[0] = polynomials_out[i].head
        q[1] = gx * ax + gy * bx - r[6]
        q[2] = gx * ay + gy * by - r[7]
        q[3] = gx * az + gy * bz - r[8]
        axx, axy, axz, ayy, ayz, azz = squared(ax, ay, az)
        bxx, bxy, bxz, byy, byz, bzz = squared(bx, by, bz)
        xx, xy, yy = 0.5 * jet.z_xx, jet.z_xy, 0.5 * jet.z_yy
        q[4] = xx * axx + yy * bxx + xy * ax * bx
        q[5] = xx * axy + yy * bxy + xy * (ax * by + ay * bx)
        q[6] = xx * axz + yy * bxz + xy * (ax * bz + az * bx)
        q[7] = xx * ayy + yy * byy + xy * ay * by
        q[8] = xx * ayz + yy * byz + xy * (ay * bz + az * by)
        q[9] = xx * azz + yy * bzz + xy * az * bz
        # the cubic is (a . d)^2 (u . d) + (b . d)^2 (v . d)
        xxx, xxy = jet.z_xxx / 6.0, 0.5 * jet.z_xxy
        xyy, yyy = 0.5 * jet.z_xyy, jet.z_yyy / 6.0
        ux, uy, uz = xxx * ax + xxy * bx, xxx * ay + xxy * by, xxx * az + xxy * bz
        vx, vy, vz = xyy * ax + yyy * bx, xyy * ay + yyy * by, xyy * az + yyy * bz
        q[10] = axx * ux + bxx * vx
        q[11] = axx * uy + axy * ux + bxx * vy + bxy * vx
        q[12] = axx * uz + axz * ux + bxx * vz + bxz * vx
        q[13] = ayy * ux + axy * uy + byy * vx + bxy * vy
        q[14] = axy * uz + axz * uy + ayz * ux + bxy * vz + bxz * vy + byz * vx
        q[15] = azz * ux + axz * uz + bzz * vx + bxz * vz
        q[16] = ayy * uy + byy * vy
        q[17] = ayy * uz + ayz * uy + byy * vz + byz * vy
        q[18] = ayz * uz + azz * uy + byz * vz + bzz * vy
        q[19] = azz * uz + bzz * vz
        polynomials_out[i].bound_2 = np.sqrt(xx * xx + 0.5 * xy * xy + yy * yy)
        polynomials_out[i].bound_3 = np.sqrt(xxx * xxx + (xxy * xxy + xyy * xyy) / 3.0 + yyy * yyy)


@inline
def product(ax, ay, az, bx, by, bz):
    """Coefficients of xx, xy, xz, yy, yz, zz in the product of two linear forms."""
    return ax * bx, ax * by + ay * bx, ax * bz + az * bx, ay * by, ay * bz + az * by, az * bz


@inline
def add_cubic(q, i, xx, xy, xz, yy, yz, zz, x, y, z):
    """Add the product of a quadratic and a linear form to the cubic coefficients in place i."""
    q[10, i] += xx * x
    q[11, i] += xx * y + xy * x
    q[12, i] += xx * z + xz * x
    q[13, i] += xy * y + yy * x
    q[14, i] += xy * z + xz * y + yz * x
    q[15, i] += xz * z + zz * x
    q[16, i] += yy * y
    q[17, i] += yy * z + yz * y
    q[18, i] += yz * z + zz * y
    q[19, i] += zz * z


@inline
def form(a, b, c, r, i):
    """The linear form a x + b y + c z of world coordinates, in the frame of the rotation at place
    i."""
    return (
        a * r[0, i] + b * r[3, i] + c * r[6, i],
        a * r[1, i] + b * r[4, i] + c * r[7, i],
        a * r[2, i] + b * r[5, i] + c * r[8, i],
    )


@inline
def set_linear(w, i, jet):
    """Value and first-order coefficients in place i of a TURNING, from HEAD_JETS."""
    w.c[0, i] = jet.h[i]
    w.c[1, i], w.c[2, i], w.c[3, i] = form(jet.x[i], jet.y[i], jet.z[i], w.turns, i)


@inline
def set_quadratic(w, i, jet):
    """Second-order coefficients in place i of a TURNING, and their bound."""
    q, r = w.c, w.turns
    xx, xy, yy = 0.5 * jet.xx[i], jet.xy[i], 0.5 * jet.yy[i]
    xz, yz, zz = jet.xz[i], jet.yz[i], 0.5 * jet.zz[i]
    ux, uy, uz = form(xx, xy, xz, r, i)
    vx, vy, vz = form(0.0, yy, yz, r, i)
    wx, wy, wz = form(0.0, 0.0, zz, r, i)
    a0, a1, a2, a3, a4, a5 = product(r[0, i], r[1, i], r[2, i], ux, uy, uz)
    b0, b1, b2, b3, b4, b5 = product(r[3, i], r[4, i], r[5, i], vx, vy, vz)
    c0, c1, c2, c3, c4, c5 = product(r[6, i], r[7, i], r[8, i], wx, wy, wz)
    q[4, i], q[5, i], q[6, i] = a0 + b0 + c0, a1 + b1 + c1, a2 + b2 + c2
    q[7, i], q[8, i], q[9, i] = a3 + b3 + c3, a4 + b4 + c4, a5 + b5 + c5
    w.bound_2[i] = np.sqrt(xx * xx + yy * yy + zz * zz + 0.5 * (xy * xy + xz * xz + yz * yz))


@inline
def set_cubic(w, i, jet):
    """Third-order coefficients in place i of a TURNING, and their bound. The cubic is
    (a . d)^2 (u . d) + (b . d)^2 (v . d) + (c . d)^2 (w . d) plus the product of all three
    forms."""
    q, r = w.c, w.turns
    xxx, xxy, xyy = jet.xxx[i] / 6.0, 0.5 * jet.xxy[i], 0.5 * jet.xyy[i]
    yyy, xxz, xyz, yyz = jet.yyy[i] / 6.0, 0.5 * jet.xxz[i], jet.xyz[i], 0.5 * jet.yyz[i]
    xzz, yzz, zzz = 0.5 * jet.xzz[i], 0.5 * jet.yzz[i], jet.zzz[i] / 6.0
    ax, ay, az = r[0, i], r[1, i], r[2, i]
    bx, by, bz = r[3, i], r[4, i], r[5, i]
    cx, cy, cz = r[6, i], r[7, i], r[8, i]
    for j in range(10, MONOMIALS):
        q[j, i] = 0.0
    xx, xy, xz, yy, yz, zz = squared(ax, ay, az)
    x, y, z = form(xxx, xxy, xxz, r, i)
    add_cubic(q, i, xx, xy, xz, yy, yz, zz, x, y, z)
    xx, xy, xz, yy, yz, zz = squared(bx, by, bz)
    x, y, z = form(xyy, yyy, yyz, r, i)
    add_cubic(q, i, xx, xy, xz, yy, yz, zz, x, y, z)
    xx, xy, xz, yy, yz, zz = squared(cx, cy, cz)
    x, y, z = form(xzz, yzz, zzz, r, i)
    add_cubic(q, i, xx, xy, xz, yy, yz, zz, x, y, z)
    xx, xy, xz, yy, yz, zz = product(ax, ay, az, bx, by, bz)
    add_cubic(q, i, xx, xy, xz, yy, yz, zz, xyz * cx, xyz * cy, xyz * cz)
    mixed = xxy * xxy + xxz * xxz + xyy * xyy + yyz * yyz + xzz * xzz + yzz * yzz
    w.bound_3[i] = np.sqrt(xxx * xxx + yyy * yyy + zzz * zzz + mixed / 3.0 + xyz * xyz / 6.0)


@kernel
def gather_turns(count, chosen, rotations, work):
    """Copy the rotations of the poses of the chosen patches, at least one, into the first `count`
    places of a TURNING, and repeat the first one in those that are left."""
    w, first = work[0], chosen[0].pose
    for j in range(9):
        for i in range(count):
            w.turns[j, i] = rotations[first, j]
    if chosen[chosen.size - 1].pose != first:  # patches of several hulls, which follow each other
        for i in range(chosen.size):
            r = rotations[chosen[i].pose]
            for j in range(9):
                w.turns[j, i] = r[j]


@kernel
def turn_jets(count, jets, work):
    """Compute the first `count` polynomials of a TURNING from HEAD_JETS."""
    w, jet = work[0], jets[0]
    for i in range(count):
        set_linear(w, i, jet)
    for i in range(count):
        set_quadratic(w, i, jet)
    for i in range(count):
        set_cubic(w, i, jet)


@kernel
def scatter(jets, work, polynomials_out):
    """Copy the first polynomials (N,) out of a TURNING, and their heads out of HEAD_JETS."""
    jet, w = jets[0], work[0]
    for i in range(polynomials_out.size):
        polynomial = polynomials_out[i]
        for j in range(MONOMIALS):
            polynomial.c[j] = w.c[j, i]
        polynomial.bound_2, polynomial.bound_3 = w.bound_2[i], w.bound_3[i]
        polynomial.head = jet.h[i]


@kernel
def decayed_polynomials(jets, chosen, rotations, polynomials_out):
    """Polynomials (N,) of the heads around the chosen patches' centres, from one to CHUNK of them,
    from their HEAD_JETS."""
    work = workspace(TURNING)
    filled = -(-chosen.size // LANES) * LANES
    gather_turns(filled, chosen, rotations, work)
    turn_jets(filled, jets, work)
    scatter(jets, work, polynomials_out)


@inline
def head_and_slope(q, x, y, z):
    """Head and its gradient at a point."""
    axx = q[4] + x * q[10] + y * q[11] + z * q[12]
    axy, axz = q[5] + y * q[13] + z * q[14], q[6] + z * q[15]
    ayy, ayz, azz = q[7] + y * q[16] + z * q[17], q[8] + z * q[18], q[9] + z * q[19]
    dx, dy, dz = x * axx + y * axy + z * axz, y * ayy + z * ayz, z * azz
    head = q[0] + x * (q[1] + dx) + y * (q[2] + dy) + z * (q[3] + dz)
    gx = q[1] + dx + x * (axx + x * q[10])
    gy = q[2] + dy + x * (axy + x * q[11] + y * q[13]) + y * (ayy + y * q[16])
    gz = q[3] + dz + x * (axz + x * q[12] + y * q[14] + z * q[15])
    gz += y * (ayz + y * q[17] + z * q[18]) + z * (azz + z * q[19])
    return head, gx, gy, gz


@inline
def bend_at(c, leaf, factor):
    """The six quadratic coefficients of a polynomial around a leaf's middle, times a factor."""
    x, y, z = leaf.middle_x, leaf.middle_y, leaf.middle_z
    return (
        factor * (c[4] + 3.0 * x * c[10] + y * c[11] + z * c[12]),
        factor * (c[5] + 2.0 * x * c[11] + 2.0 * y * c[13] + z * c[14]),
        factor * (c[6] + 2.0 * x * c[12] + y * c[14] + 2.0 * z * c[15]),
        factor * (c[7] + x * c[13] + 3.0 * y * c[16] + z * c[17]),
        factor * (c[8] + x * c[14] + 2.0 * y * c[17] + 2.0 * z * c[18]),
        factor * (c[9] + x * c[15] + y * c[18] + 3.0 * z * c[19]),
    )


@inline
def five(c, j):
    """Five coefficients from number j on."""
    return c[j], c[j + 1], c[j + 2], c[j + 3], c[j + 4]
