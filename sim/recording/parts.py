"""Parts: what a model shows besides its floating hulls: geoms and sites as MuJoCo's viewer draws
them, tendons and contacts."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sim.mjcf.floats import geom_label
from sim.mjcf.geoms import PRIMITIVES
from sim.recording.colours import SHOWN_GROUPS, colour_of, is_shown, rounded
from sim.recording.display_mesh import shaded_corners

Array = NDArray[np.float64]
Kind = mujoco.mjtGeom

GROUND = (Kind.mjGEOM_PLANE, Kind.mjGEOM_HFIELD)
GROUND_LIGHT = np.array([0.30, 0.48, 0.55])
"""Share of red, green and blue light that reaches the ground under water. The viewer draws no
haze."""

GROUND_REACH = 20.0
"""Half the side of an infinite plane over the radius of the water. The far sea hides its edge."""

MOST_TEXELS = 512
"""Largest number of texels along a side of a texture; larger textures are thinned."""

TEXTURE_ROLES = (mujoco.mjtTextureRole.mjTEXROLE_RGB, mujoco.mjtTextureRole.mjTEXROLE_RGBA)


@dataclass(frozen=True, eq=False)
class Part:
    """A drawn geom or site. body: its id. path: its entity below its body's. pose: position (3,)
    [m] and quaternion (4,) (w, x, y, z) in the body's frame. mesh: its surface, in its own frame.
    """

    body: int
    path: tuple[str, ...]
    pose: tuple[Array, Array]
    mesh: rr.Mesh3D


def parts_of(model: mujoco.MjModel, hulls: set[int], reach: float, level: float) -> Iterator[Part]:
    """The visible geoms of a model but for the ids in `hulls`, and its visible sites. reach [m]:
    half the side of an infinite plane. level [m]: of the sea, below which the ground is dim."""
    for geom in range(model.ngeom):
        if geom not in hulls and is_shown(model, geom):
            row = model.geom(geom)
            is_ground = row.type.item() in GROUND and row.bodyid.item() == 0
            light = GROUND_LIGHT if is_ground and row.pos[2] < level else np.ones(3)
            path = (geom_label(model, geom),)
            yield _part(model, row, int(row.dataid.item()), path, reach, light)
    for site in range(model.nsite):
        row = model.site(site)
        if row.group.item() < SHOWN_GROUPS and row.rgba[3] > 0.0:
            yield _part(model, row, -1, ("sites", row.name or f"site {site}"), reach, np.ones(3))


def _part(
    model: mujoco.MjModel, row: Any, data: int, path: tuple[str, ...], reach: float, light: Array
) -> Part:
    """The part of a row of a model's table of geoms or sites. data: id of its mesh or height
    field. light: (3,), share of each colour that reaches it."""
    kind, material = Kind(int(row.type.item())), int(row.matid.item())
    surface = _surface(model, kind, row.size, data, material, reach)
    colour = colour_of(model, row.rgba, material) * [*light, 1.0]
    mesh = _mesh(model, surface, colour, material)
    return Part(int(row.bodyid.item()), path, (row.pos.copy(), row.quat.copy()), mesh)


def tendon_points(
    model: mujoco.MjModel, data: mujoco.MjData, tendon: int
) -> list[NDArray[np.float32]]:
    """The path of a spatial tendon as lines (N, 3) [m], one for each stretch between pulleys."""
    first = int(data.ten_wrapadr[tendon])
    path = slice(first, first + int(data.ten_wrapnum[tendon]))
    points = data.wrap_xpos.reshape(-1, 3)[path].astype(np.float32)
    starts = np.flatnonzero(data.wrap_obj.reshape(-1)[path] == -2)  # MuJoCo's mark of a pulley
    return [line for line in np.split(points, starts) if len(line) > 1]


def shown_tendons(model: mujoco.MjModel) -> dict[int, str]:
    """Names of the visible spatial tendons."""
    joint = mujoco.mjtWrap.mjWRAP_JOINT
    return {
        i: model.tendon(i).name or f"tendon {i}"
        for i in range(model.ntendon)
        if model.tendon_group[i] < SHOWN_GROUPS
        and model.tendon_rgba[i, 3] > 0.0
        and model.wrap_type[model.tendon_adr[i]] != joint
    }


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Points (C, 3) [m] of the contacts of the last step, and forces (C, 3) [N] on the body of the
    second geom of each."""
    points, forces, force = [], [], np.empty(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        mujoco.mj_contactForce(model, data, i, force)
        points.append(contact.pos.copy())
        forces.append(contact.frame.reshape(3, 3).T @ force[:3])
    return np.reshape(points, (-1, 3)), np.reshape(forces, (-1, 3))


def _mesh(
    model: mujoco.MjModel, surface: dict[str, Any], colour: Array, material: int
) -> rr.Mesh3D:
    """A surface in a colour (4,), 0 to 1, with the texture of its material, or with the
    texture's mean colour if the surface has no texture coordinates."""
    texture = _texture(model, material)
    if texture is not None and "vertex_texcoords" in surface:
        surface = surface | {"albedo_texture": texture}
    elif texture is not None:
        colour[:3] *= texture.mean(axis=(0, 1)) / 255.0
    return rr.Mesh3D(albedo_factor=rounded(255.0 * colour.clip(0.0, 1.0)), **surface)


def _texture(model: mujoco.MjModel, material: int) -> NDArray[np.uint8] | None:
    """The texture of a material, (height, width, 3)."""
    textures = [int(model.mat_texid[material, role]) for role in TEXTURE_ROLES if material >= 0]
    for texture in textures:
        if texture >= 0:
            height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
            first, channels = int(model.tex_adr[texture]), int(model.tex_nchannel[texture])
            texels = model.tex_data[first : first + height * width * channels]
            texels = texels.reshape(height, width, channels)
            step = -(-max(min(height, width), 1) // MOST_TEXELS)
            thinned = texels[::step, ::step, :3]
            return np.ascontiguousarray(np.broadcast_to(thinned, (*thinned.shape[:2], 3)))
    return None


def _surface(
    model: mujoco.MjModel, kind: Kind, size: Array, data: int, material: int, reach: float
) -> dict[str, Any]:
    """The surface of a geom or site, as arguments of a Mesh3D."""
    if kind in (Kind.mjGEOM_MESH, Kind.mjGEOM_SDF):
        return _asset(model, data)
    if kind == Kind.mjGEOM_PLANE:
        return _plane(model, size, material, reach)
    if kind == Kind.mjGEOM_HFIELD:
        return _terrain(model, data)
    make, count = PRIMITIVES[kind]
    hull = make(*size[:count])
    return _smoothed(hull.vertices, hull.faces)


def _smoothed(vertices: Array, faces: NDArray[np.int64]) -> dict[str, Any]:
    """A surface of its own normals."""
    of_corners, corner_faces, normals = shaded_corners(vertices, faces)
    return dict(
        vertex_positions=vertices[of_corners], vertex_normals=normals, triangle_indices=corner_faces
    )


def _asset(model: mujoco.MjModel, mesh: int) -> dict[str, Any]:
    """The surface of a mesh asset, with its texture coordinates if it has any."""
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    start, vertices = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    faces, texcoords = slice(first, first + count), int(model.mesh_texcoordadr[mesh])
    points = model.mesh_vert[start : start + vertices].astype(float)
    surface = _smoothed(points, model.mesh_face[faces].astype(np.int64))
    if texcoords < 0:
        return surface
    keys = np.stack([surface["triangle_indices"], model.mesh_facetexcoord[faces]], axis=-1)
    corners, number = np.unique(keys.reshape(-1, 2), axis=0, return_inverse=True)
    return dict(
        vertex_positions=surface["vertex_positions"][corners[:, 0]],
        vertex_normals=surface["vertex_normals"][corners[:, 0]],
        triangle_indices=number.reshape(-1, 3),
        vertex_texcoords=model.mesh_texcoord[corners[:, 1] + texcoords],
    )


def _plane(model: mujoco.MjModel, size: Array, material: int, reach: float) -> dict[str, Any]:
    """A rectangle, with texture coordinates."""
    half = np.where(size[:2] > 0.0, size[:2], reach)
    corners = half * [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
    repeats = np.ones(2) if material < 0 else model.mat_texrepeat[material]
    is_per_metre = material >= 0 and model.mat_texuniform[material]
    return dict(
        vertex_positions=np.column_stack([corners, np.zeros(4)]),
        vertex_normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        vertex_texcoords=repeats * (corners if is_per_metre else 0.5 * corners / half + 0.5),
    )


def _terrain(model: mujoco.MjModel, field: int) -> dict[str, Any]:
    """The top of a height field."""
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    first, (x, y, top, _) = int(model.hfield_adr[field]), model.hfield_size[field]
    heights = top * model.hfield_data[first : first + rows * columns]
    across, along = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
    vertices = np.column_stack([across.ravel(), along.ravel(), heights])
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()
    c, d = corner[1:, 1:].ravel(), corner[1:, :-1].ravel()
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return _smoothed(vertices, faces)
