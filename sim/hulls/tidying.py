"""Tidying: merges almost equal vertices of a surface, and drops faces without area and doubled
faces."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import spread_lowest
from sim.hulls.topology import collapsed, compacted

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MERGING_SHARE = 1e-5
"""Share of a surface's size within which vertices are merged."""


class Tidied(NamedTuple):
    """A surface, vertices (V, 3) [m] and faces (F, 3), and counts of the vertices that were merged
    into others, of the dropped faces without area, and of the dropped doubles of faces."""

    vertices: Array
    faces: Indices
    merged: int
    flat: int
    doubled: int


def tidied(vertices: Array, faces: Indices, within: float) -> Tidied:
    """Tidy a surface, with vertices closer than `within` [m] merged. The rest keeps its order."""
    vertices_before, faces_before = len(np.unique(faces)), len(faces)
    vertices, faces = _merged(vertices, faces, within)
    faces = faces[~collapsed(faces)]
    first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    merged, flat = vertices_before - len(vertices), faces_before - len(faces)
    return Tidied(vertices, faces[np.sort(first)], merged, flat, len(faces) - len(first))


def _merged(vertices: Array, faces: Indices, within: float) -> tuple[Array, Indices]:
    """Merge vertices closer than `within` [m]. Faces keep their order and may collapse. Grids of
    cells twice as wide, at eight offsets, find all such vertices."""
    label = np.arange(len(vertices))
    coordinates = (vertices - vertices.min(axis=0)) / (2.0 * within)
    for shift in np.ndindex(2, 2, 2):
        cells = np.floor(coordinates + 0.5 * np.array(shift)).astype(np.int64)
        sizes = cells.max(axis=0) + 2
        keys = cells @ [sizes[1] * sizes[2], sizes[2], 1]  # one number for each cell
        _, first, group = np.unique(keys, return_index=True, return_inverse=True)
        spread_lowest(np.stack([np.arange(len(keys)), first[group.reshape(-1)]], axis=1), label)
    return compacted(vertices, label[faces])


def size_of(vertices: Array) -> float:
    """Diagonal [m] of the box around vertices."""
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))
