"""MuJoCo's one passive callback: shared by scenes, threads, copies and what users have set."""

import copy
import ctypes
import pickle
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from scenes import CUBE, WAVES, model

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
        with pytest.raises(ValueError, match="copy of 2 models that are installed"):
            mujoco.mj_forward(copied, mujoco.MjData(copied))
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


CHANGES = {
    "geom_size": lambda m: m.geom_size.__setitem__(0, 0.4),
    "geom_pos": lambda m: m.geom_pos.__setitem__((0, 2), 0.1),
    "body_ipos": lambda m: m.body_ipos.__setitem__((1, 2), -0.2),
    "body_mass": lambda m: m.body_mass.__setitem__(1, 100.0),
    "numeric_data": lambda m: m.numeric_data.__setitem__(0, 500.0),
    "gravity": lambda m: m.opt.gravity.__setitem__(2, -1.62),
}


@pytest.mark.parametrize("field", CHANGES)
def test_what_the_hulls_were_made_from_may_not_change_behind_their_back(field):
    scene = cube()
    CHANGES[field](scene.model)
    for enter in (lambda: scene.buoyancy.installed().__enter__(), scene.buoyancy.install):
        with pytest.raises(ValueError, match=f"the model's {field} changed after this Buoyancy"):
            enter()
    assert mujoco.get_mjcb_passive() is None
    made_anew = Buoyancy.from_model(scene.model)
    with made_anew.installed():
        mujoco.mj_step(scene.model, scene.data)


def test_what_concerns_no_hull_may_change():
    """A new mass acts where nothing but MuJoCo takes it; the timestep always."""
    scene = cube(custom="")
    scene.model.body_mass[1] = 300.0
    scene.model.opt.timestep = 0.001
    mujoco.mj_setConst(scene.model, scene.data)
    with scene.buoyancy.installed():
        mujoco.mj_forward(scene.model, scene.data)
    expected = (1025.0 * 0.5 - 300.0) * 9.81 / 300.0
    assert scene.data.qacc[2] == pytest.approx(expected, rel=1e-9)
