"""Drag: what moving water does to a hull besides pushing it up.

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

Drag may be strong and bodies light; the step that bears it, and added mass, is in `sim.implicit`.

The water's velocity below the surface is that of Gerstner's waves: a particle moves on the
circle of the surface particle above it with the radius times exp(- k depth). Label and depth
are those of the surface right above the point, which is exact at the surface and off by a
relative k a at depth, where little is left of the motion (see `tests/test_drag.py`).

Sources: Morison et al. 1950 and Faltinsen 1990 for the splitting into terms; Newman 1977 for
the wave damping; Kerner 2015 (Water interaction model for boats in video games) for drag summed
over a hull's facets.
"""

import heapq
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sim.gerstner import (
    AMPLITUDE,
    DIRECTION_X,
    DIRECTION_Y,
    FREQUENCY,
    HEIGHT,
    LABEL_X,
    LABEL_Y,
    LANES,
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
    summing_kernel,
)
from sim.hull import Hull
from sim.sea import Sea
from sim.triangle import cross

Array = NDArray[np.float64]

ELEMENTS = 128
"""Surface elements a hull is gathered into; the cost of drag is proportional to it."""

LABEL_ERROR = 0.02
"""Largest error of the labels above the elements, in hull lengths or in radians of the waves'
phase: the water's velocity is then right to some 2 %, where drag coefficients are to 20 %."""

SAFETY = 1.5
"""A residual this many times the largest of the samples makes the solver go on."""

SYMMETRY = 1e-9
"""Relative round-off that a symmetric, positive semidefinite matrix given in decimals may have."""

# Rows of the solver's scratch after the labels are found.
SPEED_X, SPEED_Y, SPEED_Z, DEPTH = OFFSET_X, OFFSET_Y, HEIGHT, RESIDUAL

# Rows of an array of elements, hull frame.
POINT_X, POINT_Y, POINT_Z, NORMAL_X, NORMAL_Y, NORMAL_Z, AREA, RADIUS = range(8)

# Rows of the work: the elements in the world, their wet areas, and forces.
WORLD_X, WORLD_Y, WORLD_Z, HEAD, WET = range(5)
FORCE_X, FORCE_Y, FORCE_Z, SKIN_X, SKIN_Y, SKIN_Z, ACROSS, ALONG, RUB = range(5, 14)
WORK_ROWS = 14


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

    elements (8, N): as of `surface_elements`, filled up to whole LANES with elements of no area,
    N = 0 without surface drag; pressures (3,): density times coefficients, the factors of u_n,
    |u_n| u_n and |u_t| u_t; label_steps, label_residual: as of that function.
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
        speed = np.sqrt(sea.gravity * np.cbrt(hull.volume))
        self.pressures = sea.density * np.array([c.linear * speed, 0.25 * c.form, 0.5 * c.friction])
        self.elements = np.empty((8, 0))
        if self.pressures.any():
            elements = surface_elements(hull)
            fill = np.repeat(elements[:, :1], -elements.shape[1] % LANES, axis=1)
            fill[AREA] = 0.0
            self.elements = np.hstack([elements, fill])
        size = float(np.linalg.norm(hull.bounds[1] - hull.bounds[0]))
        self.label_steps, self.label_residual = label_steps(sea, size)

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
        """Add drag to wrench (6,) and - d wrench / d velocity to damping (6, 6), and leave the
        water's velocity and acceleration (6,) at the hull's centroid in motion.

        position (3,), rotation (3, 3): pose of the hull frame; velocity (6,): of its origin
        and angular, world axes, like all that comes out; time [s]. Without the angular rate.
        """
        sea, count = self.sea, self.elements.shape[1]
        rotation = np.ascontiguousarray(rotation)  # or kernels would be compiled for others too
        centroid, time = position + rotation @ self.hull.centroid, float(time)
        water_motion(centroid, sea.components, sea.residual_tolerance, sea.level, time, motion)
        turn = np.kron(np.eye(2), rotation)
        work, scratch = np.empty((WORK_ROWS, count)), np.empty((SCRATCH_ROWS, count))
        drag, lower = np.zeros(6), np.zeros((6, 6))
        hull_drag(
            self.elements, self.pressures, sea.components, self.label_residual, self.label_steps,
            sea.level, position, rotation, turn.T @ velocity, time, 1.0, work, scratch, drag, lower,
        )  # fmt: skip
        wrench += turn @ drag
        damping += turn @ (np.tril(lower) + np.tril(lower, -1).T) @ turn.T


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


def label_steps(sea: Sea, size: float) -> tuple[int, float]:
    """Newton steps, from the point itself, that bring the labels of all samples to LABEL_ERROR for
    a hull of a size [m], and the residual [m] before the last of them that no sample
    exceeded. With as many steps for every element drag is a smooth function of the pose."""
    speeds = sea.components[:, FREQUENCY] * sea.components[:, AMPLITUDE]
    if not speeds.any():
        return 1, np.inf
    wavenumber = np.linalg.norm(sea.components[:, WAVENUMBER] * speeds) / np.linalg.norm(speeds)
    allowed = LABEL_ERROR * min(size, 1.0 / wavenumber)
    steps, residual = sea.newton_steps(allowed)
    return steps, SAFETY * residual


@njit(inline="always")
def decay(x):
    """exp(-x) for x >= 0 as (1 - y + ... + y^4/24)^64 with y = x/64 up to 1: to 5e-10 at x = 1 and
    5e-5 at 10, never rising. Without a call in it, a loop over it vectorises."""
    y = min(x / 64.0, 1.0)
    power = 1.0 - y * (1.0 - y * (0.5 - y * (1.0 / 6.0 - y / 24.0)))
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
def water_motion(point, components, tolerance, level, time, motion):
    """Velocity [m/s] and acceleration [m/s^2] of the water at a point (3,) into motion (6,)."""
    scratch, height = np.empty((SCRATCH_ROWS, LANES)), np.empty(1)
    scratch[LABEL_X, 0], scratch[LABEL_Y, 0] = point[0], point[1]
    solve_chunk(point[:1], point[1:2], components, time, tolerance, 1, height, scratch)
    scratch[DEPTH, 0] = depth = max(height[0] + level - point[2], 0.0)
    water_velocities(height.size, components, time, scratch)
    motion[:3] = scratch[SPEED_X : SPEED_Z + 1, 0]
    motion[3:] = 0.0
    for w in range(components.shape[0]):
        wave = components[w]
        s, c = sine_cosine(
            wave[TURNS_X] * scratch[LABEL_X, 0]
            + wave[TURNS_Y] * scratch[LABEL_Y, 0]
            + (wave[TURNS] - wave[FREQUENCY] * time)
        )
        rate = 2.0 * np.pi * wave[FREQUENCY]
        a = rate * rate * wave[AMPLITUDE] * decay(wave[WAVENUMBER] * depth)
        motion[3] -= wave[DIRECTION_X] * a * c
        motion[4] -= wave[DIRECTION_Y] * a * c
        motion[5] -= a * s


@kernel
def place_elements(elements, position, rotation, work, scratch):
    """World positions of the elements into rows WORLD_X to WORLD_Z, the first guess of their labels
    into the scratch."""
    px, py, pz = position
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = rotation
    for i in range(elements.shape[1]):
        x, y, z = elements[POINT_X, i], elements[POINT_Y, i], elements[POINT_Z, i]
        work[WORLD_X, i] = px + (ax * x + ay * y + az * z)
        work[WORLD_Y, i] = py + (bx * x + by * y + bz * z)
        work[WORLD_Z, i] = pz + (cx * x + cy * y + cz * z)
    for i in range(elements.shape[1]):
        scratch[LABEL_X, i] = work[WORLD_X, i]
        scratch[LABEL_Y, i] = work[WORLD_Y, i]


@summing_kernel
def wet_areas(elements, level, work, scratch):
    """Wet areas of the elements into row WET, their depths into the scratch; returns their sum."""
    total = 0.0
    for i in range(elements.shape[1]):
        head = work[HEAD, i] + (level - work[WORLD_Z, i])
        # An element gets wet over its own size, so that no force jumps.
        share = min(max(0.5 + 0.5 * head / elements[RADIUS, i], 0.0), 1.0)
        work[WET, i] = share * elements[AREA, i]
        scratch[DEPTH, i] = max(head, 0.0)
        total += work[WET, i]
    return total


@kernel
def element_forces(elements, pressures, rotation, velocity, work, scratch):
    """Forces of the elements, in the hull's axes, into rows FORCE_X to FORCE_Z, and what their
    derivatives are made of:

    - dF/du = across n n^T + along t t^T + rub 1,    t the tangential velocity.
    """
    linear, form, friction = pressures
    vx, vy, vz, wx, wy, wz = velocity
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = rotation
    for i in range(elements.shape[1]):
        sx, sy, sz = scratch[SPEED_X, i], scratch[SPEED_Y, i], scratch[SPEED_Z, i]
        x, y, z = cross(
            wx, wy, wz, elements[POINT_X, i], elements[POINT_Y, i], elements[POINT_Z, i]
        )
        ux = vx + x - (ax * sx + bx * sy + cx * sz)
        uy = vy + y - (ay * sx + by * sy + cy * sz)
        uz = vz + z - (az * sx + bz * sy + cz * sz)
        nx, ny, nz = elements[NORMAL_X, i], elements[NORMAL_Y, i], elements[NORMAL_Z, i]
        speed = ux * nx + uy * ny + uz * nz
        tx, ty, tz = ux - speed * nx, uy - speed * ny, uz - speed * nz
        skin_speed = np.sqrt(tx * tx + ty * ty + tz * tz)
        area = work[WET, i]
        push = area * (linear + form * abs(speed)) * speed
        rub = area * friction * skin_speed
        work[FORCE_X, i] = -push * nx - rub * tx
        work[FORCE_Y, i] = -push * ny - rub * ty
        work[FORCE_Z, i] = -push * nz - rub * tz
        work[SKIN_X, i], work[SKIN_Y, i], work[SKIN_Z, i] = tx, ty, tz
        work[ACROSS, i] = area * (linear + 2.0 * form * abs(speed)) - rub
        work[ALONG, i] = area * friction / skin_speed if skin_speed > 0.0 else 0.0
        work[RUB, i] = rub


@summing_kernel
def add_wrench(elements, work, wrench):
    """Add the elements' forces and their torques to wrench (6,)."""
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(elements.shape[1]):
        x, y, z = work[FORCE_X, i], work[FORCE_Y, i], work[FORCE_Z, i]
        px, py, pz = elements[POINT_X, i], elements[POINT_Y, i], elements[POINT_Z, i]
        fx, fy, fz = fx + x, fy + y, fz + z
        tx, ty, tz = tx + (py * z - pz * y), ty + (pz * x - px * z), tz + (px * y - py * x)
    wrench[0] += fx
    wrench[1] += fy
    wrench[2] += fz
    wrench[3] += tx
    wrench[4] += ty
    wrench[5] += tz


@summing_kernel
def add_squares(elements, vectors, weights, factor, damping):
    """Add factor * sum of weight b b^T, b = (a, point x a), to the lower triangle of damping;
    vectors a: (3, N), weights: (N,)."""
    aa, ba, bb, ca, cb, cc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    da, db, dc, dd, ea, eb, ec, ed, ee = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fa, fb, fc, fd, fe, ff = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(weights.size):
        w, a, b, c = weights[i], vectors[0, i], vectors[1, i], vectors[2, i]
        x, y, z = elements[POINT_X, i], elements[POINT_Y, i], elements[POINT_Z, i]
        d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
        wa, wb, wc, wd, we, wf = w * a, w * b, w * c, w * d, w * e, w * f
        aa, ba, bb = aa + wa * a, ba + wb * a, bb + wb * b
        ca, cb, cc = ca + wc * a, cb + wc * b, cc + wc * c
        da, db, dc, dd = da + wd * a, db + wd * b, dc + wd * c, dd + wd * d
        ea, eb, ec, ed, ee = ea + we * a, eb + we * b, ec + we * c, ed + we * d, ee + we * e
        fa, fb, fc = fa + wf * a, fb + wf * b, fc + wf * c
        fd, fe, ff = fd + wf * d, fe + wf * e, ff + wf * f
    sums = (
        aa, ba, bb, ca, cb, cc, da, db, dc, dd, ea, eb, ec, ed, ee, fa, fb, fc, fd, fe, ff
    )  # fmt: skip
    k = 0
    for i in range(6):
        for j in range(i + 1):
            damping[i, j] += factor * sums[k]
            k += 1


@summing_kernel
def add_rub(elements, weights, factor, damping):
    """Add factor * sum of weight (1, [point x]) (1, [point x])^T to the lower triangle of
    damping; weights (N,)."""
    s, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
    xx, yx, yy, zx, zy, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(weights.size):
        w, x, y, z = weights[i], elements[POINT_X, i], elements[POINT_Y, i], elements[POINT_Z, i]
        wx, wy, wz = w * x, w * y, w * z
        s, sx, sy, sz = s + w, sx + wx, sy + wy, sz + wz
        xx, yx, yy = xx + wx * x, yx + wy * x, yy + wy * y
        zx, zy, zz = zx + wz * x, zy + wz * y, zz + wz * z
    for i in range(3):
        damping[i, i] += factor * s
    damping[3, 1] -= factor * sz
    damping[3, 2] += factor * sy
    damping[4, 0] += factor * sz
    damping[4, 2] -= factor * sx
    damping[5, 0] -= factor * sy
    damping[5, 1] += factor * sx
    damping[3, 3] += factor * (yy + zz)
    damping[4, 4] += factor * (xx + zz)
    damping[5, 5] += factor * (xx + yy)
    damping[4, 3] -= factor * yx
    damping[5, 3] -= factor * zx
    damping[5, 4] -= factor * zy


@kernel
def hull_drag(
    elements, pressures, components, residual, steps, level, position, rotation, velocity, time,
    factor, work, scratch, wrench, damping,
):  # fmt: skip
    """Add a hull's drag to wrench (6,) and factor * - d wrench / d velocity to the lower triangle
    of damping (6, 6): these and velocity (6,) along the axes of the hull frame."""
    count = elements.shape[1]
    place_elements(elements, position, rotation, work, scratch)
    x, y, heads = work[WORLD_X, :count], work[WORLD_Y, :count], work[HEAD, :count]
    solve_chunk(x, y, components, time, residual, steps, heads, scratch)
    if wet_areas(elements, level, work, scratch) == 0.0:
        return
    water_velocities(count, components, time, scratch)
    element_forces(elements, pressures, rotation, velocity, work, scratch)
    add_wrench(elements, work, wrench)
    add_squares(elements, elements[NORMAL_X:AREA], work[ACROSS, :count], factor, damping)
    if pressures[2] > 0.0:
        add_squares(elements, work[SKIN_X:ACROSS], work[ALONG, :count], factor, damping)
        add_rub(elements, work[RUB, :count], factor, damping)
