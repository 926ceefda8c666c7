"""Topology: edges, rims and parts of a triangle surface as it comes from a file.

Faces are (F, 3) indices; an edge is named by its two vertices, the lower index first.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import spread_lowest
from sim.kernels import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Edges(NamedTuple):
    """Of a surface: vertices (E, 2), how many faces (E,) each has, and which edge (3 F,) each of
    the faces' sides 01, 12, 20 is, first all of the first kind."""

    vertices: Indices
    count: Indices
    of_side: Indices


def directed(faces: Indices) -> Indices:
    """Sides (3 F, 2) of the faces as they run."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edges_of(faces: Indices) -> Edges:
    sides = np.sort(directed(faces), axis=1)
    base = int(faces.max()) + 1 if len(faces) else 1
    keys, of_side, count = np.unique(
        sides[:, 0] * base + sides[:, 1], return_inverse=True, return_counts=True
    )
    return Edges(np.stack([keys // base, keys % base], axis=1), count, np.ravel(of_side))


def face_pairs(faces: Indices, edges: Edges) -> tuple[Indices, NDArray[np.bool_]]:
    """Pairs (P, 2) of faces at edges that have two, and whether (P,) they run alike along it, as
    those of one winding do not."""
    two = edges.count[edges.of_side] == 2
    sides = np.flatnonzero(two)
    order = sides[np.argsort(edges.of_side[sides], kind="stable")].reshape(-1, 2)
    forward = directed(faces)[:, 0] < directed(faces)[:, 1]
    return order % len(faces), forward[order[:, 0]] == forward[order[:, 1]]


def parts_of(faces: Indices) -> Indices:
    """Part (F,) of each face, from 0: faces hang together where an edge has just two."""
    pairs, _ = face_pairs(faces, edges_of(faces))
    label = np.arange(len(faces))
    spread_lowest(pairs, label)
    return np.unique(label, return_inverse=True)[1].reshape(-1)


@kernel
def turn_alike(starts, neighbours, alike, turned_out):
    """Which faces (F,) are to be turned so that all of a part run as its first: neighbours and
    whether they run alike, those of face f from starts[f] on. -1: not yet known."""
    stack = np.empty(turned_out.size, np.int64)
    for first in range(turned_out.size):
        if turned_out[first] >= 0:
            continue
        turned_out[first], stack[0], size = 0, first, 1
        while size > 0:
            size -= 1
            f = stack[size]
            for i in range(starts[f], starts[f + 1]):
                g = neighbours[i]
                if turned_out[g] < 0:
                    turned_out[g] = turned_out[f] ^ alike[i]
                    stack[size] = g
                    size += 1


def wound_alike(faces: Indices) -> Indices:
    """The faces, those turned that do not run as the first one of their part."""
    if len(faces) == 0:
        return faces
    pairs, alike = face_pairs(faces, edges_of(faces))
    both = np.concatenate([pairs, pairs[:, ::-1]])
    order = np.argsort(both[:, 0], kind="stable")
    starts = np.searchsorted(both[order, 0], np.arange(len(faces) + 1))
    turned = np.full(len(faces), -1, dtype=np.int64)
    turn_alike(starts, both[order, 1], np.tile(alike, 2)[order].astype(np.int64), turned)
    return np.where(turned[:, None] == 1, faces[:, ::-1], faces)


def rims_of(faces: Indices) -> list[Indices]:
    """The loops of vertices around the holes of a surface, each as the missing faces would run."""
    edges = edges_of(faces)
    sides = directed(faces)[edges.count[edges.of_side] == 1]
    onward: dict[int, list[int]] = {}
    for a, b in sides[:, ::-1].tolist():
        onward.setdefault(a, []).append(b)
    loops = []
    for start in list(onward):
        while onward.get(start):
            loop, here = [], start
            while onward.get(here):
                loop.append(here)
                here = onward[here].pop()
                if here == start:
                    break
            loops.append(np.array(loop))
    return loops
