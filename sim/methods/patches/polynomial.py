"""Polynomials: the head over a patch as a cubic in the body frame.

In the body frame the head at d from a patch's centre is

    head(d) = h + G . d + d . Q d / 2 + C(d, d, d) / 6,

a sum over twenty monomials. This module makes such polynomials from jets, rotates them, evaluates
them and moves their origin.
"""

import numpy as np
from numpy.typing import NDArray

from sim.kernels import inline, kernel, record
from sim.water.head import depth

Array = NDArray[np.float64]

LINEAR, BENDING = 4, 16
"""Numbers of monomials in two groups: 1, x, y, z; and xx, xy, xz, yy, yz, zz, xxx, xxy, xxz, xyy,
xyz, xzz, yyy, yyz, yzz, zzz. The second group matters only in waves and is small there, so its
moments are kept in single precision: the time of a step depends mostly on memory traffic."""

MONOMIALS = LINEAR + BENDING

QUADRATICS = 8
"""The six quadratic coefficients and two zeros, which fill a vector register."""

POLYNOMIAL = record(c=("f8", MONOMIALS), bound_2="f8", bound_3="f8", fills_lines=("f8", 2))
"""Coefficients of a head in the body frame around a patch's centre, and bounds on its second-order
terms over the distance squared and its third-order terms over the distance cubed."""


def monomials(d: Array) -> Array:
    """The monomials (..., MONOMIALS) at points (..., 3)."""
    x, y, z = np.moveaxis(d, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    second = xx, x * y, x * z, yy, y * z, zz
    third = x * xx, y * xx, z * xx, x * yy, x * y * z, x * zz, y * yy, z * yy, y * zz, z * zz
    return np.stack([np.ones_like(x), x, y, z, *second, *third], axis=-1)


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
        q[0] = depth(jet.z, above[i])
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
def add_cubic(q, xx, xy, xz, yy, yz, zz, x, y, z):
    """Add the product of a quadratic and a linear form to the cubic coefficients."""
    q[10] += xx * x
    q[11] += xx * y + xy * x
    q[12] += xx * z + xz * x
    q[13] += xy * y + yy * x
    q[14] += xy * z + xz * y + yz * x
    q[15] += xz * z + zz * x
    q[16] += yy * y
    q[17] += yy * z + yz * y
    q[18] += yz * z + zz * y
    q[19] += zz * z


@inline
def form(a, b, c, r):
    """The linear form a x + b y + c z of world coordinates, in the frame of a rotation (9,)."""
    return (
        a * r[0] + b * r[3] + c * r[6],
        a * r[1] + b * r[4] + c * r[7],
        a * r[2] + b * r[5] + c * r[8],
    )


@kernel
def set_quadratic(jet, r, polynomial_out):
    """Second-order coefficients of a HEAD_JET in the frame of a rotation (9,), and their bound."""
    q = polynomial_out.c
    xx, yy, zz = 0.5 * jet.xx, 0.5 * jet.yy, 0.5 * jet.zz
    ux, uy, uz = form(xx, jet.xy, jet.xz, r)
    vx, vy, vz = form(0.0, yy, jet.yz, r)
    wx, wy, wz = form(0.0, 0.0, zz, r)
    a0, a1, a2, a3, a4, a5 = product(r[0], r[1], r[2], ux, uy, uz)
    b0, b1, b2, b3, b4, b5 = product(r[3], r[4], r[5], vx, vy, vz)
    c0, c1, c2, c3, c4, c5 = product(r[6], r[7], r[8], wx, wy, wz)
    q[4], q[5], q[6] = a0 + b0 + c0, a1 + b1 + c1, a2 + b2 + c2
    q[7], q[8], q[9] = a3 + b3 + c3, a4 + b4 + c4, a5 + b5 + c5
    mixed = jet.xy * jet.xy + jet.xz * jet.xz + jet.yz * jet.yz
    polynomial_out.bound_2 = np.sqrt(xx * xx + yy * yy + zz * zz + 0.5 * mixed)


@kernel
def set_cubic(jet, r, polynomial_out):
    """Third-order coefficients and their bound. The cubic is (a . d)^2 (u . d) + (b . d)^2 (v . d)
    + (c . d)^2 (w . d) plus the product of all three forms."""
    q = polynomial_out.c
    xxx, xxy, xxz = jet.xxx / 6.0, 0.5 * jet.xxy, 0.5 * jet.xxz
    xyy, yyy, yyz = 0.5 * jet.xyy, jet.yyy / 6.0, 0.5 * jet.yyz
    xzz, yzz, zzz, xyz = 0.5 * jet.xzz, 0.5 * jet.yzz, jet.zzz / 6.0, jet.xyz
    ax, ay, az, bx, by, bz, cx, cy, cz = r
    for j in range(10, MONOMIALS):
        q[j] = 0.0
    xx, xy, xz, yy, yz, zz = squared(ax, ay, az)
    x, y, z = form(xxx, xxy, xxz, r)
    add_cubic(q, xx, xy, xz, yy, yz, zz, x, y, z)
    xx, xy, xz, yy, yz, zz = squared(bx, by, bz)
    x, y, z = form(xyy, yyy, yyz, r)
    add_cubic(q, xx, xy, xz, yy, yz, zz, x, y, z)
    xx, xy, xz, yy, yz, zz = squared(cx, cy, cz)
    x, y, z = form(xzz, yzz, zzz, r)
    add_cubic(q, xx, xy, xz, yy, yz, zz, x, y, z)
    xx, xy, xz, yy, yz, zz = product(ax, ay, az, bx, by, bz)
    add_cubic(q, xx, xy, xz, yy, yz, zz, xyz * cx, xyz * cy, xyz * cz)
    mixed = xxy * xxy + xxz * xxz + xyy * xyy + yyz * yyz + xzz * xzz + yzz * yzz
    polynomial_out.bound_3 = np.sqrt(
        xxx * xxx + yyy * yyy + zzz * zzz + mixed / 3.0 + xyz * xyz / 6.0
    )


@kernel
def decayed_polynomials(jets, chosen, rotations, polynomials_out):
    """Polynomials (N,) of the heads around the chosen patches' centres, from their HEAD_JETs."""
    for i in range(jets.size):
        jet, r, polynomial = jets[i], rotations[chosen[i].pose], polynomials_out[i]
        q = polynomial.c
        q[0] = jet.h
        q[1], q[2], q[3] = form(jet.x, jet.y, jet.z, r)
        set_quadratic(jet, r, polynomial)
        set_cubic(jet, r, polynomial)


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
def bend_at(c, leaf, factor, bend_out):
    """The six quadratic coefficients of a polynomial around a leaf's middle, times a factor."""
    x, y, z = leaf.middle_x, leaf.middle_y, leaf.middle_z
    bend_out[0] = factor * (c[4] + 3.0 * x * c[10] + y * c[11] + z * c[12])
    bend_out[1] = factor * (c[5] + 2.0 * x * c[11] + 2.0 * y * c[13] + z * c[14])
    bend_out[2] = factor * (c[6] + 2.0 * x * c[12] + y * c[14] + 2.0 * z * c[15])
    bend_out[3] = factor * (c[7] + x * c[13] + 3.0 * y * c[16] + z * c[17])
    bend_out[4] = factor * (c[8] + x * c[14] + 2.0 * y * c[17] + 2.0 * z * c[18])
    bend_out[5] = factor * (c[9] + x * c[15] + y * c[18] + 3.0 * z * c[19])


@inline
def five(c, j):
    """Five coefficients from number j on."""
    return c[j], c[j + 1], c[j + 2], c[j + 3], c[j + 4]
