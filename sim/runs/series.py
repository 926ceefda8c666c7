"""Series: the samples of a run as a table, one row per sample and floating body."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.runs.motions import motion
from sim.runs.simulation import Sample
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

COLUMNS = (
    "x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz",
    "water_height", "heave", "heel_deg", "trim_deg", "tilt_deg", "submerged_fraction",
    "fx", "fy", "fz", "tx", "ty", "tz",
    "drag_fx", "drag_fy", "drag_fz", "drag_tx", "drag_ty", "drag_tz",
)  # fmt: skip
"""Columns after time [s] and body: position [m] and quaternion of the body's frame, velocity [m/s]
of its origin, angular velocity [rad/s], height of the water [m], heave [m], heel (starboard down),
trim (bow down) and tilt [deg], submerged share of its hulls' volume, forces [N] and torques [N m]
of buoyancy and drag about the centre of mass. All axes are world axes."""


class Series:
    """The table of a scene's samples. `motions` defines heave, heel and trim."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._rest_heights = scene.rest_heights
        self._rows: list[Array] = []
        self._times: list[float] = []

    def add(self, sample: Sample) -> None:
        """Add the sample of the scene's present state."""
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
        """Time [s], body and COLUMNS, each (samples x bodies,)."""
        bodies = self._scene.buoyancy.body_names
        rows = np.concatenate(self._rows) if self._rows else np.empty((0, len(COLUMNS)))
        return {
            "time": np.repeat(self._times, len(bodies)),
            "body": np.array(bodies * len(self._times)),
        } | dict(zip(COLUMNS, rows.T, strict=True))

    def _velocities(self) -> Array:
        """Velocities (B, 6) of the bodies' frames in the present state, linear before angular."""
        model, data = self._scene.model, self._scene.data
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        kind, bodies = mujoco.mjtObj.mjOBJ_XBODY, self._scene.buoyancy.bodies.tolist()
        velocities = np.empty((len(bodies), 6))  # of MuJoCo: angular before linear
        for body, velocity in zip(bodies, velocities, strict=True):
            mujoco.mj_objectVelocity(model, data, kind, body, velocity, 0)
        return np.roll(velocities, 3, axis=1)
