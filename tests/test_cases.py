"""The hard cases that take little time, at the timestep of the shipped scenes.
scripts/benchmarks/hard_cases.py runs all of them with every integrator and timestep."""

import pytest

from benchmarks.cases import CASES, attempts

QUICK = [name for name, case in CASES.items() if case.duration <= 5.0]


@pytest.fixture(autouse=True)
def _quiet_mujoco(tmp_path, monkeypatch):
    """MuJoCo writes its log file to the current folder."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", QUICK)
def test_hard_case_holds_at_2_ms(name):
    outcome = attempts(CASES[name], "implicitfast", [0.002])
    assert outcome.holds_up_to(CASES[name].limit) == 0.002, (outcome, CASES[name].expects)


def test_a_diverging_case_does_not_hold():
    """The tiny cube's period is 0.045 s, so a timestep of 20 ms throws it."""
    case = CASES["mesh in millimetres"]
    outcome = attempts(case, "Euler", [0.0005, 0.02])
    assert outcome.holds_up_to(case.limit) == 0.0005
    assert not outcome.errors[0.02] or outcome.errors[0.02] > case.limit
