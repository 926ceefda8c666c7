"""Hydrostatics of the bodies of a scene in still water."""

from collections.abc import Iterator, Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix
from sim.mjcf.floats import FloatingGeom, bodies_above, body_label
from sim.plugin.refusals import reading
from sim.scenes.buoyancy import Buoyancy
from sim.statics.equilibrium import Attitude
from sim.statics.joints import Joint
from sim.statics.report import AddedMass, FloatingBody, Hydrostatics, report

Array = NDArray[np.float64]

NOTED_ROTATION = 30.0
"""Angle [deg] between start and rest above which there is a note."""

NOTED_TILT = 5.0
"""Angle [deg] between the rest of a body and that of its coefficients above which there is a
note."""

NOTED_FALL_SIZES = 4.0
"""Height of a fall, in sizes of the body and besides the amplitude of the waves, above which there
is a note."""


class Afloat(Protocol):
    """The attributes of a Scene that this module uses."""

    @property
    def model(self) -> mujoco.MjModel: ...
    @property
    def data(self) -> mujoco.MjData: ...
    @property
    def buoyancy(self) -> Buoyancy: ...


def hydrostatics(scene: Afloat, with_gz: bool = True) -> dict[str, Hydrostatics]:
    """Hydrostatics of each of the scene's `trees`, by the name of its root.

    with_gz: whether to compute righting arms, which takes most of the time.
    """
    omega_h = largest_omega_h(scene.model)
    return {body.name: report(body, omega_h, with_gz) for body in trees(scene).values()}


def largest_omega_h(model: mujoco.MjModel) -> float:
    """Largest angular frequency [rad/s] times timestep [s] with which undamped oscillations on the
    water do not grow. All integrators but RK4 behave like semi-implicit Euler, because none knows
    the water's stiffness."""
    is_rk4 = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    return 2.0 * np.sqrt(2.0) if is_rk4 else 2.0


def notes_about_start(scene: Afloat) -> Iterator[str]:
    """Notes about free bodies that sink, turn over, or are released far from the water."""
    model, sea = scene.model, scene.buoyancy.sea
    for root, body in trees(scene).items():
        joint = model.body_jntadr[root]
        if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            continue
        if body.at_rest is None:
            yield f"body '{body.name}' {body.reason}"
            continue
        if body.turned > NOTED_ROTATION:
            yield (
                f"body '{body.name}' will turn over: in still water it rests {body.turned:.0f} deg "
                "from how it starts (python scripts/hydrostatics.py says how)"
            )
        yield from _about_rest_frames(scene, root, body.at_rest)
        above = body.start.height - body.at_rest.height
        if abs(above) > NOTED_FALL_SIZES * body.size + sea.amplitude:
            side, verb = ("above", "falls") if above > 0.0 else ("below", "shoots up")
            yield (
                f"body '{body.name}' starts {abs(above):.3g} m {side} where it floats and {verb} "
                "first"
            )


def _about_rest_frames(scene: Afloat, root: int, at_rest: Attitude) -> Iterator[str]:
    """A note if a body's coefficients are for another attitude than that in which it floats."""
    for response in scene.buoyancy.responses:
        if response.body == root and not response.is_relative:
            up = at_rest.rotation @ response.coefficients.rotation[:, 2]
            tilt = np.degrees(np.arctan2(np.hypot(up[0], up[1]), up[2]))
            if tilt > NOTED_TILT:
                yield (
                    f"body '{body_label(scene.model, root)}' rests {tilt:.0f} deg from the "
                    "attitude that its hydrodynamics are for; make them again for this scene"
                )


def trees(scene: Afloat) -> dict[int, FloatingBody]:
    """Each floating tree of bodies, by the id of its root: the first body above the floating ones
    that can move. A tree is one rigid body, with the joints below its root as in the scene's state.
    It is released from that state. The joints of its root hold it, but their limits, contacts and
    equality constraints do not."""
    model, of_root = scene.model, {}
    with reading():  # this state needs no water
        data = mujoco.MjData(model)
    for field in ("qpos", "mocap_pos", "mocap_quat"):
        getattr(data, field)[:] = getattr(scene.data, field)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    for f in scene.buoyancy.floats:
        of_root.setdefault(_root(model, f.body), []).append(f)
    return {root: _tree(scene, data, root, floats) for root, floats in of_root.items()}


def _tree(
    scene: Afloat, data: mujoco.MjData, root: int, floats: Sequence[FloatingGeom]
) -> FloatingBody:
    """A tree in a state, in the axes of its root body."""
    model, sea = scene.model, scene.buoyancy.sea
    centre, rotation = data.subtree_com[root].copy(), data.xmat[root].reshape(3, 3).copy()

    def in_tree(matrix: Array, position: Array, axes: Array) -> Array:
        """Transform a matrix (6, 6) of a frame in the world to the tree's axes and centre of
        mass."""
        axes = axes.reshape(3, 3).T
        return moved_matrix(matrix, axes @ (centre - position), axes @ rotation)

    inertia, added_masses = np.zeros((6, 6)), []
    for b in range(root, model.nbody):
        if root not in bodies_above(model, np.array([b])):
            continue
        own = np.diag([*3 * [model.body_mass[b]], *model.body_inertia[b]])
        inertia += in_tree(own, data.xipos[b], data.ximat[b])
    corners = []
    for f in floats:
        position, axes, hull = data.geom_xpos[f.geom], data.geom_xmat[f.geom], f.method.hull
        corners.append(hull.vertices[hull.faces] @ axes.reshape(3, 3).T + (position - centre))
        if f.drag is not None and f.drag.added_mass is not None:
            turn = rotation.T @ axes.reshape(3, 3)
            grip = turn @ f.drag.grip @ turn.T
            matrix = in_tree(f.drag.added_mass, position, axes)
            added_masses.append(AddedMass(corners[-1] @ rotation, matrix, grip))
    for response in scene.buoyancy.responses:
        own, axes = response.coefficients, data.xmat[response.body].reshape(3, 3)
        hulls = [i for i, f in enumerate(floats) if f.body == response.body]
        if hulls:
            whole = sum(floats[i].displaced * floats[i].method.hull.volume for i in hulls)
            share = response.volume / whole
            position = data.xpos[response.body] + axes @ own.position
            matrix = in_tree(own.added_mass / share, position, (axes @ own.rotation).ravel())
            shape = np.concatenate([corners[i] for i in hulls]) @ rotation
            added_masses.append(AddedMass(shape, matrix, np.zeros((3, 3))))
    return FloatingBody(
        corners=np.concatenate(corners) @ rotation,
        mass=float(model.body_subtreemass[root]),
        density=sea.density,
        gravity=sea.gravity,
        displaced=np.repeat([f.displaced for f in floats], [len(c) for c in corners]),
        name=body_label(model, root),
        origin=rotation.T @ (data.xpos[root] - centre),
        inertia=inertia,
        added_masses=tuple(added_masses),
        start=Attitude(float(centre[2] - sea.level), rotation),
        level=sea.level,
        joints=_joints(model, data, root, centre - [0.0, 0.0, centre[2] - sea.level]),
    )


def _root(model: mujoco.MjModel, body: int) -> int:
    """The first body on the way from the world to a body that can move."""
    while model.body_weldid[model.body_parentid[body]] != 0:
        body = int(model.body_parentid[body])
    return body


def _joints(
    model: mujoco.MjModel, data: mujoco.MjData, root: int, origin: Array
) -> tuple[Joint, ...] | None:
    """The joints that hold a root, about an origin (3,) in the world; None if it is free. A ball is
    three hinges, about its body's axes."""
    first, found = int(model.body_jntadr[root]), []
    for j in range(first, first + int(model.body_jntnum[root])):
        kind, place = model.jnt_type[j], int(model.jnt_qposadr[j])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            return None
        name, anchor = model.joint(j).name or f"joint {j}", data.xanchor[j] - origin
        armature = float(model.dof_armature[model.jnt_dofadr[j]])
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            axes = data.xmat[root].reshape(3, 3).T
            found += [
                Joint(f"{name} {axis}", True, vector, anchor, armature=armature)
                for axis, vector in zip("xyz", axes, strict=True)
            ]
            continue
        is_hinge, axis = kind == mujoco.mjtJoint.mjJNT_HINGE, data.xaxis[j].copy()
        spring, rest = model.jnt_stiffness[j], model.qpos_spring[place] - data.qpos[place]
        found.append(Joint(name, is_hinge, axis, anchor, float(spring), float(rest), armature))
    return tuple(found)
