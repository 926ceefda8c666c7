"""Drag: the force of moving water on a hull, besides buoyancy.

The hull's surface is gathered once into about a hundred flat elements of area A, outward normal n
and radius r. Let u be the velocity of an element relative to the orbital motion of the water there,
u_n = u . n, u_t = u - u_n n, and w the wet share of the element. The drag is

    F = - density w A [ (c_l sqrt(g L) u_n + c_f |u_n| u_n / 4) n  +  c_t |u_t| u_t / 2 ],

where L is the cube root of the hull's volume. c_l decays with the depth d of the element as e^(-2 d
/ L), because waves are made near the surface. The three coefficients are dimensionless:

    linear    c_l   waves made by the motion: at low speed it damps bobbing
    form      c_f   eddies behind edges; half of it acts on the front and half on the rear, so that
                    it is the drag coefficient of a cube moving along an edge; a sphere has c_f / 2
    friction  c_t   along the skin

A cheap alternative is a uniform rate [1/s] at which the angular momentum I omega decays (of a fully
submerged body). Every term opposes u, so drag never does work on the motion relative to the water.

Drag may be strong and bodies light. `reaction` keeps the time integration stable in that case.
`elements` gathers the surface, and `probes` has the motion of the water there.

Sources: Morison et al. 1950 and Faltinsen 1990 for the splitting into terms; Newman 1977 for the
wave damping; Kerner 2015 (Water interaction model for boats in video games) for drag summed over a
hull's facets.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import cross
from sim.hulls.hull import Hull
from sim.kernels import inline, kernel, read_only, record, scratch_zeros, summing_kernel, workspace
from sim.precision import real, reals
from sim.resistance.added_mass import added_mass_matrix, damping_matrix, gripped_axes, wet_reach
from sim.resistance.elements import (
    ELEMENTS,
    ROW,
    Pose,
    enclosed_volume,
    nine,
    surface_elements,
    upwards,
)
from sim.resistance.probes import (
    QUANTITIES,
    Flow,
    label_steps,
    probe_hull,
    probes_of,
    spread_velocities,
)
from sim.water.gerstner import decay, level_and_rise
from sim.water.head import depth
from sim.water.motion import MOTION
from sim.water.sea import Sea

Array = NDArray[np.float64]
Table = NDArray[np.void]

MOST_SHARED = 16
"""Largest number of hulls whose tables are kept for further geoms with the same hull. They keep
the hulls in memory."""

STRENGTH = record(
    linear="real", form="real", friction="real", fade="real", area="real", volume=("real", 9),
    residual="f8", steps="i8",
)  # fmt: skip
"""The constants of a hull's drag.

linear, form, friction: density times coefficients, the factors of u_n, |u_n| u_n and |u_t| u_t;
fade [1/m]: decay of the first with depth; area [m^2] of all elements; volume [m^3] that they
enclose, as a symmetric (3, 3) matrix, see `enclosed_volume`; steps: number of Newton steps to the
labels; residual [m]: the largest allowed before the last of these steps.
"""

WORK = record(
    height=ROW, depth=ROW, wet=ROW, sunk=ROW, u_x=ROW, u_y=ROW, u_z=ROW,
    force_x=ROW, force_y=ROW, force_z=ROW, xx=ROW, yx=ROW, yy=ROW, zx=ROW, zy=ROW, zz=ROW,
)  # fmt: skip
"""Workspace of the elements.

height [m]: of the water above the level; depth [m], 0 above the surface; wet [m^2]: wet areas; sunk
[m]: means of the depth over the elements, with dry shares counted as 0. In the hull's axes: u_x,
u_y, u_z: velocities [m/s] relative to the water; force_x, force_y, force_z [N]; and the lower
triangle, xx to zz, of - dF/du, a symmetric matrix.
"""


@dataclass(frozen=True)
class DragCoefficients:
    """Strengths of drag, 0 or more.

    linear, form, friction: dimensionless, see the module; angular [1/s]: the rate at which the
    angular momentum of the submerged body decays. Raises ValueError for invalid numbers.
    """

    linear: float = 0.0
    form: float = 0.0
    friction: float = 0.0
    angular: float = 0.0

    def __post_init__(self) -> None:
        for coefficient in fields(self):
            value = getattr(self, coefficient.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(
                    f"the {coefficient.name} drag coefficient is {value:g}; it must be finite and "
                    "0 or more (below 0 drag would drive the body)"
                )


@lru_cache(maxsize=MOST_SHARED)
def _shared_tables(hull: Hull, sea: Sea) -> tuple[Table, Table, Table]:
    """SURFACE, PROBE rows and STRENGTH of a hull in a sea, the last without coefficients. Geoms
    with the same hull share the tables, so a step finds them in the processor's cache."""
    surface = surface_elements(hull)
    steps, residual = label_steps(sea, float(np.linalg.norm(hull.bounds[1] - hull.bounds[0])))
    fade, area = 2.0 / np.cbrt(hull.volume), surface["area"].sum()
    volume = enclosed_volume(surface).ravel()
    strength = np.array([(0.0, 0.0, 0.0, fade, area, volume, residual, steps)], STRENGTH)
    return surface, probes_of(surface, strength, sea), strength


class Drag:
    """Drag of one hull in a sea, and its added mass (see `added_mass`).

    coefficients: strengths of drag; added_mass: None, six coefficients or a (6, 6) matrix (see
    `added_mass_matrix`); damping, damping_quadratic: None, six numbers or a (6, 6) matrix, of the
    submerged hull (see `damping_matrix`), the first in its frame, the second in a frame to whose
    motions `frame` (6, 6) takes those of the hull's. follows: whether the added mass moves with the
    centroid of the wet part. Raises ValueError for invalid numbers.

    surface, strength, probes: the hull's SURFACE, STRENGTH and PROBE rows; has_surface_drag:
    whether any coefficient of the elements' drag is above 0; grip (3, 3): see `gripped_axes`, 0
    without `follows`; reach (3, 3) [m]: see `wet_reach`.
    """

    def __init__(
        self,
        hull: Hull,
        sea: Sea,
        coefficients: DragCoefficients = DragCoefficients(),
        added_mass: ArrayLike | None = None,
        damping: ArrayLike | None = None,
        damping_quadratic: ArrayLike | None = None,
        frame: ArrayLike | None = None,
        follows: bool = False,
    ) -> None:
        self.hull = hull
        self.sea = sea
        self.coefficients = c = coefficients
        self.added_mass = self.damping = self.damping_quadratic = None
        self.frame = np.eye(6) if frame is None else np.asarray(frame, dtype=float)
        if added_mass is not None:
            self.added_mass = added_mass_matrix(hull, sea.density, added_mass)
        if damping is not None:
            self.damping = damping_matrix(damping)
        if damping_quadratic is not None:
            self.damping_quadratic = damping_matrix(damping_quadratic)
        self.grip = gripped_axes(hull) if follows else np.zeros((3, 3))
        self.reach = wet_reach(hull)
        speed = np.sqrt(sea.gravity * np.cbrt(hull.volume))
        pressures = sea.density * np.array([c.linear * speed, 0.25 * c.form, 0.5 * c.friction])
        self.has_surface_drag = bool(pressures.any())
        self.surface, self.probes, strength = _shared_tables(hull, sea)
        strength = strength.copy()
        strength["linear"], strength["form"], strength["friction"] = pressures
        self.strength = read_only(strength)

    def wrench(
        self, position: ArrayLike, rotation: ArrayLike, velocity: ArrayLike, time: float
    ) -> Array:
        """Surface drag (6,) [N, N m] about the position, in world axes. The damping matrix, the
        decay of the angular momentum and the added mass are not included.

        position (3,) [m], rotation (3, 3) or (9,): pose of the hull frame; velocity (6,) [m/s,
        rad/s]: linear velocity of its origin, then angular velocity, in world axes; time [s].
        """
        rotation = np.ascontiguousarray(rotation, dtype=float).reshape(9)
        turn = np.kron(np.eye(2), rotation.reshape(3, 3))
        position = np.ascontiguousarray(position, dtype=float)
        velocity, drag = turn.T @ np.asarray(velocity, dtype=float), np.zeros(6)
        if self.has_surface_drag:
            sea = self.sea
            flow = Flow(sea.components, sea.water, float(time))
            write_drag(
                self.surface, self.strength, self.probes, flow, position, rotation, velocity, drag
            )
        return turn @ drag


@summing_kernel
def wet_areas(surface, level, pose, work):
    """Depths and wet areas of the elements, from the heights of the water above the level [m].
    Return the sum of the wet areas."""
    s, e, total, above = surface, work[0], 0.0, real(pose.position[2] - level)
    ux, uy, uz = upwards(pose.rotation)
    for i in range(ELEMENTS):
        below = depth(e.height[i], above + ux * s.x[i] + uy * s.y[i] + uz * s.z[i])
        # the wet share rises gradually over the element's size, so that no force jumps
        share = min(max(0.5 + 0.5 * below / s.radius[i], 0.0), 1.0)
        e.wet[i] = share * s.area[i]
        e.depth[i] = max(below, 0.0)
        e.sunk[i] = below if share == 1.0 else s.radius[i] * share * share
        total += e.wet[i]
    return total


@inline
def along(matrix, x, y, z):
    """A matrix (9,) times a vector."""
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[3] * x + matrix[4] * y + matrix[5] * z,
        matrix[6] * x + matrix[7] * y + matrix[8] * z,
    )


@summing_kernel
def submerged_fraction(surface, volume, rotation, work):
    """The share of the hull below the surface: the integral of the depth over the elements' area
    vectors, divided by its value for the fully submerged hull."""
    s, e, sunk = surface, work[0], 0.0
    x, y, z = upwards(rotation)
    for i in range(ELEMENTS):
        up = x * s.normal_x[i] + y * s.normal_y[i] + z * s.normal_z[i]
        sunk -= up * s.flat[i] * e.sunk[i]
    vx, vy, vz = along(volume, x, y, z)
    return min(max(sunk / (x * vx + y * vy + z * vz), 0.0), 1.0)


@summing_kernel
def submersion_rate(surface, volume, fraction, rotation, velocity, work):
    """Time derivative [1/s] of the submerged fraction, from the velocity (6,) of the hull in its
    own axes and the velocities of the elements relative to the water."""
    s, e, rate = surface, work[0], 0.0
    x, y, z = upwards(rotation)
    wx, wy, wz = real(velocity[3]), real(velocity[4]), real(velocity[5])
    tx, ty, tz = cross(x, y, z, wx, wy, wz)  # the vertical's rate
    for i in range(ELEMENTS):
        nx, ny, nz = s.normal_x[i], s.normal_y[i], s.normal_z[i]
        up, turning = x * nx + y * ny + z * nz, tx * nx + ty * ny + tz * nz
        rising = x * e.u_x[i] + y * e.u_y[i] + z * e.u_z[i]
        wet = e.wet[i] / max(s.area[i], 1e-300)
        rate += s.flat[i] * (up * wet * rising - turning * e.sunk[i])
    vx, vy, vz = along(volume, x, y, z)
    rate -= 2.0 * fraction * (tx * vx + ty * vy + tz * vz)
    return rate / (x * vx + y * vy + z * vz)


@kernel
def relative_velocities(surface, rotation, velocity, motion, work):
    """Velocities of the elements relative to the water, in the hull's axes. velocity: (6,), of the
    hull in its own axes; motion: the water's velocities, a MOTION in world axes."""
    s, e, water = surface, work[0], motion[0]
    vx, vy, vz = real(velocity[0]), real(velocity[1]), real(velocity[2])
    wx, wy, wz = real(velocity[3]), real(velocity[4]), real(velocity[5])
    ax, ay, az, bx, by, bz, cx, cy, cz = nine(rotation)
    for i in range(ELEMENTS):
        sx, sy, sz = water.x[i], water.y[i], water.z[i]
        x, y, z = cross(wx, wy, wz, s.x[i], s.y[i], s.z[i])
        e.u_x[i] = vx + x - (ax * sx + bx * sy + cx * sz)
        e.u_y[i] = vy + y - (ay * sx + by * sy + cy * sz)
        e.u_z[i] = vz + z - (az * sx + bz * sy + cz * sz)


@kernel
def element_forces(surface, strength, work):
    """Forces of the elements and their derivatives, from their velocities: with the unit normal n
    and the tangential velocity t, - dF/du = across n n^T + along t t^T + rub 1."""
    s, e = surface, work[0]
    form, friction, fade = strength.form, strength.friction, strength.fade
    for i in range(ELEMENTS):
        ux, uy, uz = e.u_x[i], e.u_y[i], e.u_z[i]
        linear = strength.linear * decay(fade * e.depth[i])
        nx, ny, nz = s.normal_x[i], s.normal_y[i], s.normal_z[i]
        speed = ux * nx + uy * ny + uz * nz
        tx, ty, tz = ux - speed * nx, uy - speed * ny, uz - speed * nz
        skin_speed = np.sqrt(tx * tx + ty * ty + tz * tz)
        area = e.wet[i]
        push = area * (linear + form * abs(speed)) * speed
        rub = area * friction * skin_speed
        e.force_x[i] = -push * nx - rub * tx
        e.force_y[i] = -push * ny - rub * ty
        e.force_z[i] = -push * nz - rub * tz
        across = area * (linear + 2.0 * form * abs(speed)) - rub
        along = area * friction / skin_speed if skin_speed > 0.0 else 0.0
        wx, wy, wz, vx, vy, vz = (
            across * nx, across * ny, across * nz, along * tx, along * ty, along * tz
        )  # fmt: skip
        e.xx[i], e.yx[i] = wx * nx + vx * tx + rub, wy * nx + vy * tx
        e.yy[i], e.zx[i] = wy * ny + vy * ty + rub, wz * nx + vz * tx
        e.zy[i], e.zz[i] = wz * ny + vz * ty, wz * nz + vz * tz + rub


@summing_kernel
def add_forces(surface, work, wrench_out):
    """Add the elements' forces and torques to a wrench (6,)."""
    s, e = surface, work[0]
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(ELEMENTS):
        x, y, z = e.force_x[i], e.force_y[i], e.force_z[i]
        px, py, pz = s.x[i], s.y[i], s.z[i]
        fx, fy, fz = fx + x, fy + y, fz + z
        tx, ty, tz = tx + (py * z - pz * y), ty + (pz * x - px * z), tz + (px * y - py * x)
    wrench_out[0] += fx
    wrench_out[1] += fy
    wrench_out[2] += fz
    wrench_out[3] += tx
    wrench_out[4] += ty
    wrench_out[5] += tz


@summing_kernel
def add_damping(surface, work, factor, damping_out):
    """Add factor * - d wrench / d velocity to the lower triangle of damping (6, 6): the sum of B^T
    (- dF/du) B, where B takes a hull's velocity (6,) to that of an element's point."""
    s, e = surface, work[0]
    aa, ba, bb, ca, cb, cc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    da, db, dc, dd, ea, eb, ec, ed, ee = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fa, fb, fc, fd, fe, ff = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(ELEMENTS):
        x, y, z = s.x[i], s.y[i], s.z[i]
        xx, yx, yy, zx, zy, zz = e.xx[i], e.yx[i], e.yy[i], e.zx[i], e.zy[i], e.zz[i]
        xa, ya, za = y * zx - z * yx, z * xx - x * zx, x * yx - y * xx  # point x columns
        xb, yb, zb = y * zy - z * yy, z * yx - x * zy, x * yy - y * yx
        xc, yc, zc = y * zz - z * zy, z * zx - x * zz, x * zy - y * zx
        aa, ba, bb, ca, cb, cc = aa + xx, ba + yx, bb + yy, ca + zx, cb + zy, cc + zz
        da, db, dc, ea, eb, ec = da + xa, db + xb, dc + xc, ea + ya, eb + yb, ec + yc
        fa, fb, fc, dd = fa + za, fb + zb, fc + zc, dd + (y * xc - z * xb)
        ed, ee = ed + (y * yc - z * yb), ee + (z * ya - x * yc)
        fd, fe, ff = fd + (y * zc - z * zb), fe + (z * za - x * zc), ff + (x * zb - y * za)
    sums = (
        aa, ba, bb, ca, cb, cc, da, db, dc, dd, ea, eb, ec, ed, ee, fa, fb, fc, fd, fe, ff
    )  # fmt: skip
    k = 0
    for i in range(6):
        for j in range(i + 1):
            damping_out[i, j] += factor * sums[k]
            k += 1


@kernel
def wet_elements(surface, probes, probed, level, pose, work, motion):
    """Compute the depths and wet areas of the elements, and the water's velocities
    there, a MOTION, from the water at the probes and the still level [m]. Return the sum of the wet
    areas."""
    spread_velocities(probed, probes, work[0].height[:], motion)
    return wet_areas(surface, level, pose, work)


@kernel
def add_hull_drag(surface, strength, factor, work, wrench_out, damping_out):
    """Add a hull's drag to a wrench (6,), and factor * - d wrench / d velocity to the lower
    triangle of damping (6, 6), in the hull's axes. The elements must be solved and have their
    velocities."""
    element_forces(surface, strength, work)
    add_forces(surface, work, wrench_out)
    add_damping(surface, work, factor, damping_out)


@kernel
def write_drag(surface, strength, probes, flow, position, rotation, velocity, wrench_out):
    """Compute the drag (6,) of one hull, in the axes of its frame."""
    pose, damping = Pose(position, rotation), scratch_zeros((6, 6))
    work, motion, probed = workspace(WORK), workspace(MOTION), reals((QUANTITIES, ELEMENTS))
    wrench_out[:] = 0.0
    probe_hull(surface[0], strength[0], probes, flow, pose, False, probed)
    level, _ = level_and_rise(flow.water[0], flow.time)
    if wet_elements(surface[0], probes, probed, level, pose, work, motion) > 0.0:
        relative_velocities(surface[0], rotation, velocity, motion, work)
        add_hull_drag(surface[0], strength[0], 1.0, work, wrench_out, damping)
