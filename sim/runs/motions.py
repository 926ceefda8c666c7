"""Motions: heave, heel and trim of floating bodies, as naval architects define them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import rotation_matrix
from sim.runs.simulation import Sample
from sim.statics.report import heel_and_trim
from sim.water.sea import Sea

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """Motion of the B floating bodies: heave [m], heel [deg], starboard down, trim [deg], bow down,
    and the height [m] of the water above the still level at each body; each (B,)."""

    heave: Array
    heel_deg: Array
    trim_deg: Array
    water: Array


def motion(sample: Sample, sea: Sea, rest_heights: Array) -> Motion:
    """The motion of a sample's bodies. Heave is the height of a body's origin above its rest height
    (`Scene.rest_heights`, (B,) [m]). Both are measured from the still level, which a tide moves."""
    level = float(sea.level_at(sample.time))
    heel, trim = np.degrees(heel_and_trim(rotation_matrix(sample.quaternions)[:, 2]))
    heave = sample.positions[:, 2] - rest_heights - level
    return Motion(heave, heel, trim, sample.elevations - level)
