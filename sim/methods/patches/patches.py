"""Patches: a method whose work depends on the sea, not on the mesh.

Over a small region the head is a cubic: its value and derivatives up to the third at a point, its
*jet*, from one Newton solve. The cubic is not Taylor's but nearly the best one over the region
(`fit`), at the same cost. In the body frame, the head at d from the region's centre is then a
polynomial

    head(d) = h + G . d + d . Q d / 2 + C(d, d, d) / 6

(for hydrostatic pressure, whose jet is the surface's: h = elevation - z, G = R^T (slope, -1), Q =
R^T diag(curvature, 0) R, and C the third derivatives rotated in the same way). The wrench of a
piece of surface that is wet all over is linear in the twenty coefficients of the polynomial. The
factors are integrals over the piece, its *moments*, which are computed in advance.

For a given hull and sea, the hull is cut once into *patches* small enough for the jet to keep the
tolerance (`fit.jet_radius`). Each has a tree of nodes below it (`tree`). A step then has three
stages:

1. One jet for each patch, all together. A patch above the highest crest has none, nor a patch that
   is out of the water's reach once the height of the surface is known.
2. A walk through the tree of each patch. A node that is surely dry adds nothing. A node that is
   surely wet adds its moments times the coefficients. Only nodes on the waterline are opened.
3. At the leaves, heads of the vertices from the polynomial and the straight clip.

Far below the surface only long waves are left, and larger patches suffice. The tree therefore has
levels (`fit.deep_levels`): patches of each level hold from some depth of their centres on, and
divide into patches of the level below. A step uses the largest that it may. They are wet all over.

The work grows with the number of small waves under the hull and the length of the waterline, not
with the number of triangles. Only stage 1 computes sines and cosines.

In an opened leaf, heads are linear over each triangle. The terms of the polynomial beyond that are
added in proportion to the wet share of the leaf. A leaf that becomes wet all over then has exactly
the value of its moments, and forces do not jump when nodes open or close.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import placed, random_rotation
from sim.hulls.hull import Hull
from sim.hulls.triangle import dry_weights
from sim.kernels import (
    inline,
    kernel,
    lowest_bit,
    packed,
    read_only,
    record,
    scratch,
    summing_kernel,
    table,
    workspace,
    workspaces,
)
from sim.methods.linear import write_turned
from sim.methods.method import Compiled, Part, Settings
from sim.methods.patches.fit import CENTRE_SHIFT_RADII, Level, jet_waves, steepest_slope
from sim.methods.patches.polynomial import (
    BENDING,
    LINEAR,
    MONOMIALS,
    POLYNOMIAL,
    bend_at,
    decayed_polynomials,
    five,
    head_and_slope,
    head_polynomials,
    monomials,
)
from sim.methods.patches.sizes import cut, default_tolerance
from sim.methods.patches.tree import (
    CORNER_BITS,
    LEAF,
    LEAF_TERMS,
    LEAF_VERTICES,
    MOMENTS,
    NODE,
    PATCH,
    TRIANGLE,
    PatchTree,
    corner,
    joined,
)
from sim.notes import say
from sim.precision import IS_SINGLE, reals, single, word
from sim.water.gerstner import (
    CHUNK,
    PLAIN_STEPS,
    ROW,
    WATER,
    WAVE,
    growth,
    level_and_rise,
)
from sim.water.head_jets import HEAD_JETS, solve_head_jets
from sim.water.jets import JET, Near, find_near, solve_jets
from sim.water.many_waves import (
    MANY_WAVES,
    find_many_near,
    solve_many_head_jets,
    solve_many_jets,
)
from sim.water.samples import SAFETY, newton_steps, sample_places
from sim.water.sea import Sea

Array = NDArray[np.float64]
Table = NDArray[np.void]

SINGLE_TOLERANCE = 1e-5
"""Smallest tolerance of a head, as a share of the highest crest and of the hull's length, for which
single precision is accurate enough by far."""

LARGEST_FORCE_ERROR, JUDGED_POSES = 1e-2, 4
"""Largest error of the force that a coarsened tolerance may leave, as a share of density * gravity
* volume, and the number of poses in which it is measured. With 4 poses this takes a third of the
time of cutting the hull."""

INSTANCE = record(pose="i8", row="i8", first="i8", end="i8", level="i8", levels="i8")
"""A hull of a batch: rows of its pose and its wrench, its first patch and the end of its patches,
and the first LEVEL row and the number of levels of its tree."""

SOLVE = record(steps="i8", residual="f8", squeeze="f8", reach="f8")
"""steps: number of Newton steps to a jet; residual [m] that is allowed after them; squeeze: limit
of J in jets (see `jets`); reach: height above the surface, in radii of a patch, beyond which the
patch is out of the water's reach, with the surface above the patch's centre."""

LEVEL = record(first="i8", end="i8", depth="f8", sunk="f8", rise="f8")
"""A level of a tree: the range of its fitted waves; the depth [m] below the still level from which
the centres of its patches must lie, 0 for level 0; and the head [m] that the waves take which
matter only above, with their `rise` (see `gerstner.WAVE`)."""

CHOSEN = record(patch="i8", instance="i8", pose="i8")
"""A patch that the water could reach, its instance and its pose."""

PLACES = record(x=ROW, y=ROW, above=ROW, label_x=ROW, label_y=ROW, height=ROW)
"""Workspace: a chunk's centres of patches, x and y in the world and heights above the level [m],
and the particles near them, as in `jets.Near`."""


class Water(NamedTuple):
    """The tables of the sea in a block. `waves` holds the fitted waves of one level after
    another."""

    waves: Table
    water: Table
    solve: Table
    levels: Table


class Patches(Compiled):
    """Wrench of a hull in a sea from jets over patches.

    tolerance [m of water height]: bound on the error of the head inside every patch, at all times.
    None for the default, which leaves an error of the force of less than 1e-3 of the displaced
    water's weight, or for the nearest tolerance that can be kept (see `sizes`). Raises ValueError
    for a tolerance that is not positive or needs too many patches.

    is_coarse: whether the default could not be kept; is_loose: whether the tolerance is far above
    the errors of single precision, which is then used unless the sea is about to fold; tree: the
    hull cut for this sea; radius [m]: of the largest patch allowed at the surface, inf on flat
    water; levels: the fitted components of the sea from which this hull's jets are made, as in the
    search for the radius, and those of the larger patches far below the surface. Fits over smaller
    discs can have larger errors where a wave is shorter than a patch.
    """

    def __init__(self, hull: Hull, sea: Sea, tolerance: float | None = None) -> None:
        self._make(hull, sea, tolerance)
        say(self.notes)

    @classmethod
    def from_settings(cls, hull: Hull, sea: Sea, settings: Settings) -> Self:
        """See `Method`. Notes are not said but left to the scene."""
        method = cls.__new__(cls)
        method._make(hull, sea, settings.buoyancy_tolerance)
        return method

    def _make(self, hull: Hull, sea: Sea, tolerance: float | None) -> None:
        if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
            raise ValueError(
                f"the tolerance is {tolerance} m of water height; it must be finite and above 0"
            )
        super().__init__(hull, sea)
        sizes, self.tree = cut(hull, sea, tolerance)
        self.radius, self.tolerance = sizes.radius, sizes.tolerance
        scale = max(float(sea.water["amplitude"][0]), hull.length)
        self.is_loose = bool(sea.waves) and sizes.tolerance > SINGLE_TOLERANCE * scale
        self.squeeze = sizes.squeeze
        self.is_coarse = sizes.is_coarse
        self.levels = (Level(self.radius, 0.0, 0.0, jet_waves(sea, self.radius)), *sizes.deep)
        self._prepare()
        if self.is_coarse:
            self._judge_force()

    def _judge_force(self) -> None:
        """Note a tolerance that was coarsened. Raises ValueError if it leaves too large an error of
        the force."""
        error, count = self._force_error(), len(self.tree.patches)
        if error > LARGEST_FORCE_ERROR:
            raise ValueError(
                f"{count} patches leave an error of the force of {error:.2g} of density * gravity "
                f"* volume at the crests of this sea; expected at most {LARGEST_FORCE_ERROR:g}: "
                "lower or lengthen the waves, or set buoyancy_method to linear on small faces"
            )
        self.notes = (
            f"the water's height is kept to {self.tolerance:.2g} m instead of "
            f"{default_tolerance(self.hull):.2g} m, and forces at crests to {error:.1g} of density "
            f"* gravity * volume: {count} patches cannot follow waves this steep or short more "
            "closely; a buoyancy_tolerance that you set is kept or refused",
        )

    def _force_error(self) -> float:
        """Largest error of the force, as a share of density * gravity * volume, from the patches'
        heads at the vertices of their triangles, with the hull half under the highest crests among
        the samples."""
        x, y = sample_places(self.sea)
        heights = self.sea.elevation(x, y, self.sea.ramp)
        weights, errors = self.tree.leaves["weights"][:, :3, :LEAF_VERTICES], []
        rng = np.random.default_rng(0)
        for i in np.argsort(-heights)[:JUDGED_POSES]:
            rotation = random_rotation(rng)
            position = np.array([x[i], y[i], heights[i]]) - rotation @ self.hull.centroid
            places, found = self.heads_at_vertices(position, rotation, self.sea.ramp)
            px, py, pz = places.T
            true = self.sea.head(px, py, pz, self.sea.ramp)
            missed = np.maximum(np.nan_to_num(found), 0.0) - np.maximum(true, 0.0)
            errors.append(np.einsum("lv,lav->a", missed.reshape(-1, LEAF_VERTICES), weights))
        return float(np.linalg.norm(errors, axis=1).max() / self.hull.volume)

    @classmethod
    def parts(cls, methods: Sequence[Self], places: Table) -> list[Part]:
        """One part for hulls with a loose tolerance, and one for others."""
        groups: dict[bool, list[int]] = {True: [], False: []}
        for i, method in enumerate(methods):
            groups[method.is_loose].append(i)
        return [cls._part([methods[i] for i in g], places[g]) for g in groups.values() if g]

    @classmethod
    def _part(cls, methods: Sequence[Self], places: Table) -> Part:
        """A part of hulls in one precision. Hulls with the same tree share it."""
        sea = methods[0].sea
        of_trees = list({id(method.tree): method for method in methods}.values())
        numbers = {id(method.tree): i for i, method in enumerate(of_trees)}
        first = np.cumsum([0] + [len(method.tree.patches) for method in of_trees])
        levels = np.cumsum([0] + [len(method.levels) for method in of_trees])
        which = [numbers[id(method.tree)] for method in methods]
        instances = np.array(
            [
                (place["pose"], place["row"], *first[w : w + 2], levels[w],
                 len(of_trees[w].levels))
                for w, place in zip(which, places, strict=True)
            ],
            INSTANCE,
        )  # fmt: skip
        of_levels = [level for method in of_trees for level in method.levels]
        waves = np.concatenate([level.waves for level in of_levels])
        tables, solve = joined([m.tree for m in of_trees]), solve_table(methods)
        kernel = patches_wrenches
        if methods[0].is_loose and solve["steps"][0] < PLAIN_STEPS:
            kernel = single_patches_wrenches
            tables, waves = tables.in_single, waves.astype(single(WAVE))
        block = packed(*tables, waves, sea.water, solve, level_table(of_levels, sea))
        instances = instances[np.argsort(which, kind="stable")]
        return Part(kernel, block, read_only(instances))

    def _polynomials(self, positions: Array, rotations: Array, time: float) -> tuple[Table, Table]:
        """The CHOSEN patches and the POLYNOMIAL of each, for poses (1, 3) and (1, 9)."""
        kernel, block, instances = self._alone
        of_block = polynomials_of if kernel is patches_wrenches else single_polynomials_of
        return of_block(block, instances, positions, rotations, time)

    def heads_at_vertices(
        self, position: ArrayLike, rotation: ArrayLike, time: float
    ) -> tuple[Array, Array]:
        """Heads from the patches' polynomials at the vertices of all their triangles, to measure
        their error: points (N, 3) [m] in the world and heads (N,) [m] there, NaN out of the water's
        reach."""
        positions = np.ascontiguousarray(position, dtype=float).reshape(1, 3)
        rotations = np.ascontiguousarray(rotation, dtype=float).reshape(1, 9)
        chosen, reached = self._polynomials(positions, rotations, float(time))
        patches, leaves = self.tree.patches, self.tree.leaves
        coefficients, used = np.full((len(patches), MONOMIALS), np.nan), np.arange(len(patches))
        for patch, row, head in zip(chosen["patch"], reached["c"], reached["head"], strict=True):
            inside = slice(patch, patches["after"][patch])
            coefficients[inside], used[inside] = row, patch
            coefficients[inside, 0] = head
        small = np.flatnonzero(patches["level"] == 0)
        of_leaf = np.flatnonzero(self.tree.nodes["leaf"] >= 0)
        patch = small[np.searchsorted(patches["end"][small], of_leaf, side="right")]
        places = np.stack([leaves[axis][:, :LEAF_VERTICES] for axis in "xyz"], axis=-1)
        centres = np.stack([patches[axis] for axis in "xyz"], axis=-1)
        places += centres[patch][:, None]
        from_centres = places - centres[used[patch]][:, None]
        heads = np.einsum("lvm,lm->lv", monomials(from_centres), coefficients[patch])
        return places.reshape(-1, 3) @ rotations.reshape(3, 3).T + positions, heads.ravel()


def solve_table(methods: Sequence[Patches]) -> Table:
    """The SOLVE row of methods that share a sea."""
    sea = methods[0].sea
    radii = [m.tree.patches["radius"][m.tree.patches["level"] == 0] for m in methods]
    residual = CENTRE_SHIFT_RADII * min(each.max() for each in radii)
    steps, _ = newton_steps(sea, residual / SAFETY)
    if steps == PLAIN_STEPS:  # near a fold, a small residual does not mean a near label
        residual = float(sea.water["tolerance"][0])
    squeeze = max(method.squeeze for method in methods)
    slope = steepest_slope(sea)
    # the heights are those of nearby particles, hence the shift
    reach = np.hypot(1.0, slope) + CENTRE_SHIFT_RADII * slope
    return np.array([(steps, residual, squeeze, reach)], SOLVE)


def level_table(levels: Sequence[Level], sea: Sea) -> Table:
    """LEVEL rows."""
    ends = np.cumsum([len(level.waves) for level in levels])
    rise = sea.components["rise"].max(initial=0.0)
    rows = [
        (end - len(level.waves), end, level.depth, level.sunk, rise)
        for end, level in zip(ends, levels, strict=True)
    ]
    return np.array(rows, LEVEL)


@inline
def tree_of(block):
    """The tables of the hulls in a block."""
    return PatchTree(
        table(block, 0, PATCH),
        table(block, 1, NODE),
        table(block, 2, MOMENTS),
        table(block, 3, LEAF),
        table(block, 4, TRIANGLE),
    )


@inline
def water_of(block):
    """The tables of the sea in a block."""
    return Water(
        table(block, 5, WAVE), table(block, 6, WATER), table(block, 7, SOLVE),
        table(block, 8, LEVEL),
    )  # fmt: skip


@kernel
def most_patches(instances):
    """Number of patches of all instances together."""
    count = 0
    for i in range(instances.size):
        count += instances[i].end - instances[i].first
    return count


@kernel
def next_patches(
    tree, instances, run, number, sea, time, positions, rotations, places_out, chosen_out
):
    """Find up to CHUNK patches of a level of a run of instances that the highest crest could reach,
    and in which no larger patch may be used: their PLACES and their CHOSEN rows.

    run: the instance and the patch to begin with and the end of the run, which share a tree;
    number: of the level. Return the number of patches, and the instance and the patch to go on
    with.
    """
    level, _ = level_and_rise(sea.water[0], time)
    crest, places, count = sea.water[0].amplitude, places_out[0], 0
    first, p, last = run
    for i in range(first, last):
        end, pose = instances[i].end, instances[i].pose
        if i > first:
            p = instances[i].first
        position, rotation = positions[pose], rotations[pose]
        while p < end:
            if count == CHUNK:
                return count, i, p
            patch = tree.patches[p]
            x, y, z = placed(patch.x, patch.y, patch.z, position, rotation)
            if patch.level > 0 and z - level > -sea.levels[instances[i].level + patch.level].depth:
                p += 1
                continue
            if patch.level == number and not z - level > crest + patch.radius:
                places.x[count], places.y[count], places.above[count] = x, y, z - level
                chosen = chosen_out[count]
                chosen.patch, chosen.instance, chosen.pose = p, i, pose
                count += 1
            p = patch.after
    return count, last, p


@inline
def end_of_tree(start, instances):
    """The end of the run of instances with the same tree as the instance at `start`."""
    level, end = instances[start].level, start
    while end < instances.size and instances[end].level == level:
        end += 1
    return end


@inline
def add_products(factors, first, count, rows, sums_out, at):
    """Add the product of rows (6, count) and the factors from number `first` on to the sums of an
    instance."""
    b0, b1, b2, b3, b4, b5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # kept in registers, unlike the sums
    for i in range(count):
        f = factors[first + i]
        b0 += f * rows[0, i]
        b1 += f * rows[1, i]
        b2 += f * rows[2, i]
        b3 += f * rows[3, i]
        b4 += f * rows[4, i]
        b5 += f * rows[5, i]
    add_six(sums_out, at, b0, b1, b2, b3, b4, b5)


@inline
def add_six(sums_out, i, b0, b1, b2, b3, b4, b5):
    """Add a force and a torque to the sums of instance i."""
    sums_out[i, 0] += b0
    sums_out[i, 1] += b1
    sums_out[i, 2] += b2
    sums_out[i, 3] += b3
    sums_out[i, 4] += b4
    sums_out[i, 5] += b5


@inline
def add_wet_node(moments, p, sums_out, at):
    """Add the MOMENTS of a surely wet node, times a POLYNOMIAL, to an instance's sums."""
    h, x, y, z, k = p.head, p.c[1], p.c[2], p.c[3], moments.linear
    add_six(
        sums_out, at,
        h * k[0, 0] + x * k[0, 1] + y * k[0, 2] + z * k[0, 3],
        h * k[1, 0] + x * k[1, 1] + y * k[1, 2] + z * k[1, 3],
        h * k[2, 0] + x * k[2, 1] + y * k[2, 2] + z * k[2, 3],
        h * k[3, 0] + x * k[3, 1] + y * k[3, 2] + z * k[3, 3],
        h * k[4, 0] + x * k[4, 1] + y * k[4, 2] + z * k[4, 3],
        h * k[5, 0] + x * k[5, 1] + y * k[5, 2] + z * k[5, 3],
    )  # fmt: skip
    add_products(p.c, LINEAR, BENDING, moments.bending, sums_out, at)


@inline
def set_leaf_heads(c, leaf, heads_out, terms_out):
    """Heads [m] of a leaf's vertices, from a polynomial, and the positive ones alone: (LEAF_TERMS,)
    each. Return the wet share of the leaf, and the triangles whose first, second and third corner
    is wet, as bits.

    The share is the sum of the positive heads over the sum of all heads' magnitudes. It is 0 for a
    dry leaf, 1 for a wet one, and continuous in between.
    """
    q0, q1, q2, q3, q4 = five(c, 0)
    q5, q6, q7, q8, q9 = five(c, 5)
    q10, q11, q12, q13, q14 = five(c, 10)
    q15, q16, q17, q18, q19 = five(c, 15)
    share, total = 0.0, 0.0
    wet_a, wet_b, wet_c, none = word(0), word(0), word(0), word(0)
    for v in range(LEAF_TERMS):
        x, y, z = leaf.x[v], leaf.y[v], leaf.z[v]
        head = (
            q0
            + x * (q1 + x * (q4 + x * q10 + y * q11 + z * q12)
                   + y * (q5 + y * q13 + z * q14) + z * (q6 + z * q15))
            + y * (q2 + y * (q7 + y * q16 + z * q17) + z * (q8 + z * q18))
            + z * (q3 + z * (q9 + z * q19))
        )  # fmt: skip
        is_wet = head > 0.0
        heads_out[v], terms_out[v] = head, head if is_wet else 0.0
        share += head if is_wet else 0.0
        total += abs(head)
        wet_a = word(wet_a | (leaf.fans[0, v] if is_wet else none))
        wet_b = word(wet_b | (leaf.fans[1, v] if is_wet else none))
        wet_c = word(wet_c | (leaf.fans[2, v] if is_wet else none))
    return share / total, wet_a, wet_b, wet_c


@inline
def subtract_dry_parts(crossed, odd_b, odd_c, leaf, triangles, heads, sums_out, at):
    """Subtract from an instance's sums over wet vertices what the clip removes from the triangles
    of a leaf that the water cuts.

    crossed: these triangles as bits; odd_b, odd_c: those whose only wet or only dry corner is the
    second or third; heads: of the leaf's vertices.
    """
    b0, b1, b2, b3, b4, b5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    while crossed != 0:
        t = lowest_bit(crossed)
        crossed &= crossed - 1
        i = (odd_b >> t & 1) + 2 * (odd_c >> t & 1)
        row, code = triangles[leaf.first + t], leaf.triangles[t] >> i * CORNER_BITS
        u, v, w = dry_weights(
            heads[corner(code, 0)], heads[corner(code, 1)], heads[corner(code, 2)]
        )
        b0 += (u + v + w) * row.area[0]
        b1 += (u + v + w) * row.area[1]
        b2 += (u + v + w) * row.area[2]
        b3 += u * row.arms[i, 0] + v * row.arms[i + 1, 0] + w * row.arms[i + 2, 0]
        b4 += u * row.arms[i, 1] + v * row.arms[i + 1, 1] + w * row.arms[i + 2, 1]
        b5 += u * row.arms[i, 2] + v * row.arms[i + 1, 2] + w * row.arms[i + 2, 2]
    add_six(sums_out, at, -b0, -b1, -b2, -b3, -b4, -b5)


@inline
def add_opened_leaf(leaf, triangles, c, heads, terms, sums_out, at):
    """Add a leaf that the waterline may cross to an instance's sums: the sums over the wet
    vertices, the polynomial's terms beyond linear heads in proportion to the wet share, and all
    that without what the clip removes. heads, terms: workspaces (LEAF_TERMS,)."""
    share, wet_a, wet_b, wet_c = set_leaf_heads(c, leaf, heads, terms)
    wet, first = wet_a | wet_b | wet_c, LEAF_VERTICES
    if wet != 0:
        xx, xy, xz, yy, yz, zz = bend_at(c, leaf, share)
        terms[first], terms[first + 1], terms[first + 2] = xx, xy, xz
        terms[first + 3], terms[first + 4], terms[first + 5] = yy, yz, zz
        add_products(terms, 0, LEAF_TERMS, leaf.weights, sums_out, at)
        crossed = wet & ~(wet_a & wet_b & wet_c)
        odd_b, odd_c = crossed & ~(wet_a ^ wet_c), crossed & ~(wet_a ^ wet_b)
        subtract_dry_parts(crossed, odd_b, odd_c, leaf, triangles, heads, sums_out, at)


@summing_kernel
def add_nodes(first, end, radius, tree, polynomial, at, sums_out):
    """Add the wet surface of some nodes of a patch of a radius [m] to the sums (H, 6) of instance
    number `at`. A node that is surely dry adds nothing, and one that is surely wet adds its
    moments. Other nodes are opened, and leaves that the waterline may cross are cut. polynomial:
    POLYNOMIAL of the patch, in a table of one row."""
    heads, terms, p, node = reals(LEAF_TERMS), reals(LEAF_TERMS), polynomial[0], first
    # The box around points in a ball has its middle at most 1.1 radii from the ball's centre, and
    # so at most 2.1 radii from any point. Around that middle the cubic contributes
    # 3 C(middle, u, u) + C(u, u, u).
    bend = p.bound_2 + (3.0 * 1.1 + 2.1) * radius * p.bound_3
    while node < end:
        box = tree.nodes[node]
        u, v, w = box.half_x, box.half_y, box.half_z
        value, gx, gy, gz = head_and_slope(p.c, box.x, box.y, box.z)
        slack = abs(gx) * u + abs(gy) * v + abs(gz) * w + bend * (u * u + v * v + w * w)
        if value <= -slack:
            node = box.after
        elif value >= slack:
            add_wet_node(tree.moments[node], p, sums_out, at)
            node = box.after
        else:
            if box.leaf >= 0:
                leaf = tree.leaves[box.leaf]
                add_opened_leaf(leaf, tree.triangles, p.c, heads, terms, sums_out, at)
            node += 1


@kernel
def keep_reached(count, patches, reach, places_out, chosen_out):
    """Move those of the first `count` patches that the water can reach to the front, with their
    PLACES. Return their number."""
    places, kept = places_out[0], 0
    for i in range(count):
        if places.above[i] - places.height[i] > reach * patches[chosen_out[i].patch].radius:
            continue
        if kept < i:
            places.x[kept], places.y[kept] = places.x[i], places.y[i]
            places.above[kept], places.height[kept] = places.above[i], places.height[i]
            places.label_x[kept], places.label_y[kept] = places.label_x[i], places.label_y[i]
            chosen_out[kept] = chosen_out[i]
        kept += 1
    return kept


@inline
def near_in(places, count):
    """The particles Near the first `count` PLACES."""
    return Near(places.label_x[:count], places.label_y[:count], places.height[:count])


@kernel
def find_particles(count, waves, time, solve, places_out):
    """Find the particles near the first `count` PLACES, from fitted waves."""
    places = places_out[0]
    x, y, near = places.x[:count], places.y[:count], near_in(places, count)
    if IS_SINGLE and waves.size >= MANY_WAVES:
        find_many_near(x, y, waves, time, solve.steps, near)
    else:
        find_near(x, y, waves, time, solve.steps, solve.residual, near)


@kernel
def set_polynomials(sea, waves, found, time, chosen, rotations, polynomials_out):
    """Polynomials (N,) of the heads around the chosen patches' centres, whose PLACES were found,
    from fitted waves."""
    places, solve = found[0], sea.solve[0]
    x, y, above = places.x[: chosen.size], places.y[: chosen.size], places.above[: chosen.size]
    near, tolerance, squeeze = near_in(places, chosen.size), solve.residual, solve.squeeze
    is_many = IS_SINGLE and waves.size >= MANY_WAVES
    if sea.water[0].decays and waves.size > 0:
        head_jets = workspace(HEAD_JETS)
        if is_many:
            solve_many_head_jets(x, y, above, near, waves, time, tolerance, squeeze, head_jets)
        else:
            solve_head_jets(x, y, above, near, waves, time, tolerance, squeeze, head_jets)
        decayed_polynomials(head_jets, chosen, rotations, polynomials_out)
    else:
        jets = workspaces(CHUNK, JET)[: chosen.size]
        if is_many:
            solve_many_jets(x, y, near, waves, time, tolerance, squeeze, jets)
        else:
            solve_jets(x, y, near, waves, time, tolerance, squeeze, jets)
        head_polynomials(jets, above, chosen, rotations, polynomials_out)


@kernel
def sink_heads(level, time, polynomials_out):
    """Take from the heads of a level's patches what the waves take that it leaves out."""
    part = growth(level, time)
    for i in range(polynomials_out.size):
        polynomials_out[i].head -= part * part * level.sunk
        polynomials_out[i].c[0] = polynomials_out[i].head


@kernel
def reached_polynomials(
    tree, sea, instances, positions, rotations, time, chosen_out, polynomials_out
):
    """Find the CHOSEN patches that the water could reach, and the POLYNOMIAL of the head over each.
    Return their number."""
    places, solve, start, count = workspace(PLACES), sea.solve[0], 0, 0
    while start < instances.size:
        end = end_of_tree(start, instances)
        for number in range(instances[start].levels):
            level = sea.levels[instances[start].level + number]
            waves = sea.waves[level.first : level.end]
            i, p = start, instances[start].first
            while i < end:
                chosen = chosen_out[count:]
                found, i, p = next_patches(
                    tree, instances, (i, p, end), number, sea, time, positions, rotations, places,
                    chosen,
                )  # fmt: skip
                find_particles(found, waves, time, solve, places)
                kept = keep_reached(found, tree.patches, solve.reach, places, chosen)
                to = polynomials_out[count : count + kept]
                if kept > 0:
                    set_polynomials(sea, waves, places, time, chosen[:kept], rotations, to)
                if level.sunk > 0.0:
                    sink_heads(level, time, to)
                count += kept
        start = end
    return count


@summing_kernel
def add_surface(tree, chosen, polynomials, sums_out):
    """Add the wet surface of the chosen patches to their instances' sums (H, 6)."""
    for i in range(chosen.size):
        patch, at = tree.patches[chosen[i].patch], chosen[i].instance
        if patch.level > 0:  # far below the surface
            add_wet_node(tree.moments[patch.first], polynomials[i], sums_out, at)
        else:
            own = polynomials[i : i + 1]
            add_nodes(patch.first, patch.end, patch.radius, tree, own, at, sums_out)


@kernel
def polynomials_of(block, instances, positions, rotations, time):
    """`reached_polynomials` of a block."""
    tree, sea, most = tree_of(block), water_of(block), most_patches(instances) + 1
    chosen, polynomials = np.empty(most, CHOSEN), np.empty(most, POLYNOMIAL)
    count = reached_polynomials(
        tree, sea, instances, positions, rotations, time, chosen, polynomials
    )
    return chosen[:count], polynomials[:count]


@kernel
def patches_wrenches(block, instances, positions, rotations, time, wrenches_out):
    """See `Compiled`."""
    tree, sea, most = tree_of(block), water_of(block), most_patches(instances) + 1
    chosen, polynomials = workspaces(CHUNK, CHOSEN), workspaces(CHUNK, POLYNOMIAL)
    if most > CHUNK:
        chosen, polynomials = np.empty(most, CHOSEN), np.empty(most, POLYNOMIAL)
    scale = sea.water[0].scale
    sums, turn = np.zeros((instances.size, 6)), scratch(9)
    count = reached_polynomials(
        tree, sea, instances, positions, rotations, time, chosen, polynomials
    )
    add_surface(tree, chosen[:count], polynomials, sums)
    for i in range(instances.size):
        rotation = rotations[instances[i].pose]
        for j in range(9):
            turn[j] = scale * rotation[j]
        write_turned(sums[i], turn, 1.0, wrenches_out[instances[i].row])


single_polynomials_of = single(polynomials_of)
single_patches_wrenches = single(patches_wrenches)
