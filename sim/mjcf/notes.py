"""Notes: likely mistakes in a model, each in one line with its remedy."""

from collections.abc import Iterable, Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.mjcf.checks import AIR_BOUNDS
from sim.mjcf.floats import (
    FloatingGeom,
    bodies_above,
    body_label,
    collides,
    geom_label,
    moving_dofs,
)
from sim.mjcf.overlaps import Shape, notes_of_overlaps
from sim.water.sea import Sea

Array = NDArray[np.float64]

SMALLEST_RELATIVE_DENSITY, LARGEST_RELATIVE_DENSITY = 0.01, 20.0
"""Relative densities outside of which a mass or a size is likely wrong."""

LARGEST_WAVELENGTHS, SMALLEST_WAVELENGTHS = 100.0, 1e-3
"""Extents of a hull, in longest and in shortest wavelengths, outside of which units are likely
wrong."""

FLOOR_DISTANCE_SHARE = 0.1
"""Share of the longest hull: a floor closer than this to the waves is at the water's surface."""


def notes_about(model: mujoco.MjModel, sea: Sea, floats: Sequence[FloatingGeom]) -> list[str]:
    """Notes about a model that floats, whatever its state."""
    return [
        *_about_air(model), *_about_gravity(model, floats), *_about_densities(model, sea, floats),
    ]  # fmt: skip


def notes_about_positions(
    model: mujoco.MjModel, start: mujoco.MjData, sea: Sea, floats: Sequence[FloatingGeom]
) -> list[str]:
    """Notes about the positions in which a model starts."""
    return [
        *notes_of_overlaps(model, start, floats), *_about_floors(model, start, sea, floats),
        *_about_the_bottom(start, sea, floats),
    ]  # fmt: skip


def _about_air(model: mujoco.MjModel) -> Iterator[str]:
    for name in AIR_BOUNDS:
        value = getattr(model.opt, name)
        if value > 0.0:
            yield (
                f"option {name} is {value:g}, as in air: MuJoCo's air drag acts under water too; "
                "set it to 0 if that matters"
            )


def _about_gravity(model: mujoco.MjModel, floats: Sequence[FloatingGeom]) -> Iterator[str]:
    for body in sorted(bodies_above(model, np.array([f.body for f in floats]))):
        share = float(model.body_gravcomp[body])
        if share != 0.0 and model.body_mass[body] > 0.0:
            yield (
                f"body '{body_label(model, body)}' has gravcomp {share:g}: MuJoCo carries that "
                "share of its weight, so it floats too high or flies; set it to 0"
            )


def _about_densities(
    model: mujoco.MjModel, sea: Sea, floats: Sequence[FloatingGeom]
) -> Iterator[str]:
    volumes: dict[int, float] = {}
    for f in floats:
        root = int(model.body_rootid[f.body])
        volumes[root] = volumes.get(root, 0.0) + f.displaced * f.method.hull.volume
    least, most = SMALLEST_RELATIVE_DENSITY, LARGEST_RELATIVE_DENSITY
    for root, volume in volumes.items():
        mass = float(model.body_subtreemass[root])
        relative = mass / (sea.density * volume)
        if not least <= relative <= most:
            yield (
                f"body '{body_label(model, root)}' weighs {mass:.3g} kg and its hulls displace "
                f"{volume:.3g} m^3: {relative:.3g} times as dense as the water; expected "
                f"{least:g} to {most:g}: check masses and units (lengths are metres)"
            )


def notes_about_sizes(sea: Sea, hulls: Iterable[tuple[str, Hull]]) -> Iterator[str]:
    """Notes about hulls (name, hull) that are much larger or smaller than the waves."""
    if not sea.waves:
        return
    lengths = [wave.wavelength for wave in sea.waves]
    least, most = SMALLEST_WAVELENGTHS * min(lengths), LARGEST_WAVELENGTHS * max(lengths)
    for name, hull in hulls:
        size = hull.length
        if not least <= size <= most:
            yield (
                f"geom '{name}' is {size:.3g} m long and the waves {min(lengths):.3g} to "
                f"{max(lengths):.3g} m: check the units (a mesh in millimetres needs "
                'scale="0.001 0.001 0.001")'
            )


def notes_about_matrices(model: mujoco.MjModel, shapes: Sequence[Shape]) -> list[str]:
    """Notes about 6 x 6 matrices of bodies that their joints keep from floating freely. A matrix
    belongs to the draught at which its body's weight floats."""
    found = {}
    for shape in shapes:
        body, values = int(model.geom_bodyid[shape.geoms[0]]), shape.drag.values
        joints = model.jnt_type[model.dof_jntid[moving_dofs(model, body)]]
        if not np.isin(joints, (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_SLIDE)).any():
            matrices = [
                name for base, name in shape.drag.sources.items() if values[base].size == 36
            ]
            found |= dict.fromkeys(matrices, body)
    return [
        f"the matrix '{name}' is taken for the draught at which body '{body_label(model, body)}' "
        "floats freely, but its joints hold it elsewhere: give a file by the text "
        "'hydrodynamics_<body>', which acts in full there"
        for name, body in found.items()
    ]


def _about_floors(
    model: mujoco.MjModel, start: mujoco.MjData, sea: Sea, floats: Sequence[FloatingGeom]
) -> Iterator[str]:
    """Static planes, boxes and height fields at the water's surface, which floats may stand on."""
    size = max(f.method.hull.length for f in floats)
    band = sea.amplitude + FLOOR_DISTANCE_SHARE * size
    for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist():
        top = _top(model, start, geom)
        if top is None or not collides(model, geom) or abs(top - sea.level) > band:
            continue
        over = [f for f in floats if _is_over(model, start, geom, f)]
        if over:
            kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
            yield (
                f"the {kind} '{geom_label(model, geom)}' at z = {top:.3g} is at the water's "
                f"surface: '{over[0].name}' will stand on it rather than float; lower it, or let "
                "it collide with nothing (contype and conaffinity 0)"
            )


def _about_the_bottom(
    start: mujoco.MjData, sea: Sea, floats: Sequence[FloatingGeom]
) -> Iterator[str]:
    """Hulls that start on or below the bottom, which bounds the waves but stops no body."""
    bottom = sea.level - sea.depth
    low = {}
    for f in floats:
        up, z = start.geom_xmat[f.geom].reshape(3, 3)[2], float(start.geom_xpos[f.geom, 2])
        lowest = z + float((f.method.hull.vertices @ up).min())
        if lowest <= bottom:
            low[f.name] = lowest
    if low:
        name = min(low, key=low.__getitem__)
        others = f" and {len(low) - 1} other hulls" if len(low) > 1 else ""
        yield (
            f"'{name}'{others} start on or below the bottom of the water at z = {bottom:.3g} "
            f"(water_depth {sea.depth:.3g} m): it reaches down to {low[name]:.3g}; the bottom "
            "shapes the waves but carries no body: raise the body, or add a plane to stand on"
        )


def _top(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float | None:
    """World height [m] of the highest point of a level plane, a level height field or a box; None
    for any other geom."""
    kinds, up = mujoco.mjtGeom, data.geom_xmat[geom].reshape(3, 3)[2]
    height, kind = float(data.geom_xpos[geom, 2]), model.geom_type[geom]
    if kind == kinds.mjGEOM_PLANE:
        return height if up[2] > 0.99 else None
    if kind == kinds.mjGEOM_HFIELD:
        return height + float(model.hfield_size[model.geom_dataid[geom], 2])
    if kind == kinds.mjGEOM_BOX:
        return height + float(np.abs(up) @ model.geom_size[geom])
    return None


def _is_over(model: mujoco.MjModel, data: mujoco.MjData, geom: int, f: FloatingGeom) -> bool:
    """Whether a hull starts above or below a floor."""
    kinds, kind = mujoco.mjtGeom, model.geom_type[geom]
    half = model.geom_size[geom]
    if kind == kinds.mjGEOM_PLANE and not (half[:2] > 0.0).all():
        return True
    if kind == kinds.mjGEOM_HFIELD:
        half = model.hfield_size[model.geom_dataid[geom]]
    reach = half[:2] + 0.5 * np.linalg.norm(np.ptp(f.method.hull.bounds, axis=0))
    offset = data.geom_xmat[geom].reshape(3, 3).T @ (data.geom_xpos[f.geom] - data.geom_xpos[geom])
    return bool((np.abs(offset[:2]) < reach).all())
