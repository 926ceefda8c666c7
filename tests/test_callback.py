"""MuJoCo's one passive callback: shared by scenes, threads, copies and what users have set."""

import copy
import ctypes
import pickle
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from hashlib import sha256

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from mujoco.batch import Batch
from scenes import CUBE, WAVES, model, xml

from sim import Buoyancy, Scene, simulate

DRAG = '<numeric name="drag" data="0.2 1.0 0.005"/>'


def cube(z: float = 0.0, custom: str = WAVES + DRAG) -> Scene:
    scene = Scene.from_model(model(custom=custom))
    scene.data.qpos[2] = z
    return scene


def state(data: mujoco.MjData) -> np.ndarray:
    return np.concatenate([data.qpos, data.qvel])


def alone(z: float, steps: int) -> np.ndarray:
    scene = cube(z)
    with scene.buoyancy.installed():
        mujoco.mj_step(scene.model, scene.data, nstep=steps)
    return state(scene.data)


@pytest.mark.parametrize("threads", [1, 4])
def test_rollouts_in_threads_are_those_of_one(threads):
    """Sixteen trajectories with drag, each at its own place and time of the sea, to the bit."""
    scene = cube()
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    starts = np.empty((16, mujoco.mj_stateSize(scene.model, full)))
    rng = np.random.default_rng(0)
    for start in starts:
        scene.data.qpos[:3], scene.data.time = rng.uniform(-1.0, 1.0, 3), rng.uniform(0.0, 10.0)
        mujoco.mj_getState(scene.model, scene.data, start, full)
    datas = [mujoco.MjData(scene.model) for _ in range(threads)]
    with scene.buoyancy.installed(), rollout.Rollout(nthread=threads) as pool:
        found, _ = pool.rollout([scene.model] * 16, datas, starts, nstep=100)
    for start, end in zip(starts, found[:, -1], strict=True):
        data = mujoco.MjData(scene.model)
        mujoco.mj_setState(scene.model, data, start, full)
        with scene.buoyancy.installed():
            mujoco.mj_step(scene.model, data, nstep=100)
        expected = np.empty_like(end)
        mujoco.mj_getState(scene.model, data, expected, full)
        np.testing.assert_array_equal(end, expected)


def test_simulations_in_threads_do_not_touch_each_other():
    """Of different lengths, so that blocks end in any order; nothing is left behind."""
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
    assert mujoco.get_mjcb_passive() is None
    mujoco.MjModel.from_xml_string("<mujoco/>")  # no dead callback in the compiler's way


def test_many_threads_install_step_and_remove():
    expected = {z: alone(z, 40) for z in (0.0, 0.3)}

    def work(seed: int) -> int:
        rng, wrong = np.random.default_rng(seed), 0
        for _ in range(20):
            z = float(rng.choice([0.0, 0.3]))
            scene = scenes[seed]
            mujoco.mj_resetData(scene.model, scene.data)
            scene.data.qpos[2] = z
            with scene.buoyancy.installed():
                mujoco.mj_step(scene.model, scene.data, nstep=20)
                with scene.buoyancy.installed():
                    mujoco.mj_step(scene.model, scene.data, nstep=20)
            wrong += not np.array_equal(state(scene.data), expected[z])
        return wrong

    scenes = [cube() for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(work, range(8))) == 0
    assert mujoco.get_mjcb_passive() is None


def test_blocks_may_end_in_any_order():
    first, second = cube(), cube()
    one, other = first.buoyancy.installed(), second.buoyancy.installed()
    one.__enter__()
    other.__enter__()
    mujoco.mj_step(first.model, first.data)
    one.__exit__(None, None, None)
    mujoco.mj_step(second.model, second.data, nstep=100)
    other.__exit__(None, None, None)
    np.testing.assert_array_equal(state(second.data), alone(0.0, 100))
    assert mujoco.get_mjcb_passive() is None


@pytest.mark.parametrize("kind", ["Python", "C"])
def test_an_earlier_callback_is_still_called_and_comes_back(kind):
    calls = []
    mine = lambda model, data: calls.append(1)  # noqa: E731
    if kind == "C":
        mine = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64)(mine)
    scene, expected = cube(), alone(0.0, 10)
    mujoco.set_mjcb_passive(mine)
    try:
        with scene.buoyancy.installed():
            mujoco.mj_step(scene.model, scene.data, nstep=10)
        assert len(calls) == 10
        assert mujoco.get_mjcb_passive() is mine
        np.testing.assert_array_equal(state(scene.data), expected)
    finally:
        mujoco.set_mjcb_passive(None)


def test_install_keeps_the_forces_for_loops_that_step_by_halves():
    """mj_step2 takes the forces that mj_step1 left the time before, as dm_control steps."""
    scene = cube()
    scene.buoyancy.install()
    try:
        mujoco.mj_step1(scene.model, scene.data)
        for _ in range(50):
            mujoco.mj_step2(scene.model, scene.data)
            mujoco.mj_step1(scene.model, scene.data)
    finally:
        scene.buoyancy.uninstall()
    np.testing.assert_array_equal(state(scene.data), alone(0.0, 50))
    assert mujoco.get_mjcb_passive() is None
    with pytest.raises(ValueError, match="is not installed"):
        scene.buoyancy.uninstall()


def test_a_block_around_each_half_step_has_the_forces_too():
    """As an environment that knows nothing of the callback would write it."""
    scene = cube()
    with scene.buoyancy.installed():
        mujoco.mj_step1(scene.model, scene.data)
    for _ in range(50):
        with scene.buoyancy.installed():
            mujoco.mj_step2(scene.model, scene.data)
            mujoco.mj_step1(scene.model, scene.data)
    np.testing.assert_array_equal(state(scene.data), alone(0.0, 50))


def test_models_may_be_compiled_inside_a_block():
    scene = cube()
    with scene.buoyancy.installed():
        mujoco.mj_step(scene.model, scene.data)
        twin, other = model(custom=WAVES + DRAG), model(CUBE.replace("512.5", "300"))
        assert scene.buoyancy.calls == 1  # what is compiled is not stepped by ours
        for compiled in (twin, other):
            with Buoyancy.from_model(compiled).installed() as own:
                mujoco.mj_step(compiled, mujoco.MjData(compiled))
            assert own.calls == 1
    np.testing.assert_array_equal(state(scene.data), alone(0.0, 1))


def batch_of(scene: Scene, starts: np.ndarray, **options) -> Batch:
    batch = Batch(scene.model, nsim=len(starts), **options)
    batch.bind("qpos")[:, :3], batch.bind("time")[:] = starts[:, :3], starts[:, 3]
    return batch


STARTS = np.random.default_rng(3).uniform(-0.5, 0.5, (12, 4)) + [0.0, 0.0, 0.0, 5.0]


def one_by_one(buoyancy: Buoyancy, compiled: mujoco.MjModel, starts: np.ndarray) -> np.ndarray:
    ends = []
    for start in starts:
        data = mujoco.MjData(compiled)
        data.qpos[:3], data.time = start[:3], start[3]
        with buoyancy.installed():
            mujoco.mj_step(compiled, data, nstep=60)
        ends.append(state(data))
    return np.array(ends)


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("nthread", [1, 2])
def test_a_batch_is_its_simulations_one_by_one(nthread, persistent):
    scene = cube()
    with scene.buoyancy.installed():
        batch = batch_of(scene, STARTS, nthread=nthread, persistent=persistent)
        batch.step(nstep=60)
    ends = np.hstack([batch.bind("qpos"), batch.bind("qvel")])
    np.testing.assert_array_equal(ends, one_by_one(scene.buoyancy, scene.model, STARTS))
    assert len(np.unique(ends, axis=0)) == len(STARTS)


@pytest.mark.parametrize("field", ["body_mass", "body_ipos", "geom_pos"])
def test_expanded_fields_of_a_batch_act_as_in_a_model_of_their_own(field):
    scene, rng = barge(), np.random.default_rng(1)
    values = getattr(scene.model, field) * rng.uniform(0.8, 1.2, (len(STARTS), 1, 1))
    values = values.reshape(len(STARTS), *getattr(scene.model, field).shape)
    with scene.buoyancy.installed():
        batch = batch_of(scene, STARTS, nthread=2)
        batch.expand(field)[:] = values
        batch.step(nstep=60)
    ends = np.hstack([batch.bind("qpos"), batch.bind("qvel")])
    for end, start, value in zip(ends, STARTS, values, strict=True):
        own = copy.copy(scene.model)
        getattr(own, field)[:] = value
        expected = one_by_one(scene.buoyancy, own, start[None])[0]
        np.testing.assert_array_equal(end, expected)


def test_a_batch_says_which_model_it_cannot_follow():
    scene = cube()
    with scene.buoyancy.installed():
        mujoco.mj_step(scene.model, scene.data)
        batch = batch_of(scene, STARTS, nthread=2)
        batch.expand("geom_size")[:] = 0.4
        with pytest.warns(UserWarning, match="no state of its model"):  # noqa: SIM117
            with scene.buoyancy.installed():
                batch.step()


def test_methods_of_the_interpreter_refuse_batches_in_words():
    scene = Scene.from_model(model(custom=WAVES), method="reference")
    with scene.buoyancy.installed():
        mujoco.mj_step(scene.model, scene.data)
        with pytest.raises(ValueError, match="callback"):
            Batch(scene.model, nsim=2).step()


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "RK4"])
def test_one_call_of_many_steps_in_many_threads_is_many_calls_in_one(integrator):
    option = f'<option integrator="{integrator}"/>'
    scene = Scene.from_model(model(custom=WAVES + DRAG, option=option))

    def run(steps: int) -> bytes:
        data, digest = mujoco.MjData(scene.model), sha256()
        data.qpos[2] = 0.3
        for step in range(0, 1000, steps):
            mujoco.mj_step(scene.model, data, nstep=steps)
            if (step + steps) % 100 == 0:
                digest.update(state(data))
        return digest.digest()

    with scene.buoyancy.installed():
        expected = run(1)
        for threads in (1, 2, 8):
            with ThreadPoolExecutor(threads) as pool:
                assert set(pool.map(run, [100, 1, 10, 50, 1, 100, 100, 10])) == {expected}


def test_the_latest_block_of_a_model_acts_and_then_the_earlier_one_again():
    compiled = model(custom=WAVES)
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    outer, inner = (Buoyancy.from_model(compiled, m) for m in ("linear", "patches"))
    pushes = [b.wrenches(data)[0, 2] for b in (outer, inner)]
    assert pushes[0] != pytest.approx(pushes[1], rel=1e-5)
    with outer.installed():
        for acting, push in ((inner, pushes[1]), (None, pushes[0])):
            with acting.installed() if acting else nullcontext():
                mujoco.mj_forward(compiled, data)
            assert data.xfrc_applied[1, 2] == pytest.approx(push, rel=1e-12)
    assert (outer.calls, inner.calls) == (1, 1)


def test_a_model_with_more_in_it_is_no_copy():
    """Though MuJoCo's signature is the same: numbers of custom fields do not count there."""
    scene = cube(custom=WAVES + '<numeric name="mine" data="1"/>')
    other = model(custom=WAVES + '<numeric name="mine" data="1 2 3"/>')
    assert other.signature == scene.model.signature
    with (
        pytest.warns(UserWarning, match="one of the same structure was, with other numbers"),
        scene.buoyancy.installed(),
    ):
        mujoco.mj_forward(other, mujoco.MjData(other))


def test_a_copy_of_a_model_floats_as_the_model():
    scene = cube()
    copied = copy.copy(scene.model)
    data = mujoco.MjData(copied)
    data.qpos[2] = 0.0
    with scene.buoyancy.installed():
        mujoco.mj_step(copied, data, nstep=30)
    np.testing.assert_array_equal(state(data), alone(0.0, 30))


def test_a_copy_with_a_timestep_of_its_own_is_stepped_by_that():
    """The implicit step of the drag depends on it."""
    scene = cube()
    copied = copy.copy(scene.model)
    copied.opt.timestep *= 5
    data = mujoco.MjData(copied)
    data.qpos[2] = 0.0
    with scene.buoyancy.installed():
        mujoco.mj_step(copied, data, nstep=30)
    own = cube()
    own.model.opt.timestep *= 5
    with own.buoyancy.installed():
        mujoco.mj_step(own.model, own.data, nstep=30)
    np.testing.assert_array_equal(state(data), state(own.data))


def test_a_copy_of_several_models_is_refused():
    twins = [cube(), cube()]
    copied = copy.copy(twins[0].model)
    for twin in twins:
        twin.buoyancy.install()
    try:
        with pytest.raises(mujoco.FatalError, match="copy of several that are installed"):
            mujoco.mj_forward(copied, mujoco.MjData(copied))
        mujoco.MjModel.from_xml_string(xml(custom=WAVES + DRAG))  # one that is compiled is none
        mujoco.mj_step(twins[0].model, twins[0].data)  # they themselves are known
    finally:
        for twin in twins:
            twin.buoyancy.uninstall()


def test_a_block_in_which_another_model_is_stepped_warns():
    scene = cube()
    other = model(CUBE.replace("512.5", "300"))
    data = mujoco.MjData(other)
    with (
        pytest.warns(UserWarning, match="no state of its model was stepped"),
        scene.buoyancy.installed(),
    ):
        mujoco.mj_step(other, data)


def test_a_force_of_ones_own_in_the_water_s_rows_is_said_to_be_overwritten():
    scene = cube()
    scene.data.xfrc_applied[1, 0] = 5.0
    with pytest.warns(UserWarning, match="push such a body by qfrc_applied"):  # noqa: SIM117
        with scene.buoyancy.installed():
            mujoco.mj_step(scene.model, scene.data, nstep=5)
    np.testing.assert_array_equal(state(scene.data), alone(0.0, 5))


def test_a_buoyancy_says_how_it_is_made_anew_elsewhere():
    with pytest.raises(TypeError, match=r"make a new one there with Buoyancy.from_model\(model\)"):
        pickle.dumps(Buoyancy.from_model(model()))


REFUSED = {
    "geom_size": lambda m: m.geom_size.__setitem__(0, 0.4),
    "numeric_data": lambda m: m.numeric_data.__setitem__(0, 500.0),
    "mesh_vert": lambda m: m.mesh_vert.__imul__(2.0),
}

LAGGING = """
    <body name="barge" pos="0 0 -0.4"><freejoint/>
      <geom name="barge" type="mesh" mesh="wedge" pos="0.3 -0.2 0.1" euler="20 30 40"
            density="500"/>
      <geom type="sphere" size="0.1" pos="-0.4 0.6 0.1" density="3000"/></body>"""
WEDGE = """<mesh name="wedge" inertia="exact" vertex="0 0 0  1 0 0  0 1 0  0 0 1"
             face="0 2 1  0 1 3  0 3 2  1 2 3"/>"""
LINEAR = '<text name="buoyancy_method" data="linear"/>'


def barge(custom: str = WAVES + DRAG + LINEAR) -> Scene:
    """A hull off its body's origin and turned."""
    return Scene.from_model(model(LAGGING, ("barge",), custom, assets=WEDGE))


@pytest.mark.parametrize("field", REFUSED)
def test_what_the_hulls_were_made_from_may_not_change_behind_their_back(field):
    """Not before a block, nor inside one."""
    scene = cube() if field == "geom_size" else barge()
    with scene.buoyancy.installed():
        mujoco.mj_step(scene.model, scene.data)
        REFUSED[field](scene.model)
        with pytest.raises(mujoco.FatalError, match=f"{field} changed after its Buoyancy was made"):
            mujoco.mj_step(scene.model, scene.data)
    for enter in (lambda: scene.buoyancy.installed().__enter__(), scene.buoyancy.install):
        with pytest.raises(ValueError, match=f"the model's {field} changed after this Buoyancy"):
            enter()
    assert mujoco.get_mjcb_passive() is None


def test_gravity_off_the_vertical_is_refused():
    scene = cube()
    scene.model.opt.gravity[0] = 0.1
    with (
        scene.buoyancy.installed(),
        pytest.raises(mujoco.FatalError, match="gravity is not along -z any more"),
    ):
        mujoco.mj_step(scene.model, scene.data)


def test_threads_of_a_rollout_are_refused_at_the_end_of_the_block():
    """Nobody there could catch an error: the state is given up and the block says why."""
    scene = cube()
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty((2, mujoco.mj_stateSize(scene.model, full)))
    for row in start:
        mujoco.mj_getState(scene.model, scene.data, row, full)
    datas = [mujoco.MjData(scene.model) for _ in range(2)]
    block = scene.buoyancy.installed()
    block.__enter__()
    scene.model.geom_size[0] = 0.4
    with rollout.Rollout(nthread=2) as pool:
        pool.rollout([scene.model] * 2, datas, start, nstep=3)
    with pytest.raises(ValueError, match="geom_size changed after its Buoyancy was made"):
        block.__exit__(None, None, None)
    assert any(data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number for data in datas)


FOLLOWED = {
    "body_mass": lambda m: m.body_mass.__setitem__(1, 300.0),
    "body_inertia": lambda m: m.body_inertia.__setitem__((1, 0), 40.0),
    "body_ipos": lambda m: m.body_ipos.__setitem__((1, 2), -0.2),
    "body_iquat": lambda m: m.body_iquat.__setitem__(1, [0.8, 0.0, 0.6, 0.0]),
    "geom_pos": lambda m: m.geom_pos.__setitem__((0, 2), 0.3),
    "geom_quat": lambda m: m.geom_quat.__setitem__(0, [0.6, 0.8, 0.0, 0.0]),
    "gravity": lambda m: m.opt.gravity.__setitem__(2, -1.62),
    "timestep": lambda m: setattr(m.opt, "timestep", 0.01),
}


@pytest.mark.parametrize("field", FOLLOWED)
def test_what_else_is_changed_acts(field):
    """As it does in a Buoyancy that is made afterwards, to the bit; a sea's gravity, which it takes
    for another measure of time, to round-off."""
    ends = []
    for changes_first in (True, False):
        scene = barge()
        buoyancy = scene.buoyancy
        if changes_first:
            FOLLOWED[field](scene.model)
            buoyancy = Buoyancy.from_model(scene.model)
        with buoyancy.installed():
            FOLLOWED[field](scene.model)
            mujoco.mj_setConst(scene.model, mujoco.MjData(scene.model))
            mujoco.mj_step(scene.model, scene.data, nstep=20)
        ends.append(state(scene.data))
    unchanged = barge()
    with unchanged.buoyancy.installed():
        mujoco.mj_step(unchanged.model, unchanged.data, nstep=20)
    assert np.abs(ends[0] - state(unchanged.data)).max() > 1e-4
    np.testing.assert_allclose(*ends, atol=1e-11 if field == "gravity" else 0.0, rtol=0.0)


def test_a_changed_mass_is_the_closed_form():
    scene = cube(custom="")
    scene.model.body_mass[1] = 300.0
    mujoco.mj_setConst(scene.model, scene.data)
    with scene.buoyancy.installed():
        mujoco.mj_forward(scene.model, scene.data)
    expected = (1025.0 * 0.5 - 300.0) * 9.81 / 300.0
    assert scene.data.qacc[2] == pytest.approx(expected, rel=1e-9)


def test_a_moved_centre_of_mass_leaves_the_hull_where_it_is():
    """Ballast moved to the side leaves the push, and adds to its torque push x way."""
    scene, rows = barge(custom=LINEAR), []
    with scene.buoyancy.installed():
        for way in (0.0, 0.1):
            scene.model.body_ipos[1, 0] += way
            mujoco.mj_forward(scene.model, scene.data)
            rows.append(scene.data.xfrc_applied[1].copy())
    change = np.cross(rows[0][:3], [0.1, 0.0, 0.0])
    assert abs(change[1]) > 10.0
    np.testing.assert_allclose(rows[1], rows[0] + [0, 0, 0, *change], atol=1e-9)
