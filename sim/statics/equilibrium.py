"""Equilibrium: how a rigid body lies in still water.

Its potential energy, of itself and of the water that it displaces, is a function of its height and
of its rotation about two horizontal axes. Both its gradient, the wrench that is left, and its
second derivatives, the hydrostatic stiffness, are known in closed form, so a rest is found by
Newton's method on a minimum: along directions in which the energy falls off (an upright body that
would capsize), the step goes downhill, and rest is reached from any way up.

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
"""Radians, and heights in the body's sizes, that a step may go."""

AT_REST = 1e-11
"""Of weight and weight times size: a force and a torque below this are round-off."""

FALLS_OFF = 1e-9
"""Of weight times size: a stiffness below minus this makes a body turn over."""

NUDGE = 0.02
"""Radians by which a body in an equilibrium that is none to stay is pushed out of it."""

MOST_STEPS = 400


class Attitude(NamedTuple):
    """height [m] of the centre of mass above the water; rotation (3, 3), body -> world."""

    height: float
    rotation: Array


@dataclass(frozen=True)
class RigidFloat:
    """A body as hydrostatics sees it: corners (F, 3, 3) [m] of its hulls' triangles about its
    centre of mass, its mass [kg], the water's density [kg/m^3] and gravity [m/s^2]; displaced (F,):
    the volume that each triangle's hull displaces, over that which it encloses."""

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
        """That the whole hulls displace [m^3]."""
        return self.wetted(Attitude(-2.0 * self.size, np.eye(3))).volume

    @property
    def weight(self) -> float:
        return self.mass * self.gravity

    def wetted(self, attitude: Attitude) -> Wetted:
        """What is under water, in world axes below the centre of mass, z from the level."""
        shares = np.broadcast_to(np.asarray(self.displaced, dtype=float), len(self.corners))
        return wetted_part(self.corners, shares, attitude.rotation, attitude.height)

    def stiffness(self, attitude: Attitude, wetted: Wetted) -> Array:
        """Hydrostatic stiffness (3, 3) [N/m, N, N m] in heave and in rotations about the world's x
        and y axes through the centre of mass."""
        rho_g, (mx, my), i = self.density * self.gravity, wetted.plane_moment, wetted.plane_squares
        lever = wetted.moment[2] - wetted.volume * attitude.height
        k = np.array(
            [[wetted.waterplane, my, -mx], [my, i[1, 1], -i[0, 1]], [-mx, -i[0, 1], i[0, 0]]]
        )
        k[1, 1] += lever
        k[2, 2] += lever
        return rho_g * k

    def pull(self, wetted: Wetted) -> Array:
        """What is left of weight and buoyancy (3,): force up [N], torques about x and y [N m]."""
        rho_g, (x, y, _) = self.density * self.gravity, wetted.moment
        return np.array([rho_g * wetted.volume - self.weight, rho_g * y, -rho_g * x])

    def energy(self, attitude: Attitude, wetted: Wetted) -> float:
        """Of the body and the water that it displaces [J]."""
        return self.weight * attitude.height - self.density * self.gravity * wetted.moment[2]


def afloat(body: RigidFloat, rotation: Array) -> Attitude:
    """The attitude of this rotation in which a body that does not sink displaces its mass."""
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
    """The attitude in which a body stays that is let go in a rotation (3, 3), free to rise and to
    turn about these of the world's axes. It must not sink."""
    free = [0] + [1 + "xy".index(axis) for axis in axes]
    scale = np.array([body.size, 1.0, 1.0])[free]
    unit, squares = body.weight * body.size, np.outer(scale, scale)
    attitude = afloat(body, rotation)
    wetted = body.wetted(attitude)
    for _ in range(MOST_STEPS):
        pull = body.pull(wetted)[free] * scale / unit
        stiffness = body.stiffness(attitude, wetted)[np.ix_(free, free)] * squares / unit
        values, vectors = np.linalg.eigh(stiffness)
        if np.abs(pull).max() < AT_REST:
            if values[0] >= -FALLS_OFF:
                break
            attitude = _moved(attitude, free, scale * NUDGE * vectors[:, 0])
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
    """The attitude after a step, or a part of it, that takes energy; None where none does, which is
    round-off."""
    energy, allowed = body.energy(attitude, wetted), 1e-14 * body.weight * body.size
    for _ in range(30):
        moved = _moved(attitude, free, step)
        found = body.wetted(moved)
        if body.energy(moved, found) <= energy + allowed:
            return moved, found
        step = 0.5 * step
    return None


def _moved(attitude: Attitude, free: list[int], step: Array) -> Attitude:
    """An attitude after a step (height [m], rotations [rad]) in its free directions."""
    whole = np.zeros(3)
    whole[free] = step
    turn = rotation_about(np.array([whole[1], whole[2], 0.0]))
    return Attitude(attitude.height + whole[0], turn @ attitude.rotation)
