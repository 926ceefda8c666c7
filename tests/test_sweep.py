"""Sweeps and series: many runs of a scene, their saved rows, and tables of samples."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from scenes import CUBE, WAVES, model, xml

from command_line import UNWRITABLE
from independent import MODELS, REPOSITORY, receive_ctrl_c, sending, status_of
from sim import Scene, Sea, Tally, simulate
from sim.runs.locked import LockedFile
from sim.runs.series import COLUMNS, Series
from sim.runs.statistics import heights, start_times
from sim.runs.sweep import Plan, Run, kept_rows, perform, runs_of
from sim.runs.tables import read_columns, write_columns

SWEEP = [sys.executable, str(REPOSITORY / "scripts" / "sweep.py")]
SHORT = ("--duration", "4", "--warm-up", "1")
ROW = {"run": 0, "start": 0.0, "status": "held", "seconds": 1.0, "stepping_seconds": 0.5}
"""The row of the first run, without statistics."""
RUNS = (str(MODELS / "cube.xml"), "--starts", "12", "--duration", "6", "--warm-up", "1")


def test_wave_heights_of_a_sine_are_twice_its_amplitude():
    times = np.linspace(0.0, 50.0, 5001)
    found = heights(times, 3.0 + 0.5 * np.sin(2.0 * np.pi * times / 2.5))
    assert found.significant == pytest.approx(1.0, abs=1e-3)
    assert found.largest == pytest.approx(1.0, abs=1e-3)
    assert found.period == pytest.approx(2.5, abs=1e-3)
    growing = heights(times, times * np.sin(2.0 * np.pi * times / 2.5))
    assert growing.largest > growing.significant > 0.6 * growing.largest
    assert np.isnan(heights(times, np.ones_like(times)).largest)


def test_the_significant_height_of_a_gaussian_sea_is_four_standard_deviations():
    times = np.arange(0.0, 5_000.0, 0.25)
    values = Sea.jonswap(1.0, 8.0, spread=0.0, waves=100).elevation(0.0, 0.0, times)
    found = heights(times, values)
    assert found.significant == pytest.approx(4.0 * values.std(), rel=0.06)


def test_runs_are_all_combinations():
    runs = runs_of(["a=1,2", "b=3 4, 5 6"], seeds=2, starts=3)
    assert len(runs) == 24
    assert len({(run.settings, run.start) for run in runs}) == 24
    assert runs[0].settings == (("a", "1"), ("b", "3 4"), ("seed", "0"))
    assert [run.number for run in runs] == list(range(24))
    assert [run.start for run in runs[:3]] == start_times(3)
    for wrong in ("a", "=1", "a=1,,2"):
        with pytest.raises(ValueError, match="expected NAME=VALUE,VALUE"):
            runs_of([wrong], 0, 1)


def test_the_row_of_a_run_matches_its_samples():
    plan = Plan(MODELS / "cube.xml", 6.0, 2.0, 10.0)
    row = perform(plan, Run(0, (("wave_swell.amplitude", "0.05"),), 3.0))
    scene = Scene.load(MODELS / "cube.xml", settings=["wave_swell.amplitude=0.05"])
    scene.data.time = 3.0
    samples = [s for s in simulate(scene, 6.0, 10.0) if s.time >= 5.0]
    assert row["status"] == "held"
    assert row["cube heave std"] == pytest.approx(np.std([s.positions[0, 2] for s in samples]))
    tilts = np.degrees([s.tilts[0] for s in samples])
    assert row["cube tilt_deg mean"] == pytest.approx(np.mean(tilts))


def test_a_sweep_takes_the_options_of_a_scene(tmp_path):
    """A dry file with two keyframes; resuming compares the options."""
    cube = CUBE.replace("<body", "<body gravcomp='0'")
    keys = '<keyframe><key name="low"/><key name="high" qpos="0 0 0.3 1 0 0 0"/></keyframe>'
    (tmp_path / "dry.xml").write_text(xml(cube, (), extra=keys))
    options = ("--buoyant", "cube", "--density", "cube=300", "--timestep", "0.01")
    output = tmp_path / "a.csv"
    arguments = (*options, "--keyframe", "high", "--output", output, "--quiet", *SHORT)
    assert status_of("sweep.py", tmp_path / "dry.xml", *arguments) == 0
    found = read_columns(output)
    load = dict(buoyant=("cube",), densities={"cube": 300.0}, timestep=0.01, keyframe="high")
    scene = Scene.load(tmp_path / "dry.xml", **load)
    tally = Tally(scene, warm_up=1.0)
    for sample in simulate(scene, 4.0, 10.0):
        tally.add(sample)
    heave = tally.bodies()["cube"]["heave_m"]
    assert found["cube heave mean"][0] == pytest.approx(heave["mean"])
    assert found["cube heave std"][0] == pytest.approx(heave["std"])
    plan = Plan(tmp_path / "dry.xml", 4.0, 1.0, 10.0, ("cube",), (("cube", 300.0),))
    assert json.loads(json.dumps(plan.as_row())) == plan.as_row()


def test_runs_in_threads_match_runs_in_one():
    """The runs share a compiled scene, and each has its own state."""
    plan = Plan(MODELS / "cube.xml", 4.0, 1.0, 10.0)
    runs = runs_of([], 0, 6)
    alone = [perform(plan, run) for run in runs]
    with ThreadPoolExecutor(3) as threads:
        together = list(threads.map(lambda run: perform(plan, run), runs))
    timed = ("seconds", "stepping_seconds")
    for one, other in zip(alone, together, strict=True):
        assert {k: v for k, v in one.items() if k not in timed} == {
            k: v for k, v in other.items() if k not in timed
        }


def test_failed_runs_have_rows(tmp_path):
    """One run diverges because its timestep is too long, and the waves of the other fold."""
    light = """<body name="ball" pos="0 0 0.05"><freejoint/>
      <geom name="ball" type="sphere" size="0.1" density="0.5"/></body>"""
    wave = '<numeric name="wave_swell" data="0.1 4 0 0"/>'
    option = '<option timestep="0.02"/>'
    (tmp_path / "s.xml").write_text(xml(light, ("ball",), wave, option))
    output = tmp_path / "a.csv"
    arguments = ("--set", "wave_swell.amplitude=0.01,3", "--output", output, "--quiet")
    duration = ("--duration", "60", "--warm-up", "1")
    assert status_of("sweep.py", tmp_path / "s.xml", *arguments, *duration) == 0
    found = read_columns(output)
    assert found["status"][0].startswith("diverged: body 'ball' diverged at ")
    assert found["status"][1].startswith("refused: ")
    assert "the waves fold" in found["status"][1]


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_tables_are_read_as_they_were_written(ending, tmp_path):
    columns = {"time": np.array([0.0, 0.1, np.nan]), "body": np.array(["a", "b ö", "c,d"])}
    path = tmp_path / f"t.{ending}"
    write_columns(path, columns)
    found = read_columns(path)
    assert list(found) == list(columns)
    np.testing.assert_array_equal(found["time"], columns["time"])
    assert found["body"].tolist() == columns["body"].tolist()


def has_two_rows(kept: Path) -> bool:
    """Whether a sweep has saved two rows after its plan."""
    return kept.exists() and kept.read_text().count("\n") >= 3


def wait_for_rows(process: subprocess.Popen, kept: Path) -> None:
    deadline = time.monotonic() + 120.0
    while not has_two_rows(kept):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.02)


def check_interrupted(kept: Path, stderr: str) -> None:
    """Check that Ctrl-C has stopped a sweep of RUNS after some of them."""
    rows = kept.read_text().count("\n") - 1
    assert 2 <= rows < 12
    lines = [line for line in stderr.splitlines() if line.startswith("sweep.py: ")]
    *notes, stopped, resume = lines  # joblib may print others
    assert stopped == "sweep.py: stopped by SIGINT"
    assert resume == f"sweep.py: {rows} of 12 runs are saved; --resume does the others"
    assert all(note.startswith("sweep.py: note: ") for note in notes)


def test_an_interrupted_sweep_keeps_its_rows_and_resumes(tmp_path, capsys):
    output, kept = tmp_path / "a.parquet", tmp_path / "a.parquet.rows"
    with sending(signal.SIGINT, lambda: has_two_rows(kept)):
        assert status_of("sweep.py", *RUNS, "--output", output) == 130
    check_interrupted(kept, capsys.readouterr().err)
    with kept.open("a") as file:
        file.write('{"run": 11, "sta')  # an incomplete row, as after a kill
    command = [*RUNS, "--quiet", "--output", output]
    assert status_of("sweep.py", *command) == 2  # it does not overwrite the rows
    assert status_of("sweep.py", *command, "--resume") == 0
    found = read_columns(tmp_path / "a.parquet")
    assert found["run"].tolist() == list(range(12))
    assert set(found["status"]) == {"held"}
    assert sorted(os.listdir(tmp_path)) == ["a.parquet"]


def test_ctrl_c_stops_all_processes(tmp_path):
    process = subprocess.Popen(
        [*SWEEP, *RUNS, "--output", "a.csv", "--jobs", "2"], cwd=tmp_path, stderr=subprocess.PIPE,
        text=True, preexec_fn=receive_ctrl_c, start_new_session=True,
    )  # fmt: skip
    wait_for_rows(process, tmp_path / "a.csv.rows")
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to the workers too
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    check_interrupted(tmp_path / "a.csv.rows", stderr)


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs Linux's /proc")
def test_a_killed_worker_is_reported_and_finished_rows_are_kept(tmp_path):
    command = [*SWEEP, *RUNS, "--jobs", "2", "--output", "a.csv", "--quiet"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    wait_for_rows(process, tmp_path / "a.csv.rows")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    workers = [c for c in children if b"popen_loky" in Path(f"/proc/{c}/cmdline").read_bytes()]
    os.kill(int(workers[0]), signal.SIGKILL)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 4
    assert stderr.startswith("sweep.py: a process was killed")  # joblib may print more after it
    assert "of 12 runs are saved; --resume does the others" in stderr
    assert "Traceback" not in stderr
    assert (tmp_path / "a.csv.rows").exists()


def test_an_incomplete_row_is_removed_before_more_follow():
    """Otherwise the next row would continue its line, and a later --resume could read neither."""
    plan = Plan(MODELS / "cube.xml", 4.0, 1.0, 10.0)
    complete = f"{json.dumps(plan.as_row())}\n{json.dumps(ROW)}\n".encode()
    rows, size = kept_rows(complete + b'{"run": 1, "sta', plan, runs_of([], 0, 1))
    assert rows == [ROW]
    assert size == len(complete)


def test_the_summary_omits_settings_and_columns_without_numbers(tmp_path, capsys):
    """A run too short for two upcrossings has no period, and gives no warning."""
    arguments = ("--output", tmp_path / "a.csv", "--duration", "1", "--warm-up", "0.5")
    sea = ("--set", "sea_bretschneider=0.1 2", "--set", "sea_bretschneider.peak_period=3")
    assert status_of("sweep.py", MODELS / "cube.xml", *arguments, *sea) == 0
    printed = capsys.readouterr().out
    assert "nan" not in printed
    assert "peak_period" not in printed
    assert "cube heave std" in printed


@pytest.mark.parametrize(
    ("others", "message"),
    [
        (("--set", "wave_swell.amplitude=0.2"), "rows of another sweep; remove"),
        (("--duration", "5"), "rows of a sweep with another duration"),
    ],
    ids=lambda v: v[0] if isinstance(v, tuple) else "",
)
def test_rows_of_another_sweep_are_not_resumed(others, message, tmp_path, capsys):
    kept = tmp_path / "a.csv.rows"
    options = ("--set", "wave_swell.amplitude=0.1", "--output", tmp_path / "a.csv", *SHORT)
    rows = [Plan(MODELS / "cube.xml", 4.0, 1.0, 10.0).as_row()]
    rows += [ROW | {"wave_swell.amplitude": "0.1"}]
    kept.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert status_of("sweep.py", MODELS / "cube.xml", *options, *others, "--resume") == 2
    assert message in capsys.readouterr().err
    assert status_of("sweep.py", MODELS / "cube.xml", *options, "--resume", "--quiet") == 0
    assert read_columns(tmp_path / "a.csv")["status"].tolist() == ["held"]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([ROW, ROW], "its line 3 is a second row of run 0"),
        ([[0, 1]], "its line 2 is not the row of a run"),
        (["text"], "its line 2 is not the row of a run"),
        ([{"start": 0.0}], "rows of another sweep"),
        ([ROW | {"run": -1}], "rows of another sweep"),
        ([{name: ROW[name] for name in ("run", "start", "status")}], "its line 2 is not the row"),
        ([ROW | {"cube heave std": "high"}], "its line 2 is not the row of a run"),
        ([ROW | {"cube heave std": [1.0]}], "its line 2 is not the row of a run"),
    ],
)
def test_rows_of_another_shape_are_refused(lines, message):
    plan = Plan(MODELS / "cube.xml", 4.0, 1.0, 10.0)
    text = "".join(json.dumps(line) + "\n" for line in [plan.as_row(), *lines])
    with pytest.raises(ValueError, match=message):
        kept_rows(text.encode(), plan, runs_of([], 0, 1))


def test_a_second_sweep_into_one_table_is_refused(tmp_path, capsys):
    arguments = (MODELS / "cube.xml", "--output", tmp_path / "a.csv", *SHORT)
    with LockedFile(tmp_path / "a.csv.rows"):
        for more in ((), ("--resume",)):
            assert status_of("sweep.py", *arguments, *more) == UNWRITABLE
            assert "a.csv.rows is being written by another run" in capsys.readouterr().err


def test_removed_rows_end_the_sweep(tmp_path, capsys):
    rows = tmp_path / "a.csv.rows"

    def remove() -> None:
        while not (rows.exists() and rows.stat().st_size):
            time.sleep(0.01)
        rows.unlink()

    Thread(target=remove, daemon=True).start()
    assert status_of("sweep.py", *RUNS, "--output", tmp_path / "a.csv") == UNWRITABLE
    *_, removed, saved = capsys.readouterr().err.splitlines()
    assert removed == f"sweep.py: {rows} was removed while it was written; run again"
    assert saved == "sweep.py: 0 of 12 runs are saved; --resume does the others"
    assert list(tmp_path.iterdir()) == []


def test_a_file_on_a_full_disk_keeps_what_it_had_and_is_not_left_empty(tmp_path, monkeypatch):
    path = tmp_path / "new" / "rows"

    def fail(number: int) -> None:
        raise OSError(28, "No space left on device")

    with LockedFile(path) as file, monkeypatch.context() as full:
        full.setattr("os.fsync", fail)
        with pytest.raises(
            OSError, match=r"rows cannot be written \(No space left on device\); make"
        ):
            file.append(b"row")
        assert file.size == 0
    assert not path.exists()
    for expected in (b"one\n", b"one\none\n"):
        with LockedFile(path) as file:
            file.append(b"one\n")
            full.setattr("os.fsync", fail)
            with pytest.raises(OSError, match="cannot be written"):
                file.append(b"another\n")
            full.undo()
        assert path.read_bytes() == expected


def test_a_sweep_of_an_edited_scene_is_another_sweep(tmp_path):
    path = tmp_path / "s.xml"
    path.write_text(xml(CUBE))
    before = Plan(path, 4.0, 1.0, 10.0).as_row()
    path.write_text(xml(CUBE, custom=WAVES))
    after = Plan(path, 4.0, 1.0, 10.0).as_row()
    assert before.pop("scene") != after.pop("scene")
    assert before == after


def test_a_cluster_gives_the_same_rows(tmp_path):
    """A dask scheduler and a worker process on this machine."""
    distributed = pytest.importorskip("distributed")
    arguments = [str(MODELS / "cube.xml"), "--starts", "2", "--quiet", *SHORT]
    local, remote = tmp_path / "local.csv", tmp_path / "remote.csv"
    assert status_of("sweep.py", *arguments, "--output", local) == 0
    with distributed.LocalCluster(n_workers=1, dashboard_address=None) as cluster:
        options = ("--output", remote, "--dask", cluster.scheduler_address)
        assert status_of("sweep.py", *arguments, *options) == 0
    expected, found = read_columns(local), read_columns(remote)
    for name in expected:
        if "seconds" not in name:
            np.testing.assert_array_equal(found[name], expected[name])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--output", "a.txt"), "expected a name that ends in .csv, .parquet, .npz"),
        (("--output", "a.csv", "--set", "wave_swell.amplitude"), "expected NAME=VALUE,VALUE"),
        (("--output", "a.csv", "--set", "wave_swel.amplitude=1"), "no numeric 'wave_swel'"),
        (("--output", "a.csv", "--seeds", "2"), "the scene has no irregular sea"),
        (("--output", "a.csv", "--duration", "5", "--warm-up", "9"), "has nothing left"),
    ],
)
def test_unusable_input_gives_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert status_of("sweep.py", MODELS / "cube.xml", *arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert os.listdir(tmp_path) == []


def test_a_missing_scheduler_is_reported(tmp_path, monkeypatch, capsys):
    distributed = pytest.importorskip("dask.distributed")
    client = distributed.Client
    impatient = lambda address, timeout: client(address, timeout="0.1s")  # noqa: E731
    monkeypatch.setattr(distributed, "Client", impatient)
    arguments = ("--output", tmp_path / "a.csv", "--dask", "tcp://127.0.0.1:9")
    assert status_of("sweep.py", MODELS / "cube.xml", *arguments) == 2
    assert "there is no dask scheduler at tcp://127.0.0.1:9" in capsys.readouterr().err


def test_series_match_the_samples(tmp_path):
    path = tmp_path / "s.npz"
    command = (MODELS / "trio.xml", "--no-record", "--duration", "2", "--rate", "20", "--quiet")
    assert status_of("run.py", *command, "--series", path) == 0
    found = read_columns(path)
    assert list(found) == ["time", "body", *COLUMNS]
    scene = Scene.load(MODELS / "trio.xml")
    series = Series(scene)
    for sample in simulate(scene, 2.0, 20.0):
        series.add(sample)
    names = scene.buoyancy.body_names
    last = {name: column[-len(names) :] for name, column in found.items()}
    assert tuple(last["body"]) == names
    np.testing.assert_allclose(np.stack([last[a] for a in "xyz"], 1), sample.positions)
    np.testing.assert_allclose(last["tilt_deg"], np.degrees(sample.tilts))
    np.testing.assert_allclose(last["fz"], sample.body_wrenches[:, 2])
    np.testing.assert_allclose(last["water_height"], sample.elevations)
    chosen = found["body"] == names[0]
    slope = np.gradient(found["z"][chosen], found["time"][chosen])
    finite_differences = 0.2  # m/s
    np.testing.assert_allclose(found["vz"][chosen][5:-5], slope[5:-5], atol=finite_differences)


def test_heave_heel_and_trim_follow_naval_convention():
    """Heave is relative to the rest of a box, whose draught is half its height."""
    body = """<body name="b" pos="0 0 0.3" euler="0 10 0"><freejoint/>
      <geom name="b" type="box" size="2 1 0.25" density="512.5"/></body>"""
    scene = Scene.from_model(model(body, ("b",)))
    series = Series(scene)
    series.add(next(simulate(scene, 0.1)))
    found = series.columns()
    assert found["heave"][0] == pytest.approx(0.3, abs=1e-6)
    assert found["trim_deg"][0] == pytest.approx(10.0)  # bow down
    assert found["heel_deg"][0] == pytest.approx(0.0, abs=1e-9)
