"""Preparation for all tests."""

import pytest

from independent import MODELS
from sim import Scene, observe


@pytest.fixture(scope="session", autouse=True)
def _compiled_kernels():
    """Compile the kernels before the first test, because compiling prints a notice."""
    observe(Scene.load(MODELS / "cube.xml"))
