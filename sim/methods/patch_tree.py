"""Patch tree: a hull's surface cut into patches, with all that a step needs prepared.

See `patches` for what it is for. Heads are polynomials in d, the place relative to the patch's
centre, over twenty monomials. For each node of the tree the integrals of

    monomial(d) n        and        r x monomial(d) n        (r from the hull frame's origin)

over its surface are the *moments*: a surely wet node contributes the head's coefficients
times its moments, exactly. Everything here happens once, in plain NumPy.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.gerstner import COMPONENT_COLUMNS
from sim.hull import Hull
from sim.methods.linear import corner_shares
from sim.triangle import gauss_rule

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

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

LINEAR, BENDING = 4, 16
"""Monomials: 1, x, y, z, and xx, xy, xz, yy, yz, zz, xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz,
zzz. The second group only counts in waves, where it is small, so its moments are kept in single
precision: a step waits for memory more than for anything else."""

MONOMIALS = LINEAR + BENDING

QUADRATICS = 8
"""The six quadratic coefficients and two zeros, which make them a vector."""

# Parts of a triangle's code (see triangle_codes): bits for a corner, a mask for one, and where the
# set of corners begins.
CORNER_BITS = 5
CORNER = (1 << CORNER_BITS) - 1
CORNER_SET = 5 * CORNER_BITS

# Where a leaf's record has what (see PatchTree.leaf_records).
WEIGHTS = 3 * LEAF_VERTICES
BENDS = WEIGHTS + 6 * LEAF_VERTICES
MIDDLE = BENDS + 6 * QUADRATICS
RECORD = MIDDLE + 8

CACHE_LINE = 64
"""Bytes."""

# Columns of PatchTree.nodes after the box: a node's numbers are kept as reals so that all a walk
# needs of it is one line of the cache.
AFTER, LEAF = 6, 7

# Columns of a fleet's instances: the patches' first and end, the rows of the pose and of the
# wrench, and the tree that it is an instance of.
FIRST, END, POSE, ROW, TREE = range(5)


@dataclass(frozen=True)
class PatchTree:
    """A hull cut into patches of a given radius; lengths in metres, body frame.

    patches: (P, 4), centre and radius; patch_nodes (P, 2), first node and end. Nodes come in
    the order of a walk that opens all: nodes (N, 8), the bounding box's middle from the
    patch's centre, its half sides, the node AFTER the subtree and the number of the LEAF, -1 for
    other nodes. Their moments by monomial group: linear_moments (N, 6, LINEAR) and bending_moments
    (N, 6, BENDING). Of the L leaves: places (L, 3, LEAF_VERTICES) of the vertices from the patch's
    centre and their weights (L, 6, LEAF_VERTICES) as in `linear`, the last ones of no weight;
    bends (L, 6, QUADRATICS), what the quadratic coefficients at the leaf's middle (L, 3) add to the
    vertex sum when all of the leaf is wet; triangles (L, LEAF_TRIANGLES), as `triangle_codes`
    has them, 0 for none.
    """

    patches: Array
    nodes: Array
    linear_moments: Array
    places: Array
    weights: Array
    bends: Array
    middles: Array
    bending_moments: Singles
    patch_nodes: Integers
    triangles: Integers

    def leaf_records(self) -> Array:
        """All reals of a leaf in one row (L, RECORD), for the cache's sake."""
        parts = (self.places, self.weights, self.bends, self.middles)
        records = np.zeros((len(self.places), RECORD))
        records[:, : MIDDLE + 3] = np.hstack([part.reshape(len(part), -1) for part in parts])
        return records


def triangle_codes(corners: Integers) -> Integers:
    """Triangles (N, 3) of vertices below 32 as one number each: a, b, c, a, b in CORNER_BITS each,
    from which the corners are read in any order, then the set of corners as bits."""
    bits = (np.int64(1) << corners).sum(axis=1) << CORNER_SET
    for place, corner in enumerate((0, 1, 2, 0, 1)):
        bits |= corners[:, corner] << place * CORNER_BITS
    return bits


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
    """The monomials (..., MONOMIALS) at places (..., 3)."""
    x, y, z = np.moveaxis(d, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    second = xx, x * y, x * z, yy, y * z, zz
    third = x * xx, y * xx, z * xx, x * yy, x * y * z, x * zz, y * yy, z * yy, y * zz, z * zz
    return np.stack([np.ones_like(x), x, y, z, *second, *third], axis=-1)


def triangle_moments(corners: Array, area_vectors: Array, centres: Array) -> Array:
    """Moments (N, 6, MONOMIALS) of triangles (N, 3, 3), places d taken from centres (N, 3)."""
    points, weights = gauss_rule(3)  # exact to degree 4: what the torque of a cubic needs
    moments = np.zeros((len(corners), 6, MONOMIALS))
    for barycentric, weight in zip(points, weights, strict=True):
        place = np.einsum("c,ncx->nx", barycentric, corners)
        wrench = np.hstack([area_vectors, np.cross(place, area_vectors)])
        moments += weight * wrench[:, :, None] * monomials(place - centres)[:, None, :]
    return moments


def local_quadratic(x: float, y: float, z: float) -> Array:
    """Matrix (6, BENDING) that takes a polynomial's bending coefficients to the quadratic ones of
    the same polynomial around the place x, y, z."""
    return np.array(
        [
            [1, 0, 0, 0, 0, 0, 3 * x, y, z, 0, 0, 0, 0, 0, 0, 0],
            [0, 1, 0, 0, 0, 0, 0, 2 * x, 0, 2 * y, z, 0, 0, 0, 0, 0],
            [0, 0, 1, 0, 0, 0, 0, 0, 2 * x, 0, y, 2 * z, 0, 0, 0, 0],
            [0, 0, 0, 1, 0, 0, 0, 0, 0, x, 0, 0, 3 * y, z, 0, 0],
            [0, 0, 0, 0, 1, 0, 0, 0, 0, 0, x, 0, 0, 2 * y, 2 * z, 0],
            [0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, x, 0, 0, y, 3 * z],
        ]
    )


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
        a, b, c = np.moveaxis(corners, 1, 0)
        self.area_vectors = 0.5 * np.cross(b - a, c - a)
        self.sizes = np.maximum(np.linalg.norm(self.area_vectors, axis=1), TINY)
        self.shares = corner_shares(corners, self.area_vectors)
        self.points, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        self.numbers = numbers.reshape(-1, 3)
        self.nodes: list[list[float]] = []
        self.node_moments: list[Array] = []
        self.leaves: list[tuple[Array, Array, Array, Array, Integers]] = []

    def tree(self) -> PatchTree:
        patches = list(self._patches(np.arange(len(self.corners))))
        centres = np.empty((len(self.corners), 3))
        for chosen, centre, _ in patches:
            centres[chosen] = centre
        self.moments = triangle_moments(self.corners, self.area_vectors, centres)
        first = []
        for chosen, centre, _ in patches:
            first.append(len(self.nodes))
            self._grow(chosen, centre)
        moments = np.array(self.node_moments)
        places, weights, bends, middles, triangles = map(np.array, zip(*self.leaves, strict=True))
        return PatchTree(
            patches=np.array([[*centre, radius] for _, centre, radius in patches]),
            nodes=np.array(self.nodes),
            linear_moments=moments[:, :, :LINEAR],
            places=places,
            weights=weights,
            bends=bends,
            middles=middles,
            bending_moments=moments[:, :, LINEAR:].astype(np.float32),
            patch_nodes=np.column_stack([first, [*first[1:], len(self.nodes)]]),
            triangles=triangles,
        )

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
        node = len(self.nodes)
        points = self.corners[chosen].reshape(-1, 3) - centre
        low, high = points.min(axis=0), points.max(axis=0)
        middle = 0.5 * (low + high)
        self.nodes.append([*middle, *(0.5 * (high - low)), 0.0, -1.0])
        self.node_moments.append(np.zeros(0))
        vertices = np.unique(self.numbers[chosen]) if len(chosen) <= LEAF_TRIANGLES else ()
        if 0 < len(vertices) <= LEAF_VERTICES:
            self.nodes[node][LEAF] = len(self.leaves)
            moments = self._add_leaf(chosen, vertices, middle, centre)
        else:
            order = np.argsort(self._along(chosen), kind="stable")
            leaves = max(2, -(-len(chosen) // LEAF_TRIANGLES))
            near = len(chosen) * (leaves // 2) // leaves  # so that leaves become full
            moments = self._grow(chosen[np.sort(order[:near])], centre)
            moments = moments + self._grow(chosen[np.sort(order[near:])], centre)
        self.nodes[node][AFTER] = len(self.nodes)
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
    arrays: dict[str, list[NDArray]] = {field.name: [] for field in fields(PatchTree)}
    nodes = leaves = 0
    for tree in trees:
        for name, blocks in arrays.items():
            blocks.append(getattr(tree, name))
        moved = tree.nodes.copy()
        moved[:, AFTER] += nodes
        moved[moved[:, LEAF] >= 0.0, LEAF] += leaves
        arrays["nodes"][-1] = moved
        arrays["patch_nodes"][-1] = tree.patch_nodes + nodes
        nodes += len(tree.nodes)
        leaves += len(tree.places)
    return PatchTree(**{name: np.concatenate(blocks) for name, blocks in arrays.items()})


def packed(
    tree: PatchTree,
    instances: Integers,
    components: Array,
    steps: int,
    residual: float,
    level: float,
    amplitude: float,
    scale: float,
) -> tuple[Array, Singles, Integers]:
    """All that a step needs of a tree, its instances (H, 5) and their seas' components (., W, .)
    in three arrays: each argument handed to a kernel costs a tenth of a microsecond."""
    counts = [len(a) for a in (tree.patches, tree.nodes, tree.places, instances)]
    patches = np.sum(instances[:, END] - instances[:, FIRST])
    counts += [*components.shape[:2], steps, patches]
    setting = np.array([residual, level, amplitude, scale])
    moments = tree.linear_moments
    reals = (tree.nodes, moments, tree.leaf_records(), tree.patches, components, setting)
    integers = (tree.triangles, tree.patch_nodes, instances)
    return (
        _in_lines(np.concatenate([array.ravel() for array in reals])),
        _in_lines(tree.bending_moments.ravel()),
        _in_lines(np.concatenate([counts, *(array.ravel() for array in integers)])),
    )


def _in_lines(array: NDArray) -> NDArray:
    """A copy that begins where a line of the cache does, and with it each node and leaf; read-only,
    as a Sea's components are, or kernels would be compiled for both."""
    room = np.empty(array.nbytes + CACHE_LINE, dtype=np.uint8)
    first = -room.ctypes.data % CACHE_LINE
    copy = room[first : first + array.nbytes].view(array.dtype)
    copy[:] = array
    copy.setflags(write=False)
    return copy


@njit(inline="always")
def _block(array, start, rows, columns):
    end = start + rows * columns
    return array[start:end].reshape(rows, columns), end


@njit(inline="always")
def unpacked(reals, singles, integers):
    """From the arrays of `packed` those of PatchTree, a row for each patch, node or leaf, and then
    instances, components, Newton steps, how many patches the instances have together, residual,
    level, amplitude and scale."""
    p, n, leaves = integers[0], integers[1], integers[2]
    h, seas, waves, steps, most = integers[3], integers[4], integers[5], integers[6], integers[7]
    nodes, at = _block(reals, 0, n, 8)
    linear_moments, at = _block(reals, at, n, 6 * LINEAR)
    records, at = _block(reals, at, leaves, RECORD)
    patches, at = _block(reals, at, p, 4)
    components, at = _block(reals, at, seas * waves, COMPONENT_COLUMNS)
    residual, level, amplitude, scale = reals[at], reals[at + 1], reals[at + 2], reals[at + 3]
    bending_moments, at = _block(singles, 0, n, 6 * BENDING)
    triangles, at = _block(integers, 8, leaves, LEAF_TRIANGLES)
    patch_nodes, at = _block(integers, at, p, 2)
    instances, at = _block(integers, at, h, 5)
    tree = patches, nodes, linear_moments, bending_moments, records, patch_nodes, triangles
    components = components.reshape(seas, waves, COMPONENT_COLUMNS)
    return tree, (instances, components, steps, most, residual, level, amplitude, scale)
