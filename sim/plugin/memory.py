"""Memory: MuJoCo's library, and numbers at addresses that it gives."""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.platforms import mujoco_file

ADDRESS, INTEGER, WORD = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64


@cache
def mujoco_library() -> ctypes.CDLL:
    """MuJoCo's library."""
    return ctypes.CDLL(str(mujoco_file(Path(mujoco.__file__).parent)))


def function_address(library: ctypes.CDLL, name: str) -> int:
    """The address of a library's function; 0 if the library has none of that name."""
    function = getattr(library, name, None)
    return callback_address(function) if function else 0


def callback_address(function: Any) -> int:
    """The address of a C function; 0 for none."""
    return ctypes.cast(function, ADDRESS).value or 0


def word_at(address: int) -> int:
    """The 8-byte integer at an address."""
    return WORD.from_address(address).value


def integers_at(address: int, count: int) -> list[int]:
    """C ints at an address."""
    return list((INTEGER * count).from_address(address))


def floats_at(address: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Doubles at an address, as an array that shares the memory."""
    count = int(np.prod(shape))
    numbers: Any = (ctypes.c_double * count).from_address(address)
    return np.frombuffer(numbers).reshape(shape)
