"""Loading: the time and the memory that it takes to prepare a hull."""

from collections.abc import Iterator
from resource import RUSAGE_SELF, getrusage
from time import perf_counter
from typing import Any

import trimesh

from sim.hulls.hull import Hull
from sim.methods import Patches
from sim.water.sea import Sea

TOLERANCE_DIVISOR = 10.0
"""The last column is measured at the default tolerance divided by this number."""


def loading_times(mesh: trimesh.Trimesh, sea: Sea, halvings: int) -> Iterator[dict[str, Any]]:
    """Yield a row for a mesh and for each of `halvings` subdivisions of it, which divide each
    triangle into four: seconds for the hull's checks and for patches at the default tolerance and
    at a tenth of it, and the largest memory [MB] of the process so far."""
    small = trimesh.creation.box()  # compiles the kernels
    Patches(Hull(small.vertices, small.faces), sea)
    for _ in range(halvings + 1):
        started = perf_counter()
        hull = Hull(mesh.vertices, mesh.faces)
        checked = perf_counter()
        patches = Patches(hull, sea)
        done = perf_counter()
        memory = getrusage(RUSAGE_SELF).ru_maxrss / 1024.0
        Patches(hull, sea, patches.tolerance / TOLERANCE_DIVISOR)
        yield {
            "faces": len(hull.faces), "hull_s": checked - started, "patches_s": done - checked,
            "finer_s": perf_counter() - done, "memory_mb": memory,
        }  # fmt: skip
        mesh = mesh.subdivide()
