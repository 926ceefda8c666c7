"""Divergence: states that cannot be.

MuJoCo warns of numbers that are not finite or huge. A body on too long a timestep may be thrown
kilometres high without that: `Watch` holds its energy against what explains it.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.mjcf.floats import body_label
from sim.scenes.scene import Scene
from sim.scenes.timestep import unstable_bodies

Array = NDArray[np.float64]


class DivergenceError(RuntimeError):
    """The state is not a number, or one that nothing explains. `body` is the name of the body,
    `time` [s] when it was noticed; `str()` adds the remedy."""

    def __init__(self, body: str, time: float, what: str, remedy: str) -> None:
        self.body = body
        self.time = time
        super().__init__(f"body '{body}' diverged at {time:.4f} s: its {what}; {remedy}")


class Watch:
    """Holds the energy of the bodies for which the timestep is too long against what explains it.

    Energies are heads [m]: heights over the level that a body would reach in air if all of its
    energy went into height. Explained is the gain of a body that a wave pushes under water, and
    that moves at twice the speed of the fastest wave and the current.

    A body with a timestep that is short enough is not watched. Actuators, forces, springs and
    collisions may give it any energy. They may not where the timestep is too long: the remedy is
    a shorter one.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._bodies = list(unstable_bodies(scene))
        sea = scene.buoyancy.sea
        waves = max((np.sqrt(sea.gravity / wave.wavenumber) for wave in sea.waves), default=0.0)
        speed = 2.0 * (waves + np.linalg.norm(sea.current))
        self._explained = speed**2 / (2.0 * sea.gravity) + np.array(
            [found.lift * (found.reach + 2.0 * sea.amplitude) for found in self._bodies]
        )
        self._gains = np.zeros(len(self._bodies))

    def heads(self) -> Array:
        """The heads [m] of the watched bodies as the state stands."""
        model, data, sea = self.scene.model, self.scene.data, self.scene.buoyancy.sea
        heads, velocity = np.zeros(len(self._bodies)), np.zeros(6)
        if self._bodies:
            for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
                update(model, data)
        for i, found in enumerate(self._bodies):
            mujoco.mj_objectVelocity(
                model, data, mujoco.mjtObj.mjOBJ_BODY, found.body, velocity, 1
            )  # rotation first
            mass = max(model.body_mass[found.body], mujoco.mjMINVAL)
            squares = model.body_inertia[found.body] / mass @ velocity[:3] ** 2
            squares += velocity[3:] @ velocity[3:]
            height = data.xipos[found.body, 2] - sea.level_at(data.time)
            heads[i] = squares / (2.0 * sea.gravity) + max(height, (1.0 - found.lift) * height)
        return heads

    def check(self, before: Array) -> None:
        """Add what steps have changed since the heads were `before`. What changes between steps is
        the caller's doing. Raises DivergenceError for a gain that is not explained."""
        self._gains = np.maximum(self._gains + self.heads() - before, 0.0)
        for i in np.flatnonzero(self._gains > self._explained)[:1]:
            raise self.divergence(
                self._bodies[i].body,
                self.scene.data.time,
                f"energy would take it {self._gains[i]:.3g} m higher than before, of which waves "
                f"and buoyancy explain {self._explained[i]:.3g} m",
            )

    def divergence(self, body: int, time: float, what: str) -> DivergenceError:
        """The error for a body of which `what` says what is wrong, with the remedy."""
        model = self.scene.model
        remedy = (
            f"try a timestep below {model.opt.timestep:g} s, and check the body's mass and inertia "
            "and that the bodies do not overlap at the start"
        )
        for found in self._bodies:
            if found.body == model.body_weldid[body]:
                remedy = found.remedy
        return DivergenceError(body_label(model, body), time, what, remedy)
