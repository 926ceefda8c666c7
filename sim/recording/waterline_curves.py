"""Waterline: where the sea's surface meets a hull's surface, as closed curves.

The sign of the head at a vertex says whether it is wet. Every edge with a wet and a dry end has a
point of the curve, which is solved on the surface of the waves. The curve goes from triangle to
triangle and closes because the hull is closed. It is straight between its points, so a hull of
large triangles is `display_mesh.refined` first.
"""

import numpy as np
from numpy.typing import NDArray

from sim.hulls.topology import edges_of
from sim.kernels import kernel
from sim.water.sea import Sea

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

WATERLINE_ERROR = 1e-5
"""Largest head [m] at a point of the waterline, far below the resolution of a picture."""

LEAST_OPENING = 0.4
"""Smallest value of 1 + cos of the angle between a surface's normal and the vertical for which a
drawn line lies outside. The line would be far from a surface that nearly lies on the water."""

MOST_BRACKET_STEPS = 60
"""Largest number of steps for a point. About 4 suffice; plain halving would take 17."""


def heads(sea: Sea, points: Array, time: float) -> Array:
    """Depths (N,) [m] of points (N, 3) [m], world axes, below the instantaneous surface.

    If no crest or trough can reach a point, it is the depth below the still level, which has the
    right sign and needs no solution.
    """
    depths = sea.level_at(time) - points[:, 2]
    near = np.flatnonzero(np.abs(depths) <= sea.amplitude)
    x, y, z = points[near].T
    depths[near] = sea.head(x, y, z, time)
    return depths


def faces_across(faces: Indices) -> Indices:
    """The neighbours (F, 3) of each face of closed surfaces across its edges ab, bc and ca."""
    both_sides = np.argsort(edges_of(faces).of_side).reshape(-1, 2)  # of each edge
    across = np.empty(3 * len(faces), np.int64)
    across[both_sides] = both_sides[:, ::-1] % len(faces)
    return np.ascontiguousarray(across.reshape(3, -1).T)


def waterlines(
    sea: Sea,
    time: float,
    vertices: Array,
    areas: Array,
    faces: Indices,
    across: Indices,
    depths: Array,
    radius: float = 0.0,
) -> list[Array]:
    """Closed curves (N, 3) [m] along which the sea cuts closed surfaces. The last point repeats the
    first, and the wet side lies to the right as seen from outside.

    vertices: (V, 3) [m], world axes. areas: (V, 3) [m^2], their outward area vectors. faces:
    (F, 3), of one or more closed, outward surfaces. across: (F, 3), their `faces_across`. depths:
    (V,) [m], of the vertices, by `heads`. radius [m]: of the drawn line. Its middle is this far
    outside the surface and above the sea, so that neither hides it. With radius 0, a point lies on
    an edge to round-off and on the sea's surface to WATERLINE_ERROR.
    """
    dry, wet, ends = _traced(faces, across, depths > 0.0)
    points = _crossings(sea, time, vertices[dry], vertices[wet], depths[dry], depths[wet])
    if radius > 0.0:
        points = points + radius * _beside(areas[dry] + areas[wet])
    starts = [0, *ends.tolist()]
    return [
        np.concatenate([points[start:end], points[start : start + 1]])
        for start, end in zip(starts, ends.tolist(), strict=False)
    ]


def _beside(outward: Array) -> Array:
    """Vectors (N, 3) to points that are 1 outside a surface with outward normals of any length
    (N, 3), and 1 above level water. They are not longer than 2 over LEAST_OPENING."""
    normals = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    opening = np.maximum(1.0 + normals[:, 2:], LEAST_OPENING)
    return (normals + [0.0, 0.0, 1.0]) / opening


@kernel
def _traced(faces: Indices, across: Indices, wet: Flags) -> tuple[Indices, Indices, Indices]:
    """The dry and the wet end (N,) of every edge that the curves cross, in order, and the index of
    the end of each curve.

    A curve enters a triangle at the edge from a dry to a wet vertex, and leaves it at the edge from
    a wet to a dry vertex. The next triangle runs along that edge in the opposite direction.
    """
    dry_ends, wet_ends = np.empty(len(faces), np.int64), np.empty(len(faces), np.int64)
    ends = np.empty(len(faces), np.int64)
    seen = np.zeros(len(faces), np.bool_)
    count = curves = 0
    for first in range(len(faces)):
        a, b, c = wet[faces[first, 0]], wet[faces[first, 1]], wet[faces[first, 2]]
        if seen[first] or (a == b and b == c):
            continue
        face = following = first
        while not seen[face]:
            seen[face] = True
            for edge in range(3):
                here, there = faces[face, edge], faces[face, (edge + 1) % 3]
                if wet[there] and not wet[here]:
                    dry_ends[count], wet_ends[count] = here, there
                elif wet[here] and not wet[there]:
                    following = across[face, edge]
            count += 1
            face = following
        ends[curves] = count
        curves += 1
    return dry_ends[:count], wet_ends[:count], ends[:curves]


def _crossings(
    sea: Sea, time: float, dry: Array, wet: Array, dry_depths: Array, wet_depths: Array
) -> Array:
    """A point (N, 3) of the sea's surface between each dry and wet point, by bracketed secants with
    the Illinois rule (Dowell and Jarratt 1971), which halves the value of an end that stays."""
    low, high = np.zeros(len(dry)), np.ones(len(dry))
    below, above = dry_depths.copy(), wet_depths.copy()
    side = np.zeros(len(dry))
    for _ in range(MOST_BRACKET_STEPS):
        fraction = (low * above - high * below) / (above - below)
        points = dry + fraction[:, None] * (wet - dry)
        depths = sea.head(*points.T, time)
        if (np.abs(depths) < WATERLINE_ERROR).all():
            break
        now = np.where(depths > 0.0, 1.0, -1.0)
        below = np.where(now < 0.0, depths, np.where(side == now, 0.5 * below, below))
        above = np.where(now > 0.0, depths, np.where(side == now, 0.5 * above, above))
        low, high = np.where(now < 0.0, fraction, low), np.where(now > 0.0, fraction, high)
        side = now
    return points
