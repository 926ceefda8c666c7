"""Fit: how few points of a sea have to be solved, for what error.

Numbers that have no useful bound, such as over what distance a jet holds, are found on samples of
the sea (see `water.samples`). Where many waves would have to conspire, bounds are several times too
careful.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from math import factorial, prod

import numpy as np
from numpy.typing import NDArray

from sim.kernels import read_only
from sim.water.head_jets import HEAD_JET, solve_head_jets
from sim.water.jets import JET, near_particles, solve_jets
from sim.water.samples import SAFETY, sample_places, still
from sim.water.sea import Sea

Array = NDArray[np.float64]
Table = NDArray[np.void]

DISC, DECAYING_DISC = 0.65, 0.3
"""Jets are fitted over a disc of so many radii of the largest patch allowed: seen from above, most
of a patch is near its middle. The wrench's errors were smallest so, among 0.4 to 1.1 for
hydrostatic pressure and 0 to 1 for one that decays: that is nearly a harmonic function, of which
Taylor's cubic is the best one over a ball."""

WIDE = 3.0
"""Radii of a patch over a wavelength, times 2 pi, above which a wave is fitted over all of it: no
cubic follows it, and one that fits its middle would be far off at the rim."""

DIRECTIONS, RINGS = 8, (0.25, 0.5, 0.75, 1.0)
"""Directions and distances, in radii, in which jets are tried on the samples of the sea."""

DIPS = tuple(np.radians([-90.0, -45.0, 0.0, 45.0]))
"""Slopes of these directions, where jets are tried below the surface."""

SURFACE_TERMS = {name: name[2:] for name in JET.names if name[0] == "z"}
HEAD_TERMS = {name: name.replace("h", "") for name in HEAD_JET.names}
"""Fields of jets, and the axes of the derivatives that they are."""

MOST_TURNS = 1000.0
"""Radii of a disc over a wavelength, times 2 pi, above which a fit takes them for so many."""

RADII = 40
"""Radii that are tried at most: a tolerance near round-off is met by none."""

NO_LESS, NO_MORE = 0.9, 1.05
"""An error is as large as another of which it is so much: waves that are shorter than patches are
missed as a whole, however large these are, and radii are halved until they are longer. And a radius
is as small as another over which it is so much, where that was halved too often."""

SHIFT = 0.05
"""A jet may come from a particle so many radii away from the patch's centre: the solve for it then
ends early, and patches are by that much smaller."""


def fitted_waves(sea: Sea, radius: float | Array) -> Table:
    """Components whose jets are cubics that fit best over a disc of a radius [m], or of one for
    each wave, instead of Taylor's, which are best in its centre and several times worse at its rim.

    Along its direction each wave is replaced by the cubic next to it in the mean square over
    the disc. With s the place over the radius and u = k radius that is

        cos(u s) ~ b0 + b2 (4 s^2 - 1),        sin(u s) ~ 2 b1 s + b3 (8 s^3 - 4 s),

    Chebyshev's polynomials of the second kind, whose weight is that of a disc seen from the
    side; value and derivatives in the centre follow (economised series: Lanczos 1938).
    Products of waves stay Taylor's. Slopes and offsets are changed so much alike that a
    label's Newton steps still shrink the residual, by a third or more, in any sea.
    """
    fitted = sea.components.copy()
    # beyond MOST_TURNS the coefficients are below 1e-4 of the amplitude: the disc averages it out
    u = np.minimum(fitted["wavenumber"] * radius, MOST_TURNS)[:, None]
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
    """The fitted components of which jets over patches of a radius [m] are made."""
    share = DISC if sea.pressure == "hydrostatic" else DECAYING_DISC
    is_short = sea.components["wavenumber"] * radius > WIDE
    return fitted_waves(sea, radius * np.where(is_short, 1.0, share))


def jet_radius(
    sea: Sea, tolerance: float, largest: float, smallest: float = 0.0
) -> tuple[float, float]:
    """Radius [m] up to which a fitted jet of the sea is right to the tolerance [m], from `largest`
    to `smallest` [m], and what is kept there [m]: more than the tolerance at the smallest where no
    radius will do. inf and 0 on flat water.

    A bound from the fourth derivatives would do as well, but where many waves would have to
    conspire it asks for several times too many patches. So jets are tried where particles
    are, all phases alike, and the worst error found, times SAFETY, has to pass: on the outermost
    ring, where it mostly is, and then on all.
    """
    if not sea.components.size:
        return np.inf, 0.0
    radius, error = largest, np.inf
    good, kept, bad = 0.0, np.inf, np.inf
    for _ in range(RADII):
        last, is_last = error, radius <= smallest
        error = jet_tolerance(sea, radius, RINGS[-1:])
        if error <= tolerance or is_last:
            error = jet_tolerance(sea, radius)
        if error <= tolerance:
            good, kept = radius, error
        else:
            bad = radius
        if good >= largest or (is_last and not good):
            break
        # error ~ radius^4 where it is small; a hair less, so that the next try passes
        if good:
            radius = min(0.99 * good * (tolerance / kept) ** 0.25, np.sqrt(good * bad))
            if radius < NO_MORE * good:
                break
        else:
            shrunk = 0.99 * (tolerance / error) ** 0.25
            shrunk = shrunk if error < NO_LESS * last else min(shrunk, 0.5)
            radius = max(radius * shrunk, smallest)
    return (good, kept) if good else (radius, error)


def jet_tolerance(sea: Sea, radius: float, rings: Sequence[float] = RINGS) -> float:
    """Tolerance [m] to which the fitted jets of a sea are right over patches of a radius [m], as
    far as rings of so many radii tell."""
    find_error = jet_error if sea.pressure == "hydrostatic" else head_jet_error
    return SAFETY * find_error(sea, jet_waves(sea, radius), (1.0 + SHIFT) * radius, rings)


def jets_of(sea: Sea, waves: Table, x: Array, y: Array) -> Table:
    """JETs (N,) of waves of a sea, its own or fitted ones, at places x, y: (N,) [m]."""
    jets, time = np.empty(x.size, JET), sea.ramp
    near = near_particles(x, y, waves, time, 1)
    solve_jets(x, y, near, waves, time, float(sea.water["tolerance"][0]), jets)
    return jets


def jet_error(sea: Sea, waves: Table, radius: float, rings: Sequence[float] = RINGS) -> float:
    """Largest error [m] of the surface's jets at the samples, of fitted waves, on rings of so many
    times a radius [m] around them."""
    x, y = sample_places(sea)
    jets = fields_of(jets_of(sea, waves, x, y), SURFACE_TERMS)
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    worst = 0.0
    for ring, angle in product(rings, angles):
        dx, dy = ring * radius * np.cos(angle), ring * radius * np.sin(angle)
        found = sea.elevation(x + dx, y + dy, sea.ramp) - still(sea)
        said = taylor_weights(SURFACE_TERMS, {"x": dx, "y": dy}) @ jets
        worst = max(worst, float(np.abs(found - said).max()))
    return worst


def head_jets(sea: Sea, waves: Table, x: Array, y: Array, above: Array) -> Table:
    """HEAD_JETs (N,) of waves of a sea, its own or fitted ones, at places x, y, so far
    above the level, all (N,) [m]."""
    jets, time = np.empty(x.size, HEAD_JET), sea.ramp
    near = near_particles(x, y, waves, time, 1)
    solve_head_jets(x, y, above, near, waves, time, float(sea.water["tolerance"][0]), jets)
    return jets


def head_jet_error(sea: Sea, waves: Table, radius: float, rings: Sequence[float] = RINGS) -> float:
    """The same of the head's jets, at the samples and up to two radii below and one above them.
    Above the water is no head to be right about, but what is there must not be taken to be below.
    """
    x, y = sample_places(sea)
    share = np.resize(np.linspace(-2.0, 1.0, 7), x.size)
    above = sea.elevation(x, y, sea.ramp) - still(sea) + radius * np.minimum(share, 0.0)
    above += 0.7 * radius * np.maximum(share, 0.0)
    jets = fields_of(head_jets(sea, waves, x, y, above), HEAD_TERMS)
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    worst = 0.0
    for ring, angle, dip in product(rings, angles, DIPS):
        dx, dy = (ring * radius * np.cos(dip) * f(angle) for f in (np.cos, np.sin))
        dz = ring * radius * np.sin(dip)
        found = sea.head(x + dx, y + dy, still(sea) + above + dz, sea.ramp)
        said = taylor_weights(HEAD_TERMS, {"x": dx, "y": dy, "z": dz}) @ jets
        missed = np.where(found >= 0.0, np.abs(found - said), np.maximum(said, 0.0))
        worst = max(worst, float(missed.max()))
    return worst


def fields_of(jets: Table, terms: Mapping[str, str]) -> Array:
    """Fields (T, N) of jets (N,), in the order of the terms."""
    return np.stack([jets[name] for name in terms])


def taylor_weights(terms: Mapping[str, str], step: Mapping[str, float]) -> Array:
    """Weights (T,) of terms, each a derivative along such axes, in a Taylor series over a step [m]
    along each axis."""
    return np.array(
        [prod(step[a] ** axes.count(a) / factorial(axes.count(a)) for a in step)
         for axes in terms.values()]
    )  # fmt: skip


def longest_edge(sea: Sea, waves: Table, tolerance: float) -> float:
    """Edge [m] up to which heads of jets of fitted waves, linear over a triangle, are right to the
    tolerance [m] of what the jets say.

    Linear interpolation within a circle of radius r misses M r^2 / 2, M being the largest second
    derivative, and r is at most the edge over the root of 3.
    """
    bend = largest_bend(sea, waves)
    return float(np.sqrt(6.0 * tolerance / bend)) if bend > 0.0 else np.inf


def edge_tolerance(sea: Sea, waves: Table, edge: float) -> float:
    """Tolerance [m] to which heads of jets are right, linear over triangles of an edge [m]."""
    return largest_bend(sea, waves) * edge**2 / 6.0


def largest_bend(sea: Sea, waves: Table) -> float:
    """Largest second derivative [1/m] of the head in any direction that jets of fitted waves have,
    at the samples, times SAFETY; 0 without waves."""
    if not waves.size:
        return 0.0
    x, y = sample_places(sea)
    if sea.pressure == "hydrostatic":
        jets = jets_of(sea, waves, x, y)
        names, axes = ("z_xx", "z_xy", "z_xy", "z_yy"), 2
    else:
        jets = head_jets(sea, waves, x, y, sea.elevation(x, y, sea.ramp) - still(sea))
        names, axes = ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz"), 3
    hessians = np.stack([jets[n] for n in names], axis=-1).reshape(-1, axes, axes)
    return SAFETY * float(np.abs(np.linalg.eigvalsh(hessians)).max())


def steepest_slope(sea: Sea) -> float:
    """Largest slope [m/m] of the surface at the samples, times SAFETY; 0 without waves."""
    if not sea.components.size:
        return 0.0
    jets = jets_of(sea, sea.components, *sample_places(sea))
    return SAFETY * float(np.hypot(jets["z_x"], jets["z_y"]).max())
