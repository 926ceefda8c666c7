"""Refusals: how a model that cannot float is refused through MuJoCo, and what each thread is doing.

MuJoCo's own error has little room for text and knows no Python exceptions. What it has no room for
is printed, or raised by `refusals_raised`.
"""

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from threading import local

from sim.mjcf.faults import ModelError, Note
from sim.plugin.memory import mujoco_library

ROOM = 400
"""Characters of faults for which MuJoCo's error has room."""


class _ThreadState(local):
    """What a thread is doing.

    is_reading: it reads a model, and the states that it makes for that need no water.
    is_compiling: the next state belongs to a model that is being compiled.
    refusal: why the last model of this thread was refused.
    takes_refusal: a block of `refusals_raised` will raise it.
    """

    is_reading = False
    is_compiling = False
    refusal: BaseException | None = None
    takes_refusal = False


thread = _ThreadState()


@contextmanager
def refusals_raised() -> Iterator[None]:
    """Raise what the plugin refuses in this block as it is, instead of as MuJoCo's error."""
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
    """Tell MuJoCo why a model is refused. Returns what a plugin's `init` must return."""
    if not isinstance(error, ValueError | Note):  # an error in Waterline
        traceback.print_exception(error)
        error = RuntimeError(f"{type(error).__name__}: {error}")
    thread.refusal = error
    faults = list(error.faults) if isinstance(error, ModelError) else [str(error)]
    shown = [fault for i, fault in enumerate(faults) if len("".join(faults[: i + 1])) < ROOM]
    if not shown:
        shown = [faults[0][:ROOM] + " ..."]
    if len(shown) < len(faults):
        shown.append(f"and {len(faults) - len(shown)} more: see above")
        if not thread.takes_refusal:
            print("waterline refuses the model:", *faults, sep="\n  ", file=sys.stderr, flush=True)
    text = "\n".join(shown).replace("%", "%%")  # MuJoCo takes it as a printf format
    mujoco_library().mju_warning(text.encode())
    return -1
