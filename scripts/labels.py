"""Labels: short names of methods in comparisons, with a setting and a pressure.

linear    chord:4    patches:8e-4    reference:1e-6    patches/hydrostatic
"""

from sim import Hull, Sea
from sim.methods import Chord, Method, Settings, make_method
from sim.mjcf.fields import METHOD, PRESSURE, TOLERANCE

NUMBER_FIELDS = {"chord": "chord_samples", "patches": TOLERANCE, "reference": "reference_tolerance"}
"""The field of a label's number, by method."""


def fields_of(label: str) -> dict[str, str]:
    """The fields of a scene for a label. Raises ValueError."""
    text, _, pressure = label.partition("/")
    name, colon, number = text.partition(":")
    if colon and name not in NUMBER_FIELDS:
        raise ValueError(f"'{label}': {name} takes no number; expected METHOD[:NUMBER][/PRESSURE]")
    fields = {METHOD: name}
    if colon:
        fields[NUMBER_FIELDS[name]] = number
    if pressure:
        fields[PRESSURE] = pressure
    return fields


def labelled_method(label: str, hull: Hull, sea: Sea) -> Method:
    """The method of a label. `chord:4:crests` is the biased variant of `chord`, which ignores
    troughs. Raises ValueError."""
    text, _, variant = label.rpartition(":")
    if variant == "crests":
        return Chord(hull, sea, int(text.removeprefix("chord:")), crests_only=True)
    fields = fields_of(label)
    name, pressure = fields.pop(METHOD), fields.pop(PRESSURE, sea.pressure)
    kinds = {"chord_samples": int}
    numbers = {field: kinds.get(field, float)(number) for field, number in fields.items()}
    return make_method(name, hull, sea.with_pressure(pressure), Settings(**numbers))
