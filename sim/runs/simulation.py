"""Simulation: steps a scene, samples it at a constant rate, and stops when it diverges."""

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.runs.divergence import DivergenceError, Watch
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

DIVERGENCE_WARNINGS = {
    int(mujoco.mjtWarning.mjWARN_BADQPOS): "position",
    int(mujoco.mjtWarning.mjWARN_BADQVEL): "velocity",
    int(mujoco.mjtWarning.mjWARN_BADQACC): "acceleration",
}
"""MuJoCo's warnings at which a run stops, and the quantity. MuJoCo would reset the state and go
on."""

MOST_STEPS = 1e9
"""Largest number of steps of a run, which takes some hours at a few microseconds per step."""


@dataclass(frozen=True)
class Sample:
    """The state of a scene at one instant, in world axes.

    time [s]. step: the number of steps so far. For the B floating bodies, in the order of
    `scene.buoyancy.body_names`: positions (B, 3) [m] and quaternions (B, 4) (w, x, y, z) of the
    body frames; centres (B, 3) [m] of mass; elevations (B,) [m] of the water at the centres; tilts
    (B,) [rad] between the body's z axis and the vertical; submerged_fractions (B,) of the hulls'
    volume; body_wrenches and drag_wrenches (B, 6) [N, N m] of buoyancy and drag about the centres.
    For the H hulls: wrenches (H, 6) [N, N m] of buoyancy about the centre of the hull's body.
    step_seconds, buoyancy_seconds: wall time [s] of all steps so far, and of buoyancy in them.
    """

    time: float
    step: int
    positions: Array
    quaternions: Array
    centres: Array
    elevations: Array
    tilts: Array
    submerged_fractions: Array
    wrenches: Array
    body_wrenches: Array
    drag_wrenches: Array
    step_seconds: float
    buoyancy_seconds: float


def simulate(scene: Scene, duration: float, rate: float = 30.0) -> Iterator[Sample]:
    """Step a scene for a duration [s] of simulated time and yield Samples at a rate [Hz]. The first
    Sample comes before the first step; the others come at the first step at or after their time.

    Raises DivergenceError if numbers are not finite or huge, or if the timestep is too long for a
    body (of which a Note warns at load) and its energy cannot be explained; `mujoco.mj_step` and
    `observe` do not. Raises ValueError as `check_run` does.
    """
    check_run(scene, duration, rate)
    return _samples(scene, duration, rate)


def check_run(scene: Scene, duration: float, rate: float, warm_up: float = 0.0) -> None:
    """Raise ValueError for an invalid duration [s] or rate [Hz], for a warm-up [s] that leaves
    nothing of the duration, for too many steps, and for a model that has changed since it was
    loaded."""
    for name, value in (("duration", duration), ("rate", rate)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}; it must be finite and above 0")
    if warm_up >= duration:
        raise ValueError(
            f"a run of {duration:g} s has nothing left after a warm-up of {warm_up:g} s; run "
            "longer (--duration) or warm up for less time (--warm-up)"
        )
    if not 0.0 < scene.model.opt.timestep < np.inf:
        raise ValueError(
            f"the model's timestep is {scene.model.opt.timestep:g} s; it must be finite and above 0"
        )
    steps = duration / scene.model.opt.timestep
    if not steps <= MOST_STEPS:
        raise ValueError(
            f"{duration:g} s are {steps:.3g} steps of {scene.model.opt.timestep:g} s, more than "
            f"{MOST_STEPS:g}; use a larger timestep or a shorter run"
        )
    if not scene.buoyancy.is_current:
        raise ValueError(
            "hulls, waves or options of the scene's model have changed since it was loaded, and "
            "samples and recordings would show the old ones: make a new scene with "
            "Scene.from_model(model)"
        )


def _samples(scene: Scene, duration: float, rate: float) -> Iterator[Sample]:
    timestep = scene.model.opt.timestep
    last_step = max(1, round(duration / timestep))
    spent_before = scene.buoyancy.seconds(scene.data)
    step, step_seconds = 0, 0.0
    watch = Watch(scene)
    yield observe(scene, step)
    while step < last_step:
        frame = np.floor(step * timestep * rate + 1e-9) + 1.0
        due = int(np.ceil(frame / (rate * timestep) - 1e-9))
        due = min(max(due, step + 1), last_step)
        before = watch.heads()
        step_seconds += _advance(watch, due - step)
        watch.check(before)
        step = due
        buoyancy_seconds = scene.buoyancy.seconds(scene.data) - spent_before
        yield observe(scene, step, step_seconds, buoyancy_seconds)


def _advance(watch: Watch, steps: int) -> float:
    """Do a number of steps in one call, and return their wall time [s]. Raises DivergenceError if
    MuJoCo warns of the state."""
    model, data = watch.scene.model, watch.scene.data
    start = data.time
    if not np.isfinite(start):
        name = watch.scene.buoyancy.body_names[0]
        raise DivergenceError(name, start, "time is not finite", "set data.time to a number")
    data.warning.number[list(DIVERGENCE_WARNINGS)] = 0
    started = perf_counter()
    mujoco.mj_step(model, data, steps)
    spent = perf_counter() - started
    for warning, quantity in DIVERGENCE_WARNINGS.items():
        if data.warning[warning].number:
            body = _body_of(model, warning, int(data.warning[warning].lastinfo))
            is_reset = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
            since = data.time if is_reset else 0.0  # MuJoCo resets the time with the state
            time = start + steps * model.opt.timestep - since
            raise watch.divergence(body, time, f"{quantity} is not finite or huge")
    return spent


def _body_of(model: mujoco.MjModel, warning: int, index: int) -> int:
    """The body with the coordinate of MuJoCo's warning."""
    if warning == mujoco.mjtWarning.mjWARN_BADQPOS:
        joint = int(np.searchsorted(model.jnt_qposadr, index, side="right")) - 1
        return int(model.jnt_bodyid[joint])
    return int(model.dof_bodyid[index])


def observe(
    scene: Scene, step: int = 0, step_seconds: float = 0.0, buoyancy_seconds: float = 0.0
) -> Sample:
    """A Sample of a scene's present state. Updates the kinematics, which `mj_step` leaves one step
    behind; a run stays the same to the bit."""
    model, data, buoyancy = scene.model, scene.data, scene.buoyancy
    mujoco.mj_kinematics(model, data)
    bodies = buoyancy.bodies
    centres = data.xipos[bodies]
    up = data.xmat[bodies].reshape(-1, 3, 3)[:, :, 2]
    push = buoyancy.push(data)
    wrenches = buoyancy.wrenches(data, push)
    body_wrenches = np.zeros((len(bodies), 6))
    np.add.at(body_wrenches, buoyancy.float_bodies, wrenches)
    submerged = np.bincount(buoyancy.float_bodies, buoyancy.submerged_volumes(data, push))
    sea = buoyancy.sea
    return Sample(
        time=data.time,
        step=step,
        positions=data.xpos[bodies],
        quaternions=data.xquat[bodies],
        centres=centres,
        elevations=sea.elevation(centres[:, 0], centres[:, 1], data.time),
        tilts=np.arctan2(np.hypot(up[:, 0], up[:, 1]), up[:, 2]),
        submerged_fractions=submerged / buoyancy.volumes,
        wrenches=wrenches,
        body_wrenches=body_wrenches,
        drag_wrenches=buoyancy.drag_wrenches(data, push),
        step_seconds=step_seconds,
        buoyancy_seconds=buoyancy_seconds,
    )
