"""The sea: the inverse of the Gerstner map, its derivatives, refusals."""

import copy
import pickle

import numpy as np
import pytest

from independent import GRAVITY, three_waves
from sim import Sea, Wave
from sim.methods.patches.fit import fitted_waves
from sim.water.gerstner import (
    CHUNK,
    LABELS,
    PLAIN_STEPS,
    SUMS,
    set_labels,
    sine_cosine,
    solve_labels,
    solve_point,
    wave_sums,
)
from sim.water.samples import newton_steps
from sim.water.sea import ELEVATION_ERROR

MAP_ROUND_OFF = 1e-12
"""Round-off [m] of positions within some tens of metres."""


def seas_of_steepness(steepness: float) -> list[Sea]:
    """Seas of one, three and forty crossing waves with the same sum of k a."""
    rng = np.random.default_rng(7)
    seas = [Sea([Wave(steepness / (2.0 * np.pi) * 2.0, 2.0, 0.3, 0.1)]), three_waves(steepness)]
    shares = rng.uniform(0.5, 1.5, 40)
    shares *= steepness / shares.sum()
    lengths = rng.uniform(0.5, 8.0, 40)
    waves = [
        Wave(share * length / (2.0 * np.pi), length, *rng.uniform(-np.pi, np.pi, 2))
        for share, length in zip(shares, lengths, strict=True)
    ]
    return [*seas, Sea(waves)]


def test_an_elevation_is_solved_from_the_points_themselves():
    """The first guess of a label is its point. Any other guess gives other last digits."""
    sea, x = three_waves(0.5), np.linspace(-20.0, 20.0, 60)
    guess, labels, heights = np.empty(1, LABELS), np.empty(1, LABELS), np.empty(60)
    set_labels(x, 0.3 * x, guess)
    tolerance = sea.water["tolerance"][0]
    solve_labels(x, 0.3 * x, guess, sea.components, 1.0, tolerance, 1, heights, labels)
    np.testing.assert_array_equal(sea.elevation(x, 0.3 * x, 1.0), heights)


@pytest.mark.parametrize("steepness", [0.0, 0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95])
def test_elevation_lies_on_the_particles_at_any_steepness(steepness):
    """At the horizontal position of a surface particle, the elevation is the particle's height."""
    rng = np.random.default_rng(1)
    for sea in seas_of_steepness(steepness):
        assert sea.steepness == pytest.approx(steepness)
        particles = sea.particles(rng.uniform(-20.0, 20.0, (3000, 2)), 3.7)
        error = np.abs(particles[:, 2] - sea.elevation(*particles[:, :2].T, 3.7))
        steepest_slope = steepness / (1.0 - steepness)
        assert error.max() < ELEVATION_ERROR + MAP_ROUND_OFF * (1.0 + steepest_slope)


@pytest.mark.parametrize("steepness", [0.5, 0.95])
def test_solver_converges_from_any_starting_label(steepness):
    rng = np.random.default_rng(2)
    for sea in seas_of_steepness(steepness):
        tolerance, work = float(sea.water["tolerance"][0]), (np.empty(1, LABELS), np.empty(1, SUMS))
        for _ in range(200):
            x, y = rng.uniform(-5.0, 5.0, 2)
            guess = rng.uniform(-20.0, 20.0, 2)
            *label, height = solve_point(x, y, *guess, sea.components, 0.4, tolerance, *work)
            np.testing.assert_allclose(sea.particles(label, 0.4)[:2], (x, y), atol=MAP_ROUND_OFF)
            assert abs(height - sea.elevation(x, y, 0.4)) < 2 * ELEVATION_ERROR + MAP_ROUND_OFF


def test_the_safeguard_solves_points_that_plain_newton_steps_miss():
    """In this sea plain steps leave samples unsolved, but elevations still match the particles."""
    sea = seas_of_steepness(0.99)[0]
    steps, residual = newton_steps(sea, 1e-9)
    assert steps == PLAIN_STEPS
    assert residual > 1e-3
    particles = sea.particles(np.column_stack([np.linspace(-2.0, 2.0, 999)] * 2), 0.0)
    error = np.abs(particles[:, 2] - sea.elevation(*particles[:, :2].T, 0.0))
    steepest_slope = 100.0
    assert error.max() < steepest_slope * MAP_ROUND_OFF


def test_sine_and_cosine_are_accurate_far_from_zero():
    rng = np.random.default_rng(3)
    turns = rng.uniform(-1.0, 1.0, 2000) * 10.0 ** rng.uniform(-8, 6, 2000)
    turns = np.concatenate([turns, np.arange(-8, 9) / 8.0])
    nearest = turns - np.round(turns)  # exact
    s, c = np.array([sine_cosine(t) for t in turns]).T
    np.testing.assert_allclose(s, np.sin(2.0 * np.pi * nearest), atol=5e-16, rtol=0)
    np.testing.assert_allclose(c, np.cos(2.0 * np.pi * nearest), atol=5e-16, rtol=0)


def test_one_gentle_wave_is_a_sine_with_second_order_crests():
    """Gerstner's profile to second order: eta = a sin(kx) - k a^2 / 2 (1 + cos(2kx))."""
    amplitude, length = 1e-4, 2.0
    sea = Sea([Wave(amplitude, length)], level=3.0)
    k = 2.0 * np.pi / length
    x = np.linspace(0.0, length, 41)
    eta = amplitude * np.sin(k * x) - 0.5 * k * amplitude**2 * (1.0 + np.cos(2.0 * k * x))
    third_order = 2.0 * k**2 * amplitude**3
    np.testing.assert_allclose(sea.elevation(x, 0.0, 0.0), 3.0 + eta, atol=third_order, rtol=0)


def test_a_wave_travels_along_its_heading_with_the_deep_water_speed():
    heading, length, time = 0.7, 3.0, 2.3
    sea = Sea([Wave(0.1, length, heading, 0.4)])
    speed = np.sqrt(9.81 * length / (2.0 * np.pi))
    x, y = np.random.default_rng(4).uniform(-3.0, 3.0, (2, 200))
    shifted = sea.elevation(
        x + speed * time * np.cos(heading), y + speed * time * np.sin(heading), time
    )
    np.testing.assert_allclose(shifted, sea.elevation(x, y, 0.0), atol=1e-12)


@pytest.mark.parametrize("steepness", [0.2, 0.6, 0.8])
def test_gradient_and_hessian_agree_with_finite_differences(steepness):
    sea = three_waves(steepness)
    x, y = np.random.default_rng(5).uniform(-3.0, 3.0, (2, 300))
    surface = sea.surface(x, y, 1.3)

    def elevation(x, y):
        return sea.elevation(x, y, 1.3)

    def gradient(x, y):
        return sea.surface(x, y, 1.3).gradient

    for exact, function in ((surface.gradient, elevation), (surface.hessian, gradient)):
        errors = [np.abs(_central(function, x, y, h) - exact).max() for h in (2e-3, 1e-3, 5e-4)]
        slopes = np.log2(np.array(errors[:-1]) / errors[1:])
        assert (slopes > 1.8).all(), (errors, slopes)  # second order
        assert errors[-1] < 1e-3 * np.abs(exact).max()


def _central(function, x, y, h):
    """Central differences in x and y, along a new last axis."""
    dx = (function(x + h, y) - function(x - h, y)) / (2.0 * h)
    dy = (function(x, y + h) - function(x, y - h)) / (2.0 * h)
    return np.stack([dx, dy], axis=-1)


def test_the_hessian_is_symmetric_and_the_elevation_consistent():
    sea = three_waves(0.7)
    x, y = np.random.default_rng(6).uniform(-3.0, 3.0, (2, 300))
    surface = sea.surface(x, y, 0.2)
    np.testing.assert_array_equal(surface.hessian[:, 0, 1], surface.hessian[:, 1, 0])
    np.testing.assert_allclose(
        surface.elevation, sea.elevation(x, y, 0.2), atol=2 * ELEVATION_ERROR, rtol=0
    )


@pytest.mark.parametrize(("ramp", "share"), [(0.0, 1.0), (4.6, 0.5), (2.0, 1.0)])
def test_particles_move_on_circles(ramp, share):
    """By Gerstner's formula, here in NumPy; there are more particles than in a chunk."""
    x, y = np.linspace(-3.0, 5.0, 30), np.linspace(1.0, 2.0, 40)
    labels = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    sea = Sea(three_waves(0.6).waves, level=0.3, ramp=ramp)
    expected = np.concatenate([labels, np.full((30, 40, 1), 0.3)], axis=-1)
    for wave in sea.waves:
        direction = np.array([np.cos(wave.heading), np.sin(wave.heading)])
        theta = wave.wavenumber * labels @ direction + wave.phase
        theta -= np.sqrt(GRAVITY * wave.wavenumber) * 2.3
        expected[..., :2] += share * wave.amplitude * np.cos(theta)[..., None] * direction
        expected[..., 2] += share * wave.amplitude * np.sin(theta)
    np.testing.assert_allclose(sea.particles(labels, 2.3), expected, atol=MAP_ROUND_OFF)
    assert sea.particles(labels[0, 0], 2.3).shape == (3,)


def test_the_velocity_is_that_of_the_particles():
    sea, h = three_waves(0.6), 1e-5
    labels = np.random.default_rng(8).uniform(-3.0, 3.0, (100, 2))
    by_difference = (sea.particles(labels, 0.9 + h) - sea.particles(labels, 0.9 - h)) / (2.0 * h)
    x, y, _ = sea.particles(labels, 0.9).T
    np.testing.assert_allclose(sea.surface(x, y, 0.9).velocity, by_difference, atol=1e-8)


def test_head_is_the_depth_below_the_surface():
    """It is signed, and relative to the surface at any level."""
    sea = Sea(three_waves().waves, level=-1.5, pressure="hydrostatic")
    x, y, z = np.random.default_rng(10).uniform(-3.0, 3.0, (3, 200))
    expected = sea.elevation(x, y, 0.4) - z
    np.testing.assert_allclose(sea.head(x, y, z, 0.4), expected, atol=MAP_ROUND_OFF)
    times = np.array([0.0, 0.7])
    heads = sea.head(0.2, 0.1, z[:, None], times)
    assert heads.shape == (200, 2)
    np.testing.assert_allclose(heads[:, 1], sea.head(0.2, 0.1, z, 0.7), atol=MAP_ROUND_OFF)


def test_arguments_broadcast_including_time():
    sea = three_waves()
    x, times = np.linspace(0.0, 2.0, 5), np.array([0.0, 1.0, 2.0])
    record = sea.elevation(x[None, :], 0.3, times[:, None])
    assert record.shape == (3, 5)
    for row, time in zip(record, times, strict=True):
        np.testing.assert_array_equal(row, sea.elevation(x, 0.3, time))
    assert sea.elevation(0.0, 0.0, 0.0).shape == ()
    assert sea.hessian(x, 0.0, times[:, None]).shape == (3, 5, 2, 2)
    assert sea.elevation([], [], 0.0).shape == (0,)


def test_the_elevation_of_a_point_does_not_depend_on_other_points():
    sea = three_waves(0.8)
    x, y = np.random.default_rng(9).uniform(-3.0, 3.0, (2, 700))
    together = sea.elevation(x, y, 0.0)
    alone = [float(sea.elevation(a, b, 0.0)) for a, b in zip(x, y, strict=True)]
    np.testing.assert_allclose(together, alone, atol=2 * ELEVATION_ERROR, rtol=0)


def test_points_that_are_not_finite_give_nan_and_affect_no_others():
    sea = three_waves()
    eta = sea.elevation([0.0, np.nan, np.inf, 1.0], 0.0, 0.0)
    assert np.isnan(eta).tolist() == [False, True, True, False]
    assert eta[3] == pytest.approx(float(sea.elevation(1.0, 0.0, 0.0)), abs=2 * ELEVATION_ERROR)
    assert np.isnan(sea.surface(np.nan, 0.0, 0.0).gradient).all()


def test_far_away_and_late_only_round_off_of_positions_is_lost():
    """The sea repeats after a whole number of wavelengths or periods."""
    wave = Wave(0.1, 2.0)
    sea = Sea([wave])
    period = 2.0 * np.pi / np.sqrt(9.81 * wave.wavenumber)
    x = np.linspace(0.0, 2.0, 50)
    far = sea.elevation(x + 1e6, 0.0, 0.0)
    position_round_off = 1e-9
    np.testing.assert_allclose(far, sea.elevation(x, 0.0, 0.0), atol=position_round_off)
    late = sea.elevation(x, 0.0, 1e6 * period)
    np.testing.assert_allclose(late, sea.elevation(x, 0.0, 0.0), atol=position_round_off)


def test_points_at_huge_distances_are_solved_to_round_off():
    """At 1e10 m, positions have a round-off of 2e-6 m, which is above the solver's tolerance."""
    sea = three_waves(0.6)
    eta = sea.elevation(1e10 + np.linspace(0.0, 10.0, 50), -1e10, 0.0)
    assert np.isfinite(eta).all()
    assert np.ptp(eta) > 0.5 * sea.amplitude
    assert np.abs(eta).max() <= sea.amplitude


@pytest.mark.parametrize("u", [0.1, 1.0, 3.0, 10.0])
def test_fitted_waves_are_the_best_cubic_over_a_disc(u):
    """They match a least-squares fit along the wave, weighted by the disc's width."""
    wavenumber, amplitude = np.pi, 0.1
    row = fitted_waves(Sea([Wave(amplitude, 2.0)]), u / wavenumber)[0]
    s = (np.arange(20000) + 0.5) / 10000 - 1.0
    x, root = u / wavenumber * s, (1.0 - s**2) ** 0.25  # the root of the weights
    for function, powers, names in (
        (np.cos, (0, 2), ("amplitude", "kka")),
        (np.sin, (1, 3), ("ka", "kkka")),
    ):
        basis = np.stack([x**power for power in powers], axis=1)
        best = np.linalg.lstsq(root[:, None] * basis, root * function(wavenumber * x), rcond=None)
        # Coefficients times factorials are derivatives, with alternating signs.
        expected = amplitude * best[0] * [1.0, -[2.0, 6.0][powers[0]]]
        found = [row[name] for name in names]
        midpoint_rule = 1e-5
        np.testing.assert_allclose(found, expected, rtol=midpoint_rule)


def test_fitted_waves_converge_to_the_sea_with_the_radius():
    """The difference falls with the square of the radius."""
    sea = three_waves()

    def strengths(waves):
        return np.stack([waves[name] for name in ("amplitude", "ka", "kka", "kkka")])

    own = strengths(sea.components)
    changes = [
        np.abs(strengths(fitted_waves(sea, r)) / own - 1.0).max() for r in (0.1, 0.05, 0.025)
    ]
    assert changes[0] < 0.02
    np.testing.assert_allclose(np.divide(changes[:-1], changes[1:]), 4.0, rtol=0.02)
    assert not fitted_waves(Sea(), 1.0).size


def test_newton_steps_converge_for_fitted_waves():
    """The slope differs from the offset's derivative by less than two thirds of 1 - |slope|."""
    for u in np.geomspace(0.01, 100.0, 300):
        row = fitted_waves(Sea([Wave(0.1, 2.0 * np.pi)]), u)[0]
        offset, slope = row["amplitude"] / 0.1, row["ka"] / 0.1
        assert abs(slope - offset) <= (2.0 / 3.0) * (1.0 - abs(slope)) + 1e-12


def test_flat_water_is_level():
    sea = Sea(level=-2.0)
    surface = sea.surface(np.arange(3.0), 0.0, 5.0)
    np.testing.assert_array_equal(surface.elevation, -2.0)
    assert not surface.gradient.any()
    assert not surface.hessian.any()
    assert not surface.velocity.any()


def test_a_sea_is_immutable():
    sea = three_waves()
    with pytest.raises(AttributeError):
        sea.level = 1.0
    with pytest.raises(ValueError, match="read-only"):
        sea.components["amplitude"] = 1.0
    with pytest.raises(AttributeError):
        sea.waves[0].amplitude = 1.0


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Sea([Wave(0.2, 2.0), Wave(0.2, 2.0)]), "fold.*1.257.*0.796"),
        (lambda: Wave(-0.1, 2.0), "amplitude is -0.1"),
        (lambda: Wave(0.1, 0.0), "wavelength is 0.0"),
        (lambda: Wave(0.1, 2.0, np.nan), "heading is nan"),
        (lambda: Wave(np.inf, 2.0), "amplitude is inf"),
        (lambda: Sea(density=0.0), "density is 0.0"),
        (lambda: Sea(gravity=-9.81), "gravity is -9.81"),
        (lambda: Sea(level=np.nan), "level is nan"),
    ],
)
def test_refusals(build, message):
    with pytest.raises(ValueError, match=message):
        build()


@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_copies_are_equal_and_immutable(again):
    sea = again(three_waves())
    assert sea == three_waves()
    assert sea.elevation(0.3, 0.2, 1.0) == three_waves().elevation(0.3, 0.2, 1.0)
    for table in (sea.components, sea.water):
        with pytest.raises(ValueError, match="read-only"):
            table[:] = table


def many_waves(**options) -> Sea:
    """An ordinary sea of 200 waves. Their steepnesses add up to 1.6."""
    return Sea.jonswap(4.0, 9.0, waves=200, seed=1, **options)


def test_many_waves_are_judged_by_their_standard_deviation():
    """The worst steepness is the sum for few waves, and seven standard deviations for many. A sea
    that is too steep is refused with the remedy."""
    sea = many_waves()
    assert sea.steepness == pytest.approx(1.61, abs=0.02)
    deviation = np.sqrt(0.5 * sum(w.steepness**2 for w in sea.waves))
    assert sea.worst_steepness == pytest.approx(7.0 * deviation)
    assert 0.5 < sea.worst_steepness < 1.0
    few = three_waves()
    assert few.worst_steepness == few.steepness
    with pytest.raises(ValueError, match="as waves meet and must stay below 1; scale all"):
        Sea([Wave(1.3 * w.amplitude, w.wavelength, w.heading, w.phase) for w in sea.waves])


def test_many_waves_never_fold_at_random_points():
    """At a million seeded points and times the map from labels to positions keeps its orientation,
    and pressure grows downwards."""
    sea, rng = many_waves(), np.random.default_rng(12)
    labels, sums = np.empty(1, LABELS), np.empty(1, SUMS)
    least = np.inf
    for time in rng.uniform(0.0, 1e5, 4):
        for _ in range(1_000_000 // 4 // CHUNK):
            count = set_labels(*rng.uniform(-1e4, 1e4, (2, CHUNK)), labels)
            wave_sums(count, sea.components, time, labels, sums)
            xx, xy, yy = (sums[name][0] for name in ("x_x", "x_y", "y_y"))
            determinant = (1.0 + xx) * (1.0 + yy) - xy * xy
            least = min(least, determinant.min(), (1.0 + xx + yy).min())
    assert least > 0.3  # no sum reaches six standard deviations


def test_the_surface_is_finite_where_all_waves_coincide():
    """Also in a fold, which is assumed never to happen."""
    waves = [Wave(w.amplitude, w.wavelength, w.heading, 0.5 * np.pi) for w in many_waves().waves]
    sea = Sea(waves)
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, 41), np.linspace(-3.0, 3.0, 41))
    heights = sea.elevation(x, y, 0.0)
    assert np.isfinite(heights).all()
    highest = sum(w.amplitude for w in waves)
    assert sea.amplitude < np.abs(heights).max() < highest + MAP_ROUND_OFF
    assert np.isfinite(sea.head(x, y, -1.0, 0.0)).all()
    assert np.isnan(sea.elevation(np.nan, 0.0, 0.0))
