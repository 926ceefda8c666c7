"""Custom fields: the elements of a model's `<custom>` that concern the water.

    numeric water_density             kg/m^3                           (1025, sea water)
    numeric water_level               m, or pairs of time s and level m, with straight lines between
                                      them                             (0)
    numeric water_current             m/s, 2 or 3 numbers: the waves ride on it   (0 0)
    numeric water_ramp                s in which the waves grow from nothing      (0)
    numeric wave_<name>               amplitude m, wavelength m, heading deg, phase deg
    numeric sea_jonswap               significant height m, peak period s, gamma (3.3), heading deg
                                      (0), spread deg (25), waves (40), seed (0); all after the
                                      period may be left out (see Sea.jonswap)
    numeric sea_bretschneider         the same without gamma
    numeric sea_pierson_moskowitz     the same without the period
    numeric sea_ochi_hubble           height m, period s, sharpness of the swell, then of the wind
                                      sea, heading deg and so on
    text    sea_components            a CSV file beside the MJCF file: amplitude m, wavelength m or
                                      period s, heading deg, phase deg     (see sim/water/measured)
    text    sea_record                a CSV file of time s and elevation m at a place
    numeric sea_record                its heading deg, shortest and longest period s (1 60), place x
                                      and y m (0 0)
    numeric water_drawn               0: MuJoCo's own pictures show no water      (1)
    text    water_pressure            froude-krylov or hydrostatic     (see sim/water/head)
    text    buoyancy_method           how wrenches are computed        (see sim.methods)
    text    buoyancy_method_<geom>    the same for one geom
    numeric buoyancy_tolerance        m of water height, for methods that take one
    numeric buoyancy_threads          threads that share the hulls   (1)
    numeric buoyancy_union            0: hulls of one body that overlap stay apart   (1)
    numeric displaced_<geom>          the volume that it displaces, over that of its hull   (1)
    numeric chord_samples             points of a chord, for the method chord
    numeric drag                      linear, form, friction                   (see resistance/drag)
    numeric drag_<geom>               the same for one geom, or for a body and what hangs on it
    numeric drag_angular              1/s, decay of the angular momentum
    numeric drag_angular_<geom>       the same for one geom
    numeric added_mass                6 coefficients or a 6 x 6 matrix         (see resistance/drag)
    numeric added_mass_<geom>         the same for one geom
    numeric damping                   N s/m and N m s along and about the axes of the body's
                                      inertial frame, or a 6 x 6 matrix, relative to the water
    numeric damping_<geom>            the same for one geom
    tuple   buoyant                   the geoms whose surface is a hull; a body stands for all geoms
                                      of its subtree that collide, or all if none does

<geom> is a geom's name, or a body's, for all its subtree; the nearest holds. A geom without a name
is called '<body>/geom <n>', the first of a body 0. A name that begins as ours do and is none of
these is a typing error, and refused. Where MjSpec.attach put a prefix before the names of a model,
its tuple, settings and waves are taken as its own.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.mjcf.faults import Faults
from sim.mjcf.numbers import NUMERICS, WAVE, NumericKind

Array = NDArray[np.float64]

OWN_PREFIXES = (
    "water",
    "wave",
    "sea_",
    "buoyan",
    "chord_",
    "drag_",
    "added_mass",
    "damping",
    "displaced",
)
"""Custom elements that begin so are ours: one we do not know is a typing error, not ignored."""

BUOYANT = "buoyant"
"""The tuple that names what floats."""

COMPONENTS, RECORD = "sea_components", "sea_record"
"""The texts that name files."""

METHOD = "buoyancy_method"
"""The text that names a method; '<METHOD>_<geom>' one geom's own."""

PRESSURE = "water_pressure"
"""The text that names the pressure under waves."""


TEXTS = (PRESSURE, COMPONENTS, RECORD, METHOD)
"""The custom texts that we know, besides a geom's own method."""


def is_text(name: str) -> bool:
    """Whether a text of ours may have a name."""
    return name in TEXTS or name.startswith(f"{METHOD}_")


def custom_names(model: mujoco.MjModel, kind: mujoco.mjtObj) -> list[str]:
    """Names of all custom elements of one kind, by their index; "" for one without."""
    count = {
        mujoco.mjtObj.mjOBJ_NUMERIC: model.nnumeric,
        mujoco.mjtObj.mjOBJ_TEXT: model.ntext,
        mujoco.mjtObj.mjOBJ_TUPLE: model.ntuple,
    }[kind]
    return [mujoco.mj_id2name(model, kind, i) or "" for i in range(count)]


def prefixes(model: mujoco.MjModel) -> list[str]:
    """What stands before the names of each model that was attached and floats; "" for the model's
    own, which comes first."""
    names = custom_names(model, mujoco.mjtObj.mjOBJ_TUPLE)
    attached = [n.removesuffix(BUOYANT) for n in names if n.endswith(BUOYANT) and n != BUOYANT]
    return ["", *attached]


def elements_of(
    model: mujoco.MjModel, kind: mujoco.mjtObj, prefix: str = ""
) -> Iterator[tuple[int, str]]:
    """Index and name, behind a prefix, of the custom elements of one kind that are ours."""
    for i, whole in enumerate(custom_names(model, kind)):
        name = whole.removeprefix(prefix)
        is_ours = name.startswith(OWN_PREFIXES) or name == "drag"
        if whole.startswith(prefix) and is_ours:
            yield i, name


def refuse_unknown(kind: str, name: str, known: str) -> None:
    raise ValueError(f"custom {kind} '{name}' is unknown; expected {known}: correct or rename it")


def numeric_kind(name: str) -> NumericKind | None:
    """What a numeric of ours of a name holds, None for an unknown name."""
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


def numerics_of(model: mujoco.MjModel, prefix: str, faults: Faults) -> dict[str, Array]:
    """Our numerics by name; those that are unknown or have another size are faults."""
    found = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_NUMERIC, prefix):
        with faults.collected():
            values = np.array(model.numeric(i).data)
            check_numeric(name, values)
            found[name] = values
    return found


def known_numerics() -> str:
    """The names that our numerics may have."""
    names = [base + "[_<geom>]" * kind.per_geom for base, kind in NUMERICS.items()]
    return f"{', '.join(names)} or wave_<name>"


def known_texts() -> str:
    """The names that our texts may have."""
    return f"{', '.join(TEXTS)} or {METHOD}_<geom>"


def check_numeric(name: str, values: Array) -> None:
    """Raises ValueError for a name that is unknown and for numbers that cannot be."""
    kind = numeric_kind(name)
    if kind is None:
        refuse_unknown("numeric", name, known_numerics())
    try:
        kind.check_count(values.size)
    except ValueError as error:
        raise ValueError(f"custom numeric '{name}' {error}") from None
    try:
        kind.check(values)
    except ValueError as error:
        raise ValueError(f"custom numeric '{name}': {error}") from None


def texts_of(model: mujoco.MjModel, prefix: str, faults: Faults) -> dict[str, str]:
    """Our texts by name; those that are unknown are faults."""
    found = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_TEXT, prefix):
        with faults.collected():
            if not is_text(name):
                refuse_unknown("text", name, known_texts())
            start = model.text_adr[i]
            raw = bytes(model.text_data[start : start + model.text_size[i]])
            found[name] = raw.split(b"\0")[0].decode().strip()
    return found


def check_geoms(
    kind: str, names: Iterable[str], geoms: Sequence[Sequence[str]], faults: Faults
) -> None:
    """Elements of a kind that are the own ones of none of these geoms, each with its names, are
    faults."""
    known = set().union(*geoms)
    for name in names:
        base = METHOD if name.startswith(METHOD) else base_of(name)
        if base in (None, name) or name.removeprefix(f"{base}_") in known:
            continue
        with faults.collected():
            raise ValueError(
                f"custom {kind} '{name}' names no geom of the tuple 'buoyant' "
                f"(which has {', '.join(own[0] for own in geoms)}); correct the name or list the "
                "geom"
            )


def of_geom(base: str, names: Sequence[str], found: Mapping[str, Any]) -> str:
    """The name of the element that holds for a geom with these names: the first that there is,
    else the scene's."""
    return next((f"{base}_{n}" for n in names if f"{base}_{n}" in found), base)
