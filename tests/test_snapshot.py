"""scripts/snapshot.py: its pictures, its refusals, and the viewers that it starts.

Without a graphics driver there is no picture, and the tests require the script to report that.
pillow and psutil come with rerun-sdk.
"""

import importlib.util
import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
import rerun as rr
from PIL import Image

from independent import MODELS, REPOSITORY, receive_ctrl_c
from sim import Recorder, Scene, simulate

SCRIPT = REPOSITORY / "scripts" / "snapshot.py"
SIZE = (480, 270)
"""Width and height [pixels] of the pictures, which are small because software draws them."""

NO_DRIVER = "apt-get install mesa-vulkan-drivers"

_spec = importlib.util.spec_from_file_location("snapshot", SCRIPT)
snapshot = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(snapshot)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Half a second of the bunny."""
    path = tmp_path_factory.mktemp("snapshot") / "bunny.rrd"
    scene = Scene.load(MODELS / "bunny.xml")
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.5, rate=20.0):
            recorder.log(sample)
    return path


@pytest.fixture
def take(recording, capsys):
    """A function that runs the script on the recording: exit status, stdout and stderr."""

    def run(*arguments, path=recording):
        try:
            status = snapshot.main([str(a) for a in (path, *arguments)])
        except SystemExit as end:  # from the parser
            status = end.code
        return status, *capsys.readouterr()

    return run


def is_refusal(result, message: str) -> bool:
    """Whether a run ended with status 2 and one line that contains the message."""
    status, out, err = result
    return (status, out) == (2, "") and message in err and err.count("\n") == 1


def test_pictures_show_the_given_time(take, tmp_path):
    shots = {}
    for name, time_s in {"start": 0.0, "again": 0.0, "end": 0.5}.items():
        shots[name] = tmp_path / "new" / f"{name}.png"
        size = ("--width", SIZE[0], "--height", SIZE[1])
        result = take("--time", time_s, "--output", shots[name], *size)
        if result[0]:
            assert is_refusal(result, NO_DRIVER)
            return
        assert result[1].endswith(f" at {time_s:.3f} s\n")
    assert shots["start"].read_bytes() == shots["again"].read_bytes()
    assert shots["start"].read_bytes() != shots["end"].read_bytes()
    with Image.open(shots["end"]) as image:
        assert (image.format, image.size) == ("PNG", SIZE)
        red, _, blue = np.moveaxis(np.asarray(image.convert("RGB"), dtype=float), -1, 0)
    assert (blue > red + 40).mean() > 0.05  # the water


UNUSABLE = {
    "not a number": (["--time", "soon"], "--time: soon is not a number from 0"),
    "nan": (["--time", "nan"], "--time: nan is not a number from 0"),
    "infinite": (["--time", "inf"], "--time: inf is not a number from 0"),
    "negative": (["--time", "-1"], "--time: -1 is not a number from 0"),
    "beyond the end": (["--time", "0.6"], "which covers 0.000 to 0.500 s"),
    "too small": (["--width", "9"], "--width: 9 is not a whole number from 64 to"),
    "too large": (["--height", "99999"], "--height: 99999 is not a whole number from 64"),
    "unknown option": (["--fast"], "unrecognized arguments: --fast"),
    "a folder": (["--output", "."], "is no file but a folder or a device"),
    "no time at all": (["--timeout", "1e300"], "1e300 is not a number above 0"),
    "below a file": (["--output", "text.txt/deep/a.png"], "cannot be written because of"),
    "no time to draw": (["--timeout", "0.01"], "no picture within 0.01 s"),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_input_gives_one_line_and_status_2(case, take, tmp_path, monkeypatch):
    arguments, message = UNUSABLE[case]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.txt").write_text("not a folder")
    if "--output" not in arguments:
        arguments = [*arguments, "--output", "a.png"]
    assert is_refusal(take(*arguments), message)
    assert [p.name for p in tmp_path.iterdir()] == ["text.txt"]


def test_other_files_are_refused(take, recording, tmp_path):
    assert is_refusal(take(path=tmp_path / "none.rrd"), "there is no recording file")
    assert is_refusal(take(path=tmp_path), "there is no recording file")
    for name, content in {
        "empty": b"",
        "text": b"hello",
        "cut": recording.read_bytes()[:9999],
    }.items():
        path = tmp_path / f"{name}.rrd"
        path.write_bytes(content)
        assert is_refusal(take(path=path), f"{name}.rrd is not a readable recording")
    path = tmp_path / "foreign.rrd"
    with rr.RecordingStream("foreign") as stream:
        stream.save(path)
        stream.log("point", rr.Points3D([[0.0, 0.0, 0.0]]))
        stream.disconnect()
    assert is_refusal(take(path=path), "has no data on the timeline 'time'")


def test_a_missing_driver_is_reported_with_the_remedy(take, monkeypatch, tmp_path):
    monkeypatch.setenv("WGPU_BACKEND", "vulkan")
    for variable in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(variable, str(tmp_path / "none.json"))
    assert is_refusal(take("--output", tmp_path / "a.png"), NO_DRIVER)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_viewer_outlives_the_script(number, recording, tmp_path):
    command = [sys.executable, SCRIPT, recording, "--output", tmp_path / "a.png"]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, preexec_fn=receive_ctrl_c,
        env=os.environ | {"TMPDIR": str(tmp_path)},
    ) as script:  # fmt: skip
        viewers = []
        while len(viewers) < 2 and script.poll() is None:  # the viewer and the process above it
            time.sleep(0.01)
            viewers = psutil.Process(script.pid).children(recursive=True)
        script.send_signal(number)
        _, err = script.communicate(timeout=30)
    _, alive = psutil.wait_procs(viewers, timeout=20)
    assert [v for v in alive if v.status() != psutil.STATUS_ZOMBIE] == []
    if number == signal.SIGKILL:
        assert script.returncode == -number
    else:
        assert script.returncode == 128 + number
        assert err == f"snapshot.py: stopped by {number.name}\n"
        assert list(tmp_path.iterdir()) == []
