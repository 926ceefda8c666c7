"""Waterline curves: on the hull, on the sea, closed, and equal to known circles."""

import numpy as np
import pytest
import trimesh

from independent import load_mesh, meshes, random_rotation, three_waves, volume_below
from sim import Sea
from sim.recording.display_mesh import refined, vertex_areas
from sim.recording.waterline_curves import WATERLINE_ERROR, faces_across, heads, waterlines

ROUND_OFF = 1e-12


def curves(sea: Sea, mesh: trimesh.Trimesh, time: float = 0.0) -> list[np.ndarray]:
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    depths = heads(sea, vertices, time)
    areas = vertex_areas(vertices, faces)
    return waterlines(sea, time, vertices, areas, faces, faces_across(faces), depths)


def placed(mesh: trimesh.Trimesh, seed: int) -> trimesh.Trimesh:
    rng = np.random.default_rng(seed)
    mesh = mesh.copy()
    mesh.vertices = mesh.vertices @ random_rotation(rng).T + rng.uniform(-0.2, 0.2, 3)
    return mesh


@pytest.mark.parametrize("name", meshes())
@pytest.mark.parametrize("seed", range(3))
def test_curves_are_closed_and_on_the_hull_and_the_sea(name, seed):
    sea, mesh = three_waves(), placed(meshes()[name], seed)
    found = curves(sea, mesh, time=0.4 * seed)
    assert found
    points = np.concatenate(found)
    x, y, z = points.T
    head = sea.elevation(x, y, 0.4 * seed) - z
    assert np.abs(head).max() < WATERLINE_ERROR
    assert distance_to_edges(mesh, points) < ROUND_OFF
    for curve in found:
        np.testing.assert_array_equal(curve[0], curve[-1])
        assert len(curve) > 3


def distance_to_edges(mesh: trimesh.Trimesh, points: np.ndarray) -> float:
    """Largest distance [m] of a point from the nearest edge of the mesh."""
    a, b = np.moveaxis(np.array(mesh.vertices)[mesh.edges_unique], 1, 0)
    along = b - a
    worst = 0.0
    for p in points:
        s = np.clip(np.einsum("ei,ei->e", p - a, along) / np.einsum("ei,ei->e", along, along), 0, 1)
        worst = max(worst, np.linalg.norm(a + s[:, None] * along - p, axis=1).min())
    return worst


def test_every_edge_across_the_water_is_visited_once():
    sea, mesh = three_waves(), placed(load_mesh("bunny"), 7)
    wet = sea.elevation(*np.array(mesh.vertices)[:, :2].T, 0.0) > mesh.vertices[:, 2]
    crossed = np.count_nonzero(wet[mesh.edges_unique[:, 0]] != wet[mesh.edges_unique[:, 1]])
    assert sum(len(curve) - 1 for curve in curves(sea, mesh)) == crossed


def test_flat_water_cuts_a_ball_in_a_circle_with_the_wet_side_on_the_right():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    (curve,) = curves(Sea(level=0.3), ball)
    radii = np.hypot(curve[:, 0], curve[:, 1])
    facets = 1e-3 * 0.5  # m, from the icosphere's faces to the sphere
    np.testing.assert_allclose(radii, 0.4, atol=facets)
    # A curve counterclockwise from above has the wet side on its right.
    x, y = curve[:, 0], curve[:, 1]
    assert 0.5 * (x[:-1] * y[1:] - x[1:] * y[:-1]).sum() == pytest.approx(0.16 * np.pi, rel=1e-2)


def test_a_torus_has_two_curves_across_the_water_and_none_elsewhere():
    torus = meshes()["torus"]
    assert len(curves(Sea(level=0.0501), torus)) == 2
    assert curves(Sea(level=3.0), torus) == []
    assert curves(Sea(level=-3.0), torus) == []


def test_two_surfaces_at_once_have_the_curves_of_both():
    sea, a, b = three_waves(), placed(load_mesh("bunny"), 1), placed(meshes()["torus"], 2)
    both = trimesh.util.concatenate([a, b])
    together, apart = curves(sea, both), curves(sea, a) + curves(sea, b)
    assert len(together) == len(apart)
    total = [sum(map(len, group)) for group in (together, apart)]
    assert total[0] == total[1]


def test_heads_are_exact_near_the_surface_and_have_the_right_sign_elsewhere():
    sea = three_waves()
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (500, 3))
    exact = sea.elevation(points[:, 0], points[:, 1], 0.7) - points[:, 2]
    found = heads(sea, points, 0.7)
    near = np.abs(points[:, 2]) <= sea.amplitude
    assert near.any()
    assert not near.all()
    np.testing.assert_allclose(found[near], exact[near], atol=1e-12)
    np.testing.assert_array_equal(found > 0.0, exact > 0.0)


@pytest.mark.parametrize("longest", [0.5, 0.1])
def test_refining_keeps_the_surface_and_bounds_the_edges(longest):
    box = trimesh.creation.box(extents=(1.0, 0.6, 0.3))
    vertices, faces = refined(np.array(box.vertices), np.array(box.faces), longest)
    fine = trimesh.Trimesh(vertices, faces, process=False)
    assert fine.edges_unique_length.max() <= longest
    assert fine.is_watertight
    assert fine.is_winding_consistent
    assert fine.volume == pytest.approx(0.18, rel=ROUND_OFF)
    assert fine.area == pytest.approx(box.area, rel=ROUND_OFF)
    assert volume_below(fine, 0.05) == pytest.approx(0.12, rel=ROUND_OFF)
    equilateral = box.area / (np.sqrt(3.0) / 4.0 * longest**2)
    assert len(faces) < 8 * equilateral + 12


def test_fine_meshes_stay_unchanged():
    ball = meshes()["icosphere"]
    vertices, faces = refined(ball.vertices, ball.faces, 1.0)
    np.testing.assert_array_equal(vertices, ball.vertices)
    np.testing.assert_array_equal(faces, ball.faces)


def test_a_refined_box_has_the_curved_waterline():
    """Chords of 4 cm stay within their sagitta of the true curve; those of the box do not."""
    sea, box = three_waves(0.6), trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    fine = trimesh.Trimesh(*refined(np.array(box.vertices), np.array(box.faces), 0.04))
    deviations = []
    for mesh in (box, fine):
        middles = np.concatenate([0.5 * (c[:-1] + c[1:]) for c in curves(sea, mesh)])
        x, y, z = middles.T
        deviations.append(np.abs(sea.elevation(x, y, 0.0) - z).max())
    assert deviations[1] < sea.curvature_bound * 0.04**2 / 8.0
    assert deviations[1] < 0.05 * deviations[0]
