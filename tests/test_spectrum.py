"""The JONSWAP spectrum and seas that have its energy."""

import numpy as np
import pytest
from scenes import model

from independent import ROUND_OFF
from sim import Buoyancy, Sea
from sim.spectrum import density, equal_energy_frequencies, equal_share_angles

HEIGHT, PERIOD = 0.5, 4.0
OMEGA = np.linspace(0.3, 40.0, 200_001) * 2.0 * np.pi / PERIOD

QUADRATURE = 1e-4
"""Relative error of sums over a table of frequencies, ends included."""


@pytest.mark.parametrize("gamma", [1.0, 3.3, 7.0])
def test_moments_and_peak_of_the_spectrum(gamma):
    spectrum = density(OMEGA, HEIGHT, PERIOD, gamma)
    assert np.trapezoid(spectrum, OMEGA) == pytest.approx(HEIGHT**2 / 16.0, rel=QUADRATURE)
    assert OMEGA[spectrum.argmax()] == pytest.approx(2.0 * np.pi / PERIOD, rel=1e-3)


def test_without_enhancement_it_is_pierson_moskowitzs_closed_form():
    peak = 2.0 * np.pi / PERIOD
    closed = 5.0 / 16.0 * HEIGHT**2 * peak**4 * OMEGA**-5 * np.exp(-1.25 * (OMEGA / peak) ** -4)
    found = density(OMEGA, HEIGHT, PERIOD, 1.0)
    np.testing.assert_allclose(found, closed, rtol=QUADRATURE, atol=1e-12)


@pytest.mark.parametrize("gamma", [2.0, 3.3, 5.0])
def test_the_usual_fit_of_the_normalisation_is_close(gamma):
    """DNV-RP-C205: S at gamma = S of Pierson and Moskowitz (1 - 0.287 ln gamma) gamma^..."""
    peak = 2.0 * np.pi / PERIOD
    ratio = density(peak, HEIGHT, PERIOD, gamma) / density(peak, HEIGHT, PERIOD, 1.0)
    fit = 0.02  # its own error
    assert ratio == pytest.approx((1.0 - 0.287 * np.log(gamma)) * gamma, rel=fit)


@pytest.mark.parametrize("count", [1, 7, 40])
def test_each_wave_stands_for_a_band_of_equal_energy(count):
    """Below the i-th frequency lie (i + 1/2) / N of the energy."""
    for i, omega in enumerate(equal_energy_frequencies(PERIOD, 3.3, count)):
        below = np.linspace(1e-3, omega, 100_001)
        share = np.trapezoid(density(below, 1.0, PERIOD, 3.3), below) * 16.0
        assert share == pytest.approx((i + 0.5) / count, abs=QUADRATURE)


def test_energy_of_a_sea_is_the_spectrums():
    sea = Sea.jonswap(HEIGHT, PERIOD)
    m0 = sum(0.5 * wave.amplitude**2 for wave in sea.waves)
    assert m0 == pytest.approx(HEIGHT**2 / 16.0, rel=ROUND_OFF)
    assert sea.significant_height == pytest.approx(HEIGHT, rel=ROUND_OFF)
    omega = np.sqrt(9.81 * np.array([wave.wavenumber for wave in sea.waves]))
    np.testing.assert_allclose(np.sort(omega), equal_energy_frequencies(PERIOD, 3.3, 40))


def test_significant_height_of_a_long_record():
    """Four standard deviations of the elevation over an hour at places far apart; what is
    left is the scatter of a finite record."""
    sea = Sea.jonswap(HEIGHT, 6.0, seed=4)
    x = 1000.0 * np.arange(20.0)
    record = np.stack([sea.elevation(x, 0.0, time) for time in np.arange(0.0, 3600.0, 2.7)])
    # Crests are sharper than troughs, so between the particles the mean lies below the level.
    assert abs(record.mean()) < 0.05 * HEIGHT
    assert 4.0 * record.std() == pytest.approx(HEIGHT, rel=0.03)


@pytest.mark.parametrize("waves", [20, 40])
def test_record_does_not_repeat_early(waves):
    """The elevation's autocorrelation, sum of a^2 cos(omega tau), once it has decayed stays away
    from 1 for an hour: such a record never looks like what has been."""
    sea = Sea.jonswap(HEIGHT, PERIOD, waves=waves)
    omega = np.sqrt(9.81 * np.array([wave.wavenumber for wave in sea.waves]))
    lags = np.arange(10.0 * PERIOD, 3600.0, 0.1)
    correlation = np.cos(lags[:, None] * omega).mean(axis=1)
    assert correlation.max() < 0.8
    evenly = np.linspace(omega.min(), omega.max(), waves)  # what would repeat
    assert np.cos(lags[:, None] * evenly).mean(axis=1).max() > 0.99


@pytest.mark.parametrize("spread", [0.2, 0.436, 0.8])
def test_headings_spread_as_asked(spread):
    angles = equal_share_angles(spread, 2000)
    assert angles.mean() == pytest.approx(0.0, abs=1e-3)
    # sqrt(2 / (1 + q)) is the width in the circular sense: 2 (1 - |mean of exp(i angle)|).
    width = np.sqrt(2.0 * (1.0 - np.abs(np.exp(1j * angles).mean())))
    assert width == pytest.approx(spread, rel=0.01)
    headings = [
        wave.heading for wave in Sea.jonswap(HEIGHT, PERIOD, heading=1.0, spread=spread).waves
    ]
    assert np.mean(headings) == pytest.approx(1.0, abs=1e-3)


def test_long_crests_head_one_way_and_seeds_differ():
    sea = Sea.jonswap(HEIGHT, PERIOD, heading=0.3, spread=0.0)
    assert {wave.heading for wave in sea.waves} == {0.3}
    assert sea == Sea.jonswap(HEIGHT, PERIOD, heading=0.3, spread=0.0)
    assert sea != Sea.jonswap(HEIGHT, PERIOD, heading=0.3, spread=0.0, seed=1)


def test_advice_on_folding_helps():
    with pytest.raises(ValueError, match=r"JONSWAP sea fold.*k a over 40 waves") as error:
        Sea.jonswap(2.0, PERIOD)
    words = str(error.value).replace(",", "").split()
    height = float(words[words.index("height") + 2])
    period = float(words[words.index("period") + 2])
    fewer = int(words[words.index("some") + 1])
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
    return Buoyancy.from_model(model(custom=f'<numeric name="sea_jonswap" data="{data}"/>')).sea


def test_custom_numeric_has_the_same_numbers_in_the_same_order():
    assert sea_of("0.5 4") == Sea.jonswap(0.5, 4.0)
    every = Sea.jonswap(0.5, 4.0, 2.0, np.radians(30.0), np.radians(10.0), 25, 7)
    assert sea_of("0.5 4 2 30 10 25 7") == every


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("0.5", "'sea_jonswap' has 1 number; expected 2 to 7: significant height m, peak"),
        ("0.5 4 3.3 0 25 40 0 1", "'sea_jonswap' has 8 numbers"),
        ("2 4", "custom numeric 'sea_jonswap': the waves of this JONSWAP sea fold"),
        ("0.5 4 3.3 0 25 2.5", "custom numeric 'sea_jonswap': the number of waves is 2.5"),
    ],
)
def test_unusable_custom_numerics(data, message):
    with pytest.raises(ValueError, match=message):
        sea_of(data)


def test_a_misspelt_sea_is_refused():
    with pytest.raises(ValueError, match=r"numeric 'sea_jonsvap' is unknown.*sea_jonswap"):
        Buoyancy.from_model(model(custom='<numeric name="sea_jonsvap" data="1 5"/>'))
