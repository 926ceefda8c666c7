"""The validation suite holds, and its checks can fail."""

import json

import make_scenes
import numpy as np
import pytest

from benchmarks import validate, validation
from sim import Hull


def test_all_rows_hold_except_known_ones(tmp_path, capsys):
    table, numbers = tmp_path / "table.md", tmp_path / "rows.json"
    given = ["--quick", "--markdown", str(table), "--json", str(numbers)]
    assert validate.main(given) == 0
    rows = json.loads(numbers.read_text())
    assert {row["group"] for row in rows} == {
        "hydrostatics", "linear Froude-Krylov", "terminal speed", "heave decay",
        "response in head waves", "response of wide bodies",
    }  # fmt: skip
    failed = [row["what"] for row in rows if row["verdict"] != "holds"]
    assert all("let go" in name for name in failed), failed  # radiated waves have no memory
    assert len(failed) <= 2
    printed = capsys.readouterr().out
    assert "response in head waves" in printed
    assert table.read_text().count("| holds |") == len(rows) - len(failed)


def test_a_value_outside_its_band_is_reported():
    check = validation.Check("", "", "m", "closed form", 1.0, 2.0, lambda: 2.5)
    assert check.verdict(1.5) == "holds"
    assert check.verdict(2.5) == "off by +25.0 %"


@pytest.mark.parametrize("ratio", [2.0, 1.2, 0.9])
def test_responses_of_the_wigley_hull_match_a_panel_code(ratio):
    """The wavelengths that the quick suite omits, within 5 % with one added mass and damping."""
    found = validation.wigley_response(Hull(*make_scenes.wigley()), ratio)
    np.testing.assert_allclose(found, validation.WIGLEY_RESPONSES[ratio], rtol=0.05)
