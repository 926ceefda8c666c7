"""Linear: one elevation per vertex, heads linear over each triangle, straight clip.

The closed form of a triangle (see `triangle`) is linear in its three heads. Summed over a mesh,
each vertex v therefore has fixed weights in force and torque,

    A_v = sum over its triangles of S / 3
    B_v = sum over its triangles of (a + b + c + v) / 12 x S,

computed once in the body frame. A step computes the heads e_v of all vertices and the sum of e_v
(A_v, B_v) over the wet ones. For each triangle that the water cuts, it subtracts the section that
the clip removes. Only this last step looks at triangles.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from sim.geometry import cross, placed, sides
from sim.hulls.hull import Hull
from sim.hulls.triangle import clip_dry_part
from sim.kernels import inline, kernel, packed, read_only, record, scratch, table
from sim.methods.method import Compiled, Kernel, Part, Table
from sim.water.gerstner import WATER, WAVE, level_and_rise
from sim.water.head import solve_heads
from sim.water.sea import Sea

Array = NDArray[np.float64]

VERTEX = record(x="f8", y="f8", z="f8", weights=("f8", 6))
"""A vertex in the body frame [m], with A_v [m^2] and B_v [m^3] of the module's docstring."""

FACE = record(a="i4", b="i4", c="i4", area_x="f8", area_y="f8", area_z="f8")
"""A triangle's corners and its area vector [m^2]."""

SHAPE = record(low=("f8", 3), high=("f8", 3), reach="f8", samples="i8", crests_only="i8")
"""The hull's bounds and its longest edge [m], and the settings of `chord`."""


class Surface(NamedTuple):
    """The tables of a hull in a block."""

    vertices: NDArray[np.void]
    faces: NDArray[np.void]
    shape: NDArray[np.void]


class Linear(Compiled):
    """Wrench of a hull in a sea by the straight clip. All other methods are compared with it.

    It is exact to round-off where the surface is flat. In waves, the surface over each triangle is
    replaced by its linear interpolation, so the error falls with the square of the triangles' size.
    """

    def __init__(self, hull: Hull, sea: Sea) -> None:
        super().__init__(hull, sea)
        self._surface = surface_tables(hull)
        self._prepare()

    @classmethod
    def parts(cls, methods: Sequence[Self], places: Table) -> list[Part]:
        """One part for each method, with the places of all hulls that have it."""
        return [
            Part(
                method._kernel(),
                packed(*method._surface, method.sea.components, method.sea.water),
                read_only(places[[other is method for other in methods]]),
            )
            for method in dict.fromkeys(methods)
        ]

    def _kernel(self) -> Kernel:
        return linear_wrenches


def corner_shares(corners: Array, area_vectors: Array) -> Array:
    """Contributions (F, 3, 6) of the corners of triangles (F, 3, 3) to A_v [m^2] and B_v [m^3]."""
    arms = (corners.sum(axis=1, keepdims=True) + corners) / 12.0
    shares = np.empty((len(corners), 3, 6))
    shares[:, :, :3] = area_vectors[:, None] / 3.0
    shares[:, :, 3:] = np.cross(arms, area_vectors[:, None])
    return shares


def surface_tables(hull: Hull) -> Surface:
    """A hull's vertices, faces and shape."""
    corners = hull.vertices[hull.faces]
    vertices = np.zeros(len(hull.vertices), VERTEX)
    vertices["x"], vertices["y"], vertices["z"] = hull.vertices.T
    shares = corner_shares(corners, hull.area_vectors)
    np.add.at(vertices["weights"], hull.faces.ravel(), shares.reshape(-1, 6))
    faces = np.zeros(len(hull.faces), FACE)
    faces["a"], faces["b"], faces["c"] = hull.faces.T
    faces["area_x"], faces["area_y"], faces["area_z"] = hull.area_vectors.T
    shape = np.zeros(1, SHAPE)
    shape["low"], shape["high"] = hull.bounds
    shape["reach"] = sides(corners).max()
    return Surface(vertices, faces, shape)


@inline
def unpacked(block):
    """The Surface, the waves and the water in a block."""
    surface = Surface(table(block, 0, VERTEX), table(block, 1, FACE), table(block, 2, SHAPE))
    return surface, table(block, 3, WAVE), table(block, 4, WATER)


@inline
def is_above(crest, shape, position, rotation):
    """Whether the hull's box, rotated into the world, is all above the height [m] of a crest."""
    height = position[2]
    for j in range(3):
        height += min(rotation[6 + j] * shape[0].low[j], rotation[6 + j] * shape[0].high[j])
    return height > crest


@kernel
def heads_at_vertices(surface, waves, water, position, rotation, time, heads_out):
    """Heads (V,) [m] of the vertices. Return the number of wet vertices.

    A hull above the highest crest gives 0 at once. A vertex higher above the highest crest than the
    longest edge belongs to no triangle that the water can touch. It gets its head below that crest,
    without a solve.
    """
    level, _ = level_and_rise(water[0], time)
    count, crest = surface.vertices.size, level + water[0].amplitude
    if is_above(crest, surface.shape, position, rotation):
        return 0
    reach = surface.shape[0].reach
    x, y, z, heads = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    chosen = np.empty(count, np.int64)
    active = 0
    for v in range(count):
        vertex = surface.vertices[v]
        x[active], y[active], z[active] = placed(vertex.x, vertex.y, vertex.z, position, rotation)
        heads_out[v] = crest - z[active]
        chosen[active] = v
        active += not heads_out[v] < -reach
    solve_heads(x[:active], y[:active], z[:active], waves, water, time, heads[:active])
    wet = 0
    for i in range(active):
        heads_out[chosen[i]] = heads[i]
        wet += not heads[i] <= 0.0
    return wet


@inline
def odd_corner_first(face, heads):
    """Whether the water cuts a face, and the face's corners in an order in which the only wet or
    the only dry corner comes first."""
    a, b, c = face.a, face.b, face.c
    wet_a, wet_b, wet_c = heads[a] > 0.0, heads[b] > 0.0, heads[c] > 0.0
    if wet_a == wet_c:
        a, b, c = b, c, a
    elif wet_a == wet_b:
        a, b, c = c, a, b
    return not (wet_a == wet_b and wet_b == wet_c), a, b, c


@kernel
def subtract_dry_parts(surface, heads, sums_out):
    """Subtract from the sums (6,) over wet vertices the sections that the clip removes from cut
    triangles."""
    for f in range(surface.faces.size):
        face = surface.faces[f]
        is_cut, a, b, c = odd_corner_first(face, heads)
        if not is_cut:
            continue
        p, q, r = surface.vertices[a], surface.vertices[b], surface.vertices[c]
        share, mx, my, mz = clip_dry_part(
            p.x, p.y, p.z, q.x, q.y, q.z, r.x, r.y, r.z, heads[a], heads[b], heads[c]
        )
        tx, ty, tz = cross(mx, my, mz, face.area_x, face.area_y, face.area_z)
        sums_out[0] -= share * face.area_x
        sums_out[1] -= share * face.area_y
        sums_out[2] -= share * face.area_z
        sums_out[3] -= tx
        sums_out[4] -= ty
        sums_out[5] -= tz


@kernel
def add_wet_vertices(vertices, heads, datum, sums_out):
    """Add the sum over the wet vertices to the sums (6,). datum [m]: a head that is subtracted."""
    for v in range(heads.size):
        head = heads[v] - datum if not heads[v] <= 0.0 else 0.0
        weights = vertices[v].weights
        for j in range(6):
            sums_out[j] += head * weights[j]


@kernel
def wet_sums(surface, heads, wet, sums_out):
    """Sums (6,) of the wet surface over - density gravity, body frame, from the heads of all
    vertices."""
    # A uniform head on a closed surface adds nothing. Subtracting it keeps large numbers that
    # cancel, and their round-off, out of the sum of a deeply submerged hull.
    datum = heads[0] if wet == heads.size else 0.0
    sums_out[:] = 0.0
    add_wet_vertices(surface.vertices, heads, datum, sums_out)
    if wet < heads.size:
        subtract_dry_parts(surface, heads, sums_out)


@inline
def write_turned(sums, rotation, scale, wrench_out):
    """Rotate sums (6,) from the body frame to world axes by a rotation (9,), and write them, times
    a scale, as a wrench (6,)."""
    for i in range(3):
        force, torque = 0.0, 0.0
        for j in range(3):
            force += rotation[3 * i + j] * sums[j]
            torque += rotation[3 * i + j] * sums[3 + j]
        wrench_out[i], wrench_out[3 + i] = scale * force, scale * torque


@kernel
def linear_wrenches(block, places, positions, rotations, time, wrenches_out):
    """See `Compiled`."""
    surface, waves, water = unpacked(block)
    heads, sums = np.empty(surface.vertices.size), scratch(6)
    for i in range(places.size):
        position, rotation = positions[places[i].pose], rotations[places[i].pose]
        wrench = wrenches_out[places[i].row]
        wrench[:] = 0.0
        wet = heads_at_vertices(surface, waves, water, position, rotation, time, heads)
        if wet > 0:
            wet_sums(surface, heads, wet, sums)
            write_turned(sums, rotation, water[0].scale, wrench)
