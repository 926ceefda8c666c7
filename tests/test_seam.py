"""Waterline as a plugin of MuJoCo: pushes, processes, contexts, refusals, sensors, pictures."""

import copy
import gc
import os
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

from independent import REPOSITORY
from sim import Buoyancy, ModelError, Note, Scene
from sim.plugin import seam
from sim.plugin.context import MOST_UNUSED_CONTEXTS
from sim.plugin.native import SLAB
from sim.plugin.picture import OPACITY

DRAG = '<numeric name="drag" data="0.2 1.0 0.005"/>'
FULLPHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS
INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
ROW = 6
"""Index of the first number of the cube in a flat xfrc_applied."""

ROUND_OFF = 1e-12  # m and m/s, over 100 steps


def dry(**kwargs) -> mujoco.MjModel:
    """The same model without water and gravity, so that only pushes act."""
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


# Pushes: forces that a user writes into xfrc_applied act as on a dry model


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
    """The present push stays, as in a dry model."""
    data.xfrc_applied[1, 0] = 100.0
    if step == 30:
        SAVED[compiled] = state_of(compiled, data, FULLPHYSICS)
    if step == 60:
        mujoco.mj_setState(compiled, data, SAVED[compiled], FULLPHYSICS)


def restore_integration(compiled, data, step):
    """The push of the saved state is restored."""
    if step == 0:
        data.xfrc_applied[1, :2] = 100.0, 0.0
    if step == 30:
        SAVED[compiled] = state_of(compiled, data, INTEGRATION)
        data.xfrc_applied[1, :2] = 0.0, 70.0
    if step == 60:
        mujoco.mj_setState(compiled, data, SAVED[compiled], INTEGRATION)


def reset_in_between(compiled, data, step):
    if step == 0:
        data.xfrc_applied[1, 0] = 100.0
    if step == 50:
        mujoco.mj_resetData(compiled, data)
    if step == 70:
        data.xfrc_applied[1, 1] = 30.0


SAVED: dict[mujoco.MjModel, np.ndarray] = {}

PUSHES = (
    push_once, push_each_step, zero_and_push, push_one_component, push_for_a_while,
    drag_by_the_mouse, restore_fullphysics, restore_integration, reset_in_between,
)  # fmt: skip


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("push", PUSHES, ids=lambda push: push.__name__)
def test_a_push_acts_on_a_floating_body_as_on_a_dry_one(push, integrator):
    """The push is along the surface of still water, which exerts no force in that direction."""
    option = f'<option timestep="0.01" integrator="{integrator}"/>'
    ends = []
    for compiled in (model(option=option), dry(option=option)):
        data = mujoco.MjData(compiled)
        for step in range(100):
            push(compiled, data, step)
            mujoco.mj_step(compiled, data)
        ends.append(np.concatenate([data.qpos[:2], data.qvel[:2]]))
    assert np.abs(ends[1][:2]).max() > 0.002
    np.testing.assert_allclose(ends[0], ends[1], atol=ROUND_OFF)


def test_100_newtons_move_500_kilograms_by_a_decimetre_in_a_second():
    compiled = model(CUBE.replace("512.5", "500"), option='<option timestep="0.001"/>')
    data = mujoco.MjData(compiled)
    data.xfrc_applied[1, 0] = 100.0
    mujoco.mj_step(compiled, data, nstep=1000)
    time_integration = 2e-4  # m
    assert data.qpos[0] == pytest.approx(0.100, abs=time_integration)


def test_controls_of_a_rollout_may_push():
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
    np.testing.assert_allclose(ends[0], ends[1], atol=ROUND_OFF)


def test_xfrc_applied_is_the_push_plus_the_water():
    compiled = model(custom=WAVES + DRAG)
    data, buoyancy = stepped(compiled), Buoyancy.of(compiled)
    alone = copy.copy(data)
    push = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    data.xfrc_applied[1] = push
    np.testing.assert_array_equal(buoyancy.pushes(data), [push])  # also before a step
    for each in (data, alone):
        mujoco.mj_forward(compiled, each)
    np.testing.assert_array_equal(buoyancy.pushes(data), [push])
    np.testing.assert_array_equal(buoyancy.pushes(alone), np.zeros((1, 6)))
    difference = data.xfrc_applied[1] - alone.xfrc_applied[1]
    round_off = 1e-11  # N, of forces of 5000 N
    np.testing.assert_allclose(difference, push, atol=round_off)


def test_repeated_forward_calls_never_count_the_water_twice():
    compiled = model(custom=WAVES + DRAG)
    data = stepped(compiled)
    data.xfrc_applied[1, :3] = 7.0
    mujoco.mj_forward(compiled, data)
    first = data.xfrc_applied.copy()
    for call in (mujoco.mj_forward, mujoco.mj_step1, mujoco.mj_inverse, mujoco.mj_forward):
        call(compiled, data)
        np.testing.assert_array_equal(data.xfrc_applied, first)


@pytest.mark.parametrize("kind", [FULLPHYSICS, INTEGRATION], ids=str)
def test_a_state_continues_in_another_mjdata_to_the_bit(kind):
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


def test_a_state_saved_right_after_a_restore_counts_no_water_twice():
    """FULLPHYSICS restores the plugin's memory but not xfrc_applied. INTEGRATION, saved after that,
    restores both, from different times. mjd_transitionFD restores a state in this way many
    times."""
    compiled = model(custom=WAVES + DRAG)
    data = mujoco.MjData(compiled)
    data.xfrc_applied[1, 0] = 50.0
    mujoco.mj_step(compiled, data, nstep=50)
    slopes = np.zeros((12, 12))
    mujoco.mjd_transitionFD(compiled, data, 1e-6, True, slopes, None, None, None)
    saved = state_of(compiled, data, INTEGRATION)
    ends = []
    for _ in range(3):
        mujoco.mj_setState(compiled, data, saved, INTEGRATION)
        np.testing.assert_array_equal(Buoyancy.of(compiled).pushes(data)[0, :3], [50.0, 0.0, 0.0])
        mujoco.mj_step(compiled, data, nstep=30)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(ends[1:], ends[:-1])


# Copies, pickles, other processes


def test_copies_continue_to_the_bit():
    compiled = model(custom=WAVES + DRAG)
    data = stepped(compiled)
    data.xfrc_applied[1, 1] = 40.0
    mujoco.mj_step(compiled, data)
    into = stepped(compiled, 3)
    mujoco.mj_copyData(into, compiled, data)
    others = [copy.copy(data), copy.deepcopy(data), into]
    for each in (data, *others):
        mujoco.mj_step(compiled, each, nstep=50)
        pushes = Buoyancy.of(compiled).pushes(each)
        np.testing.assert_array_equal(pushes, [[0.0, 40.0, 0.0, 0.0, 0.0, 0.0]])
        np.testing.assert_array_equal(each.qpos, data.qpos)


def test_an_unpickled_state_continues_to_the_bit_and_leaves_the_original_unchanged():
    """MuJoCo's pickles carry the plugin's word of the original state."""
    compiled = model(custom=WAVES + DRAG)
    data = mujoco.MjData(compiled)
    data.xfrc_applied[1, 1] = 40.0
    mujoco.mj_step(compiled, data, nstep=50)
    twins = [pickle.loads(pickle.dumps((compiled, data))) for _ in range(3)]
    mujoco.mj_resetData(*twins[2])
    assert twins[2][1].plugin_data[0] != data.plugin_data[0]
    del twins[1]  # which was never stepped
    twin_model, twin = twins[0]
    for _ in range(10):
        mujoco.mj_step(twin_model, twin, nstep=5)
        mujoco.mj_step(compiled, data, nstep=5)
    np.testing.assert_array_equal(twin.qpos, data.qpos)
    np.testing.assert_array_equal(Buoyancy.of(twin_model).pushes(twin)[0, :2], [0.0, 40.0])
    assert Buoyancy.of(compiled).calls(data) == 100
    assert Buoyancy.of(twin_model).calls(twin) == 50
    del twins, twin
    gc.collect()
    mujoco.mj_step(compiled, data, nstep=20)
    assert np.isfinite(data.qpos).all()


def step_there(compiled: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Continue in another process, which has not compiled the model."""
    mujoco.mj_step(compiled, data, nstep=50)
    return data.qpos.copy()


@pytest.mark.parametrize("start", ["spawn", "fork"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_another_process_continues_to_the_bit(start):
    compiled = model(custom=WAVES + DRAG)
    data = stepped(compiled)
    with ProcessPoolExecutor(1, mp_context=get_context(start)) as pool:
        end = pool.submit(step_there, compiled, data).result(timeout=120)
    mujoco.mj_step(compiled, data, nstep=50)
    np.testing.assert_array_equal(end, data.qpos)


FIRST_AND_LAST = """
import contextlib, mujoco, sim
from scenes import model
with contextlib.suppress(ValueError):
    model(buoyant=())
    raise SystemExit("a model without floats was accepted")
compiled = model()
states = [mujoco.MjData(compiled) for _ in range(5)]
mujoco.mj_step(compiled, states[0])
class Cycle: pass
cycle = Cycle()
cycle.itself, cycle.data = cycle, mujoco.MjData(compiled)
"""


def test_a_process_may_begin_with_a_faulty_model_and_end_before_its_states():
    done = subprocess.run(
        [sys.executable, "-c", FIRST_AND_LAST], cwd=REPOSITORY / "tests", capture_output=True,
        text=True, timeout=120, env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "nothing floats" in done.stderr or done.stderr == ""


def test_many_models_and_states_leave_no_growth():
    """Contexts are dropped after their last user, except for a few. Homes are reused."""
    gc.collect()
    users = sum(context.users for context in seam.contexts)
    linear = WAVES + '<text name="buoyancy_method" data="linear"/>'
    for i in range(2 * MOST_UNUSED_CONTEXTS):
        wave = f'<numeric name="wave_a" data="0.01 {4.0 + 0.01 * i} 0 0"/>'
        compiled = model(custom=linear + wave)
        for _ in range(SLAB // MOST_UNUSED_CONTEXTS // 2 + 1):  # more than a slab in total
            data = mujoco.MjData(compiled)
    del compiled, data
    gc.collect()
    assert sum(context.users for context in seam.contexts) <= users
    assert sum(not context.users for context in seam.contexts) <= MOST_UNUSED_CONTEXTS + 1
    assert len(seam.homes._slabs) == 1


def test_a_state_whose_word_was_overwritten_ends_with_the_next_one_at_its_address():
    """A pickle overwrites the word, so the end of the state cannot find its home."""
    compiled = model()
    other = mujoco.MjData(compiled)
    users = seam.context_of(compiled).users
    for _ in range(20):  # the allocator reuses the address
        data = mujoco.MjData(compiled)
        data.plugin_data[0] = other.plugin_data[0]
        del data
    assert seam.context_of(compiled).users <= users + 10  # the allocator may use a few addresses


def test_models_with_the_same_content_share_a_context():
    """They may have different masses, unless added mass depends on them."""
    light, heavy = model(), model(CUBE.replace('density="512.5"', 'mass="900"'))
    data = [mujoco.MjData(each) for each in (light, light, heavy)]
    assert seam.context_of(light) is seam.context_of(heavy)
    assert seam.context_of(light).users >= len(data)
    matrix = f'<numeric name="added_mass" data="{"100 0 0 0 0 0 0 " * 5}100"/>'
    light, heavy = (model(body, custom=matrix) for body in (CUBE, CUBE.replace("512.5", "300")))
    assert seam.context_of(light) is not seam.context_of(heavy)


# Changes of a compiled model


def test_mass_acts_at_once_and_geom_size_at_the_next_reset():
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


def test_gravity_and_waves_act_from_the_next_reset():
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


def test_a_state_from_before_a_change_has_the_present_water():
    """FULLPHYSICS records the water that a state was reset with, for the worlds of a batch."""
    compiled = model()
    data = stepped(compiled, 1)
    before = state_of(compiled, data, FULLPHYSICS)
    compiled.geom_size[0] *= 0.5
    mujoco.mj_resetData(compiled, data)
    mujoco.mj_setState(compiled, data, before, FULLPHYSICS)
    mujoco.mj_forward(compiled, data)
    assert data.xfrc_applied[1, 2] == pytest.approx(512.5 * 9.81 / 8.0)


def test_changed_options_are_checked_by_the_next_reset(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log file there
    compiled = model(custom=DRAG)
    data = mujoco.MjData(compiled)
    compiled.opt.solver = mujoco.mjtSolver.mjSOL_PGS
    mujoco.mj_resetData(compiled, data)
    assert "option solver is PGS" in capfd.readouterr().err


# Refusals and notes


@contextmanager
def no_warnings():
    """A block in which a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_mujocos_error_has_all_faults():
    faulty = xml(custom='<numeric name="drag" data="1"/><numeric name="water_ramp" data="-1"/>')
    with pytest.raises(ValueError, match="plugin->init failed") as error:
        mujoco.MjModel.from_xml_string(faulty)
    for fault in ("'drag' has 1 number;", "the water ramp is -1 s"):
        assert fault in str(error.value)


def test_faults_without_room_in_the_error_are_printed(capfd):
    many = "".join(f'<numeric name="wave_{i}" data="-1 4 0 0"/>' for i in range(20))
    with pytest.raises(ValueError, match=r"and 1\d more: see above"):
        mujoco.MjModel.from_xml_string(xml(custom=many))
    assert sum("the amplitude is -1" in line for line in capfd.readouterr().err.splitlines()) == 20
    with pytest.raises(ModelError) as error:
        afloat(custom=many)
    assert len(error.value.faults) == 20


def test_mujoco_itself_finds_files_in_the_current_folder(tmp_path, monkeypatch):
    """MuJoCo does not pass the folder of the MJCF file to a plugin."""
    custom = '<text name="sea_components" data="waves.csv"/>'
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"there is no file .*waves\.csv; Scene\.load searches"):
        model(custom=custom)
    waves = tmp_path / "waves.csv"
    for amplitude in (0.1, 0.125):  # a changed file is read again
        waves.write_text(f"amplitude,wavelength,heading,phase\n{amplitude},4,0,0\n")
        assert Buoyancy.of(model(custom=custom)).sea.waves[0].amplitude == amplitude


def test_percent_signs_are_not_formats_of_printf():
    with pytest.raises(ValueError, match="'%s%n' is not a method"):
        model(custom='<text name="buoyancy_method" data="%s%n"/>')


def test_notes_appear_at_compilation_and_not_for_each_state():
    text = xml(CUBE.replace("512.5", "0.5"))
    with pytest.warns(Note, match="times as dense as the water") as notes:
        compiled = mujoco.MjModel.from_xml_string(text)
    assert notes[0].filename == __file__
    with no_warnings():
        for _ in range(3):
            mujoco.MjData(compiled)


def test_a_note_that_is_an_error_refuses_the_model():
    with no_warnings(), pytest.raises(ValueError, match="times as dense as the water"):
        model(CUBE.replace("512.5", "0.5"))


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
def test_attached_boats_float_if_an_instance_is_attached_too(named, of_parent, instances):
    compiled = fleet(named, of_parent).compile()
    assert compiled.nplugin == instances
    data = stepped(compiled, 600)
    np.testing.assert_allclose(data.xpos[1:, 2], 0.1 - 0.2 * 400 / 1025, atol=0.02)
    assert Buoyancy.of(compiled).body_names == ("a_hull", "b_hull")
    loaded = Scene.load(fleet(False, False))  # which adds an instance
    end = stepped(loaded.model, 600)
    np.testing.assert_array_equal(data.qpos, end.qpos)


def test_attach_drops_an_unused_instance():
    compiled = fleet(named=False, of_parent=False).compile()
    assert compiled.nplugin == 0
    with pytest.raises(ModelError, match=r"MjSpec\.attach copies an instance only"):
        Buoyancy.of(compiled)


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
    solver_tolerance = 1e-12
    head = float(sea.head(x, y, z, data.time))
    np.testing.assert_allclose(found[:2], [elevation, head], atol=solver_tolerance)
    assert (found[1] > 0.0) == (height < 0.0)
    if height > 0.0:
        surface = sea.surface(x, y, data.time).velocity
        np.testing.assert_allclose(found[2:], surface, atol=1e-9)


def test_the_velocity_of_a_gauge_decays_with_depth():
    """The speed of a single wave is omega a e^-kd."""
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


def test_gauges_without_water_or_site_are_refused():
    alone = xml(SITE, extra=GAUGE.format("bow")).replace(WATER, "")
    alone = alone.replace(
        "<custom>", '<extension><plugin plugin="waterline.gauge"/></extension><custom>'
    )
    with pytest.raises(ValueError, match="reads the water of 'waterline': add <extension>"):
        mujoco.MjModel.from_xml_string(alone)
    with pytest.raises(ValueError, match='needs a site: set objtype="site"'):
        gauged(sensor=GAUGE.format("cube").replace('"site"', '"body"'))


def drawn(compiled: mujoco.MjModel, data: mujoco.MjData, scene: mujoco.MjvScene) -> mujoco.MjvScene:
    """The scene, after MuJoCo has updated it."""
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(
        compiled, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene
    )
    return scene


def picture(compiled: mujoco.MjModel, data: mujoco.MjData, room: int = 10_000) -> mujoco.MjvScene:
    return drawn(compiled, data, mujoco.MjvScene(compiled, room))


def triangles(scene: mujoco.MjvScene) -> np.ndarray:
    """Indices (T,) of the triangles of a picture."""
    kinds = np.array([scene.geoms[i].type for i in range(scene.ngeom)])
    return np.flatnonzero(kinds == mujoco.mjtGeom.mjGEOM_TRIANGLE)


def corners(scene: mujoco.MjvScene) -> np.ndarray:
    """Corners (T, 3, 3) [m] of the triangles of a picture."""
    found = []
    for i in triangles(scene):
        corner, sides = scene.geoms[i].pos, np.array(scene.geoms[i].mat)
        found.append([corner, corner + sides[:, 0], corner + sides[:, 1]])
    return np.array(found, dtype=float)


def test_mujocos_pictures_show_the_sea_at_its_elevation():
    compiled = model(custom=WAVES)
    data, sea = stepped(compiled, 200), Buoyancy.of(compiled).sea
    data.xpos[1:] += 50.0  # moves the picture, but not the drawn bodies
    data.xipos[1:, :2] += 50.0
    found = corners(picture(compiled, data))
    points = found.reshape(-1, 3)
    expected = sea.elevation(points[:, 0], points[:, 1], data.time)
    single_precision = 5e-7 * np.repeat(np.abs(found).max(axis=(1, 2)), 3)
    assert (np.abs(points[:, 2] - expected) < single_precision).all()
    assert np.ptp(points[:, 0]) > 200.0
    near = np.abs(points[:, :2] - data.xipos[1:, :2].mean(axis=0)).max(axis=1) < 2.0
    assert near.sum() > 1000
    normals = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
    assert (normals[:, 2] >= 0.0).all()
    area = normals[:, 2].sum() / 2.0  # triangles neither overlap nor leave gaps
    np.testing.assert_allclose(area, np.prod(np.ptp(points[:, :2], axis=0)), rtol=1e-5)


def test_drawn_water_reflects_as_fresnels_law_says():
    """On calm water, seen from the eye of the picture before."""
    compiled, eye = model(), np.array([3.0, -2.0, 2.5])
    scene = mujoco.MjvScene(compiled, 10_000)
    scene.camera[0].pos = eye
    cells = corners(drawn(compiled, stepped(compiled, 1), scene))[::2]  # of two triangles each
    to_eye = eye - 0.5 * (cells[:, 0] + cells[:, 2])
    cosines = to_eye[:, 2] / np.linalg.norm(to_eye, axis=1)
    inside = np.sqrt(1.0 - (1.0 - cosines**2) / 1.33**2)
    parallel = ((inside - 1.33 * cosines) / (inside + 1.33 * cosines)) ** 2
    across = ((cosines - 1.33 * inside) / (cosines + 1.33 * inside)) ** 2
    expected = OPACITY + (1.0 - OPACITY) * 0.5 * (parallel + across)
    found = np.array([scene.geoms[i].rgba[3] for i in triangles(scene)])[::2]
    near = np.linalg.norm(to_eye, axis=1) < 40.0  # haze makes the rest opaque
    assert cosines[near].min() < 0.07
    schlicks_error = 0.03
    np.testing.assert_allclose(found[near], expected[near], atol=schlicks_error)


def test_a_picture_with_little_room_shows_a_coarser_sea():
    compiled = model(custom=WAVES)
    data = stepped(compiled, 1)
    for room in (2, 9, 200, 10_000):
        assert picture(compiled, data, room).ngeom <= room
    assert 100 < len(corners(picture(compiled, data, 200))) < 200
    hidden = model(custom=WAVES + '<numeric name="water_drawn" data="0"/>')
    assert len(corners(picture(hidden, stepped(hidden, 1)))) == 0


# Gymnasium


def test_eight_environments_of_one_file_are_independent():
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


def test_ctrl_c_ends_reading_a_model(monkeypatch):
    """MuJoCo calls the plugin then, and would lose an exception that is raised inside the call."""

    def interrupt(model):
        raise KeyboardInterrupt

    monkeypatch.setattr(seam, "read_model", interrupt)
    with pytest.raises(KeyboardInterrupt):
        afloat(custom='<numeric name="water_level" data="-0.0517"/>')  # in no other test
