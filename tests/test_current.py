"""Current, ramp and tide: moving water, growing waves, a changing level."""

import numpy as np
import pytest
import trimesh
from scenes import CUBE, WAVES, model

from independent import GRAVITY, ROUND_OFF, random_rotation, three_waves
from sim import Chord, Hull, Linear, Patches, Reference, Scene, Sea, Wave, simulate

CURRENT = np.array([0.7, -0.4, 0.0])
DRAG = '<numeric name="drag" data="0.2 1 0.005"/>'


def box() -> Hull:
    return Hull.from_trimesh(trimesh.creation.box(extents=(1.2, 0.7, 0.5)))


def poses(count: int):
    rng = np.random.default_rng(8)
    for _ in range(count):
        yield rng.uniform([-5, -5, -0.4], [5, 5, 0.4]), random_rotation(rng), rng.uniform(0.0, 20.0)


@pytest.mark.parametrize("pressure", ["froude-krylov", "hydrostatic"])
@pytest.mark.parametrize("method", [Linear, Chord, Patches, Reference])
def test_a_hull_moving_with_the_water_has_the_wrench_of_one_at_rest(method, pressure):
    """Galilean invariance, to the round-off of positions."""
    hull, sea = box(), three_waves().with_pressure(pressure)
    moving = Sea(sea.waves, sea.density, sea.gravity, sea.level, pressure, CURRENT[:2])
    at_rest, carried = method(hull, sea), method(hull, moving)
    for position, rotation, time in poses(6):
        here = at_rest.wrench(position, rotation, time)
        there = carried.wrench(position + CURRENT * time, rotation, time)
        position_round_off = 1e-9 * sea.density * GRAVITY * hull.volume
        assert np.abs(there - here).max() < position_round_off


def test_a_current_shifts_the_surface_and_adds_its_velocity():
    sea = three_waves()
    moving = Sea(sea.waves, current=CURRENT)
    x, y, time = np.array([0.3, -2.0, 5.0]), np.array([1.0, 0.4, -3.0]), 7.3
    here = sea.surface(x, y, time)
    there = moving.surface(x + CURRENT[0] * time, y + CURRENT[1] * time, time)
    np.testing.assert_allclose(there.elevation, here.elevation, atol=1e-12)
    np.testing.assert_allclose(there.velocity, here.velocity + CURRENT, atol=1e-12)
    assert np.abs(moving.elevation(x, y, time) - sea.elevation(x, y, time)).max() > 0.01


def scene(custom: str, velocity=(0.0, 0.0, 0.0)) -> Scene:
    made = Scene.from_model(model(CUBE, custom=custom))
    made.data.qvel[:3] = velocity
    return made


def test_a_scene_moving_with_its_water_takes_the_same_path():
    """With drag and added mass, to the round-off that accumulates in ten seconds of waves."""
    more = DRAG + '<numeric name="added_mass" data="0.5 0.5 0.5 0 0 0"/>'
    still = list(simulate(scene(WAVES + more), 10.0))
    moving = '<numeric name="water_current" data="0.7 -0.4"/>'
    carried = list(simulate(scene(WAVES + more + moving, CURRENT), 10.0))
    accumulated_round_off = 1e-7
    for here, there in zip(still, carried, strict=True):
        moved = there.positions - CURRENT * there.time
        np.testing.assert_allclose(moved, here.positions, atol=accumulated_round_off)
        np.testing.assert_allclose(there.quaternions, here.quaternions, atol=accumulated_round_off)


def test_a_float_without_thrust_ends_at_the_speed_of_the_current():
    custom = DRAG + '<numeric name="water_current" data="0.5 0.2"/>'
    *_, before, last = simulate(scene(custom), 60.0, rate=0.1)
    speed = (last.positions[0] - before.positions[0]) / 10.0
    quadratic_drag_decays_slowly = 0.01  # m/s
    np.testing.assert_allclose(speed, [0.5, 0.2, 0.0], atol=quadratic_drag_decays_slowly)


def test_waves_grow_from_still_water_to_those_without_a_ramp():
    waves = three_waves().waves
    sea, grown = Sea(waves, ramp=8.0), Sea(waves)
    x, y = np.linspace(-3.0, 3.0, 7), np.linspace(2.0, -2.0, 7)
    assert np.abs(sea.elevation(x, y, 0.0)).max() == 0.0
    for time in (8.0, 20.0):
        np.testing.assert_array_equal(sea.elevation(x, y, time), grown.elevation(x, y, time))
    half = Sea([Wave(0.5 * w.amplitude, w.wavelength, w.heading, w.phase) for w in waves])
    np.testing.assert_allclose(sea.elevation(x, y, 4.0), half.elevation(x, y, 4.0), atol=1e-12)
    np.testing.assert_allclose(sea.head(x, y, -0.3, 4.0), half.head(x, y, -0.3, 4.0), atol=1e-12)
    hull, weight = box(), 1025.0 * GRAVITY * box().volume
    cut_for_grown_waves = 5e-4
    for kind, error in ((Linear, ROUND_OFF), (Patches, cut_for_grown_waves)):
        position, rotation, _ = next(poses(1))
        found = kind(hull, sea).wrench(position, rotation, 4.0)
        truth = kind(hull, half).wrench(position, rotation, 4.0)
        assert np.abs(found - truth)[:3].max() < error * weight


def test_a_settled_float_starts_on_a_ramp_without_a_jump():
    """A cube at its draught does not move at first, and then follows the waves."""
    ramp = WAVES + '<numeric name="water_ramp" data="10"/>' + DRAG
    moved = [s.positions[0, 2] for s in simulate(scene(ramp), 20.0)]
    assert np.abs(moved[:10]).max() < 1e-3
    assert np.ptp(moved[-200:]) > 0.05
    jumped = [s.positions[0, 2] for s in simulate(scene(WAVES + DRAG), 1.0)]
    assert np.abs(jumped[:10]).max() > 5e-3


TIDE = '<numeric name="water_level" data="0 0  10 1.5  20 1.5"/>'


def test_the_tide_lifts_the_water_and_floating_bodies():
    sea = Sea(tide=[(0.0, 0.0), (10.0, 1.5), (20.0, 1.5)])
    times = np.array([-5.0, 0.0, 5.0, 10.0, 15.0, 40.0])
    expected = [0.0, 0.0, 0.75, 1.5, 1.5, 1.5]
    np.testing.assert_allclose(sea.level_at(times), expected)
    np.testing.assert_allclose(sea.elevation(0.0, 0.0, times), expected)
    rise = sea.surface(0.0, 0.0, times).velocity[:, 2]
    np.testing.assert_allclose(rise, [0.0, 0.15, 0.15, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(sea.head(0.0, 0.0, -1.0, times), np.add(expected, 1.0))
    hull = box()
    for kind in (Linear, Chord, Patches, Reference):
        method = kind(hull, sea)
        for time, level in zip(times, expected, strict=True):
            position, rotation, _ = next(poses(1))
            still = kind(hull, Sea(level=level)).wrench(position, rotation, 0.0)
            there = method.wrench(position, rotation, time)
            assert np.abs(there - still).max() < ROUND_OFF * 1025.0 * GRAVITY * hull.volume
    samples = list(simulate(scene(TIDE + DRAG), 30.0))
    start, end = samples[0].positions[0, 2], samples[-1].positions[0, 2]
    assert end - start == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        (dict(current=(1.0,)), "current is .*2 or 3 finite numbers"),
        (dict(current=(1.0, np.nan)), "current is .*2 or 3 finite numbers"),
        (dict(ramp=-1.0), "ramp is -1.0 s; it must be finite and 0 or more"),
        (dict(tide=[(0.0, 1.0)]), "the tide has 1 levels; expected 2 to 16"),
        (dict(tide=[(0.0, 1.0), (0.0, 2.0)]), "the tide's times must rise"),
        (dict(tide=[(0.0, 1.0), (1.0, np.inf)]), "all of its numbers must be finite"),
    ],
)
def test_impossible_numbers_are_refused(numbers, message):
    with pytest.raises(ValueError, match=message):
        Sea(**numbers)
