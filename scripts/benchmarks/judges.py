"""Judges: functions that measure the error of a run of a hard case."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.energy import mechanical_energy, potential_energy
from sim.runs.simulation import Sample, simulate
from sim.scenes.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """A finished run of a case (`cases.Case`)."""

    case: Any
    integrator: str
    timestep: float
    scene: Scene
    samples: list[Sample]


Judge = Callable[[Run], float]


def final_speed(run: Run) -> float:
    """Speed [m/s] of a single body. Spin does not count: drag hardly slows the spin of a ball."""
    return float(np.linalg.norm(run.scene.data.qvel[:3]))


def final_tilt(expected: float) -> Judge:
    """Difference [deg] between the tilt at the end and the expected tilt [deg]."""

    def judge(run: Run) -> float:
        return float(abs(np.degrees(run.samples[-1].tilts[0]) - expected))

    return judge


def flat_tilt(run: Run) -> float:
    """Angle [deg] between a plate's axis and the vertical; either side may be up."""
    tilt = np.degrees(run.samples[-1].tilts[0])
    return float(min(tilt, 180.0 - tilt))


def highest(run: Run) -> float:
    return max(float(s.centres[0, 2]) for s in run.samples)


def departure(run: Run) -> float:
    """Largest displacement [m] of a body from its start along a world axis."""
    start = run.samples[0].centres
    return max(float(np.abs(s.centres - start).max()) for s in run.samples)


def apex(expected: float) -> Judge:
    """Relative error of the greatest height against the expected height [m]."""

    def judge(run: Run) -> float:
        return abs(highest(run) / expected - 1.0)

    return judge


def rise(acceleration: float) -> Judge:
    """Relative error of the distance risen, expected at a constant acceleration [m/s^2]."""

    def judge(run: Run) -> float:
        distance = run.samples[-1].centres[0, 2] - run.samples[0].centres[0, 2]
        return abs(distance / (0.5 * acceleration * run.samples[-1].time ** 2) - 1.0)

    return judge


def final_velocity(expected: float) -> Judge:
    def judge(run: Run) -> float:
        return abs(run.scene.data.qvel[2] / expected - 1.0)

    return judge


def distance_from_surface(after: float) -> Judge:
    """Largest vertical distance [m] from the water's surface, later than `after` [s]."""

    def judge(run: Run) -> float:
        start = run.samples[0].time
        late = [s for s in run.samples if s.time - start > after]
        return max(float(np.abs(s.centres[:, 2] - s.elevations).max()) for s in late)

    return judge


def mean_fraction(expected: float) -> Judge:
    """Largest relative error of a body's mean submerged fraction in the second half of the run."""

    def judge(run: Run) -> float:
        half = run.samples[len(run.samples) // 2 :]
        means = np.mean([s.submerged_fractions for s in half], axis=0)
        return float(np.abs(means / expected - 1.0).max())

    return judge


def heave(amplitude: float, draft: float) -> Judge:
    """Largest deviation from free heave, amplitude [m] * cos(omega t), over the amplitude."""
    omega = np.sqrt(9.81 / draft)

    def judge(run: Run) -> float:
        return max(
            abs(float(s.centres[0, 2]) / amplitude - np.cos(omega * s.time)) for s in run.samples
        )

    return judge


def symmetry(run: Run) -> float:
    """Largest sideways motion [m] or change of a quaternion component of a body that only moves up
    and down."""
    start = run.samples[0]
    return max(
        max(
            float(np.abs(s.centres[0, :2] - start.centres[0, :2]).max()),
            float(np.abs(s.quaternions[0] - start.quaternions[0]).max()),
        )
        for s in run.samples
    )


def same_as(other: Any, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Judge:
    """Largest difference [m] from the run of another case that is `offset` [m] away."""

    def judge(run: Run) -> float:
        twin = other.scene(run.integrator, run.timestep)
        twins = simulate(twin, other.duration, other.rate)
        return max(
            float(np.abs(a.centres - b.centres - offset).max())
            for a, b in zip(run.samples, twins, strict=True)
        )

    return judge


def energy_growth(run: Run) -> float:
    """Linear kinetic energy at the end over the energy at 1 m/s."""
    return float(0.5 * (run.scene.data.qvel[:3] ** 2).sum() / 0.5)


def conserves(scale: Callable[[Scene], float]) -> Judge:
    """Change of the mechanical energy from start to end over a scale [J]."""

    def judge(run: Run) -> float:
        start = run.case.scene(run.integrator, run.timestep)
        change = mechanical_energy(run.scene) - mechanical_energy(start)
        return abs(change) / scale(start)

    return judge


def kinetic_energy(scene: Scene) -> float:
    return mechanical_energy(scene) - potential_energy(scene)


def weight_times_30_cm(scene: Scene) -> float:
    return 0.3 * scene.buoyancy.sea.gravity * float(scene.model.body_mass.sum())
