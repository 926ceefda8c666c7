"""Patch sizes: how finely hulls are cut, refusals, and the error of the default tolerance."""

import numpy as np
import pytest
import trimesh

from benchmarks.accuracy import errors, wrenches
from benchmarks.random_cases import random_cases, random_hull
from benchmarks.seas import SEAS, waterline_poses
from sim import Hull, Linear, Note, Patches, Reference, Sea, Wave
from sim.geometry import across, area_vectors, areas, cone_volumes, sides, split_triangles
from sim.methods.patches import fit
from sim.methods.patches import sizes as patch_sizes
from sim.methods.patches.fit import EQUAL_RADIUS_RATIO, jet_radius, jet_tolerance
from sim.methods.patches.patches import LARGEST_FORCE_ERROR
from sim.methods.patches.sizes import (
    EDGE_RADII,
    FEW_PATCHES,
    LARGER_RADIUS_RATIO,
    MANY_PATCHES,
    MOST_PATCHES,
    MOST_TRIANGLES,
    _radius_of,
    default_tolerance,
)
from sim.methods.patches.tree import build_tree
from sim.water.head import PRESSURES

TURN = 2.0 * np.pi


def box(extents) -> Hull:
    return Hull.from_trimesh(trimesh.creation.box(extents=extents))


def subdivided(hull: Hull, halvings: int) -> Hull:
    """The hull with edges 2^halvings times as short."""
    mesh = trimesh.Trimesh(hull.vertices, hull.faces)
    for _ in range(halvings):
        mesh = mesh.subdivide()
    return Hull(mesh.vertices, mesh.faces)


@pytest.mark.parametrize(
    ("extents", "steepness", "tolerance", "reason"),
    [
        ((200.0, 30.0, 20.0), 0.5, 1e-4, r"patches below .* more than 100000 on this hull; use"),
        ((10.0, 4.0, 2.0), 0.95, 1e-3, r"patches below .* more than 100000 on this hull; use"),
        ((10.0, 4.0, 2.0), 0.3, 1e-30, r"patches below .* more than 100000 on this hull; use"),
        ((100.0, 100.0, 1.0), 0.05, 1e-4, r"triangles with .* more than 2000000 on this hull; use"),
    ],
)
def test_a_tolerance_that_needs_too_many_patches_is_refused(
    extents, steepness, tolerance, reason, monkeypatch
):
    """The estimate refuses it before anything is cut."""
    monkeypatch.setattr(patch_sizes, "build_tree", None)
    with pytest.raises(ValueError, match=reason):
        Patches(box(extents), Sea([Wave(steepness * 20.0 / TURN, 20.0)]), tolerance)


@pytest.mark.parametrize(
    ("extents", "steepness"),
    [
        ((1.0, 1.0, 1.0), 0.16), ((1.0, 1.0, 1.0), 0.8), ((1.0, 1.0, 1.0), 0.99),
        ((10.0, 4.0, 2.0), 0.16), ((10.0, 4.0, 2.0), 0.99), ((200.0, 40.0, 4.0), 0.8),
        ((20.0, 0.01, 0.01), 0.16), ((20.0, 0.01, 0.01), 0.99),
        ((1e6, 1e6, 1e6), 0.16), ((1e6, 1e6, 1e6), 0.99),
    ],
    ids=str,
)  # fmt: skip
def test_the_default_tolerance_has_a_budget(extents, steepness):
    hull, sea = box(extents), Sea([Wave(steepness * 4.0 / TURN, 4.0)])
    method = Patches(hull, sea)
    count = np.count_nonzero(method.tree.patches["level"] == 0)
    assert count <= MOST_PATCHES
    estimate_ratio = 1.2
    triangles = np.count_nonzero(method.tree.leaves["triangles"])
    assert triangles <= estimate_ratio * MOST_TRIANGLES
    wanted = default_tolerance(hull)
    assert method.is_coarse == bool(method.notes)
    if not method.is_coarse:
        assert method.tolerance <= wanted * LARGER_RADIUS_RATIO**4
        assert method.tolerance <= wanted or count > 0.3 * MANY_PATCHES
        assert method.tolerance >= wanted or count < 4 * FEW_PATCHES
    else:  # a coarse method uses its budget
        assert count > 0.5 * MOST_PATCHES or max(extents) == 20.0


FEW = dict(MOST_PATCHES=400, MOST_TRIANGLES=4_000)
"""Small limits: a cut that takes a tenth of a second."""


@pytest.mark.parametrize("steepness", [0.98, 0.9999])
@pytest.mark.parametrize("pressure", PRESSURES)
def test_forces_hold_up_to_the_fold(steepness, pressure, monkeypatch):
    """Against linear heads on small faces. Cubics with exact derivatives would be wrong by 0.02 to
    500 of density * gravity * volume, because next to a cusp they hold within a millimetre."""
    for name, most in FEW.items():
        monkeypatch.setattr(patch_sizes, name, most)
    hull, sea = box((1.0, 1.0, 1.0)), Sea([Wave(steepness * 4.0 / TURN, 4.0)], pressure=pressure)
    with pytest.warns(Note, match=r"kept to 0\.\d+ m instead of .* forces at crests to 0\.00"):
        method = Patches(hull, sea)
    poses = [
        (np.array([1.0 + x, 0.2, 0.3 * steepness]), np.eye(3), 0.0) for x in (-0.3, -0.02, 0.0, 0.2)
    ]
    truth = wrenches(Linear(subdivided(hull, 6), sea), poses)
    assert errors(wrenches(method, poses), truth, method).force_max < LARGEST_FORCE_ERROR


def test_a_force_that_does_not_hold_is_refused(monkeypatch):
    for name, most in FEW.items():
        monkeypatch.setattr(patch_sizes, name, most)
    monkeypatch.setattr(fit, "SQUEEZES", (0.0,))
    with pytest.raises(ValueError, match=r"error of the force of .* expected at most 0\.01: lower"):
        Patches(box((1.0, 1.0, 1.0)), Sea([Wave(0.99 * 4.0 / TURN, 4.0)]))


def test_the_default_tolerance_bounds_the_force_error(monkeypatch):
    """Over random hulls and seas the force error stays below the claim in the doc of Patches."""
    monkeypatch.setattr("benchmarks.random_cases.POSES_PER_CASE", 2)
    cases = list(random_cases(8, seed=7, truth=1e-5))
    assert any("box" in c.name for c in cases)
    assert len({c.name.split(";")[0] for c in cases}) == 8
    assert sum(c.is_coarse for c in cases) < 4
    assert max(c.error for c in cases) < 1e-3


def test_the_number_of_patches_is_estimated_to_a_factor():
    for number in range(12):
        name, hull = random_hull(np.random.default_rng([7, number]))
        for estimate in (30, 200):
            radius = _radius_of(hull, estimate)
            count = len(build_tree(hull, radius, EDGE_RADII * radius).patches)
            assert 0.25 * estimate < count < 1.25 * estimate, name


def test_slivers_are_cut_across_their_length():
    """The pieces are about as long as the largest edge allowed, and the surface stays the same."""
    corners = box((20.0, 0.01, 0.02)).vertices[box((20.0, 0.01, 0.02)).faces]
    cut = split_triangles(across(corners, 0.1), lambda c: sides(c).max(axis=1) > 0.1, 10_000)
    assert 8 * 200 <= len(cut) <= 2.2 * 8 * 200
    np.testing.assert_allclose(area_vectors(cut).sum(axis=0), 0.0, atol=1e-12)
    assert areas(cut).sum() == pytest.approx(areas(corners).sum(), rel=1e-12)
    assert cone_volumes(cut).sum() == pytest.approx(0.004, rel=1e-12)
    chunky = box((1.0, 1.0, 1.0))
    np.testing.assert_array_equal(
        across(chunky.vertices[chunky.faces], 0.1), chunky.vertices[chunky.faces]
    )


def test_waves_much_shorter_than_patches_are_averaged():
    """A cubic that fits ripples only near the centre of a patch is wrong by hundreds of their
    heights at its rim. Fitted over the whole patch, of any size, it is wrong by a few."""
    swell, ripples = Wave(0.3, 12.0), [Wave(0.02, 0.8, 1.0), Wave(0.03, 1.5, 2.0)]
    for pressure in PRESSURES:
        sea = Sea([swell, *ripples], pressure=pressure)
        assert jet_tolerance(sea, 1.7) < 0.2  # it would be 17 with one disc for all waves
        assert jet_tolerance(Sea(ripples, pressure=pressure), 1e5) < 4.0 * 0.05


@pytest.mark.parametrize(
    ("extents", "length"),
    [((20.0, 0.01, 0.01), 4.0), ((20.0, 0.02, 0.02), 15.0), ((10.0, 10.0, 0.03), 8.0)],
)
def test_slender_and_flat_hulls_are_as_accurate_as_others(extents, length):
    """A tolerance from their longest side would leave five to a thousand times the error."""
    hull, sea = box(extents), Sea([Wave(0.16 * length / TURN, length, 0.3)])
    poses = waterline_poses(hull, sea, 3, seed=1)
    truth = wrenches(Reference(hull, sea, 1e-5), poses)
    by_depth, by_length = (
        errors(wrenches(method, poses), truth, method).force_max
        for method in (Patches(hull, sea), Patches(hull, sea, max(extents) / 400.0))
    )
    assert by_depth < 5e-4
    assert by_depth < 0.2 * by_length


def test_linear_heads_over_triangles_err_less_than_jets():
    """Under a crest, the errors of all triangles of a plate in the surface have the same sign. If
    the triangles were as large as the tolerance allows, they would add up to 1.1e-3."""
    waves = [
        (0.0535, 3.39, 2.667, 5.564),
        (0.0491, 1.92, 1.3, 4.917),
        (0.0519, 1.887, 0.657, 6.017),
    ]
    plate, sea = box((1.79, 0.058, 1.06)), Sea([Wave(*wave) for wave in waves])
    poses = waterline_poses(plate, sea, 2, seed=25)[1:]
    truth = wrenches(Reference(plate, sea, 2e-5), poses)
    method = Patches(plate, sea)
    assert errors(wrenches(method, poses), truth, method).force_max < 3e-4


def test_many_patches_may_each_be_larger():
    hull, sea = box((1.0, 1.0, 1.0)), Sea([Wave(0.8 * 4.0 / TURN, 4.0)])
    by_default, as_wanted = Patches(hull, sea), Patches(hull, sea, default_tolerance(hull))
    assert 0.3 * MANY_PATCHES < len(by_default.tree.patches) < 0.6 * len(as_wanted.tree.patches)
    assert by_default.tolerance > 2.0 * as_wanted.tolerance
    poses = waterline_poses(hull, sea, 3, seed=1)
    truth = wrenches(Reference(hull, sea, 1e-5), poses)
    assert errors(wrenches(by_default, poses), truth, by_default).force_max < 1e-4


def test_a_larger_tolerance_never_needs_smaller_patches():
    """Also where patches longer than the waves are halved."""
    tolerances = np.array([1e-3, 3e-3, 1e-2, 1.5e-2, 2e-2, 3e-2])
    for name in ("three", "chop", "forty"):
        radii, reached = np.transpose([jet_radius(SEAS[name], t, 0.87) for t in tolerances])
        assert (radii[1:] * EQUAL_RADIUS_RATIO > radii[:-1]).all()  # where the search ends
        # errors of chop grow with the eighth power of the radius, which is known to 5 percent
        assert (reached > 0.45 * tolerances).all()
