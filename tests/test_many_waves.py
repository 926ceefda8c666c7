"""The sums of jets in single precision, with waves as lanes, against those in double precision."""

import numpy as np
import pytest
import trimesh

import sim.methods.patches.patches as patches_module
from independent import load_mesh, random_rotation
from sim import Hull, Patches, Sea, Wave
from sim.methods.method import PLACE
from sim.methods.patches import fit
from sim.methods.patches.fit import (
    head_errors,
    jet_waves,
    rough_heads,
    rough_steps,
    true_heads,
)
from sim.water.gerstner import CHUNK, LABELS, PLAIN_STEPS, SUMS
from sim.water.head_jets import DECAYED, head_sums
from sim.water.jets import HIGHER_SUMS, Near
from sim.water.many_waves import (
    MANY_WAVES,
    TILE,
    find_many_near,
    many_head_sums,
    many_jet_sums,
    many_wave_sums,
)
from sim.water.samples import sample_places

SINGLE_ROUND_OFF = 1e-6
"""Error of a sum in single precision, as a share of its largest values: 64 waves at a time, each to
6e-8."""

COUNT = 40


def waves_of(count: int, **water) -> Sea:
    return Sea.jonswap(3.0, 8.0, waves=count, seed=2, **water)


def sums_at(sea: Sea, far: float, time: float, compute) -> dict[str, np.ndarray]:
    """All sums at COUNT random labels and depths."""
    rng = np.random.default_rng(4)
    labels, *found = (np.zeros(1, kind) for kind in (LABELS, SUMS, HIGHER_SUMS, DECAYED))
    labels["x"][0] = far + rng.uniform(-60.0, 60.0, CHUNK)
    labels["y"][0] = rng.uniform(-60.0, 60.0, CHUNK)
    found[2]["s"][0] = -rng.uniform(0.0, 15.0, CHUNK)
    compute(COUNT, sea.components, time, labels, *found)
    return {
        f"{kind} {name}": table[name][0, :COUNT]
        for kind, table in zip("psd", found, strict=True)
        for name in table.dtype.names
        if name not in ("sine", "cosine", "phase", "rest_x", "rest_y", "up")
    }


@pytest.mark.parametrize("water", [{}, {"depth": 25.0}, {"ramp": 9.0}], ids=str)
@pytest.mark.parametrize("count", [MANY_WAVES, TILE + 1, 3 * TILE])
def test_sums_are_those_in_double_precision(count, water):
    sea = waves_of(count, **water)
    for far, time in ((0.0, 5.0), (1e5, 1e5)):
        truth = sums_at(sea, far, time, head_sums)
        found = sums_at(sea, far, time, many_head_sums)
        for name, values in truth.items():
            scale = np.abs(values).max()
            assert scale > 0.0, name
            np.testing.assert_allclose(found[name], values, atol=SINGLE_ROUND_OFF * scale)
        fewer = sums_at(sea, far, time, lambda *given: many_jet_sums(*given[:-1]))
        fewest = sums_at(sea, far, time, lambda *given: many_wave_sums(*given[:-2]))
        for name, values in found.items():
            if name[0] in "ps":
                np.testing.assert_array_equal(fewer[name], values)
            if name[0] == "p":
                np.testing.assert_array_equal(fewest[name], values)


def test_particles_near_points_are_above_and_below_them():
    """After four steps their labels and heights are those of the surface at the points."""
    sea, rng = waves_of(60), np.random.default_rng(5)
    x, y = rng.uniform(-90.0, 90.0, (2, COUNT))
    near = Near(*np.empty((3, len(x))))
    find_many_near(x, y, sea.components, 3.0, 4, near)
    np.testing.assert_allclose(near.height, sea.elevation(x, y, 3.0), atol=1e-5)


@pytest.mark.parametrize("count", [3, 200])
@pytest.mark.parametrize("pressure", ["hydrostatic", "froude-krylov"])
def test_wrenches_are_those_in_double_precision(pressure, count, monkeypatch):
    mesh = load_mesh("bunny")
    hull = Hull.from_trimesh(mesh.apply_scale(40.0 / mesh.extents.max()))
    sea = waves_of(count, pressure=pressure)
    single = Patches(hull, sea)
    assert is_single(single)
    monkeypatch.setattr(patches_module, "SINGLE_TOLERANCE", np.inf)
    double = Patches(hull, sea)
    assert not is_single(double)
    rng, weight = np.random.default_rng(6), sea.density * sea.gravity * hull.volume
    for _ in range(10):
        pose = rng.uniform(-30.0, 30.0, 3) * [1, 1, 0.2], random_rotation(rng), rng.uniform(0, 99.0)
        missed = single.wrench(*pose) - double.wrench(*pose)
        assert 0.0 < np.abs(missed[:3]).max() < SINGLE_ROUND_OFF * weight
        assert np.abs(missed[3:]).max() < SINGLE_ROUND_OFF * weight * hull.length


def is_single(method: Patches) -> bool:
    return method._alone[0] is patches_module.single_patches_wrenches


def test_tight_tolerances_flat_water_and_seas_about_to_fold_keep_double_precision():
    hull = Hull.from_trimesh(trimesh.creation.box((1.0, 1.0, 1.0)))
    sea = waves_of(MANY_WAVES)
    assert is_single(Patches(hull, sea, 1e-3))
    assert not is_single(Patches(hull, sea, 1e-6))
    assert not is_single(Patches(hull, Sea()))
    folding = Sea([Wave(0.98 / (2.0 * np.pi) * 8.0, 8.0)])
    assert not is_single(Patches(hull, folding, 0.02))


def test_a_tolerance_is_kept_that_is_large_for_the_waves_and_small_for_the_hull():
    """Single precision loses digits of the hull's length."""
    hull, sea = Hull.from_trimesh(trimesh.creation.box((20.0, 10.0, 6.0))), Sea([Wave(1e-3, 100.0)])
    method, rng = Patches(hull, sea, 1e-7), np.random.default_rng(7)
    for _ in range(5):
        places, found = method.heads_at_vertices(np.zeros(3), random_rotation(rng), 1.0)
        x, y, z = places.T
        assert np.nanmax(np.abs(found - sea.head(x, y, z, 1.0))[found > 0.0]) < 1e-7


def test_hulls_with_tight_and_loose_tolerances_are_computed_apart():
    hull, sea = Hull.from_trimesh(trimesh.creation.box((1.0, 1.0, 1.0))), waves_of(3)
    methods = [Patches(hull, sea, tolerance) for tolerance in (1e-3, 1e-6, 2e-3)]
    places = np.array([(0, row) for row in range(3)], PLACE)
    parts = Patches.parts(methods, places)
    assert [part.kernel is patches_module.patches_wrenches for part in parts] == [False, True]
    position, rotation = np.array([[0.1, 0.2, -0.1]]), np.eye(3).reshape(1, 9)
    wrenches = np.empty((3, 6))
    for part in parts:
        part.kernel(part.block, part.places, position, rotation, 1.0, wrenches)
    for method, wrench in zip(methods, wrenches, strict=True):
        alone = method.wrench(position[0], rotation[0], 1.0)
        np.testing.assert_allclose(wrench, alone, atol=SINGLE_ROUND_OFF * np.abs(alone).max())


@pytest.mark.parametrize("count", [MANY_WAVES, 200])
def test_rough_heads_judge_jets_like_true_ones(count):
    """The errors of jets found with rough heads are those found with true heads, to a tenth of the
    smallest that rough heads judge."""
    sea, radius = waves_of(count), 4.0
    steps, least = rough_steps(sea)
    assert steps < PLAIN_STEPS
    x, y = (axis[:200] for axis in sample_places(sea))
    above = np.linspace(-12.0, 0.0, 200)
    true, rough = true_heads(sea)(x, y, above), rough_heads(sea, steps)(x, y, above)
    wet = true > 0.0
    assert 50 < np.count_nonzero(wet) < 200
    assert 0.0 < np.abs(rough - true)[wet].max() < 0.1 * least
    assert (rough[~wet] <= 0.1 * least).all()
    errors = head_errors(sea, jet_waves(sea, radius), radius, chosen=np.arange(200))
    assert errors.max() > least
    exact = rough_steps.__wrapped__(sea.hydrostatic)
    assert exact[0] == PLAIN_STEPS


def test_small_errors_are_judged_by_true_heads(monkeypatch):
    sea, calls = waves_of(MANY_WAVES), []
    monkeypatch.setattr(fit, "true_heads", lambda sea: calls.append(sea) or true_heads(sea))
    for radius, count in ((8.0, 0), (0.1, 1)):
        head_errors(sea, jet_waves(sea, radius), radius, chosen=np.arange(50))
        assert len(calls) == count
