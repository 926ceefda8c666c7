"""Where recordings are written: one writer a file, and a word when somebody touches it."""

import os
import subprocess
import sys

import pytest

from independent import MODELS, REPOSITORY, status_of
from sim import Recorder, Scene, read_series, simulate

SAMPLES = 200
"""Enough that Rerun has the first of them on disk."""


def record(recorder: Recorder, scene: Scene, meddle) -> None:
    """A run half way through which something happens to the file."""
    with recorder:
        for i, sample in enumerate(simulate(scene, SAMPLES / 30.0)):
            recorder.log(sample)
            if i == SAMPLES // 2:
                recorder._output.flush()
                meddle()


def test_a_file_has_one_writer_and_nothing_of_it_is_lost(tmp_path):
    scene, path = Scene.load(MODELS / "cube.xml"), tmp_path / "a.rrd"

    def try_too() -> None:
        with pytest.raises(OSError, match=r"a\.rrd is being written by another run; give another"):
            Recorder(path, scene)

    record(Recorder(path, scene), scene, try_too)
    assert len(read_series(path)["height/cube"][0]) == SAMPLES + 1
    Recorder(path, scene).close()  # it is free again


def test_a_killed_run_leaves_no_lock(tmp_path):
    path = tmp_path / "a.rrd"
    lines = (
        "import os, sys; from sim import Recorder, Scene; "
        "Recorder(sys.argv[2], Scene.load(sys.argv[1])); os.kill(os.getpid(), 9)"
    )
    command = [sys.executable, "-c", lines, str(MODELS / "cube.xml"), str(path)]
    assert subprocess.run(command, cwd=REPOSITORY, timeout=60).returncode == -9
    assert path.exists()
    Recorder(path, Scene.load(MODELS / "cube.xml")).close()


@pytest.mark.parametrize(
    ("meddle", "message"),
    [
        (os.remove, "was removed while it was written"),
        (lambda path: os.truncate(path, 1000), "was cut or replaced while it was written"),
        (lambda path: (os.remove(path), path.write_bytes(b"RRF2")), "was cut or replaced"),
    ],
    ids=["removed", "cut", "replaced"],
)
def test_who_meddles_with_a_recording_ends_the_run(meddle, message, tmp_path):
    scene, path = Scene.load(MODELS / "cube.xml"), tmp_path / "a.rrd"
    with pytest.raises(OSError, match=rf"a\.rrd: the recording {message}"):
        record(Recorder(path, scene), scene, lambda: meddle(path))


def test_a_recording_that_was_touched_by_nobody_is_no_trouble(tmp_path):
    scene, path = Scene.load(MODELS / "cube.xml"), tmp_path / "a.rrd"
    record(Recorder(path, scene), scene, lambda: None)
    assert len(read_series(path)["height/cube"][0]) == SAMPLES + 1


def test_rerun_switched_off_is_said(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("RERUN", "off")
    arguments = MODELS / "cube.xml", "--duration", "0.1", "--record", tmp_path / "a.rrd"
    assert status_of("run.py", *arguments) == 2
    assert "variable RERUN is 'off', so Rerun would write an empty" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is full")
def test_a_disk_that_is_full_at_the_start_is_told_from_bad_input(capfd):
    assert status_of("run.py", MODELS / "cube.xml", "--record", "/dev/full") == 4
    assert "No space left on device; make room" in capfd.readouterr().err
