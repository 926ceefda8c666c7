"""Repair: makes a closed, outward surface from a surface in a file.

The steps, in this order: almost equal vertices are merged; faces without area and doubled faces are
dropped; open edges are divided at vertices of other open edges; half a hull is mirrored, if asked
for; sheets that meet at crowded edges are separated; each part gets one winding, and its rims are
capped; parts are turned outward, and overlapping parts are united.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, areas
from sim.hulls.hull import Hull
from sim.hulls.tidying import MERGING_SHARE, size_of, tidied
from sim.hulls.topology import compacted, edges_of, joined, parts_of, rims_of, wound_alike
from sim.hulls.union import outer_surface, signed_volume, united

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LARGEST_CHANGE_SHARE = 0.03
"""Share of the volume that a repair may change, apart from volume that was counted twice."""

SHRINK_SHARE = 1e-6
"""Share of their size by which parts shrink if they touch other parts at edges."""

SHEET_SHARE = 1e-7
"""Share of area times size: a part with a smaller volume is a sheet."""


@dataclass(frozen=True)
class Repaired:
    """The hull, or None; the steps that were done; and the faults that are left, as texts."""

    hull: Hull | None
    done: tuple[str, ...]
    faults: tuple[str, ...]


def repair(vertices: Array, faces: Indices, mirror: str = "") -> Repaired:
    """Close a surface and keep all its parts. mirror: the axis along which half a hull is mirrored;
    `Survey.half_hull` gives it."""
    size = size_of(vertices)
    within = MERGING_SHARE * size
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
    """Divide faces whose open edge has a vertex of another open edge within a distance [m]. Returns
    the faces and the number of divisions."""
    divided = 0
    for _ in range(20):
        edges = edges_of(faces)
        candidates = np.unique(edges.sides[edges.open_sides])
        divisions: dict[int, tuple[int, int]] = {}  # side and vertex of each face
        for s in edges.open_sides.tolist():
            side, face = divmod(s, len(faces))
            vertex = _first_on(vertices, candidates, *edges.sides[s], within)
            if face not in divisions and vertex is not None:
                divisions[face] = side, vertex
        if not divisions:
            break
        divided += len(divisions)
        pieces = []
        for face, (side, vertex) in divisions.items():
            a, b, c = np.roll(faces[face], -side)
            pieces += [(a, vertex, c), (vertex, b, c)]
        faces = np.concatenate([np.delete(faces, list(divisions), axis=0), np.array(pieces)])
    return faces, divided


def _first_on(vertices: Array, candidates: Indices, a: int, b: int, within: float) -> int | None:
    """The candidate on the side from a to b that is closest to a; None if there is none."""
    side = vertices[b] - vertices[a]
    length = float(np.linalg.norm(side))
    arms = vertices[candidates] - vertices[a]
    along = arms @ side / length
    off = np.linalg.norm(arms - np.outer(along / length, side), axis=1)
    on = (along > within) & (along < length - within) & (off < within)
    return int(candidates[on][np.argmin(along[on])]) if on.any() else None


def _mirrored(vertices: Array, faces: Indices, axis: str, size: float) -> tuple[Array, Indices]:
    """A half hull and its mirror image. The mirror is the plane of the rim that is flattest along
    the axis."""
    i = "xyz".index(axis)
    loops = [vertices[loop] for loop in rims_of(wound_alike(faces))]
    plane = float(min((loop[:, i] for loop in loops), key=np.ptp).mean())
    image = vertices.copy()
    image[:, i] = 2.0 * plane - image[:, i]
    both = np.concatenate([vertices, image])
    near = np.abs(both[:, i] - plane) < 10.0 * MERGING_SHARE * size
    both[near, i] = plane
    return both, np.concatenate([faces, faces[:, ::-1] + len(vertices)])


def _parted(vertices: Array, faces: Indices, size: float) -> tuple[list[Indices], int, int]:
    """The faces of each part, the number of crowded edges, and the number of inner walls, which are
    dropped. Sheets that meet at crowded edges are separate parts. An inner wall is a part whose
    whole rim is crowded edges and which encloses no volume when it is capped."""
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
    return abs(signed_volume(vertices, part)) <= SHEET_SHARE * area * size


def _capped(vertices: Array, faces: Indices) -> tuple[Indices, int]:
    """A part with each of its rims closed, and the number of rims."""
    loops = rims_of(faces)
    caps = [_cap(vertices, loop) for loop in loops]
    return np.concatenate([faces, *caps]), len(loops)


def _cap(vertices: Array, loop: Indices) -> Indices:
    """Faces (N, 3) over a loop, triangulated in its mean plane; a fan if that fails."""
    import manifold3d

    if len(loop) < 3:
        return np.zeros((0, 3), np.int64)
    arms = vertices[loop] - vertices[loop].mean(axis=0)
    fan = np.stack(
        [np.zeros(len(loop) - 2, int), *np.arange(1, len(loop) - 1) + [[0], [1]]], axis=1
    )
    normal = area_vectors(arms[fan]).sum(axis=0)
    length = np.linalg.norm(normal)
    if length > 0.0:
        axis = np.eye(3)[np.argmin(np.abs(normal))]
        right = np.cross(axis, normal / length)
        right /= np.linalg.norm(right)
        flat = np.stack([arms @ right, arms @ np.cross(normal / length, right)], axis=1)
        cap = np.asarray(manifold3d.triangulate([np.ascontiguousarray(flat)]), dtype=np.int64)
        if len(cap) == len(loop) - 2:
            return loop[cap]
    return loop[fan]


def _assembled(vertices: Array, parts: list[Indices], done: list[str]) -> Repaired:
    """Turn the parts outward and unite them as one hull."""
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
            f"{_listed(sheets)}: give them thickness or remove them"
        )
    if not kept:
        return Repaired(None, tuple(done), (*faults, "nothing encloses a volume"))
    expected = sum(signed_volume(vertices, part) for part in kept)
    try:
        hull, twice = _one_hull(vertices, kept)
    except ValueError as error:
        edges = edges_of(np.concatenate(kept))
        points = vertices[edges.vertices[edges.count != 2]].mean(axis=1)
        where = f" around {_listed(points)}" if len(points) else ""
        return Repaired(None, tuple(done), (*faults, f"it cannot be closed{where}: {error}"))
    if twice > 0.0:
        done.append(f"overlaps united: {twice:.4g} m^3 were counted twice")
    change = abs(hull.volume / (expected - twice) - 1.0)
    if change > LARGEST_CHANGE_SHARE:
        faults.append(f"the volume changed by {100.0 * change:.2g} %")
    return Repaired(hull, tuple(done), tuple(faults))


def _listed(points: Sequence[Array]) -> str:
    """The first three points (3,) [m], as text."""
    return " and ".join("({:.4g}, {:.4g}, {:.4g})".format(*point) for point in points[:3])


def _one_hull(vertices: Array, parts: list[Indices]) -> tuple[Hull, float]:
    """Closed parts as one hull, and the volume [m^3] that they counted twice. Parts that touch are
    united like overlapping parts, because their edges would be crowded. If the result still touches
    itself at an edge, all parts but the first shrink by SHRINK_SHARE."""
    surfaces = [compacted(vertices, part) for part in parts]
    try:
        hull, twice, _ = outer_surface(*joined(surfaces))
        return hull, twice
    except ValueError:
        hulls = [Hull(*surface) for surface in surfaces]  # raises the fault of a single part
    try:
        return united(hulls, at_least=-1.0) or (hulls[0], 0.0)
    except ValueError:
        for points, _ in surfaces[1:]:
            points -= SHRINK_SHARE * (points - points.mean(axis=0))
        hull, twice, _ = outer_surface(*joined(surfaces))
        return hull, twice
