"""The closed form of a wet triangle and the straight clip, against quadrature and sums."""

import numpy as np
import pytest

from independent import DENSITY, GRAVITY, ROUND_OFF, clip, meshes, quadrature_wrench
from sim import Hull, wet_triangles_wrench
from sim.hulls.triangle import clip_dry_part


def random_triangles(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3, 3)), rng.normal(size=(count, 3))


def test_wrench_of_wet_triangles_agrees_with_quadrature():
    corners, heads = random_triangles(50)
    about = np.array([0.3, -0.2, 0.5])
    wrench = wet_triangles_wrench(corners, heads, DENSITY, GRAVITY, about)
    expected = quadrature_wrench(corners, heads, about)
    np.testing.assert_allclose(wrench, expected, atol=ROUND_OFF * np.abs(expected).max())


def test_one_triangle_by_hand():
    """A triangle of area 1/2 that faces up under a head of 2 is pushed down at its centroid."""
    corners = [[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    wrench = wet_triangles_wrench(corners, [[2.0, 2.0, 2.0]], 1000.0, 10.0)
    np.testing.assert_allclose(wrench, [0, 0, -1e4, -1e4 / 3.0, 1e4 / 3.0, 0.0])


def test_uniform_pressure_on_a_closed_surface_gives_no_wrench():
    for mesh in meshes().values():
        hull = Hull.from_trimesh(mesh)
        corners = hull.vertices[hull.faces]
        wrench = wet_triangles_wrench(corners, np.ones((len(corners), 3)), DENSITY, GRAVITY)
        np.testing.assert_allclose(wrench, 0.0, atol=ROUND_OFF * DENSITY * GRAVITY * mesh.area)


@pytest.mark.parametrize("lone_corner_is_wet", [True, False])
def test_the_clip_removes_the_dry_piece(lone_corner_is_wet):
    """Sums over the corners minus the dry piece equal the wrench of the wet polygon."""
    corners, heads = random_triangles(200, seed=1)
    signs = [1.0, -1.0, -1.0] if lone_corner_is_wet else [-1.0, 1.0, 1.0]
    heads = np.abs(heads) * signs
    for corner, head in zip(corners, heads, strict=True):
        area = 0.5 * np.cross(corner[1] - corner[0], corner[2] - corner[0])
        arms = (corner.sum(axis=0) + corner) / 12.0
        wet = np.maximum(head, 0.0)
        share, *moment = clip_dry_part(*corner.ravel(), *head)
        force = (wet.sum() / 3.0 - share) * area
        torque = np.cross(wet @ arms - moment, area)
        expected = wet_triangles_wrench(*clip(corner[None], head[None]), 1.0, 1.0)
        np.testing.assert_allclose(-force, expected[:3], atol=1e-13 * np.abs(head).max())
        np.testing.assert_allclose(-torque, expected[3:], atol=1e-12 * np.abs(head).max())


def test_wet_and_dry_pieces_add_up_to_the_triangle():
    corners, heads = random_triangles(200, seed=2)
    wet = wet_triangles_wrench(*clip(corners, heads), 1.0, 1.0)
    dry = -wet_triangles_wrench(*clip(corners, -heads), 1.0, 1.0)
    whole = wet_triangles_wrench(corners, heads, 1.0, 1.0)
    round_off = 1e-11  # of 200 triangles
    np.testing.assert_allclose(wet + dry, whole, atol=round_off)


def test_mismatched_shapes_are_refused():
    corners, heads = random_triangles(4)
    with pytest.raises(ValueError, match=r"\(4, 3, 3\) and heads \(4, 2\).*one head for each"):
        wet_triangles_wrench(corners, heads[:, :2], DENSITY, GRAVITY)
    with pytest.raises(ValueError, match=r"corners have shape \(12, 3\)"):
        wet_triangles_wrench(corners.reshape(-1, 3), heads, DENSITY, GRAVITY)
