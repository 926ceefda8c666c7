"""Geometry: triangles, the solids that they enclose, and rotations; each formula once.

Corners are (F, 3, 3) [m]: three corners a, b, c a triangle, counterclockwise seen from outside.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.kernels import inline, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


FEWEST_STRIPS = 4
"""Strips below which halving triangles makes as few pieces as cutting them into strips."""


def area_vectors(corners: Array) -> Array:
    """Outward vectors (F, 3) [m^2], as long as the triangle is large: (b - a) x (c - a) / 2."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def areas(corners: Array) -> Array:
    """Areas (F,) [m^2]."""
    return np.linalg.norm(area_vectors(corners), axis=1)


def cone_volumes(corners: Array) -> Array:
    """Signed volumes (F,) [m^3] of the cones from the origin to the triangles, which for a closed
    surface add up to what it encloses (Gauss)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0


def cone_centroid(corners: Array, volumes: Array) -> Array:
    """Centre of mass (3,) [m] of cones from the origin with volumes (F,)."""
    return volumes @ (corners.sum(axis=1) / 4.0) / volumes.sum()


def cone_moments(corners: Array, volumes: Array) -> Array:
    """Integral (3, 3) [m^5] of x x^T over cones from the origin with volumes (F,): that of a
    tetrahedron is volume / 20 times the sum of p p^T over a + b + c, a, b and c."""
    a, b, c = np.moveaxis(corners, 1, 0)
    squares = sum(p[:, :, None] * p[:, None, :] for p in (a + b + c, a, b, c))
    return (volumes[:, None, None] * squares).sum(axis=0) / 20.0


def inertia_of(moments: Array) -> Array:
    """Matrix of inertia (3, 3) over the density, from the integral (3, 3) of x x^T."""
    return np.trace(moments) * np.eye(3) - moments


def sides(corners: Array) -> Array:
    """Lengths (F, 3) [m] of the sides ab, bc, ca."""
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)


def across(corners: Array, edge: float) -> Array:
    """Slivers cut across into strips that are as long as wide or have sides of an edge [m], what
    is longer; other triangles as they are: (F, 3, 3) again. Halving alone would make a length of n
    edges into n^1.6 pieces."""
    lengths = sides(corners)
    wide = lengths.min(axis=1)
    long = np.sqrt(np.maximum(edge**2 - wide**2, wide**2))
    count = np.ceil(lengths.max(axis=1) / long).astype(np.int64)
    is_sliver = count >= FEWEST_STRIPS
    turn = (lengths[is_sliver].argmin(axis=1)[:, None] + 2 + np.arange(3)) % 3  # the tip first
    tip, b, c = np.moveaxis(np.take_along_axis(corners[is_sliver], turn[:, :, None], axis=1), 1, 0)
    count = count[is_sliver]
    which = np.repeat(np.arange(len(count)), count)
    strip = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    near, far = ((strip + n) / count[which] for n in (0, 1))
    tip, to_b, to_c = (v[which] for v in (tip, b - tip, c - tip))
    b0, b1 = (tip + part[:, None] * to_b for part in (near, far))
    c0, c1 = (tip + part[:, None] * to_c for part in (near, far))
    second = np.stack([b0, c1, c0], axis=1)[strip > 0]  # at the tip there is none
    return np.concatenate([corners[~is_sliver], np.stack([b0, b1, c1], axis=1), second])


def split_triangles(corners: Array, is_large: Callable[[Array], Flags], most: int) -> Array:
    """Halve triangles across their longest side until none is large, (F, 3, 3) again.

    Neighbours are not halved with them, so the surface stays the same but its corners do not match
    any more (where they must, see `drawing.display_mesh.refined`). Raises ValueError when that
    would make more than `most`.
    """
    done: list[Array] = []
    while len(corners):
        large = is_large(corners)
        done.append(corners[~large])
        if 2 * np.count_nonzero(large) + sum(map(len, done)) > most:
            raise ValueError(f"more than {most}")
        corners = halved(corners[large])
    return np.concatenate(done)


def halved(corners: Array) -> Array:
    """Both halves (2 F, 3, 3) of triangles cut across their longest side: first all that keep the
    corner where it begins, then the others."""
    longest = sides(corners).argmax(axis=1)
    turn = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(corners, turn[:, :, None], axis=1), 1, 0)
    m = 0.5 * (a + b)
    return np.concatenate([np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)])


def distinct_points(points: Array) -> tuple[Indices, Indices]:
    """Of points (N, 3) those that are at places of their own: the first index (K,) at each, in the
    places' order, and which of them (N,) each point is."""
    order = np.lexsort(points.T)
    placed = points[order]
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (placed[1:] != placed[:-1]).any(axis=1)
    numbers = np.empty(len(points), dtype=np.int64)
    numbers[order] = np.cumsum(is_new) - 1
    return order[is_new], numbers


@kernel
def spread_lowest(pairs, label_out):
    """Give all that pairs (P, 2) hang together the lowest label (N,): union-find."""
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        while label_out[a] != a:
            label_out[a] = label_out[label_out[a]]
            a = label_out[a]
        while label_out[b] != b:
            label_out[b] = label_out[label_out[b]]
            b = label_out[b]
        if a < b:
            label_out[b] = a
        else:
            label_out[a] = b
    for i in range(label_out.size):
        label_out[i] = label_out[label_out[i]]


def rotation_matrix(quaternion: Array) -> Array:
    """Rotations (..., 3, 3), body -> world, of unit quaternions (..., 4) as w, x, y, z."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion), -1, 0)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([number for row in rows for number in row], axis=-1).reshape(*w.shape, 3, 3)


def moved_matrix(matrix: Array, place: Array, rotation: Array) -> Array:
    """A matrix (6, 6) over motions (linear, angular) of a frame as one over those of another, which
    lies in it at a place (3,) with a rotation (3, 3)."""
    x, y, z = place
    move = np.zeros((6, 6))  # motion of the one from that of the other: v - omega x place
    move[:3, :3] = move[3:, 3:] = rotation
    move[:3, 3:] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
    return move.T @ matrix @ move


def rotation_about(vector: Array) -> Array:
    """Rotation (3, 3) about a vector by its length [rad]."""
    half = 0.5 * np.linalg.norm(vector)
    return rotation_matrix(np.array([np.cos(half), *(0.5 * np.sinc(half / np.pi) * vector)]))


def random_rotation(rng: np.random.Generator) -> Array:
    """Rotation (3, 3), uniform over all rotations: that of a random unit quaternion."""
    q = rng.normal(size=4)
    return rotation_matrix(q / np.linalg.norm(q))


@inline
def cross(ax, ay, az, bx, by, bz):
    """a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inline
def placed(x, y, z, position, rotation):
    """World coordinates of a point x, y, z of the body frame; rotation: (9,), body -> world."""
    r = rotation
    return (
        position[0] + (r[0] * x + r[1] * y + r[2] * z),
        position[1] + (r[3] * x + r[4] * y + r[5] * z),
        position[2] + (r[6] * x + r[7] * y + r[8] * z),
    )
