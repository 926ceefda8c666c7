"""Waterline: mesh buoyancy on Gerstner waves for MuJoCo.

The rooms of the house. Each imports only from lines below its own (`tests/test_layers.py`
reads this map and keeps it so):

    drawing/, measure/        recordings for Rerun; errors and timings, statistics, hard cases
    coupling/                 MuJoCo: the plugin, an MJCF file as a scene, the stepping loop
    methods/, resistance/     (hull, sea, pose, time) -> wrench of the water; drag, added mass
    statics/                  how a body rests in still water, and what brings it back
    meshes/                   surfaces as files have them: what is wrong, repair, unions
    hull, triangle, water/    closed surfaces; the wrench of one triangle; waves and pressure
    geometry                  areas, volumes, rotations of triangles and bodies
    addresses                 arrays, functions and counters at places in memory
    kernels                   how kernels are compiled, and the blocks of tables they read

Nothing below coupling knows MuJoCo, and only drawing knows Rerun, which is loaded when it is first
asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sim.coupling.buoyancy import Buoyancy
from sim.coupling.divergence import DivergenceError
from sim.coupling.faults import ModelError, Note
from sim.coupling.hydrostatics import Hydrostatics, hydrostatics
from sim.coupling.scene import Scene
from sim.coupling.simulation import Sample, Tally, observe, simulate
from sim.coupling.spec import add_water
from sim.hull import Hull
from sim.methods import Chord, Linear, Patches, Reference
from sim.resistance.drag import Drag, DragCoefficients
from sim.triangle import wet_triangles_wrench
from sim.water.sea import Sea
from sim.water.wave import Wave

if TYPE_CHECKING:
    from sim.drawing.reader import read_series
    from sim.drawing.recorder import Recorder
    from sim.drawing.twins import SideBySideRecorder

_LATER = {
    "Recorder": "sim.drawing.recorder",
    "SideBySideRecorder": "sim.drawing.twins",
    "read_series": "sim.drawing.reader",
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
