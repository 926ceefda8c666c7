"""Preparation for all tests."""

import pytest

from command_line import compile_in_two
from independent import MODELS
from sim import Scene, Sea, observe


def compile_kernels() -> None:
    """Compile the kernels in waves, and those of flat water, which are in double precision."""
    for sea in (None, Sea()):
        observe(Scene.load(MODELS / "cube.xml", sea=sea))


def pytest_sessionstart(session):
    """Compile the kernels in two processes, before several processes test."""
    if not hasattr(session.config, "workerinput") and compile_in_two():
        compile_kernels()


@pytest.fixture(scope="session", autouse=True)
def _compiled_kernels():
    """Compile the kernels before the first test, because compiling prints a notice."""
    compile_kernels()
