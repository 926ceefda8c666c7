"""Linear: one elevation a vertex, heads linear over each triangle, straight clip.

The closed form of a triangle (see `triangle`) is linear in its three heads. Summed over a
mesh, each vertex v therefore has a fixed weight in force and torque,

    A_v = sum over its triangles of S / 3
    B_v = sum over its triangles of (a + b + c + v) / 12 x S,

known in the body frame once and for all. A step is then: the heads of all
vertices, the sum of e_v (A_v, B_v) over the wet ones, and for each triangle that the
water cuts the part that the clip takes away. Only that last part looks at triangles.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sim.gerstner import kernel, solve_heights
from sim.hull import Hull
from sim.sea import Sea
from sim.triangle import clip_dry_part, cross

Array = NDArray[np.float64]


class Linear:
    """Wrench of a hull in a sea by the straight clip; the baseline of all methods.

    Exact to round-off where the surface is flat. In waves the surface is replaced by its
    linear interpolation over every triangle, so the error falls with the square of the
    triangles' size. Stateless: calls may come from several threads.
    """

    def __init__(self, hull: Hull, sea: Sea) -> None:
        self.hull = hull
        self.sea = sea
        self._surface = (
            hull.vertices,
            hull.faces,
            hull.area_vectors,
            hull.bounds,
            vertex_weights(hull),
            longest_edge(hull),
        )
        self._water = (sea.components, sea.residual_tolerance, sea.level, sea.amplitude)

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        """Force [N] and torque [N m] about the position, world axes: (6,).

        position: (3,) [m], the hull frame's origin in the world; rotation: (3, 3) or (9,),
        hull -> world; time [s].
        """
        out = np.empty(6)
        position = np.ascontiguousarray(position, dtype=float)
        rotation = np.ascontiguousarray(rotation, dtype=float).reshape(3, 3)
        self._sum(position, rotation, float(time), out)  # one layout, one set of kernels
        out *= -self.sea.density * self.sea.gravity
        return out

    def _sum(self, position: Array, rotation: Array, time: float, out: Array) -> None:
        """The wrench over - density gravity into out."""
        linear_wrench(*self._surface, *self._water, position, rotation, time, out)


def corner_shares(corners: Array, area_vectors: Array) -> Array:
    """(F, 3, 6): what each corner of triangles (F, 3, 3) adds to A_v [m^2] and B_v [m^3]."""
    arms = (corners.sum(axis=1, keepdims=True) + corners) / 12.0
    shares = np.empty((len(corners), 3, 6))
    shares[:, :, :3] = area_vectors[:, None] / 3.0
    shares[:, :, 3:] = np.cross(arms, area_vectors[:, None])
    return shares


def vertex_weights(hull: Hull) -> Array:
    """(V, 6): A_v and B_v of the module's docstring, body frame."""
    weights = np.zeros((len(hull.vertices), 6))
    shares = corner_shares(hull.vertices[hull.faces], hull.area_vectors)
    np.add.at(weights, hull.faces.ravel(), shares.reshape(-1, 6))
    return weights


def longest_edge(hull: Hull) -> float:
    corners = hull.vertices[hull.faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())


@njit(inline="always")
def placed(point, position, rotation):
    """World coordinates of a point given in the body frame."""
    r, a, b, c = rotation, point[0], point[1], point[2]
    return (
        position[0] + (r[0, 0] * a + r[0, 1] * b + r[0, 2] * c),
        position[1] + (r[1, 0] * a + r[1, 1] * b + r[1, 2] * c),
        position[2] + (r[2, 0] * a + r[2, 1] * b + r[2, 2] * c),
    )


@kernel
def heads_at_vertices(
    vertices, reach, components, tolerance, level, amplitude, position, rotation, time, heads
):
    """Heads (V,) [m] of the vertices and how many of them are wet.

    A vertex higher above the highest crest than an edge is long (reach [m]) touches no triangle
    that the water could: it gets the head below that crest and no elevation is solved.
    """
    count = vertices.shape[0]
    x, y, heights = np.empty(count), np.empty(count), np.empty(count)
    chosen = np.empty(count, np.int64)
    active = 0
    for v in range(count):
        x[active], y[active], z = placed(vertices[v], position, rotation)
        heads[v] = level + amplitude - z
        chosen[active] = v
        active += not heads[v] < -reach
    solve_heights(x[:active], y[:active], components, time, tolerance, heights[:active])
    wet = 0
    for i in range(active):
        v = chosen[i]
        heads[v] += heights[i] - amplitude
        wet += not heads[v] <= 0.0
    return wet


@njit(inline="always")
def odd_corner_first(face, heads):
    """Whether the water cuts a face, and its corners turned so that the odd one, the only wet
    or the only dry one, comes first."""
    a, b, c = face[0], face[1], face[2]
    wet_a, wet_b, wet_c = heads[a] > 0.0, heads[b] > 0.0, heads[c] > 0.0
    if wet_a == wet_c:
        a, b, c = b, c, a
    elif wet_a == wet_b:
        a, b, c = c, a, b
    return not (wet_a == wet_b and wet_b == wet_c), a, b, c


@kernel
def subtract_dry_parts(vertices, faces, area_vectors, heads, out):
    """Take from the sums over wet vertices, out (6,), what the clip removes from cut triangles."""
    for f in range(faces.shape[0]):
        is_cut, a, b, c = odd_corner_first(faces[f], heads)
        if not is_cut:
            continue
        va, vb, vc = vertices[a], vertices[b], vertices[c]
        share, mx, my, mz = clip_dry_part(
            va[0], va[1], va[2], vb[0], vb[1], vb[2], vc[0], vc[1], vc[2],
            heads[a], heads[b], heads[c],
        )  # fmt: skip
        sx, sy, sz = area_vectors[f, 0], area_vectors[f, 1], area_vectors[f, 2]
        tx, ty, tz = cross(mx, my, mz, sx, sy, sz)
        out[0] -= share * sx
        out[1] -= share * sy
        out[2] -= share * sz
        out[3] -= tx
        out[4] -= ty
        out[5] -= tz


@kernel
def sum_wet_body_frame(vertices, faces, area_vectors, weights, heads, wet, out):
    """Sum (6,) over - density gravity into out, body frame, from the heads of all vertices."""
    # A uniform head on a closed surface adds nothing. Deep under water taking it off
    # keeps the sum free of the round-off of large numbers that cancel.
    datum = heads[0] if wet == vertices.shape[0] else 0.0
    for v in range(vertices.shape[0]):
        head = heads[v] - datum if not heads[v] <= 0.0 else 0.0
        for j in range(6):
            out[j] += head * weights[v, j]
    if wet < vertices.shape[0]:
        subtract_dry_parts(vertices, faces, area_vectors, heads, out)


@kernel
def lowest_height(bounds, position, rotation):
    """Height [m] that no point of a box turned into the world lies below."""
    height = position[2]
    for j in range(3):
        height += min(rotation[2, j] * bounds[0, j], rotation[2, j] * bounds[1, j])
    return height


@kernel
def turned_into_world(rotation, body, out):
    """Turn force and torque (6,) from the body frame into world axes."""
    for i in range(3):
        out[i] = 0.0
        out[3 + i] = 0.0
        for j in range(3):
            out[i] += rotation[i, j] * body[j]
            out[3 + i] += rotation[i, j] * body[3 + j]


@kernel
def linear_wrench(
    vertices, faces, area_vectors, bounds, weights, longest_edge,
    components, tolerance, level, amplitude,
    position, rotation, time, out,
):  # fmt: skip
    """Wrench (6,) over - density gravity into out, world axes, torque about the position."""
    out[:] = 0.0
    if lowest_height(bounds, position, rotation) > level + amplitude:
        return
    heads = np.empty(vertices.shape[0])
    wet = heads_at_vertices(
        vertices, longest_edge, components, tolerance, level, amplitude, position, rotation, time,
        heads,
    )  # fmt: skip
    if wet == 0:
        return
    body = np.zeros(6)
    sum_wet_body_frame(vertices, faces, area_vectors, weights, heads, wet, body)
    turned_into_world(rotation, body, out)
