"""Ship: what a hull of a ship's size costs in irregular seas of many waves.

The hull is Wigley's form, stretched to the size of a destroyer (DTMB 5415: 142 m long, 19 m wide,
draught 6.15 m). Where hundreds of waves meet, each patch costs hundreds of sines.
"""

from collections.abc import Iterator, Sequence
from time import perf_counter
from typing import Any

import numpy as np
import trimesh

from benchmarks.accuracy import errors, time_in_turns, wrenches
from benchmarks.seas import Pose
from sim.geometry import rotation_about
from sim.hulls.hull import Hull
from sim.methods import Linear, Patches
from sim.water.sea import Sea

SIZE = (142.0, 19.0, 12.3)
"""Length, beam and depth [m] of the ship."""

FACES = 20_000
"""Its triangles are halved until there are more."""

PERIOD = 9.0
"""Peak period [s] of the seas."""

POSES = 20

FINER = 2
"""Times that the triangles are halved again, each into four, for the truth: linear's error falls to
a sixteenth. (`Reference` would take minutes for it.)"""


def ship(mesh: trimesh.Trimesh) -> Hull:
    """A mesh stretched to the ship's size, in fine triangles."""
    mesh = trimesh.Trimesh(mesh.vertices * (SIZE / mesh.extents), mesh.faces, process=False)
    while len(mesh.faces) < FACES:
        mesh = mesh.subdivide()
    return Hull.from_trimesh(mesh)


def finer(hull: Hull) -> Hull:
    """The same surface in FINER triangles."""
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    return Hull.from_trimesh(mesh.subdivide(iterations=FINER))


def ship_poses(count: int, seed: int = 0) -> list[Pose]:
    """Afloat: heave within a metre, roll and pitch of some degrees, any place and time."""
    rng = np.random.default_rng(seed)
    return [
        (
            rng.uniform([-50.0, -50.0, -1.0], [50.0, 50.0, 1.0]),
            rotation_about(rng.uniform([-0.15, -0.03, 0.0], [0.15, 0.03, 0.0])),
            float(rng.uniform(0.0, 1000.0)),
        )
        for _ in range(count)
    ]


def ship_costs(
    mesh: trimesh.Trimesh, counts: Sequence[int], heights: Sequence[float], seconds: float
) -> Iterator[dict[str, Any]]:
    """For JONSWAP seas of such counts of waves and significant heights [m]: seconds to be ready,
    patches and their tolerance, microseconds a wrench beside linear's, and the largest force
    error, all at the default tolerance."""
    hull, poses = ship(mesh), ship_poses(POSES)
    fine = finer(hull)
    for count in counts:
        for height in heights:
            sea = Sea.jonswap(height, PERIOD, waves=count, seed=1)
            started = perf_counter()
            patches = Patches(hull, sea)
            ready = perf_counter() - started
            times = 1e6 * time_in_turns([Linear(hull, sea), patches], poses, seconds)
            linear_us, us = times.min(axis=0).mean(axis=1)
            truth = wrenches(Linear(fine, sea), poses)
            yield {
                "waves": count, "height": height, "ready_s": ready,
                "patches": len(patches.tree.patches), "tolerance": patches.tolerance,
                "us": float(us), "linear_us": float(linear_us),
                "force_max": errors(wrenches(patches, poses), truth, patches).force_max,
            }  # fmt: skip
