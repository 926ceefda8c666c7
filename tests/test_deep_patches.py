"""Larger patches far below the surface, where only long waves are left."""

import numpy as np
import pytest
import trimesh

from sim import Hull, Patches, Sea
from sim.geometry import random_rotation
from sim.methods.patches.polynomial import monomials, moved_monomials
from sim.methods.patches.tree import MOMENTS

ROUND_OFF = 1e-12


@pytest.fixture(scope="module")
def tower():
    """A block, deep in the water, in a sea of waves from long to short."""
    mesh = trimesh.creation.box((6.0, 6.0, 16.0)).subdivide().subdivide()
    return Patches(Hull.from_trimesh(mesh), Sea.jonswap(0.5, 4.0, waves=60, seed=1), 0.02)


def chosen_levels(patches, position, rotation, time):
    """The levels of the patches that get jets."""
    chosen, _ = patches._polynomials(
        np.reshape(position, (1, 3)), np.reshape(rotation, (1, 9)), time
    )
    return patches.tree.patches["level"][chosen["patch"]]


def test_monomials_move_by_the_binomial_theorem():
    rng = np.random.default_rng(61)
    d, offset = rng.normal(size=(5, 3)), rng.normal(size=3)
    (moved,) = moved_monomials(offset[None])
    np.testing.assert_allclose(monomials(d + offset), monomials(d) @ moved.T, atol=ROUND_OFF)


def test_larger_patches_have_the_moments_of_the_patches_inside(tower):
    """Moments of the four linear monomials, about the centre of the larger patch, are integrals
    over the same surface."""
    patches, moments = tower.tree.patches, tower.tree.moments
    centres = np.stack([patches[axis] for axis in "xyz"], axis=1)
    linear = MOMENTS["linear"].shape[1]
    larger = np.flatnonzero(patches["level"])
    assert len(larger) > 10
    for p in larger:
        inside = np.arange(p + 1, patches["after"][p])
        assert len(inside) > 1
        inside = inside[patches["level"][inside] == 0]
        (row,) = moments["linear"][[patches["first"][p]]]
        found = moments["linear"][patches["first"][inside]]
        assert row[:, 0] == pytest.approx(found[:, :, 0].sum(axis=0), abs=1e-9)
        offsets = centres[inside] - centres[p]
        wanted = found[:, :, 1:] + found[:, :, :1] * offsets[:, None]
        np.testing.assert_allclose(row[:, 1:linear], wanted.sum(axis=0), atol=1e-9)


def test_larger_patches_keep_the_tolerance_and_save_jets(tower):
    """Heads at all vertices of the wet part are within the tolerance, and far fewer jets are made
    than the hull has patches below the surface."""
    rng, sea = np.random.default_rng(62), tower.sea
    small = np.count_nonzero(tower.tree.patches["level"] == 0)
    for _ in range(6):
        rotation = random_rotation(rng) if rng.random() < 0.3 else np.eye(3)
        position, time = rng.uniform([-20.0, -20.0, -9.0], [20.0, 20.0, -7.0]), rng.uniform(0, 100)
        levels = chosen_levels(tower, position, rotation, time)
        assert levels.max() > 0
        assert len(levels) < 0.5 * small
        places, found = tower.heads_at_vertices(position, rotation, time)
        true = sea.head(*places.T, time)
        missed = np.maximum(np.nan_to_num(found), 0.0) - np.maximum(true, 0.0)
        assert np.abs(missed).max() < tower.tolerance


def test_a_hull_deep_down_has_few_jets_and_the_wrench_of_its_volume(tower):
    """Below the waves the force is the displaced water's weight, from a handful of jets."""
    levels = chosen_levels(tower, (0.0, 0.0, -60.0), np.eye(3), 3.0)
    assert len(levels) < 0.05 * np.count_nonzero(tower.tree.patches["level"] == 0)
    wrench = tower.wrench((0.0, 0.0, -60.0), np.eye(3), 3.0)
    weight = tower.sea.density * tower.sea.gravity * tower.hull.volume
    assert wrench[2] == pytest.approx(weight, rel=1e-5)  # what long waves leave there


def test_hydrostatic_pressure_has_no_larger_patches():
    """Its waves reach down as far as one likes."""
    mesh = trimesh.creation.box((6.0, 6.0, 16.0))
    sea = Sea.jonswap(0.5, 4.0, waves=60, seed=1).hydrostatic
    assert len(Patches(Hull.from_trimesh(mesh), sea).levels) == 1


def test_a_hull_thinner_than_the_waves_reach_has_no_larger_patches():
    """It would have more small ones and no use of the others."""
    mesh = trimesh.creation.box((16.0, 16.0, 1.0)).subdivide().subdivide()
    raft = Patches(Hull.from_trimesh(mesh), Sea.jonswap(0.5, 4.0, waves=60, seed=1), 0.02)
    assert len(raft.tree.patches) > 200
    assert len(raft.levels) == 1


def test_the_mean_level_of_waves_that_are_left_out_counts(tower):
    """Deep down the head is that below the mean of the surface, not below the still level."""
    sunk = max(level.sunk for level in tower.levels)
    places, found = tower.heads_at_vertices((0.0, 0.0, -60.0), np.eye(3), 3.0)
    missed = np.abs(found - tower.sea.head(*places.T, 3.0)).max()
    assert missed < 0.5 * sunk
