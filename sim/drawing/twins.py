"""Twins: several simulations of one scene side by side in one recording."""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import rerun as rr

from sim.coupling.scene import Scene
from sim.coupling.simulation import Sample
from sim.drawing.display_mesh import DisplayMeshes
from sim.drawing.frame import WATER_RESOLUTION, Artist
from sim.drawing.look import MOST_PLOTTED, SERIES, side_by_side_blueprint
from sim.drawing.output import Output, Part, part
from sim.drawing.recorder import Recording, SceneWriter

GOLDEN_TURN = 0.618
"""From one twin's hue to the next: however many there are, no two of them come near each other."""


class SideBySideRecorder(Recording):
    """Writes several simulations of one scene to one .rrd file; a context manager.

        with SideBySideRecorder("twins.rrd", {"linear": one, "chord:4": other}) as recorder:
            for samples in zip(simulate(one, 10.0), simulate(other, 10.0)):
                recorder.log(samples)

    Each has a 3D view of its own, titled with its label, all in the same water, and colours of its
    own there and in the plots, which share axes. What a `Recorder` writes stands below the entity
    <label>. Raises OSError as it does.
    """

    def __init__(self, path: str | Path, scenes: Mapping[str, Scene]) -> None:
        self.path = Path(path)
        first = next(iter(scenes.values()))
        name = f"{first.name}: {', '.join(scenes)}"
        output = Output(self.path, name, side_by_side_blueprint(scenes))
        writers = []
        for i, (label, scene) in enumerate(scenes.items()):
            meshes = DisplayMeshes(scene.buoyancy, hue=i * GOLDEN_TURN)
            artist = Artist(scene, meshes, None, WATER_RESOLUTION)
            own = Part(output, part(label))
            writers.append(SceneWriter(scene, own, artist))
        bodies = first.buoyancy.body_names[:MOST_PLOTTED]
        for label, path_of, body in product(scenes, SERIES.values(), bodies):
            title = f"water at {body}" if path_of.endswith("water") else body
            line = rr.SeriesLines(names=f"{title}, {label}")
            output.log(f"{part(label)}/{path_of.format(part(body))}", line, static=True)
        super().__init__(output, writers)

    def log(self, samples: Sequence[Sample]) -> None:
        """Add one sample of each simulation, in the order of the scenes, as the next frame."""
        self._log(samples)
