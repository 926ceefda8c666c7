"""Survey: measures a surface from a file, and finds the faults that keep it from floating."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sim.geometry import areas, cone_volumes, middle, sides
from sim.hulls.crossings import crossing_faces
from sim.hulls.hull import Hull
from sim.hulls.solids import TOUCHING_SHARE, signed_volume
from sim.hulls.tidying import MERGING_SHARE, Tidied, size_of, tidied
from sim.hulls.topology import edges_of, face_pairs, parts_of, rims_of, wound_alike
from sim.hulls.union import decked, shared_volume

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SLIVER_SHARE = 1e-3
"""Share of the longest side: a face with a smaller height is a sliver."""

LIKELY_MILLIMETRES, LIKELY_KILOMETRES = 500.0, 0.005
"""Extents [m]: a larger surface is likely in millimetres, and a smaller one in kilometres."""


@dataclass(frozen=True)
class Rim:
    """A loop of open edges: their number, middle (3,) [m] and extents (3,) [m]. symmetry: the axis
    along which it is the open side of half a hull; "" if it is not."""

    edges: int
    middle: tuple[float, float, float]
    extents: tuple[float, float, float]
    symmetry: str = ""


@dataclass(frozen=True)
class Survey:
    """A surface in numbers. The units assume that the file's lengths are metres.

    volume [m^3]: as the faces are wound, without caps over the holes. crowded_at: positions (K, 3)
    of edges with more than two faces. crossing_faces: the number of faces that go through others.
    holds [m^3]: the volume of water that an open boat holds. refusal: why `Hull` refuses the
    surface; "" if it does not. changes: what `Hull` unites or leaves out, as texts.
    """

    faces: int
    vertices: int
    doubled_vertices: int
    parts: int
    extents: tuple[float, float, float]
    unit_guess: str
    volume: float
    area: float
    rims: tuple[Rim, ...]
    crowded_edges: int
    crowded_at: tuple[tuple[float, float, float], ...]
    twisted_edges: int
    slivers: int
    flat_faces: int
    doubled_faces: int
    inward_parts: int
    nested_parts: int
    overlapping_parts: int
    crossing_faces: int
    holds: float
    refusal: str
    changes: tuple[str, ...]

    @property
    def half_hull(self) -> str:
        """The axis along which half a hull must be mirrored; "" if it is no half hull."""
        return next((rim.symmetry for rim in self.rims if rim.symmetry), "")


def survey(vertices: Array, faces: Indices) -> Survey:
    """The Survey of a surface. Vertices within MERGING_SHARE of its size count as one."""
    tidy = tidied(vertices, faces, MERGING_SHARE * size_of(vertices))
    corners = vertices[faces]
    longest = sides(corners).max(axis=1)
    heights = 2.0 * areas(corners) / np.maximum(longest, np.finfo(float).tiny)
    edges = edges_of(tidy.faces)
    crowded = edges.vertices[edges.count > 2]
    _, alike = face_pairs(edges)
    parts = parts_of(tidy.faces)
    inward, nested, overlapping = _closed_parts(tidy.vertices, parts)
    hull, refusal = _hull(vertices, faces)
    if refusal and not tidy.doubled and _hull(tidy.vertices, tidy.faces)[0]:
        refusal = _not_quite_equal(vertices, faces, tidy) or refusal
    boat = decked(hull) if hull else None
    return Survey(
        faces=len(faces),
        vertices=len(vertices),
        doubled_vertices=tidy.merged,
        parts=len(parts),
        extents=tuple(np.ptp(vertices, axis=0).tolist()),
        unit_guess=unit_guess(vertices),
        volume=float(cone_volumes(corners - middle(vertices)).sum()),
        area=float(areas(corners).sum()),
        rims=tuple(_rims(tidy.vertices, tidy.faces)),
        crowded_edges=len(crowded),
        crowded_at=tuple(map(tuple, tidy.vertices[crowded[:5]].mean(axis=1).tolist())),
        twisted_edges=int(alike.sum()),
        slivers=int(np.count_nonzero((heights < SLIVER_SHARE * longest) & (heights > 0.0))),
        flat_faces=tidy.flat,
        doubled_faces=tidy.doubled,
        inward_parts=inward,
        nested_parts=nested,
        overlapping_parts=overlapping,
        crossing_faces=len(crossing_faces(tidy.vertices, tidy.faces)),
        holds=boat[1] if boat else 0.0,
        refusal=refusal,
        changes=hull.changes if hull else (),
    )


def unit_guess(vertices: Array) -> str:
    """The likely unit of the lengths, from the largest extent."""
    largest = float(np.ptp(vertices, axis=0).max())
    if largest >= LIKELY_MILLIMETRES:
        return f"millimetres? {largest:.4g} m is long; --scale 0.001 makes it {largest / 1e3:.4g} m"
    if largest < LIKELY_KILOMETRES:
        return f"kilometres? {largest:.3g} m is short; --scale 1000 makes it {1e3 * largest:.4g} m"
    return "metres"


def _hull(vertices: Array, faces: Indices) -> tuple[Hull | None, str]:
    """The hull of a surface, or None and why `Hull` refuses it."""
    try:
        return Hull(vertices, faces), ""
    except ValueError as error:
        return None, str(error)


def _not_quite_equal(vertices: Array, faces: Indices, tidy: Tidied) -> str:
    """Why `Hull` refuses a surface that it takes when vertices are merged; "" if that is not why.
    Writers of STL files repeat each vertex, and may round the copies differently."""
    positions = len(np.unique(vertices[faces].reshape(-1, 3), axis=0))
    apart = positions - len(tidy.vertices)
    if not apart:
        return ""
    return (
        f"{apart} vertices are not quite where others are, by up to {MERGING_SHARE:g} of the size, "
        "so that edges between them are open; --repair merges them"
    )


def _rims(vertices: Array, faces: Indices) -> Iterator[Rim]:
    low, high, size = vertices.min(axis=0), vertices.max(axis=0), size_of(vertices)
    for loop in rims_of(wound_alike(faces)):
        points = vertices[loop]
        centre, extents, symmetry = points.mean(axis=0), np.ptp(points, axis=0), ""
        for axis, name in enumerate("xy"):
            is_flat = extents[axis] <= 10.0 * MERGING_SHARE * size
            to_end = min(centre[axis] - low[axis], high[axis] - centre[axis])
            others = np.delete(extents, axis) / np.maximum(np.delete(high - low, axis), 1e-300)
            if is_flat and to_end <= 1e-4 * size and (others > 0.9).all():
                symmetry = name
        yield Rim(len(loop), tuple(centre.tolist()), tuple(extents.tolist()), symmetry)


def _closed_parts(vertices: Array, parts: Sequence[Indices]) -> tuple[int, int, int]:
    """The numbers of closed parts that face inward, that lie within others, and that overlap with
    others."""
    hulls, inward = [], 0
    for part in map(wound_alike, parts):
        if (edges_of(part).count != 2).any():
            continue
        volume = signed_volume(vertices, part)
        inward += volume < 0.0
        try:
            hulls.append(Hull(vertices, part if volume > 0.0 else part[:, ::-1]))
        except ValueError:
            continue
    nested, overlapping = set(), set()
    for large, small in combinations(sorted(hulls, key=lambda hull: -hull.volume), 2):
        if (large.bounds[0] > small.bounds[1]).any() or (small.bounds[0] > large.bounds[1]).any():
            continue
        try:
            share = shared_volume(small, large) / small.volume
        except ValueError:
            continue
        if share > 0.999:
            nested.add(small)
        elif share > TOUCHING_SHARE:
            overlapping |= {small, large}
    return inward, len(nested), len(overlapping)
