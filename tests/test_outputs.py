"""Scripts never overwrite their inputs."""

import shutil
from pathlib import Path

import pytest

from independent import MODELS, status_of
from sim.mjcf.files import model_files

SCENE = """<mujoco>
  <include file="parts/water.xml"/>
  <compiler meshdir="hulls"/>
  <asset><mesh name="bunny" file="bunny.obj" inertia="exact"/></asset>
  <worldbody><body><freejoint/><geom name="bunny" type="mesh" mesh="bunny" density="500"/></body>
  </worldbody></mujoco>"""

WATER = """<mujocoinclude><custom><tuple name="buoyant">
  <element objtype="geom" objname="bunny" prm="0"/></tuple></custom></mujocoinclude>"""


@pytest.fixture
def scene(tmp_path) -> Path:
    """A scene of three files."""
    for folder in ("parts", "hulls"):
        (tmp_path / folder).mkdir()
    (tmp_path / "parts" / "water.xml").write_text(WATER)
    shutil.copy(MODELS / "meshes" / "bunny.obj", tmp_path / "hulls")
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "link.rrd").symlink_to(tmp_path / "scene.xml")
    return tmp_path / "scene.xml"


INPUTS = ("scene.xml", "link.rrd", "parts/water.xml", "hulls/bunny.obj")


def test_all_files_of_a_model_are_found(scene):
    folder = scene.parent
    expected = [folder / name for name in INPUTS if name != "link.rrd"]
    assert sorted(model_files(scene)) == sorted(expected)
    broken = folder / "broken.xml"
    broken.write_text("<mujoco")
    assert model_files(broken) == [broken]
    assert model_files(folder / "none.xml") == [folder / "none.xml"]


OPTIONS = [
    ("run.py", "--record"), ("run.py", "--json"), ("compare.py", "--record"),
    ("compare.py", "--json"), ("hydrostatics.py", "--json"), ("hydrostatics.py", "--figure"),
    ("video.py", "--output"),
]  # fmt: skip


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize(("script", "option"), OPTIONS)
def test_no_script_overwrites_a_file_of_its_scene(scene, script, option, name, capsys):
    before = {path: (scene.parent / path).read_bytes() for path in INPUTS}
    methods = ["--methods", "linear", "--no-record"][: 2 if option == "--record" else 3]
    more = methods if script == "compare.py" else []
    assert status_of(script, scene, option, scene.parent / name, *more) == 2
    error = capsys.readouterr().err
    assert "is read and would be written over" in error
    assert error.count("\n") == 1
    assert {path: (scene.parent / path).read_bytes() for path in INPUTS} == before


@pytest.mark.parametrize(
    ("script", "options"),
    [("run.py", ("--record", "--json")), ("hydrostatics.py", ("--json", "--figure"))],
)
def test_two_outputs_need_two_files(scene, script, options, capsys):
    same = scene.parent / "out.rrd"
    assert (
        status_of(script, scene, options[0], same, options[1], scene.parent / "." / "out.rrd") == 2
    )
    assert "is given for two outputs" in capsys.readouterr().err
    assert not same.exists()


def test_a_recording_that_is_read_is_not_overwritten(tmp_path, capsys):
    file = tmp_path / "a.rrd"
    file.write_bytes(b"RRF2 and so on")
    assert status_of("read_recording.py", file, "--output", file) == 2
    assert status_of("snapshot.py", file, "--output", file) != 0
    assert file.read_bytes() == b"RRF2 and so on"
    assert "written over" in capsys.readouterr().err
