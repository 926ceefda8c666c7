"""Ship: the cost of a hull of a ship's size in irregular seas of many waves.

The hull is Wigley's form, stretched to the size of a destroyer (DTMB 5415: 142 m long, 19 m wide,
draught 6.15 m). In hundreds of waves each patch takes hundreds of sines.
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

FEWEST_FACES = 20_000
"""The ship's triangles are divided until there are at least this many."""

PEAK_PERIOD = 9.0
"""Peak period [s] of the seas."""

POSE_COUNT = 20

TRUTH_SUBDIVISIONS = 2
"""Times that each triangle is divided into four for the true wrenches, which `Linear` computes: its
error falls to a sixteenth. (`Reference` would take minutes.)"""


def ship(mesh: trimesh.Trimesh) -> Hull:
    """A mesh, stretched to the ship's size and divided into fine triangles."""
    mesh = trimesh.Trimesh(mesh.vertices * (SIZE / mesh.extents), mesh.faces, process=False)
    while len(mesh.faces) < FEWEST_FACES:
        mesh = mesh.subdivide()
    return Hull.from_trimesh(mesh)


def finer(hull: Hull) -> Hull:
    """The same surface with the triangles that the true wrenches need."""
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    return Hull.from_trimesh(mesh.subdivide(iterations=TRUTH_SUBDIVISIONS))


def ship_poses(count: int, seed: int = 0) -> list[Pose]:
    """Random poses afloat: up to 1 m of heave and a few degrees of roll and pitch."""
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
    """Yield a row per JONSWAP sea, for each count of waves and each significant height [m].

    A row holds the seconds of preparation, the number of patches and their tolerance [m],
    microseconds per wrench of patches and of linear, and the largest force error of patches. Timing
    takes about `seconds` per sea.
    """
    hull, poses = ship(mesh), ship_poses(POSE_COUNT)
    fine = finer(hull)
    for count in counts:
        for height in heights:
            sea = Sea.jonswap(height, PEAK_PERIOD, waves=count, seed=1)
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
