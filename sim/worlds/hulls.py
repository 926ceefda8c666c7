"""Hulls: the tables of a model's hulls, bodies and degrees of freedom for the programs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.methods import Linear, Patches
from sim.methods.linear import surface_tables
from sim.methods.patches.tree import PatchTree, joined
from sim.mjcf.floats import FloatingGeom, drags_of, moving_dofs
from sim.resistance.elements import ELEMENTS
from sim.resistance.probes import PROBE
from sim.resistance.reaction import hull_tables
from sim.worlds.programs import single

Table = NDArray[np.void]
Integers = NDArray[np.int32]

PIECE_LEAVES = 4
"""Most leaves of a tree that one thread walks. Fewer make more threads and more sums to add up."""

PIECE_VERTICES = 64
"""Most vertices of a linear hull that one thread sums."""


def rows(values: Sequence[Any], width: int) -> Integers:
    """Rows of integers (N, width), at least one."""
    found = np.array(values, dtype=np.int32).reshape(-1, width)
    return found if len(found) else np.full((1, width), -1, dtype=np.int32)


@dataclass
class PatchTables:
    """The hulls that are cut into patches.

    rows: hull, patch and tree of every patch of every hull; pieces: row, patch, first node and end
    of every piece; spans: first piece and end by hull.
    """

    tables: PatchTree | None
    rows: Integers
    pieces: Integers
    spans: dict[int, tuple[int, int]]
    count: int


def patch_tables(
    hulls: dict[int, Patches], trees: list[PatchTree], which: dict[int, int]
) -> PatchTables:
    """PatchTables of hulls by number, with the number of each hull's tree."""
    tables = joined(trees) if trees else None
    first = np.cumsum([0] + [len(tree.patches) for tree in trees])
    of_patches, pieces, spans = [], [], {}
    for hull in hulls:
        start, w = len(pieces), which[hull]
        for patch in range(first[w], first[w + 1]):
            assert tables is not None
            if tables.patches["level"][patch] > 0:  # worlds use the smallest patches everywhere
                continue
            row = len(of_patches)
            of_patches.append((hull, patch, w))
            span = int(tables.patches["first"][patch]), int(tables.patches["end"][patch])
            pieces += [(row, patch, *piece) for piece in subtrees(tables.nodes, *span)]
        spans[hull] = start, len(pieces)
    return PatchTables(tables, rows(of_patches, 3), rows(pieces, 4), spans, len(of_patches))


def subtrees(nodes: Table, first: int, end: int) -> list[tuple[int, int]]:
    """Ranges of nodes with at most PIECE_LEAVES leaves each, which cover the leaves of a range."""
    found, node = [], first
    leaves = np.concatenate([[0], np.cumsum(nodes["leaf"][first:end] >= 0)])
    while node < end:
        after = int(nodes["after"][node])
        if leaves[after - first] - leaves[node - first] <= PIECE_LEAVES:
            found.append((node, after))
            node = after
        else:
            node += 1  # to its first child
    return found


@dataclass
class LinearTables:
    """The hulls of the linear method.

    rows: hull, vertex and shape of every vertex of every hull; spans (pieces, 4): first row and
    number of rows of a piece's hull, its first vertex, 0; ranges (pieces, 4): first vertex and end
    in the hull, first face and end in `faces`; counts: first piece and end of a piece's hull.
    """

    vertices: Table
    faces: Table
    shapes: Table
    rows: Integers
    spans: Integers
    ranges: Integers
    counts: Integers
    of_hulls: dict[int, tuple[int, int]]


def linear_tables(hulls: dict[int, Linear]) -> LinearTables:
    """LinearTables of hulls by number. Hulls with the same method share their tables."""
    made: dict[int, tuple[int, int, int]] = {}
    surfaces, of_vertices, spans, ranges, counts, of_hulls = [], [], [], [], [], {}
    vertices = faces = 0
    for number, method in hulls.items():
        if id(method.hull) not in made:
            made[id(method.hull)] = len(surfaces), vertices, faces
            surfaces.append(surface_tables(method.hull))
            vertices += len(surfaces[-1].vertices)
            faces += len(surfaces[-1].faces)
        shape, first_vertex, first_face = made[id(method.hull)]
        size, face_count = len(surfaces[shape].vertices), len(surfaces[shape].faces)
        start, pieces = len(of_vertices), -(-size // PIECE_VERTICES)
        of_vertices += [(number, first_vertex + v, shape) for v in range(size)]
        cuts = np.linspace(0, size, pieces + 1).astype(int)
        face_cuts = first_face + np.linspace(0, face_count, pieces + 1).astype(int)
        of_hulls[number] = len(spans), len(spans) + pieces
        spans += [(start, size, first_vertex, 0)] * pieces
        ranges += zip(cuts[:-1], cuts[1:], face_cuts[:-1], face_cuts[1:], strict=True)
        counts += [of_hulls[number]] * pieces
    vertices_of, faces_of, shapes = (
        np.concatenate(tables) for tables in zip(*surfaces, strict=True)
    )
    return LinearTables(
        vertices_of, faces_of, shapes, rows(of_vertices, 3), rows(spans, 4), rows(ranges, 4),
        rows(counts, 2), of_hulls,
    )  # fmt: skip


@dataclass
class ReactionTables:
    """The hulls with drag, added mass or damping.

    rows: hull, geom, body and root of each; first_dof, dofs: the degrees of freedom that move it.
    probes: records with the shares of the elements of one thread each, (lanes,) for every probe.
    """

    hulls: Table
    surfaces: Table
    probes: Table
    rows: Integers
    first_dof: Integers
    dofs: Integers
    numbers: dict[int, int]


def reaction_tables(
    model: mujoco.MjModel, floats: Sequence[FloatingGeom], lanes: int
) -> ReactionTables | None:
    """ReactionTables for blocks of `lanes` threads; None without any resistance."""
    numbers = {i: n for n, i in enumerate(i for i, f in enumerate(floats) if f.drag)}
    if not numbers:
        return None
    hulls, surfaces, probes = hull_tables(drags_of(floats))
    of_hulls, first, dofs = [], [0], []
    for i in numbers:
        f = floats[i]
        of_hulls.append((i, f.geom, f.body, model.body_rootid[f.body]))
        dofs += moving_dofs(model, f.body)
        first.append(len(dofs))
    return ReactionTables(
        single(hulls), shared(surfaces, lanes),
        shared(np.concatenate([probes, np.zeros(1, PROBE)]), lanes), rows(of_hulls, 4),
        np.array(first, np.int32), np.array(dofs or [0], np.int32), numbers,
    )  # fmt: skip


def shared(table: Table, lanes: int) -> Table:
    """SURFACE or PROBE rows, each as (lanes,) records with the elements of one thread each."""
    share = ELEMENTS // lanes
    kinds = {name: table.dtype[name] for name in table.dtype.names or ()}
    kind = [
        (name, "f4", (share,)) if each.subdtype else (name, "i4") for name, each in kinds.items()
    ]
    found = np.zeros((len(table), lanes), np.dtype(kind, align=True))
    for name, each in kinds.items():
        rows_of = table[name].reshape(len(table), lanes, share) if each.subdtype else None
        found[name] = table[name][:, None] if rows_of is None else rows_of
    return found.ravel()


@dataclass
class BodyTables:
    """The bodies that float and the degrees of freedom that move them.

    bodies: id, root, first float and end; floats: hull, geom and reaction; dofs: id, and first and
    end in `moved`, which holds numbers of bodies; entries: address in M, row and column, and first
    and end in `moved` of the bodies with a reaction; simple: number of a body of whose M only the
    diagonal is stored, its first degree of freedom and their number; diagonal: addresses in M.
    """

    bodies: Integers
    floats: Integers
    dofs: Integers
    moved: Integers
    entries: Integers
    entry_spans: Integers
    simple: Integers
    diagonal: Integers
    entry_count: int
    simple_count: int


def body_tables(
    model: mujoco.MjModel, floats: Sequence[FloatingGeom], numbers: dict[int, int]
) -> BodyTables:
    """BodyTables. numbers: of the reactions by hull."""
    bodies, of_floats, chains, is_resisted = [], [], [], []
    for body in sorted({f.body for f in floats}):
        own = [i for i, f in enumerate(floats) if f.body == body]
        end = len(of_floats) + len(own)
        bodies.append((body, model.body_rootid[body], len(of_floats), end))
        of_floats += [(i, floats[i].geom, numbers.get(i, -1)) for i in own]
        chains.append(moving_dofs(model, body))
        is_resisted.append(any(i in numbers for i in own))
    lengths, starts = model.M_rownnz, model.M_rowadr
    is_simple = [len(chain) > 1 and lengths[chain[-1]] == 1 for chain in chains]
    dofs, moved, entries, spans = [], [], [], []
    for dof in sorted({dof for chain in chains for dof in chain}):
        first = len(moved)
        moved += [b for b, chain in enumerate(chains) if dof in chain]
        dofs.append((dof, first, len(moved)))
        first = len(moved)
        moved += [
            b for b, chain in enumerate(chains) if dof in chain and is_resisted[b]
            and not is_simple[b]
        ]  # fmt: skip
        if len(moved) > first:
            for c in range(lengths[dof]):
                address = starts[dof] + c
                entries.append((address, dof, model.M_colind[address]))
                spans.append((first, len(moved)))
    simple = [
        (b, chains[b][0], len(chains[b])) for b in range(len(bodies))
        if is_simple[b] and is_resisted[b]
    ]  # fmt: skip
    diagonal = (starts + lengths - 1).astype(np.int32)
    return BodyTables(
        rows(bodies, 4), rows(of_floats, 3), rows(dofs, 3), np.array(moved or [0], np.int32),
        rows(entries, 3), rows(spans, 2), rows(simple, 3),
        diagonal if len(diagonal) else np.zeros(1, np.int32), len(entries), len(simple),
    )  # fmt: skip
