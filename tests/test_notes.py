"""Robots and scenes from outside: their floats, faults and notes."""

import copy
import pickle
import warnings
from collections.abc import Callable

import made_hulls
import mujoco
import numpy as np
import pytest
from scenes import CUBE, WAVES, afloat, model, xml

from independent import DENSITY, GRAVITY, MODELS, status_of
from sim import Buoyancy, ModelError, Note, Scene, Sea, hydrostatics
from sim.mjcf.geoms import geom_hull

ROUND_OFF = 1e-9


def notes_of(*args, **kwargs) -> list[str]:
    """The notes from compiling the `model` with these arguments."""
    return notes_while(lambda: model(*args, **kwargs))


def notes_while(compile_one: Callable[[], mujoco.MjModel]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        compile_one()
    assert all(issubclass(w.category, Note) for w in caught)
    return [str(w.message) for w in caught]


def listing(*bodies: str) -> str:
    elements = "".join(f'<element objtype="body" objname="{b}"/>' for b in bodies)
    return f'<custom><tuple name="buoyant">{elements}</tuple></custom>'


def robot(limbs: int = 20) -> str:
    """A torso with limbs of two unnamed geoms each, one of which is only visual."""
    links = "".join(
        f'<body pos="{0.5 * i} 0 0"><joint axis="0 1 0"/>'
        '<geom type="capsule" size="0.05 0.15" density="500"/>'
        '<geom type="box" size="0.3 0.3 0.3" contype="0" conaffinity="0" mass="0"/></body>'
        for i in range(1, limbs + 1)
    )
    return f'<body name="torso"><freejoint/><geom size="0.2" density="500"/>{links}</body>'


def test_a_body_stands_for_all_colliding_geoms_of_its_subtree():
    compiled = model(robot(), (), extra=listing("torso"))
    floats = Buoyancy.of(compiled).floats
    assert len(floats) == 21
    assert floats[0].name == "torso/geom 0"
    assert floats[1].name == f"body {floats[1].body}/geom 0"
    ghosts = robot(1).replace('density="500"', 'density="500" contype="0" conaffinity="0"')
    floats = Buoyancy.of(model(ghosts, (), extra=listing("torso"))).floats
    assert [f.geoms for f in floats] == [(0,), (1, 2)]  # capsule and box overlap


def test_settings_may_name_bodies_and_unnamed_geoms():
    custom = (
        '<numeric name="drag_torso" data="0.2 1 0"/><numeric name="drag_arm" data="0.3 2 0"/>'
        '<text name="buoyancy_method_arm/geom 1" data="linear"/>'
    )
    bodies = """<body name="torso"><freejoint/><geom size="0.2"/>
      <body name="arm" pos="1 0 0"><joint/><geom size="0.1" pos="0.5 0 0"/><geom size="0.1"/></body>
      </body>"""
    torso, first, second = Buoyancy.of(model(bodies, (), custom, extra=listing("torso"))).floats
    assert torso.drag.coefficients.form == 1.0
    assert first.drag.coefficients.form == second.drag.coefficients.form == 2.0
    assert type(first.method).__name__ == "Patches"
    assert type(second.method).__name__ == "Linear"


def test_a_body_without_geoms_is_refused():
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    bodies = f'{CUBE}<body name="empty"><freejoint/>{inertial}</body>'
    with pytest.raises(ModelError, match="lists body 'empty', which has no geom"):
        afloat(bodies, (), extra=listing("empty"))


FAULTY = xml(
    CUBE + '<geom name="rock" size="1"/>',
    ("cube", "rock"),
    '<numeric name="wave_a" data="0.5 2 0"/><numeric name="water_tint" data="1"/>'
    '<text name="buoyancy_method" data="magic"/><numeric name="drag" data="0 -1 0"/>',
    '<option density="1000"><flag gravity="disable"/></option>',
)


def test_all_faults_are_reported_at_once(tmp_path, capsys):
    with pytest.raises(ModelError) as caught:
        Scene.load(mujoco.MjSpec.from_string(FAULTY))
    faults = caught.value.faults
    for text in ("density is 1000", "flag gravity", "wave_a' has 3", "water_tint' is unknown",
                 "rock' belongs to the world", "'magic' is not a method"):  # fmt: skip
        assert sum(text in fault for fault in faults) == 1, text
    assert all("\n" not in fault for fault in faults)
    for again in (pickle.loads(pickle.dumps(caught.value)), copy.copy(caught.value)):
        assert again.faults == faults
    file = tmp_path / "faulty.xml"
    file.write_text(FAULTY)
    assert status_of("run.py", file, "--no-record") == 2
    lines = capsys.readouterr().err.strip().split("\n")
    assert len(lines) == len(faults)
    assert all(line.startswith(f"run.py: {file}: ") for line in lines)


STATIC = '<geom name="floor" type="{}" size="{}" pos="0 0 {}"/>'
NOTED = {
    "a misspelt wave": (
        dict(custom='<numeric name="wav_swell" data="0.1 4 0 0"/>'),
        "numeric 'wav_swell' has no effect on the water.*meant to be 'wave_<name>'",
    ),
    "a misspelt method": (
        dict(custom='<text name="bouyancy_method_cube" data="linear"/>'),
        r"text 'bouyancy_method_cube' has no effect.*meant to be 'buoyancy_method'",
    ),
    "air": (dict(option='<option density="1.2" viscosity="1.8e-5"/>'), "air drag acts under water"),
    "gravcomp": (
        dict(bodies=CUBE.replace("<body", '<body gravcomp="1"')),
        "'cube' has gravcomp 1.*floats too high.*set it to 0",
    ),
    "a floor": (
        dict(bodies=CUBE + STATIC.format("plane", "5 5 1", 0)),
        "plane 'floor' at z = 0 is at the water's surface: 'cube' will stand on it",
    ),
    "a quay": (
        dict(bodies=CUBE + STATIC.format("box", "1 1 0.5", -0.5)),
        "box 'floor' at z = 0 is at the water's surface",
    ),
    "too light": (dict(bodies=CUBE.replace("512.5", "1")), "its hulls displace 1 m.*units"),
    "too heavy": (dict(bodies=CUBE.replace("512.5", "30000")), "29.3 times as dense as the water"),
    "millimetres": (
        dict(bodies=CUBE.replace("0.5 0.5 0.5", "500 500 500"),
             custom=WAVES + '<text name="buoyancy_method" data="linear"/>'),
        "1e.03 m long and the waves 1.4 to 4 m: check the units",
    ),
    "two bodies overlap": (
        dict(bodies=CUBE + CUBE.replace('"cube"', '"crate"').replace("0 0 0", "0.7 0 0"),
             buoyant=("cube", "crate")),
        "'cube' and 'crate' .30 % of the smaller.*move them apart",
    ),
    "two geoms overlap": (
        dict(bodies=CUBE.replace("</body>", '<geom name="keel" type="box" size="0.5 0.5 0.5" '
                                 'pos="0.5 0 0" density="512.5"/></body>'),
             buoyant=("cube", "keel")),
        "'cube' and 'keel' overlap and are united.*33 % of the volume twice.*'buoyancy_union' 0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", NOTED)
def test_likely_mistakes_are_noted(case):
    changes, message = NOTED[case]
    with pytest.warns(Note, match=message):
        model(**changes)


def test_models_without_mistakes_are_not_noted():
    far = CUBE + STATIC.format("plane", "5 5 1", -3)
    ghost = CUBE + STATIC.format("plane", "5 5 1", 0).replace(
        "/>", ' contype="0" conaffinity="0"/>'
    )
    aside = CUBE + STATIC.format("box", "1 1 0.5", -0.5).replace('pos="0', 'pos="9')
    for bodies in (CUBE, far, ghost, aside):
        assert notes_of(bodies, custom=WAVES) == []
    others = ("gain", "init_qpos", "save_interval", "range", "density", "timestep", "season")
    custom = "".join(f'<numeric name="{name}" data="1"/>' for name in others)
    assert notes_of(custom=custom) == []


def test_a_misspelt_tuple_is_noted_with_the_fault(capsys, tmp_path):
    (tmp_path / "a.xml").write_text(xml().replace('"buoyant"', '"bouyant"'))
    assert status_of("run.py", tmp_path / "a.xml", "--no-record") == 2
    note, fault = capsys.readouterr().err.splitlines()
    assert "tuple 'bouyant' has no effect on the water" in note
    assert "nothing floats" in fault


def test_the_fields_of_attached_models_are_not_noted():
    assert not any("has no effect" in note for note in notes_while(attached))


@pytest.mark.parametrize("name", ["wigley", "spar", "articulated", "cube", "bunny", "spheres"])
def test_the_shipped_models_are_not_noted(name):
    path = str(MODELS / f"{name}.xml")
    assert notes_while(lambda: mujoco.MjModel.from_xml_path(path)) == []


def test_equal_notes_are_combined():
    (note,) = notes_of(
        robot(8).replace('contype="0" conaffinity="0"', ""),
        (),
        '<numeric name="buoyancy_union" data="1"/>',
        extra=listing("torso"),
    )[:1]
    assert note.endswith("(7 more like this)")


TWO = CUBE + CUBE.replace('"cube"', '"crate"').replace("0 0 0", "{} 0 0")
KEYS = '<keyframe><key qpos="0 0 0 1 0 0 0  {} 0 0 1 0 0 0"/></keyframe>'
NEARLY_ALIKE = {
    "mass": (dict(), dict(bodies=CUBE.replace("512.5", "1")), "times as dense"),
    "gravcomp": (dict(), dict(bodies=CUBE.replace("<body", '<body gravcomp="1"')), "gravcomp"),
    "position": (
        dict(bodies=TWO.format(3), buoyant=("cube", "crate")),
        dict(bodies=TWO.format(0.7), buoyant=("cube", "crate")),
        "move them apart",
    ),
    "keyframe": (
        dict(bodies=TWO.format(3), buoyant=("cube", "crate"), extra=KEYS.format(3)),
        dict(bodies=TWO.format(3), buoyant=("cube", "crate"), extra=KEYS.format(0.7)),
        "move them apart",
    ),
}


@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize("case", NEARLY_ALIKE)
def test_notes_belong_to_the_model_and_not_to_a_similar_one(case, is_first):
    """In either order. No other test has the water level of these models."""
    faultless, noted, message = NEARLY_ALIKE[case]
    level = 1e-6 * (2 * list(NEARLY_ALIKE).index(case) + is_first + 1)
    custom = f'<numeric name="water_level" data="{level}"/>'
    for changes in (faultless, noted)[:: 1 if is_first else -1]:
        notes = " ".join(notes_of(**changes, custom=custom))
        assert (message in notes) == (changes is noted)


def test_notes_can_be_errors_or_silent():
    with warnings.catch_warnings():
        warnings.simplefilter("error", Note)
        with pytest.raises(ValueError, match="times as dense as the water"):
            model(CUBE.replace("512.5", "1"))
        with pytest.raises(Note):
            afloat(CUBE.replace("512.5", "1"))
        warnings.simplefilter("ignore", Note)
        model(CUBE.replace("512.5", "1"))
        afloat(CUBE.replace("512.5", "1"))


def test_a_mesh_with_legacy_inertia_is_noted():
    mesh = f'<mesh name="m" file="{MODELS / "meshes" / "bunny.obj"}"{{}}/>'
    body = '<body><freejoint/><geom name="g" type="mesh" mesh="m" density="500"/></body>'
    assert notes_of(body, ("g",), assets=mesh.format(' inertia="exact"')) == []
    (note,) = notes_of(body, ("g",), assets=mesh.format(' inertia="legacy"'))
    assert 'inertia="exact"' in note
    assert "its mass 7.9 % above" in note


OVERLAP = CUBE.replace(
    "</body>",
    '<geom name="keel" type="box" size="0.5 0.5 0.5" pos="0.5 0 0.1" euler="0 0 30" density="1"/>'
    "</body>",
)


def test_overlaps_of_a_body_count_once_by_default():
    with pytest.warns(Note):
        scene = Scene.from_model(model(OVERLAP, ("cube", "keel")))
    (one,) = scene.buoyancy.floats
    assert one.name == "cube + keel"
    assert len(one.geoms) == 2
    scene.data.qpos[2] = -9.0
    mujoco.mj_forward(scene.model, scene.data)
    lift = scene.buoyancy.wrenches(scene.data)[0, 2]
    assert lift == pytest.approx(DENSITY * GRAVITY * one.method.hull.volume, rel=ROUND_OFF)
    assert 1.2 < one.method.hull.volume < 1.7
    off = '<numeric name="buoyancy_union" data="0"/>'
    assert len(Buoyancy.of(model(OVERLAP, ("cube", "keel"), off)).floats) == 2
    other = '<numeric name="drag_keel" data="1 1 0"/>'
    with pytest.warns(Note, match="overlap and count shared volume twice"):
        assert len(Buoyancy.of(model(OVERLAP, ("cube", "keel"), other)).floats) == 2


def test_overlaps_that_cannot_be_united_stay_separate_and_are_noted():
    """Two boxes touch along an edge, and a third overlaps both of them elsewhere."""
    box = '<geom name="{}" type="box" size="0.5 0.5 {}" pos="{}" density="100"/>'
    geoms = box.format("a", 0.5, "0 0 0") + box.format("b", 0.5, "1 1 0")
    third = '<geom name="c" type="box" size="0.4 0.4 0.1" pos="0.5 0.5 0" density="100"/>'
    with pytest.warns(Note, match="'a', 'b' and 'c' overlap.*cannot be united"):
        compiled = model(f"<body><freejoint/>{geoms}{third}</body>", ("a", "b", "c"))
    assert len(Buoyancy.of(compiled).floats) == 3


def test_a_moved_geom_is_united_again_at_a_reset():
    compiled = model(OVERLAP, ("cube", "keel"))
    before, data = Buoyancy.of(compiled), mujoco.MjData(compiled)
    compiled.geom_pos[1, 0] += 0.1
    for expected in (before, Buoyancy.of(compiled)):
        data.qpos[2] = -9.0
        mujoco.mj_forward(compiled, data)
        volume = expected.floats[0].method.hull.volume
        lift = data.xfrc_applied[1, 2]
        assert lift == pytest.approx(DENSITY * GRAVITY * volume, rel=ROUND_OFF)
        mujoco.mj_resetData(compiled, data)
    after = Buoyancy.of(compiled).floats[0].method.hull.volume
    assert after > before.floats[0].method.hull.volume + 0.05


def test_the_displaced_volume_may_differ_from_the_hulls():
    """For example, a flooded vehicle displaces less than the box around its frame."""
    custom = '<numeric name="displaced_cube" data="0.25"/>'
    scene = Scene.from_model(model(CUBE.replace("512.5", "128"), custom=custom))
    scene.data.qpos[2] = -9.0
    mujoco.mj_forward(scene.model, scene.data)
    lift = scene.buoyancy.wrenches(scene.data)[0, 2]
    assert lift == pytest.approx(0.25 * DENSITY * GRAVITY, rel=ROUND_OFF)
    assert scene.buoyancy.submerged_volumes(scene.data)[0] == pytest.approx(1.0, rel=ROUND_OFF)
    found = hydrostatics(scene, with_gz=False)["cube"]
    assert found.volume_m3 == pytest.approx(0.25)
    assert found.rest.displacement_m3 == pytest.approx(128.0 / DENSITY)
    with pytest.raises(ModelError, match=r"'displaced_cube': .* is 0; it must be above 1e-09"):
        afloat(custom=custom.replace("0.25", "0"))


@pytest.mark.parametrize("size", [1e-7, 1e-4, 1.0, 100.0])
@pytest.mark.parametrize(
    ("kind", "sizes", "volume"),
    [
        ("box", "1 2 3", 48.0),
        ("sphere", "1", 4.0 / 3.0 * np.pi),
        ("ellipsoid", "1 2 3", 8.0 * np.pi),
        ("cylinder", "1 2", 4.0 * np.pi),
        ("capsule", "1 2", 4.0 * np.pi + 4.0 / 3.0 * np.pi),
        ("capsule", "1 2000", 4000.0 * np.pi + 4.0 / 3.0 * np.pi),
    ],
)
def test_primitives_of_any_size_have_their_volume(kind, sizes, volume, size):
    scaled = " ".join(str(size * float(s)) for s in sizes.split())
    body = f'<body><freejoint/><geom name="g" type="{kind}" size="{scaled}" mass="1"/></body>'
    limits = '<compiler boundmass="1" boundinertia="1"/>'
    hull, notes = geom_hull(model(body, ("g",), option=limits), 0)
    assert notes == []
    assert hull.volume == pytest.approx(size**3 * volume, rel=1e-12)


def attached(sea: str | None = WAVES, own: str = "") -> mujoco.MjModel:
    """A cube that MjSpec has attached to a model, with 'a_' before all names. sea: None for a cube
    without water fields."""
    parent = mujoco.MjSpec.from_string(
        f'<mujoco><option timestep="0.005"/><custom>{own}</custom><worldbody/></mujoco>'
    )
    text = xml(custom=(sea or "") + '<numeric name="drag_cube" data="1 1 0"/>')
    if sea is None:
        text = text.replace('<numeric name="water_density" data="1025"/>', "")
    child = mujoco.MjSpec.from_string(text)
    parent.attach(child, prefix="a_", frame=parent.worldbody.add_frame())
    return Scene.load(parent).model


def test_an_attached_model_floats_in_its_own_sea():
    compiled = attached()
    assert compiled.tuple(0).name == "a_buoyant"
    buoyancy = Buoyancy.of(compiled)
    assert len(buoyancy.sea.waves) == 3
    assert buoyancy.floats[0].name == "cube"
    assert buoyancy.floats[0].drag.coefficients.linear == 1.0
    data = mujoco.MjData(compiled)
    mujoco.mj_step(compiled, data, nstep=10)
    assert data.xfrc_applied[1, 2] > 0.0


def test_two_different_seas_are_refused():
    same = '<numeric name="water_density" data="1025"/>' + WAVES
    assert len(Buoyancy.of(attached(own=same)).sea.waves) == 3
    with pytest.raises(ModelError, match=r"the model itself and .* define two different seas"):
        attached(own='<numeric name="wave_a" data="0.1 3 0 0"/>')


def test_parts_without_water_fields_take_the_sea_of_the_others():
    drag = '<numeric name="drag" data="1 1 0"/>'
    assert len(Buoyancy.of(attached(own=drag)).sea.waves) == 3
    assert Buoyancy.of(attached(None, own=drag)).sea == Sea()


def test_wrapped_models_as_in_dm_control_are_accepted():
    class Wrapper:
        ptr = model()

    assert Buoyancy.of(Wrapper()).model is Wrapper.ptr


STARTS = {
    "sinks": (CUBE.replace("512.5", "3000"), "'cube' sinks: it weighs 3000 kg"),
    "turns over": (
        CUBE.replace("0.5 0.5 0.5", "0.1 0.1 1"), "'cube' will turn over.*rests 90 deg from how",
    ),
    "falls": (CUBE.replace("0 0 0", "0 0 9"), "'cube' starts 9 m above where it floats and falls"),
    "shoots up": (CUBE.replace("0 0 0", "0 0 -9"), "starts 9 m below where it floats and shoots"),
}  # fmt: skip


@pytest.mark.parametrize("case", STARTS)
def test_a_start_away_from_the_rest_is_noted(case):
    body, message = STARTS[case]
    with pytest.warns(Note, match=message):
        Scene.from_model(model(body))


def test_run_prints_each_note_in_one_line(tmp_path, capsys):
    file = tmp_path / "light.xml"
    file.write_text(xml(CUBE.replace("512.5", "1"), option='<option density="1.2"/>'))
    arguments = [file, "--no-record", "--duration", "0.01"]
    assert status_of("run.py", *arguments) == 0
    lines = [line for line in capsys.readouterr().err.split("\n") if "note" in line]
    assert len(lines) == 2
    assert all(line.startswith("run.py: note: ") for line in lines)
    assert status_of("run.py", *arguments, "--quiet") == 0
    assert capsys.readouterr().err == ""


def test_a_tank_of_plates_is_dry_inside():
    """Six plates of 4 cm around a void: the water is pushed out of all of the cube."""
    plates = [made_hulls.plates(side)[0].bounds for side in range(6)]
    geoms = "".join(
        f'<geom name="p{i}" type="box" size="{half[0]} {half[1]} {half[2]}" '
        f'pos="{at[0]} {at[1]} {at[2]}" density="1000"/>'
        for i, (low, high) in enumerate(plates)
        for half, at in [(0.5 * (high - low), 0.5 * (low + high))]
    )
    names = [f"p{i}" for i in range(6)]
    with pytest.warns(Note, match="are united: 1 cavity stays dry: 0.779 m.3"):
        (tank,) = Buoyancy.of(model(f"<body><freejoint/>{geoms}</body>", names)).floats
    assert tank.method.hull.volume == pytest.approx(1.0, rel=ROUND_OFF)


def test_specks_of_a_mesh_are_noted_and_a_refusal_names_its_file(tmp_path):
    file, ship_file = tmp_path / "m.obj", tmp_path / "ship.obj"  # MuJoCo keeps a file for seconds
    mesh = '<mesh name="m" inertia="legacy" file="{}"/>'
    body = '<body><freejoint/><geom name="g" type="mesh" mesh="m" density="500"/></body>'
    ship = made_hulls.ship()
    made_hulls.SPECKS["a triangle outside"](ship).export(ship_file)
    with pytest.warns(Note, match=r"mesh 'm'\): specks left out: 1 faces, 1.6e-05 % of the area"):
        (found,) = Buoyancy.of(model(body, ("g",), assets=mesh.format(ship_file))).floats
    single_precision = 1e-5
    assert found.method.hull.volume == pytest.approx(ship.volume, rel=single_precision)
    made_hulls.without_top(made_hulls.box([1, 1, 1])).export(file)
    with pytest.raises(ValueError, match=f"not closed.*check_hull.py {file} --repair OUT"):
        model(body, ("g",), assets=mesh.format(file))


def test_overlapping_shells_of_a_mesh_are_noted(tmp_path):
    both = made_hulls.joined(made_hulls.box([2, 2, 2]), made_hulls.box([1, 1, 1]))
    both.export(tmp_path / "m.obj")
    body = '<body><freejoint/><geom name="g" type="mesh" mesh="m" density="500"/></body>'
    mesh = f'<mesh name="m" inertia="exact" file="{tmp_path / "m.obj"}"/>'
    with pytest.warns(Note, match="its shells overlap and are one hull.*12 % of its volume twice"):
        buoyancy = Buoyancy.of(model(body, ("g",), assets=mesh))
    assert buoyancy.floats[0].method.hull.volume == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("joint", "is_held"),
    [("<freejoint/>", False), ('<joint type="slide" axis="0 0 1"/>', False), ("<joint/>", True)],
)
def test_a_matrix_of_a_body_that_joints_hold_is_noted(joint, is_held):
    """Its submerged share at rest is that of a body that floats freely."""
    numbers = " ".join(map(str, np.diag(np.full(6, 100.0)).ravel()))
    flap = f'<body name="flap">{joint}<body/><geom name="f" size="1 0.2 1" type="box"/></body>'
    extra = f'<custom><numeric name="damping_f" data="{numbers}"/></custom>'
    notes = notes_of(flap, ("f",), extra=extra)
    assert any("'damping_f' is taken for the draught" in note for note in notes) == is_held
