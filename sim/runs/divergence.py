"""Divergence: a state that cannot be, and which of the usual causes fits it.

MuJoCo reports numbers that are not finite itself; `watch` finds states that are finite and yet
nothing explains.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import areas, cone_centroid, cone_moments, cone_volumes, inertia_of
from sim.plugin.refusals import reading
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

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
    with reading():  # also of a model that would be refused by now
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
