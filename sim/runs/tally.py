"""Tally: means and motions of the floating bodies over the samples of a run."""

from typing import Any

import numpy as np

from sim.runs.motions import motion
from sim.runs.simulation import Sample
from sim.scenes.scene import Scene

MEANS = ("mean_height", "mean_tilt_deg", "mean_submerged_fraction", "mean_force_over_weight")

MOTIONS = ("heave_m", "heel_deg", "trim_deg", "drift_m")
"""Motions with a mean, a standard deviation and a largest value. Drift is the horizontal distance
of a body's centre of mass from its place in the first sample that counts."""


class Tally:
    """Statistics over the samples of a run.

    tally = Tally(scene)
    for sample in simulate(scene, 10.0):
        tally.add(sample)
    tally.bodies()

    warm_up [s]: time after the first sample in which samples do not count. If a run is shorter, all
    of its samples count.
    """

    def __init__(self, scene: Scene, warm_up: float = 0.0) -> None:
        self.scene = scene
        self.last: Sample | None = None
        self._warm_up = warm_up
        self._begin: float | None = None
        self._forget()

    def _forget(self) -> None:
        """Begin to count."""
        shape = len(self.scene.buoyancy.bodies), len(MEANS) + len(MOTIONS)
        self._count = 0
        self._means, self._squares = np.zeros(shape), np.zeros(shape)
        self._largest = np.zeros((shape[0], len(MOTIONS)))

    def add(self, sample: Sample) -> None:
        """Add a sample; all samples have the same weight."""
        if self._begin is None:
            self._begin = sample.time
        if self._warm_up and sample.time - self._begin >= self._warm_up - 1e-9:
            self._warm_up = 0.0
            self._forget()
        if self._count == 0:
            self._origin = sample.centres[:, :2]
        self.last = sample
        values = self._values(sample)
        self._count += 1
        off = values - self._means  # sums of squares about the mean, as Welford (1962) updates them
        self._means += off / self._count
        self._squares += off * (values - self._means)
        motions = values[:, len(MEANS) :]
        is_larger = np.abs(motions) > np.abs(self._largest)
        self._largest = np.where(is_larger, motions, self._largest)

    def _values(self, sample: Sample) -> np.ndarray:
        """The values (B, MEANS + MOTIONS) of a sample."""
        moved = motion(sample, self.scene.buoyancy.sea, self.scene.rest_heights)
        return np.column_stack(
            [
                sample.centres[:, 2],
                np.degrees(sample.tilts),
                sample.submerged_fractions,
                sample.body_wrenches[:, 2] / self.scene.buoyancy.weights,
                moved.heave,
                moved.heel_deg,
                moved.trim_deg,
                np.linalg.norm(sample.centres[:, :2] - self._origin, axis=1),
            ]
        )

    def bodies(self) -> dict[str, dict[str, Any]]:
        """For each floating body, as numbers for JSON: mean_height [m] of the centre of mass,
        mean_tilt_deg, mean_submerged_fraction, mean_force_over_weight (vertical, over its weight
        with all bodies that are welded to it), final_position (3) [m] and final_quaternion (4) of
        its frame; and for each of MOTIONS its mean, std and largest, which is the value of the
        largest size, with its sign."""
        if self.last is None:
            return {}
        deviations = np.sqrt(self._squares / self._count)
        found = {}
        for b, body in enumerate(self.scene.buoyancy.body_names):
            means, stds = self._means[b].tolist(), deviations[b].tolist()
            found[body] = {
                **dict(zip(MEANS, means, strict=False)),
                "final_position": self.last.positions[b].tolist(),
                "final_quaternion": self.last.quaternions[b].tolist(),
            }
            for m, name in enumerate(MOTIONS):
                found[body][name] = {
                    "mean": means[len(MEANS) + m],
                    "std": stds[len(MEANS) + m],
                    "largest": float(self._largest[b, m]),
                }
        return found
