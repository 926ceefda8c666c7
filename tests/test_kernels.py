"""Blocks of tables, and the compiled code that is kept."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from numba import njit

from independent import REPOSITORY
from sim.kernels import kernel, packed, record, table, when_compiling

PAIR = record(name="i8", numbers=("f8", 3))
SINGLE = record(value="f4")


@kernel
def sums_of(block, sums_out):
    pairs, singles = table(block, 0, PAIR), table(block, 1, SINGLE)
    sums_out[:] = 0.0
    for i in range(pairs.size):
        sums_out[0] += pairs[i].name * pairs[i].numbers[1]
    for i in range(singles.size):
        sums_out[1] += singles[i].value


def test_kernels_find_the_tables_of_a_block():
    pairs = np.array([(2, [0, 0.5, 0]), (3, [0, 1.5, 0])], PAIR)
    singles = np.array([(0.25,)] * 5, SINGLE)
    block, sums = packed(pairs, singles), np.empty(2)
    sums_of(block, sums)
    np.testing.assert_array_equal(sums, [5.5, 1.25])
    sums_of(packed(pairs[:0], singles[:1]), sums)
    np.testing.assert_array_equal(sums, [0.0, 0.25])


def test_a_block_is_closed_and_its_tables_begin_at_lines_of_the_cache():
    block = packed(np.zeros(3, SINGLE), np.zeros(2, PAIR))
    with pytest.raises(ValueError, match="read-only"):
        block[0] = 1
    starts = block[:32].view(np.int64)[::2]
    assert ((block.ctypes.data + starts) % 64 == 0).all()


def test_an_edited_kernel_is_compiled_again_in_those_that_call_it(tmp_path):
    """They stand in other files, which have not changed."""
    shutil.copy(REPOSITORY / "sim" / "kernels.py", tmp_path)
    (tmp_path / "above.py").write_text(
        "from kernels import kernel\nfrom below import value\n\n\n"
        "@kernel\ndef twice():\n    return 2 * value()\n"
    )

    def answer(value: int) -> int:
        (tmp_path / "below.py").write_text(
            f"from kernels import kernel\n\n\n@kernel\ndef value():\n    return {value}\n"
        )
        code = "from above import twice; print(twice())"
        run = [sys.executable, "-c", code]
        return int(subprocess.run(run, cwd=tmp_path, capture_output=True, check=True).stdout)

    assert [answer(21), answer(21), answer(34)] == [42, 42, 68]


def test_what_other_sources_left_in_the_cache_is_not_looked_at(tmp_path):
    """It may name a class that is no more: numba would stumble over it before it looks at dates."""
    shutil.copy(REPOSITORY / "sim" / "kernels.py", tmp_path)
    source = (
        "from typing import NamedTuple\nfrom kernels import kernel\n\n\n"
        "class {0}(NamedTuple):\n    value: int\n\n\n"
        "@kernel\ndef twice(pair):\n    return 2 * pair.value\n\n\n"
        "def run():\n    return twice({0}(21))\n"
    )
    for name in ("Pair", "Couple"):
        (tmp_path / "made.py").write_text(source.format(name))
        run = [sys.executable, "-c", "from made import run; print(run())"]
        done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True)
        assert done.stdout == "42\n", done.stderr


def test_compiling_is_told_when_it_happens_and_only_then():
    told = []
    with when_compiling(lambda: told.append(1)):

        @njit  # not kept
        def twice(x):
            return 2.0 * x

        assert told == []
        assert twice(1.5) == 3.0
        assert told == [1]
        assert twice(2.5) == 5.0
        assert twice(1) == 2.0  # compiled once more, but told once
    assert told == [1]


TWICE = (
    "from kernels import c_query, kernel\n\n\n"
    "@kernel\ndef twice(x):\n    return 2 * x\n\n\n"
    "@c_query\ndef thrice(x):\n    return 3 * x\n"
)


def answers(folder, **environment: str) -> tuple[str, list[str]]:
    """What kernels in a folder answer, and the lines of what they say besides."""
    shutil.copy(REPOSITORY / "sim" / "kernels.py", folder)
    (folder / "made.py").write_text(TWICE)
    run = [sys.executable, "-c", "import made; print(made.twice(21), made.thrice.call(14))"]
    variables = os.environ | environment
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, env=variables)
    assert done.returncode == 0, done.stderr
    return done.stdout, [line for line in done.stderr.splitlines() if "Warning" in line]


def damage(data: bytes, how: str) -> bytes:
    if how == "cut":
        return data[: len(data) // 2]
    if how == "emptied":
        return b""
    middle = len(data) // 2  # of a data file that is machine code, which pickle does not look at
    return data[:middle] + bytes([data[middle] ^ 0xFF]) + data[middle + 1 :]


@pytest.mark.parametrize(
    ("kind", "how"), [("nbi", "emptied"), ("nbc", "cut"), ("nbc", "a byte is another one")]
)
def test_damaged_code_is_compiled_anew_with_one_word(kind, how, tmp_path):
    assert answers(tmp_path) == ("42 42\n", [])
    kept = list(tmp_path.rglob(f"*.{kind}"))
    assert len(kept) == 2
    for path in kept:
        path.write_bytes(damage(path.read_bytes(), how))
    said, warned = answers(tmp_path)
    assert said == "42 42\n"
    assert len(warned) == 1
    assert "are damaged" in warned[0]
    assert "compiled anew" in warned[0]
    assert answers(tmp_path) == ("42 42\n", [])


def test_where_no_code_can_be_kept_one_word_says_so(tmp_path):
    (tmp_path / "__pycache__").write_text("in the way of a folder")
    nowhere = {name: "/dev/null/x" for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    said, warned = answers(tmp_path, **nowhere)
    assert said == "42 42\n"
    assert len(warned) == 1
    assert "compiled kernels cannot be kept" in warned[0]
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in warned[0]


def test_a_disk_that_is_full_keeps_no_code_and_says_so(tmp_path):
    """Files may grow to a few bytes only, as on a disk that has no more room."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
    shutil.copy(REPOSITORY / "sim" / "kernels.py", tmp_path)
    (tmp_path / "made.py").write_text(limit + TWICE)
    run = [sys.executable, "-B", "-c", "import made; print(made.twice(21))"]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "42\n"), done.stderr
    assert done.stderr.count("cannot be kept ([Errno 27] File too large)") == 1
