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
together is then conserved (no slamming). In integrators of one stage the matrix has f + h/2 df/dt
instead of f, the fraction in the middle of the step, and likewise for A: with those of the start,
and this force, a bobbing hull would gain energy. The stages of RK4 need no such term, and keep
their order.

The added mass of coefficients is at the centroid of the wet part, so A changes, too, and there is
- 1/2 f (dA/dt) nu. With L the lever arms of that centroid (`wet_levers`) and A0 the matrix of the
submerged hull,

    A = Y^T A0 Y,   Y = [1 L; 0 1],   dA/dt = Z^T A + A Z,   Z = [0 dL/dt; 0 0],

because Y^-1 dY/dt = Z. For any A(t) such a term keeps the energy.

With drag a step is of first order, also in RK4, because each of its stages takes the whole
timestep. Added mass alone does not lower the order.

Source: Newman 1977 for Kirchhoff's equations.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.geometry import cross
from sim.kernels import kernel, record, scratch, scratch_zeros, workspace
from sim.precision import reals
from sim.resistance.drag import (
    STRENGTH,
    WORK,
    Drag,
    add_hull_drag,
    relative_velocities,
    submerged_fraction,
    submersion_rate,
    wet_elements,
)
from sim.resistance.elements import ELEMENTS, SURFACE
from sim.resistance.probes import PROBE, QUANTITIES, probe_hull, spread_accelerations
from sim.resistance.rigid_fit import fit_matrix, fit_motion
from sim.water.gerstner import level_and_rise
from sim.water.motion import MOTION

Table = NDArray[np.void]

LEAST_CARRIED = 0.25
"""Least share of the submerged fraction that stays in the matrix while a hull leaves the water
quickly."""

HULL = record(
    surface="i8", first_probe="i8", end_probe="i8", has_drag="i8", has_added_mass="i8",
    has_damping="i8", has_quadratic="i8", follows="i8", strength=STRENGTH, rate="f8",
    added_mass=("f8", (6, 6)),
    damping=("f8", (6, 6)), quadratic=("f8", (6, 6)), frame=("f8", (6, 6)), grip=("f8", (3, 3)),
    reach=("f8", (3, 3)),
)  # fmt: skip
"""A hull with drag, added mass or damping.

surface: row of its elements; first_probe, end_probe: its PROBE rows; follows: whether its added
mass moves with its wet part, see `grip` and `reach` of a Drag; rate [1/s]: at which it takes
angular momentum from its body; quadratic: damping in a frame to whose motions `frame` takes those
of the hull's.
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


def hull_tables(drags: Sequence[tuple[Drag, float]]) -> tuple[Table, Table, Table]:
    """HULL, SURFACE and PROBE rows of drags, each given with the volume [m^3] of all hulls with
    drag of its body, which share the decay of angular momentum. Drags of the same hull share
    rows."""
    hulls, places = [], dict[int, tuple[int, int]]()
    surfaces, probes = [np.zeros(0, SURFACE)], [np.zeros(0, PROBE)]
    count = 0
    for drag, volume in drags:
        if id(drag.surface) not in places:
            places[id(drag.surface)] = len(places), count
            surfaces.append(drag.surface)
            probes.append(drag.probes)
            count += len(drag.probes)
        hulls.append(_hull_row(*places[id(drag.surface)], drag, volume))
    return np.array(hulls, HULL), np.concatenate(surfaces), np.concatenate(probes)


def _hull_row(surface: int, probe: int, drag: Drag, volume: float) -> tuple[object, ...]:
    """A HULL. surface: row of its elements; probe: its first PROBE row."""
    matrices = drag.added_mass, drag.damping, drag.damping_quadratic
    return (
        surface, probe, probe + len(drag.probes), drag.has_surface_drag,
        *(matrix is not None for matrix in matrices),
        drag.grip.any(), drag.strength[0], drag.coefficients.angular * drag.hull.volume / volume,
        *(np.zeros((6, 6)) if matrix is None else matrix for matrix in matrices), drag.frame,
        drag.grip, drag.reach,
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
def wet_levers(fraction, growth, hull, rotation, spin, lever_out, rate_out):
    """The matrix (3, 3) [m] from a rotation of the hull to the velocity that it adds where the
    added mass is, beyond that at the hull's centroid, and its time derivative [m/s].

    The added mass is at the centroid of the wet part (`wet_reach`), but its lever arms about axes
    about which the hull is round are left out (`gripped_axes`). spin (3,): angular velocity.
    """
    x, y, z = rotation[6], rotation[7], rotation[8]
    tx, ty, tz = cross(x, y, z, spin[0], spin[1], spin[2])  # the vertical's rate
    shift, change = scratch(3), scratch(3)
    for i in range(3):
        a, b, c = hull.reach[i, 0], hull.reach[i, 1], hull.reach[i, 2]
        reach = a * x + b * y + c * z
        shift[i] = (1.0 - fraction) * reach
        change[i] = (1.0 - fraction) * (a * tx + b * ty + c * tz) - growth * reach
    for j in range(3):
        x, y, z = hull.grip[0, j], hull.grip[1, j], hull.grip[2, j]
        lx, ly, lz = cross(x, y, z, shift[0], shift[1], shift[2])
        rx, ry, rz = cross(x, y, z, change[0], change[1], change[2])
        lever_out[0, j], lever_out[1, j], lever_out[2, j] = lx, ly, lz
        rate_out[0, j], rate_out[1, j], rate_out[2, j] = rx, ry, rz


@kernel
def shift_matrix(lever, matrix):
    """Replace a matrix (6, 6) by Y^T matrix Y with Y = [1 lever; 0 1]."""
    for i in range(6):
        for j in range(3):
            for k in range(3):
                matrix[i, 3 + j] += matrix[i, k] * lever[k, j]
    for i in range(3):
        for j in range(6):
            for k in range(3):
                matrix[3 + i, j] += lever[k, i] * matrix[k, j]


@kernel
def add_shifting(fraction, rate, matrix, velocity, wrench_out):
    """Add - f/2 (dA/dt) nu for an added mass A, a matrix (6, 6) that moves with levers, whose rate
    (3, 3) is given, and a velocity nu (6,) relative to the water."""
    slip, momentum = scratch_zeros(3), scratch_zeros(6)
    for i in range(3):
        for j in range(3):
            slip[i] += rate[i, j] * velocity[3 + j]
    for i in range(6):
        for j in range(3):
            wrench_out[i] -= 0.5 * fraction * matrix[i, j] * slip[j]
        for j in range(6):
            momentum[i] += matrix[i, j] * velocity[j]
    for i in range(3):
        for j in range(3):
            wrench_out[3 + i] -= 0.5 * fraction * rate[j, i] * momentum[j]


@kernel
def add_added_mass(fraction, growth, ahead, matrix, middle, reaction_out):
    """Add the forces of an added mass, a matrix (6, 6) of the submerged hull. growth [1/s]: rate of
    the submerged fraction; ahead [s]: time after which the inertia is taken, with the matrix that
    is then, `middle` (6, 6)."""
    r, velocity, known, momentum = reaction_out[0], scratch(6), scratch(6), scratch_zeros(6)
    for i in range(6):
        velocity[i], known[i] = r.velocity[i] - r.water[i], r.pull[i] - r.bias[i]
    subtract_turning(r.velocity, r.water, known)
    carried = max(fraction + ahead * growth, LEAST_CARRIED * fraction)
    for i in range(6):
        for j in range(6):
            a = matrix[i, j]
            r.matrix[i, j] += carried * middle[i, j]
            momentum[i] += fraction * a * velocity[j]
            r.inertia[i] += a * (fraction * known[j] - 0.5 * growth * velocity[j])
    add_momentum(velocity[:3], r.velocity[3:], momentum, r.inertia)


@kernel
def add_wet_added_mass(fraction, growth, ahead, hull, rotation, reaction_out):
    """Add the forces of an added mass that moves with the centroid of the wet part."""
    r, now, middle = reaction_out[0], scratch((6, 6)), scratch((6, 6))
    for i in range(6):
        for j in range(6):
            now[i, j], middle[i, j] = hull.added_mass[i, j], hull.added_mass[i, j]
    lever, rate, velocity = scratch((3, 3)), scratch((3, 3)), scratch(6)
    wet_levers(fraction, growth, hull, rotation, r.velocity[3:], lever, rate)
    shift_matrix(lever, now)
    for i in range(3):
        for j in range(3):
            lever[i, j] += ahead * rate[i, j]
    shift_matrix(lever, middle)
    for i in range(6):
        velocity[i] = r.velocity[i] - r.water[i]
    add_added_mass(fraction, growth, ahead, now, middle, reaction_out)
    add_shifting(fraction, rate, now, velocity, r.inertia[:])


@kernel
def add_matrix_damping(fraction, factor, hull, reaction_out):
    """Add the damping by a matrix, from the hull's velocity relative to the water."""
    r = reaction_out[0]
    for i in range(6):
        for j in range(6):
            r.drag[i] -= fraction * hull.damping[i, j] * (r.velocity[j] - r.water[j])
            r.matrix[i, j] += factor * fraction * hull.damping[i, j]


@kernel
def add_quadratic_damping(fraction, factor, hull, reaction_out):
    """Add the quadratic damping, from the hull's velocity relative to the water, in the frame of
    its matrix D: a force - R D R nu there, with R the square roots of |nu|."""
    r, roots, pushes = reaction_out[0], scratch((6, 6)), scratch_zeros(6)
    for i in range(6):
        speed = 0.0
        for j in range(6):
            speed += hull.frame[i, j] * (r.velocity[j] - r.water[j])
        root = np.sqrt(abs(speed))
        for j in range(6):
            roots[i, j] = root * hull.frame[i, j]  # R times the frame
            pushes[j] += hull.quadratic[j, i] * root * speed
    for k in range(6):
        for j in range(6):
            r.drag[k] -= fraction * roots[j, k] * pushes[j]
            braked = 0.0
            for i in range(6):
                braked += hull.quadratic[j, i] * roots[i, k]
            for i in range(6):
                r.matrix[i, k] += 2.0 * factor * fraction * roots[j, i] * braked


@kernel
def hull_reaction(hull, surfaces, probes, flow, pose, factor, ahead, reaction_out):
    """Compute a hull's reaction in a flow. See `reaction_in`."""
    surface, own = surfaces[hull.surface], probes[hull.first_probe : hull.end_probe]
    probed = reals((QUANTITIES, ELEMENTS))
    probe_hull(surface, hull.strength, own, flow, pose, hull.has_added_mass != 0, probed)
    level, _ = level_and_rise(flow.water[0], flow.time)
    return reaction_in(probed, own, level, hull, surface, pose, factor, ahead, reaction_out)


@kernel
def reaction_in(probed, probes, level, hull, surface, pose, factor, ahead, reaction_out):
    """Compute a hull's reaction, without the decay of angular momentum, for the motion given in the
    REACTION. Everything is in the hull's axes about its origin.

    probed (QUANTITIES, ELEMENTS): the water at its PROBE rows; level: the still level [m]; factor:
    multiplies the damping in the matrix; ahead: see `add_added_mass`. Return the submerged
    fraction; 1 for a wet hull if nothing depends on it.
    """
    r, strength = reaction_out[0], hull.strength
    r.drag[:], r.inertia[:], r.matrix[:] = 0.0, 0.0, 0.0
    work, motion = workspace(WORK), workspace(MOTION)
    area = wet_elements(surface, probes, probed, level, pose, work, motion)
    if area == 0.0:
        return 0.0
    relative_velocities(surface, pose.rotation, r.velocity, motion, work)
    if hull.has_drag:
        add_hull_drag(surface, strength, factor, work, r.drag[:], r.matrix[:])
    has_matrix = hull.has_added_mass or hull.has_damping or hull.has_quadratic
    fraction, growth = 1.0, 0.0
    if (has_matrix or hull.rate > 0.0) and area < (1.0 - 1e-12) * strength.area:
        fraction = submerged_fraction(surface, strength.volume, pose.rotation, work)
        if hull.has_added_mass:
            growth = submersion_rate(
                surface, strength.volume, fraction, pose.rotation, r.velocity, work
            )
    if has_matrix:
        lower = scratch((6, 6))
        fit_matrix(surface, work, lower)
        fit_motion(surface, pose.rotation, work, lower, motion, r.water)
        if hull.has_added_mass:
            spread_accelerations(probed, probes, motion)
            fit_motion(surface, pose.rotation, work, lower, motion, r.pull)
            if hull.follows and fraction < 1.0:
                add_wet_added_mass(fraction, growth, ahead, hull, pose.rotation, reaction_out)
            else:
                matrix = hull.added_mass[:]
                add_added_mass(fraction, growth, ahead, matrix, matrix, reaction_out)
        if hull.has_damping:
            add_matrix_damping(fraction, factor, hull, reaction_out)
        if hull.has_quadratic:
            add_quadratic_damping(fraction, factor, hull, reaction_out)
    return fraction
