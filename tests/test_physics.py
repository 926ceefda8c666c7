"""Floating bodies in MuJoCo against known drafts, periods, resting tilts and energies."""

import mujoco
import numpy as np
import pytest
from scenes import CUBE, model

from benchmarks.energy import mechanical_energy, potential_energy
from sim import Scene, simulate

G, WATER = 9.81, 1025.0

BOX_DENSITY, BOX_DRAFT = 0.6 * WATER, 0.6 * 0.4
BOX = f"""
    <body name="box"><freejoint/>
      <geom name="box" type="box" size="1 0.5 0.2" density="{BOX_DENSITY}"/></body>"""


def period(states: np.ndarray, timestep: float) -> float:
    """Mean period [s] of an oscillation about 0 from its upward zero crossings, interpolated."""
    before = np.flatnonzero((states[:-1] < 0.0) & (states[1:] >= 0.0))
    crossings = before + states[before] / (states[before] - states[before + 1])
    return float(np.diff(crossings).mean() * timestep)


def measured_period(bodies: str, name: str, start, coordinate, timestep: float) -> float:
    """Period [s] of a coordinate, a function of qpos that is 0 in equilibrium."""
    option = f'<option timestep="{timestep}" integrator="Euler"/>'
    scene = Scene.from_model(model(bodies, (name,), option=option))
    scene.data.qpos[:] = start
    states = [coordinate(scene.data.qpos.copy()) for _ in simulate(scene, 12.0, 1.0 / timestep)]
    return period(np.array(states), timestep)


def roll(qpos: np.ndarray) -> float:
    """Angle [rad] about the long axis."""
    return 2.0 * np.arctan2(qpos[4], qpos[3])


CUBE_HEAVE = 2.0 * np.pi * np.sqrt(0.5 / G)
BOX_HEAVE = 2.0 * np.pi * np.sqrt(BOX_DRAFT / G)
BOX_GM = 1.0 / (12.0 * BOX_DRAFT) + BOX_DRAFT / 2.0 - 0.2
BOX_ROLL = 2.0 * np.pi * np.sqrt((1.0**2 + 0.4**2) / 12.0 / (G * BOX_GM))

PERIODS = {
    "cube heave": (
        1.4185, CUBE_HEAVE, (CUBE, "cube", [0, 0, 0.01, 1, 0, 0, 0], lambda q: q[2]),
    ),
    "box heave": (
        0.983, BOX_HEAVE,
        (BOX, "box", [0, 0, 0.2 - BOX_DRAFT + 0.01, 1, 0, 0, 0], lambda q: q[2] - 0.2 + BOX_DRAFT),
    ),
    "box roll": (
        1.207, BOX_ROLL, (BOX, "box", [0, 0, 0.2 - BOX_DRAFT, 1, 5e-4, 0, 0], roll),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", PERIODS)
def test_periods_of_small_motions(case):
    """Without added mass. Semi-implicit Euler shortens a period by (h omega)^2 / 24."""
    rounded, expected, motion = PERIODS[case]
    assert expected == pytest.approx(rounded, abs=6e-4)
    omega = 2.0 * np.pi / expected
    errors = []
    for timestep in (0.02, 0.01):
        error = measured_period(*motion, timestep) / expected - 1.0
        time_integration = (timestep * omega) ** 2 / 24.0
        assert error == pytest.approx(-time_integration, rel=0.05)
        errors.append(abs(error))
    assert errors[1] < 0.3 * errors[0]


def test_a_cube_of_half_the_waters_density_floats_half_submerged():
    scene = Scene.from_model(
        model(
            CUBE.replace("<freejoint/>", '<joint type="free" damping="2000"/>'),
            option='<option timestep="0.01"/>',
        )
    )
    scene.data.qpos[2] = 0.3
    *_, last = simulate(scene, 20.0)
    assert last.positions[0, 2] == pytest.approx(0.0, abs=1e-9)  # the draft is 0.5 m
    assert last.submerged_fractions[0] == pytest.approx(0.5, abs=1e-9)


BAR = """
    <body name="bar">
      <joint type="slide" axis="0 0 1" damping="3000"/>
      <joint type="hinge" axis="1 0 0" damping="300"/>
      <geom name="bar" type="box" size="1 0.5 0.5" density="{}"/></body>"""


@pytest.mark.parametrize(
    ("relative_density", "rest"), [(0.5, 45.0), (0.75, np.degrees(np.arctan(0.5))), (0.9, 0.0)]
)
def test_a_square_bar_settles_at_its_known_tilt(relative_density, rest):
    """Stable tilts of a long square bar that rotates about one axis (Gilbert 1991)."""
    bar = BAR.format(relative_density * WATER)
    scene = Scene.from_model(model(bar, ("bar",), option='<option timestep="0.01"/>'))
    scene.data.qpos[:] = [0.5 - relative_density, np.radians(15.0)]
    *_, last = simulate(scene, 120.0, rate=1.0)
    still_rocking_deg = 1e-3
    assert np.degrees(scene.data.qpos[1]) == pytest.approx(rest, abs=still_rocking_deg)
    assert np.degrees(last.tilts[0]) == pytest.approx(rest, abs=still_rocking_deg)
    assert abs(scene.data.qvel).max() < 1e-5


def test_the_energy_of_the_water_is_that_of_its_displaced_volume():
    """An upright box at a draught d has lifted the water by d / 2, so the energy is
    rho g A d^2 / 2. A cube with only an edge submerged displaces a triangle."""
    box = Scene.from_model(model(BOX, ("box",), option='<option timestep="0.002"/>'))
    weight = BOX_DENSITY * 0.8 * G
    for draught in (0.05, 0.24, 0.39):
        box.data.qpos[2] = 0.2 - draught
        mujoco.mj_forward(box.model, box.data)
        expected = weight * (0.2 - draught) + WATER * G * 2.0 * draught**2 / 2.0
        assert potential_energy(box) == pytest.approx(expected, rel=1e-12)
    bar = Scene.from_model(model(CUBE))
    bar.data.qpos[2:5] = [np.sqrt(0.5) - 0.3, np.cos(np.pi / 8), np.sin(np.pi / 8)]
    mujoco.mj_forward(bar.model, bar.data)
    expected = 512.5 * G * bar.data.qpos[2] + WATER * G * 0.3**3 / 3.0  # a width of 2 d at depth d
    assert potential_energy(bar) == pytest.approx(expected, rel=1e-9)


def energy_drift(integrator: str, timestep: float) -> float:
    """Largest change of energy [J] over 5 s of a tilted box dropped into flat water."""
    option = f'<option timestep="{timestep}" integrator="{integrator}"/>'
    scene = Scene.from_model(model(BOX, ("box",), option=option))
    scene.data.qpos[:] = [0, 0, 0.3, np.cos(0.3), np.sin(0.3), 0, 0]
    energies = [mechanical_energy(scene) for _ in simulate(scene, 5.0, rate=20.0)]
    return float(np.abs(np.array(energies) - energies[0]).max())


@pytest.mark.parametrize(("integrator", "order"), [("RK4", 2.0), ("Euler", 0.8)])
def test_flat_water_conserves_energy_up_to_the_integrators_error(integrator, order):
    """The drift of energy falls with the timestep. RK4 does not reach its fourth order, because the
    force has kinks where edges meet the water."""
    coarse, fine = energy_drift(integrator, 0.01), energy_drift(integrator, 0.0025)
    weight = BOX_DENSITY * 0.8 * G
    assert coarse < 0.05 * weight
    assert np.log2(coarse / fine) / 2.0 > order
