"""Elements: the custom elements of a compiled model that belong to the table of fields.

`MjSpec.attach` puts a prefix before the names of the attached model. Each attached model with a
tuple `buoyant` has its own fields.
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
    check_numeric,
    check_text,
    is_ours,
    nearest,
    numeric_base,
    text_base,
)

Array = NDArray[np.float64]


def prefixes_of(tuples: Iterable[str]) -> list[str]:
    """The prefixes of the model itself, "", and of attached models, from the names of all
    tuples."""
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
    for i, full_name in enumerate(custom_names(model, kind)):
        name = full_name.removeprefix(prefix)
        if full_name.startswith(prefix) and _is_read(kind, name):
            yield i, name


def _is_read(kind: mujoco.mjtObj, name: str) -> bool:
    """Whether a custom element belongs to the table of fields."""
    return is_ours(name) or (kind == mujoco.mjtObj.mjOBJ_TEXT and text_base(name) is not None)


def notes_about_names(model: mujoco.MjModel) -> Iterator[str]:
    """Notes about custom elements that are not read, because their names are only nearly fields."""
    kinds = mujoco.mjtObj
    prefixes = prefixes_of(custom_names(model, kinds.mjOBJ_TUPLE))
    for kind in (kinds.mjOBJ_NUMERIC, kinds.mjOBJ_TEXT, kinds.mjOBJ_TUPLE):
        for name in custom_names(model, kind):
            own = [name.removeprefix(prefix) for prefix in prefixes if name.startswith(prefix)]
            near = None if any(_is_read(kind, n) for n in own) else nearest(own[-1])
            if near is not None:
                yield (
                    f"custom {kind.name.removeprefix('mjOBJ_').lower()} '{name}' has no effect on "
                    f"the water; correct its name if it is meant to be '{near}'"
                )


def numerics_of(model: mujoco.MjModel, prefix: str, faults: Faults) -> dict[str, Array]:
    """The numerics by name. Unknown names and wrong numbers are faults."""
    numerics = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_NUMERIC, prefix):
        with faults.collected():
            values = np.array(model.numeric(i).data)
            check_numeric(name, values)
            numerics[name] = values
    return numerics


def texts_of(model: mujoco.MjModel, prefix: str, faults: Faults) -> dict[str, str]:
    """The texts by name. Unknown names and wrong contents are faults."""
    texts = {}
    for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_TEXT, prefix):
        with faults.collected():
            start = model.text_adr[i]
            raw = bytes(model.text_data[start : start + model.text_size[i]])
            content = raw.split(b"\0")[0].decode().strip()
            check_text(name, content)
            texts[name] = content
    return texts


def check_geoms(
    kind: str, names: Iterable[str], geoms: Sequence[Sequence[str]], faults: Faults
) -> None:
    """Collect a fault for each element of a kind that is for one geom (`<name>_<geom>`) and names
    none of the listed geoms. geoms: for each geom the names by which fields may refer to it."""
    known = set().union(*geoms)
    for name in names:
        base = text_base(name) if kind == "text" else numeric_base(name)
        if base is None or base == name or "<" in base or name.removeprefix(f"{base}_") in known:
            continue
        with faults.collected():
            raise ValueError(
                f"custom {kind} '{name}' names no geom of the tuple 'buoyant' "
                f"(which has {', '.join(own[0] for own in geoms)}); correct the name or list the "
                "geom"
            )


def of_geom(base: str, names: Sequence[str], fields: Mapping[str, Any]) -> str:
    """The name of the field that applies to a geom: the geom's field, else the field of the nearest
    body above it, else the scene's field. names: of the geom and the bodies, as in `Listed`."""
    return next((f"{base}_{n}" for n in names if f"{base}_{n}" in fields), base)


def numbers_of(base: str, fields: Mapping[str, Array], names: Sequence[str] = ()) -> list[float]:
    """All numbers of a field of the scene, or of a geom with these names, with defaults for missing
    numbers."""
    return NUMERICS[base].filled(fields.get(of_geom(base, names, fields), ()))
