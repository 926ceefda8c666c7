"""Ship: the cost of large hulls in irregular seas of many waves.

The ship is Wigley's form, stretched to the size of a destroyer (DTMB 5415: 142 m long, 19 m wide,
draught 6.15 m). In hundreds of waves each patch takes hundreds of sines. Two hulls reach far down,
where only long waves are left: a bunny of 100 m and a semi-submersible.
"""

from collections.abc import Iterator, Sequence
from itertools import product
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


def tall_hulls(mesh: trimesh.Trimesh) -> dict[str, Hull]:
    """A mesh, scaled to a length of 100 m and centred 10 m below the water, and a semi-submersible:
    two pontoons under four columns, with a draught of 20 m."""
    scaled = trimesh.Trimesh(mesh.vertices * (100.0 / mesh.extents.max()), mesh.faces)
    scaled.apply_translation(-scaled.center_mass - [0.0, 0.0, 10.0])
    boxes = []
    for side in (-30.0, 30.0):
        boxes.append(_box((100.0, 15.0, 10.0), (0.0, side, -15.0)))
        boxes += [_box((12.0, 12.0, 35.0), (along, side, 5.0)) for along in (-35.0, 35.0)]
    platform = trimesh.boolean.union(boxes, engine="manifold")
    while len(platform.faces) < FEWEST_FACES // 4:
        platform = platform.subdivide()
    return {"bunny of 100 m": Hull.from_trimesh(scaled), "platform": Hull.from_trimesh(platform)}


def _box(size: tuple[float, ...], centre: tuple[float, ...]) -> trimesh.Trimesh:
    found = trimesh.creation.box(size)
    found.apply_translation(centre)
    return found


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
    hull: Hull, counts: Sequence[int], heights: Sequence[float], seconds: float,
    tolerances: Sequence[float | None] = (None,),
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Yield a row per JONSWAP sea, for each count of waves and each significant height [m], and per
    tolerance [m] of patches.

    A row holds the seconds of preparation, the number of patches and their tolerance [m],
    microseconds per wrench of patches and of linear, and the largest force errors of both. Timing
    takes about `seconds` per sea.
    """
    poses, fine = ship_poses(POSE_COUNT), finer(hull)
    for count, height, tolerance in product(counts, heights, tolerances):
        sea = Sea.jonswap(height, PEAK_PERIOD, waves=count, seed=1)
        started = perf_counter()
        patches = Patches(hull, sea, tolerance)
        ready = perf_counter() - started
        times = 1e6 * time_in_turns([Linear(hull, sea), patches], poses, seconds)
        linear_us, us = times.min(axis=0).mean(axis=1)
        truth = wrenches(Linear(fine, sea), poses)
        linear = wrenches(Linear(hull, sea), poses)
        yield {
            "waves": count, "height": height, "ready_s": ready,
            "patches": len(patches.tree.patches), "tolerance": patches.tolerance,
            "us": float(us), "linear_us": float(linear_us),
            "force_max": errors(wrenches(patches, poses), truth, patches).force_max,
            "linear_force_max": errors(linear, truth, patches).force_max,
        }  # fmt: skip
