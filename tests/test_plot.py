"""scripts/plot.py and its spectra."""

import numpy as np
import pytest

from independent import MODELS, status_of
from sim import Sea
from sim.runs.statistics import spectra

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


def test_other_files_are_refused_in_one_line(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("time,x\n1,2\n")
    for name, message in (("a.csv", "is not a series of run.py"), ("b.csv", "there is no file")):
        assert status_of("plot.py", tmp_path / name) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
