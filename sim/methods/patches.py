"""Patches: the work follows the sea, not the mesh.

Over a small region the sea is a cubic: value, two slopes, three curvatures and four third
derivatives at a point, its *jet*, from one Newton solve. It is not Taylor's cubic, but nearly the
best one over the region (`Sea.economised`), at the same cost. In the body frame the head above a
place d from the region's centre is then a polynomial

    head(d) = h + G . d + d . Q d / 2 + C(d, d, d) / 6

(for hydrostatic pressure: h = elevation - z, G = R^T (slope, -1), Q = R^T diag(curvature, 0) R,
C the third derivatives turned likewise), and the wrench of a piece of surface that is wet all over
is linear in its twenty coefficients, with integrals over that piece as factors, which are
known beforehand: its *moments*.

Once, when hull and sea are known, the hull is cut into *patches* small enough for the
jet to hold to the tolerance (`patch_radius`), each with a tree of nodes below it
(`patch_tree`). A step is then

1. one jet for each patch, all together (none for a patch above the highest crest);
2. for each patch a walk through its tree: a node that is surely dry adds nothing, one that is
   surely wet its moments times the coefficients, and only nodes on the waterline are opened;
3. at the leaves, heads of the vertices from the polynomial and the straight clip.

The work grows with the number of wavelets under the hull and the length of the waterline, not
with the number of triangles, and no sine or cosine is taken outside of step 1.

In an opened leaf heads are linear over each triangle. What the polynomial has beyond that is
added in proportion to how much of the leaf is wet, so a leaf that comes to be wet all over has
the very value of its moments, and forces do not jump when nodes open or close.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sim.gerstner import (
    JET_HEIGHT,
    JET_ROWS,
    JET_X,
    JET_XX,
    JET_XXX,
    JET_XXY,
    JET_XY,
    JET_XYY,
    JET_Y,
    JET_YY,
    JET_YYY,
    kernel,
    solve_jets,
    summing_kernel,
)
from sim.hull import Hull
from sim.methods.crew import Crew
from sim.methods.linear import placed
from sim.methods.patch_tree import (
    AFTER,
    BENDING,
    BENDS,
    CORNER,
    CORNER_BITS,
    CORNER_SET,
    END,
    FIRST,
    LEAF,
    LEAF_TRIANGLES,
    LEAF_VERTICES,
    LINEAR,
    MIDDLE,
    MONOMIALS,
    POSE,
    QUADRATICS,
    ROW,
    TREE,
    WEIGHTS,
    build_tree,
    enclosing_ball,
    joined,
    packed,
    unpacked,
)
from sim.sea import Sea
from sim.triangle import clip_dry_part, cross

Array = NDArray[np.float64]

DEFAULT_TOLERANCE = 1.0 / 250.0
"""Of the hull's longest side. Errors of patches cancel: this much water height leaves less than
5e-5 of the weight of the displaced water, a third of what linear has on 4000 triangles."""

DISC = 0.65
"""Jets are economised over a disc of so many radii of the largest patch allowed: seen from above,
most of a patch is near its middle. The wrench's errors were smallest so, among 0.4 to 1.1."""

DIRECTIONS, RINGS = 8, (0.25, 0.5, 0.75, 1.0)
"""Directions and distances, in radii, in which jets are tried on the samples of the sea."""

RADII = 20
"""Radii that are tried at most: a tolerance near round-off is met by none, and the number of
triangles it asks for is refused."""

SAFETY = 1.5
"""The worst place of the sea may be this much worse than the worst sample."""

CARRY = 0.05
"""A jet may come from a particle so many radii away from the patch's centre: the solve for it then
ends early, and patches are by that much smaller."""

PARTS_A_THREAD = 3
"""Parts into which a fleet is cut for each thread: the more, the less one waits for another in the
end, but each part costs a few microseconds."""

# What a polynomial has behind its coefficients: bounds on its second and third order terms over
# the second and third power of the distance.
BOUND_2, BOUND_3 = MONOMIALS, MONOMIALS + 1
POLYNOMIAL_COLUMNS = 24


class Patches:
    """Wrench of a hull in a sea from jets over patches.

    tolerance [m of water height]: the elevation inside a patch is right to it, everywhere and
    always; None for DEFAULT_TOLERANCE of the hull's longest side. Raises ValueError for a
    tolerance that is not positive or asks for too many patches. Stateless between calls;
    hull and sea are immutable, so what was prepared for them stays true.

    tree: the hull cut for this sea; radius [m]: of the largest patch allowed, inf on flat water.
    """

    def __init__(self, hull: Hull, sea: Sea, tolerance: float | None = None) -> None:
        if tolerance is None:
            tolerance = DEFAULT_TOLERANCE * float(np.ptp(hull.bounds, axis=0).max())
        if not (np.isfinite(tolerance) and tolerance > 0):
            raise ValueError(
                f"the tolerance is {tolerance} m of water height; it must be finite and above 0"
            )
        self.hull = hull
        self.sea = sea
        self.tolerance = float(tolerance)
        corners, sizes = hull.vertices[hull.faces], np.linalg.norm(hull.area_vectors, axis=1)
        _, largest = enclosing_ball(corners, sizes)
        self.radius = patch_radius(sea, self.tolerance, largest)
        self.tree = build_tree(hull, self.radius, longest_edge(sea, self.tolerance))
        self._packed = PatchFleet([self], [0], [0]).packed

    @property
    def jet_reach(self) -> float:
        """Distance [m] over which the sea's jets have to hold for this hull."""
        return float(self.tree.patches[:, 3].max())

    @property
    def components(self) -> Array:
        """The sea's components that this hull's jets are made of: those that the radius was found
        with. Over smaller discs the error may be larger, where a wave is shorter than a patch."""
        return self.sea.economised(DISC * self.radius)

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        """Force [N] and torque [N m] about the position, world axes: (6,).

        position: (3,) [m], the hull frame's origin in the world; rotation: (3, 3) or (9,),
        hull -> world; time [s].
        """
        positions = np.ascontiguousarray(position, dtype=float).reshape(1, 3)
        rotations = np.ascontiguousarray(rotation, dtype=float).reshape(1, 9)
        out = np.zeros((1, 6))
        fleet_wrenches(*self._packed, positions, rotations, float(time), out)
        return out[0]


class PatchFleet:
    """Several hulls in one sea, computed in one call; those with the same tree share it.

    methods: Patches, all for the same sea; poses: for each the row of its pose in the arrays
    given to `add_wrenches`; rows: its row in what that adds to (several may have the same);
    threads: how many, with the caller's own, share the hulls. The result is the same to the bit.
    """

    def __init__(
        self,
        methods: Sequence[Patches],
        poses: Sequence[int],
        rows: Sequence[int],
        threads: int = 1,
    ) -> None:
        sea = methods[0].sea
        if any(method.sea is not sea for method in methods):
            raise ValueError("the hulls of a fleet float in one sea; make a fleet for each sea")
        of_trees = {id(method.tree): method for method in methods}
        trees = [method.tree for method in of_trees.values()]
        components = np.stack([method.components for method in of_trees.values()])
        first = np.cumsum([0] + [len(tree.patches) for tree in trees])
        which = [list(of_trees).index(id(method.tree)) for method in methods]
        instances = np.array(
            [
                [first[w], first[w + 1], pose, row, w]
                for w, pose, row in zip(which, poses, rows, strict=True)
            ]
        )
        instances = instances[np.argsort(which, kind="stable")]
        residual = CARRY * min(method.jet_reach for method in methods)
        steps, _ = sea.newton_steps(residual / SAFETY)
        scale = -sea.density * sea.gravity
        setting = (components, steps, residual, sea.level, sea.amplitude, scale)
        tree = joined(trees)
        self.packed = packed(tree, instances, *setting)
        self._crew: Crew | None = None
        parts = parts_of(instances, threads)
        if len(parts) > 1:
            self._parts = [packed(tree, part, *setting)[2] for part in parts]
            self._crew = Crew(min(threads, len(parts)) - 1)

    def add_wrenches(self, positions: Array, rotations: Array, time: float, out: Array) -> None:
        """Add each hull's wrench, as of `Patches.wrench`, to its row of out (., 6), for its pose
        among positions (., 3) [m] and rotations (., 9)."""
        if self._crew is None:
            fleet_wrenches(*self.packed, positions, rotations, time, out)
            return
        reals, singles, _ = self.packed

        def add(part: NDArray[np.int64]) -> None:
            fleet_wrenches(reals, singles, part, positions, rotations, time, out)

        self._crew.share(add, self._parts)


def parts_of(instances: NDArray[np.int64], threads: int) -> list[NDArray[np.int64]]:
    """The instances (H, 5) of a fleet in parts for so many threads, the largest first; those that
    add to the same row stay together, in order."""
    if threads == 1:
        return [instances]
    rows, turns = np.unique(instances[:, ROW], return_inverse=True)
    count = min(PARTS_A_THREAD * threads, len(rows))
    parts = [instances[turns % count == i] for i in range(count)]
    return sorted(parts, key=lambda part: -np.sum(part[:, END] - part[:, FIRST]))


def patch_radius(sea: Sea, tolerance: float, largest: float) -> float:
    """Radius [m] up to which an economised jet of the sea is right to the tolerance [m], at most
    `largest` [m]; inf on flat water.

    A bound from the fourth derivatives would do as well, but where many waves would have to
    conspire it asks for several times too many patches. So jets are tried where particles
    are, all phases alike, and the worst error found, times SAFETY, has to pass.
    """
    if not sea.components.size:
        return np.inf
    x, y = sea.sample_places()
    jets = np.empty((JET_ROWS, x.size))
    radius = largest
    for _ in range(RADII):
        components = sea.economised(DISC * radius)
        solve_jets(x, y, components, 0.0, sea.residual_tolerance, 0, jets)
        error = SAFETY * jet_error(sea, x, y, jets, (1.0 + CARRY) * radius)
        if error <= tolerance:
            break
        # error ~ radius^4 where it is small; a hair less, so that the next try passes
        radius *= 0.99 * (tolerance / error) ** 0.25
    return radius


def jet_error(sea: Sea, x: Array, y: Array, jets: Array, radius: float) -> float:
    """Largest error [m] of the jets at places x, y, up to a radius away from them."""
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    worst = 0.0
    for ring, angle in product(RINGS, angles):
        dx, dy = ring * radius * np.cos(angle), ring * radius * np.sin(angle)
        head = jets[JET_HEIGHT] + dx * jets[JET_X] + dy * jets[JET_Y]
        head += 0.5 * (dx * dx * jets[JET_XX] + dy * dy * jets[JET_YY]) + dx * dy * jets[JET_XY]
        head += (dx**3 * jets[JET_XXX] + dy**3 * jets[JET_YYY]) / 6.0
        head += 0.5 * dx * dy * (dx * jets[JET_XXY] + dy * jets[JET_XYY])
        found = sea.elevation(x + dx, y + dy, 0.0) - sea.level
        worst = max(worst, float(np.abs(found - head).max()))
    return worst


def longest_edge(sea: Sea, tolerance: float) -> float:
    """Edge [m] up to which a surface linear over a triangle is right to the tolerance [m].

    Linear interpolation within a circle of radius r misses M r^2 / 2, M being the largest second
    derivative (of the samples, times SAFETY), and r is at most the edge over the root of 3.
    """
    if not sea.components.size:
        return np.inf
    hessians = sea.hessian(*sea.sample_places(), 0.0)
    largest = SAFETY * float(np.abs(np.linalg.eigvalsh(hessians)).max())
    return np.sqrt(6.0 * tolerance / largest) if largest > 0.0 else np.inf


@kernel
def reachable_patches(
    patches, patch_nodes, instances, level, amplitude, positions, rotations, places, chosen
):
    """Of all patches that the highest crest could reach: centres in the world, the third
    coordinate above the level, into places (3, .), and chosen (., 3): patch, instance and pose.
    Returns how many, and how many nodes they have."""
    active, nodes = 0, 0
    for i in range(instances.shape[0]):
        pose = instances[i, POSE]
        position, rotation = positions[pose], rotations[pose].reshape(3, 3)
        for p in range(instances[i, FIRST], instances[i, END]):
            x, y, z = placed(patches[p], position, rotation)
            places[0, active], places[1, active], places[2, active] = x, y, z - level
            chosen[active, 0], chosen[active, 1], chosen[active, 2] = p, i, pose
            if not z - level > amplitude + patches[p, 3]:
                active += 1
                nodes += patch_nodes[p, 1] - patch_nodes[p, 0]
    return active, nodes


@njit(inline="always")
def end_of_tree(start, chosen, instances):
    """Where the run of chosen patches ends that are of the same tree as that at `start`."""
    tree, end = instances[chosen[start, 1], TREE], start
    while end < chosen.shape[0] and instances[chosen[end, 1], TREE] == tree:
        end += 1
    return end


@njit(inline="always")
def squared(x, y, z):
    """Coefficients of xx, xy, xz, yy, yz, zz in the square of a linear form."""
    return x * x, 2.0 * x * y, 2.0 * x * z, y * y, 2.0 * y * z, z * z


@kernel
def head_polynomials(jets, z, chosen, rotations, polynomials):
    """Coefficients and bounds (N, POLYNOMIAL_COLUMNS) in the body frame of the heads around the
    chosen patches' centres, at heights z [m] above the level, from their jets; rotations (., 9):
    body -> world, for each pose."""
    for i in range(z.size):
        r, q = rotations[chosen[i, 2]], polynomials[i]
        gx, gy = jets[JET_X, i], jets[JET_Y, i]
        # the horizontal coordinates are the linear forms a . d and b . d
        ax, ay, az, bx, by, bz = r[0], r[1], r[2], r[3], r[4], r[5]
        q[0] = jets[JET_HEIGHT, i] - z[i]
        q[1] = gx * ax + gy * bx - r[6]
        q[2] = gx * ay + gy * by - r[7]
        q[3] = gx * az + gy * bz - r[8]
        axx, axy, axz, ayy, ayz, azz = squared(ax, ay, az)
        bxx, bxy, bxz, byy, byz, bzz = squared(bx, by, bz)
        xx, xy, yy = 0.5 * jets[JET_XX, i], jets[JET_XY, i], 0.5 * jets[JET_YY, i]
        q[4] = xx * axx + yy * bxx + xy * ax * bx
        q[5] = xx * axy + yy * bxy + xy * (ax * by + ay * bx)
        q[6] = xx * axz + yy * bxz + xy * (ax * bz + az * bx)
        q[7] = xx * ayy + yy * byy + xy * ay * by
        q[8] = xx * ayz + yy * byz + xy * (ay * bz + az * by)
        q[9] = xx * azz + yy * bzz + xy * az * bz
        # the cubic is (a . d)^2 (u . d) + (b . d)^2 (v . d)
        xxx, xxy = jets[JET_XXX, i] / 6.0, 0.5 * jets[JET_XXY, i]
        xyy, yyy = 0.5 * jets[JET_XYY, i], jets[JET_YYY, i] / 6.0
        ux, uy, uz = xxx * ax + xxy * bx, xxx * ay + xxy * by, xxx * az + xxy * bz
        vx, vy, vz = xyy * ax + yyy * bx, xyy * ay + yyy * by, xyy * az + yyy * bz
        q[10] = axx * ux + bxx * vx
        q[11] = axx * uy + axy * ux + bxx * vy + bxy * vx
        q[12] = axx * uz + axz * ux + bxx * vz + bxz * vx
        q[13] = ayy * ux + axy * uy + byy * vx + bxy * vy
        q[14] = axy * uz + axz * uy + ayz * ux + bxy * vz + bxz * vy + byz * vx
        q[15] = azz * ux + axz * uz + bzz * vx + bxz * vz
        q[16] = ayy * uy + byy * vy
        q[17] = ayy * uz + ayz * uy + byy * vz + byz * vy
        q[18] = ayz * uz + azz * uy + byz * vz + bzz * vy
        q[19] = azz * uz + bzz * vz
        q[BOUND_2] = np.sqrt(xx * xx + 0.5 * xy * xy + yy * yy)
        q[BOUND_3] = np.sqrt(xxx * xxx + (xxy * xxy + xyy * xyy) / 3.0 + yyy * yyy)


@njit(inline="always")
def head_and_slope(q, x, y, z):
    """Head at a place and its gradient there."""
    axx = q[4] + x * q[10] + y * q[11] + z * q[12]
    axy, axz = q[5] + y * q[13] + z * q[14], q[6] + z * q[15]
    ayy, ayz, azz = q[7] + y * q[16] + z * q[17], q[8] + z * q[18], q[9] + z * q[19]
    dx, dy, dz = x * axx + y * axy + z * axz, y * ayy + z * ayz, z * azz
    head = q[0] + x * (q[1] + dx) + y * (q[2] + dy) + z * (q[3] + dz)
    gx = q[1] + dx + x * (axx + x * q[10])
    gy = q[2] + dy + x * (axy + x * q[11] + y * q[13]) + y * (ayy + y * q[16])
    gz = q[3] + dz + x * (axz + x * q[12] + y * q[14] + z * q[15])
    gz += y * (ayz + y * q[17] + z * q[18]) + z * (azz + z * q[19])
    return head, gx, gy, gz


# What loops that branch call takes arrays and rows in them, not views of rows: a view is counted as
# a reference, and there the compiler does not see that it need not be.


@njit(inline="always")
def middle_and_sides(nodes, i):
    """Of a node's box."""
    return nodes[i, 0], nodes[i, 1], nodes[i, 2], nodes[i, 3], nodes[i, 4], nodes[i, 5]


@kernel
def walk(patch_nodes, nodes, patches, chosen, polynomials, wet, opened):
    """Walk the trees of the chosen patches: (node, place in `chosen`) of the surely wet nodes and
    of the leaves that the waterline may cross, into wet (., 2) and opened (., 2); returns
    how many of each."""
    wet_count, opened_count = 0, 0
    for i in range(chosen.shape[0]):
        q, patch = polynomials[i], chosen[i, 0]
        # the middle of the box of points in a ball is at most 1.1 radii from the ball's, and so
        # 2.1 from a point: of the cubic around it 3 C(middle, u, u) + C(u, u, u)
        bend = q[BOUND_2] + (3.0 * 1.1 + 2.1) * patches[patch, 3] * q[BOUND_3]
        node, end = patch_nodes[patch, 0], patch_nodes[patch, 1]
        while node < end:
            x, y, z, u, v, w = middle_and_sides(nodes, node)
            head, gx, gy, gz = head_and_slope(q, x, y, z)
            slack = abs(gx) * u + abs(gy) * v + abs(gz) * w + bend * (u * u + v * v + w * w)
            if head <= -slack:
                node = int(nodes[node, AFTER])
            elif head >= slack:
                wet[wet_count, 0], wet[wet_count, 1] = node, i
                wet_count += 1
                node = int(nodes[node, AFTER])
            else:
                if nodes[node, LEAF] >= 0.0:
                    opened[opened_count, 0], opened[opened_count, 1] = int(nodes[node, LEAF]), i
                    opened_count += 1
                node += 1
    return wet_count, opened_count


@njit(inline="always")
def add_products(factors, first, count, rows, n, column, body, at):
    """Add the products of a (6, count) block of row n, from a column on, with a vector's part to
    the sums of an instance."""
    b0, b1, b2, b3, b4, b5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # in registers, unlike body
    for i in range(count):
        f, j = factors[first + i], column + i
        b0 += f * rows[n, j]
        b1 += f * rows[n, j + count]
        b2 += f * rows[n, j + 2 * count]
        b3 += f * rows[n, j + 3 * count]
        b4 += f * rows[n, j + 4 * count]
        b5 += f * rows[n, j + 5 * count]
    add_six(body, at, b0, b1, b2, b3, b4, b5)


@njit(inline="always")
def add_six(body, i, b0, b1, b2, b3, b4, b5):
    body[i, 0], body[i, 1], body[i, 2] = body[i, 0] + b0, body[i, 1] + b1, body[i, 2] + b2
    body[i, 3], body[i, 4], body[i, 5] = body[i, 3] + b3, body[i, 4] + b4, body[i, 5] + b5


@summing_kernel
def add_wet_nodes(wet, linear_moments, bending_moments, chosen, polynomials, body):
    """Add the moments of the surely wet nodes to their instances' sums body (H, 6)."""
    for n in range(wet.shape[0]):
        node, i = wet[n, 0], wet[n, 1]
        q, at = polynomials[i], chosen[i, 1]
        add_products(q, 0, LINEAR, linear_moments, node, 0, body, at)
        add_products(q, LINEAR, BENDING, bending_moments, node, 0, body, at)


@njit(inline="always")
def bend_at(polynomials, i, records, leaf, factor, bend):
    """The six quadratic coefficients of a polynomial around a leaf's middle, times a factor."""
    x, y, z = records[leaf, MIDDLE], records[leaf, MIDDLE + 1], records[leaf, MIDDLE + 2]
    q10, q11, q12, q13, q14 = coefficients(polynomials, i, 10)
    q15, q16, q17, q18, q19 = coefficients(polynomials, i, 15)
    bend[0] = factor * (polynomials[i, 4] + 3.0 * x * q10 + y * q11 + z * q12)
    bend[1] = factor * (polynomials[i, 5] + 2.0 * x * q11 + 2.0 * y * q13 + z * q14)
    bend[2] = factor * (polynomials[i, 6] + 2.0 * x * q12 + y * q14 + 2.0 * z * q15)
    bend[3] = factor * (polynomials[i, 7] + x * q13 + 3.0 * y * q16 + z * q17)
    bend[4] = factor * (polynomials[i, 8] + x * q14 + 2.0 * y * q17 + 2.0 * z * q18)
    bend[5] = factor * (polynomials[i, 9] + x * q15 + y * q18 + 3.0 * z * q19)


@njit(inline="always")
def coefficients(polynomials, i, j):
    """Five coefficients of polynomial i from number j on."""
    return (
        polynomials[i, j], polynomials[i, j + 1], polynomials[i, j + 2], polynomials[i, j + 3],
        polynomials[i, j + 4],
    )  # fmt: skip


@njit(inline="always")
def leaf_heads(polynomials, i, records, leaf, heads, n):
    """Heads [m] of a leaf's vertices, from a polynomial, into row n."""
    q0, q1, q2, q3, q4 = coefficients(polynomials, i, 0)
    q5, q6, q7, q8, q9 = coefficients(polynomials, i, 5)
    q10, q11, q12, q13, q14 = coefficients(polynomials, i, 10)
    q15, q16, q17, q18, q19 = coefficients(polynomials, i, 15)
    for v in range(LEAF_VERTICES):
        x, y = records[leaf, v], records[leaf, LEAF_VERTICES + v]
        z = records[leaf, 2 * LEAF_VERTICES + v]
        heads[n, v] = (
            q0
            + x * (q1 + x * (q4 + x * q10 + y * q11 + z * q12)
                   + y * (q5 + y * q13 + z * q14) + z * (q6 + z * q15))
            + y * (q2 + y * (q7 + y * q16 + z * q17) + z * (q8 + z * q18))
            + z * (q3 + z * (q9 + z * q19))
        )  # fmt: skip


@njit(inline="always")
def wet_vertices(heads, n):
    """The set of wet vertices in row n as bits."""
    wet = 0
    for v in range(LEAF_VERTICES):
        wet |= (1 if heads[n, v] > 0.0 else 0) << v
    return wet


@njit(inline="always")
def add_wet_vertices(heads, n, records, leaf, body, at):
    """Add the sum over a leaf's wet vertices to an instance's sums, and return which share of the
    leaf is wet: the sum of the heads above 0 over that of all heads' sizes, 0 for a dry leaf, 1
    for a wet one, and continuous in between."""
    b0, b1, b2, b3, b4, b5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    wet, total = 0.0, 0.0
    for v in range(LEAF_VERTICES):
        head, j = max(heads[n, v], 0.0), WEIGHTS + v
        wet += head
        total += abs(heads[n, v])
        b0 += head * records[leaf, j]
        b1 += head * records[leaf, j + LEAF_VERTICES]
        b2 += head * records[leaf, j + 2 * LEAF_VERTICES]
        b3 += head * records[leaf, j + 3 * LEAF_VERTICES]
        b4 += head * records[leaf, j + 4 * LEAF_VERTICES]
        b5 += head * records[leaf, j + 5 * LEAF_VERTICES]
    add_six(body, at, b0, b1, b2, b3, b4, b5)
    return wet / total


@summing_kernel
def add_opened_leaves(opened, records, triangles, chosen, polynomials, heads, cut, body):
    """Add the leaves that the waterline may cross to their instances' sums body (H, 6), as if
    their triangles reached down to the last wet vertex: over the wet vertices, and the polynomial's
    part beyond linear heads in proportion to the wet share. Leaves the heads (., LEAF_VERTICES) and
    cut (., 2), codes of the triangles that the waterline cuts and the places of their leaves in
    `opened`; returns how many."""
    count = 0
    bend = np.zeros(QUADRATICS)
    for n in range(opened.shape[0]):
        leaf, i = opened[n, 0], opened[n, 1]
        at = chosen[i, 1]
        leaf_heads(polynomials, i, records, leaf, heads, n)
        wet = wet_vertices(heads, n)
        if wet == 0:
            continue
        share = add_wet_vertices(heads, n, records, leaf, body, at)
        bend_at(polynomials, i, records, leaf, share, bend)
        add_products(bend, 0, QUADRATICS, records, leaf, BENDS, body, at)
        for t in range(LEAF_TRIANGLES):
            cut[count, 0], cut[count, 1] = triangles[leaf, t], n
            corners = triangles[leaf, t] >> CORNER_SET
            count += (wet & corners != 0) & (wet & corners != corners)
    return count


@kernel
def subtract_dry_parts(cut, opened, records, heads, patches, chosen, body):
    """Take from the sums over wet vertices what the clip takes of the triangles that are cut. A
    loop of their own, because nothing in it depends on which they are."""
    for n in range(cut.shape[0]):
        code, at = cut[n, 0], cut[n, 1]
        head, d, i = heads[at], records[opened[at, 0]], opened[at, 1]
        patch = patches[chosen[i, 0]]
        wet_a = head[code & CORNER] > 0.0
        wet_b = head[code >> CORNER_BITS & CORNER] > 0.0
        wet_c = head[code >> 2 * CORNER_BITS & CORNER] > 0.0
        # turned so that the only wet or the only dry corner comes first
        code >>= CORNER_BITS * ((wet_b != wet_c) * (1 + (wet_a != wet_c)))
        a, b, c = code & CORNER, code >> CORNER_BITS & CORNER, code >> 2 * CORNER_BITS & CORNER
        y, z = LEAF_VERTICES, 2 * LEAF_VERTICES
        ax, ay, az = d[a], d[y + a], d[z + a]
        bx, by, bz = d[b], d[y + b], d[z + b]
        cx, cy, cz = d[c], d[y + c], d[z + c]
        sx, sy, sz = cross(bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az)
        px, py, pz = patch[0], patch[1], patch[2]
        share, mx, my, mz = clip_dry_part(
            ax + px, ay + py, az + pz, bx + px, by + py, bz + pz, cx + px, cy + py, cz + pz,
            head[a], head[b], head[c],
        )  # fmt: skip
        tx, ty, tz = cross(mx, my, mz, sx, sy, sz)
        add_six(
            body, chosen[i, 1], -0.5 * share * sx, -0.5 * share * sy, -0.5 * share * sz,
            -0.5 * tx, -0.5 * ty, -0.5 * tz,
        )  # fmt: skip


@njit(inline="always")
def add_turned(body, position, rotation, scale, row):
    """Add an instance's sums (6,), turned into the world and scaled, to a row of the wrenches."""
    if not np.isfinite(np.sum(position) + np.sum(rotation)):
        scale = np.nan  # else no node would be wet and the hull would seem to be dry
    for j in range(3):
        for k in range(3):
            factor = scale * rotation[3 * j + k]
            row[j] += factor * body[k]
            row[3 + j] += factor * body[3 + k]


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")  # for threads
def fleet_wrenches(reals, singles, integers, positions, rotations, time, out):
    """Add the wrenches of all instances of a packed fleet to out (., 6)."""
    tree, setting = unpacked(reals, singles, integers)
    patches, nodes, linear_moments, bending_moments, records, patch_nodes, triangles = tree
    instances, components, steps, most, residual, level, amplitude, scale = setting
    places, chosen = np.empty((3, most + 1)), np.empty((most + 1, 3), np.int64)
    active, most_nodes = reachable_patches(
        patches, patch_nodes, instances, level, amplitude, positions, rotations, places, chosen
    )
    if active == 0:
        return
    chosen = chosen[:active]
    polynomials = np.empty((active, POLYNOMIAL_COLUMNS))
    start = 0
    while start < active:
        end = end_of_tree(start, chosen, instances)
        x, y, z = places[0, start:end], places[1, start:end], places[2, start:end]
        jets = np.empty((JET_ROWS, end - start))
        waves = components[instances[chosen[start, 1], TREE]]
        solve_jets(x, y, waves, time, residual, steps, jets)
        head_polynomials(jets, z, chosen[start:end], rotations, polynomials[start:end])
        start = end
    wet, opened = np.empty((most_nodes, 2), np.int64), np.empty((most_nodes, 2), np.int64)
    wet_count, count = walk(patch_nodes, nodes, patches, chosen, polynomials, wet, opened)
    body = np.zeros((instances.shape[0], 6))
    add_wet_nodes(wet[:wet_count], linear_moments, bending_moments, chosen, polynomials, body)
    heads = np.empty((count, LEAF_VERTICES))
    cut = np.empty((count * LEAF_TRIANGLES + 1, 2), np.int64)
    cut_count = add_opened_leaves(
        opened[:count], records, triangles, chosen, polynomials, heads, cut, body
    )
    subtract_dry_parts(cut[:cut_count], opened, records, heads, patches, chosen, body)
    for i in range(instances.shape[0]):
        pose, row = instances[i, POSE], instances[i, ROW]
        add_turned(body[i], positions[pose], rotations[pose], scale, out[row])
