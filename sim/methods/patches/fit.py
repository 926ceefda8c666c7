"""Fit: how few points of a sea must be solved for a given error.

Some quantities have no useful bound, such as the distance over which a jet holds. They are
estimated from samples of the sea (see `water.samples`). Bounds are several times too cautious where
many waves would have to coincide.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, lru_cache, partial
from itertools import product
from math import factorial, prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.kernels import read_only
from sim.water.gerstner import CHUNK, PLAIN_STEPS
from sim.water.head_jets import HEAD_JETS, solve_head_jets
from sim.water.jets import JET, near_particles, solve_jets
from sim.water.many_waves import MANY_WAVES, solve_many_head_jets, solve_many_heads
from sim.water.samples import SAFETY, newton_steps, sample_places, still
from sim.water.sea import Sea

Array = NDArray[np.float64]
Heads = Callable[[Array, Array, Array], Array]
Chosen = slice | NDArray[np.int64]
Table = NDArray[np.void]

DISC_RADII, DECAYING_DISC_RADII = 0.65, 0.3
"""Radius of the disc over which jets are fitted, in radii of the largest patch allowed: for
hydrostatic pressure, and for pressure that decays with depth. Seen from above, most of a patch is
near its middle. These values gave the smallest errors of the wrench among 0.4 to 1.1 and among 0 to
1. A decaying head is nearly a harmonic function, for which Taylor's cubic is the best one over a
ball."""

WIDE_PHASE = 3.0
"""Phase [rad] of a wave over a patch's radius, k radius, above which the wave is fitted over the
whole patch. No cubic follows such a wave, and one that fits its middle would be far off at the
rim."""

DIRECTIONS, RINGS = 8, (0.25, 0.5, 0.75, 1.0)
"""Number of directions, and distances in radii, in which jets are tried at the samples of the
sea."""

DIP_ANGLES = tuple(np.radians([-90.0, -45.0, 0.0, 45.0]))
"""Inclinations [rad] of these directions, where jets are tried below the surface."""

SURFACE_TERMS = {name: name[2:] for name in JET.names or () if name[0] == "z"}
HEAD_TERMS = {name: name.replace("h", "") for name in HEAD_JETS.names or ()}
"""For each field of a jet, the axes of its derivative."""

MOST_PHASE = 1000.0
"""Largest phase [rad] over a disc's radius, k radius, in a fit. A fit takes larger ones as this."""

MOST_RADIUS_TRIALS = 40
"""Maximum number of radii that are tried. A tolerance near round-off is met by none."""

EQUAL_ERROR_RATIO, EQUAL_RADIUS_RATIO = 0.9, 1.05
"""Ratios at which a search for a radius counts two values as equal. An error of at least 0.9 of the
last one has not fallen: waves shorter than the patches are missed as a whole, however large the
patches are, so the radius is halved until it is shorter than the waves. A next radius of less than
1.05 of the best one is no improvement, and the search ends."""

SQUEEZES = (0.0, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4)
"""Limits of J that are tried where patches are larger than the tolerance asks for."""

WORST_PART = 8
"""One of this number of samples, the worst at the last radius at which all were tried, judges the
radii of a search."""

LEVEL_RATIO, MOST_LEVELS = 2.0, 5
"""Ratio of the radii of patches of one level and the next, and largest number of levels below the
surface. With smaller ratios the small patches fill their balls less well, and there are more of
them: 1.6 times as many with 1.5, 1.1 times with 2."""

DEPTH_STEP = 1.15
"""Ratio of the depths that are tried for a level."""

LEFT_OUT_SHARE = 0.02
"""Share of the tolerance that the waves may amount to, at the top of a level's highest patch, that
the level leaves out."""

DEEP_STRIDE = 4
"""One of this number of samples judges a level."""

CENTRE_SHIFT_RADII = 0.05
"""Distance, in patch radii, between a patch's centre and the particle that its jet may come from.
The solve can then stop early, and patches are smaller by this share."""

ROUGH_ERROR = 1e-4
"""Largest error of the labels of rough heads, as a share of the highest crest. The heads are at
least as accurate."""

ROUGH_SHARE = 1e-3
"""Smallest error of jets that rough heads judge, as a share of the highest crest."""


class Level(NamedTuple):
    """Patches of one size.

    radius [m]: the largest; depth [m]: of their centres below the still level, from which they may
    be used; sunk [m]: head that the waves take which matter only above (the mean of their surface
    is lower than the still level); waves: the fitted waves.
    """

    radius: float
    depth: float
    sunk: float
    waves: Table


def fitted_waves(sea: Sea, radius: float | Array) -> Table:
    """Components of the sea whose jets are the best cubics over a disc, instead of Taylor's cubics.
    Taylor's are best at the centre and several times worse at the rim. radius [m]: of the disc, one
    for all waves or one for each.

    Along its direction, each wave is replaced by the cubic closest to it in the mean square over
    the disc. With the position s over the radius, and u = k radius, this is

        cos(u s) ~ b0 + b2 (4 s^2 - 1),        sin(u s) ~ 2 b1 s + b3 (8 s^3 - 4 s),

    Chebyshev polynomials of the second kind, whose weight is that of a disc seen from the side.
    Value and derivatives at the centre follow (economised series: Lanczos 1938). Products of waves
    remain Taylor's. Slopes and offsets change nearly alike, so the Newton steps to a label still
    reduce the residual, by a third or more, in any sea.
    """
    fitted = sea.components.copy()
    # beyond MOST_PHASE the wave averages out: the coefficients are below 1e-4 of the amplitude
    u = np.minimum(fitted["wavenumber"] * radius, MOST_PHASE)[:, None]
    count = 32 + 2 * int(u.max(initial=0.0))  # enough to resolve the shortest wave
    angles = np.pi * np.arange(1, count) / count
    s, weights = np.cos(angles), 2.0 / count * np.sin(angles)
    b0, b2 = (np.cos(u * s) @ (weights * np.sin(n * angles)) for n in (1, 3))
    b1, b3 = (np.sin(u * s) @ (weights * np.sin(n * angles)) for n in (2, 4))
    amplitude = sea.components["amplitude"]
    fitted["amplitude"] = amplitude * (b0 - b2)
    fitted["ka"] = amplitude * (2.0 * b1 - 4.0 * b3) / radius
    fitted["kka"] = amplitude * -8.0 * b2 / radius**2
    fitted["kkka"] = amplitude * -48.0 * b3 / radius**3
    return read_only(fitted)


def jet_waves(sea: Sea, radius: float) -> Table:
    """The fitted components for jets over patches of a radius [m]."""
    share = DISC_RADII if sea.pressure == "hydrostatic" else DECAYING_DISC_RADII
    is_short = sea.components["wavenumber"] * radius > WIDE_PHASE
    return fitted_waves(sea, radius * np.where(is_short, 1.0, share))


def jet_radius(
    sea: Sea, tolerance: float, largest: float, smallest: float = 0.0
) -> tuple[float, float]:
    """Radius [m], between `smallest` and `largest`, up to which fitted jets of the sea keep the
    tolerance [m], and the tolerance [m] kept at that radius. If no radius keeps it, the result is
    `smallest` and the larger tolerance kept there. Flat water gives inf and 0.

    A bound from the fourth derivatives would need several times too many patches, because it
    assumes that many waves coincide. Instead, jets are tried at particles of all phases, and the
    largest error found times SAFETY must pass: first on the outermost ring around the particles
    that were worst before, then around all particles, then on the other rings around the worst.
    """
    if not sea.components.size:
        return np.inf, 0.0
    radius, error, outer = largest, np.inf, np.inf
    good, kept, bad = 0.0, np.inf, np.inf
    worst: Chosen = slice(None)
    for _ in range(MOST_RADIUS_TRIALS):
        last, is_last = outer, radius <= smallest
        errors = jet_errors(sea, radius, RINGS[-1:], worst)
        is_all = isinstance(worst, slice)
        if not is_all and (SAFETY * errors.max() <= tolerance or is_last):
            errors, is_all = jet_errors(sea, radius, RINGS[-1:]), True
        if is_all:
            worst = np.argsort(errors)[-(errors.size // WORST_PART) :]
        error = outer = SAFETY * float(errors.max())
        if error <= tolerance or is_last:
            inner = jet_errors(sea, radius, RINGS[:-1], worst)
            error = max(outer, SAFETY * float(inner.max()))
        if error <= tolerance:
            good, kept = radius, error
        else:
            bad = radius
        if good >= largest or (is_last and not good):
            break
        # the error goes as radius^4 where it is small; 0.99 lets the next radius pass
        if good:
            radius = min(0.99 * good * (tolerance / kept) ** 0.25, np.sqrt(good * bad))
            if radius < EQUAL_RADIUS_RATIO * good:
                break
        else:
            shrunk = 0.99 * (tolerance / error) ** 0.25
            shrunk = shrunk if outer < EQUAL_ERROR_RATIO * last else min(shrunk, 0.5)
            radius = max(radius * shrunk, smallest)
    return (good, kept) if good else (radius, error)


def jet_tolerance(sea: Sea, radius: float, squeeze: float = 0.0) -> float:
    """Tolerance [m] that the fitted jets of a sea keep over patches of a radius [m]."""
    return SAFETY * float(jet_errors(sea, radius, RINGS, squeeze=squeeze).max())


def jet_errors(
    sea: Sea, radius: float, rings: Sequence[float], chosen: Chosen = slice(None),
    squeeze: float = 0.0,
) -> Array:  # fmt: skip
    """Largest errors (N,) [m] of the fitted jets of a sea over patches of a radius [m], at the
    chosen samples, on rings at distances in radii."""
    find_errors = surface_errors if sea.pressure == "hydrostatic" else head_errors
    return find_errors(
        sea, jet_waves(sea, radius), (1.0 + CENTRE_SHIFT_RADII) * radius, rings, chosen, squeeze
    )


def best_squeeze(sea: Sea, radius: float) -> tuple[float, float]:
    """The limit of J among SQUEEZES with which fitted jets of a sea over patches of a radius [m]
    keep the smallest tolerance, and that tolerance [m]."""

    def largest(squeeze: float) -> float:
        return float(jet_errors(sea, radius, RINGS[-1:], squeeze=squeeze).max())

    best = min(SQUEEZES, key=largest)
    return best, jet_tolerance(sea, radius, best)


def jets_of(sea: Sea, waves: Table, x: Array, y: Array, squeeze: float = 0.0) -> Table:
    """JETs (N,) at the points x, y: (N,) [m], of the sea's own waves or fitted ones. squeeze: as in
    `jets.solve_jets`."""
    jets, time, tolerance = np.empty(x.size, JET), sea.ramp, float(sea.water["tolerance"][0])
    near = near_particles(x, y, waves, time, 1, tolerance)
    solve_jets(x, y, near, waves, time, tolerance, squeeze, jets)
    return jets


def surface_errors(
    sea: Sea, waves: Table, radius: float, rings: Sequence[float] = RINGS,
    chosen: Chosen = slice(None), squeeze: float = 0.0,
) -> Array:  # fmt: skip
    """Largest errors (N,) [m] of the surface's jets of fitted waves, at the chosen samples, on
    rings around them at distances in units of the radius [m]."""
    x, y = (axis[chosen] for axis in sample_places(sea))
    jets = fields_of(jets_of(sea, waves, x, y, squeeze), SURFACE_TERMS)
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    worst = np.zeros(x.size)
    for ring, angle in product(rings, angles):
        dx, dy = ring * radius * np.cos(angle), ring * radius * np.sin(angle)
        found = sea.elevation(x + dx, y + dy, sea.ramp) - still(sea)
        said = taylor_weights(SURFACE_TERMS, {"x": dx, "y": dy}) @ jets
        worst = np.maximum(worst, np.abs(found - said))
    return worst


def head_jets(
    sea: Sea, waves: Table, x: Array, y: Array, above: Array, squeeze: float, is_rough: bool
) -> Array:
    """HEAD_TERMS (T, N) of the head at the points x, y with heights `above` the level, all (N,)
    [m], of the sea's own waves or fitted ones. squeeze: as in `jets.solve_jets`; is_rough: whether
    sums over many waves may be in single precision."""
    jets, time = np.empty(-(-x.size // CHUNK), HEAD_JETS), sea.ramp
    tolerance = float(sea.water["tolerance"][0])
    near = near_particles(x, y, waves, time, 1, tolerance)
    is_rough = is_rough and waves.size >= MANY_WAVES
    solve = solve_many_head_jets if is_rough else solve_head_jets
    solve(x, y, above, near, waves, time, tolerance, squeeze, jets)
    return np.stack([jets[name].ravel()[: x.size] for name in HEAD_TERMS])


def head_errors(
    sea: Sea, waves: Table, radius: float, rings: Sequence[float] = RINGS,
    chosen: Chosen = slice(None), squeeze: float = 0.0,
) -> Array:  # fmt: skip
    """Largest errors (N,) [m] of the head's jets of fitted waves, as in `surface_errors`, at the
    chosen samples and from two radii below to 0.7 radii above them, but not below the bottom. Above
    the water, only a positive head counts as an error."""
    x, y = sample_places(sea)
    share = np.resize(np.linspace(-2.0, 1.0, 7), x.size)[chosen]
    x, y = x[chosen], y[chosen]
    above = sea.elevation(x, y, sea.ramp) - still(sea) + radius * np.minimum(share, 0.0)
    above += 0.7 * radius * np.maximum(share, 0.0)
    above = np.maximum(above, -sea.depth)
    jets = partial(head_jets, sea, waves, x, y, above, squeeze)
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return _missed(sea, jets, (x, y, above), radius, product(rings, angles, DIP_ANGLES))


def _missed(
    sea: Sea, jets: Callable[[bool], Array], places: tuple[Array, Array, Array], radius: float,
    around: Iterable[tuple[float, float, float]],
) -> Array:  # fmt: skip
    """Largest errors (N,) [m] of jets (T, N), rough or not, at places x, y and `above` the level,
    all (N,) [m], at points around them: a distance in radii, a direction and a dip [rad]."""
    around = list(around)
    steps, round_off = rough_steps(sea)
    if steps < PLAIN_STEPS:
        worst = _missed_of(rough_heads(sea, steps), sea, jets(True), places, radius, around)
        if worst.max(initial=0.0) > round_off:
            return worst
    return _missed_of(true_heads(sea), sea, jets(False), places, radius, around)


def _missed_of(
    heads: Heads, sea: Sea, jets: Array, places: tuple[Array, Array, Array], radius: float,
    around: Sequence[tuple[float, float, float]],
) -> Array:  # fmt: skip
    x, y, above = places
    worst = np.zeros(x.size)
    for ring, angle, dip in around:
        dx, dy = (ring * radius * np.cos(dip) * f(angle) for f in (np.cos, np.sin))
        dz = ring * radius * np.sin(dip)
        found = heads(x + dx, y + dy, above + dz)
        said = taylor_weights(HEAD_TERMS, {"x": dx, "y": dy, "z": dz}) @ jets
        missed = np.where(found >= 0.0, np.abs(found - said), np.maximum(said, 0.0))
        missed[above + dz < -sea.depth] = 0.0
        worst = np.maximum(worst, missed)
    return worst


def true_heads(sea: Sea) -> Heads:
    """The heads of a sea at x, y and heights above the level."""
    return lambda x, y, above: sea.head(x, y, still(sea) + above, sea.ramp)


def rough_heads(sea: Sea, steps: int) -> Heads:
    """The heads in single precision after a number of Newton steps."""

    def heads(x: Array, y: Array, above: Array) -> Array:
        found = np.empty(x.size)
        solve_many_heads(x, y, above, sea.components, sea.ramp, np.int64(steps), found)
        return found

    return heads


@lru_cache(maxsize=2)
def rough_steps(sea: Sea) -> tuple[int, float]:
    """Number of Newton steps to rough heads, and the smallest error of jets [m] that they judge.
    PLAIN_STEPS where true heads are needed, or cost no more."""
    amplitude = float(sea.water["amplitude"][0])
    is_many = len(sea.components) >= MANY_WAVES and sea.pressure != "hydrostatic"
    steps = newton_steps(sea, ROUGH_ERROR * amplitude)[0] if is_many else PLAIN_STEPS
    return steps, ROUGH_SHARE * amplitude


def deep_levels(
    sea: Sea, radius: float, tolerance: float, reach: float, deepest: tuple[float, float],
    squeeze: float,
) -> tuple[Level, ...]:  # fmt: skip
    """Levels of larger patches, which keep a tolerance [m] from some depth on, because short waves
    do not reach that far down.

    radius [m]: of the patches at the surface; reach [m]: radius of a patch with the whole hull;
    deepest [m]: depths from which the first level, and from which any other, is of no use; squeeze:
    as in `jets.solve_jets`.
    """
    if sea.pressure == "hydrostatic" or not sea.components.size or radius >= reach:
        return ()
    x, y = sample_places(sea)
    trough = SAFETY * float(np.abs(sea.elevation(x, y, sea.ramp) - still(sea)).max())
    missed, levels, depth = _missed_estimate(sea, radius, radius), [], 0.0
    smallest = radius
    while radius < reach and len(levels) < MOST_LEVELS:
        radius = min(LEVEL_RATIO * radius, reach)
        kept = tolerance * smallest / radius
        depth = max(depth, trough + (1.0 + CENTRE_SHIFT_RADII) * radius)
        limit = deepest[1] if levels else deepest[0]
        while depth <= limit and _missed_estimate(sea, radius, depth) > missed * kept / tolerance:
            depth *= DEPTH_STEP
        while depth <= limit:
            level = _level_at(sea, radius, depth, kept)
            if SAFETY * _deep_error(sea, level, squeeze) <= kept:
                break
            depth *= DEPTH_STEP
        if depth > limit:
            break
        levels.append(level)
    return tuple(levels)


def _missed_estimate(sea: Sea, radius: float, depth: float) -> float:
    """Estimate [m] of what the best cubics over patches of a radius [m], at a depth [m] of their
    centres, miss of the waves, each by itself: (k radius)^4 / 192 of its amplitude, at most all."""
    k, a = sea.components["wavenumber"], sea.components["amplitude"]
    shares = np.minimum((k * radius) ** 4 / 192.0, 1.0)
    return float(np.linalg.norm(a * shares * np.exp(-k * max(depth - radius, 0.0))))


def _level_at(sea: Sea, radius: float, depth: float, tolerance: float) -> Level:
    """A level of patches, without the waves that do not reach them."""
    k, a = sea.components["wavenumber"], sea.components["amplitude"]
    order = np.argsort(-k)
    left = np.cumsum((a * np.exp(-k * (depth - radius)))[order])
    out = order[left <= LEFT_OUT_SHARE * tolerance]
    sunk = 0.5 * (a * sea.components["ka"] * sea.components["stretch"])[out].sum()
    kept = np.setdiff1d(np.arange(k.size), out)
    return Level(radius, depth, float(sunk), read_only(jet_waves(sea, radius)[kept]))


def _deep_error(sea: Sea, level: Level, squeeze: float) -> float:
    """Largest error [m] of the head's jets of a level, at some of the samples, on the rims of
    patches whose centres are at the depth of the level."""
    x, y = (axis[::DEEP_STRIDE] for axis in sample_places(sea))
    above, radius = np.full(x.size, -level.depth), (1.0 + CENTRE_SHIFT_RADII) * level.radius

    def jets(is_rough: bool) -> Array:
        if level.waves.size:
            found = head_jets(sea, level.waves, x, y, above, squeeze, is_rough)
        else:
            found, names = np.zeros((len(HEAD_TERMS), x.size)), list(HEAD_TERMS)
            found[names.index("h")], found[names.index("z")] = level.depth, -1.0
        found[0] -= level.sunk
        return found

    angles = 2.0 * np.pi * np.arange(0, DIRECTIONS, 2) / DIRECTIONS
    around = product(RINGS[-1:], angles, np.radians([-45.0, 0.0, 45.0]))
    return float(_missed(sea, jets, (x, y, above), radius, around).max())


def fields_of(jets: Table, terms: Mapping[str, str]) -> Array:
    """Fields (T, N) of jets (N,), in the order of the terms."""
    return np.stack([jets[name] for name in terms])


def taylor_weights(terms: Mapping[str, str], step: Mapping[str, float]) -> Array:
    """Weights (T,) of the terms in a Taylor series over a step [m] along each axis. A term is given
    by the axes of its derivative."""
    powers, divisors = _powers(tuple(terms.values()), "".join(step))
    return (np.array([*step.values()]) ** powers).prod(axis=1) / divisors


@cache
def _powers(terms: tuple[str, ...], axes: str) -> tuple[Array, Array]:
    """Powers (T, A) of steps along axes in the terms of a Taylor series, and what they are divided
    by (T,)."""
    powers = np.array([[term.count(axis) for axis in axes] for term in terms])
    return powers, np.array([prod(map(factorial, row)) for row in powers.tolist()])


def longest_edge(sea: Sea, waves: Table, tolerance: float, squeeze: float = 0.0) -> float:
    """Edge [m] of a triangle up to which linear interpolation of the heads from jets of fitted
    waves is within the tolerance [m].

    Linear interpolation within a circle of radius r has an error of at most M r^2 / 2, where M is
    the largest second derivative, and r is at most the edge over the root of 3.
    """
    bend = largest_bend(sea, waves, squeeze)
    return float(np.sqrt(6.0 * tolerance / bend)) if bend > 0.0 else np.inf


def edge_tolerance(sea: Sea, waves: Table, edge: float, squeeze: float = 0.0) -> float:
    """Error [m] of linear interpolation of the heads from jets over triangles with an edge [m]."""
    return largest_bend(sea, waves, squeeze) * edge**2 / 6.0


def largest_bend(sea: Sea, waves: Table, squeeze: float) -> float:
    """Largest second derivative [1/m] of the head from jets of fitted waves, in any direction, at
    the samples, times SAFETY; 0 without waves."""
    if not waves.size:
        return 0.0
    x, y = sample_places(sea)
    if sea.pressure == "hydrostatic":
        jets = jets_of(sea, waves, x, y, squeeze)
        names, axes = ("z_xx", "z_xy", "z_xy", "z_yy"), 2
    else:
        above = sea.elevation(x, y, sea.ramp) - still(sea)
        terms = head_jets(sea, waves, x, y, above, squeeze, is_rough=False)
        jets = dict(zip(HEAD_TERMS, terms, strict=True))
        names, axes = ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz"), 3
    hessians = np.stack([jets[n] for n in names], axis=-1).reshape(-1, axes, axes)
    return SAFETY * float(np.abs(np.linalg.eigvalsh(hessians)).max())


def steepest_slope(sea: Sea) -> float:
    """Largest slope [m/m] of the surface at the samples, times SAFETY; 0 without waves."""
    if not sea.components.size:
        return 0.0
    jets = jets_of(sea, sea.components, *sample_places(sea))
    return SAFETY * float(np.hypot(jets["z_x"], jets["z_y"]).max())
