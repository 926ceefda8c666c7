"""Odd places to run in: closed and full streams, Python without docstrings, names that are no
UTF-8. Each is one line or plain success, and never a traceback."""

import os
import subprocess
import sys

import pytest

from independent import MODELS, REPOSITORY

RUN = str(REPOSITORY / "scripts" / "run.py")
SHORT = [str(MODELS / "cube.xml"), "--no-record", "--duration", "0.1"]


def run(arguments, folder, python=(), close=(), **options) -> tuple[int, list[str]]:
    """Exit status and lines on stderr; with numbers of streams that are closed at the start."""

    def shut() -> None:
        for number in close:
            os.close(number)

    done = subprocess.run(
        [sys.executable, *python, RUN, *arguments], cwd=folder, preexec_fn=shut, timeout=300,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options,
    )  # fmt: skip
    return done.returncode, (done.stderr or b"").decode(errors="replace").splitlines()


@pytest.mark.parametrize("close", [(1,), (0, 1, 2)], ids=str)
def test_closed_streams_are_no_trouble(close, tmp_path):
    arguments = [SHORT[0], "--record", "a.rrd", "--duration", "0.1"]
    status, said = run(arguments, tmp_path, close=close)
    assert status == 0
    assert all(line.startswith("run.py: note: ") for line in said)
    rerun = os.path.join(os.path.dirname(sys.executable), "rerun")
    assert subprocess.run([rerun, "rrd", "verify", str(tmp_path / "a.rrd")]).returncode == 0


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is full")
def test_a_full_output_is_one_line(tmp_path):
    with open("/dev/full", "wb") as full:
        status, said = run(SHORT, tmp_path, stdout=full)
        assert status == 4
        assert said[-1] == "run.py: output: No space left on device"
        assert run(SHORT, tmp_path, stderr=full)[0] in (0, 4)


def test_python_without_docstrings_runs_too(tmp_path):
    """As far as kernels, which would be compiled anew for it."""
    status, said = run(["none.xml"], tmp_path, python=("-OO",))
    assert (status, len(said)) == (2, 1)
    assert "there is no scene file none.xml" in said[0]


def test_names_that_are_no_utf_8(tmp_path):
    scene, recording = (os.fsencode(tmp_path) + b"/\xe4" + end for end in (b".xml", b".rrd"))
    try:
        with open(scene, "wb") as file:
            file.write((MODELS / "cube.xml").read_bytes())
    except OSError:
        pytest.skip("the file system has no such names")
    variables = os.environ | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
    status, said = run([scene, "--no-record"], tmp_path, env=variables)
    assert status == 2
    assert len(said) == 1
    assert said[0].endswith("MuJoCo opens only names in UTF-8; rename it")
    arguments = [SHORT[0], "--record", recording, "--duration", "0.1"]
    assert run(arguments, tmp_path, env=variables)[0] == 0
    assert os.path.exists(recording)
