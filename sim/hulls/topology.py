"""Topology: edges, rims and connected parts of a triangle surface, given by its faces, (F, 3)
indices."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import spread_lowest
from sim.kernels import kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Edges(NamedTuple):
    """Edges of a surface. Side s of a surface of F faces is side s // F of face s % F.

    sides: (3 F, 2), the vertices of each side in the face's direction: all sides 01, then 12, then
    20. vertices: (E, 2) of each edge, the lower one first. count: (E,), the number of its faces.
    of_side: (3 F,), the edge of each side.
    """

    sides: Indices
    vertices: Indices
    count: Indices
    of_side: Indices

    @property
    def is_forward(self) -> Flags:
        """Whether each side (3 F,) runs from the lower vertex to the higher one."""
        return self.sides[:, 0] < self.sides[:, 1]

    @property
    def open_sides(self) -> Indices:
        """The sides whose edge has no other face."""
        return np.flatnonzero(self.count[self.of_side] == 1)


def directed(faces: Indices) -> Indices:
    """Sides (3 F, 2) of the faces, in the order of `Edges`."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edges_of(faces: Indices) -> Edges:
    sides = directed(faces)
    base = int(faces.max(initial=0)) + 1
    keys, of_side, count = np.unique(
        sides.min(axis=1) * base + sides.max(axis=1), return_inverse=True, return_counts=True
    )
    vertices = np.stack([keys // base, keys % base], axis=1)
    return Edges(sides, vertices, count, np.ravel(of_side))


def face_pairs(edges: Edges) -> tuple[Indices, Flags]:
    """The two faces (P, 2) at each edge that has exactly two, and whether (P,) both run along it in
    the same direction, so that their windings differ."""
    sides = np.flatnonzero(edges.count[edges.of_side] == 2)
    pairs = sides[np.argsort(edges.of_side[sides], kind="stable")].reshape(-1, 2)
    forward = edges.is_forward[pairs]
    return pairs % (len(edges.sides) // 3), forward[:, 0] == forward[:, 1]


def parts_of(faces: Indices) -> list[Indices]:
    """The connected parts of a surface, as faces (N, 3) each, in the order of their first faces.
    Two faces are connected if they are the only ones at an edge."""
    pairs, _ = face_pairs(edges_of(faces))
    label = np.arange(len(faces))
    spread_lowest(pairs, label)
    order = np.argsort(label, kind="stable")
    parts = np.split(faces[order], np.flatnonzero(np.diff(label[order])) + 1)
    return [part for part in parts if len(part)]


def edge_fault(faces: Indices) -> str:
    """Why a surface is not closed or not wound alike; "" if every edge has two faces that run in
    opposite directions along it."""
    edges = edges_of(faces)
    count = len(edges.count)
    if open_edges := int(np.count_nonzero(edges.count == 1)):
        return (
            f"the surface is not closed: {open_edges} of {count} edges have only one face; close "
            "its holes (`sim.hulls.repair.repair` does)"
        )
    if crowded := int(np.count_nonzero(edges.count > 2)):
        return (
            f"{crowded} of {count} edges have more than two faces; remove doubled faces, inner "
            "faces and sheets, or make separate hulls of parts that only touch"
        )
    forward = np.bincount(edges.of_side, weights=edges.is_forward)
    if twisted := int(np.count_nonzero(forward != 1)):
        return (
            f"the winding is inconsistent: {twisted} of {count} edges are run along twice in "
            "the same direction; wind all faces alike"
        )
    return ""


@kernel
def turn_alike(starts, neighbours, alike, turned_out):
    """Mark the faces (F,) to be reversed so that all faces of a part are wound like its first. The
    neighbours of face f, and their entries of `alike`, begin at starts[f]. -1: not yet known."""
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
    """The faces, reversed where they are not wound like the first face of their part."""
    pairs, alike = face_pairs(edges_of(faces))
    both = np.concatenate([pairs, pairs[:, ::-1]])
    order = np.argsort(both[:, 0], kind="stable")
    starts = np.searchsorted(both[order, 0], np.arange(len(faces) + 1))
    turned = np.full(len(faces), -1, dtype=np.int64)
    turn_alike(starts, both[order, 1], np.tile(alike, 2)[order].astype(np.int64), turned)
    return np.where(turned[:, None] == 1, faces[:, ::-1], faces)


def rims_of(faces: Indices) -> list[Indices]:
    """The loops of vertices around the holes of a surface, in the direction of the missing
    faces."""
    edges = edges_of(faces)
    onward: dict[int, list[int]] = {}
    for b, a in edges.sides[edges.open_sides].tolist():
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


def collapsed(faces: Indices) -> Flags:
    """Whether each face (F,) has a vertex twice."""
    a, b, c = faces.T
    return (a == b) | (b == c) | (c == a)


def compacted(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Vertices and faces of a surface, without the vertices that no face uses."""
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def joined(surfaces: Sequence[tuple[Array, Indices]]) -> tuple[Array, Indices]:
    """Vertices and faces of several surfaces in one; the surfaces share no vertex."""
    first = np.cumsum([0] + [len(vertices) for vertices, _ in surfaces])
    faces = [faces + n for (_, faces), n in zip(surfaces, first, strict=False)]
    return np.concatenate([vertices for vertices, _ in surfaces]), np.concatenate(faces)
