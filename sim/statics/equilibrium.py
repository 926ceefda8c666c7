"""Equilibrium: how a rigid body lies in still water.

The potential energy of the body and of the water that it displaces is a function of the body's
height and of its rotation about two horizontal axes. Its gradient (the net wrench) and its second
derivatives (the hydrostatic stiffness) are known in closed form, so Newton's method finds a
minimum. In directions of negative curvature, for example of a body that capsizes, a step goes
downhill. So a rest is found from any rotation.

Source: Newman 1977, 6.16, for the stiffness; Nocedal and Wright 2006, 3.4, for Newton's method with
the moduli of the eigenvalues.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import rotation_about
from sim.statics.wetted import Wetted, wetted_part

Array = NDArray[np.float64]

LARGEST_STEP = 0.3
"""Largest rotation [rad] in a step, and largest rise as a share of the body's size."""

ROUND_OFF_SHARE = 1e-11
"""Share of the weight, and of weight times size: a smaller force or torque is round-off."""

UNSTABLE_SHARE = 1e-9
"""Share of weight times size: an equilibrium with a stiffness below minus this is unstable."""

NUDGE_ANGLE = 0.02
"""Angle [rad] by which a body is moved out of an unstable equilibrium."""

MOST_STEPS = 400
"""Largest number of Newton steps."""


class Attitude(NamedTuple):
    """height [m]: of the centre of mass above the water. rotation: (3, 3), body -> world."""

    height: float
    rotation: Array


@dataclass(frozen=True, eq=False)
class RigidFloat:
    """A rigid body in still water.

    corners: (F, 3, 3) [m], the triangles of its hulls, about its centre of mass. mass [kg]. density
    [kg/m^3]: of the water. gravity [m/s^2]. displaced: the volume that a hull displaces over the
    volume that it encloses, (F,) for the hull of each triangle, or one number.
    """

    corners: Array
    mass: float
    density: float
    gravity: float
    displaced: Array | float = 1.0

    @cached_property
    def size(self) -> float:
        """Largest distance [m] from the centre of mass."""
        return float(np.linalg.norm(self.corners, axis=2).max())

    @cached_property
    def volume(self) -> float:
        """Volume [m^3] that the whole hulls displace."""
        return self.wetted(Attitude(-2.0 * self.size, np.eye(3))).volume

    @property
    def weight(self) -> float:
        """Weight [N]."""
        return self.mass * self.gravity

    @cached_property
    def shares(self) -> Array:
        """`displaced` of each triangle (F,)."""
        return np.full(len(self.corners), self.displaced, dtype=float)

    def placed(self, attitude: Attitude) -> Array:
        """Corners (F, 3, 3) [m] in world axes. The origin is the point of the water's surface above
        or below the centre of mass."""
        return self.corners @ attitude.rotation.T + [0.0, 0.0, attitude.height]

    def wetted(self, attitude: Attitude) -> Wetted:
        """The wetted part, in the axes and with the origin of `placed`."""
        return wetted_part(self.corners, self.shares, attitude.rotation, attitude.height)

    def stiffness(self, attitude: Attitude, wetted: Wetted) -> Array:
        """Hydrostatic stiffness (3, 3) [N/m, N, N m] in heave and in rotations about the world's x
        and y axes through the centre of mass."""
        area, (mx, my), i = wetted.waterplane, wetted.plane_moment, wetted.plane_squares
        lever = wetted.moment[2] - wetted.volume * attitude.height
        k = np.array([[area, my, -mx], [my, i[1, 1], -i[0, 1]], [-mx, -i[0, 1], i[0, 0]]])
        k[1, 1] += lever
        k[2, 2] += lever
        return self.density * self.gravity * k

    def pull(self, wetted: Wetted) -> Array:
        """Sum (3,) of weight and buoyancy: upward force [N], torques about x and y [N m]."""
        rho_g, (x, y, _) = self.density * self.gravity, wetted.moment
        return np.array([rho_g * wetted.volume - self.weight, rho_g * y, -rho_g * x])

    def energy(self, attitude: Attitude, wetted: Wetted) -> float:
        """Potential energy [J] of the body and the water that it displaces."""
        return self.weight * attitude.height - self.density * self.gravity * wetted.moment[2]


def afloat(body: RigidFloat, rotation: Array) -> Attitude:
    """The attitude with a rotation (3, 3) in which a body displaces its mass. It must not sink."""
    ups = (body.corners @ rotation.T)[:, :, 2]
    low, high = -float(ups.max()), -float(ups.min())
    height, wanted = 0.5 * (low + high), body.mass / body.density
    for _ in range(100):
        wetted = body.wetted(Attitude(height, rotation))
        excess = wetted.volume - wanted
        if abs(excess) <= 1e-15 * wanted or high - low <= 1e-15 * body.size:
            break
        low, high = (height, high) if excess > 0.0 else (low, height)
        guess = height + excess / wetted.waterplane if wetted.waterplane > 0.0 else low
        height = guess if low < guess < high else 0.5 * (low + high)
    return Attitude(height, rotation)


def rest(body: RigidFloat, rotation: Array, axes: str = "xy") -> Attitude:
    """The attitude in which a body comes to rest after it is released in a rotation (3, 3), free in
    heave and in rotation about `axes` of the world. It must not sink."""
    free = [0] + [1 + "xy".index(axis) for axis in axes]
    scale = np.array([body.size, 1.0, 1.0])[free]
    unit, squares = body.weight * body.size, np.outer(scale, scale)
    attitude = afloat(body, rotation)
    wetted = body.wetted(attitude)
    for _ in range(MOST_STEPS):
        pull = body.pull(wetted)[free] * scale / unit
        stiffness = body.stiffness(attitude, wetted)[np.ix_(free, free)] * squares / unit
        values, vectors = np.linalg.eigh(stiffness)
        if np.abs(pull).max() < ROUND_OFF_SHARE:
            if values[0] >= -UNSTABLE_SHARE:
                break
            attitude = _moved(attitude, free, scale * NUDGE_ANGLE * vectors[:, 0])
            wetted = body.wetted(attitude)
            continue
        step = vectors @ (vectors.T @ pull / np.maximum(np.abs(values), 1e-6))
        step *= min(1.0, LARGEST_STEP / np.abs(step).max())
        moved = _downhill(body, attitude, wetted, free, scale * step)
        if moved is None:
            break
        attitude, wetted = moved
    return attitude


def _downhill(
    body: RigidFloat, attitude: Attitude, wetted: Wetted, free: list[int], step: Array
) -> tuple[Attitude, Wetted] | None:
    """The attitude and its Wetted after a step, halved until it lowers the energy; None if
    round-off prevents that."""
    energy, allowed = body.energy(attitude, wetted), 1e-14 * body.weight * body.size
    for _ in range(30):
        moved = _moved(attitude, free, step)
        moved_wetted = body.wetted(moved)
        if body.energy(moved, moved_wetted) <= energy + allowed:
            return moved, moved_wetted
        step = 0.5 * step
    return None


def _moved(attitude: Attitude, free: list[int], step: Array) -> Attitude:
    """An attitude after a step (height [m], rotations [rad]) in its free directions."""
    change = np.zeros(3)
    change[free] = step
    rotation = rotation_about(np.array([change[1], change[2], 0.0]))
    return Attitude(attitude.height + change[0], rotation @ attitude.rotation)
