"""Twins: several simulations of one scene side by side in one recording."""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
import rerun as rr

from sim.recording.colours import HUE_STEP
from sim.recording.display_mesh import DisplayMeshes
from sim.recording.episodes import Episodes
from sim.recording.frame import WATER_RESOLUTION, Artist
from sim.recording.look import DIFFERENCES, MOST_PLOTTED, SERIES, side_by_side_blueprint
from sim.recording.output import Output, path_part
from sim.recording.recorder import BATCH_SECONDS, Recording, SceneWriter
from sim.runs.simulation import Sample
from sim.scenes.scene import Scene


class SideBySideRecorder(Recording):
    """Writes several simulations of one scene to one .rrd file; a context manager.

        with SideBySideRecorder("twins.rrd", {"linear": one, "chord:4": other}) as recorder:
            for samples in zip(simulate(one, 10.0), simulate(other, 10.0)):
                recorder.log(samples)

    Each simulation has a 3D view with its label as title, and its own colours in the view and in
    the common plots. The entities of a `Recorder` are below the entity <label>. Raises OSError as
    `Recorder` does.
    """

    def __init__(self, path: str | Path, scenes: Mapping[str, Scene]) -> None:
        self.path = Path(path)
        first = next(iter(scenes.values()))
        name = f"{first.name}: {', '.join(scenes)}"
        artists = [
            Artist(s, DisplayMeshes(s.buoyancy, hue=i * HUE_STEP), None, WATER_RESOLUTION)
            for i, s in enumerate(scenes.values())
        ]
        arrangement = side_by_side_blueprint(scenes, artists[0].framing.distance)
        output = Output(self.path, name, arrangement)
        writers = [
            SceneWriter(scene, output, artist, f"/{path_part(label)}")
            for (label, scene), artist in zip(scenes.items(), artists, strict=True)
        ]
        bodies = first.buoyancy.body_names[:MOST_PLOTTED]
        for label, path_of, body in product(scenes, SERIES.values(), bodies):
            title = f"water at {body}" if path_of.endswith("water") else body
            line = rr.SeriesLines(names=f"{title}, {label}")
            output.log(f"{path_part(label)}/{path_of.format(path_part(body))}", line, static=True)
        super().__init__(output, writers)
        self._differences = Differences(list(scenes), bodies, output)

    def log(self, samples: Sequence[Sample]) -> None:
        """Add one sample of each simulation, in the order of the scenes, as the next frame."""
        self._differences.add(samples)
        self._log(samples)

    def close(self) -> None:
        if self._output.is_open:
            self._differences.send()
        super().close()


class Differences:
    """Writes the differences in heave and tilt from the first simulation, in batches."""

    def __init__(self, labels: list[str], bodies: Sequence[str], output: Output) -> None:
        self._labels, self._bodies, self._output = labels, bodies, output
        self._waiting: list[tuple[float, Sequence[Sample]]] = []
        self._episodes = Episodes()
        for entity, label, body in product(DIFFERENCES, labels[1:], bodies):
            line = rr.SeriesLines(names=f"{body}, {label}")
            output.log(self._path(entity, label, body), line, static=True)

    def add(self, samples: Sequence[Sample]) -> None:
        """Add one sample of each simulation."""
        self._waiting.append((self._episodes.add(samples[0].time), samples))
        if self._waiting[-1][0] - self._waiting[0][0] >= BATCH_SECONDS:
            self.send()

    def send(self) -> None:
        """Send the waiting samples."""
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        indexes = [rr.TimeColumn("time", duration=[time for time, _ in waiting])]
        values = {
            "heave": np.array([[s.positions[:, 2] for s in samples] for _, samples in waiting]),
            "tilt": np.degrees([[s.tilts for s in samples] for _, samples in waiting]),
        }
        for entity, series in values.items():  # frames, twins, bodies
            differences = series[:, 1:] - series[:, :1]
            for (j, label), (i, body) in product(
                enumerate(self._labels[1:]), enumerate(self._bodies)
            ):
                columns = rr.Scalars.columns(scalars=differences[:, j, i])
                path = self._path(entity, label, body)
                self._output.send_columns(path, indexes=indexes, columns=columns)

    def _path(self, entity: str, label: str, body: str) -> str:
        return f"difference/{entity}/{path_part(label)}/{path_part(body)}"
