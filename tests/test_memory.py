"""Memory of the waves that a body makes, and its added mass at infinite frequency."""

import copy
import pickle
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from mujoco.batch import Batch
from panel_codes import HEAVE, coefficients, column, random_matrix, text_of
from scenes import WATER, WAVES, model, xml

from sim import Buoyancy, Note, Scene, hydrostatics
from sim.geometry import moved_matrix, rotation_about
from sim.plugin.native import MEMORY_SIZE
from sim.resistance.memory import COLUMN, advanced, remember

GRAVITY, DENSITY = 9.81, 1025.0
FULLPHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS
INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
INTEGRATORS = ("Euler", "implicit", "implicitfast", "RK4")

# One pole: mass 1, added mass 0.5, stiffness 3, c 0.5, a0 1.5, a1 1.3, let go at 1 (closed form)
POLE = column(1.5, 1.3, 0.5)
TIMES, HEIGHTS = (1.0, 2.0, 5.0), (0.173804647, -0.836253138, 0.424403689)
ENERGIES = (1.457628380, 1.315757866, 0.732141648)
STIFFNESS, ADDED_MASS = 3.0, 0.5

TIME_INTEGRATION = 1e-6
"""Error [m] of RK4 at a timestep of 5 ms; the memory is of second order."""

ORDER = 0.05
"""Deviation of a measured order of convergence."""


def oscillator(
    folder: Path, timestep: float, integrator: str = "RK4", pole: list[float] = POLE
) -> mujoco.MjModel:
    """A box of 1 kg, upright on a slide, whose waterplane has the stiffness of the closed form."""
    half, side = GRAVITY / STIFFNESS, 0.5 * np.sqrt(STIFFNESS / (DENSITY * GRAVITY))
    added_mass = np.zeros((6, 6))
    added_mass[HEAVE, HEAVE] = ADDED_MASS
    body = f"""<body name="b"><joint type="slide" axis="0 0 1"/>
        <geom name="b" type="box" size="{side} {side} {half}" mass="1"/></body>"""
    return model(
        body, ("b",), text_of(folder, "b", added_mass=added_mass, memory=[pole]),
        f'<option timestep="{timestep}" integrator="{integrator}"/>',
    )  # fmt: skip


def energy_of(data: mujoco.MjData, speed: float) -> float:
    """Energy of the oscillator and of the water that remembers it."""
    x1, x2 = data.plugin_state[-len_of_memory(data) :][8:10]
    z = data.qpos[0]
    stored = 0.5 * (x1**2 + POLE[0] * x2**2)
    return 0.5 * (1.0 + ADDED_MASS) * speed**2 + 0.5 * STIFFNESS * z**2 + stored


def len_of_memory(data: mujoco.MjData) -> int:
    return len(data.plugin_state) - MEMORY_SIZE - 1


def heights(compiled: mujoco.MjModel, speed: float = 0.0) -> np.ndarray:
    """Heights of the oscillator at TIMES, let go at 1 with a speed."""
    data = mujoco.MjData(compiled)
    data.qpos[0], data.qvel[0] = 1.0, speed
    found = []
    for time in TIMES:
        mujoco.mj_step(compiled, data, nstep=round((time - data.time) / compiled.opt.timestep))
        found.append(data.qpos[0])
    return np.array(found)


def test_one_pole_moves_as_the_closed_form(tmp_path):
    np.testing.assert_allclose(
        heights(oscillator(tmp_path, 0.005)), HEIGHTS, rtol=0.0, atol=TIME_INTEGRATION
    )
    errors = [np.abs(heights(oscillator(tmp_path, h)) - HEIGHTS).max() for h in (0.04, 0.02, 0.01)]
    np.testing.assert_allclose(np.diff(np.log2(errors)), -2.0, atol=ORDER)


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_other_integrators_are_of_second_order_but_for_their_start(tmp_path, integrator):
    """They move a body by the velocity at the end of a step, so their velocities are those half a
    step earlier: the oscillator begins with its velocity at - h / 2."""
    start = STIFFNESS / (1.0 + ADDED_MASS)
    errors = [
        np.abs(heights(oscillator(tmp_path, h, integrator), 0.5 * h * start) - HEIGHTS).max()
        for h in (0.04, 0.02, 0.01)
    ]
    np.testing.assert_allclose(np.diff(np.log2(errors)), -2.0, atol=ORDER)


def test_energy_of_one_pole_is_the_closed_form(tmp_path):
    compiled = oscillator(tmp_path, 0.005)
    data = mujoco.MjData(compiled)
    data.qpos[0] = 1.0
    for time, expected in zip(TIMES, ENERGIES, strict=True):
        mujoco.mj_step(compiled, data, nstep=round((time - data.time) / 0.005))
        mujoco.mj_forward(compiled, data)
        assert energy_of(data, data.qvel[0]) == pytest.approx(expected, abs=3.0 * TIME_INTEGRATION)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_a_memory_that_loses_nothing_keeps_energy_to_the_second_order(tmp_path, integrator):
    """A memory that lagged by half a step would drive the body, at the first order."""
    drift = []
    for h in (0.04, 0.02):
        compiled = oscillator(tmp_path, h, integrator, [POLE[0], 1e-9, *POLE[2:]])
        data = mujoco.MjData(compiled)
        data.qpos[0] = 1.0
        energies = []
        for _ in range(round(20.0 / h)):
            mujoco.mj_forward(compiled, data)
            ahead = 0.0 if integrator == "RK4" else 0.5 * h  # the others' velocities are early
            energies.append(energy_of(data, data.qvel[0] + ahead * data.qacc[0]))
            mujoco.mj_step(compiled, data)
        drift.append(np.abs(np.array(energies) / energies[0] - 1.0).max())
    assert drift[0] < 2e-3
    assert drift[1] < 0.27 * drift[0]


def test_the_propagator_is_the_matrix_exponential():
    """Of under-damped, critical and over-damped columns, against 40 terms of the series of the
    exponential of the augmented system (x1, x2, u, u')."""
    rng = np.random.default_rng(1)
    for a0, a1 in ((1.5, 1.3), (4.0, 4.0), (4.0, 4.0 + 1e-9), (0.3, 5.0), (900.0, 2.0)):
        row, span = np.array([(a0, a1, np.zeros(6))], COLUMN), 0.07
        x1, x2, before, after = rng.normal(size=4)
        system = np.array([[-a1, -a0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]]) * span
        expected = term = np.array([x1, x2, before, (after - before) / span])
        for n in range(1, 40):
            term = system @ term / n
            expected = expected + term
        found = advanced(row[0], x1, x2, before, after, span)
        np.testing.assert_allclose(found, expected[:2], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("share", [0.04, 0.5, 1.0])
def test_the_memory_stores_or_loses_what_it_takes_however_wet_the_body_is(share):
    """The power of its force on the body is the rate of its energy plus a1 x1^2."""
    rng = np.random.default_rng(2)
    columns, velocity, span = np.zeros(3, COLUMN), rng.normal(size=6), 1e-7
    columns["stiffness"], columns["damping"] = rng.uniform(0.5, 3.0, (2, 3))
    columns["column"] = rng.normal(size=(3, 6))
    states, force = np.append(np.sqrt(share) * velocity, rng.normal(size=6)), np.zeros(6)

    def stored() -> float:
        return 0.5 * float((states[6::2] ** 2 + columns["stiffness"] * states[7::2] ** 2).sum())

    before, lost = stored(), float((columns["damping"] * states[6::2] ** 2).sum())
    remember(columns, span, share, True, True, velocity, states, force)
    assert (stored() - before) / span + lost == pytest.approx(-force @ velocity, abs=1e-5)


BOX = """
    <body name="cube">
      <freejoint/>
      <geom name="cube" type="box" size="0.5 0.4 0.3" density="512.5"/>
      <body/>
    </body>"""
"""The empty body inside makes room for the whole matrix of inertia."""


def wide(folder: Path, integrator: str = "Euler", waves: str = WAVES) -> mujoco.MjModel:
    """A free box with memory in all motions, in waves."""
    rng = np.random.default_rng(5)
    memory = np.hstack([rng.uniform(0.5, 3.0, (8, 2)), 6.0 * rng.normal(size=(8, 6))])
    text = text_of(folder, "cube", added_mass=random_matrix(rng, 40.0), memory=memory)
    option = f'<option timestep="0.005" integrator="{integrator}"/>'
    return model(BOX, custom=waves + text, option=option)


def pushed(compiled: mujoco.MjModel, steps: int = 30) -> mujoco.MjData:
    data = mujoco.MjData(compiled)
    data.qvel[:] = [0.3, -0.2, 0.5, 0.4, -0.6, 0.2]
    mujoco.mj_step(compiled, data, nstep=steps)
    return data


def full_state(compiled: mujoco.MjModel, data: mujoco.MjData, kind=FULLPHYSICS) -> np.ndarray:
    state = np.empty(mujoco.mj_stateSize(compiled, kind))
    mujoco.mj_getState(compiled, data, state, kind)
    return state


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_states_continue_to_the_bit(tmp_path, integrator):
    """Copies, saved states, pickles and resets, and calls in between that keep nothing."""
    compiled = wide(tmp_path, integrator)
    data = pushed(compiled)
    saved, into = mujoco.MjData(compiled), pushed(compiled, 7)
    restored, looked_at = pushed(compiled, 3), copy.copy(data)
    mujoco.mj_setState(compiled, saved, full_state(compiled, data), FULLPHYSICS)
    mujoco.mj_setState(compiled, restored, full_state(compiled, data, INTEGRATION), INTEGRATION)
    mujoco.mj_copyData(into, compiled, data)
    unpickled = pickle.loads(pickle.dumps(data))
    slopes = np.zeros((12, 12))
    ends = []
    for each in (data, saved, restored, into, unpickled, looked_at):
        for _ in range(20):
            mujoco.mj_step(compiled, each)
            if each is looked_at:
                mujoco.mj_forward(compiled, each)
                mujoco.mj_forward(compiled, each)
                mujoco.mj_inverse(compiled, each)
                if integrator != "RK4":  # which it refuses
                    mujoco.mjd_transitionFD(compiled, each, 1e-6, True, slopes, None, None, None)
        ends.append(np.concatenate([each.qpos, each.qvel]))
    mujoco.mj_resetData(compiled, data)
    again = mujoco.MjData(compiled)
    for each in (data, again):
        mujoco.mj_step(compiled, each, nstep=10)
    np.testing.assert_array_equal(data.qpos, again.qpos)
    assert np.array_equal(ends, [ends[0]] * len(ends))


def test_half_steps_are_whole_steps(tmp_path):
    compiled = wide(tmp_path)
    whole, halves = pushed(compiled), pushed(compiled)
    for _ in range(20):
        mujoco.mj_step(compiled, whole)
        mujoco.mj_step1(compiled, halves)
        mujoco.mj_step2(compiled, halves)
    np.testing.assert_array_equal(halves.qpos, whole.qpos)


def test_rollouts_and_batches_match_single_states(tmp_path):
    compiled = wide(tmp_path)
    datas = [pushed(compiled, steps) for steps in (1, 5, 9, 20)]
    starts = np.array([full_state(compiled, data) for data in datas])
    with rollout.Rollout(nthread=2) as pool:
        workers = [mujoco.MjData(compiled) for _ in range(2)]
        found, _ = pool.rollout([compiled] * 4, workers, starts, nstep=40)
    batch = Batch(compiled, 4, nthread=2)
    velocities = np.random.default_rng(1).normal(size=(4, 6))
    batch.bind("qvel")[:] = velocities
    batch.step(nstep=40)
    for i, data in enumerate(datas):
        mujoco.mj_step(compiled, data, nstep=40)
        np.testing.assert_array_equal(found[i, -1], full_state(compiled, data))
        own = mujoco.MjData(compiled)
        own.qvel[:] = velocities[i]
        mujoco.mj_step(compiled, own, nstep=40)
        np.testing.assert_array_equal(batch.bind("qpos")[i], own.qpos)


def test_the_rest_frame_is_a_choice_of_axes(tmp_path):
    """The same coefficients in another rest frame move a body in the same way."""
    rng = np.random.default_rng(3)
    added_mass, columns = random_matrix(rng, 60.0), 8.0 * rng.normal(size=(2, 6))
    place, turn = np.array([0.1, -0.2, 0.15]), rotation_about(np.array([0.0, 0.0, 0.7]))
    moved = [
        np.concatenate([turn.T @ row[:3], turn.T @ (row[3:] - np.cross(place, row[:3]))])
        for row in columns
    ]
    ends = []
    for position, rotation, mass, rows in (
        (np.zeros(3), np.eye(3), added_mass, columns),
        (place, turn, moved_matrix(added_mass, place, turn), moved),
    ):
        memory = [[1.5, 0.8, *rows[0]], [0.7, 1.1, *rows[1]]]
        text = text_of(
            tmp_path, "cube", position=position, rotation=rotation, added_mass=mass, memory=memory
        )
        data = pushed(model(BOX, custom=text), 100)
        ends.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-10)


def test_added_mass_acts_on_the_bodys_own_motion_and_not_in_the_air(tmp_path):
    added_mass = np.diag([100.0, 100.0, 300.0, 0.0, 0.0, 0.0])
    compiled = model(BOX, custom=text_of(tmp_path, "cube", added_mass=added_mass))
    data, mass = mujoco.MjData(compiled), compiled.body_mass[1]
    data.xfrc_applied[1, :3] = 50.0, 0.0, 60.0
    mujoco.mj_forward(compiled, data)
    np.testing.assert_allclose(
        data.qacc[:3], [50.0 / (mass + 100.0), 0.0, 60.0 / (mass + 300.0)], rtol=0.0, atol=1e-9
    )
    data.qpos[2] = 5.0
    mujoco.mj_forward(compiled, data)
    np.testing.assert_allclose(data.qacc[2], 60.0 / mass - GRAVITY, rtol=1e-12)


def test_memory_in_numbers_acts_relative_to_the_water():
    """A body that drifts with the current makes no waves; one that is held makes some."""
    memory = " ".join(map(str, column(1.0, 1.0, 1e4, motion=0)))
    custom = f"""<numeric name="memory_cube" data="{memory}"/>
        <numeric name="water_current" data="1 0"/>"""
    compiled = model(BOX, custom=custom)
    data = mujoco.MjData(compiled)
    data.qvel[0] = 1.0
    mujoco.mj_step(compiled, data, nstep=200)
    np.testing.assert_allclose(data.qvel[:3], [1.0, 0.0, 0.0], rtol=0.0, atol=1e-9)
    mujoco.mj_resetData(compiled, data)
    mujoco.mj_step(compiled, data, nstep=200)
    assert data.qvel[0] > 0.05


def test_a_files_damping_acts_on_the_bodys_own_motion(tmp_path):
    """Held in a current: with a file nothing, without it the damping of the passing water."""
    damping = '<numeric name="damping_cube" data="500 0 0 0 0 0"/>'
    current = '<numeric name="water_current" data="1 0"/>'
    for text, expected in ((text_of(tmp_path, "cube"), 0.0), ("", 250.0)):
        compiled = model(BOX, custom=damping + current + text)
        data = mujoco.MjData(compiled)
        mujoco.mj_forward(compiled, data)
        assert data.xfrc_applied[1, 0] == pytest.approx(expected, abs=0.01 * 250.0)
        data.qvel[0] = 1.0
        mujoco.mj_forward(compiled, data)
        assert data.xfrc_applied[1, 0] == pytest.approx(expected - 250.0, abs=0.01 * 250.0)


def test_a_hinge_feels_the_memory_about_its_axis(tmp_path):
    """The pitch of a body on a hinge, with heave at an arm of 2 m: J^T does it."""
    body = """<body name="cube" pos="2 0 0"><joint type="hinge" axis="0 1 0" pos="-2 0 0"/>
        <geom name="cube" type="box" size="0.5 0.4 0.3" density="512.5"/></body>"""
    added_mass = np.diag([0.0, 0.0, 300.0, 0.0, 20.0, 0.0])
    compiled = model(body, custom=text_of(tmp_path, "cube", added_mass=added_mass))
    plain = model(body)
    found = []
    for each in (compiled, plain):
        data = mujoco.MjData(each)
        data.qfrc_applied[0] = 10.0
        mujoco.mj_forward(each, data)
        found.append(10.0 / data.qacc[0])
    assert found[0] - found[1] == pytest.approx(300.0 * 4.0 + 20.0, rel=1e-9)


@pytest.mark.parametrize(
    ("custom", "words"),
    [
        ('<numeric name="memory_cube" data="1 2 3"/>', "has 3 numbers; expected 8, 16, 24"),
        ('<numeric name="memory_cube" data="0 1 0 0 1 0 0 0"/>', "a0 is 0 1/s\\^2; it must be"),
        ('<numeric name="memory_cube" data="1 -1 0 0 1 0 0 0"/>', "a1 is -1 1/s; it must be"),
        (
            '<numeric name="memory_cube" data="1 1 1e6 0 0 0 0 0"/>',
            "l\\^2 is 1e\\+12 kg/s\\^2 in row 1",
        ),
        ('<numeric name="memory_boat" data="1 1 0 0 1 0 0 0"/>', "names no body with a geom"),
        ('<text name="hydrodynamics_boat" data="FILE"/>', "names no body with a geom"),
        (
            '<text name="hydrodynamics_cube" data="no.npz"/>',
            "cube': there is no file",
        ),
        (
            '<text name="hydrodynamics_cube" data="FILE"/>'
            '<numeric name="added_mass" data="0 0 1 0 0 0"/>',
            "both give the added mass of body 'cube'",
        ),
        (
            '<text name="hydrodynamics_cube" data="FILE"/>'
            '<numeric name="memory_cube" data="1 1 0 0 1 0 0 0"/>',
            "both give the memory",
        ),
    ],
)
def test_faults_are_refused(tmp_path, custom, words):
    coefficients().save(tmp_path / "file.npz")
    with pytest.raises(ValueError, match=words):
        model(BOX, custom=custom.replace("FILE", str(tmp_path / "file.npz")))


def test_a_full_matrix_needs_an_empty_body(tmp_path):
    text = text_of(tmp_path, "cube", added_mass=np.diag([10.0, 20.0, 30.0, 0, 0, 0]))
    with pytest.raises(ValueError, match="put an empty <body/> inside"):
        model(BOX.replace("<body/>", ""), custom=text)


def test_another_water_and_drag_of_waves_are_noted(tmp_path):
    text = text_of(tmp_path, "cube", memory=[POLE], density=1000.0, depth=20.0)
    drag = '<numeric name="drag" data="0.3 0 0"/>'
    with pytest.warns(Note) as notes:
        model(BOX, custom=text + drag)
    said = "\n".join(str(note.message) for note in notes)
    for words in ("a density of 1000, and the scene's is 1025", "a depth of 20", "set that to 0"):
        assert words in said


def test_a_changed_file_is_read_again_and_found_beside_the_scene(tmp_path):
    path = tmp_path / "scene.xml"
    found = []
    for mass in (100.0, 400.0):
        coefficients(added_mass=np.diag([mass] * 3 + [0.0] * 3)).save(tmp_path / "c.npz")
        path.write_text(xml(BOX, custom='<text name="hydrodynamics_cube" data="c.npz"/>'))
        scene = Scene.load(path)
        scene.data.xfrc_applied[1, 0] = 10.0
        mujoco.mj_forward(scene.model, scene.data)
        found.append(10.0 / scene.data.qacc[0] - scene.model.body_mass[1])
    np.testing.assert_allclose(found, [100.0, 400.0], rtol=1e-9)


def test_hydrostatics_have_the_added_mass_of_the_file(tmp_path):
    """The heave period of a box, which is 2 pi sqrt((m + A) / (rho g area))."""
    text = text_of(tmp_path, "cube", added_mass=np.diag([0.0, 0.0, 300.0, 0.0, 0.0, 0.0]))
    scene = Scene.from_model(model(BOX, custom=text))
    mass = scene.model.body_mass[1] + 300.0
    expected = 2.0 * np.pi * np.sqrt(mass / (DENSITY * GRAVITY * 1.0 * 0.8))
    found = hydrostatics(scene, with_gz=False)["cube"].rest.heave_period_s
    assert found == pytest.approx(expected, rel=1e-9)


def test_coefficients_of_another_attitude_are_noted(tmp_path):
    text = text_of(tmp_path, "cube", rotation=rotation_about(np.array([0.3, 0.0, 0.0])))
    with pytest.warns(Note, match="rests 17 deg from the attitude that its hydrodynamics are for"):
        Scene.load(mujoco.MjSpec.from_string(xml(BOX, custom=text)))


def test_an_attached_body_brings_its_memory():
    memory = " ".join(map(str, column(1.0, 1.0, 1e3)))
    child = mujoco.MjSpec.from_string(
        xml(BOX, custom=f'<numeric name="memory_cube" data="{memory}"/>').replace(WATER, "")
    )
    option = '<option timestep="0.005"/>'
    parent = mujoco.MjSpec.from_string(f"<mujoco>{WATER}{option}<worldbody/></mujoco>")
    parent.attach(child, prefix="x_", frame=parent.worldbody.add_frame())
    compiled = parent.compile()
    (response,) = Buoyancy.of(compiled).responses
    assert response.body == compiled.body("x_cube").id
    np.testing.assert_array_equal(response.coefficients.memory, [column(1.0, 1.0, 1e3)])
