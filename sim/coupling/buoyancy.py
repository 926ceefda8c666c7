"""Buoyancy writes the water's wrenches into a model's `xfrc_applied`.

It does so in MuJoCo's passive callback (see `callback`): what is written there acts in the same
step, and at every stage of RK4.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Lock
from time import perf_counter
from typing import Any, NamedTuple, NoReturn

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling import callback
from sim.coupling.mjcf import FloatingGeom, is_free, read_model
from sim.coupling.primitives import frame_rotation
from sim.methods import Batch, Place
from sim.resistance.implicit import Resistance, ResistedBody
from sim.water.sea import Sea

Array = NDArray[np.float64]

HULLS_MADE_FROM = (
    "numeric_data", "text_data", "tuple_objid", "geom_bodyid", "geom_type", "geom_dataid",
    "geom_size", "geom_pos", "geom_quat", "mesh_vert", "mesh_face", "body_ipos", "body_iquat",
    "gravity",
)  # fmt: skip
"""Fields of a model that seas and hulls are made from."""

RESISTANCE_MADE_FROM = ("body_mass", "body_inertia")
"""Fields that the implicit step takes besides, for bodies with drag or added mass."""


def _update_velocities(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Bring the bodies' velocities up to the positions and `qvel` as they stand."""
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)


class Buoyancy:
    """The water's push on the hulls of one model.

        buoyancy = Buoyancy.from_model(model)
        with buoyancy.installed():
            mujoco.mj_step(model, data)

    An environment that keeps it for good calls `install()` and `uninstall()` instead of the block.
    Without the callback, `buoyancy.apply(model, data)` before each step does the same, to the bit
    (except under RK4, whose inner stages only the callback sees).

    The rows of `xfrc_applied` that belong to `bodies` are overwritten each time; to push such a
    body yourself use `qfrc_applied`. All other rows are left alone. Geoms' frames are read
    once, when the object is made.

    threads: how many, with the caller's own, share the hulls of all methods but reference. The
    result is the same to the bit; it pays for many hulls, not for a few. The helpers end with the
    object.

    No state is kept between calls, so any number of threads, states and copies of the model may use
    it at once.

    sea: what they float in; floats: the hulls; bodies: (B,) ids of their bodies, each once;
    float_bodies: (H,) for each hull its place in `bodies`; calls, seconds: how often
    wrenches were written and the wall time that took.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sea: Sea,
        floats: Sequence[FloatingGeom],
        threads: int = 1,
    ) -> None:
        self.model = model
        self._gravity = model.opt.gravity
        self.sea = sea
        self.floats = tuple(floats)
        self.bodies, self.float_bodies = np.unique(
            [f.body for f in self.floats], return_inverse=True
        )
        self._rows = np.array([f.body for f in self.floats])
        self.calls = 0
        self.seconds = 0.0
        self._counting = Lock()
        self._compared: dict[int, tuple[mujoco.MjModel, bool]] = {}
        self._batches = _batches(self.floats, _whole(threads))
        self._resisted = [
            _resisted_body(model, int(body), self.floats)
            for body in self.bodies
            if any(f.drag for f in self.floats if f.body == body)
        ]
        self._resistance = Resistance(self._resisted) if self._resisted else None
        names = HULLS_MADE_FROM + RESISTANCE_MADE_FROM * bool(self._resisted)
        self._made_from = {
            name: (_field(model, name), bytes(_field(model, name))) for name in names
        }

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        method: str | None = None,
        tolerance: float | None = None,
        threads: int | None = None,
    ) -> "Buoyancy":
        """Read the model's custom fields (see `mjcf`); `method` overrules them for all geoms,
        `tolerance` [m of water height] for the methods that take one, and `threads`. Raises
        ValueError that names the element at fault."""
        sea, floats, asked = read_model(model, method, tolerance)
        return cls(model, sea, floats, asked if threads is None else threads)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of `bodies`; 'body <id>' for one without a name."""
        return tuple(self.model.body(b).name or f"body {b}" for b in self.bodies)

    @property
    def takes_tolerance(self) -> bool:
        """Whether any of the hulls' methods has a tolerance of water height."""
        return any(f.method.takes_tolerance for f in self.floats)

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
        if self._resistance is not None:
            _update_velocities(model, data)
            mujoco.mj_passive(model, data)
        self.write(model, data)

    @contextmanager
    def installed(self) -> Iterator["Buoyancy"]:
        """Be part of MuJoCo's passive callback inside a `with` block.

        What was installed before is still called, and blocks may overlap in any order and any
        threads. The rows written are set to zero at the end, in any case; so a loop that steps by
        mj_step2 and then mj_step1, which uses the forces of the last time, needs `install()` or
        one block around all of it. Compile models outside: MuJoCo's compiler calls back too and
        fails with a Python callback set. Warns when no state of the model was seen. Raises
        ValueError when what the hulls were made from has been changed in the model since.
        """
        self._check_unchanged()
        block = _Block(self)
        callback.install(block)
        try:
            yield self
            block.warn_if_nothing_was_seen()
        finally:
            callback.uninstall(block)
            block.clear()

    def install(self) -> None:
        """Be part of MuJoCo's passive callback until `uninstall()`, as often as that is called; the
        rows that were written last stay. Raises ValueError as `installed` does."""
        self._check_unchanged()
        callback.install(self)

    def uninstall(self) -> None:
        """Undo one `install()`. Raises ValueError when there was none."""
        callback.uninstall(self)

    def wrenches(self, data: mujoco.MjData) -> Array:
        """Wrench of every hull, (H, 6) [N, N m], world axes, torque about its body's centre of
        mass, for the kinematics as they stand in `data`. Writes nothing."""
        return self._wrenches(State.of(data))

    def drag_wrenches(self, data: mujoco.MjData) -> Array:
        """Drag on every body of `bodies`, (B, 6) [N, N m], world axes, torque about its centre
        of mass, for the state in `data`: the force of the water's resistance as such, without
        added mass. Zero where the model asks for none. Updates the kinematics; writes no force."""
        drags = np.zeros((len(self.bodies), 6))
        if self._resistance is None:
            return drags
        mujoco.mj_kinematics(self.model, data)
        _update_velocities(self.model, data)
        places = np.searchsorted(self.bodies, [body.body for body in self._resisted])
        state = State.of(data)
        state = state._replace(rows=np.zeros_like(state.rows))
        drags[places] = self._add_resistance(self.model, state, self._wrenches(state))
        return drags

    def _wrenches(self, state: "State") -> Array:
        """Buoyancy (H, 6) of all hulls."""
        wrenches = np.empty((len(self.floats), 6))
        time = state.data.time
        for batch in self._batches:
            batch.write_wrenches(state.positions, state.rotations, time, wrenches)
        return wrenches

    def _add_resistance(self, model: mujoco.MjModel, state: "State", buoyancy: Array) -> Array:
        """Turn the resisted bodies' rows, their buoyancy, into the whole wrench of the water;
        returns their drag. model: the one that is stepped, maybe a copy with a timestep of its
        own; buoyancy (H, 6): of all hulls."""
        s = state
        return self._resistance.add_resistance(
            s.positions, s.rotations, s.velocities, s.references, self._gravity, s.applied,
            s.passive, model.opt.timestep, s.data.time, buoyancy, s.rows,
        )  # fmt: skip

    def write_into(self, model: mujoco.MjModel, state: "State") -> None:
        """Write the wrenches for the kinematics as they stand: what the callback does."""
        started = perf_counter()
        wrenches = self._wrenches(state)
        if len(self.bodies) == len(self.floats):
            state.rows[self._rows] = wrenches
        else:
            state.rows[self.bodies] = 0.0
            np.add.at(state.rows, self._rows, wrenches)
        if self._resistance is not None:
            self._add_resistance(model, state, wrenches)
        with self._counting:
            self.calls += 1
            self.seconds += perf_counter() - started

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """`write_into` for a state by itself."""
        self.write_into(model, State.of(data))

    def note(self, data: mujoco.MjData) -> None:
        """Nothing: somebody else writes into this state."""

    def is_copy(self, model: mujoco.MjModel) -> bool:
        """Whether a model is a copy of the one this was made for, in all that it was made from."""
        if model.signature != self.model.signature:  # which only the structure decides
            return False
        if id(model) not in self._compared:
            alike = all(
                bytes(_field(model, name)) == then for name, (_, then) in self._made_from.items()
            )
            self._compared[id(model)] = model, alike  # kept alive, or another might have its id
        return self._compared[id(model)][1]

    def _check_unchanged(self) -> None:
        changed = [name for name, (now, then) in self._made_from.items() if bytes(now) != then]
        if changed:
            raise ValueError(
                f"the model's {' and '.join(changed)} changed after this Buoyancy was made, which "
                "does not follow that; make a new one with Buoyancy.from_model(model)"
            )

    def __getstate__(self) -> NoReturn:
        raise TypeError(
            "a Buoyancy belongs to its model in this process; pickle the model (or its file) and "
            "make a new one there with Buoyancy.from_model(model)"
        )


class State(NamedTuple):
    """A state's arrays that the water reads, and the rows (nbody, 6) of `xfrc_applied` that it
    writes. They are MuJoCo's own; asking for them costs more than using them."""

    data: mujoco.MjData
    rows: Array
    positions: Array
    rotations: Array
    velocities: Array
    references: Array
    applied: Array
    passive: Array

    @classmethod
    def of(cls, data: mujoco.MjData) -> "State":
        return cls(
            data, data.xfrc_applied, data.xipos, data.ximat, data.cvel, data.subtree_com,
            data.qfrc_applied, data.qfrc_passive,
        )  # fmt: skip


class _Block:
    """A Buoyancy inside a `with` block: it knows the states that it has written into."""

    def __init__(self, buoyancy: Buoyancy) -> None:
        self.model, self._buoyancy = buoyancy.model, buoyancy
        self._written: dict[int, State] = {}

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        state = self._written.get(id(data))
        if state is None:
            state = self._written[id(data)] = State.of(data)
            self._warn_of_overwriting(state)
        self._buoyancy.write_into(model, state)

    def note(self, data: mujoco.MjData) -> None:
        self._written.setdefault(id(data), State.of(data))

    def is_copy(self, model: mujoco.MjModel) -> bool:
        return self._buoyancy.is_copy(model)

    def _warn_of_overwriting(self, state: State) -> None:
        """Of rows that somebody else has set, unless it may have been an outer block."""
        if callback.is_alone(self) and state.rows[self._buoyancy.bodies].any():
            warnings.warn(
                "xfrc_applied of a floating body was set and is overwritten: these rows are the "
                "water's; push such a body by qfrc_applied",
                stacklevel=2,
            )

    def warn_if_nothing_was_seen(self) -> None:
        if not self._written:
            warnings.warn(
                "a block of Buoyancy.installed() ended and no state of its model was stepped in "
                "it; if another model was, make a Buoyancy for that one",
                stacklevel=4,
            )

    def clear(self) -> None:
        """Set the rows that were written to zero."""
        for state in list(self._written.values()):  # a thread may be late
            state.rows[self._buoyancy.bodies] = 0.0


def _field(model: mujoco.MjModel, name: str) -> Any:
    """A field of a model, or of its options: an array that shows what is there now, or bytes."""
    return getattr(model.opt if name == "gravity" else model, name)


def _whole(threads: float) -> int:
    """A number of threads that makes sense, or ValueError."""
    if not (np.isfinite(threads) and threads == int(threads) and threads >= 1):
        raise ValueError(
            f"the number of threads is {threads:g}; expected a whole number, 1 for the caller's "
            "alone: give another one, or correct the custom numeric 'buoyancy_threads'"
        )
    return int(threads)


def _batches(floats: Sequence[FloatingGeom], threads: int) -> list[Batch]:
    """The floats in batches, one for each class of methods."""
    by_class: dict[type, list[tuple[int, FloatingGeom]]] = {}
    for i, f in enumerate(floats):
        by_class.setdefault(type(f.method), []).append((i, f))
    return [
        kind.batch([f.method for _, f in members], [Place(f.body, i) for i, f in members], threads)
        for kind, members in by_class.items()
    ]


def _resisted_body(
    model: mujoco.MjModel, body: int, floats: Sequence[FloatingGeom]
) -> ResistedBody:
    """A body with drag, as the model describes it."""
    axes = frame_rotation(model.body_iquat[body]).T
    return ResistedBody(
        body=body,
        root=int(model.body_rootid[body]),
        dof=int(model.body_dofadr[body]) if is_free(model, body) else -1,
        mass=float(model.body_mass[body]),
        inertia=model.body_inertia[body].copy(),
        origin=-axes @ model.body_ipos[body],
        axes=axes,
        hulls=[(i, f.drag) for i, f in enumerate(floats) if f.body == body],
    )
