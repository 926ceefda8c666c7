"""Watch: whether the energy that bodies have gained can be explained.

A stiff float on too long a timestep may be thrown kilometres high with every number finite and no
warning of MuJoCo's. What gives it away is its energy: in flat water the sum of

    kinetic energy + m g z + springs' energy + what it takes to push the hull so far under

stays, drag only lowers it, and waves cannot do more than carry a body along at their own speed and
push it under or lift it by their height. The last term is density g V times the depth of the hull's
centroid once it is submerged, and that of a column of the same height while it is not: an error of
a fraction of density g V times the height. What actuators and forces of the user's own put in is
known from their power.

Each kinematic tree has to explain its own energy, together with those that it has touched or is
tied to, from which it may have it.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.mjcf.floats import FloatingGeom
from sim.runs.divergence import DivergenceError, remedy
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

MARGIN = 4.0
"""How many times the explained change of energy passes. Resonance in waves and errors of
integration that one can live with stay below; a divergence grows through any margin."""

LENGTHS = 0.25
"""Of its own length, over which a body's weight may have moved it by the errors of `energies`."""

SPRUNG = 0.02
"""Of the springs' energy at the start, that steps of half their longest may be off by."""


class Watch:
    """Holds the energy of a scene's bodies against what explains it.

    `begin` before steps, `check` after them: what happens between `check` and the next
    `begin` is the caller's doing and is accepted. start: (nq,) the positions at the start.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.start = scene.data.qpos.copy()
        mujoco.mj_kinematics(scene.model, scene.data)
        self._allowances = _allowances(scene) + SPRUNG * _spring_energies(scene)
        self._gains = np.zeros(scene.model.nbody)
        self._before = self._gains
        self._power = self._gains
        self._began = scene.data.time
        self._found: Array | None = None  # changes at the state that was looked at last
        self._groups = np.arange(scene.model.nbody)  # which one each tree, by its root, belongs to
        for one, other in _tied(scene.model):
            self._unite(one, other)

    def begin(self) -> None:
        """Take the energy as it is now as given."""
        self._before = energies(self.scene)
        self._power = powers(self.scene)
        self._began = self.scene.data.time

    def touched(self) -> None:
        """Remember which bodies are in contact: they may have one another's energy from then on."""
        model, data = self.scene.model, self.scene.data
        self._found = None
        for pair in model.geom_bodyid[data.contact.geom] if data.ncon else ():
            self._unite(*model.body_rootid[pair])

    def is_explained(self) -> bool:
        """Whether the energy gained is no more than what explains it."""
        self.touched()
        self._found = self._changes()
        return mujoco.get_mjcb_passive() is not None or not (self._excess(self._found) > 0.0).any()

    def check(self) -> None:
        """Count in what was gained since `begin`. Raises DivergenceError when it cannot be
        explained."""
        changes = self._changes() if self._found is None else self._found
        self.touched()
        if mujoco.get_mjcb_passive() is not None:
            self._gains = np.zeros_like(self._gains)
            return
        if (self._excess(changes) > 0.0).any():
            raise self._divergence(changes)
        # energy that was lost does not come back, but for what the waves had of it
        self._gains = changes
        lowest = self._of_groups(MARGIN * self._allowances)
        self._gains += np.maximum(-lowest - self._of_groups(changes), 0.0)

    def _changes(self) -> Array:
        """Energy (nbody,) [J] gained since the start, without what actuators and forces that the
        user applies can have put in."""
        power = np.maximum(self._power, powers(self.scene))
        work = np.maximum(power, 0.0) * (self.scene.data.time - self._began)
        return self._gains + energies(self.scene) - self._before - MARGIN * work

    def _excess(self, changes: Array) -> Array:
        """Energy (nbody,) [J] of each group beyond what is explained, by its number."""
        excess = self._of_groups(changes - MARGIN * self._allowances)
        excess[self._groups[self._unwatched()]] = 0.0
        return excess

    def _of_groups(self, of_bodies: Array) -> Array:
        """Sums (nbody,) over the groups, by their numbers, which are those of bodies in them."""
        of_body = self._groups[self.scene.model.body_rootid]
        return np.bincount(of_body, of_bodies, len(of_bodies))

    def _unwatched(self) -> Array:
        """Roots that get energy nobody knows of: from bodies that the user moves; and the world."""
        model = self.scene.model
        return model.body_rootid[(model.body_mocapid >= 0) | (np.arange(model.nbody) == 0)]

    def _unite(self, one: int, other: int) -> None:
        if 0 not in (one, other):
            self._groups[self._groups == self._groups[one]] = self._groups[other]

    def _divergence(self, changes: Array) -> DivergenceError:
        scene, excess = self.scene, self._excess(changes)
        model = scene.model
        of_group = self._groups[model.body_rootid] == int(excess.argmax())
        least = 1e-3 * self._allowances[of_group].max()
        ratios = np.where(of_group, changes / np.maximum(self._allowances, least), -np.inf)
        body = int(ratios.argmax())
        several = len(set(model.body_rootid[of_group])) > 1
        gain = float(changes[of_group].sum())
        what = (
            f"energy cannot be explained: it {'and what it touched have' if several else 'has'} "
            f"{gain:.3g} J more than at the start, of which gravity, waves and buoyancy explain at "
            f"most {gain - excess.max():.3g} J"
        )
        name = model.body(body).name or f"body {body}"
        return DivergenceError(name, scene.data.time, what, remedy(scene, self.start, body))


def _tied(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """Pairs of roots of trees that equalities, tendons, flexes or springs tie together."""
    roots = model.body_rootid
    of_kind = {
        int(mujoco.mjtObj.mjOBJ_BODY): roots,
        int(mujoco.mjtObj.mjOBJ_SITE): roots[model.site_bodyid],
        int(mujoco.mjtObj.mjOBJ_JOINT): roots[model.jnt_bodyid],
    }
    for i in range(model.neq):
        kind = int(model.eq_objtype[i])
        ends = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        if kind in of_kind and min(ends) >= 0:
            yield int(of_kind[kind][ends[0]]), int(of_kind[kind][ends[1]])
    tied = np.unique(roots[model.jnt_bodyid[_has_spring(model)]])
    if model.ntendon or model.nflex:
        tied = np.unique(roots)
    for one, other in pairwise(tied):
        yield int(one), int(other)


def _has_spring(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which joints (njnt,) have one."""
    return np.reshape(model.jnt_stiffness != 0.0, (model.njnt, -1)).any(axis=1)


def powers(scene: Scene) -> Array:
    """Power (nbody,) [W] that actuators and forces which the user applies feed each body."""
    model, data = scene.model, scene.data
    of_dofs = (data.qfrc_actuator + data.qfrc_applied) * data.qvel
    found = np.bincount(model.dof_bodyid, of_dofs, model.nbody)
    pushes = data.xfrc_applied.copy()
    pushes[scene.buoyancy.bodies] = scene.buoyancy.pushes(data)
    for body in np.flatnonzero(pushes.any(axis=1)):
        velocity = np.zeros(6)  # rotation first
        kind = mujoco.mjtObj.mjOBJ_BODY  # a body's inertial frame
        mujoco.mj_objectVelocity(model, data, kind, int(body), velocity, 0)
        found[body] += pushes[body] @ np.roll(velocity, 3)
    return found


def energies(scene: Scene) -> Array:
    """Energy (nbody,) [J] of every body; needs no more than `qpos` and `qvel` to be current."""
    model, data = scene.model, scene.data
    sea = scene.buoyancy.sea
    level = float(sea.level_at(data.time))
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    angular, at_reference = data.cvel[:, :3], data.cvel[:, 3:]
    arm = data.xipos - data.subtree_com[model.body_rootid]
    turning = [np.roll(angular, -n, 1) * np.roll(arm, n, 1) for n in (1, -1)]
    linear = at_reference + turning[0] - turning[1]  # angular x arm, as fast as can be
    axes = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bij,bi->bj", axes, angular)
    found = 0.5 * (model.body_mass * (linear**2).sum(1) + (model.body_inertia * own**2).sum(1))
    weights = model.body_mass * (1.0 - model.body_gravcomp) * sea.gravity
    found += weights * data.xipos[:, 2]
    for hull, floats in _of_each_hull(scene.buoyancy.floats):
        geoms, bodies = [f.geom for f in floats], [f.body for f in floats]
        depths, ups = level - data.geom_xpos[geoms, 2], data.geom_xmat[geoms, 6:]
        rises = ups @ hull.vertices.T
        lows, highs = depths - rises.min(axis=1), depths - rises.max(axis=1)
        shares = np.clip(lows / (lows - highs), 0.0, 1.0)
        pushed = shares**2 * (depths - ups @ hull.centroid - np.minimum(highs, 0.0))
        volumes = hull.volume * np.array([f.displaced for f in floats])
        np.add.at(found, bodies, sea.density * sea.gravity * volumes * pushed)
    return found + _spring_energies(scene)


def _spring_energies(scene: Scene) -> Array:
    """Energy (nbody,) [J] of springs, all of it as the first body's that has one: MuJoCo's
    potential energy without that of the weights. Needs the kinematics."""
    model, data = scene.model, scene.data
    found = np.zeros(model.nbody)
    sprung = model.jnt_bodyid[_has_spring(model)]
    if not (sprung.size or model.ntendon or model.nflex):
        return found
    kept = data.energy.copy()
    if model.ntendon:
        mujoco.mj_tendon(model, data)
    mujoco.mj_energyPos(model, data)
    weights = float(model.opt.gravity @ (model.body_mass @ data.xipos))
    found[sprung[0] if sprung.size else -1] = data.energy[0] + weights
    data.energy[:] = kept
    return found


def _of_each_hull(
    floats: Sequence[FloatingGeom],
) -> Iterable[tuple[Hull, list[FloatingGeom]]]:
    """Each hull, equal ones being one object, and the geoms that have it."""
    found: dict[int, tuple[Hull, list[FloatingGeom]]] = {}
    for f in floats:
        found.setdefault(id(f.method.hull), (f.method.hull, []))[1].append(f)
    return found.values()


def _allowances(scene: Scene) -> Array:
    """Change of energy (nbody,) [J] that a body may have: its own and the displaced water's weight
    times LENGTHS of its length (the error of `energies`), the waves' height and the tide's, and
    motion at twice the speed of the fastest wave and the current."""
    model, sea = scene.model, scene.buoyancy.sea
    speed = max((np.sqrt(sea.gravity / w.wavenumber) for w in sea.waves), default=0.0)
    speed += float(np.linalg.norm(sea.current))
    rise = 2.0 * sea.amplitude + (float(np.ptp(sea.tide, axis=0)[1]) if sea.tide else 0.0)
    lengths = np.zeros(model.nbody)
    np.maximum.at(lengths, model.geom_bodyid, 2.0 * model.geom_rbound)
    reach = LENGTHS * lengths + rise
    allowances = model.body_mass * (sea.gravity * reach + 2.0 * speed**2)
    for f in scene.buoyancy.floats:
        hull = f.method.hull
        length = float(np.linalg.norm(hull.bounds[1] - hull.bounds[0]))
        displaced = sea.density * f.displaced * hull.volume * sea.gravity
        allowances[f.body] += displaced * (LENGTHS * length + rise)
    return allowances
