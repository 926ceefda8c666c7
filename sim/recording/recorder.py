"""Recorder: writes Samples to a Rerun file with a blueprint.

Entities, all in world axes [m]:

    world/water                     the surface around the bodies, made of its own particles
    world/horizon/sea, sky          the far sea and the sky around it
    world/bodies/<body>             pose of the body frame; below it its hulls, darker where wet,
                                    its other geoms, and its sites
    world/tendons/<tendon>          paths of tendons
    world/contacts                  forces of contacts
    world/waterline                 where the surface meets the hulls
    world/forces/<force>            arrows: buoyancy at its centre, weight and drag at the centre of
                                    mass
    world/trail                     recent positions of the centres of mass, hidden at first
    world/focus                     target of the camera, which moves with it
    plots/<quantity>/<body>         heave, surge, height and height of the water [m], tilt, heel,
                                    trim [deg], submerged fraction [-], vertical buoyant force
                                    [weights]
    others/<quantity>               the same of all bodies beyond MOST_PLOTTED, in one row
    envelope/<quantity>             largest, mean and smallest value over so many bodies
    overview                        scene, sea, hulls and settings; at the end the means

The timelines are `time` (simulated seconds) and `frame`. If the time of the samples goes back, as
after a reset, a new episode begins: `time` goes on after a gap of EPISODE_GAP.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic, perf_counter
from typing import Any, Self

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import notebook

from sim.mjcf.floats import body_label
from sim.recording.colours import palette, rounded
from sim.recording.display_mesh import DisplayMesh, DisplayMeshes
from sim.recording.episodes import EPISODE_GAP, Episodes
from sim.recording.frame import WATER_RESOLUTION, Artist, Frame
from sim.recording.look import (
    COLOURS,
    CONTACT_COLOUR,
    FORCE_COLOURS,
    HEAD_PALETTE,
    TINT_SHARE,
    TRAIL_COLOUR,
    WATERLINE_COLOUR,
    WET_TINT,
    blueprint,
    overview,
)
from sim.recording.output import PROGRAM, VIEWER_PORT, Output, path_part
from sim.recording.plots import Plots
from sim.recording.reader import reader
from sim.recording.sea_surface import WATER_OPACITY
from sim.runs.simulation import Sample, observe
from sim.runs.tally import Tally
from sim.scenes.scene import Scene

Array = NDArray[np.float64]
Send = Callable[[str, rr.ComponentColumnList], None]

ARROW_RADIUS = 0.022
"""Radius of an arrow over the length of the weight's arrow."""

ARROW_IN_HULLS, WIDEST_ARROW = 0.75, 1.8
"""Length of the weight's arrow, in diagonals of the body's largest hull, and the largest diagonal
that counts, in cube roots of the volume that the body displaces, unless the hull is taller. Arrows
then end outside hulls."""

CONTACT_ARROW = 0.12
"""Largest length of a contact's arrow, in distances of the eye."""

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
        self._due = -np.inf
        self._episodes = Episodes()
        self._waiting: list[Frame] = []
        self._had_contacts = False
        self._tally = Tally(scene)
        self._plots = Plots(scene, artist.meshes.of_bodies())
        self._weights = scene.buoyancy.weights
        self._palettes = [
            palette(mesh.rgba[:3], mesh.rgba[:3] + TINT_SHARE * (WET_TINT - mesh.rgba[:3]))
            if artist.largest_head is None
            else HEAD_PALETTE
            for mesh in artist.meshes
        ]
        output.log(root or "/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log_bodies()
        self._log_water()
        self._log_lines()
        for entity, line in self._plots.styles():
            self._log(entity, line)
        self._log_overview()
        output.flush()
        artist.frame(observe(scene), 0.0)  # compiles before the run's time counts
        artist.forget()
        self._sent_at = self._clock()

    def log(self, sample: Sample) -> None:
        """Add one sample as the next frame, unless it comes before the next frame is due."""
        self._tally.add(sample)
        if self._episodes.is_new(sample.time):
            self._begin(sample)
        time = self._episodes.add(sample.time)
        if sample.time < self._due - 1e-9:
            return
        self._due += self._period
        self._waiting.append(self._artist.frame(sample, time))
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

    def _begin(self, sample: Sample) -> None:
        """Begin an episode with a sample. The plotted lines have a gap before it."""
        self._due = sample.time
        self._plots.begin(sample)
        self._artist.forget()
        if self._episodes.starts:
            self._send()
            end = self._episodes.time + 0.5 * EPISODE_GAP
            index = rr.TimeColumn("time", duration=[end])
            for entity in ("plots", "others", "envelope"):
                self._output.send_columns(
                    f"{self._root}/{entity}",
                    indexes=[index],
                    columns=rr.Clear.columns(is_recursive=[True]),
                )

    def _log_bodies(self) -> None:
        """Log the surfaces of hulls, other geoms and sites, and the poses of bodies that are
        fixed."""
        artist, model = self._artist, self.scene.model
        for mesh in artist.meshes:
            if not mesh.is_drawn:
                continue
            geom = model.geom(mesh.geom)
            white = np.array([255.0, 255.0, 255.0, mesh.rgba[3]])
            self._log(
                self._entity(mesh),
                _transform(geom.pos, geom.quat),
                rr.Mesh3D(
                    vertex_positions=mesh.corners,
                    triangle_indices=mesh.corner_faces,
                    vertex_normals=mesh.corner_normals,
                    albedo_factor=rounded(white if artist.is_shaded else mesh.rgba),
                ),
            )
        for part in artist.parts:
            self._log(self._body(part.body, *part.path), _transform(*part.pose), part.mesh)
        data = self.scene.data
        for body in {part.body for part in artist.parts} - set(artist.moving):
            self._log(self._body(body), _transform(data.xpos[body], data.xquat[body]))

    def _log_water(self) -> None:
        surface = self._artist.surface
        water = rr.Mesh3D.from_fields(
            triangle_indices=surface.faces, albedo_factor=(255, 255, 255, WATER_OPACITY)
        )
        self._log("world/water", water)
        for name, (points, faces, colours) in surface.backdrop().items():
            mesh = rr.Mesh3D(vertex_positions=points, triangle_indices=faces, vertex_colors=colours)
            self._log(f"world/horizon/{name}", mesh)

    def _log_lines(self) -> None:
        """Log the colours and widths of all lines, and the arrows of the weights."""
        artist, model = self._artist, self.scene.model
        sizes = np.array([mesh.size for mesh in artist.meshes.of_bodies()])
        density = self.scene.buoyancy.sea.density
        displaced = self._weights / (density * -model.opt.gravity[2])
        points, _ = artist.meshes.placed(observe(self.scene))
        tall = [np.ptp(points[mesh.vertices, 2]) for mesh in artist.meshes.of_bodies()]
        broad = np.maximum(tall, WIDEST_ARROW * np.cbrt(displaced))
        lengths = ARROW_IN_HULLS * np.minimum(sizes, broad)
        self._metres_per_newton = (lengths / self._weights)[:, None]
        own = self.scene.model.body_mass[self.scene.buoyancy.bodies]
        weight = own[:, None] * self.scene.model.opt.gravity
        for name, colour in FORCE_COLOURS.items():
            arrows = rr.Arrows3D.from_fields(colors=[colour], radii=ARROW_RADIUS * lengths)
            self._log(f"world/forces/{name}", arrows)
        weight = rr.Arrows3D.from_fields(vectors=self._metres_per_newton * weight)
        self._log("world/forces/weight", weight)
        thin = artist.line_radius
        for name, colour in {"waterline": WATERLINE_COLOUR, "trail": TRAIL_COLOUR}.items():
            line = rr.LineStrips3D.from_fields(colors=[colour], radii=thin)
            self._log(f"world/{name}", line)
        arrows = rr.Arrows3D.from_fields(colors=[CONTACT_COLOUR], radii=2.0 * thin)
        self._log("world/contacts", arrows)
        for tendon, name in artist.tendons.items():
            line = rr.LineStrips3D.from_fields(
                colors=[rounded(255.0 * model.tendon_rgba[tendon])],
                radii=max(float(model.tendon_width[tendon]), thin),
            )
            self._log(f"world/tendons/{path_part(name)}", line)

    def _entity(self, mesh: DisplayMesh) -> str:
        return self._body(mesh.body, mesh.name)

    def _body(self, body: int, *below: str) -> str:
        """The entity of a body, or of something below it."""
        names = body_label(self.scene.model, body), *below
        return "/".join(["world/bodies", *map(path_part, names)])

    def _log_overview(self) -> None:
        text = overview(self.scene, self._tally, self._artist.largest_head, self._episodes.starts)
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
            rr.TimeColumn("time", duration=[frame.time for frame in frames]),
            rr.TimeColumn("frame", sequence=range(self.frames - len(frames), self.frames)),
        ]

        def send(entity: str, columns: rr.ComponentColumnList) -> None:
            path = f"{self._root}/{entity}"
            self._output.send_columns(path, indexes=indexes, columns=columns)

        self._send_poses(frames, send)
        self._send_surfaces(frames, send)
        self._send_lines(frames, send)
        self._send_forces(frames, send)
        for entity, columns in self._plots.columns(samples):
            send(entity, columns)

    def _send_poses(self, frames: list[Frame], send: Send) -> None:
        """Send the poses of the bodies, and the places of the camera and the horizon."""
        positions = np.stack([f.positions for f in frames], axis=1)
        quaternions = np.roll([f.quaternions for f in frames], -1, axis=2)
        for i, body in enumerate(self._artist.moving):
            pose = rr.Transform3D.columns(translation=positions[i], quaternion=quaternions[:, i])
            send(self._body(body), pose)
        focus = np.array([f.focus for f in frames])
        send("world/focus", rr.Transform3D.columns(translation=focus))
        level = self.scene.buoyancy.sea.level_at([f.sample.time for f in frames])
        middle = np.column_stack([focus[:, :2], level])
        send("world/horizon", rr.Transform3D.columns(translation=middle))

    def _send_surfaces(self, frames: list[Frame], send: Send) -> None:
        """Send the water and the colours of the hulls."""
        water = rr.Mesh3D.columns(
            vertex_positions=np.concatenate([f.water.points for f in frames]),
            vertex_colors=np.concatenate([f.water.colours for f in frames]),
        )
        send("world/water", water.partition([len(f.water.points) for f in frames]))
        if not self._artist.is_shaded:
            return
        wetness = np.stack([f.wetness for f in frames if f.wetness is not None])
        for mesh, shades in zip(self._artist.meshes, self._palettes, strict=True):
            if not mesh.is_drawn:
                continue
            of_corners = np.take(wetness, mesh.vertices.start + mesh.corner_vertices, axis=1)
            shade = rr.Mesh3D.columns(vertex_colors=np.take(shades, of_corners).ravel())
            send(self._entity(mesh), shade.partition([len(mesh.corners)] * len(frames)))

    def _send_lines(self, frames: list[Frame], send: Send) -> None:
        lines = {"waterline": [f.curves for f in frames], "trail": [f.trail for f in frames]}
        for i, name in enumerate(self._artist.tendons.values()):
            lines[f"tendons/{path_part(name)}"] = [f.tendons[i] for f in frames]
        for name, strips in lines.items():
            columns = rr.LineStrips3D.columns(strips=[line for frame in strips for line in frame])
            if name == "waterline" or any(strips):
                send(f"world/{name}", columns.partition([len(frame) for frame in strips]))

    def _send_forces(self, frames: list[Frame], send: Send) -> None:
        """Send the arrows of forces; the weight's vectors never change."""
        samples = [f.sample for f in frames]
        centres = [s.centres for s in samples]
        sizes = [len(s.centres) for s in samples]
        arrows = {
            "buoyancy": ([s.body_wrenches for s in samples], [f.upward for f in frames]),
            "drag": ([s.drag_wrenches for s in samples], centres),
        }
        for name, (wrench, origins) in arrows.items():
            vectors = np.stack(wrench)[:, :, :3] * self._metres_per_newton
            columns = rr.Arrows3D.columns(
                vectors=vectors.reshape(-1, 3), origins=np.concatenate(origins)
            )
            send(f"world/forces/{name}", columns.partition(sizes))
        columns = rr.Arrows3D.columns(origins=np.concatenate(centres))
        send("world/forces/weight", columns.partition(sizes))
        self._send_contacts(frames, send)

    def _send_contacts(self, frames: list[Frame], send: Send) -> None:
        """Send the arrows of contacts, of which very large ones are shortened."""
        counts = [len(f.contacts[0]) for f in frames]
        if not (any(counts) or self._had_contacts):
            return
        self._had_contacts = any(counts)
        origins = np.concatenate([f.contacts[0] for f in frames])
        forces = np.concatenate([f.contacts[1] for f in frames])
        vectors = forces * self._metres_per_newton.max()
        longest = CONTACT_ARROW * self._artist.framing.distance
        lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
        vectors *= np.minimum(1.0, longest / np.maximum(lengths, longest))
        arrows = rr.Arrows3D.columns(vectors=vectors, origins=origins)
        send("world/contacts", arrows.partition(counts))


def _transform(position: Array, quaternion: Array) -> rr.Transform3D:
    """A pose with a quaternion (w, x, y, z); Rerun puts w last."""
    return rr.Transform3D(translation=position, quaternion=np.roll(quaternion, -1).tolist())


class Recording:
    """Scene writers and their output; a context manager that closes the output.

    path: of the file, or None. seconds: wall time [s] of logging so far. stream: Rerun's stream,
    for data of your own.
    """

    path: Path | None

    def __init__(self, output: Output, writers: Sequence[SceneWriter]) -> None:
        self._output, self._writers = output, writers
        self.stream = output.stream
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

    def _ipython_display_(self) -> None:
        """Show the recorded file in a notebook, which needs the extra `notebook`. Raises ValueError
        if there is no file yet."""
        if self._output.is_open or self.path is None:
            raise ValueError(
                "the recording is not complete: show it after its 'with' block, or after close(); "
                "it must be a file"
            )
        stream = rr.RecordingStream(PROGRAM)
        viewer = notebook.Viewer(
            recording=stream, blueprint=self._output.blueprint, width="auto", height="auto"
        )
        viewer.display()
        with reader(self.path) as recording:
            rr.send_chunks(recording.stream(), recording=stream)

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
    for one per sample. water_size [m]: width of the water that moves, None to fit the bodies.
    water_resolution: square root of about the number of its vertices. view: whether to show the run
    in a viewer, which is opened unless one listens on `port`. colour: the colouring of hulls, "wet"
    or "pressure". frames, seconds: the number of frames so far, and the wall time [s] of logging.

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
        arrangement = blueprint(scene, artist.framing.distance)
        output = Output(self.path, scene.name, arrangement, view, port)
        longest_wait = LONGEST_VIEWER_WAIT if view else LONGEST_WAIT
        super().__init__(output, [SceneWriter(scene, output, artist, "", rate, longest_wait)])

    def log(self, sample: Sample) -> None:
        """Add one sample as the next frame, unless it comes before the next frame is due."""
        self._log([sample])
