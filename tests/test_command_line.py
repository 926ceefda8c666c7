"""What all scripts do with signals and with readers that go away."""

from command_line import print_table, progress, run_script, stop_signals

import os
import signal
import subprocess
import sys

import pytest

from independent import REPOSITORY, hear_ctrl_c


def test_signals_are_noted_and_the_handlers_restored():
    before = [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)]
    with stop_signals() as received:
        assert received == []
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)  # at once: no insisting yet
    assert received == [signal.SIGTERM, signal.SIGINT]
    assert [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)] == before


def test_who_insists_ends_the_process_at_once(monkeypatch, capfd):
    def leave(status: int) -> None:
        raise SystemExit(status)

    monkeypatch.setattr("os._exit", leave)
    with pytest.raises(SystemExit) as left, stop_signals(same=-1.0):
        os.kill(os.getpid(), signal.SIGTERM)
    assert left.value.code == 143
    assert capfd.readouterr().err.endswith(": terminated\n")


def test_an_interrupt_anywhere_else_is_one_line_and_status_130(capsys):
    def main() -> int:
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as left:
        run_script(main)
    assert left.value.code == 130
    stderr = capsys.readouterr().err
    assert stderr.endswith(": interrupted\n")
    assert stderr.count("\n") == 1


def test_a_script_is_interrupted_in_its_imports_without_a_traceback(tmp_path):
    """Python itself answers until command_line is imported, so the interrupt waits for that."""
    (tmp_path / "mujoco.py").write_text(
        "import os, signal; os.kill(os.getpid(), signal.SIGINT); import time; time.sleep(60)"
    )
    result = subprocess.run(
        [sys.executable, str(REPOSITORY / "scripts" / "run.py")],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{REPOSITORY}"},
        capture_output=True, text=True, timeout=60, preexec_fn=hear_ctrl_c,
    )  # fmt: skip
    assert (result.returncode, result.stderr) == (130, "run.py: interrupted\n")


def test_a_reader_that_goes_away_leaves_no_traceback(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    result = subprocess.run(
        [sys.executable, str(REPOSITORY / "scripts" / "make_scenes.py"), "--output", tmp_path],
        stdout=writing, stderr=subprocess.PIPE, text=True, timeout=60,
    )  # fmt: skip
    os.close(writing)
    assert (result.returncode, result.stderr) == (141, "")
    assert (tmp_path / "meshes" / "wigley.obj").is_file()


def test_tables_align_names_left_and_numbers_right(capsys):
    print_table(("body", "height m"), [("cube", "0.10"), ("long name", "-12.345")])
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["body       height m", "cube           0.10", "long name   -12.345"]
    rows = (row for row in [("a", "1"), ("b", "2")])  # printed as they come
    print_table(("", "x"), rows, widths={"": 3, "x": 4})
    assert capsys.readouterr().out.splitlines() == ["        x", "a       1", "b       2"]


def test_progress_is_shown_on_a_terminal_only(monkeypatch, capsys):
    with progress(10.0, "s") as bar:
        bar.update(5.0)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    for quiet, seen in ((False, True), (True, False)):
        with progress(10.0, "s", quiet) as bar:
            bar.update(5.0)
            bar.refresh()
        assert ("of 10 s" in capsys.readouterr().err) == seen
