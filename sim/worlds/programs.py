"""Programs: the Warp kernels that run `threads`, one launch for each stage of a step.

Which thread does what: threads next to each other do the same work in neighbouring worlds, so they
read the same tables and take the same branches. Only the elements of a hull's surface are shared by
a block of LANES threads, which belongs to one hull in one world; on the CPU such a block has one
thread.

Arrays between the stages have one row for each number and one column for each world.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from sim.methods.linear import FACE, SHAPE, VERTEX
from sim.methods.patches.patches import SOLVE, add_nodes
from sim.methods.patches.polynomial import MONOMIALS, POLYNOMIAL
from sim.methods.patches.tree import LEAF, MOMENTS, NODE, PATCH, TRIANGLE
from sim.resistance.elements import ELEMENTS, SURFACE
from sim.resistance.probes import PROBE, QUANTITIES
from sim.resistance.reaction import HULL, REACTION
from sim.water.gerstner import CHUNK, ROUND_OFF, WATER, WAVE
from sim.worlds import threads
from sim.worlds.translate import Fixed, Flavour, Named, Opaque, Translator, View, name_of

GPU_LANES = 128
"""Threads of a block that share the elements of a hull on a GPU."""

POLYNOMIAL_ROWS = MONOMIALS + 3
"""Numbers of a patch: the coefficients, the bounds, and whether the water could reach it."""

FORCE_ROWS, MATRIX_ROWS, LOAD_ROWS = 6, 21, 6
REACTION_ROWS = FORCE_ROWS + MATRIX_ROWS + 1
"""Numbers of a hull's reaction: force, lower triangle of the matrix, decay of the spin."""

SINGLE_ROUND_OFF = 2e-7
"""Replaces gerstner.ROUND_OFF: round-off of a residual in single precision, as a share of the
distance from the origin."""

INLINE = """
#if defined(__CUDA_ARCH__)
#define WORLDS_INLINE __forceinline__
#else
#define WORLDS_INLINE inline
#endif
"""


def flavour(lanes: int = 0) -> Flavour:
    """Single precision. lanes: threads that share the elements of a hull; 0 where each thread has
    one point."""
    rows = ELEMENTS // lanes if lanes else 1
    return Flavour(
        real="float",
        integer="int",
        lengths={CHUNK: rows, ELEMENTS: rows},
        constants={"CHUNK": rows, "LANES": 1, "ELEMENTS": rows, "ROUND_OFF": SINGLE_ROUND_OFF},
        shared="ELEMENTS" if lanes > 1 else None,
    )


assert ROUND_OFF < SINGLE_ROUND_OFF

WAVES = """
struct Waves {
  const %(wave)s* rows; const float* turns; int size; int step; float share;
  CUDA_CALLABLE %(wave)s at(int w) const {
    %(wave)s wave = rows[w];
    wave.turns = turns[w * step];
    wave.rise = 0.0f;
    wave.amplitude *= share; wave.ka *= share; wave.kka *= share; wave.kkka *= share;
    return wave;
  }
};
"""
"""The waves of a sea around a hull now: fixed rows, phases at the hull, and the share of growth."""


SOURCES: list["Source"] = []
"""The C++ of all stages of all programs that were made."""


class Source:
    """The C++ of one stage's function."""

    def __init__(self, kind: Flavour) -> None:
        SOURCES.append(self)
        self.translator = Translator(kind, classes=WAVES % {"wave": name_of(WAVE)})
        self.records = {
            name: self.translator.record(name_of(dtype), dtype)
            for name, dtype in dict(
                WAVE=WAVE, WATER=WATER, PATCH=PATCH, NODE=NODE, MOMENTS=MOMENTS, LEAF=LEAF,
                POLYNOMIAL=POLYNOMIAL, SOLVE=SOLVE, VERTEX=VERTEX, FACE=FACE, SHAPE=SHAPE,
                HULL=HULL, SURFACE=SURFACE, REACTION=REACTION, TRIANGLE=TRIANGLE,
                PROBE=PROBE,
            ).items()
        }  # fmt: skip
        self.waves = Opaque("Waves", self.records["WAVE"])

    def named(self, name: str, **kinds: Any) -> Named:
        return Named(name, tuple(kinds.items()))

    def text(self, glue: str, **calls: Any) -> str:
        """The snippet: records, functions, and the lines that call them. In these lines, $NAME is a
        record, and $name() a function of `calls`."""
        for name, (function, *kinds) in calls.items():
            glue = glue.replace(f"${name}(", f"Code::{self.translator.add(function, *kinds).name}(")
        glue = glue.replace("$Waves", "Code::Waves")
        for name in sorted(self.records, key=len, reverse=True):
            glue = glue.replace(f"${name}", f"Code::{self.records[name].name}")
        return INLINE + self.translator.text + glue


REAL6, REAL9, REAL3 = Fixed("real", (6,)), Fixed("real", (9,)), Fixed("real", (3,))
MATRIX = Fixed("real", (6, 6))


@cache
def programs(lanes: int) -> SimpleNamespace:
    """All kernels. lanes: threads of a block that share the elements of a hull."""
    module = wp.get_module(f"waterline_worlds_{lanes}")
    module.options["enable_backward"] = False
    module.options["block_dim"] = lanes  # all launches have this size: the module compiles once
    kernels = SimpleNamespace(module=module, lanes=lanes)
    for add in (_add_clock, _add_sea, _add_patches, _add_linear, _add_reaction, _add_bodies):
        add(kernels, lambda f: wp.kernel(f, module=module, enable_backward=False))
    return kernels


def _add_clock(kernels: SimpleNamespace, kernel: Any) -> None:
    """The clock: mujoco_warp's time is a sum in single precision, which is off by milliseconds
    after a minute. Steps are counted instead, and resets of the time are followed."""

    @kernel
    def tick(
        time: wp.array[wp.float32],
        timestep: wp.array[wp.float32],
        exact_step: wp.float64,
        start: wp.array[wp.float64],
        steps: wp.array[wp.int64],
        seen: wp.array[wp.float32],
        pace: wp.array[wp.float32],
        clock: wp.array[wp.float64],
    ):
        world = wp.tid()
        now = time[world]
        step = pace[world]
        if now != seen[world]:
            if now == seen[world] + step:
                steps[world] = steps[world] + wp.int64(1)
            else:
                start[world] = wp.float64(now)
                steps[world] = wp.int64(0)
        exact = wp.float64(step)
        if step == wp.float32(exact_step):
            exact = exact_step
        clock[world] = start[world] + wp.float64(steps[world]) * exact
        following = timestep[world % timestep.shape[0]]
        if following != step:
            start[world] = clock[world]
            steps[world] = wp.int64(0)
            pace[world] = following
        seen[world] = now

    kernels.tick = tick


def _add_sea(kernels: SimpleNamespace, kernel: Any) -> None:
    double = Translator(Flavour(integer="long long", constants={"LANES": 1, "CHUNK": 1}))
    wave, water = (double.record(name_of(dtype), dtype) for dtype in (WAVE, WATER))
    anchored = double.add(threads.anchored, wave, "real", "real", "real").name
    still = double.add(threads.still_water, View(wave), water, "real", "real").name
    code, view = INLINE + double.text, double.ctype(View(wave))

    @wp.func_native(
        f"""{code}
        Code::{wave.name}* rows = (Code::{wave.name}*)waves.data + first;
        return (float)Code::{anchored}(*rows, x, y, time);"""
    )
    def run_anchored(
        waves: wp.array[wp.uint8],
        first: int,
        x: wp.float64,
        y: wp.float64,
        time: wp.float64,
    ) -> float: ...

    @wp.func_native(
        f"""{code}
        Code::{view} rows = {{(Code::{wave.name}*)waves.data + sea * count, count, 1}};
        double level, rise, share;
        Code::{still}(rows, ((Code::{water.name}*)waters.data)[sea], z, time, level, rise, share);
        return wp::vec_t<3, float>((float)level, (float)rise, (float)share);"""
    )
    def run_still(
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        sea: int,
        count: int,
        z: wp.float64,
        time: wp.float64,
    ) -> wp.vec3: ...

    @kernel
    def gather(
        geoms: wp.array[int],
        geom_xpos: wp.array2d[wp.vec3],
        origins: wp.array2d[wp.vec3],
    ):
        hull, world = wp.tid()
        origins[hull, world] = geom_xpos[world, geoms[hull]]

    @kernel
    def anchor(
        clock: wp.array[wp.float64],
        waves: wp.array[wp.uint8],
        seas: int,
        count: int,
        origins: wp.array2d[wp.vec3],
        turns: wp.array2d[float],
    ):
        place, wave, world = wp.tid()
        at = origins[place, world]
        turns[place * count + wave, world] = run_anchored(
            waves, (world % seas) * count + wave, wp.float64(at[0]), wp.float64(at[1]), clock[world]
        )

    @kernel
    def still_levels(
        clock: wp.array[wp.float64],
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        seas: int,
        count: int,
        origins: wp.array2d[wp.vec3],
        levels: wp.array2d[wp.vec3],
    ):
        place, world = wp.tid()
        height = wp.float64(origins[place, world][2])
        levels[place, world] = run_still(waves, waters, world % seas, count, height, clock[world])

    source = Source(flavour())
    snippet = source.text(
        """
        $Waves at = {($WAVE*)waves.data + sea * count,
                     turns.data + (place * count) * worlds + world, count, worlds, level[2]};
        return level[0] + $height(at, (($WATER*)waters.data)[sea]);""",
        height=(threads.surface_height, source.waves, source.records["WATER"]),
    )

    @wp.func_native(snippet)
    def run_height(
        place: int,
        world: int,
        worlds: int,
        sea: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        level: wp.vec3,
    ) -> float: ...

    @kernel
    def elevations(
        seas: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        origins: wp.array2d[wp.vec3],
        levels: wp.array2d[wp.vec3],
        found: wp.array2d[float],
    ):
        place, world = wp.tid()
        above = run_height(
            place, world, turns.shape[1], world % seas, count, waves, waters, turns,
            levels[place, world],
        )  # fmt: skip
        found[world, place] = origins[place, world][2] + above

    @kernel
    def place_points(
        points: wp.array2d[wp.vec3],
        origins: wp.array2d[wp.vec3],
    ):
        place, world = wp.tid()
        at = points[world, place]
        origins[place, world] = wp.vec3(at[0], at[1], 0.0)

    kernels.place_points = place_points
    kernels.gather, kernels.anchor, kernels.still_levels = gather, anchor, still_levels
    kernels.elevations = elevations


def _add_patches(kernels: SimpleNamespace, kernel: Any) -> None:
    source = Source(flavour())
    records = source.records
    snippet = source.text(
        """
        $Waves at = {($WAVE*)waves.data + (tree * seas + sea) * count,
                     turns.data + (hull * count) * worlds + world, count, worlds, level[2]};
        $POLYNOMIAL found;
        for (int k = 0; k < COEFFICIENTS; k++) found.c[k] = 0.0f;
        found.bound_2 = found.bound_3 = 0.0f;
        Code::ROTATIONS rotations = {&rotation.data[0][0], 1, 1};
        bool is_reached = $polynomial((($PATCH*)patches.data)[patch], *($SOLVE*)solve.data,
            at, (($WATER*)waters.data)[sea], level[0], rotations, found);
        float* to = out.data + (row * ROWS) * worlds + world;
        for (int k = 0; k < COEFFICIENTS; k++) to[k * worlds] = found.c[k];
        to[COEFFICIENTS * worlds] = found.bound_2;
        to[(COEFFICIENTS + 1) * worlds] = found.bound_3;
        to[(COEFFICIENTS + 2) * worlds] = is_reached ? 1.0f : 0.0f;
        """.replace("COEFFICIENTS", str(MONOMIALS))
        .replace("ROWS", str(POLYNOMIAL_ROWS))
        .replace("ROTATIONS", source.translator.ctype(View(REAL9))),
        polynomial=(
            threads.patch_polynomial, records["PATCH"], records["SOLVE"], source.waves,
            records["WATER"], "real", View(REAL9), records["POLYNOMIAL"],
        ),
    )  # fmt: skip

    @wp.func_native(snippet)
    def run_polynomial(
        row: int,
        world: int,
        worlds: int,
        hull: int,
        patch: int,
        tree: int,
        sea: int,
        seas: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        patches: wp.array[wp.uint8],
        solve: wp.array[wp.uint8],
        level: wp.vec3,
        rotation: wp.mat33,
        out: wp.array2d[float],
    ): ...

    @kernel
    def polynomials(
        rows: wp.array[wp.vec3i],
        geoms: wp.array[int],
        geom_xmat: wp.array2d[wp.mat33],
        seas: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        levels: wp.array2d[wp.vec3],
        patches: wp.array[wp.uint8],
        solve: wp.array[wp.uint8],
        out: wp.array2d[float],
    ):
        row, world = wp.tid()
        hull, patch, tree = rows[row][0], rows[row][1], rows[row][2]
        run_polynomial(
            row, world, out.shape[1], hull, patch, tree, world % seas, seas, count, waves, waters,
            turns, patches, solve, levels[hull, world], geom_xmat[world, geoms[hull]], out,
        )  # fmt: skip

    source = Source(flavour())
    records = source.records
    tree = source.named(
        "PatchTree", patches=View(records["PATCH"]), nodes=View(records["NODE"]),
        moments=View(records["MOMENTS"]), leaves=View(records["LEAF"]),
        triangles=View(records["TRIANGLE"]),
    )  # fmt: skip
    views = {
        name: source.translator.ctype(View(records[name]))
        for name in ("PATCH", "NODE", "MOMENTS", "LEAF", "TRIANGLE")
    }
    snippet = source.text(
        f"""
        const float* from = polynomials.data + (row * {POLYNOMIAL_ROWS}) * worlds + world;
        float sums[6] = {{0.0f}};
        if (from[{MONOMIALS + 2} * worlds] > 0.0f) {{
          $POLYNOMIAL p;
          for (int k = 0; k < {MONOMIALS}; k++) p.c[k] = from[k * worlds];
          p.bound_2 = from[{MONOMIALS} * worlds];
          p.bound_3 = from[{MONOMIALS + 1} * worlds];
          p.head = p.c[0];
          Code::{source.translator.ctype(tree)} tree = {{
            Code::{views["PATCH"]}{{($PATCH*)patches.data, 1, 1}},
            Code::{views["NODE"]}{{($NODE*)nodes.data, 1, 1}},
            Code::{views["MOMENTS"]}{{($MOMENTS*)moments.data, 1, 1}},
            Code::{views["LEAF"]}{{($LEAF*)leaves.data, 1, 1}},
            Code::{views["TRIANGLE"]}{{($TRIANGLE*)triangles.data, 1, 1}}}};
          const float radius = (($PATCH*)patches.data)[patch].radius;
          $nodes(first, end, radius, tree, p, 0, sums);
        }}
        for (int k = 0; k < 6; k++) out.data[(piece * 6 + k) * worlds + world] = sums[k];
        """,
        nodes=(
            add_nodes, "int", "int", "real", tree, records["POLYNOMIAL"], "int",
            Fixed("real", (1, 6)),
        ),
    )  # fmt: skip

    @wp.func_native(snippet)
    def run_nodes(
        piece: int,
        world: int,
        worlds: int,
        row: int,
        patch: int,
        first: int,
        end: int,
        polynomials: wp.array2d[float],
        patches: wp.array[wp.uint8],
        nodes: wp.array[wp.uint8],
        moments: wp.array[wp.uint8],
        leaves: wp.array[wp.uint8],
        triangles: wp.array[wp.uint8],
        out: wp.array2d[float],
    ): ...

    @kernel
    def patch_pieces(
        pieces: wp.array[wp.vec4i],
        polynomials: wp.array2d[float],
        patches: wp.array[wp.uint8],
        nodes: wp.array[wp.uint8],
        moments: wp.array[wp.uint8],
        leaves: wp.array[wp.uint8],
        triangles: wp.array[wp.uint8],
        out: wp.array2d[float],
    ):
        piece, world = wp.tid()
        row, patch, first, end = (
            pieces[piece][0], pieces[piece][1], pieces[piece][2], pieces[piece][3]
        )  # fmt: skip
        run_nodes(
            piece, world, out.shape[1], row, patch, first, end, polynomials, patches, nodes,
            moments, leaves, triangles, out,
        )  # fmt: skip

    kernels.polynomials, kernels.patch_pieces = polynomials, patch_pieces


def _add_linear(kernels: SimpleNamespace, kernel: Any) -> None:
    source = Source(flavour())
    records = source.records
    snippet = source.text(
        """
        $Waves at = {($WAVE*)waves.data + sea * count,
                     turns.data + (hull * count) * worlds + world, count, worlds, level[2]};
        return $head((($VERTEX*)vertices.data)[vertex], (($SHAPE*)shapes.data)[shape], at,
            (($WATER*)waters.data)[sea], level[0], level[1], &rotation.data[0][0]);
        """,
        head=(
            threads.vertex_head, records["VERTEX"], records["SHAPE"], source.waves,
            records["WATER"], "real", "real", REAL9,
        ),
    )  # fmt: skip

    @wp.func_native(snippet)
    def run_head(
        vertex: int,
        shape: int,
        hull: int,
        world: int,
        worlds: int,
        sea: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        vertices: wp.array[wp.uint8],
        shapes: wp.array[wp.uint8],
        level: wp.vec3,
        rotation: wp.mat33,
    ) -> float: ...

    @kernel
    def vertex_heads(
        rows: wp.array[wp.vec3i],
        geoms: wp.array[int],
        geom_xmat: wp.array2d[wp.mat33],
        seas: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        levels: wp.array2d[wp.vec3],
        vertices: wp.array[wp.uint8],
        shapes: wp.array[wp.uint8],
        heads: wp.array2d[float],
    ):
        row, world = wp.tid()
        hull, vertex, shape = rows[row][0], rows[row][1], rows[row][2]
        heads[row, world] = run_head(
            vertex, shape, hull, world, heads.shape[1], world % seas, count, waves, waters, turns,
            vertices, shapes, levels[hull, world], geom_xmat[world, geoms[hull]],
        )  # fmt: skip

    source = Source(flavour())
    records = source.records
    surface = source.named(
        "Surface", vertices=View(records["VERTEX"]), faces=View(records["FACE"]),
        shape=records["SHAPE"],
    )  # fmt: skip
    ctype = source.translator.ctype
    reals = ctype(View("real"))
    counting = source.text(
        f"""
        Code::{reals} found = {{heads.data + first * worlds + world, size, worlds}};
        return $wet(found);""",
        wet=(threads.count_wet, View("real")),
    )

    @wp.func_native(counting)
    def run_count(
        first: int,
        size: int,
        world: int,
        worlds: int,
        heads: wp.array2d[float],
    ) -> int: ...

    source = Source(flavour())
    ctype = source.translator.ctype
    snippet = source.text(
        f"""
        Code::{ctype(View("real"))} found = {{heads.data + row * worlds + world, size, worlds}};
        $SHAPE shape;
        Code::{ctype(surface)} surface = {{
          Code::{ctype(View(records["VERTEX"]))}{{($VERTEX*)vertices.data + vertex, size, 1}},
          Code::{ctype(View(records["FACE"]))}{{($FACE*)faces.data, 1 << 30, 1}}, &shape}};
        float sums[6];
        $sums(surface, found, first, end, first_face, end_face, wet, sums);
        for (int k = 0; k < 6; k++) out.data[(piece * 6 + k) * worlds + world] = sums[k];
        """,
        sums=(
            threads.piece_sums, surface, View("real"), "int", "int", "int", "int", "int", REAL6
        ),
    )  # fmt: skip

    @wp.func_native(snippet)
    def run_sums(
        piece: int,
        world: int,
        worlds: int,
        row: int,
        vertex: int,
        size: int,
        first: int,
        end: int,
        first_face: int,
        end_face: int,
        wet: int,
        heads: wp.array2d[float],
        vertices: wp.array[wp.uint8],
        faces: wp.array[wp.uint8],
        out: wp.array2d[float],
    ): ...

    @kernel
    def count_wet(
        spans: wp.array[wp.vec4i],
        ranges: wp.array[wp.vec4i],
        heads: wp.array2d[float],
        wet: wp.array2d[int],
    ):
        piece, world = wp.tid()
        first = ranges[piece][0]
        wet[piece, world] = run_count(
            spans[piece][0] + first, ranges[piece][1] - first, world, heads.shape[1], heads
        )

    @kernel
    def linear_pieces(
        spans: wp.array[wp.vec4i],
        ranges: wp.array[wp.vec4i],
        counts: wp.array[wp.vec2i],
        heads: wp.array2d[float],
        wet: wp.array2d[int],
        vertices: wp.array[wp.uint8],
        faces: wp.array[wp.uint8],
        offset: int,
        out: wp.array2d[float],
    ):
        piece, world = wp.tid()
        total = wp.int32(0)
        for other in range(counts[piece][0], counts[piece][1]):
            total += wet[other, world]
        span, part = spans[piece], ranges[piece]
        run_sums(
            offset + piece, world, heads.shape[1], span[0], span[2], span[1], part[0], part[1],
            part[2], part[3], total, heads, vertices, faces, out,
        )  # fmt: skip

    kernels.vertex_heads, kernels.count_wet = vertex_heads, count_wet
    kernels.linear_pieces = linear_pieces


def _add_reaction(kernels: SimpleNamespace, kernel: Any) -> None:
    lanes = kernels.lanes
    source = Source(flavour(lanes))
    records, share = source.records, ELEMENTS // lanes
    probes = source.translator.ctype(View(records["PROBE"]))
    snippet = source.text(
        f"""
        $Waves at = {{($WAVE*)waves.data + sea * count,
                     turns.data + (hull * count) * worlds + world, count, worlds, level[2]}};
        $HULL& own = (($HULL*)hulls.data)[row];
        $SURFACE* surface = ($SURFACE*)surfaces.data + own.surface * {lanes};
        $PROBE* chosen = ($PROBE*)probes.data + own.first_probe * {lanes};
        int probe_count = own.end_probe - own.first_probe;
        #if defined(__CUDA_ARCH__)
        __shared__ float probed[{QUANTITIES * ELEMENTS}];
        #else
        float probed[{QUANTITIES * ELEMENTS}];
        #endif
        for (int n = lane; n < (probe_count ? probe_count : {ELEMENTS}); n += {lanes}) {{
          int element = probe_count ? chosen[n * {lanes}].element : n;
          $SURFACE& near = surface[element / {share}];
          int k = element % {share};
          float place[3] = {{near.x[k], near.y[k], near.z[k]}}, water[{QUANTITIES}];
          $probe(place, own, at, (($WATER*)waters.data)[sea], level[0], level[1],
              &rotation.data[0][0], probe_count > 0, water);
          for (int q = 0; q < {QUANTITIES}; q++) probed[q * {ELEMENTS} + n] = water[q];
        }}
        #if defined(__CUDA_ARCH__)
        __syncthreads();
        #endif
        Code::{probes} shares = {{chosen + lane, probe_count, {lanes}}};
        $REACTION reaction;
        float decay = $resist(own, surface[lane], shares,
            probed + (probe_count ? 0 : lane * {share}), level[0], &rotation.data[0][0],
            &arm.c[0], &velocity.c[0], &bias.c[0], timestep, reaction);
        if (lane == 0) {{
          float* to = out.data + (row * {REACTION_ROWS}) * worlds + world;
          for (int k = 0; k < 6; k++) to[k * worlds] = reaction.drag[k] + reaction.inertia[k];
          int k = 6;
          for (int i = 0; i < 6; i++)
            for (int j = 0; j <= i; j++) to[(k++) * worlds] = reaction.matrix[6 * i + j];
          to[k * worlds] = decay;
        }}
        """,
        probe=(
            threads.probe, REAL3, records["HULL"], source.waves, records["WATER"], "real", "real",
            REAL9, "bool", Fixed("real", (QUANTITIES, 1)),
        ),
        resist=(
            threads.resist, records["HULL"], records["SURFACE"], View(records["PROBE"]),
            Fixed("real", (QUANTITIES, ELEMENTS)), "real", REAL9, REAL3, REAL6, REAL6, "real",
            records["REACTION"],
        ),
    )  # fmt: skip

    @wp.func_native(snippet)
    def run_reaction(
        row: int,
        hull: int,
        world: int,
        worlds: int,
        lane: int,
        sea: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        hulls: wp.array[wp.uint8],
        surfaces: wp.array[wp.uint8],
        probes: wp.array[wp.uint8],
        level: wp.vec3,
        rotation: wp.mat33,
        arm: wp.vec3,
        velocity: wp.spatial_vector,
        bias: wp.spatial_vector,
        timestep: float,
        out: wp.array2d[float],
    ): ...

    @kernel
    def reactions(
        rows: wp.array[wp.vec4i],
        first_dof: wp.array[int],
        dofs: wp.array[int],
        timestep: wp.array[float],
        geom_xmat: wp.array2d[wp.mat33],
        subtree_com: wp.array2d[wp.vec3],
        cvel: wp.array2d[wp.spatial_vector],
        cdof_dot: wp.array2d[wp.spatial_vector],
        qvel: wp.array2d[float],
        origins: wp.array2d[wp.vec3],
        seas: int,
        count: int,
        waves: wp.array[wp.uint8],
        waters: wp.array[wp.uint8],
        turns: wp.array2d[float],
        levels: wp.array2d[wp.vec3],
        lifts: wp.array2d[float],
        hulls: wp.array[wp.uint8],
        surfaces: wp.array[wp.uint8],
        probes: wp.array[wp.uint8],
        out: wp.array2d[float],
    ):
        block, lane = wp.tid()
        worlds = out.shape[1]
        row, world = block // worlds, block % worlds
        hull, geom, body, root = rows[row][0], rows[row][1], rows[row][2], rows[row][3]
        if lifts[hull * LOAD_ROWS + 2, world] == 0.0:  # dry, for all threads of the block
            if lane == 0:
                for k in range(REACTION_ROWS):
                    out[row * REACTION_ROWS + k, world] = 0.0
            return
        bias = wp.spatial_vector()
        for d in range(first_dof[row], first_dof[row + 1]):
            bias += cdof_dot[world, dofs[d]] * qvel[world, dofs[d]]
        run_reaction(
            row, hull, world, worlds, lane, world % seas, count, waves, waters, turns, hulls,
            surfaces, probes, levels[hull, world], geom_xmat[world, geom],
            origins[hull, world] - subtree_com[world, root], cvel[world, body], bias,
            timestep[world % timestep.shape[0]], out,
        )  # fmt: skip

    kernels.reactions = reactions


def _add_bodies(kernels: SimpleNamespace, kernel: Any) -> None:
    source = Source(flavour())
    snippet = source.text(
        """
        float sums[6], found[6];
        for (int k = 0; k < 6; k++) sums[k] = 0.0f;
        for (int p = first; p < end; p++)
          for (int k = 0; k < 6; k++) sums[k] += partial.data[(p * 6 + k) * worlds + world];
        $lift(sums, &rotation.data[0][0], (($WATER*)waters.data)[sea].scale, found);
        for (int k = 0; k < 6; k++) out.data[(hull * 6 + k) * worlds + world] = found[k];
        """,
        lift=(threads.lift, REAL6, REAL9, "real", REAL6),
    )

    @wp.func_native(snippet)
    def run_lift(
        hull: int,
        first: int,
        end: int,
        world: int,
        worlds: int,
        sea: int,
        waters: wp.array[wp.uint8],
        partial: wp.array2d[float],
        rotation: wp.mat33,
        out: wp.array2d[float],
    ): ...

    @kernel
    def sum_lifts(
        pieces: wp.array[wp.vec2i],
        geoms: wp.array[int],
        geom_xmat: wp.array2d[wp.mat33],
        seas: int,
        waters: wp.array[wp.uint8],
        partial: wp.array2d[float],
        out: wp.array2d[float],
    ):
        hull, world = wp.tid()
        run_lift(
            hull, pieces[hull][0], pieces[hull][1], world, out.shape[1], world % seas, waters,
            partial, geom_xmat[world, geoms[hull]], out,
        )  # fmt: skip

    @kernel
    def wrenches(
        bodies: wp.array[int],
        xipos: wp.array2d[wp.vec3],
        origins: wp.array2d[wp.vec3],
        lifts: wp.array2d[float],
        found: wp.array2d[wp.spatial_vector],
    ):
        hull, world = wp.tid()
        h = hull * LOAD_ROWS
        force = wp.vec3(lifts[h, world], lifts[h + 1, world], lifts[h + 2, world])
        torque = wp.vec3(lifts[h + 3, world], lifts[h + 4, world], lifts[h + 5, world])
        torque += wp.cross(origins[hull, world] - xipos[world, bodies[hull]], force)
        found[world, hull] = wp.spatial_vector(force, torque)

    kernels.wrenches = wrenches
    source = Source(flavour())
    snippet = source.text(
        f"""
        float load[6], wrench[6], inertia[36], matrix[36];
        for (int k = 0; k < 6; k++) load[k] = loads.data[(body * 6 + k) * worlds + world];
        for (int k = 0; k < 6; k++) wrench[k] = lifts.data[(hull * 6 + k) * worlds + world];
        $lift(wrench, &arm.c[0], load);
        if (row >= 0) {{
          const float* from = reactions.data + (row * {REACTION_ROWS}) * worlds + world;
          for (int k = 0; k < 6; k++) wrench[k] = from[k * worlds];
          int k = 6, n = 0;
          for (int i = 0; i < 6; i++)
            for (int j = 0; j <= i; j++, k++, n++) {{
              matrix[6 * i + j] = from[k * worlds];
              inertia[6 * i + j] = inertias.data[(body * 21 + n) * worlds + world];
            }}
          $reaction(wrench, matrix, &arm.c[0], &rotation.data[0][0], load, inertia);
          n = 0;
          for (int i = 0; i < 6; i++)
            for (int j = 0; j <= i; j++, n++)
              inertias.data[(body * 21 + n) * worlds + world] = inertia[6 * i + j];
        }}
        for (int k = 0; k < 6; k++) loads.data[(body * 6 + k) * worlds + world] = load[k];
        """,
        lift=(threads.add_lift, REAL6, REAL3, REAL6),
        reaction=(threads.add_reaction, REAL6, MATRIX, REAL3, REAL9, REAL6, MATRIX),
    )

    @wp.func_native(snippet)
    def run_load(
        body: int,
        hull: int,
        row: int,
        world: int,
        worlds: int,
        lifts: wp.array2d[float],
        reactions: wp.array2d[float],
        arm: wp.vec3,
        rotation: wp.mat33,
        loads: wp.array2d[float],
        inertias: wp.array2d[float],
    ): ...

    source = Source(flavour())
    snippet = source.text(
        """
        float load[6], inertia[36];
        for (int k = 0; k < 6; k++) load[k] = loads.data[(body * 6 + k) * worlds + world];
        int n = 0;
        for (int i = 0; i < 6; i++)
          for (int j = 0; j <= i; j++, n++)
            inertia[6 * i + j] = inertias.data[(body * 21 + n) * worlds + world];
        $spin(decay, timestep, &principal.c[0], &spin.c[0], &axes.data[0][0], &arm.c[0], load,
              inertia);
        n = 0;
        for (int i = 0; i < 6; i++)
          for (int j = 0; j <= i; j++, n++)
            inertias.data[(body * 21 + n) * worlds + world] = inertia[6 * i + j];
        for (int k = 0; k < 6; k++) loads.data[(body * 6 + k) * worlds + world] = load[k];
        """,
        spin=(
            threads.add_spin_decay, "real", "real", REAL3, REAL3, REAL9, REAL3, REAL6, MATRIX
        ),
    )  # fmt: skip

    @wp.func_native(snippet)
    def run_spin(
        body: int,
        world: int,
        worlds: int,
        decay: float,
        timestep: float,
        principal: wp.vec3,
        spin: wp.vec3,
        axes: wp.mat33,
        arm: wp.vec3,
        loads: wp.array2d[float],
        inertias: wp.array2d[float],
    ): ...

    @kernel
    def body_loads(
        bodies: wp.array[wp.vec4i],
        floats: wp.array[wp.vec3i],
        has_reaction: int,
        timestep: wp.array[float],
        body_inertia: wp.array2d[wp.vec3],
        geom_xmat: wp.array2d[wp.mat33],
        xipos: wp.array2d[wp.vec3],
        ximat: wp.array2d[wp.mat33],
        cvel: wp.array2d[wp.spatial_vector],
        subtree_com: wp.array2d[wp.vec3],
        origins: wp.array2d[wp.vec3],
        lifts: wp.array2d[float],
        reactions: wp.array2d[float],
        loads: wp.array2d[float],
        inertias: wp.array2d[float],
    ):
        b, world = wp.tid()
        worlds = loads.shape[1]
        body, root = bodies[b][0], bodies[b][1]
        centre = subtree_com[world, root]
        for k in range(LOAD_ROWS):
            loads[b * LOAD_ROWS + k, world] = 0.0
        if has_reaction > 0:
            for k in range(MATRIX_ROWS):
                inertias[b * MATRIX_ROWS + k, world] = 0.0
        decay = wp.float32(0.0)
        for f in range(bodies[b][2], bodies[b][3]):
            hull, geom, row = floats[f][0], floats[f][1], floats[f][2]
            run_load(
                b, hull, row, world, worlds, lifts, reactions, origins[hull, world] - centre,
                geom_xmat[world, geom], loads, inertias,
            )  # fmt: skip
            if row >= 0:
                decay += reactions[row * REACTION_ROWS + FORCE_ROWS + MATRIX_ROWS, world]
        if decay > 0.0:
            motion = cvel[world, body]
            run_spin(
                b, world, worlds, decay, timestep[world % timestep.shape[0]],
                body_inertia[world % body_inertia.shape[0], body],
                wp.vec3(motion[0], motion[1], motion[2]), ximat[world, body],
                xipos[world, body] - centre, loads, inertias,
            )  # fmt: skip

    @kernel
    def add_forces(
        dofs: wp.array[wp.vec3i],
        moved: wp.array[int],
        cdof: wp.array2d[wp.spatial_vector],
        loads: wp.array2d[float],
        qfrc: wp.array2d[float],
    ):
        d, world = wp.tid()
        dof = dofs[d][0]
        axis = cdof[world, dof]
        total = wp.float32(0.0)
        for k in range(dofs[d][1], dofs[d][2]):
            b = moved[k] * LOAD_ROWS
            for j in range(LOAD_ROWS):
                total += axis[j] * loads[b + j, world]
        qfrc[world, dof] += total

    source = Source(flavour())
    snippet = source.text(
        """
        float inertia[36];
        int n = 0;
        for (int i = 0; i < 6; i++)
          for (int j = 0; j <= i; j++, n++)
            inertia[6 * i + j] = inertias.data[(body * 21 + n) * worlds + world];
        return $product(&a.c[0], inertia, &b.c[0]);
        """,
        product=(threads.product_of, REAL6, MATRIX, REAL6),
    )

    @wp.func_native(snippet)
    def run_product(
        body: int,
        world: int,
        worlds: int,
        a: wp.spatial_vector,
        b: wp.spatial_vector,
        inertias: wp.array2d[float],
    ) -> float: ...

    @kernel
    def add_inertias(
        entries: wp.array[wp.vec3i],
        spans: wp.array[wp.vec2i],
        moved: wp.array[int],
        cdof: wp.array2d[wp.spatial_vector],
        inertias: wp.array2d[float],
        matrix: wp.array2d[float],
    ):
        e, world = wp.tid()
        address, i, j = entries[e][0], entries[e][1], entries[e][2]
        total = wp.float32(0.0)
        for k in range(spans[e][0], spans[e][1]):
            total += run_product(
                moved[k], world, inertias.shape[1], cdof[world, i],
                cdof[world, j], inertias,
            )  # fmt: skip
        matrix[world, address] += total

    @kernel
    def add_diagonals(
        simple: wp.array[wp.vec3i],
        addresses: wp.array[int],
        cdof: wp.array2d[wp.spatial_vector],
        inertias: wp.array2d[float],
        matrix: wp.array2d[float],
    ):
        s, world = wp.tid()
        body, first, size = simple[s][0], simple[s][1], simple[s][2]
        worlds = inertias.shape[1]
        for a in range(size):
            axis = cdof[world, first + a]
            matrix[world, addresses[first + a]] += run_product(
                body, world, worlds, axis, axis, inertias
            )
        for a in range(size):
            for b in range(a):
                entry = run_product(
                    body,
                    world,
                    worlds,
                    cdof[world, first + a],
                    cdof[world, first + b],
                    inertias,
                )
                entry = wp.abs(entry)
                p, q = addresses[first + a], addresses[first + b]
                share = wp.sqrt(matrix[world, p] / matrix[world, q])
                matrix[world, p] += entry * share
                matrix[world, q] += entry / share

    kernels.sum_lifts, kernels.body_loads, kernels.add_forces = sum_lifts, body_loads, add_forces
    kernels.add_inertias, kernels.add_diagonals = add_inertias, add_diagonals


def single(table: np.ndarray, lengths: dict[int, int] | None = None) -> np.ndarray:
    """A table of records in the layout of the programs: single precision, small integers."""
    lengths = lengths or {}

    def narrowed(dtype: np.dtype[Any]) -> np.dtype[Any]:
        fields = []
        for name, (kind, *_) in (dtype.fields or {}).items():
            base, shape = kind.subdtype or (kind, ())
            base = narrowed(base) if base.names else np.dtype({"f": "f4", "i": "i4"}[base.kind])
            fields.append((name, base, tuple(lengths.get(int(n), int(n)) for n in shape)))
        return np.dtype(fields, align=True)

    def fill(to: np.ndarray, given: np.ndarray) -> None:
        for name in given.dtype.names or ():
            if given[name].dtype.names:
                fill(to[name], given[name])
            else:
                to[name] = given[name]

    found = np.zeros(table.shape, narrowed(table.dtype))
    fill(found, table)
    return found
