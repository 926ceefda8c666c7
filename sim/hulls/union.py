"""Union: closed surfaces that overlap as one, so that no water is displaced twice.

By the library manifold3d, in double precision. What does not overlap is left as it is, to the bit.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import cone_volumes
from sim.hulls.hull import Hull, closed_parts

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

COUNTED_TWICE = 1e-6
"""Part of the volume below which surfaces touch and do not overlap."""

LEVELS = 64
"""Heights, from the top, at which an open boat's inside is looked for."""

INTO_WALLS = 1e-5
"""Part of its size by which an inside reaches into the walls around it."""

SAME_HEIGHT = 1e-6
"""Of a hull's height: a gunwale this close to a vertex is there."""


def overlapping(bounds: Array) -> list[list[int]]:
    """Groups of boxes (N, 2, 3) that hang together by overlaps, in the order of their first."""
    low, high = bounds[:, 0], bounds[:, 1]
    meets = (low[:, None] < high[None]).all(axis=2) & (low[None] < high[:, None]).all(axis=2)
    group = np.arange(len(bounds))
    for _ in range(len(bounds)):
        lowest = np.where(meets, group[None], len(bounds)).min(axis=1, initial=len(bounds))
        if (lowest >= group).all():
            break
        group = np.minimum(group, lowest)
    return [np.flatnonzero(group == g).tolist() for g in np.unique(group)]


def united(hulls: Sequence[Hull], at_least: float = COUNTED_TWICE) -> tuple[Hull, float] | None:
    """Hulls, in one frame, as one, and the volume [m^3] that they count twice by themselves; None
    where that is not even this part of theirs. Raises ValueError where manifold3d cannot."""
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


def shared_volume(one: Hull, other: Hull) -> float:
    """Volume [m^3] that lies in both, in one frame."""
    return float((_solid(one) ^ _solid(other)).volume())


def decked(hull: Hull) -> tuple[Hull, float] | None:
    """An open boat's hull with what it would hold of water up to its lowest gunwale, closed by a
    level deck there, and that volume [m^3]; None where it holds none. z is up.

    A section below the gunwale is a ring; a prism over its inside, less the hull itself, falls into
    the inside, which reaches up to the deck, and what lies below the hull's outside.
    """
    import manifold3d

    solid, (low, high) = _solid(hull), hull.bounds
    level = _gunwale(solid, float(low[2]), float(high[2]))
    if level is None:
        return None
    close = SAME_HEIGHT * (high[2] - low[2])
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
    """A solid made larger by INTO_WALLS about its middle, so that it does not only touch."""
    box = np.reshape(solid.bounding_box(), (2, 3))
    middle = 0.5 * (box[0] + box[1])
    grown = solid.translate(-middle).scale([1.0 + INTO_WALLS] * 3)
    return grown.translate(middle)


def _gunwale(solid: Any, low: float, high: float) -> float | None:
    """The greatest height [m] below which a level section has an inside; None where none has."""

    def is_ring(level: float) -> bool:
        return any(map(_is_hole, solid.slice(level).to_polygons()))

    levels = np.linspace(high, low, LEVELS + 2)[1:-1]
    below = next((level for level in levels if is_ring(level)), None)
    if below is None:
        return None
    above = below + (high - low) / (LEVELS + 1)
    for _ in range(30):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if is_ring(middle) else (below, middle)
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
        vert_properties=hull.vertices.copy(),  # it refuses what is read-only
        tri_verts=hull.faces.astype(np.uint64),
    )
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        raise ValueError(f"manifold3d cannot take the surface: {solid.status().name}")
    return solid


def outer_surface(vertices: ArrayLike, faces: ArrayLike) -> tuple[Hull, float, int]:
    """The Hull of a surface of several closed shells, as the water sees it: shells that overlap or
    lie in one another count once, and a shell that faces inward within another is a cavity that
    stays dry, so it displaces what is around it.

    Returns the hull, the volume [m^3] that the shells counted twice, and the number of cavities.
    Raises ValueError as Hull does.
    """
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces)
    parts = closed_parts(vertices, faces)
    if len(parts) < 2:
        return Hull(vertices, faces), 0.0, 0
    volumes = [signed_volume(vertices, part) for part in parts]
    outward = [part for part, volume in zip(parts, volumes, strict=True) if volume > 0.0]
    if not outward:
        return Hull(vertices, faces), 0.0, 0
    hulls = [Hull(vertices, part) for part in outward]
    for part, volume in zip(parts, volumes, strict=True):
        if volume <= 0.0 and not _is_cavity(vertices, part, hulls):
            return Hull(vertices, faces), 0.0, 0  # which says what is wrong
    cavities = len(parts) - len(outward)
    twice, whole = 0.0, []
    for group in overlapping(np.array([hull.bounds for hull in hulls])):
        try:
            found = united([hulls[i] for i in group])
        except ValueError:
            return Hull(vertices, faces), 0.0, 0  # as it is, or what is wrong with it
        whole += [found[0]] if found else [hulls[i] for i in group]
        twice += found[1] if found else 0.0
    if not twice:
        return Hull(vertices, np.concatenate(outward)), 0.0, cavities
    first = np.cumsum([0] + [len(hull.vertices) for hull in whole])
    joined = np.concatenate([hull.faces + n for hull, n in zip(whole, first, strict=False)])
    return Hull(np.concatenate([hull.vertices for hull in whole]), joined), twice, cavities


def signed_volume(vertices: Array, faces: Indices) -> float:
    """Volume [m^3] of a closed shell, below 0 where it faces inward."""
    corners = vertices[faces]
    return float(cone_volumes(corners - corners.reshape(-1, 3).mean(axis=0)).sum())


def _is_cavity(vertices: Array, part: Indices, outward: Sequence[Hull]) -> bool:
    """Whether a shell that faces inward lies wholly in one that faces outward."""
    shell = Hull(vertices, part[:, ::-1])
    return any(
        (hull.bounds[0] <= shell.bounds[0]).all() and (shell.bounds[1] <= hull.bounds[1]).all()
        and shared_volume(shell, hull) >= (1.0 - COUNTED_TWICE) * shell.volume
        for hull in outward
    )  # fmt: skip
