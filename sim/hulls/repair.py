"""Repair: a closed, outward surface made from what a file has, with all its parts.

The steps, in this order: vertices that are almost one are merged; faces without area and doubled
faces are dropped; open edges are divided where vertices of other open edges lie on them; half a
hull is mirrored, if asked for; sheets that meet at crowded edges are parted; each part is wound one
way, and each of its rims capped; parts are turned outward, and those that overlap are united.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, areas
from sim.hulls.hull import Hull
from sim.hulls.tidying import MERGED_WITHIN, size_of, tidied
from sim.hulls.topology import compacted, edges_of, joined, parts_of, rims_of, wound_alike
from sim.hulls.union import outer_surface, signed_volume, united

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MOST_CHANGE = 0.03
"""Share of the volume that a repair may change, apart from what was counted twice."""

SHRUNK = 1e-6
"""Share of their size by which parts shrink where they touch others at edges."""

THIN = 1e-7
"""Volume over area times size below which a part is a sheet that holds nothing."""


@dataclass(frozen=True)
class Repaired:
    """The hull, None where there is none; what was done; and the faults that are left. In words."""

    hull: Hull | None
    done: tuple[str, ...]
    faults: tuple[str, ...]


def repair(vertices: Array, faces: Indices, mirror: str = "") -> Repaired:
    """Close a surface and keep all its parts; mirror: the axis along which half a hull is made
    whole, as its Survey names it."""
    size = size_of(vertices)
    within = MERGED_WITHIN * size
    tidy = tidied(vertices, faces, within)
    vertices, faces, divided = tidy.vertices, *_divided(tidy.vertices, tidy.faces, within)
    if mirror:
        vertices, faces, *_ = tidied(*_mirrored(vertices, faces, mirror, size), within)
    sheets, crowded, walls = _parted(vertices, faces, size)
    capped = [_capped(vertices, wound_alike(sheet)) for sheet in sheets]
    rims = sum(count for _, count in capped)
    done = (
        (tidy.merged, f"{tidy.merged} vertices merged"),
        (tidy.flat, f"{tidy.flat} faces without area dropped"),
        (tidy.doubled, f"{tidy.doubled} doubled faces dropped"),
        (divided, f"{divided} faces divided at vertices on their edges"),
        (mirror, f"mirrored along {mirror}"),
        (crowded, f"{crowded} crowded edges parted"),
        (walls, f"{walls} inner walls dropped"),
        (rims, f"{rims} rims capped"),
    )
    parts = [part for part, _ in capped]
    return _assembled(vertices, parts, [text for happened, text in done if happened])


def _divided(vertices: Array, faces: Indices, within: float) -> tuple[Indices, int]:
    """The faces, divided where a vertex of another open edge lies within a distance [m] of an open
    edge of theirs, and how many were."""
    divided = 0
    for _ in range(20):
        edges = edges_of(faces)
        candidates = np.unique(edges.sides[edges.open_sides])
        found: dict[int, tuple[int, int]] = {}
        for s in edges.open_sides.tolist():
            side, face = divmod(s, len(faces))
            on = _first_on(vertices, candidates, *edges.sides[s], within)
            if face not in found and on is not None:
                found[face] = side, on
        if not found:
            break
        divided += len(found)
        faces = _split_faces(faces, found)
    return faces, divided


def _first_on(vertices: Array, candidates: Indices, a: int, b: int, within: float) -> int | None:
    """Of the candidates on the side from a to b the one next to a; None where there is none."""
    along = vertices[b] - vertices[a]
    length = float(np.linalg.norm(along))
    arms = vertices[candidates] - vertices[a]
    at = arms @ along / length
    off = np.linalg.norm(arms - np.outer(at / length, along), axis=1)
    on = (at > within) & (at < length - within) & (off < within)
    return int(candidates[on][np.argmin(at[on])]) if on.any() else None


def _split_faces(faces: Indices, at: dict[int, tuple[int, int]]) -> Indices:
    """The faces, with those divided that `at` gives a side and a vertex on it."""
    kept = np.delete(faces, list(at), axis=0)
    pieces = []
    for face, (side, vertex) in at.items():
        a, b, c = np.roll(faces[face], -side)
        pieces += [(a, vertex, c), (vertex, b, c)]
    return np.concatenate([kept, np.array(pieces)])


def _mirrored(vertices: Array, faces: Indices, axis: str, size: float) -> tuple[Array, Indices]:
    """A half hull and its mirror image. Across the axis, its flattest rim is the plane between."""
    i = "xyz".index(axis)
    loops = [vertices[loop] for loop in rims_of(wound_alike(faces))]
    plane = float(min((loop[:, i] for loop in loops), key=np.ptp).mean())
    image = vertices.copy()
    image[:, i] = 2.0 * plane - image[:, i]
    both = np.concatenate([vertices, image])
    near = np.abs(both[:, i] - plane) < 10.0 * MERGED_WITHIN * size
    both[near, i] = plane
    return both, np.concatenate([faces, faces[:, ::-1] + len(vertices)])


def _parted(vertices: Array, faces: Indices, size: float) -> tuple[list[Indices], int, int]:
    """The faces of each part, where sheets that meet at crowded edges are parts too; how many such
    edges there are, and how many inner walls are left out: sheets that end at such edges all around
    and hold nothing when they are capped."""
    edges, parts = edges_of(faces), parts_of(faces)
    crowded = set(map(tuple, edges.vertices[edges.count > 2].tolist()))
    outer = [part for part in parts if not _is_wall(vertices, part, size, crowded)]
    return outer, len(crowded), len(parts) - len(outer)


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
    """A part with each of its rims closed, and the number of rims."""
    loops = rims_of(faces)
    caps = [_cap(vertices, loop) for loop in loops]
    return np.concatenate([faces, *caps]), len(loops)


def _cap(vertices: Array, loop: Indices) -> Indices:
    """Faces (N, 3) over a loop, triangulated where it is laid flat; a fan where it cannot be."""
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
    """In words, where edges do not have two faces; "" where all do."""
    edges = edges_of(np.concatenate(parts))
    places = vertices[edges.vertices[edges.count != 2]].mean(axis=1)
    return f" around {_listed(places)}" if len(places) else ""


def _listed(places: Sequence[Array]) -> str:
    """The first of some places (3,) [m], in words."""
    return " and ".join("({:.4g}, {:.4g}, {:.4g})".format(*place) for place in places[:3])


def _one_hull(vertices: Array, parts: list[Indices]) -> tuple[Hull, float]:
    """Closed parts as one hull, and the volume [m^3] that they counted twice. Parts that touch, so
    that their edges would be crowded, are united like those that overlap. Where the result still
    touches itself at an edge, all parts but the first shrink by SHRUNK."""
    surfaces = [compacted(vertices, part) for part in parts]
    try:
        hull, twice, _ = outer_surface(*joined(surfaces))
        return hull, twice
    except ValueError:
        hulls = [Hull(*surface) for surface in surfaces]  # which says what is wrong with one
    try:
        return united(hulls, at_least=-1.0) or (hulls[0], 0.0)
    except ValueError:
        for places, _ in surfaces[1:]:
            places -= SHRUNK * (places - places.mean(axis=0))
        hull, twice, _ = outer_surface(*joined(surfaces))
        return hull, twice
