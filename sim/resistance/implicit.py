"""Implicit: the step that bears strong drag, large added mass and very light bodies.

Added mass is the water that a hull has to accelerate with itself: A, 6 x 6, times the submerged
fraction f. By Kirchhoff's equations, in axes that turn with the body and with nu = (u, omega)
relative to the water at the hull's centroid, which itself accelerates by a_w,

    F_added = - f A (a - a_w, alpha) + f A (omega x u, 0) - (omega x p, omega x l + u x p),
    (p, l) = f A nu.

Explicit in time, strong drag (see `drag`) and large added mass would both throw a light body
out of the water. So one small system is solved a step for the acceleration a,

    (M + A + h C) a = F_gravity + F_buoyancy + F_drag(v) - bias + ...,   C = - dF_drag/dv >= 0,

and M a - F_gravity + bias is handed over as the wrench, with which the free body
accelerates by just that (Hairer and Wanner 1996, IV.7: the linearly implicit Euler method).
All of it happens along the axes of the body's inertial frame, in which M and A are constant.

Exact (of first order in the timestep, as Euler's methods are) for a free body that nothing
touches. Approximations:

* other forces: those in `qfrc_applied` meet the added mass too; actuators, joint damping and
  contacts meet the dry mass alone. A body that rests on something with
  its added mass presses with M / (M + A) of its weight in water.
* a link of a kinematic tree: drag is damped with the link's own inertia, of which its
  joints leave it no less, so it is stable and statically exact, and at h C << M the explicit drag;
  an added mass is refused.
* RK4: every stage solves with the full timestep, so drag makes RK4 of first order too (added mass
  alone does not).
* the water that enters or leaves the added mass as f changes carries no momentum (no slamming).

Source: Newman 1977 for Kirchhoff's equations.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.geometry import cross
from sim.kernels import kernel, packed, record, table
from sim.resistance.drag import STRENGTH, SURFACE, Drag, add_hull_drag
from sim.water.gerstner import WATER, WAVE
from sim.water.motion import water_motion

Array = NDArray[np.float64]

BODY = record(
    body="i8", root="i8", dof="i8", first="i8", end="i8",
    mass="f8", inertia=("f8", 3), origin=("f8", 3), axes=("f8", (3, 3)),
)  # fmt: skip
"""A ResistedBody: its rows, its first hull and where they end, and its constants."""

HULL = record(
    row="i8", surface="i8", has_drag="i8", has_added_mass="i8", strength=STRENGTH,
    whole="f8", rate="f8", centroid=("f8", 3), added_mass=("f8", (6, 6)),
)  # fmt: skip
"""A hull with drag or added mass: its row among the wrenches of buoyancy and its drag's elements,
the buoyancy [N] when it is submerged, and the rate [1/s] at which it takes angular momentum."""


@dataclass(frozen=True)
class ResistedBody:
    """A rigid body some of whose hulls have drag or added mass, and its places in arrays.

    body: its row in the arrays of all bodies; root: the row of the point to which its
    velocity refers; dof: the first of its free joint's six degrees of freedom, -1 for a link of a
    tree; mass [kg]; inertia (3,) [kg m^2], principal; origin (3,) [m], axes (3, 3): pose
    of the body frame in the inertial frame; hulls: for each its row among the wrenches of
    buoyancy and its Drag, None for a hull that has none, in the inertial frame.
    """

    body: int
    root: int
    dof: int
    mass: float
    inertia: Array
    origin: Array
    axes: Array
    hulls: Sequence[tuple[int, Drag | None]]


class Resistance:
    """Bodies with drag or added mass in one sea, computed in one call."""

    def __init__(self, bodies: Sequence[ResistedBody]) -> None:
        hulls = [(row, drag, body) for body in bodies for row, drag in body.hulls if drag]
        sea = hulls[0][1].sea
        if any(drag.sea is not sea for _, drag, _ in hulls):
            raise ValueError("these hulls float in one sea; take those of each sea by themselves")
        rows = [_hull_row(i, *hull) for i, hull in enumerate(hulls)]
        surfaces = np.concatenate([drag.surface for _, drag, _ in hulls])
        self._block = packed(
            _body_table(bodies), np.array(rows, HULL), surfaces, sea.components, sea.water
        )
        self._count = len(bodies)

    def add_resistance(
        self,
        positions: Array,
        rotations: Array,
        velocities: Array,
        references: Array,
        gravity: Array,
        applied: Array,
        passive: Array,
        timestep: float,
        time: float,
        buoyancy: Array,
        wrenches: Array,
    ) -> Array:
        """Turn the buoyancy in the bodies' rows of wrenches (., 6) into the whole wrench of the
        water: such that a free body accelerates as the linearly implicit step says. Returns the
        drag as such, without added mass: (B, 6) in the order of the bodies. Both [N, N m], about
        the centres of mass, world axes.

        positions (., 3) [m], rotations (., 9): inertial frames of all bodies; velocities (., 6):
        angular, then linear at the body's reference point, references (., 3) [m]; gravity (3,);
        applied, passive: forces along all degrees of freedom known before the step, those
        of a free joint being a force in world axes and a torque in the joint's own; timestep,
        time [s]; buoyancy (., 6): the wrenches of all hulls.
        """
        drags = np.empty((self._count, 6))
        implicit_wrenches(
            self._block, positions, rotations, velocities, references, gravity, applied, passive,
            timestep, time, buoyancy, wrenches, drags,
        )  # fmt: skip
        return drags


def _body_table(bodies: Sequence[ResistedBody]) -> NDArray[np.void]:
    rows, first = [], 0
    for b in bodies:
        end = first + sum(drag is not None for _, drag in b.hulls)
        rows.append((b.body, b.root, b.dof, first, end, b.mass, b.inertia, b.origin, b.axes))
        first = end
    return np.array(rows, BODY)


def _hull_row(surface: int, row: int, drag: Drag, body: ResistedBody) -> tuple[Any, ...]:
    sea, hull = drag.sea, drag.hull
    submerged = sum(other.hull.volume for _, other in body.hulls if other is not None)
    whole = sea.density * sea.gravity * hull.volume
    rate = drag.coefficients.angular * hull.volume / submerged
    has_added_mass = drag.added_mass is not None
    added_mass = drag.added_mass if has_added_mass else np.zeros((6, 6))
    return (
        row, surface, drag.has_surface_drag, has_added_mass, drag.strength[0],
        whole, rate, hull.centroid, added_mass,
    )  # fmt: skip


@kernel
def into_body(rotation, world, body):
    """Add the two vectors of world (6,), in world axes, to those of body (6,), in body axes."""
    for i in range(3):
        for j in range(3):
            body[i] += rotation[j, i] * world[j]
            body[3 + i] += rotation[j, i] * world[3 + j]


@kernel
def into_world(rotation, body, world):
    """Add the two vectors of body (6,), in body axes, to those of world (6,), in world axes."""
    for i in range(3):
        for j in range(3):
            world[i] += rotation[i, j] * body[j]
            world[3 + i] += rotation[i, j] * body[3 + j]


@kernel
def body_velocity(position, rotation, spatial, reference, velocity):
    """Velocity of the centre of mass and angular velocity into velocity (6,), body axes, from
    spatial (6,): angular, then linear at the reference point, world axes."""
    wx, wy, wz = spatial[0], spatial[1], spatial[2]
    x, y, z = position[0] - reference[0], position[1] - reference[1], position[2] - reference[2]
    vx, vy, vz = cross(wx, wy, wz, x, y, z)
    vx, vy, vz = vx + spatial[3], vy + spatial[4], vz + spatial[5]
    for i in range(3):
        velocity[i] = rotation[0, i] * vx + rotation[1, i] * vy + rotation[2, i] * vz
        velocity[3 + i] = rotation[0, i] * wx + rotation[1, i] * wy + rotation[2, i] * wz


@kernel
def known_wrench(inertial, rotation, velocity, gravity, applied, passive, dof, known):
    """Wrench of gravity and of the generalised forces on the free joint at dof, less the bias
    omega x I omega, into known (6,), in body axes. The joint takes a force at its own origin in
    world axes and a torque in its own."""
    known[:] = 0.0
    for i in range(3):
        for j in range(3):
            known[i] += rotation[j, i] * (applied[dof + j] + passive[dof + j])
            torque = applied[dof + 3 + j] + passive[dof + 3 + j]
            known[3 + i] += inertial.axes[i, j] * torque
    mx, my, mz = cross(
        inertial.origin[0], inertial.origin[1], inertial.origin[2], known[0], known[1], known[2]
    )
    wx, wy, wz = velocity[3], velocity[4], velocity[5]
    a, b, c = inertial.inertia[0], inertial.inertia[1], inertial.inertia[2]
    bx, by, bz = cross(wx, wy, wz, a * wx, b * wy, c * wz)
    known[3] += mx - bx
    known[4] += my - by
    known[5] += mz - bz
    for i in range(3):
        for j in range(3):
            known[i] += inertial.mass * rotation[j, i] * gravity[j]


@kernel
def add_angular(rate, timestep, inertial, velocity, drag, matrix):
    """Add the decay of the angular momentum at a rate [1/s]."""
    for i in range(3):
        damping = rate * inertial.inertia[i]
        drag[3 + i] -= damping * velocity[3 + i]
        matrix[3 + i, 3 + i] += timestep * damping


@kernel
def add_added_mass(fraction, added, rotation, velocity, motion, fluid, matrix):
    """Add a hull's added mass (6, 6), times the submerged fraction, to the matrix, and to
    fluid what does not depend on the body's acceleration: the water's own, and Kirchhoff's terms.
    motion (6,): velocity and acceleration of the water at its centroid, world axes."""
    u, turning, momentum = velocity.copy(), np.zeros(3), np.zeros(6)
    for i in range(3):
        for j in range(3):
            u[i] -= rotation[j, i] * motion[j]
            turning[i] += rotation[j, i] * motion[3 + j]
    ux, uy, uz = cross(u[3], u[4], u[5], u[0], u[1], u[2])
    turning[0] += ux
    turning[1] += uy
    turning[2] += uz
    for i in range(6):
        for j in range(6):
            a = fraction * added[i, j]
            matrix[i, j] += a
            momentum[i] += a * u[j]
            if j < 3:
                fluid[i] += a * turning[j]
    p, m = momentum[:3], momentum[3:]
    fx, fy, fz = cross(u[3], u[4], u[5], p[0], p[1], p[2])
    tx, ty, tz = cross(u[3], u[4], u[5], m[0], m[1], m[2])
    mx, my, mz = cross(u[0], u[1], u[2], p[0], p[1], p[2])
    fluid[0] -= fx
    fluid[1] -= fy
    fluid[2] -= fz
    fluid[3] -= tx + mx
    fluid[4] -= ty + my
    fluid[5] -= tz + mz


@kernel
def solve_symmetric(matrix, vector):
    """Solve a symmetric positive definite system (6, 6) by Cholesky's method, in place; of the
    matrix the lower triangle is read. The factor's diagonal is kept as its reciprocals. (Our own,
    because a call of LAPACK costs more than all of this.)"""
    for j in range(6):
        square = matrix[j, j]
        for k in range(j):
            square -= matrix[j, k] * matrix[j, k]
        inverse = 1.0 / np.sqrt(square)
        matrix[j, j] = inverse
        for i in range(j + 1, 6):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = rest * inverse
    for i in range(6):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] *= matrix[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] *= matrix[i, i]


@kernel
def accelerate(inertial, rest, fluid, matrix):
    """What to hand over as `fluid`, overwritten, so that the body accelerates as the linearly
    implicit step says; all (6,) in body axes.

    rest: the other forces, gravity and bias included; fluid: buoyancy, drag and what the added
    mass adds to them; matrix (6, 6): A + h C, overwritten.
    """
    acceleration = fluid + rest
    for i in range(3):
        matrix[i, i] += inertial.mass
        matrix[3 + i, 3 + i] += inertial.inertia[i]
    solve_symmetric(matrix, acceleration)
    for i in range(3):
        fluid[i] = inertial.mass * acceleration[i] - rest[i]
        fluid[3 + i] = inertial.inertia[i] * acceleration[3 + i] - rest[3 + i]


@kernel
def add_hull(
    hull, surfaces, inertial, waves, water, position, rotation, velocity,
    timestep, time, push, drag, fluid, matrix,
):  # fmt: skip
    """Add what a hull meets, all in body axes: its drag (6,), the wrench (6,) that comes with its
    added mass to fluid, and A + h C to the lower triangle of matrix. push [N]: its buoyancy."""
    fraction = min(push / hull.whole, 1.0)
    turn = rotation.reshape(3, 3)
    if hull.has_drag:
        add_hull_drag(
            surfaces[hull.surface], hull.strength, waves, water, position, rotation, velocity,
            time, timestep, drag, matrix,
        )  # fmt: skip
    if hull.rate > 0.0:
        add_angular(fraction * hull.rate, timestep, inertial, velocity, drag, matrix)
    if hull.has_added_mass:
        point, motion = position.copy(), np.empty(6)
        for i in range(3):
            for j in range(3):
                point[i] += turn[i, j] * hull.centroid[j]
        water_motion(point, waves, water, time, motion)
        add_added_mass(fraction, hull.added_mass, turn, velocity, motion, fluid, matrix)


@kernel
def is_wet(body, hulls, buoyancy):
    """Whether the water pushes any of a body's hulls with drag or added mass up."""
    wet = False
    for h in range(body.first, body.end):
        wet |= buoyancy[hulls[h].row, 2] > 0.0
    return wet


@kernel
def implicit_wrenches(
    block, positions, rotations, velocities, references, gravity, applied, passive,
    timestep, time, buoyancy, wrenches, drags_out,
):  # fmt: skip
    """See Resistance.add_resistance; the drag of the bodies into drags_out (B, 6)."""
    bodies, hulls, surfaces = table(block, 0, BODY), table(block, 1, HULL), table(block, 2, SURFACE)
    waves, water = table(block, 3, WAVE), table(block, 4, WATER)
    velocity, matrix = np.empty(6), np.empty((6, 6))
    drags_out[:] = 0.0
    for b in range(bodies.size):
        inertial = bodies[b]
        if not is_wet(inertial, hulls, buoyancy):
            continue
        body, dof = inertial.body, inertial.dof
        position, rotation = positions[body], rotations[body]
        turn, reference = rotation.reshape(3, 3), references[inertial.root]
        body_velocity(position, turn, velocities[body], reference, velocity)
        drag, fluid, rest = np.zeros(6), np.zeros(6), np.zeros(6)
        matrix[:] = 0.0
        for h in range(inertial.first, inertial.end):
            push = buoyancy[hulls[h].row, 2]
            if push > 0.0:
                add_hull(
                    hulls[h], surfaces, inertial, waves, water, position, rotation, velocity,
                    timestep, time, push, drag, fluid, matrix,
                )  # fmt: skip
        into_world(turn, drag, drags_out[b])
        fluid += drag
        if dof >= 0:
            into_body(turn, wrenches[body], fluid)
            wrenches[body] = 0.0
            known_wrench(inertial, turn, velocity, gravity, applied, passive, dof, rest)
        accelerate(inertial, rest, fluid, matrix)
        into_world(turn, fluid, wrenches[body])
