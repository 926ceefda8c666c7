"""Loading: how long a hull takes to be ready, and how much memory."""

from collections.abc import Iterator
from resource import RUSAGE_SELF, getrusage
from time import perf_counter
from typing import Any

import trimesh

from sim.hulls.hull import Hull
from sim.methods import Patches
from sim.water.sea import Sea

FINER = 10.0
"""By which the default tolerance is divided for the last column."""


def loading_times(mesh: trimesh.Trimesh, sea: Sea, halvings: int) -> Iterator[dict[str, Any]]:
    """For a mesh and what it becomes with each triangle made four, so many times: seconds for the
    hull's checks, for patches at the default tolerance and a tenth of it, and the process's largest
    memory [MB] so far. Kernels are compiled before."""
    small = trimesh.creation.box()
    Patches(Hull(small.vertices, small.faces), sea)
    for _ in range(halvings + 1):
        started = perf_counter()
        hull = Hull(mesh.vertices, mesh.faces)
        checked = perf_counter()
        patches = Patches(hull, sea)
        done = perf_counter()
        memory = getrusage(RUSAGE_SELF).ru_maxrss / 1024.0
        Patches(hull, sea, patches.tolerance / FINER)
        yield {
            "faces": len(hull.faces), "hull_s": checked - started, "patches_s": done - checked,
            "finer_s": perf_counter() - done, "memory_mb": memory,
        }  # fmt: skip
        mesh = mesh.subdivide()
