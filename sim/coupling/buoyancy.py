"""Buoyancy writes the water's wrenches into a model's `xfrc_applied`.

It does so in MuJoCo's passive callback (see `callback`): what is written there acts in the same
step, and at every stage of RK4. Drag and added mass go into MuJoCo's matrix of inertia there, so
its solver and integrators do the rest, contacts included.
"""

import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from threading import RLock
from time import perf_counter_ns
from typing import NoReturn

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling import callback, native
from sim.coupling.checks import check_solver
from sim.coupling.context import Context, probes_of
from sim.coupling.floats import FloatingGeom, body_label
from sim.coupling.mjcf import read_model
from sim.coupling.numbers import NUMERICS
from sim.coupling.settings import Overrulings
from sim.methods import Batch, Linear, Patches, Place
from sim.water.sea import Sea

Array = NDArray[np.float64]

MADE_FROM = (
    "numeric_data", "text_data", "tuple_objid", "geom_bodyid", "geom_type", "geom_dataid",
    "geom_size", "mesh_vert", "mesh_face",
)  # fmt: skip
"""Fields of a model that seas and hulls are made from."""

PLACES = ("geom_pos", "geom_quat")
"""The same where hulls were united."""


FINE = 2000
"""Faces of a hull from which on the linear method is right enough about its volume."""


class Buoyancy:
    """The water's push on the hulls of one model.

        buoyancy = Buoyancy.from_model(model)
        with buoyancy.installed():
            mujoco.mj_step(model, data)

    An environment that keeps it for good calls `install()` and `uninstall()` instead of the block.
    Without the callback, `buoyancy.apply(model, data)` before each step does the same, to the bit,
    for models without drag and added mass (except under RK4, whose inner stages only the callback
    sees).

    The rows of `xfrc_applied` that belong to `bodies` are overwritten each time, and keep what was
    written last; to push such a body yourself use `qfrc_applied`. All other rows are left alone.

    What you change in the model acts: mass, inertia, body_ipos, body_iquat, geom_pos, geom_quat,
    the timestep, and the strength of gravity, which waves follow in time but not in length. What
    hulls and waves are made from (geom_size, vertices, custom fields) and gravity's direction may
    not change: the next step is refused.

    No state is kept between calls, so any number of threads, states, copies of the model and
    batches may use it at once. The callback is a C function, except with methods that are no
    kernels (reference, your own): then it holds the interpreter's lock, and `mujoco.batch` refuses
    it.

    threads: how many, with the caller's own, share the hulls of linear, chord and patches. The
    result is the same to the bit; it pays for many hulls in many waves, not for a few, and the
    callback is then the interpreter's.

    sea: what they float in; floats: the hulls; bodies: (B,) ids of their bodies, each once;
    float_bodies: (H,) for each hull its place in `bodies`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sea: Sea,
        floats: Sequence[FloatingGeom],
        threads: int = 1,
    ) -> None:
        self.model = model
        self.sea = sea
        self.floats = tuple(floats)
        self.bodies, self.float_bodies = np.unique(
            [f.body for f in self.floats], return_inverse=True
        )
        self.has_resistance = any(f.drag for f in self.floats)
        self._geoms = np.array([f.geom for f in self.floats])
        self._rows = np.array([f.body for f in self.floats])
        self._displaced = np.array([f.displaced for f in self.floats])
        NUMERICS["buoyancy_threads"].check([threads])
        self._batches = _batches(self.floats, int(threads))
        self._probes = probes_of(model, self.floats)
        self._making = RLock()
        fields = MADE_FROM + (PLACES if any(f.united for f in self.floats) else ())
        self._made_from = {
            name: (getattr(model, name), bytes(getattr(model, name))) for name in fields
        }

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        method: str | None = None,
        tolerance: float | None = None,
        threads: int | None = None,
        pressure: str | None = None,
        settings: Iterable[str] = (),
        folder: str | Path = "",
        keyframe: str | None = None,
    ) -> "Buoyancy":
        """Read the model's custom fields (see `mjcf`); `method` overrules them for all geoms (and
        the pressure, if it names one: "patches/hydrostatic"), `tolerance` [m of water height] for
        the methods that take one, `threads` and `pressure`, `settings` single fields (see
        `settings`). `keyframe`, the first one by default, is where it starts, for notes about that.
        Files that the fields name are looked for in the folder. Raises ValueError that names the
        element at fault."""
        model = getattr(model, "ptr", model)  # dm_control's wrapper
        sea, floats, asked = read_model(
            model,
            Overrulings.of(
                method, pressure, tolerance=tolerance, settings=tuple(settings), keyframe=keyframe,
                folder=Path(folder),
            ),
        )  # fmt: skip
        return cls(model, sea, floats, asked if threads is None else threads)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of `bodies`; 'body <id>' for one without a name."""
        return tuple(body_label(self.model, b) for b in self.bodies)

    @property
    def takes_tolerance(self) -> bool:
        """Whether any of the hulls' methods has a tolerance of water height."""
        return any(f.method.takes_tolerance for f in self.floats)

    @property
    def calls(self) -> int:
        """How often wrenches were written, in all threads."""
        return self.context.counted(native.CALLS) if self._is_made else 0

    @property
    def seconds(self) -> float:
        """Wall time [s] that this took, in all threads together."""
        return 1e-9 * self.context.counted(native.NANOSECONDS) if self._is_made else 0.0

    def reset_clock(self) -> None:
        """Count `calls` and `seconds` anew."""
        self.context.clear(native.CALLS, native.NANOSECONDS)

    @property
    def context(self) -> Context:
        """What kernels need of all this. Compiles the kernels when it is first asked for."""
        with self._making:
            return self._context

    @property
    def _is_made(self) -> bool:
        return "_context" in self.__dict__

    @cached_property
    def _context(self) -> Context:
        of_batches = [batch.native() for batch in self._batches]
        parts = None if None in of_batches else [part for parts in of_batches for part in parts]
        return Context(self.model, self.sea, self.floats, self._probes, parts)

    def apply(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Write the wrenches for the state in `data`; call it before each `mj_step`.

        Updates the kinematics first, which `mj_step` leaves one step behind. Raises ValueError
        for another model than the one this was made for, and for drag and added mass, which belong
        into a matrix that `mj_step` makes itself.
        """
        if model is not self.model:
            raise ValueError(
                "this Buoyancy was made for another model; make one with Buoyancy.from_model(model)"
            )
        if self.has_resistance:
            raise ValueError(
                "drag and added mass act on MuJoCo's matrix of inertia, which mj_step makes anew: "
                "step inside `with buoyancy.installed():`"
            )
        mujoco.mj_kinematics(model, data)
        self.write(model, data)

    @contextmanager
    def installed(self) -> Iterator["Buoyancy"]:
        """Be part of MuJoCo's passive callback inside a `with` block.

        What was installed before is still called, and blocks may overlap in any order and any
        threads. The rows of xfrc_applied keep the last wrenches, as a loop by mj_step2 and
        mj_step1 needs them. Raises ValueError when what the hulls were made from has been
        changed in the model. At the end, warns of what is amiss: no state of the model was
        stepped, or one had forces of your own in the water's rows.
        """
        self._check_unchanged()
        seen = self._seen()
        callback.install(self)
        try:
            yield self
        finally:
            callback.uninstall(self)
        self._say(seen)

    def install(self) -> None:
        """Be part of MuJoCo's passive callback until `uninstall()`, as often as that is called.
        Raises ValueError as `installed` does."""
        self._check_unchanged()
        callback.install(self)

    def uninstall(self) -> None:
        """Undo one `install()`. Raises ValueError when there was none, and warns as `installed`
        does."""
        callback.uninstall(self)
        self._say(-1)

    def wrenches(self, data: mujoco.MjData) -> Array:
        """Wrench of every hull, (H, 6) [N, N m], world axes, torque about its body's centre of
        mass, for the kinematics as they stand in `data`. Writes nothing."""
        wrenches = self._pushed(self.model, data) * self._rate(self.model) ** 2
        arms = data.geom_xpos[self._geoms] - data.xipos[self._rows]
        wrenches[:, 3:] += np.cross(arms, wrenches[:, :3])
        return wrenches

    def submerged_volumes(self, data: mujoco.MjData) -> Array:
        """Volume (H,) [m^3] of each hull below the surface, for the kinematics as they stand in
        `data`: the vertical force that hydrostatic pressure would have, over density * gravity."""
        sea = self.sea
        if sea.pressure == "hydrostatic" or not sea.waves:
            lifts = self._pushed(self.model, data)[:, 2] / self._displaced
        else:
            lifts = self._computed(self._still_batches, self.model, data)[:, 2]
        return lifts / (sea.density * sea.gravity)

    @cached_property
    def _still_batches(self) -> list[Batch]:
        """The hulls in the same water with hydrostatic pressure: patches where that takes few
        faces to make, linear where the faces are fine anyway."""
        still, made = self.sea.hydrostatic, {}
        for f in self.floats:
            hull = f.method.hull
            kind = Patches if len(hull.faces) < FINE else Linear
            made.setdefault(id(hull), kind(hull, still))
        return _batches([replace(f, method=made[id(f.method.hull)]) for f in self.floats], 1)

    def drag_wrenches(self, data: mujoco.MjData) -> Array:
        """Drag on every body of `bodies`, (B, 6) [N, N m], world axes, torque about its centre
        of mass, for the state in `data`: the force of the water's resistance as such, without
        added mass. Zero where the model asks for none. Updates the kinematics; writes no force."""
        if not self.has_resistance:
            return np.zeros((len(self.bodies), 6))
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_comVel(self.model, data)
        return self.context.drags(self.model, data, self._pushed(self.model, data))

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Write what the water does for the kinematics as they stand: a call of the callback."""
        context = self.context
        if context.is_native:
            context.act(model, data)
            return
        started = perf_counter_ns()
        context.write(model, data, self._pushed(model, data))
        context.add(native.CALLS, 1)
        context.add(native.NANOSECONDS, perf_counter_ns() - started)

    def _pushed(self, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
        """Buoyancy (H, 6) of all hulls about their geoms' places, by the sea's own gravity."""
        if not self.context.is_native:
            return self._computed(self._batches, model, data)
        wrenches = np.empty((len(self.floats), 6))
        self.context.push(model, data, wrenches)
        return wrenches

    def _computed(
        self, batches: Sequence[Batch], model: mujoco.MjModel, data: mujoco.MjData
    ) -> Array:
        """The same by the interpreter, from batches of the hulls."""
        wrenches, time = np.empty((len(self.floats), 6)), self._rate(model) * data.time
        for batch in batches:
            batch.write_wrenches(data.geom_xpos, data.geom_xmat, time, wrenches)
        return wrenches

    def _rate(self, model: mujoco.MjModel) -> float:
        """How much faster waves run than under the gravity that the sea was made for."""
        return float(np.sqrt(-model.opt.gravity[2] / self.sea.gravity))

    def _check_unchanged(self) -> None:
        changed = [name for name, (now, then) in self._made_from.items() if bytes(now) != then]
        if changed:
            raise ValueError(
                f"the model's {' and '.join(changed)} changed after this Buoyancy was made, which "
                "does not follow that; make a new one with Buoyancy.from_model(model)"
            )
        if self.has_resistance:
            check_solver(self.model)

    def _seen(self) -> int:
        return self.calls + self.context.counted(native.SEEN)

    def _say(self, seen_before: int) -> None:
        """Say what a block has left to be said: of models that were refused, by ValueError; of
        others and of rows that had been somebody else's, by warnings."""
        context = self.context
        refused = context.refusal()
        if refused:
            raise ValueError(callback.REASONS[refused])
        if self._seen() == seen_before:
            strangers = context.counted(native.STRANGERS)
            warnings.warn(
                "a block of Buoyancy.installed() ended and no state of its model was stepped in "
                "it; if another model was, make a Buoyancy for that one"
                + " (one of the same structure was, with other numbers)"
                * (strangers > 0),
                stacklevel=4,
            )
        if context.counted(native.OVERWRITTEN):
            warnings.warn(
                "xfrc_applied of a floating body was set and is overwritten: these rows are the "
                "water's; push such a body by qfrc_applied",
                stacklevel=4,
            )
        context.clear(native.STRANGERS, native.OVERWRITTEN)

    def __getstate__(self) -> NoReturn:
        raise TypeError(
            "a Buoyancy belongs to its model in this process; pickle the model (or its file) and "
            "make a new one there with Buoyancy.from_model(model)"
        )


def _batches(floats: Sequence[FloatingGeom], threads: int) -> list[Batch]:
    """The floats in batches, one for each class of methods and each sea."""
    alike: dict[tuple[type, int], list[tuple[int, FloatingGeom]]] = {}
    for i, f in enumerate(floats):
        alike.setdefault((type(f.method), id(f.method.sea)), []).append((i, f))
    return [
        kind.batch([f.method for _, f in members], [Place(f.geom, i) for i, f in members], threads)
        for (kind, _), members in alike.items()
    ]
