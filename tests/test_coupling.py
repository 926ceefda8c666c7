"""Buoyancy in MuJoCo: the callback, its manners, frames and integrators."""

import gc
import runpy
import threading
import weakref
from time import monotonic, sleep

import mujoco
import numpy as np
import pytest
import trimesh
from scenes import CUBE, WAVES, model

from independent import MODELS, REPOSITORY, ROUND_OFF
from sim import Buoyancy, Hull, Linear, Scene

WEIGHT = 512.5 * 9.81  # N, of the cube


def started(compiled: mujoco.MjModel, qpos: list[float] | None = None) -> mujoco.MjData:
    data = mujoco.MjData(compiled)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_forward(compiled, data)
    return data


def trajectory(compiled: mujoco.MjModel, steps: int = 100) -> np.ndarray:
    data, buoyancy = started(compiled), Buoyancy.from_model(compiled)
    states = []
    with buoyancy.installed():
        for _ in range(steps):
            mujoco.mj_step(compiled, data)
            states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "implicit", "discrete", "RK4"])
def test_a_cube_in_equilibrium_stays(integrator):
    """Half as dense as water it floats half under, from the first step on, at every stage."""
    compiled = model(option=f'<option timestep="0.005" integrator="{integrator}"/>')
    states = trajectory(compiled)
    np.testing.assert_allclose(states[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(states[:, 7:], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("integrator", "calls"), [("Euler", 1), ("implicitfast", 1), ("discrete", 1), ("RK4", 4)]
)
def test_wrenches_are_computed_once_for_every_evaluation(integrator, calls):
    compiled = model(option=f'<option integrator="{integrator}"/>', custom=WAVES)
    buoyancy, data = Buoyancy.from_model(compiled), started(compiled)
    with buoyancy.installed():
        mujoco.mj_step(compiled, data)
    assert buoyancy.calls == calls


def test_integrators_agree_as_the_timestep_shrinks():
    """All see the same force: they tend to one trajectory, RK4 being there already."""
    ends = {}
    for integrator in ("RK4", "Euler", "implicitfast"):
        for halvings in range(3):
            timestep = 0.004 / 2**halvings
            option = f'<option timestep="{timestep}" integrator="{integrator}"/>'
            states = trajectory(model(option=option, custom=WAVES), 100 * 2**halvings)
            ends[integrator, halvings] = states[-1]
    truth = ends["RK4", 2]
    assert np.abs(ends["RK4", 1] - truth).max() < 1e-6
    for integrator in ("Euler", "implicitfast"):
        errors = [np.abs(ends[integrator, n] - truth).max() for n in range(3)]
        slopes = np.log2(np.array(errors[:-1]) / errors[1:])
        assert ((slopes > 0.8) & (slopes < 1.3)).all(), slopes  # first order


@pytest.mark.parametrize("method", ["linear", "chord", "patches"])
@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_apply_before_each_step_is_the_callback_to_the_bit(integrator, method):
    option = f'<option timestep="0.005" integrator="{integrator}"/>'
    custom = WAVES + f'<text name="buoyancy_method" data="{method}"/>'
    compiled = model(custom=custom, option=option)
    data, buoyancy = started(compiled), Buoyancy.from_model(compiled)
    states = []
    for _ in range(100):
        buoyancy.apply(compiled, data)
        mujoco.mj_step(compiled, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_array_equal(states, trajectory(compiled))


def test_apply_refuses_another_model():
    compiled, other = model(), model()
    buoyancy = Buoyancy.from_model(compiled)
    with pytest.raises(ValueError, match="made for another model"):
        buoyancy.apply(other, mujoco.MjData(other))


def test_two_models_alive_at_once_do_not_touch_each_other():
    calm, rough = model(), model(custom=WAVES)
    alone = {m: trajectory(m) for m in (calm, rough)}
    both = {calm: [], rough: []}
    datas = {m: started(m) for m in (calm, rough)}
    with Buoyancy.from_model(calm).installed(), Buoyancy.from_model(rough).installed():
        for _ in range(100):
            for m, data in datas.items():
                mujoco.mj_step(m, data)
                both[m].append(np.concatenate([data.qpos, data.qvel]))
    for m in (calm, rough):
        np.testing.assert_array_equal(both[m], alone[m])


def test_other_models_and_other_rows_are_left_alone():
    stone = '<body name="stone" pos="5 0 0"><freejoint/><geom name="stone" size="0.1"/></body>'
    compiled, other = model(CUBE + stone), model()
    data, other_data = started(compiled), started(other)
    data.xfrc_applied[2] = np.arange(6.0)
    other_data.xfrc_applied[1] = np.arange(6.0)
    with Buoyancy.from_model(compiled).installed():
        mujoco.mj_forward(compiled, data)
        mujoco.mj_forward(other, other_data)
        assert data.xfrc_applied[1, 2] == pytest.approx(WEIGHT)
        np.testing.assert_array_equal(data.xfrc_applied[2], np.arange(6.0))
    assert data.xfrc_applied[1, 2] == pytest.approx(WEIGHT)  # what was written last stays
    np.testing.assert_array_equal(data.xfrc_applied[2], np.arange(6.0))
    np.testing.assert_array_equal(other_data.xfrc_applied[1], np.arange(6.0))


def test_installed_restores_what_was_there_in_any_case():
    compiled, seen = model(), []

    def mine(model, data):
        seen.append(data.time)

    mujoco.set_mjcb_passive(mine)
    try:
        data = started(compiled)
        seen.clear()
        with pytest.raises(RuntimeError, match="on purpose"):
            _step_once_and_fail(compiled, data)
        assert len(seen) == 1  # what was installed before goes on being called
        assert mujoco.get_mjcb_passive() is mine
    finally:
        mujoco.set_mjcb_passive(None)


def _step_once_and_fail(compiled: mujoco.MjModel, data: mujoco.MjData) -> None:
    with Buoyancy.from_model(compiled).installed():
        mujoco.mj_step(compiled, data)
        raise RuntimeError("on purpose")


def test_several_states_of_one_model():
    compiled = model(custom=WAVES)
    buoyancy = Buoyancy.from_model(compiled)
    high, low = started(compiled, [0, 0, 5, 1, 0, 0, 0]), started(compiled)
    with buoyancy.installed():
        for data in (high, low, high):
            mujoco.mj_forward(compiled, data)
        assert not high.xfrc_applied.any()
        assert low.xfrc_applied[1, 2] > 0.0


def test_nothing_is_kept_alive_after_the_block():
    compiled = model()
    buoyancy = Buoyancy.from_model(compiled)
    with buoyancy.installed():
        mujoco.mj_forward(compiled, mujoco.MjData(compiled))
    hook = weakref.ref(buoyancy)
    del buoyancy
    gc.collect()
    assert hook() is None
    assert mujoco.get_mjcb_passive() is None


def test_a_geom_off_its_body_frame_floats_where_it_is():
    """Wrench about the centre of mass, as that of a hull placed by hand in the world."""
    geom = '<geom name="g" type="mesh" mesh="m" pos="0.3 -0.2 0.5" euler="20 30 40" density="500"/>'
    ballast = '<geom type="sphere" size="0.1" pos="-0.4 0.6 0.1" density="3000"/>'
    body = f'<body pos="0 0 -0.4" euler="10 0 5"><freejoint/>{geom}{ballast}</body>'
    assets = f'<mesh name="m" file="{MODELS / "meshes" / "bunny.obj"}" inertia="exact"/>'
    compiled = model(body, ("g",), WAVES, assets=assets)
    data, buoyancy = started(compiled), Buoyancy.from_model(compiled, method="linear")
    assert np.abs(data.geom_xpos[0] - data.xipos[1]).max() > 0.05  # the case is not a trivial one
    count = compiled.mesh_vertnum[0]
    in_world = compiled.mesh_vert[:count] @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    hull = Hull(in_world - data.xipos[1], compiled.mesh_face)
    expected = Linear(hull, buoyancy.sea).wrench(data.xipos[1], np.eye(3), 0.0)
    scale = np.abs(expected).max()
    buoyancy.apply(compiled, data)
    np.testing.assert_allclose(data.xfrc_applied[1] / scale, expected / scale, atol=ROUND_OFF)


def test_two_geoms_of_a_body_add_up():
    """A box cut in two halves floats as the whole."""
    half = '<geom name="{}" type="box" size="0.25 0.5 0.5" pos="{} 0 0" density="512.5"/>'
    halves = half.format("left", -0.25) + half.format("right", 0.25)
    cut = model(f'<body euler="10 20 30"><freejoint/>{halves}</body>', ("left", "right"))
    whole = model(CUBE.replace("<body", '<body euler="10 20 30"'))
    rows = []
    for compiled in (cut, whole):
        data = started(compiled)
        Buoyancy.from_model(compiled).apply(compiled, data)
        rows.append(data.xfrc_applied[1].copy())
    # on flat water the straight clip is exact, however the surface is cut
    np.testing.assert_allclose(rows[0], rows[1], atol=ROUND_OFF * WEIGHT)


def test_bodies_in_a_kinematic_tree():
    """Two boxes joined by a hinge, level on flat water: each carries its own weight."""
    box = '<geom name="{}" type="box" size="0.5 0.5 0.1" density="512.5"/>'
    tree = f"""
    <body name="front"><freejoint/>{box.format("front")}
      <body name="rear" pos="1.2 0 0"><joint type="hinge" axis="0 1 0" pos="-0.6 0 0"/>
        {box.format("rear")}</body></body>"""
    compiled = model(tree, ("front", "rear"))
    data, buoyancy = started(compiled), Buoyancy.from_model(compiled)
    assert buoyancy.body_names == ("front", "rear")
    with buoyancy.installed():
        for _ in range(200):
            mujoco.mj_step(compiled, data)
    np.testing.assert_allclose(data.qpos[2], 0.0, atol=1e-9)
    np.testing.assert_allclose(data.qpos[7], 0.0, atol=1e-9)
    data.qpos[7] = 0.3  # fold the hinge: the rear end dips and is pushed back up
    mujoco.mj_forward(compiled, data)
    buoyancy.apply(compiled, data)
    assert data.xfrc_applied[2, 2] > compiled.body_mass[2] * 9.81


def test_wrenches_reads_without_writing():
    compiled = model(custom=WAVES)
    data, buoyancy = started(compiled), Buoyancy.from_model(compiled)
    wrenches = buoyancy.wrenches(data)
    assert not data.xfrc_applied.any()
    buoyancy.apply(compiled, data)
    np.testing.assert_array_equal(wrenches[0], data.xfrc_applied[1])


def test_sphere_floats_at_the_depth_that_its_mass_says():
    """Volume-true facets: a ball of half the water's density hangs with its middle in the water."""
    ball = '<body><freejoint/><geom name="b" type="sphere" size="0.5" density="512.5"/></body>'
    compiled = model(ball, ("b",))
    data = started(compiled)
    Buoyancy.from_model(compiled).apply(compiled, data)
    weight = compiled.body_mass[1] * 9.81
    assert data.xfrc_applied[1, 2] == pytest.approx(weight, rel=1e-9)
    whole = trimesh.creation.icosphere(subdivisions=3, radius=0.5).volume * 512.5 * 9.81
    assert abs(whole / weight - 1.0) > 5e-3  # plain facets would not do


def test_hulls_computed_together_get_what_each_gets_alone():
    """Two alike, that share their tree, another one, and one with a method of its own."""
    ball = '<body pos="{} 2 -0.1"><freejoint/><geom name="{}" size="0.4"/></body>'
    boat = '<body pos="1 1 0"><freejoint/><geom name="boat" type="capsule" size="0.2 0.5"/></body>'
    custom = WAVES + '<text name="buoyancy_method_cube" data="chord"/>'
    bodies = CUBE + ball.format(2, "left") + ball.format(4, "right") + boat
    compiled = model(bodies, ("cube", "right", "boat", "left"), custom)
    data, buoyancy = started(compiled), Buoyancy.from_model(compiled)
    left, right = (f.method for f in buoyancy.floats if f.name in ("left", "right"))
    assert left is right
    buoyancy.apply(compiled, data)
    for f in buoyancy.floats:
        alone = f.method.wrench(data.xipos[f.body], data.ximat[f.body], 0.0)
        assert np.abs(alone).max() > 0.0
        np.testing.assert_array_equal(data.xfrc_applied[f.body], alone)


def raft(custom: str = "") -> mujoco.MjModel:
    """Seven hulls of three shapes, one of them with a method of its own, in waves."""
    ball = (
        '<body pos="{0} 2 0.1"><freejoint/><geom name="ball{0}" size="0.4" density="400"/></body>'
    )
    boat = '<body pos="1 1 0"><freejoint/><geom name="boat" type="capsule" size="0.2 0.5"/></body>'
    custom += WAVES + '<text name="buoyancy_method_cube" data="chord"/>'
    bodies = CUBE + boat + "".join(ball.format(x) for x in range(2, 7))
    return model(bodies, ("boat", "ball2", "cube", *(f"ball{x}" for x in range(3, 7))), custom)


def helpers() -> int:
    return sum(thread.name.startswith("waterline") for thread in threading.enumerate())


def test_threads_change_no_bit():
    runs = {}
    for threads in (1, 2, 5):
        compiled = raft()
        data, buoyancy = started(compiled), Buoyancy.from_model(compiled, threads=threads)
        with buoyancy.installed():
            mujoco.mj_step(compiled, data, nstep=200)
        assert min(threads - 1, 1) <= helpers() <= threads - 1
        runs[threads] = np.concatenate([data.qpos, data.qvel])
        del buoyancy
        no_helpers_are_left()
    np.testing.assert_array_equal(runs[2], runs[1])
    np.testing.assert_array_equal(runs[5], runs[1])


def no_helpers_are_left() -> None:
    gc.collect()
    deadline = monotonic() + 30.0
    while helpers():
        assert monotonic() < deadline
        sleep(0.01)


def test_threads_are_no_more_than_parts_and_end_with_the_buoyancy():
    compiled = raft('<numeric name="buoyancy_threads" data="100"/>')
    data, buoyancy = started(compiled), Buoyancy.from_model(compiled)
    for _ in range(50):
        buoyancy.wrenches(data)
    assert 1 <= helpers() <= 5  # six hulls are computed together
    del buoyancy
    no_helpers_are_left()


@pytest.mark.parametrize("threads", [0, -1, 1.5, np.nan, np.inf])
def test_refuses_threads_that_cannot_be(threads):
    compiled = model()
    with pytest.raises(ValueError, match=f"threads is {threads:g}; it must be a whole"):
        Buoyancy.from_model(compiled, threads=threads)


def test_tiles_of_the_viewer_lie_on_the_water(monkeypatch):
    """MuJoCo's own viewer: the example's drawing, which needs no screen."""
    pytest.importorskip("mujoco.viewer")
    drawing = runpy.run_path(str(REPOSITORY / "scripts" / "examples" / "viewer.py"))
    scene = Scene.load(MODELS / "bunny.xml")
    picture = mujoco.MjvScene(scene.model, 2000)
    drawing["draw_water"](picture, scene)
    assert picture.ngeom == drawing["TILES"] ** 2
    places = np.array([picture.geoms[i].pos for i in range(picture.ngeom)], dtype=float)
    expected = scene.buoyancy.sea.elevation(places[:, 0], places[:, 1], scene.data.time)
    np.testing.assert_allclose(places[:, 2], expected, atol=1e-6)
    assert all(picture.geoms[i].mat[2, 2] > 0.5 for i in range(picture.ngeom))
