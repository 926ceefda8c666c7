"""Repair: makes a closed, outward surface from a surface in a file.

The steps, in this order: almost equal vertices are merged; faces without area and doubled faces are
dropped; open edges are divided at vertices of other open edges; half a hull is mirrored, if asked
for; sheets that meet at crowded edges are separated; each part gets one winding, and its rims are
capped; specks, and sheets if asked for, are left out; parts are turned outward, and overlapping
parts are united.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, areas
from sim.hulls.hull import Hull
from sim.hulls.solids import signed_volume
from sim.hulls.specks import described, places, specks_among
from sim.hulls.tidying import MERGING_SHARE, size_of, tidied
from sim.hulls.topology import compacted, edges_of, joined, parts_of, rims_of, wound_alike
from sim.hulls.union import united

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

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


def repair(
    vertices: Array, faces: Indices, mirror: str = "", drop_sheets: bool = False
) -> Repaired:
    """Close a surface and keep all its parts except specks. mirror: the axis along which half a
    hull is mirrored; `Survey.half_hull` gives it. drop_sheets: whether sheets that enclose nothing,
    such as fins, are left out; they are a fault otherwise."""
    size = size_of(vertices)
    within = MERGING_SHARE * size
    tidy = tidied(vertices, faces, within)
    vertices, faces, divided = tidy.vertices, *_divided(tidy.vertices, tidy.faces, within)
    if mirror:
        vertices, faces, *_ = tidied(*_mirrored(vertices, faces, mirror, size), within)
    parts, crowded, walls = _parted(vertices, faces, size)
    capped = [_capped(vertices, wound_alike(part)) for part in parts]
    is_sheet = [_is_sheet(vertices, part, size) for part, _ in capped]
    solid = [part for part, flat in zip(capped, is_sheet, strict=True) if not flat]
    sheets = [part for part, flat in zip(parts, is_sheet, strict=True) if flat]
    rims = sum(count for _, count in solid)
    steps = (
        (tidy.merged, f"{tidy.merged} vertices merged"),
        (tidy.flat, f"{tidy.flat} faces without area dropped"),
        (tidy.doubled, f"{tidy.doubled} doubled faces dropped"),
        (divided, f"{divided} faces divided at vertices on their edges"),
        (mirror, f"mirrored along {mirror}"),
        (crowded, f"{crowded} crowded edges parted"),
        (walls, f"{walls} inner walls dropped"),
        (rims, f"{rims} rims capped"),
    )
    left_out, faults = _without_sheets(vertices, faces, sheets, drop_sheets)
    done = [text for happened, text in steps if happened] + left_out
    return _assembled(vertices, [part for part, _ in solid], done, faults)


def _without_sheets(
    vertices: Array, faces: Indices, sheets: list[Indices], drop_sheets: bool
) -> tuple[list[str], list[str]]:
    """What is left out, and the faults that are left, as texts: sheets that are no specks are a
    fault unless they are to be dropped."""
    specks = specks_among(vertices, sheets, float(areas(vertices[faces]).sum()))
    large = [sheet for sheet in sheets if not any(sheet is speck for speck in specks)]
    done, faults = [], []
    if specks:
        done.append(f"specks left out: {described(vertices, specks, faces)}")
    if large and drop_sheets:
        done.append(f"sheets left out: {described(vertices, large, faces)}")
    elif large:
        faults.append(
            f"it has sheets that enclose nothing: {described(vertices, large, faces)}; give them "
            "thickness, or leave them out with --drop-sheets"
        )
    return done, faults


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


def _assembled(
    vertices: Array, parts: list[Indices], done: list[str], faults: list[str]
) -> Repaired:
    """Turn closed parts outward and unite them as one hull."""
    volumes = [signed_volume(vertices, part) for part in parts]
    if turned := sum(volume < 0.0 for volume in volumes):
        done = [*done, f"{turned} parts turned outward"]
    if not parts:
        return Repaired(None, tuple(done), (*faults, "nothing encloses a volume"))
    outward = [
        part if volume > 0.0 else part[:, ::-1] for part, volume in zip(parts, volumes, strict=True)
    ]
    try:
        hull = _one_hull(vertices, outward)
    except ValueError as error:
        edges = edges_of(np.concatenate(outward))
        crowded = edges.vertices[edges.count != 2]
        where = f" around {places(vertices, crowded)}" if len(crowded) else ""
        return Repaired(None, tuple(done), (*faults, f"it cannot be closed{where}: {error}"))
    return Repaired(hull, (*done, *hull.changes), tuple(faults))


def _one_hull(vertices: Array, parts: list[Indices]) -> Hull:
    """Closed parts as one hull. Parts that touch at edges are united like overlapping parts. If the
    union still touches itself at an edge, all parts but the first shrink by SHRINK_SHARE."""
    surfaces = [compacted(vertices, part) for part in parts]
    try:
        return Hull(*joined(surfaces))
    except ValueError:
        hulls = [Hull(*surface) for surface in surfaces]  # raises the fault of a single part
    try:
        union = united(hulls, at_least=-1.0)
        return union[0] if union else hulls[0]
    except ValueError:
        for points, _ in surfaces[1:]:
            points -= SHRINK_SHARE * (points - points.mean(axis=0))
        return Hull(*joined(surfaces))
