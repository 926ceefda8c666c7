"""Buoyancy: the interface in Python to the water of a model.

The water acts without this class: MuJoCo calls the plugin (see `plugin.seam`) in every step.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.methods import Linear, Patches
from sim.methods.method import Part, Settings, parts_of
from sim.mjcf.faults import ModelError
from sim.mjcf.floats import FloatingGeom, body_label
from sim.plugin import native, seam
from sim.plugin.context import Context
from sim.plugin.layout import without_plugin
from sim.resistance.response import Response
from sim.water.sea import Sea

if TYPE_CHECKING:
    from sim.worlds.worlds import Worlds

Array = NDArray[np.float64]

LINEAR_FACES = 2000
"""Number of faces from which on the linear method computes the submerged volume of a hull. Patches
compute it for fewer faces, because their error does not depend on the faces."""


class Buoyancy:
    """The water of one model, as it was when this object was made.

        buoyancy = Buoyancy.of(model)
        buoyancy.sea.elevation(0.0, 0.0, data.time)
        buoyancy.wrenches(data)

    sea: the sea. floats: the H hulls. responses: memory and diffraction of bodies. bodies: (B,),
    ids of the hulls' bodies, each once. float_bodies: (H,), index of each hull's body in `bodies`.
    volumes: (B,) [m^3], of each body's hulls. has_resistance: whether any hull has drag or added
    mass.

    All methods use the kinematics in the given state. `mj_step` leaves these one step behind;
    `mj_kinematics` updates them. `push` is the result of `push(data)`, computed if it is not given.
    """

    def __init__(self, model: mujoco.MjModel, context: Context) -> None:
        self.model = model
        self._context = context
        self.sea: Sea = context.sea
        self.floats: tuple[FloatingGeom, ...] = context.floats
        self.responses: tuple[Response, ...] = context.responses
        self.bodies, self.float_bodies = context.bodies, context.float_bodies
        self.has_resistance = context.has_resistance
        self._geoms = np.array([f.geom for f in self.floats])
        self._rows = np.array([f.body for f in self.floats])
        self._displaced = np.array([f.displaced for f in self.floats])
        volumes = [f.method.hull.volume for f in self.floats]
        self.volumes = np.bincount(self.float_bodies, weights=volumes)

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "Buoyancy":
        """The water of a compiled model. Raises ModelError for a model without the plugin, and for
        invalid hulls or waves."""
        model = getattr(model, "ptr", model)  # dm_control's wrapper
        if not seam.has_water(model):
            raise ModelError(
                [
                    f"the model has no instance of the plugin '{seam.NAME}', so it is dry: add "
                    f"{seam.ELEMENT} to its MJCF file, or use Scene.load or sim.add_water, which "
                    "add it; MjSpec.attach copies an instance only if a body names it"
                ]
            )
        return cls(model, seam.context_of(model))

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of `bodies`; 'body <id>' without a name."""
        return tuple(body_label(self.model, b) for b in self.bodies)

    @property
    def weights(self) -> Array:
        """Weights (B,) [N] of `bodies`, each with all bodies that are welded to it: a body may have
        no mass of its own, but one that moves has some with these."""
        model = self.model
        masses = np.bincount(model.body_weldid, weights=model.body_mass, minlength=model.nbody)
        return masses[model.body_weldid[self.bodies]] * -model.opt.gravity[2]

    @property
    def is_current(self) -> bool:
        """Whether the model still describes these hulls and waves. Raises ModelError for invalid
        hulls or waves."""
        return seam.context_of(self.model) is self._context

    def calls(self, data: mujoco.MjData) -> int:
        """The number of times that the water has acted on a state since the state was made: once
        per step, or four times with RK4."""
        return seam.counted(data, native.CALLS)

    def seconds(self, data: mujoco.MjData) -> float:
        """Wall time [s] of these calls."""
        return 1e-9 * seam.counted(data, native.NANOSECONDS)

    def push(self, data: mujoco.MjData) -> Array:
        """Buoyancy of every hull, (H, 6) [N, N m], in world axes, about its geom's position."""
        return self._context.push(self.model, data)

    def wrenches(self, data: mujoco.MjData, push: Array | None = None) -> Array:
        """Buoyancy of every hull, (H, 6) [N, N m], in world axes, about its body's centre of mass.
        Writes nothing."""
        wrenches = self.push(data) if push is None else push.copy()
        arms = data.geom_xpos[self._geoms] - data.xipos[self._rows]
        wrenches[:, 3:] += np.cross(arms, wrenches[:, :3])
        return wrenches

    def submerged_volumes(self, data: mujoco.MjData, push: Array | None = None) -> Array:
        """Submerged volume (H,) [m^3] of each hull: the vertical force of hydrostatic pressure over
        density * gravity."""
        sea = self.sea
        if sea.pressure == "hydrostatic" or not sea.waves:
            lifts = (self.push(data) if push is None else push)[:, 2] / self._displaced
        else:
            wrenches, poses = np.empty((len(self.floats), 6)), (data.geom_xpos, data.geom_xmat)
            for kernel, block, places in self._still_parts:
                kernel(block, places, *poses, data.time, wrenches)
            known = np.isfinite(np.hstack(poses)[self._geoms]).all(axis=1) & np.isfinite(data.time)
            lifts = np.where(known, wrenches[:, 2], np.nan)
        return lifts / (sea.density * sea.gravity)

    @cached_property
    def _still_parts(self) -> list[Part]:
        """The hulls in the same sea with hydrostatic pressure: patches on few faces, linear on
        many."""
        still, made = self.sea.hydrostatic, {}
        for f in self.floats:
            hull = f.method.hull
            kind = Patches if len(hull.faces) < LINEAR_FACES else Linear
            made.setdefault(id(hull), kind.from_settings(hull, still, Settings()))
        methods = [made[id(f.method.hull)] for f in self.floats]
        return parts_of(methods, [f.geom for f in self.floats])

    def drag_wrenches(self, data: mujoco.MjData, push: Array | None = None) -> Array:
        """Drag on every body of `bodies`, (B, 6) [N, N m], in world axes, about its centre of mass.
        Added mass is not included. Zero without drag. Updates the kinematics; writes no force."""
        if not self.has_resistance:
            return np.zeros((len(self.bodies), 6))
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_comVel(self.model, data)
        push = self.push(data) if push is None else push
        return self._context.drags(self.model, data, push)

    def pushes(self, data: mujoco.MjData) -> Array:
        """The user's pushes in the bodies' rows of xfrc_applied, (B, 6) [N, N m]. The rest of a row
        is the water's wrench of the last step."""
        rows = data.xfrc_applied[self.bodies]
        pushes = rows.copy()
        movable = (np.cumsum(self.model.body_weldid != 0) - 1)[self.bodies]
        for memories in reversed(seam.memories_of(self.model, data)):
            left, own = np.split(memories[movable], 2, axis=1)
            pushes = np.where(rows == left, own, pushes)
        return pushes

    @cached_property
    def dry_model(self) -> mujoco.MjModel:
        """A copy of the model without the plugin, for `mujoco_warp.put_model`. Version 4.0.0 of
        mujoco_warp cannot take a model with an instance that no element names."""
        return without_plugin(self.model)

    def on_warp(self, m: Any, d: Any, seas: Sequence[Sea] | None = None) -> "Worlds":
        """Let the water act in the worlds of mujoco_warp, on a GPU or on the CPU (see
        `worlds.Worlds`).

        m, d: from `mujoco_warp.put_model` and `put_data` of this model. seas: one for each world,
        or fewer, in turn; the model's own without them. Raises ModelError for a model that
        mujoco_warp cannot float, ValueError for seas of another density, and ImportError without
        mujoco_warp.
        """
        try:
            from sim.worlds.worlds import Worlds
        except ImportError as error:
            raise ImportError(
                f"{error}: worlds take mujoco_warp and warp-lang; install waterline-sim[warp]"
            ) from error
        return Worlds(self.model, self.floats, self.sea, m, d, seas)

    def __getstate__(self) -> NoReturn:
        raise TypeError(
            "a Buoyancy belongs to a model in this process and cannot be pickled; pickle the model "
            "and call Buoyancy.of(model) where it is loaded"
        )
