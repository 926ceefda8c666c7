"""Elements: the surface of a hull as flat pieces, for its drag and added mass."""

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, areas, split_triangles
from sim.hulls.hull import Hull
from sim.kernels import inline, read_only, record
from sim.precision import real

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Table = NDArray[np.void]

ELEMENTS = 128
"""Number of surface elements of a hull, a multiple of gerstner.LANES. The cost of drag is
proportional to it."""

MOST_PIECES = 1_000_000
"""Maximum number of triangles into which faces are split before they are gathered. A few hundred
suffice."""

ROW = ("real", ELEMENTS)

SURFACE = record(
    x=ROW, y=ROW, z=ROW, normal_x=ROW, normal_y=ROW, normal_z=ROW, area=ROW, radius=ROW, flat=ROW
)  # fmt: skip
"""The elements of a hull in its frame.

x, y, z: points [m]; normal_x, normal_y, normal_z: unit normals; area [m^2]; radius [m]: of discs
with these areas; flat [m^2]: lengths of the elements' area vectors; the vectors add up to
zero. If there are fewer elements, the last rows have no area.
"""


class Pose(NamedTuple):
    """A hull's frame in the world: position (3,) [m], rotation (9,), hull -> world."""

    position: Array
    rotation: Array


@inline
def nine(rotation):
    """The entries of a matrix (9,)."""
    r = rotation
    return (
        real(r[0]), real(r[1]), real(r[2]), real(r[3]), real(r[4]), real(r[5]), real(r[6]),
        real(r[7]), real(r[8]),
    )  # fmt: skip


@inline
def upwards(rotation):
    """The vertical in the frame of a rotation (9,)."""
    return real(rotation[6]), real(rotation[7]), real(rotation[8])


def surface_elements(hull: Hull, count: int = ELEMENTS) -> Table:
    """Gather the hull's surface into `count` flat elements, a SURFACE.

    Faces larger than half an element are split. Then the largest group of faces is halved across
    its widest direction until there are enough groups. For this, a face has six coordinates: its
    centre over the hull's radius, and its normal.
    """
    limit = areas(hull.vertices[hull.faces]).sum() / (2.0 * count)
    corners = split_triangles(
        hull.vertices[hull.faces], lambda c: areas(c) > limit, most=MOST_PIECES
    )
    vectors = area_vectors(corners)
    sizes = np.linalg.norm(vectors, axis=1)
    centres = corners.sum(axis=1) / 3.0
    radius = 0.5 * np.linalg.norm(hull.bounds[1] - hull.bounds[0])
    normals = vectors / np.maximum(sizes, np.finfo(float).tiny)[:, None]
    places = np.hstack([centres / radius, normals])
    groups = [(-sizes.sum(), 0, np.arange(len(sizes)))]
    serial = 1
    while len(groups) < count and len(groups[0][2]) > 1:
        _, _, group = heapq.heappop(groups)
        for half in _halves(group, places, sizes):
            heapq.heappush(groups, (-sizes[half].sum(), serial, half))
            serial += 1
    members = [group for _, _, group in sorted(groups, key=lambda g: g[1])]
    return _surface(members, sizes, centres, vectors)


def _surface(members: list[Indices], sizes: Array, centres: Array, vectors: Array) -> Table:
    """Groups of faces as a SURFACE, with their areas, centroids and mean normals."""
    surface = np.zeros(1, SURFACE)
    for i, group in enumerate(members):
        area, vector = sizes[group].sum(), vectors[group].sum(axis=0)
        point = sizes[group] @ centres[group] / area
        normal = vector / max(np.linalg.norm(vector), np.finfo(float).tiny)
        for axis, place, part in zip("xyz", point, normal, strict=True):
            surface[axis][0, i], surface[f"normal_{axis}"][0, i] = place, part
        surface["area"][0, i], surface["radius"][0, i] = area, np.sqrt(area / np.pi)
        surface["flat"][0, i] = np.linalg.norm(vector)
    for name in SURFACE.names or ():
        if name not in ("area", "flat"):
            surface[name][0, len(members) :] = surface[name][0, 0]
    return read_only(surface)


def enclosed_volume(surface: Table) -> Array:
    """Matrix (3, 3) [m^3] that a SURFACE encloses: the sum of point times area vector. It is the
    volume times the identity, apart from the difference between the elements and the shape."""
    places = np.stack([surface[axis][0] for axis in "xyz"])
    vectors = np.stack([surface[f"normal_{axis}"][0] for axis in "xyz"]) * surface["flat"][0]
    matrix = places @ vectors.T
    return 0.5 * (matrix + matrix.T)


def _halves(group: Indices, places: Array, sizes: Array) -> tuple[Indices, Indices]:
    """Cut a group in two across its widest direction. The cut minimises the spread within the
    halves, so it follows edges of the surface where there are any."""
    weights = sizes[group] / sizes[group].sum()
    spread = places[group] - weights @ places[group]
    _, directions = np.linalg.eigh((spread * weights[:, None]).T @ spread)
    along = spread @ directions[:, -1]
    order = np.argsort(along, kind="stable")
    weight = np.cumsum(weights[order])[:-1]
    moment = np.cumsum((weights * along)[order])[:-1]
    between = moment**2 / np.maximum(weight * (1.0 - weight), np.finfo(float).tiny)
    cut = int(np.argmax(between)) + 1
    return group[order[:cut]], group[order[cut:]]
