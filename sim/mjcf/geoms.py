"""Geoms: the hull of a compiled geom."""

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import areas, cone_volumes
from sim.hulls import primitives
from sim.hulls.hull import Hull
from sim.hulls.union import convex_hull
from sim.mjcf.fields import CONVEX, HULL
from sim.mjcf.floats import geom_label

Array = NDArray[np.float64]
GeomType = mujoco.mjtGeom

PRIMITIVES: dict[GeomType, tuple[Callable[..., Hull], int]] = {
    GeomType.mjGEOM_BOX: (primitives.box, 3),
    GeomType.mjGEOM_SPHERE: (primitives.sphere, 1),
    GeomType.mjGEOM_ELLIPSOID: (primitives.ellipsoid, 3),
    GeomType.mjGEOM_CYLINDER: (primitives.cylinder, 2),
    GeomType.mjGEOM_CAPSULE: (primitives.capsule, 2),
}
"""The function that makes the hull of a geom, and the number of the geom's sizes that it takes."""

OFF_CENTRE_SHARE = 1e-3
"""Share of a mesh's extent: if the centre of mass is farther than this from the centre of volume,
the mass was not computed from the volume."""


def geom_hull(model: mujoco.MjModel, geom: int, is_convex: bool = False) -> tuple[Hull, list[str]]:
    """The hull of a geom, in the geom's frame, and notes about it. is_convex: whether the hull of a
    mesh is its convex hull. Raises ValueError."""
    kind = GeomType(int(model.geom_type[geom]))
    label, remedy = f"geom '{geom_label(model, geom)}'", ""
    try:
        if kind == GeomType.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            label += f" (mesh '{model.mesh(mesh).name}')"
            if is_convex:
                return convex_hull(_mesh_surface(model, mesh)[0]), []
            remedy = (
                f"; or float its convex hull: custom text '{HULL}_{geom_label(model, geom)}', or "
                f"'{HULL}' for all meshes, with data \"{CONVEX}\""
            )
            return _mesh_hull(model, mesh, label)
        if kind in PRIMITIVES:
            make, count = PRIMITIVES[kind]
            return make(*model.geom_size[geom, :count]), []
    except ValueError as error:
        raise ValueError(f"{label}: {error}{remedy}") from None
    raise ValueError(
        f"{label} is a {kind.name.removeprefix('mjGEOM_').lower()}, which has no closed "
        "surface; use a mesh, box, sphere, capsule, cylinder or ellipsoid"
    )


def _mesh_hull(model: mujoco.MjModel, mesh: int, label: str) -> tuple[Hull, list[str]]:
    """The hull of a mesh asset, and notes about it. Raises ValueError."""
    try:
        hull = Hull(*_mesh_surface(model, mesh))
    except ValueError as error:
        file = _mesh_file(model, mesh)
        remedy = f"; `python scripts/check_hull.py {file} --repair OUT` repairs it" if file else ""
        raise ValueError(f"{error}{remedy}") from None
    notes = [f"{label}: {change}" for change in hull.changes]
    if inexact := _inexact_inertia(hull):
        notes.append(f"{label}: {inexact}")
    return hull, notes


def _inexact_inertia(hull: Hull) -> str:
    """A note if MuJoCo did not compute a mesh's mass from its volume; "" if it did. Its frame is
    then not at the centre of volume.

    By default MuJoCo counts the volumes of all pyramids from a middle as positive, which overstates
    the volume of a mesh that is not convex.
    """
    if np.linalg.norm(hull.centroid) <= OFF_CENTRE_SHARE * hull.length:
        return ""
    corners = hull.vertices[hull.faces]
    sizes = areas(corners)
    middle = sizes @ corners.mean(axis=1) / sizes.sum()
    volumes = np.abs(cone_volumes(corners - middle))
    overstated = 100.0 * (volumes.sum() / hull.volume - 1.0)
    mass = f"its mass {overstated:.2g} % above" if overstated > 0.1 else "its mass is off"
    return (
        f"MuJoCo's centre of mass is {np.linalg.norm(hull.centroid):.2g} m from the centre of "
        f'volume, and {mass}; give the mesh asset inertia="exact" (or the body an <inertial>)'
    )


def geom_in_inertial_frame(model: mujoco.MjModel, geom: int) -> tuple[Array, Array]:
    """Position (3,) [m] and rotation (3, 3) of a geom in its body's inertial frame."""
    body = int(model.geom_bodyid[geom])
    axes = frame_rotation(model.body_iquat[body]).T
    position = axes @ (model.geom_pos[geom] - model.body_ipos[body])
    return position, axes @ frame_rotation(model.geom_quat[geom])


def frame_rotation(quaternion: Array) -> Array:
    """Rotation (3, 3) of a quaternion (4,), computed by MuJoCo, so that hulls lie exactly where the
    geoms do."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _mesh_file(model: mujoco.MjModel, mesh: int) -> str:
    """The file of a mesh asset; "" if the model itself has its vertices."""
    start = int(model.mesh_pathadr[mesh])
    return model.paths[start:].split(b"\0")[0].decode() if start >= 0 else ""


def _mesh_surface(model: mujoco.MjModel, mesh: int) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and faces of a mesh asset in its geom's frame; MuJoCo keeps vertices as float32."""
    first_vertex, first_face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first_vertex : first_vertex + model.mesh_vertnum[mesh]]
    faces = model.mesh_face[first_face : first_face + model.mesh_facenum[mesh]]
    return vertices.astype(float), np.array(faces)
