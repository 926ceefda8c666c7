"""Random cases: random hulls in random seas, for claims that must hold for every hull and sea.

The hulls are boxes, cylinders, capsules and ellipsoids, 0.1 to 100 m long; half of them may be up
to 300 times as long as they are wide or high. The seas have one to three waves or a spectrum. The
waves are 0.1 to 30 times as long as the hull and have a steepness of at most 0.8.
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

REFERENCE_TOLERANCE = 1e-6
"""Tolerance of the reference, a share of density * gravity * volume."""

POSES_PER_CASE = 4
"""Poses at the waterline in which each case is tried."""

LARGEST_STEEPNESS = 0.8
"""Largest sum of k a of a random sea of one to three waves."""


@dataclass(frozen=True)
class RandomCase:
    """A hull in a sea at the default tolerance.

    seconds: time that the preparation took. patches: number of patches. tolerance [m]: the one
    that was kept. is_coarse: whether it is coarser than the default. error: largest force error
    over POSES_PER_CASE poses, a share of density * gravity * volume.
    """

    name: str
    seconds: float
    patches: int
    tolerance: float
    is_coarse: bool
    error: float


def random_hull(rng: np.random.Generator) -> tuple[str, Hull]:
    """A description of a random hull, and the hull."""
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
    vertices = np.roll(mesh.vertices, 1, axis=1)  # cylinders lie along x
    vertices = vertices * (extents / np.ptp(vertices, axis=0))
    shape = " x ".join(f"{side:.3g}" for side in extents)
    return f"{kind} {shape} m", Hull(vertices, mesh.faces)


def random_sea(rng: np.random.Generator, length: float) -> Sea:
    """A random sea for a hull of a length [m]."""
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
    return steepened(waves, float(rng.uniform(0.03, LARGEST_STEEPNESS)))


def random_cases(
    count: int, seed: int = 0, truth: float = REFERENCE_TOLERANCE
) -> Iterator[RandomCase]:
    """Yield `count` cases as they are finished; the seed determines them.

    truth: tolerance of the reference, a share of density * gravity * volume.
    """
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        name, hull = random_hull(rng)
        sea = random_sea(rng, float(np.ptp(hull.bounds, axis=0).max()))
        started = perf_counter()
        method = Patches(hull, sea)
        seconds = perf_counter() - started
        poses = waterline_poses(hull, sea, POSES_PER_CASE, number)
        true_wrenches = _true_wrenches(hull, sea, poses, truth)
        found = errors(wrenches(method, poses), true_wrenches, method)
        waves = f"{len(sea.waves)} waves from {sea.waves[0].wavelength:.3g} m, {sea.steepness:.2f}"
        yield RandomCase(
            f"{name}; {waves}",
            seconds,
            len(method.tree.patches),
            method.tolerance,
            method.is_coarse,
            found.force_max,
        )


def _true_wrenches(
    hull: Hull, sea: Sea, poses: Sequence[Pose], tolerance: float
) -> NDArray[np.float64]:
    """The reference's wrenches (N, 6). Where it does not converge, next to crests that nearly fold,
    the tolerance is 10 or 100 times as large. NaN where that fails, too."""
    for factor in (1.0, 10.0, 100.0):
        try:
            return wrenches(Reference(hull, sea, factor * tolerance), poses)
        except RuntimeError:
            continue
    return np.full((len(poses), 6), np.nan)
