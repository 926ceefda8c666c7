"""Water and hulls of a model, and all refusals."""

import re
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
import trimesh
from scenes import CUBE, WAVES, afloat, model, xml

from independent import MODELS, ROUND_OFF
from sim import Buoyancy, Chord, DragCoefficients, Linear, ModelError, Scene
from sim.mjcf.fields import NUMERICS, check_numeric


def test_the_sea_is_read_from_custom_fields():
    compiled = model(custom='<numeric name="water_level" data="0.5"/>' + WAVES)
    sea = Buoyancy.of(compiled).sea
    assert (sea.density, sea.gravity, sea.level) == (1025.0, 9.81, 0.5)
    assert [w.amplitude for w in sea.waves] == [0.10, 0.06, 0.03]
    assert [w.wavelength for w in sea.waves] == [4.0, 2.4, 1.4]
    np.testing.assert_allclose([w.heading for w in sea.waves], np.radians([0.0, 55.0, -65.0]))
    np.testing.assert_allclose([w.phase for w in sea.waves], np.radians([0.0, 40.0, 110.0]))


def test_gravity_comes_from_the_model():
    assert Buoyancy.of(model(option='<option gravity="0 0 -1.62"/>')).sea.gravity == 1.62


def test_other_custom_elements_are_ignored():
    other = '<numeric name="gain" data="1 2"/><numeric name="dragon" data="1"/>'
    other += '<text name="author" data="me"/>'
    assert len(Buoyancy.of(model(custom=other)).floats) == 1


GEOMS = {
    "box": ('type="box" size="0.5 0.4 0.3"', 0.48),
    "sphere": ('type="sphere" size="0.5"', np.pi / 6.0),
    "ellipsoid": ('type="ellipsoid" size="0.5 0.4 0.3"', 0.24 * np.pi / 3.0),
    "cylinder": ('type="cylinder" size="0.3 0.5"', 0.09 * np.pi),
    "capsule": ('type="capsule" size="0.3 0.5"', 0.09 * np.pi * 1.4),
}


@pytest.mark.parametrize("kind", GEOMS)
def test_primitives_have_their_exact_volume_and_position(kind):
    """The geom is moved and rotated, so its frame differs from the body's inertial frame."""
    shape, volume = GEOMS[kind]
    pose = 'pos="0.2 -0.1 0.4" euler="30 40 50"'
    second = '<geom type="sphere" size="0.1" pos="-1 0 0"/>'
    body = f'<body><freejoint/><geom name="g" {shape} {pose}/>{second}</body>'
    compiled = model(body, ("g",))
    (geom,) = Buoyancy.of(compiled).floats
    hull = geom.method.hull
    assert hull.volume == pytest.approx(volume, rel=ROUND_OFF)
    rotation = trimesh.transformations.quaternion_matrix(compiled.geom_quat[0])[:3, :3]
    centroid = rotation @ hull.centroid + compiled.geom_pos[0]
    np.testing.assert_allclose(centroid, [0.2, -0.1, 0.4], atol=ROUND_OFF)
    radius = np.linalg.norm(hull.vertices - hull.centroid, axis=1).max()
    expected = {"box": 0.5**0.5, "sphere": 0.5, "ellipsoid": 0.5, "cylinder": 0.34**0.5}
    facets = 4e-3
    assert radius == pytest.approx(expected.get(kind, 0.8), rel=facets)


def test_mesh_geom_is_the_file_in_the_geoms_frame():
    """MuJoCo moves that frame to the mesh's centre of mass, and keeps vertices in float32."""
    assets = f'<mesh name="m" file="{MODELS / "meshes" / "bunny.obj"}" inertia="exact"/>'
    body = '<body><freejoint/><geom name="g" type="mesh" mesh="m" pos="1 2 3"/></body>'
    compiled = model(body, ("g",), assets=assets)
    (geom,) = Buoyancy.of(compiled).floats
    hull = geom.method.hull
    mesh = trimesh.load_mesh(MODELS / "meshes" / "bunny.obj", process=False)
    assert len(hull.faces) == len(mesh.faces)
    single_precision = 1e-6
    assert hull.volume == pytest.approx(mesh.volume, rel=single_precision)
    np.testing.assert_allclose(hull.centroid, 0.0, atol=single_precision)


def test_method_of_one_geom_overrides_the_scenes_and_a_setting_overrides_both():
    custom = """
    <text name="buoyancy_method" data="chord"/> <numeric name="chord_samples" data="7"/>
    <text name="buoyancy_method_ball" data="linear"/>"""
    ball = '<body pos="3 0 0"><freejoint/><geom name="ball" size="0.2"/></body>'
    arguments = CUBE + ball, ("cube", "ball"), custom
    cube, ball = (f.method for f in Buoyancy.of(model(*arguments)).floats)
    assert (type(cube), cube.samples, type(ball)) == (Chord, 7, Linear)
    settings = {"buoyancy_method": "linear", "buoyancy_method_ball": "chord", "chord_samples": 2}
    scene = afloat(*arguments, load=dict(settings=settings))
    cube, ball = (f.method for f in scene.buoyancy.floats)
    assert (type(cube), type(ball), ball.samples) == (Linear, Chord, 2)


def test_a_setting_overrides_the_scenes_pressure():
    plain, still = "", '<text name="water_pressure" data="hydrostatic"/>'
    cases = {
        (plain, None): "froude-krylov",
        (still, None): "hydrostatic",
        (still, "froude-krylov"): "froude-krylov",
        (plain, "hydrostatic"): "hydrostatic",
    }
    for (custom, pressure), expected in cases.items():
        settings = {} if pressure is None else {"water_pressure": pressure}
        buoyancy = afloat(custom=custom, load=dict(settings=settings)).buoyancy
        assert buoyancy.sea.pressure == buoyancy.floats[0].method.sea.pressure == expected


def numbers(matrix: np.ndarray) -> str:
    return " ".join(f"{x:g}" for x in matrix.ravel())


COUPLED = np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
COUPLED[0, 2] = COUPLED[2, 0] = 0.5

TWO_CUBES = CUBE + CUBE.replace('"cube"', '"crate"').replace("0 0 0", "3 0 0")


def test_drag_and_added_mass_of_one_geom_override_the_scenes():
    custom = (
        '<numeric name="drag" data="0.2 1 0.005"/><numeric name="drag_angular" data="0.5"/>'
        '<numeric name="added_mass" data="0.5 0.5 0.5 0 0 0"/>'
        '<numeric name="drag_crate" data="0.3 2 0"/><numeric name="drag_angular_crate" data="0"/>'
        f'<numeric name="added_mass_crate" data="{numbers(np.eye(6))}"/>'
    )
    cube, crate = Buoyancy.of(model(TWO_CUBES, ("cube", "crate"), custom)).floats
    assert cube.drag.coefficients == DragCoefficients(0.2, 1.0, 0.005, 0.5)
    assert crate.drag.coefficients == DragCoefficients(0.3, 2.0, 0.0, 0.0)
    expected = np.diag([1025.0 / 2.0] * 3 + [0.0] * 3)
    np.testing.assert_allclose(cube.drag.added_mass, expected, atol=1e-9)
    submerged_share = 0.5  # at which a floating cube has the given matrix
    np.testing.assert_allclose(crate.drag.added_mass, np.eye(6) / submerged_share, rtol=1e-12)


def test_drag_is_off_by_default():
    assert Buoyancy.of(model()).floats[0].drag is None
    custom = '<numeric name="drag_cube" data="0.2 1 0"/>'
    cube, crate = Buoyancy.of(model(TWO_CUBES, ("cube", "crate"), custom)).floats
    assert cube.drag is not None
    assert crate.drag is None


def test_six_zeros_remove_the_added_mass_of_one_geom():
    slide = CUBE.replace("<freejoint/>", '<joint type="slide" axis="0 0 1"/>')
    custom = '<numeric name="added_mass" data="1 1 1 0 0 0"/>'
    custom += '<numeric name="added_mass_cube" data="0 0 0 0 0 0"/>'
    assert Buoyancy.of(model(slide, custom=custom)).floats[0].drag is None


def mesh_model(file: str) -> str:
    body = '<body><freejoint/><geom name="g" type="mesh" mesh="m"/></body>'
    return xml(body, ("g",), assets=f'<mesh name="m" file="{file}"/>')


PASSIVE_OFF = '<option><flag spring="disable" damper="disable"/></option>'
PLANE = '<geom name="floor" type="plane" size="1 1 1"/>'
WELDED = '<body name="pier"><geom name="cube" type="box" size="1 1 1"/></body>'
MOCAP = '<body name="hand" mocap="true"><geom name="cube" type="box" size="1 1 1"/></body>'

REFUSALS = {
    "own fluid": (dict(option='<option density="1000"/>'), "option density is 1000.*twice.*to 0"),
    "viscosity": (dict(option='<option viscosity="0.1"/>'), "option viscosity is 0.1.*to 0"),
    "slanted gravity": (dict(option='<option gravity="1 0 -9.81"/>'), r"gravity is \(1, 0, -9.81"),
    "no gravity": (dict(option='<option gravity="0 0 0"/>'), "gravity along -z"),
    "upward gravity": (dict(option='<option gravity="0 0 9.81"/>'), "gravity along -z"),
    "passive off": (dict(option=PASSIVE_OFF), "spring and damper are both disabled.*enable one"),
    "no timestep": (dict(option='<option timestep="0"/>'), "option timestep is 0.*above 0"),
    "backwards": (dict(option='<option timestep="-0.002"/>'), "option timestep is -0.002"),
    "endless timestep": (dict(option='<option timestep="inf"/>'), "option timestep is inf"),
    "no impratio": (dict(option='<option impratio="nan"/>'), "option impratio is nan.*above 0"),
    "endless tolerance": (dict(option='<option tolerance="inf"/>'), "option tolerance is inf"),
    "nothing floats": (dict(buoyant=()), "no custom tuple 'buoyant'.*add"),
    "world body": (
        dict(bodies=CUBE + '<geom name="rock" size="1"/>', buoyant=("rock",)),
        "geom 'rock' belongs to the world body.*joint",
    ),
    "welded body": (dict(bodies=WELDED), "geom 'cube' belongs to body 'pier', which cannot move"),
    "mocap body": (dict(bodies=MOCAP), "geom 'cube' belongs to body 'hand', which cannot move"),
    "not a closed shape": (
        dict(bodies="<body><freejoint/><inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>"
             '<geom name="h" type="hfield" hfield="h"/></body>', buoyant=("h",),
             assets='<hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/>'),
        "geom 'h' is a hfield, which has no closed surface.*use a mesh, box",
    ),
    "listed twice": (dict(buoyant=("cube", "cube")), "lists geom 'cube' twice"),
    "folding waves": (
        dict(custom='<numeric name="wave_a" data="0.5 2 0 0"/>'),
        "the waves fold.*1.571.*0.637",
    ),
    "three numbers": (
        dict(custom='<numeric name="wave_a" data="0.5 2 0"/>'),
        "'wave_a' has 3 numbers; expected 4: amplitude m",
    ),
    "two levels": (
        dict(custom='<numeric name="water_level" data="0 1"/>'),
        "'water_level' has 2 numbers; expected 1, 4, 6, ... or 32: water level",
    ),
    "negative wavelength": (
        dict(custom='<numeric name="wave_a" data="0.1 -2 0 0"/>'),
        "'wave_a': the wavelength is -2 m; it must be above 1e-09",
    ),
    "unknown numeric": (
        dict(custom='<numeric name="water_tint" data="1"/>'),
        "numeric 'water_tint' is unknown.*water_density",
    ),
    "unknown text": (
        dict(custom='<text name="buoyancy_metod" data="linear"/>'),
        "text 'buoyancy_metod' is unknown",
    ),
    "unknown tuple": (
        dict(extra='<custom><tuple name="buoyants"><element objtype="body" objname="cube"/>'
             "</tuple></custom>"),
        "tuple 'buoyants' is unknown; expected buoyant",
    ),
    "not a geom": (
        dict(bodies=CUBE.replace("</body>", '<site name="cube"/></body>'), buoyant=(),
             extra='<custom><tuple name="buoyant"><element objtype="site" objname="cube"/></tuple>'
             "</custom>"),
        "lists 'cube', which is neither a geom nor a body",
    ),
    "unknown method": (
        dict(custom='<text name="buoyancy_method" data="magic"/>'),
        "custom text 'buoyancy_method': 'magic' is not a method; expected one of: linear, chord",
    ),
    "unknown method of a geom": (
        dict(custom='<text name="buoyancy_method_cube" data="magic"/>'),
        "'buoyancy_method_cube': 'magic' is not a method",
    ),
    "method of an unknown geom": (
        dict(custom='<text name="buoyancy_method_ball" data="linear"/>'),
        "'buoyancy_method_ball' names no geom of the tuple 'buoyant' .which has cube",
    ),
    "unknown hull": (
        dict(custom='<text name="hull_cube" data="concave"/>'),
        "custom text 'hull_cube' is 'concave'; expected mesh or convex",
    ),
    "half a sample": (
        dict(custom='<numeric name="chord_samples" data="1.5"/>'),
        "'chord_samples': the number of samples is 1.5",
    ),
    "a setting behind a method": (
        dict(custom='<text name="buoyancy_method" data="chord:3"/>'),
        "'chord:3' is not a method; expected one of",
    ),
    "negative tolerance": (
        dict(custom='<numeric name="buoyancy_tolerance" data="-1"/>'),
        "tolerance is -1 m.*above 1e-09",
    ),
    "a reference finer than round-off": (
        dict(custom='<numeric name="reference_tolerance" data="0"/>'),
        "'reference_tolerance': the reference tolerance is 0 of rho g V; it must be 1e-14 or more",
    ),
    "two drags": (
        dict(custom='<numeric name="drag" data="0.2 1"/>'),
        "'drag' has 2 numbers; expected 3: linear drag coefficient, form",
    ),
    "negative drag": (
        dict(custom='<numeric name="drag_cube" data="0.2 -1 0"/>'),
        "'drag_cube': the form drag coefficient is -1.*0 or more",
    ),
    "endless drag": (
        dict(custom='<numeric name="drag_angular" data="inf"/>'),
        "'drag_angular': the angular drag coefficient is inf",
    ),
    "drag of an unknown geom": (
        dict(custom='<numeric name="drag_ball" data="0.2 1 0"/>'),
        "'drag_ball' names no geom of the tuple 'buoyant' .which has cube",
    ),
    "angular drag of an unknown geom": (
        dict(custom='<numeric name="drag_angular_ball" data="1"/>'),
        "'drag_angular_ball' names no geom",
    ),
    "seven added masses": (
        dict(custom='<numeric name="added_mass" data="1 1 1 0 0 0 0"/>'),
        "'added_mass' has 7 numbers; expected 6 or 36: coefficient of added mass, or",
    ),
    "negative added mass": (
        dict(custom='<numeric name="added_mass_cube" data="1 1 -0.5 0 0 0"/>'),
        "'added_mass_cube': the added mass has a negative coefficient, -0.5",
    ),
    "added mass that is no number": (
        dict(custom='<numeric name="added_mass" data="1 1 nan 0 0 0"/>'),
        "'added_mass': the coefficient of added mass.* is nan; it must be",
    ),
    "asymmetric added mass": (
        dict(custom=f'<numeric name="added_mass" data="{numbers(np.eye(6) + np.eye(6, k=1))}"/>'),
        "'added_mass': the added mass matrix is not symmetric.*differ by 1;",
    ),
    "indefinite added mass": (
        dict(custom=f'<numeric name="added_mass" data="{numbers(np.diag([1, 1, 1, 1, 1, -2]))}"/>'),
        "negative eigenvalue -2, .*positive semidefinite",
    ),
    "unknown pressure": (
        dict(custom='<text name="water_pressure" data="static"/>'),
        "water pressure is 'static'; expected froude-krylov or hydrostatic",
    ),
    "added mass without room": (
        dict(custom='<numeric name="added_mass" data="1 1 2 0 0 0"/>'),
        "'added_mass': MuJoCo keeps only the diagonal of the inertia of body 'cube'.*<body/>",
    ),
    "added mass without room on slides": (
        dict(bodies=CUBE.replace(
                 "<freejoint/>", '<joint type="slide" axis="1 0 0"/><joint type="slide"/>'
             ).replace("<body", '<body euler="0 30 0"'),
             custom=f'<numeric name="added_mass" data="{numbers(COUPLED)}"/>'),
        "'added_mass': MuJoCo keeps only the diagonal of the inertia of body 'cube'.*<body/>",
    ),
    "drag with PGS": (
        dict(custom='<numeric name="drag" data="1 1 1"/>', option='<option solver="PGS"/>'),
        "option solver is PGS: contacts would not feel drag.*Newton or CG",
    ),
    "drag with noslip": (
        dict(custom='<numeric name="drag" data="1 1 1"/>',
             option='<option noslip_iterations="3"/>'),
        "option noslip_iterations is 3: contacts would not feel drag.*noslip_iterations to 0",
    ),
    "added mass of another hull": (
        dict(custom=f'<numeric name="added_mass" data="{numbers(11000.0 * np.eye(6))}"/>'),
        "'added_mass': the added mass matrix has 1.1e\\+04 kg, 10.7 times the displaced mass",
    ),
    "negative damping": (
        dict(custom='<numeric name="damping" data="1 1 1 0 0 -3"/>'),
        "'damping': the damping has a negative coefficient, -3",
    ),
    "misspelt added mass": (
        dict(custom='<numeric name="added_masses" data="1 1 1 0 0 0"/>'),
        "numeric 'added_masses' is unknown.*added_mass",
    ),
    "no water": (
        dict(custom="", extra='<custom><numeric name="water_level" data="nan"/></custom>'),
        "level m, or .* is nan",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSALS)
def test_refusals_name_the_element_and_the_remedy(case):
    changes, message = REFUSALS[case]
    with pytest.raises(ModelError, match=message):
        afloat(**changes)
    with pytest.raises(ValueError, match=r"plugin->init failed"):
        model(**changes)


def test_an_impossible_timestep_is_refused_after_an_otherwise_equal_model():
    custom = '<numeric name="water_level" data="-0.0625"/>'
    assert Buoyancy.of(model(custom=custom)).sea.level == -0.0625
    with pytest.raises(ModelError, match=r"option timestep is 0.*above 0"):
        afloat(custom=custom, option='<option timestep="0"/>')


def test_settings_are_checked_too():
    with pytest.raises(ValueError, match="'buoyancy_method': 'magic' is no"):
        afloat(load=dict(settings={"buoyancy_method": "magic"}))
    with pytest.raises(ValueError, match="tolerance is 0 m"):
        afloat(load=dict(settings={"buoyancy_tolerance": 0.0}))
    with pytest.raises(ValueError, match="water pressure is 'static'"):
        afloat(load=dict(settings={"water_pressure": "static"}))


def test_an_open_mesh_is_refused_by_geom_and_mesh(tmp_path):
    mesh = trimesh.creation.box()
    mesh.update_faces(np.arange(12) > 0)
    mesh.export(tmp_path / "open.obj")
    text = mesh_model(str(tmp_path / "open.obj"))
    with pytest.raises(ModelError, match=r"geom 'g' \(mesh 'm'\): .*not closed: 3 of 18 edges"):
        Scene.load(mujoco.MjSpec.from_string(text))


USUAL = {
    "wave_<name>": (0.1, 4.0, 0.0, 0.0),
    "sea_jonswap": (0.1, 2.0, 3.3, 0.0, 25.0, 5.0, 0.0),
    "sea_bretschneider": (0.1, 2.0, 0.0, 25.0, 5.0, 0.0),
    "sea_pierson_moskowitz": (0.1, 0.0, 25.0, 5.0, 0.0),
    "sea_ochi_hubble": (0.1, 2.0, 1.0, 0.05, 1.5, 1.0, 0.0, 25.0, 5.0, 0.0),
    "sea_record": (0.0, 1.0, 60.0, 0.0, 0.0),
    "water_level": (0.0, 0.0, 1.0, 0.1),
    "added_mass": (0.5,) * 6,
    "damping": (1.0,) * 6,
    "damping_quadratic": (1.0,) * 6,
}
"""Numbers of fields that have several numbers without defaults."""

EXTREMES = (5e-324, 1e-300, 1e300, -1e300)


def extreme_rows() -> Iterator:
    """A field's name, the count of one of its numbers, and its rows with an extreme there."""
    for base, field in NUMERICS.items():
        usual = USUAL.get(base, [n.default or 0.1 for n in field.numbers])
        for i in range(len(usual)):
            rows = [[*usual[:i], extreme, *usual[i + 1 :]] for extreme in EXTREMES]
            yield pytest.param(base.replace("<name>", "a"), rows, id=f"{base}[{i}]")


@pytest.mark.parametrize(("name", "rows"), list(extreme_rows()))
def test_extreme_numbers_are_refused_in_one_line_or_give_finite_motion(name, rows):
    name = name.replace("<body>", "cube")
    custom = '<numeric name="wave_b" data="0.1 4 0 0"/>'
    if name.startswith(("wave_", "sea_")):
        custom = ""
    if name != "buoyancy_tolerance":
        custom += '<text name="buoyancy_method" data="linear"/>'
    text = xml(CUBE.replace("</body>", "<body/></body>"), custom=custom)
    for row in rows:
        scene, error = None, ""
        try:
            check_numeric(name, row)
            scene = Scene.load(mujoco.MjSpec.from_string(text), settings={name: row})
        except ValueError as refusal:
            error = str(refusal)
        assert "\n" not in error
        if scene is None:
            assert re.search(r"must|expected|use a|lower|lengthen|add ", error)
            assert len(error) < 400
        else:
            mujoco.mj_step(scene.model, scene.data, nstep=3)
            assert np.isfinite(scene.data.qpos).all()
            assert not scene.data.warning.number.any()
