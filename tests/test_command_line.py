"""What all scripts share: signals, notes, files, tables, broken pipes."""

import ast
import json
import os
import signal
import subprocess
import sys
import warnings
from argparse import ArgumentTypeError
from contextlib import suppress

import numpy as np
import pytest
from video import size

import command_line
from command_line import (
    UNWRITABLE,
    Progress,
    Stopped,
    at_least,
    check_outputs,
    compile_in_two,
    named_number,
    not_negative,
    notes_said,
    positive,
    print_table,
    run_script,
    stops_held,
    write_json,
    write_whole,
)
from independent import REPOSITORY, status_of
from sim import ModelError, Note


@pytest.fixture
def handlers():
    """The signal handlers that `run_script` replaces; they are restored afterwards."""
    before = {stop: signal.getsignal(stop) for stop in (signal.SIGINT, signal.SIGTERM)}
    yield before
    for stop, handler in before.items():
        signal.signal(stop, handler)


def status_and_line(main, capsys) -> tuple[int, str]:
    """Exit status of a script with this main, and the text that it prints after its name."""
    with pytest.raises(SystemExit) as end:
        run_script(main)
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    return end.value.code, printed.partition(": ")[2].strip()


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "SIGTERM"]
)
def test_a_signal_ends_a_script_with_one_line_and_its_status(number, status, handlers, capsys):
    def main() -> int:
        os.kill(os.getpid(), number)
        return 0

    assert status_and_line(main, capsys) == (status, f"stopped by {number.name}")


def test_a_held_signal_ends_the_run_between_two_samples(handlers):
    done: list[int] = []

    def run(checked: int) -> None:
        with stops_held() as check:
            for sample in range(4):
                if sample == 2:
                    os.kill(os.getpid(), signal.SIGTERM)
                    os.kill(os.getpid(), signal.SIGINT)
                done.append(sample)
                if sample < checked:
                    check()

    for checked, expected in ((4, [0, 1, 2]), (0, [0, 1, 2, 3])):  # the latter at the block's end
        done.clear()
        with pytest.raises(Stopped) as stopped:
            run(checked)
        assert done == expected
        assert stopped.value.args == (signal.SIGTERM,)
        assert handlers == {stop: signal.getsignal(stop) for stop in handlers}


def test_an_unwritable_file_is_reported_in_one_line(handlers, capsys):
    def main() -> int:
        raise OSError("no space\nat all")

    assert status_and_line(main, capsys) == (UNWRITABLE, "no space at all")


def test_a_broken_pipe_leaves_no_traceback(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    result = subprocess.run(
        [sys.executable, str(REPOSITORY / "scripts" / "make_scenes.py"), "--output", tmp_path],
        stdout=writing, stderr=subprocess.PIPE, text=True, timeout=60,
    )  # fmt: skip
    os.close(writing)
    assert (result.returncode, result.stderr) == (141, "")
    assert (tmp_path / "meshes" / "wigley.obj").is_file()


def notes_of(capsys) -> list[str]:
    return [line.partition(": note: ")[2] for line in capsys.readouterr().err.splitlines()]


def test_each_note_of_a_successful_block_is_one_line(capsys):
    def warn() -> None:
        for text in ("one\nline", "one\nline", "another"):
            warnings.warn(text, Note, stacklevel=1)
        warnings.warn("a library's", UserWarning, stacklevel=1)

    with notes_said():
        warn()
    assert notes_of(capsys) == ["one line", "another", "a library's"]
    with notes_said(quiet=True):
        warn()
    assert notes_of(capsys) == []
    faults = ModelError(["a fault"])  # notes may explain it
    for error, notes in ((OSError("full"), []), (faults, ["one line", "another"])):
        with suppress(type(error)), notes_said():
            warn()
            raise error
        assert notes_of(capsys) == notes


def test_tables_align_names_left_and_numbers_right(capsys):
    print_table(("body", "height m"), [("cube", "0.10"), ("long name", "-12.345")])
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["body       height m", "cube           0.10", "long name   -12.345"]


@pytest.mark.parametrize(("quiet", "total", "lines"), [
    (False, 1e5, ["bunny.py: note: 100000 s: about 5.6 h more at this speed"]),
    (False, 1e3, ["bunny.py: note: 1000 s: about 3 minutes more at this speed"]),
    (False, 200.0, []), (True, 1e5, []),
])  # fmt: skip
def test_long_work_says_how_long_it_takes_off_a_terminal(quiet, total, lines, monkeypatch, capsys):
    """0.2 s of wall time for every unit, from the first that was not done before."""
    clock = iter(0.2 * np.arange(100.0))
    monkeypatch.setattr(command_line, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(sys, "argv", ["bunny.py"])
    with Progress(total, "s", quiet, done=50.0) as bar:
        for _ in range(20):
            bar.update(1.0)
    assert bar.n == 70.0
    assert capsys.readouterr().err.splitlines() == lines


def test_progress_is_shown_only_on_a_terminal(monkeypatch, capsys):
    with Progress(10.0, "s") as bar:
        bar.update(5.0)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    for quiet, is_shown in ((False, True), (True, False)):
        with Progress(10.0, "s", quiet) as bar:
            bar.update(5.0)
            bar.bar.refresh()
        assert ("of 10 s" in capsys.readouterr().err) == is_shown


def test_a_failed_write_leaves_the_old_file(tmp_path):
    file = tmp_path / "report.json"
    file.write_text("old")

    def fail(beside):
        beside.write_text("half of it")
        raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        write_whole(file, fail)
    assert file.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    link = tmp_path / "link.json"
    link.symlink_to(file)
    write_whole(link, lambda beside: beside.write_text("new"))
    assert file.read_text() == "new"
    assert link.is_symlink()
    early = tmp_path / "early.json"
    early.symlink_to(tmp_path / "none" / "yet.json")
    write_whole(early, lambda beside: beside.write_text("new"))
    assert (tmp_path / "none" / "yet.json").read_text() == "new"
    assert early.is_symlink()
    write_whole(tmp_path / "new" / "folder" / "a", lambda beside: beside.write_text("there"))
    assert (tmp_path / "new" / "folder" / "a").read_text() == "there"


def test_unwritable_outputs_are_refused_before_the_work(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.touch()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    check_outputs((None, file, tmp_path / "new" / "folder" / "a"), [])
    for bad, message in (
        (tmp_path, "is no file but a folder or a device"),
        (tmp_path.joinpath("/dev/null"), "is no file but a folder or a device"),
        (tmp_path / "pipe", "is no file but a folder or a device"),
        (tmp_path / "circle", "is a link that leads to itself"),
        (file / "deep" / "a", "cannot be written because of .*file; give another name"),
    ):
        with pytest.raises(ValueError, match=message):
            check_outputs([bad], [])
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(ValueError, match="cannot be written because of"):
        check_outputs([file], [])
    assert {path.name for path in tmp_path.iterdir()} == {"file", "pipe", "circle"}


READERS = positive, not_negative, at_least(2, 9), named_number, size


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("text", ["x", "", "nan", "-1", "1e300", "a=b", "=1"])
def test_numbers_are_refused_by_what_is_expected(read, text):
    """argparse would name the function after any other error."""
    with pytest.raises(ArgumentTypeError, match=r"is not (a|NAME=)"):
        read(text)


def test_scripts_read_numbers_only_by_these_readers():
    used = set()
    for path in REPOSITORY.glob("scripts/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "add_argument":
                kinds = [keyword.value for keyword in node.keywords if keyword.arg == "type"]
                used |= {ast.unparse(kind).partition("(")[0] for kind in kinds}
    assert used == {"Path", "positive", "not_negative", "at_least", "named_number", "size"}


@pytest.mark.parametrize("named", ["scene", "mesh"])
def test_a_pipe_as_input_is_refused_at_once(named, tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe.stl")
    scene = tmp_path / "scene.xml"
    scene.write_text('<mujoco><asset><mesh name="m" file="pipe.stl"/></asset></mujoco>')
    given = tmp_path / "pipe.stl" if named == "scene" else scene
    assert status_of("run.py", given, "--no-record") == 2
    assert "pipe.stl" in capsys.readouterr().err


def test_numbers_that_are_not_finite_are_null_in_json(tmp_path):
    report = {"a": [1.5, float("inf")], "b": {"c": (float("nan"), 2)}, "d": None, "e": "inf"}
    write_json(tmp_path / "a.json", report)
    read = json.loads((tmp_path / "a.json").read_text(), parse_constant=pytest.fail)
    assert read == {"a": [1.5, None], "b": {"c": [None, 2]}, "d": None, "e": "inf"}


def test_a_second_process_compiles_only_if_nothing_is_compiled(monkeypatch):
    assert not compile_in_two()
    started = []
    monkeypatch.setattr(command_line, "_helpers", [])
    monkeypatch.setattr(subprocess, "Popen", lambda command, **_: started.append(command))
    monkeypatch.setattr("sim.kernels.kept_kernels", lambda: 0)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    assert compile_in_two()
    names = {}
    exec(started[0][-1], names)
    assert names["model"].nplugin == 1
