"""Worlds: the water of a model in the worlds of mujoco_warp, on a GPU or on the CPU."""

from collections.abc import Sequence
from typing import Any

import mujoco
import mujoco_warp
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from sim.methods import Linear, Patches
from sim.mjcf.floats import FloatingGeom
from sim.water.sea import Sea
from sim.worlds import hulls as tables
from sim.worlds.programs import (
    GPU_LANES,
    LOAD_ROWS,
    MATRIX_ROWS,
    POLYNOMIAL_ROWS,
    REACTION_ROWS,
    programs,
    single,
)
from sim.worlds.refusals import check, check_seas
from sim.worlds.seas import (
    at_sea,
    check_patches,
    check_probes,
    cut_for,
    solve_row,
    water_rows,
    wave_rows,
)


class Worlds:
    """The water in the worlds of mujoco_warp's model m and data d: `Buoyancy.on_warp` makes it.

    From then on `mujoco_warp.step(m, d)` has the water's forces, also when it is captured in a CUDA
    graph. They are computed in mujoco_warp's passive stage: buoyancy, drag and the rest are added
    to d.qfrc_passive, and added mass and damping to d.M. Nothing waits for the GPU.

    seas: of world i, seas[i % len(seas)]. clock: (nworld,), time [s] of the water in double
    precision. It counts steps and follows a d.time that is set; set it yourself, after d.time, for
    a time that single precision does not hold.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        floats: Sequence[FloatingGeom],
        sea: Sea,
        m: Any,
        d: Any,
        seas: Sequence[Sea] | None = None,
    ) -> None:
        check(model, tuple(floats), m, d)
        self.seas = [sea] if seas is None else list(seas)
        check_seas(self.seas, sea)
        self.model, self.floats, self._sea = model, tuple(floats), sea
        self._m, self._d, self._worlds, self._device = m, d, d.nworld, d.time.device
        lanes = GPU_LANES if self._device.is_cuda else 1
        self._programs = programs(lanes)
        with wp.ScopedDevice(self._device):
            self._make_clock(model, m)
            self._make_hulls(model, lanes)
            self._make_seas()
        self._before = m.callback.passive
        self._points: dict[int, tuple[Any, ...]] = {}
        self._acts = True
        m.callback.passive = self._passive

    def _passive(self, m: Any, d: Any) -> None:
        if self._before:
            self._before(m, d)
        if self._acts:
            self.act(m, d)

    def uninstall(self) -> None:
        """Leave the water out from now on. A captured graph keeps it."""
        self._acts = False
        if self._m.callback.passive == self._passive:
            self._m.callback.passive = self._before

    # Tables

    def _make_clock(self, model: mujoco.MjModel, m: Any) -> None:
        n = self._worlds
        self._exact_step = float(model.opt.timestep)
        self._start, self.clock = (wp.zeros(n, dtype=wp.float64) for _ in range(2))
        self._steps = wp.zeros(n, dtype=wp.int64)
        self._seen = wp.full(n, np.nan, dtype=wp.float32)
        self._pace = wp.array(np.resize(m.opt.timestep.numpy(), n), dtype=wp.float32)

    def _make_hulls(self, model: mujoco.MjModel, lanes: int) -> None:
        n, methods = self._worlds, {i: f.method for i, f in enumerate(self.floats)}
        patched = {i: cut_for(m, self.seas) for i, m in methods.items() if isinstance(m, Patches)}
        self._patched = list({id(method.tree): method for method in patched.values()}.values())
        number = {id(method.tree): k for k, method in enumerate(self._patched)}
        which = {i: number[id(method.tree)] for i, method in patched.items()}
        trees = [method.tree for method in self._patched]
        self._patch = tables.patch_tables(patched, trees, which)
        linear = {i: method for i, method in methods.items() if isinstance(method, Linear)}
        self._linear = tables.linear_tables(linear) if linear else None
        check_probes([f.drag for f in self.floats if f.drag], self.seas)
        self._reaction = tables.reaction_tables(model, self.floats, lanes)
        numbers = self._reaction.numbers if self._reaction else {}
        self._bodies = tables.body_tables(model, self.floats, numbers)
        self._put_tables()
        spans, count = dict(self._patch.spans), len(self._patch.pieces) if patched else 0
        self._offset = count
        for i, (first, end) in (self._linear.of_hulls if self._linear else {}).items():
            spans[i] = count + first, count + end
        total = max([end for _, end in spans.values()], default=1)
        hulls, bodies = len(self.floats), len(self._bodies.bodies)
        self._spans = wp.array([spans[i] for i in range(hulls)], dtype=wp.vec2i)
        self._geoms = wp.array([f.geom for f in self.floats], dtype=int)

        def numbers_of(rows: int) -> Any:
            return wp.zeros((max(rows, 1), n), dtype=float)

        self._origins = wp.zeros((hulls, n), dtype=wp.vec3)
        self._levels = wp.zeros((hulls, n), dtype=wp.vec3)
        self._polynomials = numbers_of(self._patch.count * POLYNOMIAL_ROWS)
        self._partial, self._lifts = numbers_of(6 * total), numbers_of(LOAD_ROWS * hulls)
        self._heads = numbers_of(len(self._linear.rows) if self._linear else 0)
        self._wet = wp.zeros((len(self._linear.spans) if self._linear else 1, n), dtype=int)
        self._reactions = numbers_of(len(numbers) * REACTION_ROWS)
        self._loads = numbers_of(bodies * LOAD_ROWS)
        self._inertias = numbers_of(bodies * MATRIX_ROWS if numbers else 0)

    def _put_tables(self) -> None:
        """Copy the tables of hulls to the device."""
        put = self._put = {}
        if self._patch.tables:
            for name, table in self._patch.tables._asdict().items():
                put[name] = as_bytes(single(table))
            put["patch_rows"] = wp.array(self._patch.rows, dtype=wp.vec3i)
            put["patch_pieces"] = wp.array(self._patch.pieces, dtype=wp.vec4i)
        if self._linear:
            t = self._linear
            put["vertices"], put["faces"] = as_bytes(single(t.vertices)), as_bytes(single(t.faces))
            put["shapes"] = as_bytes(single(t.shapes))
            put["vertex_rows"] = wp.array(t.rows, dtype=wp.vec3i)
            put["spans"], put["ranges"] = (
                wp.array(each, dtype=wp.vec4i) for each in (t.spans, t.ranges)
            )
            put["counts"] = wp.array(t.counts, dtype=wp.vec2i)
        if self._reaction:
            t = self._reaction
            put["hulls"], put["surfaces"] = as_bytes(t.hulls), as_bytes(t.surfaces)
            put["probes"] = as_bytes(t.probes)
            put["reaction_rows"] = wp.array(t.rows, dtype=wp.vec4i)
            put["first_dof"], put["hull_dofs"] = (
                wp.array(each, dtype=int) for each in (t.first_dof, t.dofs)
            )
        b = self._bodies
        put["bodies"] = wp.array(b.bodies, dtype=wp.vec4i)
        for name, kind in dict(
            floats=wp.vec3i, dofs=wp.vec3i, moved=int, entries=wp.vec3i, entry_spans=wp.vec2i,
            simple=wp.vec3i, diagonal=int,
        ).items():  # fmt: skip
            put[name] = wp.array(getattr(b, name), dtype=kind)

    def _make_seas(self) -> None:
        self._count = max(len(sea.components) for sea in self.seas)
        n, room = self._worlds, max(self._count, 1)
        self._turns = wp.zeros((len(self.floats) * room, n), dtype=float)
        self._seas = {name: as_bytes(table) for name, table in self._sea_tables().items()}

    def _sea_tables(self) -> dict[str, Any]:
        """The tables of the seas: the waves in double and in single precision, those fitted to each
        tree's patches, the water in both, and SOLVE."""
        count, seas = max(self._count, 1), self.seas
        waves = wave_rows([sea.components for sea in seas], count)
        fitted = [
            wave_rows(
                [at_sea(method, sea).levels[0].waves for sea in seas],
                count,
            )
            for method in self._patched
        ] or [waves]
        water, narrow = water_rows(seas)
        return {
            "double": waves,
            "waves": single(waves),
            "fitted": single(np.stack(fitted)),
            "double_water": water,
            "water": narrow,
            "solve": solve_row(self._patched, seas),
        }

    def set_seas(self, seas: Sequence[Sea]) -> None:
        """Give the worlds other seas, as many as before and with no more waves than the largest
        had. A captured graph has them, too. Raises ValueError for others, and for waves that are
        too short or steep for the patches that the hulls were cut into."""
        seas = list(seas)
        check_seas(seas, self._sea, len(self.seas), self._count)
        check_patches(self._patched, seas)
        check_probes([f.drag for f in self.floats if f.drag], seas)
        self.seas = seas
        for name, table in self._sea_tables().items():
            self._seas[name].assign(np.ascontiguousarray(table).reshape(-1).view(np.uint8))

    # A step

    def _launch(self, kernel: Any, dim: Any, *inputs: Any) -> None:
        lanes = self._programs.lanes
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._device, block_dim=lanes)

    def act(self, m: Any, d: Any) -> None:
        """Add the water's forces to d.qfrc_passive and d.M, from the kinematics in d."""
        k, n = self._programs, self._worlds
        self._tick(m, d)
        self._launch(k.gather, (len(self.floats), n), self._geoms, d.geom_xpos, self._origins)
        self._anchor(len(self.floats), self._origins, self._turns, self._levels)
        if self._patched:
            self._push_patches(d)
        if self._linear:
            self._push_linear(d)
        self._launch(
            k.sum_lifts, (len(self.floats), n), self._spans, self._geoms, d.geom_xmat,
            len(self.seas), self._seas["water"], self._partial, self._lifts,
        )  # fmt: skip
        if self._reaction:
            self._resist(m, d)
        self._load(m, d)

    def _tick(self, m: Any, d: Any) -> None:
        self._launch(
            self._programs.tick, self._worlds, d.time, m.opt.timestep, self._exact_step,
            self._start, self._steps, self._seen, self._pace, self.clock,
        )  # fmt: skip

    def _anchor(self, places: int, origins: Any, turns: Any, levels: Any) -> None:
        """Phases of the waves and levels at origins."""
        k, n, seas, count = self._programs, self._worlds, len(self.seas), self._count
        waves, water = self._seas["double"], self._seas["double_water"]
        if count:
            self._launch(
                k.anchor, (places, count, n), self.clock, waves, seas, count, origins, turns
            )
        self._launch(
            k.still_levels, (places, n), self.clock, waves, water, seas, count, origins, levels
        )

    def _push_patches(self, d: Any) -> None:
        k, n, p = self._programs, self._worlds, self._put
        self._launch(
            k.polynomials, (self._patch.count, n), p["patch_rows"], self._geoms, d.geom_xmat,
            len(self.seas), self._count, self._seas["fitted"], self._seas["water"], self._turns,
            self._levels, p["patches"], self._seas["solve"], self._polynomials,
        )  # fmt: skip
        self._launch(
            k.patch_pieces, (len(self._patch.pieces), n), p["patch_pieces"], self._polynomials,
            p["patches"], p["nodes"], p["moments"], p["leaves"], p["triangles"], self._partial,
        )  # fmt: skip

    def _push_linear(self, d: Any) -> None:
        k, n, p, linear = self._programs, self._worlds, self._put, self._linear
        assert linear is not None
        self._launch(
            k.vertex_heads, (len(linear.rows), n), p["vertex_rows"], self._geoms, d.geom_xmat,
            len(self.seas), self._count, self._seas["waves"], self._seas["water"], self._turns,
            self._levels, p["vertices"], p["shapes"], self._heads,
        )  # fmt: skip
        pieces = len(linear.spans), n
        self._launch(k.count_wet, pieces, p["spans"], p["ranges"], self._heads, self._wet)
        self._launch(
            k.linear_pieces, pieces, p["spans"], p["ranges"], p["counts"], self._heads, self._wet,
            p["vertices"], p["faces"], self._offset, self._partial,
        )  # fmt: skip

    def _resist(self, m: Any, d: Any) -> None:
        k, n, p = self._programs, self._worlds, self._put
        assert self._reaction is not None
        self._launch(
            k.reactions, (len(self._reaction.rows) * n, k.lanes), p["reaction_rows"],
            p["first_dof"], p["hull_dofs"], m.opt.timestep, d.geom_xmat, d.subtree_com, d.cvel,
            d.cdof_dot, d.qvel, self._origins, len(self.seas), self._count, self._seas["waves"],
            self._seas["water"], self._turns, self._levels, self._lifts, p["hulls"], p["surfaces"],
            p["probes"], self._reactions,
        )  # fmt: skip

    def _load(self, m: Any, d: Any) -> None:
        """Add the loads of the bodies to the forces along the degrees of freedom, and to M."""
        k, n, p, b = self._programs, self._worlds, self._put, self._bodies
        self._launch(
            k.body_loads, (len(b.bodies), n), p["bodies"], p["floats"],
            int(self._reaction is not None), m.opt.timestep, m.body_inertia, d.geom_xmat, d.xipos,
            d.ximat, d.cvel, d.subtree_com, self._origins, self._lifts, self._reactions,
            self._loads, self._inertias,
        )  # fmt: skip
        if b.dofs[0, 0] < 0:
            return  # nothing that floats can move
        self._launch(
            k.add_forces, (len(b.dofs), n), p["dofs"], p["moved"], d.cdof, self._loads,
            d.qfrc_passive,
        )  # fmt: skip
        if b.entry_count:
            self._launch(
                k.add_inertias, (b.entry_count, n), p["entries"], p["entry_spans"], p["moved"],
                d.cdof, self._inertias, d.M,
            )  # fmt: skip
        if b.simple_count:
            self._launch(
                k.add_diagonals, (b.simple_count, n), p["simple"], p["diagonal"], d.cdof,
                self._inertias, d.M,
            )  # fmt: skip
        if self._reaction:
            mujoco_warp.factor_m(m, d)  # step does so again; step1 has done so before

    # Questions

    def wrenches(self) -> Any:
        """Buoyancy of every hull in the last passive stage: a Warp array (nworld, H) of force and
        torque [N, N m] in world axes, about the centre of mass of the hull's body."""
        found = wp.zeros(
            (self._worlds, len(self.floats)), dtype=wp.spatial_vector, device=self._device
        )
        bodies = wp.array([f.body for f in self.floats], dtype=int, device=self._device)
        self._launch(
            self._programs.wrenches, (len(self.floats), self._worlds), bodies, self._d.xipos,
            self._origins, self._lifts, found,
        )  # fmt: skip
        return found

    def elevation(self, points: Any) -> Any:
        """Height of the water [m] above points, now: a Warp array (nworld, P), which the next call
        with as many points uses again.

        points: x and y (P, 2) or (nworld, P, 2) [m], the same for all worlds or for each; or a Warp
        array (nworld, P) of vec3, such as a part of d.site_xpos, whose z is ignored.
        """
        with wp.ScopedDevice(self._device):
            given = points if isinstance(points, wp.array) else self._vectors(points)
            if given.ndim != 2 or given.shape[0] != self._worlds or given.dtype != wp.vec3:
                raise ValueError(
                    f"the points have the shape {given.shape}; expected (nworld, P) of vec3"
                )
            count = given.shape[1]
            if count not in self._points:
                room, n = count * max(self._count, 1), self._worlds
                self._points[count] = (
                    wp.zeros((count, n), dtype=wp.vec3), wp.zeros((room, n), dtype=float),
                    wp.zeros((count, n), dtype=wp.vec3), wp.zeros((n, count), dtype=float),
                )  # fmt: skip
            origins, turns, levels, found = self._points[count]
            k, n = self._programs, self._worlds
            self._tick(self._m, self._d)
            self._launch(k.place_points, (count, n), given, origins)
            self._anchor(count, origins, turns, levels)
            self._launch(
                k.elevations, (count, n), len(self.seas), self._count, self._seas["waves"],
                self._seas["water"], turns, origins, levels, found,
            )  # fmt: skip
        return found

    def _vectors(self, points: ArrayLike) -> Any:
        """Points as a Warp array (nworld, P) of vec3."""
        at: NDArray[np.float32] = np.asarray(points, dtype=np.float32)
        if at.ndim not in (2, 3) or at.shape[-1] != 2:
            raise ValueError(
                f"the points have the shape {at.shape}; expected (P, 2) or (nworld, P, 2)"
            )
        whole = np.zeros((self._worlds, at.shape[-2], 3), np.float32)
        whole[:, :, :2] = at
        return wp.array(whole, dtype=wp.vec3)


def as_bytes(table: Any) -> Any:
    """A table as a Warp array of bytes on the current device."""
    return wp.array(np.ascontiguousarray(table).reshape(-1).view(np.uint8), dtype=wp.uint8)
