"""Floats: which geoms of a model float, and what they are called."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from sim.methods import Method
from sim.mjcf.elements import elements_of
from sim.mjcf.faults import Faults
from sim.mjcf.fields import BUOYANT, refuse_unknown
from sim.resistance.drag import Drag


@dataclass(frozen=True)
class FloatingGeom:
    """A geom that the water pushes: its name and id, its body's id, the method that knows its
    wrench, and its drag and added mass, if the model asks for them; the hull of both is given in
    the geom's frame (geom_xpos, geom_xmat).

    displaced: the volume that it displaces, over that of its hull; united: ids of the geoms whose
    hulls are one with it, itself included, where there are several.
    """

    name: str
    geom: int
    body: int
    method: Method
    drag: Drag | None = None
    displaced: float = 1.0
    united: tuple[int, ...] = ()

    @property
    def geoms(self) -> tuple[int, ...]:
        """All geoms that it stands for."""
        return self.united or (self.geom,)


class Listed(NamedTuple):
    """A geom that is to float, and what a setting may call it: its own name, then its body's and
    those above."""

    geom: int
    names: tuple[str, ...]


def body_label(model: mujoco.MjModel, body: int) -> str:
    """A body's name; 'body <id>' for one without."""
    return model.body(body).name or f"body {body}"


def geom_label(model: mujoco.MjModel, geom: int) -> str:
    """A geom's name; '<body>/geom <n>' for one without, the first of a body 0."""
    body = int(model.geom_bodyid[geom])
    own = geom - int(model.body_geomadr[body])
    return model.geom(geom).name or f"{body_label(model, body)}/geom {own}"


def listed_geoms(model: mujoco.MjModel, prefix: str, faults: Faults) -> list[Listed]:
    """The geoms that the tuple behind a prefix names, each on a body that can move."""
    tuples = {name: i for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_TUPLE, prefix)}
    for name in tuples:
        if name != BUOYANT:
            with faults.collected():
                refuse_unknown("tuple", name, BUOYANT)
    found: list[Listed] = []
    if BUOYANT not in tuples:
        return found
    elements = model.tuple(tuples[BUOYANT])
    for kind, target in zip(elements.objtype, elements.objid, strict=True):
        with faults.collected():
            for geom in _geoms_of(model, int(kind), int(target)):
                with faults.collected():
                    _check_new(model, geom, found)
                    _check_movable(model, geom)
                    names = tuple(n.removeprefix(prefix) for n in _names_of(model, geom))
                    found.append(Listed(geom, names))
    return found


def _geoms_of(model: mujoco.MjModel, kind: int, target: int) -> list[int]:
    """The geoms that an element of the tuple stands for. Raises ValueError."""
    if kind == mujoco.mjtObj.mjOBJ_GEOM:
        return [target]
    if kind != mujoco.mjtObj.mjOBJ_BODY:
        raise ValueError(
            f"tuple 'buoyant' lists '{mujoco.mj_id2name(model, kind, target)}', which is neither a "
            'geom nor a body; hulls are made from geoms: use objtype="geom" or objtype="body"'
        )
    below = [g for g in range(model.ngeom) if _is_below(model, int(model.geom_bodyid[g]), target)]
    if not below:
        raise ValueError(
            f"tuple 'buoyant' lists body '{body_label(model, target)}', which has no geom, nor has "
            "any body on it; list one that has"
        )
    return [g for g in below if collides(model, g)] or below


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom may touch others."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def _is_below(model: mujoco.MjModel, body: int, ancestor: int) -> bool:
    return ancestor in _ancestors(model, body)


def _ancestors(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """A body and those above it, but for the world."""
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


def _names_of(model: mujoco.MjModel, geom: int) -> Iterator[str]:
    yield geom_label(model, geom)
    for body in _ancestors(model, int(model.geom_bodyid[geom])):
        yield body_label(model, body)


def _check_new(model: mujoco.MjModel, geom: int, listed: list[Listed]) -> None:
    if geom in (other.geom for other in listed):
        raise ValueError(
            f"tuple 'buoyant' lists geom '{geom_label(model, geom)}' twice; its buoyancy would "
            "count twice: keep one"
        )


def _check_movable(model: mujoco.MjModel, geom: int) -> None:
    name, body = geom_label(model, geom), int(model.geom_bodyid[geom])
    where = f"geom '{name}' belongs to body '{body_label(model, body)}'"
    if body == 0:
        where = f"geom '{name}' belongs to the world body"
    if model.body_weldid[body] == 0 or model.body_mocapid[body] >= 0:
        raise ValueError(
            f"{where}, which cannot move, so nothing can float it; give its body a joint "
            "(<freejoint/>) or take it from the tuple 'buoyant'"
        )


def first_state(model: mujoco.MjModel, keyframe: str | None = None) -> mujoco.MjData:
    """A state of a model in a keyframe, by its name, or the first one, if it has one, with the
    kinematics of that. Raises ValueError for one that there is not, or with a number that is not
    finite, for which MuJoCo would take others."""
    data = mujoco.MjData(model)
    key = 0 if model.nkey else -1
    if keyframe is not None:
        key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
        if key < 0:
            known = ", ".join(f"'{model.key(i).name}'" for i in range(model.nkey)) or "none"
            raise ValueError(f"there is no keyframe '{keyframe}'; the scene has {known}")
    if key >= 0:
        mujoco.mj_resetDataKeyframe(model, data, key)
        for what in ("time", "qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat"):
            if not np.isfinite(getattr(data, what)).all():
                raise ValueError(
                    f"keyframe '{model.key(key).name}': its {what} has a number that is not "
                    "finite; correct it"
                )
    mujoco.mj_kinematics(model, data)
    return data


def moving_dofs(model: mujoco.MjModel, body: int) -> list[int]:
    """The degrees of freedom that move a body, in ascending order."""
    while body > 0 and model.body_dofnum[body] == 0:
        body = int(model.body_parentid[body])
    dof, found = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1, []
    while dof >= 0:
        found.insert(0, dof)
        dof = int(model.dof_parentid[dof])
    return found


def bodies_above(model: mujoco.MjModel, bodies: np.ndarray) -> set[int]:
    """Bodies and all above them, but for the world."""
    return {a for b in bodies for a in _ancestors(model, int(b))}
