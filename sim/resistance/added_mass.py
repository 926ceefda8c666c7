"""Added mass: the water that accelerates with a hull, as a 6 x 6 matrix."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import area_vectors, cone_moments, cone_volumes, inertia_of, moved_matrix
from sim.hulls.hull import Hull

Array = NDArray[np.float64]

MOST_DISPLACED_MASSES = 10.0
"""Largest plausible added mass, in displaced masses. A larger one is refused as an error of
units."""

MATRIX_ROUND_OFF = 1e-9
"""Relative round-off allowed in a symmetric, positive semidefinite matrix given in decimals."""


def added_mass_matrix(hull: Hull, density: float, added_mass: ArrayLike) -> Array:
    """Added mass (6, 6) of the fully submerged hull, about the origin of the hull frame.

    added_mass: six coefficients or a (6, 6) matrix. Of six coefficients, the first three are
    multiples of the displaced mass along the hull frame's axes, and the last three are multiples of
    its moments of inertia about them, all at the hull's centroid (a sphere: 0.5 0.5 0.5 0 0 0). A
    matrix [kg], [kg m], [kg m^2] over (translation, rotation) is along the axes and about the
    origin of the hull frame, which must be the body's inertial frame. Raises ValueError for invalid
    numbers.
    """
    given = _numbers(added_mass, "added mass")
    if given.size == 6:
        return _from_coefficients(hull, density, given)
    matrix = checked_matrix(given.reshape(6, 6), "added mass")
    heaviest, displaced = np.diag(matrix)[:3].max(), density * hull.volume
    if heaviest > MOST_DISPLACED_MASSES * displaced:
        raise ValueError(
            f"the added mass matrix has {heaviest:.4g} kg, {heaviest / displaced:.3g} times the "
            f"displaced mass; expected at most {MOST_DISPLACED_MASSES:g} times: use kg, kg m and "
            "kg m^2"
        )
    return matrix


def damping_matrix(damping: ArrayLike) -> Array:
    """Damping (6, 6) [N s/m, N s, N m s] in a frame: force and torque over velocity and angular
    velocity relative to the water. damping: the six numbers of its diagonal, or all 36. Raises
    ValueError for invalid numbers."""
    given = _numbers(damping, "damping")
    return np.diag(given) if given.size == 6 else checked_matrix(given.reshape(6, 6), "damping")


ROUND_SHARE = 0.01
"""Mean square of the lever arms of a surface's normals about an axis, as a share of the mean square
of its distances from its centroid: a surface with less is round about the axis."""


def gripped_axes(hull: Hull) -> Array:
    """Projection (3, 3), in the hull frame, on the directions about which the hull is not round.

    The pressure of the water has no torque about the axis of a round hull, however its wet part
    lies: an added mass that acts off this axis would have one.
    """
    corners = hull.vertices[hull.faces]
    vectors, points = area_vectors(corners), corners.mean(axis=1) - hull.centroid
    sizes = np.linalg.norm(vectors, axis=1)
    arms = np.cross(points, vectors / np.maximum(sizes, np.finfo(float).tiny)[:, None])
    values, axes = np.linalg.eigh((arms * sizes[:, None]).T @ arms)
    gripped = axes[:, values > ROUND_SHARE * (sizes @ np.square(points).sum(axis=1))]
    return gripped @ gripped.T


def wet_reach(hull: Hull) -> Array:
    """Matrix (3, 3) [m] from the vertical, in the hull frame, to the centroid of a small wet part,
    from the hull's centroid: that of a submerged fraction f is at 1 - f of it.

    It is - sqrt(3) times the square root of the covariance of the hull's volume. This is exact for
    a box along any of its axes (half of its height) and within 5 % for a wedge or an ellipsoid that
    is half submerged.
    """
    corners = (hull.vertices - hull.centroid)[hull.faces]
    values, axes = np.linalg.eigh(cone_moments(corners, cone_volumes(corners)) / hull.volume)
    return -np.sqrt(3.0) * (axes * np.sqrt(values)) @ axes.T


def _numbers(given: ArrayLike, quantity: str) -> Array:
    """Six or 36 finite numbers; six must be 0 or more. Raises ValueError."""
    given = np.asarray(given, dtype=float).ravel()
    if given.size not in (6, 36):
        raise ValueError(
            f"the {quantity} has {given.size} numbers; expected 6 coefficients or a 6 x 6 matrix"
        )
    if not np.isfinite(given).all():
        raise ValueError(f"the {quantity} has a number that is not finite")
    if given.size == 6 and (given < 0.0).any():
        raise ValueError(
            f"the {quantity} has a negative coefficient, {given.min():g}; all six must be 0 or more"
        )
    return given


def checked_matrix(matrix: Array, quantity: str) -> Array:
    """The symmetric part of a matrix that is symmetric and positive semidefinite up to round-off.
    Raises ValueError for others."""
    largest = np.abs(matrix).max()
    asymmetry = np.abs(matrix - matrix.T).max()
    if asymmetry > MATRIX_ROUND_OFF * largest:
        raise ValueError(
            f"the {quantity} matrix is not symmetric: two opposite entries differ by "
            f"{asymmetry:g}; set both to their mean"
        )
    lowest = np.linalg.eigvalsh(matrix)[0]
    if lowest < -MATRIX_ROUND_OFF * largest:
        raise ValueError(
            f"the {quantity} matrix has the negative eigenvalue {lowest:g}, which would add "
            "energy to a moving body; it must be positive semidefinite"
        )
    return 0.5 * (matrix + matrix.T)


def _from_coefficients(hull: Hull, density: float, coefficients: Array) -> Array:
    """Matrix of coefficients at the hull's centroid, moved to the frame's origin."""
    corners = (hull.vertices - hull.centroid)[hull.faces]
    inertia = np.diag(inertia_of(cone_moments(corners, cone_volumes(corners))))
    at_centroid = density * np.diag(coefficients * np.concatenate([[hull.volume] * 3, inertia]))
    return moved_matrix(at_centroid, -hull.centroid, np.eye(3))
