"""Union: unites or cuts overlapping closed surfaces, so that no water is displaced twice.

The library manifold3d computes it in double precision. Surfaces that do not overlap stay the same
to the bit.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import cone_volumes, distinct_points, middle, spread_lowest
from sim.hulls.hull import Hull
from sim.hulls.topology import joined, shells_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TOUCHING_SHARE = 1e-6
"""Share of their volume: surfaces that share no more than this touch, and do not overlap."""

GUNWALE_LEVELS = 64
"""Number of levels at which `_gunwale` cuts a hull. More levels find shallower open boats."""

WALL_OVERLAP_SHARE = 1e-5
"""Share of its size by which the inside of a boat is enlarged to overlap with the walls."""

VERTEX_SHARE = 1e-6
"""Share of a hull's height: a gunwale that is closer than this to a vertex is moved to it."""


def overlapping(bounds: Array) -> list[list[int]]:
    """Groups of boxes (N, 2, 3) connected by overlaps, in the order of their first members."""
    low, high = bounds[:, 0], bounds[:, 1]
    meets = (low[:, None] < high[None]).all(axis=2) & (low[None] < high[:, None]).all(axis=2)
    group = np.arange(len(bounds))
    spread_lowest(np.ascontiguousarray(np.argwhere(meets)), group)
    return [np.flatnonzero(group == g).tolist() for g in np.unique(group)]


def united(hulls: Sequence[Hull], at_least: float = TOUCHING_SHARE) -> tuple[Hull, float] | None:
    """The union of hulls in one frame, and the volume [m^3] that they count twice when they are
    separate; None if this is at most a share `at_least` of their volume. Raises ValueError if
    manifold3d cannot unite them."""
    import manifold3d

    if len(hulls) < 2:
        return None
    solids = [_solid(hull) for hull in hulls]
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    total = sum(hull.volume for hull in hulls)
    twice = total - whole.volume()
    if twice <= at_least * total:
        return None
    return Hull(*_arrays(whole)), float(twice)


def without(hull: Hull, others: Sequence[Hull]) -> Hull | None:
    """A hull without what it shares with others, in one frame; None if nothing is left. It is the
    same object if it shares at most TOUCHING_SHARE of its volume. Pieces that are not larger than
    this are dropped. Raises ValueError if manifold3d cannot cut it, or if the rest is not a hull,
    for example with a cavity where another hull lies inside."""
    import manifold3d

    solids = [_solid(each) for each in (hull, *others)]
    rest = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Subtract)
    least = TOUCHING_SHARE * hull.volume
    if rest.volume() >= hull.volume - least:
        return hull
    pieces = [_arrays(piece) for piece in rest.decompose() if abs(piece.volume()) > least]
    return Hull(*joined(pieces)) if pieces else None


def convex_hull(points: ArrayLike) -> Hull:
    """The convex hull of points (N, 3) [m]. Raises ValueError if they lie in a plane."""
    import manifold3d

    return Hull(*_arrays(manifold3d.Manifold.hull_points(np.array(points, dtype=float))))


def shared_volume(one: Hull, other: Hull) -> float:
    """Volume [m^3] that lies in both hulls, in one frame."""
    return float((_solid(one) ^ _solid(other)).volume())


def decked(hull: Hull) -> tuple[Hull, float] | None:
    """The hull of an open boat, closed by a level deck at its lowest gunwale, and the volume [m^3]
    of water that it holds without the deck; None if it holds none. z is up.

    A level section below the gunwale is a ring. A prism over the ring's hole minus the hull
    consists of the boat's inside, which reaches up to the deck, and of pieces below the hull.
    """
    import manifold3d

    solid, (low, high) = _solid(hull), hull.bounds
    level = _gunwale(solid, float(low[2]), float(high[2]))
    if level is None:
        return None
    close = VERTEX_SHARE * (high[2] - low[2])
    heights = hull.vertices[:, 2]
    nearest = float(heights[np.argmin(np.abs(heights - level))])
    deck = nearest if abs(nearest - level) < close else level
    holes = [p[::-1] for p in solid.slice(level - close).to_polygons() if _is_hole(p)]
    prism = manifold3d.CrossSection(holes).extrude(deck - low[2] + 1.0)
    pieces = (prism.translate([0.0, 0.0, low[2] - 1.0]) - solid).decompose()
    inside = [piece for piece in pieces if piece.bounding_box()[5] > deck - 0.5 * close]
    wide = [_widened(piece).trim_by_plane((0.0, 0.0, -1.0), -deck) for piece in inside]
    whole = manifold3d.Manifold.batch_boolean([solid, *wide], manifold3d.OpType.Add)
    closed, *_ = outer_surface(*_arrays(whole))
    return closed, closed.volume - hull.volume


def _widened(solid: Any) -> Any:
    """A solid enlarged about its middle by WALL_OVERLAP_SHARE."""
    centre = middle(np.reshape(solid.bounding_box(), (2, 3)))
    return solid.translate(-centre).scale([1.0 + WALL_OVERLAP_SHARE] * 3).translate(centre)


def _gunwale(solid: Any, low: float, high: float) -> float | None:
    """The greatest height [m] at which a level section is a ring; None if there is none."""

    def is_ring(level: float) -> bool:
        return any(map(_is_hole, solid.slice(level).to_polygons()))

    levels = np.linspace(high, low, GUNWALE_LEVELS + 2)[1:-1]
    below = next((level for level in levels if is_ring(level)), None)
    if below is None:
        return None
    above = below + (high - low) / (GUNWALE_LEVELS + 1)
    for _ in range(30):
        between = 0.5 * (below + above)
        below, above = (between, above) if is_ring(between) else (below, between)
    return float(below)


def _is_hole(polygon: Array) -> bool:
    """Whether a loop (N, 2) runs clockwise."""
    x, y = np.asarray(polygon).T
    return bool(x @ np.roll(y, -1) < y @ np.roll(x, -1))


def _arrays(solid: Any) -> tuple[Array, Indices]:
    """Vertices and faces of a manifold3d solid."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)


def _solid(hull: Hull) -> Any:
    import manifold3d

    mesh = manifold3d.Mesh64(
        vert_properties=hull.vertices.copy(),  # manifold3d refuses read-only arrays
        tri_verts=hull.faces.astype(np.uint64),
    )
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        raise ValueError(f"manifold3d cannot take the surface: {solid.status().name}")
    return solid


def outer_surface(vertices: ArrayLike, faces: ArrayLike) -> tuple[Hull, float, int]:
    """The outer Hull of a surface of several closed shells. The volume of shells that overlap or
    lie in one another counts once. A shell that faces inward within another is a cavity that stays
    dry, so it displaces water too.

    Returns the hull, the volume [m^3] that the shells count twice, and the number of cavities.
    Raises ValueError as Hull does.
    """
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces)
    label = shells_of(distinct_points(vertices)[1][faces])
    shells = [faces[label == n] for n in np.unique(label)]
    if len(shells) < 2:
        return Hull(vertices, faces), 0.0, 0
    outward, inward = [], []
    for shell in shells:
        (outward if signed_volume(vertices, shell) > 0.0 else inward).append(shell)
    hulls = [Hull(vertices, shell) for shell in outward]
    if not hulls or not all(_is_cavity(vertices, shell, hulls) for shell in inward):
        return Hull(vertices, faces), 0.0, 0  # raises the fault
    twice, whole = 0.0, []
    for group in overlapping(np.array([hull.bounds for hull in hulls])):
        try:
            union = united([hulls[i] for i in group])
        except ValueError:
            return Hull(vertices, faces), 0.0, 0  # without a union, or raises the fault
        whole += [union[0]] if union else [hulls[i] for i in group]
        twice += union[1] if union else 0.0
    if not twice:
        return Hull(vertices, np.concatenate(outward)), 0.0, len(inward)
    return Hull(*joined([(hull.vertices, hull.faces) for hull in whole])), twice, len(inward)


def signed_volume(vertices: Array, faces: Indices) -> float:
    """Volume [m^3] of a closed shell; negative if it faces inward."""
    corners = vertices[faces]
    return float(cone_volumes(corners - corners.reshape(-1, 3).mean(axis=0)).sum())


def _is_cavity(vertices: Array, faces: Indices, outward: Sequence[Hull]) -> bool:
    """Whether a shell that faces inward lies wholly in a hull."""
    shell = Hull(vertices, faces[:, ::-1])
    return any(
        (hull.bounds[0] <= shell.bounds[0]).all() and (shell.bounds[1] <= hull.bounds[1]).all()
        and shared_volume(shell, hull) >= (1.0 - TOUCHING_SHARE) * shell.volume
        for hull in outward
    )  # fmt: skip
