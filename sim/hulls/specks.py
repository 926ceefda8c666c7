"""Specks: debris in a surface from a file, so small that it matters neither to the volume nor to
the drag of a hull.

Files of ships contain faces without a neighbour, slivers of two faces, and faces drawn twice.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import areas
from sim.hulls.solids import signed_volume
from sim.hulls.tidying import size_of
from sim.hulls.topology import edge_fault, parts_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FLAT_SHARE = 1e-14
"""Share of area times diagonal: a smaller volume is the round-off of a flat surface."""

SPECKS_AREA_SHARE = 1e-4
"""Largest share of the surface's area that all specks have together. Skin friction on them is at
most this share of the hull's. With this area they could enclose 1e-7 of the third power of the
surface's size (the square root of its area), if they were a ball."""

SPECK_LENGTH_SHARE = 0.05
"""Share of the surface's size: a longer part is no speck, however narrow it is, because it may be a
stay or a rail. Slivers between two faces of a mesh of a thousand faces are shorter."""

MOST_PLACES = 3
"""Largest number of places that a text names."""


class WithoutSpecks(NamedTuple):
    """The faces (F, 3) of a surface without its specks, and texts that say what was left out."""

    faces: Indices
    changes: tuple[str, ...]


def without_specks(vertices: Array, faces: Indices) -> WithoutSpecks | None:
    """A surface without doubled faces and specks; None if it has none. Parts that are closed and
    face outward are kept, however small they are."""
    first = np.sort(np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1])
    doubles = list(np.delete(faces, first, axis=0)[:, None])
    parts = parts_of(faces[first])
    stray = [part for part in parts if not _encloses(vertices, part)]
    specks = specks_among(vertices, stray, float(areas(vertices[faces]).sum()))
    dropped = set(map(id, specks))
    kept = [part for part in parts if id(part) not in dropped]
    if len(kept) == 0 or not (doubles or specks):
        return None
    changes = [
        f"{name} left out: {described(vertices, left_out, faces)}"
        for name, left_out in (("doubled faces", doubles), ("specks", specks))
        if left_out
    ]
    return WithoutSpecks(np.concatenate(kept), tuple(changes))


def specks_among(vertices: Array, parts: Sequence[Indices], area: float) -> list[Indices]:
    """The parts that are specks of a surface with an area [m^2]. Short parts that together have too
    much area are not debris, so none of them is a speck."""
    length = SPECK_LENGTH_SHARE * np.sqrt(area)
    short = [part for part in parts if size_of(vertices[part].reshape(-1, 3)) <= length]
    together = sum(float(areas(vertices[part]).sum()) for part in short)
    return short if together <= SPECKS_AREA_SHARE * area else []


def described(vertices: Array, parts: Sequence[Indices], faces: Indices) -> str:
    """How many faces parts have, how much of a surface's area, and where the first ones are, as
    text."""
    count = sum(map(len, parts))
    share = areas(vertices[np.concatenate(parts)]).sum() / areas(vertices[faces]).sum()
    return f"{count} faces, {100.0 * share:.2g} % of the area, around {places(vertices, parts)}"


def places(vertices: Array, parts: Sequence[Indices] | Indices) -> str:
    """The middles of the first few parts or edges, given by their vertices, as text."""
    middles = [vertices[part].reshape(-1, 3).mean(axis=0) for part in parts[:MOST_PLACES]]
    return " and ".join("({:.4g}, {:.4g}, {:.4g})".format(*point) for point in middles)


def is_flat(vertices: Array, part: Indices) -> bool:
    """Whether a closed part of a surface encloses no volume."""
    round_off = FLAT_SHARE * areas(vertices[part]).sum() * size_of(vertices)
    return bool(abs(signed_volume(vertices, part)) <= round_off)


def _encloses(vertices: Array, part: Indices) -> bool:
    """Whether a part is closed and faces outward around a volume."""
    if edge_fault(part) or is_flat(vertices, part):
        return False
    return signed_volume(vertices, part) > 0.0
