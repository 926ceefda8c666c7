"""Simulation: step a scene, look at it at a steady rate, stop when it diverges."""

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.runs.divergence import DivergenceError, Watch
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

WARNINGS_OF_DIVERGENCE = {
    int(mujoco.mjtWarning.mjWARN_BADQPOS): "position",
    int(mujoco.mjtWarning.mjWARN_BADQVEL): "velocity",
    int(mujoco.mjtWarning.mjWARN_BADQACC): "acceleration",
}
"""MuJoCo answers these by resetting the state and stepping on; we stop instead."""

MOST_STEPS = 1e9
"""Steps of a run: some hours at a few microseconds each."""


@dataclass(frozen=True)
class Sample:
    """The state of a scene at one instant, all of it for that same instant.

    time [s]; step: steps taken; for the B floating bodies, in the order of
    `scene.buoyancy.body_names`: positions (B, 3) [m] and quaternions (B, 4) (w, x, y, z) of the
    body frame, centres (B, 3) [m] of mass, elevations (B,) [m] of the water at the centres,
    tilts (B,) [rad] between the body's z axis and the vertical, submerged_fractions (B,)
    of the hulls' volume, body_wrenches (B, 6) [N, N m] of buoyancy about the centres,
    drag_wrenches (B, 6) of drag likewise (0 without); for the H hulls wrenches (H, 6) of
    buoyancy likewise. World axes. step_seconds, buoyancy_seconds: wall time
    that all steps so far took, and the part of it spent on buoyancy.
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
    """Step `scene` for `duration` [s of simulated time] and yield a Sample `rate` times a second
    [Hz], the first of them before the first step; where the rate does not divide into
    timesteps, at the first step at or after each instant.

    Raises DivergenceError where numbers are not finite or huge, and where the timestep is too long
    for a body (a Note at load says so) and its energy cannot be explained; `mujoco.mj_step` and
    `observe` go on regardless. Raises ValueError for a duration or rate that cannot be.
    """
    check_run(scene, duration, rate)
    return _samples(scene, duration, rate)


def check_run(scene: Scene, duration: float, rate: float) -> None:
    """Raise the ValueError that `simulate` would for a duration [s], a rate [Hz] or a timestep that
    cannot be, and for a model that has changed."""
    for name, value in (("duration", duration), ("rate", rate)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}; it must be finite and above 0")
    steps = duration / scene.model.opt.timestep
    if not steps <= MOST_STEPS:
        raise ValueError(
            f"{duration:g} s are {steps:.3g} steps of {scene.model.opt.timestep:g} s, more than "
            f"{MOST_STEPS:g}; take a larger timestep or a shorter run"
        )
    if not scene.buoyancy.is_current:
        raise ValueError(
            "hulls, waves or options of the scene's model have changed since it was loaded, and "
            "samples and recordings would show what it had then: make a new one by "
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
    """So many steps in one call, and the seconds that they took. Raises DivergenceError where
    MuJoCo warns of a state."""
    model, data = watch.scene.model, watch.scene.data
    start = data.time
    if not np.isfinite(start):
        name = watch.scene.buoyancy.body_names[0]
        raise DivergenceError(name, start, "time is not finite", "set data.time to a number")
    data.warning.number[list(WARNINGS_OF_DIVERGENCE)] = 0
    started = perf_counter()
    mujoco.mj_step(model, data, steps)
    spent = perf_counter() - started
    for warning, what in WARNINGS_OF_DIVERGENCE.items():
        if data.warning[warning].number:
            body = _body_of(model, warning, int(data.warning[warning].lastinfo))
            is_reset = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
            since = data.time if is_reset else 0.0  # MuJoCo resets the time with the state
            time = start + steps * model.opt.timestep - since
            raise watch.divergence(body, time, f"{what} is not finite or huge")
    return spent


def _body_of(model: mujoco.MjModel, warning: int, index: int) -> int:
    """The body whose coordinate MuJoCo's warning points at."""
    if warning == mujoco.mjtWarning.mjWARN_BADQPOS:
        joint = int(np.searchsorted(model.jnt_qposadr, index, side="right")) - 1
        return int(model.jnt_bodyid[joint])
    return int(model.dof_bodyid[index])


def observe(
    scene: Scene, step: int = 0, step_seconds: float = 0.0, buoyancy_seconds: float = 0.0
) -> Sample:
    """Sample of a scene as it stands. Updates the kinematics, which `mj_step` leaves one step
    behind; the run itself stays the same to the bit."""
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


class Tally:
    """Means over the samples of a run.

    tally = Tally(scene)
    for sample in simulate(scene, 10.0):
        tally.add(sample)
    tally.bodies()
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.last: Sample | None = None
        self._count = 0
        self._sums = np.zeros((len(scene.buoyancy.bodies), 4))

    def add(self, sample: Sample) -> None:
        """Count one sample in; all samples weigh the same."""
        model, bodies = self.scene.model, self.scene.buoyancy.bodies
        weights = model.body_mass[bodies] * -model.opt.gravity[2]
        self._sums += np.column_stack(
            [
                sample.centres[:, 2],
                np.degrees(sample.tilts),
                sample.submerged_fractions,
                sample.body_wrenches[:, 2] / weights,
            ]
        )
        self._count += 1
        self.last = sample

    def bodies(self) -> dict[str, dict[str, Any]]:
        """For each floating body: mean_height [m] of the centre of mass, mean_tilt_deg,
        mean_submerged_fraction, mean_force_over_weight (vertical), final_position (3) [m] and
        final_quaternion (4) of its frame. Plain numbers, ready for JSON."""
        if self.last is None:
            return {}
        names = (
            "mean_height",
            "mean_tilt_deg",
            "mean_submerged_fraction",
            "mean_force_over_weight",
        )
        means = self._sums / self._count
        return {
            body: dict(zip(names, means[i].tolist(), strict=True))
            | {
                "final_position": self.last.positions[i].tolist(),
                "final_quaternion": self.last.quaternions[i].tolist(),
            }
            for i, body in enumerate(self.scene.buoyancy.body_names)
        }
