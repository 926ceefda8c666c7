"""Sources: the errors that do not come from the method.

Each source of error is switched on alone and compared with the same computation without it: first
for wrenches at poses at the waterline, then for the path of a bunny dropped into three waves.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.accuracy import errors, wrenches
from benchmarks.customary import Customary
from benchmarks.seas import SEAS, Pose, steepened, waterline_poses
from sim.hulls.hull import Hull
from sim.methods import METHODS, Chord, Linear, Method, Reference, Settings
from sim.runs.simulation import simulate
from sim.scenes.scene import Scene
from sim.water.sea import Sea

FALL_TIME, DURATION = 3.0, 10.0  # [s]; after 3 s the bunny has fallen in and follows the waves
RATE = 50.0  # [Hz]
FINE_TIMESTEP = 1.25e-4  # [s], a sixteenth of the scene's timestep

LARGEST_STEEPNESS = 0.8
"""Sum of k a of the steepest sea in the table."""

CONVERGED_STEPS = 8
"""Newton steps after which the customary elevation has only round-off error in these seas."""

Report = dict[str, list[dict[str, Any]]]


def error_sources(bunny: Hull, scene: Path, pose_count: int, seed: int) -> Report:
    """Rows of two tables: wrench errors of a hull, and path errors of the scene's body with that
    hull."""
    seas = {name: SEAS[name].hydrostatic for name in ("three", "forty")}
    seas["three, steep"] = steepened(SEAS["three"].waves, LARGEST_STEEPNESS).hydrostatic
    wrench_rows = [
        {"sea": name, "waves": len(sea.waves), "steepness": sea.steepness} | row
        for name, sea in seas.items()
        for row in _wrench_rows(bunny, sea, waterline_poses(bunny, sea, pose_count, seed))
    ]
    return {"wrench": wrench_rows, "path": _path_rows(scene)}


def _refined(hull: Hull) -> Hull:
    """The same surface with 16 times as many faces."""
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    return Hull.from_trimesh(mesh.subdivide().subdivide())


def _wrench_rows(bunny: Hull, sea: Sea, poses: Sequence[Pose]) -> list[dict[str, Any]]:
    """Errors of the bunny's wrench in a sea, a row per source."""
    fine = _refined(bunny)
    exact = Customary(bunny, sea, CONVERGED_STEPS)
    single = Customary(bunny, sea, CONVERGED_STEPS, np.float32)
    pairs: dict[str, tuple[Method, Method]] = {
        "linear on 3,674 faces": (Linear(bunny, sea), Reference(bunny, sea, 1e-7)),
        "the same surface in 58,784 faces": (Linear(fine, sea), Reference(bunny, sea, 1e-7)),
        "chord:4 instead of linear": (Chord(bunny, sea), Linear(bunny, sea)),
    }
    for steps in (1, 2, 3, 4):
        name = f"{steps} Newton step{'s' * (steps > 1)} for an elevation"
        pairs[name] = (Customary(bunny, sea, steps), exact)
    pairs["single precision"] = (single, exact)
    decaying = sea.with_pressure("froude-krylov")
    pairs["hydrostatic instead of decaying pressure"] = (
        Reference(bunny, sea, 1e-6), Reference(bunny, decaying, 1e-6)
    )  # fmt: skip
    pairs["our elevation's tolerance and round-off"] = (Linear(bunny, sea), exact)
    rows = []
    for name, (method, other) in pairs.items():
        found = errors(wrenches(method, poses), wrenches(other, poses), method)
        rows.append({"source": name, "force_max": found.force_max, "force_rms": found.force_rms,
                     "torque_max": found.torque_max, "torque_rms": found.torque_rms})  # fmt: skip
    return rows


def _path_rows(scene: Path) -> list[dict[str, Any]]:
    """Errors of the height and tilt of the scene's bunny, until FALL_TIME and later."""
    plain = _path(scene, Linear)  # hydrostatic, like all runs but one
    true_time = _path(scene, Linear, FINE_TIMESTEP)
    cases = {
        "timestep 2 ms": (plain, true_time),
        "timestep 1 ms": (_path(scene, Linear, 1e-3), true_time),
        "timestep 0.5 ms": (_path(scene, Linear, 5e-4), true_time),
    }
    methods: dict[str, Callable[[Hull, Sea], Method]] = {
        "linear on 3,674 faces, not 58,784": lambda hull, sea: Linear(_refined(hull), sea),
        "chord:4 instead of linear": Chord,
        "2 Newton steps for an elevation": lambda hull, sea: Customary(hull, sea, 2),
        "single precision": lambda *given: Customary(*given, CONVERGED_STEPS, np.float32),
    }
    cases |= {name: (_path(scene, make), plain) for name, make in methods.items()}
    decaying = _path(scene, Linear, pressure="froude-krylov")
    cases["hydrostatic instead of decaying pressure"] = plain, decaying
    rows = []
    for name, (path, other) in cases.items():
        off = np.abs(path - other)
        split = round(FALL_TIME * RATE)
        fall, after = off[:split].max(axis=0), off[split:].max(axis=0)
        rows.append(
            {
                "source": name,
                "fall_height_mm": 1e3 * float(fall[0]),
                "fall_tilt_deg": float(fall[1]),
                "height_mm": 1e3 * float(after[0]),
                "tilt_deg": float(after[1]),
            }
        )
    return rows


def _path(
    path: Path,
    make: Callable[[Hull, Sea], Method],
    timestep: float | None = None,
    pressure: str = "hydrostatic",
) -> np.ndarray:
    """Height [m] and tilt [deg] of the scene's body, (N, 2), with the method from `make`."""

    class Made(Linear):
        @classmethod
        def from_settings(cls, hull: Hull, sea: Sea, settings: Settings) -> Method:
            return make(hull, sea)

    METHODS["made"] = Made
    try:
        settings = {"buoyancy_method": "made", "water_pressure": pressure}
        scene = Scene.load(path, settings=settings, timestep=timestep)
        samples = simulate(scene, DURATION, RATE)
        return np.array([[s.centres[0, 2], np.degrees(s.tilts[0])] for s in samples])
    finally:
        del METHODS["made"]
