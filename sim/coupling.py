"""Coupling: Buoyancy writes the water's wrenches into a model's `xfrc_applied`.

MuJoCo calls `mjcb_passive` inside every `mj_forward`, after kinematics and before
dynamics: what is written there acts in the same step, and at every stage of RK4. That callback
is one for the whole process and sees every model, so it is set only inside a `with` block.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.drag import BodyDrag, known_wrench, velocity_at
from sim.methods import Method, Patches, PatchFleet
from sim.mjcf import FloatingGeom, is_free, read_model
from sim.sea import Sea

Array = NDArray[np.float64]


def _update_velocities(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Bring the bodies' velocities up to the positions and `qvel` as they stand."""
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)


@dataclass(frozen=True)
class _ResistedRow:
    """A body with drag or added mass: its row of `xfrc_applied` and views of what that needs.

    hulls: the places of its hulls among all; velocity: (6,) angular and linear at the point
    `reference` [m]; applied, passive: (6,) forces along the free joint's degrees of freedom,
    empty for a body that is not free.
    """

    body: int
    resistance: BodyDrag
    hulls: list[int]
    row: Array
    position: Array
    rotation: Array
    velocity: Array
    reference: Array
    origin: Array
    axes: Array
    applied: Array
    passive: Array

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        body: int,
        resistance: BodyDrag,
        hulls: list[int],
    ) -> "_ResistedRow":
        first = model.body_dofadr[body]
        dofs = slice(first, first + 6 * resistance.free)
        return cls(
            body,
            resistance,
            hulls,
            row=data.xfrc_applied[body],
            position=data.xipos[body],
            rotation=data.ximat[body].reshape(3, 3),
            velocity=data.cvel[body],
            reference=data.subtree_com[model.body_rootid[body]],
            origin=data.xpos[body],
            axes=data.xmat[body].reshape(3, 3),
            applied=data.qfrc_applied[dofs],
            passive=data.qfrc_passive[dofs],
        )

    def write(self, option: mujoco.MjOption, time: float, buoyancy: Array) -> None:
        """Write the wrench of the water for the state as it stands; buoyancy (H, 6): all hulls'."""
        self.row[:] = self.resistance.wrench(
            self.position,
            self.rotation,
            self._velocity(),
            time,
            [buoyancy[i] for i in self.hulls],
            self._other_forces(option.gravity),
            option.timestep,
        )

    def drag_wrench(self, time: float, buoyancy: Array) -> Array:
        """The drag alone (6,), as it is."""
        mine = [buoyancy[i] for i in self.hulls]
        return self.resistance.drag(self.position, self.rotation, self._velocity(), time, mine)

    def _velocity(self) -> Array:
        """Velocity (6,) of the centre of mass and angular, world axes."""
        return velocity_at(self.velocity, self.reference, self.position)

    def _other_forces(self, gravity: Array) -> Array:
        """Wrench (6,) about the centre of mass of gravity and of the generalised forces known
        before the step."""
        return known_wrench(
            self.resistance.mass,
            gravity,
            self.applied,
            self.passive,
            self.origin,
            self.axes,
            self.position,
        )


class Buoyancy:
    """The water's push on the hulls of one model.

        buoyancy = Buoyancy.from_model(model)
        with buoyancy.installed():
            mujoco.mj_step(model, data)

    or, without the callback, `buoyancy.apply(model, data)` before each step (the same to the
    bit, except under RK4, whose inner stages only the callback sees).

    The rows of `xfrc_applied` that belong to `bodies` are overwritten each time; to push such a
    body yourself use `qfrc_applied`. All other rows are left alone. Geoms' frames are read
    once, when the object is made.

    sea: what they float in; floats: the hulls; bodies: (B,) ids of their bodies, each once;
    float_bodies: (H,) for each hull its place in `bodies`; calls, seconds: how often
    wrenches were written and the wall time that took.
    """

    def __init__(self, model: mujoco.MjModel, sea: Sea, floats: Sequence[FloatingGeom]) -> None:
        self.model = model
        self.sea = sea
        self.floats = tuple(floats)
        self.bodies, self.float_bodies = np.unique(
            [f.body for f in self.floats], return_inverse=True
        )
        self._rows = np.array([f.body for f in self.floats])
        self.calls = 0
        self.seconds = 0.0
        self._fleet, self._others = _sorted_by_call(self.floats)
        self._data: mujoco.MjData | None = None
        self._views: tuple[Array, Array, Array] = ()
        self._resisted = {
            int(body): resistance
            for body in self.bodies
            if (resistance := self._body_drag(int(body))) is not None
        }
        self._resisted_rows: list[_ResistedRow] = []

    @classmethod
    def from_model(
        cls, model: mujoco.MjModel, method: str | None = None, tolerance: float | None = None
    ) -> "Buoyancy":
        """Read the model's custom fields (see `sim.mjcf`); `method` overrules them for all geoms
        and `tolerance` [m of water height] for the methods that take one. Raises ValueError
        that names the element at fault."""
        return cls(model, *read_model(model, method, tolerance))

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of `bodies`; 'body <id>' for one without a name."""
        return tuple(self.model.body(b).name or f"body {b}" for b in self.bodies)

    @property
    def takes_tolerance(self) -> bool:
        """Whether any of the hulls' methods has a tolerance of water height."""
        return self._fleet is not None

    def apply(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Write the wrenches for the state in `data`; call it before each `mj_step`.

        Updates the kinematics first, which `mj_step` leaves one step behind. Raises ValueError
        for another model than the one this was made for.
        """
        if model is not self.model:
            raise ValueError(
                "this Buoyancy was made for another model; make one with Buoyancy.from_model(model)"
            )
        mujoco.mj_kinematics(model, data)
        if self._resisted:
            _update_velocities(model, data)
            mujoco.mj_passive(model, data)
        self._write(data)

    @contextmanager
    def installed(self) -> Iterator["Buoyancy"]:
        """Be MuJoCo's passive callback inside a `with` block.

        What was installed before is called first, so blocks nest, and is restored in any case.
        The rows written are set to zero at the end. Compile models outside: MuJoCo's compiler
        calls back too and fails with a Python callback set.
        """
        previous = mujoco.get_mjcb_passive()
        written: dict[int, mujoco.MjData] = {}

        def callback(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            if previous is not None:
                previous(model, data)
            if model is self.model:
                written[id(data)] = data
                self._write(data)

        mujoco.set_mjcb_passive(callback)
        try:
            yield self
        finally:
            mujoco.set_mjcb_passive(previous)
            for data in written.values():
                data.xfrc_applied[self.bodies] = 0.0

    def wrenches(self, data: mujoco.MjData) -> Array:
        """Wrench of every hull, (H, 6) [N, N m], world axes, torque about its body's centre of
        mass, for the kinematics as they stand in `data`. Writes nothing."""
        return self._hull_wrenches(data.xipos, data.ximat, data.time)

    def drag_wrenches(self, data: mujoco.MjData) -> Array:
        """Drag on every body of `bodies`, (B, 6) [N, N m], world axes, torque about its centre
        of mass, for the state in `data`: the force of the water's resistance as such, without
        added mass. Zero where the model asks for none. Updates the kinematics; writes no force."""
        drags = np.zeros((len(self.bodies), 6))
        if not self._resisted:
            return drags
        mujoco.mj_kinematics(self.model, data)
        _update_velocities(self.model, data)
        if data is not self._data:
            self._bind(data)
        buoyancy = self._hull_wrenches(data.xipos, data.ximat, data.time)
        for row in self._resisted_rows:
            place = np.searchsorted(self.bodies, row.body)
            drags[place] = row.drag_wrench(data.time, buoyancy)
        return drags

    def _body_drag(self, body: int) -> BodyDrag | None:
        """Drag of a body's hulls; None when no hull has any."""
        hulls = [f.drag for f in self.floats if f.body == body]
        if not any(hulls):
            return None
        model = self.model
        free = is_free(model, body)
        return BodyDrag(model.body_mass[body], model.body_inertia[body], hulls, free)

    def _bind(self, data: mujoco.MjData) -> None:
        """Keep views of the arrays of `data`: asking for them anew costs more than using them."""
        self._data = data
        self._views = (data.xipos, data.ximat, data.xfrc_applied)
        self._resisted_rows = [
            _ResistedRow.of(
                self.model, data, body, drag, np.flatnonzero(self._rows == body).tolist()
            )
            for body, drag in self._resisted.items()
        ]

    def _hull_wrenches(self, positions: Array, rotations: Array, time: float) -> Array:
        """Buoyancy (H, 6) of all hulls for the poses of all bodies (., 3), (., 9)."""
        wrenches = np.zeros((len(self.floats), 6))
        if self._fleet is not None:
            self._fleet.add_wrenches(positions, rotations, time, wrenches)
        for hull, body, method in self._others:
            wrenches[hull] = method.wrench(positions[body], rotations[body], time)
        return wrenches

    def _write(self, data: mujoco.MjData) -> None:
        started = perf_counter()
        if data is not self._data:
            self._bind(data)
        time = data.time
        positions, rotations, rows = self._views
        wrenches = self._hull_wrenches(positions, rotations, time)
        if len(self.bodies) == len(self.floats):
            rows[self._rows] = wrenches
        else:
            rows[self.bodies] = 0.0
            np.add.at(rows, self._rows, wrenches)
        for resisted in self._resisted_rows:
            resisted.write(self.model.opt, time, wrenches)
        self.calls += 1
        self.seconds += perf_counter() - started


def _sorted_by_call(
    floats: Sequence[FloatingGeom],
) -> tuple[PatchFleet | None, list[tuple[int, int, Method]]]:
    """The floats that one call computes together; the place, body and method of the others."""
    together = [(i, f) for i, f in enumerate(floats) if isinstance(f.method, Patches)]
    others = [
        (i, f.body, f.method) for i, f in enumerate(floats) if not isinstance(f.method, Patches)
    ]
    if not together:
        return None, others
    methods, poses = [f.method for _, f in together], [f.body for _, f in together]
    return PatchFleet(methods, poses, [i for i, _ in together]), others
