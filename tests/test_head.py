"""The head: Froude and Krylov's pressure under Gerstner waves, and how all methods take it."""

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
from sim.water.head_jets import HEAD_JET, solve_head_jets
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
    """The design's, to the last digit given there."""
    sea = decaying(Wave(0.1, 4.0))
    place = (1.0, 0.0, -0.454406187223, 0.0)
    assert sea.head(*place) == pytest.approx(0.493610436067, abs=1e-12)
    assert sea.hydrostatic.head(*place) == pytest.approx(0.554406187223, abs=1e-12)
    known = {
        (0.2, -0.1, -0.05): (0.036489141494, (0.2450941772, 0.0345126277, -1.123055415)),
        (0.2, -0.1, -0.5): (0.502514370231, (0.0857561325, 0.0164816958, -0.9944648885)),
    }
    sea = decaying(*CUBE_WAVES)
    for (x, y, z), (head, gradient) in known.items():
        assert sea.head(x, y, z, 1.5) == pytest.approx(head, abs=1e-12)
        jet = head_jets(sea, np.array([[x, y, z]]), 1.5)[0]
        np.testing.assert_allclose([jet["x"], jet["y"], jet["z"]], gradient, atol=5e-10)
    assert sea.head(3.0, 1.0, -1.2, 1.5) == pytest.approx(1.169424613093, abs=1e-12)


def head_jets(sea: Sea, places: np.ndarray, time: float) -> np.ndarray:
    x, y, z = places.T.copy()
    jets = np.empty(len(places), HEAD_JET)
    near = near_particles(x, y, sea.components, time, 1)
    solve_head_jets(x, y, z - sea.level, near, sea.components, time, 1e-14, jets)
    return jets


def exact_head(wave: Wave, x: float, z: float) -> float:
    """Gerstner's own pressure at time 0: of the particle of label (alpha, c), found by Newton."""
    k, a = wave.wavenumber, wave.amplitude
    alpha, c = x, z
    for _ in range(60):
        e, s, t = a * np.exp(k * c), np.sin(k * alpha), np.cos(k * alpha)
        rest = np.array([alpha + e * t - x, c + e * s - z])
        slope = np.array([[1.0 - k * e * s, k * e * t], [k * e * t, 1.0 + k * e * s]])
        alpha, c = np.array([alpha, c]) - np.linalg.solve(slope, rest)
    return -c - 0.5 * k * a * a * (1.0 - np.exp(2.0 * k * c))


@pytest.mark.parametrize("steepness", [0.05, 0.2, 0.4, 0.6])
def test_a_single_wave_is_within_second_order_of_gerstners_own_pressure(steepness):
    wave = Wave(steepness * 4.0 / (2.0 * np.pi), 4.0)
    sea, a = decaying(wave), wave.amplitude
    x, depths = np.linspace(0.0, 4.0, 13), np.geomspace(1e-3, 4.0, 12)
    worst = 0.0
    for place in x:
        surface = float(sea.elevation(place, 0.0, 0.0))
        for depth in depths:
            found = float(sea.head(place, 0.0, surface - depth, 0.0))
            worst = max(worst, abs(found - exact_head(wave, place, surface - depth)))
    assert worst <= 0.075 * steepness**2 * a
    assert worst > 1e-3 * steepness**2 * a  # it is not that pressure itself


def test_the_head_is_zero_on_the_surface_alone_and_smooth_across():
    sea, step = decaying(*CUBE_WAVES, level=0.3), 1e-6
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-5.0, 5.0, (2, 200))
    surface = sea.elevation(x, y, 2.0)
    np.testing.assert_allclose(sea.head(x, y, surface, 2.0), 0.0, atol=1e-12)
    below = (sea.head(x, y, surface - step, 2.0)) / step
    above = (sea.head(x, y, surface + step, 2.0)) / -step
    np.testing.assert_allclose(below, above, atol=1e-4)  # the second derivative times the step
    for depth in np.linspace(-1.0, 3.0, 41):
        slope = sea.head(x, y, surface - depth - step, 2.0) - sea.head(x, y, surface - depth, 2.0)
        assert (slope / step > 1.0 - sea.steepness - 1e-6).all()


def test_deep_down_the_water_weighs_what_its_mean_level_says():
    sea = decaying(*CUBE_WAVES)
    lost = sum(0.5 * w.wavenumber * w.amplitude**2 for w in CUBE_WAVES)
    heads = sea.head(np.linspace(-3.0, 3.0, 20), 0.4, -40.0, 1.0)
    np.testing.assert_allclose(heads, 40.0 - lost, rtol=1e-14)


def test_without_waves_it_is_hydrostatic_to_the_bit():
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), decaying(level=0.1)
    for pose in random_poses(4, seed=3):
        for kind in (Linear, Chord, Patches):
            np.testing.assert_array_equal(
                kind(hull, sea).wrench(*pose), kind(hull, sea.hydrostatic).wrench(*pose)
            )


def test_at_the_surface_the_gradient_is_what_the_particles_acceleration_asks_for():
    """Of one heading, to round-off: grad h = - (acceleration / g + z)."""
    sea = decaying(Wave(0.2, 4.0, 0.7), Wave(0.05, 1.5, 0.7, 1.0))
    labels, time = np.random.default_rng(2).uniform(-9.0, 9.0, (50, 2)), 1.3
    places = sea.particles(labels, time)
    before, here, after = (sea.particles(labels, time + h) for h in (-1e-3, 0.0, 1e-3))
    acceleration = (before - 2.0 * here + after) / 1e-6
    exact = np.zeros((50, 3))
    for wave in sea.waves:
        k, d = wave.wavenumber, np.array([np.cos(wave.heading), np.sin(wave.heading)])
        theta = k * labels @ d - np.sqrt(GRAVITY * k) * time + wave.phase
        square = GRAVITY * k * wave.amplitude
        exact[:, :2] -= square * np.cos(theta)[:, None] * d
        exact[:, 2] -= square * np.sin(theta)
    np.testing.assert_allclose(acceleration, exact, atol=1e-4)
    jets = head_jets(sea, places, time)
    gradient = np.stack([jets["x"], jets["y"], jets["z"]], axis=1)
    expected = -(exact / GRAVITY + [0.0, 0.0, 1.0])
    np.testing.assert_allclose(gradient, expected, atol=1e-12)


def test_jets_are_the_derivatives_of_the_head():
    """Each number of a jet against differences of the one before, along all axes; the first
    against heads."""
    sea, step = decaying(*CUBE_WAVES), 1e-5
    rng = np.random.default_rng(4)
    places = rng.uniform(-2.0, 2.0, (12, 3)) * [1.0, 1.0, 0.3] - [0.0, 0.0, 0.8]
    jets = head_jets(sea, places, 0.7)
    np.testing.assert_allclose(jets["h"], sea.head(*places.T, 0.7), atol=1e-13)
    for name in HEAD_JET.names[:10]:
        for axis, unit in zip("xyz", np.eye(3), strict=True):
            ahead, behind = (head_jets(sea, places + s * step * unit, 0.7) for s in (1.0, -1.0))
            derivative = (ahead[name] - behind[name]) / (2.0 * step)
            full = "".join(sorted(name.strip("h") + axis))
            np.testing.assert_allclose(derivative, jets[full], atol=2e-7)


METHODS = {
    "linear": lambda hull, sea: Linear(hull, sea),
    "chord": lambda hull, sea: Chord(hull, sea, samples=4),
    "patches": lambda hull, sea: Patches(hull, sea, 1e-3),
}


@pytest.mark.parametrize("method", METHODS)
def test_all_methods_take_it(method):
    """Against the reference; hydrostatic pressure is a hundred times as far away."""
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


def test_a_box_in_small_waves_feels_linear_theory_with_second_order_errors():
    """4 m x 1 m, draught 0.5 m, in waves of 8 m."""
    box = trimesh.creation.box(extents=[4.0, 1.0, 1.0])
    hull, errors = Hull.from_trimesh(box), []
    for amplitude in (0.1, 0.05, 0.025):
        wave = Wave(amplitude, 8.0)
        method = Patches(hull, decaying(wave), tolerance=3e-4 * amplitude)
        found = np.abs(first_harmonic(method, wave, np.zeros(3)))
        errors.append(np.abs(found[[0, 2]] - [8315.84, 17289.64]) / 17289.64)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1].max() < 2e-3
    assert ((slopes > 1.9) & (slopes < 2.1)).all(), slopes


def test_a_deep_sphere_feels_the_acceleration_of_the_water():
    """Radius 1 m, 2 m deep, waves of 8 m: rho g V k e^(-kd) along and up."""
    hull = Hull.from_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=1.0))
    wave = Wave(0.01, 8.0)
    found = np.abs(first_harmonic(Linear(hull, decaying(wave)), wave, np.array([0.0, 0.0, -2.0])))
    true_volume = 4.0 / 3.0 * np.pi / hull.volume
    np.testing.assert_allclose(found[[0, 2]] * true_volume, 6876.749, rtol=3e-3)


@pytest.mark.parametrize(
    ("length", "heave", "pitch"), [(10.0, 15775.0, 75160.0), (20.0, 45575.0, 77053.0)]
)
def test_the_wigley_hull_feels_what_a_panel_code_says(length, heave, pitch):
    """Linear Froude-Krylov forces of the scene's hull, level at its draught, about its centre of
    mass."""
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
    """As the water there does: radius a e^(-kd). Hydrostatic pressure drives it away."""
    import mujoco

    k = 2.0 * np.pi / 8.0
    radius, omega = 0.05 * np.exp(-3.0 * k), np.sqrt(GRAVITY * k)
    ends = {}
    for pressure in ("froude-krylov", "hydrostatic"):
        scene = Scene.load(mujoco.MjSpec.from_string(NEUTRAL.format(pressure)))
        # the velocity of the circle through its right end, where the crest's phase is 0
        scene.data.qpos[:3] = [radius, 0.0, -3.0]
        scene.data.qvel[2] = -radius * omega
        track = np.array([s.centres[0] for s in simulate(scene, 4 * 2.0 * np.pi / omega, 50.0)])
        ends[pressure] = np.hypot(track[:, 0], track[:, 2] + 3.0)
    np.testing.assert_allclose(ends["froude-krylov"], radius, atol=0.1 * radius)
    assert ends["hydrostatic"].max() > 10.0 * radius
