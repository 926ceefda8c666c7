"""The validation suite holds, and its rows can fail."""

import json

import make_scenes
import numpy as np
import pytest

from benchmarks import validate, validation
from sim import Hull


def test_every_row_holds_or_says_why_not(tmp_path, capsys):
    table, numbers = tmp_path / "table.md", tmp_path / "rows.json"
    given = ["--quick", "--markdown", str(table), "--json", str(numbers)]
    assert validate.main(given) == 0
    rows = json.loads(numbers.read_text())
    assert {row["group"] for row in rows} == {
        "hydrostatics", "linear Froude-Krylov", "terminal speed", "heave decay",
        "response in head waves",
    }  # fmt: skip
    off = [row["what"] for row in rows if row["verdict"] != "holds"]
    assert all("let go" in what for what in off), off  # no memory of radiated waves
    assert len(off) <= 2
    printed = capsys.readouterr().out
    assert "response in head waves" in printed
    assert table.read_text().count("| holds |") == len(rows) - len(off)


def test_a_value_off_its_band_is_said():
    check = validation.Check("", "", "m", "closed form", 1.0, 2.0, lambda: 2.5)
    assert check.verdict(1.5) == "holds"
    assert check.verdict(2.5) == "off by +25.0 %"


@pytest.mark.parametrize("ratio", [2.0, 1.2, 0.9])
def test_the_wigley_hull_answers_waves_as_a_panel_code_says(ratio):
    """Those that the quick suite leaves out, within 5 %, by one pair of added mass and damping."""
    found = validation.wigley_response(Hull(*make_scenes.wigley()), ratio)
    np.testing.assert_allclose(found, validation.WIGLEY_RESPONSES[ratio], rtol=0.05)
