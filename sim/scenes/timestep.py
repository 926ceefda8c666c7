"""Timestep: finds the bodies for which the timestep is too long.

The water is a spring, and no integrator of MuJoCo knows its stiffness. An oscillation does not grow
only if timestep * omega is below the integrator's limit. A body beyond the limit gains energy each
time it meets the water and may be thrown kilometres high, with every number finite.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from sim.geometry import moved_matrix
from sim.mjcf.floats import FloatingGeom, body_label
from sim.plugin.refusals import reading
from sim.scenes.hydrostatics import Afloat, largest_omega_h

SAFE_SHARE = 0.75
"""Share of the integrator's limit that is safe. Balls, plates, boxes and capsules that are dropped
into the water gain hardly any energy up to it. Capsules fly up from 0.8 on, balls from 0.9 on."""

ADVISED_SHARE = 0.5
"""Share of the longest safe timestep that is advised. Rounded to one digit it is still safe."""

WET_SHARE = 0.5
"""Largest share of the added mass that counts: the share of a hull that is half under water. A body
that floats higher has its share at rest."""


@dataclass(frozen=True)
class UnstableBody:
    """A body, with all bodies welded to it, whose oscillation on the water grows.

    lift: buoyancy under water over weight. reach [m]: the largest distance of its hulls' surfaces
    from its centre of mass. remedy: the fault and what to do.
    """

    body: int
    lift: float
    reach: float
    remedy: str


def unstable_bodies(scene: Afloat) -> Iterator[UnstableBody]:
    """The bodies for which the scene's timestep is too long."""
    model = scene.model
    with reading():  # this state needs no water
        data = mujoco.MjData(model)
    for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_crb, mujoco.mj_factorM):
        update(model, data)
    limit = SAFE_SHARE * largest_omega_h(model)
    welded: dict[int, list[FloatingGeom]] = {}
    for f in scene.buoyancy.floats:
        welded.setdefault(int(model.body_weldid[f.body]), []).append(f)
    for body, floats in welded.items():
        mass = float(model.body_mass[model.body_weldid == body].sum())
        volume = sum(f.displaced * f.method.hull.volume for f in floats)
        lift = scene.buoyancy.sea.density * volume / mass
        omega = _fastest(scene, data, body, floats, min(WET_SHARE, 1.0 / lift))
        if model.opt.timestep * omega <= limit:
            continue
        geoms = [geom for f in floats for geom in f.geoms]
        distances = np.linalg.norm(data.geom_xpos[geoms] - data.xipos[body], axis=1)
        yield UnstableBody(
            body,
            lift,
            reach=float((distances + model.geom_rbound[geoms]).max()),
            remedy=(
                f"a timestep of {model.opt.timestep:g} s is too long for its fastest motion on the "
                f"water, with a period of {2.0 * np.pi / omega:.2g} s; use "
                f"{ADVISED_SHARE * limit / omega:.1g} s, or check its mass and inertia"
            ),
        )


def notes_about_timestep(scene: Afloat) -> Iterator[str]:
    """Notes about bodies for which the timestep is too long."""
    for unstable in unstable_bodies(scene):
        yield f"body '{body_label(scene.model, unstable.body)}': {unstable.remedy}"


def _fastest(
    scene: Afloat, data: mujoco.MjData, body: int, floats: list[FloatingGeom], wet_share: float
) -> float:
    """Largest angular frequency [rad/s] of a body in heave, roll and pitch, as its joints allow.

    The water is stiffest when a hull is half under it; its waterplane is then its outline from
    above. The body may turn over, so the outlines along all three axes count. wet_share: the share
    of the added mass that counts.
    """
    model, sea, centre = scene.model, scene.buoyancy.sea, data.xipos[body]
    stiffnesses, added = np.zeros((3, 6, 6)), np.zeros((6, 6))
    for f in floats:
        hull, rotation = f.method.hull, data.geom_xmat[f.geom].reshape(3, 3)
        arm, corners = data.geom_xpos[f.geom] - centre, hull.vertices[hull.faces]
        mid_edges = (0.5 * (corners + np.roll(corners, 1, axis=1))).reshape(-1, 3)
        mid_edges = mid_edges @ rotation.T + arm
        points = np.column_stack([mid_edges, np.ones(len(mid_edges))])
        centroid = rotation @ hull.centroid + arm
        for axis, stiffness in zip(np.eye(3), stiffnesses, strict=True):
            # each edge midpoint has a third of its face; both sides of the hull cover the outline
            outline = np.abs(hull.area_vectors @ rotation.T @ axis).repeat(3) / 6.0
            moments = sea.density * sea.gravity * f.displaced * (points.T * outline) @ points
            rises = np.zeros((6, 4))  # of a point, in each of the body's six motions
            rises[:3, 3], rises[3:, :3] = axis, np.cross(np.eye(3), axis).T
            stiffness += rises @ moments @ rises.T
            # the centre of buoyancy lies below the waterplane, which makes the body turn over
            depth = np.append(axis, -axis @ centroid)
            across = np.eye(3) - np.outer(axis, axis)
            stiffness[3:, 3:] -= 0.5 * (depth @ moments @ depth) * across
        if f.drag is not None and f.drag.added_mass is not None:
            added += wet_share * moved_matrix(f.drag.added_mass, rotation.T @ -arm, rotation.T)
    jacobian, response = np.zeros((2, 6, model.nv))
    mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], centre, body)
    mujoco.mj_solveM(model, data, response, jacobian)
    mobility = response @ jacobian.T
    mobility = np.linalg.solve(np.eye(6) + mobility @ added, mobility)
    squares = np.linalg.eigvals(mobility @ stiffnesses).real
    return float(np.sqrt(max(squares.max(), 0.0)))
