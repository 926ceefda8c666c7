"""Elements: the custom elements of a compiled model that belong to the table of fields.

`MjSpec.attach` puts a prefix before the names of the model that it attaches. Each attached model
with a tuple `buoyant` is read by itself, with its own fields.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.mjcf.faults import Faults
from sim.mjcf.fields import (
    BUOYANT,
    NUMERICS,
    PREFIXES,
    check_numeric,
    check_text,
    numeric_base,
    text_base,
)

Array = NDArray[np.float64]


def prefixes_of(tuples: Iterable[str]) -> list[str]:
    """The prefixes of attached models, from the names of all tuples. The model's own, "", is
    first."""
    attached = [n.removesuffix(BUOYANT) for n in tuples if n.endswith(BUOYANT) and n != BUOYANT]
    return ["", *attached]


def custom_names(model: mujoco.MjModel, kind: mujoco.mjtObj) -> list[str]:
    """Names of all custom elements of one kind, by their index; "" for one without a name."""
    count = {
        mujoco.mjtObj.mjOBJ_NUMERIC: model.nnumeric,
        mujoco.mjtObj.mjOBJ_TEXT: model.ntext,
        mujoco.mjtObj.mjOBJ_TUPLE: model.ntuple,
    }[kind]
    return [mujoco.mj_id2name(model, kind, i) or "" for i in range(count)]


def elements_of(
    model: mujoco.MjModel, kind: mujoco.mjtObj, prefix: str = ""
) -> Iterator[tuple[int, str]]:
    """Index and name (without the prefix) of the custom elements of one kind that belong to the
    table of fields."""
    for i, whole in enumerate(custom_names(model, kind)):
        name = whole.removeprefix(prefix)
        if whole.startswith(prefix) and (name.startswith(PREFIXES) or name == "drag"):
            yield i, name


def numerics_of(model: mujoco.MjModel, prefix: str, faults: Faults) -> dict[str, Array]:
    """The numerics by name. Unknown names and wrong numbers are faults."""
    found = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_NUMERIC, prefix):
        with faults.collected():
            values = np.array(model.numeric(i).data)
            check_numeric(name, values)
            found[name] = values
    return found


def texts_of(model: mujoco.MjModel, prefix: str, faults: Faults) -> dict[str, str]:
    """The texts by name. Unknown names are faults."""
    found = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_TEXT, prefix):
        with faults.collected():
            check_text(name)
            start = model.text_adr[i]
            raw = bytes(model.text_data[start : start + model.text_size[i]])
            found[name] = raw.split(b"\0")[0].decode().strip()
    return found


def check_geoms(
    kind: str, names: Iterable[str], geoms: Sequence[Sequence[str]], faults: Faults
) -> None:
    """Collect a fault for each element of a kind that is meant for one geom (`<name>_<geom>`) and
    names none of the listed geoms. geoms: for each of them the names that fields may call it."""
    known = set().union(*geoms)
    for name in names:
        base = text_base(name) if kind == "text" else numeric_base(name)
        if base in (None, name, "wave_<name>") or name.removeprefix(f"{base}_") in known:
            continue
        with faults.collected():
            raise ValueError(
                f"custom {kind} '{name}' names no geom of the tuple 'buoyant' "
                f"(which has {', '.join(own[0] for own in geoms)}); correct the name or list the "
                "geom"
            )


def of_geom(base: str, names: Sequence[str], found: Mapping[str, Any]) -> str:
    """The name of the field that holds for a geom: its own, else that of the nearest body above it,
    else the scene's."""
    return next((f"{base}_{n}" for n in names if f"{base}_{n}" in found), base)


def numbers_of(base: str, found: Mapping[str, Array], names: Sequence[str] = ()) -> list[float]:
    """All numbers of a field, with its defaults where they are left out; for a geom, of_geom's."""
    return NUMERICS[base].filled(found.get(of_geom(base, names, found), ()))
