"""Settings: what overrules the custom fields of a scene, as a command line has it.

wave_swell=0.2 4 0 0        a numeric's numbers, of the scene's or a new one
wave_swell.amplitude=0.2    one of them, by its name with _ for blanks
buoyancy_method=linear      a text
seed=3                      the seed of all irregular seas
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sim.mjcf.custom_fields import check_numeric, is_text, numeric_kind
from sim.mjcf.faults import Faults
from sim.mjcf.numbers import NumericKind

SEED = "seed"


def overrule(
    settings: Iterable[str],
    numerics: dict[str, NDArray[np.float64]],
    texts: dict[str, str],
    faults: Faults,
) -> None:
    """Put settings into a scene's numerics and texts; those that cannot be are faults."""
    for setting in settings:
        with faults.collected():
            name, equals, value = setting.partition("=")
            name, value = name.strip(), value.strip()
            if not equals or not name or not value:
                raise ValueError(f"setting '{setting}': expected NAME=VALUE")
            if is_text(name) and not _is_numbers(value):
                texts[name] = value
                continue
            try:
                for numeric, values in _changed(name, value, numerics):
                    check_numeric(numeric, values)
                    numerics[numeric] = values
            except ValueError as error:
                raise ValueError(f"setting '{setting}': {error}") from None


def _changed(
    name: str, value: str, numerics: dict[str, NDArray[np.float64]]
) -> list[tuple[str, NDArray[np.float64]]]:
    """Names and numbers of the numerics that a setting changes."""
    try:
        numbers = np.array([float(word) for word in value.replace(",", " ").split()])
    except ValueError:
        raise ValueError(f"'{value}' is not a row of numbers") from None
    base, dot, part = name.partition(".")
    if name == SEED:
        seas = [n for n in numerics if (k := numeric_kind(n)) and SEED in _names(k)]
        if not seas:
            raise ValueError("the scene has no irregular sea (sea_<name>) that takes a seed")
        return [(sea, _with(numerics[sea], sea, SEED, numbers)) for sea in seas]
    if not dot:
        return [(name, numbers)]
    if base not in numerics:
        raise ValueError(f"the scene has no numeric '{base}'; it has {', '.join(numerics) or '-'}")
    return [(base, _with(numerics[base], base, part, numbers))]


def _with(
    values: NDArray[np.float64], name: str, part: str, numbers: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The numbers of a numeric with another one for the part of a name."""
    kind = numeric_kind(name)
    names = _names(kind)
    if part not in names or numbers.size != 1 or kind.of_one:
        raise ValueError(f"'{name}' has the parts {', '.join(names)}, each of one number")
    filled = np.array(kind.filled(values))
    filled[names.index(part)] = numbers[0]
    return filled


def _names(kind: NumericKind) -> list[str]:
    return [number.name.replace(" ", "_") for number in kind.numbers]


def _is_numbers(value: str) -> bool:
    try:
        [float(word) for word in value.split()]
    except ValueError:
        return False
    return True
