"""Sea fields: makes a sea from a model's custom fields, and the fields from a sea."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.mjcf.elements import numbers_of
from sim.mjcf.faults import Faults
from sim.mjcf.fields import (
    COMPONENTS,
    NUMERICS,
    PRESSURE,
    RECORD,
    WATER_PREFIXES,
    Numbers,
    numeric_base,
)
from sim.water.records import read_components, read_record
from sim.water.sea import DEFAULT_PRESSURE, Sea
from sim.water.spectrum import bretschneider, jonswap, ochi_hubble, pierson_moskowitz
from sim.water.wave import Wave

Numerics = Mapping[str, NDArray[np.float64]]
Texts = Mapping[str, str]

SPECTRA = {
    "sea_jonswap": jonswap,
    "sea_bretschneider": bretschneider,
    "sea_pierson_moskowitz": pierson_moskowitz,
    "sea_ochi_hubble": ochi_hubble,
}
"""The spectrum of each irregular sea. The last DIVISION_NUMBERS numbers of the field say how it is
divided into waves; the others are arguments of the spectrum."""

DIVISION_NUMBERS = 4


def sea_of(
    model: mujoco.MjModel,
    sections: Sequence[tuple[str, Numerics, Texts]],
    faults: Faults,
) -> Sea | None:
    """The one sea that all sections with water fields agree on; the default sea if none has any;
    None if no section can be read. sections: prefix, numerics and texts of each."""
    with_water = [
        (prefix, numerics, texts)
        for prefix, numerics, texts in sections
        if any(name.startswith(WATER_PREFIXES) for name in (*numerics, *texts))
    ]
    seas: list[tuple[str, Sea]] = []
    for prefix, numerics, texts in with_water or [("", {}, {})]:
        with faults.collected():
            seas.append((prefix, _read_sea(model, numerics, texts, faults)))
    for prefix, sea in seas[1:]:
        if sea != seas[0][1]:
            with faults.collected():
                raise ValueError(
                    f"{_owner(seas[0][0])} and {_owner(prefix)} define two different seas; give "
                    "both the same custom water, wave and sea elements, or remove them from one"
                )
    return seas[0][1] if seas else None


def _owner(prefix: str) -> str:
    return f"the model attached as '{prefix}'" if prefix else "the model itself"


def _read_sea(model: mujoco.MjModel, numerics: Numerics, texts: Texts, faults: Faults) -> Sea:
    gravity = abs(float(model.opt.gravity[2])) or 9.81  # no gravity is a fault already
    (depth,) = numbers_of("water_depth", numerics)
    waves: list[Wave] = []
    for name, values in numerics.items():
        with faults.collected():
            try:
                if name in SPECTRA:
                    waves += _irregular(name, _in_radians(name, values), gravity, depth)
                elif name.startswith("wave_"):
                    waves.append(Wave(*_in_radians(name, values)))
            except ValueError as error:
                raise ValueError(f"custom numeric '{name}': {error}") from None
    with faults.collected():
        waves += _from_files(numerics, texts, gravity, depth)
    (density,) = numbers_of("water_density", numerics)
    levels = numbers_of("water_level", numerics)
    level, tide = (levels[0], ()) if len(levels) == 1 else (0.0, np.reshape(levels, (-1, 2)))
    current = numbers_of("water_current", numerics)
    (ramp,) = numbers_of("water_ramp", numerics)
    pressure = texts.get(PRESSURE, DEFAULT_PRESSURE)
    (stokes,) = numbers_of("water_stokes", numerics)
    return Sea(waves, density, gravity, level, pressure, current, ramp, tide, depth, bool(stokes))


def _irregular(name: str, numbers: list[float], gravity: float, depth: float) -> tuple[Wave, ...]:
    """The waves of an irregular sea."""
    arguments, division = numbers[:-DIVISION_NUMBERS], numbers[-DIVISION_NUMBERS:]
    if name == "sea_pierson_moskowitz":  # its period follows from gravity
        arguments = [*arguments, gravity]
    return SPECTRA[name](*arguments).waves(*division, gravity, depth)


def _from_files(numerics: Numerics, texts: Texts, gravity: float, depth: float) -> list[Wave]:
    """The waves in the files that texts name."""
    waves: list[Wave] = []
    for name in (name for name in (COMPONENTS, RECORD) if name in texts):
        path = Path(texts[name])
        try:
            if not path.is_file():
                raise ValueError(
                    f"there is no file {path.absolute()}; Scene.load searches beside the MJCF "
                    "file, MuJoCo's compiler in the current folder: give a full path"
                )
            if name == COMPONENTS:
                waves += read_components(path, gravity, depth)
            else:
                numbers = _in_radians(RECORD, numerics.get(RECORD, ()))
                heading, shortest, longest, x, y = numbers
                waves += read_record(path, gravity, heading, (shortest, longest), (x, y), depth)
        except (ValueError, OSError) as error:
            raise ValueError(f"custom text '{name}': {error}") from None
    if RECORD in numerics and RECORD not in texts:
        raise ValueError(f"custom numeric '{RECORD}' needs a text of the same name; add it")
    return waves


def _in_radians(name: str, values: Numbers) -> list[float]:
    """All numbers of a numeric, with angles in radians."""
    field = NUMERICS[numeric_base(name) or name]
    return [
        float(np.radians(value)) if number.unit == "deg" else value
        for number, value in zip(field.numbers, field.filled(values), strict=True)
    ]


def fields_of(sea: Sea) -> dict[str, ArrayLike | str]:
    """The fields, by name, that describe a sea, to the round-off of angles in degrees."""
    fields: dict[str, ArrayLike | str] = {
        "water_density": [sea.density],
        "water_level": np.ravel(sea.tide) if sea.tide else [sea.level],
        "water_current": sea.current,
        "water_ramp": [sea.ramp],
        "water_stokes": [float(sea.stokes)],
        PRESSURE: sea.pressure,
    }
    if sea.depth < np.inf:
        fields["water_depth"] = [sea.depth]
    for i, wave in enumerate(sea.waves):
        heading, phase = np.degrees([wave.heading, wave.phase]).tolist()
        fields[f"wave_{i}"] = [wave.amplitude, wave.wavelength, heading, phase]
    return fields
