"""Waterline as a plugin of MuJoCo: pushes, copies, changes, refusals, sensors, pictures."""

import copy
import gc
import pickle
import runpy
import subprocess
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from mujoco.batch import Batch
from scenes import CUBE, WATER, WAVES, afloat, model, xml

import sim
from independent import MODELS, REPOSITORY
from sim import Buoyancy, ModelError, Note, Scene
from sim.plugin import seam

DRAG = '<numeric name="drag" data="0.2 1.0 0.005"/>'
FULLPHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS
INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
ROW = 6  # where the cube's row of xfrc_applied begins among all numbers of it


def dry(**kwargs) -> mujoco.MjModel:
    """The same model out of the water, and weightless: it shows what a push alone does."""
    compiled = mujoco.MjModel.from_xml_string(xml(**kwargs).replace(WATER, ""))
    compiled.opt.gravity[:] = 0.0
    return compiled


def stepped(compiled: mujoco.MjModel, steps: int = 50) -> mujoco.MjData:
    data = mujoco.MjData(compiled)
    mujoco.mj_step(compiled, data, nstep=steps)
    return data


def state_of(compiled: mujoco.MjModel, data: mujoco.MjData, kind: mujoco.mjtState) -> np.ndarray:
    state = np.empty(mujoco.mj_stateSize(compiled, kind))
    mujoco.mj_getState(compiled, data, state, kind)
    return state


# Pushes: what a user writes into xfrc_applied acts as it would on a dry model


def push_once(compiled, data, step):
    if step == 0:
        data.xfrc_applied[1, :2] = 100.0, 20.0


def push_each_step(compiled, data, step):
    data.xfrc_applied[1, :2] = 100.0, 20.0


def zero_and_push(compiled, data, step):
    data.xfrc_applied[:] = 0.0
    data.xfrc_applied[1, :2] = 100.0, 20.0


def push_one_component(compiled, data, step):
    if step in (10, 60):
        data.xfrc_applied[1, 1] = 50.0 if step == 10 else 0.0


def push_for_a_while(compiled, data, step):
    data.xfrc_applied[1, 0] = 80.0 * (20 <= step < 50)


def drag_by_the_mouse(compiled, data, step):
    mouse = mujoco.MjvPerturb()
    mouse.select, mouse.active = 1, mujoco.mjtPertBit.mjPERT_TRANSLATE
    mouse.localmass, mouse.scale = 100.0, 1.0
    mouse.refpos[:] = mouse.refselpos[:] = data.xpos[1] + [0.1, 0.05, 0.0]
    mouse.refquat[:] = data.xquat[1]
    data.xfrc_applied[:] = 0.0
    mujoco.mjv_applyPerturbForce(compiled, data, mouse)


def restore_fullphysics(compiled, data, step):
    """The push that stands stays, as it does in a dry model."""
    data.xfrc_applied[1, 0] = 100.0
    if step == 30:
        KEPT[compiled] = state_of(compiled, data, FULLPHYSICS)
    if step == 60:
        mujoco.mj_setState(compiled, data, KEPT[compiled], FULLPHYSICS)


def restore_integration(compiled, data, step):
    """The push of then comes back."""
    if step == 0:
        data.xfrc_applied[1, :2] = 100.0, 0.0
    if step == 30:
        KEPT[compiled] = state_of(compiled, data, INTEGRATION)
        data.xfrc_applied[1, :2] = 0.0, 70.0
    if step == 60:
        mujoco.mj_setState(compiled, data, KEPT[compiled], INTEGRATION)


def reset_in_between(compiled, data, step):
    if step == 0:
        data.xfrc_applied[1, 0] = 100.0
    if step == 50:
        mujoco.mj_resetData(compiled, data)
    if step == 70:
        data.xfrc_applied[1, 1] = 30.0


KEPT: dict[mujoco.MjModel, np.ndarray] = {}

PUSHES = (
    push_once, push_each_step, zero_and_push, push_one_component, push_for_a_while,
    drag_by_the_mouse, restore_fullphysics, restore_integration, reset_in_between,
)  # fmt: skip


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("push", PUSHES, ids=lambda push: push.__name__)
def test_a_push_acts_on_a_floating_body_as_on_a_dry_one(push, integrator):
    """Along the surface of still water, where the water itself does nothing."""
    option = f'<option timestep="0.01" integrator="{integrator}"/>'
    ends = []
    for compiled in (model(option=option), dry(option=option)):
        data = mujoco.MjData(compiled)
        for step in range(100):
            push(compiled, data, step)
            mujoco.mj_step(compiled, data)
        ends.append(np.concatenate([data.qpos[:2], data.qvel[:2]]))
    assert np.abs(ends[1][:2]).max() > 0.002
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)  # round-off


def test_a_push_of_100_newtons_moves_500_kilograms_by_a_decimetre_in_a_second():
    compiled = model(CUBE.replace("512.5", "500"), option='<option timestep="0.001"/>')
    data = mujoco.MjData(compiled)
    data.xfrc_applied[1, 0] = 100.0
    mujoco.mj_step(compiled, data, nstep=1000)
    assert data.qpos[0] == pytest.approx(0.100, abs=2e-4)  # Euler's first order


def test_the_controls_of_a_rollout_push():
    ends = []
    for compiled in (model(), dry()):
        start = state_of(compiled, mujoco.MjData(compiled), FULLPHYSICS)
        pushes = np.zeros((1, 80, 12))
        pushes[0, :, ROW] = 100.0
        kind = mujoco.mjtState.mjSTATE_XFRC_APPLIED
        found, _ = rollout.rollout(
            compiled, mujoco.MjData(compiled), start[None], pushes, control_spec=kind
        )
        ends.append(found[0, -1, 1:3])
    assert ends[1][0] > 0.01
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)


def test_the_row_is_the_push_plus_the_water_and_pushes_tells_them_apart():
    compiled = model(custom=WAVES + DRAG)
    data, buoyancy = stepped(compiled), Buoyancy.of(compiled)
    alone = copy.copy(data)
    push = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    data.xfrc_applied[1] = push
    np.testing.assert_array_equal(buoyancy.pushes(data), [push])  # before a step too
    for each in (data, alone):
        mujoco.mj_forward(compiled, each)
    np.testing.assert_array_equal(buoyancy.pushes(data), [push])
    np.testing.assert_array_equal(buoyancy.pushes(alone), np.zeros((1, 6)))
    difference = data.xfrc_applied[1] - alone.xfrc_applied[1]
    np.testing.assert_allclose(difference, push, atol=1e-11)  # round-off of some 5000 N


def test_forward_again_and_again_never_counts_the_water_twice():
    compiled = model(custom=WAVES + DRAG)
    data = stepped(compiled)
    data.xfrc_applied[1, :3] = 7.0
    mujoco.mj_forward(compiled, data)
    first = data.xfrc_applied.copy()
    for call in (mujoco.mj_forward, mujoco.mj_step1, mujoco.mj_inverse, mujoco.mj_forward):
        call(compiled, data)
        np.testing.assert_array_equal(data.xfrc_applied, first)


@pytest.mark.parametrize("kind", [FULLPHYSICS, INTEGRATION], ids=str)
def test_a_state_that_another_mjdata_takes_goes_on_to_the_bit(kind):
    compiled = model(custom=WAVES + DRAG)
    data = mujoco.MjData(compiled)
    data.xfrc_applied[1, 0] = 30.0 if kind == INTEGRATION else 0.0
    mujoco.mj_step(compiled, data, nstep=40)
    other = stepped(compiled, 7)
    other.xfrc_applied[:] = 0.0
    mujoco.mj_setState(compiled, other, state_of(compiled, data, kind), kind)
    for each in (data, other):
        mujoco.mj_step(compiled, each, nstep=40)
    np.testing.assert_array_equal(other.qpos, data.qpos)


def test_a_state_taken_right_after_another_was_restored_counts_no_water_twice():
    """FULLPHYSICS brings back what the plugin remembers and not the row; INTEGRATION, taken then,
    brings back both, from two different times. So does mjd_transitionFD, which restores a state
    many times."""
    compiled = model(custom=WAVES + DRAG)
    data = mujoco.MjData(compiled)
    data.xfrc_applied[1, 0] = 50.0
    mujoco.mj_step(compiled, data, nstep=50)
    slopes = np.zeros((12, 12))
    mujoco.mjd_transitionFD(compiled, data, 1e-6, True, slopes, None, None, None)
    kept = state_of(compiled, data, INTEGRATION)
    ends = []
    for _ in range(3):
        mujoco.mj_setState(compiled, data, kept, INTEGRATION)
        np.testing.assert_array_equal(Buoyancy.of(compiled).pushes(data)[0, :3], [50.0, 0.0, 0.0])
        mujoco.mj_step(compiled, data, nstep=30)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(ends[1:], ends[:-1])


# Copies, pickles, other processes


def test_copies_go_on_to_the_bit():
    compiled = model(custom=WAVES + DRAG)
    data = stepped(compiled)
    data.xfrc_applied[1, 1] = 40.0
    mujoco.mj_step(compiled, data)
    into = stepped(compiled, 3)
    mujoco.mj_copyData(into, compiled, data)
    others = [copy.copy(data), copy.deepcopy(data), into]
    for each in (data, *others):
        mujoco.mj_step(compiled, each, nstep=50)
    for other in others:
        np.testing.assert_array_equal(other.qpos, data.qpos)


def test_an_unpickled_state_goes_on_to_the_bit_and_leaves_the_first_one_alone():
    """MuJoCo's pickles bring along the plugin's word of the first state."""
    compiled = model(custom=WAVES + DRAG)
    data = mujoco.MjData(compiled)
    data.xfrc_applied[1, 1] = 40.0
    mujoco.mj_step(compiled, data, nstep=50)
    twins = [pickle.loads(pickle.dumps((compiled, data))) for _ in range(3)]
    mujoco.mj_resetData(*twins[2])
    assert twins[2][1].plugin_data[0] != data.plugin_data[0]
    del twins[1]  # one that was never stepped
    twin_model, twin = twins[0]
    for _ in range(10):
        mujoco.mj_step(twin_model, twin, nstep=5)
        mujoco.mj_step(compiled, data, nstep=5)
    np.testing.assert_array_equal(twin.qpos, data.qpos)
    assert Buoyancy.of(compiled).calls(data) == 100
    assert Buoyancy.of(twin_model).calls(twin) == 50


def step_there(compiled: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """In another process, where the model was never compiled."""
    mujoco.mj_step(compiled, data, nstep=50)
    return data.qpos.copy()


@pytest.mark.parametrize("start", ["spawn", "fork"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_another_process_goes_on_to_the_bit(start):
    compiled = model(custom=WAVES + DRAG)
    data = stepped(compiled)
    with ProcessPoolExecutor(1, mp_context=get_context(start)) as pool:
        end = pool.submit(step_there, compiled, data).result(timeout=120)
    mujoco.mj_step(compiled, data, nstep=50)
    np.testing.assert_array_equal(end, data.qpos)


END = """
import mujoco, sim
from scenes import DATA_CYCLE, model
compiled = model()
kept = [mujoco.MjData(compiled) for _ in range(5)]
mujoco.mj_step(compiled, kept[0])
class Cycle: pass
cycle = Cycle()
cycle.itself, cycle.data = cycle, mujoco.MjData(compiled)
"""


def test_states_may_end_after_the_interpreter():
    program = END.replace("DATA_CYCLE, ", "")
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=REPOSITORY / "tests", capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")


def test_a_thousand_models_leave_no_growth():
    """Contexts are dropped with what uses them, but for the last few."""
    text = xml(custom=WAVES)
    for i in range(1000):
        compiled = mujoco.MjModel.from_xml_string(text.replace("512.5", str(400 + i % 7)))
        data = mujoco.MjData(compiled)
        if i % 40 == 0:  # each of these is another sea
            mujoco.MjModel.from_xml_string(text.replace("4.0 0 0", f"{4.0 + 0.001 * i} 0 0"))
    del compiled, data
    gc.collect()
    assert sum(context.users for context in seam.contexts) <= 40  # of other tests
    assert len(list(seam.contexts)) <= 60
    assert len(seam.homes._slabs) == 1


def test_models_with_the_same_content_share_a_context():
    """Whatever their masses, as long as nothing is made from these."""
    light, heavy = model(), model(CUBE.replace('density="512.5"', 'mass="900"'))
    data = [mujoco.MjData(each) for each in (light, light, heavy)]
    assert seam.context_of(light) is seam.context_of(heavy)
    assert seam.context_of(light).users >= len(data)
    matrix = f'<numeric name="added_mass" data="{"100 0 0 0 0 0 0 " * 5}100"/>'
    light, heavy = (model(body, custom=matrix) for body in (CUBE, CUBE.replace("512.5", "300")))
    assert seam.context_of(light) is not seam.context_of(heavy)


# Changes of a compiled model


def test_mass_acts_at_once_and_what_a_hull_is_made_of_at_the_next_reset():
    compiled = model()
    data = stepped(compiled, 1)
    for factor, expected in ((0.5, 9.81), (2.0, 0.0)):
        compiled.body_mass[1] *= factor
        mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
        mujoco.mj_forward(compiled, data)
        assert data.qacc[2] == pytest.approx(expected, abs=0.01)
    compiled.geom_size[0] *= 0.5
    mujoco.mj_forward(compiled, data)
    assert data.xfrc_applied[1, 2] == pytest.approx(512.5 * 9.81, rel=1e-3)
    mujoco.mj_resetData(compiled, data)
    mujoco.mj_forward(compiled, data)
    assert data.xfrc_applied[1, 2] == pytest.approx(512.5 * 9.81 / 8.0)
    assert Buoyancy.of(compiled).floats[0].method.hull.volume == pytest.approx(0.125)


def test_gravity_and_waves_act_from_the_next_reset_on():
    compiled = model(custom='<numeric name="wave_a" data="0.1 4 0 0"/>')
    data = mujoco.MjData(compiled)
    compiled.opt.gravity[2] = -1.62
    compiled.numeric("wave_a").data[0] = 0.3
    mujoco.mj_resetData(compiled, data)
    mujoco.mj_forward(compiled, data)
    fresh = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, fresh)
    np.testing.assert_array_equal(data.xfrc_applied, fresh.xfrc_applied)
    sea = Buoyancy.of(compiled).sea
    assert (sea.gravity, sea.waves[0].amplitude) == (1.62, 0.3)


def test_a_state_from_before_a_change_is_in_the_water_of_today():
    """FULLPHYSICS holds which water a state was reset with, for the worlds of a batch."""
    compiled = model()
    data = stepped(compiled, 1)
    before = state_of(compiled, data, FULLPHYSICS)
    compiled.geom_size[0] *= 0.5
    mujoco.mj_resetData(compiled, data)
    mujoco.mj_setState(compiled, data, before, FULLPHYSICS)
    mujoco.mj_forward(compiled, data)
    assert data.xfrc_applied[1, 2] == pytest.approx(512.5 * 9.81 / 8.0)


def test_a_reset_that_cannot_be_followed_gives_nan_until_it_is_mended(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo keeps a log there
    compiled = model(custom='<numeric name="wave_a" data="0.1 4 0 0"/>')
    data = mujoco.MjData(compiled)
    compiled.numeric("wave_a").data[0] = 3.0
    mujoco.mj_resetData(compiled, data)
    assert "the waves fold" in capfd.readouterr().err
    mujoco.mj_forward(compiled, data)
    assert np.isnan(data.xfrc_applied[1]).all()
    compiled.numeric("wave_a").data[0] = 0.1
    mujoco.mj_resetData(compiled, data)
    mujoco.mj_forward(compiled, data)
    assert data.xfrc_applied[1, 2] > 1000.0


def test_options_that_were_changed_are_looked_at_by_the_next_reset(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    compiled = model(custom=DRAG)
    data = mujoco.MjData(compiled)
    compiled.opt.solver = mujoco.mjtSolver.mjSOL_PGS
    mujoco.mj_resetData(compiled, data)
    assert "option solver is PGS" in capfd.readouterr().err


def test_worlds_of_a_batch_have_masses_and_sizes_of_their_own():
    compiled = model(custom=WAVES + DRAG)
    masses, sizes = np.linspace(300.0, 700.0, 8), np.linspace(0.4, 0.5, 8)
    batch = Batch(compiled, nsim=8, nthread=2, persistent=True)
    batch.expand("body_mass")[:, 1] = masses
    batch.step(nstep=20)
    heights = batch.bind("qpos")[:, 2].copy()
    assert (np.diff(heights) < 0.0).all()
    for i in (0, 7):
        own = copy.copy(compiled)
        own.body_mass[1] = masses[i]
        np.testing.assert_array_equal(stepped(own, 20).qpos[2], heights[i])
    batch.expand("geom_size")[:, 0] = sizes[:, None]
    batch.reset()
    batch.step()
    rows = batch.bind("xfrc_applied").reshape(8, 2, 6)
    for i in (0, 7):
        own = copy.copy(compiled)
        own.body_mass[1], own.geom_size[0] = masses[i], sizes[i]
        np.testing.assert_array_equal(stepped(own, 1).xfrc_applied, rows[i])


# Refusals and notes


@contextmanager
def no_warnings():
    """A block in which a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_all_faults_stand_in_mujoco_s_own_error():
    faulty = xml(custom='<numeric name="drag" data="1"/><numeric name="water_ramp" data="-1"/>')
    with pytest.raises(ValueError, match="plugin->init failed") as error:
        mujoco.MjModel.from_xml_string(faulty)
    for fault in ("'drag' has 1 number;", "the water ramp is -1 s"):
        assert fault in str(error.value)


def test_faults_that_have_no_room_there_are_printed(capfd):
    many = "".join(f'<numeric name="wave_{i}" data="-1 4 0 0"/>' for i in range(20))
    with pytest.raises(ValueError, match=r"and 1\d more: see above"):
        mujoco.MjModel.from_xml_string(xml(custom=many))
    assert sum("the amplitude is -1" in line for line in capfd.readouterr().err.splitlines()) == 20
    with pytest.raises(ModelError) as error:
        afloat(custom=many)
    assert len(error.value.faults) == 20


def test_files_lie_in_the_current_folder_where_mujoco_itself_compiles(tmp_path, monkeypatch):
    """It does not tell a plugin where the MJCF file is."""
    custom = '<text name="sea_components" data="waves.csv"/>'
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"there is no file .*waves\.csv; Scene\.load searches"):
        model(custom=custom)
    waves = tmp_path / "waves.csv"
    for amplitude in (0.1, 0.125):  # a file that changes is read anew
        waves.write_text(f"amplitude,wavelength,heading,phase\n{amplitude},4,0,0\n")
        assert Buoyancy.of(model(custom=custom)).sea.waves[0].amplitude == amplitude


def test_a_percent_sign_is_no_format_of_printf():
    with pytest.raises(ValueError, match="'%s%n' is not a method"):
        model(custom='<text name="buoyancy_method" data="%s%n"/>')


def test_notes_are_said_at_compile_and_not_for_each_state():
    text = xml(CUBE.replace("512.5", "0.5"))
    with pytest.warns(Note, match="times as dense as the water") as said:
        compiled = mujoco.MjModel.from_xml_string(text)
    assert said[0].filename == __file__
    with no_warnings():
        for _ in range(3):
            mujoco.MjData(compiled)


def test_a_note_that_is_an_error_refuses_the_model():
    with no_warnings(), pytest.raises(ValueError, match="times as dense as the water"):
        model(CUBE.replace("512.5", "0.5"))


def test_a_model_without_an_instance_is_dry_and_says_how_to_mend_it():
    compiled = dry()
    for ask in (Buoyancy.of, Scene.from_model):
        with pytest.raises(ModelError, match="no instance of the plugin 'waterline'") as error:
            ask(compiled)
        assert WATER in str(error.value)


# Attached models


BOAT = f"""<mujoco model="boat">{WATER}
  <custom>{DRAG}<tuple name="buoyant"><element objtype="body" objname="hull"/></tuple></custom>
  <worldbody><body name="hull"><freejoint/>{{}}<geom type="box" size="0.5 0.3 0.1" density="400"/>
  </body></worldbody></mujoco>"""
NAMED = '<plugin instance="water"/>'


def fleet(named: bool, of_parent: bool) -> mujoco.MjSpec:
    parent = mujoco.MjSpec.from_string(f"<mujoco>{WATER if of_parent else ''}<worldbody/></mujoco>")
    for i, prefix in enumerate(("a_", "b_")):
        boat = mujoco.MjSpec.from_string(BOAT.format(NAMED if named else ""))
        parent.attach(boat, prefix=prefix, frame=parent.worldbody.add_frame(pos=[3.0 * i, 0, 0.3]))
    return parent


@pytest.mark.parametrize(
    ("named", "of_parent", "instances"), [(True, False, 2), (True, True, 3), (False, True, 1)]
)
def test_attached_boats_float_where_some_instance_comes_along(named, of_parent, instances):
    compiled = fleet(named, of_parent).compile()
    assert compiled.nplugin == instances
    data = stepped(compiled, 600)
    np.testing.assert_allclose(data.xpos[1:, 2], 0.1 - 0.2 * 400 / 1025, atol=0.02)
    assert Buoyancy.of(compiled).body_names == ("a_hull", "b_hull")
    once = Scene.load(fleet(False, False))  # which adds one
    end = stepped(once.model, 600)
    np.testing.assert_array_equal(data.qpos, end.qpos)


def test_attach_drops_an_instance_that_stands_alone():
    compiled = fleet(named=False, of_parent=False).compile()
    assert compiled.nplugin == 0
    with pytest.raises(ModelError, match=r"MjSpec\.attach copies an instance only"):
        Buoyancy.of(compiled)


# Models that somebody else wrote


ROBOT = """<mujoco><worldbody><body name="torso"><freejoint/><geom size="0.3" density="500"/>
  <body name="leg" pos="0 0 -0.5"><joint axis="0 1 0"/><geom type="capsule" size="0.05 0.2"/></body>
  </body></worldbody></mujoco>"""


def test_a_robot_is_in_the_sea_in_three_lines(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    compiled = sim.add_water(
        path, "torso", wave_swell=(0.1, 4, 0, 0), drag=(0.2, 1, 0.005)
    ).compile()
    data = mujoco.MjData(compiled)
    mujoco.mj_step(compiled, data, nstep=500)
    assert path.read_text() == ROBOT
    assert Buoyancy.of(compiled).body_names == ("torso", "leg")
    assert abs(data.qpos[2]) < 0.3
    assert Buoyancy.of(compiled).sea.waves[0].wavelength == 4.0


URDF = """<robot name="r"><link name="base">
  <inertial><mass value="60"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="1 0.5 0.2"/></geometry></collision></link></robot>"""


def test_a_urdf_floats_though_its_base_was_fixed(tmp_path):
    (tmp_path / "robot.urdf").write_text(URDF)
    compiled = sim.add_water(tmp_path / "robot.urdf", "base").compile()
    data = mujoco.MjData(compiled)
    data.qpos[2] = 0.1 - 60.0 / (1025.0 * 0.5)
    mujoco.mj_forward(compiled, data)
    np.testing.assert_allclose(data.xfrc_applied[1, 2], 60.0 * 9.81, rtol=1e-9)


def test_water_that_is_added_twice_is_there_once():
    spec = mujoco.MjSpec.from_string(ROBOT)
    sim.add_water(spec, "torso", buoyancy_method="linear", water_level=0.5)
    sim.add_water(spec, "torso", water_level=0.7)
    scene = Scene.load(spec)
    assert scene.model.nplugin == 1
    assert scene.buoyancy.sea.level == 0.7
    assert type(scene.buoyancy.floats[0].method) is sim.Linear


def test_what_cannot_be_added_is_refused_all_at_once():
    with pytest.raises(ModelError) as error:
        sim.add_water(
            mujoco.MjSpec.from_string(ROBOT), "torsi", wav_swell=(1, 2), drag="much",
            buoyancy_method=3, water_density=-1.0,
        )  # fmt: skip
    found = error.value.faults
    assert len(found) == 5
    assert found[0] == "there is no body 'torsi'; the model has torso, leg"
    assert "'wav_swell' is unknown; expected wave_<name>, sea_jonswap" in found[1]
    assert found[2] == "field 'drag': 'much' is not a row of numbers"
    assert found[3] == "field 'buoyancy_method': it takes a text, not 3"
    assert "the water density is -1" in found[4]


# Sensors and pictures


GAUGE = """<sensor><plugin name="{0}" plugin="waterline.gauge" objtype="site" objname="{0}"/>
  </sensor>"""
GAUGES = '<extension><plugin plugin="waterline.gauge"/></extension>'
SITE = CUBE.replace("</body>", '<site name="bow" pos="0.5 0.1 -0.6"/></body>')


def gauged(body: str = SITE, sensor: str = GAUGE.format("bow")) -> mujoco.MjModel:
    current = '<numeric name="water_current" data="0.3 -0.1"/>'
    return model(body, custom=WAVES + current, extra=GAUGES + sensor)


@pytest.mark.parametrize("height", [-0.4, 0.3], ids=["wet", "dry"])
def test_a_gauge_reads_the_sea_at_its_site(height):
    compiled = gauged(SITE.replace("-0.6", str(height)))
    data, sea = stepped(compiled, 100), Buoyancy.of(compiled).sea
    mujoco.mj_forward(compiled, data)
    x, y, z = data.site("bow").xpos
    elevation = float(sea.elevation(x, y, data.time))
    found = data.sensor("bow").data
    np.testing.assert_allclose(found[0], elevation, atol=1e-12)  # the solver's tolerance
    np.testing.assert_allclose(found[1], float(sea.head(x, y, z, data.time)), atol=1e-12)
    assert (found[1] > 0.0) == (height < 0.0)
    if height > 0.0:
        surface = sea.surface(x, y, data.time).velocity
        np.testing.assert_allclose(found[2:], surface, atol=1e-9)


def test_the_velocity_that_a_gauge_reads_dies_out_with_depth():
    """A single wave's is omega a e^-kd, besides the current."""
    wave = '<numeric name="wave_a" data="0.05 4 0 0"/>'
    compiled = model(SITE, custom=wave, extra=GAUGES + GAUGE.format("bow"))
    data, sea = mujoco.MjData(compiled), Buoyancy.of(compiled).sea
    k, speeds = 2.0 * np.pi / 4.0, []
    for depth in (0.5, 1.5):
        data.qpos[2] = 0.6 - depth
        mujoco.mj_forward(compiled, data)
        x, y, z = data.site("bow").xpos
        below = float(sea.elevation(x, y, 0.0)) - z
        speeds.append(np.linalg.norm(data.sensordata[2:]) * np.exp(k * below))
    np.testing.assert_allclose(speeds, np.sqrt(9.81 * k) * 0.05, rtol=1e-9)


def test_gauges_read_in_batches_and_rollouts():
    compiled = gauged()
    batch = Batch(compiled, nsim=3, nthread=2)
    batch.bind("time")[:] = [0.0, 1.0, 2.0]
    readings = batch.bind("sensordata")
    batch.step(nstep=5)
    for i, found in enumerate(readings):
        data = mujoco.MjData(compiled)
        data.time = float(i)
        mujoco.mj_step(compiled, data, nstep=5)
        np.testing.assert_array_equal(found, data.sensordata)


def test_a_gauge_without_water_and_one_without_a_site_are_refused():
    alone = xml(SITE, extra=GAUGE.format("bow")).replace(WATER, "")
    alone = alone.replace(
        "<custom>", '<extension><plugin plugin="waterline.gauge"/></extension><custom>'
    )
    with pytest.raises(ValueError, match="reads the water of 'waterline': add <extension>"):
        mujoco.MjModel.from_xml_string(alone)
    with pytest.raises(ValueError, match='needs a site: set objtype="site"'):
        gauged(sensor=GAUGE.format("cube").replace('"site"', '"body"'))


def picture(compiled: mujoco.MjModel, data: mujoco.MjData, room: int = 10_000) -> mujoco.MjvScene:
    found = mujoco.MjvScene(compiled, room)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(
        compiled, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, found
    )
    return found


def corners(scene: mujoco.MjvScene) -> np.ndarray:
    """Corners (T, 3, 3) [m] of the triangles of a picture."""
    kinds = np.array([scene.geoms[i].type for i in range(scene.ngeom)])
    found = []
    for i in np.flatnonzero(kinds == mujoco.mjtGeom.mjGEOM_TRIANGLE):
        place, sides = scene.geoms[i].pos, np.array(scene.geoms[i].mat)
        found.append([place, place + sides[:, 0], place + sides[:, 1]])
    return np.array(found, dtype=float)


def test_mujoco_s_pictures_show_the_sea_where_it_is():
    scene = Scene.load(MODELS / "trio.xml")
    compiled, data, sea = scene.model, scene.data, scene.buoyancy.sea
    mujoco.mj_step(compiled, data, nstep=200)
    data.xpos[1:] += 50.0  # what a picture shows, and not where the bodies are drawn
    data.xipos[1:, :2] += 50.0
    found = corners(picture(compiled, data))
    places = found.reshape(-1, 3)
    near = np.abs(places[:, :2] - data.xipos[1:, :2].mean(axis=0)).max(axis=1) < 5.0
    expected = sea.elevation(places[near, 0], places[near, 1], data.time)
    assert near.sum() > 1000
    np.testing.assert_allclose(places[near, 2], expected, atol=2e-5)  # single precision at 50 m
    normals = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
    assert (normals[:, 2] >= 0.0).all()
    extent = normals[:, 2].sum() / 2.0  # neighbours neither overlap nor leave gaps
    np.testing.assert_allclose(extent, np.prod(np.ptp(places[:, :2], axis=0)), rtol=1e-5)


def test_a_picture_with_little_room_shows_a_coarser_sea_and_one_without_any_none():
    compiled = model(custom=WAVES)
    data = stepped(compiled, 1)
    for room in (2, 9, 200, 10_000):
        assert picture(compiled, data, room).ngeom <= room
    assert 100 < len(corners(picture(compiled, data, 200))) < 200
    hidden = model(custom=WAVES + '<numeric name="water_drawn" data="0"/>')
    assert len(corners(picture(hidden, stepped(hidden, 1)))) == 0


# Gymnasium


def test_eight_environments_of_one_file_live_side_by_side():
    gymnasium = pytest.importorskip("gymnasium")
    program = runpy.run_path(str(REPOSITORY / "scripts" / "examples" / "environment.py"))
    make = program["HoldTheCube"]
    pushes = np.random.default_rng(0).uniform(-300.0, 300.0, (20, 8, 2))
    together = gymnasium.vector.SyncVectorEnv([make] * 8)
    together.reset(seed=list(range(8)))
    for push in pushes:
        found, *_ = together.step(push)
    for i in (0, 7):
        alone = make()
        alone.reset(seed=i)
        for push in pushes[:, i]:
            expected, *_ = alone.step(push)
        np.testing.assert_array_equal(found[i], expected)


def test_ctrl_c_ends_the_reading_of_a_model(monkeypatch):
    """It comes while MuJoCo waits for us, and would be lost if it were raised there."""

    def interrupt(model):
        raise KeyboardInterrupt

    monkeypatch.setattr(seam, "read_model", interrupt)
    with pytest.raises(KeyboardInterrupt):
        afloat(CUBE.replace("512.5", "317.25"))  # which no other test has had read
