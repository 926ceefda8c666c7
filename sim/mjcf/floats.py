"""Floats: which geoms of a model float, and their names."""

from collections.abc import Iterable, Iterator
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
    """A geom that floats.

    geom: its id. body: the id of its body. method: computes its wrench. drag: its resistance, if it
    has any. The hull of both is in the geom's frame (geom_xpos, geom_xmat). displaced: the volume
    that it displaces, over its hull's volume. united: ids of all geoms that its hull is made from,
    if there are several. is_cut: whether its hull lost what it shares with others.
    """

    name: str
    geom: int
    body: int
    method: Method
    drag: Drag | None = None
    displaced: float = 1.0
    united: tuple[int, ...] = ()
    is_cut: bool = False

    @property
    def geoms(self) -> tuple[int, ...]:
        """All geoms that the hull is made from."""
        return self.united or (self.geom,)


def drags_of(floats: Iterable[FloatingGeom]) -> list[tuple[Drag, float]]:
    """The drags of floats, each with the volume [m^3] of all hulls with drag of the same body."""
    volumes: dict[int, float] = {}
    found = [(f.body, f.drag) for f in floats if f.drag]
    for body, drag in found:
        volumes[body] = volumes.get(body, 0.0) + drag.hull.volume
    return [(drag, volumes[body]) for body, drag in found]


class Listed(NamedTuple):
    """A geom in the tuple `buoyant`, and the names by which fields may refer to it: its own, then
    the names of its body and of the bodies above."""

    geom: int
    names: tuple[str, ...]


def body_label(model: mujoco.MjModel, body: int) -> str:
    """A body's name, or 'body <id>'."""
    return model.body(body).name or f"body {body}"


def geom_label(model: mujoco.MjModel, geom: int) -> str:
    """A geom's name, or '<body>/geom <n>', counted from 0 in its body."""
    body = int(model.geom_bodyid[geom])
    own = geom - int(model.body_geomadr[body])
    return model.geom(geom).name or f"{body_label(model, body)}/geom {own}"


def listed_geoms(model: mujoco.MjModel, prefix: str, faults: Faults) -> list[Listed]:
    """The geoms of the tuple `buoyant` with a prefix, all on bodies that can move."""
    tuples = {name: i for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_TUPLE, prefix)}
    for name in tuples:
        if name != BUOYANT:
            with faults.collected():
                refuse_unknown("tuple", name, BUOYANT)
    listed: list[Listed] = []
    if BUOYANT not in tuples:
        return listed
    elements = model.tuple(tuples[BUOYANT])
    for kind, target in zip(elements.objtype, elements.objid, strict=True):
        with faults.collected():
            for geom in _geoms_of(model, int(kind), int(target)):
                with faults.collected():
                    _check_new(model, geom, listed)
                    _check_movable(model, geom)
                    bodies = _ancestors(model, int(model.geom_bodyid[geom]))
                    names = geom_label(model, geom), *(body_label(model, b) for b in bodies)
                    listed.append(Listed(geom, tuple(n.removeprefix(prefix) for n in names)))
    return listed


def _geoms_of(model: mujoco.MjModel, kind: int, target: int) -> list[int]:
    """The geoms of one element of the tuple. Raises ValueError."""
    if kind == mujoco.mjtObj.mjOBJ_GEOM:
        return [target]
    if kind != mujoco.mjtObj.mjOBJ_BODY:
        raise ValueError(
            f"tuple 'buoyant' lists '{mujoco.mj_id2name(model, kind, target)}', which is neither a "
            'geom nor a body; hulls are made from geoms: use objtype="geom" or objtype="body"'
        )
    bodies = map(int, model.geom_bodyid)
    below = [geom for geom, body in enumerate(bodies) if target in _ancestors(model, body)]
    if not below:
        raise ValueError(
            f"tuple 'buoyant' lists body '{body_label(model, target)}', which has no geom in its "
            "subtree; list a body that has one"
        )
    return [g for g in below if collides(model, g)] or below


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom may collide with others."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def _ancestors(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """A body and all bodies above it, without the world."""
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


def _check_new(model: mujoco.MjModel, geom: int, listed: list[Listed]) -> None:
    if geom in (other.geom for other in listed):
        raise ValueError(
            f"tuple 'buoyant' lists geom '{geom_label(model, geom)}' twice; its buoyancy would "
            "count twice; keep one"
        )


def _check_movable(model: mujoco.MjModel, geom: int) -> None:
    body = int(model.geom_bodyid[geom])
    if model.body_weldid[body] == 0 or model.body_mocapid[body] >= 0:
        owner = f"body '{body_label(model, body)}'" if body else "the world body"
        raise ValueError(
            f"geom '{geom_label(model, geom)}' belongs to {owner}, which cannot move and so cannot "
            "float; give its body a joint (<freejoint/>) or remove it from the tuple 'buoyant'"
        )


def first_state(model: mujoco.MjModel, keyframe: str | None = None) -> mujoco.MjData:
    """A state of a model, with its kinematics, in a named keyframe, or by default in the first
    keyframe, if there is one. Raises ValueError for an unknown name, and for a keyframe with a
    number that is not finite, which MuJoCo would silently replace."""
    data = mujoco.MjData(model)
    key = 0 if model.nkey else -1
    if keyframe is not None:
        key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
        if key < 0:
            known = ", ".join(f"'{model.key(i).name}'" for i in range(model.nkey)) or "none"
            raise ValueError(f"there is no keyframe '{keyframe}'; the scene has {known}")
    if key >= 0:
        mujoco.mj_resetDataKeyframe(model, data, key)
        for field in ("time", "qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat"):
            if not np.isfinite(getattr(data, field)).all():
                raise ValueError(
                    f"keyframe '{model.key(key).name}': its {field} has a number that is not "
                    "finite; correct it"
                )
    mujoco.mj_kinematics(model, data)
    return data


def moving_dofs(model: mujoco.MjModel, body: int) -> list[int]:
    """The degrees of freedom that move a body, ascending."""
    while body > 0 and model.body_dofnum[body] == 0:
        body = int(model.body_parentid[body])
    dof, dofs = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1, []
    while dof >= 0:
        dofs.insert(0, dof)
        dof = int(model.dof_parentid[dof])
    return dofs


def bodies_above(model: mujoco.MjModel, bodies: np.ndarray) -> set[int]:
    """Bodies and all bodies above them, without the world."""
    return {a for b in bodies for a in _ancestors(model, int(b))}
