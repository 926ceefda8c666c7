"""Crossings: triangles of a surface that go through one another.

Source: Moeller and Trumbore 1997, for the intersection of a side with a triangle.
"""

import numpy as np
from numpy.typing import NDArray

from sim.geometry import cross
from sim.kernels import inline, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TOUCHING_SHARE = 1e-9
"""Share of a side and of a triangle: an intersection closer than this to the end of the side or the
triangle's border counts as a touch."""

PARALLEL_SINE_SQUARED = 1e-18
"""Square of the sine of the angle between a side and a triangle's plane below which they count as
parallel."""


@inline
def pierces(corners, i, a, b, j):
    """Whether the side from a to b of triangle i goes through triangle j."""
    px, py, pz = corners[i, a, 0], corners[i, a, 1], corners[i, a, 2]
    dx, dy, dz = corners[i, b, 0] - px, corners[i, b, 1] - py, corners[i, b, 2] - pz
    ox, oy, oz = corners[j, 0, 0], corners[j, 0, 1], corners[j, 0, 2]
    ux, uy, uz = corners[j, 1, 0] - ox, corners[j, 1, 1] - oy, corners[j, 1, 2] - oz
    vx, vy, vz = corners[j, 2, 0] - ox, corners[j, 2, 1] - oy, corners[j, 2, 2] - oz
    hx, hy, hz = cross(dx, dy, dz, vx, vy, vz)
    det = ux * hx + uy * hy + uz * hz
    lengths = (dx * dx + dy * dy + dz * dz) * (ux * ux + uy * uy + uz * uz)
    if det * det <= PARALLEL_SINE_SQUARED * lengths * (vx * vx + vy * vy + vz * vz):
        return False
    sx, sy, sz = px - ox, py - oy, pz - oz
    qx, qy, qz = cross(sx, sy, sz, ux, uy, uz)
    u = (sx * hx + sy * hy + sz * hz) / det
    v = (dx * qx + dy * qy + dz * qz) / det
    t = (vx * qx + vy * qy + vz * qz) / det
    least = min(min(u, v), min(1.0 - u - v, min(t, 1.0 - t)))
    return least > TOUCHING_SHARE


@kernel
def mark_crossings(corners, faces, low, high, crosses_out):
    """Mark the triangles (F, 3, 3) that cross others. low, high: corners (F, 3) of their boxes. All
    arrays are sorted by low[:, 0]."""
    count = faces.shape[0]
    for i in range(count):
        for j in range(i + 1, count):
            if low[j, 0] > high[i, 0]:
                break
            if low[j, 1] > high[i, 1] or low[i, 1] > high[j, 1]:
                continue
            if low[j, 2] > high[i, 2] or low[i, 2] > high[j, 2]:
                continue
            shared = 0
            for a in range(3):
                for b in range(3):
                    shared += faces[i, a] == faces[j, b]
            if shared > 0:
                continue
            for a in range(3):
                b = (a + 1) % 3
                if pierces(corners, i, a, b, j) or pierces(corners, j, a, b, i):
                    crosses_out[i], crosses_out[j] = True, True
                    break


def crossing_faces(vertices: Array, faces: Indices) -> Indices:
    """Indices of the faces that cross other faces with which they share no vertex."""
    axes = np.argsort(-np.ptp(vertices, axis=0))  # the longest axis first, for sorting
    corners = np.ascontiguousarray(vertices[faces][:, :, axes])
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    crosses = np.zeros(len(faces), dtype=np.bool_)
    mark_crossings(corners[order], faces[order], low[order], high[order], crosses)
    return np.sort(order[crosses])
