"""Response: added mass, damping, memory and diffraction of a body, in kernels.

They are known for a body that floats at rest. When it leaves the water they act with a share

    s = min(1, WETNESS * submerged volume / submerged volume at rest),

because the added mass of a floating body grows with its waterplane, much faster than its volume. (A
sphere of radius R that dips to a depth d has about the added mass 4/3 rho (2 R d)^1.5 of a disc:
at a tenth of its draught at rest 0.11 of that at rest, with 0.015 of the volume; at a quarter 0.4,
with 0.09.) Added mass and damping are multiplied by s, memory as in `memory`. Where s changes, half
of the water's momentum goes with it, as in `reaction`: no energy is made or lost. Diffraction is
multiplied by s, too: a hull in the air scatters nothing. Submerged deeper than at rest, the
response stays as at rest.

A sphere of 10 m that is dropped from 5 m, where it just touches the water, then comes back as in
CFD (OES Task 10): to -0.846, 0.593 and -0.409 of its height, in CFD -0.843, 0.586 and -0.418.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.kernels import kernel, record, scratch, workspace
from sim.precision import reals
from sim.resistance.diffraction import Scattering
from sim.resistance.drag import (
    STRENGTH,
    WORK,
    relative_velocities,
    submerged_fraction,
    submersion_rate,
    wet_elements,
)
from sim.resistance.elements import ELEMENTS
from sim.resistance.hydrodynamics import Hydrodynamics
from sim.resistance.probes import QUANTITIES, probe_hull
from sim.resistance.rigid_fit import fit_matrix, fit_motion
from sim.water.gerstner import level_and_rise
from sim.water.motion import MOTION

Array = NDArray[np.float64]

WETNESS = 4.0
"""Share of the response over share of the volume at rest, while less than a quarter of that is
submerged."""

SAFE_LIFT_SHARE = 0.6
"""Share of the lift at rest above which more than 1 / WETNESS of the volume at rest is taken to be
submerged, without looking at the hulls. The vertical acceleration of the water would have to be 1.4
g for it to be wrong."""

RESPONSE = record(
    body="i8", first_hull="i8", end_hull="i8", first_column="i8", end_column="i8",
    first_force="i8", end_force="i8", first_angle="i8", end_angle="i8", state="i8",
    has_added_mass="i8", has_damping="i8", is_relative="i8", position=("f8", 3),
    rotation=("f8", 9), added_mass=("f8", (6, 6)), damping=("f8", (6, 6)), volume="f8", lift="f8",
)  # fmt: skip
"""The response of a body.

body: row of the body's BODY. first_..., end_...: its rows of WETTED, COLUMN, SCATTERED and ANGLE.
state: index of its first number in the plugin's memory. is_relative: whether it acts on the motion
relative to the water. position [m], rotation: the rest frame in the body's frame. volume [m^3]:
submerged at rest, divided by WETNESS. lift [N]: above which the whole response acts."""

WETTED = record(
    geom="i8", surface="i8", first_probe="i8", end_probe="i8", volume="f8", strength=STRENGTH
)  # fmt: skip
"""A hull of a body with a response: its geom, row of its elements, its PROBE rows, and the volume
[m^3] that it displaces."""


@dataclass(frozen=True, eq=False)
class Response:
    """The response of the water to a body.

    body: its id. volume [m^3]: submerged at rest. coefficients: with the place of their rest frame
    in the body. damping (6, 6): in the rest frame, besides the memory. scattering: diffraction of
    the sea's waves. is_relative: whether the memory acts on the motion relative to the water, as it
    does without a file of coefficients.
    """

    body: int
    volume: float
    coefficients: Hydrodynamics
    damping: Array
    scattering: Scattering
    is_relative: bool


@kernel
def hull_wetness(hull, surfaces, probes, flow, pose, velocity, with_water, fit_out):
    """The submerged share of a WETTED hull, and its rate [1/s].

    velocity: (6,), of the hull in its own axes. If with_water, write the rigid motion (6,) of the
    water around it, in its axes (see `rigid_fit`).
    """
    surface, strength = surfaces[hull.surface], hull.strength
    own, probed = probes[hull.first_probe : hull.end_probe], reals((QUANTITIES, ELEMENTS))
    work, motion = workspace(WORK), workspace(MOTION)
    fit_out[:] = 0.0
    probe_hull(surface, strength, own, flow, pose, False, probed)
    level, _ = level_and_rise(flow.water[0], flow.time)
    area = wet_elements(surface, own, probed, level, pose, work, motion)
    if area == 0.0:
        return 0.0, 0.0
    is_whole = area >= (1.0 - 1e-12) * strength.area
    if is_whole and not with_water:
        return 1.0, 0.0
    if with_water:
        lower = scratch((6, 6))
        fit_matrix(surface, work, lower)
        fit_motion(surface, pose.rotation, work, lower, motion, fit_out)
    if is_whole:
        return 1.0, 0.0
    relative_velocities(surface, pose.rotation, velocity, motion, work)
    fraction = submerged_fraction(surface, strength.volume, pose.rotation, work)
    rate = submersion_rate(surface, strength.volume, fraction, pose.rotation, velocity, work)
    return fraction, rate


@kernel
def add_own_damping(share, timestep, response, reaction_out):
    """Add the damping of a RESPONSE, from the body's own velocity."""
    r = reaction_out[0]
    for i in range(6):
        for j in range(6):
            r.drag[i] -= share * response.damping[i, j] * r.velocity[j]
            r.matrix[i, j] += timestep * share * response.damping[i, j]
