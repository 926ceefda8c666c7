"""Recorder: writes Samples to a Rerun file with a blueprint.

Entities, all in world axes [m]:

    world/water                     the surface around the bodies, made of its own particles
    world/bodies/<body>             pose of the body frame; below it its hulls, darker where wet
    world/waterline                 where the surface meets the hulls
    world/forces/<force>            arrows at the centres of mass: buoyancy, weight, drag
    world/trail                     recent positions of the centres of mass
    world/focus                     target of the camera, which moves with it
    plots/<quantity>/<body>         heave, surge, height and height of the water [m], tilt, heel,
                                    trim [deg], submerged fraction [-], vertical buoyant force
                                    [weights]
    others/<quantity>               the same of all bodies beyond MOST_PLOTTED, in one row
    overview                        scene, sea, hulls and settings; at the end the means

The timelines are `time` (simulated seconds) and `frame`.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic, perf_counter
from typing import Any, Self

import numpy as np
import rerun as rr

from sim.recording.display_mesh import DisplayMesh, DisplayMeshes
from sim.recording.frame import WATER_RESOLUTION, Artist, Frame
from sim.recording.look import (
    COLOURS,
    FORCE_COLOURS,
    HEAD_PALETTE,
    MOST_PLOTTED,
    OTHER_SERIES,
    SERIES,
    TINT_SHARE,
    WATER_OPACITY,
    WATER_PALETTE,
    WATER_QUANTITIES,
    WATER_SERIES_COLOUR,
    WATERLINE_COLOUR,
    WET_TINT,
    blueprint,
    overview,
    palette,
    rounded,
)
from sim.recording.output import VIEWER_PORT, Output, path_part
from sim.runs.motions import motion
from sim.runs.simulation import Sample, observe
from sim.runs.tally import Tally
from sim.scenes.scene import Scene

Send = Callable[[str, rr.ComponentColumnList], None]

ARROW_IN_HULLS, WIDEST_ARROW = 0.55, 1.6
"""Length of the weight's arrow, in diagonals of the body's largest hull, and the largest diagonal
that counts, in cube roots of the volume that the body displaces."""

BATCH_SECONDS = 1.0
"""Simulated time [s] that is sent at once, in columns. Single rows cost ten times as much."""

LONGEST_WAIT, LONGEST_VIEWER_WAIT = 0.7, 0.05
"""Wall time [s] after which a shorter batch is sent, without and with a viewer. A killed run loses
at most this time and a frame."""


class SceneWriter:
    """Writes the samples of one scene to an output in batches.

    artist: draws them. root: the entity above all others, for example "/linear", or "". rate: the
    largest number of frames per simulated second [Hz], None for one per sample. longest_wait: time
    [s] of the clock that a frame may wait for others. frames: the number of frames so far.
    """

    def __init__(
        self,
        scene: Scene,
        output: Output,
        artist: Artist,
        root: str = "",
        rate: float | None = None,
        longest_wait: float = LONGEST_WAIT,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.scene, self.frames = scene, 0
        self._clock = clock
        self._output, self._artist, self._root = output, artist, root
        self._period, self._longest_wait = 0.0 if rate is None else 1.0 / rate, longest_wait
        self._due: float | None = None
        self._waiting: list[Frame] = []
        self._tally = Tally(scene)
        names = scene.buoyancy.body_names
        self._plotted, self._others = names[:MOST_PLOTTED], names[MOST_PLOTTED:]
        self._weights = scene.buoyancy.weights
        self._rest_heights = scene.rest_heights
        self._start = scene.data.xpos[scene.buoyancy.bodies, 0].copy()
        self._palettes = [
            palette(mesh.rgba[:3], mesh.rgba[:3] + TINT_SHARE * (WET_TINT - mesh.rgba[:3]))
            if artist.largest_head is None
            else HEAD_PALETTE
            for mesh in artist.meshes
        ]
        output.log(root or "/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log_static_surfaces()
        self._log_static_lines()
        self._log_overview()
        output.flush()
        artist.frame(observe(scene))  # compiles before the run's time counts
        artist.forget()
        self._sent_at = self._clock()

    def log(self, sample: Sample) -> None:
        """Add one sample as the next frame, unless it comes before the next frame is due."""
        self._tally.add(sample)
        if self._due is None:
            self._due = sample.time
        if sample.time < self._due - 1e-9:
            return
        self._due += self._period
        self._waiting.append(self._artist.frame(sample))
        self.frames += 1
        first = self._waiting[0].sample
        late = self._clock() - self._sent_at > self._longest_wait
        if late or sample.time - first.time >= BATCH_SECONDS:
            self._send()
            self._output.flush()

    def finish(self) -> None:
        """Write the waiting frames and the means over the run."""
        self._send()
        self._log_overview()

    def _log_static_surfaces(self) -> None:
        for mesh in self._artist.meshes:
            geom = self.scene.model.geom(mesh.geom)
            albedo = (
                np.array([255.0, 255.0, 255.0, mesh.rgba[3]])
                if self._artist.is_shaded
                else mesh.rgba
            )
            self._log(
                self._entity(mesh),
                rr.Transform3D(translation=geom.pos, quaternion=np.roll(geom.quat, -1)),
                rr.Mesh3D(
                    vertex_positions=mesh.corners,
                    triangle_indices=mesh.corner_faces,
                    vertex_normals=mesh.corner_normals,
                    albedo_factor=rounded(albedo),
                ),
            )
        water = rr.Mesh3D.from_fields(
            triangle_indices=self._artist.water_faces,
            albedo_factor=(255, 255, 255, WATER_OPACITY),
        )
        self._log("world/water", water)

    def _log_static_lines(self) -> None:
        """Log the colours and widths of all lines, and the arrows of the weights."""
        meshes = self._artist.meshes.of_bodies()
        sizes = np.array([mesh.size for mesh in meshes])
        density = self.scene.buoyancy.sea.density
        displaced = self._weights / (density * -self.scene.model.opt.gravity[2])
        lengths = ARROW_IN_HULLS * np.minimum(sizes, WIDEST_ARROW * np.cbrt(displaced))
        self._metres_per_newton = (lengths / self._weights)[:, None]
        own = self.scene.model.body_mass[self.scene.buoyancy.bodies]
        weight = own[:, None] * self.scene.model.opt.gravity
        for name, colour in FORCE_COLOURS.items():
            arrows = rr.Arrows3D.from_fields(colors=[colour], radii=0.014 * sizes)
            self._log(f"world/forces/{name}", arrows)
        weight = rr.Arrows3D.from_fields(vectors=self._metres_per_newton * weight)
        self._log("world/forces/weight", weight)
        waterline = rr.LineStrips3D.from_fields(
            colors=[WATERLINE_COLOUR], radii=0.009 * min(mesh.size for mesh in self._artist.meshes)
        )
        self._log("world/waterline", waterline)
        trail = rr.LineStrips3D.from_fields(
            colors=[rounded(mesh.rgba[:3]) for mesh in meshes],
            radii=0.006 * sizes,
        )
        self._log("world/trail", trail)
        for quantity, path in SERIES.items():
            for name, mesh in zip(self._plotted, meshes, strict=False):
                colour, label, width = mesh.rgba[:3], name, 2.0
                if quantity in WATER_QUANTITIES:
                    colour, label, width = WATER_SERIES_COLOUR, f"water at {name}", 1.0
                line = rr.SeriesLines(names=label, colors=[rounded(colour)], widths=[width])
                self._log(path.format(path_part(name)), line)
            if self._others:
                self._log(OTHER_SERIES[quantity], rr.SeriesLines(names=self._others))

    def _entity(self, mesh: DisplayMesh) -> str:
        buoyancy = self.scene.buoyancy
        body = buoyancy.body_names[buoyancy.bodies.tolist().index(mesh.body)]
        return f"world/bodies/{path_part(body)}/{path_part(mesh.name)}"

    def _log_overview(self) -> None:
        text = overview(self.scene, self._tally, self._artist.largest_head)
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._log("overview", document)

    def _log(self, entity: str, *components: Any) -> None:
        self._output.log(f"{self._root}/{entity}", *components, static=True)

    def _send(self) -> None:
        """Send the waiting frames, with one call per entity."""
        self._sent_at = self._clock()
        if not self._waiting:
            return
        frames, self._waiting = self._waiting, []
        samples = [frame.sample for frame in frames]
        indexes = [
            rr.TimeColumn("time", duration=[sample.time for sample in samples]),
            rr.TimeColumn("frame", sequence=range(self.frames - len(frames), self.frames)),
        ]

        def send(entity: str, columns: rr.ComponentColumnList) -> None:
            path = f"{self._root}/{entity}"
            self._output.send_columns(path, indexes=indexes, columns=columns)

        self._send_poses(samples, send)
        self._send_surfaces(frames, send)
        self._send_lines(frames, send)
        self._send_forces(samples, send)
        self._send_series(samples, send)

    def _send_poses(self, samples: list[Sample], send: Send) -> None:
        for i, name in enumerate(self.scene.buoyancy.body_names):
            pose = rr.Transform3D.columns(
                translation=[s.positions[i] for s in samples],
                quaternion=np.roll([s.quaternions[i] for s in samples], -1, axis=1),
            )
            send(f"world/bodies/{path_part(name)}", pose)
        level = self.scene.buoyancy.sea.level_at
        focus = [[*s.centres[:, :2].mean(axis=0), float(level(s.time))] for s in samples]
        send("world/focus", rr.Transform3D.columns(translation=focus))

    def _send_surfaces(self, frames: list[Frame], send: Send) -> None:
        """Send the water and the colours of the hulls."""
        water = rr.Mesh3D.columns(
            vertex_positions=np.concatenate([f.particles for f in frames]),
            vertex_colors=WATER_PALETTE[np.concatenate([f.heights for f in frames])],
        )
        send("world/water", water.partition([f.particles.shape[0] for f in frames]))
        if not self._artist.is_shaded:
            return
        wetness = np.stack([f.wetness for f in frames if f.wetness is not None])
        for mesh, shades in zip(self._artist.meshes, self._palettes, strict=True):
            of_corners = np.take(wetness, mesh.vertices.start + mesh.corner_vertices, axis=1)
            shade = rr.Mesh3D.columns(vertex_colors=np.take(shades, of_corners).ravel())
            send(self._entity(mesh), shade.partition([len(mesh.corners)] * len(frames)))

    def _send_lines(self, frames: list[Frame], send: Send) -> None:
        lines = {"waterline": [f.curves for f in frames], "trail": [f.trail for f in frames]}
        for name, strips in lines.items():
            columns = rr.LineStrips3D.columns(strips=[line for frame in strips for line in frame])
            if name == "waterline" or any(strips):
                send(f"world/{name}", columns.partition([len(frame) for frame in strips]))

    def _send_forces(self, samples: list[Sample], send: Send) -> None:
        """Send the arrows at the centres of mass; the weight's vectors never change."""
        sizes = [len(s.centres) for s in samples]
        origins = np.concatenate([s.centres for s in samples]).astype(np.float32)
        wrenches = {
            "buoyancy": [s.body_wrenches for s in samples],
            "drag": [s.drag_wrenches for s in samples],
        }
        for name, wrench in wrenches.items():
            vectors = np.stack(wrench)[:, :, :3] * self._metres_per_newton
            arrows = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3), origins=origins)
            send(f"world/forces/{name}", arrows.partition(sizes))
        send("world/forces/weight", rr.Arrows3D.columns(origins=origins).partition(sizes))

    def _send_series(self, samples: list[Sample], send: Send) -> None:
        sea = self.scene.buoyancy.sea
        motions = [motion(s, sea, self._rest_heights) for s in samples]
        values = {
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
        for quantity, path in SERIES.items():
            of_bodies = np.stack(values[quantity], axis=1)
            for name, series in zip(self._plotted, of_bodies, strict=False):
                send(path.format(path_part(name)), rr.Scalars.columns(scalars=series))
            if self._others:
                rows = rr.Scalars.columns(scalars=of_bodies[MOST_PLOTTED:].T.ravel())
                sizes = [len(self._others)] * len(samples)
                send(OTHER_SERIES[quantity], rows.partition(sizes))


class Recording:
    """Scene writers and their output; a context manager that closes the output.

    seconds: wall time [s] of logging so far.
    """

    def __init__(self, output: Output, writers: Sequence[SceneWriter]) -> None:
        self._output, self._writers = output, writers
        self.seconds = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def frames(self) -> int:
        """The number of frames so far."""
        return self._writers[0].frames

    def close(self) -> None:
        """Write the waiting frames and the means over the run, and close the output. Further calls
        do nothing."""
        if not self._output.is_open:
            return
        started = perf_counter()
        for writer in self._writers:
            writer.finish()
        self._output.close()
        self.seconds += perf_counter() - started

    def _log(self, samples: Sequence[Sample]) -> None:
        started = perf_counter()
        for writer, sample in zip(self._writers, samples, strict=True):
            writer.log(sample)
        self.seconds += perf_counter() - started


class Recorder(Recording):
    """Writes samples of one scene to an .rrd file, shows them in a viewer, or both; a context
    manager.

        with Recorder("run.rrd", scene) as recorder:
            for sample in simulate(scene, 10.0):
                recorder.log(sample)

    path: of the file, or None. rate: the largest number of frames per simulated second [Hz], None
    for one per sample. water_size [m]: side of the water's square, None to fit the bodies.
    water_resolution: vertices along that side. view: whether to show the run in a viewer, which is
    opened unless one listens on `port`. colour: the colouring of hulls, "wet" or "pressure".
    frames, seconds: the number of frames so far, and the wall time [s] of logging.

    The file is readable after the block ends, also by an exception. Missing folders are made.
    Raises OSError if the file cannot be written, now or later (data until a second before stays
    readable), or if no viewer can be opened; ValueError for invalid numbers.
    """

    def __init__(
        self,
        path: str | Path | None,
        scene: Scene,
        rate: float | None = None,
        water_size: float | None = None,
        water_resolution: int = WATER_RESOLUTION,
        view: bool = False,
        port: int = VIEWER_PORT,
        colour: str = COLOURS[0],
    ) -> None:
        if rate is not None and not (np.isfinite(rate) and rate > 0.0):
            raise ValueError(f"the recording rate is {rate}; it must be finite and above 0")
        artist = Artist(scene, DisplayMeshes(scene.buoyancy), water_size, water_resolution, colour)
        self.path = None if path is None else Path(path)
        output = Output(self.path, scene.name, blueprint(scene), view, port)
        longest_wait = LONGEST_VIEWER_WAIT if view else LONGEST_WAIT
        super().__init__(output, [SceneWriter(scene, output, artist, "", rate, longest_wait)])

    def log(self, sample: Sample) -> None:
        """Add one sample as the next frame, unless it comes before the next frame is due."""
        self._log([sample])
