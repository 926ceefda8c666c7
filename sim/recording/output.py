"""Output: an .rrd file, a viewer, or both; and what can go wrong with them."""

import atexit
import os
import socket
import sys
from collections.abc import Callable, Mapping
from io import FileIO
from pathlib import Path
from typing import Any, NoReturn, Protocol

import rerun as rr
import rerun.blueprint as rrb

try:
    import fcntl
except ImportError:  # where there is none, files are not locked
    fcntl = None

VIEWER_PORT = 9876
"""Where a Rerun viewer listens, unless told otherwise."""

FLUSH_SECONDS = 5.0
"""Longest wait for the disk to take about a megabyte. Rerun's writer, once it has given up, leaves
a flush unanswered, so this is also how long it takes to notice that the disk is full."""

END_BYTES = 64
"""Of a recording, by which it is seen that nobody cut it."""

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

    Raises OSError where that cannot be, at once, when the disk fills up (the file then ends with
    the last flush, readable, or is removed if nothing had been written), or when somebody else
    writes to the file, cuts or removes it; ValueError where Rerun is switched off.
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
        self._end = b""
        self._lock: FileIO | None = None
        if is_switched_off(os.environ):
            raise ValueError(
                f"the environment variable RERUN is '{os.environ['RERUN']}', so Rerun would write "
                "an empty recording; unset it, or do without a recording"
            )
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
            self._lock = _locked(path)
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
            self._check_file()
            self._intact = self._path.stat().st_size
            self._end = self._last_bytes()

    @property
    def is_open(self) -> bool:
        """False after the end, good or bad."""
        return self._intact is not None

    def close(self) -> None:
        """Write what is waiting and let go of file and viewer."""
        self.flush()
        self._stream.disconnect()
        self._let_go()

    def _let_go(self) -> None:
        self._intact = None
        if self._lock is not None:
            self._lock.close()

    def _check_file(self) -> None:
        """Raise OSError if another one is there by now, or none, or part of it."""
        try:
            now, ours = os.stat(self._path), os.fstat(self._lock.fileno())
        except FileNotFoundError:
            self._let_go()
            raise OSError(f"{self._path}: the recording was removed while it was written") from None
        if not os.path.samestat(now, ours) or self._last_bytes() != self._end:
            self._let_go()
            raise OSError(
                f"{self._path}: the recording was cut or replaced while it was written; what was "
                "recorded is lost"
            )

    def _last_bytes(self) -> bytes:
        """Those before what is intact ends: nulls once the file was cut and written on."""
        if not self._path.is_file():
            return b""
        start = max(self._intact - END_BYTES, 0)
        self._lock.seek(start)
        return self._lock.read(self._intact - start)

    def _give_up(self, error: RuntimeError) -> NoReturn:
        intact = self._intact
        self._let_go()
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


def is_switched_off(environment: Mapping[str, str]) -> bool:
    """Whether Rerun would write nothing at all."""
    return environment.get("RERUN", "").lower() in ("0", "false", "off")


def _locked(path: Path) -> FileIO:
    """The file, open, which nobody else records to until it is closed, if by the end of the
    process. Tells plainly, and before anything is simulated, what Rerun would report from a
    thread. Raises OSError."""
    file = path.open("a+b", buffering=0)
    try:
        if fcntl is not None and path.is_file():
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise OSError(f"{path} is being written by another run; give another name") from None
    try:
        if path.is_file():
            file.truncate(0)
        file.write(b"RRF2")
    except OSError as error:
        file.close()
        full = OSError(f"{path}: {error.strerror}; make room or record elsewhere")
        full.errno = error.errno
        raise full from None
    return file


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
