"""Probes: where the motion of the water around a hull is computed.

The water around a hull smaller than the waves moves much the same everywhere, so its motion at all
elements follows from that at a few of them, the *probes*:

    motion at element i  =  sum over probes n of  share[n, i] * motion at probe n.

The shares do not depend on the pose, because they relate points of the hull to each other. They are
fitted once for a hull and a sea, to the motions at random poses on the surface, and the probes are
the elements that pivots of a QR decomposition choose. This is an interpolative decomposition. The
shares of an element add up to 1, so a uniform flow is exact. Probes above the surface have the
motion that is reflected there (see `motion`), which interpolates better than one that stops. A hull
that takes more than MOST_PROBES probes has none, and the water's motion is computed at each of its
elements.

Source: Cheng, Gimbutas, Martinsson and Rokhlin 2005 (On the compression of low rank matrices).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import placed, random_rotation
from sim.kernels import inline, kernel, read_only, record, scratch, workspace
from sim.precision import reals
from sim.resistance.elements import ELEMENTS, ROW, Pose
from sim.water.gerstner import LABELS, LANES, level_and_rise, set_labels, solve_labels
from sim.water.head import depth
from sim.water.motion import ACCELERATION, MOTION, VELOCITY, water_motion
from sim.water.samples import SAFETY, newton_steps, sample_places, still
from sim.water.sea import Sea

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Table = NDArray[np.void]

LABEL_ERROR = 0.02
"""Largest error of the labels above the elements, as a share of the hull's length or in radians of
the waves' phase. The water's velocity is then accurate to about 2 %, and drag coefficients are
known to 20 %."""

PROBE_ERROR = 0.02
"""Largest rms error of the interpolated velocity of the water at the wet elements, as a share of
its rms, and of the water's height there, as a share of an element's diameter. The drag
of a hull at rest in the waves is then that from all elements within the same share. A smaller limit
takes more probes."""

LEAST_PROBES, MOST_PROBES = 16, 32
"""Smallest and largest number of probes of a hull in waves. A full quadratic takes ten; with fewer,
what is of second order, such as drift, is off by a hundredth. In a few waves, more than the largest
number cost as much as the motion at every element."""

POSES = 64
"""Number of random poses to which shares are fitted, and of further poses that judge them."""

QUANTITIES = 7
"""Numbers at a probe: the height [m] of the water above the level, its velocity [m/s], and its
acceleration [m/s^2]."""

HEIGHT, VELOCITIES, ACCELERATIONS = 0, 1, 4
"""Indices of the height, and of the first components of the velocity and of the acceleration."""

PROBE = record(element="i8", share=ROW)
"""A probe: the number of its element, and its shares in the motions at all elements."""


NO_PROBES = read_only(np.zeros(0, PROBE))
"""The probes of a hull that needs the water's motion at every element."""


class Flow(NamedTuple):
    """The water at an instant, as kernels take it: WAVE rows, WATER, time [s]."""

    waves: Table
    water: Table
    time: float


def label_steps(sea: Sea, size: float) -> tuple[int, float]:
    """Number of Newton steps, from the points themselves, that bring the labels of all samples to
    LABEL_ERROR for a hull of a size [m], and a bound on the residual [m] before the last step. A
    fixed number of steps for every element makes drag a smooth function of the pose."""
    waves = sea.components
    speeds = waves["rate"] * waves["amplitude"]
    if not speeds.any():
        return 1, np.inf
    wavenumber = np.linalg.norm(waves["wavenumber"] * speeds) / np.linalg.norm(speeds)
    allowed = LABEL_ERROR * min(size, float(1.0 / wavenumber))
    steps, residual = newton_steps(sea, allowed)
    return steps, SAFETY * residual


def probes_of(surface: Table, strength: Table, sea: Sea) -> Table:
    """The PROBE rows of a hull in a sea. No rows if every element needs the water's motion.

    surface, strength: the hull's SURFACE and STRENGTH.
    """
    heights, velocities, _ = sampled_motions(surface, strength, sea, seed=0)
    if not (sea.waves and heights.any()):
        return _probe_rows(np.zeros(1, np.int64), np.ones((1, ELEMENTS)))
    size = 2.0 * surface["radius"].mean()
    fields = np.concatenate(
        [heights[:, None] / size, velocities / _rms(velocities)], axis=1
    ).reshape(-1, ELEMENTS)
    uniform = np.full((1, ELEMENTS), 1e3 * np.abs(fields).max())
    fields = np.concatenate([uniform, fields])
    pivots = _pivots(fields, MOST_PROBES)
    judged = sampled_motions(surface, strength, sea, seed=1)
    for count in range(LEAST_PROBES, MOST_PROBES + 1, LANES):
        chosen = pivots[:count]
        shares = np.linalg.lstsq(fields[:, chosen], fields, rcond=None)[0]
        probes = _probe_rows(chosen, shares / shares.sum(axis=0))
        if probe_error(probes, surface, *judged) <= PROBE_ERROR:
            return probes
    return NO_PROBES


def probe_error(
    probes: Table, surface: Table, heights: Array, velocities: Array, is_wet: NDArray[np.bool_]
) -> float:
    """The larger of the two errors that PROBE_ERROR limits, of probes at `sampled_motions`."""
    shares, at = probes["share"], probes["element"]
    missed = (heights[:, at] @ shares - heights)[is_wet] / (2.0 * surface["radius"].mean())
    slips = (velocities[:, :, at] @ shares - velocities).swapaxes(1, 2)[is_wet]
    return max(_rms(missed), _rms(slips) / _rms(velocities.swapaxes(1, 2)[is_wet]))


def sampled_motions(
    surface: Table, strength: Table, sea: Sea, seed: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Heights (P, E) [m] and reflected velocities (P, 3, E) [m/s] of the water, less its current,
    at the elements of a hull in random poses on the surface, and which elements are wet (P, E)."""
    rng, (x, y) = np.random.default_rng(seed), sample_places(sea)
    time, level = sea.ramp, still(sea)
    points = np.stack([surface[axis][0] for axis in "xyz"], axis=1)
    middle = points.mean(axis=0)
    size = np.linalg.norm(np.ptp(points, axis=0))
    flow = Flow(sea.components, sea.water, time)
    probed, found, is_wet = np.empty((QUANTITIES, ELEMENTS)), [], []
    for i in rng.integers(0, len(x), POSES):
        rotation, up = random_rotation(rng), rng.uniform(-0.5, 0.5) * size
        above = float(sea.elevation(x[i], y[i], time)) + up
        position = np.array([x[i], y[i], above]) - rotation @ middle
        pose = Pose(position, np.ascontiguousarray(rotation).ravel())
        write_reflected(surface, strength, NO_PROBES, flow, pose, probed)
        found.append(probed[:4].copy())
        z = position[2] + points @ rotation[2]
        is_wet.append(probed[HEIGHT] + level - z > -surface["radius"][0])
    motions = np.array(found)
    waves = motions[:, VELOCITIES : VELOCITIES + 3] - sea.water["current"][0][:, None]
    return motions[:, HEIGHT], waves, np.array(is_wet)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _pivots(fields: Array, count: int) -> Integers:
    """The columns (count,) that a QR decomposition with pivots takes first."""
    rest, chosen = fields.copy(), []
    for _ in range(count):
        lengths = (rest**2).sum(axis=0)
        lengths[chosen] = -1.0
        chosen.append(int(np.argmax(lengths)))
        along = rest[:, chosen[-1]] / max(np.sqrt(lengths[chosen[-1]]), np.finfo(float).tiny)
        rest -= np.outer(along, along @ rest)
    return np.array(chosen)


def _probe_rows(elements: Integers, shares: Array) -> Table:
    """PROBE rows, filled up to LANES with probes that have no share."""
    rows = np.zeros(-(-len(elements) // LANES) * LANES, PROBE)
    rows["element"], rows["share"][: len(elements)] = elements[0], shares
    rows["element"][: len(elements)] = elements
    return read_only(rows)


@inline
def probe_count(probes):
    """The number of points at which the motion of the water is computed."""
    return probes.size if probes.size > 0 else ELEMENTS


@kernel
def place_probes(surface, probes, pose, x_out, y_out, z_out):
    """World positions of a hull's probes, or of all its elements."""
    s = surface
    if probes.size == 0:
        for i in range(ELEMENTS):
            x_out[i], y_out[i], z_out[i] = placed(
                s.x[i], s.y[i], s.z[i], pose.position, pose.rotation
            )
    for n in range(probes.size):
        i = probes[n].element
        x_out[n], y_out[n], z_out[n] = placed(s.x[i], s.y[i], s.z[i], pose.position, pose.rotation)


@kernel
def keep_motion(count, first, motion, probed_out):
    """Copy the first `count` velocities or accelerations of a MOTION, to rows from `first` on."""
    v = motion[0]
    for n in range(count):
        probed_out[first, n], probed_out[first + 1, n] = v.x[n], v.y[n]
        probed_out[first + 2, n] = v.z[n]


@kernel
def probe_water(x, y, z, strength, flow, is_reflected, has_acceleration, probed_out):
    """Compute the QUANTITIES (QUANTITIES, N) of the water at points x, y, z: (N,) [m].
    is_reflected: whether points above the surface have its reflected motion, and not the motion at
    the surface."""
    guess, labels, motion = workspace(LABELS), workspace(LABELS), workspace(MOTION)
    heights, depths, residual = scratch(ELEMENTS), reals(ELEMENTS), strength.residual
    found, below, time = heights[: x.size], depths[: x.size], flow.time
    set_labels(x, y, guess)
    solve_labels(x, y, guess, flow.waves, time, residual, strength.steps, found, labels)
    level, _ = level_and_rise(flow.water[0], time)
    for n in range(x.size):
        probed_out[HEIGHT, n] = found[n]
        deep = depth(found[n], z[n] - level)
        below[n] = deep if is_reflected else max(deep, 0.0)
    water_motion(VELOCITY, below, flow.waves, flow.water, time, labels, motion)
    keep_motion(x.size, VELOCITIES, motion, probed_out)
    if has_acceleration:
        water_motion(ACCELERATION, below, flow.waves, flow.water, time, labels, motion)
        keep_motion(x.size, ACCELERATIONS, motion, probed_out)


@kernel
def probe_hull(surface, strength, probes, flow, pose, has_acceleration, probed_out):
    """Compute the QUANTITIES (QUANTITIES, ELEMENTS) of the water at a hull's probes, or at all its
    elements."""
    xs, ys, zs, count = scratch(ELEMENTS), scratch(ELEMENTS), scratch(ELEMENTS), probe_count(probes)
    x, y, z = xs[:count], ys[:count], zs[:count]
    place_probes(surface, probes, pose, x, y, z)
    probe_water(x, y, z, strength, flow, probes.size > 0, has_acceleration, probed_out)


@kernel
def write_reflected(surface, strength, probes, flow, pose, probed_out):
    """Compute the reflected QUANTITIES (QUANTITIES, ELEMENTS) of the water at all elements of a
    hull, to which probes are fitted. probes: no rows."""
    x, y, z = scratch(ELEMENTS), scratch(ELEMENTS), scratch(ELEMENTS)
    place_probes(surface[0], probes, pose, x, y, z)
    probe_water(x, y, z, strength[0], flow, True, False, probed_out)


@kernel
def spread(first, probed, probes, a_out, b_out, c_out, d_out):
    """Values (ELEMENTS,) at all elements, from four rows of those at the probes."""
    if probes.size == 0:
        for i in range(ELEMENTS):
            a_out[i], b_out[i] = probed[first, i], probed[first + 1, i]
            c_out[i], d_out[i] = probed[first + 2, i], probed[first + 3, i]
        return
    for i in range(ELEMENTS):
        a_out[i], b_out[i], c_out[i], d_out[i] = 0.0, 0.0, 0.0, 0.0
    for n in range(0, probes.size, 2):  # two at a time, for fewer loads and stores
        p, q = probes[n], probes[n + 1]
        pa, pb, pc, pd = four(probed, first, n)
        qa, qb, qc, qd = four(probed, first, n + 1)
        for i in range(ELEMENTS):
            u, v = p.share[i], q.share[i]
            a_out[i] += pa * u + qa * v
            b_out[i] += pb * u + qb * v
            c_out[i] += pc * u + qc * v
            d_out[i] += pd * u + qd * v


@inline
def four(probed, first, n):
    """The numbers of probe n in four rows."""
    return probed[first, n], probed[first + 1, n], probed[first + 2, n], probed[first + 3, n]


@kernel
def spread_velocities(probed, probes, heights_out, motion_out):
    """Heights (ELEMENTS,) and velocities, a MOTION, of the water at all elements."""
    v = motion_out[0]
    spread(HEIGHT, probed, probes, heights_out, v.x[:], v.y[:], v.z[:])


@kernel
def spread_accelerations(probed, probes, motion_out):
    """Accelerations of the water at all elements, a MOTION."""
    v, others = motion_out[0], reals(ELEMENTS)
    spread(VELOCITIES + 2, probed, probes, others, v.x[:], v.y[:], v.z[:])
