"""Display mesh: the drawn surfaces of a scene's hulls.

Long edges are halved so that a waterline can bend between them. Sharp edges get separate normals.
All hulls are in one set of arrays, so that a hundred hulls need few calls.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import area_vectors, rotation_matrix, turned
from sim.hulls.topology import edges_of
from sim.mjcf.floats import FloatingGeom
from sim.recording.colours import colour_of, is_shown, with_hue_shifted
from sim.recording.waterline_curves import faces_across
from sim.runs.simulation import Sample
from sim.scenes.buoyancy import Buoyancy

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

EDGES_PER_LENGTH = 12
"""Smallest number of edges along a drawn hull's longest side. More edges make a smoother
waterline."""

SHARP_COSINE = float(np.cos(np.radians(30.0)))
"""Cosine of the largest angle between a face's normal and the mean normal at a smooth corner. A box
has 45 degrees at its edges and 35 or more at its corners."""


@dataclass(frozen=True, eq=False)
class DisplayMesh:
    """The drawn surface of a hull.

    name: of its geom. geom, body: ids. is_drawn: whether its surface is drawn, and not only its
    waterline, because other geoms show its body. rgba: (4,), 0 to 255. size [m]: diagonal of the
    hull's box. edge [m]: the longest drawn edge. vertices: their slice of the vertices of all
    hulls. corners: (N, 3) [m], in the geom's frame. corner_normals: (N, 3). corner_faces: (F, 3).
    corner_vertices: (N,), the vertex at each corner, counted from 0 in this hull. A vertex on a
    sharp edge has
    several corners.
    """

    name: str
    geom: int
    body: int
    is_drawn: bool
    rgba: Array
    size: float
    edge: float
    vertices: slice
    corners: Array
    corner_normals: Array
    corner_faces: Indices
    corner_vertices: Indices


class DisplayMeshes:
    """The drawn surfaces of all hulls of a scene, in the order of `buoyancy.floats`.

    hue: shift of the colours, in turns of the colour circle. faces: (F, 3), indices into the
    vertices (V, 3) of `placed`. across: (F, 3), the neighbours across their edges. hull_starts:
    (H,), the first vertex of each hull. All surfaces have outward area vectors at their vertices, a
    third of those of the faces around.
    """

    def __init__(self, buoyancy: Buoyancy, hue: float = 0.0) -> None:
        self._bodies = buoyancy.float_bodies
        self._meshes: list[DisplayMesh] = []
        self._in_body: list[Array] = []
        self._areas_in_body: list[Array] = []
        faces, count = [], 0
        for f in buoyancy.floats:
            mesh, vertices, own_faces = _display_mesh(buoyancy, f, count, hue)
            geom = buoyancy.model.geom(f.geom)
            self._meshes.append(mesh)
            to_body = rotation_matrix(geom.quat).T
            self._in_body.append(vertices @ to_body + geom.pos)
            self._areas_in_body.append(vertex_areas(vertices, own_faces) @ to_body)
            faces.append(own_faces + count)
            count = mesh.vertices.stop
        self.faces = np.concatenate(faces)
        self.hull_starts = np.array([mesh.vertices.start for mesh in self._meshes])
        self.across = faces_across(self.faces)
        self.vertex_count = count

    def __iter__(self) -> Iterator[DisplayMesh]:
        return iter(self._meshes)

    def of_bodies(self) -> list[DisplayMesh]:
        """The largest surface of each body, in the order of `buoyancy.bodies`."""
        largest: dict[int, DisplayMesh] = {}
        for mesh in sorted(self._meshes, key=lambda s: s.size):
            largest[mesh.body] = mesh
        return [largest[body] for body in sorted(largest)]

    def placed(self, sample: Sample) -> tuple[Array, Array]:
        """Vertices (V, 3) [m] of all hulls and their area vectors (V, 3) [m^2] in world axes."""
        rotations = np.swapaxes(rotation_matrix(sample.quaternions), 1, 2)
        points, areas = np.empty((2, self.vertex_count, 3))
        surfaces = zip(self._meshes, self._in_body, self._areas_in_body, self._bodies, strict=True)
        for mesh, vertices, area, b in surfaces:
            points[mesh.vertices] = vertices @ rotations[b] + sample.positions[b]
            areas[mesh.vertices] = area @ rotations[b]
        return points, areas


def _display_mesh(
    buoyancy: Buoyancy, geom: FloatingGeom, first: int, hue: float
) -> tuple[DisplayMesh, Array, Indices]:
    """Build the mesh that is drawn for a hull. Returns it with its refined vertices and faces.

    first: index of its first vertex among the vertices of all hulls. hue: shift of the colour's
    hue, as a share of the circle of hues.
    """
    model, hull = buoyancy.model, geom.method.hull
    row = model.geom(geom.geom)
    edge = hull.length / EDGES_PER_LENGTH
    vertices, faces = refined(hull.vertices, hull.faces, edge)
    corner_vertices, corner_faces, normals = shaded_corners(vertices, faces)
    mesh = DisplayMesh(
        name=geom.name,
        geom=geom.geom,
        body=geom.body,
        is_drawn=_is_drawn(model, geom),
        rgba=255.0 * with_hue_shifted(colour_of(model, row.rgba, int(row.matid.item())), hue),
        size=float(np.linalg.norm(np.ptp(hull.bounds, axis=0))),
        edge=edge,
        vertices=slice(first, first + len(vertices)),
        corners=vertices[corner_vertices],
        corner_normals=normals,
        corner_faces=corner_faces,
        corner_vertices=corner_vertices,
    )
    return mesh, vertices, faces


def _is_drawn(model: mujoco.MjModel, geom: FloatingGeom) -> bool:
    """Whether a hull's surface is drawn: if MuJoCo's viewer shows its geom, or else shows no geom
    of its body."""
    first = int(model.body_geomadr[geom.body])
    of_body = range(first, first + int(model.body_geomnum[geom.body]))
    return any(is_shown(model, g) for g in geom.geoms) or not any(
        is_shown(model, g) for g in of_body
    )


def shaded_corners(vertices: Array, faces: Indices) -> tuple[Indices, Indices, Array]:
    """Corners of a surface for drawing: their vertices (N,), faces (F, 3) of corners, and outward
    unit normals (N, 3).

    A vertex has one corner with the mean normal of its faces, weighted by area. If the normal of a
    face is too far from the mean (SHARP_COSINE), the vertex has a corner for each of its faces.
    """
    flat, smooth = area_vectors(vertices[faces]), vertex_areas(vertices, faces)
    smooth, flat = _unit(smooth)[faces], np.repeat(_unit(flat)[:, None], 3, axis=1)
    sharp_vertices = faces[np.einsum("fci,fci->fc", smooth, flat) < SHARP_COSINE]
    is_sharp = np.isin(faces, sharp_vertices)
    owner = np.where(is_sharp, np.arange(len(faces))[:, None], -1)
    keys = np.column_stack([faces.ravel(), owner.ravel()])
    corners, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    normals = np.where(is_sharp[..., None], flat, smooth).reshape(-1, 3)[first]
    return corners[:, 0], number.reshape(-1, 3), normals


def vertex_areas(vertices: Array, faces: Indices) -> Array:
    """Outward area vectors (V, 3) [m^2] at the vertices of a surface: a third of the faces'."""
    areas, thirds = np.zeros_like(vertices), area_vectors(vertices[faces]) / 3.0
    for corner in range(3):
        np.add.at(areas, faces[:, corner], thirds)
    return areas


def _unit(vectors: Array) -> Array:
    """Vectors (N, 3) scaled to length 1; zero vectors stay zero."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)


def refined(vertices: Array, faces: Indices, longest: float) -> tuple[Array, Indices]:
    """Refine a closed surface until no edge is longer than `longest` [m]. Returns vertices (V, 3)
    and faces (F, 3); the rest of the surface stays the same.

    Edges that are the longest of both their triangles are halved repeatedly, so that the surface
    stays closed and triangles do not get thin (Rivara 1984).
    """
    while True:
        surface_edges = edges_of(faces)
        edges, of_face = surface_edges.vertices, surface_edges.of_side.reshape(3, -1).T
        lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
        # Ranks instead of lengths, because equally long edges must have an order.
        rank = np.argsort(np.argsort(lengths, kind="stable"), kind="stable")
        longest_of_face = np.argmax(rank[of_face], axis=1)
        chosen = of_face[np.arange(len(faces)), longest_of_face]
        is_split = (np.bincount(chosen, minlength=len(edges)) == 2) & (lengths > longest)
        if not is_split.any():
            return vertices, faces
        middle = len(vertices) + np.cumsum(is_split) - 1
        vertices = np.vstack([vertices, vertices[edges[is_split]].mean(axis=1)])
        halved = is_split[chosen]
        a, b, c = turned(faces[halved], longest_of_face[halved]).T
        m = middle[chosen[halved]]
        halves = [np.column_stack([a, m, c]), np.column_stack([m, b, c])]
        faces = np.concatenate([faces[~halved], *halves])
