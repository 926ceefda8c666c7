"""Custom fields: the elements of a model's `<custom>` that concern the water.

    numeric water_density             kg/m^3                           (1025, sea water)
    numeric water_level               m                                (0)
    numeric wave_<name>               amplitude m, wavelength m, heading deg, phase deg
    numeric sea_jonswap               significant height m, peak period s, gamma, heading deg,
                                      spread deg, waves, seed; all after the period may be left
                                      out (see Sea.jonswap)
    text    water_pressure            froude-krylov or hydrostatic     (see sim/water/head)
    text    buoyancy_method           how wrenches are computed        (see sim.methods)
    text    buoyancy_method_<geom>    the same for one geom
    numeric buoyancy_tolerance        m of water height, for methods that take one
    numeric buoyancy_threads          threads that share the hulls   (1)
    numeric chord_samples             points of a chord, for the method chord
    numeric drag                      linear, form, friction                   (see resistance/drag)
    numeric drag_<geom>               the same for one geom
    numeric drag_angular              1/s, decay of the angular momentum
    numeric drag_angular_<geom>       the same for one geom
    numeric added_mass                6 coefficients or a 6 x 6 matrix         (see resistance/drag)
    numeric added_mass_<geom>         the same for one geom
    numeric damping                   N s/m and N m s along and about the axes of the body's
                                      inertial frame, or a 6 x 6 matrix, relative to the water
    numeric damping_<geom>            the same for one geom
    tuple   buoyant                   the geoms whose surface is a hull

A name that begins as ours do and is none of these is a typing error, and refused.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OWN_PREFIXES = ("water", "wave", "sea_", "buoyan", "chord_", "drag_", "added_mass", "damping")
"""Custom elements that begin so are ours: one we do not know is a typing error, not ignored."""

IRREGULAR_SEA = "sea_jonswap"

METHOD = "buoyancy_method"
"""The text that names a method; '<METHOD>_<geom>' one geom's own."""

PRESSURE = "water_pressure"
"""The text that names the pressure under waves."""


def elements_of(
    model: mujoco.MjModel, kind: mujoco.mjtObj, count: int
) -> Iterator[tuple[int, str]]:
    """Index and name of the custom elements of one kind that are ours."""
    for i in range(count):
        name = mujoco.mj_id2name(model, kind, i) or ""
        if name.startswith(OWN_PREFIXES) or name == "drag":
            yield i, name


def refuse_unknown(kind: str, name: str, known: str) -> None:
    raise ValueError(f"custom {kind} '{name}' is unknown; expected {known}: correct or rename it")


@dataclass(frozen=True)
class NumericKind:
    """What a custom numeric of ours holds: how many numbers, what they mean, and whether a geom
    may have its own ('<name>_<geom>')."""

    sizes: tuple[int, ...]
    meaning: str
    per_geom: bool = False


WAVE = NumericKind((4,), "amplitude m, wavelength m, heading deg, phase deg")

NUMERICS = {
    "water_density": NumericKind((1,), "kg/m^3"),
    "water_level": NumericKind((1,), "m"),
    IRREGULAR_SEA: NumericKind(
        (2, 3, 4, 5, 6, 7),
        "significant height m, peak period s, gamma, heading deg, spread deg, waves, seed",
    ),
    "buoyancy_tolerance": NumericKind((1,), "m of water height"),
    "buoyancy_threads": NumericKind((1,), "threads that share the hulls"),
    "chord_samples": NumericKind((1,), "points of a chord"),
    "drag_angular": NumericKind((1,), "1/s", per_geom=True),
    "drag": NumericKind((3,), "linear, form, friction", per_geom=True),
    "added_mass": NumericKind((6, 36), "coefficients, or a matrix row by row", per_geom=True),
    "damping": NumericKind((6, 36), "N s/m and N m s, or a matrix row by row", per_geom=True),
}
"""The custom numerics we know, besides the waves; a name that begins another comes before it."""


def _numeric_kind(name: str) -> NumericKind | None:
    if name.startswith("wave_"):
        return WAVE
    base = base_of(name)
    return None if base is None else NUMERICS[base]


def base_of(name: str) -> str | None:
    """The known numeric that a name is, or is one geom's own of."""
    for base, kind in NUMERICS.items():
        if name == base or (kind.per_geom and name.startswith(f"{base}_")):
            return base
    return None


def numerics_of(model: mujoco.MjModel) -> dict[str, Array]:
    """Our numerics by name. Raises ValueError for one that is unknown or has another size."""
    found = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_NUMERIC, model.nnumeric):
        kind = _numeric_kind(name)
        if kind is None:
            known = [b + "[_<geom>]" * k.per_geom for b, k in NUMERICS.items()]
            refuse_unknown("numeric", name, f"{', '.join(known)} or wave_<name>")
        values = np.array(model.numeric(i).data)
        if values.size not in kind.sizes:
            several = len(kind.sizes) > 2
            expected = (" to " if several else " or ").join(
                map(str, (kind.sizes[0], kind.sizes[-1]) if several else kind.sizes)
            )
            raise ValueError(
                f"custom numeric '{name}' has {values.size} number{'s' * (values.size != 1)}; "
                f"expected {expected}: {kind.meaning}"
            )
        found[name] = values
    return found


def texts_of(model: mujoco.MjModel) -> dict[str, str]:
    """Our texts by name. Raises ValueError for one that is unknown."""
    found = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_TEXT, model.ntext):
        if name not in (METHOD, PRESSURE) and not name.startswith(f"{METHOD}_"):
            refuse_unknown(
                "text", name, "water_pressure, buoyancy_method or buoyancy_method_<geom>"
            )
        start = model.text_adr[i]
        raw = bytes(model.text_data[start : start + model.text_size[i]])
        found[name] = raw.split(b"\0")[0].decode().strip()
    return found


def check_geoms(kind: str, names: Iterable[str], geoms: Sequence[str]) -> None:
    """Refuse elements of a kind that are the own ones of other geoms than these."""
    for name in names:
        base = METHOD if name.startswith(METHOD) else base_of(name)
        if base in (None, name) or name.removeprefix(f"{base}_") in geoms:
            continue
        raise ValueError(
            f"custom {kind} '{name}' names no geom of the tuple 'buoyant' "
            f"(which has {', '.join(geoms)}); correct the name or list the geom"
        )


def of_geom(base: str, geom: str, found: Mapping[str, Any]) -> str:
    """The name of the element that holds for a geom: its own if there is one, else the scene's."""
    own = f"{base}_{geom}"
    return own if own in found else base
