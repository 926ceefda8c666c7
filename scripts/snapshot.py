"""Make a picture of a recording at a simulated time, without a screen.

    python scripts/snapshot.py recordings/bunny.rrd --time 5 --output bunny.png

The picture is drawn by the viewer that comes with Rerun, which needs a graphics driver; Debian's
mesa-vulkan-drivers has one that needs no graphics card. Linux and macOS only.

Exit status: 0 on success, 2 when there is no picture, 4 when it cannot be written, 130 after
Ctrl-C, 143 after SIGTERM.
"""

import argparse
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import IO

from PIL import Image
from rerun.experimental import ViewerClient

from command_line import Parser, check_outputs, failure, run_script, write_whole
from sim.recording.reader import reader, whole

TIMELINE = "time"
"""Name of the recording's timeline of simulated seconds."""

ROUNDING = 1e-3
"""Seconds by which --time may miss the recording: as it is rounded in messages."""

SIDES = range(64, 4097)
"""Width and height [pixels] that can be asked for; every Vulkan driver draws up to 4096."""

TITLE_STRIP = 37
"""Pixels that the viewer of Rerun 0.41 keeps blank at its top when it shows no menu."""

PAUSE = 0.1
"""Seconds between two looks at the viewer."""

NO_DRIVER = ("No graphics adapter was found", "Failed to get render context")
"""What a viewer says as it ends: no driver at all, or only one for OpenGL that cannot do it."""


class SnapshotError(ValueError):
    """Why there is no picture and what to do about it, in one line."""


def side(text: str) -> int:
    """A width or height [pixels] from the command line."""
    pixels = int(text)
    if pixels not in SIDES:
        raise argparse.ArgumentTypeError(
            f"{pixels} pixels are asked for; from {SIDES.start} to {SIDES.stop - 1} can be drawn"
        )
    return pixels


def seconds(text: str) -> float:
    """A time [s] from the command line."""
    value = float(text)
    if not (math.isfinite(value) and value >= 0.0):
        raise argparse.ArgumentTypeError(f"{text} s is not a time; give a finite one from 0 on")
    return value


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("recording", type=Path, metavar="FILE.rrd", help="written by run.py")
    parser.add_argument(
        "--time", type=seconds, metavar="S", help="simulated seconds (half-way through)"
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE.png", help="default: beside the recording, as .png"
    )
    parser.add_argument("--width", type=side, default=1600, metavar="PIXELS", help="(1600)")
    parser.add_argument("--height", type=side, default=900, metavar="PIXELS", help="(900)")
    parser.add_argument(
        "--timeout", type=seconds, default=60.0, metavar="S", help="seconds to wait at most (60)"
    )
    options = parser.parse_args(arguments)
    options.output = options.output or options.recording.with_suffix(".png")
    return options


def one_line(error: Exception) -> str:
    """The first line of what an error says: Rerun's go on with causes and metadata."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def recorded_span(path: Path) -> tuple[float, float]:
    """First and last simulated time [s] of a recording."""
    if not path.is_file():
        raise SnapshotError(f"there is no recording file {path}; make one with scripts/run.py")
    spans = []
    try:
        with reader(path) as recording:
            for chunk in recording.stream().filter(has_timeline=TIMELINE):
                times = chunk.to_record_batch().column(TIMELINE).to_numpy(zero_copy_only=False)
                if len(times) and times.dtype.kind == "m":
                    spans.append((times.min(), times.max()))
    except (RuntimeError, ValueError) as error:
        raise SnapshotError(
            f"{path} is no recording that can be read ({one_line(error)}); make it anew"
        ) from error
    if not spans:
        raise SnapshotError(
            f"{path} holds nothing on the timeline {TIMELINE!r} of simulated seconds; "
            "give a recording made by scripts/run.py"
        )
    starts, ends = zip(*spans, strict=True)
    return min(starts).item() * 1e-9, max(ends).item() * 1e-9  # from whole nanoseconds


def moment(path: Path, wanted: float | None) -> float:
    """The time [s] to show: the one that is wanted, or half-way through the recording."""
    start, end = recorded_span(path)
    if wanted is None:
        return 0.5 * (start + end)
    if not start - ROUNDING <= wanted <= end + ROUNDING:
        raise SnapshotError(
            f"--time {wanted:g} s is not in {path}, which goes from {start:.3f} to {end:.3f} s; "
            "give a time between them"
        )
    return min(max(wanted, start), end)


def free_port() -> int:
    """A port of this machine that nobody listens on, such as another viewer."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def start_viewer(port: int, width: int, height: int, log: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start a viewer without a window; a child of the process is what draws.

    The command line instead of ViewerClient.spawn, which cannot set the size of the picture.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "rerun", "--headless", "--hide-welcome-screen"]
        + ["--bind", "127.0.0.1", "--port", str(port), "--window-size", f"{width}x{height}"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=log,
        # Every message that is logged pops up in the picture. What ends a viewer is told anyway.
        env=os.environ | {"RUST_LOG": "off"},
        # A process group of its own, by which process and child are ended together.
        start_new_session=True,
    )


def end_viewer(process: subprocess.Popen[bytes]) -> None:
    """End a viewer at once: there is nothing in it that is worth saving."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def connect(port: int, process: subprocess.Popen[bytes]) -> ViewerClient:
    """Wait until a viewer that was just started answers."""
    while process.poll() is None:
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
        except ConnectionError:
            time.sleep(PAUSE)
        else:
            return client
    raise ConnectionError("it ended before it answered")


def explain(error: Exception, process: subprocess.Popen[bytes], log: IO[bytes]) -> str:
    """Why a viewer drew nothing, from the error of a call to it and from what it wrote."""
    log.seek(0)
    written = log.read().decode(errors="replace")
    if any(sign in written for sign in NO_DRIVER):
        return (
            "the viewer found no Vulkan driver to draw with; install the one of your graphics "
            "card, or one that needs none (on Debian: apt-get install mesa-vulkan-drivers)"
        )
    panic = next((line for line in written.splitlines() if "panicked" in line), None)
    if process.poll() is None:
        return f"the viewer refused: {one_line(error)}"
    return f"the viewer ended by itself: {panic or one_line(error)}"


@contextmanager
def viewer(width: int, height: int, timeout: float) -> Iterator[ViewerClient]:
    """A viewer without a window that lives as long as the block, and timeout [s] at most."""
    port = free_port()
    deadline = time.monotonic() + timeout
    with tempfile.TemporaryFile() as log:
        process = start_viewer(port, width, height, log)
        # Calls to a viewer that is stuck do not come back by themselves, but fail once it is gone.
        watchdog = threading.Timer(timeout, end_viewer, [process])
        try:
            watchdog.start()
            yield connect(port, process)
        except (ConnectionError, RuntimeError) as error:
            if time.monotonic() >= deadline:
                reason = f"the viewer gave no picture within {timeout:g} s; give it more --timeout"
            else:
                reason = explain(error, process, log)
            raise SnapshotError(reason) from error
        finally:
            watchdog.cancel()
            end_viewer(process)
            process.wait()


def settled_picture(client: ViewerClient, looks: int) -> bytes:
    """What a viewer shows, as a PNG, once it shows the same for a number of looks."""
    picture, alike = client.take_screenshot(), 1
    while alike < looks:
        time.sleep(PAUSE)
        latest = client.take_screenshot()
        alike = alike + 1 if latest == picture else 1
        picture = latest
    return picture


def hide_panels(client: ViewerClient) -> None:
    """Leave only the views: no menu, no lists, no timeline."""
    blueprint = client.get_blueprint("recording").blueprint
    for panel in ("top", "blueprint", "selection"):
        blueprint[f"/{panel}_panel"] = {"PanelBlueprint": {"state": "Hidden"}}
    time_panel = blueprint.setdefault("/time_panel", {})
    time_panel.setdefault("TimePanelBlueprint", {})["state"] = "Hidden"
    client.set_blueprint(blueprint, "recording")


def draw(client: ViewerClient, path: Path, time_s: float) -> bytes:
    """Let a viewer show a recording at a time; return the whole window as a PNG."""
    opened = client.open(str(path.resolve()))
    while client.get_state().loading:
        time.sleep(PAUSE)
    if not opened.store_ids:
        raise RuntimeError(f"it cannot open {path}")
    client.set_time(TIMELINE, duration=time_s, play_state="paused")
    # A viewer fetches data only as it needs them, and tells nobody when it has them. But the bar
    # of its time panel shows what there is: as long as that grows, no two pictures are alike.
    settled_picture(client, looks=3)
    hide_panels(client)
    return settled_picture(client, looks=2)


def take(options: argparse.Namespace) -> None:
    """Make the picture that is asked for and write it."""
    time_s = moment(options.recording, options.time)
    check_outputs([options.output], [options.recording])
    size = options.width, options.height + TITLE_STRIP
    with whole(options.recording) as recording, viewer(*size, options.timeout) as client:
        picture = draw(client, recording, time_s)
    image = Image.open(BytesIO(picture))
    if image.size != size:
        raise SnapshotError(
            f"the viewer drew {image.size} pixels instead of {size}; ask for another size"
        )
    image = image.crop((0, TITLE_STRIP, *size))
    write_whole(options.output, lambda beside: image.save(beside, format="PNG"))
    print(f"{options.output}: {options.recording} at {time_s:.3f} s")


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        take(options)
    except ValueError as error:
        return failure(error)
    return 0


if __name__ == "__main__":
    run_script(main)
