"""Chord: like linear, but the waterline across a cut triangle follows the true surface.

The straight clip gives each cut triangle a chord from p to q along which the interpolated head
vanishes. This method takes the true heads at n interior points of the chord and makes these points
vertices of the wet polygon. They are positive under a crest and negative where a trough dips below
the chord (the closed form then subtracts). The polygon is a fan from a wet corner that is not on
the chord.

The closed form is linear in the heads, and the heads of p and q are zero. The samples therefore add
to the straight clip just the sum of head times weight. The weight of sample c is

    S / 3  and  (f + c' + c'' + c) / 12 x S      of a fan triangle (f, c', c''), area vector S,

summed over the two fan triangles that meet at c.
"""

from typing import Self

import numpy as np

from sim.geometry import cross, placed
from sim.hulls.hull import Hull
from sim.kernels import kernel, record, scratch
from sim.methods.linear import (
    Linear,
    heads_at_vertices,
    odd_corner_first,
    unpacked,
    wet_sums,
    write_turned,
)
from sim.methods.method import Kernel, Settings
from sim.water.head import solve_heads
from sim.water.sea import Sea

MOST_SAMPLES = 64
"""Maximum number of samples on a chord. A few are as accurate as any number."""

SAMPLE = record(x="f8", y="f8", z="f8", weights=("f8", 6))
"""A point of a chord in the body frame [m] and its weights in the sums over the surface."""


class Chord(Linear):
    """Wrench of a hull in a sea by a clip that bends along each chord.

    samples: number of interior points of a chord, 0 for the straight clip; crests_only: ignore the
    troughs, which biases the force upwards (for experiments). Raises ValueError for an invalid
    number of samples.
    """

    def __init__(self, hull: Hull, sea: Sea, samples: int = 4, crests_only: bool = False) -> None:
        if not (0 <= samples <= MOST_SAMPLES and samples == int(samples)):
            raise ValueError(
                f"samples is {samples}; expected a whole number from 0 to {MOST_SAMPLES}"
            )
        self.samples = int(samples)
        self.crests_only = bool(crests_only)
        super().__init__(hull, sea)

    def _prepare(self) -> None:
        self._surface.shape["samples"] = self.samples
        self._surface.shape["crests_only"] = self.crests_only
        super()._prepare()

    def _kernel(self) -> Kernel:
        return chord_wrenches

    @classmethod
    def from_settings(cls, hull: Hull, sea: Sea, settings: Settings) -> Self:
        return cls(hull, sea, settings.chord_samples)


@kernel
def chord_ends(vertices, heads, a, b, c, ends_out):
    """Write the fan corner f and the chord's ends (3, 3), in the order that keeps the face's
    winding."""
    p, q, r = vertices[a], vertices[b], vertices[c]
    tb, tc = heads[a] / (heads[a] - heads[b]), heads[a] / (heads[a] - heads[c])
    first, last = (1, 2) if heads[a] > 0.0 else (2, 1)
    fan = p if heads[a] > 0.0 else q
    ends_out[0, 0], ends_out[0, 1], ends_out[0, 2] = fan.x, fan.y, fan.z
    ends_out[first, 0] = p.x + tb * (q.x - p.x)
    ends_out[first, 1] = p.y + tb * (q.y - p.y)
    ends_out[first, 2] = p.z + tb * (q.z - p.z)
    ends_out[last, 0] = p.x + tc * (r.x - p.x)
    ends_out[last, 1] = p.y + tc * (r.y - p.y)
    ends_out[last, 2] = p.z + tc * (r.z - p.z)


@kernel
def sample_chord(ends, samples_out):
    """Samples along the chord of `chord_ends`."""
    n = samples_out.size
    fan, first, last = ends[0], ends[1], ends[2]
    # all fan triangles have the same share of the chord, and so the same area
    sx, sy, sz = cross(
        first[0] - fan[0], first[1] - fan[1], first[2] - fan[2],
        last[0] - fan[0], last[1] - fan[1], last[2] - fan[2],
    )  # fmt: skip
    sx, sy, sz = 0.5 * sx / (n + 1.0), 0.5 * sy / (n + 1.0), 0.5 * sz / (n + 1.0)
    for i in range(n):
        along = (i + 1.0) / (n + 1.0)
        x = first[0] + along * (last[0] - first[0])
        y = first[1] + along * (last[1] - first[1])
        z = first[2] + along * (last[2] - first[2])
        # the two triangles are (f, c - d, c) and (f, c, c + d): the offsets d cancel
        mx, my, mz = (
            (2.0 * fan[0] + 6.0 * x) / 12.0,
            (2.0 * fan[1] + 6.0 * y) / 12.0,
            (2.0 * fan[2] + 6.0 * z) / 12.0,
        )
        sample = samples_out[i]
        sample.x, sample.y, sample.z = x, y, z
        weights = sample.weights
        weights[0], weights[1], weights[2] = 2.0 / 3.0 * sx, 2.0 / 3.0 * sy, 2.0 / 3.0 * sz
        weights[3], weights[4], weights[5] = cross(mx, my, mz, sx, sy, sz)


@kernel
def chord_samples(surface, heads):
    """Samples (N,) of all chords."""
    cut, n = 0, surface.shape[0].samples
    for f in range(surface.faces.size):
        cut += odd_corner_first(surface.faces[f], heads)[0]
    samples, ends = np.empty(cut * n, SAMPLE), scratch((3, 3))
    count = 0
    for f in range(surface.faces.size):
        is_cut, a, b, c = odd_corner_first(surface.faces[f], heads)
        if is_cut:
            chord_ends(surface.vertices, heads, a, b, c, ends)
            sample_chord(ends, samples[count : count + n])
            count += n
    return samples


@kernel
def add_chords(samples, crests_only, waves, water, position, rotation, time, sums_out):
    """Add the samples of all chords to the straight clip's sums (6,)."""
    n = samples.size
    x, y, z, heads = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        s = samples[i]
        x[i], y[i], z[i] = placed(s.x, s.y, s.z, position, rotation)
    solve_heads(x, y, z, waves, water, time, heads)
    for i in range(n):
        head = heads[i]
        if crests_only and head < 0.0:
            head = 0.0
        weights = samples[i].weights
        for j in range(6):
            sums_out[j] += head * weights[j]


@kernel
def chord_wrenches(block, places, positions, rotations, time, wrenches_out):
    """See `Compiled`."""
    surface, waves, water = unpacked(block)
    heads, sums = np.empty(surface.vertices.size), scratch(6)
    crests_only = surface.shape[0].crests_only != 0
    for i in range(places.size):
        position, rotation = positions[places[i].pose], rotations[places[i].pose]
        wrench = wrenches_out[places[i].row]
        wrench[:] = 0.0
        wet = heads_at_vertices(surface, waves, water, position, rotation, time, heads)
        if wet > 0:
            wet_sums(surface, heads, wet, sums)
            if surface.shape[0].samples > 0 and wet < heads.size:
                samples = chord_samples(surface, heads)
                add_chords(samples, crests_only, waves, water, position, rotation, time, sums)
            write_turned(sums, rotation, water[0].scale, wrench)
