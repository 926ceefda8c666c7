"""Imports follow the map in sim/__init__.py."""

import ast
import re
import subprocess
import sys

import pytest

import sim
from independent import REPOSITORY

TIERS = [
    {name.strip().rstrip("/") for name in line.split(",")}
    for line in re.findall(r"^    ([a-z_/, ]+?)   *\S", sim.__doc__, flags=re.MULTILINE)
][::-1]
"""Rooms of the map, from the bottom up. Rooms of one line do not import one another."""

OUTSIDE = {
    "mujoco": {"mjcf", "plugin", "worlds", "scenes", "runs", "recording"},
    "mujoco_warp": {"worlds"},
    "warp": {"worlds"},
    "trimesh": {"hulls"},
    "manifold3d": {"hulls"},
    "rerun": {"recording"},
    "numba": {"kernels", "addresses"},
    "llvmlite": {"addresses"},
}
"""The rooms that may import an external package. All rooms may import the other packages."""

PACKAGE = REPOSITORY / "sim"
FILES = sorted(set(PACKAGE.rglob("*.py")) - {PACKAGE / "__init__.py"})


def imported(path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names.add(node.module)
    return names


def room_of(path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(REPOSITORY)))
def test_imports_point_down_the_map(path):
    room = room_of(path)
    tier = next(i for i, rooms in enumerate(TIERS) if room in rooms)
    below = set().union({room}, *TIERS[:tier])
    for name in imported(path):
        first, *rest = name.split(".")
        if first == "sim":
            assert rest, f"{path} imports the package from inside"
            assert rest[0] in below, f"{room} imports {name}"
        else:
            assert room in OUTSIDE.get(first, {room}), f"{room} imports {name}"


def test_imports_have_no_cycles():
    imports = {
        ".".join(path.relative_to(REPOSITORY).with_suffix("").parts): imported(path)
        for path in FILES
    }
    remaining = {name: names & set(imports) for name, names in imports.items()}
    while free := {name for name, names in remaining.items() if not names & set(remaining)}:
        remaining = {name: names for name, names in remaining.items() if name not in free}
    assert remaining == {}


def test_every_room_is_on_the_map():
    assert {room_of(path) for path in FILES} == set().union(*TIERS)


def test_public_names_exist():
    contract = "Wave Sea Hull Linear Chord Patches Reference Buoyancy Scene simulate Recorder"
    assert set(contract.split()) <= set(sim.__all__)
    assert all(hasattr(sim, name) for name in sim.__all__)
    assert not hasattr(sim, "Kraken")


def test_importing_the_package_does_not_load_rerun():
    code = (
        "import sys, sim; assert 'rerun' not in sys.modules; sim.Recorder; 'rerun' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=REPOSITORY, timeout=60)
