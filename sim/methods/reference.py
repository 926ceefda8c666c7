"""Reference: the wrench converged to a stated error, against which other methods are measured.

The hull's triangles are flat; the water's surface over them is curved. Triangles are halved in both
directions, level by level, until each piece is one of three:

- surely dry: it adds nothing;
- surely wet: the head is smooth, and Gauss quadrature integrates it. The difference of two orders
  estimates the error. A piece that exceeds its share of the tolerance is halved again;
- on the waterline: it is clipped straight, with the head linear over the piece. Only these few
  pieces are halved down to the smallest size. Their error falls with its third power: the second
  from the linear elevation, the first from the shrinking band.

"Surely" means deeper or higher than the sag of the surface over the piece: a linear interpolation
over a triangle within a circle of radius r has an error of at most M r^2 / 2, where M bounds the
surface's second derivatives everywhere. The surface is therefore never assumed to be flat between
the corners of a piece.
"""

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import area_vectors, areas, sides
from sim.hulls.hull import Hull
from sim.hulls.triangle import clipped, gauss_rule, sum_wet
from sim.methods.method import Method, Settings, pose_arrays
from sim.water.sea import Sea

Array = NDArray[np.float64]

SMALLEST_TOLERANCE = 1e-14
"""Smallest tolerance, as a share of density * gravity * volume. Round-off exceeds smaller ones."""

MOST_PIECES = 4_000_000
"""Maximum number of triangles at a level. Far from the origin in position or time the phases are
noise, and no halving would reach the tolerance."""

NOISE_TOLERANCES = 10.0
"""Largest round-off from the phases, in tolerances. It may exceed 1 because the round-off averages
out."""

MOST_HALVINGS = 24
"""Maximum number of halvings. They reduce a kilometre to a tenth of a millimetre; more would only
add round-off."""


class Reference(Method):
    """Wrench of a hull in a sea, converged to a tolerance.

    tolerance: error of the force over density * gravity * volume, and of the torque over that times
    the hull's largest distance from its frame's origin; halvings: maximum number of halvings.
    Raises ValueError for an invalid tolerance.

    It is slow: a call takes thousands to millions of heads. `wrench` raises RuntimeError if it does
    not reach the tolerance.
    """

    def __init__(
        self, hull: Hull, sea: Sea, tolerance: float = 1e-9, halvings: int = MOST_HALVINGS
    ) -> None:
        if not SMALLEST_TOLERANCE <= tolerance < np.inf:
            raise ValueError(
                f"the tolerance is {tolerance}; it must be finite and "
                f"{SMALLEST_TOLERANCE:g} or more"
            )
        super().__init__(hull, sea)
        self._tolerance = float(tolerance)
        self.halvings = halvings
        self._area = float(np.linalg.norm(hull.area_vectors, axis=1).sum())

    @classmethod
    def from_settings(cls, hull: Hull, sea: Sea, settings: Settings) -> Self:
        return cls(hull, sea, settings.reference_tolerance)

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        position, rotation, is_finite = pose_arrays(position, rotation, float(time))
        if not is_finite:
            return np.full(6, np.nan)
        self._check_phases(position, float(time))
        corners = (self.hull.vertices @ rotation.reshape(3, 3).T)[self.hull.faces]
        total = self._integrate(_Water(self.sea, position, float(time)), corners)
        return -self.sea.density * self.sea.gravity * total

    def _check_phases(self, position: Array, time: float) -> None:
        """Raise RuntimeError for a position or time so far off that the waves' phases are noise
        there. No halving would reach the tolerance."""
        waves, eps = self.sea.components, np.finfo(float).eps
        rates = 2.0 * np.pi * waves["frequency"] * abs(time)
        rates += waves["wavenumber"] * float(np.hypot(*position[:2]))
        noise = eps * float(waves["amplitude"] @ rates) * self._area / self.hull.volume
        if noise > NOISE_TOLERANCES * self._tolerance:
            raise RuntimeError(
                f"at {position.tolist()} m and {time:g} s, round-off of the waves' phases leaves a "
                f"relative error of {noise:.1g} in the wrench, above the tolerance "
                f"{self._tolerance:g}; use a larger tolerance or a position and time nearer to 0"
            )

    def _integrate(self, water: "_Water", corners: Array) -> Array:
        """Sum (6,) over - density gravity of the wet surface of triangles (N, 3, 3), given in world
        axes from the hull frame's origin."""
        allowed = (
            0.5 * self._tolerance * self.hull.volume
        )  # half for the wet, half for the waterline
        heads = water.heads(corners)
        total = np.zeros(6)
        for _ in range(self.halvings):
            sag = self.sea.curvature_bound * 0.5 * _horizontal_radius(corners) ** 2
            depths = water.depths(corners, heads)
            wet = depths.min(axis=1) >= sag
            dry = depths.max(axis=1) <= -sag
            sums, rough = self._integrate_wet(water, corners[wet], allowed / self._area)
            total += sums
            waterline = ~wet & ~dry
            children, child_heads, error = _halved(water, corners[waterline], heads[waterline])
            if error <= allowed and self._resolved(corners[waterline]).all():
                total += _sum_clipped(children, child_heads)
                children, child_heads = children[:0], child_heads[:0]
            if len(children) + len(rough) == 0:
                return total
            rough_children, rough_heads, _ = _halved(water, rough, water.heads(rough))
            corners = np.concatenate([children, rough_children])
            heads = np.concatenate([child_heads, rough_heads])
            if len(corners) > MOST_PIECES:
                break
        raise RuntimeError(
            f"the wrench did not converge to {self._tolerance:g} of density * gravity * volume in "
            f"{self.halvings} halvings or {MOST_PIECES:,} triangles; use a larger tolerance"
        )

    def _resolved(self, corners: Array) -> NDArray[np.bool_]:
        """Whether each triangle (N,) is small enough for samples to show the surface's shape.
        Samples on a large one may all meet the same phase of a short wave."""
        shortest = max((w.wavenumber for w in self.sea.waves), default=0.0)
        return _horizontal_radius(corners) * shortest <= 1.0 - self.sea.worst_steepness

    def _integrate_wet(
        self, water: "_Water", corners: Array, allowed: float
    ) -> tuple[Array, Array]:
        """Sum (6,) over the wet triangles whose quadrature error is below `allowed` [m] times their
        area, and the corners of the other triangles."""
        resolved = self._resolved(corners)
        unresolved, corners = corners[~resolved], corners[resolved]
        coarse, _ = _quadrature(water, corners, COARSE_RULE)
        head, moment = _quadrature(water, corners, FINE_RULE)
        good = np.abs(head - coarse) <= allowed
        area = area_vectors(corners[good])
        force = head[good] @ area
        torque = np.cross(moment[good], area).sum(axis=0)
        return np.concatenate([force, torque]), np.concatenate([corners[~good], unresolved])


class _Water:
    """Heads at points given from the hull frame's origin, at one time."""

    def __init__(self, sea: Sea, position: Array, time: float) -> None:
        self.sea, self.position, self.time = sea, position, time
        self._still = sea.hydrostatic

    def heads(self, points: Array) -> Array:
        """Heads (...) [m] at points (..., 3) [m]."""
        x, y, z = np.moveaxis(points + self.position, -1, 0)
        return self.sea.head(x, y, z, self.time)

    def depths(self, points: Array, heads: Array) -> Array:
        """Depths (...) [m] of the points below the surface directly above, from their heads."""
        if self._still is self.sea:
            return heads
        x, y, z = np.moveaxis(points + self.position, -1, 0)
        return self._still.head(x, y, z, self.time)


def _horizontal_radius(corners: Array) -> Array:
    """Radius (N,) [m] of a circle that covers the triangle, seen from above: its longest side over
    the root of 3 (Jung's theorem)."""
    return sides(corners[..., :2]).max(axis=1) / np.sqrt(3.0)


def _halved(water: _Water, corners: Array, heads: Array) -> tuple[Array, Array, float]:
    """Four children of each triangle, their heads, and the error of the volume [m^3] from linear
    elevation over the children. It is a quarter of the parents' error, which the midpoints
    integrate exactly to second order."""
    middles = 0.5 * (corners + np.roll(corners, -1, axis=1))  # of the sides ab, bc, ca
    middle_heads = water.heads(middles)
    deviation = np.abs(middle_heads - 0.5 * (heads + np.roll(heads, -1, axis=1))).mean(axis=1)
    error = float(0.25 * deviation @ areas(corners))
    children = np.concatenate(
        [np.stack([corners[:, i], middles[:, i], middles[:, i - 1]], axis=1) for i in range(3)]
        + [middles]
    )
    child_heads = np.concatenate(
        [np.stack([heads[:, i], middle_heads[:, i], middle_heads[:, i - 1]], axis=1)
         for i in range(3)]
        + [middle_heads]
    )  # fmt: skip
    return children, child_heads, error


def _sum_clipped(corners: Array, heads: Array) -> Array:
    total = np.empty(6)
    sum_wet(*clipped(corners, heads), total)
    return total


COARSE_RULE, FINE_RULE = gauss_rule(4), gauss_rule(6)


def _quadrature(water: _Water, corners: Array, rule: tuple[Array, Array]) -> tuple[Array, Array]:
    """Means over triangles of the head (N,) [m] and of head times position (N, 3) [m^2]."""
    points, weights = rule
    places = np.einsum("qc,ncx->nqx", points, corners)
    weighted = water.heads(places) * weights
    return weighted.sum(axis=1), np.einsum("nq,nqx->nx", weighted, places)
