"""Union: the union of hulls, a hull without others, and open boats closed by a deck."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import middle
from sim.hulls.hull import Hull
from sim.hulls.solids import (
    TOUCHING_SHARE,
    Surface,
    common_volume,
    solid_of,
    surface_of,
    union_of,
)
from sim.hulls.topology import joined

Array = NDArray[np.float64]

GUNWALE_LEVELS = 64
"""Number of levels at which `_gunwale` cuts a hull. More levels find shallower open boats."""

WALL_OVERLAP_SHARE = 1e-5
"""Share of its size by which the inside of a boat is enlarged to overlap with the walls."""

VERTEX_SHARE = 1e-6
"""Share of a hull's height: a gunwale that is closer than this to a vertex is moved to it."""


def united(hulls: Sequence[Hull], at_least: float = TOUCHING_SHARE) -> tuple[Hull, float] | None:
    """The union of hulls in one frame, and the volume [m^3] that they count twice when they are
    separate; None if this is at most a share `at_least` of their volume. Raises ValueError if they
    cannot be united."""
    union = union_of([_surface(hull) for hull in hulls], at_least)
    return None if union is None else (Hull(*union[0]), union[1])


def without(hull: Hull, others: Sequence[Hull]) -> Hull | None:
    """A hull without what it shares with others, in one frame; None if nothing is left. It is the
    same object if it shares at most TOUCHING_SHARE of its volume. Pieces that are not larger than
    this are dropped. Raises ValueError if it cannot be cut, or if the rest is not a hull, for
    example with a cavity where another hull lies inside."""
    import manifold3d

    solids = [solid_of(_surface(each)) for each in (hull, *others)]
    rest = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Subtract)
    least = TOUCHING_SHARE * hull.volume
    if rest.volume() >= hull.volume - least:
        return hull
    pieces = [surface_of(piece) for piece in rest.decompose() if abs(piece.volume()) > least]
    if not pieces:
        return None
    left = Hull(*joined(pieces))
    if abs(left.volume - rest.volume()) > least * len(solids):
        raise ValueError("another hull lies inside it, and a hull has no cavities")
    return left


def convex_hull(points: ArrayLike) -> Hull:
    """The convex hull of points (N, 3) [m]. Raises ValueError if they lie in a plane."""
    import manifold3d

    return Hull(*surface_of(manifold3d.Manifold.hull_points(np.array(points, dtype=float))))


def shared_volume(one: Hull, other: Hull) -> float:
    """Volume [m^3] that lies in both hulls, in one frame."""
    return common_volume(_surface(one), _surface(other))


def _surface(hull: Hull) -> Surface:
    return hull.vertices, hull.faces


def decked(hull: Hull) -> tuple[Hull, float] | None:
    """The hull of an open boat, closed by a level deck at its lowest gunwale, and the volume [m^3]
    of water that it holds without the deck; None if it holds none. z is up.

    A level section below the gunwale is a ring. A prism over the ring's hole minus the hull
    consists of the boat's inside, which reaches up to the deck, and of pieces below the hull.
    """
    import manifold3d

    solid, (low, high) = solid_of(_surface(hull)), hull.bounds
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
    closed = Hull(*surface_of(whole))
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
