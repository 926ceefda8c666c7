"""Packed blocks of tables, and the cache of compiled code."""

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit

from independent import REPOSITORY
from sim.addresses import floats_at
from sim.kernels import (
    kernel,
    packed,
    record,
    scratch,
    scratch_zeros,
    table,
    when_compiling,
    workspace,
)
from sim.water.gerstner import wave_sums
from sim.water.head_jets import solve_head_jets

PAIR = record(name="i8", numbers=("f8", 3))
SINGLE = record(value="f4")

KERNELS = {"kernel", "summing_kernel", "inline", "c_function", "c_query"}
"""The decorators of functions that numba compiles."""


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


@kernel
def strides_at(address):
    return floats_at(address, (2, 3, 4)).strides


def test_an_array_at_an_address_is_in_c_order():
    numbers = np.empty((2, 3, 4))
    assert strides_at(numbers.ctypes.data) == numbers.strides


def test_a_block_is_read_only_and_its_tables_are_aligned_to_cache_lines():
    block = packed(np.zeros(3, SINGLE), np.zeros(2, PAIR))
    with pytest.raises(ValueError, match="read-only"):
        block[0] = 1
    starts = block[:32].view(np.int64)[::2]
    assert ((block.ctypes.data + starts) % 64 == 0).all()


def run(folder: Path, code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder with its own cache and a package `sim` with kernels.py only."""
    (folder / "sim").mkdir(exist_ok=True)
    (folder / "sim" / "__init__.py").touch()  # or an installed package would come first
    for name in ("kernels.py", "addresses.py", "platforms.py"):
        shutil.copy(REPOSITORY / "sim" / name, folder / "sim")
    variables = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache")} | environment
    variables["PYTHONPATH"] = str(folder)
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=variables)


def test_an_edited_kernel_is_compiled_again_in_its_callers(tmp_path):
    """The callers are in another file, which has not changed."""
    package = tmp_path / "sim"
    package.mkdir()
    (package / "above.py").write_text(
        "from sim.kernels import kernel\nfrom sim.below import value\n\n\n"
        "@kernel\ndef twice():\n    return 2 * value()\n"
    )

    def answer(value: int) -> str:
        (package / "below.py").write_text(
            f"from sim.kernels import kernel\n\n\n@kernel\ndef value():\n    return {value}\n"
        )
        return run(tmp_path, "from sim.above import twice; print(twice())").stdout

    assert [answer(21), answer(21), answer(34)] == ["42\n", "42\n", "68\n"]


def test_compiling_calls_back_when_it_happens():
    calls = []
    with when_compiling(lambda: calls.append(1)):

        @njit  # not cached
        def twice(x):
            return 2.0 * x

        assert calls == []
        assert twice(1.5) == 3.0
        assert calls == [1]
        assert twice(2.5) == 5.0
        assert calls == [1]
        assert twice(1) == 2.0  # compiles again
    assert calls == [1, 1]


TWICE = (
    "from sim.kernels import c_query, kernel\n\n\n"
    "@kernel\ndef twice(x):\n    return 2 * x\n\n\n"
    "@c_query\ndef thrice(x):\n    return 3 * x\n"
)


def results(folder: Path, **environment: str) -> tuple[str, list[str]]:
    """The results of kernels in a folder, and the lines of their warnings."""
    if not (folder / "made.py").exists():  # numba 0.61 compiles a file that was written again
        (folder / "made.py").write_text(TWICE)
    done = run(folder, "import made; print(made.twice(21), made.thrice.call(14))", **environment)
    assert done.returncode == 0, done.stderr
    return done.stdout, [line for line in done.stderr.splitlines() if "Warning" in line]


def test_compiled_code_is_kept_only_in_the_users_cache_folder(tmp_path):
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "users"), "NUMBA_CACHE_DIR": ""}
    assert results(tmp_path, **home) == ("42 42\n", [])
    (stamp,) = (tmp_path / "users" / "waterline").iterdir()
    assert sorted(tmp_path.rglob("*.nbi")) == sorted(stamp.rglob("*.nbi"))
    assert len(list(stamp.rglob("*.nbc"))) == 2
    before = {path: path.stat().st_mtime_ns for path in stamp.rglob("*.nb?")}
    assert results(tmp_path, **home) == ("42 42\n", [])
    assert {path: path.stat().st_mtime_ns for path in stamp.rglob("*.nb?")} == before


def test_damaged_code_is_refused_with_the_folder_to_remove(tmp_path):
    assert results(tmp_path) == ("42 42\n", [])
    (stamp,) = (tmp_path / "cache" / "waterline").iterdir()
    for kind in ("nbi", "nbc"):
        intact = {path: path.read_bytes() for path in stamp.rglob(f"*.{kind}")}
        for path, content in intact.items():
            path.write_bytes(content[: len(content) // 2])
        done = run(tmp_path, "import made; made.twice(21)")
        error = done.stderr.splitlines()[-1]
        assert error.startswith(f"RuntimeError: compiled kernels in {stamp} are damaged (")
        assert error.endswith("remove that folder")
        for path, content in intact.items():
            path.write_bytes(content)
    shutil.rmtree(stamp)
    assert results(tmp_path) == ("42 42\n", [])


def test_an_unwritable_cache_gives_one_warning(tmp_path):
    printed, warnings = results(tmp_path, NUMBA_CACHE_DIR="/dev/null/x")
    assert printed == "42 42\n"
    (warning,) = warnings
    assert "compiled kernels cannot be kept in /dev/null/x/waterline/" in warning
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in warning
    assert not list(tmp_path.rglob("*.nb?"))


def test_a_full_disk_gives_one_warning(tmp_path):
    """A limit on the size of files stands for the full disk."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
    (tmp_path / "made.py").write_text(limit + TWICE)
    done = run(tmp_path, "import made; print(made.twice(21))", PYTHONDONTWRITEBYTECODE="1")
    assert (done.returncode, done.stdout) == (0, "42\n"), done.stderr
    assert done.stderr.count("compiled kernels cannot be kept") == 1


MAKERS = ("np.empty(1, ", "np.zeros(1, ")
ON_STACK = ("workspace(", "scratch(", "scratch_zeros(")


def made_by(function: ast.FunctionDef, makers: tuple[str, ...]) -> set[str]:
    """The names of the arrays that a function makes in one of the ways."""
    made = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Assign):
            target = node.targets[0]
            pairs = (
                zip(target.elts, node.value.elts, strict=True)
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                else [(target, node.value)]
            )
            made |= {
                ast.unparse(name) for name, value in pairs if ast.unparse(value).startswith(makers)
            }
    return made


def all_kernels() -> Iterator[tuple[str, ast.FunctionDef]]:
    """The name of its file and the text of each kernel."""
    for path in (REPOSITORY / "sim").rglob("*.py"):
        for function in ast.walk(ast.parse(path.read_text())):
            if isinstance(function, ast.FunctionDef) and any(
                ast.unparse(d) in KERNELS for d in function.decorator_list
            ):
                yield path.name, function


def test_no_kernel_takes_a_row_of_a_table_that_it_makes():
    """A row does not keep its table alive: numba frees the table after its last use by name."""
    for name, function in all_kernels():
        made = made_by(function, MAKERS)
        taken = [
            node for node in ast.walk(function)
            if isinstance(node, ast.Subscript) and ast.unparse(node.value) in made
        ]  # fmt: skip
        assert not taken, f"{name}, {function.name}: {ast.unparse(taken[0])}"


def test_no_kernel_returns_an_array_on_its_stack():
    found = 0
    for name, function in all_kernels():
        made = made_by(function, ON_STACK)
        found += len(made)
        returned = [
            part
            for node in ast.walk(function)
            if isinstance(node, ast.Return) and node.value
            for part in (node.value.elts if isinstance(node.value, ast.Tuple) else [node.value])
        ]
        for part in returned:
            while isinstance(part, ast.Subscript) and isinstance(part.slice, ast.Slice):
                part = part.value
            assert ast.unparse(part) not in made, f"{name}, {function.name}: {ast.unparse(part)}"
    assert found > 40


@kernel
def making(count):
    return np.empty(count)


@kernel
def using(count):
    return making(count).size


def test_only_kernels_that_make_arrays_count_references_and_none_returns_one_that_it_was_given():
    """The caller would take away a reference that nobody has added."""
    kernels: list[Any] = [wave_sums, solve_head_jets, making, using]
    counts = [kernel.targetoptions["_nrt"] for kernel in kernels]
    assert counts == [False, False, True, True]
    for name, function in all_kernels():
        given = {argument.arg for argument in function.args.args}
        if name == "memory.py":
            given -= {"first", "second"}  # numbers
        if "inline" in map(ast.unparse, function.decorator_list):
            continue  # it becomes a part of its callers
        for node in ast.walk(function):
            if isinstance(node, ast.Return) and node.value:
                parts = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                for part in parts:
                    while isinstance(part, ast.Subscript) and isinstance(part.slice, ast.Slice):
                        part = part.value
                    assert ast.unparse(part) not in given, f"{name}, {function.name}"


TWO_ROWS = record(x=("f8", 3), y=("f8", 3))


@kernel
def on_stack(count):
    total = 0.0
    for i in range(count):
        work, numbers, zeros = workspace(TWO_ROWS), scratch((2, 3)), scratch_zeros(3)
        row = work[0]
        row.x[1], row.y[2], numbers[1, 2] = i, 10.0, 100.0
        total += row.x[1] + row.y[2] + numbers[1, 2] + zeros.sum()
        zeros[1] = 1000.0  # gone in the next round
    return total


def test_arrays_on_the_stack():
    assert on_stack(4) == 0 + 1 + 2 + 3 + 4 * 110.0
