"""Joints: the rest and the small motions of a body that can move only as its joints allow.

The body's pose is a product of rotations about hinges and shifts along slides, the first joint
outermost. Its potential energy is that of a free body (see `equilibrium`) plus that of the springs
of its joints. The gradient is known in closed form: the net wrench, projected on the joints. The
stiffness is its difference quotient. Newton's method goes to a minimum, as for a free body.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import rotation_about
from sim.statics.equilibrium import (
    LARGEST_STEP,
    MOST_STEPS,
    NUDGE_ANGLE,
    ROUND_OFF_SHARE,
    UNSTABLE_SHARE,
    Attitude,
    RigidFloat,
)

Array = NDArray[np.float64]

DIFFERENCE = 1e-5
"""Step [rad], and as a share of the body's size, of the difference quotients. Their relative error
is about 1e-9."""


@dataclass(frozen=True)
class Joint:
    """A hinge or a slide between a body and the world.

    name: what it is called. is_hinge: whether it is a hinge. axis (3,): unit vector; anchor (3,)
    [m]: a point of a hinge's axis, both at the start, in world axes about the point of the water's
    surface above or below the body's centre of mass. spring [N m/rad, N/m], rest [rad, m]: of the
    joint's spring, the latter from the start. armature [kg m^2, kg]: inertia of the joint.
    """

    name: str
    is_hinge: bool
    axis: Array
    anchor: Array
    spring: float = 0.0
    rest: float = 0.0
    armature: float = 0.0


class Pose(NamedTuple):
    """centre (3,) [m]: of mass, about the same point as the joints; rotation (3, 3): body -> world;
    motions (6, J): velocities of the centre of mass and angular velocities, in world axes, per
    speed of each joint."""

    centre: Array
    rotation: Array
    motions: Array

    @property
    def attitude(self) -> Attitude:
        return Attitude(float(self.centre[2]), self.rotation)


@dataclass(frozen=True)
class JointedFloat:
    """A body in still water that moves only by its joints, from an attitude at the start.

    values (J,) below are rotations [rad] and shifts [m] of the joints from the start.
    """

    body: RigidFloat
    start: Attitude
    joints: tuple[Joint, ...]

    def pose(self, values: Array) -> Pose:
        """The body's Pose at values of its joints."""
        turn, shift, axes = np.eye(3), np.zeros(3), []
        for joint, value in zip(self.joints, values, strict=True):
            axis, anchor = turn @ joint.axis, turn @ joint.anchor + shift
            axes.append((axis, anchor))
            if joint.is_hinge:
                turn = rotation_about(value * axis) @ turn
                shift = anchor - turn @ joint.anchor
            else:
                shift = shift + value * axis
        centre = turn @ [0.0, 0.0, self.start.height] + shift
        motions = np.zeros((6, len(self.joints)))
        for column, joint, (axis, anchor) in zip(motions.T, self.joints, axes, strict=True):
            column[:3] = np.cross(axis, centre - anchor) if joint.is_hinge else axis
            column[3:] = axis if joint.is_hinge else 0.0
        return Pose(centre, turn @ self.start.rotation, motions)

    def energy(self, values: Array) -> float:
        """Potential energy [J] of body, water and springs."""
        attitude = self.pose(values).attitude
        energy = self.body.energy(attitude, self.body.wetted(attitude))
        for joint, value in zip(self.joints, values, strict=True):
            energy += 0.5 * joint.spring * (value - joint.rest) ** 2
        return float(energy)

    def pull(self, values: Array) -> Array:
        """Forces [N] and torques [N m] (J,) of weight, buoyancy and springs on the joints."""
        pose = self.pose(values)
        wrench = self.body.pull(self.body.wetted(pose.attitude))
        springs = [j.spring * (v - j.rest) for j, v in zip(self.joints, values, strict=True)]
        return pose.motions[2:5].T @ wrench - springs

    @property
    def scale(self) -> Array:
        """Sizes (J,) of the joints' values: 1 rad, or the body's size [m]."""
        return np.array([1.0 if j.is_hinge else self.body.size for j in self.joints])

    def stiffness(self, values: Array) -> Array:
        """Stiffness (J, J): minus the derivative of the pull."""
        found = np.empty((len(values), len(values)))
        for i, step in enumerate(np.diag(DIFFERENCE * self.scale)):
            found[i] = (self.pull(values - step) - self.pull(values + step)) / (2.0 * step[i])
        return 0.5 * (found + found.T)

    def at_rest(self) -> Array | None:
        """Values (J,) of the joints at rest, reached downhill from the start; None if there is no
        rest."""
        scale, unit = self.scale, self.body.weight * self.body.size
        values = np.zeros(len(self.joints))
        for _ in range(MOST_STEPS):
            pull = self.pull(values) * scale / unit
            moduli, vectors = np.linalg.eigh(self.stiffness(values) * np.outer(scale, scale) / unit)
            if np.abs(pull).max(initial=0.0) < ROUND_OFF_SHARE:
                if moduli.min(initial=0.0) >= -UNSTABLE_SHARE:
                    return values
                values = values + scale * NUDGE_ANGLE * vectors[:, 0]
                continue
            step = vectors @ (vectors.T @ pull / np.maximum(np.abs(moduli), 1e-6))
            step *= scale * min(1.0, LARGEST_STEP / np.abs(step).max())
            moved = self._downhill(values, step)
            if moved is None:  # as near as round-off allows
                return values
            values = moved
        return None

    def _downhill(self, values: Array, step: Array) -> Array | None:
        """The values after a step, halved until it lowers the energy; None if round-off prevents
        that."""
        energy, allowed = self.energy(values), 1e-14 * self.body.weight * self.body.size
        for _ in range(30):
            if self.energy(values + step) <= energy + allowed:
                return values + step
            step = 0.5 * step
        return None
