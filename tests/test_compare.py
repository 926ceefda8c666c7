"""scripts/compare.py: twins in the same water."""

import json
import signal
from contextlib import chdir, redirect_stdout
from io import StringIO

import numpy as np
import pytest
from rerun.chunk import RrdReader

from independent import MODELS, sending, status_of
from labels import fields_of
from sim import Scene, SideBySideRecorder, simulate


def test_twins_with_the_same_method_stay_identical_to_the_bit():
    twins = [Scene.load(MODELS / "bunny.xml", settings=fields_of("chord:4")) for _ in range(2)]
    for one, other in zip(*(simulate(twin, 2.0) for twin in twins), strict=True):
        for name in ("positions", "quaternions", "body_wrenches", "elevations"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert twins[0].data.qvel.tobytes() == twins[1].data.qvel.tobytes()


def labelled_cube(label: str) -> Scene:
    return Scene.load(MODELS / "cube.xml", settings=fields_of(label))


def test_a_twin_moves_as_it_does_alone():
    """Interleaved simulations with different methods do not affect each other."""
    alone = [s.positions for s in simulate(labelled_cube("chord:4"), 1.0)]
    twins = [labelled_cube(m) for m in ("linear", "chord:4")]
    pairs = list(zip(*(simulate(twin, 1.0) for twin in twins), strict=True))
    np.testing.assert_array_equal([pair[1].positions for pair in pairs], alone)
    assert (pairs[-1][0].positions != pairs[-1][1].positions).any()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    with chdir(folder), redirect_stdout(StringIO()) as printed:
        status = status_of(
            "compare.py", MODELS / "cube.xml", "--methods", "linear", "chord:4", "linear",
            "--duration", 6, "--warm-up", 2, "--rate", 20, "--timestep", 0.004,
            "--json", "out.json",
        )  # fmt: skip
    assert status == 0
    return printed.getvalue(), json.loads((folder / "out.json").read_text()), folder


def test_summary_has_means_differences_and_times(run):
    printed, summary, _ = run
    assert list(summary) == [
        "scene", "timestep", "duration", "starts", "warm_up", "rate", "methods",
        "buoyancy_us_per_step", "means", "differences", "wall_s", "recording",
    ]  # fmt: skip
    labels = ["linear", "chord:4", "linear (2)"]
    assert summary["methods"] == list(summary["means"]["cube"]) == labels
    assert all(us > 0.0 for us in summary["buoyancy_us_per_step"].values())
    identical = summary["differences"]["cube"]["linear (2)"]
    assert identical["height_m"]["largest"] == identical["tilt_deg"]["largest"] == 0.0
    assert identical["metres_apart"] == 0.0
    other = summary["differences"]["cube"]["chord:4"]
    assert other["height_m"]["largest"] > 0.0
    means = summary["means"]["cube"]
    apart = means["chord:4"]["tilt_deg"]["value"] - means["linear"]["tilt_deg"]["value"]
    assert other["tilt_deg"]["value"] == pytest.approx(apart)
    assert "cube, linear (2) minus linear" in printed
    assert "identical" in printed


def test_twins_may_differ_only_in_pressure(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status = status_of(
        "compare.py", MODELS / "spar.xml", "--methods", "patches", "patches/hydrostatic",
        "--duration", 12, "--warm-up", 4, "--rate", 20, "--no-record", "--json", "out.json",
    )  # fmt: skip
    assert status == 0
    differences = json.loads((tmp_path / "out.json").read_text())["differences"]["spar"]
    assert differences["patches/hydrostatic"]["height_m"]["largest"] > 0.1


def test_means_exclude_the_warm_up(run):
    *_, summary, _ = run
    scene = Scene.load(MODELS / "cube.xml", settings=fields_of("linear"), timestep=0.004)
    heights = [s.centres[0, 2] for s in simulate(scene, 6.0, 20.0) if s.time > 2.0 - 1e-9]
    assert summary["means"]["cube"]["linear"]["height_m"]["value"] == pytest.approx(
        np.mean(heights)
    )


def test_each_start_is_a_run_at_another_time_of_the_sea(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status = status_of(
        "compare.py", MODELS / "cube.xml", "--methods", "linear", "linear", "--starts", 3,
        "--duration", 3, "--warm-up", 1, "--rate", 20, "--timestep", 0.004, "--no-record",
        "--json", "out.json",
    )  # fmt: skip
    assert status == 0
    summary = json.loads((tmp_path / "out.json").read_text())
    height = summary["means"]["cube"]["linear"]["height_m"]
    assert (height["batches"], height["batch"]) == (3, 41)
    means = []
    for start in (0.0, *np.random.default_rng(0).uniform(0.0, 1e4, 2)):
        scene = Scene.load(MODELS / "cube.xml", settings=fields_of("linear"), timestep=0.004)
        scene.data.time = start
        heights = [s.centres[0, 2] for s in simulate(scene, 3.0, 20.0)]
        means.append(np.mean(heights[20:]))
    assert height["value"] == pytest.approx(np.mean(means))
    assert height["error"] == pytest.approx(np.std(means, ddof=1) / np.sqrt(3))
    assert summary["differences"]["cube"]["linear (2)"]["height_m"]["largest"] == 0.0


def test_all_twins_are_in_one_recording(run):
    *_, summary, folder = run
    assert summary["recording"] == "recordings/cube_twins.rrd"
    reader = RrdReader(folder / summary["recording"])
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    rows: dict[str, int] = {}
    for chunk in reader.stream():
        if not chunk.is_static:
            rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    for label in (r"linear", r"chord\:4", r"linear\ \(2\)"):
        for entity in ("world/bodies/cube", "world/water", "plots/height/cube", "plots/tilt/cube"):
            assert rows[f"/{label}/{entity}"] == 121


def test_recording_is_readable_when_a_run_fails_half_way(tmp_path):
    twins = {m: labelled_cube(m) for m in ("linear", "chord:4")}

    def record() -> None:
        with SideBySideRecorder(tmp_path / "cut.rrd", twins) as recorder:
            for samples in zip(*(simulate(twin, 5.0) for twin in twins.values()), strict=True):
                recorder.log(samples)
                if samples[0].time > 0.499:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    chunks = RrdReader(tmp_path / "cut.rrd").stream().filter(content="/linear/plots/height/cube")
    assert sum(chunk.num_rows for chunk in chunks if not chunk.is_static) == 16


def test_divergence_gives_status_3_and_keeps_the_recording(tmp_path, monkeypatch, capsys):
    """Negative damping accelerates a cube without drag until its velocity is huge."""
    scene = (MODELS / "cube.xml").read_text().replace("0.2 1.05 0.0047", "0 0 0")
    still, wild = '<freejoint name="cube"/>', '<joint type="free" damping="-5000"/>'
    assert still in scene
    (tmp_path / "wild.xml").write_text(scene.replace(still, wild))
    monkeypatch.chdir(tmp_path)
    methods = ("--methods", "linear", "chord:4")
    files = ("--record", "wild.rrd", "--json", "out.json")
    assert status_of("compare.py", "wild.xml", *methods, *files) == 3
    assert "body 'cube' diverged at" in capsys.readouterr().err
    assert json.loads((tmp_path / "out.json").read_text())["differences"] == {}
    assert len(RrdReader(tmp_path / "wild.rrd").recordings()) == 1


def test_ctrl_c_gives_status_130_and_a_readable_recording(tmp_path, capsys):
    recording = tmp_path / "cut.rrd"

    def is_recording() -> bool:
        return recording.exists() and recording.stat().st_size > 2_000_000

    with sending(signal.SIGINT, is_recording):
        status = status_of(
            "compare.py", MODELS / "cube.xml", "--methods", "linear", "chord:4",
            "--duration", 1000, "--record", recording,
        )  # fmt: skip
    assert status == 130
    assert capsys.readouterr().err.splitlines()[-1] == "compare.py: stopped by SIGINT"
    assert len(RrdReader(recording).recordings()) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.xml", "--methods", "linear"], "there is no scene file missing.xml"),
        ([MODELS / "cube.xml"], "--methods"),
        ([MODELS / "cube.xml", "--methods", "guess"], "'guess' is not a method"),
        ([MODELS / "cube.xml", "--methods", "linear", "--duration", "5"], "run longer"),
        ([MODELS / "cube.xml", "--methods", "linear", "--rate", "0"], "0 is not a number above 0"),
    ],
)
def test_unusable_input_gives_one_line_and_status_2(
    arguments, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert status_of("compare.py", *arguments) == 2
    stdout, stderr = capsys.readouterr()
    assert stdout == ""
    assert message in stderr
    assert stderr.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == []


def test_the_difference_of_twins_is_plotted(tmp_path):
    scenes = {m: labelled_cube(m) for m in ("linear", "patches")}
    path, differences = tmp_path / "twins.rrd", []
    with SideBySideRecorder(path, scenes) as recorder:
        for samples in zip(*(simulate(s, 2.5) for s in scenes.values()), strict=True):
            recorder.log(samples)
            one, other = samples
            differences.append(other.positions[0, 2] - one.positions[0, 2])
    chunks = RrdReader(path).stream().filter(content="/difference/heave/patches/cube")
    found = []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            found += np.ravel(batch.column("Scalars:scalars").to_pylist()).tolist()
    np.testing.assert_array_equal(found, differences)
    assert np.abs(differences).max() > 0.0
