"""Bodies of a scene at rest in still water, as panel codes want them."""

from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim import Scene
from sim.geometry import moved_matrix, rotation_about
from sim.hulls.solids import solid_of
from sim.mjcf.floats import body_label, moving_dofs
from sim.scenes.hydrostatics import trees
from sim.statics.equilibrium import Attitude, afloat
from sim.statics.report import FloatingBody

Array = NDArray[np.float64]

SMALL_MOVE = 1e-4
"""Distance as a share of the body's size, and angle [rad], over which a stiffness is measured."""

TITLES = ("surge", "sway", "heave", "roll", "pitch", "yaw")

LEAST_PART = 0.99
"""Part of a joint's axis along an axis of the world from which on it counts as along this."""

FREE, BALL, SLIDE, HINGE = map(int, mujoco.mjtJoint.__members__.values())


@dataclass(frozen=True, eq=False)
class Freedoms:
    """The D motions of a body. motions: (6, D), what each does to the centre of mass and the body,
    in world axes. mass, damping, stiffness: (D, D), with those of the joints, without the water's
    added mass and damping."""

    titles: tuple[str, ...]
    motions: Array
    mass: Array
    damping: Array
    stiffness: Array


@dataclass(frozen=True, eq=False)
class Resting:
    """A body at rest. Its rest frame has the axes of the world. Its origin is the centre of mass of
    the body and of those that are welded to it.

    solid: the manifold3d solid of its hulls in the rest frame's axes; z = 0 is the water, and x and
    y are 0 in the centre of mass. height [m]: of this above the water. position (3,) [m], rotation
    (3, 3): of the rest frame in the body's frame. freedoms: None for a body with moving parts.
    """

    name: str
    solid: Any
    height: float
    position: Array
    rotation: Array
    freedoms: Freedoms | None


def resting_bodies(scene: Scene, names: Container[str]) -> Iterator[Resting]:
    """The floating bodies of a scene that have these names.

    A body on a free joint or on a vertical slide lies where it floats; another one, for example on
    a hinge, where it starts. Raises ValueError for a body that does not float.
    """
    of_root = trees(scene)
    for body in map(int, scene.buoyancy.bodies):
        if body_label(scene.model, body) not in names:
            continue
        root = int(scene.model.body_rootid[body])
        yield _resting(scene, body, of_root[root], _attitude(scene.model, root, of_root[root]))


def _attitude(model: mujoco.MjModel, root: int, tree: FloatingBody) -> Attitude:
    first = model.body_jntadr[root]
    joints = range(first, first + model.body_jntnum[root])
    is_free = bool((model.jnt_type[joints] == FREE).any())
    axes = [tree.start.rotation @ model.jnt_axis[j] for j in joints if model.jnt_type[j] == SLIDE]
    rises = any(abs(axis[2]) > LEAST_PART for axis in axes)
    if (is_free or rises) and tree.reason:
        raise ValueError(
            f"body '{tree.name}' {tree.reason}; a panel code needs a body that floats at rest"
        )
    if is_free:
        return tree.at_rest or tree.start
    return afloat(tree, tree.start.rotation) if rises else tree.start


def _resting(scene: Scene, body: int, tree: FloatingBody, attitude: Attitude) -> Resting:
    model, data = scene.model, scene.data
    root = int(model.body_rootid[body])
    turn = attitude.rotation @ tree.start.rotation.T
    middle = data.xpos[root] - data.xmat[root].reshape(3, 3) @ tree.origin

    def placed(points: Array) -> Array:
        """Points (..., 3) [m] of the scene's state, at rest above the tree's centre of mass."""
        return (points - middle) @ turn.T + [0.0, 0.0, attitude.height]

    welded = np.flatnonzero(model.body_weldid == model.body_weldid[body])
    masses = model.body_mass[welded]
    own = np.average(data.xipos[welded], axis=0, weights=masses if masses.any() else None)
    centre, axes = placed(own), turn @ data.xmat[body].reshape(3, 3)
    solids = []
    for f in scene.buoyancy.floats:
        if f.body == body:
            hull, geom_axes = f.method.hull, data.geom_xmat[f.geom].reshape(3, 3)
            vertices = placed(hull.vertices @ geom_axes.T + data.geom_xpos[f.geom])
            solids.append(solid_of((vertices - [*centre[:2], 0.0], hull.faces)))
    rigid = set(np.flatnonzero(model.body_rootid == root)) == set(welded)
    return Resting(
        name=body_label(model, body),
        solid=_united(solids),
        height=float(centre[2]),
        position=axes.T @ (centre - placed(data.xpos[body])),
        rotation=axes.T,
        freedoms=_freedoms(scene, body, tree, attitude, placed, turn) if rigid else None,
    )


def _united(solids: list[Any]) -> Any:
    import manifold3d

    return manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)


class Move(NamedTuple):
    """A motion of a body along an axis (3,), or about one through an anchor (3,) [m]."""

    title: str
    axis: Array
    anchor: Array
    turns: bool

    def velocity(self, point: Array) -> Array:
        """What it does to a point (3,) [m] of the body and to the body, (6,)."""
        if self.turns:
            return np.concatenate([np.cross(self.axis, point - self.anchor), self.axis])
        return np.concatenate([self.axis, np.zeros(3)])

    def moved(self, point: Array, amount: float) -> tuple[Array, Array]:
        """A point of the body after a distance [m] or angle [rad], and the rotation (3, 3)."""
        if not self.turns:
            return point + amount * self.axis, np.eye(3)
        rotation = rotation_about(amount * self.axis)
        return self.anchor + rotation @ (point - self.anchor), rotation


def _freedoms(
    scene: Scene, body: int, tree: FloatingBody, attitude: Attitude,
    placed: Callable[[Array], Array], turn: Array,
) -> Freedoms:  # fmt: skip
    """The motions of a rigid tree at rest: the six of a free body, or those of its joints."""
    model, centre = scene.model, np.array([0.0, 0.0, attitude.height])
    dofs = moving_dofs(model, body)
    moves = [_move(scene, dof, centre, placed, turn) for dof in dofs]
    motions = np.array([move.velocity(centre) for move in moves]).T
    inertia = moved_matrix(tree.inertia, np.zeros(3), attitude.rotation.T)
    joints = model.dof_jntid[dofs]
    springs = np.where(
        model.jnt_type[joints] == FREE, 0.0, np.ravel(model.jnt_stiffness[joints]).astype(float)
    )
    return Freedoms(
        titles=tuple(move.title for move in moves),
        motions=motions,
        mass=motions.T @ inertia @ motions + np.diag(model.dof_armature[dofs]),
        damping=np.diag(model.dof_damping[dofs]).astype(float),
        stiffness=_stiffness(tree, attitude, moves) + np.diag(springs),
    )


def _move(
    scene: Scene, dof: int, centre: Array, placed: Callable[[Array], Array], turn: Array
) -> Move:
    """The motion of a degree of freedom, in world axes at rest."""
    model, joint = scene.model, int(scene.model.dof_jntid[dof])
    kind, number = model.jnt_type[joint], dof - int(model.jnt_dofadr[joint])
    turns = bool(kind in (BALL, HINGE) or number >= 3)
    axis, anchor = turn @ scene.data.xaxis[joint], placed(scene.data.xanchor[joint])
    if kind in (FREE, BALL):
        axis = np.eye(3)[number % 3]
    along = int(np.argmax(np.abs(axis)))
    title = TITLES[along + 3 * turns] if abs(axis[along]) > LEAST_PART else model.joint(joint).name
    return Move(title or f"joint {joint}", axis, centre if kind == FREE else anchor, turns)


def _stiffness(tree: FloatingBody, attitude: Attitude, moves: list[Move]) -> Array:
    """Stiffness (D, D) of weight and buoyancy, from central differences of their pull."""
    centre = np.array([0.0, 0.0, attitude.height])

    def pull(move: Move, amount: float) -> Array:
        point, rotation = move.moved(centre, amount)
        at = Attitude(float(point[2]), rotation @ attitude.rotation)
        lift, about_x, about_y = tree.pull(tree.wetted(at))
        wrench = np.array([0.0, 0.0, lift, about_x, about_y, 0.0])
        return np.array([each.velocity(point) @ wrench for each in moves])

    columns = []
    for move in moves:
        step = SMALL_MOVE * (1.0 if move.turns else tree.size)
        columns.append((pull(move, -step) - pull(move, step)) / (2.0 * step))
    return np.array(columns).T
