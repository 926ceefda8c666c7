"""Patches: the work follows the sea, not the mesh.

Over a small region the sea is a quadratic: value, two slopes and three curvatures at a point, its
*jet*, from one Newton solve. In the body frame the head above a place d from the region's centre
is then a polynomial

    head(d) = h + G . d + d . Q d / 2

(for hydrostatic pressure: h = elevation - z, G = R^T (slope, -1), Q = R^T diag(curvature, 0) R),
and the wrench of a piece of surface that is wet all over is linear in its ten coefficients,
with integrals over that piece as factors, which are known beforehand: its *moments*.

Once, when hull and sea are known, the hull is cut into *patches* small enough for the
jet to hold to the tolerance (`patch_radius`), each with a tree of nodes below it
(`patch_tree`). A step is then

1. one jet for each patch, all together (none for a patch above the highest crest);
2. for each patch a walk through its tree: a node that is surely dry adds nothing, one that is
   surely wet its moments times the coefficients, and only nodes on the waterline are opened;
3. at the leaves, heads of the vertices from the polynomial and the straight clip.

The work grows with the number of wavelets under the hull and the length of the waterline, not
with the number of triangles, and no sine or cosine is taken outside of step 1.

In an opened leaf heads are linear over each triangle. What the quadratic has beyond that is
added in proportion to the leaf's wet area, so a leaf that comes to be wet all over has
the very value of its moments, and forces do not jump when nodes open or close.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sim.gerstner import (
    JET_HEIGHT,
    JET_ROWS,
    JET_X,
    JET_XX,
    JET_XY,
    JET_Y,
    JET_YY,
    LABEL_X,
    LABEL_Y,
    PLAIN_STEPS,
    RESIDUAL,
    SCRATCH_ROWS,
    kernel,
    newton_update,
    solve_jets,
    wave_sums,
)
from sim.hull import Hull
from sim.methods.linear import placed
from sim.methods.patch_tree import (
    AFTER,
    LEAF,
    LEAF_AREA,
    LEAF_TRIANGLES,
    MOMENTS,
    MONOMIALS,
    QUADRATIC,
    TRIANGLES,
    TRIANGLES_END,
    VERTICES,
    VERTICES_END,
    build_tree,
    joined,
    packed,
    unpacked,
)
from sim.sea import Sea
from sim.triangle import clip_dry_part, cross

Array = NDArray[np.float64]

DEFAULT_TOLERANCE = 1.0 / 250.0
"""Of the hull's longest side. Errors of patches cancel: this much water height leaves some 1e-4 of
the weight of the displaced water, about what linear has on a mesh of 4000 triangles."""

SAMPLES, DIRECTIONS = 2048, 8
"""Places and directions in which jets are tried on the sea, spread evenly over the particles:
crests, where jets are worst, are where particles crowd."""

SAFETY = 1.5
"""The worst place of the sea may be this much worse than the worst sample."""


class Patches:
    """Wrench of a hull in a sea from jets over patches.

    tolerance [m of water height]: the elevation inside a patch is right to it, everywhere and
    always; None for DEFAULT_TOLERANCE of the hull's longest side. Raises ValueError for a
    tolerance that is not positive or asks for too many patches. Stateless between calls;
    hull and sea are immutable, so what was prepared for them stays true.

    tree: the hull cut for this sea; radius [m]: of the largest patch allowed.
    """

    def __init__(self, hull: Hull, sea: Sea, tolerance: float | None = None) -> None:
        side = float(np.ptp(hull.bounds, axis=0).max())
        if tolerance is None:
            tolerance = DEFAULT_TOLERANCE * side
        if not (np.isfinite(tolerance) and tolerance > 0):
            raise ValueError(
                f"the tolerance is {tolerance} m of water height; it must be finite and above 0"
            )
        self.hull = hull
        self.sea = sea
        self.tolerance = float(tolerance)
        self.radius = patch_radius(sea, self.tolerance, side)
        self.tree = build_tree(hull, self.radius, longest_edge(sea, self.tolerance))
        self._fleet = PatchFleet([self], [0], [0])

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        """Force [N] and torque [N m] about the position, world axes: (6,).

        position: (3,) [m], the hull frame's origin in the world; rotation: (3, 3) or (9,),
        hull -> world; time [s].
        """
        position = np.ascontiguousarray(position, dtype=float).reshape(1, 3)
        rotation = np.ascontiguousarray(rotation, dtype=float).reshape(1, 9)
        out = np.zeros((1, 6))
        self._fleet.add_wrenches(position, rotation, float(time), out)
        return out[0]


class PatchFleet:
    """Several hulls in one sea, computed in one call; those with the same tree share it.

    methods: Patches, all for the same sea; poses: for each the row of its pose in the arrays
    given to `add_wrenches`; rows: its row in what that adds to (several may have the same).
    """

    def __init__(
        self, methods: Sequence[Patches], poses: Sequence[int], rows: Sequence[int]
    ) -> None:
        self._sea = sea = methods[0].sea
        if any(method.sea is not sea for method in methods):
            raise ValueError("the hulls of a fleet float in one sea; make a fleet for each sea")
        trees = list({id(method.tree): method.tree for method in methods}.values())
        first = np.cumsum([0] + [len(tree.patches) for tree in trees])
        which = [next(i for i, t in enumerate(trees) if t is m.tree) for m in methods]
        self._instances = np.array(
            [
                [first[w], first[w + 1], pose, row]
                for w, pose, row in zip(which, poses, rows, strict=True)
            ]
        )
        self._reals, self._integers = packed(joined(trees))
        self._residual = jet_residual(sea, min(method.radius for method in methods))
        self._steps = jet_steps(sea, self._residual)

    def add_wrenches(self, positions: Array, rotations: Array, time: float, out: Array) -> None:
        """Add each hull's wrench, as of `Patches.wrench`, to its row of out (., 6), for its pose
        among positions (., 3) [m] and rotations (., 9)."""
        sea = self._sea
        fleet_wrenches(
            self._reals,
            self._integers,
            self._instances,
            sea.components,
            self._residual,
            self._steps,
            sea.level,
            sea.amplitude,
            -sea.density * sea.gravity,
            positions,
            rotations,
            time,
            out,
        )


def patch_radius(sea: Sea, tolerance: float, largest: float) -> float:
    """Radius [m] up to which a jet of the sea is right to the tolerance [m], inf if that is more
    than `largest` [m].

    A bound from the third derivatives would do as well, but where many waves would have to
    conspire it asks for several times too many patches. So jets are tried where particles
    are, all phases alike, and the worst error found, times SAFETY, has to pass.
    """
    if not sea.components.size:
        return np.inf
    places = _sample_places(sea)
    surface = sea.surface(places[:, 0], places[:, 1], 0.0)
    radius = largest
    for _ in range(12):
        error = SAFETY * _jet_error(sea, places, surface, radius)
        if error <= tolerance:
            return np.inf if radius == largest else radius
        # error ~ radius^3 where it is small; a hair less, so that the next try passes
        radius *= 0.99 * (tolerance / error) ** (1.0 / 3.0)
    return radius


def _sample_places(sea: Sea) -> Array:
    """Places (SAMPLES, 2) [m] of particles whose labels are spread over many wavelengths."""
    span = 1000.0 * max(wave.wavelength for wave in sea.waves)
    labels = np.random.default_rng(0).uniform(-span, span, (SAMPLES, 2))
    return sea.particles(labels, 0.0)[:, :2]


def _jet_error(sea: Sea, places: Array, surface, radius: float) -> float:
    """Largest error [m] of the jets at places, a radius away from them."""
    worst = 0.0
    for angle in 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        d = radius * np.array([np.cos(angle), np.sin(angle)])
        jet = surface.elevation + surface.gradient @ d + 0.5 * (surface.hessian @ d) @ d
        found = sea.elevation(places[:, 0] + d[0], places[:, 1] + d[1], 0.0)
        worst = max(worst, float(np.abs(found - jet).max()))
    return worst


def longest_edge(sea: Sea, tolerance: float) -> float:
    """Edge [m] up to which a surface linear over a triangle is right to the tolerance [m].

    Linear interpolation within a circle of radius r misses M r^2 / 2, M being the largest second
    derivative (of the samples, times SAFETY), and r is at most the edge over the root of 3.
    """
    if not sea.components.size:
        return np.inf
    places = _sample_places(sea)
    hessians = sea.hessian(places[:, 0], places[:, 1], 0.0)
    largest = SAFETY * float(np.abs(np.linalg.eigvalsh(hessians)).max())
    return np.sqrt(6.0 * tolerance / largest) if largest > 0.0 else np.inf


def jet_residual(sea: Sea, radius: float) -> float:
    """Residual [m] at which to stop solving for a jet: one more step then leaves at most a
    hundredth of the radius, from which the jet itself carries on without loss."""
    bend = sum(wave.wavenumber**2 * wave.amplitude for wave in sea.waves)
    if bend == 0.0 or radius == np.inf:
        return sea.residual_tolerance
    return (1.0 - sea.steepness) * np.sqrt(0.02 * radius / bend)


def jet_steps(sea: Sea, residual: float) -> int:
    """Newton steps that bring all samples below a residual [m]. Taking as many for every patch,
    whatever its residual, keeps the wrench a smooth function of the pose."""
    if not sea.components.size:
        return 1
    x, y = _sample_places(sea).T.copy()
    scratch, heights = np.zeros((SCRATCH_ROWS, SAMPLES)), np.empty(SAMPLES)
    scratch[LABEL_X], scratch[LABEL_Y] = x, y
    for steps in range(1, PLAIN_STEPS):
        wave_sums(SAMPLES, sea.components, 0.0, scratch)
        newton_update(x, y, heights, scratch)
        if scratch[RESIDUAL].max() <= residual**2:
            return steps
    return PLAIN_STEPS


@kernel
def reachable_patches(
    patches, instances, level, amplitude, positions, rotations, x, y, z, owner, chosen
):
    """Centres in the world, heights above the level, instances and numbers of all patches that
    the highest crest could reach; returns how many."""
    active = 0
    for i in range(instances.shape[0]):
        position = positions[instances[i, 2]]
        rotation = rotations[instances[i, 2]].reshape(3, 3)
        for p in range(instances[i, 0], instances[i, 1]):
            x[active], y[active], height = placed(patches[p], position, rotation)
            z[active] = height - level
            owner[active] = i
            chosen[active] = p
            active += not z[active] > amplitude + patches[p, 3]
    return active


@kernel
def head_polynomials(jets, z, rows, rotations, polynomials):
    """Coefficients (N, MONOMIALS) in the body frame of the heads around places at heights z [m]
    above the level, from their jets; rows: of the rotations (., 9), body -> world."""
    for i in range(z.size):
        r, q = rotations[rows[i]], polynomials[i]
        gx, gy = jets[JET_X, i], jets[JET_Y, i]
        xx, xy, yy = 0.5 * jets[JET_XX, i], 0.5 * jets[JET_XY, i], 0.5 * jets[JET_YY, i]
        ax, ay, az, bx, by, bz = r[0], r[1], r[2], r[3], r[4], r[5]
        q[0] = jets[JET_HEIGHT, i] - z[i]
        q[1] = gx * ax + gy * bx - r[6]
        q[2] = gx * ay + gy * by - r[7]
        q[3] = gx * az + gy * bz - r[8]
        ux, uy, uz = xx * ax + xy * bx, xx * ay + xy * by, xx * az + xy * bz
        vx, vy, vz = xy * ax + yy * bx, xy * ay + yy * by, xy * az + yy * bz
        q[4] = ux * ax + vx * bx
        q[5] = 2.0 * (ux * ay + vx * by)
        q[6] = 2.0 * (ux * az + vx * bz)
        q[7] = uy * ay + vy * by
        q[8] = 2.0 * (uy * az + vy * bz)
        q[9] = uz * az + vz * bz


@kernel
def walk(patch_nodes, nodes, links, chosen, polynomials, wet, opened):
    """Walk the trees of the chosen patches: (node, place in `chosen`) of the surely wet nodes and
    of the leaves that the waterline may cross, into wet (., 2) and opened (., 2); returns
    how many of each."""
    wet_count, opened_count = 0, 0
    for i in range(chosen.size):
        q = polynomials[i]
        q0, q1, q2, q3, q4 = q[0], q[1], q[2], q[3], q[4]
        q5, q6, q7, q8, q9 = q[5], q[6], q[7], q[8], q[9]
        # bounds |d . Q d| / |d|^2
        curvature = np.sqrt(q4 * q4 + q7 * q7 + q9 * q9 + 0.5 * (q5 * q5 + q6 * q6 + q8 * q8))
        node, end = patch_nodes[chosen[i], 0], patch_nodes[chosen[i], 1]
        while node < end:
            x, y, z = nodes[node, 0], nodes[node, 1], nodes[node, 2]
            u, v, w = nodes[node, 3], nodes[node, 4], nodes[node, 5]
            gx = q1 + 2.0 * q4 * x + q5 * y + q6 * z
            gy = q2 + q5 * x + 2.0 * q7 * y + q8 * z
            gz = q3 + q6 * x + q8 * y + 2.0 * q9 * z
            head = q0 + 0.5 * (x * (q1 + gx) + y * (q2 + gy) + z * (q3 + gz))
            slack = abs(gx) * u + abs(gy) * v + abs(gz) * w + curvature * (u * u + v * v + w * w)
            if head <= -slack:
                node = links[node, AFTER]
            elif head >= slack:
                wet[wet_count, 0], wet[wet_count, 1] = node, i
                wet_count += 1
                node = links[node, AFTER]
            else:
                if links[node, LEAF] >= 0:
                    opened[opened_count, 0], opened[opened_count, 1] = node, i
                    opened_count += 1
                node += 1
    return wet_count, opened_count


@njit(inline="always")
def add_products(q, first, count, row, column, factor, body):
    """Add factor * q[first : first + count] times the (count, 6) block of a row."""
    b0, b1, b2, b3, b4, b5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        c = q[first + k]
        j = column + 6 * k
        b0, b1, b2 = b0 + c * row[j], b1 + c * row[j + 1], b2 + c * row[j + 2]
        b3, b4, b5 = b3 + c * row[j + 3], b4 + c * row[j + 4], b5 + c * row[j + 5]
    add_six(body, factor * b0, factor * b1, factor * b2, factor * b3, factor * b4, factor * b5)


@njit(inline="always")
def add_six(body, b0, b1, b2, b3, b4, b5):
    body[0], body[1], body[2] = body[0] + b0, body[1] + b1, body[2] + b2
    body[3], body[4], body[5] = body[3] + b3, body[4] + b4, body[5] + b5


@kernel
def add_wet_nodes(wet, nodes, owner, polynomials, body):
    """Add the moments of the surely wet nodes to their instances' sums body (H, 6)."""
    for n in range(wet.shape[0]):
        i = wet[n, 1]
        add_products(polynomials[i], 0, MONOMIALS, nodes[wet[n, 0]], MOMENTS, 1.0, body[owner[i]])


@njit(inline="always")
def evaluate_heads(first, count, places, q, heads):
    """Heads (count,) [m] of a leaf's vertices; returns the set of wet ones as bits."""
    q0, q1, q2, q3, q4 = q[0], q[1], q[2], q[3], q[4]
    q5, q6, q7, q8, q9 = q[5], q[6], q[7], q[8], q[9]
    for i in range(count):
        x, y, z = places[0, first + i], places[1, first + i], places[2, first + i]
        heads[i] = (
            q0
            + x * (q1 + x * q4 + y * q5 + z * q6)
            + y * (q2 + y * q7 + z * q8)
            + z * (q3 + z * q9)
        )
    wet = 0
    for i in range(count):
        wet |= (1 if heads[i] > 0.0 else 0) << i
    return wet


@njit(inline="always")
def odd_corner(a, b, c, ea, eb, ec):
    """The corners and their heads, turned so that the only wet or the only dry one is first."""
    wet_a, wet_b, wet_c = ea > 0.0, eb > 0.0, ec > 0.0
    if wet_b == wet_c:
        return a, b, c, ea, eb, ec
    if wet_a == wet_c:
        return b, c, a, eb, ec, ea
    return c, a, b, ec, ea, eb


@njit(inline="always")
def add_leaf(first, count, wet, start, end, places, weights, triangles, areas, patch, heads, body):
    """Add the sum over a leaf's wet vertices, less what the clip takes from cut triangles
    (start to end); returns the wet part of the area."""
    cx, cy, cz = patch[0], patch[1], patch[2]
    b0, b1, b2, b3, b4, b5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # in registers, unlike body
    for i in range(count):
        head, w = max(heads[i], 0.0), weights[first + i]
        b0, b1, b2 = b0 + head * w[0], b1 + head * w[1], b2 + head * w[2]
        b3, b4, b5 = b3 + head * w[3], b4 + head * w[4], b5 + head * w[5]
    wet_area = 0.0
    for t in range(start, end):
        corners = triangles[t, 3]
        if wet & corners == corners:
            wet_area += areas[t, 3]
        elif wet & corners != 0:
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            ea, eb, ec = heads[a - first], heads[b - first], heads[c - first]
            a, b, c, ea, eb, ec = odd_corner(a, b, c, ea, eb, ec)
            share, mx, my, mz = clip_dry_part(
                places[0, a] + cx, places[1, a] + cy, places[2, a] + cz,
                places[0, b] + cx, places[1, b] + cy, places[2, b] + cz,
                places[0, c] + cx, places[1, c] + cy, places[2, c] + cz,
                ea, eb, ec,
            )  # fmt: skip
            sx, sy, sz = areas[t, 0], areas[t, 1], areas[t, 2]
            tx, ty, tz = cross(mx, my, mz, sx, sy, sz)
            b0, b1, b2 = b0 - share * sx, b1 - share * sy, b2 - share * sz
            b3, b4, b5 = b3 - tx, b4 - ty, b5 - tz
            corner = ea / (ea - eb) * (ea / (ea - ec))
            wet_area += areas[t, 3] * (corner if ea > 0.0 else 1.0 - corner)
    add_six(body, b0, b1, b2, b3, b4, b5)
    return wet_area


@kernel
def add_opened_leaves(
    opened, nodes, links, places, weights, triangles, areas, leaves, patches, chosen, owner,
    polynomials, body,
):  # fmt: skip
    """Add the leaves that the waterline may cross to their instances' sums body (H, 6). The
    quadratic's part beyond linear heads enters in proportion to the wet area."""
    heads = np.empty(3 * LEAF_TRIANGLES)
    for n in range(opened.shape[0]):
        node, i = opened[n, 0], opened[n, 1]
        link, q, total = links[node], polynomials[i], body[owner[i]]
        first, count = link[VERTICES], link[VERTICES_END] - link[VERTICES]
        wet = evaluate_heads(first, count, places, q, heads)
        if wet == (1 << count) - 1:
            add_products(q, 0, MONOMIALS, nodes[node], MOMENTS, 1.0, total)
        elif wet != 0:
            wet_area = add_leaf(
                first, count, wet, link[TRIANGLES], link[TRIANGLES_END],
                places, weights, triangles, areas, patches[chosen[i]], heads, total,
            )  # fmt: skip
            leaf = leaves[link[LEAF]]
            fraction = wet_area / leaf[LEAF_AREA]
            add_products(q, QUADRATIC, MONOMIALS - QUADRATIC, leaf, 0, fraction, total)


@kernel
def fleet_wrenches(
    reals, integers, instances, components, residual, steps, level, amplitude, scale,
    positions, rotations, time, out,
):  # fmt: skip
    """Add the wrenches of all instances (H, 4), first patch, end, pose and row, to out (., 6)."""
    patches, patch_nodes, nodes, links, places, weights, triangles, areas, leaves = unpacked(
        reals, integers
    )
    most = np.sum(instances[:, 1] - instances[:, 0])
    x, y, z = np.empty(most), np.empty(most), np.empty(most)
    owner, chosen = np.empty(most, np.int64), np.empty(most, np.int64)
    active = reachable_patches(
        patches, instances, level, amplitude, positions, rotations, x, y, z, owner, chosen
    )
    if active == 0:
        return
    owner, chosen = owner[:active], chosen[:active]
    jets = np.empty((JET_ROWS, active))
    solve_jets(x[:active], y[:active], components, time, residual, steps, jets)
    polynomials = np.empty((active, MONOMIALS))
    head_polynomials(jets, z[:active], instances[owner, 2], rotations, polynomials)
    subtree_nodes = np.sum(patch_nodes[chosen, 1] - patch_nodes[chosen, 0])
    wet, opened = np.empty((subtree_nodes, 2), np.int64), np.empty((subtree_nodes, 2), np.int64)
    counts = walk(patch_nodes, nodes, links, chosen, polynomials, wet, opened)
    body = np.zeros((instances.shape[0], 6))
    add_wet_nodes(wet[: counts[0]], nodes, owner, polynomials, body)
    add_opened_leaves(
        opened[: counts[1]], nodes, links, places, weights, triangles, areas, leaves, patches,
        chosen, owner, polynomials, body,
    )  # fmt: skip
    for i in range(instances.shape[0]):
        pose, row = instances[i, 2], instances[i, 3]
        if not np.isfinite(np.sum(positions[pose]) + np.sum(rotations[pose])):
            body[i] = np.nan  # else no node would be wet and the hull would seem to be dry
        for j in range(3):
            for k in range(3):
                factor = scale * rotations[pose, 3 * j + k]
                out[row, j] += factor * body[i, k]
                out[row, 3 + j] += factor * body[i, 3 + k]
