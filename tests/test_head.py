"""The head: Froude-Krylov pressure under Gerstner waves, and all methods with it."""

import mujoco
import numpy as np
import pytest
import trimesh

from independent import (
    DENSITY,
    GRAVITY,
    MODELS,
    load_mesh,
    random_poses,
    relative_error,
    three_waves,
)
from sim import Chord, Hull, Linear, Patches, Reference, Scene, Sea, Wave, simulate
from sim.water.head_jets import HEAD_JETS, solve_head_jets
from sim.water.jets import near_particles

DEGREE = np.pi / 180.0
CUBE_WAVES = (
    Wave(0.10, 4.0, 0.0, 0.0),
    Wave(0.06, 2.4, 55.0 * DEGREE, 40.0 * DEGREE),
    Wave(0.03, 1.4, -65.0 * DEGREE, 110.0 * DEGREE),
)


def decaying(*waves: Wave, level: float = 0.0) -> Sea:
    return Sea(waves, DENSITY, GRAVITY, level, "froude-krylov")


def test_known_heads():
    """To the last known digit."""
    sea = decaying(Wave(0.1, 4.0))
    point = (1.0, 0.0, -0.454406187223, 0.0)
    assert sea.head(*point) == pytest.approx(0.493610436067, abs=1e-12)
    assert sea.hydrostatic.head(*point) == pytest.approx(0.554406187223, abs=1e-12)
    known = {
        (0.2, -0.1, -0.05): (0.036489141494, (0.2450941772, 0.0345126277, -1.123055415)),
        (0.2, -0.1, -0.5): (0.502514370231, (0.0857561325, 0.0164816958, -0.9944648885)),
    }
    sea = decaying(*CUBE_WAVES)
    for (x, y, z), (head, gradient) in known.items():
        assert sea.head(x, y, z, 1.5) == pytest.approx(head, abs=1e-12)
        jets = head_jets(sea, np.array([[x, y, z]]), 1.5)
        np.testing.assert_allclose([jets[axis][0] for axis in "xyz"], gradient, atol=5e-10)
    assert sea.head(3.0, 1.0, -1.2, 1.5) == pytest.approx(1.169424613093, abs=1e-12)


def head_jets(sea: Sea, points: np.ndarray, time: float) -> dict[str, np.ndarray]:
    """The fields (N,) of HEAD_JETS at up to a chunk of points."""
    x, y, z = points.T.copy()
    jets = np.empty(1, HEAD_JETS)
    near = near_particles(x, y, sea.components, time, 1, 1e-14)
    solve_head_jets(x, y, z - sea.level, near, sea.components, time, 1e-14, 0.0, jets)
    return {name: jets[name][0, : len(points)] for name in HEAD_JETS.names}


def exact_head(wave: Wave, x: float, z: float) -> float:
    """Head [m] of Gerstner's wave at time 0. Newton's method finds the label (alpha, c)."""
    k, a = wave.wavenumber, wave.amplitude
    alpha, c = x, z
    for _ in range(60):
        e, s, t = a * np.exp(k * c), np.sin(k * alpha), np.cos(k * alpha)
        rest = np.array([alpha + e * t - x, c + e * s - z])
        slope = np.array([[1.0 - k * e * s, k * e * t], [k * e * t, 1.0 + k * e * s]])
        alpha, c = np.array([alpha, c]) - np.linalg.solve(slope, rest)
    return -c - 0.5 * k * a * a * (1.0 - np.exp(2.0 * k * c))


@pytest.mark.parametrize("steepness", [0.05, 0.2, 0.4, 0.6])
def test_a_single_wave_is_within_second_order_of_gerstners_pressure(steepness):
    wave = Wave(steepness * 4.0 / (2.0 * np.pi), 4.0)
    sea, a = decaying(wave), wave.amplitude
    x, depths = np.linspace(0.0, 4.0, 13), np.geomspace(1e-3, 4.0, 12)
    worst = 0.0
    for position in x:
        surface = float(sea.elevation(position, 0.0, 0.0))
        for depth in depths:
            found = float(sea.head(position, 0.0, surface - depth, 0.0))
            worst = max(worst, abs(found - exact_head(wave, position, surface - depth)))
    assert worst <= 0.075 * steepness**2 * a
    assert worst > 1e-3 * steepness**2 * a  # the two pressures differ


def test_the_head_is_zero_only_on_the_surface_and_smooth_across_it():
    sea, step = decaying(*CUBE_WAVES, level=0.3), 1e-6
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-5.0, 5.0, (2, 200))
    surface = sea.elevation(x, y, 2.0)
    np.testing.assert_allclose(sea.head(x, y, surface, 2.0), 0.0, atol=1e-12)
    below = (sea.head(x, y, surface - step, 2.0)) / step
    above = (sea.head(x, y, surface + step, 2.0)) / -step
    second_derivative = 1e-4  # times the step
    np.testing.assert_allclose(below, above, atol=second_derivative)
    for depth in np.linspace(-1.0, 3.0, 41):
        slope = sea.head(x, y, surface - depth - step, 2.0) - sea.head(x, y, surface - depth, 2.0)
        assert (slope / step > 1.0 - sea.steepness - 1e-6).all()


def test_the_deep_head_is_the_depth_below_the_mean_level():
    sea = decaying(*CUBE_WAVES)
    lost = sum(0.5 * w.wavenumber * w.amplitude**2 for w in CUBE_WAVES)
    heads = sea.head(np.linspace(-3.0, 3.0, 20), 0.4, -40.0, 1.0)
    np.testing.assert_allclose(heads, 40.0 - lost, rtol=1e-14)


def test_without_waves_the_head_is_hydrostatic_to_the_bit():
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), decaying(level=0.1)
    for pose in random_poses(4, seed=3):
        for kind in (Linear, Chord, Patches):
            np.testing.assert_array_equal(
                kind(hull, sea).wrench(*pose), kind(hull, sea.hydrostatic).wrench(*pose)
            )


def test_the_gradient_at_the_surface_matches_the_particles_acceleration():
    """For one heading, grad h = - (acceleration / g + z) to round-off."""
    sea = decaying(Wave(0.2, 4.0, 0.7), Wave(0.05, 1.5, 0.7, 1.0))
    labels, time = np.random.default_rng(2).uniform(-9.0, 9.0, (50, 2)), 1.3
    before, here, after = (sea.particles(labels, time + h) for h in (-1e-3, 0.0, 1e-3))
    acceleration = (before - 2.0 * here + after) / 1e-6
    exact = np.zeros((50, 3))
    for wave in sea.waves:
        k, d = wave.wavenumber, np.array([np.cos(wave.heading), np.sin(wave.heading)])
        theta = k * labels @ d - np.sqrt(GRAVITY * k) * time + wave.phase
        square = GRAVITY * k * wave.amplitude
        exact[:, :2] -= square * np.cos(theta)[:, None] * d
        exact[:, 2] -= square * np.sin(theta)
    finite_differences = 1e-4
    np.testing.assert_allclose(acceleration, exact, atol=finite_differences)
    jets = head_jets(sea, here, time)
    gradient = np.stack([jets["x"], jets["y"], jets["z"]], axis=1)
    expected = -(exact / GRAVITY + [0.0, 0.0, 1.0])
    np.testing.assert_allclose(gradient, expected, atol=1e-12)


def test_jets_are_the_derivatives_of_the_head():
    """Each derivative equals differences of the next lower one, and the value equals the head."""
    sea, step = decaying(*CUBE_WAVES), 1e-5
    rng = np.random.default_rng(4)
    points = rng.uniform(-2.0, 2.0, (12, 3)) * [1.0, 1.0, 0.3] - [0.0, 0.0, 0.8]
    jets = head_jets(sea, points, 0.7)
    np.testing.assert_allclose(jets["h"], sea.head(*points.T, 0.7), atol=1e-13)
    finite_differences = 2e-7
    for name in HEAD_JETS.names[:10]:
        for axis, unit in zip("xyz", np.eye(3), strict=True):
            ahead, behind = (head_jets(sea, points + s * step * unit, 0.7) for s in (1.0, -1.0))
            derivative = (ahead[name] - behind[name]) / (2.0 * step)
            full = "".join(sorted(name.strip("h") + axis))
            np.testing.assert_allclose(derivative, jets[full], atol=finite_differences)


METHODS = {
    "linear": lambda hull, sea: Linear(hull, sea),
    "chord": lambda hull, sea: Chord(hull, sea, samples=4),
    "patches": lambda hull, sea: Patches(hull, sea, 1e-3),
}


@pytest.mark.parametrize("method", METHODS)
def test_all_methods_use_the_head(method):
    """They agree with the reference. Hydrostatic pressure differs a hundred times as much."""
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), decaying(*three_waves().waves)
    poses = random_poses(6, seed=8)
    made = METHODS[method](hull, sea)
    truths = [Reference(hull, sea, 1e-7).wrench(*pose) for pose in poses]
    still = [Reference(hull, sea.hydrostatic, 1e-6).wrench(*pose) for pose in poses]
    errors = [relative_error(made.wrench(*p), t, hull) for p, t in zip(poses, truths, strict=True)]
    assert max(errors) < 5e-4
    assert max(relative_error(s, t, hull) for s, t in zip(still, truths, strict=True)) > 0.05


def test_the_reference_converges():
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), decaying(*three_waves().waves)
    pose = random_poses(1, seed=5)[0]
    truth = Reference(hull, sea, 1e-9).wrench(*pose)
    for tolerance in (1e-4, 1e-6):
        found = Reference(hull, sea, tolerance).wrench(*pose)
        assert relative_error(found, truth, hull) < tolerance


def first_harmonic(method, wave: Wave, position) -> np.ndarray:
    """Complex amplitude (6,) of the wrench over a period, per metre of the wave's amplitude."""
    omega = np.sqrt(GRAVITY * wave.wavenumber)
    phases = 2.0 * np.pi * np.arange(16) / 16.0
    wrenches = [method.wrench(position, np.eye(3), phase / omega) for phase in phases]
    return 2.0 / 16.0 * np.exp(1j * phases) @ np.array(wrenches) / wave.amplitude


def test_a_box_in_small_waves_matches_linear_theory_to_second_order():
    """A box 4 m long and 1 m wide, at a draught of 0.5 m, in waves of 8 m."""
    box = trimesh.creation.box(extents=[4.0, 1.0, 1.0])
    hull, errors = Hull.from_trimesh(box), []
    for amplitude in (0.1, 0.05, 0.025):
        wave = Wave(amplitude, 8.0)
        method = Patches(hull, decaying(wave), tolerance=1e-3 * amplitude)
        found = np.abs(first_harmonic(method, wave, np.zeros(3)))
        errors.append(np.abs(found[[0, 2]] - [8315.84, 17289.64]) / 17289.64)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1].max() < 2e-3
    assert ((slopes > 1.9) & (slopes < 2.1)).all(), slopes


def test_the_force_on_a_deep_sphere_matches_the_acceleration_of_the_water():
    """A sphere of radius 1 m, 2 m deep, in waves of 8 m: rho g V k e^(-kd) in surge and heave."""
    hull = Hull.from_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=1.0))
    wave = Wave(0.01, 8.0)
    found = np.abs(first_harmonic(Linear(hull, decaying(wave)), wave, np.array([0.0, 0.0, -2.0])))
    true_volume = 4.0 / 3.0 * np.pi / hull.volume
    np.testing.assert_allclose(found[[0, 2]] * true_volume, 6876.749, rtol=3e-3)


@pytest.mark.parametrize(
    ("length", "heave", "pitch"), [(10.0, 15775.0, 75160.0), (20.0, 45575.0, 77053.0)]
)
def test_forces_on_the_wigley_hull_match_a_panel_code(length, heave, pitch):
    """Linear Froude-Krylov forces of the level hull at its draught, about its centre of mass."""
    mesh = trimesh.load_mesh(MODELS / "meshes" / "wigley.obj", process=False)
    centre, wave = np.array([0.0, 0.0, -0.2]), Wave(0.01, length)
    hull = Hull(mesh.vertices - centre, mesh.faces)
    found = np.abs(first_harmonic(Linear(hull, decaying(wave)), wave, centre))
    np.testing.assert_allclose(found[[2, 4]], [heave, pitch], rtol=0.01)


NEUTRAL = """
<mujoco><option timestep="0.005" integrator="RK4"/>
  <custom><numeric name="wave_a" data="0.05 8 0 0"/><text name="water_pressure" data="{}"/>
    <tuple name="buoyant"><element objtype="geom" objname="ball" prm="0"/></tuple></custom>
  <worldbody><body pos="0 0 -3"><freejoint/>
    <geom name="ball" size="0.1" density="1025"/></body></worldbody></mujoco>"""


def test_a_neutral_ball_deep_down_moves_on_a_circle_and_stays():
    """The water there moves on the radius a e^(-kd). Hydrostatic pressure drives the ball away."""
    k = 2.0 * np.pi / 8.0
    radius, omega = 0.05 * np.exp(-3.0 * k), np.sqrt(GRAVITY * k)
    ends = {}
    for pressure in ("froude-krylov", "hydrostatic"):
        scene = Scene.load(mujoco.MjSpec.from_string(NEUTRAL.format(pressure)))
        # It starts at the right end of the circle, with the velocity of the water there.
        scene.data.qpos[:3] = [radius, 0.0, -3.0]
        scene.data.qvel[2] = -radius * omega
        track = np.array([s.centres[0] for s in simulate(scene, 4 * 2.0 * np.pi / omega, 50.0)])
        ends[pressure] = np.hypot(track[:, 0], track[:, 2] + 3.0)
    np.testing.assert_allclose(ends["froude-krylov"], radius, atol=0.1 * radius)
    assert ends["hydrostatic"].max() > 10.0 * radius
