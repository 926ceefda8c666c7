"""Shells: the outside of a surface that consists of one or several closed shells.

A shell is a part of the surface whose faces are connected by edges. Shells that overlap, or lie in
one another, are united, so that no water is displaced twice. A shell that faces inward within
another one is a cavity. It stays dry, so it is not part of the outside. Specks are left out if
nothing else keeps the surface from being closed. Surfaces that need none of this stay the same to
the bit.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import distinct_points
from sim.hulls.solids import (
    TOUCHING_SHARE,
    Surface,
    common_volume,
    overlapping,
    signed_volume,
    union_of,
)
from sim.hulls.specks import is_flat, without_specks
from sim.hulls.topology import collapsed, compacted, edge_fault, joined, parts_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Outside(NamedTuple):
    """The outside of a surface, vertices (V, 3) [m] and faces (F, 3), and texts that say in what it
    differs from the surface."""

    vertices: Array
    faces: Indices
    changes: tuple[str, ...] = ()


class Shells(NamedTuple):
    """The shells of a surface, as faces (N, 3) each, by the side to which they face, and the signed
    volume [m^3] of them all."""

    outward: list[Indices]
    inward: list[Indices]
    volume: float


def outside_of(vertices: Array, faces: Indices) -> Outside:
    """The outside of a surface. Raises a ValueError that counts the faults."""
    vertices, faces = _merged(vertices, faces)
    try:
        return _outside(vertices, faces)
    except ValueError as fault:
        rest = without_specks(vertices, faces)
        if rest is None:
            raise
        try:
            outside = _outside(*compacted(vertices, rest.faces))
        except ValueError:
            raise fault from None  # the specks are not its only fault
    return outside._replace(changes=rest.changes + outside.changes)


def _merged(vertices: Array, faces: Indices) -> Surface:
    """Merge vertices at the same position, and drop collapsed faces and unused vertices. The rest
    keeps its order."""
    first, number = distinct_points(vertices)
    faces = first[number][faces]
    faces = faces[~collapsed(faces)]
    if len(faces) == 0:
        raise ValueError(
            "no face is left after merging vertices at the same position; check the units"
        )
    return compacted(vertices, faces)


def _outside(vertices: Array, faces: Indices) -> Outside:
    """The outside of a surface with merged vertices and without specks."""
    shells = _shells(vertices, faces)
    if shells.volume < 0.0:
        outside = _outside(vertices, faces[:, ::-1].copy())
        warnings.warn(
            f"the hull faced inward (signed volume {shells.volume:.4g} m^3) and was turned outward",
            stacklevel=5,
        )
        return outside
    return _united(vertices, shells) or _without_cavities(vertices, faces)


def _shells(vertices: Array, faces: Indices) -> Shells:
    """The shells of a surface. Raises a ValueError if one is not closed or encloses nothing."""
    parts = parts_of(faces)
    fault = edge_fault(faces)
    if fault and any(map(edge_fault, parts)):  # without the second, closed shells touch at edges
        raise ValueError(fault)
    if flat := sum(is_flat(vertices, part) for part in parts):
        raise ValueError(
            f"{flat} of {len(parts)} closed parts of the surface enclose no volume; "
            "give a flat body some thickness"
        )
    volumes = [signed_volume(vertices, part) for part in parts]
    sides = [], []
    for volume, part in zip(volumes, parts, strict=True):
        sides[volume < 0.0].append(part)
    return Shells(*sides, sum(volumes))


def _united(vertices: Array, shells: Shells) -> Outside | None:
    """The outside of a surface whose outward shells overlap; None if they do not. Raises
    ValueError if they cannot be united."""
    surfaces = [compacted(vertices, shell) for shell in shells.outward]
    bounds = np.array([(points.min(axis=0), points.max(axis=0)) for points, _ in surfaces])
    twice, whole = 0.0, [compacted(vertices, shell) for shell in shells.inward]
    for group in overlapping(bounds):
        union = union_of([surfaces[i] for i in group], TOUCHING_SHARE)
        whole += [union[0]] if union else [surfaces[i] for i in group]
        twice += union[1] if union else 0.0
    if not twice:
        return None
    outside = _without_cavities(*_merged(*joined(whole)))
    share = 100.0 * twice / signed_volume(outside.vertices, outside.faces)
    change = (
        "its shells overlap and are one hull: separate shells would count "
        f"{share:.2g} % of its volume twice"
    )
    return outside._replace(changes=(change, *outside.changes))


def _without_cavities(vertices: Array, faces: Indices) -> Outside:
    """A surface without the shells that face inward within others. Raises ValueError if other
    shells face inward, or if shells touch at edges."""
    outward, inward, _ = _shells(vertices, faces)
    solids = [compacted(vertices, shell) for shell in outward]
    cavities = [compacted(vertices, shell[:, ::-1]) for shell in inward]
    loose = sum(not any(_is_within(cavity, solid) for solid in solids) for cavity in cavities)
    if loose:
        raise ValueError(
            f"{loose} of {len(outward) + len(inward)} closed parts of the surface face inward and "
            "do not lie within others, as cavities do; turn them outward"
        )
    kept = np.concatenate(outward) if cavities else faces
    if fault := edge_fault(kept):
        raise ValueError(fault)
    return Outside(*compacted(vertices, kept), _cavity_text(cavities))


def _is_within(small: Surface, large: Surface) -> bool:
    """Whether an outward surface lies wholly within another."""
    low, high = large[0].min(axis=0), large[0].max(axis=0)
    if (small[0] < low).any() or (small[0] > high).any():
        return False
    return common_volume(small, large) >= (1.0 - TOUCHING_SHARE) * signed_volume(*small)


def _cavity_text(cavities: Sequence[Surface]) -> tuple[str, ...]:
    """A text about cavities, given as outward surfaces, if there are any."""
    if not cavities:
        return ()
    union = union_of(cavities, 0.0)
    volume = sum(signed_volume(*cavity) for cavity in cavities) - (union[1] if union else 0.0)
    verb = "cavity stays" if len(cavities) == 1 else "cavities stay"
    return (f"{len(cavities)} {verb} dry: {volume:.3g} m^3 of its volume",)
