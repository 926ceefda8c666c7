"""Output: an .rrd file, a viewer, or both; and what can go wrong with them."""

import atexit
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, Protocol

import rerun as rr
import rerun.blueprint as rrb

VIEWER_PORT = 9876
"""Where a Rerun viewer listens, unless told otherwise."""

FLUSH_SECONDS = 5.0
"""Longest wait for the disk to take about a megabyte. Rerun's writer, once it has given up, leaves
a flush unanswered, so this is also how long it takes to notice that the disk is full."""

ABANDONED: list[rr.RecordingStream] = []
"""Streams whose writer has died: collecting one would wait for it for ever."""

Send = Callable[[str, rr.ComponentColumnList], None]


def part(name: str) -> str:
    """A name as one part of an entity path, whatever characters it has."""
    return rr.escape_entity_path_part(name)


class Sink(Protocol):
    """What takes entities: an Output, or a part of one."""

    def log(self, entity: str, *what: Any, **options: Any) -> None: ...
    def send_columns(self, entity: str, **columns: Any) -> None: ...
    def flush(self) -> None: ...


class Output:
    """An .rrd file, a viewer, or both, that takes what is logged.

    Raises OSError where that cannot be, at once or when the disk fills up; the file then ends
    with the last flush, readable, or is removed if nothing had been written.
    """

    def __init__(
        self,
        path: Path | None,
        name: str,
        blueprint: rrb.Blueprint,
        view: bool = False,
        port: int = VIEWER_PORT,
    ) -> None:
        self._path = path
        self._intact: int | None = 0
        self._stream = stream = rr.RecordingStream("waterline")
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        self.log, self.send_columns = stream.log, stream.send_columns
        sinks = []
        if view:
            _open_viewer(port)
            sinks.append(rr.GrpcSink(f"rerun+http://127.0.0.1:{port}/proxy"))
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


class Part:
    """The part of an output below one entity."""

    def __init__(self, output: Output, root: str) -> None:
        self._output, self._root = output, root
        self.flush = output.flush

    def log(self, entity: str, *what: Any, **options: Any) -> None:
        self._output.log(f"{self._root}/{entity}".rstrip("/"), *what, **options)

    def send_columns(self, entity: str, **columns: Any) -> None:
        self._output.send_columns(f"{self._root}/{entity}", **columns)


def _check_writable(path: Path) -> None:
    """Tells plainly, and before anything is simulated, what Rerun would report from a thread."""
    with path.open("wb") as file:
        try:
            file.write(b"RRF2")
            file.flush()
        except OSError as error:
            raise OSError(f"{path}: {error.strerror}; make room or record elsewhere") from None


def _open_viewer(port: int) -> None:
    """Start a viewer unless one is listening. Raises OSError where it would have no screen."""
    with socket.socket() as probe:
        if probe.connect_ex(("127.0.0.1", port)) == 0:
            return
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in screens):
        raise OSError(
            "there is no screen for the viewer (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            f"start one elsewhere that listens on port {port} here, or look at a recording"
        )
    rr.spawn(port=port, connect=False, hide_welcome_screen=True)
