"""Report: the hydrostatics of a body in the terms of naval architects."""

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix, rotation_about
from sim.statics.equilibrium import Attitude, RigidFloat, rest
from sim.statics.joints import Joint, JointedFloat
from sim.statics.stability import righting_arms, vanishing_angle
from sim.statics.wetted import Wetted, wetted_part

Array = NDArray[np.float64]

LARGEST_HEEL = 175.0
"""Heel [deg] up to which righting arms are computed, to find where they vanish."""

ROUND_OFF_SHARE = 1e-9
"""Share of the weight [N]: a smaller stiffness [N/m, N m] is round-off."""

NEUTRAL_SHARE = 1e-6
"""Share of the displaced mass within which a body's mass equals it: the body is neutral."""

CENTRED_SHARE = 1e-9
"""Share of the size: a centre of buoyancy that is nearer to the centre of mass is at it."""

MOST_RESTS = 1000
"""Largest number of attitudes in `_RESTS`."""

_RESTS: dict[bytes, Attitude] = {}
"""Attitudes at rest by a digest of everything that they depend on. Notes, reports, recordings and
equal bodies share them."""


class JointMotion(TypedDict):
    """The small motion of a joint around the rest. stiffness [N m/rad] of a hinge, [N/m] of a
    slide, with the joint's spring."""

    joint: str
    is_hinge: bool
    stiffness: float
    period_s: float | None


@dataclass(frozen=True)
class Rest:
    """A body at rest in still water.

    Axes: x along the bow (the body's x axis, seen from above), y to port, z up. heel is a rotation
    about x, starboard down; trim is a rotation about y, bow down. height is the height of the
    body's origin. K is the lowest point of the hulls. The centres of buoyancy (lcb, tcb) and of the
    waterplane (lcf, tcf) are measured ahead and to port from the body's origin. stiffness and
    added_mass (6, 6) are about the centre of mass, along the axes above, in the order surge, sway,
    heave, roll, pitch, yaw.

    These may be None: the waterplane's lcf, tcf, length lwl, breadth bwl, block coefficient cb and
    waterplane coefficient cwp, if the body is wholly under water; the period of each uncoupled
    motion, if nothing restores it; largest_timestep, at which the stiffest oscillation begins to
    grow, if nothing oscillates; gz, rows of heel [deg] from the rest and righting arm [m], free to
    sink and trim, if it was not asked for; vanishing, the heel at which gz vanishes, if there is
    none.

    A body that only moves by its joints has `joints` instead of gz and of the periods of heave,
    roll and pitch: for each joint its name, stiffness and period (None if nothing restores it).
    joints is None for a free body.
    """

    draught_m: float
    heel_deg: float
    trim_deg: float
    height_m: float
    tilt_from_start_deg: float
    displacement_m3: float
    submerged_fraction: float
    kb_m: float
    lcb_m: float
    tcb_m: float
    bmt_m: float
    bml_m: float
    kg_m: float
    gmt_m: float
    gml_m: float
    waterplane_m2: float
    wetted_m2: float
    stiffness: list[list[float]]
    added_mass: list[list[float]]
    lcf_m: float | None
    tcf_m: float | None
    lwl_m: float | None
    bwl_m: float | None
    cb: float | None
    cwp: float | None
    heave_period_s: float | None
    roll_period_s: float | None
    pitch_period_s: float | None
    largest_timestep_s: float | None
    gz: list[list[float]] | None
    vanishing_deg: float | None
    joints: list[JointMotion] | None


@dataclass(frozen=True)
class Hydrostatics:
    """The hydrostatics of a tree of bodies. rest: None if it does not come to rest; reason says
    why. submerged: then the same figures of the body wholly under water, upright (its centre of
    buoyancy above its centre of mass), where it starts or as high as it can be."""

    name: str
    mass_kg: float
    volume_m3: float
    relative_density: float
    rest: Rest | None
    reason: str
    submerged: Rest | None = None

    def flat(self) -> dict[str, Any]:
        """All figures of the body and its rest by name; or of the body under water, and the
        reason."""
        figures = dict(vars(self), sinks=self.relative_density >= 1.0)
        rest, reason, submerged = map(figures.pop, ("rest", "reason", "submerged"))
        if rest:
            return figures | vars(rest)
        return figures | (vars(submerged) if submerged else {}) | {"reason": reason}


@dataclass(frozen=True, eq=False)
class AddedMass:
    """The added mass of a hull. Its arrays are in the body's axes, about its centre of mass.

    corners: (F, 3, 3) [m], of the hull's triangles. matrix: (6, 6), of the submerged hull. grip:
    (3, 3), projection on the axes about which it acts at the centroid of the wet part (see
    `resistance.reaction`).
    """

    corners: Array
    matrix: Array
    grip: Array

    def at(self, attitude: Attitude) -> Array:
        """The added mass (6, 6) of the wet part in an attitude."""
        deep = -2.0 * float(np.abs(self.corners).sum(axis=2).max())
        wet, whole = (
            wetted_part(self.corners, np.ones(len(self.corners)), attitude.rotation, height)
            for height in (attitude.height, deep)
        )
        shift = wet.centre - whole.centre - [0.0, 0.0, attitude.height - deep]
        motion = np.eye(6)
        motion[:3, 3:] = np.cross(self.grip, attitude.rotation.T @ shift, axis=0)
        return wet.volume / whole.volume * motion.T @ self.matrix @ motion


@dataclass(frozen=True, eq=False, kw_only=True)
class FloatingBody(RigidFloat):
    """A RigidFloat that is released in still water. Its arrays are in the body's axes.

    origin: (3,) [m], of its frame, from the centre of mass. inertia: (6, 6), about the centre of
    mass. added_masses: of its hulls. start: its attitude at the release. level [m]: the water's
    height in the world. joints: what it can move by; None for a free body.
    """

    name: str
    origin: Array
    inertia: Array
    added_masses: tuple[AddedMass, ...]
    start: Attitude
    level: float
    joints: tuple[Joint, ...] | None = None

    @property
    def reason(self) -> str:
        """Why it does not come to rest; "" if it does."""
        most = self.density * self.volume
        if self.joints is not None:
            return "" if self.values_at_rest is not None else "finds no rest on its joints"
        if abs(self.mass - most) <= NEUTRAL_SHARE * most:
            return f"is neutral: it weighs {self.mass:.4g} kg and rests at any depth"
        if self.mass < most:
            return ""
        return f"sinks: it weighs {self.mass:.4g} kg and displaces at most {most:.4g} kg"

    def added_mass(self, attitude: Attitude) -> Array:
        """Added mass (6, 6) of the wet parts of its hulls in an attitude."""
        return sum((hull.at(attitude) for hull in self.added_masses), np.zeros((6, 6)))

    @cached_property
    def jointed(self) -> JointedFloat:
        """The same body as one that moves only by its joints."""
        return JointedFloat(self, self.start, self.joints or ())

    @cached_property
    def values_at_rest(self) -> Array | None:
        """Values (J,) of the joints at rest, from the start; None if there is no rest."""
        return self.jointed.at_rest()

    @property
    def under_water(self) -> Attitude:
        """The attitude wholly under water with the centre of buoyancy above the centre of mass: as
        high as at the start, or as high as possible."""
        deep = self.wetted(Attitude(-2.0 * self.size, np.eye(3)))
        up = deep.centre + [0.0, 0.0, 2.0 * self.size]
        rotation, arm = self.start.rotation, np.linalg.norm(up)
        if arm > CENTRED_SHARE * self.size:
            now = rotation @ up / arm
            axis = np.cross(now, [0.0, 0.0, 1.0])
            sine = float(np.linalg.norm(axis))
            angle = np.arctan2(sine, now[2])
            if sine < CENTRED_SHARE:  # upright, or upside down
                axis, sine = np.array([1.0, 0.0, 0.0]), 1.0
            rotation = rotation_about(angle * axis / sine) @ rotation
        rotation = bow_ahead(rotation)
        top = float((self.corners @ rotation.T)[:, :, 2].max())
        return Attitude(min(self.start.height, -top - CENTRED_SHARE * self.size), rotation)

    @cached_property
    def at_rest(self) -> Attitude | None:
        """Its attitude at rest, with the bow along the world's x axis; None if it has a
        `reason`."""
        if self.reason:
            return None
        if self.joints is not None:
            assert self.values_at_rest is not None  # else there is a reason
            height, rotation = self.jointed.pose(self.values_at_rest).attitude
            return Attitude(height, bow_ahead(rotation))
        ahead = bow_ahead(self.start.rotation)
        inputs = self.corners, self.shares, [self.mass, self.density, self.gravity], ahead
        key = sha256(b"".join(np.asarray(values).tobytes() for values in inputs)).digest()
        if key not in _RESTS:
            height, rotation = rest(self, ahead)
            if len(_RESTS) >= MOST_RESTS:
                _RESTS.clear()
            _RESTS[key] = Attitude(height, bow_ahead(rotation))
        return _RESTS[key]

    @property
    def turned(self) -> float:
        """Angle [deg] between the vertical in the body's axes at the start and at rest; 0 without a
        rest."""
        end = self.at_rest or self.start
        before, now = self.start.rotation[2], end.rotation[2]
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(before, now)), before @ now)))


def report(body: FloatingBody, omega_h: float, with_gz: bool = True) -> Hydrostatics:
    """The Hydrostatics of a body. omega_h: limit of angular frequency [rad/s] times timestep [s]
    above which an undamped oscillation grows. with_gz: whether to compute righting arms, which
    takes most of the time."""
    rest, submerged = None, None
    if body.at_rest is not None:
        rest = _figures(body, body.at_rest, omega_h, with_gz)
    elif body.joints is None:
        submerged = _figures(body, body.under_water, omega_h, False)
    relative_density = body.mass / (body.density * body.volume)
    figures = body.mass, body.volume, relative_density, rest, body.reason, submerged
    return Hydrostatics(body.name, *figures)


def _figures(body: FloatingBody, attitude: Attitude, omega_h: float, with_gz: bool) -> Rest:
    """The figures of a body in an attitude."""
    wetted = body.wetted(attitude)
    figures = _place(body, attitude, wetted) | _motions(body, attitude, wetted, omega_h)
    if body.joints is not None:
        values = body.values_at_rest
        assert values is not None  # else the body has a reason
        return Rest(**figures | _joint_motions(body, values, omega_h))
    return Rest(**figures, **_righting(body, attitude, with_gz), joints=None)


def heel_and_trim(up: Array) -> tuple[Array, Array]:
    """Heel and trim [rad] of bodies from the vertical (..., 3) in their axes: first the heel about
    the bow, then the trim about the horizontal."""
    trim = -np.arcsin(np.clip(up[..., 0], -1.0, 1.0))
    return np.arctan2(up[..., 1], up[..., 2]), trim


def bow_ahead(rotation: Array) -> Array:
    """A rotation (3, 3) rotated about the vertical until the body's x axis, seen from above, lies
    along the world's x axis; or its z axis, if the bow points straight up or down."""
    ahead = rotation[:2, 0] if np.hypot(*rotation[:2, 0]) > 1e-6 else rotation[:2, 2]
    c, s = ahead / np.linalg.norm(ahead)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation


def _place(body: FloatingBody, attitude: Attitude, wetted: Wetted) -> dict[str, Any]:
    """Attitude, displacement, centres, metacentres and waterplane."""
    corners, area, volume = body.placed(attitude), wetted.waterplane, wetted.volume
    keel = float(corners[:, :, 2].min())
    heel, trim = np.degrees(heel_and_trim(attitude.rotation[2])).tolist()
    x, y, z = (attitude.rotation @ body.origin).tolist()
    bx, by, bz = wetted.centre.tolist()
    fx = fy = length = breadth = cb = cwp = None
    bmt = bml = 0.0
    if area > 0.0 and corners[:, :, 2].max() >= 0.0:  # under water the area is round-off
        fx, fy = (wetted.plane_moment / area).tolist()
        squares = wetted.plane_squares - area * np.outer([fx, fy], [fx, fy])
        bml, bmt = (np.diag(squares) / volume).tolist()
        fx, fy = fx - x, fy - y
        length, breadth = _extents(corners)
        cb, cwp = volume / (length * breadth * -keel), area / (length * breadth)
    kb, kg = bz - keel, attitude.height - keel
    return dict(
        draught_m=-keel, heel_deg=heel, trim_deg=trim, height_m=body.level + attitude.height + z,
        tilt_from_start_deg=body.turned, displacement_m3=volume,
        submerged_fraction=volume / body.volume, kb_m=kb, kg_m=kg, lcb_m=bx - x, tcb_m=by - y,
        bmt_m=bmt, bml_m=bml, gmt_m=kb + bmt - kg, gml_m=kb + bml - kg, waterplane_m2=area,
        wetted_m2=wetted.surface, lcf_m=fx, tcf_m=fy, lwl_m=length, bwl_m=breadth, cb=cb, cwp=cwp,
    )  # fmt: skip


def _extents(corners: Array) -> tuple[float, float]:
    """Length and breadth [m] of the waterplane."""
    a, b = corners, np.roll(corners, -1, axis=1)
    crossing = (a[:, :, 2] < 0.0) != (b[:, :, 2] < 0.0)
    a, b = a[crossing], b[crossing]
    share = a[:, 2] / (a[:, 2] - b[:, 2])
    length, breadth, _ = np.ptp(a + share[:, None] * (b - a), axis=0).tolist()
    return length, breadth


def _motions(
    body: FloatingBody, attitude: Attitude, wetted: Wetted, omega_h: float
) -> dict[str, Any]:
    """Stiffness, added mass, periods, and the largest timestep."""
    inertia, added = (
        moved_matrix(matrix, np.zeros(3), attitude.rotation.T)
        for matrix in (body.inertia, body.added_mass(attitude))
    )
    stiffness, heave_roll_pitch = np.zeros((6, 6)), slice(2, 5)
    stiff = body.stiffness(attitude, wetted)
    stiffness[heave_roll_pitch, heave_roll_pitch] = stiff
    mass = (inertia + added)[heave_roll_pitch, heave_roll_pitch]
    fastest = np.sqrt(max(np.linalg.eigvals(np.linalg.solve(mass, stiff)).real.max(), 0.0))
    periods = [
        2.0 * np.pi * float(np.sqrt(m / k)) if k > ROUND_OFF_SHARE * body.weight else None
        for m, k in zip(np.diag(mass), np.diag(stiff), strict=True)
    ]
    return dict(
        stiffness=stiffness.tolist(), added_mass=added.tolist(),
        heave_period_s=periods[0], roll_period_s=periods[1], pitch_period_s=periods[2],
        largest_timestep_s=float(omega_h / fastest) if fastest > 0.0 else None,
    )  # fmt: skip


def _joint_motions(body: FloatingBody, values: Array, omega_h: float) -> dict[str, Any]:
    """The motions of a body's joints around their values (J,) at rest, and the largest timestep,
    instead of those of a free body."""
    jointed = body.jointed
    pose, stiffness = jointed.pose(values), jointed.stiffness(values)
    own = body.inertia + body.added_mass(pose.attitude)
    world = moved_matrix(own, np.zeros(3), pose.rotation.T)
    mass = pose.motions.T @ world @ pose.motions + np.diag([j.armature for j in jointed.joints])
    least = ROUND_OFF_SHARE * body.weight
    moving = [
        JointMotion(
            joint=j.name, is_hinge=j.is_hinge, stiffness=float(k),
            period_s=2.0 * np.pi * float(np.sqrt(m / k)) if k > least else None,
        )
        for j, m, k in zip(jointed.joints, np.diag(mass), np.diag(stiffness), strict=True)
    ]  # fmt: skip
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real.max(initial=0.0)
    return dict(
        gz=None, vanishing_deg=None, heave_period_s=None, roll_period_s=None, pitch_period_s=None,
        largest_timestep_s=omega_h / float(np.sqrt(squares)) if squares > 0.0 else None,
        joints=moving,
    )  # fmt: skip


def _righting(body: FloatingBody, attitude: Attitude, is_asked: bool) -> dict[str, Any]:
    if not is_asked:
        return dict(gz=None, vanishing_deg=None)
    arms = righting_arms(body, attitude.rotation, LARGEST_HEEL)
    vanishing = vanishing_angle(body, attitude.rotation, arms)
    return dict(gz=arms[arms[:, 0] <= 90.0].tolist(), vanishing_deg=vanishing)
