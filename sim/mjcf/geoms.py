"""Primitives: the closed surface of a geom, whatever MuJoCo calls it.

Round primitives get facets whose corners lie slightly outside the true surface and whose middles
lie inside, so that the volume is exact: a ball then floats as deep as its mass says.
"""

from collections.abc import Callable

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.geometry import areas, cone_volumes
from sim.hulls.hull import Hull
from sim.hulls.union import outer_surface
from sim.mjcf.floats import geom_label

Array = NDArray[np.float64]
GeomType = mujoco.mjtGeom

SPHERE_SUBDIVISIONS = 3
"""Of an icosahedron: 1280 faces. The surface lies within 0.3 % of the radius from the true one;
one more divides that by four and makes four times the faces."""

OFF_CENTRE = 1e-3
"""Of a mesh's extents: a centre of mass so far from the volume's is not that of the volume."""

ROUND_SECTIONS = 64
"""Sides of a cylinder and a capsule: within 0.15 % of the radius from the true surface."""


def geom_hull(model: mujoco.MjModel, geom: int) -> tuple[Hull, list[str]]:
    """Hull of a geom, in its own frame, and what is to be said about it. Raises ValueError."""
    kind = GeomType(int(model.geom_type[geom]))
    label = f"geom '{geom_label(model, geom)}'"
    try:
        if kind == GeomType.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            label += f" (mesh '{model.mesh(mesh).name}')"
            return _mesh_hull(model, mesh, label)
        if kind in PRIMITIVES:
            made = PRIMITIVES[kind](np.array(model.geom_size[geom]))
            return Hull(made.vertices, made.faces), []
    except ValueError as error:
        raise ValueError(f"{label}: {error}") from None
    raise ValueError(
        f"{label} is a {kind.name.removeprefix('mjGEOM_').lower()}, which has no closed "
        "surface; use a mesh, box, sphere, capsule, cylinder or ellipsoid"
    )


def _mesh_hull(model: mujoco.MjModel, mesh: int, label: str) -> tuple[Hull, list[str]]:
    """Hull of a mesh asset, shells in shells counted once."""
    hull, twice, cavities = outer_surface(*_mesh_surface(model, mesh))
    notes = []
    if twice > 0.0:
        notes.append(
            f"{label}: its shells overlap and are one hull: by themselves they would count "
            f"{100.0 * twice / hull.volume:.2g} % of its volume twice"
        )
    if cavities:
        notes.append(
            f"{label}: {cavities} of its shells lie inside and face inward: cavities that stay dry"
        )
    if inexact := _inexact_inertia(hull):
        notes.append(f"{label}: {inexact}")
    return hull, notes


def _inexact_inertia(hull: Hull) -> str:
    """What is to be said where MuJoCo did not put a mesh's frame at its centre of volume, and so
    did not compute its mass from its volume either; "" where it did.

    Its default takes the volumes of pyramids from a middle as all positive, which overstates what
    is not convex.
    """
    size = float(np.ptp(hull.bounds, axis=0).max())
    if np.linalg.norm(hull.centroid) <= OFF_CENTRE * size:
        return ""
    corners = hull.vertices[hull.faces]
    sizes = areas(corners)
    middle = sizes @ corners.mean(axis=1) / sizes.sum()
    volumes = np.abs(cone_volumes(corners - middle))
    overstated = 100.0 * (volumes.sum() / hull.volume - 1.0)
    mass = (
        f", and its mass {overstated:.2g} % above" if overstated > 0.1 else ", and its mass is off"
    )
    return (
        f"MuJoCo's centre of mass is {np.linalg.norm(hull.centroid):.2g} m from that of the volume"
        f'{mass}; give the mesh asset inertia="exact" (or the body an inertial of its own)'
    )


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
    return _stretched(trimesh.creation.box(extents=(2.0, 2.0, 2.0)), size)


def _ellipsoid(semi_axes: Array) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
    true_volume = 4.0 / 3.0 * np.pi
    mesh.apply_scale((true_volume / mesh.volume) ** (1.0 / 3.0))
    return _stretched(mesh, semi_axes)


def _sphere(size: Array) -> trimesh.Trimesh:
    return _ellipsoid(np.full(3, size[0]))


def _cylinder(size: Array) -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(radius=1.0, height=2.0, sections=ROUND_SECTIONS)
    return _stretched(_widened(mesh, 2.0 * np.pi), size[[0, 0, 1]])


def _capsule(size: Array) -> trimesh.Trimesh:
    radius, half_length = size[:2]
    count = ROUND_SECTIONS // 2, ROUND_SECTIONS
    mesh = trimesh.creation.capsule(radius=1.0, height=2.0, count=count)
    ratio = half_length / radius
    beyond = np.maximum(np.abs(mesh.vertices[:, 2]) - 1.0, 0.0)
    middle = np.clip(mesh.vertices[:, 2], -1.0, 1.0)
    mesh.vertices[:, 2] = middle * ratio + np.sign(middle) * beyond
    return _stretched(_widened(mesh, np.pi * (2.0 * ratio + 4.0 / 3.0)), np.full(3, radius))


def _widened(mesh: trimesh.Trimesh, true_volume: float) -> trimesh.Trimesh:
    """Scale across the z axis until the faceted volume is the true one."""
    widening = np.sqrt(true_volume / mesh.volume)
    return _stretched(mesh, np.array([widening, widening, 1.0]))


def _stretched(mesh: trimesh.Trimesh, factors: Array) -> trimesh.Trimesh:
    """Scale along the axes: shapes are made at unit size, where trimesh's tolerances hold."""
    return trimesh.Trimesh(mesh.vertices * factors, mesh.faces, process=False)


PRIMITIVES: dict[GeomType, Callable[[Array], trimesh.Trimesh]] = {
    GeomType.mjGEOM_BOX: _box,
    GeomType.mjGEOM_SPHERE: _sphere,
    GeomType.mjGEOM_ELLIPSOID: _ellipsoid,
    GeomType.mjGEOM_CYLINDER: _cylinder,
    GeomType.mjGEOM_CAPSULE: _capsule,
}
