"""Robots of others: open meshes, links that overlap, links without mass."""

import json
from pathlib import Path

import made_hulls
import mujoco
import numpy as np
import pytest
import trimesh
from scenes import model, xml

from independent import DENSITY, GRAVITY, status_of
from sim import Buoyancy, ModelError, Note, Scene, add_water, hydrostatics, read_series
from sim.hulls.union import TOUCHING_SHARE, convex_hull

ROUND_OFF, SINGLE_PRECISION = 1e-9, 1e-5
"""Relative errors of volumes; MuJoCo keeps the vertices of meshes in single precision. A cut hull
is exact to TOUCHING_SHARE, because smaller pieces are dropped."""


def without_some(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh with every tenth face missing."""
    return made_hulls.made(mesh.vertices, mesh.faces[np.arange(len(mesh.faces)) % 10 > 0])


def robot_of_meshes(folder: Path, **meshes: trimesh.Trimesh) -> Path:
    """The path of a model with a chain of links, each of one mesh and 2 m beside the last."""
    assets = links = ""
    for name, mesh in meshes.items():
        mesh.export(folder / f"{name}.stl")
        assets += f'<mesh name="{name}" file="{name}.stl"/>'
        joint = "<joint/>" if links else "<freejoint/>"
        links += (
            f'<body name="{name}" pos="2 0 0">{joint}<geom type="mesh" mesh="{name}"/>'
            '<inertial pos="0 0 0" mass="50" diaginertia="1 1 1"/>'
        )
    path = folder / "robot.xml"
    path.write_text(
        f'<mujoco><compiler meshdir="{folder}"/><asset>{assets}</asset>'
        f"<worldbody>{links}{'</body>' * len(meshes)}</worldbody></mujoco>"
    )
    return path


def volumes(compiled: mujoco.MjModel) -> dict[str, float]:
    """The volumes [m^3] of a model's hulls by the name of the body."""
    floats = Buoyancy.of(compiled).floats
    return {compiled.body(f.body).name: f.method.hull.volume for f in floats}


def test_one_argument_floats_a_robot_of_open_meshes(tmp_path):
    ball, limb = trimesh.creation.icosphere(radius=0.4), made_hulls.capsule(0.2, 0.8)
    path = robot_of_meshes(tmp_path, torso=without_some(ball), limb=without_some(limb))
    with pytest.raises(ValueError, match="plugin->init failed"):
        add_water(path, "torso").compile()
    found = volumes(add_water(path, "torso", hull="convex").compile())
    assert found["torso"] == pytest.approx(ball.volume, rel=SINGLE_PRECISION)
    assert found["limb"] == pytest.approx(limb.volume, rel=SINGLE_PRECISION)


def test_the_convex_hull_of_one_geom_and_the_refusal_that_names_it(tmp_path):
    """The convex hull of a tub is a box, whether the mesh is closed or not. Two geoms of one mesh
    may have different hulls."""
    tub = made_hulls.open_boat()
    path = robot_of_meshes(tmp_path, tub=tub, shell=without_some(tub))
    with pytest.raises(ModelError) as caught:
        Scene.load(add_water(path, "tub"))
    (fault,) = caught.value.faults
    remedy = "float its convex hull: custom text 'hull_shell/geom 0', or 'hull' for all"
    assert "not closed" in fault
    assert remedy in fault
    found = volumes(add_water(path, "tub", **{"hull_shell/geom 0": "convex"}).compile())
    assert found["shell"] == pytest.approx(1.0, rel=SINGLE_PRECISION)
    assert found["tub"] == pytest.approx(tub.volume, rel=SINGLE_PRECISION)
    path.write_text(path.read_text().replace('mesh="shell"/>', 'mesh="tub"/>'))
    again = volumes(add_water(path, "tub", hull="convex", **{"hull_tub/geom 0": "mesh"}).compile())
    assert again == pytest.approx(found, rel=SINGLE_PRECISION)


def test_flat_points_have_no_convex_hull():
    flat = trimesh.creation.box(extents=[1.0, 1.0, 1.0])
    flat.vertices[:, 2] = 0.0
    with pytest.raises(ValueError, match="enclose no volume; give a flat body some thickness"):
        convex_hull(flat.vertices)


SNAKE = "".join(
    f'<body name="link{i}" pos="{0.3 * (i > 0)} 0 0" euler="0 {10 * i} {7 * i}">'
    f"{'<joint/>' if i else '<freejoint/>'}"
    f'<geom type="{kind}" size="{size}" pos="0.15 0 0" euler="0 90 0" density="400"/>'
    for i, (kind, size) in enumerate(
        (("capsule", "0.08 0.15"), ("capsule", "0.08 0.15"), ("box", "0.1 0.07 0.18"),
         ("cylinder", "0.09 0.16"), ("capsule", "0.08 0.15"))
    )
) + "</body>" * 5  # fmt: skip
"""Links of which each overlaps its neighbours."""


def listed(bodies: str, custom: str = "", names: tuple[str, ...] = ("link0",)) -> mujoco.MjModel:
    """The model of bodies, of which those with names float with their subtrees."""
    elements = "".join(f'<element objtype="body" objname="{name}"/>' for name in names)
    tuple_ = f'<custom><tuple name="buoyant">{elements}</tuple></custom>'
    return model(bodies, (), custom, extra=tuple_)


CUT = '<text name="overlap" data="cut"/>'


def union_of(compiled: mujoco.MjModel) -> trimesh.Trimesh:
    """The union of a model's uncut hulls at the reference pose, about the world's origin, in the
    axes of the first body."""
    pose = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, pose)
    solids = []
    for f in Buoyancy.of(compiled).floats:
        rotation, hull = pose.geom_xmat[f.geom].reshape(3, 3), f.method.hull
        vertices = hull.vertices @ rotation.T + pose.geom_xpos[f.geom]
        solids.append(trimesh.Trimesh(vertices, hull.faces, process=False))
    return trimesh.boolean.union(solids, engine="manifold")


@pytest.mark.filterwarnings("ignore::sim.Note")
def test_a_cut_robot_displaces_and_is_pushed_as_the_union_of_its_links():
    """Its links stand as in the reference pose; the first one floats in any attitude."""
    union = union_of(listed(SNAKE))
    compiled = listed(SNAKE, CUT + '<text name="buoyancy_method" data="linear"/>')
    assert sum(volumes(compiled).values()) == pytest.approx(union.volume, rel=TOUCHING_SHARE)
    data, buoyancy = mujoco.MjData(compiled), Buoyancy.of(compiled)
    data.qpos[:7] = [0.3, -0.2, -0.4, 0.8, 0.3, -0.5, 0.1]
    mujoco.mj_forward(compiled, data)
    wrenches = buoyancy.wrenches(data)
    arms = data.xipos[[f.body for f in buoyancy.floats]]
    force = wrenches[:, :3].sum(axis=0)
    torque = (wrenches[:, 3:] + np.cross(arms, wrenches[:, :3])).sum(axis=0)
    rotation = data.xmat[1].reshape(3, 3)
    corners = union.vertices[union.faces] @ rotation.T + data.xpos[1]
    wet = made_hulls.clipped(corners)
    cones = np.einsum("ij,ij->i", wet[:, 0], np.cross(wet[:, 1], wet[:, 2])) / 6.0  # lid at z = 0
    lift = DENSITY * GRAVITY * cones.sum()
    centre = (cones[:, None] * wet.sum(axis=1)).sum(axis=0) / 4.0 / cones.sum()
    assert 0.1 < cones.sum() / union.volume < 0.9
    np.testing.assert_allclose(force, [0.0, 0.0, lift], atol=TOUCHING_SHARE * lift)
    np.testing.assert_allclose(torque, np.cross(centre, force), atol=TOUCHING_SHARE * lift)


TWO = """<body name="big"><freejoint/><geom type="box" size="0.5 0.5 {0}" density="400"/>
  <body name="small" pos="0.7 0 0"><joint/><geom type="box" size="0.5 0.5 0.5" density="400"/>
  <body name="tip" pos="2 0 0"><geom size="0.1" density="400"/></body></body></body>"""
"""Two boxes that share 0.3 m along x, and a ball apart from them."""

CASES = {
    "neither": ("", 0.5, (1.0, 1.0)),
    "another one": (CUT.replace("overlap", "overlap_tip"), 0.5, (1.0, 1.0)),
    "equal ones": (CUT, 0.5, (1.0, 0.7)),
    "the smaller one, though it comes first": (CUT, 0.4, (0.56, 1.0)),
    "one that is chosen": (CUT.replace("overlap", "overlap_big/geom 0"), 0.5, (0.7, 1.0)),
    "a body with its subtree": (CUT.replace("overlap", "overlap_big"), 0.5, (1.0, 0.7)),
    "all but one": (CUT + '<text name="overlap_small" data="keep"/>', 0.5, (0.7, 1.0)),
}


@pytest.mark.filterwarnings("ignore::sim.Note")
@pytest.mark.parametrize("case", CASES)
def test_which_of_two_hulls_is_cut(case):
    custom, height, expected = CASES[case]
    found = volumes(listed(TWO.format(height), custom, ("big",)))
    assert (found["big"], found["small"]) == pytest.approx(expected, rel=ROUND_OFF)


def test_a_geom_that_is_cut_is_not_united_with_others_of_its_body():
    geom = '<geom name="{}" type="box" size="0.5 0.5 0.5" pos="{} 0 0" density="400"/>'
    body = f"<body><freejoint/>{geom.format('a', 0)}{geom.format('b', 0.7)}</body>"
    floats = Buoyancy.of(model(body, ("a", "b"), CUT.replace("overlap", "overlap_b"))).floats
    found = {f.name: f.method.hull.volume for f in floats}
    assert found == {"a": pytest.approx(1.0), "b": pytest.approx(0.7)}


GLIDER = """<body name="glider"><freejoint/><geom type="capsule" size="0.2 0.8" density="900"/>
  <body name="ballast" pos="0 0 0.3"><joint type="slide"/>
  <geom type="cylinder" size="0.08 0.1" density="3000"/></body></body>"""


def test_a_ballast_inside_a_hull_is_cut_away():
    """Its weight acts, and the water pushes only the hull around it."""
    with pytest.warns(Note, match="'ballast/geom 0' .100 % .*text 'overlap_ballast' \"cut\""):
        before = volumes(listed(GLIDER, names=("glider",)))
    custom = CUT.replace("overlap", "overlap_ballast")
    with pytest.warns(Note, match="'ballast/geom 0' lies inside other hulls: the water does not"):
        scene = Scene.from_model(listed(GLIDER, custom, ("glider",)))
    assert volumes(scene.model) == {"glider": before["glider"]}
    found = hydrostatics(scene, with_gz=False)["glider"]
    assert found.volume_m3 == pytest.approx(before["glider"], rel=ROUND_OFF)
    assert found.mass_kg == pytest.approx(scene.model.body_mass.sum())


def test_a_hull_around_another_cannot_be_cut():
    custom = CUT + '<text name="overlap_ballast" data="keep"/>'
    with pytest.warns(Note, match="'glider/geom 0' cannot be cut and counts shared volume twice"):
        found = volumes(listed(GLIDER, custom, ("glider",)))
    assert len(found) == 2


def test_hulls_of_different_trees_are_not_cut():
    apart = TWO.format(0.5).replace("</body></body></body>", "</body></body>").replace(
        '<body name="small"', '</body><body name="small"'
    ).replace("<joint/>", "<freejoint/>")  # fmt: skip
    with pytest.warns(Note, match="30 % of the smaller.; move them apart, or let only one"):
        found = volumes(listed(apart, CUT, ("big", "small")))
    assert (found["big"], found["small"]) == pytest.approx((1.0, 1.0))


def test_overlaps_at_another_start_are_noted():
    key = '<keyframe><key qpos="0 0 0 1 0 0 0 0.8"/></keyframe>'
    with pytest.warns(Note, match="'overlap' cuts hulls as they stand at qpos0, and the start"):
        model(TWO.format(0.5), (), CUT + '<tuple name="buoyant"><element objtype="body" '
              'objname="big"/></tuple>', extra=key)  # fmt: skip


@pytest.mark.filterwarnings("ignore::sim.Note")
def test_a_cut_follows_the_place_of_a_link_and_nothing_else_does():
    """Models that differ in the places of their links share hulls only if these are not cut."""
    for custom, are_shared in (("", True), (CUT, False)):
        near, far = (
            listed(TWO.format(0.5).replace("0.7", x), custom, ("big",)) for x in ("0.7", "0.9")
        )
        assert (Buoyancy.of(near).floats is Buoyancy.of(far).floats) == are_shared
    data = mujoco.MjData(near)
    near.body_pos[2, 0] = 0.9
    mujoco.mj_resetData(near, data)
    assert volumes(near)["small"] == pytest.approx(0.9, rel=ROUND_OFF)
    assert Buoyancy.of(near).floats is Buoyancy.of(far).floats


BOAT = """<body name="boat" pos="0 0 -5"><freejoint/>
  <inertial pos="0 0 0" mass="60" diaginertia="5 9 12"/>
  <geom type="box" size="0.5 0.2 0.15"/><body name="outrigger" pos="0 0.5 0">
  <geom type="capsule" size="0.08 0.3" euler="0 90 0" mass="0"/></body></body>"""


def test_a_link_without_mass_has_finite_numbers_everywhere(tmp_path):
    """Its lift under water counts in weights of the body that it is welded to."""
    file, numbers = tmp_path / "boat.xml", tmp_path / "boat.json"
    names = '<tuple name="buoyant"><element objtype="body" objname="boat"/></tuple>'
    file.write_text(xml(BOAT, (), names))
    run = ("run.py", "--duration", "0.1", "--record", tmp_path / "boat.rrd", "--quiet")
    for script, *options in (("hydrostatics.py",), run):
        assert status_of(script, file, *options, "--json", numbers) == 0
        report = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    outrigger = 0.08**2 * np.pi * (0.6 + 4.0 / 3.0 * 0.08)
    for name, volume in (("boat", 0.12), ("outrigger", outrigger)):
        share = report["bodies"][name]["mean_force_over_weight"]
        assert share == pytest.approx(DENSITY * volume / 60.0, rel=SINGLE_PRECISION)
    series = read_series(tmp_path / "boat.rrd")
    assert all(np.isfinite(values).all() for _, values in series.values())
