"""Spec: adds water to a model that is not compiled yet (MuJoCo's MjSpec)."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
from numpy.typing import ArrayLike

from sim.mjcf.faults import Faults, ModelError
from sim.mjcf.fields import BUOYANT, names_file
from sim.mjcf.files import model_files
from sim.plugin import seam
from sim.plugin.refusals import refusals_raised
from sim.scenes.settings import override

BODY = mujoco.mjtObj.mjOBJ_BODY


def add_water(
    source: mujoco.MjSpec | str | Path, *bodies: str, **fields: ArrayLike | str
) -> mujoco.MjSpec:
    """Add water to any model.

        spec = sim.add_water("ant.xml", "torso", wave_swell=(0.1, 4, 0, 0), drag=(0.2, 1, 0.005))
        model = spec.compile()

    source: an MjSpec, which is changed, or the path of an MJCF or URDF file, which is not changed.
    bodies: names of the bodies that float, each with its subtree. A body that is fixed to the
    world, like the base of a URDF, gets a free joint. fields: custom fields by name (see
    `mjcf.fields`), as numbers or texts; they replace the model's. Returns the spec. Raises
    FileNotFoundError, or ModelError with all faults.
    """
    spec = source if isinstance(source, mujoco.MjSpec) else read_spec(Path(source))
    faults = Faults()
    floating = []
    for name in bodies:
        with faults.collected():
            floating.append(_body(spec, name))
    with faults.collected():
        override(spec, fields)
    faults.refuse()
    for body in floating:
        if body.parent.name == "world" and not body.joints and not body.mocap:
            body.add_freejoint()
    if bodies:
        _list(spec, bodies)
    return with_plugin(spec)


def _body(spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
    known = {body.name: body for body in spec.bodies if body.name not in ("", "world")}
    if name not in known:
        raise ValueError(f"there is no body '{name}'; the model has {', '.join(known)}")
    return known[name]


def read_spec(path: Path) -> mujoco.MjSpec:
    """The MjSpec of an MJCF or URDF file. Paths in its fields are relative to its folder. Raises
    FileNotFoundError, or ValueError for a file that MuJoCo cannot read."""
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no scene file {path}; give the path of an MJCF or URDF file"
        )
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise ValueError(f"{path}: MuJoCo opens only names in UTF-8; rename it") from None
    for named in model_files(path):
        if not named.is_file():  # MuJoCo would wait for a pipe
            raise ValueError(f"{path} names {named}, which is no file; give the name of a file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"{path}: {_reason(error)}") from None
    for text in spec.texts:
        if names_file(text.name):
            text.data = str(path.parent.absolute() / text.data)
    return spec


def with_plugin(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Add an instance of the plugin to a spec without one, and return the spec."""
    if not any(plugin.plugin_name == seam.NAME for plugin in spec.plugins):
        spec.activate_plugin(seam.NAME)
        spec.add_plugin(plugin_name=seam.NAME, name=seam.INSTANCE)
    return spec


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a spec. Raises ModelError with all faults of its water, or ValueError if MuJoCo
    refuses it."""
    try:
        with refusals_raised():
            return spec.compile()
    except ModelError:
        raise
    except ValueError as error:
        raise ValueError(_reason(error)) from None


def _reason(error: ValueError) -> str:
    """MuJoCo's message, in one line."""
    return f"MuJoCo cannot compile it: {' '.join(str(error).split())}"


def _list(spec: mujoco.MjSpec, bodies: Sequence[str]) -> None:
    """Add bodies to the tuple `buoyant`."""
    kinds, names = [], []
    for listing in [t for t in spec.tuples if t.name == BUOYANT]:
        kinds, names = list(listing.objtype), list(listing.objname)
        spec.delete(listing)
    listed = set(zip(kinds, names, strict=True))
    new = [body for body in bodies if (int(BODY), body) not in listed]
    spec.add_tuple(
        name=BUOYANT,
        objtype=[*kinds, *[int(BODY)] * len(new)],
        objname=[*names, *new],
        objprm=[0.0] * (len(names) + len(new)),
    )
