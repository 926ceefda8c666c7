"""The reference method against exact integrals, other tolerances and other meshes."""

import numpy as np
import pytest
import trimesh
from numpy.polynomial.legendre import leggauss

from independent import (
    DENSITY,
    GRAVITY,
    ROUND_OFF,
    load_mesh,
    mean_error,
    meshes,
    random_poses,
    relative_error,
    three_waves,
)
from sim import Hull, Linear, Reference, Sea, Wave

BARGE = trimesh.creation.box(extents=[2.0, 1.0, 1.2])


def label_above(wave: Wave, x: float) -> float:
    """Label of the particle of a wave along +x that is at x at time 0, by bisection."""

    def position(label):
        return label + wave.amplitude * np.cos(wave.wavenumber * label + wave.phase)

    low, high = x - wave.amplitude, x + wave.amplitude
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if position(middle) < x else (low, middle)
    return low


def barge_wrench(wave: Wave, x: float, keel: float) -> np.ndarray:
    """Wrench (6,), about the world's origin, of the upright barge at (x, 0) with its bottom at
    z = keel, in a wave along +x. Gauss-Legendre quadrature integrates over particle labels."""
    k, a = wave.wavenumber, wave.amplitude
    first, last = label_above(wave, x - 1.0), label_above(wave, x + 1.0)
    nodes, weights = leggauss(60)
    labels = 0.5 * (first + last) + 0.5 * (last - first) * nodes
    theta = k * labels + wave.phase
    dx = 0.5 * (last - first) * weights * (1.0 - k * a * np.sin(theta))
    position, head = labels + a * np.cos(theta), a * np.sin(theta) - keel
    heave = head @ dx
    pitch = -(position * head) @ dx
    surge = 0.0
    for label, sign in ((first, 1.0), (last, -1.0)):  # the ends, from keel to surface
        depth = a * np.sin(k * label + wave.phase) - keel
        surge += sign * depth**2 / 2.0
        pitch += sign * (keel * depth**2 / 2.0 + depth**3 / 6.0)
    return DENSITY * GRAVITY * np.array([surge, 0.0, heave, 0.0, pitch, 0.0])


@pytest.mark.parametrize("steepness", [0.1, 0.5, 0.8])
@pytest.mark.parametrize("length", [0.7, 2.3, 40.0])
def test_upright_barge_in_a_long_crested_wave(steepness, length):
    wave = Wave(min(steepness * length / (2.0 * np.pi), 0.3), length, 0.0, 0.9)
    hull = Hull.from_trimesh(BARGE)
    position = np.array([0.3, 0.0, 0.1])
    wrench = Reference(hull, Sea([wave], pressure="hydrostatic")).wrench(position, np.eye(3), 0.0)
    wrench[3:] += np.cross(position, wrench[:3])  # about the world's origin
    expected = barge_wrench(wave, 0.3, 0.1 - 0.6)
    assert relative_error(wrench, expected, hull) < 1e-9


@pytest.mark.parametrize("name", ["cube", "bunny", "torus"])
def test_errors_stay_below_the_tolerance(name):
    mesh = BARGE if name == "cube" else meshes()[name]
    hull, sea = Hull.from_trimesh(mesh), three_waves(0.6)
    for pose in random_poses(3, seed=21):
        truth = Reference(hull, sea, 1e-11).wrench(*pose)
        for tolerance in (1e-4, 1e-6, 1e-8):
            found = Reference(hull, sea, tolerance).wrench(*pose)
            assert relative_error(found, truth, hull) < tolerance


class CountingSea(Sea):
    """A sea that counts the heads that it computes."""

    def head(self, x, y, z, time):
        HEADS.append(np.size(x))
        return super().head(x, y, z, time)


HEADS: list[int] = []


def test_errors_fall_with_the_third_power_of_the_work():
    """Work is the number of computed heads. Most are along the waterline, so their number is
    inversely proportional to the size of the pieces."""
    hull = Hull.from_trimesh(BARGE)
    sea = CountingSea(three_waves(0.3).waves, pressure="hydrostatic")
    poses = random_poses(3, seed=22)
    truths = [Reference(hull, sea, 1e-12).wrench(*pose) for pose in poses]
    errors, work = [], []
    for tolerance in (1e-6, 1e-10):
        HEADS.clear()
        found = [Reference(hull, sea, tolerance).wrench(*pose) for pose in poses]
        errors.append(mean_error(found, truths, hull))
        work.append(sum(HEADS))
    slope = np.log(errors[0] / errors[1]) / np.log(work[1] / work[0])
    assert 2.5 < slope < 3.9, (errors, work)


@pytest.mark.parametrize("name", ["cube", "bunny"])
def test_wrenches_do_not_depend_on_the_mesh_of_a_surface(name):
    mesh = BARGE if name == "cube" else load_mesh("bunny")
    once, sea, hull = mesh.subdivide(), three_waves(), Hull.from_trimesh(mesh)
    finer = (Hull.from_trimesh(m) for m in (once, once.subdivide()))
    references = [Reference(h, sea) for h in (hull, *finer)]
    for pose in random_poses(2, seed=23):
        wrenches = [reference.wrench(*pose) for reference in references]
        assert relative_error(wrenches[1], wrenches[0], hull) < 1e-8
        assert relative_error(wrenches[2], wrenches[0], hull) < 1e-8


def test_crests_inside_a_face_with_dry_corners_count():
    """Short waves cross a large flat face just above the still level."""
    hull = Hull.from_trimesh(trimesh.creation.box(extents=[4.0, 4.0, 1.0]))
    sea = Sea([Wave(0.02, 0.5)], pressure="hydrostatic")
    pose = (np.array([0.0, 0.0, 0.51]), np.eye(3), 0.0)
    wrench = Reference(hull, sea).wrench(*pose)
    x = np.linspace(-2.0, 2.0, 40001)[:-1] + 5e-5
    head = np.maximum(sea.elevation(x, 0.0, 0.0) - 0.01, 0.0)
    expected = DENSITY * GRAVITY * 16.0 * head.mean()
    midpoint_rule = 1e-6
    assert wrench[2] == pytest.approx(expected, rel=midpoint_rule)


def test_flat_water_is_exact():
    hull, sea = Hull.from_trimesh(meshes()["bunny"]), Sea()
    for pose in random_poses(5, seed=24):
        expected = Linear(hull, sea).wrench(*pose)
        assert relative_error(Reference(hull, sea).wrench(*pose), expected, hull) < ROUND_OFF


def test_deep_and_dry_hulls():
    hull, sea = Hull.from_trimesh(meshes()["bunny"]), three_waves()
    assert not Reference(hull, sea).wrench([0.0, 0.0, 5.0], np.eye(3), 0.0).any()
    deep = Reference(hull, sea).wrench([0.0, 0.0, -5.0], np.eye(3), 0.0)
    assert deep[2] / (DENSITY * GRAVITY * hull.volume) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan])
def test_an_impossible_tolerance_is_refused(tolerance):
    with pytest.raises(ValueError, match=r"tolerance is .*or more"):
        Reference(Hull.from_trimesh(BARGE), Sea(), tolerance)


def test_a_tolerance_out_of_reach_is_an_error():
    method = Reference(Hull.from_trimesh(BARGE), three_waves(), halvings=3)
    with pytest.raises(RuntimeError, match=r"did not converge to 1e-09 .* 3 halvings"):
        method.wrench([0, 0, 0], np.eye(3), 0.0)


def test_endless_computations_are_refused():
    hull = Hull.from_trimesh(trimesh.creation.box())
    with pytest.raises(ValueError, match="1e-14 or more"):
        Reference(hull, Sea(), 1e-30)
    with pytest.raises(
        RuntimeError, match=r"waves' phases leaves a relative error of.*larger tolerance"
    ):
        Reference(hull, three_waves(), 1e-9).wrench([0, 0, 0], np.eye(3), 1e14)
