"""Linux, macOS and Windows: what can be tested of the others on one of them."""

import ctypes
import re
import sys
import time
from types import SimpleNamespace

import pytest
from numba import njit

from independent import REPOSITORY
from sim import platforms
from sim.addresses import nanoseconds, reader_of
from sim.platforms import clock, has_screen, lock, mujoco_file

NAMES = r"sys\.platform|os\.name\b|fcntl|msvcrt|CDLL\((None|\")|WinDLL|dylib|\.dll\b|killpg|SIGKILL"
NAMES += r"|clock_gettime|CLOCK_MONOTONIC|/dev/|posix"


def test_no_other_module_names_a_platform():
    files = [*REPOSITORY.glob("sim/**/*.py"), *REPOSITORY.glob("scripts/**/*.py")]
    assert len(files) > 100
    naming = {path.name for path in files if re.search(NAMES, path.read_text())}
    # MuJoCo reads the choice of graphics.py when it is imported, as it is by sim
    assert naming == {"platforms.py", "graphics.py"}


@pytest.mark.parametrize(
    ("system", "name"),
    [("linux", "libmujoco.so.4.0.0"), ("darwin", "libmujoco.4.0.1.dylib"), ("win32", "mujoco.dll")],
)
def test_the_library_of_mujoco_is_found(system, name, tmp_path):
    with pytest.raises(FileNotFoundError, match="install mujoco again"):
        mujoco_file(tmp_path, system)
    for other in (name, "_structs.pyd", "__init__.py", "libmujoco.lib"):
        (tmp_path / other).touch()
    assert mujoco_file(tmp_path, system).name == name


def test_the_clock_of_this_system_counts_nanoseconds():
    read = njit(lambda: nanoseconds())
    before, found, after = time.monotonic_ns(), read(), time.monotonic_ns()
    assert before <= found <= after


def test_the_clock_of_windows_counts_units_of_100_nanoseconds(monkeypatch):
    ticks = 3 * 10**15 + 12_345_678  # ten years and a little

    @ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_uint64))
    def tell(count) -> None:
        count[0] = ticks

    library = SimpleNamespace(QueryUnbiasedInterruptTimePrecise=tell)
    monkeypatch.setattr(ctypes, "WinDLL", {"kernelbase": library}.get, raising=False)
    found = clock("win32")
    read_windows_clock = reader_of(found._replace(name="waterline_test_clock"))
    assert (found.numbers, found.rate) == ((), 10**7)
    assert njit(lambda: read_windows_clock())() == 100 * ticks


def test_a_lock_excludes_other_writers(tmp_path, monkeypatch):
    path = tmp_path / "file"
    with path.open("ab", buffering=0) as one, path.open("ab", buffering=0) as other:
        assert lock(one)
        assert not lock(other)
    locked: list[int] = []

    def locking(number: int, mode: int, count: int) -> None:
        position = file.tell()
        if position in locked:
            raise PermissionError("as Windows does")
        locked.append(position)

    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    path.write_bytes(b"content")
    with path.open("ab", buffering=0) as file:
        assert lock(file, "win32")
        assert not lock(file, "win32")
        assert locked == [platforms.LOCKED_BYTE]
        assert file.tell() == len(b"content")


def test_only_linux_tells_by_its_environment_that_there_is_no_screen(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert [has_screen(system) for system in ("linux", "darwin", "win32")] == [False, True, True]
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert has_screen("linux")
