"""Finite depth: waves above a level bottom, in all that reads the water."""

import warnings

import mujoco
import numpy as np
import pytest
import trimesh
from scenes import afloat, model

from independent import DENSITY, GRAVITY, relative_error
from sim import Chord, Hull, Linear, Note, Patches, Reference, Sea, Wave
from sim.mjcf.sea_fields import fields_of
from sim.recording.sea_surface import SeaSurface
from sim.water.gerstner import LABELS, set_labels
from sim.water.head_jets import HEAD_JETS, solve_head_jets
from sim.water.jets import near_particles
from sim.water.motion import ACCELERATION, MOTION, VELOCITY, water_motion
from sim.water.records import read_components, read_record
from sim.water.wave import DEEP_PHASE

KNOWN = {
    0.5: (2.221688701, -0.002445520653, 0.197499391172, (0.09577704, -0.99838756),
          (-0.010418803, -0.130557352)),
    1.0: (2.832010880, -0.018159029390, 0.184063334045, (0.08831097, -1.00983428),
          (-0.057216944, -0.215218983)),
    2.0: (3.156911426, -0.028045960068, 0.176281719390, (0.08417259, -1.02212791),
          (-0.076719483, -0.251397361)),
}  # fmt: skip
"""By depth [m], for a wave of 0.1 by 6 m with a phase of 20 degrees at 0.4 s: angular frequency;
elevation at x = 0.7 m; head, its gradient, and the water's velocity 0.2 m below the level there.
They were worked out apart from this package, to the digits given."""

WAVES = (Wave(0.08, 5.0, 0.2, 0.5), Wave(0.04, 3.0, 1.3, 2.0), Wave(0.02, 1.7, -0.7, 4.0))
ROUND_OFF = 1e-12


def jet_at(sea: Sea, x: float, y: float, z: float, time: float) -> dict[str, float]:
    x, y, above = np.array([[x], [y], [z - sea.level]])
    near, jets = near_particles(x, y, sea.components, time, 1, 1e-14), np.empty(1, HEAD_JETS)
    solve_head_jets(x, y, above, near, sea.components, time, 1e-14, 0.0, jets)
    return {name: float(jets[name][0, 0]) for name in HEAD_JETS.names}


def motion_at(order: np.int64, sea: Sea, labels: np.ndarray, depths: np.ndarray, time: float):
    """Velocities or accelerations (N, 3) at depths (N,) [m] below the particles with labels."""
    at, motion = np.empty(1, LABELS), np.empty(1, MOTION)
    set_labels(*labels.T.copy(), at)
    water_motion(order, depths, sea.components, sea.water, time, at, motion)
    return np.stack([motion[0][axis][: len(depths)] for axis in "xyz"], axis=1)


def label_at(sea: Sea, x: float, y: float, time: float) -> np.ndarray:
    """The label (1, 2) of the surface particle above a point, by fixed-point iteration."""
    label = np.array([[x, y]])
    for _ in range(100):
        label = label + [x, y] - sea.particles(label, time)[:, :2]
    return label


@pytest.mark.parametrize("depth", KNOWN)
def test_known_answers(depth):
    omega, elevation, head, gradient, velocity = KNOWN[depth]
    sea = Sea([Wave(0.1, 6.0, 0.0, np.radians(20.0))], depth=depth)
    printed = 6e-10
    assert sea.components["rate"][0] == pytest.approx(omega, abs=printed)
    assert sea.elevation(0.7, 0.0, 0.4) == pytest.approx(elevation, abs=ROUND_OFF)
    assert sea.head(0.7, 0.0, -0.2, 0.4) == pytest.approx(head, abs=ROUND_OFF)
    jet = jet_at(sea, 0.7, 0.0, -0.2, 0.4)
    assert jet["h"] == pytest.approx(head, abs=ROUND_OFF)
    assert [jet["x"], jet["z"]] == pytest.approx(gradient, abs=6e-9)
    label, below = label_at(sea, 0.7, 0.0, 0.4), np.array([0.2 + elevation])
    found = motion_at(VELOCITY, sea, label, below, 0.4)[0]
    assert [found[0], found[2]] == pytest.approx(velocity, abs=printed)


@pytest.mark.parametrize("phase", [DEEP_PHASE, 0.999 * DEEP_PHASE])
def test_the_deep_limit(phase):
    """At k H = 20 all is as on deep water, whether or not the wave counts as one there."""
    deep = Sea([Wave(0.1, 6.0, 0.3)])
    sea = Sea(deep.waves, depth=phase / deep.waves[0].wavenumber)
    x, z = np.linspace(0.0, 6.0, 20), np.linspace(0.2, -6.0, 20)
    np.testing.assert_allclose(sea.head(x, 0.0, z, 1.0), deep.head(x, 0.0, z, 1.0), atol=ROUND_OFF)
    for at in zip(x, z, strict=True):
        jets = ([*jet_at(water, at[0], 0.0, at[1], 1.0).values()] for water in (sea, deep))
        np.testing.assert_allclose(*jets, atol=ROUND_OFF)
    labels, depths = np.stack([x, x], axis=1), np.abs(z)
    for order in (VELOCITY, ACCELERATION):
        motions = (motion_at(order, water, labels, depths, 1.0) for water in (sea, deep))
        np.testing.assert_allclose(*motions, atol=ROUND_OFF)


def test_small_waves_are_those_of_linear_theory():
    """Airy's pressure and velocity, at all depths; no water crosses the bottom."""
    a, depth = 1e-6, 1.2
    wave = Wave(a, 8.0)
    sea, k = Sea([wave], depth=depth), wave.wavenumber
    omega = np.sqrt(sea.gravity * k * np.tanh(k * depth))
    x, z = np.linspace(0.0, 8.0, 13), np.linspace(-0.001, -depth, 13)
    theta = k * x - omega * 0.7
    along, up = (f(k * (depth + z)) / np.cosh(k * depth) for f in (np.cosh, np.sinh))
    second_order = k * a**2 / np.tanh(k * depth)
    head = -z + a * along * np.sin(theta)
    np.testing.assert_allclose(sea.head(x, 0.0, z, 0.7), head, atol=2.0 * second_order)
    velocity = motion_at(VELOCITY, sea, np.stack([x, 0.0 * x], axis=1), -z, 0.7)
    scale = omega * a / np.tanh(k * depth)
    np.testing.assert_allclose(velocity[:, 0], scale * along * np.sin(theta), atol=ROUND_OFF)
    np.testing.assert_allclose(velocity[:, 2], -scale * up * np.cos(theta), atol=ROUND_OFF)
    assert velocity[-1, 2] == pytest.approx(0.0, abs=1e-20)


def test_the_surface_and_the_motion_are_those_of_the_particles():
    """Elevation, drawn water, velocity and acceleration follow from the particles' positions."""
    sea, time, step = Sea(WAVES, level=0.3, depth=0.9), 1.3, 1e-4
    labels = np.random.default_rng(3).uniform(-4.0, 4.0, (30, 2))
    before, now, after = (sea.particles(labels, time + s * step) for s in (-1.0, 0.0, 1.0))
    x, y, z = now.T
    np.testing.assert_allclose(sea.elevation(x, y, time), z, atol=ROUND_OFF)
    velocity = (after - before) / (2.0 * step)
    acceleration = (after - 2.0 * now + before) / step**2
    finite_differences = 1e-6
    np.testing.assert_allclose(sea.surface(x, y, time).velocity, velocity, atol=finite_differences)
    found = motion_at(ACCELERATION, sea, labels, np.zeros(30), time)
    np.testing.assert_allclose(found, acceleration, atol=finite_differences)
    np.testing.assert_allclose(sea.head(x, y, z, time), 0.0, atol=ROUND_OFF)
    step, second_order = 1e-5, 1e-9  # the head is smooth across the surface
    above, below = (sea.head(x, y, z + s * step, time) for s in (1.0, -1.0))
    np.testing.assert_allclose(above, -below, atol=second_order)
    drawn = SeaSurface(sea, 2.0, 20.0, 24).at(np.array([0.5, 0.2]), time).points[:40].astype(float)
    single_precision = 1e-6
    np.testing.assert_allclose(
        sea.elevation(*drawn.T[:2], time), drawn[:, 2], atol=single_precision
    )


def test_jets_are_the_derivatives_of_the_head():
    sea, step, time = Sea(WAVES, depth=0.9), 1e-5, 0.7
    finite_differences = 2e-6
    for point in np.random.default_rng(4).uniform([-2.0, -2.0, -0.9], [2.0, 2.0, -0.1], (6, 3)):
        jet = jet_at(sea, *point, time)
        assert jet["h"] == pytest.approx(float(sea.head(*point, time)), abs=ROUND_OFF)
        for axis, unit in zip("xyz", step * np.eye(3), strict=True):
            ahead, behind = (jet_at(sea, *(point + s * unit), time) for s in (1.0, -1.0))
            for name in HEAD_JETS.names[:10]:
                derivative = (ahead[name] - behind[name]) / (2.0 * step)
                full = "".join(sorted(name.strip("h") + axis))
                assert derivative == pytest.approx(jet[full], abs=finite_differences)


METHODS = {"linear": (Linear, 5e-4), "chord": (Chord, 5e-4), "patches": (Patches, 2e-5)}


@pytest.mark.parametrize("method", METHODS)
def test_all_methods_agree_with_the_reference(method):
    """Deep water differs by a hundred times as much."""
    make, allowed = METHODS[method]
    box = trimesh.creation.box(extents=(1.0, 0.6, 0.5)).subdivide().subdivide().subdivide()
    hull, pose = Hull.from_trimesh(box), (np.array([0.3, 0.1, -0.1]), np.eye(3), 2.0)
    truth, deep = (Reference(hull, Sea(WAVES, depth=h), 1e-5).wrench(*pose) for h in (0.9, np.inf))
    found = make(hull, Sea(WAVES, depth=0.9)).wrench(*pose)
    assert relative_error(found, truth, hull) < allowed
    assert relative_error(deep, truth, hull) > 100.0 * allowed


@pytest.mark.parametrize("phase", [0.5, 1.0, 2.0])
def test_the_force_on_a_barge_is_that_of_linear_theory(phase):
    """Froude-Krylov heave and surge, integrated by hand: the pressure a C(z) sin(theta) over the
    bottom, and over the two ends."""
    length, beam, draught, a = 10.0, 4.0, 0.4, 1e-4
    wave = Wave(a, 30.0)
    k = wave.wavenumber
    depth = phase / k
    sea = Sea([wave], DENSITY, GRAVITY, depth=depth)
    hull = Hull.from_trimesh(trimesh.creation.box(extents=(length, beam, 1.0)))
    position = np.array([0.0, 0.0, 0.5 - draught])
    still = Linear(hull, Sea((), DENSITY, GRAVITY)).wrench(position, np.eye(3), 0.0)
    period = 2.0 * np.pi / float(sea.components["rate"][0])
    heave, surge = (
        Patches(hull, sea, 1e-3 * a).wrench(position, np.eye(3), t) - still
        for t in (0.75 * period, 0.0)  # a crest amidships, and a rising surface aft of it
    )
    scale = 2.0 * DENSITY * GRAVITY * a * beam * np.sin(0.5 * k * length)
    mean = (np.sinh(k * depth) - np.sinh(k * (depth - draught))) / (k * np.cosh(k * depth))
    below = np.cosh(k * (depth - draught)) / np.cosh(k * depth) / k
    assert heave[2] == pytest.approx(scale * below, rel=2e-3)
    assert surge[0] == pytest.approx(-scale * mean, rel=2e-3)


def test_periods_are_kept(tmp_path):
    """Spectra, components by period, and records keep their periods; components by wavelength keep
    their lengths."""
    deep, shallow = (Sea.jonswap(0.05, 3.0, seed=2, depth=h) for h in (np.inf, 0.8))
    rates = shallow.components["rate"]
    np.testing.assert_allclose(rates, deep.components["rate"], rtol=ROUND_OFF)
    assert (shallow.components["wavenumber"] > deep.components["wavenumber"]).all()
    file = tmp_path / "waves.csv"
    file.write_text("amplitude,period\n0.02,0.3\n0.02,3\n0.02,30\n")
    sea = Sea(read_components(file, 9.81, 0.8), depth=0.8)
    np.testing.assert_allclose(2.0 * np.pi / sea.components["rate"], [0.3, 3.0, 30.0])
    file.write_text("amplitude,wavelength\n0.02,5\n")
    assert read_components(file, 9.81, 0.8)[0].wavelength == 5.0
    times = 0.25 * np.arange(160)
    series = 0.04 * np.sin(1.7 * times) + 0.02 * np.cos(2.6 * times + 1.0)
    rows = "\n".join(f"{t},{e}" for t, e in zip(times, series, strict=True))
    file.write_text(f"time,elevation\n{rows}\n")
    sea = Sea(read_record(file, 9.81, 0.4, (1.0, 60.0), (2.0, 1.0), 0.8), depth=0.8)
    found = sea.elevation(2.0, 1.0, times)
    assert np.std((found - series)[5:-5]) < 0.05 * np.std(series)


def test_waves_fold_where_their_particles_meet():
    """At the sum of k a / tanh(k H) = 1, which for long waves is an amplitude of the depth."""
    wave = Wave(0.1, 6.0)
    folding = np.arctanh(wave.steepness) / wave.wavenumber
    assert Sea([wave], depth=1.001 * folding).steepness == pytest.approx(1.0, abs=2e-3)
    with pytest.raises(ValueError, match=r"waves fold.*k a / tanh\(k depth\)"):
        Sea([wave], depth=0.999 * folding)
    with pytest.raises(ValueError, match="fold"):
        Sea.jonswap(1.2, 8.0, depth=0.5)
    for depth in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="depth"):
            Sea(depth=depth)


def test_the_field_is_read_and_written():
    custom = '<numeric name="water_depth" data="0.8"/><numeric name="wave_a" data="0.05 6 0 0"/>'
    sea = afloat(custom=custom).buoyancy.sea
    assert sea.depth == 0.8
    assert sea == Sea([Wave(0.05, 6.0)], sea.density, sea.gravity, sea.level, depth=0.8)
    assert fields_of(sea)["water_depth"] == [0.8]
    assert "water_depth" not in fields_of(Sea())


@pytest.mark.parametrize("depth", KNOWN)
def test_gauge_and_drag_see_the_known_water(depth):
    """A gauge reads the known answers. The drag of a small ball is its drag in a current of the
    known velocity."""
    _, elevation, head, _, (along, up) = KNOWN[depth]
    ball = """<body name="ball" pos="0.7 0 -0.2"><freejoint/><site name="bow"/>
      <geom name="ball" size="0.01" density="1025"/></body>"""
    gauge = """<extension><plugin plugin="waterline.gauge"/></extension>
      <sensor><plugin name="bow" plugin="waterline.gauge" objtype="site" objname="bow"/></sensor>"""
    wave = '<numeric name="wave_a" data="0.1 6 0 20"/>'
    drag = '<numeric name="drag" data="0 1 0"/>'
    bottom = f'<numeric name="water_depth" data="{depth}"/>'
    current = f'<numeric name="water_current" data="{along} 0 {up}"/>'
    drags = []
    for custom in (wave + bottom + drag, current + drag):
        scene = afloat(ball, ("ball",), custom, extra=gauge)
        scene.data.time = 0.4
        mujoco.mj_forward(scene.model, scene.data)
        if custom.startswith(wave):
            known = [elevation, head, along, 0.0, up]
            printed = 6e-10
            np.testing.assert_allclose(scene.data.sensor("bow").data, known, atol=printed)
        drags.append(scene.buoyancy.drag_wrenches(scene.data)[0, :3])
    size_over_wavelength = 1e-3
    np.testing.assert_allclose(*drags, atol=size_over_wavelength * np.linalg.norm(drags[1]))


def test_a_body_that_starts_below_the_bottom_is_noted():
    custom = '<numeric name="water_depth" data="0.3"/>'
    with pytest.warns(Note, match=r"cube.*below the bottom.*-0.3.*water_depth"):
        model(custom=custom)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model(custom=custom.replace("0.3", "30"))
