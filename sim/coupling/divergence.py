"""Divergence: notice a state that cannot be, and say which of the usual causes fits.

Numbers that are not finite MuJoCo reports itself. But a stiff float on too long a timestep may also
be thrown kilometres high with every number finite and no warning. What gives
it away is its energy: in flat water the sum of

    kinetic energy + m g z + what it takes to push the hull so far under

over all bodies stays, drag only lowers it, and waves cannot do more than carry a body along
at their own speed and push it under or lift it by their height. The last term is density g V times
the depth of the hull's centroid once it is submerged, and that of a column of the same height
while it is not: an error of a fraction of density g V times the height.
"""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling import callback
from sim.coupling.floats import FloatingGeom
from sim.coupling.scene import Scene
from sim.geometry import areas, cone_centroid, cone_moments, cone_volumes, inertia_of
from sim.hull import Hull

Array = NDArray[np.float64]

MARGIN = 4.0
"""How many times the explained change of energy passes. Resonance in waves and errors of
integration that one can live with stay below; a divergence grows through any margin."""

STABLE = 2.0
"""Semi-implicit Euler holds an oscillation for h omega below this; RK4 to 2.8."""

DEEP_CONTACT = 0.01
"""Overlap at the start, as a part of the smaller geom, above which it is named as a cause."""

SMALLEST, LARGEST = 1e-3, 1e3
"""Lengths [m] of hulls beyond which their units are asked about."""

SAME = 1e-3
"""Relative difference up to which two inertias are the same: meshes are kept as float32."""


class DivergenceError(RuntimeError):
    """The state is not a number, or not one that gravity, the waves and the start explain. `body`
    is the name of the body, `time` [s] when it was noticed; `str()` adds cause and remedy."""

    def __init__(self, body: str, time: float, what: str, remedy: str) -> None:
        self.body = body
        self.time = time
        super().__init__(f"body '{body}' diverged at {time:.4f} s: its {what}; {remedy}")


class Watch:
    """Holds a scene's energy against what explains it.

    `begin` before steps, `check` after them: what happens between `check` and the next
    `begin` is the caller's doing and is accepted.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.start = scene.data.qpos.copy()
        self._allowance = _allowances(scene)
        self._baseline: float | None = None
        self._last = 0.0

    def begin(self) -> None:
        """Take the energy as it is now as given."""
        energy = float(body_energies(self.scene).sum())
        self._baseline = energy + (0.0 if self._baseline is None else self._baseline - self._last)

    def check(self) -> None:
        """Raise DivergenceError when the energy cannot be explained."""
        scene = self.scene
        energies = body_energies(scene)
        self._last = float(energies.sum())
        if _is_driven(scene):
            self._baseline = self._last
            return
        gain, explained = self._last - self._baseline, MARGIN * float(self._allowance.sum())
        if gain <= explained:
            return
        ratios = (energies / np.maximum(self._allowance, 1e-3 * self._allowance.max()))[1:]
        body = 1 + int(np.argmax(ratios))
        what = (
            f"energy cannot be explained: the scene has {gain:.3g} J more than at the start, of "
            f"which gravity, waves and buoyancy explain at most {explained:.3g} J"
        )
        name = scene.model.body(body).name or f"body {body}"
        raise DivergenceError(name, scene.data.time, what, remedy(scene, self.start, body))


def _is_driven(scene: Scene) -> bool:
    """Whether something may feed energy in that is not accounted for."""
    model, data = scene.model, scene.data
    return bool(
        callback.is_other_set()
        or model.nu
        or model.neq
        or model.ntendon
        or model.nflex
        or model.nmocap
        or model.jnt_stiffness.any()
        or data.qfrc_applied.any()
        or np.delete(data.xfrc_applied, scene.buoyancy.bodies, axis=0).any()
    )


def body_energies(scene: Scene) -> Array:
    """Energy (nbody,) [J] of every body; needs no more than `qpos` and `qvel` to be current."""
    model, data = scene.model, scene.data
    sea = scene.buoyancy.sea
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_comVel(model, data)
    angular, at_reference = data.cvel[:, :3], data.cvel[:, 3:]
    arm = data.xipos - data.subtree_com[model.body_rootid]
    linear = at_reference + np.cross(angular, arm)
    axes = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bij,bi->bj", axes, angular)
    energies = 0.5 * (model.body_mass * (linear**2).sum(1) + (model.body_inertia * own**2).sum(1))
    energies += model.body_mass * sea.gravity * data.xipos[:, 2]
    for hull, floats in _of_each_hull(scene.buoyancy.floats):
        geoms, bodies = [f.geom for f in floats], [f.body for f in floats]
        depths, ups = sea.level - data.geom_xpos[geoms, 2], data.geom_xmat[geoms, 6:]
        rises = ups @ hull.vertices.T
        lows, highs = depths - rises.min(axis=1), depths - rises.max(axis=1)
        shares = np.clip(lows / (lows - highs), 0.0, 1.0)
        pushed = shares**2 * (depths - ups @ hull.centroid - np.minimum(highs, 0.0))
        volumes = hull.volume * np.array([f.displaced for f in floats])
        np.add.at(energies, bodies, sea.density * sea.gravity * volumes * pushed)
    return energies


def _of_each_hull(
    floats: Sequence[FloatingGeom],
) -> Iterable[tuple[Hull, list[FloatingGeom]]]:
    """Each hull, equal ones being one object, and the geoms that have it."""
    found: dict[int, tuple[Hull, list[FloatingGeom]]] = {}
    for f in floats:
        found.setdefault(id(f.method.hull), (f.method.hull, []))[1].append(f)
    return found.values()


def _allowances(scene: Scene) -> Array:
    """Change of energy (nbody,) [J] that a float may have: its own and the displaced water's weight
    times a quarter of its length (the error of `body_energies`) and the waves' height, and
    motion at twice the speed of the fastest wave."""
    model, sea = scene.model, scene.buoyancy.sea
    speed = max((np.sqrt(sea.gravity / w.wavenumber) for w in sea.waves), default=0.0)
    allowances = np.zeros(model.nbody)
    for f in scene.buoyancy.floats:
        hull, mass = f.method.hull, float(model.body_mass[f.body])
        length = float(np.linalg.norm(hull.bounds[1] - hull.bounds[0]))
        weight = (mass + sea.density * hull.volume) * sea.gravity
        allowances[f.body] += weight * (0.25 * length + 2.0 * sea.amplitude)
        allowances[f.body] += 2.0 * mass * speed**2
    return allowances


def remedy(scene: Scene, start: Array, body: int) -> str:
    """The usual causes that fit a body, with their numbers; in general terms when none does.

    start: (nq,) the positions that the run started with.
    """
    found = [
        _gravity_taken_away(scene, body),
        _other_units(scene, body),
        _too_long_a_timestep(scene, body),
        _overlap(scene, start, body),
        _legacy_inertia(scene, body),
        _cannot_float(scene, body),
    ]
    causes = [cause for cause in found if cause]
    if causes:
        return "; ".join(causes)
    return (
        f"try a timestep below {scene.model.opt.timestep:g} s, and check the body's mass and "
        "inertia and that the bodies do not overlap at the start"
    )


def _gravity_taken_away(scene: Scene, body: int) -> str:
    """What weighs nothing is thrown out of the water."""
    model = scene.model
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
        return "gravity is switched off by a flag, the water's push is not: enable it"
    if model.body_gravcomp[body] > 0.0:
        return (
            f"gravcomp takes {model.body_gravcomp[body]:g} of its weight away and the water pushes "
            "on: set gravcomp to 0 for what floats"
        )
    return ""


def _other_units(scene: Scene, body: int) -> str:
    for f in scene.buoyancy.floats:
        length = float(np.ptp(f.method.hull.bounds, axis=0).max())
        if f.body == body and not SMALLEST <= length <= LARGEST:
            return (
                f"geom '{f.name}' is {length:.3g} m long: if its mesh is in other units, give the "
                'asset a scale (millimetres: scale="0.001 0.001 0.001")'
            )
    return ""


def _too_long_a_timestep(scene: Scene, body: int) -> str:
    """omega^2 = density g A / m, A the hulls' area seen from above, m with half the added mass."""
    model, sea, timestep = scene.model, scene.buoyancy.sea, scene.model.opt.timestep
    area, mass = 0.0, float(model.body_mass[body])
    for f in scene.buoyancy.floats:
        if f.body == body:
            vertical = scene.data.geom_xmat[f.geom].reshape(3, 3)[2]
            area += 0.5 * float(np.abs(f.method.hull.area_vectors @ vertical).sum())
            if f.drag is not None and f.drag.added_mass is not None:
                mass += 0.5 * float(np.trace(f.drag.added_mass[:3, :3])) / 3.0
    omega = np.sqrt(sea.density * sea.gravity * area / mass) if mass > 0.0 else 0.0
    if not timestep * omega > 0.5 * STABLE:
        return ""
    return (
        f"the timestep of {timestep:g} s is too long for its heave: a waterplane of some "
        f"{area:.3g} m^2 under {mass:.3g} kg gives h omega = {timestep * omega:.2f}, and explicit "
        f"steps hold below {STABLE:g}; use a timestep below {0.5 * STABLE / omega:.1g} s, or give "
        "it its mass or added mass"
    )


def _overlap(scene: Scene, start: Array, body: int) -> str:
    model = scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = start
    mujoco.mj_fwdPosition(model, data)
    for contact in data.contact:
        geoms = [int(g) for g in contact.geom]
        bodies = [int(model.geom_bodyid[g]) for g in geoms]
        size = min(float(model.geom_rbound[g]) or np.inf for g in geoms)
        if body in bodies and -contact.dist > DEEP_CONTACT * size:
            names = " and ".join(f"'{model.geom(g).name or g}'" for g in geoms)
            return f"geoms {names} overlap by {-contact.dist:.3g} m at the start: move them apart"
    return ""


def _cannot_float(scene: Scene, body: int) -> str:
    mass = float(scene.model.body_subtreemass[scene.model.body_rootid[body]])
    root = scene.model.body_rootid[body]
    hulls = [f for f in scene.buoyancy.floats if scene.model.body_rootid[f.body] == root]
    displaced = scene.buoyancy.sea.density * sum(f.displaced * f.method.hull.volume for f in hulls)
    if not hulls or mass <= displaced:
        return ""
    return f"it cannot float: it has {mass:.4g} kg and displaces at most {displaced:.4g} kg"


def _legacy_inertia(scene: Scene, body: int) -> str:
    """Whether a body's inertia is that which MuJoCo's default makes of its only mesh."""
    model = scene.model
    floats = [f for f in scene.buoyancy.floats if f.body == body]
    if model.body_geomnum[body] != 1 or len(floats) != 1:
        return ""
    hull = floats[0].method.hull
    ratio = np.sort(model.body_inertia[body]) / model.body_mass[body]
    true_volume, true = _uniform_inertia(hull.vertices[hull.faces], signed=True)
    volume, legacy = _uniform_inertia(hull.vertices[hull.faces], signed=False)
    if np.allclose(ratio, true, rtol=SAME) or not np.allclose(ratio, legacy, rtol=SAME):
        return ""
    excess = 100.0 * (volume / true_volume - 1.0)
    return (
        f"its mesh inertia is the legacy one, for {excess:.1f} % more volume than the mesh has: "
        'set inertia="exact" on the mesh asset'
    )


def _uniform_inertia(corners: Array, signed: bool) -> tuple[float, Array]:
    """Volume and principal inertias (3,) over the mass, ascending, of the cones from a point to the
    triangles: first the middle of the surface, then the cones' own centre of mass. MuJoCo's legacy
    inertia is that with all cones counted as positive."""
    sizes = areas(corners)
    middle = sizes @ corners.mean(axis=1) / sizes.sum()
    for _ in range(2):
        about = corners - middle
        volumes = cone_volumes(about) if signed else np.abs(cone_volumes(about))
        middle = middle + cone_centroid(about, volumes)
    moments = cone_moments(about, volumes) / volumes.sum()
    return float(volumes.sum()), np.linalg.eigvalsh(inertia_of(moments))
