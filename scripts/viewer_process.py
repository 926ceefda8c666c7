"""Rerun's viewer in a process that ends with the process that started it, however that ends.

Run as a script, this file starts the viewer with the given arguments, and kills it when standard
input ends. The other end of standard input is a pipe, which a process cannot leave open when it
dies, not even if it is killed.
"""

import os
import subprocess
import sys
import time
from tempfile import TemporaryDirectory
from threading import Thread
from typing import IO

import psutil
from rerun_cli.__main__ import main as run_viewer

POLL_INTERVAL = 0.05
"""Seconds between two attempts to kill a viewer, which may not have started yet."""


def start_viewer(
    *arguments: str, log: int | IO[bytes] = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start Rerun's viewer. log: where its messages go. `end_viewer` ends it."""
    return subprocess.Popen(
        [sys.executable, __file__, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=log,
        start_new_session=True,  # Ctrl-C in a terminal goes to the caller only
    )


def end_viewer(process: subprocess.Popen[bytes]) -> None:
    """Let a viewer be killed. It has no data to save."""
    assert process.stdin is not None
    process.stdin.close()


def _kill_when_input_ends() -> None:
    sys.stdin.read()
    while True:
        for child in psutil.Process().children(recursive=True):
            child.kill()
        time.sleep(POLL_INTERVAL)


if __name__ == "__main__":
    with TemporaryDirectory() as folder:  # a killed viewer leaves a folder of its own
        # Logged messages would appear in the picture. Fatal errors are printed anyway.
        os.environ |= {"TMPDIR": folder, "RUST_LOG": "off"}
        Thread(target=_kill_when_input_ends, daemon=True).start()
        run_viewer()
