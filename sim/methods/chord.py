"""Chord: as linear, but the waterline across a cut triangle follows the true elevation.

The straight clip gives each cut triangle a chord from p to q along which the interpolated head
vanishes. Chord samples the true elevation at n interior points of the chord and makes them
vertices of the wet polygon, each with its own head: positive under a crest, negative
where a trough dips below (the closed form then debits). The polygon is a fan from a wet corner
that is not on the chord.

The closed form is linear in the heads and those of p and q are zero, so the samples add to the
straight clip just the sum of head times weight, the weight of sample c being

    S / 3  and  (f + c' + c'' + c) / 12 x S      of a fan triangle (f, c', c''), area vector S,

summed over the two fan triangles that meet at c.
"""

import numpy as np
from numpy.typing import NDArray

from sim.gerstner import kernel, solve_heights
from sim.hull import Hull
from sim.methods.linear import (
    Linear,
    heads_at_vertices,
    lowest_height,
    odd_corner_first,
    placed,
    sum_wet_body_frame,
    turned_into_world,
)
from sim.sea import Sea
from sim.triangle import cross

Array = NDArray[np.float64]


class Chord(Linear):
    """Wrench of a hull in a sea by a clip that bends along each chord.

    samples: interior points of a chord, 0 being the straight clip; crests_only: forget the
    troughs, which biases the force upwards (for the experiment). Stateless. Raises ValueError.
    """

    def __init__(self, hull: Hull, sea: Sea, samples: int = 4, crests_only: bool = False) -> None:
        if samples != int(samples) or samples < 0:
            raise ValueError(f"samples is {samples}; a chord has 0 or more whole samples")
        super().__init__(hull, sea)
        self.samples = int(samples)
        self.crests_only = bool(crests_only)

    def _sum(self, position: Array, rotation: Array, time: float, out: Array) -> None:
        settings = (self.samples, self.crests_only)
        chord_wrench(*self._surface, *settings, *self._water, position, rotation, time, out)


@kernel
def chord_ends(vertices, heads, a, b, c):
    """Fan corner f and the chord's ends (3, 3), in the order that keeps the face's winding."""
    ends = np.empty((3, 3))
    tb = heads[a] / (heads[a] - heads[b])
    tc = heads[a] / (heads[a] - heads[c])
    a_is_wet = heads[a] > 0.0
    for i in range(3):
        p = vertices[a, i] + tb * (vertices[b, i] - vertices[a, i])
        q = vertices[a, i] + tc * (vertices[c, i] - vertices[a, i])
        ends[0, i] = vertices[a, i] if a_is_wet else vertices[b, i]
        ends[1, i] = p if a_is_wet else q
        ends[2, i] = q if a_is_wet else p
    return ends


@kernel
def sample_chord(ends, points, weights):
    """Points (n, 3) [m] along the chord of `chord_ends` and their weights (n, 6), body frame."""
    n = points.shape[0]
    fan, first, last = ends[0], ends[1], ends[2]
    for i in range(n):
        points[i] = first + (i + 1.0) / (n + 1.0) * (last - first)
    # the fan triangles are alike: all have the same share of the chord
    u, v = first - fan, last - fan
    sx, sy, sz = cross(u[0], u[1], u[2], v[0], v[1], v[2])
    sx, sy, sz = 0.5 * sx / (n + 1.0), 0.5 * sy / (n + 1.0), 0.5 * sz / (n + 1.0)
    for i in range(n):
        # two triangles (f, c - d, c), (f, c, c + d): their neighbours' offsets cancel
        mx = (2.0 * fan[0] + 6.0 * points[i, 0]) / 12.0
        my = (2.0 * fan[1] + 6.0 * points[i, 1]) / 12.0
        mz = (2.0 * fan[2] + 6.0 * points[i, 2]) / 12.0
        weights[i, 0], weights[i, 1], weights[i, 2] = 2.0 / 3.0 * sx, 2.0 / 3.0 * sy, 2.0 / 3.0 * sz
        weights[i, 3], weights[i, 4], weights[i, 5] = cross(mx, my, mz, sx, sy, sz)


@kernel
def add_chords(
    vertices, faces, heads, samples, crests_only,
    components, tolerance, level, position, rotation, time, out,
):  # fmt: skip
    """Add to the straight clip's sum, out (6,), what the samples on all chords bring."""
    cut = 0
    for f in range(faces.shape[0]):
        cut += odd_corner_first(faces[f], heads)[0]
    points, weights = np.empty((cut * samples, 3)), np.empty((cut * samples, 6))
    n = 0
    for f in range(faces.shape[0]):
        is_cut, a, b, c = odd_corner_first(faces[f], heads)
        if is_cut:
            ends = chord_ends(vertices, heads, a, b, c)
            sample_chord(ends, points[n : n + samples], weights[n : n + samples])
            n += samples
    x, y, z, heights = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        x[i], y[i], z[i] = placed(points[i], position, rotation)
    solve_heights(x, y, components, time, tolerance, heights)
    for i in range(n):
        head = level + heights[i] - z[i]
        if crests_only and head < 0.0:
            head = 0.0
        for j in range(6):
            out[j] += head * weights[i, j]


@kernel
def chord_wrench(
    vertices, faces, area_vectors, bounds, weights, longest_edge, samples, crests_only,
    components, tolerance, level, amplitude,
    position, rotation, time, out,
):  # fmt: skip
    """Wrench (6,) over - density gravity into out, world axes, torque about the position."""
    out[:] = 0.0
    if lowest_height(bounds, position, rotation) > level + amplitude:
        return
    heads = np.empty(vertices.shape[0])
    wet = heads_at_vertices(
        vertices, longest_edge, components, tolerance, level, amplitude, position, rotation, time,
        heads,
    )  # fmt: skip
    if wet == 0:
        return
    body = np.zeros(6)
    sum_wet_body_frame(vertices, faces, area_vectors, weights, heads, wet, body)
    if samples > 0 and wet < vertices.shape[0]:
        add_chords(
            vertices, faces, heads, samples, crests_only,
            components, tolerance, level, position, rotation, time, body,
        )  # fmt: skip
    turned_into_world(rotation, body, out)
