"""Series: what a run does as a table, one row a sample and floating body."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.runs.motions import motion
from sim.runs.simulation import Sample
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

NAMES = (
    "x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz",
    "water_height", "heave", "heel_deg", "trim_deg", "tilt_deg", "submerged_fraction",
    "fx", "fy", "fz", "tx", "ty", "tz",
    "drag_fx", "drag_fy", "drag_fz", "drag_tx", "drag_ty", "drag_tz",
)  # fmt: skip
"""Columns behind time [s] and body: place [m] and quaternion of the body's frame, velocity of its
origin [m/s] and angular one [rad/s], height of the water [m], heave [m], heel (starboard down),
trim (bow down) and tilt [deg], the part of its hulls' volume that is submerged; forces [N] and
torques [N m] of buoyancy and drag about the centre of mass, all in world axes."""


class Series:
    """Collects the samples of a scene; heave, heel and trim as in `motions`."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._rest_heights = scene.rest_heights
        self._rows: list[Array] = []
        self._times: list[float] = []

    def add(self, sample: Sample) -> None:
        """Count one sample in, while the scene is at it."""
        moved = motion(sample, self._scene.buoyancy.sea, self._rest_heights)
        self._times.append(sample.time)
        self._rows.append(
            np.column_stack(
                [
                    sample.positions, sample.quaternions, self._velocities(), sample.elevations,
                    moved.heave, moved.heel_deg, moved.trim_deg, np.degrees(sample.tilts),
                    sample.submerged_fractions, sample.body_wrenches, sample.drag_wrenches,
                ]
            )
        )  # fmt: skip

    def columns(self) -> dict[str, NDArray]:
        """Time [s], body and NAMES, each (samples x bodies,)."""
        bodies = self._scene.buoyancy.body_names
        rows = np.concatenate(self._rows) if self._rows else np.empty((0, len(NAMES)))
        found = {
            "time": np.repeat(self._times, len(bodies)),
            "body": np.array(bodies * len(self._times)),
        }
        return found | dict(zip(NAMES, rows.T, strict=True))

    def _velocities(self) -> Array:
        """Velocities (B, 6) of the bodies' frames, linear ones first, as the state has them now."""
        model, data = self._scene.model, self._scene.data
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        found = np.empty((len(self._scene.buoyancy.bodies), 6))
        for row, body in zip(found, self._scene.buoyancy.bodies, strict=True):
            turning_first = np.empty(6)
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectVelocity(model, data, kind, int(body), turning_first, 0)
            row[:] = np.roll(turning_first, 3)
        return found
