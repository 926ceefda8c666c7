"""Callback: MuJoCo's passive callback, which is one for the whole process, shared by many.

MuJoCo calls `mjcb_passive` inside every `mj_forward`, after kinematics and before dynamics, and at
every stage of RK4. While anything is installed here, that callback is ours: it calls what was
installed before it, then whoever is installed for the model at hand. Blocks may overlap, nest and
end in any order and in any threads.
"""

import ctypes
from collections.abc import Callable
from threading import Lock
from typing import Any, Protocol

import mujoco


class Coupled(Protocol):
    """What may be installed: it has a model, and writes into states of it and of its copies."""

    model: mujoco.MjModel

    def is_copy(self, model: mujoco.MjModel) -> bool: ...
    def write(self, model: mujoco.MjModel, data: mujoco.MjData) -> None: ...
    def note(self, data: mujoco.MjData) -> None: ...


_lock = Lock()
_installed: tuple[Coupled, ...] = ()
_previous: Callable[[Any, Any], None] | None = None


def install(coupled: Coupled) -> None:
    """Call `coupled.write(model, data)` for its model from now on, or, if something is installed
    for that later, `coupled.note(data)`. As often as it is installed it has to be uninstalled."""
    global _installed, _previous
    with _lock:
        current = mujoco.get_mjcb_passive()
        if current is not _callback:
            _previous = current
            mujoco.set_mjcb_passive(_callback)
        _installed = (*_installed, coupled)


def uninstall(coupled: Coupled) -> None:
    """Undo one `install`. The last one brings back what was there before. Raises ValueError for
    what is not installed."""
    global _installed, _previous
    with _lock:
        left = list(_installed)
        places = [i for i, other in enumerate(left) if other is coupled]
        if not places:
            raise ValueError("this Buoyancy is not installed; install() it first")
        del left[places[-1]]
        _installed = tuple(left)
        if not left and mujoco.get_mjcb_passive() is _callback:
            mujoco.set_mjcb_passive(_previous)
            _previous = None


def is_other_set() -> bool:
    """Whether the user has a passive callback of his own, before ours or alone."""
    current = mujoco.get_mjcb_passive()
    return _previous is not None if current is _callback else current is not None


def is_alone(coupled: Coupled) -> bool:
    """Whether nobody else is installed for the same model."""
    return sum(other.model is coupled.model for other in _installed) == 1


def found(model: mujoco.MjModel) -> list[Coupled]:
    """Who is installed for a model, the latest first: for itself, else, if it is a copy, for the
    one that it is a copy of. Raises ValueError for a copy of several."""
    installed = _installed[::-1]
    own = [coupled for coupled in installed if coupled.model is model]
    if own:
        return own
    copied = [coupled for coupled in installed if coupled.is_copy(model)]
    count = len({id(coupled.model) for coupled in copied})
    if count > 1:
        raise ValueError(
            f"this model is a copy of {count} models that are installed, and which of them "
            "is not known; make a Buoyancy of its own with Buoyancy.from_model(model)"
        )
    return copied


def _callback(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    previous = _previous
    if previous is not None:
        if isinstance(previous, ctypes._CFuncPtr):
            previous(model._address, data._address)
        else:
            previous(model, data)
    installed = _installed
    if len(installed) == 1 and installed[0].model is model:  # the usual case, in a hurry
        installed[0].write(model, data)
        return
    for i, coupled in enumerate(found(model)):
        if i == 0:
            coupled.write(model, data)
        else:  # an outer block of the same model
            coupled.note(data)
