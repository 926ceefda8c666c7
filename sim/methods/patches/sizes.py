"""Patch sizes: how finely a hull is cut for a sea.

The number of patches and triangles that a tolerance [m of water height] needs has no limit: no
cubic holds near a crest that is about to fold. A requested tolerance is therefore kept, or refused
before anything is cut. The default tolerance is kept if that takes at most MOST_PATCHES and
MOST_TRIANGLES; otherwise it becomes the tolerance that these numbers can keep.

The number of patches is estimated from the hull's area and length. For random hulls, including flat
and slender ones, the actual number is 0.25 to 1.25 times the estimate.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import sides
from sim.hulls.hull import Hull
from sim.methods.patches.fit import (
    Level,
    best_squeeze,
    deep_levels,
    edge_tolerance,
    jet_radius,
    jet_waves,
    longest_edge,
)
from sim.methods.patches.tree import MOST_TREE_TRIANGLES, PatchTree, build_tree, enclosing_ball
from sim.water.sea import Sea

Array = NDArray[np.float64]

LENGTH_SHARE, DEPTH_SHARE = 1.0 / 400.0, 1.0 / 30.0
"""The default tolerance: the smaller of these shares of the hull's longest side and of its depth,
which is the volume over the largest area that it shows along an axis. A uniform error of the head
by this tolerance would change the force by DEPTH_SHARE of the displaced water's weight. Errors
within and between patches cancel, so at most 1e-3 of the weight is left (`speed_vs_error.py
--random`)."""

FEW_PATCHES, FEW_PATCHES_DEPTH_SHARE = 30, 1.0 / 100.0
"""Estimated number of patches below which errors do not cancel, and the share of the depth to which
the tolerance is then reduced. This costs little."""

MANY_PATCHES, LARGER_RADIUS_RATIO = 200, 1.4
"""Estimated number of patches above which larger ones are made for the deep, and above which errors
cancel so well that patches may be larger, and the largest factor of their radius. It multiplies the
tolerance by four. Patches are enlarged only as long as this number of them remains. The errors of
random cases are then no larger than for other hulls."""

AFLOAT_SHARE = 0.5
"""Share of a hull's thinnest side to which it is taken to float. If larger patches only hold deeper
than that, none are made: the small patches inside them are less round, so there are more of them (a
ship of 350 patches had 451)."""

LINEAR_SHARE = 0.5
"""Share of the tolerance spent on interpolating linearly over a triangle. Under a crest, all these
errors have the same sign. For a plate in the surface, the error of the force was 1.1e-3 with the
share 1, and 1.5e-4 with 0.5, which costs nothing."""

EDGE_RADII = 0.5
"""Longest edge of a triangle, in patch radii, if MOST_TRIANGLES allows it. Longer triangles do not
let a patch fill its ball (a ship of 860 patches has 750 with this). Shorter ones put more leaves on
the waterline."""

MOST_PATCHES, MOST_TRIANGLES = 4_000, 40_000
"""Maximum numbers for a hull at the default tolerance. The triangles are in addition to twice the
hull's own. The hull is then cut within a second, and a wrench in one wave takes a quarter of a
millisecond."""

MOST_REQUESTED_PATCHES = 100_000
"""Maximum number of patches of a hull at a requested tolerance. Cutting it takes about twenty
seconds."""

DISC_COVERAGE, TRIANGLES_PER_EDGE_SQUARE = 2.6, 8.0
"""Area of the discs with all patches' radii, as a multiple of the hull's area; and number of
triangles per square of their longest edge. (Three of four discs extend over two sides of a box or
are smaller than the rest.)"""


class Sizes(NamedTuple):
    """Sizes of a cut, in metres: the largest radius of a patch, the longest edge of a triangle, and
    the tolerance that they keep. is_coarse: whether the tolerance is larger than the default
    because the number of patches or triangles is limited. squeeze: the limit of J in jets. deep:
    levels of larger patches far below the surface."""

    radius: float
    edge: float
    tolerance: float
    is_coarse: bool = False
    squeeze: float = 0.0
    deep: tuple[Level, ...] = ()


def default_tolerance(hull: Hull) -> float:
    """Default tolerance [m] of a hull, if it can be kept. With FEW_PATCHES it is smaller."""
    return min(LENGTH_SHARE * hull.length, DEPTH_SHARE * _depth(hull))


def cut(hull: Hull, sea: Sea, tolerance: float | None) -> tuple[Sizes, PatchTree]:
    """Cut a hull for a sea to a tolerance [m]. None gives the default one, or the nearest one that
    can be kept. Raises ValueError for a tolerance that needs too many patches or triangles."""
    if tolerance is not None:
        return _built(hull, sea, _asked(hull, sea, tolerance))
    most = int(0.9 * MOST_PATCHES)  # as estimated
    while True:
        sizes, tree = _built(hull, sea, _default(hull, sea, most))
        count = np.count_nonzero(tree.patches["level"] == 0)
        if count <= MOST_PATCHES or sizes.radius == np.inf:
            return sizes, tree
        most = int(0.9 * most * MOST_PATCHES / count)


def _built(hull: Hull, sea: Sea, sizes: Sizes) -> tuple[Sizes, PatchTree]:
    """The tree of a hull, and the sizes with its levels."""
    deep: tuple[Level, ...] = ()
    if sizes.radius < _radius_of(hull, MANY_PATCHES):
        deepest = AFLOAT_SHARE * float(np.ptp(hull.bounds, axis=0).min()), hull.length
        reach = _reach(hull)
        deep = deep_levels(sea, sizes.radius, sizes.tolerance, reach, deepest, sizes.squeeze)
    tree = build_tree(hull, sizes.radius, sizes.edge, [level.radius for level in deep])
    return sizes._replace(deep=deep), tree


def _asked(hull: Hull, sea: Sea, tolerance: float) -> Sizes:
    """Sizes for a requested tolerance [m]. Raises ValueError, from estimates, where cutting would
    take too long."""
    least = _radius_of(hull, MOST_REQUESTED_PATCHES)
    radius, kept = jet_radius(sea, tolerance, _reach(hull), least)
    edge = longest_edge(sea, jet_waves(sea, radius), LINEAR_SHARE * tolerance)
    edge = min(edge, max(EDGE_RADII * radius, _shortest_edge(hull)))
    found = ""
    if kept > tolerance:
        found = f"patches below {least:.3g} m, more than {MOST_REQUESTED_PATCHES}"
    elif _triangles(*_faces(hull), edge) > 2.0 * MOST_TREE_TRIANGLES:  # build_tree counts others
        found = f"triangles with edges below {edge:.3g} m, more than {MOST_TREE_TRIANGLES}"
    if found:
        raise ValueError(
            f"the tolerance needs {found} on this hull; use a larger tolerance or a calmer sea"
        )
    return Sizes(radius, edge, tolerance)


def _default(hull: Hull, sea: Sea, most: int) -> Sizes:
    """Sizes for the default tolerance, or for at most `most` patches and the allowed triangles, and
    the tolerance that they keep."""
    radius, tolerance, is_coarse = _default_radius(hull, sea, most)
    waves, squeeze = jet_waves(sea, radius), 0.0
    if is_coarse:
        squeeze, tolerance = best_squeeze(sea, radius)
    edge = longest_edge(sea, waves, LINEAR_SHARE * tolerance, squeeze)
    shortest = _shortest_edge(hull)
    if edge < shortest:
        edge, kept = shortest, edge_tolerance(sea, waves, shortest, squeeze)
        is_coarse, tolerance = is_coarse or kept > tolerance, max(tolerance, kept)
    edge = min(edge, max(EDGE_RADII * radius, shortest))
    return Sizes(radius, edge, tolerance, is_coarse, squeeze)


def _default_radius(hull: Hull, sea: Sea, most: int) -> tuple[float, float, bool]:
    """Radius of patches [m], the tolerance [m] that they keep, and whether the limit on patches
    makes it larger than the default."""
    wished, reach, least = default_tolerance(hull), _reach(hull), _radius_of(hull, most)
    radius, kept = jet_radius(sea, wished, reach, least)
    if kept > wished:
        return radius, kept, True
    if _radius_of(hull, FEW_PATCHES) < radius < np.inf:
        wished = min(wished, FEW_PATCHES_DEPTH_SHARE * _depth(hull))
        radius, kept = jet_radius(sea, wished, reach, least)
    elif radius < _radius_of(hull, MANY_PATCHES):
        largest, loose = (
            min(LARGER_RADIUS_RATIO * radius, _radius_of(hull, MANY_PATCHES)),
            LARGER_RADIUS_RATIO**4 * wished,
        )
        larger, less = jet_radius(sea, loose, largest, radius)
        radius, kept = (larger, less) if less <= loose else (radius, kept)
    return radius, max(wished, kept), False


def _reach(hull: Hull) -> float:
    """Radius [m] of a patch that contains the whole hull."""
    sizes = np.linalg.norm(hull.area_vectors, axis=1)
    return enclosing_ball(hull.vertices[hull.faces], sizes)[1]


def _depth(hull: Hull) -> float:
    """Volume over the largest area that a hull shows along an axis [m]."""
    return float(hull.volume / (0.5 * np.abs(hull.area_vectors).sum(axis=0).max()))


def _radius_of(hull: Hull, patches: int) -> float:
    """Radius [m] at which a hull has a number of patches: DISC_COVERAGE times its area over the
    area of a disc, plus its length over the radius, which counts for slender hulls."""
    discs = DISC_COVERAGE / np.pi * float(np.linalg.norm(hull.area_vectors, axis=1).sum())
    length = hull.length
    return (length + np.sqrt(length**2 + 4.0 * patches * discs)) / (2.0 * patches)


def _triangles(areas: Array, longest: Array, edge: float) -> float:
    """Estimated number of triangles when faces with areas (N,) [m^2] and longest edges (N,) [m] are
    split until no edge is longer than `edge` [m]."""
    halves, along = TRIANGLES_PER_EDGE_SQUARE / edge**2 * areas, longest / edge
    return float(np.maximum(np.maximum(halves, along), 1.0).sum())


def _faces(hull: Hull) -> tuple[Array, Array]:
    """Areas (N,) [m^2] and longest edges (N,) [m] of the hull's faces."""
    areas = np.linalg.norm(hull.area_vectors, axis=1)
    return areas, sides(hull.vertices[hull.faces]).max(axis=1)


def _shortest_edge(hull: Hull) -> float:
    """Edge [m] at which a hull has the maximum number of triangles, to a tenth."""
    faces, long, short = _faces(hull), hull.length, 1e-6 * hull.length
    while long > 1.1 * short:
        edge = float(np.sqrt(long * short))
        if _triangles(*faces, edge) > MOST_TRIANGLES + 2 * len(hull.faces):
            short = edge
        else:
            long = edge
    return long
