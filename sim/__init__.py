"""Waterline: mesh buoyancy on Gerstner waves for MuJoCo.

The rooms of the house. Each imports only from lines below its own (`tests/test_layers.py`
reads this map and keeps it so):

    recording/                recordings for Rerun
    runs/                     the stepping loop, samples of a run, series, sweeps, statistics
    scenes/                   an MJCF file as a scene, its hydrostatics, what Python may ask
    plugin/                   the engine plugin: what MuJoCo calls in every step
    mjcf/                     what a compiled model says about water and hulls
    methods/, resistance/     (hull, sea, pose, time) -> wrench of the water; drag, added mass
    statics/                  how a body rests in still water, and what brings it back
    hulls/, water/            closed surfaces, from files too, their repair; waves and pressure
    geometry                  areas, volumes, rotations of triangles and bodies
    kernels                   how kernels are compiled, and the blocks of tables they read
    addresses                 arrays, functions and counters at places in memory

Nothing below mjcf knows MuJoCo, and only recording knows Rerun, which is loaded when it is first
asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sim.hulls.hull import Hull
from sim.hulls.triangle import wet_triangles_wrench
from sim.methods import Chord, Linear, Patches, Reference
from sim.mjcf.faults import ModelError, Note
from sim.resistance.drag import Drag, DragCoefficients
from sim.runs.divergence import DivergenceError
from sim.runs.simulation import Sample, Tally, observe, simulate
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

_LATER = {
    "Recorder": "sim.recording.recorder",
    "SideBySideRecorder": "sim.recording.twins",
    "read_series": "sim.recording.reader",
}
"""Public names whose modules are loaded when they are first asked for."""

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
    if name not in _LATER:
        raise AttributeError(f"module 'sim' has no attribute '{name}'")
    return getattr(import_module(_LATER[name]), name)
