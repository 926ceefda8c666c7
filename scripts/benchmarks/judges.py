"""Judges: how wrong a run of a hard case is."""

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
    """A case (`cases.Case`) that has been run to its end."""

    case: Any
    integrator: str
    timestep: float
    scene: Scene
    samples: list[Sample]


Judge = Callable[[Run], float]


def final_speed(run: Run) -> float:
    """Speed [m/s] of a single body's frame; a ball may go on spinning, which takes little drag."""
    return float(np.linalg.norm(run.scene.data.qvel[:3]))


def final_tilt(expected: float) -> Judge:
    """Angle [deg] between the tilt at the end and the expected one [deg]."""

    def judge(run: Run) -> float:
        return float(abs(np.degrees(run.samples[-1].tilts[0]) - expected))

    return judge


def flat_tilt(run: Run) -> float:
    """Angle [deg] between a plate's axis and the vertical, whichever side is up."""
    tilt = np.degrees(run.samples[-1].tilts[0])
    return float(min(tilt, 180.0 - tilt))


def highest(run: Run) -> float:
    return max(float(s.centres[0, 2]) for s in run.samples)


def departure(run: Run) -> float:
    """How far [m] a body gets from where it started."""
    start = run.samples[0].centres
    return max(float(np.abs(s.centres - start).max()) for s in run.samples)


def apex(expected: float) -> Judge:
    """Relative error of the greatest height against the expected one [m]."""

    def judge(run: Run) -> float:
        return abs(highest(run) / expected - 1.0)

    return judge


def rise(acceleration: float) -> Judge:
    """Relative error of the way gone against that at a constant acceleration [m/s^2]."""

    def judge(run: Run) -> float:
        way = run.samples[-1].centres[0, 2] - run.samples[0].centres[0, 2]
        return abs(way / (0.5 * acceleration * run.samples[-1].time ** 2) - 1.0)

    return judge


def final_velocity(expected: float) -> Judge:
    def judge(run: Run) -> float:
        return abs(run.scene.data.qvel[2] / expected - 1.0)

    return judge


def distance_from_surface(after: float) -> Judge:
    """Largest distance [m] of the body from the water's surface after a while [s]."""

    def judge(run: Run) -> float:
        start = run.samples[0].time
        late = [s for s in run.samples if s.time - start > after]
        return max(float(np.abs(s.centres[:, 2] - s.elevations).max()) for s in late)

    return judge


def mean_fraction(expected: float) -> Judge:
    """Largest relative error of a body's mean submerged fraction over the second half."""

    def judge(run: Run) -> float:
        half = run.samples[len(run.samples) // 2 :]
        means = np.mean([s.submerged_fractions for s in half], axis=0)
        return float(np.abs(means / expected - 1.0).max())

    return judge


def heave(amplitude: float, draft: float) -> Judge:
    """Largest distance from free heave, amplitude cos(omega t), over the amplitude [m]."""
    omega = np.sqrt(9.81 / draft)

    def judge(run: Run) -> float:
        return max(
            abs(float(s.centres[0, 2]) / amplitude - np.cos(omega * s.time)) for s in run.samples
        )

    return judge


def symmetry(run: Run) -> float:
    """Largest sideways motion [m] and turn [rad] of a body that nothing pushes aside."""
    start = run.samples[0]
    return max(
        max(
            float(np.abs(s.centres[0, :2] - start.centres[0, :2]).max()),
            float(np.abs(s.quaternions[0] - start.quaternions[0]).max()),
        )
        for s in run.samples
    )


def same_as(other: Any, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Judge:
    """Largest distance [m] from the run of another case, apart from an offset."""

    def judge(run: Run) -> float:
        twin = other.scene(run.integrator, run.timestep)
        twins = simulate(twin, other.duration, other.rate)
        return max(
            float(np.abs(a.centres - b.centres - offset).max())
            for a, b in zip(run.samples, twins, strict=True)
        )

    return judge


def energy_growth(run: Run) -> float:
    """Kinetic energy at the end over that of 1 m/s; drag alone may only lower it."""
    return float(0.5 * (run.scene.data.qvel[:3] ** 2).sum() / 0.5)


def conserves(scale: Callable[[Scene], float]) -> Judge:
    """Change of the energy from start to end over a scale [J]."""

    def judge(run: Run) -> float:
        start = run.case.scene(run.integrator, run.timestep)
        change = mechanical_energy(run.scene) - mechanical_energy(start)
        return abs(change) / scale(start)

    return judge


def kinetic_energy(scene: Scene) -> float:
    return mechanical_energy(scene) - potential_energy(scene)


def weight_times_a_foot(scene: Scene) -> float:
    return 0.3 * scene.buoyancy.sea.gravity * float(scene.model.body_mass.sum())
