"""Diffraction: the force of the waves that a body scatters, from a panel code's coefficients."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from panel_codes import text_of
from scenes import model

from sim import Buoyancy, Note
from sim.geometry import rotation_about

BOX = """
    <body name="cube">
      <freejoint/>
      <geom name="cube" type="box" size="0.5 0.4 0.3" density="512.5"/>
    </body>"""

WAVES = ((0.03, 9.0, 20.0, 40.0), (0.02, 5.0, 200.0, -70.0), (0.01, 3.0, -75.0, 10.0))
"""Amplitude m, wavelength m, heading deg, phase deg."""

LINEAR = '<text name="buoyancy_method" data="linear"/>'

CURRENT, DEPTH, RAMP, TIME = (0.3, -0.2), 2.0, 40.0, 17.3
ROUND_OFF = 1e-9
"""Of forces up to 1000 N in a sum with buoyancy."""

BAND = np.array([0.8, 1.7, 3.1, 6.0])
ANGLES = np.radians([-150.0, -90.0, -40.0, 10.0, 60.0, 120.0])


def waves_xml(waves=WAVES) -> str:
    rows = (" ".join(map(str, wave)) for wave in waves)
    return "".join(f'<numeric name="wave_{i}" data="{row}"/>' for i, row in enumerate(rows))


def forces(seed: int = 0) -> np.ndarray:
    """Random forces (F, B, 6) of a size of 1000 N/m."""
    rng = np.random.default_rng(seed)
    shape = len(BAND), len(ANGLES), 6
    return 1000.0 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))


def scattered(folder: Path, custom: str, pose: np.ndarray, time: float, **file) -> np.ndarray:
    """The wrench (6,) of diffraction in the world about the centre of mass: the difference between
    the box with forces and without."""
    found = []
    for share in (1.0, 0.0):
        own = dict(frequencies=BAND, headings=ANGLES, diffraction=forces()) | file
        own["diffraction"] = share * own["diffraction"]
        compiled = model(BOX, custom=custom + LINEAR + text_of(folder, "cube", **own))
        data = mujoco.MjData(compiled)
        data.qpos[:], data.time = pose, time
        mujoco.mj_forward(compiled, data)
        found.append(data.xfrc_applied[1].copy())
    return found[0] - found[1]


def pose_of(x: float, y: float, yaw_degrees: float) -> np.ndarray:
    half = np.radians(yaw_degrees) / 2.0
    return np.array([x, y, 0.02, np.cos(half), 0.0, 0.0, np.sin(half)])


def by_hand(x: float, y: float, yaw: float) -> np.ndarray:
    """The sum over WAVES of Re(X a e^(-i omega t)) in the axes of the box, by plain numpy."""
    total, gravity = np.zeros(6), 9.81
    for amplitude, length, heading, phase in WAVES:
        k, heading = 2.0 * np.pi / length, np.radians(heading)
        along = np.array([np.cos(heading), np.sin(heading)])
        omega = np.sqrt(gravity * k * np.tanh(k * DEPTH))
        theta = k * along @ [x, y] - (omega + k * along @ CURRENT) * TIME + np.radians(phase)
        grown = np.polyval([-2.0, 3.0, 0.0, 0.0], TIME / RAMP)
        elevation = -1j * amplitude * grown * np.exp(1j * theta)  # Re: a sin(theta)
        angles = np.concatenate([ANGLES - 2.0 * np.pi, ANGLES, ANGLES + 2.0 * np.pi])
        relative = (heading - yaw + np.pi) % (2.0 * np.pi) - np.pi
        for j in range(6):
            at_heading = [np.interp(relative, angles, np.tile(row, 3)) for row in forces()[:, :, j]]
            total[j] += (np.interp(omega, BAND, at_heading) * elevation).real
    return total


@pytest.mark.parametrize("yaw", [0.0, 37.0, -130.0])
def test_diffraction_is_the_sum_over_the_waves_at_the_hulls_place_and_heading(tmp_path, yaw):
    """With a ramp, a current, and a depth. X belongs to the frequency without the current."""
    x, y, angle = 1.3, -0.7, np.radians(yaw)
    custom = waves_xml() + (
        f'<numeric name="water_current" data="{CURRENT[0]} {CURRENT[1]}"/>'
        f'<numeric name="water_depth" data="{DEPTH}"/><numeric name="water_ramp" data="{RAMP}"/>'
    )
    turn = np.kron(np.eye(2), rotation_about(np.array([0.0, 0.0, angle])))
    found = scattered(tmp_path, custom, pose_of(x, y, yaw), TIME, depth=DEPTH)
    np.testing.assert_allclose(found, turn @ by_hand(x, y, angle), rtol=0.0, atol=ROUND_OFF)
    assert np.abs(found).min() > 0.1


def test_a_rest_frame_off_the_centre_of_mass_shifts_phase_and_torque(tmp_path):
    """The same force with its origin a quarter of a wavelength ahead acts a quarter of a period
    later, with its arm."""
    custom, force = waves_xml([(0.03, 9.0, 0.0, 0.0)]), np.zeros((len(BAND), len(ANGLES), 6))
    force[:, :, 2] = 1000.0
    period = 2.0 * np.pi / np.sqrt(9.81 * 2.0 * np.pi / 9.0)
    pose = pose_of(0.0, 0.0, 0.0)
    here = scattered(tmp_path, custom, pose, TIME, diffraction=force + 0j)
    there = scattered(
        tmp_path, custom, pose, TIME + 0.25 * period,
        diffraction=force + 0j, position=np.array([9.0 / 4.0, 0.0, 0.0]),
    )  # fmt: skip
    np.testing.assert_allclose(there[:3], here[:3], rtol=0.0, atol=ROUND_OFF)
    np.testing.assert_allclose(there[4], -9.0 / 4.0 * here[2], rtol=0.0, atol=ROUND_OFF)


def test_long_waves_are_scattered_as_omega_squared_and_short_ones_not_at_all(tmp_path):
    """An elevation of 0.03 m right above the hull, from waves within and beyond the band."""
    constant = np.full((len(BAND), len(ANGLES), 6), 1000.0 + 0j)
    found = []
    for omega in (BAND[0], BAND[0] / 3.0):
        wave = (0.03, 2.0 * np.pi * 9.81 / omega**2, 20.0, 90.0)
        pose = pose_of(0.0, 0.0, 0.0)
        found.append(scattered(tmp_path, waves_xml([wave]), pose, 0.0, diffraction=constant))
    np.testing.assert_allclose(found[0], 30.0, rtol=1e-12, atol=ROUND_OFF)
    np.testing.assert_allclose(found[1], 30.0 / 9.0, rtol=1e-12, atol=ROUND_OFF)
    short = (0.003, 0.9 * 2.0 * np.pi * 9.81 / BAND[-1] ** 2, 20.0, 90.0)
    both = waves_xml([*WAVES, short])
    with pytest.warns(Note, match="1 of 4 waves, with 0.64 % of the energy, are shorter"):
        alone = scattered(tmp_path, both, pose_of(0.0, 0.0, 0.0), 0.0)
    np.testing.assert_allclose(
        alone, scattered(tmp_path, waves_xml(), pose_of(0.0, 0.0, 0.0), 0.0), atol=1e-6
    )


def test_a_hull_in_the_air_scatters_nothing(tmp_path):
    pose = pose_of(0.0, 0.0, 0.0)
    pose[2] = 5.0
    np.testing.assert_array_equal(scattered(tmp_path, waves_xml(), pose, TIME), np.zeros(6))


def test_a_full_turn_changes_nothing(tmp_path):
    """Also with headings of which the last repeats the first."""
    closed = np.append(ANGLES, ANGLES[0] + 2.0 * np.pi)
    twice = np.concatenate([forces(), forces()[:, :1]], axis=1)
    found = [
        scattered(tmp_path, waves_xml(), pose_of(0.5, 0.2, 100.0 + turn), TIME, **file)
        for turn, file in (
            (0.0, {}), (360.0, {}), (0.0, {"headings": closed, "diffraction": twice}),
        )
    ]  # fmt: skip
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=0.0, atol=ROUND_OFF)


def test_missing_headings_and_diffraction_are_noted(tmp_path):
    half = dict(frequencies=BAND, headings=ANGLES[:3], diffraction=forces()[:, :3])
    with pytest.warns(Note, match="two headings of its hydrodynamics are 250 deg apart"):
        model(BOX, custom=waves_xml() + text_of(tmp_path, "cube", **half))
    with pytest.warns(Note, match="have no diffraction"):
        model(BOX, custom=waves_xml() + text_of(tmp_path, "cube"))


def test_a_model_without_coefficients_has_no_states_of_them():
    compiled = model(BOX, custom=waves_xml())
    assert compiled.npluginstate == 12 + 1
    assert not Buoyancy.of(compiled)._context.responses
