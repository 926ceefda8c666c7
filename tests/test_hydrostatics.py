"""Hydrostatics against closed forms, the methods, and the motion of the same bodies."""

import json

import hydrostatics as script
import make_scenes
import mujoco
import numpy as np
import pytest
import trimesh
from scenes import CUBE, afloat, model, xml

from independent import DENSITY, GRAVITY, MODELS, load_mesh, random_rotation
from sim import Hull, Hydrostatics, Linear, Note, Scene, Sea, hydrostatics, simulate
from sim.geometry import rotation_about
from sim.statics import report
from sim.statics.equilibrium import Attitude, RigidFloat, _moved, rest
from sim.statics.report import Rest
from sim.statics.stability import righting_arms, vanishing_angle

ROUND_OFF = 1e-9
"""Relative error; equilibria are found to 1e-11 of the weight."""

FINITE_DIFFERENCES = 1e-6
"""Relative error of central differences of the energy."""


BOX = """<body name="box"><freejoint/><body/>
  <geom name="box" type="box" size="1 0.5 0.2" density="512.5"/></body>"""


def box_body(length: float, breadth: float, height: float, density: float) -> RigidFloat:
    mesh = trimesh.creation.box(extents=(length, breadth, height))
    mass = DENSITY * density * length * breadth * height
    return RigidFloat(mesh.vertices[mesh.faces], mass, DENSITY, GRAVITY)


def box_scene(size: str, density: float, option: str = "") -> Scene:
    body = (
        f'<body name="box"><freejoint/><geom name="box" type="box" size="{size}" '
        f'density="{density * DENSITY}"/></body>'
    )
    return Scene.from_model(model(body, ("box",), option=option))


def box_hydrostatics(size: str, density: float, option: str = "") -> Hydrostatics:
    return hydrostatics(box_scene(size, density, option))["box"]


def box_at_rest(size: str, density: float, option: str = "") -> Rest:
    return box_hydrostatics(size, density, option).rest


def bunny_body(relative_density: float = 0.5) -> RigidFloat:
    mesh = load_mesh("bunny")
    mass = DENSITY * relative_density * mesh.volume
    return RigidFloat(mesh.vertices[mesh.faces] - mesh.center_mass, mass, DENSITY, GRAVITY)


def test_hydrostatics_of_a_box_barge_match_the_textbook():
    barge = box_hydrostatics("1 0.5 0.2", 0.6)
    found = barge.rest
    assert barge.mass_kg == pytest.approx(0.48 * DENSITY)
    assert barge.volume_m3 == pytest.approx(0.8)
    assert barge.relative_density == pytest.approx(0.6)
    assert barge.reason == ""
    expected = {
        "draught_m": 0.24, "displacement_m3": 0.48, "kb_m": 0.12, "kg_m": 0.2,
        "bmt_m": 1.0 / 12.0 / 0.24,
        "bml_m": 4.0 / 12.0 / 0.24, "gmt_m": 0.2672222222222, "waterplane_m2": 2.0,
        "wetted_m2": 2.0 + 0.24 * 6.0, "lwl_m": 2.0, "bwl_m": 1.0, "cb": 1.0, "cwp": 1.0,
        "heave_period_s": 0.98276795, "roll_period_s": 1.207, "height_m": -0.04,
    }  # fmt: skip
    for key, value in expected.items():
        known_digits = 5e-4 if key == "roll_period_s" else 1e-8
        assert getattr(found, key) == pytest.approx(value, rel=known_digits), key
    for key in ("heel_deg", "trim_deg", "lcb_m", "tcb_m", "lcf_m", "tcf_m"):
        assert getattr(found, key) == pytest.approx(0.0, abs=ROUND_OFF), key
    stiffness = np.array(found.stiffness)
    weight = barge.mass_kg * GRAVITY
    expected = np.diag(
        [0, 0, 2.0 * DENSITY * GRAVITY, weight * found.gmt_m, weight * found.gml_m, 0]
    )
    np.testing.assert_allclose(stiffness, expected, atol=ROUND_OFF * weight)


@pytest.mark.parametrize(
    ("density", "heel"),
    [(0.22, 13.67), (0.23, 19.49), (0.24, 23.49), (0.26, 29.63), (0.27, 33.69), (0.28, 41.19)],
)
def test_square_bars_rest_at_their_known_heel(density, heel):
    """They start upright, which is an unstable equilibrium."""
    found = box_at_rest("5 0.5 0.5", density)
    known_digits = 0.005
    assert abs(found.heel_deg) == pytest.approx(heel, abs=known_digits)
    assert found.trim_deg == pytest.approx(0.0, abs=1e-6)
    assert found.gmt_m > 0.0


def test_righting_arms_of_a_box_match_the_wall_sided_formula():
    """GZ = sin(heel) (GM + BM tan^2(heel) / 2) until the deck or the bilge reaches the surface."""

    def wall_sided(heel_deg: float, gm: float, bm: float) -> float:
        heel = np.radians(heel_deg)
        return np.sin(heel) * (gm + 0.5 * bm * np.tan(heel) ** 2)

    found = box_at_rest("1 0.5 0.2", 0.6)
    assert [heel for heel, _ in found.gz] == list(range(0, 95, 5))
    for heel, arm in found.gz[:4]:  # the deck is dry below 17 degrees
        expected = wall_sided(heel, found.gmt_m, found.bmt_m)
        assert arm == pytest.approx(expected, abs=ROUND_OFF)
    deep = box_body(2.0, 1.0, 1.0, 0.5)  # the deck is dry below 45 degrees
    arms = righting_arms(deep, np.eye(3))
    bm = 1.0 / 12.0 / 0.5
    for heel, arm in arms[arms[:, 0] < 45.0]:
        assert arm == pytest.approx(wall_sided(heel, bm - 0.25, bm), abs=ROUND_OFF)


def test_the_vanishing_angle_of_a_box():
    """A flat box on its edge, at 90 degrees, is equally far from both of its equilibria."""
    found = box_at_rest("1 0.5 0.2", 0.5)
    assert found.vanishing_deg == pytest.approx(90.0, abs=1e-6)
    low = box_body(4.0, 1.0, 0.5, 0.5)
    keel = RigidFloat(low.corners + [0.0, 0.0, 0.3], low.mass, low.density, low.gravity)
    arms = righting_arms(keel, np.eye(3), 175.0)
    assert vanishing_angle(keel, np.eye(3), arms) is None  # the low weight rights it at any heel


def test_gradient_and_stiffness_are_the_derivatives_of_the_energy():
    body, rng, step = bunny_body(), np.random.default_rng(4), 1e-5
    for _ in range(5):
        attitude = Attitude(rng.uniform(-0.1, 0.1) * body.size, random_rotation(rng))
        wetted = body.wetted(attitude)
        pulls, forces = [], []
        for i in range(3):
            ahead, back = (
                _moved(attitude, [0, 1, 2], sign * step * np.eye(3)[i]) for sign in (1.0, -1.0)
            )
            energies = [body.energy(a, body.wetted(a)) for a in (ahead, back)]
            forces.append(-(energies[0] - energies[1]) / (2.0 * step))
            pulls.append(
                -(body.pull(body.wetted(ahead)) - body.pull(body.wetted(back))) / (2 * step)
            )
        error = FINITE_DIFFERENCES * body.weight * body.size
        np.testing.assert_allclose(forces, body.pull(wetted), atol=error)
        stiffness = body.stiffness(attitude, wetted)
        np.testing.assert_allclose(np.array(pulls).T, stiffness, atol=1e3 * error)


def test_hydrostatic_forces_match_the_linear_method():
    hull, sea, rng = Hull.from_trimesh(load_mesh("bunny")), Sea(), np.random.default_rng(5)
    method = Linear(hull, sea)
    body = RigidFloat(hull.vertices[hull.faces], 1.0, DENSITY, GRAVITY)
    for _ in range(5):
        attitude = Attitude(rng.uniform(-0.2, 0.2), random_rotation(rng))
        force = method.wrench([0.0, 0.0, attitude.height], attitude.rotation, 0.0)
        pull = body.pull(body.wetted(attitude)) + [body.weight, 0.0, 0.0]
        np.testing.assert_allclose(pull, force[2:5], atol=1e-10 * DENSITY * GRAVITY * hull.volume)


def test_an_equilibrium_is_found_from_any_attitude():
    """The bunny finds a stable equilibrium from any starting attitude."""
    body, rng = bunny_body(), np.random.default_rng(6)
    for _ in range(20):
        attitude = rest(body, random_rotation(rng))
        wetted = body.wetted(attitude)
        assert np.abs(body.pull(wetted)).max() < ROUND_OFF * body.weight * body.size
        assert np.linalg.eigvalsh(body.stiffness(attitude, wetted)).min() > -1e-9 * body.weight


def test_a_released_body_comes_to_the_rest_of_hydrostatics():
    """The bunny in flat water with drag, simulated."""
    body = """<body name="bunny"><freejoint/><geom name="bunny" type="mesh" mesh="bunny"
      density="500"/></body>"""
    custom = '<numeric name="drag" data="0.5 2 0.01"/>'
    asset = f"""<asset><mesh name="bunny" inertia="exact"
      file="{MODELS / "meshes" / "bunny.obj"}"/></asset>"""
    scene = Scene.from_model(model(body, ("bunny",), custom, asset))
    found = hydrostatics(scene, with_gz=False)["bunny"].rest
    for _ in simulate(scene, 60.0, 1.0):
        pass
    up = scene.data.xmat[1].reshape(3, 3)[2]
    tilt = np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))
    still_rocking_deg, still_heaving_m = 0.2, 1e-3
    assert tilt == pytest.approx(found.tilt_from_start_deg, abs=still_rocking_deg)
    assert scene.data.qpos[2] == pytest.approx(found.height_m, abs=still_heaving_m)


def test_the_wigley_hull_converges_to_its_closed_form():
    vertices, faces = make_scenes.wigley(96)
    scene = Scene.load(MODELS / "wigley.xml")
    coarse = hydrostatics(scene, with_gz=False)["wigley"].rest
    draught, mass = 0.625, DENSITY * 10.0 * 0.625 * 4.0 / 9.0
    body = RigidFloat(np.asarray(vertices)[faces] + [0.0, 0.0, 0.2], mass, DENSITY, GRAVITY)
    attitude = rest(body, np.eye(3))
    wetted = body.wetted(attitude)
    gmt, gml = np.diag(body.stiffness(attitude, wetted))[1:] / body.weight
    heave = 2.0 * np.pi * np.sqrt(mass / (DENSITY * GRAVITY * wetted.waterplane))
    facets = 1e-3
    assert attitude.height == pytest.approx(-0.2, abs=facets * draught)
    assert gmt == pytest.approx(0.1028, rel=facets)
    assert gml == pytest.approx(11.966, rel=facets)
    assert heave == pytest.approx(1.2949, rel=facets)
    coarse_facets = 0.008
    known = {"gmt_m": 0.1028, "gml_m": 11.966, "heave_period_s": 1.2949, "roll_period_s": 2.503,
             "pitch_period_s": 1.4498}  # fmt: skip
    for key, value in known.items():
        assert getattr(coarse, key) == pytest.approx(value, rel=coarse_facets), key


def test_periods_match_the_motion_with_added_mass():
    """A box with added mass, released slightly above its draught."""
    custom = '<numeric name="added_mass" data="0 0 0.8 0 0 0"/>'
    scene = Scene.from_model(model(BOX, ("box",), custom, '<option timestep="0.002"/>'))
    found = hydrostatics(scene, with_gz=False)["box"].rest
    share = found.submerged_fraction
    expected = 2.0 * np.pi * np.sqrt((1.0 + 0.8) * found.draught_m / GRAVITY)
    assert share == pytest.approx(0.5)
    assert found.heave_period_s == pytest.approx(expected, rel=1e-9)
    scene.data.qpos[2] = found.height_m + 1e-4
    heights = np.array([s.positions[0, 2] for s in simulate(scene, 6.0, 500.0)]) - found.height_m
    falling = np.flatnonzero((heights[:-1] > 0.0) & (heights[1:] <= 0.0))
    period = np.diff(falling)[0] / 500.0
    sample_interval = 0.003
    assert period == pytest.approx(found.heave_period_s, abs=sample_interval)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_oscillations_grow_above_the_largest_timestep(integrator):
    option = f'<option integrator="{integrator}"/>'
    found = box_at_rest("1 0.5 0.2", 0.5, option)
    for factor, grows in ((0.97, False), (1.03, True)):
        load = dict(timestep=factor * found.largest_timestep_s)
        scene = afloat(BOX, ("box",), "", option, load=load)
        scene.data.qpos[:] = 0, 0, found.height_m + 1e-6, 1, 1e-6, 1e-6, 0
        largest = 0.0
        while largest < 1e-4 and scene.data.time < 400 * scene.model.opt.timestep:
            mujoco.mj_step(scene.model, scene.data)
            rotated = np.abs(scene.data.qpos[4:6]).max()
            largest = max(rotated, abs(scene.data.qpos[2] - found.height_m))
        assert (largest >= 1e-4) == grows, factor


def test_a_tree_is_one_body():
    found = hydrostatics(Scene.load(MODELS / "articulated.xml"), with_gz=False)
    assert set(found) == {"fore"}
    assert found["fore"].mass_kg == pytest.approx(864.0)


def test_a_sinking_body_has_a_reason_instead_of_a_rest():
    with pytest.warns(Note, match="'box' sinks"):
        stone = box_hydrostatics("1 1 1", 2.5)
    assert stone.rest is None
    assert stone.reason == "sinks: it weighs 2.05e+04 kg and displaces at most 8200 kg"
    assert stone.flat()["sinks"] is True
    assert stone.flat()["reason"] == stone.reason


AUV = """<body name="auv" pos="0 0 -3" euler="{tilt} 0 0"><freejoint/>
    <geom name="auv" type="ellipsoid" size="0.8 0.1 0.1" mass="0"/>
    <inertial pos="0.05 0 -0.02" mass="{mass}" diaginertia="0.4 3 3"/></body>"""


@pytest.mark.parametrize(("ratio", "word"), [(1.0, "is neutral"), (1.5, "sinks")])
def test_a_body_under_water_has_the_pendulum_of_its_buoyancy(ratio, word):
    """GM = BG, and a roll of the period 2 pi sqrt(I / (rho g V BG)), whatever its weight. Its
    centre of mass is 0.02 m below and 0.05 m ahead of its buoyancy."""
    volume = Scene.from_model(model(AUV.format(tilt=0, mass=1), ("auv",))).buoyancy.volumes[0]
    body = AUV.format(tilt=180, mass=ratio * DENSITY * volume)
    with pytest.warns(Note, match=f"'auv' {word}"):
        found = hydrostatics(Scene.from_model(model(body, ("auv",))))["auv"]
    assert found.rest is None
    assert found.flat()["reason"].startswith(word)
    floating, arm = found.submerged, np.hypot(0.02, 0.05)
    assert floating.gmt_m == pytest.approx(arm, rel=ROUND_OFF)
    assert floating.gml_m == pytest.approx(arm, rel=ROUND_OFF)
    assert floating.displacement_m3 == pytest.approx(volume)
    assert floating.trim_deg == pytest.approx(np.degrees(np.arctan2(0.05, 0.02)))
    assert floating.height_m == pytest.approx(-3.0, abs=0.2)
    stiffness = DENSITY * GRAVITY * volume * arm
    assert floating.pitch_period_s == pytest.approx(2.0 * np.pi * np.sqrt(3.0 / stiffness))


FLAP = """<body name="base" pos="2 1 -7"><body name="flap" euler="0 {tilt} 0">
    <joint name="hinge" axis="0 1 0" {joint}/>
    <geom name="flap" type="box" pos="0 0 4.5" size="0.5 3 4.5" density="300"/></body></body>"""


@pytest.mark.parametrize("joint", ["", 'stiffness="1e5" armature="2e5"'])
def test_a_flap_on_a_hinge_at_the_bed_has_its_stiffness_and_period(joint):
    """A box of height H, thickness t and breadth b, d deep on its hinge: K = rho g b t (d^2 / 2 +
    t^2 / 12) - m g H / 2, I = m (H^2 / 3 + t^2 / 12)."""
    spring, armature = (1e5, 2e5) if joint else (0.0, 0.0)
    mass = 300.0 * 6.0 * 9.0
    stiffness = DENSITY * GRAVITY * 6.0 * (24.5 + 1.0 / 12.0) - mass * GRAVITY * 4.5 + spring
    inertia = mass * (81.0 / 3.0 + 1.0 / 12.0) + armature
    period = 2.0 * np.pi * np.sqrt(inertia / stiffness)
    scene = Scene.from_model(model(FLAP.format(tilt=0, joint=joint), ("flap",)))
    scene.data.qpos[0] = 0.3
    found = hydrostatics(scene)["flap"].rest
    assert found.draught_m == pytest.approx(7.0, abs=ROUND_OFF)
    assert found.tilt_from_start_deg == pytest.approx(np.degrees(0.3))
    assert found.heave_period_s is None
    (motion,) = found.joints
    assert motion["joint"] == "hinge"
    assert motion["stiffness"] == pytest.approx(stiffness, rel=1e-8)
    assert motion["period_s"] == pytest.approx(period, rel=1e-8)
    assert found.largest_timestep_s == pytest.approx(2.0 * period / (2.0 * np.pi), rel=1e-6)


def test_joints_of_a_free_body_give_its_rest_and_its_stiffness():
    """Three slides and a ball are a free joint, here tilted and above the water at the start."""
    joints = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    both = []
    for joint in (f'{joints}<joint type="ball"/>', "<freejoint/>"):
        body = f"""<body name="box">{joint}
          <geom name="box" type="box" size="1 0.5 0.2" density="600"/></body>"""
        scene = Scene.from_model(model(body, ("box",)))
        scene.data.qpos[:] = [0.0, 0.0, 0.4, 0.95, 0.2, -0.1, 0.2]
        both.append(hydrostatics(scene)["box"].rest)
    found, expected = both
    for key in ("draught_m", "heel_deg", "trim_deg", "gmt_m", "gml_m"):
        assert getattr(found, key) == pytest.approx(getattr(expected, key), abs=1e-7), key
    heave = found.joints[2]
    assert heave["stiffness"] == pytest.approx(expected.stiffness[2][2], rel=1e-6)
    assert heave["period_s"] == pytest.approx(expected.heave_period_s, rel=1e-6)
    assert found.joints[0]["period_s"] is None


def test_the_script_prints_the_joints_of_a_held_body(tmp_path, capsys):
    file, numbers = tmp_path / "flap.xml", tmp_path / "flap.json"
    file.write_text(xml(FLAP.format(tilt=10, joint=""), ("flap",)))
    assert script.main([str(file), "--json", str(numbers)]) == 0
    assert "joint hinge: period [s]" in capsys.readouterr().out
    (motion,) = json.loads(numbers.read_text())["bodies"]["flap"]["joints"]
    assert motion["is_hinge"] is True


def test_roll_with_coefficients_of_added_mass_has_the_period_of_the_motion():
    """Sway and roll are coupled, because the added mass acts at the centroid of the wet part."""
    custom = '<numeric name="added_mass" data="0.7 0.7 0.7 0.3 0.3 0.3"/>'
    option = '<option timestep="0.005" integrator="RK4"/>'
    scene = Scene.from_model(model(BOX, ("box",), custom, option))
    found = hydrostatics(scene, with_gz=False)["box"].rest
    inertia = np.diag([*3 * [scene.model.body_mass[1]], *scene.model.body_inertia[1]])
    sway_and_roll = np.ix_([1, 3], [1, 3])
    squares = np.linalg.eigvals(
        np.linalg.solve(
            (inertia + found.added_mass)[sway_and_roll], np.array(found.stiffness)[sway_and_roll]
        )
    )
    expected = 2.0 * np.pi / np.sqrt(squares.real.max())
    scene.data.qpos[:] = [0.0, 0.0, found.height_m, 1.0, 1e-3, 0.0, 0.0]
    rolls = np.array([s.quaternions[0, 1] for s in simulate(scene, 3.5, 200.0)])
    before = np.flatnonzero((rolls[:-1] > 0.0) & (rolls[1:] <= 0.0))
    crossings = before + rolls[before] / (rolls[before] - rolls[before + 1])
    flat_elements = 2e-3
    assert np.diff(crossings).mean() / 200.0 == pytest.approx(expected, rel=flat_elements)
    assert abs(expected / found.roll_period_s - 1.0) > 2.0 * flat_elements


def test_a_rest_is_computed_once_until_the_body_changes(monkeypatch):
    searched = []
    monkeypatch.setattr(report, "_RESTS", {})
    monkeypatch.setattr(
        report, "rest", lambda body, start: searched.append(body) or rest(body, start)
    )
    scene = box_scene("1 0.5 0.2", 0.6)  # its notes about the start need the rest
    draught = hydrostatics(scene, with_gz=False)["box"].rest.draught_m
    assert scene.rest_heights.size == 1
    assert len(searched) == 1
    scene.data.qpos[3:7] = 0.0, 1.0, 0.0, 0.0  # upside down, also an equilibrium
    inverted = hydrostatics(scene, with_gz=False)["box"].rest
    assert len(searched) == 2
    assert inverted.tilt_from_start_deg == pytest.approx(0.0, abs=ROUND_OFF)
    scene.model.body_mass[1] *= 1.1
    scene.model.body_subtreemass[1] *= 1.1
    assert hydrostatics(scene)["box"].rest.draught_m == pytest.approx(1.1 * draught)
    assert len(searched) == 3


def test_heel_is_to_starboard_and_trim_bow_down():
    """A weight to port and ahead of the middle of a box."""
    body = """<body name="box"><freejoint/><geom name="box" type="box" size="1 0.5 0.2"
      density="500"/><geom type="sphere" size="0.05" pos="0.3 0.05 0.2" mass="20"/></body>"""
    found = hydrostatics(Scene.from_model(model(body, ("box",))), with_gz=False)["box"].rest
    assert found.trim_deg > 0.1
    assert found.heel_deg < -0.1
    assert found.lcb_m > 0.0
    assert found.tcb_m > 0.0
    trim = rotation_about(np.radians([0.0, found.trim_deg, 0.0]))
    heel = rotation_about(np.radians([found.heel_deg, 0.0, 0.0]))
    tilt = np.degrees(np.arccos((trim @ heel)[2, 2]))
    assert tilt == pytest.approx(found.tilt_from_start_deg, abs=1e-6)


def test_the_script_draws_a_figure(tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra 'report'")
    file = tmp_path / "articulated.png"
    assert script.main([str(MODELS / "articulated.xml"), "--figure", str(file)]) == 0
    assert file.read_bytes().startswith(b"\x89PNG")


def test_the_script_prints_a_table_and_writes_json(tmp_path, capsys):
    file = tmp_path / "articulated.json"
    assert script.main([str(MODELS / "articulated.xml"), "--json", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "metacentric height GMt [m]" in printed
    bodies = json.loads(file.read_text())["bodies"]
    keys = (
        "name sinks mass_kg volume_m3 relative_density draught_m heel_deg trim_deg height_m "
        "tilt_from_start_deg displacement_m3 submerged_fraction kb_m lcb_m tcb_m lcf_m tcf_m bmt_m "
        "bml_m kg_m gmt_m gml_m waterplane_m2 wetted_m2 lwl_m bwl_m cb cwp heave_period_s "
        "roll_period_s pitch_period_s largest_timestep_s vanishing_deg gz stiffness added_mass "
        "joints"
    )
    assert set(bodies["fore"]) == set(keys.split())
    assert script.main([str(tmp_path / "none.xml")]) == 2


def test_the_script_reports_why_a_body_does_not_float(tmp_path, capsys):
    file, numbers = tmp_path / "stone.xml", tmp_path / "stone.json"
    file.write_text(xml(CUBE.replace("512.5", "3000")))
    assert script.main([str(file), "--json", str(numbers)]) == 0
    reason = "sinks: it weighs 3000 kg and displaces at most 1025 kg"
    assert f"cube {reason}" in capsys.readouterr().out
    assert json.loads(numbers.read_text())["bodies"]["cube"]["reason"] == reason
