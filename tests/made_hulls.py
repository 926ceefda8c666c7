"""Generated hulls with the faults of public files: open, doubled, in millimetres, inside out."""

import functools

import numpy as np
import trimesh

Mesh = trimesh.Trimesh


def made(vertices, faces) -> Mesh:
    return Mesh(np.asarray(vertices, dtype=float), np.asarray(faces), process=False)


def box(size, at=(0.0, 0.0, 0.0)) -> Mesh:
    mesh = trimesh.creation.box(extents=size)
    return made(mesh.vertices + at, mesh.faces)


def joined(*meshes: Mesh) -> Mesh:
    return trimesh.util.concatenate([made(m.vertices, m.faces) for m in meshes])


def without_top(mesh: Mesh) -> Mesh:
    """The mesh without the faces that face straight up."""
    return made(mesh.vertices, mesh.faces[mesh.face_normals[:, 2] < 0.99])


def clipped(corners: np.ndarray) -> np.ndarray:
    """The pieces of triangles (F, 3, 3) below z = 0, as triangles."""
    wet = corners[:, :, 2] < 0.0
    count = wet.sum(axis=1)
    pieces = [corners[count == 3]]
    for wet_count in (1, 2):
        cut, is_wet = corners[count == wet_count], wet[count == wet_count]
        lone = (is_wet if wet_count == 1 else ~is_wet).argmax(axis=1)  # alone on its side
        order = (lone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(cut, order[:, :, None], axis=1), 1, 0)
        ab, ac = _crossing(a, b), _crossing(a, c)
        if wet_count == 1:
            pieces.append(np.stack([a, ab, ac], axis=1))
        else:
            pieces += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(pieces)


def _crossing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Points (N, 3) at which the edges from a to b cross z = 0."""
    share = (a[:, 2] / (a[:, 2] - b[:, 2]))[:, None]
    point = a + share * (b - a)
    point[:, 2] = 0.0
    return point


def capsule(radius: float, length: float, sections: int = 24) -> Mesh:
    mesh = trimesh.creation.capsule(radius=radius, height=length, count=(sections, sections))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return made(mesh.vertices, mesh.faces)


def open_catamaran() -> Mesh:
    """Two open-decked pontoons and a frame across them."""
    pontoons = [without_top(box([4.0, 0.4, 0.4], [0.0, y, 0.0])) for y in (-0.8, 0.8)]
    return joined(*pontoons, box([0.1, 2.4, 0.1], [0.0, 0.0, 0.3]))


def seven_rims() -> Mesh:
    """Eight boxes in a row, seven of them without tops: seven flat rims."""
    return joined(*(
        (without_top if i else lambda m: m)(box([1.0, 1.0, 0.5], [1.5 * i, 0.0, 0.0]))
        for i in range(8)
    ))  # fmt: skip


def unmerged() -> Mesh:
    """A capsule whose faces share no vertices, as in an STL file."""
    mesh = capsule(0.3, 2.0)
    return made(
        mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    )


def four_faces_at_an_edge() -> Mesh:
    """Two boxes that touch along one edge and share its vertices."""
    both = joined(box([1.0, 1.0, 1.0]), box([1.0, 1.0, 1.0], [1.0, 1.0, 0.0]))
    both.merge_vertices()
    return made(both.vertices, both.faces)


def t_junction() -> Mesh:
    """A box with an edge that is divided in one of its faces and not in the other."""
    mesh = box([2.0, 1.0, 1.0])
    face = int(np.flatnonzero(mesh.face_normals[:, 2] > 0.99)[0])
    a, b, c = mesh.faces[face]
    lengths = [
        np.linalg.norm(mesh.vertices[p] - mesh.vertices[q]) for p, q in ((a, b), (b, c), (c, a))
    ]
    i = int(np.argmin(lengths))
    a, b, c = np.roll(mesh.faces[face], -i)
    vertices = np.vstack([mesh.vertices, mesh.vertices[[a, b]].mean(axis=0)])
    faces = np.vstack([np.delete(mesh.faces, face, axis=0), [[a, 8, c], [8, b, c]]])
    return made(vertices, faces)


def half_hull() -> Mesh:
    """The port half of a capsule, open in the plane y = 0."""
    mesh = capsule(0.3, 2.0)
    swapped = mesh.vertices[mesh.faces][:, :, [0, 2, 1]] * [1.0, 1.0, -1.0]
    half = clipped(swapped)
    vertices = (half * [1.0, 1.0, -1.0])[:, :, [0, 2, 1]].reshape(-1, 3)
    return made(vertices, np.arange(len(vertices)).reshape(-1, 3))


def in_millimetres() -> Mesh:
    mesh = capsule(0.3, 2.0)
    return made(1000.0 * mesh.vertices, mesh.faces)


def inside_out() -> Mesh:
    """Two boxes, one of which faces inward."""
    one = box([1.0, 1.0, 1.0], [3.0, 0.0, 0.0])
    return joined(box([1.0, 1.0, 1.0]), made(one.vertices, one.faces[:, ::-1]))


def drawn_twice() -> Mesh:
    mesh = capsule(0.3, 2.0)
    return joined(mesh, mesh)


def open_boat(thickness: float = 0.05) -> Mesh:
    """A tub with walls and a bottom, open on top. Its surface is closed."""
    outer, inner = [2.0, 1.0, 0.5], [2.0 - 2 * thickness, 1.0 - 2 * thickness, 0.5]
    tub = trimesh.boolean.difference(
        [box(outer), box(inner, [0.0, 0.0, thickness])], engine="manifold"
    )
    return made(tub.vertices, tub.faces)


def two_cells() -> Mesh:
    """Two boxes with a common wall, which has a face on each side, and merged vertices."""
    both = joined(box([1.0, 1.0, 1.0], [-0.5, 0.0, 0.0]), box([1.0, 1.0, 1.0], [0.5, 0.0, 0.0]))
    both.merge_vertices()
    return made(both.vertices, both.faces)


def plates(*sides: int, thickness: float = 0.04) -> list[Mesh]:
    """Plates of a unit cube's sides, which overlap at the edges. Sides: 0 to 5, for -x, -y, -z, x,
    y, z."""
    return [_plate(side, thickness) for side in sides or range(6)]


def _plate(side: int, thickness: float) -> Mesh:
    size, at = np.ones(3), np.zeros(3)
    size[side % 3] = thickness
    at[side % 3] = (0.5 - 0.5 * thickness) * (1.0 if side > 2 else -1.0)
    return box(size, at)


def inverted(mesh: Mesh) -> Mesh:
    return made(mesh.vertices, mesh.faces[:, ::-1])


@functools.cache
def ship() -> Mesh:
    """A closed hull of 20,480 faces, 10 m long."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    return made(mesh.vertices * [5.0, 1.0, 0.5], mesh.faces)


def with_faces(mesh: Mesh, points=(), faces=None) -> Mesh:
    """The mesh with triangles (N, 3, 3), or with points (N, 3) and with faces, whose vertices count
    through the mesh's vertices and the points."""
    points = np.reshape(points, (-1, 3))
    if faces is None:
        faces = len(mesh.vertices) + np.arange(len(points)).reshape(-1, 3)
    return made(np.concatenate([mesh.vertices, points]), np.concatenate([mesh.faces, faces]))


def doubled_around(mesh: Mesh, vertex: int) -> Mesh:
    """The mesh with all faces at a vertex drawn twice."""
    return with_faces(mesh, faces=mesh.faces[(mesh.faces == vertex).any(axis=1)])


def edges_along(mesh: Mesh, count: int) -> np.ndarray:
    """Vertices of a chain of edges along the mesh, beginning at vertex 0."""
    chain, neighbours = [0], mesh.vertex_neighbors
    while len(chain) < count + 1:
        ahead = [v for v in neighbours[chain[-1]] if v not in chain]
        chain.append(max(ahead, key=lambda v: mesh.vertices[v, 0]))
    return np.array(chain)


def fin(mesh: Mesh, height: float, count: int = 8) -> Mesh:
    """The mesh with a sheet along its edges, so that these edges have three faces."""
    chain = edges_along(mesh, count)
    beyond = len(mesh.vertices) + np.arange(len(chain))
    quads = np.stack([chain[:-1], chain[1:], beyond[1:], beyond[:-1]], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return with_faces(mesh, mesh.vertices[chain] * [1.0, 1.0 + height, 1.0 + height], faces)


TINY = 1e-3 * np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
"""A triangle (3, 3) of a few millimetres."""

SPECKS = {
    "a triangle outside": lambda ship: with_faces(ship, TINY + [1.0, 2.0, 0.0]),
    "a triangle inside": lambda ship: with_faces(ship, TINY + [1.0, 0.2, 0.1]),
    "a triangle without area": lambda ship: with_faces(
        ship, 1e-3 * np.eye(3)[[0, 0, 0]] * [[1], [2], [3]]
    ),
    "two faces": lambda ship: with_faces(ship, [TINY, TINY[::-1]]),
    "a tiny inward part": lambda ship: joined(ship, inverted(box([1e-3] * 3, [0.0, 3.0, 0.0]))),
    "a drawn edge": lambda ship: fin(ship, 1e-4, 1),
    "doubled faces": lambda ship: doubled_around(ship, 99),
}
"""Small faults of a large hull."""

SHEETS = {
    "a stay": lambda ship: with_faces(ship, [[0, 0, 2], [3, 0, 2], [0, 1e-3, 2]]),
    "a fin": lambda ship: fin(ship, 0.3),
    "a bilge keel": lambda ship: with_faces(ship, [
        [[-2, 1.0, -0.6], [2, 1.0, -0.6], [2, 1.2, -0.8]],
        [[-2, 1.0, -0.6], [2, 1.2, -0.8], [-2, 1.2, -0.8]],
    ]),
    "a cloud": lambda ship: with_faces(
        ship, 5 * TINY + np.mgrid[0:1:0.2, 0:1:0.2, 2:3:0.2].reshape(3, -1).T[:, None]
    ),
}  # fmt: skip
"""Sheets that are no debris: too long, or too large together."""

VOLUMES = {
    "open catamaran": (open_catamaran, 2 * 4.0 * 0.4 * 0.4 + 0.1 * 0.1 * 2.4),
    "seven rims": (seven_rims, 8 * 0.5),
    "unmerged": (unmerged, float(capsule(0.3, 2.0).volume)),
    "four faces at an edge": (four_faces_at_an_edge, 2.0),
    "T-junction": (t_junction, 2.0),
    "inside out": (inside_out, 2.0),
    "drawn twice": (drawn_twice, float(capsule(0.3, 2.0).volume)),
}
"""Hulls that a repair closes, and their volumes [m^3] after it."""
