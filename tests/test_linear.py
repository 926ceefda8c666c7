"""The linear method: Archimedes' law, independent quadrature, symmetries, extremes."""

import numpy as np
import pytest
import trimesh

from independent import (
    DENSITY,
    GRAVITY,
    ROUND_OFF,
    meshes,
    quadrature_wrench,
    random_rotation,
    three_waves,
    volume_below,
    wet_triangles,
)
from sim import Hull, Linear, Sea, Wave, wet_triangles_wrench

FLAT = Sea(density=DENSITY, gravity=GRAVITY)
CUBE = trimesh.creation.box(extents=[1.0, 1.0, 1.0])


def rotation_about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("name", ["icosphere", "torus", "bunny"])
def test_archimedes_on_flat_water_in_any_pose(name):
    """The lift is the weight of the displaced water. trimesh computes its volume."""
    mesh = meshes()[name]
    method = Linear(Hull.from_trimesh(mesh), FLAT)
    rng = np.random.default_rng(11)
    for _ in range(20):
        rotation, position = random_rotation(rng), rng.uniform(-0.5, 0.5, 3)
        placed = trimesh.Trimesh(mesh.vertices @ rotation.T + position, mesh.faces, process=False)
        displaced = volume_below(placed, 0.0)
        force = method.wrench(position, rotation, 0.0)[:3] / (DENSITY * GRAVITY)
        np.testing.assert_allclose(force, [0.0, 0.0, displaced], atol=ROUND_OFF)


@pytest.mark.parametrize("name", ["icosphere", "torus", "bunny"])
def test_a_submerged_hull_is_lifted_at_its_centroid(name):
    mesh = meshes()[name]
    hull = Hull.from_trimesh(mesh)
    rotation = random_rotation(np.random.default_rng(12))
    for depth in (2.0, 1000.0):
        wrench = Linear(hull, FLAT).wrench([3.0, -2.0, -depth], rotation, 0.0)
        wrench /= DENSITY * GRAVITY * hull.volume
        np.testing.assert_allclose(wrench[:3], [0.0, 0.0, 1.0], atol=ROUND_OFF * depth)
        torque = np.cross(rotation @ hull.centroid, [0.0, 0.0, 1.0])
        np.testing.assert_allclose(wrench[3:], torque, atol=ROUND_OFF * depth)


@pytest.mark.parametrize("name", ["icosphere", "torus", "bunny"])
def test_force_and_torque_agree_with_quadrature_of_the_clipped_surface(name):
    hull, sea = Hull.from_trimesh(meshes()[name]), three_waves()
    method = Linear(hull, sea)
    rng = np.random.default_rng(13)
    for _ in range(5):
        rotation, time = random_rotation(rng), rng.uniform(0.0, 10.0)
        position = rng.uniform(-1.0, 1.0, 3) * [3.0, 3.0, 0.4]
        expected = quadrature_wrench(*wet_triangles(hull, sea, position, rotation, time), position)
        wrench = method.wrench(position, rotation, time)
        scale = DENSITY * GRAVITY * hull.volume
        np.testing.assert_allclose(wrench / scale, expected / scale, atol=ROUND_OFF)


def test_wet_triangles_wrench_equals_the_methods_wrench():
    hull, sea = Hull.from_trimesh(meshes()["torus"]), three_waves()
    rotation, position = random_rotation(np.random.default_rng(14)), np.array([0.2, 0.1, 0.05])
    corners, heads = wet_triangles(hull, sea, position, rotation, 1.0)
    by_hand = wet_triangles_wrench(corners, heads, sea.density, sea.gravity, position)
    wrench = Linear(hull, sea).wrench(position, rotation, 1.0)
    np.testing.assert_allclose(wrench, by_hand, atol=ROUND_OFF * DENSITY * GRAVITY)


def test_metacentric_height_of_a_box():
    """The righting torque of a slightly tilted box is weight x GM x angle, with GM = 0.2672 m."""
    hull = Hull.from_trimesh(trimesh.creation.box(extents=[2.0, 1.0, 0.4]))
    draft = 0.6 * 0.4
    gm = 1.0 / (12.0 * draft) + draft / 2.0 - 0.2
    assert gm == pytest.approx(0.2672, abs=5e-5)
    weight = DENSITY * GRAVITY * 2.0 * draft
    for angle in (1e-3, 1e-2):
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        torque = Linear(hull, FLAT).wrench([0.0, 0.0, 0.2 - draft], rotation, 0.0)[3]
        assert torque / (-weight * gm * angle) == pytest.approx(1.0, abs=3.0 * angle**2)


def test_wrenches_stay_when_pose_and_sea_shift_together():
    hull, sea = Hull.from_trimesh(meshes()["bunny"]), three_waves().with_pressure("froude-krylov")
    shift, delay = np.array([1.7, -0.9]), 2.1
    moved = Sea(
        [
            Wave(
                w.amplitude,
                w.wavelength,
                w.heading,
                w.phase
                - w.wavenumber * shift @ [np.cos(w.heading), np.sin(w.heading)]
                + np.sqrt(sea.gravity * w.wavenumber) * delay,
            )
            for w in sea.waves
        ],
        level=4.0,
    )
    rotation = random_rotation(np.random.default_rng(15))
    here = Linear(hull, sea).wrench([0.1, 0.2, 0.0], rotation, 0.5)
    there = Linear(hull, moved).wrench([0.1 + shift[0], 0.2 + shift[1], 4.0], rotation, 0.5 + delay)
    np.testing.assert_allclose(there, here, atol=ROUND_OFF * DENSITY * GRAVITY)


def test_rotating_pose_and_sea_rotates_the_wrench():
    hull, sea = Hull.from_trimesh(meshes()["bunny"]), three_waves().with_pressure("froude-krylov")
    angle = 0.8
    rotated = Sea([Wave(w.amplitude, w.wavelength, w.heading + angle, w.phase) for w in sea.waves])
    about_z = rotation_about_z(angle)
    rotation, position = random_rotation(np.random.default_rng(16)), np.array([0.4, -0.3, 0.1])
    wrench = Linear(hull, sea).wrench(position, rotation, 0.7)
    expected = np.concatenate([about_z @ wrench[:3], about_z @ wrench[3:]])
    found = Linear(hull, rotated).wrench(about_z @ position, about_z @ rotation, 0.7)
    np.testing.assert_allclose(found, expected, atol=ROUND_OFF * DENSITY * GRAVITY)


def test_forces_of_flat_water_are_conservative():
    """The work along a closed path of height and tilt is zero, to the quadrature's error."""
    method = Linear(Hull.from_trimesh(trimesh.creation.box(extents=[2.0, 1.0, 0.4])), FLAT)

    def work(points: int) -> float:
        total = 0.0
        for s in 2.0 * np.pi * (np.arange(points) + 0.5) / points:
            height, angle = 0.1 * np.cos(s + 0.6) + 0.03, 0.5 * np.sin(s) + 0.2
            c, sn = np.cos(angle), np.sin(angle)
            rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -sn], [0.0, sn, c]])
            wrench = method.wrench([0.0, 0.0, height], rotation, 0.0)
            total += wrench[2] * -0.1 * np.sin(s + 0.6) + wrench[3] * 0.5 * np.cos(s)
        return abs(total * 2.0 * np.pi / points) / (DENSITY * GRAVITY * 0.8)

    coarse, fine = work(100), work(1000)
    assert fine < 1e-6
    assert fine < coarse / 50.0  # second order, because the force has kinks


def test_error_falls_with_the_square_of_the_triangles():
    """Errors are relative to the finest mesh. Subdivision at midpoints keeps the surface."""
    sea, mesh = three_waves(), trimesh.creation.box(extents=[1.0, 1.0, 1.0])
    rng = np.random.default_rng(17)
    poses = [(rng.uniform(-1, 1, 3) * [1, 1, 0.3], random_rotation(rng)) for _ in range(5)]
    wrenches = []
    for _ in range(6):
        method = Linear(Hull.from_trimesh(mesh), sea)
        wrenches.append(np.array([method.wrench(p, r, 0.3) for p, r in poses]))
        mesh = mesh.subdivide()
    errors = [np.abs(w - wrenches[-1]).max() for w in wrenches[2:-1]]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ((slopes > 1.6) & (slopes < 2.9)).all(), slopes


def test_a_dry_hull_has_no_wrench():
    hull = Hull.from_trimesh(meshes()["bunny"])
    for height in (1.0, 100.0, 1e6):
        wrench = Linear(hull, three_waves()).wrench([0.0, 0.0, height], np.eye(3), 0.0)
        assert not wrench.any()


def test_deep_down_small_differences_of_large_heads_stay_accurate():
    """Archimedes' law at a depth of 10 km, where the force is a small difference of heads of 1e4 m.
    The round-off of many vertices averages out."""
    hull, depth = Hull.from_trimesh(meshes()["bunny"]), 1e4
    rng = np.random.default_rng(18)
    for _ in range(10):
        rotation = random_rotation(rng)
        wrench = Linear(hull, FLAT).wrench(
            [0.3, 0.0, -depth * rng.uniform(0.9, 1.1)], rotation, 0.0
        )
        wrench /= DENSITY * GRAVITY * hull.volume
        expected = [0.0, 0.0, 1.0, *np.cross(rotation @ hull.centroid, [0.0, 0.0, 1.0])]
        np.testing.assert_allclose(wrench, expected, atol=1e-16 * depth)


@pytest.mark.parametrize("height", [0.5, -0.5, 0.0])
def test_faces_and_vertices_exactly_on_the_surface(height):
    wrench = Linear(Hull.from_trimesh(CUBE), FLAT).wrench([0.0, 0.0, height], np.eye(3), 0.0)
    displaced = 0.5 - height
    expected = [0.0, 0.0, DENSITY * GRAVITY * displaced, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(wrench, expected, atol=ROUND_OFF * DENSITY * GRAVITY)


def test_a_pose_that_is_not_finite_gives_nan():
    method = Linear(Hull.from_trimesh(CUBE), three_waves())
    assert np.isnan(method.wrench([np.nan, 0.0, 0.0], np.eye(3), 0.0)).any()
    assert np.isnan(method.wrench([0.0, 0.0, np.nan], np.eye(3), 0.0)).any()


def test_rotations_may_be_flat_as_in_mujoco():
    method = Linear(Hull.from_trimesh(CUBE), three_waves())
    rotation = random_rotation(np.random.default_rng(19))
    np.testing.assert_array_equal(
        method.wrench([0, 0, 0], rotation.ravel(), 0), method.wrench([0, 0, 0], rotation, 0)
    )
