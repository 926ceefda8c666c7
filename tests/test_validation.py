"""The validation suite holds, and its checks can fail."""

import json

import make_scenes
import numpy as np
import pytest

from benchmarks import checks, validate, validation
from sim import Hull


def test_all_rows_hold_except_known_ones(tmp_path, capsys):
    table, numbers = tmp_path / "table.md", tmp_path / "rows.json"
    given = ["--quick", "--markdown", str(table), "--json", str(numbers)]
    assert validate.main(given) == 0
    rows = json.loads(numbers.read_text())
    assert {row["group"] for row in rows} == {
        "hydrostatics", "linear Froude-Krylov", "terminal speed", "resistance",
        "free decay with memory", "response in head waves", "response of wide bodies",
    }  # fmt: skip
    failed = [row["what"] for row in rows if row["verdict"] != "holds"]
    assert len(failed) == 2
    assert all("memory alone" in name for name in failed), failed  # the sphere scatters the waves
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert last.startswith(f"{len(rows) - 2} of {len(rows)} rows hold. The furthest off is")
    assert table.read_text().strip().splitlines()[-1] == last
    assert table.read_text().count("| holds |") == len(rows) - 2


def made(what: str, found: float, known_gap: str = "") -> checks.Check:
    return checks.Check("heave", what, "m", "closed form", 1.0, 2.0, lambda: found, known_gap)


@pytest.mark.parametrize(("low", "high"), [(1.0, 2.0), (-2.0, -1.0)])
def test_a_miss_is_a_share_of_the_nearer_bound(low, high):
    check = checks.Check("", "", "m", "closed form", low, high, float)
    far, near = (high, low) if low > 0.0 else (low, high)
    assert check.miss(low) == check.miss(high) == 0.0
    assert check.verdict(0.5 * (low + high)) == "holds"
    assert check.miss(1.25 * far) == pytest.approx(0.25)
    assert check.miss(0.9 * near) == pytest.approx(-0.1)
    assert check.verdict(1.25 * far) == "off by +25.0 %"


def test_the_table_ends_with_the_worst_row_and_its_reason(monkeypatch, capsys):
    gaps = [made("near", 2.1, "why not"), made("far", 0.7, "because"), made("good", 1.5)]
    monkeypatch.setattr(validation, "checks", lambda hull, quick: iter(gaps))
    assert validate.main([]) == 0
    assert capsys.readouterr().out.strip().splitlines()[-1] == (
        "1 of 3 rows hold. The furthest off is 'far' (heave): off by -30.0 %: because."
    )
    gaps.append(made("not known", 2.01))
    assert validate.main([]) == 1


@pytest.mark.parametrize("ratio", [2.0, 1.2, 0.9])
def test_responses_of_the_wigley_hull_match_a_panel_code(ratio):
    """The wavelengths that the quick suite omits, within 5 % with one added mass and damping."""
    found = validation.wigley_response(Hull(*make_scenes.wigley()), ratio)
    np.testing.assert_allclose(found, validation.WIGLEY_RESPONSES[ratio], rtol=0.05)
