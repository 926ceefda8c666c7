"""Waterline: mesh buoyancy on Gerstner waves for MuJoCo.

The layers, from the bottom up; imports point only downwards in this list:

    gerstner     kernels: sums of Gerstner waves and their inverse
    sea          Wave, Sea: elevation, its derivatives, the water's velocity
    hull         Hull: a closed, outward triangle surface, checked once
    triangle     kernels: hydrostatic wrench of a triangle, the straight clip
    methods/     ways to turn (hull, sea, pose, time) into a wrench, all called alike
    drag         drag and added mass of a hull, and the linearly implicit step that bears them
    mjcf         a model's custom fields and geoms -> sea and hulls; every refusal about a model
    coupling     Buoyancy: the callback that writes xfrc_applied
    scene        Scene: an MJCF file as something that can be stepped
    divergence   a state that cannot be, and which of the usual causes fits
    simulation   simulate: the stepping loop, yields Samples
    recording    Recorder: Samples -> a Rerun recording

Nothing below mjcf knows MuJoCo and nothing but recording knows Rerun.
"""

from sim.coupling import Buoyancy
from sim.divergence import DivergenceError
from sim.drag import Drag, DragCoefficients
from sim.hull import Hull
from sim.methods import Linear
from sim.recording import Recorder
from sim.scene import Scene
from sim.sea import Sea, Wave
from sim.simulation import Sample, Tally, simulate
from sim.triangle import wet_triangles_wrench

__all__ = [
    "Buoyancy",
    "DivergenceError",
    "Drag",
    "DragCoefficients",
    "Hull",
    "Linear",
    "Recorder",
    "Sample",
    "Scene",
    "Sea",
    "Tally",
    "Wave",
    "simulate",
    "wet_triangles_wrench",
]
