"""Divergence: timesteps that are too long, runs that are stopped, and runs that are not."""

import warnings

import mujoco
import numpy as np
import pytest
from scenes import CUBE, WAVES, model

from sim import DivergenceError, ModelError, Note, Scene, hydrostatics, simulate
from sim.runs.divergence import Watch
from sim.scenes.timestep import SAFE_SWING_SHARE

RADIUS = 0.1
SAFE_PHASE = 1.5
"""Largest timestep * omega [rad] at which MuJoCo's semi-implicit integrators are safe."""

BALL = """
    <body name="ball" pos="0 0 {z}">{joint}
      <geom name="ball" type="sphere" size="0.1" density="{density}"/><site name="screw"/></body>"""

SHIP = """
    <body name="ship" pos="30 0 -0.15"><freejoint/>
      <geom name="ship" type="box" size="10 3 1.5" density="400"/></body>"""

SCREW = '<actuator><general site="screw" gear="1 0 0 0 0 0"/></actuator>'

SLIDE = '<joint type="slide" axis="0 0 1"/>'

ARM = """
    <body name="barge"><freejoint/><geom name="barge" type="box" size="1 1 0.2" density="300"/>
      <body name="arm" pos="1 0 0"><joint axis="0 1 0"/>
        <geom name="arm" type="sphere" pos="0.3 0 0" size="0.1" density="0.5"/></body></body>"""

SPINDLE = """
    <body name="box" euler="5 3 0"><freejoint/>
      <inertial pos="0 0 0" mass="50" diaginertia="1e-4 1e-4 1e-4"/>
      <geom name="box" type="box" size="0.5 0.25 0.1"/></body>"""


@pytest.fixture(autouse=True)
def _quiet_mujoco(tmp_path, monkeypatch):
    """MuJoCo writes its log file to the current folder."""
    monkeypatch.chdir(tmp_path)


def compiled(bodies: str, floats: tuple[str, ...], timestep: float, integrator="Euler", **more):
    option = f'<option timestep="{timestep}" integrator="{integrator}"/>'
    return model(bodies, floats, option=option, **more)


def ball(density: float, timestep: float, z=0.05, joint="<freejoint/>", **more) -> mujoco.MjModel:
    return compiled(BALL.format(z=z, joint=joint, density=density), ("ball",), timestep, **more)


def omega(density: float) -> float:
    """Angular frequency [rad/s] of the heave of a half-submerged ball."""
    mass = density * 4.0 / 3.0 * np.pi * RADIUS**3
    return float(np.sqrt(1025.0 * 9.81 * np.pi * RADIUS**2 / mass))


def notes_of(loaded: mujoco.MjModel) -> list[str]:
    """The notes on the timestep of a scene."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Scene.from_model(loaded)
    return [str(w.message) for w in caught if "timestep" in str(w.message)]


def test_a_ball_too_light_for_its_timestep_is_noted_and_stopped():
    """All numbers stay finite and MuJoCo does not warn; only the ball's energy is wrong."""
    with pytest.warns(Note, match=r"'ball': a timestep of 0\.02 s is too long") as notes:
        scene = Scene.from_model(ball(0.5, 0.02))
    with pytest.raises(DivergenceError, match="its energy would take it") as caught:
        list(simulate(scene, 60.0))
    assert caught.value.body == "ball"
    assert np.isfinite(scene.data.qpos).all()
    assert not scene.data.warning.number.any()
    remedy = "too long for its fastest motion on the water, with a period of 0.016 s; use 0.002 s"
    assert any(remedy in str(note.message) for note in notes)
    assert remedy in str(caught.value)
    assert notes_of(ball(0.5, 0.002)) == []
    heights = [s.positions[0, 2] for s in simulate(Scene.from_model(ball(0.5, 0.002)), 20.0)]
    released_half_submerged = 6.5  # m
    assert max(heights) < released_half_submerged


@pytest.mark.parametrize(
    ("integrator", "safe"), [("implicitfast", SAFE_PHASE), ("RK4", 1.414 * SAFE_PHASE)]
)
@pytest.mark.parametrize("joint", ["<freejoint/>", SLIDE])
def test_timesteps_are_noted_above_the_safe_phase(integrator, safe, joint):
    triangles_of_the_sphere = 0.02
    for factor, is_noted in ((1.0 - triangles_of_the_sphere, False), (1.02, True)):
        timestep = factor * safe / omega(10.0)
        loaded = ball(10.0, timestep, integrator=integrator, joint=joint)
        assert len(notes_of(loaded)) == is_noted


ADDED = '<numeric name="added_mass" data="{0} {0} {0} 0 0 0"/>'


@pytest.mark.parametrize(
    ("density", "custom", "slower"),
    [
        (10.0, ADDED.format(5), np.sqrt(1.0 + 5.0)),  # of the volume submerged at rest
        (1000.0, ADDED.format(5), np.sqrt(1.0 + 0.5 * 5.0 * 1.025)),  # of half the hull
        (10.0, '<numeric name="displaced_ball" data="0.25"/>', 2.0),
    ],
)
def test_slower_motion_allows_longer_timesteps(density, custom, slower):
    for factor, is_noted in ((0.98, False), (1.02, True)):
        loaded = ball(density, factor * slower * SAFE_PHASE / omega(density), custom=custom)
        assert len(notes_of(loaded)) == is_noted


PLANK = """
    <body name="plank" pos="0 0 0.3" euler="30 20 0"><freejoint/>
      <geom name="plank" type="box" size="0.5 0.25 0.1" density="50"/><body/></body>"""
UNEQUAL = '<numeric name="added_mass" data="0 0 10 0 0 0"/>'


def test_the_swing_by_unequal_added_mass_needs_a_short_timestep():
    """At the speed of a fall over twice the plank's reach."""
    mass, volume, sides = 5.0, 0.1, (0.5, 0.25, 0.1)
    speed = np.sqrt(4.0 * 9.81 * np.linalg.norm(sides))
    inertia = mass / 3.0 * (sides[1] ** 2 + sides[2] ** 2)
    omega = speed * np.sqrt(10.0 * 1025.0 * volume / inertia)
    for factor, is_noted in ((0.98, False), (1.02, True)):
        timestep = factor * 2.0 * SAFE_SWING_SHARE / omega
        assert len(notes_of(compiled(PLANK, ("plank",), timestep, custom=UNEQUAL))) == is_noted


def test_a_body_that_rolls_faster_than_it_heaves_is_noted():
    """From 0.75 of the timestep at which, by hydrostatics, its motion at rest begins to grow."""
    at_rest = hydrostatics(Scene.from_model(compiled(SPINDLE, ("box",), 1e-4)), with_gz=False)
    half_under_is_stiffer = 0.06
    for factor, is_noted in ((1.0 - half_under_is_stiffer, False), (1.02, True)):
        timestep = factor * 0.75 * at_rest["box"].rest.largest_timestep_s
        assert len(notes_of(compiled(SPINDLE, ("box",), timestep))) == is_noted


def test_a_plate_is_noted_in_every_starting_attitude():
    """A plate that stands on its edge falls flat."""
    for euler in ("0 0 0", "90 0 0", "0 90 0"):
        plate = f"""<body name="plate" euler="{euler}"><freejoint/>
          <geom name="plate" type="box" size="0.5 0.5 0.005" density="50"/></body>"""
        assert len(notes_of(compiled(plate, ("plate",), 0.015))) == 1


def test_welded_bodies_count_as_one():
    """A light block on a heavy frame is safe; the block alone is not."""
    light = '<geom name="light" type="box" size="0.1 0.1 0.1" density="0.5"/>'
    frame = '<body name="frame"><freejoint/><geom size="0.1" pos="0 0 -0.3" mass="{}"/>{}</body>'
    alone = f'<body name="frame"><freejoint/>{light}</body>'
    welded = frame.format(4.0, f'<body name="block">{light}</body>')
    assert notes_of(compiled(welded, ("light",), 0.02)) == []
    assert len(notes_of(compiled(alone, ("light",), 0.02))) == 1


STOPPED = {
    "with another integrator": ("ball", lambda: ball(0.5, 0.02, integrator="RK4")),
    "in waves": ("ball", lambda: ball(0.5, 0.02, custom=WAVES)),
    "on a slide": ("ball", lambda: ball(0.5, 0.02, joint=SLIDE)),
    "on the arm of a barge": ("arm", lambda: compiled(ARM, ("barge", "arm"), 0.02)),
    "with unequal added mass": ("plank", lambda: compiled(PLANK, ("plank",), 0.01, custom=UNEQUAL)),
    "with too little inertia": ("box", lambda: compiled(SPINDLE, ("box",), 0.002)),
}


@pytest.mark.parametrize("case", STOPPED)
def test_diverging_motion_is_stopped(case):
    body, load = STOPPED[case]
    with pytest.raises(DivergenceError, match=r"timestep of .* too long") as caught:
        list(simulate(Scene.from_model(load()), 60.0))
    assert caught.value.body == body


def test_each_body_is_judged_by_itself():
    """The ball is stopped at the same instant alone, beside a ship, and with a weak screw."""
    light = BALL.format(z=0.05, joint="<freejoint/>", density=0.5)
    screwed = Scene.from_model(ball(0.5, 0.02, extra=SCREW))
    screwed.data.ctrl[:] = 1e-6
    beside = Scene.from_model(compiled(light + SHIP, ("ball", "ship"), 0.02))
    times = []
    for scene in (Scene.from_model(ball(0.5, 0.02)), beside, screwed):
        with pytest.raises(DivergenceError) as caught:
            list(simulate(scene, 60.0))
        assert caught.value.body == "ball"
        times.append(caught.value.time)
    between_samples = 1.0 / 30.0
    np.testing.assert_allclose(times, times[0], atol=between_samples)


LINEAR = '<text name="buoyancy_method" data="linear"/>'  # patches for such waves take seconds

LIVELY = {
    "a light ball released deep down": lambda: ball(10.25, 0.002, z=-20.0),
    "a stone that sinks": lambda: ball(8000.0, 0.005),
    "a fall from 200 m": lambda: ball(500.0, 0.002, z=200.0),
    "waves about to break": lambda: ball(
        500.0, 0.002, custom='<numeric name="wave_a" data="0.6 4 0 0"/>' + LINEAR
    ),
    "a long ocean swell": lambda: ball(
        500.0, 0.002, custom='<numeric name="wave_a" data="5 400 0 0"/>'
    ),
    "watched, in a swell": lambda: ball(
        10.25, 0.02, custom='<numeric name="wave_a" data="5 400 0 0"/>'
    ),
}


@pytest.mark.parametrize("case", LIVELY)
def test_lively_motion_is_not_divergence(case):
    loaded = LIVELY[case]()
    assert len(notes_of(loaded)) == case.startswith("watched")
    *_, last = simulate(Scene.from_model(loaded), 8.0)
    assert last.time == pytest.approx(8.0, abs=0.02)


def test_the_head_is_conserved():
    """The head of a spinning ball that is released 2 m under water and flies 198 m high."""
    scene = Scene.from_model(ball(10.25, 0.02, z=-2.0))
    watch, heads = Watch(scene), []
    scene.model.opt.timestep = 1e-4
    scene.data.qvel[3:] = 0.0, 30.0, 40.0
    spin = 0.2 * RADIUS**2 * 50.0**2 / 9.81
    while scene.data.time < 8.0:
        heads.append(watch.heads()[0])
        mujoco.mj_step(scene.model, scene.data, 1000)
    assert heads[0] == pytest.approx(99.0 * 2.0 + spin)
    np.testing.assert_allclose(heads, heads[0], rtol=0.01)


def test_a_loss_of_energy_does_not_excuse_a_gain():
    watch = Watch(Scene.from_model(ball(10.25, 0.02)))
    heads, pushed_under = watch.heads(), 100.0 * RADIUS
    watch.check(before=heads + 1000.0)
    watch.check(before=heads - 0.99 * pushed_under)
    with pytest.raises(DivergenceError, match="of which waves and buoyancy explain 10 m"):
        watch.check(before=heads - 0.02 * pushed_under)


@pytest.mark.parametrize(
    ("custom", "explained"),
    [
        ('<numeric name="wave_a" data="0.3 8 0 0"/>', 100.0 * 2.0 * 0.3 + 8.0 / np.pi),
        ('<numeric name="water_current" data="3 4"/>', 2.0 * 5.0**2 / 9.81),
    ],
)
def test_waves_and_a_current_explain_some_energy(custom, explained):
    watch = Watch(Scene.from_model(ball(10.25, 0.02, custom=custom)))
    heads, more = watch.heads(), 100.0 * RADIUS + explained
    watch.check(before=heads - 0.99 * more)
    with pytest.raises(DivergenceError):
        watch.check(before=heads - 0.02 * more)


def test_changes_between_samples_are_not_divergence():
    """The caller kicks a watched ball."""
    scene = Scene.from_model(ball(10.25, 0.02))
    for sample in simulate(scene, 4.0, rate=10.0):
        if sample.step == 100:
            scene.data.qvel[2] = 500.0
    assert scene.data.qpos[2] > 900.0


def test_applied_forces_are_not_divergence():
    """Any force may act on a body whose timestep is short enough."""
    scene = Scene.from_model(model(custom=WAVES))
    scene.data.qfrc_applied[2] = 1e6
    *_, last = simulate(scene, 2.0)
    assert last.positions[0, 2] > 1000.0


def test_every_run_notices_a_reset_by_mujoco():
    """MuJoCo clears its warnings when it resets a state, so the second run must notice it too."""
    scene = Scene.from_model(model(CUBE))
    for _ in range(2):
        samples = simulate(scene, 1.0, rate=10.0)
        start = next(samples).time
        scene.data.qpos[0] = np.nan
        with pytest.raises(DivergenceError, match="its position is not finite or huge") as caught:
            next(samples)
        assert caught.value.time == pytest.approx(start)
    list(simulate(scene, 0.1))  # from the state after MuJoCo's reset


def test_the_error_names_the_instant_of_a_reset():
    """MuJoCo resets a state with a huge velocity between two samples."""
    scene = Scene.from_model(model(CUBE))
    samples = simulate(scene, 10.0, rate=0.2)
    next(samples)
    scene.data.qfrc_applied[0] = 5e12  # 1e10 m/s^2; MuJoCo resets above 1e10 m/s
    with pytest.raises(DivergenceError, match="its velocity") as caught:
        list(samples)
    assert caught.value.time == pytest.approx(1.025, abs=0.02)


def test_gravity_switched_off_later_is_refused():
    scene = Scene.from_model(model())
    scene.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    with pytest.raises(ModelError, match="option flag gravity is disabled"):
        simulate(scene, 1.0)
