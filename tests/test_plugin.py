"""The plugin in MuJoCo: threads, batches, copies, pushes, changed and refused models."""

import copy
import ctypes
import gc
import pickle
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from mujoco.batch import Batch
from scenes import CUBE, WATER, WAVES, afloat, model, xml

from sim import Buoyancy, ModelError, Scene, simulate

DRAG = '<numeric name="drag" data="0.2 1.0 0.005"/>'


def cube(z: float = 0.0, custom: str = WAVES + DRAG) -> Scene:
    scene = Scene.from_model(model(custom=custom))
    scene.data.qpos[2] = z
    return scene


def state(data: mujoco.MjData) -> np.ndarray:
    return np.concatenate([data.qpos, data.qvel])


def alone(z: float, steps: int) -> np.ndarray:
    scene = cube(z)
    mujoco.mj_step(scene.model, scene.data, nstep=steps)
    return state(scene.data)


@pytest.mark.parametrize("threads", [1, 4])
def test_rollouts_in_threads_match_one_thread(threads):
    """Sixteen trajectories with drag, each from its own position and time, to the bit."""
    scene = cube()
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.empty((16, mujoco.mj_stateSize(scene.model, full)))
    rng = np.random.default_rng(0)
    for start in starts:
        scene.data.qpos[:3], scene.data.time = rng.uniform(-1.0, 1.0, 3), rng.uniform(0.0, 10.0)
        mujoco.mj_getState(scene.model, scene.data, start, full)
    datas = [mujoco.MjData(scene.model) for _ in range(threads)]
    with rollout.Rollout(nthread=threads) as pool:
        found, _ = pool.rollout([scene.model] * 16, datas, starts, nstep=100)
    for start, end in zip(starts, found[:, -1], strict=True):
        data = mujoco.MjData(scene.model)
        mujoco.mj_setState(scene.model, data, start, full)
        mujoco.mj_step(scene.model, data, nstep=100)
        expected = np.empty_like(end)
        mujoco.mj_getState(scene.model, data, expected, full)
        np.testing.assert_array_equal(end, expected)


def test_simulations_in_threads_do_not_affect_each_other():
    """They have different lengths, so they end in any order."""
    heights = [0.1 * i for i in range(6)]
    scenes = [cube(z) for z in heights]

    def run(i: int) -> np.ndarray:
        for _ in simulate(scenes[i], 0.5 * (1 + i % 3), rate=50.0):
            pass
        return state(scenes[i].data)

    with ThreadPoolExecutor(6) as pool:
        together = list(pool.map(run, range(6)))
    for i, end in enumerate(together):
        np.testing.assert_array_equal(end, alone(heights[i], 100 * (1 + i % 3)))


def test_many_threads_step_reset_and_compile():
    expected = {z: alone(z, 40) for z in (0.0, 0.3)}

    def work(seed: int) -> int:
        rng, wrong = np.random.default_rng(seed), 0
        for i in range(20):
            z, scene = float(rng.choice([0.0, 0.3])), scenes[seed]
            if i % 5 == 4:  # a model that other threads have too, and a new one
                scene = cube()
                cube(custom=f'<numeric name="water_level" data="{seed + 0.01 * i}"/>')
            mujoco.mj_resetData(scene.model, scene.data)
            scene.data.qpos[2] = z
            mujoco.mj_step(scene.model, scene.data, nstep=40)
            wrong += not np.array_equal(state(scene.data), expected[z])
        return wrong

    scenes = [cube() for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(work, range(8))) == 0


@pytest.mark.parametrize("kind", ["Python", "C"])
def test_a_users_callback_is_called_besides_the_water(kind):
    calls = []
    mine = lambda model, data: calls.append(1)  # noqa: E731
    if kind == "C":
        mine = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64)(mine)
    scene, expected = cube(), alone(0.0, 10)
    mujoco.set_mjcb_passive(mine)
    try:
        mujoco.mj_step(scene.model, scene.data, nstep=10)
        assert len(calls) == 10
        assert mujoco.get_mjcb_passive() is mine
        np.testing.assert_array_equal(state(scene.data), expected)
    finally:
        mujoco.set_mjcb_passive(None)


def test_half_steps_have_the_forces():
    """mj_step2 uses the forces of the preceding mj_step1. dm_control steps like this."""
    scene = cube()
    mujoco.mj_step1(scene.model, scene.data)
    for _ in range(50):
        mujoco.mj_step2(scene.model, scene.data)
        mujoco.mj_step1(scene.model, scene.data)
    np.testing.assert_array_equal(state(scene.data), alone(0.0, 50))


def test_models_may_be_compiled_between_steps():
    scene, data = cube(), mujoco.MjData(cube().model)
    mujoco.mj_step(scene.model, data)
    twin, other = model(custom=WAVES + DRAG), model(CUBE.replace("512.5", "300"))
    assert scene.buoyancy.calls(data) == 1  # each model has its own count
    for compiled in (twin, other):
        own = mujoco.MjData(compiled)
        mujoco.mj_step(compiled, own)
        assert Buoyancy.of(compiled).calls(own) == 1
    mujoco.mj_step(scene.model, data, nstep=29)
    np.testing.assert_array_equal(state(data), alone(0.0, 30))


def batch_of(scene: Scene, starts: np.ndarray, **options) -> Batch:
    batch = Batch(scene.model, nsim=len(starts), **options)
    batch.bind("qpos")[:, :3], batch.bind("time")[:] = starts[:, :3], starts[:, 3]
    return batch


STARTS = np.random.default_rng(3).uniform(-0.5, 0.5, (12, 4)) + [0.0, 0.0, 0.0, 5.0]


def one_by_one(compiled: mujoco.MjModel, starts: np.ndarray) -> np.ndarray:
    ends = []
    for start in starts:
        data = mujoco.MjData(compiled)
        data.qpos[:3], data.time = start[:3], start[3]
        mujoco.mj_step(compiled, data, nstep=60)
        ends.append(state(data))
    return np.array(ends)


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("nthread", [1, 2])
def test_a_batch_matches_its_simulations_one_by_one(nthread, persistent):
    scene = cube()
    batch = batch_of(scene, STARTS, nthread=nthread, persistent=persistent)
    batch.step(nstep=60)
    ends = np.hstack([batch.bind("qpos"), batch.bind("qvel")])
    np.testing.assert_array_equal(ends, one_by_one(scene.model, STARTS))
    assert len(np.unique(ends, axis=0)) == len(STARTS)


@pytest.mark.parametrize("persistent", [False, True])
def test_pushes_in_a_batch_match_simulations_one_by_one(persistent):
    scene = cube()
    batch = batch_of(scene, STARTS, nthread=2, persistent=persistent)
    rows = batch.bind("xfrc_applied").reshape(len(STARTS), -1, 6)
    rows[:, 1, 0] = np.linspace(-50.0, 50.0, len(STARTS))
    for _ in range(6):
        batch.step(nstep=10)
    for i, (end, start) in enumerate(zip(batch.bind("qpos"), STARTS, strict=True)):
        data = mujoco.MjData(scene.model)
        data.qpos[:3], data.time = start[:3], start[3]
        data.xfrc_applied[1, 0] = np.linspace(-50.0, 50.0, len(STARTS))[i]
        mujoco.mj_step(scene.model, data, nstep=60)
        np.testing.assert_array_equal(end, data.qpos)


@pytest.mark.parametrize("field", ["body_mass", "body_ipos", "geom_pos"])
def test_expanded_fields_of_a_batch_act_as_in_their_own_models(field):
    scene, rng = barge(), np.random.default_rng(1)
    values = getattr(scene.model, field) * rng.uniform(0.8, 1.2, (len(STARTS), 1, 1))
    values = values.reshape(len(STARTS), *getattr(scene.model, field).shape)
    batch = batch_of(scene, STARTS, nthread=2)
    batch.expand(field)[:] = values
    batch.step(nstep=60)
    ends = np.hstack([batch.bind("qpos"), batch.bind("qvel")])
    for end, start, value in zip(ends, STARTS, values, strict=True):
        own = copy.copy(scene.model)
        getattr(own, field)[:] = value
        expected = one_by_one(own, start[None])[0]
        np.testing.assert_array_equal(end, expected)


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
def test_changed_hulls_of_a_batch_act_after_its_reset(threads, persistent):
    scene, sizes = cube(), [0.3, 0.4, 0.5]
    batch = Batch(scene.model, nsim=3, nthread=threads, persistent=persistent)
    batch.expand("geom_size")[:] = np.reshape(sizes, (3, 1, 1))
    batch.reset()
    batch.step(nstep=60)
    for size, end in zip(sizes, batch.bind("qpos"), strict=True):
        own = copy.copy(scene.model)
        own.geom_size[:] = size
        data = mujoco.MjData(own)
        mujoco.mj_step(own, data, nstep=60)
        np.testing.assert_array_equal(end, data.qpos)


def test_methods_in_python_work_in_batches():
    settings = {"buoyancy_method": "reference", "reference_tolerance": 1e-4}
    scene = afloat(custom=WAVES, load=dict(settings=settings))
    batch = batch_of(scene, STARTS[:2], nthread=2)
    batch.step(nstep=3)
    for end, start in zip(batch.bind("qpos"), STARTS, strict=False):
        data = mujoco.MjData(scene.model)
        data.qpos[:3], data.time = start[:3], start[3]
        mujoco.mj_step(scene.model, data, nstep=3)
        np.testing.assert_array_equal(end, data.qpos)


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "RK4"])
def test_many_steps_per_call_in_threads_match_single_steps(integrator):
    option = f'<option integrator="{integrator}"/>'
    scene = Scene.from_model(model(custom=WAVES + DRAG, option=option))

    def end_of(steps: int) -> bytes:
        data, digest = mujoco.MjData(scene.model), sha256()
        data.qpos[2] = 0.3
        for step in range(0, 200, steps):
            mujoco.mj_step(scene.model, data, nstep=steps)
            if (step + steps) % 100 == 0:
                digest.update(state(data))
        return digest.digest()

    expected = end_of(1)
    for threads in (2, 8):
        with ThreadPoolExecutor(threads) as pool:
            assert set(pool.map(end_of, [100, 1, 10, 50, 1, 100, 100, 10])) == {expected}


def test_models_with_equal_signatures_have_their_own_water():
    """MuJoCo's signature ignores the numbers of custom fields."""
    resisting, free = (
        model(custom=f'<numeric name="water_level" data="0"/><numeric name="drag" data="{drag}"/>')
        for drag in ("0.2 1 0.005", "0 0 0")
    )
    assert resisting.signature == free.signature
    for _ in range(2):
        for compiled, resists in ((resisting, True), (free, False)):
            data = mujoco.MjData(compiled)
            data.qvel[0] = 1.0
            mujoco.mj_forward(compiled, data)
            assert (data.xfrc_applied[1, 0] < -1.0) == resists


def test_a_copied_model_floats_like_the_original():
    scene = cube()
    copied = copy.copy(scene.model)
    data = mujoco.MjData(copied)
    data.qpos[2] = 0.0
    mujoco.mj_step(copied, data, nstep=30)
    np.testing.assert_array_equal(state(data), alone(0.0, 30))


def test_a_copied_model_may_have_another_timestep():
    """The implicit step of the drag depends on the timestep."""
    scene = cube()
    copied = copy.copy(scene.model)
    copied.opt.timestep *= 5
    data = mujoco.MjData(copied)
    data.qpos[2] = 0.0
    mujoco.mj_step(copied, data, nstep=30)
    own = cube()
    own.model.opt.timestep *= 5
    mujoco.mj_step(own.model, own.data, nstep=30)
    np.testing.assert_array_equal(state(data), state(own.data))


def test_a_copied_model_floats_after_the_original_is_freed():
    copied = copy.copy(cube().model)
    restored = pickle.loads(pickle.dumps(copied))
    gc.collect()
    for compiled in (copied, restored):
        data = mujoco.MjData(compiled)
        mujoco.mj_step(compiled, data, nstep=30)
        np.testing.assert_array_equal(state(data), alone(0.0, 30))


PUSH = np.array([40.0, -30.0, 20.0, 5.0, -4.0, 3.0])


def pushed(push: np.ndarray, option: str) -> np.ndarray:
    """The cube's state after 40 steps with a push through qfrc_applied."""
    scene = Scene.from_model(model(custom=WAVES, option=option))
    data = scene.data
    for _ in range(40):
        mujoco.mj_kinematics(scene.model, data)
        data.qfrc_applied[:3] = push[:3]
        data.qfrc_applied[3:] = data.xmat[1].reshape(3, 3).T @ push[3:]
        mujoco.mj_step(scene.model, data)
    return state(data)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("is_repeated", [False, True])
def test_a_push_acts_besides_the_water_until_it_is_removed(integrator, is_repeated):
    """The push is written once, or before each step."""
    option = f'<option timestep="0.005" integrator="{integrator}"/>'
    push = PUSH.copy()
    if integrator == "RK4":  # in its stages, a torque in qfrc_applied would rotate with the body
        push[3:] = 0.0
    scene = Scene.from_model(model(custom=WAVES, option=option))
    data, buoyancy = scene.data, scene.buoyancy
    for step in range(40):
        if is_repeated or step == 0:
            data.xfrc_applied[1] = push
        mujoco.mj_step(scene.model, data)
        np.testing.assert_array_equal(buoyancy.pushes(data), [push])
    round_off = 1e-11  # over 40 steps
    np.testing.assert_allclose(state(data), pushed(push, option), rtol=0.0, atol=round_off)
    assert np.abs(state(data) - pushed(0.0 * push, option)).max() > 1e-2
    data.xfrc_applied[1] = 0.0
    mujoco.mj_forward(scene.model, data)
    assert not buoyancy.pushes(data).any()
    np.testing.assert_allclose(data.xfrc_applied[1], buoyancy.wrenches(data)[0], atol=1e-9)


def test_components_of_a_push_may_be_changed_one_by_one():
    scene = cube(custom=WAVES)
    data, buoyancy = scene.data, scene.buoyancy
    data.xfrc_applied[1] = PUSH
    mujoco.mj_step(scene.model, data, nstep=3)
    data.xfrc_applied[1, 0] = 7.0
    mujoco.mj_step(scene.model, data, nstep=3)
    np.testing.assert_array_equal(buoyancy.pushes(data), [[7.0, *PUSH[1:]]])
    mujoco.mj_resetData(scene.model, data)
    assert not data.xfrc_applied.any()
    mujoco.mj_step(scene.model, data, nstep=3)
    assert not buoyancy.pushes(data).any()


@pytest.mark.parametrize("kind", ["FULLPHYSICS", "INTEGRATION"])
def test_a_restored_state_continues_with_its_push(kind):
    """It is restored into the same MjData and into another one. FULLPHYSICS has no xfrc_applied, so
    the push of the other MjData stays."""
    scene, kind = cube(custom=WAVES), getattr(mujoco.mjtState, f"mjSTATE_{kind}")
    data, saved = scene.data, np.empty(mujoco.mj_stateSize(scene.model, kind))
    data.xfrc_applied[1] = PUSH
    mujoco.mj_step(scene.model, data, nstep=10)
    mujoco.mj_getState(scene.model, data, saved, kind)
    mujoco.mj_step(scene.model, data, nstep=10)
    expected = state(data)
    mujoco.mj_setState(scene.model, data, saved, kind)
    mujoco.mj_step(scene.model, data, nstep=10)
    np.testing.assert_array_equal(state(data), expected)
    np.testing.assert_array_equal(scene.buoyancy.pushes(data), [PUSH])
    other = mujoco.MjData(scene.model)
    mujoco.mj_setState(scene.model, other, saved, kind)
    mujoco.mj_step(scene.model, other, nstep=10)
    if kind == mujoco.mjtState.mjSTATE_INTEGRATION:
        np.testing.assert_array_equal(state(other), expected)
    else:
        assert not scene.buoyancy.pushes(other).any()


def test_only_one_of_two_instances_acts():
    text = xml(custom=WAVES + DRAG)
    both = text.replace("</plugin></extension>", '<instance name="more"/></plugin></extension>')
    assert both != text
    compiled = mujoco.MjModel.from_xml_string(both)
    assert compiled.nplugin == 2
    data = mujoco.MjData(compiled)
    mujoco.mj_step(compiled, data, nstep=30)
    np.testing.assert_array_equal(state(data), alone(0.0, 30))
    assert Buoyancy.of(compiled).calls(data) == 30


def test_a_model_without_an_instance_is_dry_and_the_error_names_the_remedy():
    dry = mujoco.MjModel.from_xml_string(xml().replace(WATER, ""))
    data = mujoco.MjData(dry)
    mujoco.mj_step(dry, data, nstep=100)
    assert data.qpos[2] < -1.0
    for ask in (Buoyancy.of, Scene.from_model):
        with pytest.raises(ModelError, match="has no instance of the plugin 'waterline'") as error:
            ask(dry)
        assert WATER in str(error.value)


def test_a_model_that_became_faulty_has_no_new_states():
    compiled = cube().model
    compiled.opt.gravity[0] = 0.1
    with pytest.raises(mujoco.FatalError, match="plugin->init failed"):
        mujoco.MjData(compiled)
    with pytest.raises(ModelError, match="gravity is"):
        Buoyancy.of(compiled)
    compiled.opt.gravity[0] = 0.0
    data = mujoco.MjData(compiled)
    mujoco.mj_step(compiled, data, nstep=30)
    np.testing.assert_array_equal(state(data), alone(0.0, 30))


def test_pickling_a_buoyancy_is_refused_with_the_remedy():
    with pytest.raises(TypeError, match=r"call Buoyancy\.of\(model\) where it is loaded"):
        pickle.dumps(Buoyancy.of(model()))


RESET_CHANGES = {
    "geom_size": lambda m: m.geom_size.__setitem__(0, 0.4),
    "numeric_data": lambda m: m.numeric_data.__setitem__(0, 500.0),
    "mesh_vert": lambda m: m.mesh_vert.__imul__(2.0),
}

BARGE = """
    <body name="barge" pos="0 0 -0.4"><freejoint/>
      <geom name="barge" type="mesh" mesh="wedge" pos="0.3 -0.2 0.1" euler="20 30 40"
            density="500"/>
      <geom type="sphere" size="0.1" pos="-0.4 0.6 0.1" density="3000"/></body>"""
WEDGE = """<mesh name="wedge" inertia="exact" vertex="0 0 0  1 0 0  0 1 0  0 0 1"
             face="0 2 1  0 1 3  0 3 2  1 2 3"/>"""
LINEAR = '<text name="buoyancy_method" data="linear"/>'


def barge(custom: str = WAVES + DRAG + LINEAR) -> Scene:
    """A hull that is moved and rotated in its body."""
    return Scene.from_model(model(BARGE, ("barge",), custom, assets=WEDGE))


@pytest.mark.parametrize("field", RESET_CHANGES)
def test_changes_of_hulls_and_waves_act_from_the_next_reset(field):
    """Before the reset nothing changes, to the bit. After it the state is like a new one."""
    made = cube if field == "geom_size" else barge
    scene, unchanged = made(), made()
    mujoco.mj_step(scene.model, scene.data, nstep=10)
    RESET_CHANGES[field](scene.model)
    mujoco.mj_step(scene.model, scene.data, nstep=10)
    mujoco.mj_step(unchanged.model, unchanged.data, nstep=20)
    np.testing.assert_array_equal(state(scene.data), state(unchanged.data))
    mujoco.mj_resetData(scene.model, scene.data)
    later = mujoco.MjData(scene.model)
    mujoco.mj_resetData(unchanged.model, unchanged.data)
    for compiled, data in (
        (scene.model, scene.data), (scene.model, later), (unchanged.model, unchanged.data)
    ):  # fmt: skip
        mujoco.mj_step(compiled, data, nstep=20)
    np.testing.assert_array_equal(state(scene.data), state(later))
    assert np.abs(state(scene.data) - state(unchanged.data)).max() > 1e-4


@pytest.mark.parametrize("field", RESET_CHANGES)
def test_a_buoyancy_keeps_the_state_of_its_model(field):
    scene = cube() if field == "geom_size" else barge()
    before = scene.buoyancy.wrenches(scene.data)
    RESET_CHANGES[field](scene.model)
    np.testing.assert_array_equal(scene.buoyancy.wrenches(scene.data), before)
    after = Buoyancy.of(scene.model).wrenches(scene.data)
    assert np.abs(after - before).max() > 1e-3 * np.abs(before).max()


def test_a_reset_of_a_faulty_model_gives_nan_until_it_is_corrected(tmp_path, monkeypatch):
    """Gravity that is not vertical is reported in MuJoCo's log."""
    monkeypatch.chdir(tmp_path)
    scene = cube()
    bad = scene.data.warning[mujoco.mjtWarning.mjWARN_BADQACC]
    scene.model.opt.gravity[0] = 0.1
    mujoco.mj_step(scene.model, scene.data)
    assert bad.number == 0  # before the reset
    mujoco.mj_resetData(scene.model, scene.data)
    mujoco.mj_forward(scene.model, scene.data)
    assert np.isnan(scene.data.xfrc_applied[1]).all()
    assert "gravity is (0.1, 0, -9.81)" in (tmp_path / "MUJOCO_LOG.TXT").read_text()
    mujoco.mj_step(scene.model, scene.data)
    assert bad.number > 0
    scene.model.opt.gravity[0] = 0.0
    mujoco.mj_resetData(scene.model, scene.data)
    mujoco.mj_step(scene.model, scene.data, nstep=30)
    np.testing.assert_array_equal(state(scene.data), alone(0.0, 30))


def _flags_off(option: mujoco.MjOption, *names: str) -> None:
    for name in names:
        option.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))


FAULTY_OPTIONS = {
    "solver is PGS": lambda o: setattr(o, "solver", int(mujoco.mjtSolver.mjSOL_PGS)),
    "noslip_iterations is 3": lambda o: setattr(o, "noslip_iterations", 3),
    "density is 1000": lambda o: setattr(o, "density", 1000.0),
    "viscosity is 1": lambda o: setattr(o, "viscosity", 1.0),
    "gravity is disabled": lambda o: _flags_off(o, "GRAVITY"),
    "spring and damper are both disabled": lambda o: _flags_off(o, "SPRING", "DAMPER"),
}


@pytest.mark.parametrize("fault", FAULTY_OPTIONS)
def test_faulty_options_are_noticed_at_a_reset_and_a_run_but_not_in_steps(fault):
    """As the README of the plugin says."""
    scene, warned = cube(custom=DRAG), []
    mujoco.mj_step(scene.model, scene.data)
    FAULTY_OPTIONS[fault](scene.model.opt)
    mujoco.set_mju_user_warning(warned.append)
    try:
        mujoco.mj_step(scene.model, scene.data)
        assert warned == []
        assert scene.data.xfrc_applied[1, 2] > 0.0
        with pytest.raises(ModelError, match=fault):
            simulate(scene, 1.0)
        mujoco.mj_resetData(scene.model, scene.data)
        assert len(warned) == 1
        assert fault in warned[0]
        mujoco.mj_forward(scene.model, scene.data)
    finally:
        mujoco.set_mju_user_warning(None)
    is_called = "damper" not in fault
    np.testing.assert_array_equal(scene.data.xfrc_applied[1, 2], np.nan if is_called else 0.0)


IMMEDIATE_CHANGES = {
    "body_mass": lambda m: m.body_mass.__setitem__(1, 300.0),
    "body_inertia": lambda m: m.body_inertia.__setitem__((1, 0), 40.0),
    "body_ipos": lambda m: m.body_ipos.__setitem__((1, 2), -0.2),
    "body_iquat": lambda m: m.body_iquat.__setitem__(1, [0.8, 0.0, 0.6, 0.0]),
    "geom_pos": lambda m: m.geom_pos.__setitem__((0, 2), 0.3),
    "geom_quat": lambda m: m.geom_quat.__setitem__(0, [0.6, 0.8, 0.0, 0.0]),
    "timestep": lambda m: setattr(m.opt, "timestep", 0.01),
}


@pytest.mark.parametrize("field", IMMEDIATE_CHANGES)
def test_other_changes_act_at_once(field):
    """It acts at once, as in a state that is made afterwards, to the bit."""
    ends = []
    for changes_first in (True, False):
        scene = barge()
        data = scene.data
        IMMEDIATE_CHANGES[field](scene.model)
        mujoco.mj_setConst(scene.model, mujoco.MjData(scene.model))
        if changes_first:
            data = mujoco.MjData(scene.model)
        mujoco.mj_step(scene.model, data, nstep=20)
        ends.append(state(data))
    unchanged = barge()
    mujoco.mj_step(unchanged.model, unchanged.data, nstep=20)
    assert np.abs(ends[0] - state(unchanged.data)).max() > 1e-4
    np.testing.assert_array_equal(*ends)


def test_a_changed_mass_gives_the_known_acceleration():
    scene = cube(custom="")
    scene.model.body_mass[1] = 300.0
    mujoco.mj_setConst(scene.model, scene.data)
    mujoco.mj_forward(scene.model, scene.data)
    expected = (1025.0 * 0.5 - 300.0) * 9.81 / 300.0
    assert scene.data.qacc[2] == pytest.approx(expected, rel=1e-9)


def test_a_moved_centre_of_mass_does_not_move_the_hull():
    """Ballast that moves sideways keeps the force and adds force x displacement to the torque."""
    scene, rows = barge(custom=LINEAR), []
    for displacement in (0.0, 0.1):
        scene.model.body_ipos[1, 0] += displacement
        mujoco.mj_forward(scene.model, scene.data)
        rows.append(scene.data.xfrc_applied[1].copy())
    change = np.cross(rows[0][:3], [0.1, 0.0, 0.0])
    assert abs(change[1]) > 10.0
    np.testing.assert_allclose(rows[1], rows[0] + [0, 0, 0, *change], atol=1e-9)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_the_force_that_a_user_means_is_the_inverse_without_the_rows_of_the_water(integrator):
    """As sim/plugin/README.md says, with drag, added mass and a push, too."""
    custom = (
        '<numeric name="drag" data="1 1 0.1"/><numeric name="added_mass" data="1 1 1 0 0 0"/>'
        '<numeric name="wave_a" data="0.1 4 0 0"/>'
    )
    body = CUBE.replace("</body>", "<body/></body>")
    option = f'<option integrator="{integrator}"/>'
    model = mujoco.MjModel.from_xml_string(xml(body, custom=custom, option=option))
    data = mujoco.MjData(model)
    data.qvel[:], data.xfrc_applied[1, 0] = [0.1, 0.2, 0.3, 0.1, 0.2, -0.1], 50.0
    data.qfrc_applied[:] = expected = [10.0, 20.0, 30.0, 1.0, 2.0, 3.0]
    mujoco.mj_forward(model, data)
    mujoco.mj_inverse(model, data)
    rows = np.zeros(model.nv)
    for body in Buoyancy.of(model).bodies:
        force, torque = np.split(data.xfrc_applied[body], 2)
        mujoco.mj_applyFT(model, data, force, torque, data.xipos[body], body, rows)
    assert np.abs(rows).max() > 1000.0
    round_off = 1e-8
    np.testing.assert_allclose(data.qfrc_inverse - rows, expected, atol=round_off)
