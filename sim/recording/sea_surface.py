"""Sea surface: the drawn water, the far sea around it, and the sky.

The water is a disc of rings around the bodies. The inner rings have equal cells. The outer rings
grow in proportion to their radius, so that a ring takes the same number of vertices everywhere. A
wave that a ring's cells are too coarse for is left out there. The last ring is flat and meets the
far sea, which is flat, does not change, and reaches the horizon.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.recording.colours import SHADES, packed, shades
from sim.water.gerstner import CHUNK, SUMS, label_chunks, smooth, wave_sums
from sim.water.sea import Sea

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

INNER_RINGS, OUTER_RINGS = 0.29, 0.42
"""Numbers of rings over the resolution. The vertices then number about the resolution squared."""

COARSEST, FINEST = 3.0, 5.0
"""Cells in a wavelength: a wave is flat where there are fewer than the first number, and whole
where there are more than the second."""

FLAT_RINGS = 0.4
"""Share of the outer rings over which the waves fade to the flat far sea."""

HORIZON = 300.0
"""Radius of the far sea and the sky over the radius of the water."""

FAR_RINGS = 24

SKY_ELEVATIONS = np.array([-90.0, -20.0, -0.01, 0.0, 1.5, 3.5, 7.0, 13.0, 22.0, 35.0, 55.0, 90.0])
"""Elevations [deg] of the rings of the sky. The colour changes at the horizon within 0.01 deg."""

SKY_SECTIONS = 96

DEEP_COLOUR = np.array([4.0, 30.0, 48.0])
"""Colour of everything below the horizon: what is seen through the water."""

WATER_COLOURS = np.array([[5.0, 46.0, 82.0], [24.0, 104.0, 142.0], [150.0, 216.0, 224.0]])
"""Colours of the water that is turned away from the light, level, and turned towards it."""

FOAM_COLOUR = np.array([244.0, 248.0, 248.0])
HORIZON_COLOUR, ZENITH_COLOUR = np.array([198.0, 214.0, 222.0]), np.array([62.0, 112.0, 168.0])

WATER_OPACITY = 150
"""Opacity of the water, 0 to 255. The hulls are seen through it."""

WATER_SHADES = np.stack(
    [np.interp(np.linspace(0.0, 1.0, SHADES), [0.0, 0.5, 1.0], part) for part in WATER_COLOURS.T]
).astype(np.float32)

LIGHT = np.array([0.80, -0.25, 0.55]) / np.linalg.norm([0.80, -0.25, 0.55])
"""Direction towards the light that the water's colours show."""

CONTRAST = 1.5
"""Change of shade, from the first colour at -1/2 to the last at 1/2, for a change of 1 in the
cosine of the light."""

LEAST_FOAM, MOST_FOAM = 0.45, 0.3
"""Jacobians of the particles' positions by their labels at which foam begins, and is white. Still
water has 1; where it is 0 the surface has a cusp."""

HAZE_AT_EDGE = 0.35
"""Share of the horizon's colour in the colour of the water's last ring."""


class Water(NamedTuple):
    """The drawn water at one time: points (N, 3) [m] and packed colours (N,)."""

    points: NDArray[np.float32]
    colours: NDArray[np.uint32]


class SeaSurface:
    """The drawn water of a sea, as a disc around a moving middle.

    inner, radius [m]: radii of the rings with equal cells and of the whole disc. resolution: square
    root of about the number of vertices. faces: (F, 3), of the vertices. cell [m]: length of an
    edge of the inner cells.
    """

    def __init__(self, sea: Sea, inner: float, radius: float, resolution: int) -> None:
        self._sea = sea
        rings = max(1, round(INNER_RINGS * resolution))
        growing = max(1, round(OUTER_RINGS * resolution))
        self.inner, self.radius, self.cell = inner, radius, inner / rings
        radii = [inner * i / rings for i in range(rings + 1)]
        radii += [inner * (radius / inner) ** (i / growing) for i in range(1, growing + 1)]
        counts = [max(1, 6 * min(i, rings)) for i in range(len(radii))]
        self._offsets = np.concatenate([_circle(r, c) for r, c in zip(radii, counts, strict=True)])
        self.faces = _faces(counts)
        inside = sum(counts[: rings + 1])
        self._bands = [(slice(0, inside), sea.components)]
        per_band = max(1, CHUNK // counts[-1])
        for first in range(0, growing, per_band):
            last = min(first + per_band, growing)
            outermost = rings + last
            cell = radii[outermost] - radii[outermost - 1]
            flat = np.clip((1.0 - last / growing) / FLAT_RINGS, 0.0, 1.0)
            start, stop = (inside + counts[-1] * ring for ring in (first, last))
            self._bands.append((slice(start, stop), _drawable(sea, cell, smooth(flat))))
        beyond = np.log(np.maximum(np.hypot(*self._offsets.T) / inner, 1.0)) / np.log(
            radius / inner
        )
        haze = (HAZE_AT_EDGE * beyond**2.5).astype(np.float32)
        self._clear, self._haze = 1.0 - haze, haze * HORIZON_COLOUR[:, None].astype(np.float32)

    def at(self, middle: Array, time: float) -> Water:
        """The water around a point (2,) [m] at a time [s]."""
        labels = middle + self._offsets
        sums = self._sums(labels, time)
        level = float(self._sea.level_at(time))
        points = np.empty((len(labels), 3), np.float32)
        points[:, :2], points[:, 2] = labels + sums[:2].T, sums[2] + level
        return Water(points, packed(self._colours(sums)))

    def _sums(self, labels: Array, time: float) -> Array:
        """The offsets of all particles and their derivatives, fields of SUMS, (8, N)."""
        names, work = ("x", "y", "z", "z_x", "z_y", "x_x", "x_y", "y_y"), np.empty(1, SUMS)
        found = np.zeros((len(names), len(labels)))
        for band, waves in self._bands:
            if not len(waves):
                continue
            for chunk, at, count in label_chunks(labels[band]):
                wave_sums(count, waves, time, at, work)
                places = slice(band.start + chunk.start, min(band.start + chunk.stop, band.stop))
                for row, name in zip(found, names, strict=True):
                    row[places] = work[name][0, : places.stop - places.start]
        return found

    def _colours(self, sums: Array) -> Array:
        """Colours (3, N), 0 to 255, by the light on the slopes, the foam and the distance."""
        _, _, _, z_x, z_y, x_x, x_y, y_y = sums.astype(np.float32)
        along_x, along_y = 1.0 + x_x, 1.0 + y_y
        normal = x_y * z_y - z_x * along_y, z_x * x_y - z_y * along_x
        jacobian = along_x * along_y - x_y * x_y
        lit = LIGHT[0] * normal[0] + LIGHT[1] * normal[1] + LIGHT[2] * jacobian
        lit /= np.sqrt(normal[0] ** 2 + normal[1] ** 2 + jacobian**2)
        colours = WATER_SHADES[:, shades(CONTRAST * (lit - LIGHT[2]))]
        if jacobian.min() < LEAST_FOAM:
            foam = np.clip((LEAST_FOAM - jacobian) / (LEAST_FOAM - MOST_FOAM), 0.0, 1.0)
            colours += foam * (FOAM_COLOUR[:, None] - colours)
        return colours * self._clear + self._haze

    def backdrop(self) -> dict[str, tuple[Array, Indices, NDArray[np.uint32]]]:
        """Points (N, 3) [m], faces and packed colours of the far sea and of the sky, around the
        middle at the still level."""
        return {"sea": self._far_sea(), "sky": self._sky()}

    def _far_sea(self) -> tuple[Array, Indices, NDArray[np.uint32]]:
        """The far sea, which is opaque and at its inner edge has the colour of the water above
        DEEP_COLOUR."""
        count = 6 * round(self.inner / self.cell)
        share = np.linspace(0.0, 1.0, FAR_RINGS)
        circles = [_circle(self.radius * HORIZON**s, count) for s in share]
        points = np.column_stack([np.concatenate(circles), np.zeros(count * FAR_RINGS)])
        edge = WATER_COLOURS[1] + HAZE_AT_EDGE * (HORIZON_COLOUR - WATER_COLOURS[1])
        edge = _over(edge, DEEP_COLOUR, WATER_OPACITY / 255.0)
        colours = edge + np.sin(0.5 * np.pi * share)[:, None] * (HORIZON_COLOUR - edge)
        return points, _faces([count] * FAR_RINGS), packed(np.repeat(colours, count, axis=0).T)

    def _sky(self) -> tuple[Array, Indices, NDArray[np.uint32]]:
        """The sky above the horizon, and the deep below it."""
        angles, radius = np.radians(SKY_ELEVATIONS), HORIZON * self.radius
        points = np.concatenate(
            [
                np.column_stack(
                    [
                        _circle(radius * np.cos(a), SKY_SECTIONS),
                        np.full(SKY_SECTIONS, radius * np.sin(a)),
                    ]
                )
                for a in angles
            ]
        )
        height = np.sqrt(np.maximum(np.sin(angles), 0.0))[:, None]
        colours = HORIZON_COLOUR + height * (ZENITH_COLOUR - HORIZON_COLOUR)
        colours[angles < 0.0] = DEEP_COLOUR
        faces = _faces([SKY_SECTIONS] * len(angles))
        return points, faces, packed(np.repeat(colours, SKY_SECTIONS, axis=0).T)


def _over(front: Array, back: Array, opacity: float) -> Array:
    """The colour of a translucent surface in front of another. Light adds up linearly; numbers from
    0 to 255 are about its power of 1 / 2.2."""
    mixed = opacity * (front / 255.0) ** 2.2 + (1.0 - opacity) * (back / 255.0) ** 2.2
    return 255.0 * mixed ** (1.0 / 2.2)


def _circle(radius: float, count: int) -> Array:
    """Equally spaced points (count, 2) [m] on a circle."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def _faces(counts: list[int]) -> Indices:
    """Triangles (F, 3), facing up, between rings with these numbers of vertices, from the middle
    outwards. At each step the ring that lags behind in angle goes on."""
    faces, first = [], 0
    for inner, outer in pairwise(counts):
        second, i, o = first + inner, 0, 0
        while i < inner * (inner > 1) or o < outer:
            here, there = first + i % inner, second + o % outer
            if inner == 1 or (o < outer and (o + 1) * inner <= (i + 1) * outer):
                faces.append((here, there, second + (o + 1) % outer))
                o += 1
            else:
                faces.append((here, there, first + (i + 1) % inner))
                i += 1
        first = second
    return np.array(faces)


def _drawable(sea: Sea, cell: float, share: float) -> NDArray[np.void]:
    """The waves of a sea that cells of a length [m] can show, times a share."""
    waves = sea.components.copy()
    cells = 2.0 * np.pi / waves["wavenumber"] / cell
    parts = share * smooth(np.clip((cells - COARSEST) / (FINEST - COARSEST), 0.0, 1.0))
    for name in ("amplitude", "ka"):
        waves[name] *= parts
    waves = waves[parts > 0.0]
    waves.setflags(write=False)  # compiled code takes no other tables
    return waves
