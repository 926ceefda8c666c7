"""Patch sizes: how finely a hull is cut for a sea.

Patches and triangles small enough for a tolerance [m of water height] may be as many as one likes:
next to a crest that is about to fold no cubic holds. So a tolerance that is asked for is kept, or
refused before anything is cut; the default one is kept where it takes no more than MOST_PATCHES and
MOST_TRIANGLES, and else is what so many reach.

How many there will be is estimated from the hull's area and length. Of random hulls, flat and
slender ones too, a quarter to five quarters of the estimates are counted.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import sides
from sim.hulls.hull import Hull
from sim.methods.patches.fit import edge_tolerance, jet_radius, jet_waves, longest_edge
from sim.methods.patches.tree import MAX_TRIANGLES, PatchTree, build_tree, enclosing_ball
from sim.water.sea import Sea

Array = NDArray[np.float64]

OF_LENGTH, OF_DEPTH = 1.0 / 400.0, 1.0 / 30.0
"""The default tolerance, over the longest side of the hull and over its volume by the largest area
that it shows along an axis, whichever is less. A head that was off by it everywhere would change
the force by OF_DEPTH of the displaced water's weight; errors within a patch and of several cancel,
so 1e-3 of it is left at most (`speed_vs_error.py --random`)."""

FEW, OF_DEPTH_FEW = 30, 1.0 / 100.0
"""Of fewer patches, as estimated, errors do not cancel: they keep to so much of the depth, which
costs little."""

MANY, LARGER = 200, 1.4
"""Where there would be more patches, as estimated, errors cancel so well that each may be LARGER,
which keeps four times the tolerance, as long as so many are left: random cases are then no further
off than others."""

STRAIGHT = 0.5
"""Of the tolerance is what heads that are linear over a triangle may miss: under a crest all miss
in the same direction. A plate that lies in the surface was off by 1.1e-3 with all of it, by 1.5e-4
with half, which costs nothing."""

FILLING = 0.5
"""Longest edge of a triangle in radii of a patch, where MOST_TRIANGLES allow: of longer ones no
patch can be made that fills its ball (a ship of 860 patches has 750 so), shorter ones make more of
the waterline's leaves."""

MOST_PATCHES, MOST_TRIANGLES = 4_000, 40_000
"""Of a hull at the default tolerance; triangles besides twice its own. It is then cut within a
second, and a wrench in one wave takes a quarter of a millisecond."""

MOST_PATCHES_ASKED = 100_000
"""Of a hull at a tolerance that is asked for, which takes some twenty seconds."""

SPREAD, HALVES = 2.6, 8.0
"""Patches of a radius r [m], each as large as a disc of that radius, that cover its area, and
triangles that cover the square of their longest edge. (Three discs of four lie across two sides of
a box or are smaller.)"""


class Sizes(NamedTuple):
    """Of a cut: largest radius of a patch and longest edge of a triangle, and the tolerance that
    they keep, all in metres; whether that is as much as so many can, and less than was wished."""

    radius: float
    edge: float
    tolerance: float
    is_coarse: bool = False


def default_tolerance(hull: Hull) -> float:
    """The tolerance [m] that a hull has where none is asked for, if it can be kept; of FEW patches
    less."""
    return min(OF_LENGTH * hull.length, OF_DEPTH * _depth(hull))


def cut(hull: Hull, sea: Sea, tolerance: float | None) -> tuple[Sizes, PatchTree]:
    """A hull cut for a sea to a tolerance [m], or, with None, to the default one or what can be
    kept of it. Raises ValueError for one that asks for too many patches or triangles."""
    if tolerance is not None:
        sizes = _asked(hull, sea, tolerance)
        return sizes, build_tree(hull, sizes.radius, sizes.edge)
    most = int(0.9 * MOST_PATCHES)  # as estimated
    while True:
        sizes = _default(hull, sea, most)
        tree = build_tree(hull, sizes.radius, sizes.edge)
        if len(tree.patches) <= MOST_PATCHES or sizes.radius == np.inf:
            return sizes, tree
        most = int(0.9 * most * MOST_PATCHES / len(tree.patches))


def _asked(hull: Hull, sea: Sea, tolerance: float) -> Sizes:
    """Of a tolerance that is asked for; refused by estimate, where cutting would take its time."""
    least = _radius_of(hull, MOST_PATCHES_ASKED)
    radius, kept = jet_radius(sea, tolerance, _reach(hull), least)
    edge = longest_edge(sea, jet_waves(sea, radius), STRAIGHT * tolerance)
    edge = min(edge, max(FILLING * radius, _shortest_edge(hull)))
    found = ""
    if kept > tolerance:
        found = f"patches below {least:.3g} m, more than {MOST_PATCHES_ASKED}"
    elif _triangles(*_faces(hull), edge) > 2.0 * MAX_TRIANGLES:  # nearer ones are counted
        found = f"triangles with edges below {edge:.3g} m, more than {MAX_TRIANGLES}"
    if found:
        raise ValueError(
            f"the tolerance asks for {found} on this hull; ask for a larger tolerance or a calmer "
            "sea"
        )
    return Sizes(radius, edge, tolerance)


def _default(hull: Hull, sea: Sea, most: int) -> Sizes:
    """Of the default tolerance, or of so many patches and no more triangles than may be, and the
    tolerance that they keep."""
    radius, tolerance, is_coarse = _default_radius(hull, sea, most)
    waves = jet_waves(sea, radius)
    edge = longest_edge(sea, waves, STRAIGHT * tolerance)
    shortest = _shortest_edge(hull)
    if edge < shortest:
        edge, kept = shortest, edge_tolerance(sea, waves, shortest)
        is_coarse, tolerance = is_coarse or kept > tolerance, max(tolerance, kept)
    return Sizes(radius, min(edge, max(FILLING * radius, shortest)), tolerance, is_coarse)


def _default_radius(hull: Hull, sea: Sea, most: int) -> tuple[float, float, bool]:
    """Radius of patches [m], the tolerance [m] that they keep, and whether that is less than was
    wished."""
    wished, reach, least = default_tolerance(hull), _reach(hull), _radius_of(hull, most)
    radius, kept = jet_radius(sea, wished, reach, least)
    if kept > wished:
        return radius, kept, True
    if _radius_of(hull, FEW) < radius < np.inf:
        wished = min(wished, OF_DEPTH_FEW * _depth(hull))
        radius, kept = jet_radius(sea, wished, reach, least)
    elif radius < _radius_of(hull, MANY):
        largest, loose = min(LARGER * radius, _radius_of(hull, MANY)), LARGER**4 * wished
        larger, less = jet_radius(sea, loose, largest, radius)
        radius, kept = (larger, less) if less <= loose else (radius, kept)
    return radius, max(wished, kept), False


def _reach(hull: Hull) -> float:
    """Radius [m] of a patch that is all of the hull."""
    sizes = np.linalg.norm(hull.area_vectors, axis=1)
    return enclosing_ball(hull.vertices[hull.faces], sizes)[1]


def _depth(hull: Hull) -> float:
    """Volume over the largest area [m] that a hull shows along an axis."""
    return float(hull.volume / (0.5 * np.abs(hull.area_vectors).sum(axis=0).max()))


def _radius_of(hull: Hull, patches: int) -> float:
    """Radius [m] of so many patches: SPREAD discs' area is the hull's, and twice their radii, for
    slender hulls, its length besides."""
    discs = SPREAD / np.pi * float(np.linalg.norm(hull.area_vectors, axis=1).sum())
    length = hull.length
    return (length + np.sqrt(length**2 + 4.0 * patches * discs)) / (2.0 * patches)


def _triangles(areas: Array, longest: Array, edge: float) -> float:
    """About how many triangles faces of such areas (N,) [m^2] and longest edges (N,) [m] become
    when none has an edge longer than one [m]."""
    halves, along = HALVES / edge**2 * areas, longest / edge
    return float(np.maximum(np.maximum(halves, along), 1.0).sum())


def _faces(hull: Hull) -> tuple[Array, Array]:
    """Areas (N,) [m^2] and longest edges (N,) [m]."""
    areas = np.linalg.norm(hull.area_vectors, axis=1)
    return areas, sides(hull.vertices[hull.faces]).max(axis=1)


def _shortest_edge(hull: Hull) -> float:
    """Edge [m] of as many triangles as there may be of a hull, to a tenth."""
    faces, long, short = _faces(hull), hull.length, 1e-6 * hull.length
    while long > 1.1 * short:
        edge = float(np.sqrt(long * short))
        if _triangles(*faces, edge) > MOST_TRIANGLES + 2 * len(hull.faces):
            short = edge
        else:
            long = edge
    return long
