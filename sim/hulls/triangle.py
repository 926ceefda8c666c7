"""Triangle: hydrostatic force and torque of a triangle in closed form, and the straight clip.

The head e [m] is the depth below the surface and linear over the triangle. The pressure
density * gravity * e acts against the outward area vector S = (b - a) x (c - a) / 2. Exactly,

    F = - density gravity  (e_a + e_b + e_c)/3  S
    T = - density gravity  [ (a + b + c)(e_a + e_b + e_c) + a e_a + b e_b + c e_c ]/12  x  S

with the torque about the origin of a, b, c. Kernels return F and T over - density gravity, and the
caller scales their sum.
"""

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike, NDArray

from sim.geometry import cross
from sim.kernels import inline, kernel, scratch

TWELFTH = 1.0 / 12.0
"""A factor, because a multiplication is faster than a division."""


@kernel
def sum_wet(corners, heads, sums_out):
    """F and T (6,) of triangles, corners (N, 3, 3) and heads (N, 3), over - density gravity."""
    sums_out[:] = 0.0
    for i in range(corners.shape[0]):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        ea, eb, ec = heads[i, 0], heads[i, 1], heads[i, 2]
        sx, sy, sz = cross(
            b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        )
        sx, sy, sz = 0.5 * sx, 0.5 * sy, 0.5 * sz
        total = ea + eb + ec
        wa, wb, wc = (total + ea) / 12.0, (total + eb) / 12.0, (total + ec) / 12.0
        tx, ty, tz = cross(
            a[0] * wa + b[0] * wb + c[0] * wc,
            a[1] * wa + b[1] * wb + c[1] * wc,
            a[2] * wa + b[2] * wb + c[2] * wc,
            sx,
            sy,
            sz,
        )
        mean = total / 3.0
        sums_out[0] += mean * sx
        sums_out[1] += mean * sy
        sums_out[2] += mean * sz
        sums_out[3] += tx
        sums_out[4] += ty
        sums_out[5] += tz


def wet_triangles_wrench(
    corners: ArrayLike,
    heads: ArrayLike,
    density: float,
    gravity: float,
    about: ArrayLike = (0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    """Wrench (6,) [N, N m] of wholly wet triangles, for callers with their own clipping.

    corners: (N, 3, 3) [m], counterclockwise seen from outside. heads: (N, 3) [m], depth below the
    surface at each corner, linear in between; a negative head pulls. density [kg/m^3]. gravity
    [m/s^2]. about: (3,) [m], the point that the torque is about. The axes are those of the corners.
    Exact to round-off. Raises ValueError if the shapes do not fit.
    """
    about = np.asarray(about, dtype=float)
    corners = np.asarray(corners, dtype=float)
    heads = np.ascontiguousarray(heads, dtype=float)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3) or heads.shape != corners.shape[:2]:
        raise ValueError(
            f"corners have shape {corners.shape} and heads {heads.shape}; "
            "expected (N, 3, 3) and (N, 3): one head for each corner"
        )
    out = np.empty(6)
    sum_wet(np.ascontiguousarray(corners - about), heads, out)
    return -density * gravity * out


def gauss_rule(order: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gauss rule of order n on a triangle, exact for polynomials up to degree 2 n - 2: barycentric
    points (n^2, 3) and weights (n^2,) that sum to 1. It is the rule of a square with one side
    collapsed (Duffy 1982)."""
    nodes, weights = leggauss(order)
    u, w = 0.5 * (nodes + 1.0), 0.5 * weights
    x, y = np.meshgrid(u, u, indexing="ij")
    points = np.stack([1.0 - x, x * (1.0 - y), x * y], axis=-1).reshape(-1, 3)
    return points, (2.0 * np.outer(w * u, w)).ravel()


@kernel
def clipped(corners, heads):
    """The wet pieces of triangles (N, 3, 3) with linear heads (N, 3), as triangles (M, 3, 3) with
    heads (M, 3)."""
    most = 2 * corners.shape[0]  # a triangle with two wet corners leaves a quadrangle
    wet_corners, wet_heads = np.empty((most, 3, 3)), np.empty((most, 3))
    polygon, values = scratch((4, 3)), scratch(4)
    n = 0
    for f in range(corners.shape[0]):
        size = 0
        for i in range(3):
            j = (i + 1) % 3
            ei, ej = heads[f, i], heads[f, j]
            if ei > 0.0:
                values[size] = ei
                for x in range(3):
                    polygon[size, x] = corners[f, i, x]
                size += 1
            if (ei > 0.0) != (ej > 0.0):
                values[size], along = 0.0, ei / (ei - ej)
                for x in range(3):
                    side = corners[f, j, x] - corners[f, i, x]
                    polygon[size, x] = corners[f, i, x] + along * side
                size += 1
        for k in range(1, size - 1):
            for corner in range(3):
                at = 0 if corner == 0 else k + corner - 1
                wet_heads[n, corner] = values[at]
                for x in range(3):
                    wet_corners[n, corner, x] = polygon[at, x]
            n += 1
    return wet_corners[:n], wet_heads[:n]


@inline
def dry_weights(ea, eb, ec):
    """What a straight clip subtracts from the integrals of a triangle that the water cuts, if they
    take the heads of its wet corners over the whole triangle.

    e_a, e_b, e_c are the heads, positive under water. Corner a is the only wet corner or the only
    dry corner. The waterline crosses the edges ab and ac at p and q, where the head, linear along
    each edge, is zero. With A the area vector, and with one wet or one dry corner alike, the amount
    is

        |e_a| / 3  (1 - t_b t_c)                                  times A (force), and
        |e_a| / 12 [ (2a + b + c) - (2a + p + q) t_b t_c ]        crossed with A (torque),

    where t_b and t_c are the shares of the edges from a to p and from a to q. Returns the factors
    of a, b and c in the second. Their sum is the first.
    """
    tb = ea / (ea - eb)
    tc = ea / (ea - ec)
    share, scale = tb * tc, abs(ea) * TWELFTH
    # 2a + p + q = 4a + tb (b - a) + tc (c - a)
    pa, pb, pc = share * (4.0 - tb - tc), share * tb, share * tc
    return scale * (2.0 - pa), scale * (1.0 - pb), scale * (1.0 - pc)


@inline
def clip_dry_part(ax, ay, az, bx, by, bz, cx, cy, cz, ea, eb, ec):
    """What a straight clip subtracts from the force and torque sums of a triangle: the factor of
    its area vector, and the vector to be crossed with that. See `dry_weights`."""
    a, b, c = dry_weights(ea, eb, ec)
    return (
        a + b + c, a * ax + b * bx + c * cx, a * ay + b * by + c * cy, a * az + b * bz + c * cz
    )  # fmt: skip
