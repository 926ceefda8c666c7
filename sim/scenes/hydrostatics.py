"""Hydrostatics: how the bodies of a scene lie in still water, in the terms of naval architects."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix
from sim.mjcf.floats import FloatingGeom, body_label
from sim.plugin.refusals import reading
from sim.scenes.buoyancy import Buoyancy
from sim.statics.equilibrium import Attitude, RigidFloat, rest
from sim.statics.stability import righting_arms, vanishing_angle
from sim.statics.wetted import Wetted

Array = NDArray[np.float64]

FURTHEST_HEEL = 175.0
"""Degrees up to which it is looked for where righting arms vanish."""

EXPLICIT_LIMITS = {"RK4": 2.0 * np.sqrt(2.0)}
"""omega h up to which an integrator keeps an undamped oscillation from growing."""

EXPLICIT_LIMIT = 2.0
"""The same for all others: semi-implicit Euler's; none of them knows the water's stiffness."""


TURNS_OVER = 30.0
"""Degrees between start and rest from which on a note says so."""


FAR = 4.0
"""Sizes of a body, besides the waves' height, from which on its fall is worth a note."""


class Afloat(Protocol):
    """What a Scene has."""

    model: mujoco.MjModel
    data: mujoco.MjData
    buoyancy: Buoyancy


@dataclass(frozen=True)
class Hydrostatics:
    """A floating body, with all that hangs on it, as it rests in still water.

    Axes: x along the bow (the body's own x axis, seen from above), y to port, z up. Heel turns
    about x, to starboard, and trim about y, the bow down; both at rest, from the body's own axes.
    K is the hull's lowest point at rest. Centres lcb, tcb, lcf and tcf lie before and to port of
    the body's origin. None stands for what there is not: no rest of what sinks, no period where
    nothing brings the body back.

    cb is the block coefficient and cwp the waterplane coefficient, of the extents lwl and bwl of
    the waterplane. stiffness (6, 6) and added_mass (6, 6) are those about the centre of mass, along
    the axes above, in the order surge, sway, heave, roll, pitch, yaw. Periods are of each motion by
    itself. largest_timestep is where the stiffest oscillation would begin to grow. gz: heel [deg]
    from the rest, and righting arm [m], free to sink and trim; it vanishes where the body turns
    over, None where it comes back from all heels.
    """

    name: str
    sinks: bool
    mass_kg: float
    volume_m3: float
    relative_density: float
    draught_m: float | None = None
    heel_deg: float | None = None
    trim_deg: float | None = None
    height_m: float | None = None
    tilt_from_start_deg: float | None = None
    displacement_m3: float | None = None
    submerged_fraction: float | None = None
    kb_m: float | None = None
    lcb_m: float | None = None
    tcb_m: float | None = None
    lcf_m: float | None = None
    tcf_m: float | None = None
    bmt_m: float | None = None
    bml_m: float | None = None
    kg_m: float | None = None
    gmt_m: float | None = None
    gml_m: float | None = None
    waterplane_m2: float | None = None
    wetted_m2: float | None = None
    lwl_m: float | None = None
    bwl_m: float | None = None
    cb: float | None = None
    cwp: float | None = None
    heave_period_s: float | None = None
    roll_period_s: float | None = None
    pitch_period_s: float | None = None
    largest_timestep_s: float | None = None
    vanishing_deg: float | None = None
    gz: list[list[float]] | None = None
    stiffness: list[list[float]] | None = None
    added_mass: list[list[float]] | None = None


def hydrostatics(scene: Afloat, with_gz: bool = True) -> dict[str, Hydrostatics]:
    """Hydrostatics of each tree of bodies that floats, by the name of its root, from the scene's
    state: joints inside a tree stay as they are there.

    with_gz: whether the curve of righting arms is computed, which takes most of the time.
    """
    found = {}
    for tree in trees(scene):
        result = _of_tree(scene, tree, with_gz)
        found[result.name] = result
    return found


def resting_corners(scene: Afloat) -> dict[str, Array]:
    """Corners (F, 3, 3) [m] of all hulls of each tree that does not sink, at rest: in the axes of
    Hydrostatics, from the point of the water's surface above or below the centre of mass."""
    found = {}
    for tree in trees(scene):
        if not _sinks(tree.body):
            attitude = _resting(tree)
            found[tree.name] = tree.body.corners @ attitude.rotation.T + [0, 0, attitude.height]
    return found


@dataclass(frozen=True)
class Tree:
    """A root body and all on it as one rigid body in the present state: its FloatingGeoms, the
    centre of mass (3,) [m] of all, its inertia (3, 3) [kg m^2] about that, world axes; and
    as a RigidFloat in the root body's axes."""

    root: int
    name: str
    floats: tuple[FloatingGeom, ...]
    centre: Array
    inertia: Array
    body: RigidFloat
    rotation: Array


def trees(scene: Afloat) -> Iterator[Tree]:
    """The floating Trees of a scene as they stand."""
    model, sea = scene.model, scene.buoyancy.sea
    with reading():  # no water is asked of it
        data = mujoco.MjData(model)
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = (
        scene.data.qpos, scene.data.mocap_pos, scene.data.mocap_quat,
    )  # fmt: skip
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    of_root: dict[int, list[FloatingGeom]] = {}
    for f in scene.buoyancy.floats:
        of_root.setdefault(int(model.body_rootid[f.body]), []).append(f)
    for root, floats in of_root.items():
        centre, rotation = np.array(data.subtree_com[root]), data.xmat[root].reshape(3, 3).copy()
        corners = [
            f.method.hull.vertices[f.method.hull.faces] @ data.geom_xmat[f.geom].reshape(3, 3).T
            + (data.geom_xpos[f.geom] - centre)
            for f in floats
        ]
        body = RigidFloat(
            np.concatenate(corners) @ rotation, float(model.body_subtreemass[root]), sea.density,
            sea.gravity, np.repeat([f.displaced for f in floats], list(map(len, corners))),
        )  # fmt: skip
        name = body_label(model, root)
        inertia = _inertia(model, data, root, centre)
        yield Tree(root, name, tuple(floats), centre, inertia, body, rotation)


def _inertia(model: mujoco.MjModel, data: mujoco.MjData, root: int, centre: Array) -> Array:
    """Inertia (3, 3) [kg m^2] of a tree about a point, world axes."""
    total = np.zeros((3, 3))
    for b in np.flatnonzero(model.body_rootid == root):
        axes, arm = data.ximat[b].reshape(3, 3), data.xipos[b] - centre
        total += axes @ np.diag(model.body_inertia[b]) @ axes.T
        total += model.body_mass[b] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return total


def notes_about_start(scene: Afloat) -> Iterator[str]:
    """What is to be said of bodies that are free and will not stay as they start: they sink, turn
    over, or are let go far from the water."""
    known: dict[tuple[bytes, float], Attitude] = {}
    for tree in trees(scene):
        if scene.model.jnt_type[scene.model.body_jntadr[tree.root]] != mujoco.mjtJoint.mjJNT_FREE:
            continue
        body = tree.body
        if _sinks(body):
            density = body.mass / (body.density * body.volume)
            yield (
                f"body '{tree.name}' will sink: it weighs {body.mass:.4g} kg and displaces at most "
                f"{body.mass / density:.4g} kg"
            )
            continue
        key = (body.corners.tobytes() + tree.rotation.tobytes(), body.mass)
        if key not in known:
            known[key] = _resting(tree)
        yield from _about_start(scene, tree, known[key])


def _about_start(scene: Afloat, tree: Tree, attitude: Attitude) -> Iterator[str]:
    turned = _tilt(tree.rotation[2], attitude.rotation[2])
    if turned > TURNS_OVER:
        yield (
            f"body '{tree.name}' will turn over: in still water it rests {turned:.0f} deg from how "
            "it starts (python scripts/hydrostatics.py says how)"
        )
    above = tree.centre[2] - scene.buoyancy.sea.level - attitude.height
    if abs(above) > FAR * tree.body.size + scene.buoyancy.sea.amplitude:
        way = "falls" if above > 0.0 else "shoots up"
        yield (
            f"body '{tree.name}' starts {abs(above):.3g} m {'above' if above > 0.0 else 'below'} "
            f"where it floats and {way} first"
        )


def _tilt(before: Array, now: Array) -> float:
    """Angle [deg] between the vertical (3,) in a body's axes before and now."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(before, now)), before @ now)))


def heel_and_trim(up: Array) -> tuple[Array, Array]:
    """Heel and trim [rad] of bodies in whose axes the vertical is (..., 3): first heeled about the
    bow, then trimmed about the horizontal."""
    trim = -np.arcsin(np.clip(up[..., 0], -1.0, 1.0))
    return np.arctan2(up[..., 1], up[..., 2]), trim


def bow_ahead(rotation: Array) -> Array:
    """The same rotation (3, 3) turned about the vertical until the body's x axis, seen from above,
    lies along the world's; or its z axis, where the bow points straight up or down."""
    ahead = rotation[:2, 0] if np.hypot(*rotation[:2, 0]) > 1e-6 else rotation[:2, 2]
    c, s = ahead / np.linalg.norm(ahead)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation


def _of_tree(scene: Afloat, tree: Tree, with_gz: bool) -> Hydrostatics:
    body, sinks = tree.body, _sinks(tree.body)
    known = dict(
        name=tree.name, sinks=sinks, mass_kg=body.mass, volume_m3=body.volume,
        relative_density=body.mass / (body.density * body.volume),
    )  # fmt: skip
    if sinks:
        return Hydrostatics(**known)
    attitude = _resting(tree)
    wetted = body.wetted(attitude)
    known |= _place(scene, tree, attitude) | _centres(scene, tree, attitude, wetted)
    known |= _motions(scene, tree, attitude, wetted)
    if with_gz:
        arms = righting_arms(body, attitude.rotation, FURTHEST_HEEL)
        known["gz"] = arms[arms[:, 0] <= 90.0].tolist()
        known["vanishing_deg"] = vanishing_angle(body, attitude.rotation, arms)
    return Hydrostatics(**known)


def _sinks(body: RigidFloat) -> bool:
    return bool(body.mass >= body.density * body.volume)


def _resting(tree: Tree) -> Attitude:
    found = rest(tree.body, bow_ahead(tree.rotation))
    return Attitude(found.height, bow_ahead(found.rotation))


def _place(scene: Afloat, tree: Tree, attitude: Attitude) -> dict[str, float]:
    """How the body lies."""
    heel, trim = heel_and_trim(attitude.rotation[2])
    ups = tree.body.corners @ attitude.rotation[2]
    origin = attitude.rotation @ tree.rotation.T @ (scene.data.xpos[tree.root] - tree.centre)
    return dict(
        draught_m=-float(attitude.height + ups.min()), heel_deg=float(np.degrees(heel)),
        trim_deg=float(np.degrees(trim)),
        height_m=float(scene.buoyancy.sea.level + attitude.height + origin[2]),
        tilt_from_start_deg=_tilt(tree.rotation[2], attitude.rotation[2]),
    )  # fmt: skip


def _centres(
    scene: Afloat, tree: Tree, attitude: Attitude, wetted: Wetted
) -> dict[str, float | None]:
    """Displacement, centres, metacentres, waterplane."""
    body, area, volume = tree.body, wetted.waterplane, wetted.volume
    placed = body.corners @ attitude.rotation.T
    keel = float(attitude.height + placed[:, :, 2].min())
    x, y, _ = -attitude.rotation @ tree.rotation.T @ (scene.data.xpos[tree.root] - tree.centre)
    kb, kg = float(wetted.centre[2] - keel), float(attitude.height - keel)
    known = dict(
        displacement_m3=volume, submerged_fraction=volume / body.volume,
        kb_m=kb, kg_m=kg, bmt_m=0.0, bml_m=0.0,
        lcb_m=float(wetted.centre[0] + x), tcb_m=float(wetted.centre[1] + y),
        waterplane_m2=area, wetted_m2=wetted.surface,
    )  # fmt: skip
    if area > 0.0:
        fx, fy = wetted.plane_moment / area
        squares = wetted.plane_squares - area * np.outer([fx, fy], [fx, fy])
        lwl, bwl = _extents(placed + [0.0, 0.0, attitude.height])
        known |= dict(
            lcf_m=float(fx + x), tcf_m=float(fy + y),
            bmt_m=float(squares[1, 1] / volume), bml_m=float(squares[0, 0] / volume),
            lwl_m=lwl, bwl_m=bwl, cb=volume / (lwl * bwl * -keel), cwp=area / (lwl * bwl),
        )  # fmt: skip
    known |= dict(gmt_m=kb + known["bmt_m"] - kg, gml_m=kb + known["bml_m"] - kg)
    return known


def _extents(corners: Array) -> tuple[float, float]:
    """Length and breadth [m] of the waterplane."""
    a, b = corners, np.roll(corners, -1, axis=1)
    crossing = (a[:, :, 2] < 0.0) != (b[:, :, 2] < 0.0)
    a, b = a[crossing], b[crossing]
    share = a[:, 2] / (a[:, 2] - b[:, 2])
    points = a + share[:, None] * (b - a)
    length, breadth, _ = np.ptp(points, axis=0)
    return float(length), float(breadth)


def _motions(
    scene: Afloat, tree: Tree, attitude: Attitude, wetted: Wetted
) -> dict[str, float | list[list[float]] | None]:
    """Stiffness, added mass, periods, and the largest timestep that holds."""
    turn = attitude.rotation @ tree.rotation.T
    stiff = tree.body.stiffness(attitude, wetted)
    added = _added_mass(scene, tree, turn) * wetted.volume / tree.body.volume
    mass = added.copy()
    mass[:3, :3] += tree.body.mass * np.eye(3)
    mass[3:, 3:] += turn @ tree.inertia @ turn.T
    heave_roll_pitch = slice(2, 5)
    inner = mass[heave_roll_pitch, heave_roll_pitch]
    squares = np.linalg.eigvals(np.linalg.solve(inner, stiff)).real
    fastest = np.sqrt(max(squares.max(), 0.0))
    integrator = mujoco.mjtIntegrator(scene.model.opt.integrator).name.removeprefix("mjINT_")
    limit = EXPLICIT_LIMITS.get(integrator, EXPLICIT_LIMIT)
    periods = [
        2.0 * np.pi * float(np.sqrt(m / k)) if k > 1e-9 * tree.body.weight else None
        for m, k in zip(np.diag(inner), np.diag(stiff), strict=True)
    ]
    whole = np.zeros((6, 6))
    whole[heave_roll_pitch, heave_roll_pitch] = stiff
    return dict(
        heave_period_s=periods[0], roll_period_s=periods[1], pitch_period_s=periods[2],
        largest_timestep_s=float(limit / fastest) if fastest > 0.0 else None,
        stiffness=whole.tolist(), added_mass=added.tolist(),
    )  # fmt: skip


def _added_mass(scene: Afloat, tree: Tree, turn: Array) -> Array:
    """Added mass (6, 6) of the submerged tree about its centre of mass, turned by so much."""
    data, total = scene.data, np.zeros((6, 6))
    for f in tree.floats:
        if f.drag is not None and f.drag.added_mass is not None:
            axes = data.geom_xmat[f.geom].reshape(3, 3).T
            total += moved_matrix(
                f.drag.added_mass, axes @ (tree.centre - data.geom_xpos[f.geom]), axes @ turn.T
            )
    return total
