"""The JONSWAP spectrum and seas with its energy."""

import numpy as np
import pytest
from scenes import model

from independent import ROUND_OFF
from sim import Buoyancy, Sea
from sim.water.spectrum import equal_energy_frequencies, equal_share_angles

HEIGHT, PERIOD = 0.5, 4.0
OMEGA = np.linspace(0.3, 40.0, 200_001) * 2.0 * np.pi / PERIOD

QUADRATURE = 1e-4
"""Relative error of sums over a table of frequencies, including its ends."""


def density(omega, gamma: float) -> np.ndarray:
    """The variance density of JONSWAP at PERIOD as in DNV-RP-C205, without its constant factor."""
    x = np.asarray(omega) * PERIOD / (2.0 * np.pi)
    width = np.where(x <= 1.0, 0.07, 0.09)
    return x**-5.0 * np.exp(-1.25 * x**-4.0) * gamma ** np.exp(-0.5 * ((x - 1.0) / width) ** 2)


def frequencies_of(gamma: float, count: int) -> np.ndarray:
    return equal_energy_frequencies(OMEGA, density(OMEGA, gamma), count)


@pytest.mark.parametrize("gamma", [1.0, 3.3, 7.0])
@pytest.mark.parametrize("count", [1, 7, 40])
def test_each_wave_stands_for_a_band_of_equal_energy(count, gamma):
    """A share (i + 1/2) / N of the energy is below the i-th frequency."""
    total = np.trapezoid(density(OMEGA, gamma), OMEGA)
    for i, omega in enumerate(frequencies_of(gamma, count)):
        below = np.linspace(1e-3, omega, 100_001)
        share = np.trapezoid(density(below, gamma), below) / total
        assert share == pytest.approx((i + 0.5) / count, abs=QUADRATURE)


def test_without_enhancement_bands_match_pierson_and_moskowitz():
    """The share of energy below x peak frequencies is exp(-5/4 x^-4)."""
    shares = (np.arange(40) + 0.5) / 40
    expected = 2.0 * np.pi / PERIOD * (-0.8 * np.log(shares)) ** -0.25
    found = frequencies_of(1.0, 40)
    np.testing.assert_allclose(found, expected, rtol=QUADRATURE)


def test_enhancement_concentrates_waves_at_the_peak():
    peak = 2.0 * np.pi / PERIOD
    near = [
        np.count_nonzero(np.abs(frequencies_of(gamma, 400) / peak - 1.0) < 0.05)
        for gamma in (1.0, 3.3, 7.0)
    ]
    assert near == sorted(near)
    assert near[2] > 2 * near[0]


def test_the_energy_of_a_sea_matches_the_spectrum():
    sea = Sea.jonswap(HEIGHT, PERIOD)
    m0 = sum(0.5 * wave.amplitude**2 for wave in sea.waves)
    assert m0 == pytest.approx(HEIGHT**2 / 16.0, rel=ROUND_OFF)
    assert sea.significant_height == pytest.approx(HEIGHT, rel=ROUND_OFF)
    omega = np.sqrt(9.81 * np.array([wave.wavenumber for wave in sea.waves]))
    np.testing.assert_allclose(np.sort(omega), frequencies_of(3.3, 40), rtol=1e-4)


def test_headings_do_not_depend_on_wavelength():
    """Headings are drawn at random and do not depend on the wavelength."""
    for seed in range(4):
        waves = Sea.jonswap(HEIGHT, PERIOD, seed=seed).waves
        order = np.argsort([w.wavelength for w in waves])
        correlation = np.corrcoef(np.arange(40), np.array([w.heading for w in waves])[order])[0, 1]
        assert abs(correlation) < 0.5  # one in a thousand draws of forty is above


def test_the_significant_height_of_a_long_record():
    """Four standard deviations of the elevation over an hour at distant points."""
    sea = Sea.jonswap(HEIGHT, 6.0, seed=4)
    x = 1000.0 * np.arange(20.0)
    record = np.stack([sea.elevation(x, 0.0, time) for time in np.arange(0.0, 3600.0, 2.7)])
    # Crests are sharper than troughs, so the mean elevation is below the level of the particles.
    assert abs(record.mean()) < 0.05 * HEIGHT
    finite_record = 0.03
    assert 4.0 * record.std() == pytest.approx(HEIGHT, rel=finite_record)


@pytest.mark.parametrize("waves", [20, 40])
def test_records_do_not_repeat_early(waves):
    """Once it has decayed, the autocorrelation of the elevation, the mean of cos(omega tau), stays
    away from 1 for an hour."""
    sea = Sea.jonswap(HEIGHT, PERIOD, waves=waves)
    omega = np.sqrt(9.81 * np.array([wave.wavenumber for wave in sea.waves]))
    lags = np.arange(10.0 * PERIOD, 3600.0, 0.1)
    correlation = np.cos(lags[:, None] * omega).mean(axis=1)
    assert correlation.max() < 0.8
    evenly = np.linspace(omega.min(), omega.max(), waves)  # such a record would repeat
    assert np.cos(lags[:, None] * evenly).mean(axis=1).max() > 0.99


@pytest.mark.parametrize("spread", [1e-4, 0.2, 0.436, 0.8])
def test_headings_have_the_given_spread(spread):
    angles = equal_share_angles(spread, 2000)
    assert angles.mean() == pytest.approx(0.0, abs=1e-3)
    # The circular width sqrt(2 (1 - |mean of exp(i angle)|)) equals sqrt(2 / (1 + q)).
    width = np.sqrt(2.0 * (1.0 - np.abs(np.exp(1j * angles).mean())))
    assert width == pytest.approx(spread, rel=0.01)
    headings = [
        wave.heading for wave in Sea.jonswap(HEIGHT, PERIOD, heading=1.0, spread=spread).waves
    ]
    assert np.mean(headings) == pytest.approx(1.0, abs=1e-3)


def test_long_crests_have_one_heading_and_seeds_differ():
    sea = Sea.jonswap(HEIGHT, PERIOD, heading=0.3, spread=0.0)
    assert sea == Sea.jonswap(HEIGHT, PERIOD, heading=0.3, spread=1e-300)
    assert {wave.heading for wave in sea.waves} == {0.3}
    assert sea == Sea.jonswap(HEIGHT, PERIOD, heading=0.3, spread=0.0)
    assert sea != Sea.jonswap(HEIGHT, PERIOD, heading=0.3, spread=0.0, seed=1)


def test_the_remedy_for_folding_works():
    with pytest.raises(ValueError, match=r"waves of this sea fold.*k a over 40 waves") as error:
        Sea.jonswap(2.0, PERIOD)
    words = str(error.value).replace(",", "").split()
    height = float(words[words.index("height") + 2])
    period = PERIOD * float(words[words.index("times") - 1])
    fewer = int(words[words.index("about") + 1])
    Sea.jonswap(0.99 * height, PERIOD)
    Sea.jonswap(2.0, 1.01 * period)
    Sea.jonswap(2.0, PERIOD, waves=fewer)


REFUSALS = [
    (dict(significant_height=0.0), "significant height is 0.0 m"),
    (dict(peak_period=np.nan), "peak period is nan s"),
    (dict(gamma=0.5), "gamma is 0.5"),
    (dict(heading=np.inf), "heading is inf"),
    (dict(spread=2.0), "spread of the headings is 114.592 degrees.*below 81"),
    (dict(waves=2.5), "number of waves is 2.5"),
    (dict(waves=0), "number of waves is 0"),
    (dict(seed=-1), "seed is -1"),
]


@pytest.mark.parametrize(("numbers", "message"), REFUSALS)
def test_refusals(numbers, message):
    with pytest.raises(ValueError, match=message):
        Sea.jonswap(**(dict(significant_height=HEIGHT, peak_period=PERIOD) | numbers))


def sea_of(data: str) -> Sea:
    return Buoyancy.of(model(custom=f'<numeric name="sea_jonswap" data="{data}"/>')).sea


def test_the_custom_numeric_has_the_numbers_of_the_function():
    assert sea_of("0.5 4") == Sea.jonswap(0.5, 4.0)
    every = Sea.jonswap(0.5, 4.0, 2.0, np.radians(30.0), np.radians(10.0), 25, 7)
    assert sea_of("0.5 4 2 30 10 25 7") == every


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("0.5", "'sea_jonswap' has 1 number; expected 2 to 7: significant height m, peak"),
        ("0.5 4 3.3 0 25 40 0 1", "'sea_jonswap' has 8 numbers"),
        ("2 4", "custom numeric 'sea_jonswap': the waves of this sea fold"),
        ("0.5 4 3.3 0 25 2.5", "custom numeric 'sea_jonswap': the number of waves is 2.5"),
    ],
)
def test_impossible_custom_numerics_are_refused(data, message):
    with pytest.raises(ValueError, match=message):
        sea_of(data)


def test_a_misspelt_sea_is_refused():
    with pytest.raises(ValueError, match=r"numeric 'sea_jonsvap' is unknown.*sea_jonswap"):
        Buoyancy.of(model(custom='<numeric name="sea_jonsvap" data="1 5"/>'))
