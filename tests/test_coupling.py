"""Buoyancy in MuJoCo: the rows that it writes, frames, integrators, several models and states."""

import gc
import sys
import weakref

import mujoco
import numpy as np
import pytest
import trimesh
from scenes import CUBE, WATER, WAVES, model, xml

from independent import MODELS, ROUND_OFF
from sim import Buoyancy, Hull, Linear
from sim.plugin.seam import context_of

WEIGHT = 512.5 * 9.81  # N, of the cube


def started(compiled: mujoco.MjModel, qpos: list[float] | None = None) -> mujoco.MjData:
    data = mujoco.MjData(compiled)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_forward(compiled, data)
    return data


def trajectory(compiled: mujoco.MjModel, steps: int = 100) -> np.ndarray:
    data, states = started(compiled), []
    for _ in range(steps):
        mujoco.mj_step(compiled, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "implicit", "discrete", "RK4"])
def test_a_cube_in_equilibrium_stays(integrator):
    """With half the density of water it floats half submerged, from the first step on."""
    compiled = model(option=f'<option timestep="0.005" integrator="{integrator}"/>')
    states = trajectory(compiled)
    np.testing.assert_allclose(states[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(states[:, 7:], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("integrator", "calls"), [("Euler", 1), ("implicitfast", 1), ("discrete", 1), ("RK4", 4)]
)
def test_wrenches_are_computed_once_per_evaluation(integrator, calls):
    compiled = model(option=f'<option integrator="{integrator}"/>', custom=WAVES)
    buoyancy, data = Buoyancy.of(compiled), mujoco.MjData(compiled)
    mujoco.mj_step(compiled, data)
    assert buoyancy.calls(data) == calls
    mujoco.mj_step(compiled, data)
    assert buoyancy.calls(data) == 2 * calls
    assert 0.0 < buoyancy.seconds(data) < 1.0
    assert buoyancy.calls(mujoco.MjData(compiled)) == 0  # each state has its own count


def test_integrators_agree_as_the_timestep_shrinks():
    """All integrators see the same force, so they converge to one trajectory, RK4 the fastest."""
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
def test_wrenches_applied_by_hand_give_the_same_bits_as_the_water(integrator, method):
    """Applied to the same body in the air, through xfrc_applied."""
    option = f'<option timestep="0.005" integrator="{integrator}"/>'
    custom = WAVES + f'<text name="buoyancy_method" data="{method}"/>'
    compiled = model(custom=custom, option=option)
    dry = mujoco.MjModel.from_xml_string(xml(custom=custom, option=option).replace(WATER, ""))
    data, buoyancy, states = started(dry), Buoyancy.of(compiled), []
    for _ in range(100):
        mujoco.mj_kinematics(dry, data)
        data.xfrc_applied[1] = buoyancy.wrenches(data)[0]
        mujoco.mj_step(dry, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_array_equal(states, trajectory(compiled))


def test_two_models_at_once_do_not_affect_each_other():
    calm, rough = model(), model(custom=WAVES)
    alone = {m: trajectory(m) for m in (calm, rough)}
    both = {calm: [], rough: []}
    datas = {m: started(m) for m in (calm, rough)}
    for _ in range(100):
        for m, data in datas.items():
            mujoco.mj_step(m, data)
            both[m].append(np.concatenate([data.qpos, data.qvel]))
    for m in (calm, rough):
        np.testing.assert_array_equal(both[m], alone[m])


def test_dry_models_and_other_rows_stay_unchanged():
    stone = '<body name="stone" pos="5 0 0"><freejoint/><geom name="stone" size="0.1"/></body>'
    compiled = model(CUBE + stone)
    dry = mujoco.MjModel.from_xml_string(xml().replace(WATER, ""))
    data, dry_data = mujoco.MjData(compiled), mujoco.MjData(dry)
    data.xfrc_applied[2] = np.arange(6.0)
    dry_data.xfrc_applied[1] = np.arange(6.0)
    mujoco.mj_forward(compiled, data)
    mujoco.mj_forward(dry, dry_data)
    assert data.xfrc_applied[1, 2] == pytest.approx(WEIGHT)
    np.testing.assert_array_equal(data.xfrc_applied[2], np.arange(6.0))
    np.testing.assert_array_equal(dry_data.xfrc_applied[1], np.arange(6.0))
    assert mujoco.get_mjcb_passive() is None


def test_states_of_one_model_have_their_own_wrenches():
    compiled = model(custom=WAVES)
    high, low = started(compiled, [0, 0, 5, 1, 0, 0, 0]), started(compiled)
    for data in (high, low, high):
        mujoco.mj_forward(compiled, data)
    assert not high.xfrc_applied.any()
    assert low.xfrc_applied[1, 2] > 0.0


def test_models_states_and_buoyancies_are_freed():
    compiled = model(custom='<numeric name="water_level" data="-0.25"/>')
    before = sys.getrefcount(compiled)
    data, buoyancy = mujoco.MjData(compiled), Buoyancy.of(compiled)
    count = sys.getrefcount(data)
    context = context_of(compiled)
    assert context.users == 1
    mujoco.mj_step(compiled, data)
    mujoco.mj_resetData(compiled, data)
    assert sys.getrefcount(data) == count
    reference = weakref.ref(buoyancy)
    del data, buoyancy
    gc.collect()
    assert reference() is None
    assert sys.getrefcount(compiled) == before
    assert context.users == 0


def test_a_geom_off_its_body_frame_floats_where_it_is():
    """Its wrench about the centre of mass equals that of a hull placed by hand in the world."""
    geom = '<geom name="g" type="mesh" mesh="m" pos="0.3 -0.2 0.5" euler="20 30 40" density="500"/>'
    ballast = '<geom type="sphere" size="0.1" pos="-0.4 0.6 0.1" density="3000"/>'
    body = f'<body pos="0 0 -0.4" euler="10 0 5"><freejoint/>{geom}{ballast}</body>'
    assets = f'<mesh name="m" file="{MODELS / "meshes" / "bunny.obj"}" inertia="exact"/>'
    custom = WAVES + '<text name="buoyancy_method" data="linear"/>'
    compiled = model(body, ("g",), custom, assets=assets)
    data, buoyancy = started(compiled), Buoyancy.of(compiled)
    assert np.abs(data.geom_xpos[0] - data.xipos[1]).max() > 0.05  # the case is not trivial
    count = compiled.mesh_vertnum[0]
    in_world = compiled.mesh_vert[:count] @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    hull = Hull(in_world - data.xipos[1], compiled.mesh_face)
    expected = Linear(hull, buoyancy.sea).wrench(data.xipos[1], np.eye(3), 0.0)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(data.xfrc_applied[1] / scale, expected / scale, atol=ROUND_OFF)


def test_two_geoms_of_a_body_add_up():
    """A box cut into two halves floats like the whole box."""
    half = '<geom name="{}" type="box" size="0.25 0.5 0.5" pos="{} 0 0" density="512.5"/>'
    halves = half.format("left", -0.25) + half.format("right", 0.25)
    cut = model(f'<body euler="10 20 30"><freejoint/>{halves}</body>', ("left", "right"))
    whole = model(CUBE.replace("<body", '<body euler="10 20 30"'))
    rows = []
    for compiled in (cut, whole):
        data = started(compiled)
        rows.append(data.xfrc_applied[1].copy())
    # On flat water the straight clip is exact for any triangulation.
    np.testing.assert_allclose(rows[0], rows[1], atol=ROUND_OFF * WEIGHT)


def test_bodies_of_a_kinematic_tree_float_each_by_itself():
    """Two boxes joined by a hinge float level on flat water, each carrying its own weight."""
    box = '<geom name="{}" type="box" size="0.5 0.5 0.1" density="512.5"/>'
    tree = f"""
    <body name="front"><freejoint/>{box.format("front")}
      <body name="rear" pos="1.2 0 0"><joint type="hinge" axis="0 1 0" pos="-0.6 0 0"/>
        {box.format("rear")}</body></body>"""
    compiled = model(tree, ("front", "rear"))
    data = started(compiled)
    assert Buoyancy.of(compiled).body_names == ("front", "rear")
    for _ in range(200):
        mujoco.mj_step(compiled, data)
    np.testing.assert_allclose(data.qpos[2], 0.0, atol=1e-9)
    np.testing.assert_allclose(data.qpos[7], 0.0, atol=1e-9)
    data.qpos[7] = 0.3  # the rear end dips and is pushed up
    mujoco.mj_forward(compiled, data)
    assert data.xfrc_applied[2, 2] > compiled.body_mass[2] * 9.81


def test_reading_wrenches_writes_nothing():
    compiled = model(custom=WAVES)
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    wrenches = Buoyancy.of(compiled).wrenches(data)
    assert not data.xfrc_applied.any()
    mujoco.mj_forward(compiled, data)
    np.testing.assert_array_equal(wrenches[0], data.xfrc_applied[1])


def test_a_sphere_floats_at_the_depth_of_its_mass():
    """The facets have the ball's volume, so at half the water's density it is half submerged."""
    ball = '<body><freejoint/><geom name="b" type="sphere" size="0.5" density="512.5"/></body>'
    compiled = model(ball, ("b",))
    data = started(compiled)
    weight = compiled.body_mass[1] * 9.81
    assert data.xfrc_applied[1, 2] == pytest.approx(weight, rel=1e-9)
    whole = trimesh.creation.icosphere(subdivisions=3, radius=0.5).volume * 512.5 * 9.81
    assert abs(whole / weight - 1.0) > 5e-3  # facets with vertices on the sphere have less volume


def test_hulls_computed_together_equal_each_alone():
    """Two equal balls that share a tree, a capsule, and a cube with another method."""
    ball = '<body pos="{} 2 -0.1"><freejoint/><geom name="{}" size="0.4"/></body>'
    boat = '<body pos="1 1 0"><freejoint/><geom name="boat" type="capsule" size="0.2 0.5"/></body>'
    custom = WAVES + '<text name="buoyancy_method_cube" data="chord"/>'
    bodies = CUBE + ball.format(2, "left") + ball.format(4, "right") + boat
    compiled = model(bodies, ("cube", "right", "boat", "left"), custom)
    data, buoyancy = started(compiled), Buoyancy.of(compiled)
    left, right = (f.method for f in buoyancy.floats if f.name in ("left", "right"))
    assert left is right
    for f in buoyancy.floats:
        alone = f.method.wrench(data.xipos[f.body], data.ximat[f.body], 0.0)
        assert np.abs(alone).max() > 0.0
        np.testing.assert_array_equal(data.xfrc_applied[f.body], alone)


def test_a_hull_without_a_finite_pose_has_no_wrench_and_no_volume():
    other = CUBE.replace('"cube"', '"other"').replace("0 0 0", "3 0 -2")
    compiled = model(CUBE + other, ("cube", "other"), WAVES)
    data, buoyancy = started(compiled), Buoyancy.of(compiled)
    data.geom_xpos[0, 2] = np.nan
    for found in (buoyancy.push(data)[:, 2], buoyancy.submerged_volumes(data)):
        assert np.isnan(found[0])
        assert np.isfinite(found[1])
    data.time = np.inf
    assert np.isnan(buoyancy.push(data)).all()
    assert np.isnan(buoyancy.submerged_volumes(data)).all()
