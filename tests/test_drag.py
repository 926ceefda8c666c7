"""Drag and added mass against known answers, from single elements to bodies in MuJoCo."""

import mujoco
import numpy as np
import pytest
import trimesh
from scenes import CUBE, WAVES, model

from independent import DENSITY, GRAVITY, MODELS, ROUND_OFF, load_mesh, random_rotation, three_waves
from sim import Buoyancy, Drag, DragCoefficients, Hull, Scene, Sea, Wave, simulate
from sim.resistance.drag import WORK
from sim.resistance.elements import ELEMENTS, surface_elements
from sim.resistance.reaction import hull_tables
from sim.resistance.rigid_fit import MEAN_VELOCITY_SHARE, fit_matrix, fit_motion
from sim.statics.equilibrium import Attitude, RigidFloat
from sim.water.gerstner import LABELS, set_labels, solve_labels
from sim.water.motion import ACCELERATION, MOTION, VELOCITY, water_motion

CALM = Sea()
LEVEL = np.eye(3)
DEEP = np.array([0.0, 0.0, -50.0])

TIME_INTEGRATION = 0.02
"""Relative error of first-order time integration at the timesteps of these tests."""

FLAT_ELEMENTS = 0.02
"""Relative error of drag from the 128 flat elements of a surface."""


def water_at(sea: Sea, point, time: float) -> np.ndarray:
    """Velocity and acceleration (6,) of the water at a point."""
    x, y, z = np.array(point, dtype=float).reshape(3, 1)
    guess, labels, motion = np.empty(1, LABELS), np.empty(1, LABELS), np.empty(1, MOTION)
    height = np.empty(1)
    set_labels(x, y, guess)
    waves, tolerance = sea.components, sea.water["tolerance"][0]
    solve_labels(x, y, guess, waves, time, tolerance, 1, height, labels)
    found = []
    for order in (VELOCITY, ACCELERATION):
        water_motion(order, np.maximum(height - z, 0.0), waves, sea.water, time, labels, motion)
        found += [motion[axis][0, 0] for axis in "xyz"]
    return np.array(found)


def cube_hull() -> Hull:
    return Hull.from_trimesh(trimesh.creation.box(extents=(1.0, 1.0, 1.0)))


def ball_hull(radius: float = 0.5) -> Hull:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    mesh.apply_scale((np.pi / 6.0 * (2.0 * radius) ** 3 / mesh.volume) ** (1.0 / 3.0))
    return Hull.from_trimesh(mesh)


@pytest.mark.parametrize("name", ["linear", "form", "friction", "angular"])
def test_each_coefficient_is_finite_and_not_negative(name):
    largest = np.finfo(float).max
    for accepted in (0.0, largest):
        assert getattr(DragCoefficients(**{name: accepted}), name) == accepted
    for refused in (np.nextafter(0.0, -1.0), np.inf, np.nan):
        with pytest.raises(ValueError, match=f"the {name} drag coefficient is"):
            DragCoefficients(**{name: refused})


@pytest.mark.parametrize("name", ["cube", "bunny"])
def test_elements_make_up_the_surface(name):
    """Their areas add up to the surface, and their area vectors to zero."""
    hull = cube_hull() if name == "cube" else Hull.from_trimesh(load_mesh(name))
    elements = surface_elements(hull)[0]
    points = np.stack([elements[axis] for axis in "xyz"])
    normals = np.stack([elements[f"normal_{axis}"] for axis in "xyz"])
    area = np.linalg.norm(hull.area_vectors, axis=1)
    assert np.count_nonzero(elements["area"]) == 128
    assert elements["area"].sum() == pytest.approx(area.sum(), rel=ROUND_OFF)
    centroid = hull.vertices[hull.faces].mean(axis=1).T @ area / area.sum()
    np.testing.assert_allclose(points @ elements["area"] / area.sum(), centroid, atol=ROUND_OFF)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=0), 1.0, atol=ROUND_OFF)
    gap = np.linalg.norm(normals @ elements["area"]) / area.sum()
    assert gap < (ROUND_OFF if name == "cube" else FLAT_ELEMENTS)


CUBE_DRAG = {
    "form": (DragCoefficients(form=1.05), 0.5 * 1.05 * 1.5**2),
    "friction": (DragCoefficients(friction=0.01), 0.5 * 0.01 * 4.0 * 1.5**2),
}


@pytest.mark.parametrize("term", CUBE_DRAG)
def test_drag_of_a_cube_matches_the_textbook(term):
    """Two faces are normal to the motion and four parallel. The form coefficient is the C_D."""
    coefficients, expected = CUBE_DRAG[term]
    wrench = Drag(cube_hull(), CALM, coefficients).wrench(DEEP, LEVEL, [1.5, 0, 0, 0, 0, 0], 0.0)
    np.testing.assert_allclose(wrench / (DENSITY * expected), [-1, 0, 0, 0, 0, 0], atol=ROUND_OFF)


def test_linear_drag_decays_with_depth():
    """Each element's drag falls by e^(-2 d / L), for a hull 1 m long with its top at depth d."""
    drag = Drag(cube_hull(), CALM, DragCoefficients(linear=0.3))
    for top in (0.5, 1.0, 3.0):  # all elements are wet
        wrench = drag.wrench([0, 0, -top - 0.5], LEVEL, [1.5, 0, 0, 0, 0, 0], 0.0)
        mean = 0.5 * np.exp(-2.0 * top) * (1.0 - np.exp(-2.0))
        expected = DENSITY * 2.0 * 0.3 * np.sqrt(GRAVITY) * 1.5 * mean
        assert -wrench[0] == pytest.approx(expected, rel=FLAT_ELEMENTS)


def test_form_drag_of_a_ball_is_half_the_coefficient():
    drag = Drag(ball_hull(), CALM, DragCoefficients(form=0.94))
    wrench = drag.wrench(DEEP, LEVEL, [0, 2.0, 0, 0, 0, 0], 0.0)
    expected = 0.5 * DENSITY * 0.47 * np.pi * 0.25 * 4.0
    assert -wrench[1] == pytest.approx(expected, rel=FLAT_ELEMENTS)


def random_states(count: int):
    rng = np.random.default_rng(5)
    for _ in range(count):
        position = rng.normal(0.0, 0.3, 3)
        yield position, random_rotation(rng), rng.normal(0.0, 1.5, 6), rng.uniform(0.0, 60.0)


ALL_TERMS = DragCoefficients(linear=0.2, form=1.0, friction=0.05)


ROOMY_CUBE = CUBE.replace("<freejoint/>", "<freejoint/><body/>")
"""A cube with its full inertia matrix. For a single body on its joint MuJoCo keeps the diagonal."""


@pytest.mark.parametrize("timestep", [0.002, 0.02])
def test_the_step_is_linearly_implicit_in_the_derivative_of_drag(timestep):
    """(M + h C) a = forces, where finite differences of the drag give C = - d drag / d velocity."""
    custom = WAVES + '<numeric name="drag" data="0.2 1.0 0.05"/>'
    option = f'<option timestep="{timestep}"/>'
    scene = Scene.from_model(model(ROOMY_CUBE, ("cube",), custom, option))
    compiled, data, drag = scene.model, scene.data, scene.buoyancy.floats[0].drag
    inertia = np.diag([*[compiled.body_mass[1]] * 3, *compiled.body_inertia[1]])
    for position, rotation, velocity, time in random_states(5):
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        data.qpos[:], data.time = [*position, *quaternion], time
        data.qvel[:] = [*velocity[:3], *(rotation.T @ velocity[3:])]
        mujoco.mj_forward(compiled, data)
        pose = data.xipos[1].copy(), data.ximat[1].copy()
        step = 1e-5
        differences = [
            drag.wrench(*pose, velocity + change, time)
            - drag.wrench(*pose, velocity - change, time)
            for change in step * np.eye(6)
        ]
        damping = -np.transpose(differences) / (2.0 * step)
        forces = drag.wrench(*pose, velocity, time) + scene.buoyancy.wrenches(data)[0]
        forces[2] -= compiled.body_mass[1] * GRAVITY  # a cube has no gyroscopic torque
        found = np.concatenate([data.qacc[:3], rotation @ data.qacc[3:]])
        expected = np.linalg.solve(inertia + timestep * damping, forces)
        finite_differences = 1e-6 * np.abs(expected).max()
        np.testing.assert_allclose(found, expected, atol=finite_differences)
        assert np.linalg.eigvalsh(damping + damping.T)[0] > 0.0


def test_drag_never_does_work_relative_to_the_water():
    """In calm water, force . velocity + torque . angular velocity is never positive."""
    for mesh in (cube_hull(), Hull.from_trimesh(load_mesh("bunny"))):
        drag = Drag(mesh, CALM, ALL_TERMS)
        for position, rotation, velocity, _ in random_states(50):
            assert drag.wrench(position, rotation, velocity, 0.0) @ velocity <= 0.0


def test_a_body_that_moves_as_the_water_feels_no_drag():
    """A small ball below the surface of a single wave."""
    sea = Sea([Wave(0.3, 8.0, heading=0.4)])
    drag = Drag(ball_hull(0.01), sea, DragCoefficients(linear=0.2, form=1.0))
    position = [1.0, 2.0, -0.5]
    still = drag.wrench(position, LEVEL, np.zeros(6), 1.3)
    water = water_at(sea, position, 1.3)
    carried = drag.wrench(position, LEVEL, [*water[:3], 0, 0, 0], 1.3)
    water_varies_over_the_ball = 0.03
    assert np.linalg.norm(carried) < water_varies_over_the_ball * np.linalg.norm(still)


def exact_motion(wave: Wave, label: float, rest_depth: float, time: float) -> np.ndarray:
    """Position, velocity and acceleration (9,) of a particle of Gerstner's wave, heading +x."""
    k, omega = wave.wavenumber, np.sqrt(GRAVITY * wave.wavenumber)
    theta = k * label - omega * time
    a = wave.amplitude * np.exp(-k * rest_depth)
    s, c = np.sin(theta), np.cos(theta)
    position = [label + a * c, 0.0, a * s - rest_depth]
    return np.array(position + [a * omega * s, 0, -a * omega * c]
                    + [-a * omega**2 * c, 0, -a * omega**2 * s])  # fmt: skip


@pytest.mark.parametrize("rest_depth", [0.0, 0.5, 3.0])
def test_water_moves_as_in_gerstners_wave(rest_depth):
    """It is exact at the surface, apart from the tolerance of labels. Below the surface it is
    within the documented k a of the surface's motion."""
    wave = Wave(0.2, 5.0)
    steepness = wave.steepness  # 0.25
    omega = np.sqrt(GRAVITY * wave.wavenumber)
    for label in np.linspace(0.0, 5.0, 11):
        motion = exact_motion(wave, label, rest_depth, 0.7)
        found = water_at(Sea([wave]), motion[:3], 0.7)
        decay = np.exp(-wave.wavenumber * rest_depth)
        label_tolerance = 2e-4
        allowed = label_tolerance if rest_depth == 0.0 else 2.0 * steepness * decay
        for expected, value, unit in (
            (motion[3:6], found[:3], omega * wave.amplitude),
            (motion[6:9], found[3:], omega**2 * wave.amplitude),
        ):
            assert np.linalg.norm(value - expected) < allowed * unit


SEAS = {
    "three waves": three_waves(),
    "steep": Sea([Wave(0.35, 4.0), Wave(0.1, 2.4, 0.96, 0.7), Wave(0.0309, 1.4, -1.1, 1.9)]),
    "forty waves": Sea.jonswap(significant_height=0.5, peak_period=4.0, seed=1),
}


@pytest.mark.parametrize("name", SEAS)
def test_the_water_is_accurate_enough_for_drag(name):
    """Twice as many Newton steps as the sea requires change the drag by at most 1 % of the drag of
    the same motion deep in calm water."""
    hull, coefficients = Hull.from_trimesh(load_mesh("bunny")), DragCoefficients(0.2, 1.0, 0.005)
    drag, exact = (Drag(hull, SEAS[name], coefficients) for _ in range(2))
    exact.strength = exact.strength.copy()
    exact.strength["steps"] *= 2
    submerged = Drag(hull, CALM, coefficients)
    for position, rotation, velocity, time in random_states(20):
        found = drag.wrench(position, rotation, velocity, time)
        expected = exact.wrench(position, rotation, velocity, time)
        scale = submerged.wrench(DEEP, rotation, velocity, 0.0)
        assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(scale)


def test_forces_do_not_jump_when_elements_get_wet():
    drag = Drag(cube_hull(), CALM, ALL_TERMS)
    heights = np.linspace(-0.7, 0.7, 2001)
    velocity = [0.3, 0.1, -1.0, 0, 0, 0]
    lifts = np.array([drag.wrench([0, 0, z], LEVEL, velocity, 0.0) for z in heights])
    assert np.abs(np.diff(lifts, axis=0)).max() < 0.02 * np.abs(lifts).max()
    assert not lifts[-1].any()


def ball(relative_density: float, custom: str, timestep=0.002, integrator="implicitfast", z=-2.0):
    body = (
        f'<body name="ball" pos="0 0 {z}"><freejoint/><geom name="ball" type="sphere" size="0.1" '
        f'density="{relative_density * DENSITY}"/></body>'
    )
    option = f'<option timestep="{timestep}" integrator="{integrator}"/>'
    return Scene.from_model(model(body, ("ball",), custom=custom, option=option))


BALL_ADDED_MASS = '<numeric name="added_mass" data="0.5 0.5 0.5 0 0 0"/>'


@pytest.mark.parametrize("relative_density", [0.01, 0.5, 1.0, 3.0])
def test_a_submerged_ball_starts_at_its_known_acceleration(relative_density):
    """g (1 - s) / (s + 1/2) with the added mass of half the displaced water."""
    scene = ball(relative_density, BALL_ADDED_MASS)
    mujoco.mj_forward(scene.model, scene.data)
    expected = GRAVITY * (1.0 - relative_density) / (relative_density + 0.5)
    assert scene.data.qacc[2] == pytest.approx(expected, abs=1e-9)
    assert np.abs(np.delete(scene.data.qacc, 2)).max() < 1e-9


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("timestep", [0.001, 0.005, 0.02])
def test_a_light_ball_pops_out_and_settles_at_any_timestep(integrator, timestep):
    custom = BALL_ADDED_MASS + '<numeric name="drag" data="0.2 0.94 0.005"/>'
    scene = ball(0.01, custom, timestep, integrator)
    heights = np.array([s.positions[0, 2] for s in simulate(scene, 12.0, rate=100.0)])
    assert 0.3 < heights.max() < 1.3  # m; it leaves the water at about 4 m/s
    assert np.ptp(heights[-100:]) < 1e-3
    draft = 0.1 - heights[-1]
    displaced = np.pi * draft**2 * (0.3 - draft) / 3.0
    facets_of_the_ball = 0.05
    assert displaced == pytest.approx(0.01 * 4e-3 * np.pi / 3.0, rel=facets_of_the_ball)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("timestep", [0.002, 0.02])
@pytest.mark.parametrize("data", ["200 0 0", "0 1000 0", "0 0 5", "200 1000 5"])
def test_drag_a_thousand_times_too_strong_only_decays(data, timestep, integrator):
    depth = -0.3 if data == "200 0 0" else -5.0  # linear drag acts near the surface
    scene = ball(1.0, f'<numeric name="drag" data="{data}"/>', timestep, integrator, z=depth)
    scene.data.qvel[:] = [3.0, -1.0, 2.0, 1.0, 2.0, -1.0]
    mass, inertia = scene.model.body_mass[1], scene.model.body_inertia[1, 0]
    energies = [
        0.5 * scene.data.qvel**2 @ [mass, mass, mass, inertia, inertia, inertia]
        for _ in simulate(scene, 1.0, 1.0 / timestep)
    ]
    assert (np.diff(energies) <= ROUND_OFF * energies[0]).all()
    assert energies[-1] < 0.1 * energies[0]


def test_a_light_ball_deep_down_rises_at_the_speed_of_form_drag_alone():
    """Linear drag, which stands for waves, acts only near the surface."""
    scene = ball(0.5, '<numeric name="drag" data="0.2 0.94 0"/>', z=-20.0)
    *_, _ = simulate(scene, 2.0)
    lift = scene.model.body_mass[1] * GRAVITY
    expected = np.sqrt(2.0 * lift / (DENSITY * 0.47 * np.pi * 0.01))
    assert scene.data.qvel[2] == pytest.approx(expected, rel=FLAT_ELEMENTS)


OES_SPHERE = """
<mujoco><option timestep="0.01" integrator="RK4"/>
  <custom><numeric name="water_density" data="1000"/>
    <numeric name="added_mass" data="0.4325 0.4325 0.4325 0 0 0"/>
    <tuple name="buoyant"><element objtype="geom" objname="sphere" prm="0"/></tuple></custom>
  <worldbody><body><joint type="slide" axis="0 0 1"/><geom name="sphere" size="5"/>
    <inertial pos="0 0 -2" mass="261799.4" diaginertia="1e6 1e6 1e6"/></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize("height", [1.0, 3.0, 5.0])
def test_a_sphere_with_added_mass_alone_keeps_its_amplitude(height):
    """The sphere of OES Task 10, released from a height. Added mass changes with the wetted volume
    and must not change the energy."""
    scene = Scene.load(mujoco.MjSpec.from_string(OES_SPHERE))
    scene.data.qpos[0] = height
    z = np.array([s.positions[0, 2] for s in simulate(scene, 16.0, 100.0)]) / height
    extremes = np.flatnonzero(np.diff(np.sign(np.diff(z)))) + 1
    assert len(extremes) >= 5
    sample_interval = 2e-3
    np.testing.assert_allclose(np.abs(z[extremes]), 1.0, atol=sample_interval)


BALL_AT_ITS_RADIUS = """<body name="ball"><freejoint/>
    <geom name="ball" type="sphere" size="0.5" density="512.5"/></body>"""


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_no_integrator_changes_the_swing_with_added_mass(integrator):
    """Half of the momentum of the water that joins a hull comes from the hull. The ball leaves and
    enters the water, which doubles its inertia, in each swing."""
    option = f'<option timestep="0.01" integrator="{integrator}"/>'
    scene = Scene.from_model(model(BALL_AT_ITS_RADIUS, ("ball",), BALL_ADDED_MASS, option))
    scene.data.qpos[2] = 0.5
    mujoco.mj_step(scene.model, scene.data, nstep=1200)
    heights = []
    for _ in range(300):
        mujoco.mj_step(scene.model, scene.data)
        heights.append(scene.data.qpos[2])
    band = 0.001  # peaks lie between the samples
    assert np.ptp(heights) == pytest.approx(1.0, abs=band)


def test_coefficients_act_where_the_wet_part_of_a_cylinder_is():
    """Morison 1950: a slender cylinder that is held in waves has rho V (1 + C) du/dt, du/dt the
    mean over its draught. A third of its length above water does not matter."""
    body = """<body name="pile" pos="0 0 -1"><freejoint/><body/>
      <geom name="pile" type="cylinder" size="0.15 2" density="750"/></body>"""
    custom = (
        '<numeric name="added_mass" data="1 1 0 0 0 0"/><numeric name="wave_a" data="0.05 20 0 0"/>'
    )
    scene = Scene.from_model(model(body, ("pile",), custom))
    k, count = 2.0 * np.pi / 20.0, 8
    period, forces = 2.0 * np.pi / np.sqrt(GRAVITY * k), []
    for scene.data.time in np.arange(count) * period / count:
        mujoco.mj_forward(scene.model, scene.data)
        forces.append(scene.data.xfrc_applied[1, 0])
    found = 2.0 / count * np.abs(np.fft.fft(forces)[1])
    acceleration = 0.05 * GRAVITY * k * (1.0 - np.exp(-3.0 * k)) / (3.0 * k)
    expected = DENSITY * np.pi * 0.15**2 * 3.0 * (1.0 + 1.0) * acceleration
    band = 0.01
    assert found == pytest.approx(expected, rel=band)


def test_added_mass_that_follows_the_wet_part_keeps_the_energy():
    """A box tumbles and bobs at the surface. RK4 is of high order while faces leave the water
    smoothly."""
    body = """<body name="box"><freejoint/><body/>
      <geom name="box" type="box" size="1 0.5 0.4" density="512.5"/></body>"""
    custom = '<numeric name="added_mass" data="0.7 0.5 0.9 0.3 0.2 0.3"/>'
    option = '<option timestep="0.01" integrator="RK4"/>'
    scene = Scene.from_model(model(body, ("box",), custom, option))
    scene.data.qpos[2:7] = 0.1, np.cos(0.3), np.sin(0.3), 0.0, 0.0
    scene.data.qvel[:] = [0.3, 0.1, 0.0, 0.0, 0.4, 0.3]
    hull, mass = scene.buoyancy.floats[0].method.hull, scene.model.body_mass[1]
    float_ = RigidFloat(hull.vertices[hull.faces], mass, DENSITY, GRAVITY)
    kinetic, potential, inertia = [], [], np.empty((6, 6))
    for _ in simulate(scene, 4.0, 25.0):
        mujoco.mj_forward(scene.model, scene.data)
        mujoco.mj_fullM(scene.model, scene.data, inertia)  # RK4's matrix has no term of the step
        attitude = Attitude(scene.data.xipos[1, 2], scene.data.xmat[1].reshape(3, 3))
        kinetic.append(0.5 * scene.data.qvel @ inertia @ scene.data.qvel)
        potential.append(float_.energy(attitude, float_.wetted(attitude)))
    energies = np.add(kinetic, potential)
    assert np.ptp(kinetic) > 0.5 * max(kinetic)
    assert np.ptp(energies) < 1e-4 * max(kinetic)


def test_added_mass_has_no_lever_about_the_axis_of_a_round_hull():
    """The pressure on a sphere passes through its centre, and on a cylinder through its axis."""
    cylinder = trimesh.creation.cylinder(radius=0.2, height=2.0, sections=64)
    for mesh, expected in (
        (trimesh.creation.icosphere(subdivisions=3), np.zeros(3)),
        (cylinder, [1.0, 1.0, 0.0]),
        (trimesh.creation.box(extents=(1.0, 2.0, 3.0)), np.ones(3)),
    ):
        grip = Drag(Hull.from_trimesh(mesh), CALM, added_mass=[1] * 6, follows=True).grip
        np.testing.assert_allclose(grip, np.diag(expected), atol=1e-6)


def test_terminal_velocity():
    """A ball of twice the water's density sinks at the speed at which form drag carries it."""
    scene = ball(2.0, '<numeric name="drag" data="0 0.94 0"/>', z=-5.0)
    *_, last = simulate(scene, 5.0)
    drag = scene.buoyancy.drag_wrenches(scene.data)[0]
    in_water = scene.model.body_mass[1] * GRAVITY / 2.0
    rotating_slightly = 1e-3
    assert drag[2] == pytest.approx(in_water, rel=rotating_slightly)
    expected = np.sqrt(2.0 * in_water / (DENSITY * 0.47 * np.pi * 0.01))
    assert -scene.data.qvel[2] == pytest.approx(expected, rel=FLAT_ELEMENTS)
    np.testing.assert_array_equal(last.drag_wrenches[0], drag)


def test_angular_damping_is_a_uniform_rate():
    """Only rotation decays, by 1 / (1 + h c) per step for any inertia."""
    scene = ball(1.0, '<numeric name="drag_angular" data="3"/>', timestep=0.01, z=-5.0)
    scene.data.qvel[:] = [1.0, 0, 0, 2.0, -1.0, 0.5]
    *_, _ = simulate(scene, 1.0)
    np.testing.assert_allclose(scene.data.qvel[0], 1.0, rtol=ROUND_OFF)
    expected = np.array([2.0, -1.0, 0.5]) * 1.03**-100
    np.testing.assert_allclose(scene.data.qvel[3:], expected, rtol=1e-9)


ELLIPSOID = """
    <body name="e" pos="0 0 -50"><freejoint/><body/>
      <geom name="e" type="ellipsoid" size="0.5 0.3 0.2" density="1025"/></body>"""


def test_a_neutral_body_keeps_its_energy_and_momentum_with_added_mass():
    """Kirchhoff 1869: in ideal water at rest, a tumbling body and the water around it keep their
    energy and their impulse."""
    custom = '<numeric name="added_mass" data="0.2 0.6 1.1 0.1 0.4 0.2"/>'
    option = '<option timestep="0.002" integrator="RK4"/>'
    scene = Scene.from_model(model(ELLIPSOID, ("e",), custom=custom, option=option))
    scene.data.qvel[:] = [0.6, 0.3, -0.5, 0.8, -1.0, 0.5]
    drag = scene.buoyancy.floats[0].drag
    compiled = scene.model
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, compiled.body_iquat[1])
    axes, inertia = axes.reshape(3, 3), compiled.body_mass[1] * np.eye(6)
    inertia[3:, 3:] = axes @ np.diag(compiled.body_inertia[1]) @ axes.T
    energies, impulses = [], []
    for sample in simulate(scene, 3.0, rate=50.0):
        rotation = scene.data.xmat[1].reshape(3, 3)  # also of the geom
        nu = np.concatenate([rotation.T @ scene.data.qvel[:3], scene.data.qvel[3:]])
        momentum = (inertia + drag.added_mass) @ nu
        energies.append(0.5 * nu @ momentum)
        impulses.append(rotation @ momentum[:3])
        assert sample.submerged_fractions[0] == pytest.approx(1.0)
    fourth_order = 1e-6  # RK4 keeps its order without drag
    assert np.abs(np.array(energies) / energies[0] - 1.0).max() < fourth_order
    impulse_errors = np.linalg.norm(np.array(impulses) - impulses[0], axis=1)
    assert impulse_errors.max() < fourth_order * np.linalg.norm(impulses[0])


def test_added_mass_lengthens_the_heave_period():
    """A half-submerged cube has an added mass of A f = 0.68 / 2 of the whole cube's water."""
    custom = '<numeric name="added_mass" data="0.68 0.68 0.68 0 0 0"/>'
    option = '<option timestep="0.005"/>'
    scene = Scene.from_model(model(CUBE, ("cube",), custom=custom, option=option))
    scene.data.qpos[2] = 0.01
    heights = np.array([s.positions[0, 2] for s in simulate(scene, 12.0, rate=200.0)])
    before = np.flatnonzero((heights[:-1] < 0.0) & (heights[1:] >= 0.0))
    crossings = before + heights[before] / (heights[before] - heights[before + 1])
    expected = 2.0 * np.pi * np.sqrt((0.5 + 0.34) / GRAVITY)
    assert np.diff(crossings).mean() * 0.005 == pytest.approx(expected, rel=TIME_INTEGRATION)


def test_a_damping_matrix_belongs_to_the_floating_hull():
    """A cube, half submerged at rest, has the full matrix there and twice the matrix deep down. Six
    coefficients belong to the submerged hull. The step is implicit."""
    matrix = np.diag([100.0, 200.0, 300.0, 40.0, 50.0, 60.0])
    given = {"36": " ".join(map(str, matrix.ravel())), "6": "100 200 300 40 50 60"}
    timestep, velocity = 0.02, np.array([0.1, -0.2, 0.0, 0.3, 0.1, -0.1])
    for count, height, share in (("36", 0.0, 1.0), ("36", -9.0, 2.0), ("6", -9.0, 1.0)):
        custom = f'<numeric name="damping" data="{given[count]}"/>'
        option = f'<option timestep="{timestep}"/>'
        scene = Scene.from_model(model(ROOMY_CUBE, ("cube",), custom, option))
        scene.data.qpos[2], scene.data.qvel[:] = height, velocity
        np.testing.assert_allclose(
            scene.buoyancy.drag_wrenches(scene.data)[0], -share * matrix @ velocity, atol=1e-9
        )
        mujoco.mj_forward(scene.model, scene.data)
        mass, inertia = scene.model.body_mass[1], scene.model.body_inertia[1, 0]
        implicit = np.diag([mass] * 3 + [inertia] * 3) + timestep * share * matrix
        expected = np.linalg.solve(implicit, -share * matrix @ velocity)
        lift = scene.buoyancy.wrenches(scene.data)[0, 2] - mass * GRAVITY
        expected[2] += lift / implicit[2, 2]
        np.testing.assert_allclose(scene.data.qacc, expected, atol=1e-9)


TURNED_CUBE = """
    <body name="cube" pos="0 0 -9" euler="20 30 -40"><freejoint/><body/>
      <geom name="cube" type="box" size="0.5 0.5 0.5" pos="0.2 -0.1 0.3" euler="0 0 90" mass="0"/>
      <inertial pos="0.1 0.3 0" mass="1025" diaginertia="200 300 400"/></body>"""

QUADRATIC = '<numeric name="damping_quadratic" data="{}"/>'


def test_quadratic_damping_acts_along_the_axes_of_the_inertial_frame():
    """- D |nu| nu per component, about the centre of mass."""
    given = np.array([100.0, 200.0, 300.0, 40.0, 50.0, 60.0])
    custom = QUADRATIC.format(" ".join(map(str, given)))
    scene = Scene.from_model(model(TURNED_CUBE, ("cube",), custom))
    rng = np.random.default_rng(4)
    for velocity in rng.normal(size=(5, 6)):
        scene.data.qvel[:] = velocity
        mujoco.mj_forward(scene.model, scene.data)
        found = scene.buoyancy.drag_wrenches(scene.data)[0].reshape(2, 3)
        nu, axes = np.empty(6), scene.data.ximat[1].reshape(3, 3)
        mujoco.mj_objectVelocity(scene.model, scene.data, mujoco.mjtObj.mjOBJ_BODY, 1, nu, 1)
        nu = np.roll(nu, 3)  # angular first, in MuJoCo
        expected = -given * np.abs(nu) * nu
        np.testing.assert_allclose((found @ axes).ravel(), expected, atol=1e-9)


def test_any_matrix_of_quadratic_damping_takes_energy():
    """Per component, D |nu| nu of a full matrix may drive a body; the form with roots may not."""
    rng = np.random.default_rng(5)
    half = rng.normal(size=(6, 2)) * [[1.0], [30.0], [1.0], [1.0], [30.0], [1.0]]
    custom = QUADRATIC.format(" ".join(map(str, (half @ half.T).ravel())))
    scene = Scene.from_model(model(TURNED_CUBE, ("cube",), custom))
    for velocity in rng.normal(size=(100, 6)):
        scene.data.qvel[:] = velocity
        mujoco.mj_forward(scene.model, scene.data)
        wrench, generalised = scene.buoyancy.drag_wrenches(scene.data)[0], np.zeros(6)
        mujoco.mj_applyFT(
            scene.model, scene.data, wrench[:3], wrench[3:], scene.data.xipos[1], 1, generalised
        )
        assert generalised @ velocity < 0.0


def test_roll_with_quadratic_damping_decays_by_its_closed_form():
    """A neutral ball on a hinge, its buoyancy L above it: I theta'' + D |theta'| theta' + K theta =
    0. D takes D omega^2 A^3 8/3 of the energy I omega^2 A^2 / 2 in each cycle of amplitude A, so A
    = A0 / (1 + 4 omega D A0 t / (3 pi I))."""
    body = """<body name="ball" pos="0 0 -5"><joint axis="1 0 0"/>
      <geom name="ball" type="sphere" size="0.1" pos="0 0 0.05" mass="0"/>
      <inertial pos="0 0 0" mass="4" diaginertia="0.05 0.05 0.05"/></body>"""
    option = '<option timestep="0.002" integrator="implicitfast"/>'
    custom = QUADRATIC.format("0 0 0 0.03 0 0")
    scene = Scene.from_model(model(body, ("ball",), custom, option))
    omega = np.sqrt(DENSITY * GRAVITY * scene.buoyancy.volumes[0] * 0.05 / 0.05)
    scene.data.qpos[0] = 0.1
    rolls = np.empty(3000)
    for i in range(3000):
        mujoco.mj_step(scene.model, scene.data)
        rolls[i] = scene.data.qpos[0]
    peaks = np.flatnonzero((rolls[1:-1] > rolls[:-2]) & (rolls[1:-1] >= rolls[2:])) + 1
    assert len(peaks) >= 5
    times = (peaks + 1) / 500.0
    expected = 0.1 / (1.0 + 4.0 * omega * 0.03 * 0.1 / (3.0 * np.pi * 0.05) * times)
    slow_decay = 0.01  # the formula is a mean over cycles
    np.testing.assert_allclose(rolls[peaks], expected, rtol=slow_decay)


def test_a_ball_sinks_at_the_speed_of_its_quadratic_damping():
    scene = ball(2.0, QUADRATIC.format("0 0 30 0 0 0"), z=-5.0)
    *_, _ = simulate(scene, 4.0)
    excess = DENSITY * scene.buoyancy.volumes[0] * GRAVITY
    mass = scene.model.body_mass[1]
    expected = np.sqrt((mass * GRAVITY - excess) / 30.0)
    assert -scene.data.qvel[2] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_quadratic_damping_a_million_times_too_strong_only_decays(integrator):
    rng = np.random.default_rng(6)
    half = 1e3 * rng.normal(size=(6, 6))
    custom = QUADRATIC.format(" ".join(map(str, (half @ half.T).ravel())))
    option = f'<option timestep="0.02" integrator="{integrator}" gravity="0 0 -1e-9"/>'
    scene = Scene.from_model(model(TURNED_CUBE, ("cube",), custom, option))
    scene.data.qvel[:] = [3.0, -1.0, 2.0, 1.0, 2.0, -1.0]
    energies, inertia = [], np.empty((6, 6))
    for _ in simulate(scene, 1.0, 50.0):
        mujoco.mj_makeM(scene.model, scene.data)
        mujoco.mj_fullM(scene.model, scene.data, inertia)
        energies.append(0.5 * scene.data.qvel @ inertia @ scene.data.qvel)
    assert (np.diff(energies) <= ROUND_OFF * energies[0]).all()
    assert energies[-1] < 1e-5 * energies[0]


def test_off_centre_coefficients_act_like_a_moved_mass():
    """An added mass that is equal along all axes acts like a particle at the hull's centroid."""
    hull = Hull(cube_hull().vertices + [0.3, -0.2, 0.5], cube_hull().faces)
    matrix = Drag(hull, CALM, added_mass=[0.5, 0.5, 0.5, 0, 0, 0]).added_mass
    rng = np.random.default_rng(2)
    for velocity in rng.normal(size=(5, 6)):
        at_centroid = velocity[:3] + np.cross(velocity[3:], [0.3, -0.2, 0.5])
        energy = 0.5 * 0.5 * DENSITY * at_centroid @ at_centroid
        assert 0.5 * velocity @ matrix @ velocity == pytest.approx(energy, rel=ROUND_OFF)
    rotational = Drag(cube_hull(), CALM, added_mass=[0, 0, 0, 1, 2, 3]).added_mass
    np.testing.assert_allclose(
        rotational, np.diag([0, 0, 0, 1, 2, 3]) * DENSITY / 6.0, atol=ROUND_OFF * DENSITY
    )


def test_a_matrix_is_used_unchanged():
    half = np.random.default_rng(3).normal(size=(6, 6))
    matrix = half @ half.T
    found = Drag(cube_hull(), CALM, added_mass=matrix.ravel()).added_mass
    np.testing.assert_allclose(found, matrix, rtol=ROUND_OFF)


def test_an_applied_force_accelerates_the_added_mass_too():
    scene = ball(1.0, BALL_ADDED_MASS)
    scene.data.qfrc_applied[0] = 10.0
    mujoco.mj_forward(scene.model, scene.data)
    mass = scene.model.body_mass[1]
    assert scene.data.qacc[0] == pytest.approx(10.0 / (1.5 * mass), rel=1e-9)


def test_accelerating_water_carries_a_body_with_added_mass():
    """A ball released deep under a wave: (m + A) a = forces + A times the water's acceleration."""
    wave = '<numeric name="wave_a" data="0.4 9 30 50"/>'
    scene = ball(0.7, BALL_ADDED_MASS + wave)
    mujoco.mj_forward(scene.model, scene.data)
    mass = scene.model.body_mass[1]
    added = 0.5 * scene.buoyancy.floats[0].method.hull.volume * DENSITY
    forces = scene.buoyancy.wrenches(scene.data)[0, :3] - [0.0, 0.0, mass * GRAVITY]
    water = water_at(scene.buoyancy.sea, scene.data.xipos[1], 0.0)[3:]
    assert np.linalg.norm(added * water) > 0.02 * np.linalg.norm(forces)
    expected = (forces + added * water) / (mass + added)
    water_varies_over_the_ball = 2e-4 * np.abs(expected).max()
    np.testing.assert_allclose(scene.data.qacc[:3], expected, atol=water_varies_over_the_ball)


def fitted(hull: Hull, rotation: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """The rigid motion (6,), in the hull's axes, that is closest to the water's velocities (3, N),
    in world axes, at the elements of a submerged hull."""
    surface = surface_elements(hull)
    work, motion, lower = np.zeros(1, WORK), np.zeros(1, MOTION), np.empty((6, 6))
    work["wet"] = surface["area"]
    for axis, row in zip("xyz", velocities, strict=True):
        motion[axis][0, :ELEMENTS] = row
    found = np.empty(6)
    fit_matrix(surface[0], work, lower)
    fit_motion(surface[0], np.ascontiguousarray(rotation).ravel(), work, lower, motion, found)
    return found


@pytest.mark.parametrize("name", ["bunny", "wigley"])
def test_the_fit_finds_rigid_motion_of_the_water(name):
    """A uniform flow is found to round-off, and a rotating one up to the weight of the mean."""
    hull, rng = Hull.from_trimesh(load_mesh(name)), np.random.default_rng(8)
    rotation, u, omega = random_rotation(rng), rng.normal(size=3), rng.normal(size=3)
    points = np.stack([surface_elements(hull)[axis][0] for axis in "xyz"])
    uniform = np.broadcast_to((rotation @ u)[:, None], points.shape)
    np.testing.assert_allclose(fitted(hull, rotation, uniform), [*u, 0, 0, 0], atol=1e-12)
    rotating = rotation @ np.cross(omega, points.T).T
    found = fitted(hull, rotation, uniform + rotating)
    normals = np.stack([surface_elements(hull)[f"normal_{axis}"][0] for axis in "xyz"])
    error = u[:, None] + np.cross(omega, points.T).T
    error -= found[:3, None] + np.cross(found[3:], points.T).T
    normal_error = np.sqrt(np.mean((normals * error).sum(axis=0) ** 2))
    weight_of_the_mean = 0.02
    normal_flow = np.sqrt(np.mean((normals * rotating).sum(axis=0) ** 2))
    assert normal_error < weight_of_the_mean * normal_flow


def test_the_fit_has_the_least_residual():
    """The gradient of the fit's residual, including its weight of the mean velocity, is zero."""
    hull, rng = Hull.from_trimesh(load_mesh("bunny")), np.random.default_rng(9)
    surface = surface_elements(hull)
    velocities = rng.normal(size=(3, ELEMENTS))
    found, area = fitted(hull, LEVEL, velocities), surface["area"][0]
    points = np.stack([surface[axis][0] for axis in "xyz"], axis=1)
    normals = np.stack([surface[f"normal_{axis}"][0] for axis in "xyz"], axis=1)
    mean = area @ velocities.T / area.sum()
    basis = np.hstack([normals, np.cross(points, normals)])
    weights = np.repeat([area.sum(), area @ (points**2).sum(axis=1)], 3)
    weights *= MEAN_VELOCITY_SHARE / 3.0
    relative = found - [*mean, 0, 0, 0]
    residuals = (normals * (velocities.T - mean)).sum(axis=1) - basis @ relative
    gradient = basis.T @ (area * residuals)
    np.testing.assert_allclose(gradient, weights * relative, atol=1e-12 * area.sum())


def test_waves_much_shorter_than_a_hull_hardly_move_it():
    """A long box on waves of a fifth of its length. The water's velocity at a point is ten times
    that of the fitted motion."""
    hull = Hull.from_trimesh(trimesh.creation.box(extents=(10.0, 1.0, 0.5)))
    sea = Sea([Wave(0.02, 2.0)])
    surface = surface_elements(hull)[0]
    velocity = np.array([water_at(sea, p, 0.3)[:3] for p in np.stack(
        [surface[axis] for axis in "xyz"], axis=1)]).T  # fmt: skip
    at_a_point = max(np.linalg.norm(water_at(sea, [x, 0, -0.25], 0.3)[:3]) for x in (0.0, 0.5))
    found = fitted(hull, LEVEL, velocity)
    assert abs(found[2]) < 0.1 * at_a_point


def test_a_body_left_alone_comes_to_rest_in_flat_water():
    custom = '<numeric name="drag" data="0.2 1.05 0.0047"/>' + BALL_ADDED_MASS
    scene = Scene.from_model(model(CUBE, ("cube",), custom=custom))
    scene.data.qpos[2:7] = [0.4, 0.9, 0.3, 0.2, 0.1]
    scene.data.qvel[:] = [0.5, -0.3, 0.0, 0.4, 0.0, 0.6]
    *_, last = simulate(scene, 60.0, rate=1.0)
    assert np.abs(scene.data.qvel).max() < 0.02
    assert last.submerged_fractions[0] == pytest.approx(0.5, abs=1e-3)


def test_a_body_left_alone_in_waves_drifts_with_them():
    """A small float in a long wave follows the surface particles of Gerstner's wave. They move in
    circles, so it does not drift relative to them."""
    custom = '<numeric name="wave_a" data="0.3 12 0 0"/><numeric name="drag" data="1 2 0.01"/>'
    scene = ball(0.5, custom, z=0.0)
    samples = list(simulate(scene, 25.0, rate=50.0))
    track = np.array([s.centres[0] for s in samples])
    times = np.array([s.time for s in samples])
    settled = times > 10.0
    velocity = np.gradient(track, times, axis=0)[settled]
    water = scene.buoyancy.sea.surface(*track[settled].T[:2], times[settled]).velocity
    orbital = np.sqrt(np.mean(water**2))
    assert np.sqrt(np.mean((velocity - water)[:, 0] ** 2)) < 0.1 * orbital
    assert abs((velocity - water).mean(axis=0)[0]) < 0.02 * orbital


def test_stokes_drift_has_its_known_speeds():
    """omega k a^2 cosh(2 k (H - d)) / (2 sinh^2(k H)) along the heading, here in 2 m and in deep
    water, growing with the square of the amplitude."""
    assert stokes_drift(Wave(0.1, 4.0), 0.0)[0] == pytest.approx(0.0617, abs=5e-5)
    assert stokes_drift(Wave(0.2, 10.0), 0.0)[0] == pytest.approx(0.0624, abs=5e-5)
    k, heading = 2.0 * np.pi / 6.0, np.array([np.cos(0.7), np.sin(0.7), 0.0])
    for depth in (2.0, np.inf):
        rate = np.sqrt(GRAVITY * k * np.tanh(k * depth))
        for below in (0.0, 0.4, 1.9):
            decay = np.exp(-2.0 * k * below)
            if depth < np.inf:
                decay = np.cosh(2.0 * k * (depth - below)) / (2.0 * np.sinh(k * depth) ** 2)
            found = stokes_drift(Wave(0.1, 6.0, 0.7), below, depth=depth)
            np.testing.assert_allclose(found, rate * k * 0.01 * decay * heading, atol=1e-12)
    half_grown = stokes_drift(Wave(0.1, 6.0, 0.7), 0.0, ramp=0.8)
    grown = stokes_drift(Wave(0.1, 6.0, 0.7), 0.0)
    np.testing.assert_allclose(half_grown, 0.25 * grown, atol=1e-12)


def stokes_drift(wave: Wave, below: float, **water) -> np.ndarray:
    """Stokes drift (3,) of the water at time 0.4, at a depth under the surface: what it adds to the
    velocity. It adds nothing to the acceleration and the head."""
    seas = [Sea([wave], stokes=stokes, **water) for stokes in (True, False)]
    z = float(seas[0].elevation(0.3, -0.2, 0.4)) - below
    drifting, plain = (water_at(sea, (0.3, -0.2, z), 0.4) for sea in seas)
    np.testing.assert_array_equal(drifting[3:], plain[3:])
    assert seas[0].head(0.3, -0.2, z, 0.4) == seas[1].head(0.3, -0.2, z, 0.4)
    return (drifting - plain)[:3]


def test_a_strongly_dragged_ball_drifts_as_stokes_found():
    """A ball of a 40th of the wavelength, at half of its depth: it samples the drift over that
    depth. Its label in the waves, not its place, drifts steadily."""
    wave, k = Wave(0.1, 4.0), 2.0 * np.pi / 4.0
    rate = np.sqrt(GRAVITY * k)
    custom = (
        '<numeric name="wave_a" data="0.1 4 0 0"/><numeric name="water_stokes" data="1"/>'
        '<numeric name="drag" data="5 50 0"/>'
    )
    body = """<body name="ball"><freejoint/>
      <geom name="ball" type="sphere" size="0.05" density="512.5"/></body>"""
    option = '<option timestep="0.01" integrator="implicitfast"/>'
    scene = Scene.from_model(model(body, ("ball",), custom, option))
    labels = []
    for sample in simulate(scene, 9.0, 20.0):
        x = label = sample.positions[0, 0]
        for _ in range(30):
            label = x - wave.amplitude * np.cos(k * label - rate * sample.time)
        labels.append(label)
    found = np.polyfit(np.arange(120) / 20.0, labels[-120:], 1)[0]
    band = 0.05
    assert found == pytest.approx(rate * k * wave.amplitude**2, rel=band)


def test_zero_coefficients_change_no_bits():
    """Zero coefficients give the same bits as no coefficients."""
    ends = []
    zeros = '<numeric name="drag" data="0 0 0"/><numeric name="added_mass" data="0 0 0 0 0 0"/>'
    for custom in (WAVES, WAVES + zeros):
        scene = Scene.from_model(model(custom=custom))
        *_, last = simulate(scene, 1.0)
        assert not last.drag_wrenches.any()
        assert scene.buoyancy.floats[0].drag is None
        ends.append(np.concatenate([scene.data.qpos, scene.data.qvel]))
    np.testing.assert_array_equal(*ends)


def test_drag_on_links_keeps_their_equilibrium():
    """Drag on links, even a hundred times too strong, moves no equilibrium and stays finite."""
    box = '<geom name="{}" type="box" size="0.5 0.5 0.1" density="512.5"/>'
    tree = f"""
    <body name="front"><freejoint/>{box.format("front")}
      <body name="rear" pos="1.2 0 0"><joint type="hinge" axis="0 1 0" pos="-0.6 0 0"/>
        {box.format("rear")}</body></body>"""
    custom = '<numeric name="drag" data="0.2 1 0.005"/><numeric name="drag_rear" data="20 90 0.5"/>'
    scene = Scene.from_model(model(tree, ("front", "rear"), custom=custom))
    scene.data.qpos[2], scene.data.qpos[7] = 0.2, 0.5
    *_, last = simulate(scene, 60.0, rate=1.0)
    assert np.abs(scene.data.qvel).max() < 1e-2
    np.testing.assert_allclose(scene.data.qpos[[2, 7]], 0.0, atol=0.01)
    assert Buoyancy.of(scene.model).floats[0].drag.added_mass is None
    np.testing.assert_allclose(last.submerged_fractions, 0.5, atol=0.05)


def test_diagonal_damping_converges_to_full_damping():
    """A body with a diagonal inertia matrix takes the damping into its diagonal. The difference to
    the full matrix is of first order."""
    differences = []
    for timestep in (0.004, 0.002, 0.001):
        ends = []
        for body in (CUBE, ROOMY_CUBE):
            custom = WAVES + '<numeric name="drag" data="0.2 1.0 0.05"/>'
            option = f'<option timestep="{timestep}"/>'
            scene = Scene.from_model(model(body, ("cube",), custom, option))
            scene.data.qpos[3:7], scene.data.qvel[:] = [0.8, 0.36, 0.48, 0], [1, -1, 0, 2, 1, 0]
            *_, _ = simulate(scene, 0.2)
            ends.append(scene.data.qvel.copy())
        differences.append(np.abs(ends[0] - ends[1]).max())
    slopes = np.log2(np.array(differences[:-1]) / differences[1:])
    assert ((slopes > 0.8) & (slopes < 1.2)).all(), slopes


def test_diagonal_damping_is_never_too_small():
    """The diagonal minus the full matrix of the same body is positive semidefinite."""
    custom = WAVES + '<numeric name="drag" data="20 100 50"/>'
    for position, rotation, velocity, time in random_states(6):
        matrices = []
        for body in (CUBE, ROOMY_CUBE):
            scene = Scene.from_model(model(body, ("cube",), custom))
            compiled, data, matrix = scene.model, scene.data, np.empty((6, 6))
            mujoco.mju_mat2Quat(data.qpos[3:7], rotation.ravel())
            data.qpos[:3], data.qvel[:], data.time = position, velocity, time
            mujoco.mj_forward(compiled, data)
            mujoco.mj_fullM(compiled, data, matrix)
            matrices.append(matrix)
        simple, roomy = matrices
        assert not (simple - np.diag(np.diag(simple))).any()
        excess = np.linalg.eigvalsh(simple - roomy)
        assert excess[0] > -1e-9 * excess[-1]
        assert excess[-1] > 0.0


CEILING = '<geom type="plane" size="9 9 1" pos="0 0 -1" euler="180 0 0" condim="1"/>'
LIGHT = {
    "box": ('type="box" size="0.4 0.4 0.4" density="60"', -1.42, ""),
    "bunny": (
        'type="mesh" mesh="m" density="200"',
        -1.9,
        f'<mesh name="m" file="{MODELS / "meshes" / "bunny.obj"}" inertia="exact"/>',
    ),
}


@pytest.mark.parametrize("drag", ["0.2 1 0.005", "20 100 0.5", None])
@pytest.mark.parametrize("timestep", [0.002, 0.01])
@pytest.mark.parametrize("shape", LIGHT)
def test_a_body_under_a_ceiling_presses_with_its_net_buoyancy_and_rests(shape, timestep, drag):
    """At any drag and timestep. The bunny rocks and needs strong drag or friction to stop, because
    quadratic drag vanishes with the velocity."""
    look, z, assets = LIGHT[shape]
    friction = 1 if drag == "20 100 0.5" or shape == "box" else 3
    body = f'<body pos="0 0 {z}"><freejoint/><geom name="g" {look} condim="{friction}"/></body>'
    custom = f'<numeric name="drag" data="{drag}"/>' if drag else ""
    option = f'<option timestep="{timestep}" integrator="implicitfast"/>'
    scene = Scene.from_model(model(CEILING + body, ("g",), custom, option, assets))
    mujoco.mj_step(scene.model, scene.data, nstep=round(40.0 / timestep))
    lift = scene.buoyancy.wrenches(scene.data)[0, 2] - scene.model.body_mass[1] * GRAVITY
    assert -scene.data.qfrc_constraint[2] == pytest.approx(lift, rel=1e-6)
    assert np.abs(scene.data.qvel).max() < 1e-6


JOINTS = {
    "a float on a heave joint": '<joint type="slide" axis="0 0 1"/>',
    "a propeller on a hinge": '<joint axis="1 0 0" pos="0 0.3 0"/>',
    "a sensor welded on": "",
    "a ball joint": '<joint type="ball" pos="-0.2 0 0"/>',
}


@pytest.mark.parametrize("is_free", [True, False])
@pytest.mark.parametrize("joint", JOINTS)
def test_added_mass_of_a_link_acts_like_a_particle(joint, is_free):
    """In still water a ball's added mass acts like a weightless particle of half the displaced mass
    at its centre. Chains in motion have the same accelerations with either."""
    half = 0.5 * DENSITY * 4.0 / 3.0 * np.pi * 0.2**3
    particle = (
        f'<body gravcomp="1"><inertial pos="0 0 0" mass="{half}" diaginertia="1e-9 1e-9 1e-9"/>'
        "</body>"
    )
    accelerations = []
    for added in (True, False):
        link = f"""
        <body name="root" pos="0 0 -9" euler="10 20 30">
          {"<freejoint/>" if is_free else '<joint axis="0 1 0" pos="0 0 1"/>'}
          <geom type="box" size="0.3 0.2 0.1" density="700"/>
          <body pos="0.4 0 0"><joint axis="0 1 1" pos="-0.1 0 0"/>
            <geom type="box" size="0.1 0.1 0.1" density="900"/>
            <body pos="0.5 0.1 0" euler="0 40 0">{JOINTS[joint]}
              <geom name="ball" size="0.2" density="800"/>{"" if added else particle}</body>
          </body>
        </body>"""
        custom = '<numeric name="added_mass" data="0.5 0.5 0.5 0 0 0"/>' * added
        scene = Scene.from_model(model(link, ("ball",), custom))
        data = scene.data
        rng = np.random.default_rng(4)
        data.qvel[:] = rng.normal(size=scene.model.nv)
        mujoco.mj_integratePos(scene.model, data.qpos, rng.normal(size=scene.model.nv), 1.0)
        mujoco.mj_forward(scene.model, data)
        accelerations.append(data.qacc.copy())
    scale = np.abs(accelerations[1]).max()
    inertia_of_the_particle = 1e-8
    np.testing.assert_allclose(*np.array(accelerations) / scale, atol=inertia_of_the_particle)


def test_a_matrix_off_the_centre_of_mass_acts_like_a_rigid_body():
    """A full 6 x 6 matrix on a rotated geom off its body's centre of mass acts like a weightless
    second body with the same inertia that is welded there."""
    rng, ends = np.random.default_rng(8), []
    mass, pos, inertia = 400.0, np.array([0.1, -0.2, 0.3]), np.diag([30.0, 50.0, 60.0])
    x, y, z = pos
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix = np.zeros((6, 6))
    matrix[:3, :3], matrix[:3, 3:], matrix[3:, :3] = mass * np.eye(3), -mass * arm, mass * arm
    matrix[3:, 3:] = inertia - mass * arm @ arm
    numbers = " ".join(map(repr, matrix.ravel().tolist()))
    second = (
        f'<body gravcomp="1" pos="{x + 0.2} {y} {z}"><inertial pos="0 0 0" mass="{mass}" '
        'diaginertia="30 50 60"/></body>'
    )
    for added in (True, False):
        body = f"""
        <body pos="0 0 -9" euler="10 20 30"><freejoint/>
          <inertial pos="0.2 0 0" mass="600" diaginertia="100 120 150"/>
          <geom name="g" type="box" size="0.5 0.4 0.3" pos="0.3 0.2 0.1" euler="40 0 20"/>
          {"<body/>" if added else second}</body>"""
        custom = f'<numeric name="added_mass" data="{numbers}"/>' * added
        scene = Scene.from_model(model(body, ("g",), custom))
        scene.data.qvel[:] = rng.normal(size=6) if added else ends[0][1]
        mujoco.mj_forward(scene.model, scene.data)
        ends.append((scene.data.qacc.copy(), scene.data.qvel.copy()))
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-10)


def test_finite_differences_by_mujoco_count_the_matrix_once():
    """mjd_transitionFD skips stages with known results. It must agree with differences of steps."""
    custom = WAVES + BALL_ADDED_MASS + '<numeric name="drag" data="0.2 1 0.005"/>'
    scene = Scene.from_model(model(ROOMY_CUBE, custom=custom))
    compiled, data = scene.model, scene.data
    data.qpos[2], data.qvel[:] = 0.1, [0.3, -0.2, 0.4, 0.5, -0.1, 0.2]
    found, expected, step = np.empty((12, 12)), np.empty((12, 12)), 1e-6
    mujoco.mjd_transitionFD(compiled, data, step, True, found, None, None, None)
    for i in range(12):
        ends = []
        for sign in (1.0, -1.0):
            other = mujoco.MjData(compiled)
            other.qpos[:], other.qvel[:], other.time = data.qpos, data.qvel, data.time
            if i < 6:
                mujoco.mj_integratePos(compiled, other.qpos, sign * np.eye(6)[i], step)
            else:
                other.qvel[i - 6] += sign * step
            mujoco.mj_step(compiled, other)
            ends.append(other)
        change = np.empty(6)
        mujoco.mj_differentiatePos(compiled, change, 2.0 * step, ends[1].qpos, ends[0].qpos)
        expected[:, i] = [*change, *((ends[0].qvel - ends[1].qvel) / (2.0 * step))]
    assert np.abs(expected - np.eye(12)).max() > 0.02
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_a_cube_at_rest_stays_there_with_drag_and_added_mass(integrator):
    custom = '<numeric name="drag" data="0.2 1 0.005"/>' + BALL_ADDED_MASS
    option = f'<option timestep="0.005" integrator="{integrator}"/>'
    scene = Scene.from_model(model(CUBE, ("cube",), custom, option))
    *_, last = simulate(scene, 1.0)
    assert np.abs(last.positions).max() < 1e-13
    assert np.abs(scene.data.qvel).max() < 1e-13


def test_equal_hulls_share_their_elements_and_probes():
    """A hull's rows appear once, however many geoms have it and whatever their coefficients."""
    cube, ball, sea = cube_hull(), ball_hull(), three_waves()
    drags = [
        Drag(hull, sea, DragCoefficients(form=form))
        for hull, form in ((cube, 1.0), (ball, 1.0), (cube, 2.0), (ball, 3.0))
    ]
    hulls, surfaces, probes = hull_tables([(drag, drag.hull.volume) for drag in drags])
    assert hulls["surface"].tolist() == [0, 1, 0, 1]
    assert len(surfaces) == 2
    assert len(probes) == len(drags[0].probes) + len(drags[1].probes)
    forms = 0.25 * sea.density * np.array([1.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(hulls["strength"]["form"], forms, rtol=ROUND_OFF)
    for row, drag in zip(hulls, drags, strict=True):
        assert surfaces[row["surface"]] == drag.surface[0]
        found = probes[row["first_probe"] : row["end_probe"]]
        np.testing.assert_array_equal(found["share"], drag.probes["share"])


@pytest.mark.parametrize("base", ["", '<joint type="slide" axis="1 0 0.5"/>', "<freejoint/>"])
def test_links_carry_the_added_mass_of_their_tree(base):
    """M grows by the sum of J^T A J, with MuJoCo's Jacobians, for branches, a body without joints
    and a body without a hull between others."""
    box = '<geom name="{}" type="box" size="0.3 0.2 0.1" pos="0.1 0.2 0" euler="{} 30 10"/>'
    tree = f"""<body name="root" pos="0 0 -9">{base}{box.format("a", 0)}
      <body pos="1 0 0"><joint type="ball"/><geom size="0.1"/>
        <body pos="0 0 1"><joint axis="0 1 0"/>{box.format("b", 20)}</body>
        <body pos="0 1 0"><joint axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
          <geom size="0.1"/><body euler="10 20 30">{box.format("c", 70)}</body></body></body>
      <body pos="-1 0 0">{box.format("d", 50)}</body></body>"""
    listed = "".join(
        f'<element objtype="geom" objname="{name}"/>' for name in ("abcd" if base else "bc")
    )
    custom = '<numeric name="added_mass" data="0.2 0.8 0.5 0.1 0.3 0.2"/>'
    xml = f"""<mujoco><option integrator="RK4"/><custom>{custom}<tuple name="buoyant">{listed}
      </tuple></custom><worldbody>{tree}</worldbody></mujoco>"""
    scene = Scene.load(mujoco.MjSpec.from_string(xml))
    compiled, data, rng = scene.model, scene.data, np.random.default_rng(3)
    mujoco.mj_integratePos(compiled, data.qpos, rng.normal(size=compiled.nv), 1.0)
    data.qpos[2 if "free" in base else slice(0)] -= 9.0
    mujoco.mj_forward(compiled, data)
    expected, found = np.empty((2, compiled.nv, compiled.nv))
    mujoco.mj_fullM(compiled, data, found)
    mujoco.mj_makeM(compiled, data)
    mujoco.mj_fullM(compiled, data, expected)
    for f in Buoyancy.of(compiled).floats:
        jacobian, turn = np.empty((6, compiled.nv)), data.geom_xmat[f.geom].reshape(3, 3)
        mujoco.mj_jac(compiled, data, jacobian[:3], jacobian[3:], data.geom_xpos[f.geom], f.body)
        jacobian = np.kron(np.eye(2), turn.T) @ jacobian
        expected += jacobian.T @ f.drag.added_mass @ jacobian
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
