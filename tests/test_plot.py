"""scripts/plot.py and its spectra."""

import numpy as np
import pytest

from independent import MODELS, status_of
from sim import Sea
from sim.runs.statistics import spectra
from sim.runs.tables import write_columns

SHORT = ("--duration", "6", "--quiet")


def test_spectra_have_the_variance_and_the_transfer_function():
    times = np.arange(0.0, 2000.0, 0.5)
    water = Sea.jonswap(1.0, 6.0, spread=0.0, waves=300).elevation(0.0, 0.0, times)
    frequencies, (input_spectrum, output_spectrum) = spectra(times, water, -0.4 * water + 7.0)
    window, resolution = 0.05, 0.1  # relative
    assert np.trapezoid(input_spectrum, frequencies) == pytest.approx(water.var(), rel=window)
    ratios = output_spectrum[2:] / input_spectrum[2:]
    np.testing.assert_allclose(np.sqrt(ratios), 0.4, rtol=1e-6)
    assert frequencies[input_spectrum.argmax()] == pytest.approx(1.0 / 6.0, rel=resolution)


@pytest.mark.parametrize("kind", ["parquet", "rrd"])
def test_series_and_recordings_are_plotted(kind, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    path = tmp_path / f"trio.{kind}"
    option = "--record" if kind == "rrd" else "--series"
    record = () if kind == "rrd" else ("--no-record",)
    assert status_of("run.py", MODELS / "trio.xml", *SHORT, option, path, *record) == 0
    assert status_of("plot.py", path) == 0
    picture = path.with_suffix(".png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 20_000
    assert capsys.readouterr().out.endswith("trio.png\n")


def made_series(path, times, heave) -> None:
    """A series of one body, like those of run.py."""
    columns = {name: np.zeros(len(times)) for name in ("tilt_deg", "fz", "water_height")}
    body = np.array(["boat"] * len(times))
    write_columns(path, {"time": times, "body": body, "heave": heave, **columns})


def labels_of(monkeypatch) -> list[str]:
    """The labels of all lines that are drawn from now on."""
    axes = pytest.importorskip("matplotlib.axes").Axes
    plot, labels = axes.plot, []

    def noted(self, *args, **kwargs):
        labels.append((kwargs.get("label"), np.array(args[1])))
        return plot(self, *args, **kwargs)

    monkeypatch.setattr(axes, "plot", noted)
    return labels


def test_files_and_measurements_are_compared_at_common_times(tmp_path, monkeypatch, capsys):
    """Straight lines are interpolated without error, so the differences are known."""
    long, short = np.linspace(0.0, 10.0, 101), np.linspace(5.03, 12.03, 36)
    made_series(tmp_path / "a.csv", long, 0.1 * long)
    made_series(tmp_path / "b.csv", short, 0.1 * short + 0.5)
    measured = "\n".join(f"{t},{0.1 * t - 0.25}" for t in (1, 2, 6, 7, 99))
    (tmp_path / "m.csv").write_text(f"Time [s],heave (m)\n{measured}\n")
    lines = labels_of(monkeypatch)
    assert status_of("plot.py", tmp_path / "a.csv", tmp_path / "b.csv") == 0
    ((label, values),) = [line for line in lines if line[0].startswith("b minus a: rms 0.5")]
    np.testing.assert_allclose(values, 0.5)
    assert len(values) == 25  # of b, until the end of a
    lines.clear()
    files = (tmp_path / "a.csv", "--over", tmp_path / "m.csv", "--output", tmp_path / "c.png")
    assert status_of("plot.py", *files) == 0
    ((label, values),) = [line for line in lines if "minus" in line[0]]
    assert label == "boat minus measured: rms 0.25"
    np.testing.assert_allclose(values, 0.25 * np.ones(4))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,roll\n0,1\n1,2\n", "begins with 'time,roll'; expected a header with names from"),
        ("heave\n1\n2\n", "expected a column time that rises"),
        ("time,heave\n1,1\n1,2\n", "expected a column time that rises"),
        ("time,heave\n1,1\n2,high\n", "line 3: expected 2 finite numbers"),
        ("time,x\n1,1\n2,2\n", "has the column x, which not all runs have"),
        ("time,heave\n70,1\n71,2\n", "lasts from 70 to 71 s and 'boat' from 0 to 9 s"),
    ],
)
def test_other_measurements_are_refused_in_one_line(text, message, tmp_path, capsys):
    if message.startswith("lasts"):  # found when the figure is made
        pytest.importorskip("matplotlib")
    made_series(tmp_path / "a.csv", np.arange(10.0), np.zeros(10))
    (tmp_path / "m.csv").write_text(text)
    assert status_of("plot.py", tmp_path / "a.csv", "--over", tmp_path / "m.csv") == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "a.png").exists()


def test_other_files_are_refused_in_one_line(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("time,x\n1,2\n")
    for name, message in (("a.csv", "is not a series of run.py"), ("b.csv", "there is no file")):
        assert status_of("plot.py", tmp_path / name) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
