"""Repair: a closed, outward surface from what a file has, with all its parts.

The steps, in this order: vertices that are almost one are merged, faces without area and doubled
ones dropped, open edges divided where others' vertices lie on them, sheets that meet at crowded
edges parted, each part wound one way, mirrored if half a hull is asked to be whole, each rim
capped by itself, each part turned outward (but a cavity in another), parts that overlap united.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, areas
from sim.hulls.hull import Hull
from sim.hulls.survey import MERGED_WITHIN, merged, size_of
from sim.hulls.topology import directed, edges_of, parts_of, rims_of, wound_alike
from sim.hulls.union import outer_surface, signed_volume, united

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MOST_CHANGE = 0.03
"""Part of the volume that a repair may change, apart from what was counted twice."""

SHRUNK = 1e-6
"""Part of their size that parts shrink by where they touch others at edges."""

THIN = 1e-7
"""Volume over area times size below which a part is a sheet that holds nothing."""


@dataclass(frozen=True)
class Repaired:
    """The hull, what was done, in words, and what is left to be said against it."""

    hull: Hull | None
    done: tuple[str, ...]
    faults: tuple[str, ...]


def repair(vertices: Array, faces: Indices, mirror: str = "") -> Repaired:
    """Close a surface and keep all its parts; mirror: the axis along which half a hull is made
    whole, as its Survey has it."""
    done: list[str] = []
    size = size_of(vertices)
    vertices, faces = _merged(vertices, faces, size, done)
    faces = _divided(vertices, faces, size, done)
    if mirror:
        vertices, faces = _mirrored(vertices, faces, mirror, size)
        done.append(f"mirrored along {mirror}")
        vertices, faces = _merged(vertices, faces, size, [])
    parts, rims = [], 0
    for part in _parted(vertices, faces, size, done):
        whole, count = _capped(vertices, wound_alike(part))
        parts.append(whole)
        rims += count
    if rims:
        done.append(f"{rims} rims capped")
    return _assembled(vertices, parts, done)


def _merged(vertices: Array, faces: Indices, size: float, done: list[str]) -> tuple[Array, Indices]:
    before = len(np.unique(faces))
    vertices, faces = merged(vertices, faces, MERGED_WITHIN * size)
    if before > len(vertices):
        done.append(f"{before - len(vertices)} vertices merged")
    has_area = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    if not has_area.all():
        done.append(f"{np.count_nonzero(~has_area)} faces without area dropped")
    faces = faces[has_area]
    first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    if len(first) < len(faces):
        done.append(f"{len(faces) - len(first)} doubled faces dropped")
    return vertices, faces[np.sort(first)]


def _divided(vertices: Array, faces: Indices, size: float, done: list[str]) -> Indices:
    """Faces with an open edge on which a vertex of another open edge lies, divided there."""
    divided = 0
    for _ in range(20):
        edges = edges_of(faces)
        open_sides = np.flatnonzero(edges.count[edges.of_side] == 1)
        sides = directed(faces)[open_sides]
        candidates = np.unique(sides)
        found: dict[int, tuple[int, int]] = {}
        for side, (a, b) in zip(open_sides.tolist(), sides.tolist(), strict=True):
            face = side % len(faces)
            on = _first_on(vertices, candidates, a, b, MERGED_WITHIN * size)
            if face not in found and on is not None:
                found[face] = side // len(faces), on
        if not found:
            break
        divided += len(found)
        faces = _split_faces(faces, found)
    if divided:
        done.append(f"{divided} faces divided at vertices on their edges")
    return faces


def _first_on(vertices: Array, candidates: Indices, a: int, b: int, within: float) -> int | None:
    """The candidate that lies on the side from a to b, next to a; None where there is none."""
    along = vertices[b] - vertices[a]
    length = float(np.linalg.norm(along))
    arms = vertices[candidates] - vertices[a]
    at = arms @ along / length
    off = np.linalg.norm(arms - np.outer(at / length, along), axis=1)
    on = (at > within) & (at < length - within) & (off < within)
    return int(candidates[on][np.argmin(at[on])]) if on.any() else None


def _split_faces(faces: Indices, at: dict[int, tuple[int, int]]) -> Indices:
    """Faces with a vertex put on one of their sides, both given by the face."""
    kept = np.delete(faces, list(at), axis=0)
    pieces = []
    for face, (side, vertex) in at.items():
        a, b, c = np.roll(faces[face], -side)
        pieces += [(a, vertex, c), (vertex, b, c)]
    return np.concatenate([kept, np.array(pieces)])


def _mirrored(vertices: Array, faces: Indices, axis: str, size: float) -> tuple[Array, Indices]:
    """A half hull and its image beyond the plane across an axis that one of its rims lies in."""
    i = "xyz".index(axis)
    loops = [vertices[loop] for loop in rims_of(wound_alike(faces))]
    plane = float(min((loop[:, i] for loop in loops), key=np.ptp).mean())
    image = vertices.copy()
    image[:, i] = 2.0 * plane - image[:, i]
    both = np.concatenate([vertices, image])
    near = np.abs(both[:, i] - plane) < 10.0 * MERGED_WITHIN * size
    both[near, i] = plane
    return both, np.concatenate([faces, faces[:, ::-1] + len(vertices)])


def _parted(vertices: Array, faces: Indices, size: float, done: list[str]) -> list[Indices]:
    """The faces part by part, where sheets meet at crowded edges each by itself, without inner
    walls: those sheets that end at such edges all around and hold nothing when they are capped."""
    edges, label = edges_of(faces), parts_of(faces)
    parts = [faces[label == part] for part in range(int(label.max()) + 1)]
    crowded = edges.vertices[edges.count > 2]
    if len(crowded) == 0:
        return parts
    done.append(f"{len(crowded)} crowded edges parted")
    known = set(map(tuple, crowded.tolist()))
    outer = [part for part in parts if not _is_wall(vertices, part, size, known)]
    if len(outer) < len(parts):
        done.append(f"{len(parts) - len(outer)} inner walls dropped")
    return outer


def _is_wall(vertices: Array, part: Indices, size: float, crowded: set[tuple[int, ...]]) -> bool:
    edges = edges_of(part)
    rim = edges.vertices[edges.count == 1].tolist()
    if not rim or not all(tuple(edge) in crowded for edge in rim):
        return False
    return _is_sheet(vertices, _capped(vertices, wound_alike(part))[0], size)


def _is_sheet(vertices: Array, part: Indices, size: float) -> bool:
    area = areas(vertices[part]).sum()
    return abs(signed_volume(vertices, part)) <= THIN * area * size


def _capped(vertices: Array, faces: Indices) -> tuple[Indices, int]:
    """A part with each of its rims closed, and how many there were."""
    loops = rims_of(faces)
    caps = [_cap(vertices, loop) for loop in loops]
    return np.concatenate([faces, *caps]), len(loops)


def _cap(vertices: Array, loop: Indices) -> Indices:
    """Faces (N, 3) over a loop, as it would look flat; a fan where it cannot be laid flat."""
    import manifold3d

    if len(loop) < 3:
        return np.zeros((0, 3), np.int64)
    places = vertices[loop] - vertices[loop].mean(axis=0)
    fan = np.stack(
        [np.zeros(len(loop) - 2, int), *np.arange(1, len(loop) - 1) + [[0], [1]]], axis=1
    )
    normal = area_vectors(places[fan]).sum(axis=0)
    length = np.linalg.norm(normal)
    if length > 0.0:
        axis = np.eye(3)[np.argmin(np.abs(normal))]
        right = np.cross(axis, normal / length)
        right /= np.linalg.norm(right)
        flat = np.stack([places @ right, places @ np.cross(normal / length, right)], axis=1)
        laid = np.asarray(manifold3d.triangulate([np.ascontiguousarray(flat)]), dtype=np.int64)
        if len(laid) == len(loop) - 2:
            return loop[laid]
    return loop[fan]


def _assembled(vertices: Array, parts: list[Indices], done: list[str]) -> Repaired:
    """The parts turned outward and united as one hull."""
    size, kept, sheets, turned = size_of(vertices), [], [], 0
    for part in parts:
        if _is_sheet(vertices, part, size):
            sheets.append(vertices[part].reshape(-1, 3).mean(axis=0))
            continue
        volume = signed_volume(vertices, part)
        turned += volume < 0.0
        kept.append(part if volume > 0.0 else part[:, ::-1])
    if turned:
        done.append(f"{turned} parts turned outward")
    faults = []
    if sheets:
        faults.append(
            f"{len(sheets)} of {len(parts)} parts are sheets that enclose nothing, around "
            f"{_listed(sheets)}: give them thickness or take them away"
        )
    if not kept:
        return Repaired(None, tuple(done), (*faults, "nothing encloses a volume"))
    expected = sum(signed_volume(vertices, part) for part in kept)
    try:
        hull, twice = _one_hull(vertices, kept)
    except ValueError as error:
        where = _places_of_trouble(vertices, kept)
        return Repaired(None, tuple(done), (*faults, f"it cannot be closed{where}: {error}"))
    if twice > 0.0:
        done.append(f"overlaps united: {twice:.4g} m^3 were counted twice")
    change = abs(hull.volume / (expected - twice) - 1.0)
    if change > MOST_CHANGE:
        faults.append(f"the volume changed by {100.0 * change:.2g} %")
    return Repaired(hull, tuple(done), tuple(faults))


def _places_of_trouble(vertices: Array, parts: list[Indices]) -> str:
    """Where edges have not two faces, in words; "" where all have."""
    edges = edges_of(np.concatenate(parts))
    places = vertices[edges.vertices[edges.count != 2]].mean(axis=1)
    return f" around {_listed(places)}" if len(places) else ""


def _listed(places: Sequence[Array]) -> str:
    """The first of some places (3,) [m]."""
    return " and ".join("({:.4g}, {:.4g}, {:.4g})".format(*place) for place in places[:3])


def _one_hull(vertices: Array, parts: list[Indices]) -> tuple[Hull, float]:
    """Closed parts as one hull, and the volume [m^3] that they counted twice. Those that touch, so
    that their edges would be crowded, are united as those that overlap are; where that leaves them
    touching at an edge, all but the first shrink by SHRUNK."""
    try:
        hull, twice, _ = outer_surface(*_apart(vertices, parts))
        return hull, twice
    except ValueError:
        hulls = [Hull(vertices, part) for part in parts]  # which says what is wrong with one
    try:
        return united(hulls, at_least=-1.0) or (hulls[0], 0.0)
    except ValueError:
        vertices, faces = _apart(vertices, parts)
        first = np.cumsum([len(np.unique(part)) for part in parts])
        for start, end in pairwise(first):
            middle = vertices[start:end].mean(axis=0)
            vertices[start:end] -= SHRUNK * (vertices[start:end] - middle)
        hull, twice, _ = outer_surface(vertices, faces)
        return hull, twice


def _apart(vertices: Array, parts: list[Indices]) -> tuple[Array, Indices]:
    """Parts that share no vertex: where they touch they would have crowded edges."""
    places, faces, first = [], [], 0
    for part in parts:
        used, own = np.unique(part, return_inverse=True)
        places.append(vertices[used])
        faces.append(own.reshape(-1, 3) + first)
        first += len(used)
    return np.concatenate(places), np.concatenate(faces)
