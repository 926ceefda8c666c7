"""Wetted: what of a closed surface lies below still water, and its waterplane, exactly.

All of it is a sum over the wetted triangles: volumes of cones from a point of the water's surface,
and, because the wetted part and the waterplane close one another, integrals over the waterplane as
minus those over the wetted part's projection (Gauss).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, cone_volumes

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Wetted:
    """The part of a solid below z = 0.

    volume [m^3]; moment (3,) [m^4], volume times the centre of buoyancy; surface [m^2], wetted;
    waterplane [m^2]; plane_moment (2,) [m^3] and plane_squares (2, 2) [m^4], the integrals of (x,
    y) and its square over the waterplane.
    """

    volume: float
    moment: Array
    surface: float
    waterplane: float
    plane_moment: Array
    plane_squares: Array

    @property
    def centre(self) -> Array:
        """Centre of buoyancy (3,) [m]; the origin where nothing is wetted."""
        return self.moment / self.volume if self.volume > 0.0 else np.zeros(3)


def wetted_part(corners: Array, displaced: Array | float = 1.0) -> Wetted:
    """The Wetted of closed surfaces of triangles, corners (F, 3, 3) [m], outward, z up from the
    water's level. displaced (F,): over the volume that they enclose, the same for all of a surface.
    """
    below, which = clipped(corners)
    share = displaced if np.isscalar(displaced) else displaced[which]
    vectors = area_vectors(below)
    surface = float(np.linalg.norm(vectors, axis=1).sum())
    volumes, vectors = share * cone_volumes(below), np.reshape(share, (-1, 1)) * vectors
    down, places = -vectors[:, 2], below[:, :, :2]
    sums = places.sum(axis=1)
    squares = np.einsum("f,fci,fcj->ij", down, places, places, optimize=True)
    squares += np.einsum("f,fi,fj->ij", down, sums, sums, optimize=True)
    return Wetted(
        float(volumes.sum()),
        volumes @ below.sum(axis=1) / 4.0,
        surface,
        float(down.sum()),
        down @ sums / 3.0,
        squares / 12.0,
    )


def clipped(corners: Array) -> tuple[Array, Indices]:
    """The triangles (F, 3, 3) cut off at z = 0, those below, and which (F,) they are from."""
    wet = corners[:, :, 2] < 0.0
    count = wet.sum(axis=1)
    pieces, which = [corners[count == 3]], [np.flatnonzero(count == n) for n in (3, 1, 2, 2)]
    for alone in (1, 2):
        cut, is_wet = corners[count == alone], wet[count == alone]
        lone = (is_wet if alone == 1 else ~is_wet).argmax(axis=1)  # the corner on its own side
        turn = (lone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(cut, turn[:, :, None], axis=1), 1, 0)
        ab, ac = _crossing(a, b), _crossing(a, c)
        if alone == 1:
            pieces.append(np.stack([a, ab, ac], axis=1))
        else:
            pieces += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(pieces), np.concatenate(which)


def _crossing(a: Array, b: Array) -> Array:
    """Points (N, 3) where the sides from a to b, on both sides of z = 0, cross it."""
    share = (a[:, 2] / (a[:, 2] - b[:, 2]))[:, None]
    point = a + share * (b - a)
    point[:, 2] = 0.0
    return point
