"""Reaction: the forces on a moving hull besides buoyancy, as a wrench and a matrix of inertia.

Added mass is the water that a hull accelerates with itself: a 6 x 6 matrix A times the submerged
fraction f. Kirchhoff's equations hold in axes that rotate with the hull at Omega. With nu = (u,
omega) relative to the water, whose velocity as a rigid body is g and whose acceleration is a
(`rigid_fit`),

    F_added = - f A (nu_dot - (a - Omega x g)) - (Omega x p, Omega x l + u x p),
    (p, l) = f A nu,    nu_dot the rate, in these axes, of the hull's own velocity.

nu_dot is J qacc + J_dot qvel. The first term belongs to the matrix of inertia. So does the damping:
taken explicitly in time, strong drag (see `drag`) would throw a light hull out of the water. With
(M + J^T (f A + h C) J) qacc = forces and C = - dF_drag/dv >= 0, a step is the linearly implicit
Euler method (Hairer and Wanner 1996, IV.7), which is stable with any drag at any timestep h.

Where f changes, the added force also has - 1/2 (df/dt) A nu. The hull supplies half the momentum of
the water that joins it; the other half was already there. The energy of body, water and added mass
together is then conserved (no slamming).

With drag a step is of first order, also in RK4, because each of its stages takes the whole
timestep. Added mass alone does not lower the order.

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
"""A hull with drag, added mass or damping.

surface: row of its elements; rate [1/s]: at which it takes angular momentum from its body.
"""

REACTION = record(
    drag=("f8", 6), inertia=("f8", 6), matrix=("f8", (6, 6)), velocity=("f8", 6), bias=("f8", 6),
    water=("f8", 6), pull=("f8", 6),
)  # fmt: skip
"""Workspace, in the hull's axes at its frame's origin.

drag: wrench of drag and damping; inertia: wrench of added mass without its matrix times J qacc;
matrix: lower triangle of f A + h C; velocity: of the hull, linear, then angular; bias: J_dot qvel,
the share of its rate that joint accelerations do not cause; water, pull: velocity and acceleration
of the water.
"""


def hull_row(surface: int, drag: Drag, volume: float) -> tuple[object, ...]:
    """A Drag as a HULL. surface: row of its elements; volume [m^3]: of all its body's hulls with
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
    hull's axes, which rotate at w (3,)."""
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
    """Subtract Omega x (u, omega) of the water's motion from a rate (6,). Omega, the angular part
    of the hull's velocity, rotates the axes of all arguments."""
    wx, wy, wz = velocity[3], velocity[4], velocity[5]
    for i in range(0, 6, 3):
        x, y, z = cross(wx, wy, wz, water[i], water[i + 1], water[i + 2])
        rate_out[i] -= x
        rate_out[i + 1] -= y
        rate_out[i + 2] -= z


@kernel
def add_added_mass(fraction, growth, factor, hull, reaction_out):
    """Add the forces of a hull's added mass. growth [1/s]: rate of the submerged fraction."""
    r, velocity, known, momentum = reaction_out[0], np.empty(6), np.empty(6), np.zeros(6)
    for i in range(6):
        velocity[i], known[i] = r.velocity[i] - r.water[i], r.pull[i] - r.bias[i]
    subtract_turning(r.velocity, r.water, known)
    for i in range(6):
        for j in range(6):
            a = hull.added_mass[i, j]
            # braking terms are implicit: a light body's inertia is mostly that of this water
            r.matrix[i, j] += (fraction + 0.5 * factor * max(growth, 0.0)) * a
            momentum[i] += fraction * a * velocity[j]
            r.inertia[i] += a * (fraction * known[j] - 0.5 * growth * velocity[j])
    add_momentum(velocity[:3], r.velocity[3:], momentum, r.inertia)


@kernel
def add_matrix_damping(fraction, factor, hull, reaction_out):
    """Add the damping by a matrix, from the hull's velocity relative to the water."""
    r = reaction_out[0]
    for i in range(6):
        for j in range(6):
            r.drag[i] -= fraction * hull.damping[i, j] * (r.velocity[j] - r.water[j])
            r.matrix[i, j] += factor * fraction * hull.damping[i, j]


@kernel
def hull_reaction(hull, surfaces, flow, pose, factor, reaction_out):
    """Compute a hull's reaction, without the decay of angular momentum, for the motion given in the
    REACTION. Everything is in the hull's axes about its origin. factor: multiplies the damping in
    the matrix. Return the submerged fraction."""
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
