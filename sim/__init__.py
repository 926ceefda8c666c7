"""Waterline: mesh buoyancy on Gerstner waves for MuJoCo.

The layers, from the bottom up; imports point only downwards in this list:

    gerstner     kernels: sums of Gerstner waves and their inverse
    spectrum     the JONSWAP spectrum of irregular seas
    sea          Wave, Sea: elevation, its derivatives, the water's velocity
    hull         Hull: a closed, outward triangle surface, checked once
    triangle     kernels: hydrostatic wrench of a triangle, the straight clip
    methods/     ways to turn (hull, sea, pose, time) into a wrench, all called alike
    drag         drag and added mass of a hull
    implicit     the linearly implicit step of bodies that have them
    mjcf         a model's custom fields and geoms -> sea and hulls; every refusal about a model
    coupling     Buoyancy: the callback that writes xfrc_applied
    scene        Scene: an MJCF file as something that can be stepped
    divergence   a state that cannot be, and which of the usual causes fits
    simulation   simulate: the stepping loop, yields Samples
    waterline    where sea and hull meet, as curves to be drawn
    skin         the hulls' surfaces as they are drawn
    recording    Recorder: Samples -> a Rerun recording
    accuracy     errors and timings of methods, means of correlated series

Nothing below mjcf knows MuJoCo and nothing but recording knows Rerun.
"""

from sim.coupling import Buoyancy
from sim.divergence import DivergenceError
from sim.drag import Drag, DragCoefficients
from sim.hull import Hull
from sim.methods import Chord, Linear, Patches, Reference
from sim.recording import Recorder, SideBySideRecorder
from sim.scene import Scene
from sim.sea import Sea, Wave
from sim.simulation import Sample, Tally, simulate
from sim.triangle import wet_triangles_wrench

__all__ = [
    "Buoyancy",
    "Chord",
    "DivergenceError",
    "Drag",
    "DragCoefficients",
    "Hull",
    "Linear",
    "Patches",
    "Recorder",
    "Reference",
    "Sample",
    "Scene",
    "Sea",
    "SideBySideRecorder",
    "Tally",
    "Wave",
    "simulate",
    "wet_triangles_wrench",
]
