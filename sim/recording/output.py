"""Output: an .rrd file, a viewer, or both."""

import atexit
import ctypes
import fcntl
import os
import socket
import sys
from io import FileIO
from pathlib import Path
from typing import NoReturn

import rerun as rr
import rerun.blueprint as rrb

VIEWER_PORT = 9876
"""Where a Rerun viewer listens, unless told otherwise."""

FLUSH_SECONDS = 5.0
"""Longest wait for the disk to take about a megabyte. Rerun's writer does not answer a flush once
it has given up, so it also takes this long to notice that the disk is full."""


def part(name: str) -> str:
    """A name as one part of an entity path, whatever characters it has."""
    return rr.escape_entity_path_part(name)


class Output:
    """An .rrd file, a viewer, or both, which take what is logged.

    Missing folders are made. Raises OSError when the file cannot be written, when another run is
    writing it, when it is removed under way, and when no viewer can be opened; ValueError when
    Rerun is switched off. A file that exists stays as it is until the new recording begins. After
    an error the file ends with the last flush; if there was none, it is removed.
    """

    def __init__(
        self,
        path: Path | None,
        name: str,
        blueprint: rrb.Blueprint,
        view: bool = False,
        port: int = VIEWER_PORT,
    ) -> None:
        switch = os.environ.get("RERUN", "")
        if switch.lower() in ("0", "false", "off"):
            raise ValueError(
                f"the environment variable RERUN is '{switch}', so Rerun would write an empty "
                "recording; unset it, or do without a recording"
            )
        self.is_open = True
        self._path, self._file, self._flushed = path, None, 0
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
            self._file = _locked(path)
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
        if self._file is not None:
            status = os.fstat(self._file.fileno())
            if status.st_nlink == 0:
                self._let_go()
                raise OSError(f"{self._path}: the recording was removed while it was written")
            self._flushed = status.st_size

    def close(self) -> None:
        """Write what is waiting and let go of file and viewer."""
        self.flush()
        self._stream.disconnect()
        self._let_go()

    def _let_go(self) -> None:
        self.is_open = False
        if self._file is not None:
            self._file.close()

    def _give_up(self, error: RuntimeError) -> NoReturn:
        """Raise OSError, and let nobody wait for the writer, which has died: neither the end of the
        stream nor the end of the process."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._stream))
        atexit.unregister(rr.rerun_shutdown)
        if self._file is not None:
            self._file.truncate(self._flushed)
            if self._flushed == 0:
                self._path.unlink(missing_ok=True)
        self._let_go()
        reason = " ".join(str(error).split())
        raise OSError(
            f"{self._path or 'the viewer'}: the recording cannot be written ({reason}); make room "
            "on the disk or record elsewhere. What was written before is intact"
        ) from None


def _locked(path: Path) -> FileIO:
    """The file, which no other run writes until it is closed. Raises OSError."""
    file = path.open("ab", buffering=0)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise OSError(f"{path} is being written by another run; give another name") from None
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
