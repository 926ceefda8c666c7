"""Overlaps: finds, unites and cuts hulls that share volume, which must not count twice."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.hulls.solids import overlapping
from sim.hulls.union import shared_volume, united, without
from sim.methods import Settings
from sim.mjcf.drag_fields import DragFields
from sim.mjcf.fields import CUT, OVERLAP
from sim.mjcf.floats import FloatingGeom, body_label
from sim.mjcf.geoms import frame_rotation

Array = NDArray[np.float64]

MOST_NAMED = 3
"""Largest number of hulls, and of pairs of hulls, that a note names."""

NOTED_SHARE = 1e-4
"""Share of the smaller hull's volume: a note is given if two hulls share more than this."""

NOTED_UNION_SHARE = 1e-2
"""Share of a united hull's volume: a union is noted if it removes more than this."""


@dataclass(frozen=True)
class Shape:
    """A hull and the fields that apply to it.

    geoms: the geoms that it is made from; the hull is in the frame of the first one. source: the
    element that names the method. displaced: volume that it displaces, over the hull's volume.
    is_cut: whether it loses what it shares with others (see `cut_shapes`).
    """

    geoms: tuple[int, ...]
    name: str
    hull: Hull
    source: str
    method: str
    settings: Settings
    drag: DragFields
    displaced: float
    is_cut: bool

    @property
    def key(self) -> tuple[object, ...]:
        """A key that must be equal for hulls to be united."""
        return self.method, self.settings, self.drag.key, self.displaced, self.is_cut


def united_shapes(model: mujoco.MjModel, shapes: Sequence[Shape]) -> tuple[list[Shape], list[str]]:
    """Unite shapes that overlap on one body and have the same key. Returns the shapes and notes
    about unions."""
    alike: dict[tuple[object, ...], list[Shape]] = {}
    for shape in shapes:
        body = int(model.geom_bodyid[shape.geoms[0]])
        alike.setdefault((body, *shape.key), []).append(shape)
    results, notes = [], []
    for members in alike.values():
        if len(members) == 1:
            results += members
            continue
        hulls = [shape.hull.moved(*_on_body(model, shape.geoms[0])) for shape in members]
        for group in overlapping(np.array([hull.bounds for hull in hulls])):
            names = [members[i].name for i in group]
            try:
                union = united([hulls[i] for i in group])
            except ValueError as error:
                union = None
                notes.append(
                    f"{_listed(names)} overlap and count shared volume twice; they cannot be "
                    f"united: {error}"
                )
            if union is None:
                results += [members[i] for i in group]
                continue
            hull, twice = union
            first = members[group[0]]
            rotation, position = _on_body(model, first.geoms[0])
            hull_of_geom = hull.moved(rotation.T, -rotation.T @ position)
            geoms = tuple(g for i in group for g in members[i].geoms)
            results.append(replace(first, geoms=geoms, name=" + ".join(names), hull=hull_of_geom))
            if twice > NOTED_UNION_SHARE * hull.volume:
                notes.append(
                    f"{_listed(names)} overlap and are united: separate hulls "
                    f"would count {_percentage(twice, hull.volume)} of the volume twice "
                    "(numeric 'buoyancy_union' 0 keeps them separate)"
                )
            notes += [f"{_listed(names)} are united: {change}" for change in hull.changes]
    order = {g: i for i, shape in enumerate(shapes) for g in shape.geoms}
    return sorted(results, key=lambda shape: order[shape.geoms[0]]), notes


def cut_shapes(model: mujoco.MjModel, shapes: Sequence[Shape]) -> tuple[list[Shape], list[str]]:
    """Take off each shape with `is_cut` what it shares with other shapes of its tree at the
    reference pose (qpos0). Where two such shapes overlap, the smaller one is cut, and of equal ones
    the later one. Returns the shapes of which something is left, and notes about the others."""
    if not any(shape.is_cut for shape in shapes):
        return list(shapes), []
    pose = mujoco.MjData(model)
    mujoco.mj_kinematics(model, pose)
    roots = [model.body_rootid[model.geom_bodyid[shape.geoms[0]]] for shape in shapes]
    hulls = [shape.hull.moved(*_in_world(pose, shape.geoms[0])) for shape in shapes]
    order = sorted(
        range(len(shapes)),
        key=lambda i: (shapes[i].is_cut, -shapes[i].hull.volume, shapes[i].geoms),
    )
    results, notes = dict(enumerate(shapes)), []
    for place, i in enumerate(order):
        others = [hulls[j] for j in order[:place] if roots[j] == roots[i]]
        others = [other for other in others if _meet(hulls[i], other)]
        if not shapes[i].is_cut or not others:
            continue
        name = shapes[i].name
        try:
            rest = without(hulls[i], others)
        except ValueError as error:
            notes.append(f"'{name}' cannot be cut and counts shared volume twice: {error}")
            continue
        if rest is None:
            del results[i]
            notes.append(f"'{name}' lies inside other hulls: the water does not act on it")
        elif rest is not hulls[i]:
            rotation, position = _in_world(pose, shapes[i].geoms[0])
            hull = rest.moved(rotation.T, -rotation.T @ position)
            results[i] = replace(shapes[i], hull=hull)
    return list(results.values()), notes


REMEDIES = {
    "cut": f"the text '{OVERLAP}' cuts hulls as they stand at qpos0, and the start differs from it",
    "body": "give hulls of one body the same fields, then they are united",
    "tree": f"the custom text '{{}}' \"{CUT}\" takes it off the smaller hull",
    "apart": "move them apart, or let only one of them float",
}
"""What to do about two hulls that overlap: if one of them was cut, if both belong to one body, to
one tree (with the name of a field), or to different trees."""


def notes_of_overlaps(
    model: mujoco.MjModel, start: mujoco.MjData, floats: Sequence[FloatingGeom]
) -> list[str]:
    """A note about the hulls that overlap at the start, for each remedy."""
    pairs: dict[str, list[str]] = {}
    fields: dict[str, set[str]] = {}
    for one, other, shared in _overlaps(start, floats):
        # of equal hulls the later one is cut
        smaller = other if other.method.hull.volume <= one.method.hull.volume else one
        share = _percentage(shared, smaller.method.hull.volume)
        remedy = _remedy(model, one, other)
        names = _listed([one.name, other.name])
        pairs.setdefault(remedy, []).append(f"{names} ({share} of the smaller)")
        fields.setdefault(remedy, set()).add(f"{OVERLAP}_{body_label(model, smaller.body)}")
    notes = []
    for remedy, named in pairs.items():
        more = f" and {len(named) - MOST_NAMED} more pairs" if len(named) > MOST_NAMED else ""
        field = next(iter(fields[remedy])) if len(fields[remedy]) == 1 else OVERLAP
        notes.append(
            f"hulls overlap and count shared volume twice: {', '.join(named[:MOST_NAMED])}{more}; "
            + REMEDIES[remedy].format(field)
        )
    return notes


def _remedy(model: mujoco.MjModel, one: FloatingGeom, other: FloatingGeom) -> str:
    """The key in REMEDIES for two hulls that overlap."""
    if model.body_rootid[one.body] != model.body_rootid[other.body]:
        return "apart"
    if one.is_cut or other.is_cut:
        return "cut"
    return "body" if one.body == other.body else "tree"


def _overlaps(
    start: mujoco.MjData, floats: Sequence[FloatingGeom]
) -> Iterator[tuple[FloatingGeom, FloatingGeom, float]]:
    """Pairs of hulls that overlap at the start, with the volume [m^3] that they share."""
    hulls = [f.method.hull.moved(*_in_world(start, f.geom)) for f in floats]
    for group in overlapping(np.array([hull.bounds for hull in hulls])):
        for i, j in combinations(group, 2):
            if _meet(hulls[i], hulls[j]):
                try:
                    shared = shared_volume(hulls[i], hulls[j])
                except ValueError:
                    continue  # the shared volume is unknown
                if shared > NOTED_SHARE * min(hulls[i].volume, hulls[j].volume):
                    yield floats[i], floats[j], shared


def _meet(one: Hull, other: Hull) -> bool:
    """Whether the boxes around two hulls overlap."""
    return bool((one.bounds[0] < other.bounds[1]).all() and (other.bounds[0] < one.bounds[1]).all())


def _in_world(data: mujoco.MjData, geom: int) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) [m] of a geom in the world."""
    return data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]


def _on_body(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) [m] of a geom in its body's frame."""
    return frame_rotation(model.geom_quat[geom]), model.geom_pos[geom]


def _listed(names: Sequence[str]) -> str:
    """Names as text, at most MOST_NAMED of them."""
    shown = [f"'{name}'" for name in names[:MOST_NAMED]]
    if len(names) > MOST_NAMED:
        return f"{', '.join(shown)} and {len(names) - MOST_NAMED} more"
    return f"{', '.join(shown[:-1])} and {shown[-1]}"


def _percentage(volume: float, whole: float) -> str:
    return f"{float(f'{100.0 * volume / whole:.2g}'):g} %"  # no exponent for 100 %
