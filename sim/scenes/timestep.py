"""Timestep: finds the bodies for which the timestep is too long.

The water is a spring, and no integrator of MuJoCo knows its stiffness. An oscillation does not grow
only if timestep * omega is below the integrator's limit. A body beyond the limit gains energy each
time it meets the water and may be thrown kilometres high, with every number finite.

Added mass that differs between directions has the same effect. It turns a body of speed v by the
moment v x (A v), so that the body swings about its broadside with omega = v sqrt(dA / I). dA is the
largest difference between added masses, and I the smallest moment of inertia (Munk 1924). The
moment is taken explicitly in time.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix
from sim.mjcf.floats import FloatingGeom, body_label
from sim.plugin.refusals import reading
from sim.scenes.hydrostatics import Afloat, largest_omega_h

Array = NDArray[np.float64]

SAFE_SHARE = 0.75
"""Share of the integrator's limit that is safe. Balls, plates, boxes and capsules that are dropped
into the water gain hardly any energy up to it. Capsules fly up from 0.8 on, balls from 0.9 on."""

SAFE_SWING_SHARE = 0.15
"""The same for the swing by unequal added mass. Boxes of 0.01 to 0.2 of the water's density are
thrown within 20 s from 0.15 on without drag, and from 1.5 on with drag."""

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


class Motion(NamedTuple):
    """A motion that is explicit in time: its angular frequency [rad/s], the share of the
    integrator's limit that is safe, and the properties of the body that it depends on."""

    name: str
    omega: float
    safe_share: float
    depends_on: str


def unstable_bodies(scene: Afloat) -> Iterator[UnstableBody]:
    """The bodies for which the scene's timestep is too long."""
    model = scene.model
    with reading():  # this state needs no water
        data = mujoco.MjData(model)
    for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_crb, mujoco.mj_factorM):
        update(model, data)
    welded: dict[int, list[FloatingGeom]] = {}
    for f in scene.buoyancy.floats:
        welded.setdefault(int(model.body_weldid[f.body]), []).append(f)
    for body, floats in welded.items():
        mass = float(model.body_mass[model.body_weldid == body].sum())
        volume = sum(f.displaced * f.method.hull.volume for f in floats)
        lift = scene.buoyancy.sea.density * volume / mass
        geoms = [geom for f in floats for geom in f.geoms]
        distances = np.linalg.norm(data.geom_xpos[geoms] - data.xipos[body], axis=1)
        reach = float((distances + model.geom_rbound[geoms]).max())
        motions = _motions(scene, data, body, floats, min(WET_SHARE, 1.0 / lift), reach)
        name, omega, safe_share, depends_on = max(motions, key=lambda m: m.omega / m.safe_share)
        limit = safe_share * largest_omega_h(model)
        if model.opt.timestep * omega <= limit:
            continue
        yield UnstableBody(
            body,
            lift,
            reach,
            remedy=(
                f"a timestep of {model.opt.timestep:g} s is too long for its {name}, with a "
                f"period of {2.0 * np.pi / omega:.2g} s; use "
                f"{ADVISED_SHARE * limit / omega:.1g} s, or check its {depends_on}"
            ),
        )


def notes_about_timestep(scene: Afloat) -> Iterator[str]:
    """Notes about bodies for which the timestep is too long."""
    for unstable in unstable_bodies(scene):
        yield f"body '{body_label(scene.model, unstable.body)}': {unstable.remedy}"


def _motions(
    scene: Afloat,
    data: mujoco.MjData,
    body: int,
    floats: list[FloatingGeom],
    wet_share: float,
    reach: float,
) -> tuple[Motion, Motion]:
    """The fastest motion of a body in heave, roll and pitch, as its joints allow, and its swing by
    unequal added mass, at the speed of a fall over twice its reach [m].

    The water is stiffest when a hull is half under it; its waterplane is then its outline from
    above. The body may turn over, so the outlines along all three axes count. wet_share: the share
    of the added mass that counts.
    """
    centre, sea = data.xipos[body], scene.buoyancy.sea
    stiffnesses, added = _springs(scene, data, centre, floats)
    mobility = _mobility(scene.model, data, body)
    mobility = np.linalg.solve(np.eye(6) + wet_share * mobility @ added, mobility)
    squares = np.linalg.eigvals(mobility @ stiffnesses).real
    on_water = float(np.sqrt(max(squares.max(), 0.0)))
    unequal = float(np.ptp(np.linalg.eigvalsh(added[:3, :3])))
    turn = float(np.linalg.eigvalsh(mobility[3:, 3:])[-1])
    swing = 2.0 * np.sqrt(sea.gravity * reach * unequal * max(turn, 0.0))
    return (
        Motion("fastest motion on the water", on_water, SAFE_SHARE, "mass and inertia"),
        Motion("swing by unequal added mass", swing, SAFE_SWING_SHARE, "added mass, or add drag"),
    )


def _springs(
    scene: Afloat, data: mujoco.MjData, centre: Array, floats: list[FloatingGeom]
) -> tuple[Array, Array]:
    """Stiffness (3, 6, 6) of the water around a body that lies along each of the three axes, and
    its whole added mass (6, 6), both about its centre of mass."""
    sea, stiffnesses, added = scene.buoyancy.sea, np.zeros((3, 6, 6)), np.zeros((6, 6))
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
            added += moved_matrix(f.drag.added_mass, rotation.T @ -arm, rotation.T)
    return stiffnesses, added


def _mobility(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> Array:
    """Accelerations (6, 6) of a body's centre of mass by unit forces and torques there, without
    added mass."""
    jacobian, response = np.zeros((2, 6, model.nv))
    mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], data.xipos[body], body)
    mujoco.mj_solveM(model, data, response, jacobian)
    return response @ jacobian.T
