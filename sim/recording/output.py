"""Output: an .rrd file, a viewer, or both."""

import atexit
import ctypes
import os
import socket
from pathlib import Path
from typing import NoReturn

import rerun as rr
import rerun.blueprint as rrb

from sim.platforms import has_screen
from sim.runs.locked import LockedFile, raise_unwritable

PROGRAM = "waterline"
"""Name of the program in recordings, which Rerun calls the application's id."""

VIEWER_PORT = 9876
"""Default port of a Rerun viewer."""

FIRST_BYTES = 1 << 18
"""Room [bytes] that must be left on the disk when a recording begins. Rerun never answers if it
cannot write the beginning."""

FLUSH_SECONDS = 5.0
"""Longest wait [s] for a flush of about a megabyte. Rerun's writer does not answer after it has
failed, so it also takes this long to notice that the disk is full."""


def path_part(name: str) -> str:
    """A name with any characters as one part of an entity path."""
    return rr.escape_entity_path_part(name)


class Output:
    """An .rrd file, a viewer, or both, for logged data. stream: Rerun's stream of it. blueprint:
    the arrangement of its views.

    Missing folders are made. Raises OSError if the file cannot be written, is written by another
    run, or is removed, and if no viewer can be opened; ValueError if Rerun is switched off. An
    existing file is not changed before the new recording begins. After an error the file ends with
    the last flush; without a flush it is removed.
    """

    def __init__(
        self,
        path: Path | None,
        name: str,
        blueprint: rrb.Blueprint,
        view: bool = False,
        port: int = VIEWER_PORT,
    ) -> None:
        if path is None and not view:
            raise ValueError(
                "the recording would go nowhere: give the path of an .rrd file, or view=True"
            )
        switch = os.environ.get("RERUN", "")
        if switch.lower() in ("0", "false", "off"):
            raise ValueError(
                f"the environment variable RERUN is '{switch}', so Rerun would write an empty "
                "recording; unset it, or make no recording"
            )
        self.is_open, self.blueprint = True, blueprint
        self._path, self._flushed = path, 0
        self._file: LockedFile | None = None
        self.stream = stream = rr.RecordingStream(PROGRAM)
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        self.log, self.send_columns = stream.log, stream.send_columns
        sinks = []
        if view:
            _open_viewer(port)
            sinks.append(rr.GrpcSink(f"rerun+http://127.0.0.1:{port}/proxy"))
        if path is not None:
            self._file = LockedFile(path)
            self._file.check_room(FIRST_BYTES)
            sinks.append(rr.FileSink(self._file.path))
        try:
            stream.set_sinks(*sinks, default_blueprint=blueprint)
        except RuntimeError as error:
            self._give_up(error)
        stream.send_recording_name(name)

    def flush(self) -> None:
        """Write all logged data to the disk."""
        try:
            self.stream.flush(timeout_sec=FLUSH_SECONDS)
        except RuntimeError as error:
            self._give_up(error)
        if self._file is not None:
            self.is_open = not self._file.is_removed
            self._file.check()
            self._flushed = self._file.size

    def close(self) -> None:
        """Write all logged data and release the file and the viewer."""
        self.flush()
        self.stream.disconnect()
        self._release()

    def _release(self) -> None:
        self.is_open = False
        if self._file is not None:
            self._file.close()

    def _give_up(self, error: RuntimeError) -> NoReturn:
        """Raise OSError, and keep the end of the stream and of the process from waiting for the
        failed writer."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self.stream))
        atexit.unregister(rr.rerun_shutdown)
        if self._file is not None:
            self._file.cut(self._flushed)
        self._release()
        raise_unwritable(self._path or Path("the recording in the viewer"), error)


def _open_viewer(port: int) -> None:
    """Start a viewer unless one is listening. Raises OSError if there is no screen."""
    with socket.socket() as probe:
        if probe.connect_ex(("127.0.0.1", port)) == 0:
            return
    if not has_screen():
        raise OSError(
            "there is no screen for the viewer (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            f"forward port {port} to a viewer elsewhere, or make a recording"
        )
    rr.spawn(port=port, connect=False, hide_welcome_screen=True)
