"""Waterline: mesh buoyancy on Gerstner waves for MuJoCo.

Its packages and modules. Each imports only from the lines below its own; `tests/test_layers.py`
checks that:

    recording/                recordings for Rerun
    runs/                     the stepping loop, samples, series, sweeps, statistics
    scenes/                   an MJCF file as a scene, its hydrostatics, the interface in Python
    worlds/                   the water in the worlds of mujoco_warp, on a GPU
    plugin/                   the engine plugin, which MuJoCo calls in every step
    mjcf/                     reads the water and the hulls from a compiled model
    methods/, resistance/     (hull, sea, pose, time) -> wrench of the water; drag, added mass
    statics/                  rest and stability of a body in still water
    hulls/, water/            closed surfaces and their repair; waves and pressure
    notes                     warnings for the author of a scene
    geometry                  areas, volumes, rotations of triangles and bodies
    precision                 kernels in single precision, from the same text
    kernels                   compilation of kernels, and the blocks of tables they read
    addresses                 arrays, functions and counters at addresses in memory
    platforms                 what Linux, macOS and Windows do differently

Nothing below mjcf imports MuJoCo. Only recording imports Rerun, and only worlds imports Warp and
mujoco_warp; both are loaded at first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sim.hulls.hull import Hull
from sim.hulls.triangle import wet_triangles_wrench
from sim.methods import Chord, Linear, Patches, Reference
from sim.mjcf.faults import ModelError
from sim.notes import Note
from sim.resistance.drag import Drag, DragCoefficients
from sim.runs.divergence import DivergenceError
from sim.runs.simulation import Sample, observe, simulate
from sim.runs.tally import Tally
from sim.scenes.buoyancy import Buoyancy
from sim.scenes.hydrostatics import hydrostatics
from sim.scenes.scene import Scene
from sim.scenes.spec import add_water
from sim.statics.report import Hydrostatics
from sim.water.sea import Sea
from sim.water.wave import Wave

if TYPE_CHECKING:
    from sim.recording.reader import read_series
    from sim.recording.recorder import Recorder
    from sim.recording.twins import SideBySideRecorder

_LAZY_MODULES = {
    "Recorder": "sim.recording.recorder",
    "SideBySideRecorder": "sim.recording.twins",
    "read_series": "sim.recording.reader",
}
"""Modules of the public names that are loaded at first use."""

__all__ = [
    "Buoyancy",
    "Chord",
    "DivergenceError",
    "Drag",
    "DragCoefficients",
    "Hull",
    "Hydrostatics",
    "Linear",
    "ModelError",
    "Note",
    "Patches",
    "Recorder",
    "Reference",
    "Sample",
    "Scene",
    "Sea",
    "SideBySideRecorder",
    "Tally",
    "Wave",
    "add_water",
    "hydrostatics",
    "observe",
    "read_series",
    "simulate",
    "wet_triangles_wrench",
]


def __getattr__(name: str) -> Any:
    if name not in _LAZY_MODULES:
        raise AttributeError(f"module 'sim' has no attribute '{name}'")
    return getattr(import_module(_LAZY_MODULES[name]), name)
