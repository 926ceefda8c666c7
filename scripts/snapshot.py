"""Make a picture of a recording at a simulated time; no screen is needed.

    python scripts/snapshot.py recordings/bunny.rrd --time 5 --output bunny.png

Rerun's viewer draws the picture. It needs a Vulkan driver; the one in Debian's mesa-vulkan-drivers
works without a graphics card.

Exit status: 0 on success, 2 if no picture was made, 4 if it cannot be written, 130 after Ctrl-C,
143 after SIGTERM.
"""

import argparse
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO

from PIL import Image
from rerun.experimental import ViewerClient

from command_line import (
    Parser,
    at_least,
    check_outputs,
    failure,
    not_negative,
    positive,
    run_script,
    write_whole,
)
from sim.recording.reader import reader, whole
from viewer_process import end_viewer, start_viewer

TIMELINE = "time"
"""Name of the recording's timeline of simulated time."""

TIME_ROUNDING = 1e-3
"""Seconds by which --time may lie outside the recording, because messages round its times."""

SIDES = 64, 4096
"""Least and largest width and height [pixels]; every Vulkan driver draws up to 4096."""

TITLE_STRIP = 37
"""Height [pixels] of the blank strip at the top of Rerun 0.41's viewer when it shows no menu."""

POLL_INTERVAL = 0.1
"""Seconds between two requests to the viewer."""

NO_DRIVER_MESSAGES = ("No graphics adapter was found", "Failed to get render context")
"""Messages of a viewer that ends because there is no driver, or only an unsuitable OpenGL
driver."""


class SnapshotError(ValueError):
    """No picture can be made; the message says why and what to do, in one line."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("recording", type=Path, metavar="FILE.rrd", help="written by run.py")
    parser.add_argument(
        "--time", type=not_negative, metavar="S", help="simulated time [s] (half-way through)"
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE.png", help="default: beside the recording, as .png"
    )
    parser.add_argument(
        "--width", type=at_least(*SIDES), default=1600, metavar="PIXELS", help="(1600)"
    )
    parser.add_argument(
        "--height", type=at_least(*SIDES), default=900, metavar="PIXELS", help="(900)"
    )
    parser.add_argument(
        "--timeout", type=positive, default=60.0, metavar="S", help="longest wait [s] (60)"
    )
    options = parser.parse_args(arguments)
    options.output = options.output or options.recording.with_suffix(".png")
    return options


def one_line(error: Exception) -> str:
    """The first line of an error's message. Rerun's errors continue with causes and metadata."""
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
            f"{path} is not a readable recording ({one_line(error)}); record it again"
        ) from error
    if not spans:
        raise SnapshotError(
            f"{path} has no data on the timeline {TIMELINE!r} of simulated time; "
            "use a recording made by scripts/run.py"
        )
    starts, ends = zip(*spans, strict=True)
    return min(starts).item() * 1e-9, max(ends).item() * 1e-9  # from whole nanoseconds


def moment(path: Path, wanted: float | None) -> float:
    """The time [s] to show: the wanted time, or half-way through the recording."""
    start, end = recorded_span(path)
    if wanted is None:
        return 0.5 * (start + end)
    if not start - TIME_ROUNDING <= wanted <= end + TIME_ROUNDING:
        raise SnapshotError(
            f"--time {wanted:g} s is not in {path}, which covers {start:.3f} to {end:.3f} s; "
            "choose a time in between"
        )
    return min(max(wanted, start), end)


def free_port() -> int:
    """A local port on which no other program, such as another viewer, listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def connect(port: int, process: subprocess.Popen[bytes]) -> ViewerClient:
    """Wait until a new viewer answers and return a client of it."""
    while process.poll() is None:
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
        except ConnectionError:
            time.sleep(POLL_INTERVAL)
        else:
            return client
    raise ConnectionError("it ended before it answered")


def explain(error: Exception, process: subprocess.Popen[bytes], log: IO[bytes]) -> str:
    """The reason why a viewer drew nothing, from the error of a call to it and from its log."""
    log.seek(0)
    written = log.read().decode(errors="replace")
    if any(sign in written for sign in NO_DRIVER_MESSAGES):
        return (
            "the viewer found no Vulkan driver; install the one for your graphics card, or one "
            "that needs no card (on Debian: apt-get install mesa-vulkan-drivers)"
        )
    panic = next((line for line in written.splitlines() if "panicked" in line), None)
    if process.poll() is None:
        return f"the viewer refused: {one_line(error)}"
    return f"the viewer ended by itself: {panic or one_line(error)}"


@contextmanager
def viewer(width: int, height: int, timeout: float) -> Iterator[ViewerClient]:
    """A viewer without a window for the duration of the block, but no longer than timeout [s]."""
    port = free_port()
    deadline = time.monotonic() + timeout
    with tempfile.TemporaryFile() as log:
        # ViewerClient.spawn cannot set the picture's size.
        process = start_viewer(
            *("--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--port", str(port)),
            *("--window-size", f"{width}x{height}"),
            log=log,
        )
        # Calls to a viewer that hangs return only when the viewer is killed.
        watchdog = threading.Timer(timeout, end_viewer, [process])
        try:
            watchdog.start()
            yield connect(port, process)
        except (ConnectionError, RuntimeError) as error:
            if time.monotonic() >= deadline:
                reason = f"the viewer made no picture within {timeout:g} s; increase --timeout"
            else:
                reason = explain(error, process, log)
            raise SnapshotError(reason) from error
        finally:
            watchdog.cancel()
            end_viewer(process)
            process.wait()


def settled_picture(client: ViewerClient, looks: int) -> bytes:
    """The viewer's picture as a PNG, once `looks` successive screenshots are equal."""
    picture, alike = client.take_screenshot(), 1
    while alike < looks:
        time.sleep(POLL_INTERVAL)
        latest = client.take_screenshot()
        alike = alike + 1 if latest == picture else 1
        picture = latest
    return picture


def hide_panels(client: ViewerClient) -> None:
    """Hide all panels but the views: menu, lists and timeline."""
    blueprint = client.get_blueprint("recording").blueprint
    for panel in ("top", "blueprint", "selection"):
        blueprint[f"/{panel}_panel"] = {"PanelBlueprint": {"state": "Hidden"}}
    time_panel = blueprint.setdefault("/time_panel", {})
    time_panel.setdefault("TimePanelBlueprint", {})["state"] = "Hidden"
    client.set_blueprint(blueprint, "recording")


def draw(client: ViewerClient, path: Path, time_s: float) -> bytes:
    """Show a recording at a time [s] in a viewer and return the whole window as a PNG."""
    opened = client.open(str(path.resolve()))
    while client.get_state().loading:
        time.sleep(POLL_INTERVAL)
    if not opened.store_ids:
        raise RuntimeError(f"it cannot open {path}")
    client.set_time(TIMELINE, duration=time_s, play_state="paused")
    # A viewer loads data on demand and does not report when it has finished. But its time panel
    # shows the loaded data, so successive screenshots differ until all data are loaded.
    settled_picture(client, looks=3)
    hide_panels(client)
    return settled_picture(client, looks=2)


def take(options: argparse.Namespace) -> None:
    """Make the picture and write it to --output."""
    time_s = moment(options.recording, options.time)
    check_outputs([options.output], [options.recording])
    size = options.width, options.height + TITLE_STRIP
    with whole(options.recording) as recording, viewer(*size, options.timeout) as client:
        picture = draw(client, recording, time_s)
    image = Image.open(BytesIO(picture))
    if image.size != size:
        raise SnapshotError(
            f"the viewer drew {image.size} pixels instead of {size}; choose another size"
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
