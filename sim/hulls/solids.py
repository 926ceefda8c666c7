"""Solids: unions and common volumes of closed surfaces.

The library manifold3d computes them in double precision.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.geometry import cone_volumes, spread_lowest

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

Surface = tuple[Array, Indices]
"""Vertices (V, 3) [m] and faces (F, 3)."""

TOUCHING_SHARE = 1e-6
"""Share of their volume: surfaces that share no more than this touch, and do not overlap."""


def signed_volume(vertices: Array, faces: Indices) -> float:
    """Volume [m^3] of a closed shell; negative if it faces inward."""
    corners = vertices[faces]
    return float(cone_volumes(corners - corners.reshape(-1, 3).mean(axis=0)).sum())


def overlapping(bounds: Array) -> list[list[int]]:
    """Groups of boxes (N, 2, 3) connected by overlaps, in the order of their first members."""
    low, high = bounds[:, 0], bounds[:, 1]
    meets = (low[:, None] < high[None]).all(axis=2) & (low[None] < high[:, None]).all(axis=2)
    group = np.arange(len(bounds))
    spread_lowest(np.ascontiguousarray(np.argwhere(meets)), group)
    return [np.flatnonzero(group == g).tolist() for g in np.unique(group)]


def solid_of(surface: Surface) -> Any:
    """The manifold3d solid in a closed surface. Raises ValueError if manifold3d refuses it."""
    import manifold3d

    vertices, faces = surface
    mesh = manifold3d.Mesh64(
        vert_properties=vertices.copy(),  # manifold3d refuses read-only arrays
        tri_verts=faces.astype(np.uint64),
    )
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        raise ValueError(f"manifold3d cannot take the surface: {solid.status().name}")
    return solid


def surface_of(solid: Any) -> Surface:
    """The surface of a manifold3d solid."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)


def union_of(surfaces: Sequence[Surface], at_least: float) -> tuple[Surface, float] | None:
    """The union of closed surfaces, and the volume [m^3] that they count twice; None if this is at
    most a share `at_least` of their volume. Raises ValueError if manifold3d refuses a surface."""
    import manifold3d

    if len(surfaces) < 2:
        return None
    solids = [solid_of(surface) for surface in surfaces]
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    total = sum(signed_volume(*surface) for surface in surfaces)
    twice = float(total - whole.volume())
    return None if twice <= at_least * total else (surface_of(whole), twice)


def common_volume(one: Surface, other: Surface) -> float:
    """Volume [m^3] that lies in both surfaces."""
    return float((solid_of(one) ^ solid_of(other)).volume())
