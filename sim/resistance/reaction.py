"""Reaction: all that a moving hull meets besides buoyancy, as a wrench and a matrix of inertia.

Added mass is the water that a hull has to accelerate with itself: A, 6 x 6, times the submerged
fraction f. By Kirchhoff's equations, in axes that turn with the hull at Omega and with nu = (u,
omega) relative to the water, whose velocity is g and acceleration a as a rigid body (`rigid_fit`),

    F_added = - f A (nu_dot - (a - Omega x g)) - (Omega x p, Omega x l + u x p),
    (p, l) = f A nu,    nu_dot the rate, in these axes, of the hull's own velocity.

nu_dot is J qacc + J_dot qvel: the first term belongs to the matrix of inertia, and so does the
damping: explicit in time, strong drag (see `drag`) would throw a light hull out of the water, and
with (M + J^T (f A + h C) J) qacc = forces, C = - dF_drag/dv >= 0, a step is the linearly implicit
Euler method (Hairer and Wanner 1996, IV.7), which bears any drag at any timestep h.

- where f changes, - 1/2 (df/dt) A nu besides: of the momentum of the water that comes half is taken
  along and half was there, so body, water and added mass keep their energy together (no slamming)
- with drag a step is of first order, in RK4 too: each of its stages takes the whole timestep
  (added mass alone does not lower the order)

Source: Newman 1977 for Kirchhoff's equations.
"""

import numpy as np

from sim.geometry import cross
from sim.kernels import kernel, record
from sim.resistance.drag import (
    STRENGTH,
    WORK,
    Drag,
    add_hull_drag,
    element_motion,
    place_elements,
    relative_velocities,
    solve_elements,
    submerged_fraction,
    submersion_rate,
)
from sim.resistance.rigid_fit import fit_matrix, fit_motion
from sim.water.gerstner import LABELS
from sim.water.motion import ACCELERATION, MOTION, VELOCITY

HULL = record(
    surface="i8", has_drag="i8", has_added_mass="i8", has_damping="i8", strength=STRENGTH,
    rate="f8", added_mass=("f8", (6, 6)), damping=("f8", (6, 6)),
)  # fmt: skip
"""A hull with drag, added mass or damping: its elements, and the rate [1/s] at which it takes
angular momentum from its body."""

REACTION = record(
    drag=("f8", 6), inertia=("f8", 6), matrix=("f8", (6, 6)), velocity=("f8", 6), bias=("f8", 6),
    water=("f8", 6), pull=("f8", 6),
)  # fmt: skip
"""Workspace: wrenches of drag, and of added mass less its matrix times J qacc; the lower triangle
of the matrix of inertia with damping, f A + h C. And how the hull moves, in its own axes at its
frame's origin: its velocity and that part of its rate which is no acceleration of joints,
J_dot qvel: linear, then angular; and the water's velocity and acceleration."""


def hull_row(surface: int, drag: Drag, volume: float) -> tuple[object, ...]:
    """A Drag as a HULL, with the elements of a number; volume [m^3]: of all its body's hulls with
    drag, which share the decay of angular momentum."""
    has_added_mass = drag.added_mass is not None
    return (
        surface, drag.has_surface_drag, has_added_mass, drag.damping is not None, drag.strength[0],
        drag.coefficients.angular * drag.hull.volume / volume,
        drag.added_mass if has_added_mass else np.zeros((6, 6)),
        np.zeros((6, 6)) if drag.damping is None else drag.damping,
    )  # fmt: skip


@kernel
def add_momentum(u, w, momentum, wrench_out):
    """Add Kirchhoff's terms for a velocity u (3,) relative to the water and a momentum (6,), in the
    hull's own axes, which turn at w (3,)."""
    p, m = momentum[:3], momentum[3:]
    fx, fy, fz = cross(w[0], w[1], w[2], p[0], p[1], p[2])
    tx, ty, tz = cross(w[0], w[1], w[2], m[0], m[1], m[2])
    mx, my, mz = cross(u[0], u[1], u[2], p[0], p[1], p[2])
    wrench_out[0] -= fx
    wrench_out[1] -= fy
    wrench_out[2] -= fz
    wrench_out[3] -= tx + mx
    wrench_out[4] -= ty + my
    wrench_out[5] -= tz + mz


@kernel
def subtract_turning(velocity, water, rate_out):
    """Subtract Omega x (u, omega) of the water's motion from a rate (6,): Omega, the angular part
    of the hull's velocity, turns the axes in which all are given."""
    wx, wy, wz = velocity[3], velocity[4], velocity[5]
    for i in range(0, 6, 3):
        x, y, z = cross(wx, wy, wz, water[i], water[i + 1], water[i + 2])
        rate_out[i] -= x
        rate_out[i + 1] -= y
        rate_out[i + 2] -= z


@kernel
def add_added_mass(fraction, growth, factor, hull, reaction_out):
    """Add a hull's added mass. growth [1/s]: of the submerged fraction."""
    r, velocity, known, momentum = reaction_out[0], np.empty(6), np.empty(6), np.zeros(6)
    for i in range(6):
        velocity[i], known[i] = r.velocity[i] - r.water[i], r.pull[i] - r.bias[i]
    subtract_turning(r.velocity, r.water, known)
    for i in range(6):
        for j in range(6):
            a = hull.added_mass[i, j]
            # what brakes is taken implicitly: a light body's inertia is mostly this water's
            r.matrix[i, j] += (fraction + 0.5 * factor * max(growth, 0.0)) * a
            momentum[i] += fraction * a * velocity[j]
            r.inertia[i] += a * (fraction * known[j] - 0.5 * growth * velocity[j])
    add_momentum(velocity[:3], r.velocity[3:], momentum, r.inertia)


@kernel
def add_matrix_damping(fraction, factor, hull, reaction_out):
    """Add a hull's damping by a matrix, of its velocity relative to the water's."""
    r = reaction_out[0]
    for i in range(6):
        for j in range(6):
            r.drag[i] -= fraction * hull.damping[i, j] * (r.velocity[j] - r.water[j])
            r.matrix[i, j] += factor * fraction * hull.damping[i, j]


@kernel
def hull_reaction(hull, surfaces, flow, pose, factor, reaction_out):
    """What a hull meets, all in its own axes about its own origin, into a REACTION that has its
    motion, but for the decay of angular momentum. factor: that of the damping in the matrix.
    Returns how much of the hull is submerged."""
    r, surface, strength = reaction_out[0], surfaces[hull.surface], hull.strength
    r.drag[:], r.inertia[:], r.matrix[:] = 0.0, 0.0, 0.0
    work, labels, motion = np.empty(1, WORK), np.empty(1, LABELS), np.empty(1, MOTION)
    place_elements(surface, pose, work)
    area = solve_elements(surface, strength, flow, work, labels)
    if area == 0.0:
        return 0.0
    element_motion(VELOCITY, flow, work, labels, motion)
    relative_velocities(surface, pose.rotation, r.velocity, motion, work)
    fraction, growth = 1.0, 0.0
    if area < (1.0 - 1e-12) * strength.area:
        fraction = submerged_fraction(surface, strength.volume, pose.rotation, work)
        growth = submersion_rate(
            surface, strength.volume, fraction, pose.rotation, r.velocity, work
        )
    if hull.has_drag:
        add_hull_drag(surface, strength, factor, work, r.drag[:], r.matrix[:])
    if hull.has_added_mass or hull.has_damping:
        lower = np.empty((6, 6))
        fit_matrix(surface, work, lower)
        fit_motion(surface, pose.rotation, work, lower, motion, r.water)
        if hull.has_added_mass:
            element_motion(ACCELERATION, flow, work, labels, motion)
            fit_motion(surface, pose.rotation, work, lower, motion, r.pull)
            add_added_mass(fraction, growth, factor, hull, reaction_out)
        if hull.has_damping:
            add_matrix_damping(fraction, factor, hull, reaction_out)
    return fraction
