"""Overlaps: volume that several hulls share, and that must not count twice."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.hulls.union import overlapping, shared_volume, united
from sim.methods import Settings
from sim.mjcf.drag_fields import DragFields
from sim.mjcf.floats import FloatingGeom
from sim.mjcf.geoms import frame_rotation

Array = NDArray[np.float64]

MOST_NAMED = 3
"""Number of pairs of overlapping hulls that a note names."""

NOTED_SHARE = 1e-4
"""Shared volume, as a share of the smaller hull's, above which a note says so."""


@dataclass(frozen=True)
class Shape:
    """A hull and what the model says about it.

    geoms: the geoms that it is made from; the hull is in the frame of the first one. source: the
    element that names the method. displaced: volume that it displaces, over its own.
    """

    geoms: tuple[int, ...]
    name: str
    hull: Hull
    source: str
    method: str
    settings: Settings
    drag: DragFields
    displaced: float

    @property
    def key(self) -> tuple[object, ...]:
        """What hulls must have in common to be united."""
        return self.method, self.settings, self.drag.key, self.displaced


def united_shapes(model: mujoco.MjModel, shapes: Sequence[Shape]) -> tuple[list[Shape], list[str]]:
    """The shapes, after those that overlap on one body and have the same key are united; and the
    notes about that."""
    alike: dict[tuple[object, ...], list[Shape]] = {}
    for shape in shapes:
        body = int(model.geom_bodyid[shape.geoms[0]])
        alike.setdefault((body, *shape.key), []).append(shape)
    found, notes = [], []
    for members in alike.values():
        if len(members) == 1:
            found += members
            continue
        placed = [shape.hull.moved(*_on_body(model, shape.geoms[0])) for shape in members]
        for group in overlapping(np.array([hull.bounds for hull in placed])):
            names = [members[i].name for i in group]
            try:
                one = united([placed[i] for i in group])
            except ValueError as error:
                one = None
                notes.append(
                    f"{_many(names)} overlap and count shared volume twice; they cannot be united: "
                    f"{error}"
                )
            if one is None:
                found += [members[i] for i in group]
                continue
            hull, twice = one
            turn, place = _on_body(model, members[group[0]].geoms[0])
            own = hull.moved(turn.T, -turn.T @ place)
            geoms = tuple(g for i in group for g in members[i].geoms)
            found.append(replace(members[group[0]], geoms=geoms, name=" + ".join(names), hull=own))
            notes.append(
                f"{_many(names)} overlap and are united: apart they "
                f"would count {_share(twice, hull.volume)} of the volume twice "
                "(numeric 'buoyancy_union' 0 keeps them apart)"
            )
    order = {g: i for i, shape in enumerate(shapes) for g in shape.geoms}
    return sorted(found, key=lambda shape: order[shape.geoms[0]]), notes


def notes_of_overlaps(start: mujoco.MjData, floats: Sequence[FloatingGeom]) -> list[str]:
    """A note about hulls that overlap at the start."""
    if len(floats) < 2:
        return []
    pairs = list(_overlaps(start, floats))
    if not pairs:
        return []
    named = [
        f"{_many(names)} ({_share(shared, smaller)} of the smaller)"
        for names, shared, smaller in pairs[:MOST_NAMED]
    ]
    more = f" and {len(pairs) - MOST_NAMED} more pairs" if len(pairs) > MOST_NAMED else ""
    return [
        f"hulls overlap and count shared volume twice: {', '.join(named)}{more}; move them apart, "
        "or give hulls of one body the same fields, then they are united"
    ]


def _overlaps(
    start: mujoco.MjData, floats: Sequence[FloatingGeom]
) -> Iterator[tuple[list[str], float, float]]:
    """Pairs of hulls that overlap at the start: names, shared volume [m^3], and the volume of the
    smaller one."""
    placed = [
        f.method.hull.moved(start.geom_xmat[f.geom].reshape(3, 3), start.geom_xpos[f.geom])
        for f in floats
    ]
    for group in overlapping(np.array([hull.bounds for hull in placed])):
        for i, j in combinations(group, 2):
            a, b = placed[i].bounds, placed[j].bounds
            if (a[0] < b[1]).all() and (b[0] < a[1]).all():
                try:
                    shared = shared_volume(placed[i], placed[j])
                except ValueError:
                    continue  # the shared volume is unknown
                smaller = min(placed[i].volume, placed[j].volume)
                if shared > NOTED_SHARE * smaller:
                    yield [floats[i].name, floats[j].name], shared, smaller


def _on_body(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) [m] of a geom in its body's frame."""
    return frame_rotation(model.geom_quat[geom]), model.geom_pos[geom]


def _many(names: Sequence[str]) -> str:
    """Names as text; the first few, if there are many."""
    shown = [f"'{name}'" for name in names[:MOST_NAMED]]
    if len(names) > MOST_NAMED:
        return f"{', '.join(shown)} and {len(names) - MOST_NAMED} more"
    return f"{', '.join(shown[:-1])} and {shown[-1]}"


def _share(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.2g} %"
