"""The kernels for a GPU, compiled without one, keep their numbers in registers."""

import re
import subprocess
import sysconfig
from pathlib import Path

import pytest

wp = pytest.importorskip("warp")

from sim.worlds.programs import GPU_LANES, programs  # noqa: E402

MOST_STACK = 512
"""Bytes of small arrays with computed indices, such as the heads of a leaf's vertices."""


def assembler() -> str | None:
    """The path of PyPI's ptxas. One on the path may be older than Warp's code."""
    packages = Path(sysconfig.get_paths()["purelib"])
    found = sorted(packages.glob("nvidia/*/bin/ptxas"))
    return str(found[-1]) if found else None


@pytest.mark.skipif(assembler() is None, reason="there is no ptxas")
def test_no_kernel_spills_registers(tmp_path):
    module = programs(GPU_LANES).module
    (compiled,) = wp.compile_aot_module(module, arch=90, use_ptx=True, module_dir=tmp_path)
    text = compiled.read_bytes().rstrip(b"\0")  # Warp ends it with a zero, which ptxas refuses
    compiled.write_bytes(text)
    command = [assembler(), "-arch=sm_90", "-v", str(compiled), "-o", str(tmp_path / "out")]
    report = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    stacks = [int(n) for n in re.findall(r"(\d+) bytes stack frame", report)]
    spills = [int(n) for n in re.findall(r"(\d+) bytes spill", report)]
    assert len(stacks) == len(module.kernels)
    assert set(spills) == {0}
    assert max(stacks) <= MOST_STACK
