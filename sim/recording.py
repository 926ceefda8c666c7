"""Recording: Samples -> a Rerun file with its own blueprint. The only file that knows Rerun.

Entities, all in world axes [m]:

    world/water                     the surface around the bodies
    world/bodies/<body>             pose of the body frame; below it its hulls
    world/forces/buoyancy, weight   arrows at the centres of mass
    plots/<quantity>/<body>         height and water height [m], tilt [deg], submerged
                                    fraction [-], vertical force [N]

on the timelines `time` (simulated seconds) and `frame`.
"""

import atexit
import os
from pathlib import Path
from types import TracebackType
from typing import NoReturn

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from sim.hull import Hull
from sim.scene import Scene
from sim.simulation import Sample

Array = NDArray[np.float64]

FLUSH_SECONDS = 5.0
"""Longest wait for the disk to take about a megabyte. Rerun's writer, once it has given up, leaves
a flush unanswered, so this is also how long it takes to notice that the disk is full."""

ABANDONED: list[rr.RecordingStream] = []
"""Streams whose writer has died. A process that has one must leave by `os._exit`."""

WATER_RESOLUTION = 48
"""Vertices along a side of the water's grid; a frame takes 12 bytes for each of its square."""

WATER_SIZE_IN_HULLS = 6.0
"""Side of the water's grid in sides of the largest hull, where the bodies are not further apart."""

WATER_COLOUR = (38, 108, 168, 150)
BUOYANCY_COLOUR = (80, 200, 120)
WEIGHT_COLOUR = (220, 80, 60)

PLOTS = {
    "height": "Height of the centre of mass and of the water above it [m]",
    "tilt": "Tilt [deg]",
    "submerged": "Submerged fraction of the volume",
    "force": "Vertical buoyant force [N]",
}
"""Time series views, in order: the first part of the entity path and the title."""

SERIES = {
    "height": "plots/height/{}",
    "water_height": "plots/height/{}/water",
    "tilt_deg": "plots/tilt/{}",
    "submerged_fraction": "plots/submerged/{}",
    "vertical_force": "plots/force/{}",
}
"""Entity path of every quantity of a body."""


class Recorder:
    """Writes samples of one scene to an .rrd file; a context manager.

        with Recorder("run.rrd", scene) as recorder:
            for sample in simulate(scene, 10.0):
                recorder.log(sample)

    The file is readable whenever the block is left, by an exception too. Missing folders are
    made. Raises OSError when the file cannot be written.
    """

    def __init__(self, path: str | Path, scene: Scene) -> None:
        self.path = Path(path)
        self.scene = scene
        self._frame = 0
        self._waiting: list[Sample] = []
        self._side, self._steps = _water_grid(scene)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        _check_writable(self.path)
        self._stream = rr.RecordingStream("waterline")
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._intact: int | None = 0
        try:
            self._stream.save(self.path, default_blueprint=_blueprint(scene, self._side))
        except RuntimeError as error:
            self._give_up(error)
        self._stream.send_recording_name(scene.name)
        self._log_static()
        self._flush()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Write what is waiting and close the file. Raises OSError as `log` does."""
        if self._intact is None:
            return
        self._send_series()
        self._flush()
        self._stream.disconnect()

    def _flush(self) -> None:
        """Have all that was logged on disk; raises OSError when it cannot be."""
        try:
            self._stream.flush(timeout_sec=FLUSH_SECONDS)
        except RuntimeError as error:
            self._give_up(error)
        self._intact = self.path.stat().st_size

    def _give_up(self, error: RuntimeError) -> NoReturn:
        """Close the file as it was after the last flush, without the message that was cut off, and
        remove it if nothing had been written."""
        intact, self._intact = self._intact, None
        # Disconnecting, collecting the stream and Rerun's shutdown would wait for the dead
        # writer for ever.
        atexit.unregister(rr.rerun_shutdown)
        ABANDONED.append(self._stream)
        if self.path.is_file():
            os.truncate(self.path, intact)
            if intact == 0:
                self.path.unlink()
        reason = " ".join(str(error).split())
        raise OSError(
            f"{self.path}: the recording cannot be written ({reason}); make room on the disk or "
            "record elsewhere. What was written before is intact"
        )

    def log(self, sample: Sample) -> None:
        """Add one sample as the next frame. Raises OSError when the disk is full; what was
        written until a second before stays readable."""
        stream = self._stream
        stream.set_time("time", duration=sample.time)
        stream.set_time("frame", sequence=self._frame)
        for name, position, quaternion in zip(
            self.scene.buoyancy.body_names, sample.positions, sample.quaternions, strict=True
        ):
            stream.log(
                f"world/bodies/{_part(name)}",
                rr.Transform3D(translation=position, quaternion=np.roll(quaternion, -1)),
            )
        stream.log(
            "world/water",
            rr.Mesh3D.from_fields(vertex_positions=self._water_vertices(sample)),
        )
        self._log_forces(sample)
        self._frame += 1
        self._waiting.append(sample)
        if sample.time - self._waiting[0].time >= 1.0:
            self._send_series()
            self._flush()

    def _log_static(self) -> None:
        stream, scene = self._stream, self.scene
        model, buoyancy = scene.model, scene.buoyancy
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for f in buoyancy.floats:
            body = model.body(f.body)
            hull = f.method.hull
            entity = f"world/bodies/{_part(body.name or f'body {f.body}')}/{_part(f.name)}"
            stream.log(
                entity,
                rr.Transform3D(translation=body.ipos, quaternion=np.roll(body.iquat, -1)),
                rr.Mesh3D(
                    vertex_positions=hull.vertices,
                    triangle_indices=hull.faces,
                    vertex_normals=vertex_normals(hull),
                    albedo_factor=np.round(255 * model.geom(f.name).rgba).astype(np.uint8),
                ),
                static=True,
            )
        stream.log(
            "world/water",
            rr.Mesh3D.from_fields(
                triangle_indices=_grid_faces(WATER_RESOLUTION), albedo_factor=WATER_COLOUR
            ),
            static=True,
        )
        for quantity, path in SERIES.items():
            for name in buoyancy.body_names:
                label = f"water at {name}" if quantity == "water_height" else name
                stream.log(path.format(_part(name)), rr.SeriesLines(names=label), static=True)

    def _water_vertices(self, sample: Sample) -> Array:
        """(N, 3) points of the very surface that pushes, on a grid that follows the bodies by
        whole cells, so that it does not swim under the eye."""
        cell = self._steps[1] - self._steps[0]
        middle = np.round(sample.centres[:, :2].mean(axis=0) / cell) * cell
        x, y = np.meshgrid(middle[0] + self._steps, middle[1] + self._steps, indexing="ij")
        z = self.scene.buoyancy.sea.elevation(x, y, sample.time)
        return np.stack([x, y, z], axis=-1).reshape(-1, 3)

    def _log_forces(self, sample: Sample) -> None:
        """Arrows for buoyancy and weight: a body's weight is as long as a tenth of the water."""
        model, bodies = self.scene.model, self.scene.buoyancy.bodies
        weights = model.body_mass[bodies] * -model.opt.gravity[2]
        metres_per_newton = (0.1 * self._side / weights)[:, None]
        down = np.outer(weights, [0.0, 0.0, -1.0])
        forces = {
            "buoyancy": (sample.body_wrenches[:, :3], BUOYANCY_COLOUR),
            "weight": (down, WEIGHT_COLOUR),
        }
        for name, (vectors, colour) in forces.items():
            arrows = rr.Arrows3D(
                vectors=metres_per_newton * vectors,
                origins=sample.centres,
                colors=[colour],
                radii=0.004 * self._side,
            )
            self._stream.log(f"world/forces/{name}", arrows)

    def _send_series(self) -> None:
        """Send the time series in batches: one call a series costs as much as one a frame."""
        if not self._waiting:
            return
        samples, self._waiting = self._waiting, []
        first = self._frame - len(samples)
        indexes = [
            rr.TimeColumn("time", duration=[s.time for s in samples]),
            rr.TimeColumn("frame", sequence=range(first, self._frame)),
        ]
        values = {
            "height": [s.centres[:, 2] for s in samples],
            "water_height": [s.elevations for s in samples],
            "tilt_deg": [np.degrees(s.tilts) for s in samples],
            "submerged_fraction": [s.submerged_fractions for s in samples],
            "vertical_force": [s.body_wrenches[:, 2] for s in samples],
        }
        for quantity, path in SERIES.items():
            for i, name in enumerate(self.scene.buoyancy.body_names):
                series = [row[i] for row in values[quantity]]
                self._stream.send_columns(
                    path.format(_part(name)),
                    indexes=indexes,
                    columns=rr.Scalars.columns(scalars=series),
                )


def vertex_normals(hull: Hull) -> Array:
    """Outward unit normals (V, 3) at the vertices: means of the faces around, by their area."""
    normals = np.zeros_like(hull.vertices)
    for corner in range(3):
        np.add.at(normals, hull.faces[:, corner], hull.area_vectors)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _check_writable(path: Path) -> None:
    """Tells plainly, and before anything is simulated, what Rerun would report from a thread."""
    with path.open("wb") as file:
        try:
            file.write(b"RRF2")
            file.flush()
        except OSError as error:
            raise OSError(f"{path}: {error.strerror}; make room or record elsewhere") from None


def _part(name: str) -> str:
    """A name as one part of an entity path, whatever characters it has."""
    return rr.escape_entity_path_part(name)


def _water_grid(scene: Scene) -> tuple[float, Array]:
    """Side [m] of the water's grid and the grid lines (N,) along it, from its middle."""
    buoyancy = scene.buoyancy
    largest = max(np.ptp(f.method.hull.bounds, axis=0).max() for f in buoyancy.floats)
    spread = np.ptp(scene.data.xipos[buoyancy.bodies, :2], axis=0).max()
    side = float(spread + WATER_SIZE_IN_HULLS * largest)
    return side, np.linspace(-0.5 * side, 0.5 * side, WATER_RESOLUTION)


def _grid_faces(resolution: int) -> NDArray[np.int64]:
    """Two triangles for each cell of a square grid of vertices, facing up."""
    corner = np.arange(resolution * resolution).reshape(resolution, resolution)
    a, b = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
    c, d = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def _blueprint(scene: Scene, side: float) -> rrb.Blueprint:
    centre = scene.data.xipos[scene.buoyancy.bodies].mean(axis=0)
    centre[2] = scene.buoyancy.sea.level
    eye = rrb.EyeControls3D(
        position=centre + side * np.array([-0.35, -0.55, 0.25]),
        look_target=centre,
        eye_up=(0.0, 0.0, 1.0),
    )
    plots = [
        rrb.TimeSeriesView(origin=f"plots/{entity}", name=title) for entity, title in PLOTS.items()
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="world", name=scene.name, eye_controls=eye),
            rrb.Vertical(*plots),
            column_shares=[2, 1],
        ),
        rrb.TimePanel(timeline="time", state="collapsed"),
        collapse_panels=True,
    )
