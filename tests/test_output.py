"""Files of recordings: one writer per file, and files that are removed or replaced."""

import os
import signal
import time
from threading import Thread

import pytest
from rerun.chunk import RrdReader

from command_line import UNUSABLE_INPUT, UNWRITABLE
from independent import MODELS, status_of
from sim import Recorder, Scene, read_series, simulate
from sim.recording.recorder import SceneWriter

CUBE = MODELS / "cube.xml"


def record(path, scene: Scene, interfere) -> None:
    """Record a run, and call `interfere` half way through."""
    with Recorder(path, scene, water_resolution=2) as recorder:
        for i, sample in enumerate(simulate(scene, 2.0)):
            recorder.log(sample)
            if i == 30:
                interfere()


def test_a_file_has_one_writer(tmp_path):
    scene, path = Scene.load(CUBE), tmp_path / "new" / "folder" / "a.rrd"

    def open_again() -> None:
        with pytest.raises(OSError, match=r"a\.rrd is being written by another run; give another"):
            Recorder(path, scene)

    record(path, scene, open_again)
    assert len(read_series(path)["height/cube"][0]) == 61
    Recorder(path, scene).close()  # the file is free again


def replace(path) -> None:
    path.unlink()
    path.write_bytes(b"another file")


@pytest.mark.parametrize("interfere", [os.remove, replace], ids=["removed", "replaced"])
def test_a_removed_recording_ends_the_run(interfere, tmp_path):
    scene, path = Scene.load(CUBE), tmp_path / "a.rrd"
    with pytest.raises(OSError, match=r"a\.rrd was removed while it was written"):
        record(path, scene, lambda: interfere(path))
    assert not path.exists() or path.read_bytes() == b"another file"


def test_a_script_reports_a_removed_recording_and_prints_its_summary(tmp_path, capfd):
    path = tmp_path / "a.rrd"

    def remove() -> None:
        while not (path.exists() and path.stat().st_size > 500_000):
            time.sleep(0.01)
        path.unlink()

    remover = Thread(target=remove, daemon=True)
    remover.start()
    assert status_of("run.py", CUBE, "--duration", 60, "--record", path) == UNWRITABLE
    printed = capfd.readouterr()
    *notes, line = printed.err.splitlines()
    assert line == f"run.py: {path} was removed while it was written; run again"
    assert all(note.startswith("run.py: note: ") for note in notes)
    assert "x real time" in printed.out
    assert list(tmp_path.iterdir()) == []


def test_an_old_recording_stays_until_a_new_one_begins(tmp_path, capfd):
    path, broken = tmp_path / "a.rrd", tmp_path / "broken.xml"
    path.write_bytes(b"an old recording")
    broken.write_text("<mujoco/>")
    assert status_of("run.py", broken, "--record", path) == UNUSABLE_INPUT
    assert status_of("run.py", CUBE, "--timestep", "1e-12", "--record", path) == UNUSABLE_INPUT
    assert path.read_bytes() == b"an old recording"
    assert status_of("run.py", CUBE, "--duration", 0.1, "--record", path, "--quiet") == 0
    assert len(read_series(path)["height/cube"][0]) == 4


def test_rerun_switched_off_is_reported(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("RERUN", "off")
    arguments = CUBE, "--duration", "0.1", "--record", tmp_path / "a.rrd"
    assert status_of("run.py", *arguments) == UNUSABLE_INPUT
    assert "variable RERUN is 'off', so Rerun would write an empty" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "command",
    [("run.py", CUBE), ("compare.py", CUBE, "--methods", "linear", "--warm-up", "1")],
    ids=lambda command: command[0],
)
def test_a_stop_while_the_recording_is_opened_leaves_a_whole_one(
    command, tmp_path, monkeypatch, capfd
):
    start = SceneWriter.__init__

    def interrupted(*arguments, **options) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        start(*arguments, **options)

    monkeypatch.setattr(SceneWriter, "__init__", interrupted)
    path = tmp_path / "a.rrd"
    assert status_of(*command, "--duration", 60, "--record", path) == 130
    assert len(RrdReader(path).recordings()) == 1
    assert capfd.readouterr().err.splitlines()[-1].endswith("stopped by SIGINT")


def test_a_full_disk_leaves_the_old_recording_or_none(tmp_path, monkeypatch):
    def fail(number: int) -> None:
        raise OSError(28, "No space left on device")

    scene, old = Scene.load(CUBE), tmp_path / "old.rrd"
    old.write_bytes(b"an old recording")
    monkeypatch.setattr("os.fsync", fail)
    for path in (old, tmp_path / "new.rrd"):
        with pytest.raises(OSError, match=r"cannot be written \(No space left on device\)"):
            Recorder(path, scene)
    assert old.read_bytes() == b"an old recording"
    assert list(tmp_path.iterdir()) == [old]
