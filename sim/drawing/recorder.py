"""Recording: Samples -> a Rerun file with its own blueprint. The only file that knows Rerun.

Entities, all in world axes [m]:

    world/water                     the surface around the bodies, made of its own particles
    world/bodies/<body>             pose of the body frame; below it its hulls, wet parts darker
    world/waterline                 where the surface meets the hulls
    world/forces/<force>            arrows at the centres of mass: buoyancy, weight, drag
    world/trail                     where the centres of mass have just been
    world/focus                     what the camera looks at and moves with
    plots/<quantity>/<body>         height and water height [m], tilt [deg], submerged
                                    fraction [-], vertical buoyant force [weights]
    others/<quantity>               the same of all bodies beyond MOST_PLOTTED, in one row, named
    overview                        scene, sea, hulls and settings; at the end the means

on the timelines `time` (simulated seconds) and `frame`.
"""

import atexit
import os
import socket
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import monotonic, perf_counter
from types import TracebackType
from typing import Any, NoReturn

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from sim.coupling.scene import Scene
from sim.coupling.simulation import Sample, Tally, observe
from sim.drawing.display_mesh import Skin, Skins
from sim.drawing.waterline_curves import heads, waterlines
from sim.water.sea import Sea

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_Send = Callable[[str, rr.ComponentColumnList], None]

WATER_RESOLUTION = 48
"""Vertices along a side of the water's grid; a frame takes 16 bytes for each of its square."""

WATER_IN_HULLS, WATER_IN_SPREADS = 6.0, 2.4
"""Side of the water's square: so many sides of the largest hull and as many times the distance that
the bodies are apart."""

EYE_IN_HULLS, EYE_IN_SPREADS = 2.6, 0.9
"""Distance of the eye from what it looks at, likewise: near enough for the waterline, far enough to
have all bodies and a wave or two around them."""

EYE_DIRECTION = np.array([-0.49, -0.78, 0.39])

MOST_SHADED_VERTICES = 20_000
"""Of all hulls together; with more of them the wet part is not told apart by colour, because
writing the colours anew takes 4 bytes for each vertex and frame."""

MOST_WATERLINE_POINTS = 4000
"""In a frame, of all hulls together; of more only every second, third ... is kept. Each takes 12
bytes, so a hundred finely drawn hulls would take more than the water."""

FEWEST_OF_A_CURVE = 12
"""Points that a waterline keeps in any case."""

MOST_PLOTTED = 6
"""Bodies in the plots and the overview, the first ones. The series of the others are in the
recording too, as rows of one entity: an entity each would take ten times the space. With more
bodies than these there are no trails: they would be a thicket."""

MOST_WAVES_NAMED = 4
"""Waves of a sea up to which the overview has each."""

TRAIL_SECONDS = 3.0
"""How far back the trails go."""

TROUGH_COLOUR, CREST_COLOUR = np.array([12.0, 50.0, 104.0]), np.array([122.0, 196.0, 228.0])
WATER_OPACITY = 125
SKY_COLOUR = (40, 56, 72)
WET_TINT, WET_SHARE = np.array([20.0, 70.0, 130.0]), 0.4
"""A wet surface has this share of the colour WET_TINT."""

GOLDEN_TURN = 0.618
"""From one twin's hue to the next: however many there are, no two of them come near each other."""

WATER_SERIES_COLOUR = np.array([90.0, 150.0, 200.0])
ARROW_IN_HULLS = 0.55
"""Length of the weight's arrow in diagonals of the body's largest hull."""

WATERLINE_COLOUR = (255, 255, 255)
FORCE_COLOURS = {"buoyancy": (80, 200, 120), "weight": (220, 80, 60), "drag": (240, 180, 60)}

PLOTS = {
    "height": "Height of body and water [m]",
    "tilt": "Tilt [deg]",
    "force": "Buoyant force [weights]",
    "submerged": "Submerged [of the volume]",
}
"""Time series views, in order: the first part of the entity path and the title."""

PLOT_SHARES = (1.0, 1.0, 1.0, 1.55)
"""Heights of the three plots and the overview below them."""

SERIES = {
    "height": "plots/height/{}",
    "water_height": "plots/height/{}/water",
    "tilt_deg": "plots/tilt/{}",
    "submerged_fraction": "plots/submerged/{}",
    "vertical_force": "plots/force/{}",
}
"""Entity path of every quantity of a body that is plotted."""

OTHER_SERIES = {
    quantity: path.replace("plots/", "others/").replace("/{}", "")
    for quantity, path in SERIES.items()
}
"""Entity path of every quantity of all those that are not."""

VIEWER_PORT = 9876
"""Where a Rerun viewer listens."""

FLUSH_SECONDS = 5.0
"""Longest wait for the disk to take about a megabyte. Rerun's writer, once it has given up, leaves
a flush unanswered, so this is also how long it takes to notice that the disk is full."""

BATCH_SECONDS = 1.0
"""Simulated time that is sent at once, in columns: a row by itself costs ten times as much."""

LONGEST_WAIT, LONGEST_WAIT_TO_VIEW = 0.7, 0.05
"""Seconds of wall time after which what there is of a batch is sent: a run that is killed loses no
more than that and a frame, and somebody who looks on sees it move."""

SHADES = 256
"""Colours from dry to wet and from trough to crest."""

ABANDONED: list[rr.RecordingStream] = []
"""Streams whose writer has died. A process that has one must leave by `os._exit`."""


class _Output:
    """An .rrd file, a viewer, or both, that takes what is logged.

    Raises OSError where that cannot be, at once or when the disk fills up; the file then ends
    with the last flush, readable, or is removed if nothing had been written.
    """

    def __init__(
        self, path: Path | None, name: str, blueprint: rrb.Blueprint, view: bool = False
    ) -> None:
        self._path = path
        self._intact: int | None = 0
        self._stream = stream = rr.RecordingStream("waterline")
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        self.log, self.send_columns = stream.log, stream.send_columns
        sinks = []
        if view:
            _open_viewer()
            sinks.append(rr.GrpcSink(f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy"))
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            _check_writable(path)
            sinks.append(rr.FileSink(path))
        try:
            stream.set_sinks(*sinks, default_blueprint=blueprint)
        except RuntimeError as error:
            self._give_up(error)
        stream.send_recording_name(name)

    def flush(self) -> None:
        """Have all that was logged on disk."""
        try:
            self._stream.flush(timeout_sec=FLUSH_SECONDS)
        except RuntimeError as error:
            self._give_up(error)
        if self._path is not None:
            self._intact = self._path.stat().st_size

    @property
    def is_open(self) -> bool:
        """False after the end, good or bad."""
        return self._intact is not None

    def close(self) -> None:
        """Write what is waiting and let go of file and viewer."""
        self.flush()
        self._stream.disconnect()
        self._intact = None

    def _give_up(self, error: RuntimeError) -> NoReturn:
        intact, self._intact = self._intact, None
        # Disconnecting, collecting the stream and Rerun's shutdown would wait for the dead
        # writer for ever.
        atexit.unregister(rr.rerun_shutdown)
        ABANDONED.append(self._stream)
        if self._path is not None and self._path.is_file():
            os.truncate(self._path, intact)
            if intact == 0:
                self._path.unlink()
        reason = " ".join(str(error).split())
        raise OSError(
            f"{self._path}: the recording cannot be written ({reason}); make room on the disk or "
            "record elsewhere. What was written before is intact"
        )


class _Part:
    """The part of an output below one entity."""

    def __init__(self, output: _Output, root: str) -> None:
        self._output, self._root = output, root
        self.flush = output.flush

    def log(self, entity: str, *what: Any, **options: Any) -> None:
        self._output.log(f"{self._root}/{entity}".rstrip("/"), *what, **options)

    def send_columns(self, entity: str, **columns: Any) -> None:
        self._output.send_columns(f"{self._root}/{entity}", **columns)

    @property
    def is_open(self) -> bool:
        return self._output.is_open

    def close(self) -> None:
        """Leave the output open: it has other parts."""


class Recorder:
    """Writes samples of one scene to an .rrd file, shows them in a viewer, or both; a context
    manager.

        with Recorder("run.rrd", scene) as recorder:
            for sample in simulate(scene, 10.0):
                recorder.log(sample)

    path: of the file, or None for none; rate: frames a simulated second [Hz] at most, None for
    one a sample; water_size [m]: side of the water's square; water_resolution: vertices along
    that side; view: open a viewer, or use the one that is open, and show the run as it goes.

    output: part of a recording that is open already, instead of a file of its own; hue: by which
    the bodies' colours are off, in turns.
    frames, seconds: how many there are by now, and the wall time that they have taken.

    The file is readable whenever the block is left, by an exception too. Missing folders are
    made. Raises OSError when the file cannot be written, now or later (what was written until a
    second before stays readable), or no viewer can be opened, ValueError for numbers that
    cannot be.
    """

    def __init__(
        self,
        path: str | Path | None,
        scene: Scene,
        rate: float | None = None,
        water_size: float | None = None,
        water_resolution: int = WATER_RESOLUTION,
        view: bool = False,
        output: _Part | None = None,
        hue: float = 0.0,
    ) -> None:
        _check_numbers(rate, water_size, water_resolution)
        self.path = None if path is None else Path(path)
        self.scene = scene
        self._period = 0.0 if rate is None else 1.0 / rate
        self._due: float | None = None
        self.frames, self.seconds = 0, 0.0
        self._waiting: list[_Frame] = []
        self._longest_wait = LONGEST_WAIT_TO_VIEW if view else LONGEST_WAIT
        self._tally = Tally(scene)
        self._skins = Skins(scene.buoyancy, hue)
        self._largest_skins = self._skins.of_bodies()
        names = scene.buoyancy.body_names
        self._plotted, self._others = names[:MOST_PLOTTED], names[MOST_PLOTTED:]
        self._prepare_shades()
        side = water_size or _extent(scene, WATER_IN_HULLS, WATER_IN_SPREADS)
        self._steps = 0.5 * side * np.linspace(-1.0, 1.0, water_resolution)
        self._weights = scene.model.body_mass[scene.buoyancy.bodies] * -scene.model.opt.gravity[2]
        self._trail: deque[tuple[float, NDArray[np.float32]]] = deque()
        self._output = output or _Output(self.path, scene.name, _blueprint(scene), view)
        self._log_static()
        self._output.flush()
        self._drawn(observe(scene))  # compiles what is not, before the run's time counts
        self._trail.clear()
        self._sent_at = monotonic()

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
        """Write what is waiting and the means over the run, and close the file; a second time
        does nothing."""
        if not self._output.is_open:
            return
        started = perf_counter()
        self._send()
        self._log_overview()
        self._output.close()
        self.seconds += perf_counter() - started

    def log(self, sample: Sample) -> None:
        """Add one sample as the next frame, unless it comes before one is due."""
        started = perf_counter()
        self._tally.add(sample)
        if self._due is None:
            self._due = sample.time
        if sample.time >= self._due - 1e-9:
            self._due += self._period
            self.frames += 1
            self._waiting.append(self._drawn(sample))
            first = self._waiting[0].sample
            late = monotonic() - self._sent_at > self._longest_wait
            if late or sample.time - first.time >= BATCH_SECONDS:
                self._send()
                self._output.flush()
        self.seconds += perf_counter() - started

    def _prepare_shades(self) -> None:
        """Colours from dry to wet, which follow each other within half an edge."""
        skins = self._skins
        self._shaded = skins.vertex_count <= MOST_SHADED_VERTICES
        self._palettes = [
            _palette(skin.rgba[:3], skin.rgba[:3] + WET_SHARE * (WET_TINT - skin.rgba[:3]))
            for skin in skins
        ]
        self._wetness_per_metre = np.empty(skins.vertex_count)
        for skin in skins:
            self._wetness_per_metre[skin.vertices] = 2.0 / skin.edge

    def _log_static(self) -> None:
        """All that stays as it is over the run."""
        self._output.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log_static_surfaces()
        self._log_static_lines()
        self._log_overview()

    def _log_static_surfaces(self) -> None:
        for skin in self._skins:
            body = self.scene.model.body(skin.body)
            albedo = np.array([255.0, 255.0, 255.0, skin.rgba[3]]) if self._shaded else skin.rgba
            self._output.log(
                self._entity(skin),
                rr.Transform3D(translation=body.ipos, quaternion=np.roll(body.iquat, -1)),
                rr.Mesh3D(
                    vertex_positions=skin.corners,
                    triangle_indices=skin.corner_faces,
                    vertex_normals=skin.corner_normals,
                    albedo_factor=_rounded(albedo),
                ),
                static=True,
            )
        water = rr.Mesh3D.from_fields(
            triangle_indices=_grid_faces(len(self._steps)),
            albedo_factor=(255, 255, 255, WATER_OPACITY),
        )
        self._output.log("world/water", water, static=True)

    def _log_static_lines(self) -> None:
        """Colours and widths of all lines; a body's weight is as long as ARROW_IN_HULLS says."""
        output, skins = self._output, self._largest_skins
        sizes = np.array([skin.size for skin in skins])
        self._metres_per_newton = (ARROW_IN_HULLS * sizes / self._weights)[:, None]
        weight = self._weights[:, None] * [0.0, 0.0, -1.0]
        for name, colour in FORCE_COLOURS.items():
            arrows = rr.Arrows3D.from_fields(colors=[colour], radii=0.014 * sizes)
            output.log(f"world/forces/{name}", arrows, static=True)
        weight = rr.Arrows3D.from_fields(vectors=self._metres_per_newton * weight)
        output.log("world/forces/weight", weight, static=True)
        waterline = rr.LineStrips3D.from_fields(
            colors=[WATERLINE_COLOUR], radii=0.009 * min(skin.size for skin in self._skins)
        )
        output.log("world/waterline", waterline, static=True)
        trail = rr.LineStrips3D.from_fields(
            colors=[_rounded(skin.rgba[:3]) for skin in skins],
            radii=0.006 * sizes,
        )
        output.log("world/trail", trail, static=True)
        for quantity, path in SERIES.items():
            for name, skin in zip(self._plotted, skins, strict=False):
                colour, label, width = skin.rgba[:3], name, 2.0
                if quantity == "water_height":
                    colour, label, width = WATER_SERIES_COLOUR, f"water at {name}", 1.0
                line = rr.SeriesLines(names=label, colors=[_rounded(colour)], widths=[width])
                output.log(path.format(_part(name)), line, static=True)
            if self._others:
                output.log(OTHER_SERIES[quantity], rr.SeriesLines(names=self._others), static=True)

    def _entity(self, skin: Skin) -> str:
        buoyancy = self.scene.buoyancy
        body = buoyancy.body_names[buoyancy.bodies.tolist().index(skin.body)]
        return f"world/bodies/{_part(body)}/{_part(skin.name)}"

    def _log_overview(self) -> None:
        text = overview(self.scene, self._tally)
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._output.log("overview", document, static=True)

    def _drawn(self, sample: Sample) -> "_Frame":
        """What a sample looks like."""
        particles = self._particles(sample)
        sea = self.scene.buoyancy.sea
        highest = max(min(sea.amplitude, 0.5 * sea.significant_height), 1e-9)
        heights = (particles[:, 2] - sea.level) / (2.0 * highest)
        points = self._skins.placed(sample)
        depths = heads(sea, points, sample.time)
        skins = self._skins
        curves = waterlines(sea, sample.time, points, skins.faces, skins.across, depths)
        trail = []
        if len(sample.centres) <= MOST_PLOTTED:
            self._trail.append((sample.time, sample.centres.astype(np.float32)))
            while sample.time - self._trail[0][0] > TRAIL_SECONDS:
                self._trail.popleft()
            trail = list(np.stack([centres for _, centres in self._trail], axis=1))
        return _Frame(
            sample=sample,
            particles=particles.astype(np.float32),
            heights=_shades(heights),
            curves=[curve.astype(np.float32) for curve in thinned(curves)],
            wetness=_shades(depths * self._wetness_per_metre) if self._shaded else None,
            trail=trail,
        )

    def _particles(self, sample: Sample) -> Array:
        """Positions (N, 3) [m] of the particles of a grid of labels, which travel to and fro as the
        water does. The grid follows the bodies by whole cells, so that it does not swim under the
        eye."""
        cell = self._steps[1] - self._steps[0]
        middle = np.round(sample.centres[:, :2].mean(axis=0) / cell) * cell
        labels = middle[:, None] + self._steps
        return self.scene.buoyancy.sea.particle_grid(*labels, sample.time).reshape(-1, 3)

    def _send(self) -> None:
        """Send the frames that are waiting, every entity's in one call."""
        self._sent_at = monotonic()
        if not self._waiting:
            return
        frames, self._waiting = self._waiting, []
        samples = [frame.sample for frame in frames]
        indexes = [
            rr.TimeColumn("time", duration=[sample.time for sample in samples]),
            rr.TimeColumn("frame", sequence=range(self.frames - len(frames), self.frames)),
        ]

        def send(entity: str, columns: rr.ComponentColumnList) -> None:
            self._output.send_columns(entity, indexes=indexes, columns=columns)

        self._send_poses(samples, send)
        self._send_surfaces(frames, send)
        self._send_lines(frames, send)
        self._send_forces(samples, send)
        self._send_series(samples, send)

    def _send_poses(self, samples: list[Sample], send: _Send) -> None:
        for i, name in enumerate(self.scene.buoyancy.body_names):
            pose = rr.Transform3D.columns(
                translation=[s.positions[i] for s in samples],
                quaternion=np.roll([s.quaternions[i] for s in samples], -1, axis=1),
            )
            send(f"world/bodies/{_part(name)}", pose)
        level = self.scene.buoyancy.sea.level
        focus = [[*s.centres[:, :2].mean(axis=0), level] for s in samples]
        send("world/focus", rr.Transform3D.columns(translation=focus))

    def _send_surfaces(self, frames: list["_Frame"], send: _Send) -> None:
        """The water, and the wet part of each hull darker than the dry one."""
        water = rr.Mesh3D.columns(
            vertex_positions=np.concatenate([f.particles for f in frames]),
            vertex_colors=WATER_PALETTE[np.concatenate([f.heights for f in frames])],
        )
        send("world/water", water.partition([f.particles.shape[0] for f in frames]))
        if not self._shaded:
            return
        wetness = np.stack([f.wetness for f in frames])
        for skin, palette in zip(self._skins, self._palettes, strict=True):
            of_corners = np.take(wetness, skin.vertices.start + skin.corner_vertices, axis=1)
            shade = rr.Mesh3D.columns(vertex_colors=np.take(palette, of_corners).ravel())
            send(self._entity(skin), shade.partition([len(skin.corners)] * len(frames)))

    def _send_lines(self, frames: list["_Frame"], send: _Send) -> None:
        lines = {"waterline": [f.curves for f in frames], "trail": [f.trail for f in frames]}
        for name, strips in lines.items():
            columns = rr.LineStrips3D.columns(strips=[line for frame in strips for line in frame])
            if name == "waterline" or any(strips):
                send(f"world/{name}", columns.partition([len(frame) for frame in strips]))

    def _send_forces(self, samples: list[Sample], send: _Send) -> None:
        """Arrows at the centres of mass; the weight's vectors never change."""
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

    def _send_series(self, samples: list[Sample], send: _Send) -> None:
        values = {
            "height": [s.centres[:, 2] for s in samples],
            "water_height": [s.elevations for s in samples],
            "tilt_deg": [np.degrees(s.tilts) for s in samples],
            "submerged_fraction": [s.submerged_fractions for s in samples],
            "vertical_force": [s.body_wrenches[:, 2] / self._weights for s in samples],
        }
        for quantity, path in SERIES.items():
            of_bodies = np.stack(values[quantity], axis=1)
            for name, series in zip(self._plotted, of_bodies, strict=False):
                send(path.format(_part(name)), rr.Scalars.columns(scalars=series))
            if self._others:
                rows = rr.Scalars.columns(scalars=of_bodies[MOST_PLOTTED:].T.ravel())
                sizes = [len(self._others)] * len(samples)
                send(OTHER_SERIES[quantity], rows.partition(sizes))


@dataclass(frozen=True, eq=False)
class _Frame:
    """What is drawn of a sample and not sent yet.

    particles: (N, 3) [m] of the water and heights (N,) in shades from trough to crest; curves: the
    waterlines, each (., 3) [m]; wetness: (V,) of the hulls' vertices in shades, None without;
    trail: of each body (., 3) [m].
    """

    sample: Sample
    particles: NDArray[np.float32]
    heights: NDArray[np.uint8]
    curves: list[NDArray[np.float32]]
    wetness: NDArray[np.uint8] | None
    trail: list[NDArray[np.float32]]


class SideBySideRecorder:
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
        self._output = _Output(self.path, name, _side_by_side_blueprint(scenes))
        self._recorders = [
            Recorder(
                self.path, scene, output=_Part(self._output, _part(label)), hue=i * GOLDEN_TURN
            )
            for i, (label, scene) in enumerate(scenes.items())
        ]
        bodies = first.buoyancy.body_names[:MOST_PLOTTED]
        for label, path_of, body in product(scenes, SERIES.values(), bodies):
            name = f"water at {body}" if path_of.endswith("water") else body
            line = rr.SeriesLines(names=f"{name}, {label}")
            entity = f"{_part(label)}/{path_of.format(_part(body))}"
            self._output.log(entity, line, static=True)

    def __enter__(self) -> "SideBySideRecorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Write what is waiting and close the file; a second time does nothing."""
        if self._output.is_open:
            for recorder in self._recorders:
                recorder.close()
            self._output.close()

    def log(self, samples: Sequence[Sample]) -> None:
        """Add one sample of each simulation, in the order of the scenes, as the next frame."""
        for recorder, sample in zip(self._recorders, samples, strict=True):
            recorder.log(sample)


def _check_numbers(rate: float | None, water_size: float | None, water_resolution: int) -> None:
    for name, value in (("recording rate", rate), ("size of the water", water_size)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"the {name} is {value}; it must be finite and above 0")
    if water_resolution < 2:
        raise ValueError(
            f"the water's resolution is {water_resolution} vertices along a side; it must be 2 or "
            "more"
        )


def _check_writable(path: Path) -> None:
    """Tells plainly, and before anything is simulated, what Rerun would report from a thread."""
    with path.open("wb") as file:
        try:
            file.write(b"RRF2")
            file.flush()
        except OSError as error:
            raise OSError(f"{path}: {error.strerror}; make room or record elsewhere") from None


def _open_viewer() -> None:
    """Start a viewer unless one is listening. Raises OSError where it would have no screen."""
    with socket.socket() as probe:
        if probe.connect_ex(("127.0.0.1", VIEWER_PORT)) == 0:
            return
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in screens):
        raise OSError(
            "there is no screen for the viewer (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            f"start one elsewhere that listens on port {VIEWER_PORT} here, or look at a recording"
        )
    rr.spawn(port=VIEWER_PORT, connect=False, hide_welcome_screen=True)


def _rounded(colour: Array) -> NDArray[np.uint8]:
    return np.round(colour).astype(np.uint8)


def thinned(curves: list[Array]) -> list[Array]:
    """Closed curves with about MOST_WATERLINE_POINTS together, if they have more."""
    every = -(-sum(map(len, curves)) // MOST_WATERLINE_POINTS)
    if every < 2:
        return curves
    steps = [max(1, min(every, len(curve) // FEWEST_OF_A_CURVE)) for curve in curves]
    return [
        np.concatenate([curve[:-1:step], curve[:1]])
        for curve, step in zip(curves, steps, strict=True)
    ]


def _shades(values: Array) -> NDArray[np.uint8]:
    """Which of the SHADES values from -1/2 to 1/2 have; those beyond have the last ones."""
    return np.clip(SHADES * (values + 0.5), 0.0, SHADES - 1.0).astype(np.uint8)


def _palette(first: Array, last: Array) -> NDArray[np.uint32]:
    """The opaque SHADES between two colours (3,) in 0 ... 255 as Rerun keeps them, 0xRRGGBBAA."""
    share = np.linspace(0.0, 1.0, SHADES)[:, None]
    r, g, b = _rounded(first + share * (last - first)).astype(np.uint32).T
    return (r << 24) | (g << 16) | (b << 8) | 255


def _part(name: str) -> str:
    """A name as one part of an entity path, whatever characters it has."""
    return rr.escape_entity_path_part(name)


WATER_PALETTE = _palette(TROUGH_COLOUR, CREST_COLOUR)


def _extent(scene: Scene, in_hulls: float, in_spreads: float) -> float:
    """A length [m] that goes with the largest hull and with how far the bodies are apart."""
    buoyancy = scene.buoyancy
    largest = max(np.ptp(f.method.hull.bounds, axis=0).max() for f in buoyancy.floats)
    spread = np.ptp(scene.data.xipos[buoyancy.bodies, :2], axis=0).max()
    return float(in_hulls * largest + in_spreads * spread)


def _grid_faces(resolution: int) -> Indices:
    """Two triangles for each cell of a square grid of vertices, facing up."""
    corner = np.arange(resolution * resolution).reshape(resolution, resolution)
    a, b = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
    c, d = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def overview(scene: Scene, tally: Tally) -> str:
    """Scene, sea, hulls and settings as Markdown; with samples in the tally, the means too."""
    floats, timestep = scene.buoyancy.floats, scene.model.opt.timestep
    lines = [
        f"**{scene.name}**, timestep {1e3 * timestep:g} ms, {sea_in_words(scene.buoyancy.sea)}"
    ]
    for f in floats[:MOST_PLOTTED]:
        hull, method = f.method.hull, type(f.method).__name__.lower()
        lines.append(f"- {f.name}: {len(hull.faces):,} faces, {hull.volume:.4g} m³, {method}")
    if len(floats) > MOST_PLOTTED:
        lines.append(f"- and {len(floats) - MOST_PLOTTED} more")
    if tally.last is None:
        return "\n".join(lines)
    lines += ["", "| mean of | height m | tilt ° | submerged | force/weight |", "|--|--|--|--|--|"]
    for name, means in list(tally.bodies().items())[:MOST_PLOTTED]:
        lines.append(
            f"| {name} | {means['mean_height']:.3f} | {means['mean_tilt_deg']:.1f} | "
            f"{means['mean_submerged_fraction']:.3f} | {means['mean_force_over_weight']:.3f} |"
        )
    step, spent = tally.last.step, tally.last.step_seconds
    lines += [
        "",
        f"{step:,} steps to {tally.last.time:.2f} s, {1e6 * spent / max(step, 1):.0f} µs each",
    ]
    return "\n".join(lines)


def sea_in_words(sea: Sea) -> str:
    """One line on a sea: each wave, or their significant height where they are many."""
    if not sea.waves:
        return "still water"
    if len(sea.waves) > MOST_WAVES_NAMED:
        lengths = [wave.wavelength for wave in sea.waves]
        return (
            f"{len(sea.waves)} waves of {min(lengths):.3g} to {max(lengths):.3g} m, significant "
            f"height {sea.significant_height:.3g} m, steepness {sea.steepness:.2f}"
        )
    waves = [f"{w.amplitude:.3g} x {w.wavelength:.3g} m" for w in sea.waves]
    return f"waves (amplitude x length) {', '.join(waves)}, steepness {sea.steepness:.2f}"


def _view(scene: Scene, name: str, root: str = "", abreast: int = 1) -> rrb.Spatial3DView:
    """The bodies and the water around them, seen from a place that moves with them, and from
    further away by a view that is one of several abreast, hence narrow."""
    distance = np.sqrt(abreast) * _extent(scene, EYE_IN_HULLS, EYE_IN_SPREADS)
    eye = rrb.EyeControls3D(
        position=distance * EYE_DIRECTION, look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
    )
    return rrb.Spatial3DView(
        origin=f"{root}world/focus",
        contents=f"/{root}world/**",
        name=name,
        eye_controls=eye,
        line_grid=False,
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=SKY_COLOUR),
    )


def _plot(entity: str, contents: list[str]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=PLOTS[entity],
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=entity == "tilt"),
    )


def _blueprint(scene: Scene) -> rrb.Blueprint:
    names = [_part(name) for name in scene.buoyancy.body_names[:MOST_PLOTTED]]
    height, tilt, *forces = (
        _plot(entity, [f"/plots/{entity}/{name}/**" for name in names]) for entity in PLOTS
    )
    text = rrb.TextDocumentView(origin="overview", name="Overview")
    tabs = rrb.Tabs(*forces, active_tab=0)
    plots = rrb.Vertical(height, tilt, tabs, text, row_shares=PLOT_SHARES)
    title = f"{scene.name}: waterline white, buoyancy green, weight red, drag orange"
    return _arranged(_view(scene, title), plots, [2, 1])


def _side_by_side_blueprint(scenes: Mapping[str, Scene]) -> rrb.Blueprint:
    views = [
        _view(scene, label, f"{_part(label)}/", len(scenes)) for label, scene in scenes.items()
    ]
    plots = [
        _plot(entity, [f"/{_part(label)}/plots/{entity}/**" for label in scenes])
        for entity in PLOTS
    ]
    return _arranged(rrb.Horizontal(*views), rrb.Vertical(*plots), [3, 1])


def _arranged(
    left: rrb.Spatial3DView | rrb.Horizontal, right: rrb.Vertical, shares: list[int]
) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=shares),
        rrb.TimePanel(timeline="time", state="collapsed"),
        collapse_panels=True,
    )
