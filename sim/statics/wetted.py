"""Wetted: the exact part of a closed surface below still water, and its waterplane.

All figures are sums over the wetted triangles. The volume is a sum of cones from a point on the
water's surface. The wetted part and the waterplane together enclose it, so an integral over the
waterplane is minus the integral over the projection of the wetted part (Gauss).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.geometry import cross, placed
from sim.kernels import inline, kernel, scratch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Wetted:
    """The part of a solid below z = 0.

    volume [m^3]. moment: (3,) [m^4], volume times the centre of buoyancy. surface [m^2]: the wetted
    area. waterplane [m^2]: its area. plane_moment: (2,) [m^3], plane_squares: (2, 2) [m^4], the
    integrals of p and p p^T over the waterplane, with p = (x, y).
    """

    volume: float
    moment: Array
    surface: float
    waterplane: float
    plane_moment: Array
    plane_squares: Array

    @property
    def centre(self) -> Array:
        """Centre of buoyancy (3,) [m]; the origin if nothing is wetted."""
        return self.moment / self.volume if self.volume > 0.0 else np.zeros(3)


def wetted_part(corners: Array, displaced: Array, rotation: Array, height: float) -> Wetted:
    """The Wetted of closed, outward surfaces of triangles, corners (F, 3, 3) [m], rotated by a
    rotation (3, 3) and then lifted by a height [m]; z is up, and 0 at the water's level. displaced:
    (F,), the volume that a triangle's surface displaces over the volume that it encloses."""
    s = np.zeros(11)
    position = np.array([0.0, 0.0, height])
    add_wetted(corners, displaced, position, np.ascontiguousarray(rotation).reshape(9), s)
    squares = np.array([[s[7], s[8]], [s[8], s[9]]]) / 12.0
    volume, waterplane, surface = map(float, s[[0, 4, 10]])
    return Wetted(volume, s[1:4] / 4.0, surface, waterplane, s[5:7] / 3.0, squares)


@inline
def add_piece(ax, ay, az, bx, by, bz, cx, cy, cz, share, sums_out):
    """Add the contribution of the wetted triangle a, b, c."""
    nx, ny, nz = cross(bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az)
    px, py, pz = cross(bx, by, bz, cx, cy, cz)
    x, y = ax + bx + cx, ay + by + cy
    volume, down = share * (ax * px + ay * py + az * pz) / 6.0, -0.5 * share * nz
    sums_out[0] += volume
    sums_out[1] += volume * x
    sums_out[2] += volume * y
    sums_out[3] += volume * (az + bz + cz)
    sums_out[4] += down
    sums_out[5] += down * x
    sums_out[6] += down * y
    sums_out[7] += down * (ax * ax + bx * bx + cx * cx + x * x)
    sums_out[8] += down * (ax * ay + bx * by + cx * cy + x * y)
    sums_out[9] += down * (ay * ay + by * by + cy * cy + y * y)
    sums_out[10] += 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)


@kernel
def add_wetted(corners, displaced, position, rotation, sums_out):
    """Sums (11,) over the wetted pieces of triangles: see `wetted_part`."""
    p = scratch((3, 3))
    for t in range(corners.shape[0]):
        wet = 0
        for c in range(3):
            p[c, 0], p[c, 1], p[c, 2] = placed(
                corners[t, c, 0], corners[t, c, 1], corners[t, c, 2], position, rotation
            )
            wet += p[c, 2] < 0.0
        if wet == 0:
            continue
        a = 0
        if wet != 3:  # begin with the corner that is alone on its side of the water
            for c in range(3):
                if (p[c, 2] < 0.0) == (wet == 1):
                    a = c
        b, c, share = (a + 1) % 3, (a + 2) % 3, displaced[t]
        ax, ay, az = p[a, 0], p[a, 1], p[a, 2]
        bx, by, bz, cx, cy, cz = p[b, 0], p[b, 1], p[b, 2], p[c, 0], p[c, 1], p[c, 2]
        if wet == 3:
            add_piece(ax, ay, az, bx, by, bz, cx, cy, cz, share, sums_out)
            continue
        u, v = az / (az - bz), az / (az - cz)
        dx, dy = ax + u * (bx - ax), ay + u * (by - ay)
        ex, ey = ax + v * (cx - ax), ay + v * (cy - ay)
        if wet == 1:
            add_piece(ax, ay, az, dx, dy, 0.0, ex, ey, 0.0, share, sums_out)
        else:
            add_piece(dx, dy, 0.0, bx, by, bz, cx, cy, cz, share, sums_out)
            add_piece(dx, dy, 0.0, cx, cy, cz, ex, ey, 0.0, share, sums_out)
