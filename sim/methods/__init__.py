"""Methods: ways to turn (hull, sea, pose, time) into a wrench, one per file, with one interface.

    method = Linear(hull, sea)
    method.wrench(position, rotation, time)     # (6,) force [N], torque [N m], world axes

A scene names its method in the text `buoyancy_method`.
"""

from sim.hulls.hull import Hull
from sim.methods.chord import Chord
from sim.methods.linear import Linear
from sim.methods.method import Method, Settings
from sim.methods.patches.patches import Patches
from sim.methods.reference import Reference
from sim.water.sea import Sea

METHODS: dict[str, type[Method]] = {
    "linear": Linear,
    "chord": Chord,
    "patches": Patches,
    "reference": Reference,
}
"""The class of each method that a scene can name. Add your own here."""


def make_method(name: str, hull: Hull, sea: Sea, settings: Settings | None = None) -> Method:
    """The method with a given name for a hull in a sea. Raises ValueError for an unknown name and
    for settings that the method does not accept."""
    if name not in METHODS:
        raise ValueError(f"'{name}' is not a method; expected one of: {', '.join(METHODS)}")
    try:
        return METHODS[name].from_settings(hull, sea, settings or Settings())
    except ValueError as error:
        raise ValueError(f"method '{name}': {error}") from None


__all__ = [
    "METHODS",
    "Chord",
    "Linear",
    "Method",
    "Patches",
    "Reference",
    "Settings",
    "make_method",
]
