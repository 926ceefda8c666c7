"""Report: the hydrostatics of a body in the terms of naval architects."""

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix
from sim.statics.equilibrium import Attitude, RigidFloat, rest
from sim.statics.stability import righting_arms, vanishing_angle
from sim.statics.wetted import Wetted

Array = NDArray[np.float64]

LARGEST_HEEL = 175.0
"""Heel [deg] up to which righting arms are computed, to find where they vanish."""

ROUND_OFF_SHARE = 1e-9
"""Share of the weight [N]: a smaller stiffness [N/m, N m] is round-off."""

MOST_RESTS = 1000
"""Largest number of attitudes in `_RESTS`."""

_RESTS: dict[bytes, Attitude] = {}
"""Attitudes at rest by a digest of everything that they depend on. Notes, reports, recordings and
equal bodies share them."""


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


@dataclass(frozen=True)
class Hydrostatics:
    """The hydrostatics of a tree of bodies. rest: None if it does not come to rest; reason says
    why."""

    name: str
    mass_kg: float
    volume_m3: float
    relative_density: float
    rest: Rest | None
    reason: str

    def flat(self) -> dict[str, Any]:
        """All figures of the body and its rest by name, or the reason instead of the rest."""
        figures = dict(vars(self), sinks=self.relative_density >= 1.0)
        rest, reason = figures.pop("rest"), figures.pop("reason")
        return figures | (vars(rest) if rest else {"reason": reason})


@dataclass(frozen=True, eq=False, kw_only=True)
class FloatingBody(RigidFloat):
    """A RigidFloat that is released in still water. Its arrays are in the body's axes.

    origin: (3,) [m], of its frame, from the centre of mass. inertia, added_mass: (6, 6), about the
    centre of mass; the added mass is that of the whole body under water. start: its attitude at the
    release. level [m]: the water's height in the world.
    """

    name: str
    origin: Array
    inertia: Array
    added_mass: Array
    start: Attitude
    level: float

    @property
    def reason(self) -> str:
        """Why it does not come to rest; "" if it does."""
        most = self.density * self.volume
        if self.mass < most:
            return ""
        return f"sinks: it weighs {self.mass:.4g} kg and displaces at most {most:.4g} kg"

    @cached_property
    def at_rest(self) -> Attitude | None:
        """Its attitude at rest, with the bow along the world's x axis; None if it has a
        `reason`."""
        if self.reason:
            return None
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
    rest, attitude = None, body.at_rest
    if attitude is not None:
        wetted = body.wetted(attitude)
        rest = Rest(
            **_place(body, attitude, wetted),
            **_motions(body, attitude, wetted, omega_h),
            **_righting(body, attitude, with_gz),
        )
    relative_density = body.mass / (body.density * body.volume)
    return Hydrostatics(body.name, body.mass, body.volume, relative_density, rest, body.reason)


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
    if area > 0.0:
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
        for matrix in (body.inertia, body.added_mass * wetted.volume / body.volume)
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


def _righting(body: FloatingBody, attitude: Attitude, is_asked: bool) -> dict[str, Any]:
    if not is_asked:
        return dict(gz=None, vanishing_deg=None)
    arms = righting_arms(body, attitude.rotation, LARGEST_HEEL)
    vanishing = vanishing_angle(body, attitude.rotation, arms)
    return dict(gz=arms[arms[:, 0] <= 90.0].tolist(), vanishing_deg=vanishing)
