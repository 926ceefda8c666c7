"""Motions: heave, heel and trim of floating bodies, in the field's terms."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import rotation_matrix
from sim.runs.simulation import Sample
from sim.scenes.hydrostatics import hydrostatics
from sim.scenes.scene import Scene
from sim.statics.report import heel_and_trim

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """Of the B floating bodies: heave [m], heel [deg], starboard down, and trim [deg], bow down,
    each (B,); and the water's height above the still level [m] at each."""

    heave: Array
    heel_deg: Array
    trim_deg: Array
    water: Array


class Motions:
    """Heave is the height of a body's origin above the one at which it rests in still water, or,
    where it does not, at which it started; both move with the level."""

    def __init__(self, scene: Scene) -> None:
        self._sea = scene.buoyancy.sea
        names = scene.buoyancy.body_names
        self._rest = scene.data.xpos[scene.buoyancy.bodies, 2] - self._sea.level
        for name, found in hydrostatics(scene, with_gz=False).items():
            if name in names and found.rest is not None:
                self._rest[names.index(name)] = found.rest.height_m - self._sea.level

    def of(self, sample: Sample) -> Motion:
        """The motion at a sample of the scene."""
        level = float(self._sea.level_at(sample.time))
        up = rotation_matrix(sample.quaternions)[:, 2]
        heel, trim = np.degrees(heel_and_trim(up))
        heave = sample.positions[:, 2] - self._rest - level
        return Motion(heave, heel, trim, sample.elevations - level)
