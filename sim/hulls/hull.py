"""Hull: a closed triangle surface that faces outward, checked once.

Everything that computes with a hull may rely on what is refused here: no holes, no edge
with more than two faces, one consistent winding, a volume. It knows neither water nor MuJoCo.
(The checks are our own, because trimesh's say whether something is wrong, not how much of what.)
"""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import (
    area_vectors,
    areas,
    cone_centroid,
    cone_volumes,
    distinct_points,
    spread_lowest,
)
from sim.kernels import read_only

Array = NDArray[np.float64]

NO_VOLUME = 1e-14
"""A volume below this part of area x diagonal is the round-off of a flat surface."""


FARTHEST = 1e6
"""Metres: moments of patches are up to sixth powers of lengths, and single precision, in which they
are kept, ends at 3e38."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A closed, outward surface of triangles; immutable.

    vertices: (V, 3) [m], in the hull's own frame; faces: (F, 3) indices, counterclockwise
    seen from outside. Vertices at the very same place are merged, faces that collapse by
    it and vertices that no face uses are dropped. A surface that faces inward is
    turned outward with a warning. Raises ValueError that counts what is wrong and names the remedy.

    volume [m^3] and centroid (3,) [m] are those of the enclosed solid; bounds: (2, 3)
    [m], lowest and highest corner; area_vectors: (F, 3) [m^2], outward, as long as
    the face is large.
    """

    vertices: Array
    faces: NDArray[np.int64]
    area_vectors: Array
    volume: float
    centroid: Array
    bounds: Array

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        vertices, faces = _checked_arrays(vertices, faces)
        vertices, faces = _merged(vertices, faces)
        _check_edges(faces)
        self._set(vertices, _turned_outward(vertices, faces))

    def _set(self, vertices: Array, faces: NDArray[np.int64]) -> None:
        middle = _middle(vertices)
        corners = (vertices - middle)[faces]
        volumes = cone_volumes(corners)
        values = {
            "vertices": vertices,
            "faces": faces,
            "area_vectors": area_vectors(vertices[faces]),
            "volume": float(volumes.sum()),
            "centroid": middle + cone_centroid(corners, volumes),
            "bounds": np.array([vertices.min(axis=0), vertices.max(axis=0)]),
        }
        for name, value in values.items():
            object.__setattr__(self, name, _closed(value))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """For pickles and deep copies, whose arrays could else be written to."""
        self.__dict__.update({name: _closed(value) for name, value in state.items()})

    @classmethod
    def from_trimesh(cls, mesh: Any) -> "Hull":
        """The hull of a `trimesh.Trimesh` (or of anything with its vertices and faces)."""
        return cls(mesh.vertices, mesh.faces)

    def moved(self, rotation: Array, position: Array) -> "Hull":
        """The same, turned by a rotation (3, 3) and then put at a position (3,) [m]."""
        hull = object.__new__(type(self))
        hull._set(self.vertices @ rotation.T + position, self.faces)
        return hull

    @property
    def length(self) -> float:
        """Longest side [m] of the bounds."""
        return float(np.ptp(self.bounds, axis=0).max())

    def __repr__(self) -> str:
        size = " x ".join(f"{side:.4g}" for side in self.bounds[1] - self.bounds[0])
        return f"Hull({len(self.faces)} faces, {size} m, {self.volume:.6g} m^3)"


def _closed(value: Any) -> Any:
    return read_only(value) if isinstance(value, np.ndarray) else value


def _checked_arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
    vertices = np.array(vertices, dtype=float)  # copies: the caller's arrays stay the caller's
    faces = np.asarray(faces)
    if vertices.size == 0 or faces.size == 0:
        raise ValueError(
            f"a hull needs a surface: found {len(vertices)} vertices and {len(faces)} faces; "
            "give vertices of shape (V, 3) and faces of shape (F, 3)"
        )
    for name, array in (("vertices", vertices), ("faces", faces)):
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(
                f"{name} have shape {array.shape}; expected (N, 3): triangulate polygons first"
            )
    if not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"faces are {faces.dtype}; expected integer indices into the vertices")
    broken = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
    if broken:
        raise ValueError(
            f"{broken} of {len(vertices)} vertices are not finite; repair or drop them"
        )
    farthest = float(np.abs(vertices).max())
    if farthest > FARTHEST:
        raise ValueError(
            f"the hull reaches {farthest:.3g} m from the origin, where volumes are no numbers any "
            "more; check the units"
        )
    outside = int(np.count_nonzero((faces < 0) | (faces >= len(vertices))))
    if outside:
        raise ValueError(
            f"{outside} face indices lie outside 0..{len(vertices) - 1}; indices count from 0"
        )
    return vertices, faces.astype(np.int64)


def _merged(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Merge vertices at the same place, drop faces that collapse and vertices without a face. The
    order of what stays is kept."""
    first, group = distinct_points(vertices)
    faces = first[group][faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if len(faces) == 0:
        raise ValueError(
            "no face is left after merging vertices at the same place; check the units"
        )
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def _directed_edges(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _check_edges(faces: NDArray[np.int64]) -> None:
    """Every edge must have two faces that run along it in opposite directions."""
    edges = _directed_edges(faces)
    low, high = edges.min(axis=1), edges.max(axis=1)
    keys = low * (int(faces.max()) + 1) + high
    _, group, count = np.unique(keys, return_inverse=True, return_counts=True)
    open_edges = int(np.count_nonzero(count == 1))
    if open_edges:
        raise ValueError(
            f"the surface is not closed: {open_edges} of {len(count)} edges have only one face; "
            "look at it with `python scripts/check_hull.py FILE`, which mends it with --repair"
        )
    crowded = int(np.count_nonzero(count > 2))
    if crowded:
        raise ValueError(
            f"{crowded} of {len(count)} edges have more than two faces; remove duplicated and "
            "inner faces, or make parts that only touch separate hulls"
        )
    forward = np.bincount(np.ravel(group), weights=edges[:, 0] < edges[:, 1])
    twisted = int(np.count_nonzero(forward != 1))
    if twisted:
        raise ValueError(
            f"the winding is inconsistent: {twisted} of {len(count)} edges are run along twice in "
            "the same direction; orient the faces alike (for example trimesh.repair.fix_winding)"
        )


def _middle(vertices: Array) -> Array:
    """Middle (3,) of the bounds: cones from there lose little to round-off."""
    return 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))


def closed_parts(vertices: Array, faces: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """The connected shells of a surface, as faces (F, 3) each; vertices at a place are one."""
    _, group = distinct_points(vertices)
    label = _parts(group[faces], len(vertices))
    return [faces[label == part] for part in np.unique(label)]


def _parts(faces: NDArray[np.int64], vertex_count: int) -> NDArray[np.int64]:
    """Label (F,) of the connected part that each face belongs to: the lowest vertex it reaches."""
    label = np.arange(vertex_count)
    spread_lowest(_directed_edges(faces), label)
    return label[faces[:, 0]]


def _turned_outward(vertices: Array, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    volumes = cone_volumes((vertices - _middle(vertices))[faces])
    diagonal = np.linalg.norm(np.ptp(vertices, axis=0))
    area = areas(vertices[faces])
    names, part = np.unique(_parts(faces, len(vertices)), return_inverse=True)
    volume = np.bincount(part, weights=volumes)
    flat = int(np.count_nonzero(np.abs(volume) <= NO_VOLUME * diagonal * np.bincount(part, area)))
    if flat:
        raise ValueError(
            f"{flat} of {len(names)} closed parts of the surface enclose no volume; "
            "give a flat body some thickness"
        )
    inward = int(np.count_nonzero(volume < 0))
    if inward == 0:
        return faces
    if inward < len(names):
        raise ValueError(
            f"{inward} of {len(names)} closed parts of the surface face inward; turn them outward "
            "(a cavity that water cannot enter is not part of the hull: remove it), for example "
            "with `python scripts/check_hull.py FILE --repair OUT`"
        )
    warnings.warn(
        f"the hull faced inward (signed volume {volume.sum():.4g} m^3) and was turned outward",
        stacklevel=3,
    )
    return faces[:, ::-1].copy()
