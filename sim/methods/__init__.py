"""Methods: ways to turn (hull, sea, pose, time) into a wrench, one a file, all called alike.

    method = Linear(hull, sea)
    method.wrench(position, rotation, time)     # (6,) force [N], torque [N m], world axes

Scenes and command lines name a method by a text, its own settings behind colons:

    linear
    chord[:samples][:crests]     chord:8, chord:4:crests (crests only)
    patches[:tolerance]          m of water height
    reference[:tolerance]        of density * gravity * volume
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.hull import Hull
from sim.methods.chord import Chord
from sim.methods.linear import Linear
from sim.methods.patches import Patches, PatchFleet
from sim.methods.reference import Reference
from sim.sea import Sea


class Method(Protocol):
    """What every method offers: the hull and sea it was made for and the wrench."""

    hull: Hull
    sea: Sea

    def wrench(
        self, position: ArrayLike, rotation: ArrayLike, time: float
    ) -> NDArray[np.float64]: ...


@dataclass(frozen=True)
class Settings:
    """What a scene says for all its methods; one that has no use for a setting ignores it.

    tolerance [m of water height], None for the method's own default; chord_samples: points of
    a chord."""

    tolerance: float | None = None
    chord_samples: int = 4


def make_method(text: str, hull: Hull, sea: Sea, settings: Settings | None = None) -> Method:
    """The method that a text names, for a hull in a sea. Its own settings overrule `settings`.

    Raises ValueError for a text that names none.
    """
    name, *arguments = text.split(":")
    if name not in MAKERS:
        raise ValueError(f"'{text}' is no method; expected one of: {', '.join(MAKERS)}")
    try:
        return MAKERS[name](hull, sea, settings or Settings(), arguments)
    except ValueError as error:
        raise ValueError(f"method '{text}': {error}") from None


def _linear(hull: Hull, sea: Sea, settings: Settings, arguments: list[str]) -> Linear:
    _expect_at_most(0, arguments)
    return Linear(hull, sea)


def _chord(hull: Hull, sea: Sea, settings: Settings, arguments: list[str]) -> Chord:
    crests_only = arguments[-1:] == ["crests"]
    numbers = arguments[:-1] if crests_only else arguments
    _expect_at_most(1, numbers)
    samples = int(numbers[0]) if numbers else settings.chord_samples
    return Chord(hull, sea, samples, crests_only)


def _patches(hull: Hull, sea: Sea, settings: Settings, arguments: list[str]) -> Patches:
    _expect_at_most(1, arguments)
    return Patches(hull, sea, float(arguments[0]) if arguments else settings.tolerance)


def _reference(hull: Hull, sea: Sea, settings: Settings, arguments: list[str]) -> Reference:
    _expect_at_most(1, arguments)
    return Reference(hull, sea, *map(float, arguments))


def _expect_at_most(count: int, arguments: list[str]) -> None:
    if len(arguments) > count:
        raise ValueError(f"found {len(arguments)} settings, expected at most {count}")


MAKERS: dict[str, Callable[[Hull, Sea, Settings, list[str]], Method]] = {
    "linear": _linear,
    "chord": _chord,
    "patches": _patches,
    "reference": _reference,
}

__all__ = [
    "MAKERS",
    "Chord",
    "Linear",
    "Method",
    "PatchFleet",
    "Patches",
    "Reference",
    "Settings",
    "make_method",
]
