"""Overlaps: finds and unites hulls that share volume, which must not count twice."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.hulls.solids import overlapping
from sim.hulls.union import shared_volume, united
from sim.methods import Settings
from sim.mjcf.drag_fields import DragFields
from sim.mjcf.floats import FloatingGeom
from sim.mjcf.geoms import frame_rotation

Array = NDArray[np.float64]

MOST_NAMED = 3
"""Largest number of hulls, and of pairs of hulls, that a note names."""

NOTED_SHARE = 1e-4
"""Share of the smaller hull's volume: a note is given if two hulls share more than this."""


@dataclass(frozen=True)
class Shape:
    """A hull and the fields that apply to it.

    geoms: the geoms that it is made from; the hull is in the frame of the first one. source: the
    element that names the method. displaced: volume that it displaces, over the hull's volume.
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
        """A key that must be equal for hulls to be united."""
        return self.method, self.settings, self.drag.key, self.displaced


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
            notes.append(
                f"{_listed(names)} overlap and are united: separate hulls "
                f"would count {_percentage(twice, hull.volume)} of the volume twice "
                "(numeric 'buoyancy_union' 0 keeps them separate)"
            )
            notes += [f"{_listed(names)} are united: {change}" for change in hull.changes]
    order = {g: i for i, shape in enumerate(shapes) for g in shape.geoms}
    return sorted(results, key=lambda shape: order[shape.geoms[0]]), notes


def notes_of_overlaps(start: mujoco.MjData, floats: Sequence[FloatingGeom]) -> list[str]:
    """A note about hulls that overlap at the start."""
    pairs = list(_overlaps(start, floats))
    if not pairs:
        return []
    named = [
        f"{_listed(names)} ({_percentage(shared, smaller)} of the smaller)"
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
    """Pairs of hulls that overlap at the start: names, shared volume [m^3], and the volume [m^3] of
    the smaller hull."""
    hulls = [
        f.method.hull.moved(start.geom_xmat[f.geom].reshape(3, 3), start.geom_xpos[f.geom])
        for f in floats
    ]
    for group in overlapping(np.array([hull.bounds for hull in hulls])):
        for i, j in combinations(group, 2):
            a, b = hulls[i].bounds, hulls[j].bounds
            if (a[0] < b[1]).all() and (b[0] < a[1]).all():
                try:
                    shared = shared_volume(hulls[i], hulls[j])
                except ValueError:
                    continue  # the shared volume is unknown
                smaller = min(hulls[i].volume, hulls[j].volume)
                if shared > NOTED_SHARE * smaller:
                    yield [floats[i].name, floats[j].name], shared, smaller


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
    return f"{100.0 * volume / whole:.2g} %"
