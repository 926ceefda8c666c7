"""Divergence: detects impossible states.

MuJoCo warns of numbers that are not finite or huge. With too long a timestep a body may be thrown
kilometres high without a warning: `Watch` compares its energy with an explained energy.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.mjcf.floats import body_label
from sim.scenes.scene import Scene
from sim.scenes.timestep import unstable_bodies

Array = NDArray[np.float64]


class DivergenceError(RuntimeError):
    """The state is not finite, or its energy cannot be explained. `body` is the name of the body,
    `time` [s] the time of detection; `str()` adds the remedy."""

    def __init__(self, body: str, time: float, fault: str, remedy: str) -> None:
        self.body = body
        self.time = time
        super().__init__(f"body '{body}' diverged at {time:.4f} s: its {fault}; {remedy}")


class Watch:
    """Limits the energy gain of the bodies for which the timestep is too long.

    Energies are heads [m]: heights over the level that a body would reach in air if all of its
    energy became height. The limit is the gain of a body that a wave pushes under water and that
    moves at twice the speed of the fastest wave and the current.

    A body with a sufficiently short timestep is not watched. Actuators, forces, springs and
    collisions may give it any energy.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._bodies = list(unstable_bodies(scene))
        sea = scene.buoyancy.sea
        waves = max((np.sqrt(sea.gravity / wave.wavenumber) for wave in sea.waves), default=0.0)
        speed = 2.0 * (waves + np.linalg.norm(sea.current))
        self._explained = speed**2 / (2.0 * sea.gravity) + np.array(
            [body.lift * (body.reach + 2.0 * sea.amplitude) for body in self._bodies]
        )
        self._gains = np.zeros(len(self._bodies))

    def heads(self) -> Array:
        """The heads [m] of the watched bodies in the present state."""
        model, data, sea = self.scene.model, self.scene.data, self.scene.buoyancy.sea
        heads, velocity = np.zeros(len(self._bodies)), np.zeros(6)
        if self._bodies:
            for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
                update(model, data)
        kind = mujoco.mjtObj.mjOBJ_BODY
        for i, unstable in enumerate(self._bodies):
            body = unstable.body
            mujoco.mj_objectVelocity(model, data, kind, body, velocity, 1)  # angular first
            mass = max(model.body_mass[body], mujoco.mjMINVAL)
            squares = model.body_inertia[body] / mass @ velocity[:3] ** 2
            squares += velocity[3:] @ velocity[3:]
            height = data.xipos[body, 2] - sea.level_at(data.time)
            heads[i] = squares / (2.0 * sea.gravity) + max(height, (1.0 - unstable.lift) * height)
        return heads

    def check(self, before: Array) -> None:
        """Add the gains of steps that began with the heads `before`. Changes by the caller between
        steps do not count. Raises DivergenceError for a gain that is not explained."""
        self._gains = np.maximum(self._gains + self.heads() - before, 0.0)
        for i in np.flatnonzero(self._gains > self._explained)[:1]:
            raise self.divergence(
                self._bodies[i].body,
                self.scene.data.time,
                f"energy would take it {self._gains[i]:.3g} m higher than before, of which waves "
                f"and buoyancy explain {self._explained[i]:.3g} m",
            )

    def divergence(self, body: int, time: float, fault: str) -> DivergenceError:
        """The error for a fault of a body, with the remedy."""
        model = self.scene.model
        remedy = (
            f"try a timestep below {model.opt.timestep:g} s, and check the body's mass and inertia "
            "and that the bodies do not overlap at the start"
        )
        for unstable in self._bodies:
            if unstable.body == model.body_weldid[body]:
                remedy = unstable.remedy
        return DivergenceError(body_label(model, body), time, fault, remedy)
