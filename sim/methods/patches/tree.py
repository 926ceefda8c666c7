"""Patch tree: a hull's surface cut into patches, with everything that a step needs.

See `patches` for its use. Heads are polynomials in d, the position relative to the patch's centre,
over twenty monomials. For each node of the tree, the integrals of

    monomial(d) n        and        r x monomial(d) n        (r from the hull frame's origin)

over its surface are its *moments*. A surely wet node contributes exactly the head's coefficients
times its moments. A tree is built once.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import across, area_vectors, cross, distinct_points, sides, split_triangles
from sim.hulls.hull import Hull
from sim.hulls.triangle import gauss_rule
from sim.kernels import inline, kernel, record, scratch, scratch_zeros
from sim.methods.linear import corner_shares
from sim.methods.patches.polynomial import (
    BENDING,
    LINEAR,
    MONOMIALS,
    QUADRATICS,
    local_quadratic,
    monomials,
    moved_monomials,
)
from sim.precision import single

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Table = NDArray[np.void]

LEAF_TERMS = 32
"""Number of terms in the sums over a leaf: its vertices and its quadratic coefficients. All leaves
have this size in memory, so that loops over them have a fixed length and vectorise. It is a
multiple of gerstner.LANES. Smaller leaves make a deeper tree and more leaves on the waterline.
Larger ones make more opened triangles that the waterline does not touch."""

LEAF_TRIANGLES, LEAF_VERTICES = 31, LEAF_TERMS - QUADRATICS
"""Maximum numbers of triangles and vertices of a leaf. A node that exceeds neither is not divided
further. Sets of triangles are the bits of an integer, which has 31 besides its sign in single
precision."""

SEED_DISTANCE_RADII = 1.5
"""Distance, in patch radii, from all seeds of patches beyond which a triangle becomes a seed
itself."""

LLOYD_ROUNDS, SEED_ROUNDS = 15, 10
"""Number of times that seeds are moved, and that seeds are added. More rounds change little."""

MOST_CLUSTERS = 64
"""Estimated number of patches above which triangles are halved before they are clustered.
Clustering takes a time proportional to the number of triangles times the number of clusters."""

AXIS_SQUARINGS = 8
"""Number of squarings of a matrix of spread, to its 256th power. An axis in which triangles spread
1.1 times as much as in the next is then known to 1e-10. Between closer axes, the choice does not
matter."""

SMALLEST_DIVISOR = 1e-300
"""Area that replaces 0, so that a cluster of degenerate triangles has a middle."""

MOST_TREE_TRIANGLES = 2_000_000
"""Number of triangles at which splitting stops. Such a tree takes several gigabytes."""

CORNER_BITS = 5
"""Number of bits for a corner in a triangle's code (see `triangle_codes`)."""

CORNER_MASK = (1 << CORNER_BITS) - 1
"""Mask for one corner."""

PATCH = record(
    x="f8", y="f8", z="f8", radius="f8", first="i8", end="i8", level="i8", after="i8"
)  # fmt: skip
"""Centre and radius [m] of a patch in the body frame, its first node and the end of its nodes, its
level, and the patch after it and the patches of lower levels inside it, which follow it. Patches of
level 0 are the smallest ones. A patch of a higher level has a single node."""

NODE = record(
    x="real", y="real", z="real", half_x="real", half_y="real", half_z="real",
    after="word", leaf="word",
)  # fmt: skip
"""A node's bounding box [m]: its middle relative to the patch's centre and its half sides; after:
the node after its subtree; leaf: the number of its leaf, -1 for other nodes. A node fills one cache
line, or half of one in single precision, which is all that a walk reads of it."""

MOMENTS = record(linear=("f8", (6, LINEAR)), bending=("f4", (6, BENDING)))
"""A node's moments, by group of monomials."""

LEAF = record(
    x=("real", LEAF_TERMS), y=("real", LEAF_TERMS), z=("real", LEAF_TERMS),
    weights=("real", (6, LEAF_TERMS)), fans=("word", (3, LEAF_TERMS)),
    triangles=("i4", LEAF_TRIANGLES), first="i8",
    middle_x="real", middle_y="real", middle_z="real",
)  # fmt: skip
"""A leaf.

x, y, z: positions of its vertices relative to the patch's centre [m], again from the first one on
in unused places; weights: of the vertices, as in `linear`, and from LEAF_VERTICES on those of the
quadratic coefficients at the leaf's middle, which are what these contribute beyond the vertices
when all of the leaf is wet; fans: the triangles of which each vertex is the first, second or third
corner, as bits; triangles: as in `triangle_codes`; first: its first TRIANGLE. Weights, fans and
triangles are 0 in unused places.
"""

TRIANGLE = record(area=("real", 3), arms=("real", (5, 3)))
"""A triangle: its area vector [m^2], and the cross products [m^3] of its corners a, b, c, a, b,
from the hull frame's origin, and this vector."""


class PatchTree(NamedTuple):
    """A hull cut into patches of at most a given radius: tables of PATCH, NODE, MOMENTS, LEAF and
    TRIANGLE. Nodes are in the order of a walk that opens all; moments have the same order."""

    patches: Table
    nodes: Table
    moments: Table
    leaves: Table
    triangles: Table

    @property
    def in_single(self) -> "PatchTree":
        """The same tables for kernels in single precision."""
        kinds = PATCH, NODE, MOMENTS, LEAF, TRIANGLE
        return PatchTree(*(t.astype(single(kind)) for t, kind in zip(self, kinds, strict=True)))


def triangle_codes(corners: Integers) -> Integers:
    """Triangles (N, 3) of vertices below 32 as one number each: a, b, c, a, b in CORNER_BITS each,
    from which the corners can be read in any cyclic order."""
    shifts = CORNER_BITS * np.arange(5)
    return (corners[:, [0, 1, 2, 0, 1]] << shifts).sum(axis=1)


@inline
def corner(code, i):
    """Corner number i, 0 to 4, of a triangle's code: a, b, c, a, b."""
    return code >> i * CORNER_BITS & CORNER_MASK


def build_tree(hull: Hull, radius: float, edge: float, larger: Sequence[float] = ()) -> PatchTree:
    """Cut a hull into patches of at most a radius [m], with its triangles split until no edge is
    longer than `edge` [m] or the radius. larger: the rising radii [m] of the patches of level 1, 2
    and so on, which the patches of lower levels divide. Raises ValueError when this makes too many
    triangles."""
    edge = min(edge, radius)
    try:
        corners = split_triangles(
            across(hull.vertices[hull.faces], edge),
            lambda c: sides(c).max(axis=1) > edge,
            MOST_TREE_TRIANGLES,
        )
    except ValueError as error:
        raise ValueError(
            f"the tolerance needs triangles with edges below {edge:.3g} m, {error} "
            "on this hull; use a larger tolerance or a calmer sea"
        ) from None
    return _Builder(corners, (radius, *larger)).tree()


@kernel
def add_quadratic_moments(corners, which, centres, points, weights, moments_out):
    """Add the second-order moments of triangles (N, 3, 3) to the moments (L, 6, 6) of their leaves,
    relative to the centres (L, 3). which: leaf of each triangle; points, weights: a Gauss rule."""
    for t in range(corners.shape[0]):
        leaf = which[t]
        ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
        bx, by, bz = corners[t, 1, 0], corners[t, 1, 1], corners[t, 1, 2]
        cx, cy, cz = corners[t, 2, 0], corners[t, 2, 1], corners[t, 2, 2]
        sx, sy, sz = cross(bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az)
        for i in range(weights.size):
            u, v, w, half = points[i, 0], points[i, 1], points[i, 2], 0.5 * weights[i]
            px, py, pz = (
                u * ax + v * bx + w * cx,
                u * ay + v * by + w * cy,
                u * az + v * bz + w * cz,
            )
            tx, ty, tz = cross(px, py, pz, sx, sy, sz)
            x, y, z = px - centres[leaf, 0], py - centres[leaf, 1], pz - centres[leaf, 2]
            second = (x * x, x * y, x * z, y * y, y * z, z * z)
            wrench = (sx, sy, sz, tx, ty, tz)
            for a in range(6):
                for b in range(6):
                    moments_out[leaf, a, b] += half * wrench[a] * second[b]


def enclosing_ball(corners: Array, sizes: Array) -> tuple[Array, float]:
    """Centre (3,) and radius [m] of a ball around triangles (N, 3, 3) of areas (N,). The centre is
    the centroid of the area, not the middle of the bounds, because the jet's errors cancel best
    there."""
    centre = sizes @ corners.mean(axis=1) / sizes.sum()
    return centre, float(np.linalg.norm(corners - centre, axis=2).max())


def clusters(corners: Array, sizes: Array, radius: float) -> Integers:
    """Cluster numbers (N,) of triangles (N, 3, 3) of areas (N,). Nearly all clusters lie within a
    radius [m] of the centroids of their areas.

    The triangle farthest from all seeds becomes a seed, again and again (Gonzalez 1985). Each
    cluster is the set of triangles closest to a seed, and the seed moves to its centroid, again and
    again (Lloyd 1982). This makes clusters round and of similar size. The farthest triangle of a
    cluster that is still too large becomes another seed.
    """
    middles = corners.mean(axis=1)
    seeds, apart = middles[:1], np.linalg.norm(middles - middles[0], axis=1)
    while apart.max() > SEED_DISTANCE_RADII * radius:
        seeds = np.vstack([seeds, middles[apart.argmax()]])
        apart = np.minimum(apart, np.linalg.norm(middles - seeds[-1], axis=1))
    nearest = np.empty(len(middles), dtype=np.int64)
    for _ in range(SEED_ROUNDS):
        seeds = np.ascontiguousarray(seeds)
        settle(middles, sizes, np.int64(LLOYD_ROUNDS), seeds, nearest)
        distances = np.linalg.norm(corners - seeds[nearest, None], axis=2).max(axis=1)
        order = np.argsort(distances, kind="stable")
        farthest = np.zeros(len(seeds), dtype=np.int64)
        farthest[nearest[order]] = order  # the last assignment remains
        large = (distances[farthest] > radius) & (np.bincount(nearest, minlength=len(seeds)) > 1)
        if not large.any():
            break
        seeds = np.vstack([seeds, middles[farthest[large]]])
    return nearest


@kernel
def settle(points, sizes, rounds, seeds_out, nearest_out):
    """For each point (N, 3) of a size, find the closest seed (K, 3), and move the seeds to the
    centroids of their points, a number of times."""
    total, sums = np.empty(len(seeds_out)), np.empty((len(seeds_out), 3))
    for _ in range(rounds):
        total[:], sums[:] = 0.0, 0.0
        for i in range(points.shape[0]):
            x, y, z, size = points[i, 0], points[i, 1], points[i, 2], sizes[i]
            best, least = 0, np.inf
            for k in range(seeds_out.shape[0]):
                dx, dy, dz = seeds_out[k, 0] - x, seeds_out[k, 1] - y, seeds_out[k, 2] - z
                away = dx * dx + dy * dy + dz * dz
                best, least = (k, away) if away < least else (best, least)
            nearest_out[i] = best
            total[best] += size
            sums[best, 0] += size * x
            sums[best, 1] += size * y
            sums[best, 2] += size * z
        for k in range(seeds_out.shape[0]):
            if total[k] > 0.0:
                for j in range(3):
                    seeds_out[k, j] = sums[k, j] / total[k]


class _Piece(NamedTuple):
    """A patch: the numbers of its triangles, its centre and radius [m], its level, and the number
    of patches in it, itself included."""

    chosen: Integers
    centre: Array
    radius: float
    level: int = 0
    count: int = 1


class _Builder:
    """Builds the tree from the root. A patch begins where a node's radius first suffices. As much
    as possible is computed for all triangles at once, because there may be many thousand
    patches.

    radii [m]: of the levels."""

    def __init__(self, corners: Array, radii: Sequence[float]) -> None:
        self.corners = corners
        self.radii = radii
        self.middles = corners.mean(axis=1)
        self.area_vectors = area_vectors(corners)
        self.sizes = np.maximum(np.linalg.norm(self.area_vectors, axis=1), SMALLEST_DIVISOR)
        first, numbers = distinct_points(corners.reshape(-1, 3))
        self.points, self.numbers = corners.reshape(-1, 3)[first], numbers.reshape(-1, 3)

    def tree(self) -> PatchTree:
        pieces = self._pieces(np.arange(len(self.corners)), len(self.radii) - 1)
        found = [piece for piece in pieces if piece.level == 0]
        centres = np.array([piece.centre for piece in found])
        counts = np.array([len(piece.chosen) for piece in found])
        order = np.concatenate([piece.chosen for piece in found])
        ends = np.cumsum(counts)
        nodes, spans, first = divided(
            order, np.concatenate([[0], ends]), centres, self.corners, self.numbers
        )
        patches = _patch_table(pieces)
        is_small = patches["level"] == 0
        patches["first"][is_small], patches["end"][is_small] = first[:-1], first[1:]
        of_triangle = np.repeat(centres, counts, axis=0)
        is_leaf = nodes["leaf"] >= 0
        leaves, of_leaves = self._leaves(order, spans[is_leaf], of_triangle)
        moments = _moments(nodes, of_leaves)
        nodes, moments = _with_larger(patches, nodes, moments)
        table = np.zeros(len(nodes), MOMENTS)
        table["linear"], table["bending"] = np.split(moments, [LINEAR], axis=2)
        return PatchTree(patches, nodes, table, leaves, self._triangles(order))

    def _triangles(self, order: Integers) -> Table:
        """TRIANGLE rows of the triangles in order."""
        found = np.zeros(len(order), TRIANGLE)
        areas = self.area_vectors[order]
        found["area"] = areas
        found["arms"] = np.cross(self.corners[order], areas[:, None])[:, [0, 1, 2, 0, 1]]
        return found

    def _leaves(self, order: Integers, spans: Integers, centres: Array) -> tuple[Table, Array]:
        """LEAF rows and moments (L, 6, MONOMIALS) of leaves. spans (L, 2): their ranges of `order`;
        centres (N, 3): of the patches of the triangles in order. The moments are exact up to second
        order; the third order includes the terms that `local_quadratic` covers."""
        start, end = spans.T
        which = np.repeat(np.arange(len(spans)), end - start)
        keys = which[:, None] * len(self.points) + self.numbers[order]
        keys, corner = np.unique(keys, return_inverse=True)
        leaf_of, number = keys // len(self.points), keys % len(self.points)
        slot = np.arange(len(keys)) - np.searchsorted(leaf_of, np.arange(len(spans)))[leaf_of]
        relative = self.points[number] - centres[start][leaf_of]
        counts = np.bincount(leaf_of)
        again = (np.cumsum(counts) - counts)[:, None] + np.arange(LEAF_TERMS) % counts[:, None]
        places = relative[again]
        weights = self._weights(order, which, slot[corner.reshape(-1, 3)])
        low = np.full((len(spans), 3), np.inf)
        high = -low
        np.minimum.at(low, leaf_of, relative)
        np.maximum.at(high, leaf_of, relative)
        middles = 0.5 * (low + high)
        moments = weights @ monomials(places)
        exact = np.zeros((len(spans), 6, 6))
        rule = gauss_rule(3)  # exact to degree 4; the torque of a quadratic head has degree 3
        add_quadratic_moments(self.corners[order], which, centres[start], *rule, exact)
        bends = exact - moments[:, :, LINEAR : LINEAR + 6]
        moments[:, :, LINEAR:] += bends @ local_quadratic(middles)
        leaves = np.zeros(len(spans), LEAF)
        leaves["x"], leaves["y"], leaves["z"] = np.moveaxis(places, 2, 0)
        weights[:, :, LEAF_VERTICES:] = bends
        leaves["weights"] = weights
        leaves["middle_x"], leaves["middle_y"], leaves["middle_z"] = middles.T
        corners, at = slot[corner.reshape(-1, 3)], (which, np.arange(len(order)) - start[which])
        leaves["triangles"][at] = triangle_codes(corners)
        bits = np.int64(1) << at[1]
        np.bitwise_or.at(leaves["fans"], (which[:, None], np.arange(3), corners), bits[:, None])
        leaves["first"] = start
        return leaves, moments

    def _weights(self, order: Integers, which: Integers, slots: Integers) -> Array:
        """Weights (L, 6, LEAF_TERMS) of the leaves' vertices. slots: of the triangles' corners."""
        shares = corner_shares(self.corners[order], self.area_vectors[order]).reshape(-1, 6)
        at = (which[:, None] * LEAF_TERMS + slots).ravel()
        room = (int(which.max()) + 1) * LEAF_TERMS
        sums = np.stack([np.bincount(at, part, room) for part in shares.T])
        return np.ascontiguousarray(sums.reshape(6, -1, LEAF_TERMS).transpose(1, 0, 2), float)

    def _pieces(self, chosen: Integers, level: int) -> list[_Piece]:
        """Patches of a level and, after each, the patches of lower levels in it. A patch that lower
        levels do not divide belongs to the lowest level that it fits."""
        found = []
        for piece in self._patches(chosen, self.radii[level]):
            inside = self._pieces(piece.chosen, level - 1) if level else [piece]
            if len(inside) > 1:
                found.append(piece._replace(level=level, count=1 + len(inside)))
            found += inside
        return found

    def _patches(self, chosen: Integers, largest: float) -> Iterator[_Piece]:
        """Divide triangles until they fit patches of at most a radius [m]."""
        centre, radius = enclosing_ball(self.corners[chosen], self.sizes[chosen])
        if radius <= largest or len(chosen) == 1:
            yield _Piece(chosen, centre, radius)
            return
        for part in self._parts(chosen, largest):
            yield from self._patches(part, largest)

    def _parts(self, chosen: Integers, largest: float) -> list[Integers]:
        """Divide triangles that do not fit a patch: into clusters that may fit one, or into halves
        where there would be too many clusters or only one."""
        sizes = self.sizes[chosen]
        if sizes.sum() < MOST_CLUSTERS * np.pi * largest**2:
            nearest = clusters(self.corners[chosen], sizes, largest)
            if nearest.any():
                return [chosen[nearest == cluster] for cluster in np.unique(nearest)]
        along = self._along(chosen)
        near = along < 0.5 * (along.min() + along.max())
        if near.all() or not near.any():
            near = np.arange(len(chosen)) < len(chosen) // 2
        return [chosen[near], chosen[~near]]

    def _along(self, chosen: Integers) -> Array:
        """Positions of triangles along the axis in which they spread most."""
        middles = self.middles[chosen] - self.middles[chosen].mean(axis=0)
        _, axes = np.linalg.eigh(middles.T @ middles)
        return middles @ axes[:, 2]


def _patch_table(pieces: Sequence[_Piece]) -> Table:
    """PATCH rows without their nodes."""
    patches = np.zeros(len(pieces), PATCH)
    patches["x"], patches["y"], patches["z"] = np.transpose([piece.centre for piece in pieces])
    patches["radius"] = [piece.radius for piece in pieces]
    patches["level"] = [piece.level for piece in pieces]
    patches["after"] = np.arange(len(pieces)) + [piece.count for piece in pieces]
    return patches


def _moments(nodes: Table, of_leaves: Array) -> Array:
    """Moments (N, 6, MONOMIALS) of the nodes. A node's moments are the sum of those of its two
    children."""
    moments = np.empty((len(nodes), 6, MONOMIALS))
    add_up(nodes["leaf"].copy(), nodes["after"].copy(), of_leaves, moments)
    return moments


def _with_larger(patches: Table, nodes: Table, moments: Array) -> tuple[Table, Array]:
    """NODE rows and moments (N, 6, MONOMIALS) with those of the patches of higher levels, which
    also get their nodes' numbers. Their moments are those of the patches inside them, moved to
    their own centre."""
    larger = np.flatnonzero(patches["level"])
    centres = np.stack([patches[axis] for axis in "xyz"], axis=1)
    added, extra = np.zeros(len(larger), NODE), np.zeros((len(larger), 6, MONOMIALS))
    for i, p in enumerate(larger):
        inside = np.arange(p + 1, patches["after"][p])
        inside = inside[patches["level"][inside] == 0]
        moved = moved_monomials(centres[inside] - centres[p])
        extra[i] = np.einsum("nam,nkm->ak", moments[patches["first"][inside]], moved)
    added["leaf"], added["after"] = -1, len(nodes) + 1 + np.arange(len(larger))
    patches["first"][larger] = len(nodes) + np.arange(len(larger))
    patches["end"][larger] = patches["first"][larger] + 1
    return np.concatenate([nodes, added]), np.concatenate([moments, extra])


@kernel
def add_up(leaf, after, of_leaves, moments_out):
    """Moments (N, 6, M) of all nodes, in the order of a walk, from those of the leaves."""
    for n in range(leaf.size - 1, -1, -1):
        for i in range(moments_out.shape[1]):
            for j in range(moments_out.shape[2]):
                if leaf[n] >= 0:
                    moments_out[n, i, j] = of_leaves[leaf[n], i, j]
                else:
                    first, second = moments_out[n + 1, i, j], moments_out[after[n + 1], i, j]
                    moments_out[n, i, j] = first + second


def divided(
    order: Integers, starts: Integers, centres: Array, corners: Array, numbers: Integers
) -> tuple[Table, Integers, Integers]:
    """Divide patches into nodes.

    The triangles of patch i are order[starts[i]:starts[i + 1]]. Return NODE rows in the order of a
    walk, the spans (N, 2) of order that belong to them, and the first node (P + 1,) of each patch.
    Sorts order, so that a node's triangles are contiguous.
    """
    most = 2 * len(order) + len(centres)
    nodes, spans = np.zeros(most, NODE), np.zeros((most, 2), dtype=np.int64)
    first = np.zeros(len(starts), dtype=np.int64)
    count = divide(order, starts, centres, corners, numbers, nodes, spans, first)
    return nodes[:count].copy(), spans[:count].copy(), first


@kernel
def divide(order, starts, centres, corners, numbers, nodes_out, spans_out, first_out):
    """See `divided`; returns the number of nodes."""
    pending = np.empty((128, 2), np.int64)
    count, leaves = 0, 0
    for p in range(centres.shape[0]):
        begin = count
        first_out[p] = begin
        pending[0, 0], pending[0, 1], waiting = starts[p], starts[p + 1], 1
        while waiting > 0:
            waiting -= 1
            start, end = pending[waiting, 0], pending[waiting, 1]
            set_box(order[start:end], corners, centres[p], nodes_out[count])
            spans_out[count, 0], spans_out[count, 1] = start, end
            nodes_out[count].leaf = -1
            if is_leaf(order[start:end], numbers):
                nodes_out[count].leaf = leaves
                leaves += 1
            else:
                size = end - start
                parts = max(2, -(-size // LEAF_TRIANGLES))
                near = start + size * (parts // 2) // parts  # so that leaves become full
                halve(order[start:end], near - start, corners)
                pending[waiting, 0], pending[waiting, 1] = near, end
                pending[waiting + 1, 0], pending[waiting + 1, 1] = start, near
                waiting += 2
            count += 1
        for n in range(count - 1, begin - 1, -1):
            if nodes_out[n].leaf >= 0:
                nodes_out[n].after = n + 1
            else:
                nodes_out[n].after = nodes_out[nodes_out[n + 1].after].after
    first_out[centres.shape[0]] = count
    return count


@kernel
def set_box(chosen, corners, centre, node):
    """Set the box of a node: the bounds of the chosen triangles, relative to the patch's centre."""
    low, high = scratch(3), scratch(3)
    for x in range(3):
        low[x], high[x] = np.inf, -np.inf
    for i in range(chosen.size):
        for c in range(3):
            for x in range(3):
                value = corners[chosen[i], c, x] - centre[x]
                low[x], high[x] = min(low[x], value), max(high[x], value)
    node.x, node.half_x = 0.5 * (low[0] + high[0]), 0.5 * (high[0] - low[0])
    node.y, node.half_y = 0.5 * (low[1] + high[1]), 0.5 * (high[1] - low[1])
    node.z, node.half_z = 0.5 * (low[2] + high[2]), 0.5 * (high[2] - low[2])


@kernel
def is_leaf(chosen, numbers):
    """Whether triangles and their vertices fit into a leaf."""
    if chosen.size > LEAF_TRIANGLES:
        return False
    seen, count = np.empty(3 * LEAF_TRIANGLES, np.int64), 0
    for t in range(chosen.size):
        for c in range(3):
            number, is_new = numbers[chosen[t], c], True
            for i in range(count):
                is_new = is_new and seen[i] != number
            if is_new:
                seen[count] = number
                count += 1
    return count <= LEAF_VERTICES


@kernel
def halve(chosen_out, near, corners):
    """Sort triangles so that the first `near` of them lie on one side along the axis in which all
    spread most. Both sides keep their order."""
    count = chosen_out.size
    middles, mean = np.empty((count, 3)), scratch_zeros(3)
    for i in range(count):
        for x in range(3):
            t = chosen_out[i]
            middles[i, x] = corners[t, 0, x] + corners[t, 1, x] + corners[t, 2, x]
            mean[x] += middles[i, x] / count
    spread = scratch_zeros((3, 3))
    for i in range(count):
        for x in range(3):
            middles[i, x] -= mean[x]
        for x in range(3):
            for y in range(3):
                spread[x, y] += middles[i, x] * middles[i, y]
    axis = widest_axis(spread)
    along = np.empty(count)
    for i in range(count):
        along[i] = middles[i, 0] * axis[0] + middles[i, 1] * axis[1] + middles[i, 2] * axis[2]
    before, limit = chosen_out.copy(), smallest(along.copy(), near - 1)
    equal = near  # so many of those at the limit are among the first
    for i in range(count):
        equal -= along[i] < limit
    first, second = 0, near
    for i in range(count):
        if along[i] < limit or (along[i] == limit and equal > 0):
            equal -= along[i] == limit
            chosen_out[first] = before[i]
            first += 1
        else:
            chosen_out[second] = before[i]
            second += 1


@kernel
def smallest(values, k):
    """The value that sorting would put at place k. Changes the order of the values (Hoare 1961)."""
    low, high = 0, values.size - 1
    while low < high:
        pivot, i, j = values[k], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        low, high = i if j < k else low, j if k < i else high
    return values[k]


@kernel
def widest_axis(spread):
    """An approximate eigenvector (3,) of the largest eigenvalue of a matrix (3, 3). High powers of
    the matrix approach a multiple of the projection onto it."""
    power, scaled = spread.copy(), scratch((3, 3))
    for _ in range(AXIS_SQUARINGS):
        largest = SMALLEST_DIVISOR
        for x in range(3):
            for y in range(3):
                largest = max(largest, abs(power[x, y]))
        for x in range(3):
            for y in range(3):
                scaled[x, y] = power[x, y] / largest
        for x in range(3):
            for y in range(3):
                power[x, y] = (
                    scaled[x, 0] * scaled[0, y]
                    + scaled[x, 1] * scaled[1, y]
                    + scaled[x, 2] * scaled[2, y]
                )
    best = 0
    for x in range(1, 3):
        if power[x, x] > power[best, best]:
            best = x
    return power[best]


def joined(trees: Sequence[PatchTree]) -> PatchTree:
    """Several trees as one, with patches in order and all indices moved accordingly."""
    moved, count, nodes, leaves, triangles = [], 0, 0, 0, 0
    for tree in trees:
        patches, of_tree, of_leaves = tree.patches.copy(), tree.nodes.copy(), tree.leaves.copy()
        patches["after"] += count
        patches["first"] += nodes
        patches["end"] += nodes
        of_tree["after"] += nodes
        of_tree["leaf"][of_tree["leaf"] >= 0] += leaves
        of_leaves["first"] += triangles
        moved.append(PatchTree(patches, of_tree, tree.moments, of_leaves, tree.triangles))
        count += len(tree.patches)
        nodes += len(tree.nodes)
        leaves += len(tree.leaves)
        triangles += len(tree.triangles)
    return PatchTree(*(np.concatenate(tables) for tables in zip(*moved, strict=True)))
