"""Worlds of mujoco_warp, on Warp's CPU device, against the same model on the CPU."""

import mujoco
import numpy as np
import pytest

mjw = pytest.importorskip("mujoco_warp")
wp = pytest.importorskip("warp")

from independent import MODELS  # noqa: E402
from sim import ModelError, Patches, Scene, Sea, Wave  # noqa: E402
from sim.hulls.primitives import box  # noqa: E402
from sim.resistance.drag import Drag, DragCoefficients  # noqa: E402
from sim.worlds.seas import at_sea, check_probes  # noqa: E402

PATCHES_ERROR, LINEAR_ERROR = 1e-6, 5e-6
"""Single precision here, single or (linear) double in the plugin, as a share of density * gravity *
volume."""

ACCELERATION_ERROR = 2e-5
"""The same with drag and added mass, as a share of the largest acceleration."""

DRIFT = 5e-5
"""Distance [m] after 500 steps between worlds in single precision and MuJoCo in double."""

BOAT = """
<mujoco>
  <option timestep="0.002" integrator="{integrator}"><flag constraint="disable"/></option>
  <extension><plugin plugin="waterline"><instance name="w"/></plugin></extension>
  <custom>
    <numeric name="wave_a" data="0.1 4 10 0"/><numeric name="wave_b" data="0.05 2.4 50 40"/>
    {fields}
    <tuple name="buoyant"><element objtype="body" objname="boat" prm="0"/></tuple>
  </custom>
  <worldbody>
    <body name="boat"><freejoint/>
      <geom name="hull" type="box" size="0.4 0.3 0.2" density="500"/>
      <body name="arm" pos="0.6 0 0"><joint axis="0 1 0" pos="-0.15 0 0" damping="0.5"/>
        <geom name="arm" type="capsule" fromto="0 0 0 0.5 0 0" size="0.08" density="600"/>
      </body>
    </body>
    {more}
  </worldbody>
</mujoco>"""
"""A free body with a hinged link."""

DRAG = '<numeric name="drag" data="0.3 1 0.01"/><numeric name="drag_angular_hull" data="0.2"/>'
ADDED = '<numeric name="added_mass" data="0.3 0.6 0.8 0.1 0.1 0.1"/>'
DAMPING = '<numeric name="damping" data="20 30 40 5 5 5"/>'
LONE = """<body name="lone" pos="3 0 0"><freejoint/>
    <geom name="lone" type="box" size="0.3 0.3 0.2" density="500"/></body>"""


def boat(fields: str = "", integrator: str = "implicitfast", more: str = "") -> mujoco.MjSpec:
    xml = BOAT.format(fields=fields, integrator=integrator, more=more)
    if more:
        xml = xml.replace("</tuple>", '<element objtype="body" objname="lone" prm="0"/></tuple>')
    return mujoco.MjSpec.from_string(xml)


def started(
    scene: Scene, worlds: int, seas=None, seed: int = 0, time: float = 0.0, shift=(0.0, 0.0)
):
    """Model, data and water of worlds that start a little apart, turned and in motion."""
    rng, model = np.random.default_rng(seed), scene.buoyancy.dry_model
    data = mujoco.MjData(model)
    data.qpos[:] = scene.data.qpos
    mujoco.mj_forward(model, data)
    m, d = mjw.put_model(model), mjw.put_data(model, data, nworld=worlds)
    water = scene.buoyancy.on_warp(m, d, seas)
    qpos = np.tile(scene.data.qpos, (worlds, 1))
    size = max(f.method.hull.length for f in scene.buoyancy.floats)
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        at = model.jnt_qposadr[joint]
        qpos[:, at : at + 2] += shift
        qpos[:, at + 2] += 0.1 * size * rng.uniform(-1.0, 1.0, worlds)
        turned = qpos[:, at + 3 : at + 7] + 0.1 * rng.normal(size=(worlds, 4))
        qpos[:, at + 3 : at + 7] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    d.qpos.assign(qpos.astype(np.float32))
    d.qvel.assign(0.2 * rng.normal(size=(worlds, model.nv)).astype(np.float32))
    d.time.fill_(time)
    return m, d, water


def buoyancy_errors(scene: Scene, m, d, water, push=None) -> np.ndarray:
    """Largest errors of the force and of the torque over length, in shares of density gravity
    volume, for every world."""
    mjw.kinematics(m, d)
    mjw.com_pos(m, d)
    water.act(m, d)
    b, state = scene.buoyancy, mujoco.MjData(scene.model)
    found, found_errors = water.wrenches().numpy(), []
    geoms, centres = [f.geom for f in b.floats], d.xipos.numpy()[:, [f.body for f in b.floats]]
    weights = np.array([f.method.hull.volume for f in b.floats]) * b.sea.density * b.sea.gravity
    lengths = np.array([f.method.hull.length for f in b.floats])
    for i in range(d.nworld):
        state.geom_xpos[:] = d.geom_xpos.numpy()[i]
        state.geom_xmat[:] = d.geom_xmat.numpy()[i].reshape(-1, 9)
        state.time = float(d.time.numpy()[i])
        expected = (push or (lambda s, _: b.push(s)))(state, i)
        expected[:, 3:] += np.cross(state.geom_xpos[geoms] - centres[i], expected[:, :3])
        missed = (found[i] - expected) / weights[:, None]
        force = np.linalg.norm(missed[:, :3], axis=1)
        found_errors.append(
            np.maximum(force, np.linalg.norm(missed[:, 3:], axis=1) / lengths).max()
        )
    return np.array(found_errors)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (1003.7, -702.3, 0.0), (0.0, 0.0, 10000.0)])
@pytest.mark.parametrize("name", ["bunny", "wigley", "catamaran", "robot"])
def test_patches_follow_the_plugin(name, place):
    scene = Scene.load(MODELS / f"{name}.xml")
    m, d, water = started(scene, 8, time=place[2], shift=place[:2])
    errors = buoyancy_errors(scene, m, d, water)
    assert water.wrenches().numpy()[:, :, 2].max() > 0.0
    assert errors.max() < PATCHES_ERROR


@pytest.mark.parametrize("name", ["bunny", "wigley"])
def test_the_linear_method_follows_the_plugin(name):
    scene = Scene.load(MODELS / f"{name}.xml", settings={"buoyancy_method": "linear"})
    m, d, water = started(scene, 8, time=10000.0, shift=(1000.0, 0.0))
    assert buoyancy_errors(scene, m, d, water).max() < LINEAR_ERROR


@pytest.mark.parametrize("method", ["patches", "linear"])
def test_ramp_tide_current_depth_and_pressure_follow_the_cpu(method):
    waves = [Wave(0.1, 4.0, 0.3), Wave(0.05, 2.4, 1.0, 0.7)]
    tide = ((0.0, 0.1), (20.0, 0.2))
    for pressure in ("froude-krylov", "hydrostatic"):
        sea = Sea(
            waves, current=(0.3, 0.1), ramp=8.0, tide=tide, depth=1.5, pressure=pressure
        )  # fmt: skip
        scene = Scene.load(boat(DRAG + ADDED), sea=sea, settings={"buoyancy_method": method})
        m, d, water = started(scene, 4, time=3.0)
        assert buoyancy_errors(scene, m, d, water).max() < LINEAR_ERROR
        mjw.forward(m, d)
        state, accelerations = mujoco.MjData(scene.model), d.qacc.numpy()
        for i in range(4):
            state.qpos[:], state.qvel[:], state.time = d.qpos.numpy()[i], d.qvel.numpy()[i], 3.0
            mujoco.mj_forward(scene.model, state)
            missed = np.abs(accelerations[i] - state.qacc).max()
            assert missed < ACCELERATION_ERROR * np.abs(state.qacc).max()


def sixteen_seas() -> list[Sea]:
    rng = np.random.default_rng(5)
    return [
        Sea([Wave(0.02 + 0.06 * rng.random(), 3.0 + rng.random(), *rng.uniform(0, 6, 2))
             for _ in range(1 + i % 3)], level=0.1 * rng.random())
        for i in range(16)
    ]  # fmt: skip


def test_worlds_have_seas_of_their_own():
    seas, scene = sixteen_seas(), Scene.load(boat())
    for method, limit in (("linear", LINEAR_ERROR), ("patches", 2e-5)):
        scene = Scene.load(boat(), settings={"buoyancy_method": method})
        m, d, water = started(scene, 16, seas=seas[:8])
        water.set_seas(seas[8:])

        def push(state, i, water=water, scene=scene):
            found = np.empty((len(scene.buoyancy.floats), 6))
            for h, f in enumerate(scene.buoyancy.floats):
                sea = seas[8 + i % 8]
                made = type(f.method)(f.method.hull, sea)
                if isinstance(f.method, Patches):
                    tree = [p for p in water._patched if p.hull is f.method.hull]
                    made = at_sea(tree[0], sea)
                    made._prepare()
                rotation = state.geom_xmat[f.geom]
                u, _, v = np.linalg.svd(rotation.reshape(3, 3))
                found[h] = made.wrench(state.geom_xpos[f.geom], u @ v, state.time)
            return found

        assert buoyancy_errors(scene, m, d, water, push).max() < limit


@pytest.mark.parametrize(
    ("fields", "integrator", "more"),
    [(DRAG, "implicitfast", ""), (ADDED + DAMPING, "Euler", ""), (DRAG, "implicitfast", LONE)],
    ids=["drag", "added mass", "lone body"],
)
def test_worlds_follow_the_cpu(fields, integrator, more):
    scene, worlds, steps = Scene.load(boat(fields, integrator, more)), 64, 500
    m, d, _ = started(scene, worlds)
    start, speed = d.qpos.numpy().astype(float), d.qvel.numpy().astype(float)
    mjw.forward(m, d)
    matrices = d.M.numpy().copy()  # not a view of the CPU device's memory
    for _ in range(steps):
        mjw.step(m, d)
    state, found = mujoco.MjData(scene.model), d.qpos.numpy()
    for i in range(worlds):
        mujoco.mj_resetData(scene.model, state)
        state.qpos[:], state.qvel[:] = start[i], speed[i]
        mujoco.mj_forward(scene.model, state)
        assert np.abs(matrices[i] - state.M).max() < 1e-6 * np.abs(state.M).max()
        mujoco.mj_step(scene.model, state, nstep=steps)
        assert np.abs(found[i] - state.qpos)[:3].max() < DRIFT


def test_captured_and_repeated_runs_have_the_same_bits():
    spec, found = boat(DRAG + ADDED), {}
    spec.option.solver = mujoco.mjtSolver.mjSOL_CG  # it uses the factors of M
    scene = Scene.load(spec)
    for kind in ("eager", "repeated", "captured", "split"):
        m, d, _ = started(scene, 4)
        if kind == "captured":
            with wp.ScopedCapture() as capture:
                mjw.step(m, d)
        for _ in range(20):
            if kind == "captured":
                wp.capture_launch(capture.graph)
            elif kind == "split":
                mjw.step1(m, d)
                mjw.step2(m, d)
            else:
                mjw.step(m, d)
        found[kind] = np.hstack([d.qpos.numpy(), d.qacc_smooth.numpy()])
    assert (found["repeated"] == found["eager"]).all()
    assert (found["captured"] == found["eager"]).all()
    np.testing.assert_allclose(found["split"], found["eager"], rtol=1e-4, atol=1e-4)


def test_the_clock_counts_steps_and_follows_resets():
    scene = Scene.load(boat())
    m, d, water = started(scene, 2)
    step, now = np.float32(scene.model.opt.timestep), np.zeros(2, np.float32)
    for i in range(100_001):
        if i:
            now += step
        d.time.assign(now)
        water._tick(m, d)
    assert abs(float(now[0]) - 200.0) > 1e-3  # what a sum in single precision gives
    assert np.abs(water.clock.numpy() - 200.0).max() < 1e-9
    now[1] = 0.0
    d.time.assign(now)
    water._tick(m, d)
    water._tick(m, d)
    np.testing.assert_allclose(water.clock.numpy(), [200.0, 0.0], rtol=0.0, atol=1e-9)


def test_elevations_are_those_of_the_seas():
    seas, scene = sixteen_seas()[:2], Scene.load(boat())
    _, d, water = started(scene, 4, seas=seas, time=7.0)
    points = np.array([[0.0, 0.0], [1000.0, 3.0], [-2.5, 40.0]])
    found = water.elevation(points).numpy()
    for i in range(4):
        expected = seas[i % 2].elevation(*points.T, float(d.time.numpy()[i]))
        np.testing.assert_allclose(found[i], expected, rtol=0.0, atol=1e-6)
    own = wp.array(np.full((4, 2, 3), 0.5, np.float32), dtype=wp.vec3)
    assert water.elevation(own).shape == (4, 2)
    with pytest.raises(ValueError, match="expected"):
        water.elevation(np.zeros(3))


def test_a_callback_that_was_there_is_kept():
    scene, calls = Scene.load(boat()), []
    model = scene.buoyancy.dry_model
    m, d = mjw.put_model(model), mjw.put_data(model, mujoco.MjData(model), nworld=2)
    m.callback.passive = before = lambda m, d: calls.append(d)
    water = scene.buoyancy.on_warp(m, d)
    mjw.kinematics(m, d)
    mjw.com_pos(m, d)
    m.callback.passive(m, d)
    assert len(calls) == 1
    assert np.abs(d.qfrc_passive.numpy()).max() > 100.0
    water.uninstall()
    assert m.callback.passive is before


def refused(scene: Scene, change=lambda m, d: None, worlds: int = 2, seas=None) -> str:
    model = scene.buoyancy.dry_model
    m, d = mjw.put_model(model), mjw.put_data(model, mujoco.MjData(model), nworld=worlds)
    change(m, d)
    with pytest.raises((ModelError, ValueError)) as error:
        scene.buoyancy.on_warp(m, d, seas)
    return str(error.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"integrator": mujoco.mjtIntegrator.mjINT_RK4}, "integrator is RK4"),
        ({"solver": mujoco.mjtSolver.mjSOL_PGS}, "solver is PGS"),
        ({"noslip_iterations": 2}, "noslip_iterations"),
        ({"disableflags": 96}, "springs and dampers are both disabled"),
    ],
)
def test_options_that_do_not_work_are_refused(options, words):
    scene = Scene.load(boat())
    dry = scene.buoyancy.dry_model
    m, d = mjw.put_model(dry), mjw.put_data(dry, mujoco.MjData(dry), nworld=1)
    for name, value in options.items():
        setattr(scene.model.opt, name, value)
    with pytest.raises(ModelError, match=words):
        scene.buoyancy.on_warp(m, d)


def test_other_worlds_are_refused():
    scene = Scene.load(boat())

    def other_sizes(m, d):
        sizes = np.repeat(m.geom_size.numpy()[:1], 2, axis=0)
        sizes[1] *= 2.0
        m.geom_size = wp.array(sizes, dtype=wp.vec3)

    def pushed(m, d):
        d.xfrc_applied.fill_(1.0)

    def without_callback(m, d):
        del m.callback

    assert "differ in geom_size" in refused(scene, other_sizes)
    assert "would count twice" in refused(scene, pushed)
    assert "m.callback.passive" in refused(scene, without_callback)
    chord = Scene.load(boat(), settings={"buoyancy_method": "chord"})
    assert "has the method Chord" in refused(chord)
    assert "there is no sea" in refused(scene, seas=[])
    assert "density 1000" in refused(scene, seas=[Sea(density=1000.0)])


def test_seas_that_do_not_fit_are_refused():
    scene = Scene.load(boat())
    _, _, water = started(scene, 2, seas=[Sea([Wave(0.1, 8.0)]), Sea([Wave(0.1, 8.0)])])
    with pytest.raises(ValueError, match="expected 2"):
        water.set_seas([Sea()])
    with pytest.raises(ValueError, match="room for 1"):
        water.set_seas([Sea(), Sea([Wave(0.1, 8.0), Wave(0.1, 9.0)])])
    with pytest.raises(ValueError, match="as short and steep"):
        water.set_seas([Sea([Wave(0.06, 0.8)]), Sea()])


def test_drag_refuses_a_sea_too_short_for_its_probes():
    drag = Drag(box(0.15, 0.1, 0.06), Sea([Wave(0.04, 2.0)]), DragCoefficients(0.2, 1.0, 0.0))
    assert len(drag.probes) > 0
    check_probes([drag], [Sea([Wave(0.05, 1.9, 30.0)])])
    with pytest.raises(ValueError, match="takes the water's velocity in a sea to"):
        check_probes([drag], [Sea([Wave(0.004, 0.2, 30.0)])])
