"""Geometry: triangles, the solids that they enclose, and rotations.

Corners are (F, 3, 3) [m]: the corners a, b, c of each triangle, counterclockwise seen from outside.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.kernels import inline, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


FEWEST_STRIPS = 4
"""Smallest number of strips that a sliver is cut into. Halving makes no more pieces than fewer
strips would."""


def area_vectors(corners: Array) -> Array:
    """Outward normals (F, 3) [m^2] whose length is the area: (b - a) x (c - a) / 2."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def areas(corners: Array) -> Array:
    """Areas (F,) [m^2]."""
    return np.linalg.norm(area_vectors(corners), axis=1)


def cone_volumes(corners: Array) -> Array:
    """Signed volumes (F,) [m^3] of the cones from the origin to the triangles. Over a closed
    surface they add up to the enclosed volume (Gauss)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0


def cone_centroid(corners: Array, volumes: Array) -> Array:
    """Centre of mass (3,) [m] of cones from the origin with volumes (F,)."""
    return volumes @ (corners.sum(axis=1) / 4.0) / volumes.sum()


def cone_moments(corners: Array, volumes: Array) -> Array:
    """Integral (3, 3) [m^5] of x x^T over cones from the origin with volumes (F,). Each cone adds
    volume / 20 times the sum of p p^T over a + b + c, a, b and c."""
    a, b, c = np.moveaxis(corners, 1, 0)
    squares = sum(p[:, :, None] * p[:, None, :] for p in (a + b + c, a, b, c))
    return (volumes[:, None, None] * squares).sum(axis=0) / 20.0


def inertia_of(moments: Array) -> Array:
    """Inertia matrix (3, 3) over the density, from the integral (3, 3) of x x^T."""
    return np.trace(moments) * np.eye(3) - moments


def middle(points: Array) -> Array:
    """Middle (3,) of the box around points (N, 3). Volumes of cones from it lose little to
    round-off."""
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def sides(corners: Array) -> Array:
    """Lengths (F, 3) [m] of the sides ab, bc, ca; corners (F, 3, D) in any number of dimensions."""
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)


def turned(triangles: NDArray, first: Indices) -> NDArray:
    """Triangles (F, 3, ...), of corners or indices, in cyclic order from corner `first` (F,),
    modulo 3."""
    return triangles[np.arange(len(triangles))[:, None], (first[:, None] + np.arange(3)) % 3]


def across(corners: Array, edge: float) -> Array:
    """Triangles (F, 3, 3) with slivers cut across into strips. A strip is as long as it is wide, or
    has sides of `edge` [m] if that is longer. Halving alone would cut a length of n edges into
    n^1.6 pieces."""
    lengths = sides(corners)
    wide = lengths.min(axis=1)
    long = np.sqrt(np.maximum(edge**2 - wide**2, wide**2))
    count = np.ceil(lengths.max(axis=1) / long).astype(np.int64)
    is_sliver = count >= FEWEST_STRIPS
    tip_corner = lengths[is_sliver].argmin(axis=1) + 2  # opposite the shortest side
    tip, b, c = np.moveaxis(turned(corners[is_sliver], tip_corner), 1, 0)
    count = count[is_sliver]
    sliver = np.repeat(np.arange(len(count)), count)
    strip = np.arange(len(sliver)) - np.repeat(np.cumsum(count) - count, count)
    shares = [((strip + n) / count[sliver])[:, None] for n in (0, 1)]
    tip, to_b, to_c = (v[sliver] for v in (tip, b - tip, c - tip))
    b0, b1 = (tip + share * to_b for share in shares)
    c0, c1 = (tip + share * to_c for share in shares)
    second = np.stack([b0, c1, c0], axis=1)[strip > 0]  # the strip at the tip is one triangle
    return np.concatenate([corners[~is_sliver], np.stack([b0, b1, c1], axis=1), second])


def split_triangles(corners: Array, is_large: Callable[[Array], Flags], most: int) -> Array:
    """Triangles (F, 3, 3) halved across their longest side until none is large.

    The surface stays the same, but corners of neighbours no longer match, unlike those of
    `recording.display_mesh.refined`. Raises ValueError for more than `most` triangles.
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
    """Both halves (2 F, 3, 3) of triangles cut across their longest side: first the halves with the
    corner where that side begins, then the others."""
    a, b, c = np.moveaxis(turned(corners, sides(corners).argmax(axis=1)), 1, 0)
    m = 0.5 * (a + b)
    return np.concatenate([np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)])


def distinct_points(points: Array) -> tuple[Indices, Indices]:
    """The distinct positions of points (N, 3), sorted: the index (K,) of the first point at each
    position, and the number (N,) of each point's position."""
    order = np.lexsort(points.T)
    ordered = points[order]
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    numbers = np.empty(len(points), dtype=np.int64)
    numbers[order] = np.cumsum(is_new) - 1
    return order[is_new], numbers


@kernel
def spread_lowest(pairs, label_out):
    """Give all items that pairs (P, 2) connect the lowest of their labels (N,): union-find."""
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
    return np.stack([entry for row in rows for entry in row], axis=-1).reshape(*w.shape, 3, 3)


def moved_matrix(matrix: Array, position: Array, rotation: Array) -> Array:
    """Transform a matrix (6, 6) over the motions (linear, angular) of a frame to another frame,
    which has a position (3,) and a rotation (3, 3) in the first."""
    motion = moved_motion(position, rotation)
    return motion.T @ matrix @ motion


def moved_motion(position: Array, rotation: Array) -> Array:
    """Matrix (6, 6) from a motion (linear, angular) of a frame, which has a position (3,) and a
    rotation (3, 3) in another frame, to the same motion of the other: v - omega x position."""
    x, y, z = position
    motion = np.zeros((6, 6))
    motion[:3, :3] = motion[3:, 3:] = rotation
    motion[:3, 3:] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
    return motion


def rotation_about(vector: Array) -> Array:
    """Rotation (3, 3) about a vector; the angle [rad] is its length."""
    half = 0.5 * np.linalg.norm(vector)
    return rotation_matrix(np.array([np.cos(half), *(0.5 * np.sinc(half / np.pi) * vector)]))


def random_rotation(rng: np.random.Generator) -> Array:
    """A random rotation (3, 3), uniform over all rotations."""
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
