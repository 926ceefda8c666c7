"""Callback: MuJoCo's passive callback, which is one for the whole process, shared by many.

MuJoCo calls `mjcb_passive` inside every `mj_forward`, after kinematics and before dynamics, and at
every stage of RK4. While anything is installed here, that callback is ours: it calls what was
installed before it, then whoever is installed for the model at hand. Blocks may overlap, nest and
end in any order and in any threads.

It is a C function (`native.callback_at`), which batches and rollouts call in their own threads and
which does not mind models being compiled. Where something can only be done by the interpreter, a
method that is no kernel or an earlier callback in Python, it is a Python function that does the
same.
"""

import ctypes
from collections.abc import Callable
from threading import Lock
from typing import Any, NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling import native
from sim.coupling.context import Context, function_address, mujoco_library


class Coupled(Protocol):
    """What may be installed: its model and context, and how it writes where C code cannot."""

    model: mujoco.MjModel
    context: Context

    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None: ...


class Installed(NamedTuple):
    """Those who are installed, and the list of their contexts that kernels read."""

    coupled: tuple[Coupled, ...]
    contexts: NDArray[np.int64]


_lock = Lock()
_now = Installed((), np.zeros(1, dtype=np.int64))
_left: list[Installed] = []
_previous: Callable[[Any, Any], None] | None = None

REASONS = {
    native.AMBIGUOUS: "this model is a copy of several that are installed, and which of them is "
    "not known; make a Buoyancy of its own with Buoyancy.from_model(model)",
    native.TILTED: "the model's gravity is not along -z any more; the water's surface needs that",
} | {
    native.CHANGED - i: f"the model's {field} changed after its Buoyancy was made, which does not "
    "follow that; make a new one with Buoyancy.from_model(model)"
    for i, field in enumerate(native.FIELDS)
}
"""What is said of a model that is refused, by the answers of `native.find_context`."""

_texts = [ctypes.create_string_buffer(REASONS[why].encode()) for why in sorted(REASONS)[::-1]]
_refusal = np.zeros(2 + len(_texts), dtype=np.int64)


def install(coupled: Coupled) -> None:
    """Call `coupled` for its model from now on, unless something is installed for that later. As
    often as it is installed it has to be uninstalled."""
    global _previous
    with _lock:
        current = mujoco.get_mjcb_passive()
        if not _is_ours(current):
            _previous = current
        _publish((*_now.coupled, coupled))


def uninstall(coupled: Coupled) -> None:
    """Undo one `install`. The last one brings back what was there before. Raises ValueError for
    what is not installed."""
    global _previous
    with _lock:
        left = list(_now.coupled)
        places = [i for i, other in enumerate(left) if other is coupled]
        if not places:
            raise ValueError("this Buoyancy is not installed; install() it first")
        del left[places[-1]]
        _publish(tuple(left))
        if not left:
            _previous = None


def _publish(coupled: tuple[Coupled, ...]) -> None:
    """Let kernels and MuJoCo know who is installed."""
    global _now
    ours = _is_ours(mujoco.get_mjcb_passive())
    was_empty = not _now.coupled
    _left.append(_now)
    addresses = [each.context.address for each in coupled]
    _now = Installed(coupled, np.array([len(coupled), *addresses], dtype=np.int64))
    native.CELL[native.CONTEXTS] = _now.contexts.ctypes.data
    if coupled and (ours or was_empty):
        mujoco.set_mjcb_passive(_function_for(coupled))
    elif ours:
        mujoco.set_mjcb_passive(_previous)
    if not native.IN_USE.any():  # nobody reads the earlier lists and their contexts any more
        _left.clear()


def _function_for(coupled: tuple[Coupled, ...]) -> Callable[..., None]:
    """The callback that can serve all of these, and what was there before."""
    is_native = all(each.context.is_native for each in coupled)
    if not is_native or not (_previous is None or isinstance(_previous, ctypes._CFuncPtr)):
        return _python_callback
    earlier = ctypes.cast(_previous, ctypes.c_void_p).value if _previous else 0
    native.CELL[native.PREVIOUS] = earlier
    native.CELL[native.USE] = native.IN_USE.ctypes.data
    _refusal[0] = function_address(mujoco_library(), "mju_error")
    _refusal[1] = function_address(mujoco_library(), "_mjPRIVATE_setTlsLogHandler")
    _refusal[2:] = [ctypes.addressof(text) for text in _texts]
    native.CELL[native.REFUSING] = _refusal.ctypes.data
    return native.callback_at.call


def _is_ours(function: Any) -> bool:
    if function is None or function is _python_callback:
        return function is not None
    return function is native.callback_at.call


def is_other_set() -> bool:
    """Whether the user has a passive callback of his own, before ours or alone."""
    current = mujoco.get_mjcb_passive()
    return _previous is not None if _is_ours(current) else current is not None


def _python_callback(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    previous, now = _previous, _now
    if previous is not None:
        if isinstance(previous, ctypes._CFuncPtr):
            previous(model._address, data._address)
        else:
            previous(model, data)
    place = native.find_at.call(now.contexts.ctypes.data, model._address, data._address)
    if place >= 0:
        now.coupled[place].write(model, data)
    elif place != native.NOBODY:
        raise ValueError(REASONS[place])
