"""Primitives: the closed surface of a geom, whatever MuJoCo calls it.

Round primitives get facets whose corners lie slightly outside the true surface and whose middles
lie inside, so that the volume is exact: a ball then floats as deep as its mass says.
"""

from collections.abc import Callable

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.hull import Hull

Array = NDArray[np.float64]
GeomType = mujoco.mjtGeom

SPHERE_SUBDIVISIONS = 3
"""Of an icosahedron: 1280 faces. The surface lies within 0.3 % of the radius from the true one;
one more divides that by four and makes four times the faces."""

ROUND_SECTIONS = 64
"""Sides of a cylinder and a capsule: within 0.15 % of the radius from the true surface."""


def geom_hull(model: mujoco.MjModel, geom: int) -> Hull:
    """Hull of a geom, in its own frame."""
    kind = GeomType(int(model.geom_type[geom]))
    label = f"geom '{model.geom(geom).name}'"
    if kind == GeomType.mjGEOM_MESH:
        mesh_id = int(model.geom_dataid[geom])
        vertices, faces = _mesh_surface(model, mesh_id)
        label += f" (mesh '{model.mesh(mesh_id).name}')"
    elif kind in PRIMITIVES:
        mesh = PRIMITIVES[kind](np.array(model.geom_size[geom]))
        vertices, faces = mesh.vertices, mesh.faces
    else:
        raise ValueError(
            f"{label} is a {kind.name.removeprefix('mjGEOM_').lower()}, which has no closed "
            "surface; use a mesh, box, sphere, capsule, cylinder or ellipsoid"
        )
    try:
        return Hull(vertices, faces)
    except ValueError as error:
        raise ValueError(f"{label}: {error}") from None


def geom_in_inertial_frame(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Position (3,) [m] and rotation (3, 3) of a geom in its body's inertial frame."""
    body = int(model.geom_bodyid[geom])
    axes = frame_rotation(model.body_iquat[body]).T
    place = axes @ (model.geom_pos[geom] - model.body_ipos[body])
    return place, axes @ frame_rotation(model.geom_quat[geom])


def frame_rotation(quaternion: Array) -> Array:
    """Rotation (3, 3) of a model's frame, MuJoCo's own to the bit, so that hulls lie just where
    its geoms do."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _mesh_surface(model: mujoco.MjModel, mesh: int) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and faces of a mesh asset in its geom's frame; MuJoCo keeps vertices as float32."""
    first_vertex, first_face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first_vertex : first_vertex + model.mesh_vertnum[mesh]]
    faces = model.mesh_face[first_face : first_face + model.mesh_facenum[mesh]]
    return vertices.astype(float), np.array(faces)


def _box(size: Array) -> trimesh.Trimesh:
    return trimesh.creation.box(extents=2.0 * size)


def _ellipsoid(semi_axes: Array) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
    true_volume = 4.0 / 3.0 * np.pi
    mesh.apply_scale((true_volume / mesh.volume) ** (1.0 / 3.0))
    mesh.vertices = mesh.vertices * semi_axes
    return mesh


def _sphere(size: Array) -> trimesh.Trimesh:
    return _ellipsoid(np.full(3, size[0]))


def _widened(mesh: trimesh.Trimesh, true_volume: float) -> trimesh.Trimesh:
    """Scale across the z axis until the faceted volume is the true one."""
    widening = np.sqrt(true_volume / mesh.volume)
    mesh.vertices = mesh.vertices * [widening, widening, 1.0]
    return mesh


def _cylinder(size: Array) -> trimesh.Trimesh:
    radius, half_length = size[:2]
    mesh = trimesh.creation.cylinder(
        radius=radius, height=2.0 * half_length, sections=ROUND_SECTIONS
    )
    return _widened(mesh, 2.0 * np.pi * radius**2 * half_length)


def _capsule(size: Array) -> trimesh.Trimesh:
    radius, half_length = size[:2]
    mesh = trimesh.creation.capsule(
        radius=radius, height=2.0 * half_length, count=(ROUND_SECTIONS // 2, ROUND_SECTIONS)
    )
    return _widened(mesh, np.pi * radius**2 * (2.0 * half_length + 4.0 / 3.0 * radius))


PRIMITIVES: dict[GeomType, Callable[[Array], trimesh.Trimesh]] = {
    GeomType.mjGEOM_BOX: _box,
    GeomType.mjGEOM_SPHERE: _sphere,
    GeomType.mjGEOM_ELLIPSOID: _ellipsoid,
    GeomType.mjGEOM_CYLINDER: _cylinder,
    GeomType.mjGEOM_CAPSULE: _capsule,
}
