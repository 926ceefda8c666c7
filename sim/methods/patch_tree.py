"""Patch tree: a hull's surface cut into patches, with all that a step needs prepared.

See `patches` for what it is for. Heads are polynomials in d, the place relative to the patch's
centre, over ten monomials. For each node of the tree the integrals of

    monomial(d) n        and        r x monomial(d) n        (r from the hull frame's origin)

over its surface are the *moments*: a surely wet node contributes the head's ten coefficients
times its moments, exactly. Everything here happens once, in plain NumPy.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.hull import Hull
from sim.methods.linear import corner_weights
from sim.triangle import gauss_rule

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAF_TRIANGLES = 20
"""A node with at most so many triangles is not divided further: fewer make a deeper tree, more
open triangles that the waterline does not touch."""

MAX_TRIANGLES = 2_000_000
"""Splitting stops here: such a tree takes some gigabytes."""

MONOMIALS = 10
"""1, x, y, z, xx, xy, xz, yy, yz, zz."""

QUADRATIC = 4
"""The first quadratic one."""

# Columns of PatchTree.nodes before the moments and of PatchTree.leaves before the area.
MOMENTS = 6
LEAF_AREA = 6 * (MONOMIALS - QUADRATIC)

# Columns of PatchTree.links, a row for each node.
AFTER, VERTICES, VERTICES_END, TRIANGLES, TRIANGLES_END, LEAF = range(6)


@dataclass(frozen=True)
class PatchTree:
    """A hull cut into patches of a given radius; lengths in metres, body frame.

    patches: (P, 4), centre and radius; patch_nodes (P, 2), first node and end. Nodes come in
    the order of a walk that opens all: nodes (N, 6 + 60), the bounding box's middle from the
    patch's centre, its half sides, the moments; links (N, 6), the node AFTER the subtree and,
    for a leaf (LEAF is its number, -1 for other nodes), its ranges of vertices and triangles.
    Of the leaves: places (3, .) of the vertices from the patch's centre and their weights
    (., 6) as in `linear`; triangles (., 3), indices of vertices; areas (., 4), area vector and
    area; leaves (L, 37), what the six quadratic coefficients add to the vertex sum
    when all of the leaf is wet, and the leaf's area.
    """

    patches: Array
    patch_nodes: Integers
    nodes: Array
    links: Integers
    places: Array
    weights: Array
    triangles: Integers
    areas: Array
    leaves: Array


def build_tree(hull: Hull, radius: float, edge: float) -> PatchTree:
    """Cut a hull into patches of at most a radius [m], its triangles split until no edge is longer
    than `edge` [m] or the radius. Raises ValueError when that makes too many triangles."""
    return _Builder(_split(hull.vertices[hull.faces], min(edge, radius)), radius).tree()


def _split(corners: Array, edge: float) -> Array:
    """Halve triangles (N, 3, 3) across their longest side until none is longer than `edge`."""
    done = []
    while len(corners):
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        longest = sides.argmax(axis=1)
        long = sides.max(axis=1) > edge
        done.append(corners[~long])
        if 2 * np.count_nonzero(long) + sum(map(len, done)) > MAX_TRIANGLES:
            raise ValueError(
                f"the tolerance asks for triangles with edges below {edge:.3g} m, more than "
                f"{MAX_TRIANGLES} on this hull; ask for a larger tolerance or a calmer sea"
            )
        # turned so that the longest side comes first: a b is halved at m, c stays
        turn = (longest[long, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[long], turn[:, :, None], axis=1), 1, 0)
        m = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)])
    return np.concatenate(done)


def monomials(d: Array) -> Array:
    """The ten monomials (..., MONOMIALS) at places (..., 3)."""
    x, y, z = np.moveaxis(d, -1, 0)
    return np.stack([np.ones_like(x), x, y, z, x * x, x * y, x * z, y * y, y * z, z * z], axis=-1)


def triangle_moments(corners: Array, area_vectors: Array, centre: Array) -> Array:
    """Moments (N, MONOMIALS, 6) of triangles (N, 3, 3), places d taken from a centre (3,)."""
    points, weights = gauss_rule(3)  # exact to degree 4; the torque of a quadratic needs 3
    moments = np.zeros((len(corners), MONOMIALS, 6))
    for barycentric, weight in zip(points, weights, strict=True):
        place = np.einsum("c,ncx->nx", barycentric, corners)
        wrench = np.hstack([area_vectors, np.cross(place, area_vectors)])
        moments += weight * monomials(place - centre)[:, :, None] * wrench[:, None, :]
    return moments


class _Builder:
    """Grows the tree from the root; patches begin where a node's radius first suffices."""

    def __init__(self, corners: Array, radius: float) -> None:
        self.corners = corners
        self.radius = radius
        self.middles = corners.mean(axis=1)
        a, b, c = np.moveaxis(corners, 1, 0)
        self.area_vectors = 0.5 * np.cross(b - a, c - a)
        self.sizes = np.linalg.norm(self.area_vectors, axis=1)
        self.patches: list[tuple[Array, float, int, int]] = []
        self.nodes: list[Array] = []
        self.links: list[list[int]] = []
        self.vertices: list[Array] = []
        self.triangles: list[Array] = []
        self.areas: list[Array] = []
        self.leaves: list[Array] = []
        self.counts = [0, 0]  # vertices and triangles of the leaves so far

    def tree(self) -> PatchTree:
        self._grow(np.arange(len(self.corners)))
        centres, radii, first, end = zip(*self.patches, strict=True)
        vertices = np.concatenate(self.vertices)
        return PatchTree(
            patches=np.column_stack([np.array(centres), radii]),
            patch_nodes=np.column_stack([first, end]),
            nodes=np.array(self.nodes),
            links=np.array(self.links),
            places=np.ascontiguousarray(vertices[:, :3].T),
            weights=np.ascontiguousarray(vertices[:, 3:]),
            triangles=np.concatenate(self.triangles),
            areas=np.concatenate(self.areas),
            leaves=np.array(self.leaves),
        )

    def _grow(self, chosen: Integers) -> None:
        """Divide triangles until they fit a patch."""
        points = self.corners[chosen].reshape(-1, 3)
        # the middle of the area, not of the bounds: there the jet's odd errors cancel best
        centre = self.sizes[chosen] @ self.middles[chosen] / self.sizes[chosen].sum()
        radius = float(np.linalg.norm(points - centre, axis=1).max())
        if radius > self.radius and len(chosen) > 1:
            for half in self._halves(chosen):
                self._grow(chosen[half])
            return
        first = len(self.nodes)
        moments = triangle_moments(self.corners[chosen], self.area_vectors[chosen], centre)
        self._grow_patch(chosen, moments, centre)
        self.patches.append((centre, radius, first, len(self.nodes)))

    def _halves(self, chosen: Integers) -> tuple[Integers, Integers]:
        """Indices into `chosen` of two halves by number, apart along the axis in which the
        triangles spread most."""
        middles = self.middles[chosen]
        order = np.argsort(middles[:, np.ptp(middles, axis=0).argmax()], kind="stable")
        half = len(chosen) // 2
        return np.sort(order[:half]), np.sort(order[half:])

    def _grow_patch(self, chosen: Integers, moments: Array, centre: Array) -> None:
        """Add the node of triangles within a patch and, behind it, its subtree."""
        node = len(self.nodes)
        points = self.corners[chosen].reshape(-1, 3) - centre
        low, high = points.min(axis=0), points.max(axis=0)
        total = moments.sum(axis=0)
        self.nodes.append(np.concatenate([0.5 * (low + high), 0.5 * (high - low), total.ravel()]))
        self.links.append([0, 0, 0, 0, 0, -1])
        if len(chosen) <= LEAF_TRIANGLES:
            self.links[node][VERTICES:] = self._add_leaf(chosen, total, centre)
        else:
            for half in self._halves(chosen):
                self._grow_patch(chosen[half], moments[half], centre)
        self.links[node][AFTER] = len(self.nodes)

    def _add_leaf(self, chosen: Integers, moments: Array, centre: Array) -> list[int]:
        """Add the triangles of a leaf; returns its part of the node's links."""
        corners, area = self.corners[chosen], self.area_vectors[chosen]
        points, which = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        which = which.reshape(-1, 3)
        weights = corner_weights(corners, area, which, len(points))
        by_vertices = np.einsum("vk,vj->kj", monomials(points - centre), weights)
        vertex, triangle = self.counts
        self.counts = [vertex + len(points), triangle + len(chosen)]
        self.vertices.append(np.hstack([points - centre, weights]))
        self.triangles.append(which + vertex)
        self.areas.append(np.column_stack([area, self.sizes[chosen]]))
        bend = (moments - by_vertices)[QUADRATIC:]
        self.leaves.append(np.append(bend.ravel(), self.sizes[chosen].sum()))
        return [vertex, self.counts[0], triangle, self.counts[1], len(self.leaves) - 1]


def joined(trees: Sequence[PatchTree]) -> PatchTree:
    """Several trees as one, patches in order, with all indices moved accordingly."""
    patch_nodes, links, triangles = [], [], []
    nodes = vertices = faces = leaves = 0
    for tree in trees:
        patch_nodes.append(tree.patch_nodes + nodes)
        moved = tree.links + [nodes, vertices, vertices, faces, faces, leaves]
        moved[tree.links[:, LEAF] < 0, LEAF] = -1
        links.append(moved)
        triangles.append(tree.triangles + vertices)
        nodes += len(tree.nodes)
        vertices += len(tree.weights)
        faces += len(tree.triangles)
        leaves += len(tree.leaves)
    return PatchTree(
        patches=np.concatenate([tree.patches for tree in trees]),
        patch_nodes=np.concatenate(patch_nodes),
        nodes=np.concatenate([tree.nodes for tree in trees]),
        links=np.concatenate(links),
        places=np.concatenate([tree.places for tree in trees], axis=1),
        weights=np.concatenate([tree.weights for tree in trees]),
        triangles=np.concatenate(triangles),
        areas=np.concatenate([tree.areas for tree in trees]),
        leaves=np.concatenate([tree.leaves for tree in trees]),
    )


def packed(tree: PatchTree) -> tuple[Array, Integers]:
    """All arrays of a tree in two: each array handed to a kernel costs a tenth of a microsecond."""
    sizes = [len(a) for a in (tree.patches, tree.nodes, tree.weights, tree.triangles, tree.leaves)]
    reals = (tree.patches, tree.nodes, tree.places, tree.weights, tree.areas, tree.leaves)
    integers = (np.array(sizes), tree.patch_nodes, tree.links, tree.triangles)
    return (
        np.concatenate([array.ravel() for array in reals]),
        np.concatenate([array.ravel() for array in integers]).astype(np.int64),
    )


@njit(inline="always")
def _block(array, start, rows, columns):
    end = start + rows * columns
    return array[start:end].reshape(rows, columns), end


@njit(inline="always")
def unpacked(reals, integers):
    """The arrays of PatchTree, in its order, from those of `packed`."""
    p, n, v, t, m = integers[0], integers[1], integers[2], integers[3], integers[4]
    patches, at = _block(reals, 0, p, 4)
    nodes, at = _block(reals, at, n, MOMENTS + 6 * MONOMIALS)
    places, at = _block(reals, at, 3, v)
    weights, at = _block(reals, at, v, 6)
    areas, at = _block(reals, at, t, 4)
    leaves, at = _block(reals, at, m, LEAF_AREA + 1)
    patch_nodes, at = _block(integers, 5, p, 2)
    links, at = _block(integers, at, n, 6)
    triangles, at = _block(integers, at, t, 3)
    return patches, patch_nodes, nodes, links, places, weights, triangles, areas, leaves
