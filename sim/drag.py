"""Drag: what moving water does to a hull besides pushing it up, and the step that bears it.

The hull's surface is gathered once into some hundred flat elements of area A, outward normal n
and radius r. With u the velocity of an element relative to the water's own orbital motion there,
u_n = u . n, u_t = u - u_n n, and w the wet part of the element, drag is

    F = - density w A [ (c_l sqrt(g L) u_n + c_f |u_n| u_n / 4) n  +  c_t |u_t| u_t / 2 ],

L being the cube root of the hull's volume. The three coefficients are dimensionless:

    linear    c_l   waves made by the motion: at low speed it takes the energy of bobbing
    form      c_f   eddies behind edges; half of it acts on the front, half on the rear, so that
                    it is the drag coefficient of a cube moving along an edge; a sphere has c_f / 2
    friction  c_t   along the skin

and the cheap alternative, a uniform rate [1/s] at which angular momentum I omega decays
(fully submerged). Every term opposes u: it never does work on the motion relative to the water.

Added mass is the water that a hull has to accelerate with itself: A, 6 x 6, times the submerged
fraction f. By Kirchhoff's equations, in axes that turn with the body and with nu = (u, omega)
relative to the water at the hull's centroid, which itself accelerates by a_w,

    F_added = - f A (a - a_w, alpha) + f A (omega x u, 0) - (omega x p, omega x l + u x p),
    (p, l) = f A nu.

Explicit in time, strong drag and large added mass would both throw a light body out of
the water. So one small system is solved a step for the acceleration a,

    (M + A + h C) a = F_gravity + F_buoyancy + F_drag(v) - bias + ...,   C = - dF_drag/dv >= 0,

and M a - F_gravity + bias is handed over as the wrench, with which the free body
accelerates by just that (Hairer and Wanner 1996, IV.7: the linearly implicit Euler method).

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

The water's velocity below the surface is that of Gerstner's waves: a particle moves on the
circle of the surface particle above it with the radius times exp(- k depth). Label and depth
are those of the surface right above the point, which is exact at the surface and off by a
relative k a at depth, where little is left of the motion (see `tests/test_drag.py`).

Sources: Morison et al. 1950 and Faltinsen 1990 for the splitting into terms; Newman 1977 for
Kirchhoff's equations and the wave damping; Kerner 2015 (Water interaction model for boats in
video games) for drag summed over a hull's facets.
"""

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sim.gerstner import (
    AMPLITUDE,
    CHUNK,
    DIRECTION_X,
    DIRECTION_Y,
    FREQUENCY,
    HEIGHT,
    LABEL_X,
    LABEL_Y,
    OFFSET_X,
    OFFSET_Y,
    RESIDUAL,
    SCRATCH_ROWS,
    TURNS,
    TURNS_X,
    TURNS_Y,
    WAVENUMBER,
    kernel,
    sine_cosine,
    solve_chunk,
)
from sim.hull import Hull
from sim.sea import Sea
from sim.triangle import cross

Array = NDArray[np.float64]

ELEMENTS = 128
"""Surface elements a hull is gathered into; the cost of drag is proportional to it."""

LABEL_TOLERANCE = 0.01
"""Residual, in hull lengths, at which the label above an element counts as found; Newton's last
step then squares it."""

SYMMETRY = 1e-9
"""Relative round-off that a symmetric, positive semidefinite matrix given in decimals may have."""

# Rows of a chunk's scratch after its labels are found.
SPEED_X, SPEED_Y, SPEED_Z, DEPTH = OFFSET_X, OFFSET_Y, HEIGHT, RESIDUAL

# Rows of an array of elements.
POINT_X, POINT_Y, POINT_Z, NORMAL_X, NORMAL_Y, NORMAL_Z, AREA, RADIUS = range(8)


@dataclass(frozen=True)
class DragCoefficients:
    """linear, form, friction: dimensionless, see the module; angular [1/s], the rate at which
    the angular momentum of the submerged body decays. Raises ValueError for one below 0."""

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


class Drag:
    """Drag and added mass of one hull in a sea.

    coefficients: the strengths of drag; added_mass: none, six coefficients, or a (6, 6)
    matrix. Six: the first three times the mass of the displaced water along the hull frame's
    axes, the last three times its moments of inertia about them, all at the hull's centroid
    (a sphere: 0.5 0.5 0.5 0 0 0). The matrix: [kg], [kg m], [kg m^2], (translation, rotation)
    along the axes and about the origin of the hull frame, for the fully submerged hull. The
    frame must be the body's inertial frame. Raises ValueError.
    """

    def __init__(
        self,
        hull: Hull,
        sea: Sea,
        coefficients: DragCoefficients = DragCoefficients(),
        added_mass: ArrayLike | None = None,
    ) -> None:
        self.hull = hull
        self.sea = sea
        self.coefficients = coefficients
        self.added_mass = None if added_mass is None else _matrix(hull, sea.density, added_mass)
        c = coefficients
        resists = c.linear > 0.0 or c.form > 0.0 or c.friction > 0.0
        # The last element has no area: it asks for the water's motion at the centroid.
        probe = np.concatenate([hull.centroid, np.zeros(5)])[:, None]
        surface = surface_elements(hull) if resists else np.empty((8, 0))
        self._elements = np.hstack([surface, probe])
        speed = np.sqrt(sea.gravity * np.cbrt(hull.volume))
        strengths = [c.linear * speed, 0.25 * c.form, 0.5 * c.friction]
        self._pressures = sea.density * np.array(strengths)
        size = float(np.linalg.norm(hull.bounds[1] - hull.bounds[0]))
        self._tolerance = LABEL_TOLERANCE * size

    def add_drag(
        self,
        position: Array,
        rotation: Array,
        velocity: Array,
        time: float,
        wrench: Array,
        damping: Array,
        motion: Array,
    ) -> None:
        """Add drag to wrench (6,) and - d wrench / d velocity to damping (6, 6; its lower
        triangle), and leave the water's velocity and acceleration (6,) at the hull's centroid in
        motion.

        position (3,), rotation (3, 3): pose of the hull frame; velocity (6,): of its origin
        and angular, world axes, like all that comes out; time [s]. Without the angular rate.
        """
        drag_wrench(
            self._elements,
            self._pressures,
            self.sea.components,
            self._tolerance,
            self.sea.level,
            self.sea.amplitude,
            position,
            rotation,
            velocity,
            time,
            wrench,
            damping,
            motion,
        )


class BodyDrag:
    """Drag and added mass of a rigid body, hull by hull, and its linearly implicit step.

    mass [kg]; inertia: (3,) [kg m^2], principal; hulls: the Drag of each, None for a hull
    that has none, all in the body's inertial frame; free: whether nothing but the water and
    known forces moves the body.
    """

    def __init__(
        self, mass: float, inertia: Array, hulls: Sequence[Drag | None], free: bool
    ) -> None:
        self.mass = float(mass)
        self.inertia = np.array(inertia, dtype=float)
        self.hulls = tuple(hulls)
        self.free = free
        self._wholes = [
            h and h.sea.density * h.sea.gravity * h.hull.volume for h in self.hulls
        ]  # N, the buoyancy of the submerged hull
        submerged = sum(h.hull.volume for h in self.hulls if h is not None)
        self._rates = [h and h.coefficients.angular * h.hull.volume / submerged for h in self.hulls]

    def drag(
        self,
        position: Array,
        rotation: Array,
        velocity: Array,
        time: float,
        buoyancy: Iterable[Array],
    ) -> Array:
        """Drag (6,) [N, N m] about the centre of mass, world axes, without added mass.

        position (3,), rotation (3, 3): the inertial frame; velocity (6,): of the centre of mass
        and angular; time [s]; buoyancy: the wrench (6,) of each hull.
        """
        return self._evaluate(position, rotation, velocity, time, buoyancy)[0]

    def wrench(
        self,
        position: Array,
        rotation: Array,
        velocity: Array,
        time: float,
        buoyancy: Sequence[Array],
        known: Array,
        timestep: float,
    ) -> Array:
        """Wrench (6,) of the water: buoyancy, drag and added mass together, such that the body
        accelerates as the linearly implicit step says; arguments as for `drag`.

        known: (6,) the other forces, gravity included; timestep [s].
        """
        drag, damping, added, inertial = self._evaluate(
            position, rotation, velocity, time, buoyancy
        )
        fluid = drag
        if self.free:
            for wrench in (*buoyancy, inertial):
                fluid += wrench
        accelerated_wrench(
            self.mass,
            self.inertia,
            rotation,
            velocity,
            timestep,
            known,
            fluid,
            damping,
            added,
            self.free,
        )
        if not self.free:
            for wrench in buoyancy:
                fluid += wrench
        return fluid

    def _evaluate(
        self,
        position: Array,
        rotation: Array,
        velocity: Array,
        time: float,
        buoyancy: Iterable[Array],
    ) -> tuple[Array, Array, Array, Array]:
        """Drag (6,), damping (6, 6), added mass (6, 6) and the wrench (6,) that comes with it."""
        drag, inertial, motion = np.zeros(6), np.zeros(6), np.empty(6)
        damping, added = np.zeros((6, 6)), np.zeros((6, 6))
        hulls = zip(self.hulls, self._wholes, self._rates, buoyancy, strict=True)
        for hull, whole, rate, push in hulls:
            if hull is None or push[2] <= 0.0:
                continue
            fraction = min(push[2] / whole, 1.0)
            hull.add_drag(position, rotation, velocity, time, drag, damping, motion)
            if rate > 0.0:
                add_angular(rate * fraction, self.inertia, rotation, velocity, drag, damping)
            if hull.added_mass is not None:
                matrix = fraction * hull.added_mass
                add_added_mass(matrix, rotation, velocity, motion, inertial, added)
        return drag, damping, added, inertial


def _matrix(hull: Hull, density: float, added_mass: ArrayLike) -> Array:
    """Added mass (6, 6) about the origin of the hull frame, checked."""
    given = np.asarray(added_mass, dtype=float)
    if given.size not in (6, 36):
        raise ValueError(
            f"the added mass has {given.size} numbers; expected 6 coefficients or a 6 x 6 matrix"
        )
    if not np.isfinite(given).all():
        raise ValueError("the added mass has a number that is not finite")
    if given.size == 6:
        if (given < 0.0).any():
            raise ValueError(
                f"the added mass has a negative coefficient, {given.min():g}; "
                "all six must be 0 or more"
            )
        return _from_coefficients(hull, density, given.ravel())
    matrix = given.reshape(6, 6)
    largest = np.abs(matrix).max()
    asymmetry = np.abs(matrix - matrix.T).max()
    if asymmetry > SYMMETRY * largest:
        raise ValueError(
            "the added mass matrix is not symmetric: two opposite numbers differ by "
            f"{asymmetry:g}; make both their mean"
        )
    lowest = np.linalg.eigvalsh(matrix)[0]
    if lowest < -SYMMETRY * largest:
        raise ValueError(
            f"the added mass matrix has the negative eigenvalue {lowest:g}: the water would give "
            "energy to an accelerating body; it must be positive semidefinite"
        )
    return 0.5 * (matrix + matrix.T)


def _from_coefficients(hull: Hull, density: float, coefficients: Array) -> Array:
    """Coefficients of the displaced water at the hull's centroid, moved to the frame's origin."""
    a, b, c = np.moveaxis((hull.vertices - hull.centroid)[hull.faces], 1, 0)
    volumes = np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0
    # second moments of a tetrahedron with one corner at the origin
    squares = (volumes[:, None] * ((a + b + c) ** 2 + a**2 + b**2 + c**2)).sum(axis=0) / 20.0
    inertia = squares.sum() - squares
    at_centroid = density * np.diag(coefficients * np.concatenate([[hull.volume] * 3, inertia]))
    x, y, z = hull.centroid
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    move = np.eye(6)
    move[:3, 3:] = -arm  # velocity of the centroid: v + omega x arm = v - arm x omega
    return move.T @ at_centroid @ move


def surface_elements(hull: Hull, count: int = ELEMENTS) -> Array:
    """The hull's surface gathered into `count` flat elements: (8, N), hull frame; rows are point
    [m], unit normal, area [m^2] and radius [m] of the disc of that area.

    Faces larger than half an element are split, then the largest group of faces is halved across
    its widest direction, normals counting as places one hull radius from the middle, until
    there are enough groups.
    """
    corners = _split_faces(hull.vertices[hull.faces], count)
    a, b, c = np.moveaxis(corners, 1, 0)
    vectors = 0.5 * np.cross(b - a, c - a)
    areas = np.linalg.norm(vectors, axis=1)
    centres = (a + b + c) / 3.0
    radius = 0.5 * np.linalg.norm(hull.bounds[1] - hull.bounds[0])
    normals = vectors / np.maximum(areas, np.finfo(float).tiny)[:, None]
    places = np.hstack([centres / radius, normals])
    groups = [(-areas.sum(), 0, np.arange(len(areas)))]
    serial = 1
    while len(groups) < count and len(groups[0][2]) > 1:
        _, _, group = heapq.heappop(groups)
        for half in _halves(group, places, areas):
            heapq.heappush(groups, (-areas[half].sum(), serial, half))
            serial += 1
    elements = np.empty((8, len(groups)))
    for column, (_, _, group) in zip(elements.T, sorted(groups, key=lambda g: g[1]), strict=True):
        area, vector = areas[group].sum(), vectors[group].sum(axis=0)
        column[:3] = areas[group] @ centres[group] / area
        column[3:6] = vector / max(np.linalg.norm(vector), np.finfo(float).tiny)
        column[AREA], column[RADIUS] = area, np.sqrt(area / np.pi)
    return elements


def _split_faces(corners: Array, count: int) -> Array:
    """Halve triangles (F, 3, 3) across their longest edge until none is above half an element."""
    a, b, c = np.moveaxis(corners, 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)  # twice the area, but so is the sum
    limit = area.sum() / (2.0 * count)
    parts = []
    while len(corners):
        large = area > limit
        parts.append(corners[~large])
        corners, area = corners[large], area[large]
        lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        longest = lengths.argmax(axis=1)
        rows = np.arange(len(corners))
        p, q, r = (corners[rows, (longest + shift) % 3] for shift in range(3))
        middle = 0.5 * (p + q)
        corners = np.concatenate([np.stack([p, middle, r], 1), np.stack([middle, q, r], 1)])
        area = np.tile(0.5 * area, 2)
    return np.concatenate(parts)


def _halves(
    group: NDArray[np.int64], places: Array, areas: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Two parts, to both sides of a cut across the widest direction, placed so that the
    parts' own spread is least: along edges of the surface where there are any."""
    weights = areas[group] / areas[group].sum()
    spread = places[group] - weights @ places[group]
    _, directions = np.linalg.eigh((spread * weights[:, None]).T @ spread)
    along = spread @ directions[:, -1]
    order = np.argsort(along, kind="stable")
    weight = np.cumsum(weights[order])[:-1]
    moment = np.cumsum((weights * along)[order])[:-1]
    between = moment**2 / np.maximum(weight * (1.0 - weight), np.finfo(float).tiny)
    cut = int(np.argmax(between)) + 1
    return group[order[:cut]], group[order[cut:]]


@kernel
def velocity_at(spatial, reference, point):
    """Velocity (6,) of a rigid body at a point, linear then angular, from its spatial velocity:
    (6,) angular, then linear at the reference point."""
    wx, wy, wz = spatial[0], spatial[1], spatial[2]
    ax, ay, az = point[0] - reference[0], point[1] - reference[1], point[2] - reference[2]
    vx, vy, vz = cross(wx, wy, wz, ax, ay, az)
    return np.array([spatial[3] + vx, spatial[4] + vy, spatial[5] + vz, wx, wy, wz])


@kernel
def known_wrench(mass, gravity, applied, passive, origin, axes, point):
    """Wrench (6,) about a body's centre of mass, `point`, of gravity (3,) and of the generalised
    forces on its free joint, (6,) or none: force at the joint's origin in world axes, torque in
    the joint's own."""
    wrench = np.zeros(6)
    for i in range(3):
        wrench[i] = mass * gravity[i]
    if applied.size == 0:
        return wrench
    fx, fy, fz = applied[0] + passive[0], applied[1] + passive[1], applied[2] + passive[2]
    mx, my, mz = cross(origin[0] - point[0], origin[1] - point[1], origin[2] - point[2], fx, fy, fz)
    wrench[0] += fx
    wrench[1] += fy
    wrench[2] += fz
    wrench[3] += mx
    wrench[4] += my
    wrench[5] += mz
    for i in range(3):
        for j in range(3):
            wrench[3 + i] += axes[i, j] * (applied[3 + j] + passive[3 + j])
    return wrench


@njit(inline="always")
def decay(x):
    """exp(-x) for x >= 0 as (1 + y + ... + y^4/24)^-64 with y = x/64: to 5e-10 at x = 1 and 5e-5 at
    10, always falling. Without a call in it, a loop over it vectorises."""
    y = x / 64.0
    power = 1.0 / (1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y / 24.0))))
    power *= power
    power *= power
    power *= power
    power *= power
    power *= power
    return power * power


@kernel
def water_velocities(count, components, time, scratch):
    """Velocities [m/s] of the water at the depths [m] in row DEPTH below the labels in the
    scratch, into rows SPEED_X to SPEED_Z. All in one array, or the loop would not vectorise."""
    scratch[SPEED_X : SPEED_Z + 1, :count] = 0.0
    for w in range(components.shape[0]):
        wave = components[w]
        turns = wave[TURNS] - wave[FREQUENCY] * time
        k, dx, dy = wave[WAVENUMBER], wave[DIRECTION_X], wave[DIRECTION_Y]
        speed = 2.0 * np.pi * wave[FREQUENCY] * wave[AMPLITUDE]
        for i in range(count):
            s, c = sine_cosine(
                wave[TURNS_X] * scratch[LABEL_X, i] + wave[TURNS_Y] * scratch[LABEL_Y, i] + turns
            )
            v = speed * decay(k * scratch[DEPTH, i])
            scratch[SPEED_X, i] += dx * v * s
            scratch[SPEED_Y, i] += dy * v * s
            scratch[SPEED_Z, i] -= v * c


@kernel
def water_acceleration(x, y, depth, components, time, acceleration):
    """Acceleration (3,) [m/s^2] of the water at a depth [m] below the label x, y."""
    acceleration[:] = 0.0
    for w in range(components.shape[0]):
        wave = components[w]
        s, c = sine_cosine(
            wave[TURNS_X] * x + wave[TURNS_Y] * y + wave[TURNS] - wave[FREQUENCY] * time
        )
        rate = 2.0 * np.pi * wave[FREQUENCY]
        a = rate * rate * wave[AMPLITUDE] * decay(wave[WAVENUMBER] * depth)
        acceleration[0] -= wave[DIRECTION_X] * a * c
        acceleration[1] -= wave[DIRECTION_Y] * a * c
        acceleration[2] -= a * s


@kernel
def add_element(normal, arm, wet_area, u, pressures, wrench, damping):
    """Add the drag of one element and its derivative; normal, arm, u: (3,),
    world axes."""
    nx, ny, nz = normal
    normal_speed = u[0] * nx + u[1] * ny + u[2] * nz
    tx, ty, tz = u[0] - normal_speed * nx, u[1] - normal_speed * ny, u[2] - normal_speed * nz
    skin_speed = np.sqrt(tx * tx + ty * ty + tz * tz)
    linear, form, friction = (
        wet_area * pressures[0],
        wet_area * pressures[1],
        wet_area * pressures[2],
    )
    push = (linear + form * abs(normal_speed)) * normal_speed
    rub = friction * skin_speed
    fx, fy, fz = -push * nx - rub * tx, -push * ny - rub * ty, -push * nz - rub * tz
    mx, my, mz = cross(arm[0], arm[1], arm[2], fx, fy, fz)
    wrench[0] += fx
    wrench[1] += fy
    wrench[2] += fz
    wrench[3] += mx
    wrench[4] += my
    wrench[5] += mz
    # - dF/du = across n n^T + rub (1 - n n^T) + along t t^T, summed with the rows (1, [arm x])
    across = linear + 2.0 * form * abs(normal_speed) - rub
    along = friction / skin_speed if skin_speed > 0.0 else 0.0
    ax, ay, az = cross(arm[0], arm[1], arm[2], nx, ny, nz)
    bx, by, bz = cross(arm[0], arm[1], arm[2], tx, ty, tz)
    n = (nx, ny, nz, ax, ay, az)
    t = (tx, ty, tz, bx, by, bz)
    for i in range(6):
        for j in range(i + 1):
            damping[i, j] += across * n[i] * n[j] + along * t[i] * t[j]
    for i in range(3):
        damping[i, i] += rub
    x, y, z = arm[0], arm[1], arm[2]
    damping[3, 1] -= rub * z
    damping[3, 2] += rub * y
    damping[4, 0] += rub * z
    damping[4, 2] -= rub * x
    damping[5, 0] -= rub * y
    damping[5, 1] += rub * x
    damping[3, 3] += rub * (y * y + z * z)
    damping[4, 4] += rub * (x * x + z * z)
    damping[5, 5] += rub * (x * x + y * y)
    damping[4, 3] -= rub * x * y
    damping[5, 3] -= rub * x * z
    damping[5, 4] -= rub * y * z


@kernel
def find_water(points, components, tolerance, level, time, heads, velocities, motion):
    """Heads (N,) [m] of points (3, N) and the water's velocities (3, N) there; velocity and
    acceleration of the water at the last point in motion (6,)."""
    scratch = np.empty((SCRATCH_ROWS, CHUNK))
    total = points.shape[1]
    count = 0
    for start in range(0, total, CHUNK):
        end = min(start + CHUNK, total)
        count = end - start
        scratch[LABEL_X, :count] = points[0, start:end]
        scratch[LABEL_Y, :count] = points[1, start:end]
        x, y = points[0, start:end], points[1, start:end]
        solve_chunk(x, y, components, time, tolerance, 1, heads[start:end], scratch)
        for i in range(count):
            heads[start + i] += level - points[2, start + i]
            scratch[DEPTH, i] = max(heads[start + i], 0.0)
        water_velocities(count, components, time, scratch)
        velocities[:, start:end] = scratch[SPEED_X : SPEED_Z + 1, :count]
    motion[:3] = velocities[:, total - 1]
    last = scratch[:, count - 1]
    water_acceleration(last[LABEL_X], last[LABEL_Y], last[DEPTH], components, time, motion[3:])


@kernel
def choose_elements(elements, crest, position, rotation, points, chosen):
    """Points (3, N) in the world and numbers (N,) of the elements that a sea whose highest crest
    is at a height `crest` can wet, and of the last element in any case; returns how many."""
    count = elements.shape[1]
    active = 0
    r = rotation
    for i in range(count):
        px, py, pz = elements[POINT_X, i], elements[POINT_Y, i], elements[POINT_Z, i]
        for j in range(3):
            points[j, active] = position[j] + (r[j, 0] * px + r[j, 1] * py + r[j, 2] * pz)
        chosen[active] = i
        active += points[2, active] < crest + elements[RADIUS, i] or i == count - 1
    return active


@kernel
def drag_wrench(
    elements, pressures, components, tolerance, level, amplitude,
    position, rotation, velocity, time, wrench, damping, motion,
):  # fmt: skip
    """See Drag.add_drag; of damping the lower triangle is added to."""
    count = elements.shape[1]
    points, water = np.empty((3, count)), np.empty((3, count))
    heads, chosen = np.empty(count), np.empty(count, np.int64)
    active = choose_elements(elements, level + amplitude, position, rotation, points, chosen)
    find_water(points[:, :active], components, tolerance, level, time, heads, water, motion)
    arm, u, normal = np.empty(3), np.empty(3), np.empty(3)
    for i in range(active - 1):
        element = elements[:, chosen[i]]
        # An element gets wet over its own size, so that no force jumps.
        wet = min(max(0.5 + 0.5 * heads[i] / element[RADIUS], 0.0), 1.0)
        if wet == 0.0:
            continue
        for j in range(3):
            arm[j] = points[j, i] - position[j]
            normal[j] = (
                rotation[j, 0] * element[NORMAL_X]
                + rotation[j, 1] * element[NORMAL_Y]
                + rotation[j, 2] * element[NORMAL_Z]
            )
        ux, uy, uz = cross(velocity[3], velocity[4], velocity[5], arm[0], arm[1], arm[2])
        u[0] = velocity[0] + ux - water[0, i]
        u[1] = velocity[1] + uy - water[1, i]
        u[2] = velocity[2] + uz - water[2, i]
        add_element(normal, arm, wet * element[AREA], u, pressures, wrench, damping)


@kernel
def to_world(matrix, rotation, out):
    """out = diag(R, R) matrix diag(R, R)^T for (6, 6) matrices."""
    half = np.zeros((6, 6))
    out[:] = 0.0
    for i in range(6):
        for j in range(6):
            block = j // 3 * 3
            for k in range(3):
                half[i, j] += matrix[i, block + k] * rotation[j - block, k]
    for i in range(6):
        block = i // 3 * 3
        for j in range(6):
            for k in range(3):
                out[i, j] += rotation[i - block, k] * half[block + k, j]


@kernel
def add_added_mass(matrix, rotation, velocity, motion, wrench, inertia):
    """Add a hull's added mass (6, 6) [body frame, wet] to inertia, in world axes, and to wrench
    what does not depend on the body's acceleration: the water's own, and Kirchhoff's terms."""
    world = np.empty((6, 6))
    to_world(matrix, rotation, world)
    u = velocity.copy()
    u[:3] -= motion[:3]
    ux, uy, uz = cross(u[3], u[4], u[5], u[0], u[1], u[2])
    turning = (motion[3] + ux, motion[4] + uy, motion[5] + uz)
    momentum = np.zeros(6)
    for i in range(6):
        for j in range(6):
            momentum[i] += world[i, j] * u[j]
            inertia[i, j] += world[i, j]
        for j in range(3):
            wrench[i] += world[i, j] * turning[j]
    fx, fy, fz = cross(u[3], u[4], u[5], momentum[0], momentum[1], momentum[2])
    tx, ty, tz = cross(u[3], u[4], u[5], momentum[3], momentum[4], momentum[5])
    mx, my, mz = cross(u[0], u[1], u[2], momentum[0], momentum[1], momentum[2])
    wrench[0] -= fx
    wrench[1] -= fy
    wrench[2] -= fz
    wrench[3] -= tx + mx
    wrench[4] -= ty + my
    wrench[5] -= tz + mz


@kernel
def solve_symmetric(matrix, vector):
    """Solve a symmetric positive definite system (6, 6) by Cholesky's method, in place; of the
    matrix the lower triangle is read."""
    n = vector.size
    for j in range(n):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
        matrix[j, j] = np.sqrt(matrix[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    for i in range(n):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]


@kernel
def dry_inertia(mass, principal, rotation, out):
    """Inertia (6, 6) of a rigid body about its centre of mass, world axes."""
    out[:] = 0.0
    for i in range(3):
        out[i, i] = mass
        for j in range(3):
            for k in range(3):
                out[3 + i, 3 + j] += rotation[i, k] * principal[k] * rotation[j, k]


@kernel
def add_angular(rate, principal, rotation, velocity, wrench, damping):
    """Add the decay of the angular momentum at a rate [1/s]."""
    dry = np.empty((6, 6))
    dry_inertia(0.0, principal, rotation, dry)
    for i in range(3, 6):
        for j in range(3, 6):
            wrench[i] -= rate * dry[i, j] * velocity[j]
            damping[i, j] += rate * dry[i, j]


@kernel
def accelerated_wrench(
    mass, principal, rotation, velocity, timestep, known, fluid, damping, added, free
):
    """What to hand over as `fluid`: (6,), overwritten, so that the body accelerates as the
    linearly implicit step says.

    known: (6,) the other forces, gravity included; fluid: buoyancy, drag and what the added mass
    adds to them; damping, added: (6, 6). For a body that is not free, fluid is drag alone.
    """
    dry = np.empty((6, 6))
    dry_inertia(mass, principal, rotation, dry)
    lx, ly, lz = 0.0, 0.0, 0.0
    for j in range(3):
        lx += dry[3, 3 + j] * velocity[3 + j]
        ly += dry[4, 3 + j] * velocity[3 + j]
        lz += dry[5, 3 + j] * velocity[3 + j]
    rest = np.zeros(6)
    if free:
        bx, by, bz = cross(velocity[3], velocity[4], velocity[5], lx, ly, lz)
        rest[:] = known
        rest[3] -= bx
        rest[4] -= by
        rest[5] -= bz
    acceleration = fluid + rest
    matrix = dry + added + timestep * damping
    solve_symmetric(matrix, acceleration)
    for i in range(6):
        fluid[i] = -rest[i]
        for j in range(6):
            fluid[i] += dry[i, j] * acceleration[j]
