"""Tidying: a surface as it comes from a file, with vertices that are almost one merged, and without
faces that have no area or are there twice."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import spread_lowest
from sim.hulls.topology import collapsed, compacted

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MERGED_WITHIN = 1e-5
"""Share of a surface's size within which vertices are merged."""


class Tidied(NamedTuple):
    """Vertices (V, 3) [m] and faces (F, 3), and what went: vertices that were merged into others,
    faces without area, and faces that were there already."""

    vertices: Array
    faces: Indices
    merged: int
    flat: int
    doubled: int


def tidied(vertices: Array, faces: Indices, within: float) -> Tidied:
    """A surface tidied, with vertices closer than a distance [m] merged; what stays keeps its
    order."""
    before, every = len(np.unique(faces)), len(faces)
    vertices, faces = _merged(vertices, faces, within)
    faces = faces[~collapsed(faces)]
    first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    flat, doubled = every - len(faces), len(faces) - len(first)
    return Tidied(vertices, faces[np.sort(first)], before - len(vertices), flat, doubled)


def _merged(vertices: Array, faces: Indices, within: float) -> tuple[Array, Indices]:
    """Vertices closer than a distance [m] as one; faces keep their places and may collapse. Grids
    of cells twice that wide, at eight offsets, find all such vertices."""
    label = np.arange(len(vertices))
    places = (vertices - vertices.min(axis=0)) / (2.0 * within)
    for shift in np.ndindex(2, 2, 2):
        cells = np.floor(places + 0.5 * np.array(shift)).astype(np.int64)
        sizes = cells.max(axis=0) + 2
        keys = cells @ [sizes[1] * sizes[2], sizes[2], 1]  # one number for each cell
        _, first, group = np.unique(keys, return_index=True, return_inverse=True)
        spread_lowest(np.stack([np.arange(len(keys)), first[group.reshape(-1)]], axis=1), label)
    return compacted(vertices, label[faces])


def size_of(vertices: Array) -> float:
    """Diagonal [m] of the box around vertices."""
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))
