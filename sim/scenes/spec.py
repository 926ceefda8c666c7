"""Spec: the water in a model that is not compiled yet (MuJoCo's MjSpec)."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.mjcf.custom_fields import (
    BUOYANT,
    COMPONENTS,
    METHOD,
    PRESSURE,
    RECORD,
    check_numeric,
    is_text,
    known_numerics,
    known_texts,
    numeric_kind,
)
from sim.mjcf.faults import Faults, ModelError
from sim.mjcf.numbers import NUMERICS
from sim.mjcf.sea_fields import WATERS
from sim.mjcf.settings import overrule
from sim.plugin import seam

Numerics = dict[str, NDArray[np.float64]]
Texts = dict[str, str]

BODY = mujoco.mjtObj.mjOBJ_BODY


def add_water(
    source: mujoco.MjSpec | str | Path, *bodies: str, **fields: ArrayLike | str
) -> mujoco.MjSpec:
    """Put a model that somebody else wrote into the water.

        spec = sim.add_water("ant.xml", "torso", wave_swell=(0.1, 4, 0, 0), drag=(0.2, 1, 0.005))
        model = spec.compile()

    source: an MjSpec, which is changed, or the path of an MJCF or URDF file, which is not. bodies:
    names of what floats, with all that hangs on it; one that stands fixed in the world, as the base
    of a URDF does, gets a free joint. fields: custom fields by their names (see `custom_fields`),
    as numbers or texts; they replace those that the model has, and files that they name lie in the
    current folder. Returns the spec. Raises FileNotFoundError, and ModelError with all that is
    wrong.
    """
    spec = source if isinstance(source, mujoco.MjSpec) else read_spec(Path(source))
    faults = Faults()
    floating = []
    for name in bodies:
        with faults.collected():
            floating.append(_body(spec, name))
    numerics, texts = {}, {}
    for name, value in fields.items():
        with faults.collected():
            _sort(name, value, numerics, texts)
    faults.refuse()
    for body in floating:
        if body.parent.name == "world" and not body.joints and not body.mocap:
            body.add_freejoint()
    if bodies:
        _list(spec, bodies)
    _write(spec, numerics, texts)
    return with_plugin(spec)


def _body(spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
    known = {body.name: body for body in spec.bodies if body.name not in ("", "world")}
    if name not in known:
        raise ValueError(f"there is no body '{name}'; the model has {', '.join(known)}")
    return known[name]


def _sort(name: str, value: ArrayLike | str, numerics: Numerics, texts: Texts) -> None:
    """Put a field where its kind belongs. Raises ValueError for one that is unknown, is of the
    other kind, or has numbers that cannot be."""
    kind = numeric_kind(name)
    if kind is None and not is_text(name):
        raise ValueError(
            f"field '{name}' is unknown; expected numbers of {known_numerics()}, or a text of "
            f"{known_texts()}"
        )
    if isinstance(value, str):
        if not is_text(name):
            raise ValueError(f"field '{name}' takes numbers, not the text '{value}'")
        texts[name] = str(Path(value).absolute()) if name in (COMPONENTS, RECORD) else value
        return
    if kind is None:
        raise ValueError(f"field '{name}' takes a text, not {value}")
    numerics[name] = np.atleast_1d(np.asarray(value, dtype=float))
    check_numeric(name, numerics[name])


def read_spec(path: Path) -> mujoco.MjSpec:
    """The MjSpec of an MJCF or URDF file; files that its fields name lie beside it. Raises
    FileNotFoundError, and ValueError for what MuJoCo cannot read."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no scene file {path}; give the path of an MJCF file")
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise ValueError(f"{path}: MuJoCo opens only names in UTF-8; rename it") from None
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"{path}: {_reason(error)}") from None
    for text in spec.texts:
        if text.name.endswith((COMPONENTS, RECORD)):
            text.data = str(path.parent.absolute() / text.data)
    return spec


def with_plugin(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The spec, with an instance of the plugin if it had none."""
    if not any(plugin.plugin_name == seam.NAME for plugin in spec.plugins):
        spec.activate_plugin(seam.NAME)
        spec.add_plugin(plugin_name=seam.NAME, name=seam.INSTANCE)
    return spec


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a spec. Raises ModelError, with all that is wrong with its water, and ValueError
    for what MuJoCo refuses."""
    try:
        with seam.refusals_raised():
            return spec.compile()
    except ModelError:
        raise
    except ValueError as error:
        raise ValueError(_reason(error)) from None


def _reason(error: ValueError) -> str:
    """MuJoCo's message, which has several lines, in one."""
    return f"MuJoCo cannot compile it: {' '.join(str(error).split())}"


def override(
    spec: mujoco.MjSpec,
    method: str | None = None,
    tolerance: float | None = None,
    pressure: str | None = None,
    threads: int | None = None,
    settings: Iterable[str] = (),
) -> None:
    """Overrule the custom fields of a spec. `method` holds for all geoms, and may name a pressure
    too ("patches/hydrostatic"); tolerance [m of water height] holds for the methods that take one.
    Raises ModelError."""
    if method is not None and "/" in method:
        method, pressure = method.split("/", 1)
    prefixes = _prefixes(spec)
    numerics, texts = _numerics(spec), _texts(spec)
    faults = Faults()
    overrule(settings, numerics, texts, faults)
    faults.refuse()
    if method:
        for text in [t for t in spec.texts if _is_method(t.name, prefixes)]:
            spec.delete(text)
            texts.pop(text.name, None)
    for prefix in prefixes:
        if method:
            texts[prefix + METHOD] = method
        if tolerance is not None:
            NUMERICS["buoyancy_tolerance"].check([tolerance])
            numerics[prefix + "buoyancy_tolerance"] = np.array([tolerance], dtype=float)
        if pressure is not None and (_says_water(prefix, numerics, texts) or len(prefixes) == 1):
            texts[prefix + PRESSURE] = pressure
    if threads is not None:
        NUMERICS["buoyancy_threads"].check([threads])
        numerics["buoyancy_threads"] = np.array([threads], dtype=float)
    _write(spec, numerics, texts)


def _prefixes(spec: mujoco.MjSpec) -> list[str]:
    """As `custom_fields.prefixes` of a compiled model."""
    names = [each.name for each in spec.tuples]
    attached = [n.removesuffix(BUOYANT) for n in names if n.endswith(BUOYANT) and n != BUOYANT]
    return ["", *attached]


def _is_method(name: str, prefixes: Sequence[str]) -> bool:
    return any(name.startswith(prefix + METHOD) for prefix in prefixes)


def _says_water(prefix: str, numerics: Numerics, texts: Texts) -> bool:
    """Whether what was attached with a prefix describes a sea of its own."""
    begin = tuple(prefix + each for each in WATERS)
    return any(name.startswith(begin) for name in (*numerics, *texts))


def _numerics(spec: mujoco.MjSpec) -> Numerics:
    found = {}
    for numeric in spec.numerics:
        values = np.zeros(max(numeric.size, len(numeric.data)))
        values[: len(numeric.data)] = numeric.data
        found[numeric.name] = values
    return found


def _texts(spec: mujoco.MjSpec) -> Texts:
    return {text.name: text.data for text in spec.texts}


def _write(spec: mujoco.MjSpec, numerics: Numerics, texts: Texts) -> None:
    """Put numerics and texts into a spec, new ones behind those that it has."""
    before, said = _numerics(spec), _texts(spec)
    elements = {each.name: each for each in (*spec.numerics, *spec.texts)}
    for name, values in numerics.items():
        if name not in before:
            spec.add_numeric(name=name, data=values.tolist(), size=len(values))
        elif not np.array_equal(values, before[name], equal_nan=True):
            elements[name].size, elements[name].data = len(values), values.tolist()
    for name, text in texts.items():
        if name not in said:
            spec.add_text(name=name, data=text)
        elif text != said[name]:
            elements[name].data = text


def _list(spec: mujoco.MjSpec, bodies: Sequence[str]) -> None:
    """Name bodies in the tuple, besides those that are there."""
    kinds, names = [], []
    for found in [t for t in spec.tuples if t.name == BUOYANT]:
        kinds, names = list(found.objtype), list(found.objname)
        spec.delete(found)
    listed = set(zip(kinds, names, strict=True))
    new = [body for body in bodies if (int(BODY), body) not in listed]
    spec.add_tuple(
        name=BUOYANT,
        objtype=[*kinds, *[int(BODY)] * len(new)],
        objname=[*names, *new],
        objprm=[0.0] * (len(names) + len(new)),
    )
