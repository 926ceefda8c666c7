"""Errors, timings and means of the reports, tested on known cases."""

import json

import numpy as np
import pytest
import trimesh

from benchmarks.accuracy import errors, time_in_turns, wrenches
from benchmarks.customary import Customary
from benchmarks.seas import SEAS, waterline_poses
from benchmarks.ship import SIZE, finer, ship, ship_costs
from independent import GRAVITY, MODELS, ROUND_OFF, load_mesh, status_of, three_waves
from sim import Chord, Hull, Linear, Reference, Sea
from sim.runs.statistics import mean_of_correlated
from sim.water.spectrum import bretschneider

CUBE = Hull.from_trimesh(trimesh.creation.box(extents=(1.0, 1.0, 1.0)))
SCRIPT = "benchmarks/speed_vs_error.py"

INTERPOLATION = 1e-5
"""Relative error of linear interpolation in the table of a spectrum."""


def test_seas_have_the_steepness_of_the_reports():
    steepness = {name: sea.steepness for name, sea in SEAS.items()}
    assert steepness["three"] == pytest.approx(0.43)
    assert steepness["forty"] == pytest.approx(0.72)
    assert [len(SEAS[name].waves) for name in ("swell", "three", "forty")] == [1, 3, 40]


def test_the_forty_waves_are_a_wind_sea():
    """Their energies are the spectrum's at their frequencies, and their headings' sines uniform."""
    waves = SEAS["forty"].waves
    lengths, amplitudes = np.array([(w.wavelength, w.amplitude) for w in waves]).T
    frequencies = np.sqrt(2.0 * np.pi * GRAVITY / lengths)
    peak = np.sqrt(2.0 * np.pi * GRAVITY / 4.0)
    np.testing.assert_allclose(frequencies / peak, np.linspace(0.7, 3.0, 40), atol=0.021)
    spectrum = bretschneider(1.0, 2.0 * np.pi / peak)
    density = np.interp(frequencies, spectrum.frequencies, spectrum.density)
    share = amplitudes**2 / (amplitudes**2).sum()
    np.testing.assert_allclose(share, density / density.sum(), rtol=INTERPOLATION)
    cosines = np.cos([w.heading for w in waves])
    assert cosines.min() >= 0.0
    assert abs(cosines.mean() - np.pi / 4.0) < 0.1  # twice the scatter of 40 samples


@pytest.mark.parametrize("sea", SEAS)
def test_poses_are_at_the_waterline_and_repeat(sea):
    sea = SEAS[sea]
    poses = waterline_poses(CUBE, sea, 20, seed=5)
    repeated = waterline_poses(CUBE, sea, 20, 5)
    for (position, rotation, time), again in zip(poses, repeated, strict=True):
        np.testing.assert_array_equal(np.append(position, rotation), np.append(*again[:2]))
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=ROUND_OFF)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        heights = CUBE.vertices @ rotation[2] + position[2]
        elevation = sea.elevation(position[0], position[1], time)
        assert heights.min() < elevation < heights.max()


def test_errors_of_linear_on_flat_water_are_round_off():
    sea = Sea()
    linear = Linear(CUBE, sea)
    poses = waterline_poses(CUBE, sea, 10)
    found = errors(wrenches(linear, poses), wrenches(Reference(CUBE, sea), poses), linear)
    assert max(found.force_max, found.torque_max, abs(found.bias)) < ROUND_OFF


def test_errors_of_known_wrenches():
    """A hull 2 m long with errors set by hand, in units of density * gravity * volume."""
    hull = Hull.from_trimesh(trimesh.creation.box(extents=(2.0, 1.0, 0.5)))
    linear = Linear(hull, Sea())
    truth = np.zeros((2, 6))
    found = np.array([[3.0, 4.0, 12.0, 0.0, 0.0, 2.0], [0.0, 0.0, -6.0, 0.0, 0.0, 0.0]])
    e = errors(found * linear.sea.density * linear.sea.gravity * hull.volume, truth, linear)
    assert (e.force_max, e.horizontal_max, e.vertical_max) == pytest.approx((13.0, 5.0, 12.0))
    assert e.force_rms == pytest.approx(np.sqrt((13.0**2 + 6.0**2) / 2))
    assert (e.torque_max, e.torque_rms) == pytest.approx((1.0, np.sqrt(0.5)))
    assert (e.bias, e.bias_error) == pytest.approx((3.0, 9.0))


def test_every_round_times_every_method_at_every_pose():
    poses = waterline_poses(CUBE, SEAS["three"].hydrostatic, 3)
    methods = [Linear(CUBE, SEAS["three"].hydrostatic), Chord(CUBE, SEAS["three"].hydrostatic)]
    seconds = time_in_turns(methods, poses, seconds=1e-9)
    assert seconds.shape == (3, 2, 3)
    assert (seconds > 0.0).all()


def test_customary_elevation_converges_to_ours_with_newtons_order():
    """Each step squares the error, so its logarithm doubles until round-off."""
    sea = three_waves(0.5)
    hull = Hull.from_trimesh(load_mesh("bunny_coarse"))
    poses = waterline_poses(hull, sea, 5)
    truth = wrenches(Linear(hull, sea), poses)
    size = [
        errors(wrenches(Customary(hull, sea, n), poses), truth, Linear(hull, sea)).force_rms
        for n in range(1, 5)
    ]
    orders = np.log(size[1:3]) / np.log(size[:2])
    assert ((orders > 1.6) & (orders < 2.6)).all(), orders
    assert size[3] < ROUND_OFF


def test_single_precision_costs_its_round_off():
    sea = three_waves(0.5)
    hull = Hull.from_trimesh(load_mesh("bunny_coarse"))
    poses = waterline_poses(hull, sea, 5)
    rounded = Customary(hull, sea, 8, np.float32)
    found = errors(wrenches(rounded, poses), wrenches(Linear(hull, sea), poses), rounded)
    epsilon = np.finfo(np.float32).eps
    phase_turns = 100.0  # phases of some 20 turns lose as many units of the last place
    assert 0.1 * epsilon < found.force_max < phase_turns * epsilon


def autoregressive(memory: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """x[i] = memory x[i-1] + noise. The variance of the mean is 1 / (1 - memory)^2 / count."""
    noise = rng.normal(size=count)
    series = np.empty(count)
    series[0] = noise[0] / np.sqrt(1.0 - memory**2)
    for i in range(1, count):
        series[i] = memory * series[i - 1] + noise[i]
    return series


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.97])
def test_error_of_a_mean_matches_a_known_process(memory):
    rng = np.random.default_rng(6)
    count = 8000
    means = [mean_of_correlated(autoregressive(memory, count, rng)) for _ in range(60)]
    expected = 1.0 / (1.0 - memory) / np.sqrt(count)
    size = np.sqrt(np.mean([m.error**2 for m in means]))
    sampling_error = 0.15  # of 60 errors, each from about 30 batches
    assert size == pytest.approx(expected, rel=sampling_error)
    deviations = np.abs([m.value for m in means]) / [m.error for m in means]
    assert (deviations < 3.0).mean() > 0.93
    assert np.mean([m.settled for m in means]) > 0.8
    assert np.median([m.batch for m in means]) >= 1.0 / (1.0 - memory)


def test_a_drifting_mean_is_not_settled():
    assert not mean_of_correlated(np.linspace(0.0, 1.0, 1000)).settled


def test_the_fewest_samples_are_as_many_batches():
    series = np.random.default_rng(1).normal(size=16)
    mean = mean_of_correlated(series)
    assert (mean.batches, mean.batch) == (16, 1)
    assert mean.error == pytest.approx(series.std(ddof=1) / 4.0)


def test_a_mean_of_too_few_samples_is_refused():
    with pytest.raises(ValueError, match="15 samples"):
        mean_of_correlated(np.zeros(15))


def test_speed_vs_error_prints_and_writes_its_table(tmp_path, capsys):
    status = status_of(
        SCRIPT, "--hulls", "cube", "bunny_coarse", "--seas", "three", "--poses", 4,
        "--seconds", 0.01, "--methods", "linear", "chord:2", "reference:1e-4",
        "--json", tmp_path / "out.json",
    )  # fmt: skip
    stdout, stderr = capsys.readouterr()
    assert (status, stderr) == (0, "")  # no progress bar without a terminal
    report = json.loads((tmp_path / "out.json").read_text())
    assert (report["poses"], report["seed"]) == (4, 0)
    assert [(r["hull"], r["method"]) for r in report["rows"]] == [
        (hull, method)
        for hull in ("cube", "bunny_coarse")
        for method in ("linear", "chord:2", "reference:1e-4")
    ]
    for row in report["rows"]:
        assert row["us_min"] <= row["us_median"]
        assert row["force_rms"] <= row["force_max"]
        assert f"{row['force_max']:.1e}" in stdout
    assert "bunny_coarse, 250 faces, in three: 3 waves" in stdout
    linear, _, reference = report["rows"][:3]
    assert linear["speed_up"] == 1.0
    assert reference["force_max"] < 1e-4 < linear["force_max"]


def test_speed_vs_error_reports_that_matplotlib_is_missing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert status_of(SCRIPT, "--figure", "out.png") == 2
    stderr = capsys.readouterr().err
    assert "pip install '.[report]'" in stderr
    assert stderr.count("\n") == 1
    assert not (tmp_path / "out.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "linear", "guess"], "'guess' is not a method"),
        (["--hulls", "teapot"], "invalid choice: 'teapot'"),
        (["--poses", "1"], "1 is not a whole number from 2"),
        (["--quick", "--json", MODELS / "cube.xml" / "out.json"], "cannot be written because of"),
    ],
)
def test_unusable_input_gives_one_line_and_status_2(
    arguments, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert status_of(SCRIPT, *arguments) == 2
    stdout, stderr = capsys.readouterr()
    assert stdout == ""
    assert message in stderr
    assert stderr.count("\n") == 1


def test_default_tolerance_holds_for_a_ship_in_many_waves(monkeypatch):
    monkeypatch.setattr("benchmarks.ship.POSE_COUNT", 3)
    monkeypatch.setattr("benchmarks.ship.TRUTH_SUBDIVISIONS", 1)
    mesh = load_mesh("wigley")
    hull = ship(mesh)
    np.testing.assert_allclose(np.ptp(hull.bounds, axis=0), SIZE, rtol=1e-12)
    assert hull.volume == pytest.approx(finer(hull).volume, rel=1e-12)
    (row,) = ship_costs(hull, (60,), (2.4,), seconds=0.0)
    assert row["waves"] == 60
    assert 1e-6 < row["force_max"] < 1e-3
