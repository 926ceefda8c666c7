"""Random cases: hulls and seas that nobody chose, for claims that are to hold for all.

Boxes, cylinders, capsules and ellipsoids from 0.1 to 100 m long, half of them as flat or as slender
as 300 to 1; seas of one to three waves or with a spectrum, from a tenth of the hull's length to
thirty times it, up to a steepness of 0.8.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.accuracy import errors, wrenches
from benchmarks.seas import Pose, steepened, waterline_poses
from sim.hulls.hull import Hull
from sim.methods import Patches, Reference
from sim.water.sea import Sea
from sim.water.wave import Wave

TRUTH = 1e-6
"""Tolerance of the reference, of density * gravity * volume."""

POSES = 4
"""At the waterline, of each case."""

STEEPEST = 0.8
"""Sum of k a up to which seas of a few waves are drawn."""


@dataclass(frozen=True)
class RandomCase:
    """A hull in a sea at the default tolerance: seconds that it took to be ready, its patches, the
    tolerance that is kept [m], whether that is coarser than the default one, and the largest force
    error at POSES, of density * gravity * volume."""

    name: str
    seconds: float
    patches: int
    tolerance: float
    is_coarse: bool
    error: float


def random_hull(rng: np.random.Generator) -> tuple[str, Hull]:
    """A hull and what it is."""
    length = 10.0 ** rng.uniform(-1.0, 2.0)
    thinnest = -2.5 if rng.random() < 0.5 else -0.7
    extents = length * np.array([1.0, *10.0 ** rng.uniform(thinnest, 0.0, 2)])
    kinds = {
        "box": trimesh.creation.box,
        "cylinder": lambda: trimesh.creation.cylinder(0.5, 1.0, sections=24),
        "capsule": lambda: trimesh.creation.capsule(1.0, 0.5),
        "ellipsoid": lambda: trimesh.creation.icosphere(int(rng.integers(2, 5))),
    }
    kind = str(rng.choice(list(kinds)))
    mesh = kinds[kind]()
    vertices = np.roll(mesh.vertices, 1, axis=1)  # axes of cylinders along x
    vertices = vertices * (extents / np.ptp(vertices, axis=0))
    shape = " x ".join(f"{side:.3g}" for side in extents)
    return f"{kind} {shape} m", Hull(vertices, mesh.faces)


def random_sea(rng: np.random.Generator, length: float) -> Sea:
    """A sea for a hull of a length [m]."""
    longest = length * 10.0 ** rng.uniform(-1.0, 1.5)
    if rng.random() < 0.3:
        height = longest * rng.uniform(0.003, 0.015)
        period = np.sqrt(2.0 * np.pi * longest / 9.81)
        return Sea.jonswap(height, period, waves=20, seed=int(rng.integers(1000)))
    waves = [
        Wave(size * reach, reach, *rng.uniform(0.0, 2.0 * np.pi, 2))
        for size, reach in zip(
            rng.uniform(0.2, 1.0, 3), longest * rng.uniform(0.3, 1.0, 3), strict=True
        )
    ][: int(rng.integers(1, 4))]
    return steepened(waves, float(rng.uniform(0.03, STEEPEST)))


def random_cases(count: int, seed: int = 0, truth: float = TRUTH) -> Iterator[RandomCase]:
    """So many cases, as they are done, the same ones for the same seed; truth: the reference's
    tolerance, of density * gravity * volume."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name, hull = random_hull(rng)
        sea = random_sea(rng, float(np.ptp(hull.bounds, axis=0).max()))
        started = perf_counter()
        method = Patches(hull, sea)
        seconds = perf_counter() - started
        poses = waterline_poses(hull, sea, POSES, number)
        right = _truth(hull, sea, poses, truth)
        found = errors(wrenches(method, poses), right, method)
        waves = f"{len(sea.waves)} waves from {sea.waves[0].wavelength:.3g} m, {sea.steepness:.2f}"
        yield RandomCase(
            f"{name}; {waves}",
            seconds,
            len(method.tree.patches),
            method.tolerance,
            method.is_coarse,
            found.force_max,
        )


def _truth(hull: Hull, sea: Sea, poses: Sequence[Pose], tolerance: float) -> NDArray[np.float64]:
    """The reference's wrenches (N, 6), to ten or a hundred times the tolerance where it cannot be
    reached, next to crests that all but fold; NaN where that cannot be, either."""
    for larger in (1.0, 10.0, 100.0):
        try:
            return wrenches(Reference(hull, sea, larger * tolerance), poses)
        except RuntimeError:
            continue
    return np.full((len(poses), 6), np.nan)
