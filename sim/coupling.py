"""Coupling: Buoyancy writes the water's wrenches into a model's `xfrc_applied`.

MuJoCo calls `mjcb_passive` inside every `mj_forward`, after kinematics and before
dynamics: what is written there acts in the same step, and at every stage of RK4. That callback
is one for the whole process and sees every model, so it is set only inside a `with` block.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.methods import Method, Patches, PatchFleet
from sim.mjcf import FloatingGeom, read_model
from sim.sea import Sea

Array = NDArray[np.float64]


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
        self.calls = 0
        self.seconds = 0.0
        self._fleet, self._others = _sorted_by_call(self.floats)
        self._data: mujoco.MjData | None = None
        self._views: tuple[Array, Array, Array] = ()

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
        wrenches = np.empty((len(self.floats), 6))
        for wrench, f in zip(wrenches, self.floats, strict=True):
            wrench[:] = f.method.wrench(data.xipos[f.body], data.ximat[f.body], data.time)
        return wrenches

    def _bind(self, data: mujoco.MjData) -> None:
        """Keep views of the arrays of `data`: asking for them anew costs more than using them."""
        self._data = data
        self._views = (data.xipos, data.ximat, data.xfrc_applied)

    def _write(self, data: mujoco.MjData) -> None:
        started = perf_counter()
        if data is not self._data:
            self._bind(data)
        time = data.time
        positions, rotations, rows = self._views
        rows[self.bodies] = 0.0
        if self._fleet is not None:
            self._fleet.add_wrenches(positions, rotations, time, rows)
        for body, method in self._others:
            rows[body] += method.wrench(positions[body], rotations[body], time)
        self.calls += 1
        self.seconds += perf_counter() - started


def _sorted_by_call(
    floats: Sequence[FloatingGeom],
) -> tuple[PatchFleet | None, list[tuple[int, Method]]]:
    """The floats that one call computes together, and the others with their bodies."""
    together = [f for f in floats if isinstance(f.method, Patches)]
    others = [(f.body, f.method) for f in floats if not isinstance(f.method, Patches)]
    if not together:
        return None, others
    return PatchFleet([f.method for f in together], [f.body for f in together]), others
