"""Primitives: closed surfaces of boxes, balls, cylinders and capsules, as Hulls.

Round shapes have facets. Their corners lie slightly outside the true surface and the middles of
their facets inside, so that the volume is exact.
"""

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from sim.hulls.hull import Hull

BALL_SUBDIVISIONS = 3
"""Number of subdivisions of an icosahedron. 3 give 1280 faces, within 0.3 % of the radius from the
true surface. One more gives four times the faces and a quarter of that distance."""

ROUND_SECTIONS = 64
"""Number of sides of a cylinder or capsule. 64 lie within 0.15 % of the radius from the true
surface."""


def box(x: float, y: float, z: float) -> Hull:
    """A box with half sides x, y, z [m]."""
    return _scaled(trimesh.creation.box(extents=(2.0, 2.0, 2.0)), (x, y, z))


def ellipsoid(x: float, y: float, z: float) -> Hull:
    """An ellipsoid with semi-axes x, y, z [m]."""
    mesh = trimesh.creation.icosphere(subdivisions=BALL_SUBDIVISIONS)
    mesh.apply_scale((4.0 / 3.0 * np.pi / mesh.volume) ** (1.0 / 3.0))
    return _scaled(mesh, (x, y, z))


def sphere(radius: float) -> Hull:
    """A ball with a radius [m]."""
    return ellipsoid(radius, radius, radius)


def cylinder(radius: float, half_length: float) -> Hull:
    """A cylinder along z with a radius [m] and half its length [m]."""
    mesh = trimesh.creation.cylinder(radius=1.0, height=2.0, sections=ROUND_SECTIONS)
    return _scaled(_widened(mesh, 2.0 * np.pi), (radius, radius, half_length))


def capsule(radius: float, half_length: float) -> Hull:
    """A cylinder along z with a radius [m] and half its length [m], and half a ball on each end."""
    count = ROUND_SECTIONS // 2, ROUND_SECTIONS
    mesh = trimesh.creation.capsule(radius=1.0, height=2.0, count=count)
    ratio = half_length / radius
    beyond = np.maximum(np.abs(mesh.vertices[:, 2]) - 1.0, 0.0)
    middle = np.clip(mesh.vertices[:, 2], -1.0, 1.0)
    mesh.vertices[:, 2] = middle * ratio + np.sign(middle) * beyond
    return _scaled(_widened(mesh, np.pi * (2.0 * ratio + 4.0 / 3.0)), (radius, radius, radius))


def _widened(mesh: trimesh.Trimesh, true_volume: float) -> trimesh.Trimesh:
    """A mesh scaled along x and y so that its volume is the true volume."""
    widening = np.sqrt(true_volume / mesh.volume)
    return trimesh.Trimesh(mesh.vertices * [widening, widening, 1.0], mesh.faces, process=False)


def _scaled(mesh: trimesh.Trimesh, factors: ArrayLike) -> Hull:
    """A mesh scaled along its axes. Shapes are made at unit size, to which trimesh's tolerances
    fit."""
    return Hull(mesh.vertices * factors, mesh.faces)
