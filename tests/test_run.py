"""scripts/run.py: its exit status, its output, its files."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from itertools import islice

import numpy as np
import pytest
from rerun.chunk import RrdReader
from screen import Screen

from independent import MODELS, REPOSITORY, sending, status_of
from sim import Recorder, Scene, Sea, Tally, Wave, read_series, simulate
from sim.recording.reader import reader
from sim.runs.tables import read_columns
from sim.water.words import sea_in_words

RUN = [sys.executable, str(REPOSITORY / "scripts" / "run.py")]


def test_run_records_prints_and_writes_its_summary(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert status_of("run.py", MODELS / "bunny.xml", "--duration", 1, "--json", "out.json") == 0
    stdout, stderr = capsys.readouterr()
    summary = json.loads((tmp_path / "out.json").read_text())
    assert list(summary) == [
        "scene", "sea", "steps", "timestep", "duration", "wall_s", "realtime_factor",
        "buoyancy_us_per_step", "step_us", "logging_ms_per_frame", "warm_up", "bodies",
        "recording",
    ]  # fmt: skip
    assert summary["scene"] == "bunny"
    assert (summary["steps"], summary["timestep"], summary["duration"]) == (500, 0.002, 1.0)
    assert summary["realtime_factor"] == pytest.approx(1.0 / summary["wall_s"])
    assert 0.0 < summary["buoyancy_us_per_step"] * 500e-6 < summary["wall_s"]
    assert 0.0 < summary["step_us"] * 500e-6 < summary["wall_s"]
    assert 0.0 < summary["logging_ms_per_frame"] * 31e-3 < summary["wall_s"]
    assert summary["recording"] == os.path.join("recordings", "bunny.rrd")
    assert len(RrdReader(tmp_path / summary["recording"]).recordings()) == 1
    for expected in (
        "500 steps",
        "x real time",
        "us in buoyancy",
        "ms in logging",
        "bunny",
        "look at it with",
        "sea: 3 waves, amplitude 0.1, 0.06, 0.03 m",
    ):
        assert expected in stdout
    assert "\r" not in stderr  # no progress bar without a terminal


def test_the_summary_matches_the_same_run_in_python(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ("--duration", 1, "--rate", 20, "--timestep", 0.004, "--no-record", "--quiet")
    arguments += ("--set", "water_pressure=hydrostatic")
    assert status_of("run.py", MODELS / "cube.xml", *arguments, "--json", "out.json") == 0
    assert capsys.readouterr() == ("", "")
    summary = json.loads((tmp_path / "out.json").read_text())
    scene = Scene.load(MODELS / "cube.xml", timestep=0.004, settings=["water_pressure=hydrostatic"])
    tally = Tally(scene)
    for sample in simulate(scene, 1.0, 20.0):
        tally.add(sample)
    assert summary["bodies"] == tally.bodies()
    assert summary["recording"] is summary["logging_ms_per_frame"] is None
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.json"]


DRY = """<mujoco><worldbody><body name="hull"><freejoint/>
  <geom name="shell" type="box" size="0.5 0.5 0.5" density="500"/>
  <geom name="mast" pos="0 0 1" size="0.1" mass="0" contype="0" conaffinity="0"/>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize("ending", ["xml", "urdf"])
def test_bodies_of_dry_files_float(ending, tmp_path, capsys):
    """A URDF's root would be fixed to the world."""
    inertia = "".join(f' i{axes}="40"' for axes in ("xx", "yy", "zz"))
    products = "".join(f' i{axes}="0"' for axes in ("xy", "xz", "yz"))
    urdf = f"""<robot name="box"><link name="hull">
      <inertial><mass value="500"/><inertia{inertia}{products}/></inertial>
      <collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>"""
    path, out = tmp_path / f"dry.{ending}", tmp_path / "out.json"
    path.write_text(DRY if ending == "xml" else urdf)
    options = ("--no-record", "--duration", 0.1, "--quiet", "--json", out)
    assert status_of("run.py", path, *options, "--buoyant", "hull") == 0
    summary = json.loads(out.read_text())
    assert list(summary["bodies"]) == ["hull"]
    assert summary["sea"] == "still water"
    assert status_of("run.py", path, *options) == 2
    assert "name a body: --buoyant BODY" in capsys.readouterr().err


def test_the_summary_of_many_bodies_is_folded(capsys):
    """A table of 100 rows becomes its first rows and its extremes."""
    assert status_of("run.py", MODELS / "spheres.xml", "--duration", 0.1, "--no-record") == 0
    printed = capsys.readouterr().out
    assert printed.count("ball_0_0 ") == 4  # in the means, and in each block of the motions
    assert "ball_5_5" not in printed
    assert printed.count("most of 100") == printed.count("least of 100") == 4
    assert len(printed.splitlines()) < 30
    assert "--json FILE writes the numbers of all" in printed


def test_the_motions_match_the_series_after_the_warm_up(tmp_path):
    out, table = tmp_path / "out.json", tmp_path / "s.npz"
    options = ("--no-record", "--quiet", "--duration", 3, "--warm-up", 1)
    files = ("--json", out, "--series", table)
    assert status_of("run.py", MODELS / "trio.xml", *options, *files) == 0
    bodies, series = json.loads(out.read_text())["bodies"], read_columns(table)
    for body, found in bodies.items():
        counts = (series["body"] == body) & (series["time"] >= 1.0 - 1e-9)
        for name, column in (("heave_m", "heave"), ("heel_deg", "heel_deg")):
            values = series[column][counts]
            assert found[name]["mean"] == pytest.approx(values.mean())
            assert found[name]["std"] == pytest.approx(values.std())
            assert found[name]["largest"] == values[np.abs(values).argmax()]
        assert found["mean_tilt_deg"] == pytest.approx(series["tilt_deg"][counts].mean())
        assert found["drift_m"]["largest"] > 0.0


@pytest.mark.parametrize(
    ("sea", "words"),
    [
        (Sea(), "still water"),
        (Sea(density=1000.0, level=2.0), "still water; level 2 m; density 1000 kg/m^3"),
        (
            Sea([Wave(0.1, 4.0, np.pi / 2.0)], current=(-0.3, 0.0), ramp=5.0),
            "1 wave, amplitude 0.1 m, length 4 m, heading 90 deg, steepness 0.16; "
            "current 0.3 m/s towards 180 deg; the waves grow for 5 s",
        ),
        (
            Sea([Wave(0.01, length, 0.1) for length in np.linspace(2.0, 9.0, 8)]),
            "8 waves of 2 to 9 m, significant height 0.08 m, mean heading 6 deg, steepness 0.11",
        ),
        (Sea(tide=[(0, -1), (9, 1)]).hydrostatic, "still water; tide from -1 to 1 m; hydrostatic"),
    ],
)
def test_a_sea_is_named_in_one_line(sea, words):
    assert sea_in_words(sea).startswith(words)


class Window:
    """A stand-in for MuJoCo's viewer, which closes after ten views."""

    views = 0

    def sync(self):
        self.views += 1

    def is_running(self):
        return self.views < 10

    def close(self):
        self.views = -1


def test_a_viewed_run_keeps_its_speed_and_ends_with_its_window(tmp_path, monkeypatch):
    window, waits = Window(), []
    monkeypatch.setenv("DISPLAY", ":9")
    monkeypatch.setattr("glfw.init", lambda: True)
    monkeypatch.setattr("mujoco.viewer.launch_passive", lambda *_, **__: window)
    monkeypatch.setattr("time.sleep", waits.append)
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)
    scene = Scene.load(MODELS / "cube.xml")
    with Screen(scene, speed=2.0) as screen:
        shown = [screen.show(sample) for sample in islice(simulate(scene, 9.0, 10.0), 10)]
    assert shown == [True] * 9 + [False]
    np.testing.assert_allclose(waits, 0.05 * np.arange(10), atol=1e-9)
    assert window.views == -1


BROKEN = {
    "no file": (["nowhere.xml"], "there is no scene file nowhere.xml"),
    "not MJCF": (["broken.xml"], "MuJoCo cannot compile it"),
    "nothing floats": (["empty.xml"], "nothing floats"),
    "unknown method": (
        [MODELS / "cube.xml", "--set", "buoyancy_method=magic"],
        "'magic' is not a method; expected one of",
    ),
    "no body": (["dry.xml", "--buoyant", "hul"], "there is no body 'hul'; the model has hull"),
    "speed of no viewer": ([MODELS / "cube.xml", "--speed", "2"], "viewer; add --view"),
    "only a warm-up": (
        [MODELS / "cube.xml", "--duration", "2", "--warm-up", "2"],
        "nothing left after a warm-up of 2 s; run longer (--duration) or warm up for less time",
    ),
    "no screen": ([MODELS / "cube.xml", "--view"], "--view found no screen; leave it out"),
    "no duration": ([MODELS / "cube.xml", "--duration", "0"], "--duration: 0 is not"),
    "no number": (
        [MODELS / "cube.xml", "--rate", "fast"],
        "--rate: fast is not a number above 0 and at most",
    ),
    "infinite": ([MODELS / "cube.xml", "--timestep", "inf"], "--timestep: inf is not"),
    "no tolerance": (
        [MODELS / "cube.xml", "--set", "buoyancy_tolerance=-1"],
        "the buoyancy tolerance is -1 m of water height; it must be above 1e-09",
    ),
    "rate of frames": (
        [MODELS / "cube.xml", "--record-rate", "60"],
        "--record-rate 60 is above --rate 30; raise --rate",
    ),
    "no water": (
        [MODELS / "cube.xml", "--water-resolution", "1"],
        "resolution: 1 is not a whole number from 2 to 1000",
    ),
    "unknown option": ([MODELS / "cube.xml", "--fast"], "unrecognized arguments: --fast"),
    "unwritable": (
        [MODELS / "cube.xml", "--record", "broken.xml/a.rrd"],
        "broken.xml/a.rrd cannot be written because of",
    ),
    "a folder to record to": (
        [MODELS / "cube.xml", "--record", "."],
        "is no file but a folder or a device",
    ),
    "a folder as scene": (["."], "there is no scene file ."),
    "an empty file": (["void.xml"], "MuJoCo cannot compile it"),
    "not text": (["noise.xml"], "MuJoCo cannot compile it"),
    "a missing mesh": (["meshless.xml"], "MuJoCo cannot compile it"),
    "folding waves": (["folding.xml"], "the waves fold"),
    "unknown field": (["misspelt.xml"], "'water_densty' is unknown"),
    "negative drag": (["drag.xml"], "'drag': the form drag coefficient is -1"),
    "record or not": (
        [MODELS / "cube.xml", "--record", "a.rrd", "--no-record"],
        "not allowed with argument",
    ),
    "no scene": ([], "arguments are required: SCENE"),
    "not a timestep": ([MODELS / "cube.xml", "--timestep", "nan"], "--timestep: nan is not"),
    "unwritable summary": ([MODELS / "cube.xml", "--json", "void.xml/a.json"], "void.xml/a.json"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_unusable_input_gives_one_line_and_status_2(case, tmp_path, monkeypatch, capsys):
    arguments, message = BROKEN[case]
    (tmp_path / "broken.xml").write_text("<mujoco><wave/></mujoco>")
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    cube = (MODELS / "cube.xml").read_text()
    missing = '<asset><mesh file="no.obj"/></asset>'
    variants = {
        "void.xml": "",
        "dry.xml": DRY,
        "noise.xml": "\x00\x01<<<",
        "meshless.xml": cube.replace("<worldbody>", missing + "<worldbody>"),
        "folding.xml": cube.replace("0.10 4.0 0 0", "1.0 4.0 0 0"),
        "misspelt.xml": cube.replace("water_density", "water_densty"),
        "drag.xml": cube.replace('data="0.2 1.05', 'data="0.2 -1'),
    }
    for name, text in variants.items():
        (tmp_path / name).write_text(text)
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    status = status_of("run.py", *arguments)
    stdout, stderr = capsys.readouterr()
    assert (status, stdout) == (2, "")
    assert message in stderr
    assert stderr.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_the_recording_has_the_given_rate_and_water(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ("--record-rate", 10, "--water-size", 4, "--water-resolution", 9)
    assert status_of("run.py", MODELS / "cube.xml", "--duration", 1, *options) == 0
    rows = []
    for chunk in RrdReader(tmp_path / "recordings" / "cube.rrd").stream():
        if chunk.entity_path == "/world/water" and not chunk.is_static:
            rows += chunk.to_record_batch().column("Mesh3D:vertex_positions").to_pylist()
    assert len(rows) == 11
    points = np.array(rows[0])
    assert 0.8 * 9**2 < len(points) < 1.4 * 9**2
    orbits = 2 * 0.2  # m; particles are up to 0.19 m from their labels
    assert np.ptp(points, axis=0)[:2] == pytest.approx(4.0, abs=orbits)


def test_divergence_gives_status_3_and_keeps_the_recording(tmp_path, monkeypatch, capsys):
    """Negative damping accelerates a cube without drag until its velocity is huge."""
    scene = (MODELS / "cube.xml").read_text().replace("0.2 1.05 0.0047", "0 0 0")
    still = '<freejoint name="cube"/>'
    wild = '<joint type="free" damping="-5000"/>'
    assert still in scene
    (tmp_path / "wild.xml").write_text(scene.replace(still, wild))
    monkeypatch.chdir(tmp_path)
    assert status_of("run.py", "wild.xml", "--record", "wild.rrd") == 3
    stderr = capsys.readouterr().err
    assert "body 'cube' diverged at" in stderr
    assert "try a timestep below 0.002 s" in stderr
    chunks = list(RrdReader(tmp_path / "wild.rrd").stream().filter(content="/plots/height/cube"))
    assert sum(chunk.num_rows for chunk in chunks if not chunk.is_static) >= 2


def recorded_until(path) -> float:
    """Earliest last time [s] of the entities of a recording."""
    last = {}
    with reader(path) as recording:
        for chunk in recording.stream():
            batch = chunk.to_record_batch()
            if "time" in batch.schema.names:
                time_s = batch.column("time").cast("int64").to_numpy().max() * 1e-9
                last[chunk.entity_path] = max(last.get(chunk.entity_path, 0.0), time_s)
    return min(last.values())


def has_two_seconds(recording) -> bool:
    return recording.exists() and recording.stat().st_size > 2_500_000


def check_cut_recording(recording) -> None:
    assert recorded_until(recording) >= 1.0
    assert read_series(recording)["height/cube"][0][-1] >= 1.0
    Recorder(recording, Scene.load(MODELS / "cube.xml")).close()  # the file is not locked


def test_a_terminated_run_leaves_a_summary_and_a_readable_recording(tmp_path, capsys):
    """`test_compare` tests Ctrl-C."""
    recording = tmp_path / "cut.rrd"
    with sending(signal.SIGTERM, lambda: has_two_seconds(recording)):
        arguments = ("--duration", 1000, "--record", recording)
        assert status_of("run.py", MODELS / "cube.xml", *arguments) == 143
    stdout, stderr = capsys.readouterr()
    *notes, line = stderr.splitlines()
    assert line == "run.py: stopped by SIGTERM"
    assert all(note.startswith("run.py: note: ") for note in notes)
    assert "cube" in stdout
    check_cut_recording(recording)


def test_a_killed_run_leaves_a_readable_recording(tmp_path):
    recording = tmp_path / "cut.rrd"
    process = subprocess.Popen(
        [*RUN, str(MODELS / "cube.xml"), "--duration", "1000", "--record", str(recording)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + 60.0
    while not has_two_seconds(recording):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    assert process.wait(timeout=60) == -signal.SIGKILL
    check_cut_recording(recording)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_full_disk_stops_the_run_cleanly(tmp_path):
    """A limit on the size of files stands for the full disk. The flushed part is a whole file."""
    limit = (1_500_000, 1_500_000)
    result = subprocess.run(
        [*RUN, str(MODELS / "cube.xml"), "--duration", "60", "--record", "full.rrd"],
        cwd=tmp_path, capture_output=True, text=True, timeout=100,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit),
    )  # fmt: skip
    assert result.returncode == 4, result.stderr
    *notes, line = result.stderr.splitlines()
    assert line.startswith("run.py: full.rrd cannot be written (")
    assert all(note.startswith("run.py: note: ") for note in notes)
    assert "cube" in result.stdout
    assert recorded_until(tmp_path / "full.rrd") > 0.1  # a slow machine writes smaller batches
    assert len(RrdReader(tmp_path / "full.rrd").recordings()) == 1


def test_an_endless_run_is_refused_before_anything_is_written(tmp_path, capsys):
    arguments = [MODELS / "cube.xml", "--timestep", "1e-12", "--record", tmp_path / "a.rrd"]
    assert status_of("run.py", *arguments) == 2
    error = capsys.readouterr().err
    assert "1e+13 steps" in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_several_scenes_run_in_turn_and_give_one_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.xml").write_text("<mujoco/>")
    scenes = [MODELS / "cube.xml", "broken.xml", MODELS / "bunny.xml"]
    assert status_of("run.py", *scenes, "--duration", "0.2", "--no-record") == 2
    printed = capsys.readouterr()
    *_, first, second, third = printed.out.rstrip().split("\n")
    assert first.split()[1:3] == ["done", "0.2"]
    assert second.split() == ["broken.xml", "refused"]
    assert third.split()[1:3] == ["done", "0.2"]
    assert "nothing floats" in printed.err
    assert status_of("run.py", *scenes, "--json", "a.json") == 2
    assert "--json names one file, and there are 3 scenes" in capsys.readouterr().err
