"""Rigid fit: the rigid motion closest to the water's motion around a hull.

Added mass and damping are the response of the water to a hull that moves as a rigid body. In waves
they act on the hull's motion relative to the water. That motion is not rigid: along a hull longer
than a wave, the water moves up and down at the same time. The fit takes the velocity (v, omega)
with the least flow through the wet surface, of areas A and normals n,

    sum A (n . (u - v - omega x r))^2  ->  min.

Equal lengths of rising and falling water then move nothing, as they should; the velocity at one
point would. A small weight ties the fit to the water's mean velocity, for motions that have no flow
through the surface, such as the spin of a sphere.

Source: Newman 1977, 6.18, for the force of a wave by the relative motion, there in the limit of
small bodies.
"""

import numpy as np

from sim.kernels import kernel, summing_kernel
from sim.resistance.elements import ELEMENTS, nine

MEAN_VELOCITY_SHARE = 1e-3
"""Weight of the water's mean velocity in the fit, as a share of the weight of the wet surface."""


@kernel
def factor(matrix):
    """Replace a symmetric (6, 6) matrix, given by its lower triangle, by its Cholesky factor."""
    for j in range(6):
        for k in range(j):
            for i in range(j, 6):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
        pivot = np.sqrt(matrix[j, j])
        for i in range(j, 6):
            matrix[i, j] /= pivot


@kernel
def solve(lower, vector):
    """Solve lower lower^T x = vector (6,) in place."""
    for i in range(6):
        for k in range(i):
            vector[i] -= lower[i, k] * vector[k]
        vector[i] /= lower[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            vector[i] -= lower[k, i] * vector[k]
        vector[i] /= lower[i, i]


@summing_kernel
def flow_squares(surface, work, lower_out):
    """Set the lower triangle (6, 6) of the sum of wet area b b^T, where b = (n, point x n) takes a
    rigid motion to its flow through an element."""
    p, q = surface, work[0]
    aa, ba, bb, ca, cb, cc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    da, db, dc, dd, ea, eb, ec, ed, ee = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fa, fb, fc, fd, fe, ff = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(ELEMENTS):
        w, a, b, c = q.wet[i], p.normal_x[i], p.normal_y[i], p.normal_z[i]
        x, y, z = p.x[i], p.y[i], p.z[i]
        d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
        wa, wb, wc, wd, we, wf = w * a, w * b, w * c, w * d, w * e, w * f
        aa, ba, bb = aa + wa * a, ba + wb * a, bb + wb * b
        ca, cb, cc = ca + wc * a, cb + wc * b, cc + wc * c
        da, db, dc, dd = da + wd * a, db + wd * b, dc + wd * c, dd + wd * d
        ea, eb, ec, ed, ee = ea + we * a, eb + we * b, ec + we * c, ed + we * d, ee + we * e
        fa, fb, fc = fa + wf * a, fb + wf * b, fc + wf * c
        fd, fe, ff = fd + wf * d, fe + wf * e, ff + wf * f
    sums = (
        aa, ba, bb, ca, cb, cc, da, db, dc, dd, ea, eb, ec, ed, ee, fa, fb, fc, fd, fe, ff
    )  # fmt: skip
    k = 0
    for i in range(6):
        for j in range(i + 1):
            lower_out[i, j] = sums[k]
            k += 1


@summing_kernel
def fit_matrix(surface, work, lower_out):
    """Cholesky factor (6, 6) of the fit's normal equations, for elements with wet areas."""
    s, e, area, spread = surface, work[0], 0.0, 0.0
    for i in range(ELEMENTS):
        w, x, y, z = e.wet[i], s.x[i], s.y[i], s.z[i]
        area += w
        spread += w * (x * x + y * y + z * z)
    lower_out[:] = 0.0
    flow_squares(s, work, lower_out)
    for i in range(3):
        lower_out[i, i] += MEAN_VELOCITY_SHARE * area / 3.0
        lower_out[3 + i, 3 + i] += MEAN_VELOCITY_SHARE * spread / 3.0
    factor(lower_out)


@summing_kernel
def mean_motion(rotation, work, motion):
    """Mean of a MOTION of the water over the wet areas, in the axes of a rotation (9,)."""
    e, water = work[0], motion[0]
    area, x, y, z = 0.0, 0.0, 0.0, 0.0
    for i in range(ELEMENTS):
        w = e.wet[i]
        area, x, y, z = area + w, x + w * water.x[i], y + w * water.y[i], z + w * water.z[i]
    x, y, z = x / area, y / area, z / area
    ax, ay, az, bx, by, bz, cx, cy, cz = nine(rotation)
    return ax * x + bx * y + cx * z, ay * x + by * y + cy * z, az * x + bz * y + cz * z


@summing_kernel
def fit_motion(surface, rotation, work, lower, motion, fit_out):
    """The rigid motion (6,) closest to a MOTION of the water, in the hull's axes: linear at the
    hull's origin, then angular. lower: from `fit_matrix`."""
    s, e, water = surface, work[0], motion[0]
    ax, ay, az, bx, by, bz, cx, cy, cz = nine(rotation)
    mx, my, mz = mean_motion(rotation, work, motion)
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(ELEMENTS):
        vx, vy, vz = water.x[i], water.y[i], water.z[i]
        nx, ny, nz, x, y, z = s.normal_x[i], s.normal_y[i], s.normal_z[i], s.x[i], s.y[i], s.z[i]
        through = nx * (ax * vx + bx * vy + cx * vz - mx)
        through += ny * (ay * vx + by * vy + cy * vz - my)
        through += nz * (az * vx + bz * vy + cz * vz - mz)
        through *= e.wet[i]
        fx, fy, fz = fx + through * nx, fy + through * ny, fz + through * nz
        tx += through * (y * nz - z * ny)
        ty += through * (z * nx - x * nz)
        tz += through * (x * ny - y * nx)
    fit_out[0], fit_out[1], fit_out[2] = fx, fy, fz
    fit_out[3], fit_out[4], fit_out[5] = tx, ty, tz
    solve(lower, fit_out)
    fit_out[0] += mx
    fit_out[1] += my
    fit_out[2] += mz
