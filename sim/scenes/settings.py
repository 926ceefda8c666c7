"""Settings: the one way to override the custom fields of a scene.

    settings={"wave_swell": (0.2, 4, 0, 0), "buoyancy_method": "linear"}
    settings=["wave_swell=0.2 4 0 0", "buoyancy_method=linear"]        as on the command line
    wave_swell.amplitude=0.2        one number of a field, by its name with _ for spaces
    seed=3                          the seed of every irregular sea

A name may begin with the prefix of an attached model: "boat/buoyancy_method".
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.mjcf.elements import prefixes_of
from sim.mjcf.faults import Faults
from sim.mjcf.fields import (
    NUMERICS,
    TEXTS,
    WATER_PREFIXES,
    check_numeric,
    names_file,
    numeric_base,
    refuse_unknown,
    text_base,
)
from sim.mjcf.sea_fields import fields_of
from sim.water.sea import Sea

Array = NDArray[np.float64]
Settings = Mapping[str, ArrayLike | str] | Iterable[str]

SEED = "seed"


def override(spec: mujoco.MjSpec, settings: Settings) -> None:
    """Change the custom fields of a spec. Paths in settings are relative to the current folder.
    Raises ModelError with the faults of all settings."""
    if isinstance(settings, Mapping):
        given = [(f"field '{name}'", name, value) for name, value in settings.items()]
    else:
        given = [
            (f"setting '{text}'", *map(str.strip, text.partition("=")[::2])) for text in settings
        ]
    prefixes = prefixes_of(listing.name for listing in spec.tuples)
    faults, changes = Faults(), _Changes(spec, prefixes)
    for label, name, value in given:
        with faults.collected():
            if not name or (isinstance(value, str) and not value):
                raise ValueError(f"{label}: expected NAME=VALUE")
            prefix = next((p for p in prefixes[::-1] if name.startswith(p)), "")
            try:
                changes.add(prefix, name.removeprefix(prefix), value)
            except ValueError as error:
                raise ValueError(f"{label}: {error}") from None
    faults.refuse()
    changes.write()


def set_sea(spec: mujoco.MjSpec, sea: Sea) -> None:
    """Replace all fields of a spec that describe the water by the fields of a sea. Raises
    ValueError if the sea's gravity is not the model's."""
    gravity = -float(spec.option.gravity[2])
    if sea.gravity != gravity:
        raise ValueError(
            f"the sea's gravity is {sea.gravity:g} and the model's {gravity:g} m/s^2; make the sea "
            "with the model's"
        )
    prefixes = prefixes_of(listing.name for listing in spec.tuples)
    beginnings = tuple(prefix + water for prefix in prefixes for water in WATER_PREFIXES)
    for element in [*spec.numerics, *spec.texts]:
        if element.name.startswith(beginnings) and element.name != "water_drawn":
            spec.delete(element)
    override(spec, fields_of(sea))


class _Changes:
    """Changes to the fields of a spec, which `write` makes."""

    def __init__(self, spec: mujoco.MjSpec, prefixes: Sequence[str]) -> None:
        self._spec, self._prefixes = spec, prefixes
        self._numerics = {numeric.name: _numbers_of(numeric) for numeric in spec.numerics}
        self._changed: dict[str, Array] = {}
        self._texts: dict[str, str] = {}

    def add(self, prefix: str, name: str, value: ArrayLike | str) -> None:
        """Change a text, a numeric, or one number of a numeric. Raises ValueError."""
        field, dot, number = name.partition(".")
        if name == SEED:
            seas = [
                (p, sea)
                for p in self._prefixes
                for sea in (n.removeprefix(p) for n in self._numerics if n.startswith(p))
                if SEED in _number_names(sea)
            ]
            if not seas:
                raise ValueError("the scene has no irregular sea (sea_<name>) that takes a seed")
            for p, sea in seas:
                self._set(p, sea, _with_number(self._numerics[p + sea], sea, SEED, value))
        elif dot:
            known = [n.removeprefix(prefix) for n in self._numerics if n.startswith(prefix)]
            if field not in known:
                has = ", ".join(known) or "none"
                raise ValueError(
                    f"the scene has no numeric '{field}'; it has {has}: set all numbers of "
                    f"'{field}' at once"
                )
            values = self._numerics[prefix + field]
            self._set(prefix, field, _with_number(values, field, number, value))
        elif _is_text(name, value):
            path = Path(str(value)).absolute() if names_file(name) else value
            self._texts[prefix + name] = str(path)
        elif numeric_base(name) is None:
            refuse_unknown("field", name, ", ".join([*NUMERICS, *TEXTS]))
        else:
            self._set(prefix, name, _row(value))

    def _set(self, prefix: str, name: str, values: Array) -> None:
        check_numeric(name, values)
        self._numerics[prefix + name] = self._changed[prefix + name] = values

    def write(self) -> None:
        """Put the changes into the spec; new fields come last."""
        for name, values in self._changed.items():
            element = self._spec.numeric(name) or self._spec.add_numeric(name=name)
            element.size, element.data = len(values), values.tolist()
        for name, text in self._texts.items():
            element = self._spec.text(name) or self._spec.add_text(name=name)
            element.data = text


def _is_text(name: str, value: ArrayLike | str) -> bool:
    """Whether a setting changes a text. `sea_record` is both a text and a numeric; a row of numbers
    changes the numeric."""
    if text_base(name) is None:
        return False
    if numeric_base(name) is None:
        if not isinstance(value, str):
            raise ValueError(f"it takes a text, not {value}")
        return True
    try:
        _row(value)
    except ValueError:
        return True
    return False


def _row(value: ArrayLike | str) -> Array:
    """Numbers (N,) from numbers or a text of numbers. Raises ValueError."""
    words = value.replace(",", " ").split() if isinstance(value, str) else value
    try:
        return np.atleast_1d(np.asarray(words, dtype=float)).ravel()
    except (TypeError, ValueError):
        raise ValueError(f"'{value}' is not a row of numbers") from None


def _with_number(values: Array, field: str, number: str, value: ArrayLike | str) -> Array:
    """The numbers of a numeric field, with another value for one of them."""
    names, row = _number_names(field), _row(value)
    if number not in names or row.size != 1:
        raise ValueError(f"'{field}' has the numbers {', '.join(names)}; set one to one number")
    filled = np.array(NUMERICS[numeric_base(field) or field].filled(values))
    filled[names.index(number)] = row[0]
    return filled


def _number_names(field: str) -> list[str]:
    """Names of the numbers of a numeric field, as settings write them."""
    base = numeric_base(field)
    if base is None or NUMERICS[base].counts:
        return []
    return [number.name.replace(" ", "_") for number in NUMERICS[base].numbers]


def _numbers_of(numeric: mujoco.MjsNumeric) -> Array:
    values = np.zeros(max(numeric.size, len(numeric.data)))
    values[: len(numeric.data)] = numeric.data
    return values
