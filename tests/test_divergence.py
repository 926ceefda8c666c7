"""Divergence: what is noticed, which cause is named, and what is no divergence."""

import mujoco
import numpy as np
import pytest
from scenes import CUBE, WAVES, model

from independent import MODELS
from sim import DivergenceError, ModelError, Scene, simulate
from sim.runs.watch import energies

BALL = """
    <body name="ball" pos="0 0 {z}"><freejoint/>
      <geom name="ball" type="sphere" size="0.1" density="{density}"/></body>"""


@pytest.fixture(autouse=True)
def _quiet_mujoco(tmp_path, monkeypatch):
    """MuJoCo writes its warnings to a log file in the current folder."""
    monkeypatch.chdir(tmp_path)


def ball(density: float, timestep: float, z: float = 0.05, custom: str = "") -> Scene:
    option = f'<option timestep="{timestep}"/>'
    body = BALL.format(density=density, z=z)
    return Scene.from_model(model(body, ("ball",), custom, option=option))


def broken(scene: Scene) -> str:
    """The message after a position becomes NaN half way."""
    samples = simulate(scene, 1.0, 100.0)
    next(samples)
    next(samples)
    scene.data.qpos[0] = np.nan
    with pytest.raises(DivergenceError) as caught:
        next(samples)
    return str(caught.value)


def test_a_ball_too_light_for_its_timestep_is_stopped_with_its_h_omega():
    """All its numbers are finite and MuJoCo has no warning; what is wrong is its energy."""
    scene = ball(density=0.5, timestep=0.02)
    with pytest.raises(DivergenceError, match="energy cannot be explained") as caught:
        list(simulate(scene, 60.0))
    assert caught.value.body == "ball"
    assert np.isfinite(scene.data.qpos).all()
    assert not scene.data.warning.number.any()
    area, mass = np.pi * 0.01, scene.model.body_mass[1]
    h_omega = 0.02 * np.sqrt(1025.0 * 9.81 * area / mass)
    message = str(caught.value)
    assert "timestep of 0.02 s is too long for its heave" in message
    stated = float(message.split("h omega = ")[1].split(",")[0])
    assert stated == pytest.approx(h_omega, rel=0.01)
    advised = float(message.split("timestep below ")[1].split(" ")[0])
    *_, last = simulate(ball(0.5, advised), 20.0)
    assert last.time == pytest.approx(20.0, abs=advised)


def test_a_legacy_inertia_is_recognised():
    messages = {}
    for kind in ("exact", "legacy"):
        body = '<body><freejoint/><geom name="b" type="mesh" mesh="m" density="500"/></body>'
        assets = f'<mesh name="m" file="{MODELS / "meshes" / "bunny.obj"}" inertia="{kind}"/>'
        messages[kind] = broken(Scene.from_model(model(body, ("b",), assets=assets)))
    assert "legacy one, for 8." in messages["legacy"]
    assert 'set inertia="exact"' in messages["legacy"]
    assert "legacy" not in messages["exact"]
    assert "try a timestep below 0.005" in messages["exact"]


def test_a_mass_that_cannot_float_is_named():
    message = broken(ball(density=2050.0, timestep=0.005))
    assert "cannot float: it has 8.587 kg and displaces at most 4.294 kg" in message


def test_an_overlapping_start_is_named():
    crate = CUBE.replace('"cube"', '"crate"').replace("0 0 0", "0.7 0 0")
    message = broken(Scene.from_model(model(CUBE + crate, ("cube", "crate"))))
    assert "geoms 'cube' and 'crate' overlap by 0.3 m at the start: move them apart" in message


NO_DIVERGENCE = {
    "a light ball released deep down": lambda: ball(10.25, 0.002, z=-20.0),
    "a stone that sinks": lambda: ball(8000.0, 0.005),
    "a fall from 200 m": lambda: ball(500.0, 0.002, z=200.0),
    "waves about to break": lambda: ball(
        500.0,
        0.002,
        custom='<numeric name="wave_a" data="0.6 4 0 0"/>'
        '<text name="buoyancy_method" data="linear"/>',  # whatever the method
    ),
    "a long ocean swell": lambda: ball(
        500.0, 0.002, custom='<numeric name="wave_a" data="5 400 0 0"/>'
    ),
}


@pytest.mark.parametrize("case", NO_DIVERGENCE)
def test_lively_motion_is_no_divergence(case):
    samples = list(simulate(NO_DIVERGENCE[case](), 8.0))
    assert samples[-1].time == pytest.approx(8.0, abs=0.01)


def test_energy_given_by_the_caller_is_accepted():
    """Kicks between samples, forces of one's own, actuators: all beyond what waves explain."""
    scene = Scene.from_model(model(custom=WAVES))
    for sample in simulate(scene, 2.0, rate=10.0):
        if sample.step == 100:
            scene.data.qvel[2] = 500.0
    assert scene.data.qpos[2] > 300.0
    pushed = Scene.from_model(model(custom=WAVES))
    pushed.data.qfrc_applied[0] = 1e6
    *_, last = simulate(pushed, 2.0)
    assert last.positions[0, 0] > 1000.0


def test_the_energy_watched_is_conserved_in_flat_water():
    """Of a ball released at 5 m depth: to time integration under water and above it, and within a
    quarter of the displaced water's weight times the length while it passes the surface."""
    scene = ball(102.5, 0.0002, z=-5.0)
    weight = scene.model.body_mass[1] / 0.1 * 9.81
    totals, heights = [], []
    for sample in simulate(scene, 2.0, rate=500.0):
        totals.append(energies(scene).sum())
        heights.append(sample.positions[0, 2])
    change = (np.array(totals) - totals[0]) / weight
    clear = np.abs(heights) > 0.101
    assert change[0] == 0.0
    assert totals[0] / weight == pytest.approx(5.0 - 0.5)  # up against the water, down the weight
    assert np.abs(change[clear]).max() < 0.02
    assert np.abs(change).max() < 0.25 * 0.2


def test_a_wind_of_ones_own_is_no_divergence():
    """A force from the user's own passive callback, beyond what waves explain."""
    scene = Scene.from_model(model(custom=WAVES))

    def wind(compiled, data) -> None:
        data.qfrc_passive[0] += 1e6

    mujoco.set_mjcb_passive(wind)
    try:
        *_, last = simulate(scene, 2.0)
    finally:
        mujoco.set_mjcb_passive(None)
    assert last.positions[0, 0] > 1000.0


def test_the_watch_can_be_switched_off():
    scene = ball(density=0.5, timestep=0.02)
    *_, last = simulate(scene, 5.0, watch=False)
    assert last.time == pytest.approx(5.0)
    with pytest.raises(DivergenceError):
        list(simulate(ball(density=0.5, timestep=0.02), 60.0))


LIGHT = """
    <body name="ball" pos="0 0 -1" {}><freejoint/>
      <geom name="ball" type="sphere" size="{}" density="500"/></body>"""


@pytest.mark.parametrize(
    ("body", "option", "message"),
    [
        (LIGHT.format('gravcomp="1"', 0.1), "", "gravcomp takes 1 of its weight away"),
        (LIGHT.format("", 1500.0), "", "e+03 m long: if its mesh is in other units"),
    ],
)
def test_more_causes_are_named(body, option, message):
    option = f'<option timestep="0.002">{option}</option>'
    assert message in broken(Scene.from_model(model(body, ("ball",), option=option)))


def test_gravity_that_is_switched_off_later_is_refused():
    scene = Scene.from_model(model(LIGHT.format("", 0.1), ("ball",)))
    scene.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    with pytest.raises(ModelError, match="option flag gravity is disabled"):
        simulate(scene, 1.0)


SHIP = """
    <body name="ship" pos="30 0 {z}"><freejoint/>
      <geom name="ship" type="box" size="10 3 1.5" density="400"/></body>"""


def time_of_divergence(scene: Scene) -> float:
    with pytest.raises(DivergenceError) as caught:
        list(simulate(scene, 60.0))
    assert caught.value.body == "ball"
    return caught.value.time


def test_a_small_body_that_diverges_is_noticed_beside_a_large_one():
    """At the same instant as alone, whatever the ship's energy is."""
    option = '<option timestep="0.02"/>'
    light = BALL.format(z=0.05, density=0.5)
    ship = SHIP.format(z=-0.15)
    alone = model(light, ("ball",), option=option)
    beside = model(light + ship, ("ball", "ship"), option=option)
    noticed = [time_of_divergence(Scene.from_model(m)) for m in (alone, beside)]
    assert noticed[0] == noticed[1]


def test_a_body_may_have_its_energy_from_one_that_it_touched():
    """A ship falls on one end of a plank, for less than the time between two samples; a ball on the
    other flies."""
    plank = """
        <body name="plank" pos="0 0 20"><joint axis="0 1 0"/>
          <geom type="box" size="2 0.2 0.05" mass="1"/></body>
        <body name="ball" pos="1.8 0 20.14"><freejoint/>
          <geom name="ball" type="sphere" size="0.08" mass="0.05"/></body>
        <body name="ship" pos="-1.8 0 22"><freejoint/>
          <geom name="ship" type="box" size="0.2 0.2 0.2" mass="30"/></body>"""
    scene = Scene.from_model(model(plank, ("ball", "ship"), option='<option timestep="0.001"/>'))
    heights = [s.positions[0, 2] for s in simulate(scene, 3.0, rate=2.0)]
    assert max(heights) > 24.0  # of itself it could have fallen only


def driven(density: float, timestep: float) -> Scene:
    body = BALL.format(z=0.05, density=density).replace("</body>", '<site name="screw"/></body>')
    screw = '<actuator><general site="screw" gear="1 0 0 0 0 0"/></actuator>'
    option = f'<option timestep="{timestep}"/>'
    return Scene.from_model(model(body, ("ball",), extra=screw, option=option))


def test_what_actuators_do_is_counted_and_no_divergence():
    scene = driven(500.0, 0.005)
    scene.data.ctrl[:] = 40.0
    start = energies(scene).sum()
    *_, last = simulate(scene, 20.0)
    assert last.positions[0, 0] > 500.0
    gained = energies(scene).sum() - start  # far beyond what waves give
    assert gained == pytest.approx(40.0 * last.positions[0, 0], rel=0.01)


def test_a_scene_with_actuators_is_watched_too():
    """A screw that runs explains nothing of what throws a ball that is too light."""
    scene = driven(0.5, 0.02)
    scene.data.ctrl[:] = 1e-3
    with pytest.raises(DivergenceError, match="too long for its heave"):
        list(simulate(scene, 60.0))


def test_springs_are_counted_and_no_divergence():
    """A float shot out of the water by a spring of a hundred times its own energy."""
    body = """
        <body name="shot" pos="0 0 0"><joint type="slide" axis="0 0 1" stiffness="2000"
          springref="{}"/><geom name="shot" type="sphere" size="0.1" density="500"/></body>"""
    quiet, lively = (
        Scene.from_model(model(body.format(ref), ("shot",), option='<option timestep="0.001"/>'))
        for ref in (0.0, 10.0)
    )
    *_, last = simulate(lively, 3.0)
    assert np.abs(last.positions).max() > 1.0
    start = energies(Scene.from_model(lively.model)).sum()
    assert start - energies(quiet).sum() == pytest.approx(0.5 * 2000.0 * 10.0**2, rel=0.01)
    assert energies(lively).sum() == pytest.approx(start, rel=0.01)


def test_a_float_that_rises_by_gravity_compensation_is_no_divergence():
    scene = Scene.from_model(model(LIGHT.format('gravcomp="1"', 0.1), ("ball",)))
    *_, last = simulate(scene, 30.0)
    assert last.positions[0, 2] > 50.0
