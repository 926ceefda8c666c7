"""Where recordings are written: one writer for a file, and what ends a recording."""

import os
import time
from threading import Thread

import pytest

from command_line import UNUSABLE_INPUT, UNWRITABLE
from independent import MODELS, status_of
from sim import Recorder, Scene, read_series, simulate

CUBE = MODELS / "cube.xml"


def record(path, scene: Scene, meddle) -> None:
    """A run half way through which something happens to the file."""
    with Recorder(path, scene, water_resolution=2) as recorder:
        for i, sample in enumerate(simulate(scene, 2.0)):
            recorder.log(sample)
            if i == 30:
                meddle()


def test_a_file_has_one_writer_and_nothing_of_it_is_lost(tmp_path):
    scene, path = Scene.load(CUBE), tmp_path / "new" / "folder" / "a.rrd"

    def try_too() -> None:
        with pytest.raises(OSError, match=r"a\.rrd is being written by another run; give another"):
            Recorder(path, scene)

    record(path, scene, try_too)
    assert len(read_series(path)["height/cube"][0]) == 61
    Recorder(path, scene).close()  # it is free again


def replaced(path) -> None:
    path.unlink()
    path.write_bytes(b"another's")


@pytest.mark.parametrize("meddle", [os.remove, replaced], ids=["removed", "replaced"])
def test_a_recording_that_is_removed_ends_the_run(meddle, tmp_path):
    scene, path = Scene.load(CUBE), tmp_path / "a.rrd"
    with pytest.raises(OSError, match=r"a\.rrd: the recording was removed while it was written"):
        record(path, scene, lambda: meddle(path))
    assert not path.exists() or path.read_bytes() == b"another's"


def test_a_script_whose_recording_is_removed_says_so_and_sums_up(tmp_path, capfd):
    path = tmp_path / "a.rrd"

    def remove() -> None:
        while not (path.exists() and path.stat().st_size > 500_000):
            time.sleep(0.01)
        path.unlink()

    remover = Thread(target=remove, daemon=True)
    remover.start()
    assert status_of("run.py", CUBE, "--duration", 60, "--record", path) == UNWRITABLE
    told = capfd.readouterr()
    *notes, line = told.err.splitlines()
    assert line == f"run.py: {path}: the recording was removed while it was written"
    assert all(note.startswith("run.py: note: ") for note in notes)
    assert "x real time" in told.out
    assert list(tmp_path.iterdir()) == []


def test_what_is_recorded_stays_until_the_new_recording_begins(tmp_path, capfd):
    path, broken = tmp_path / "a.rrd", tmp_path / "broken.xml"
    path.write_bytes(b"of yesterday")
    broken.write_text("<mujoco/>")
    assert status_of("run.py", broken, "--record", path) == UNUSABLE_INPUT
    assert status_of("run.py", CUBE, "--timestep", "1e-12", "--record", path) == UNUSABLE_INPUT
    assert path.read_bytes() == b"of yesterday"
    assert status_of("run.py", CUBE, "--duration", 0.1, "--record", path, "--quiet") == 0
    assert len(read_series(path)["height/cube"][0]) == 4


def test_rerun_switched_off_is_said(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("RERUN", "off")
    arguments = CUBE, "--duration", "0.1", "--record", tmp_path / "a.rrd"
    assert status_of("run.py", *arguments) == UNUSABLE_INPUT
    assert "variable RERUN is 'off', so Rerun would write an empty" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []
