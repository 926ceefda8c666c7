"""Methods: ways to turn (hull, sea, pose, time) into a wrench, one a file, all called alike.

    method = Linear(hull, sea)
    method.wrench(position, rotation, time)     # (6,) force [N], torque [N m], world axes

Scenes and command lines name a method by a text, its own settings behind colons:

    linear
    chord[:samples][:crests]     chord:8, chord:4:crests (crests only)
    patches[:tolerance]          m of water height
    reference[:tolerance]        of density * gravity * volume
"""

from sim.hulls.hull import Hull
from sim.methods.chord import Chord
from sim.methods.linear import Linear
from sim.methods.method import Batch, Method, Place, Settings
from sim.methods.patches.patches import Patches
from sim.methods.reference import Reference
from sim.water.sea import Sea

METHODS: dict[str, type[Method]] = {
    "linear": Linear,
    "chord": Chord,
    "patches": Patches,
    "reference": Reference,
}
"""The class that each name in a scene or on a command line stands for; add your own."""


def make_method(text: str, hull: Hull, sea: Sea, settings: Settings | None = None) -> Method:
    """The method that a text names, for a hull in a sea. Its own settings overrule `settings`.

    Raises ValueError for a text that names none.
    """
    name, *arguments = text.split(":")
    if name not in METHODS:
        raise ValueError(f"'{text}' is no method; expected one of: {', '.join(METHODS)}")
    try:
        return METHODS[name].from_text(hull, sea, settings or Settings(), arguments)
    except ValueError as error:
        raise ValueError(f"method '{text}': {error}") from None


__all__ = [
    "METHODS",
    "Batch",
    "Chord",
    "Linear",
    "Method",
    "Patches",
    "Place",
    "Reference",
    "Settings",
    "make_method",
]
