"""scripts/plot.py and the spectra that it draws."""

import numpy as np
import pytest

from independent import MODELS, status_of
from sim import Sea
from sim.runs.statistics import spectra

SHORT = ("--duration", "6", "--quiet")


def test_a_spectrum_has_the_variance_and_a_linear_answer_its_transfer_function():
    times = np.arange(0.0, 2000.0, 0.2)
    water = Sea.jonswap(1.0, 6.0, spread=0.0, waves=300).elevation(0.0, 0.0, times)
    frequencies, (of_water, of_answer) = spectra(times, water, -0.4 * water + 7.0)
    assert np.trapezoid(of_water, frequencies) == pytest.approx(water.var(), rel=0.05)
    np.testing.assert_allclose(np.sqrt(of_answer[2:] / of_water[2:]), 0.4, rtol=1e-6)
    assert frequencies[of_water.argmax()] == pytest.approx(1.0 / 6.0, rel=0.1)


@pytest.mark.parametrize("kind", ["parquet", "rrd"])
def test_a_picture_is_drawn_of_a_series_and_of_a_recording(kind, tmp_path, capsys):
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


def test_what_is_no_series_is_said_in_one_line(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("time,x\n1,2\n")
    for name, message in (("a.csv", "is not a series of run.py"), ("b.csv", "there is no file")):
        assert status_of("plot.py", tmp_path / name) == 2
        told = capsys.readouterr().err
        assert message in told
        assert told.count("\n") == 1
