"""The direction of imports, read from the files."""

import ast

import pytest

from independent import REPOSITORY

LAYERS = {
    "gerstner": set(),
    "spectrum": set(),
    "sea": {"gerstner", "spectrum"},
    "hull": set(),
    "triangle": {"gerstner"},
    "methods": {"gerstner", "sea", "hull", "triangle"},
    "drag": {"gerstner", "sea", "hull", "triangle"},
    "implicit": {"drag", "gerstner", "triangle"},
    "mjcf": {"methods", "drag", "sea", "hull"},
    "coupling": {"mjcf", "methods", "implicit", "sea"},
    "scene": {"coupling"},
    "divergence": {"scene", "mjcf", "hull"},
    "simulation": {"scene", "divergence"},
    "waterline": {"sea"},
    "skin": {"simulation", "coupling", "hull", "waterline"},
    "recording": {"simulation", "scene", "skin", "waterline", "sea"},
    "accuracy": {"methods", "gerstner", "sea", "hull", "triangle"},
}
"""What each layer may import from the others."""

OUTSIDE = {
    "mujoco": {"mjcf", "coupling", "scene", "divergence", "simulation"},
    "trimesh": {"mjcf"},
    "rerun": {"recording"},
    "numba": {"gerstner", "triangle", "methods", "drag", "waterline"},
}
"""Which layers may import a package from outside."""

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


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(REPOSITORY)))
def test_imports_point_one_way(path):
    layer = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    for name in imported(path):
        first, *rest = name.split(".")
        if first == "sim":
            assert rest, f"{path} imports the package from inside"
            assert rest[0] == layer or rest[0] in LAYERS[layer], f"{layer} imports {name}"
        else:
            assert layer in OUTSIDE.get(first, {layer}), f"{layer} imports {name}"


def test_every_layer_is_listed():
    found = {p.relative_to(PACKAGE).parts[0].removesuffix(".py") for p in FILES}
    assert found == set(LAYERS)


def test_public_names_exist():
    import sim

    contract = "Wave Sea Hull Linear Buoyancy Scene simulate Recorder"
    assert set(contract.split()) <= set(sim.__all__)
    assert all(hasattr(sim, name) for name in sim.__all__)
