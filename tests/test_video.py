"""scripts/video.py: its videos, its refusals, its camera, and the choice of a driver.

Without a driver there is no video of a scene, and the tests require the script to say what to
install.
"""

import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import graphics
import mujoco
import numpy as np
import pytest
import video
from PIL import Image

from command_line import Stopped, stops_held
from independent import MODELS, sending
from sim import DivergenceError, Scene

CUBE = MODELS / "cube.xml"


@pytest.fixture(autouse=True)
def _without_a_driver(monkeypatch):
    """In this process mujoco was imported before a driver could be chosen for it."""
    monkeypatch.setattr(graphics, "check_driver", lambda: None)


@pytest.fixture
def make(tmp_path, capsys):
    """A function that runs the script: exit status, the output's path, stdout and stderr."""

    def run(*arguments, source=CUBE, output="a.webp"):
        path = tmp_path / output
        try:
            status = video.main([str(a) for a in (source, "--output", path, *arguments)])
        except SystemExit as end:  # from the parser
            status = end.code
        return status, path, *capsys.readouterr()

    return run


def is_refusal(result, message: str) -> bool:
    """Whether a run ended with status 2, one line that contains the message, and no output."""
    status, path, out, err = result
    is_said = message in err and err.count("\n") == 1
    return is_said and (status, out, path.exists()) == (2, "", False)


def pictures(path) -> list[np.ndarray]:
    """The pictures (H, W, 3) of a video."""
    if path.suffix == ".mp4":
        with pytest.importorskip("av").open(str(path)) as file:
            return [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    with Image.open(path) as image:
        found = []
        for i in range(image.n_frames):
            image.seek(i)
            found.append(np.asarray(image.convert("RGB")))
        return found


def test_a_video_shows_a_body_in_the_sea_under_the_sky(tmp_path):
    path = tmp_path / "new" / "a.webp"
    quick = ["--duration", "0.1", "--fps", "10", "--size", "128x96", "--output"]
    result = subprocess.run(
        [sys.executable, video.__file__, CUBE, *quick, path],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    if result.returncode:
        assert "libosmesa6" in result.stderr
        assert (result.returncode, result.stderr.count("\n")) == (2, 1)
        return
    assert "2 pictures, 0.2 s" in result.stdout
    found = np.array(pictures(path), dtype=float)
    assert found.shape == (2, 96, 128, 3)
    assert np.abs(found[1] - found[0]).mean() > 0.2  # it moves
    red, _, blue = np.moveaxis(found[0], -1, 0)
    assert (blue[:10] > 180.0).mean() > 0.9  # the sky
    assert (blue - red > 20.0)[-10:].mean() > 0.9  # the water
    assert (red > blue + 20.0)[30:70, 40:90].mean() > 0.2  # the cube is orange


@pytest.mark.parametrize("suffix", [".mp4", ".gif", ".webp"])
def test_a_video_holds_all_pictures_in_order(suffix, tmp_path):
    if suffix == ".mp4":
        pytest.importorskip("av")
    path = tmp_path / f"a{suffix}"
    greys = [40, 90, 140, 190]
    video.WRITERS[suffix](path, (np.full((64, 96, 3), grey, np.uint8) for grey in greys), 25.0)
    found = np.array(pictures(path), dtype=float)
    assert found.shape == (4, 64, 96, 3)
    compression = 6.0
    np.testing.assert_allclose(found.mean(axis=(1, 2, 3)), greys, atol=compression)


REFUSALS = {
    "no video": (dict(output="a.png"), "a.png is no video: name it .mp4, .gif, .webp"),
    "no scene": (dict(source=MODELS / "none.xml"), "there is no scene file"),
    "no recording": (dict(source=MODELS / "none.rrd"), "there is no recording file"),
    "its own input": (dict(source="a.gif", output="a.gif"), "no scene file"),
    "odd": (("--size", "127x96"), "'127x96' is not a size WIDTHxHEIGHT of two even numbers"),
    "one side": (("--size", "128"), "'128' is not a size WIDTHxHEIGHT"),
    "long": (("--duration", "1e9"), "steps of 0.002 s, more than"),
    "field": (("--set", "wave_swell=1"), "wave_swell"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_unusable_input_is_refused_in_one_line(make, case):
    what, message = REFUSALS[case]
    result = make(**what) if isinstance(what, dict) else make(*what)
    assert is_refusal(result, message)


def test_what_a_format_cannot_do_is_refused(make, monkeypatch):
    assert is_refusal(make("--fps", "30", output="a.gif"), "a .gif counts in 1/100 s; choose 10")
    changed = make("--set", "seed=2", source=MODELS / "none.rrd")
    assert is_refusal(changed, "change a scene, not a recording")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert is_refusal(make(output="a.mp4"), "run: pip install '.[video]'")


def test_ctrl_c_leaves_the_former_video(make, tmp_path):
    former = tmp_path / "a.webp"
    former.write_text("former")

    def has_begun() -> bool:
        return (tmp_path / "begun").exists()

    def pictures() -> Iterator[np.ndarray]:
        while True:
            (tmp_path / "begun").touch()
            yield np.zeros((64, 64, 3), np.uint8)

    options = video.parse_arguments([str(CUBE), "--output", str(former), "--quiet"])
    options.duration = 1.0
    with sending(signal.SIGINT, has_begun), pytest.raises(Stopped), stops_held() as check_stops:
        video.film(options, pictures(), check_stops)
    assert former.read_text() == "former"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.webp", "begun"]


def test_a_run_that_diverges_leaves_the_video_until_then(tmp_path):
    def pictures() -> Iterator[np.ndarray]:
        yield from np.zeros((3, 64, 64, 3), np.uint8)
        raise DivergenceError("cube", 0.1, "height is 1 km", "use a shorter timestep")

    options = video.parse_arguments([str(CUBE), "--output", str(tmp_path / "a.gif"), "--quiet"])
    options.duration = 1.0
    count, end = video.film(options, pictures(), lambda: None)
    assert (count, end.body) == (3, "cube")
    assert (tmp_path / "a.gif").is_file()


def seen(scene: Scene, points: np.ndarray, camera: mujoco.MjvCamera) -> tuple[np.ndarray, float]:
    """Places (N, 2) of points in the picture, in half heights from its middle: right, up; and the
    camera's height [m]."""
    drawn = mujoco.MjvScene(scene.model, 1000)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    option = mujoco.MjvOption()
    mujoco.mjv_updateScene(scene.model, scene.data, option, None, camera, everything, drawn)
    eye = drawn.camera[0]
    forward, up = np.array(eye.forward, dtype=float), np.array(eye.up, dtype=float)
    right, away = np.cross(forward, up), points - eye.pos
    half = (away @ forward) * np.tan(np.radians(0.5 * scene.model.vis.global_.fovy))
    return np.column_stack([away @ right, away @ up]) / half[:, None], float(eye.pos[2])


@pytest.mark.parametrize("name", ["cube", "catamaran", "wigley"])
def test_the_camera_follows_what_floats_down_too(name):
    scene = Scene.load(MODELS / f"{name}.xml")
    follower, data = video.Follower(scene), scene.data
    for depth in (0.0, 30.0):
        data.time += 20.0  # the camera has arrived
        data.geom_xpos[:, 2] -= depth
        follower.move()
        hulls = [
            f.method.hull.vertices @ data.geom_xmat[f.geom].reshape(3, 3).T + data.geom_xpos[f.geom]
            for f in scene.buoyancy.floats
        ]
        places, height = seen(scene, np.concatenate(hulls), follower.camera)
        assert np.abs(places).max() < 1.0  # within a square picture
        assert np.ptp(places, axis=0).max() / 2.0 > 0.25
        assert height > scene.buoyancy.sea.level  # of the camera


ABSENT = {
    "nothing set, no card": ({}, {"OSMesa", "EGL"}, "osmesa"),
    "nothing set, EGL only": ({}, {"EGL"}, "egl"),
    "nothing set, a screen": ({"DISPLAY": ":0"}, set(), None),
    "nothing there": ({}, set(), "no library of osmesa or egl"),
    "what is set": ({"MUJOCO_GL": "egl"}, {"OSMesa", "EGL"}, "egl"),
    "what is set is missing": ({"MUJOCO_GL": "osmesa"}, {"EGL"}, "no library of osmesa"),
}


@pytest.mark.parametrize("case", ABSENT)
def test_a_driver_is_chosen_or_the_error_says_what_to_install(case, monkeypatch):
    variables, libraries, expected = ABSENT[case]
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(Path, "exists", lambda path: False)
    monkeypatch.setattr(Path, "glob", lambda path, pattern: iter(()))
    monkeypatch.setattr(graphics, "find_library", lambda name: name if name in libraries else None)
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    problem = graphics.choose_driver()
    if problem is None:
        assert os.environ.get("MUJOCO_GL") == expected
        return
    assert os.environ["MUJOCO_GL"] == "disable"  # otherwise mujoco could not be imported
    assert expected in problem
    assert "libosmesa6" in problem
