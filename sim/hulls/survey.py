"""Survey: what a surface from a file is, and what would keep it from floating."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.geometry import areas, cone_volumes, spread_lowest
from sim.hulls.crossings import crossing_faces
from sim.hulls.hull import Hull
from sim.hulls.topology import (
    edges_of,
    face_pairs,
    parts_of,
    rims_of,
    wound_alike,
)
from sim.hulls.union import decked, outer_surface, shared_volume

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MERGED_WITHIN = 1e-5
"""Of a surface's size: vertices so close are one."""

SLIVER = 1e-3
"""Height over longest side below which a face is a sliver."""

MILLIMETRES, TINY = 500.0, 0.005
"""Sizes [m] from which on a surface is likely in millimetres, and below which in something else."""


@dataclass(frozen=True)
class Rim:
    """A loop of open edges: how many, where its middle (3,) [m] is, its extents (3,) [m], and the
    axis whose plane of symmetry it lies in at the end of the surface, as half a hull's does."""

    edges: int
    middle: tuple[float, float, float]
    extents: tuple[float, float, float]
    symmetry: str = ""


@dataclass(frozen=True)
class Survey:
    """A surface in numbers: sizes in metres, if the file is.

    volume [m^3]: as the faces are wound, with holes left out; crowded_at: places (K, 3) of edges
    with more than two faces; crossing_faces: how many go through others; holds [m^3]: the water in
    an open boat; refusal: what Waterline says to it, "" where it takes it.
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

    @property
    def half_hull(self) -> str:
        """The axis that half a hull is to be mirrored along, "" where it is none."""
        return next((rim.symmetry for rim in self.rims if rim.symmetry), "")


def read_surface(path: Path, scale: float = 1.0) -> tuple[Array, Indices]:
    """Vertices (V, 3) and faces (F, 3) of a file of any kind that trimesh reads, scaled. Raises
    ValueError for a file that holds no surface, OSError for one that is not there."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        mesh = trimesh.load(path, process=False, force="mesh")
        faces = np.asarray(mesh.faces)
    except ImportError:  # of what trimesh would guess the encoding with
        raise ValueError(
            f"{path}: trimesh cannot read it: it is no {path.suffix or 'file of a known kind'}"
        ) from None
    except Exception as error:  # each of trimesh's readers has errors of its own
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path}: trimesh cannot read it: {reason}") from None
    if len(faces) == 0:
        raise ValueError(f"{path}: it has no faces; expected a surface of triangles")
    vertices = scale * np.asarray(mesh.vertices, dtype=float)
    broken = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
    if broken:
        raise ValueError(f"{path}: {broken} of {len(vertices)} vertices are not finite; drop them")
    if not np.ptp(vertices, axis=0).any():
        raise ValueError(f"{path}: all vertices lie in one point; expected a surface of triangles")
    return vertices, faces.astype(np.int64)


def merged(vertices: Array, faces: Indices, within: float) -> tuple[Array, Indices]:
    """Vertices that are closer than a distance [m] as one, and those without a face dropped; faces
    keep their places and may collapse. Boxes of twice that distance in eight positions find all."""
    label = np.arange(len(vertices))
    places = (vertices - vertices.min(axis=0)) / (2.0 * within)
    for shift in np.ndindex(2, 2, 2):
        cells = np.floor(places + 0.5 * np.array(shift)).astype(np.int64)
        keys = cells @ _spreading(cells)
        _, first, group = np.unique(keys, return_index=True, return_inverse=True)
        spread_lowest(np.stack([np.arange(len(keys)), first[group.reshape(-1)]], axis=1), label)
    used, faces = np.unique(label[faces], return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def _spreading(cells: Indices) -> Indices:
    """Factors (3,) that give each cell (N, 3) a number of its own."""
    sizes = cells.max(axis=0) + 2
    return np.array([sizes[1] * sizes[2], sizes[2], 1])


def size_of(vertices: Array) -> float:
    """The diagonal [m]."""
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def survey(vertices: Array, faces: Indices) -> Survey:
    """What a surface is, as it stands but for vertices within MERGED_WITHIN of its size, which
    count as one."""
    size = size_of(vertices)
    joined, merged_faces = merged(vertices, faces, MERGED_WITHIN * size)
    collapsed = (merged_faces == np.roll(merged_faces, 1, axis=1)).any(axis=1)
    distinct = np.unique(np.sort(merged_faces, axis=1), axis=0, return_index=True)[1]
    kept = merged_faces[np.sort(distinct)]
    kept = kept[~(kept == np.roll(kept, 1, axis=1)).any(axis=1)]
    corners = vertices[faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    heights = 2.0 * areas(corners) / np.maximum(sides, np.finfo(float).tiny)
    edges = edges_of(kept) if len(kept) else edges_of(np.zeros((0, 3), np.int64))
    crowded = edges.vertices[edges.count > 2]
    _, alike = face_pairs(kept, edges)
    label = parts_of(kept) if len(kept) else np.zeros(0, np.int64)
    inward, nested, overlapping = _parts_in_parts(joined, kept, label)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    refusal, holds = _refusal(vertices, faces)
    return Survey(
        faces=len(faces),
        vertices=len(vertices),
        doubled_vertices=len(np.unique(faces)) - len(joined),
        parts=int(label.max(initial=-1)) + 1,
        extents=_numbers(np.ptp(vertices, axis=0)),
        unit_guess=unit_guess(vertices),
        volume=float(cone_volumes(corners - middle).sum()),
        area=float(areas(corners).sum()),
        rims=tuple(_rims(joined, kept)),
        crowded_edges=len(crowded),
        crowded_at=tuple(_numbers(p) for p in joined[crowded[:5]].mean(axis=1)),
        twisted_edges=int(alike.sum()),
        slivers=int(np.count_nonzero((heights < SLIVER * sides) & (heights > 0.0))),
        flat_faces=int(np.count_nonzero(collapsed)),
        doubled_faces=int(np.count_nonzero(~collapsed)) - len(kept),
        inward_parts=inward,
        nested_parts=nested,
        overlapping_parts=overlapping,
        crossing_faces=len(crossing_faces(joined, kept)) if len(kept) else 0,
        holds=holds,
        refusal=refusal,
    )


def unit_guess(vertices: Array) -> str:
    """What the lengths may be in, from the largest."""
    largest = float(np.ptp(vertices, axis=0).max())
    if largest >= MILLIMETRES:
        return f"millimetres? {largest:.4g} m is long; --scale 0.001 makes it {largest / 1e3:.4g} m"
    if largest < TINY:
        return f"kilometres? {largest:.3g} m is short; --scale 1000 makes it {1e3 * largest:.4g} m"
    return "metres"


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _refusal(vertices: Array, faces: Indices) -> tuple[str, float]:
    """What Hull says, and what an open boat holds [m^3]."""
    try:
        found = decked(outer_surface(vertices, faces)[0])
    except ValueError as error:
        return str(error), 0.0
    return "", found[1] if found else 0.0


def _rims(vertices: Array, faces: Indices) -> Iterator[Rim]:
    low, high, size = vertices.min(axis=0), vertices.max(axis=0), size_of(vertices)
    for loop in rims_of(wound_alike(faces)):
        places = vertices[loop]
        extents, symmetry = np.ptp(places, axis=0), ""
        for axis, name in enumerate("xyz"):
            is_flat = extents[axis] <= 10.0 * MERGED_WITHIN * size
            at = places[:, axis].mean()
            at_an_end = min(abs(at - low[axis]), abs(at - high[axis])) <= 1e-4 * size
            others = np.delete(extents, axis) / np.maximum(np.delete(high - low, axis), 1e-300)
            if is_flat and at_an_end and name != "z" and (others > 0.9).all():
                symmetry = name
        yield Rim(len(loop), _numbers(places.mean(axis=0)), _numbers(extents), symmetry)


def _parts_in_parts(vertices: Array, faces: Indices, label: Indices) -> tuple[int, int, int]:
    """Of the parts that are closed: how many face inward, how many lie within others' boxes, and
    how many overlap with others."""
    hulls, inward = [], 0
    for part in range(int(label.max(initial=-1)) + 1):
        own = wound_alike(faces[label == part])
        if (edges_of(own).count != 2).any():
            continue
        corners = vertices[own]
        volume = cone_volumes(corners - corners.reshape(-1, 3).mean(axis=0)).sum()
        inward += bool(volume < 0.0)
        if volume != 0.0:
            try:
                hulls.append(Hull(vertices, own if volume > 0.0 else own[:, ::-1]))
            except ValueError:
                continue
    nested, overlapping = set(), set()
    for i, one in enumerate(hulls):
        for j, other in enumerate(hulls[:i]):
            if (one.bounds[0] > other.bounds[1]).any() or (other.bounds[0] > one.bounds[1]).any():
                continue
            small, large = (i, j) if one.volume < other.volume else (j, i)
            try:
                shared = shared_volume(hulls[small], hulls[large]) / hulls[small].volume
            except ValueError:
                continue
            if shared > 0.999:
                nested.add(small)
            elif shared > 1e-6:
                overlapping |= {small, large}
    return inward, len(nested), len(overlapping)
