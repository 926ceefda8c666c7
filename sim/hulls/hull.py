"""Hull: a closed triangle surface that faces outward, checked once.

A hull has no holes, no edge with more than two faces, one winding, and a volume. (trimesh has such
checks too, but they do not count the faults.)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.geometry import area_vectors, cone_centroid, cone_volumes, middle
from sim.hulls.shells import outside_of
from sim.kernels import read_only

Array = NDArray[np.float64]

LARGEST_COORDINATE = 1e6
"""Largest coordinate [m] of a vertex. Moments of patches are up to sixth powers of lengths, kept in
single precision, which ends at 3e38."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A closed, outward surface of triangles; immutable.

    vertices: (V, 3) [m], in the hull's frame. faces: (F, 3) indices, counterclockwise seen from
    outside. Vertices at exactly the same position are merged. Faces that collapse by that, and
    vertices that no face uses, are dropped. A surface that faces inward is turned outward with a
    warning. Of several shells, the hull is the outside: overlapping and nested shells are united,
    and cavities are dry (see `sim.hulls.shells`). Raises a ValueError that counts the faults and
    names the remedy.

    volume [m^3], centroid (3,) [m]: of the enclosed solid. bounds: (2, 3) [m], lowest and highest
    corner. area_vectors: (F, 3) [m^2], outward normals whose length is the face's area. changes:
    what was united, left dry or left out, as texts.
    """

    vertices: Array
    faces: NDArray[np.int64]
    area_vectors: Array
    volume: float
    centroid: Array
    bounds: Array
    changes: tuple[str, ...]

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        self._set(*outside_of(*checked_arrays(vertices, faces)))

    def _set(self, vertices: Array, faces: NDArray[np.int64], changes: tuple[str, ...]) -> None:
        origin = middle(vertices)
        corners = (vertices - origin)[faces]
        volumes = cone_volumes(corners)
        values = {
            "vertices": vertices,
            "faces": faces,
            "area_vectors": area_vectors(vertices[faces]),
            "volume": float(volumes.sum()),
            "centroid": origin + cone_centroid(corners, volumes),
            "bounds": np.array([vertices.min(axis=0), vertices.max(axis=0)]),
            "changes": changes,
        }
        for name, value in values.items():
            object.__setattr__(self, name, _closed(value))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the arrays of pickles and deep copies read-only too."""
        self.__dict__.update({name: _closed(value) for name, value in state.items()})

    @classmethod
    def from_trimesh(cls, mesh: Any) -> "Hull":
        """The hull of a `trimesh.Trimesh`, or of any object with vertices and faces."""
        return cls(mesh.vertices, mesh.faces)

    def moved(self, rotation: Array, position: Array) -> "Hull":
        """The same hull, rotated by a rotation (3, 3), then moved by a position (3,) [m]."""
        hull = object.__new__(type(self))
        hull._set(self.vertices @ rotation.T + position, self.faces, self.changes)
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


def checked_arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
    """Copies of vertices and faces. Raises ValueError if they are not arrays of finite positions
    and of indices into them."""
    vertices = np.array(vertices, dtype=float)  # a copy, because it becomes read-only
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
    if farthest > LARGEST_COORDINATE:
        raise ValueError(
            f"the hull reaches {farthest:.3g} m from the origin; expected at most "
            f"{LARGEST_COORDINATE:g} m: check the units"
        )
    outside = int(np.count_nonzero((faces < 0) | (faces >= len(vertices))))
    if outside:
        raise ValueError(
            f"{outside} face indices lie outside 0..{len(vertices) - 1}; indices count from 0"
        )
    return vertices, faces.astype(np.int64)
