"""Simulation and scenes: samples, their instants, divergence, interleaved runs, loading."""

from functools import partial

import mujoco
import numpy as np
import pytest
from scenes import CUBE, WAVES, afloat, model

from independent import MODELS
from sim import DivergenceError, Patches, Scene, Tally, observe, simulate
from sim.plugin.context import Context

SCENES = ("cube", "bunny", "dragon", "trio")


def cube_scene(**changes) -> Scene:
    return Scene.from_model(model(custom=WAVES, **changes))


def test_samples_have_the_rate_and_start_before_the_first_step():
    samples = list(simulate(cube_scene(), duration=1.0, rate=20.0))
    np.testing.assert_allclose([s.time for s in samples], np.arange(21) * 0.05, atol=1e-12)
    assert [s.step for s in samples] == list(range(0, 201, 10))


def test_samples_between_steps_are_taken_at_the_next_step():
    samples = list(simulate(cube_scene(), duration=1.0, rate=30.0))
    due = np.arange(31) / 30.0
    late = np.array([s.time for s in samples]) - due
    assert len(samples) == 31
    assert ((late > -1e-9) & (late < 0.005)).all()


def test_the_highest_rate_is_every_step():
    assert [s.step for s in simulate(cube_scene(), 0.05, rate=1e6)] == list(range(11))


def test_a_sample_belongs_to_its_own_instant():
    """Pose, wrench and elevation are consistent."""
    scene = cube_scene()
    *_, sample = simulate(scene, 0.7, rate=10.0)
    sea, method = scene.buoyancy.sea, scene.buoyancy.floats[0].method
    assert sample.time == scene.data.time
    np.testing.assert_array_equal(sample.positions[0], scene.data.qpos[:3])
    np.testing.assert_allclose(sample.quaternions[0], scene.data.qpos[3:], atol=1e-15)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, sample.quaternions[0])
    wrench = method.wrench(sample.centres[0], rotation, sample.time)
    np.testing.assert_allclose(sample.wrenches[0], wrench, atol=1e-8)
    np.testing.assert_array_equal(sample.body_wrenches, sample.wrenches)
    x, y, _ = sample.centres[0]
    assert sample.elevations[0] == sea.elevation(x, y, sample.time)
    assert sample.tilts[0] == pytest.approx(np.arccos(rotation[8]))
    still = Patches(method.hull, sea.hydrostatic).wrench(sample.centres[0], rotation, sample.time)
    assert sample.submerged_fractions[0] == pytest.approx(still[2] / (1025.0 * 9.81))
    assert abs(still[2] / wrench[2] - 1.0) > 0.01  # the volume, not the force


def test_observe_in_a_users_loop_is_at_the_present_instant():
    """MuJoCo leaves the kinematics one step behind, and `observe` updates them."""
    scene = cube_scene()
    mujoco.mj_step(scene.model, scene.data, nstep=50)
    sample = observe(scene)
    np.testing.assert_array_equal(sample.positions[0], scene.data.qpos[:3])
    assert sample.time == pytest.approx(0.25)


def test_sampling_does_not_change_the_run():
    ends = []
    for rate in (1.0, 200.0):
        scene = cube_scene()
        *_, last = simulate(scene, 2.0, rate)
        ends.append(np.concatenate([scene.data.qpos, scene.data.qvel, last.wrenches[0]]))
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize("name", SCENES)
def test_the_same_run_twice_gives_the_same_bits(name):
    runs = []
    for _ in range(2):
        scene = Scene.load(MODELS / f"{name}.xml")
        *_, last = simulate(scene, 0.5)
        runs.append(np.concatenate([scene.data.qpos, scene.data.qvel, last.wrenches.ravel()]))
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_come_to_float(name):
    scene = Scene.load(MODELS / f"{name}.xml")
    samples = list(simulate(scene, 8.0, rate=20.0))
    settled = samples[len(samples) // 2 :]
    fractions = np.mean([s.submerged_fractions for s in settled], axis=0)
    relative_densities = scene.buoyancy.weights / (
        scene.buoyancy.sea.density * 9.81 * scene.buoyancy.volumes
    )
    np.testing.assert_allclose(fractions, relative_densities, rtol=0.1)


def test_simulations_may_be_interleaved_with_each_other_and_with_compiling():
    def run(scene):
        return [s.centres.copy() for s in simulate(scene, 0.5, 20.0)]

    alone = run(cube_scene())
    first, second = simulate(cube_scene(), 0.5, 20.0), simulate(cube_scene(), 0.5, 20.0)
    together = []
    for a, b in zip(first, second, strict=True):
        mujoco.MjModel.from_xml_string("<mujoco/>")
        together.append((a.centres, b.centres))
    for single, (a, b) in zip(alone, together, strict=True):
        np.testing.assert_array_equal(single, a)
        np.testing.assert_array_equal(single, b)


def test_simulate_can_be_left_early_and_resumed():
    scene = cube_scene()
    for sample in simulate(scene, 10.0):
        if sample.time > 0.2:
            break
    assert mujoco.get_mjcb_passive() is None
    *_, last = simulate(scene, 0.1)
    assert last.time == pytest.approx(sample.time + 0.1)


@pytest.fixture
def quiet_mujoco(tmp_path, monkeypatch):
    """MuJoCo writes its log file to the current folder."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("quiet_mujoco")
@pytest.mark.parametrize(("kind", "what"), [("qpos", "position"), ("qvel", "velocity")])
def test_divergence_names_body_time_and_remedy(kind, what):
    stone = '<body name="stone" pos="5 0 0"><freejoint/><geom size="0.1"/></body>'
    scene = cube_scene(bodies=CUBE + stone)
    samples = simulate(scene, 1.0, rate=100.0)
    for sample in samples:
        if sample.step == 20:
            getattr(scene.data, kind)[-1] = np.nan
            break
    with pytest.raises(
        DivergenceError, match=f"'stone' diverged at 0.1000 s: its {what}"
    ) as caught:
        next(samples)
    assert (caught.value.body, caught.value.time) == ("stone", pytest.approx(0.1))
    assert "timestep below 0.005" in str(caught.value)
    assert mujoco.get_mjcb_passive() is None


@pytest.mark.usefixtures("quiet_mujoco")
def test_a_nan_force_is_divergence():
    scene = cube_scene()
    samples = simulate(scene, 1.0, rate=100.0)
    next(samples)
    scene.data.qfrc_applied[2] = np.nan
    with pytest.raises(DivergenceError, match=r"'cube' diverged at 0\.0000 s: its acceleration"):
        list(samples)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((0.0,), "duration is 0"), ((np.nan,), "duration is nan"), ((1.0, -1.0), "rate is -1")],
)
def test_impossible_durations_and_rates_are_refused_at_the_call(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate(cube_scene(), *arguments)


def test_a_timestep_that_became_impossible_is_refused_at_the_call():
    scene = cube_scene()
    scene.model.opt.timestep = 0.0
    with pytest.raises(ValueError, match="timestep is 0 s; it must be finite and above 0"):
        simulate(scene, 1.0)


def test_tally_averages_samples():
    scene = cube_scene()
    tally, samples = Tally(scene), list(simulate(scene, 1.0))
    assert tally.bodies() == {}
    for sample in samples:
        tally.add(sample)
    cube = tally.bodies()["cube"]
    assert cube["mean_height"] == pytest.approx(np.mean([s.centres[0, 2] for s in samples]))
    assert cube["mean_tilt_deg"] == pytest.approx(
        np.degrees(np.mean([s.tilts[0] for s in samples]))
    )
    assert cube["mean_submerged_fraction"] == pytest.approx(
        np.mean([s.submerged_fractions[0] for s in samples])
    )
    weight = 512.5 * 9.81
    assert cube["mean_force_over_weight"] == pytest.approx(
        np.mean([s.wrenches[0, 2] for s in samples]) / weight
    )
    assert cube["final_position"] == samples[-1].positions[0].tolist()
    assert cube["final_quaternion"] == samples[-1].quaternions[0].tolist()


def test_load_starts_at_the_first_keyframe():
    scene = Scene.load(MODELS / "trio.xml")
    np.testing.assert_array_equal(scene.data.qpos, scene.model.key_qpos[0])
    assert scene.name == "trio"


def test_a_timestep_overrides_the_models():
    assert Scene.load(MODELS / "cube.xml", timestep=0.001).model.opt.timestep == 0.001
    with pytest.raises(ValueError, match=r"timestep is 0.0 s.*above 0"):
        Scene.load(MODELS / "cube.xml", timestep=0.0)


def test_load_names_the_faulty_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no scene file .*nowhere\.xml"):
        Scene.load(tmp_path / "nowhere.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><wave/></mujoco>")
    with pytest.raises(ValueError, match=r"broken.xml: MuJoCo cannot compile it: .*wave"):
        Scene.load(broken)
    empty = tmp_path / "empty.xml"
    empty.write_text("<mujoco/>")
    with pytest.raises(ValueError, match=r"empty.xml: nothing floats"):
        Scene.load(empty)


def test_simulate_refuses_a_model_with_changed_water():
    """Samples and recordings use the sea and the hulls from when the scene was made."""
    scene = cube_scene()
    scene.model.body_mass[1] *= 1.1
    simulate(scene, 1.0)
    for change in (lambda m: m.opt.gravity.__setitem__(2, -1.62), lambda m: m.geom_size.fill(0.4)):
        change(scene.model)
        with pytest.raises(ValueError, match=r"have changed since .* Scene\.from_model\(model\)"):
            simulate(scene, 1.0)
        scene = Scene.from_model(scene.model)
        simulate(scene, 1.0)


def test_the_submerged_volume_follows_a_change_of_gravity():
    """Waves are slower under lower gravity. A changed model is like one written with it."""
    changed = cube_scene()
    changed.model.opt.gravity[2] = -1.62
    written = cube_scene(option='<option timestep="0.005" gravity="0 0 -1.62"/>')
    volumes = []
    for scene in (Scene.from_model(changed.model), written, cube_scene()):
        scene.data.time = 1.3
        mujoco.mj_kinematics(scene.model, scene.data)
        volumes.append(scene.buoyancy.submerged_volumes(scene.data)[0])
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-9)
    assert volumes[2] != pytest.approx(volumes[1], rel=0.01)


@pytest.mark.parametrize("what", ["time", "qpos", "qvel"])
def test_a_keyframe_that_is_not_finite_is_refused(what):
    numbers = {"time": "0", "qpos": "0 0 0 1 0 0 0", "qvel": "0 0 0 0 0 0"}
    key = " ".join(f'{name}="{value}"' for name, value in numbers.items())
    compiled = model(extra=f'<keyframe><key name="start" {key}/></keyframe>')
    getattr(compiled, f"key_{what}")[:] = np.nan
    with pytest.raises(ValueError, match=f"keyframe 'start': its {what} has a number that is not"):
        Scene.from_model(compiled)


def test_a_time_that_is_not_finite_is_divergence():
    scene = Scene.from_model(model(custom=WAVES))
    scene.data.time = np.nan
    mujoco.mj_forward(scene.model, scene.data)
    assert np.isnan(scene.data.xfrc_applied[1]).all()
    scene = Scene.from_model(model(custom=WAVES))
    run = simulate(scene, 1.0)
    next(run)
    scene.data.time = np.nan
    with pytest.raises(DivergenceError, match=r"its time is not finite; set data\.time"):
        list(run)


def test_a_run_of_too_many_steps_is_refused():
    scene = afloat(load=dict(timestep=1e-12))
    with pytest.raises(ValueError, match=r"10 s are 1e\+13 steps of 1e-12 s, more than 1e\+09"):
        simulate(scene, 10.0)


@pytest.mark.parametrize("pressure", ["froude-krylov", "hydrostatic"])
def test_a_sample_computes_the_wrenches_once(pressure, monkeypatch):
    drag = '<numeric name="drag" data="0.2 1 0.005"/>'
    scene, pushes = (
        afloat(custom=WAVES + drag, load=dict(settings={"water_pressure": pressure})),
        [],
    )
    scene.data.qvel[:] = 0.3

    def push(context, *arguments):
        pushes.append(context)
        return Context.push(context, *arguments)

    monkeypatch.setattr(scene.buoyancy._context, "push", partial(push, scene.buoyancy._context))
    sample = observe(scene)
    assert len(pushes) == 1
    buoyancy, data = scene.buoyancy, scene.data
    np.testing.assert_array_equal(sample.wrenches, buoyancy.wrenches(data))
    np.testing.assert_array_equal(sample.submerged_fractions, buoyancy.submerged_volumes(data))
    np.testing.assert_array_equal(sample.drag_wrenches, buoyancy.drag_wrenches(data))
    assert np.abs(sample.drag_wrenches).max() > 1.0
