"""Refusals: refuses a model through MuJoCo, and keeps the state of each thread.

MuJoCo's error is a short text and not a Python exception. The faults that do not fit are printed,
or raised by `refusals_raised`.
"""

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from threading import local

from sim.mjcf.faults import ModelError
from sim.notes import Note
from sim.plugin.memory import mujoco_library

LARGEST_LENGTH = 400
"""Largest number of characters of faults in MuJoCo's error."""


class _ThreadState(local):
    """The state of a thread.

    is_reading: it reads a model and makes states without water. is_compiling: the next state
    belongs to a model that is being compiled. refusal: the error of the last refused model.
    takes_refusal: a block of `refusals_raised` will raise it.
    """

    is_reading = False
    is_compiling = False
    refusal: BaseException | None = None
    takes_refusal = False


thread = _ThreadState()


@contextmanager
def refusals_raised() -> Iterator[None]:
    """A block that raises the plugin's own error for a refused model instead of MuJoCo's."""
    before = thread.takes_refusal
    thread.takes_refusal, thread.refusal = True, None
    try:
        yield
    except ValueError as error:
        raise (thread.refusal or error) from None
    finally:
        thread.takes_refusal, thread.refusal = before, None


@contextmanager
def reading() -> Iterator[None]:
    """A block in which the states that this thread makes get no water."""
    before, thread.is_reading = thread.is_reading, True
    try:
        yield
    finally:
        thread.is_reading = before


def refused(error: Exception) -> int:
    """Give MuJoCo the reason why a model is refused. Returns -1, the result of `init`."""
    if not isinstance(error, ValueError | Note):  # an error in Waterline
        traceback.print_exception(error)
        error = RuntimeError(f"{type(error).__name__}: {error}")
    thread.refusal = error
    faults = list(error.faults) if isinstance(error, ModelError) else [str(error)]
    fits = [len("".join(faults[: i + 1])) < LARGEST_LENGTH for i in range(len(faults))]
    shown = faults[: sum(fits)]
    if not shown:
        shown = [faults[0][:LARGEST_LENGTH] + " ..."]
    if len(shown) < len(faults):
        shown.append(f"and {len(faults) - len(shown)} more: see above")
        if not thread.takes_refusal:
            print("waterline refuses the model:", *faults, sep="\n  ", file=sys.stderr, flush=True)
    text = "\n".join(shown).replace("%", "%%")  # MuJoCo takes it as a printf format
    mujoco_library().mju_warning(text.encode())
    return -1
