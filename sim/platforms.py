"""Platforms: what Linux, macOS and Windows do differently. No other module of the package names
one of them, nor a library or a function that only some of them have.

The functions take the name of the system, as in `sys.platform`, so that tests can give another one.
"""

import ctypes
import os
import sys
import time
from importlib import import_module
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

WINDOWS, MACOS = "win32", "darwin"
"""Values of `sys.platform`. Other systems count as Linux."""

LOCKED_BYTE = 1 << 40
"""Position [bytes] of the byte that is locked on Windows, where no process can read or write locked
bytes. No recording is that long."""


class Clock(NamedTuple):
    """A C function that reads a clock that never runs backwards.

    name: of the function. address: where it is. numbers: its first arguments, C ints. Its last
    argument is the address of two 64-bit integers: it writes the number of ticks into the first one
    and may write nanoseconds since that tick into the second one. rate: ticks per second.
    """

    name: str
    address: int
    numbers: tuple[int, ...]
    rate: int


def clock(system: str = sys.platform) -> Clock:
    """The clock of the system."""
    if system == WINDOWS:  # in units of 100 ns, since Windows 10
        name, numbers, rate = "QueryUnbiasedInterruptTimePrecise", (), 10**7
        library = ctypes.WinDLL("kernelbase")  # type: ignore[attr-defined]
    else:
        name, numbers, rate = "clock_gettime", (time.CLOCK_MONOTONIC,), 1
        library = ctypes.CDLL(None)
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0
    return Clock(name, address, numbers, rate)


def mujoco_file(folder: Path, system: str = sys.platform) -> Path:
    """MuJoCo's library in the folder of its Python package. Raises FileNotFoundError."""
    names = {WINDOWS: "mujoco.dll", MACOS: "libmujoco.*dylib"}
    pattern = names.get(system, "libmujoco.so*")
    found = next(folder.glob(pattern), None)
    if found is None:
        raise FileNotFoundError(f"there is no {pattern} in {folder}; install mujoco again")
    return found


def lock(file: FileIO, system: str = sys.platform) -> bool:
    """Lock an open file until it is closed. Returns False if it is locked already."""
    if system == WINDOWS:
        windows: Any = import_module("msvcrt")
        file.seek(LOCKED_BYTE)
        try:
            windows.locking(file.fileno(), windows.LK_NBLCK, 1)
        except PermissionError:
            return False
        finally:
            file.seek(0, os.SEEK_END)
    else:
        posix: Any = import_module("fcntl")
        try:
            posix.flock(file, posix.LOCK_EX | posix.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def remove_open(file: FileIO, path: Path, system: str = sys.platform) -> None:
    """Remove an open file and close it. Windows cannot remove it while it is open. Elsewhere it is
    removed first, so that no other process locks a file that is about to be removed."""
    if system == WINDOWS:
        file.close()
    path.unlink(missing_ok=True)
    file.close()


def has_screen(system: str = sys.platform) -> bool:
    """Whether a window can be opened, as far as the environment tells."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    return system in (WINDOWS, MACOS) or any(os.environ.get(name) for name in screens)
