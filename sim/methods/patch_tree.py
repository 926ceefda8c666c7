"""Patch tree: a hull's surface cut into patches, with all that a step needs prepared.

See `patches` for what it is for. Heads are polynomials in d, the place relative to the patch's
centre, over twenty monomials. For each node of the tree the integrals of

    monomial(d) n        and        r x monomial(d) n        (r from the hull frame's origin)

over its surface are the *moments*: a surely wet node contributes the head's coefficients
times its moments, exactly. Everything here happens once, in plain NumPy.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, sides, split_triangles
from sim.hull import Hull
from sim.kernels import inline, record
from sim.methods.linear import corner_shares
from sim.methods.polynomial import (
    BENDING,
    LINEAR,
    MONOMIALS,
    QUADRATICS,
    local_quadratic,
    monomials,
)
from sim.triangle import gauss_rule

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Table = NDArray[np.void]

LEAF_TRIANGLES = LEAF_VERTICES = 24
"""A node with no more of them is not divided further: fewer make a deeper tree and more leaves on
the waterline, more make more open triangles that the waterline does not touch. All leaves have
room for so many, so that loops over them have a fixed length and vectorise whole; a multiple of
gerstner.LANES, at most 32."""

APART = 1.1
"""A triangle farther than so many radii from all seeds of patches becomes one itself."""

LLOYD_ROUNDS, MORE_SEEDS = 15, 10
"""How often seeds move, and how often there are more of them: beyond that little changes."""

MOST_CLUSTERS = 64
"""What needs more patches than that is halved before it is clustered, which takes a time as the
number of triangles times that of clusters."""

TINY = 1e-300
"""Instead of areas that are 0, so that a cluster of such triangles has a middle."""

MAX_TRIANGLES = 2_000_000
"""Splitting stops here: such a tree takes some gigabytes."""

CORNER_BITS = 5
"""Bits for a corner in a triangle's code (see `triangle_codes`)."""

CORNER = (1 << CORNER_BITS) - 1
"""Mask for one of them."""

CORNER_SET = 5 * CORNER_BITS
"""Where the set of corners begins in a triangle's code."""

PATCH = record(x="f8", y="f8", z="f8", radius="f8", first="i8", end="i8")
"""Centre and radius [m] of a patch in the body frame, its first node and where its nodes end."""

NODE = record(
    x="f8", y="f8", z="f8", half_x="f8", half_y="f8", half_z="f8", after="i8", leaf="i8"
)  # fmt: skip
"""A node's bounding box [m], its middle from the patch's centre and its half sides, the node after
its subtree and the number of its leaf, -1 for other nodes. All a walk needs is one line of the
cache."""

MOMENTS = record(linear=("f8", (6, LINEAR)), bending=("f4", (6, BENDING)))
"""A node's moments, by group of monomials."""

LEAF = record(
    x=("f8", LEAF_VERTICES), y=("f8", LEAF_VERTICES), z=("f8", LEAF_VERTICES),
    weights=("f8", (6, LEAF_VERTICES)), bends=("f8", (6, QUADRATICS)),
    middle_x="f8", middle_y="f8", middle_z="f8",
    triangles=("i8", LEAF_TRIANGLES), fills_lines=("f8", 5),
)  # fmt: skip
"""A leaf: places of its vertices from the patch's centre [m] and their weights as in `linear`, the
last ones of no weight; bends, what the quadratic coefficients at the leaf's middle add to the
vertex sum when all of the leaf is wet; triangles as `triangle_codes` has them, 0 for none."""


class PatchTree(NamedTuple):
    """A hull cut into patches of a given radius: tables of PATCH, NODE, MOMENTS and LEAF. Nodes
    come in the order of a walk that opens all, moments beside them."""

    patches: Table
    nodes: Table
    moments: Table
    leaves: Table


def triangle_codes(corners: Integers) -> Integers:
    """Triangles (N, 3) of vertices below 32 as one number each: a, b, c, a, b in CORNER_BITS each,
    from which the corners are read in any order, then the set of corners as bits."""
    bits = (np.int64(1) << corners).sum(axis=1) << CORNER_SET
    for place, corner in enumerate((0, 1, 2, 0, 1)):
        bits |= corners[:, corner] << place * CORNER_BITS
    return bits


@inline
def corner(code, i):
    """Corner number i of a triangle's code, 0 to 4: of a, b, c, a, b."""
    return code >> i * CORNER_BITS & CORNER


@inline
def corner_set(code):
    """The corners of a triangle's code as bits."""
    return code >> CORNER_SET


@inline
def odd_corner_first(code, heads, n):
    """The code of a triangle that the water cuts, turned so that the only wet or the only dry
    corner comes first; heads of its leaf's vertices in row n."""
    wet_a = heads[n, corner(code, 0)] > 0.0
    wet_b = heads[n, corner(code, 1)] > 0.0
    wet_c = heads[n, corner(code, 2)] > 0.0
    return code >> CORNER_BITS * ((wet_b != wet_c) * (1 + (wet_a != wet_c)))


def build_tree(hull: Hull, radius: float, edge: float) -> PatchTree:
    """Cut a hull into patches of at most a radius [m], its triangles split until no edge is longer
    than `edge` [m] or the radius. Raises ValueError when that makes too many triangles."""
    edge = min(edge, radius)
    try:
        corners = split_triangles(
            hull.vertices[hull.faces], lambda c: sides(c).max(axis=1) > edge, MAX_TRIANGLES
        )
    except ValueError as error:
        raise ValueError(
            f"the tolerance asks for triangles with edges below {edge:.3g} m, {error} "
            "on this hull; ask for a larger tolerance or a calmer sea"
        ) from None
    return _Builder(corners, radius).tree()


def triangle_moments(corners: Array, area_vectors: Array, centres: Array) -> Array:
    """Moments (N, 6, MONOMIALS) of triangles (N, 3, 3), places d taken from centres (N, 3)."""
    points, weights = gauss_rule(3)  # exact to degree 4: what the torque of a cubic needs
    moments = np.zeros((len(corners), 6, MONOMIALS))
    for barycentric, weight in zip(points, weights, strict=True):
        place = np.einsum("c,ncx->nx", barycentric, corners)
        wrench = np.hstack([area_vectors, np.cross(place, area_vectors)])
        moments += weight * wrench[:, :, None] * monomials(place - centres)[:, None, :]
    return moments


def enclosing_ball(corners: Array, sizes: Array) -> tuple[Array, float]:
    """Centre (3,) and radius [m] of a ball around triangles (N, 3, 3) of areas (N,). The centre is
    the middle of the area, not of the bounds: there the jet's errors cancel best."""
    centre = sizes @ corners.mean(axis=1) / sizes.sum()
    return centre, float(np.linalg.norm(corners - centre, axis=2).max())


def clusters(corners: Array, sizes: Array, radius: float) -> Integers:
    """Which cluster each of the triangles (N, 3, 3) of areas (N,) belongs to; nearly all clusters
    lie within a radius [m] of the middles of their areas.

    Triangles farthest from all before become seeds (Gonzalez 1985); each cluster is what is next
    to a seed, which moves to its middle, and again (Lloyd 1982): that makes clusters round and of
    like size. Of those still too large the farthest triangle becomes a seed, too.
    """
    middles = corners.mean(axis=1)
    seeds, apart = middles[:1], np.linalg.norm(middles - middles[0], axis=1)
    while apart.max() > APART * radius:
        seeds = np.vstack([seeds, middles[apart.argmax()]])
        apart = np.minimum(apart, np.linalg.norm(middles - seeds[-1], axis=1))
    for _ in range(MORE_SEEDS):
        nearest, seeds = _lloyd(middles, sizes, seeds)
        distances = np.linalg.norm(corners - seeds[nearest, None], axis=2).max(axis=1)
        order = np.argsort(distances, kind="stable")
        farthest = np.zeros(len(seeds), dtype=np.int64)
        farthest[nearest[order]] = order  # the last one stays
        large = (distances[farthest] > radius) & (np.bincount(nearest, minlength=len(seeds)) > 1)
        if not large.any():
            break
        seeds = np.vstack([seeds, middles[farthest[large]]])
    return nearest


def _lloyd(points: Array, sizes: Array, seeds: Array) -> tuple[Integers, Array]:
    """For each point (N, 3) the seed (K, 3) next to it, and the seeds moved to those points'
    middles, LLOYD_ROUNDS times over."""
    for _ in range(LLOYD_ROUNDS):
        nearest = np.argmin(np.sum(seeds**2, axis=1) - 2.0 * points @ seeds.T, axis=1)
        total = np.bincount(nearest, sizes, len(seeds))[:, None]
        sums = [np.bincount(nearest, sizes * along, len(seeds)) for along in points.T]
        seeds = np.where(total > 0.0, np.transpose(sums) / np.maximum(total, TINY), seeds)
    return nearest, seeds


class _Builder:
    """Grows the tree from the root; patches begin where a node's radius first suffices. What can be
    is computed for all triangles at once: there may be many thousand patches."""

    def __init__(self, corners: Array, radius: float) -> None:
        self.corners = corners
        self.radius = radius
        self.middles = corners.mean(axis=1)
        self.area_vectors = area_vectors(corners)
        self.sizes = np.maximum(np.linalg.norm(self.area_vectors, axis=1), TINY)
        self.shares = corner_shares(corners, self.area_vectors)
        self.points, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        self.numbers = numbers.reshape(-1, 3)
        self.boxes: list[tuple[Array, Array]] = []
        self.afters: list[int] = []
        self.leaf_numbers: list[int] = []
        self.node_moments: list[Array] = []
        self.leaves: list[tuple[Array, Array, Array, Array, Integers]] = []

    def tree(self) -> PatchTree:
        found = list(self._patches(np.arange(len(self.corners))))
        centres = np.empty((len(self.corners), 3))
        for chosen, centre, _ in found:
            centres[chosen] = centre
        self.moments = triangle_moments(self.corners, self.area_vectors, centres)
        patches = np.zeros(len(found), PATCH)
        for patch, (chosen, centre, radius) in zip(patches, found, strict=True):
            patch["first"] = len(self.boxes)
            self._grow(chosen, centre)
            patch["x"], patch["y"], patch["z"] = centre
            patch["radius"], patch["end"] = radius, len(self.boxes)
        return PatchTree(patches, *self._node_tables(), self._leaf_table())

    def _node_tables(self) -> tuple[Table, Table]:
        nodes, moments = np.zeros(len(self.boxes), NODE), np.zeros(len(self.boxes), MOMENTS)
        middles, halves = (np.array(part).T for part in zip(*self.boxes, strict=True))
        nodes["x"], nodes["y"], nodes["z"] = middles
        nodes["half_x"], nodes["half_y"], nodes["half_z"] = halves
        nodes["after"], nodes["leaf"] = self.afters, self.leaf_numbers
        of_nodes = np.array(self.node_moments)
        moments["linear"], moments["bending"] = np.split(of_nodes, [LINEAR], axis=2)
        return nodes, moments

    def _leaf_table(self) -> Table:
        leaves = np.zeros(len(self.leaves), LEAF)
        places, weights, bends, middles, triangles = map(np.array, zip(*self.leaves, strict=True))
        leaves["x"], leaves["y"], leaves["z"] = np.moveaxis(places, 1, 0)
        leaves["weights"], leaves["bends"], leaves["triangles"] = weights, bends, triangles
        leaves["middle_x"], leaves["middle_y"], leaves["middle_z"] = middles.T
        return leaves

    def _patches(self, chosen: Integers) -> Iterator[tuple[Integers, Array, float]]:
        """Divide triangles until they fit a patch: its triangles, centre and radius."""
        centre, radius = enclosing_ball(self.corners[chosen], self.sizes[chosen])
        if radius <= self.radius or len(chosen) == 1:
            yield chosen, centre, radius
            return
        for part in self._parts(chosen):
            yield from self._patches(part)

    def _parts(self, chosen: Integers) -> list[Integers]:
        """Triangles too many for a patch in clusters that may fit one, or, where that would be too
        many or but one, in halves."""
        sizes = self.sizes[chosen]
        if sizes.sum() < MOST_CLUSTERS * np.pi * self.radius**2:
            nearest = clusters(self.corners[chosen], sizes, self.radius)
            if nearest.any():
                return [chosen[nearest == cluster] for cluster in np.unique(nearest)]
        along = self._along(chosen)
        near = along < 0.5 * (along.min() + along.max())
        if near.all() or not near.any():
            near = np.arange(len(chosen)) < len(chosen) // 2
        return [chosen[near], chosen[~near]]

    def _along(self, chosen: Integers) -> Array:
        """Where triangles lie along the axis in which they spread most."""
        middles = self.middles[chosen] - self.middles[chosen].mean(axis=0)
        _, axes = np.linalg.eigh(middles.T @ middles)
        return middles @ axes[:, 2]

    def _grow(self, chosen: Integers, centre: Array) -> Array:
        """Add the node of triangles within a patch and, behind it, its subtree; returns its
        moments (6, MONOMIALS)."""
        node = len(self.boxes)
        points = self.corners[chosen].reshape(-1, 3) - centre
        low, high = points.min(axis=0), points.max(axis=0)
        middle = 0.5 * (low + high)
        self.boxes.append((middle, 0.5 * (high - low)))
        self.afters.append(0)
        self.leaf_numbers.append(-1)
        self.node_moments.append(np.zeros(0))
        vertices = np.unique(self.numbers[chosen]) if len(chosen) <= LEAF_TRIANGLES else ()
        if 0 < len(vertices) <= LEAF_VERTICES:
            self.leaf_numbers[node] = len(self.leaves)
            moments = self._add_leaf(chosen, vertices, middle, centre)
        else:
            order = np.argsort(self._along(chosen), kind="stable")
            leaves = max(2, -(-len(chosen) // LEAF_TRIANGLES))
            near = len(chosen) * (leaves // 2) // leaves  # so that leaves become full
            moments = self._grow(chosen[np.sort(order[:near])], centre)
            moments = moments + self._grow(chosen[np.sort(order[near:])], centre)
        self.afters[node] = len(self.boxes)
        self.node_moments[node] = moments
        return moments

    def _add_leaf(
        self, chosen: Integers, vertices: Integers, middle: Array, centre: Array
    ) -> Array:
        """Add a leaf of triangles with these vertices, ascending; returns its moments: exact up to
        second order, of the third what `local_quadratic` has."""
        count, which = len(vertices), np.searchsorted(vertices, self.numbers[chosen])
        weights = np.zeros((LEAF_VERTICES, 6))
        np.add.at(weights, which.ravel(), self.shares[chosen].reshape(-1, 6))
        places = np.empty((LEAF_VERTICES, 3))
        places[:count] = self.points[vertices] - centre
        places[count:] = places[0]
        moments = weights.T @ monomials(places)
        bends = np.zeros((6, QUADRATICS))
        bends[:, :6] = (self.moments[chosen].sum(axis=0) - moments)[:, LINEAR : LINEAR + 6]
        moments[:, LINEAR:] += bends[:, :6] @ local_quadratic(*middle)
        triangles = np.zeros(LEAF_TRIANGLES, dtype=np.int64)
        triangles[: len(chosen)] = triangle_codes(which)
        self.leaves.append((places.T, weights.T, bends, middle, triangles))
        return moments


def joined(trees: Sequence[PatchTree]) -> PatchTree:
    """Several trees as one, patches in order, with all indices moved accordingly."""
    moved, nodes, leaves = [], 0, 0
    for tree in trees:
        patches, of_tree = tree.patches.copy(), tree.nodes.copy()
        patches["first"] += nodes
        patches["end"] += nodes
        of_tree["after"] += nodes
        of_tree["leaf"][of_tree["leaf"] >= 0] += leaves
        moved.append(PatchTree(patches, of_tree, tree.moments, tree.leaves))
        nodes += len(tree.nodes)
        leaves += len(tree.leaves)
    return PatchTree(*(np.concatenate(tables) for tables in zip(*moved, strict=True)))
