"""Plots: the time series of a scene's bodies, and of the envelope of many bodies."""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sim.recording.colours import rounded, told_apart
from sim.recording.display_mesh import DisplayMesh
from sim.recording.look import (
    ENVELOPE_COLOURS,
    ENVELOPE_NAMES,
    ENVELOPE_SERIES,
    MOST_PLOTTED,
    OTHER_SERIES,
    SERIES,
    WATER_QUANTITIES,
    WATER_SERIES_SHARE,
)
from sim.recording.output import path_part
from sim.runs.motions import motion
from sim.runs.simulation import Sample
from sim.scenes.scene import Scene

Array = NDArray[np.float64]


class Plots:
    """The series of a scene. meshes: the surface of each body, whose colour its series have."""

    def __init__(self, scene: Scene, meshes: Sequence[DisplayMesh]) -> None:
        names = scene.buoyancy.body_names
        self._plotted, self._others = names[:MOST_PLOTTED], names[MOST_PLOTTED:]
        self._colours = told_apart([mesh.rgba[:3] for mesh in meshes[:MOST_PLOTTED]])
        self._sea, self._rest_heights = scene.buoyancy.sea, scene.rest_heights
        self._weights = scene.buoyancy.weights
        self._start = scene.data.xpos[scene.buoyancy.bodies, 0].copy()

    def begin(self, sample: Sample) -> None:
        """Measure the surge from a sample, the first of an episode."""
        self._start = sample.positions[:, 0].copy()

    def styles(self) -> Iterator[tuple[str, rr.SeriesLines]]:
        """The names, colours and widths of all series, by entity."""
        for quantity, path in SERIES.items():
            of_water = quantity in WATER_QUANTITIES
            for name, colour in zip(self._plotted, self._colours, strict=True):
                label, width = name, 2.0
                if of_water:
                    colour, label, width = WATER_SERIES_SHARE * colour, f"water at {name}", 1.0
                line = rr.SeriesLines(names=label, colors=[rounded(colour)], widths=[width])
                yield path.format(path_part(name)), line
            if self._others:
                yield OTHER_SERIES[quantity], rr.SeriesLines(names=self._others)
                names = [f"water, {name}" if of_water else name for name in ENVELOPE_NAMES]
                share = WATER_SERIES_SHARE if of_water else 1.0
                line = rr.SeriesLines(names=names, colors=rounded(share * ENVELOPE_COLOURS))
                yield ENVELOPE_SERIES[quantity], line

    def columns(self, samples: list[Sample]) -> Iterator[tuple[str, rr.ComponentColumnList]]:
        """The series of samples, by entity."""
        for quantity, values in self._values(samples).items():
            of_bodies = np.stack(values, axis=1)
            for name, series in zip(self._plotted, of_bodies, strict=False):
                path = SERIES[quantity].format(path_part(name))
                yield path, rr.Scalars.columns(scalars=series)
            if self._others:
                envelope = of_bodies.max(axis=0), of_bodies.mean(axis=0), of_bodies.min(axis=0)
                yield OTHER_SERIES[quantity], _rows(of_bodies[MOST_PLOTTED:])
                yield ENVELOPE_SERIES[quantity], _rows(np.stack(envelope))

    def _values(self, samples: list[Sample]) -> dict[str, list[Array]]:
        """Each quantity of samples, as an array (B,) for each sample."""
        motions = [motion(s, self._sea, self._rest_heights) for s in samples]
        return {
            "heave": [m.heave for m in motions],
            "water_above_level": [m.water for m in motions],
            "surge": [s.positions[:, 0] - self._start for s in samples],
            "heel_deg": [m.heel_deg for m in motions],
            "trim_deg": [m.trim_deg for m in motions],
            "height": [s.centres[:, 2] for s in samples],
            "water_height": [s.elevations for s in samples],
            "tilt_deg": [np.degrees(s.tilts) for s in samples],
            "submerged_fraction": [s.submerged_fractions for s in samples],
            "vertical_force": [s.body_wrenches[:, 2] / self._weights for s in samples],
        }


def _rows(series: Array) -> rr.ComponentColumnList:
    """Series (M, N) as N rows of M numbers."""
    count, length = series.shape
    return rr.Scalars.columns(scalars=series.T.ravel()).partition([count] * length)
