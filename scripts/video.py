"""Make a video of a scene, which is simulated, or of a recording; no screen is needed.

    python scripts/video.py models/bunny.xml --output bunny.mp4
    python scripts/video.py recordings/bunny.rrd --output bunny.webp

The suffix of the output is the format: .mp4 (takes `pip install '.[video]'`), .gif or .webp. MuJoCo
draws scenes, with OpenGL; the script says what to install where it finds no driver. Rerun's viewer
draws recordings, with its plots, and needs what scripts/snapshot.py needs.

Exit status: 0 on success, 2 on unusable input or without a driver, 3 if the state diverged (the
video ends there), 4 if the video cannot be written, 130 after Ctrl-C, 143 after SIGTERM. A run that
is stopped leaves no video.
"""

import argparse
import importlib.util
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from fractions import Fraction
from io import BytesIO
from pathlib import Path

import graphics
import mujoco
import numpy as np
import snapshot
from numpy.typing import NDArray
from PIL import Image

from command_line import (
    Parser,
    Progress,
    add_scene_options,
    check_outputs,
    compile_in_two,
    failure,
    notes_said,
    positive,
    run_script,
    scene_options,
    stops_held,
    write_whole,
)
from sim import DivergenceError, Scene, simulate
from sim.mjcf.files import model_files
from sim.plugin.picture import HORIZON, HORIZON_SHARPNESS, ZENITH
from sim.recording.framing import corners
from sim.recording.reader import whole
from sim.runs.simulation import check_run
from sim.scenes.spec import read_spec

Picture = NDArray[np.uint8]

SIDES = range(64, 4097)
"""Possible widths and heights [pixels]."""

VIDEO_SIZE, LOOP_SIZE = (1280, 720), (640, 360)
"""Sizes [pixels] of an .mp4 and of the other formats, whose files are larger."""

MOST_GEOMS = 30_000
"""Room for geoms in a picture, enough for the finest sea of `sim.plugin.picture`."""

SCENE_SECONDS = 10.0
"""Duration [s] of a video of a scene."""

SECONDS_PER_PICTURE, SECONDS_TO_START = 10.0, 120.0
"""Longest time [s] that Rerun's viewer may take for a picture, and to load a recording."""

SKY_PIXELS = 256
"""Side of each of the six pictures of the sky [pixels]."""

SUN, SKYLIGHT = (0.85, 0.25, -0.7), (-0.7, 0.6, -0.15)
"""Directions of the two lights. The sun is behind the camera on the left; light from the sky comes
from the other side, so no side of a body is black."""

AZIMUTH, ELEVATION = 60.0, 13.0
"""Direction [deg] in which the camera looks, from +x, and the angle at which it looks down."""

VIEW_SHARE = 0.9
"""Share of the picture's height that the diagonal of the bodies' bounding box takes."""

FOLLOWING_SECONDS = 1.2
"""Time constant [s] of the camera, which so follows drift but hardly waves."""

CREST_CLEARANCE = 1.3
"""Least height of the camera above the still level, in heights of the highest crest."""


def size(text: str) -> tuple[int, int]:
    """Width and height [pixels] from the command line, "WxH"."""
    sides = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text.lower())
    found = tuple(map(int, sides.groups())) if sides else ()
    if not found or any(side not in SIDES or side % 2 for side in found):
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a size WIDTHxHEIGHT of two even numbers from {SIDES.start} to "
            f"{SIDES.stop - 1}"
        )
    return found[0], found[1]


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument(
        "source", type=Path, metavar="SCENE|RUN.rrd", help="an MJCF file, or a recording"
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help=".mp4, .gif or .webp (recordings/<source>.mp4)"
    )
    parser.add_argument(
        "--duration", type=positive, metavar="S",
        help="simulated seconds (10, or all of a recording)",
    )  # fmt: skip
    parser.add_argument(
        "--fps", type=positive, default=25.0, metavar="HZ", help="pictures per second (25)"
    )
    parser.add_argument(
        "--size", type=size, metavar="WxH", help="pixels (1280x720 for .mp4, else 640x360)"
    )
    add_scene_options(parser)
    parser.add_argument("--quiet", action="store_true", help="print only errors")
    options = parser.parse_args(arguments)
    options.output = options.output or Path("recordings") / f"{options.source.stem}.mp4"
    options.size = options.size or (VIDEO_SIZE if options.output.suffix == ".mp4" else LOOP_SIZE)
    if options.source.suffix == ".rrd" and (
        options.settings or any(scene_options(options).values())
    ):
        parser.error(
            "--buoyant, --set, --density, --timestep and --keyframe change a scene, not a recording"
        )
    return options


# Scenes


def sky() -> bytes:
    """The sky that the water reflects, for MuJoCo: six square pictures (right, left, up, down,
    front, back), each RGB."""
    across = (np.arange(SKY_PIXELS) + 0.5) / SKY_PIXELS * 2.0 - 1.0
    right, up = np.meshgrid(across, -across)
    one = np.ones_like(up)
    heights = np.stack([up, up, one, -one, up, up])  # of the direction of each pixel
    lengths = np.sqrt(1.0 + right**2 + up**2)
    to_zenith = 1.0 - np.exp(-HORIZON_SHARPNESS * np.clip(heights / lengths, 0.0, 1.0))
    horizon, zenith = 255.0 * np.array(HORIZON), 255.0 * np.array(ZENITH)
    colours = horizon + to_zenith[..., None] * (zenith - horizon)
    return colours.round().astype(np.uint8).tobytes()


def stage(spec: mujoco.MjSpec) -> None:
    """Give a model a sky, unless it has one, and daylight instead of the lights of its world."""
    skybox = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    if not any(texture.type == skybox for texture in spec.textures):
        texture = spec.add_texture(name="sky", type=skybox, nchannel=3)
        texture.width, texture.height, texture.data = SKY_PIXELS, 6 * SKY_PIXELS, sky()
    for light in list(spec.worldbody.lights):
        spec.delete(light)
    for direction, colour in ((SUN, (0.85, 0.78, 0.66)), (SKYLIGHT, (0.12, 0.16, 0.20))):
        light = spec.worldbody.add_light(dir=direction, diffuse=colour, castshadow=False)
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.ambient, light.specular = (0.0, 0.0, 0.0), (0.2, 0.2, 0.2)
    headlight = spec.visual.headlight
    headlight.ambient, headlight.diffuse = (0.34, 0.40, 0.46), (0.0, 0.0, 0.0)
    headlight.specular = (0.0, 0.0, 0.0)
    spec.visual.quality.offsamples = 8
    spec.visual.map.zfar = 500.0  # the sea reaches far


class Follower:
    """A camera that follows what floats. `camera` is MuJoCo's."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._time = scene, scene.data.time
        self._target, self._radius = self._seen()
        self._half_view = np.tan(np.radians(0.5 * scene.model.vis.global_.fovy))
        self.camera = mujoco.MjvCamera()
        self.camera.azimuth = AZIMUTH

    def _seen(self) -> tuple[NDArray[np.float64], float]:
        """The middle (3,) [m] of what floats, and half the diagonal [m] of its bounding box."""
        points = corners(self._scene)
        low, high = points.min(axis=0), points.max(axis=0)
        return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))

    def move(self) -> None:
        """Move the camera to the scene's present state. It stays above the water and zooms in on
        bodies that sink."""
        data, sea = self._scene.data, self._scene.buoyancy.sea
        target, radius = self._seen()
        share = 1.0 - np.exp(-(data.time - self._time) / FOLLOWING_SECONDS)
        self._target += share * (target - self._target)
        self._radius += share * (radius - self._radius)
        self._time = data.time
        distance, down = self._radius / (VIEW_SHARE * self._half_view), np.radians(ELEVATION)
        lowest = sea.level_at(data.time) + CREST_CLEARANCE * sea.amplitude
        rise = max(self._target[2] + distance * np.sin(down), lowest) - self._target[2]
        reach = distance * np.cos(down)
        self.camera.lookat[:] = self._target
        self.camera.elevation = -np.degrees(np.arctan2(rise, reach))
        self.camera.distance = np.hypot(rise, reach)
        zoomed = self._half_view * distance / self.camera.distance
        self._scene.model.vis.global_.fovy = 2.0 * np.degrees(np.arctan(zoomed))


def load(options: argparse.Namespace) -> Scene:
    """The scene with its stage."""
    spec = read_spec(options.source)
    stage(spec)
    settings, others = options.settings, scene_options(options)
    scene = Scene.load(spec, name=options.source.stem, settings=settings, **others)
    check_run(scene, options.duration, options.fps)
    return scene


def scene_pictures(scene: Scene, options: argparse.Namespace) -> Iterator[Picture]:
    """Pictures (H, W, 3) of a scene, which is simulated."""
    follower = Follower(scene)
    with graphics.renderer(scene.model, *options.size, MOST_GEOMS) as renderer:
        follower.move()
        renderer.update_scene(scene.data, follower.camera)  # the sea's colours need a camera
        for _ in simulate(scene, options.duration, options.fps):
            follower.move()
            renderer.update_scene(scene.data, follower.camera)
            yield renderer.render()


# Recordings


def recorded_pictures(start: float, options: argparse.Namespace) -> Iterator[Picture]:
    """Pictures (H, W, 3) of a recording from a time [s] on, by Rerun's viewer."""
    ages = np.arange(options.duration * options.fps + 1.0) / options.fps
    times = start + np.minimum(ages, options.duration)
    width, height = options.size
    longest = SECONDS_TO_START + SECONDS_PER_PICTURE * len(times)
    window = width, height + snapshot.TITLE_STRIP, longest
    with whole(options.source) as recording, snapshot.viewer(*window) as client:
        snapshot.draw(client, recording, start)
        for time in times:
            client.set_time(snapshot.TIMELINE, duration=float(time), play_state="paused")
            picture = Image.open(BytesIO(snapshot.settled_picture(client, looks=2)))
            yield np.asarray(picture.convert("RGB"))[snapshot.TITLE_STRIP :]


def prepared(options: argparse.Namespace) -> Iterator[Picture]:
    """The pictures of the source, made one by one, and the duration [s] set where it was not."""
    if options.source.suffix != ".rrd":
        options.duration = options.duration or SCENE_SECONDS
        compile_in_two()
        return scene_pictures(load(options), options)
    start, end = snapshot.recorded_span(options.source)
    options.duration = min(options.duration or np.inf, end - start)
    return recorded_pictures(start, options)


# Videos


def write_mp4(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """Write an H.264 video."""
    import av

    with av.open(str(path), "w") as file:
        stream = file.add_stream("h264", rate=Fraction(fps).limit_denominator(1000))
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "20"}  # what browsers play
        for picture in pictures:
            if not stream.codec_context.is_open:
                stream.height, stream.width = picture.shape[:2]
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
        file.mux(stream.encode(None))


def write_loop(path: Path, pictures: Iterable[Picture], fps: float) -> None:
    """Write an animated .gif or .webp that repeats."""
    images = map(Image.fromarray, pictures)
    first, step_ms = next(images), round(1000.0 / fps)
    with path.open("wb") as file:  # Pillow would leave it open after Ctrl-C
        first.save(
            file, path.suffix[1:], save_all=True, append_images=images, duration=step_ms, loop=0
        )


WRITERS = {".mp4": write_mp4, ".gif": write_loop, ".webp": write_loop}
"""Functions that write a video, by suffix."""


def check(options: argparse.Namespace) -> None:
    """Raise ValueError or FileNotFoundError for options that would fail after the run."""
    output, source = options.output, options.source
    is_scene = source.suffix != ".rrd"
    check_outputs([output], model_files(source) if is_scene else [source])
    if output.suffix not in WRITERS:
        raise ValueError(f"{output} is no video: name it {', '.join(WRITERS)}")
    if output.suffix == ".mp4" and importlib.util.find_spec("av") is None:
        raise ValueError(
            "an .mp4 needs PyAV, which is not installed; run: pip install '.[video]', or name "
            "the output .webp or .gif"
        )
    if output.suffix == ".gif" and 100 % options.fps:
        raise ValueError(
            f"--fps {options.fps:g}: a .gif counts in 1/100 s; choose 10, 20, 25 or 50"
        )
    if is_scene:
        graphics.check_driver()


def film(
    options: argparse.Namespace, pictures: Iterator[Picture], check_stops: Callable[[], None]
) -> tuple[int, DivergenceError | None]:
    """Write the pictures to the output. Returns their number, and why they end early if they do."""
    count, end = 0, None

    def watched() -> Iterator[Picture]:
        nonlocal count, end
        try:
            for picture in pictures:
                check_stops()
                yield picture
                count += 1
                bar.update()
        except DivergenceError as error:
            end = error

    total = np.ceil(options.duration * options.fps) + 1.0
    write = WRITERS[options.output.suffix]
    with closing(pictures), Progress(total, "pictures", options.quiet) as bar:
        write_whole(options.output, lambda beside: write(beside, watched(), options.fps))
    return count, end


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        check(options)
        with notes_said(options.quiet):
            pictures = prepared(options)
        with stops_held() as check_stops, notes_said(options.quiet):
            count, end = film(options, pictures, check_stops)
    except (ValueError, OSError) as error:
        return failure(error)
    if not options.quiet:
        megabytes = options.output.stat().st_size / 1e6
        print(
            f"{options.output}: {count} pictures, {count / options.fps:.4g} s, {megabytes:.1f} MB"
        )
    return 0 if end is None else failure(end)


if __name__ == "__main__":
    run_script(main)
