"""Settings: the one way to override the custom fields of a scene.

    settings={"wave_swell": (0.2, 4, 0, 0), "buoyancy_method": "linear"}
    settings=["wave_swell=0.2 4 0 0", "buoyancy_method=linear"]        as on the command line
    wave_swell.amplitude=0.2        one number of a field, by its name with _ for blanks
    seed=3                          the seed of every irregular sea

A name may begin with the prefix of an attached model: "boat/buoyancy_method".
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.mjcf.elements import prefixes_of
from sim.mjcf.faults import Faults
from sim.mjcf.fields import (
    COMPONENTS,
    NUMERICS,
    RECORD,
    TEXTS,
    WATER_PREFIXES,
    check_numeric,
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
    """Change the custom fields of a spec. A file that a setting names is looked for in the current
    folder. Raises ModelError with all settings that cannot be followed."""
    if isinstance(settings, Mapping):
        given = [(f"field '{name}'", name, value) for name, value in settings.items()]
    else:
        given = [
            (f"setting '{text}'", *map(str.strip, text.partition("=")[::2])) for text in settings
        ]
    faults, changes = Faults(), _Changes(spec)
    prefixes = prefixes_of(each.name for each in spec.tuples)
    for said, name, value in given:
        with faults.collected():
            if not name or (isinstance(value, str) and not value):
                raise ValueError(f"{said}: expected NAME=VALUE")
            prefix = next((p for p in prefixes[::-1] if name.startswith(p)), "")
            try:
                changes.add(prefix, name.removeprefix(prefix), value)
            except ValueError as error:
                raise ValueError(f"{said}: {error}") from None
    faults.refuse()
    changes.write()


def set_sea(spec: mujoco.MjSpec, sea: Sea) -> None:
    """Replace all fields of a spec that describe water by those of a sea. Raises ValueError for a
    sea with another gravity than the model's."""
    gravity = -float(spec.option.gravity[2])
    if sea.gravity != gravity:
        raise ValueError(
            f"the sea's gravity is {sea.gravity:g} and the model's {gravity:g} m/s^2; make the sea "
            "with the model's"
        )
    prefixes = prefixes_of(each.name for each in spec.tuples)
    water = tuple(prefix + each for prefix in prefixes for each in WATER_PREFIXES)
    for element in [*spec.numerics, *spec.texts]:
        if element.name.startswith(water) and element.name != "water_drawn":
            spec.delete(element)
    override(spec, fields_of(sea))


class _Changes:
    """Changes to the fields of a spec, which `write` puts there once all of them are known."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self._numerics = {numeric.name: _numbers_of(numeric) for numeric in spec.numerics}
        self._changed: dict[str, Array] = {}
        self._texts: dict[str, str] = {}

    def add(self, prefix: str, name: str, value: ArrayLike | str) -> None:
        """Change a text, a numeric, or one number of a numeric. Raises ValueError."""
        base, dot, part = name.partition(".")
        if name == SEED:
            seas = [n for n in self._numerics if SEED in _parts(n)]
            if not seas:
                raise ValueError("the scene has no irregular sea (sea_<name>) that takes a seed")
            for sea in seas:
                self._set("", sea, _with_part(self._numerics[sea], sea, SEED, value))
        elif dot:
            known = [n.removeprefix(prefix) for n in self._numerics if n.startswith(prefix)]
            if base not in known:
                has = ", ".join(known) or "none"
                raise ValueError(f"the scene has no numeric '{base}'; it has {has}")
            self._set(prefix, base, _with_part(self._numerics[prefix + base], base, part, value))
        elif _is_text(name, value):
            is_path = name in (COMPONENTS, RECORD)
            self._texts[prefix + name] = str(Path(value).absolute()) if is_path else value
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
    """Whether a setting is for a text. `sea_record` is a text and a numeric: a row of numbers is
    for the numeric."""
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


def _with_part(values: Array, name: str, part: str, value: ArrayLike | str) -> Array:
    """The numbers of a numeric with another value for the one that `part` names."""
    parts, numbers = _parts(name), _row(value)
    if part not in parts or numbers.size != 1:
        raise ValueError(f"'{name}' has the parts {', '.join(parts)}, each of one number")
    filled = np.array(NUMERICS[numeric_base(name)].filled(values))
    filled[parts.index(part)] = numbers[0]
    return filled


def _parts(name: str) -> list[str]:
    """Names of the numbers of a numeric, as settings write them."""
    base = numeric_base(name)
    field = None if base is None else NUMERICS[base]
    if field is None or field.counts:
        return []
    return [number.name.replace(" ", "_") for number in field.numbers]


def _numbers_of(numeric: mujoco.MjsNumeric) -> Array:
    values = np.zeros(max(numeric.size, len(numeric.data)))
    values[: len(numeric.data)] = numeric.data
    return values
