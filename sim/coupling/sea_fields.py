"""Sea fields: the water that a model's custom fields describe."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling.custom_fields import IRREGULAR_SEA, PRESSURE
from sim.coupling.faults import Faults
from sim.water.sea import DEFAULT_PRESSURE, Sea
from sim.water.spectrum import jonswap
from sim.water.wave import Wave

Numerics = Mapping[str, NDArray[np.float64]]
Texts = Mapping[str, str]

SEA_WATER_DENSITY = 1025.0  # kg/m^3, at 15 degrees C and 35 g/kg of salt

WATERS = ("water", "wave_", "sea_")
"""How the elements begin that describe the water."""


def sea_of(
    model: mujoco.MjModel,
    parts: Sequence[tuple[str, Numerics, Texts]],
    pressure: str | None,
    faults: Faults,
) -> Sea | None:
    """The sea of a model of several parts, each with its prefix: the one that all of those have
    which say anything about the water; None where there is a fault. pressure overrules them."""
    found: dict[str, Sea] = {}
    for prefix, numerics, texts in parts:
        says = any(name.startswith(WATERS) for name in (*numerics, *texts))
        if says or len(parts) == 1:
            with faults.collected():
                asked = pressure or texts.get(PRESSURE, DEFAULT_PRESSURE)
                found[prefix] = _read_sea(model, numerics, asked, faults)
    if not found and not faults.found:
        return Sea(
            (), SEA_WATER_DENSITY, -float(model.opt.gravity[2]), 0.0, pressure or DEFAULT_PRESSURE
        )
    seas = list(found.items())
    for prefix, sea in seas[1:]:
        if sea != seas[0][1]:
            with faults.collected():
                raise ValueError(
                    f"two different seas: that of {_whose(seas[0][0])} and that of "
                    f"{_whose(prefix)}; give both the same custom water, wave and sea elements, "
                    "or take those of one away"
                )
    return seas[0][1] if seas else None


def _whose(prefix: str) -> str:
    return f"what was attached as '{prefix}'" if prefix else "the model itself"


def _read_sea(model: mujoco.MjModel, numerics: Numerics, pressure: str, faults: Faults) -> Sea:
    gravity = abs(float(model.opt.gravity[2])) or 9.81  # else a fault of its own
    waves: list[Wave] = []
    irregular: list[Wave] = []
    for name, values in numerics.items():
        with faults.collected():
            try:
                if name == IRREGULAR_SEA:
                    heading_and_spread = np.radians(values[3:5])
                    shape = [*values[:3], *heading_and_spread, *values[5:]]
                    irregular = list(jonswap(*map(float, shape), gravity=gravity))
                elif name.startswith("wave_"):
                    waves.append(Wave(*values[:2], *np.radians(values[2:])))
            except ValueError as error:
                raise ValueError(f"custom numeric '{name}': {error}") from None
    density = float(numerics.get("water_density", [SEA_WATER_DENSITY])[0])
    levels = numerics.get("water_level", [0.0])
    level, tide = (float(levels[0]), ()) if len(levels) == 1 else (0.0, np.reshape(levels, (-1, 2)))
    current = numerics.get("water_current", (0.0, 0.0))
    ramp = float(numerics.get("water_ramp", [0.0])[0])
    return Sea([*waves, *irregular], density, gravity, level, pressure, current, ramp, tide)
