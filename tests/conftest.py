"""Preparation for all tests."""

import pytest

from command_line import compile_in_two
from independent import MODELS
from sim import Scene, observe


def pytest_sessionstart(session):
    """Compile the kernels in two processes, before several processes test."""
    if not hasattr(session.config, "workerinput") and compile_in_two():
        observe(Scene.load(MODELS / "cube.xml"))


@pytest.fixture(scope="session", autouse=True)
def _compiled_kernels():
    """Compile the kernels before the first test, because compiling prints a notice."""
    observe(Scene.load(MODELS / "cube.xml"))
