"""Faulty surfaces: surveyed, repaired with all their parts, united, decked."""

import json
import warnings

import check_hull
import made_hulls
import numpy as np
import pytest
import trimesh
from scenes import model

from independent import load_mesh
from sim import Buoyancy, Hull
from sim.hulls.repair import repair
from sim.hulls.survey import read_surface, survey
from sim.hulls.union import decked, outer_surface, overlapping, united

ROUND_OFF = 1e-9
WIDENING = 1e-4
"""Relative change of volume where touching parts are widened in order to be united."""

WELDING = 1e-5
"""Relative change of volume, and change of size [m], where vertices are merged."""


def arrays(mesh):
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


@pytest.mark.parametrize("name", made_hulls.VOLUMES)
def test_a_repair_closes_the_hull_and_keeps_all_of_it(name):
    make, volume = made_hulls.VOLUMES[name]
    mesh = make()
    found = repair(*arrays(mesh))
    assert found.faults == ()
    assert found.hull.volume == pytest.approx(volume, rel=WELDING)
    np.testing.assert_allclose(found.hull.bounds, mesh.bounds, atol=WELDING)
    after = survey(found.hull.vertices, found.hull.faces)
    assert after.parts == survey(*arrays(mesh)).parts
    assert after.refusal == ""


def test_half_a_hull_is_detected_and_mirrored():
    half = survey(*arrays(made_hulls.half_hull()))
    assert half.half_hull == "y"
    whole = made_hulls.capsule(0.3, 2.0)
    found = repair(*arrays(made_hulls.half_hull()), mirror="y")
    assert found.faults == ()
    assert found.hull.volume == pytest.approx(whole.volume, rel=ROUND_OFF)
    capped = repair(*arrays(made_hulls.half_hull()))
    assert capped.hull.volume == pytest.approx(0.5 * whole.volume, rel=ROUND_OFF)


def opened(axis: int, side: float, *others: trimesh.Trimesh) -> trimesh.Trimesh:
    """A box of 3 x 2 x 1 m around the origin, without the face at one end of an axis."""
    box = made_hulls.box([3.0, 2.0, 1.0])
    kept = made_hulls.made(box.vertices, box.faces[side * box.face_normals[:, axis] < 0.99])
    return made_hulls.joined(kept, *others)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_only_a_flat_and_whole_open_end_is_half_a_hull(side):
    """Another part moves the end away from the rim, or makes the rim too small for the hull."""
    for axis, name in enumerate(["x", "y", ""]):  # a hull open at the top is an open boat
        assert survey(*arrays(opened(axis, side))).half_hull == name
    beside = made_hulls.box([0.1, 0.1, 0.1], [0.0, side * 1.5, 0.0])
    ahead = made_hulls.box([0.1, 0.1, 0.1], [2.0, 0.0, 0.0])
    nearly = made_hulls.box([0.1, 0.1, 0.1], [1.6, 0.0, 0.0])  # the rim spans 3 of 3.15 m
    for other, name in {beside: "", ahead: "", nearly: "y"}.items():
        assert survey(*arrays(opened(1, side, other))).half_hull == name
    for shortened, name in {1e-5: "y", 1e-3: ""}.items():  # the share by which a corner is bent
        bent, faces = arrays(opened(1, side))
        bent[np.argmax(bent @ [1.0, 5.0 * side, 2.0]), 1] *= 1.0 - shortened
        assert survey(bent, faces).half_hull == name


def test_a_survey_counts_faults():
    catamaran = survey(*arrays(made_hulls.open_catamaran()))
    assert [rim.edges for rim in catamaran.rims] == [4, 4]
    np.testing.assert_allclose([rim.middle[1] for rim in catamaran.rims], [-0.8, 0.8])
    assert catamaran.parts == 3
    assert "not closed" in catamaran.refusal
    assert len(survey(*arrays(made_hulls.seven_rims())).rims) == 7
    assert survey(*arrays(made_hulls.unmerged())).doubled_vertices > 2000
    touching = survey(*arrays(made_hulls.four_faces_at_an_edge()))
    assert touching.crowded_edges == 1
    np.testing.assert_allclose(touching.crowded_at, [[0.5, 0.5, 0.0]])
    assert survey(*arrays(made_hulls.inside_out())).inward_parts == 1
    once, twice = made_hulls.capsule(0.3, 2.0), made_hulls.drawn_twice()
    assert survey(*arrays(twice)).doubled_faces == len(once.faces)
    assert "--scale 0.001" in survey(*arrays(made_hulls.in_millimetres())).unit_guess
    bunny = survey(*arrays(load_mesh("bunny")))
    assert (bunny.crossing_faces, bunny.holds, bunny.refusal) == (0, pytest.approx(0, abs=1e-3), "")


def test_crossing_faces_are_found():
    one, other = (made_hulls.box([2.0, 1.0, 1.0]), made_hulls.box([1.0, 0.4, 3.0]))
    both = survey(*arrays(made_hulls.joined(one, other)))
    assert both.overlapping_parts == 2
    assert both.crossing_faces > 0
    assert survey(*arrays(one)).crossing_faces == 0
    nested = survey(*arrays(made_hulls.joined(one, made_hulls.box([0.5, 0.5, 0.5]))))
    assert (nested.nested_parts, nested.overlapping_parts) == (1, 0)


def test_a_sheet_is_a_fault_with_its_position():
    sheet = trimesh.Trimesh([[5, 0, 0], [6, 0, 0], [6, 1, 0], [5, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    found = repair(*arrays(made_hulls.joined(made_hulls.box([1, 1, 1]), sheet)))
    assert "1 of 2 parts are sheets" in found.faults[0]
    assert "(5.5, 0.5, 0)" in found.faults[0]


def test_a_surface_without_area_is_a_fault():
    found = repair(np.eye(3), np.array([[0, 0, 1]]))
    assert found.hull is None
    assert found.done == ("1 faces without area dropped",)
    assert found.faults == ("nothing encloses a volume",)


def test_cells_with_a_common_wall_become_one():
    found = repair(*arrays(made_hulls.two_cells()))
    assert found.faults == ()
    assert "inner walls dropped" in " ".join(found.done)
    assert found.hull.volume == pytest.approx(2.0, rel=WELDING)


def test_a_surface_that_cannot_be_closed_is_a_fault_with_its_position():
    """A Moebius strip has no outside."""
    angles = np.linspace(0.0, 2.0 * np.pi, 30, endpoint=False)
    points = [
        (1 + s * np.cos(t / 2)) * np.array([np.cos(t), np.sin(t), 0]) + [0, 0, s * np.sin(t / 2)]
        for t in angles for s in (-0.3, 0.3)
    ]  # fmt: skip
    following = [*range(2, 60), 1, 0]
    faces = [[i, i + 1, following[i]] for i in range(0, 60, 2)]
    faces += [[i + 1, following[i + 1], following[i]] for i in range(0, 60, 2)]
    found = repair(np.array(points), np.array(faces))
    assert found.hull is None
    assert "it cannot be closed around (" in found.faults[0]


def test_an_open_boat_is_decked_at_its_lowest_gunwale():
    thickness = 0.05
    boat = Hull.from_trimesh(made_hulls.open_boat(thickness))
    closed, held = decked(boat)
    inside = (2.0 - 2 * thickness) * (1.0 - 2 * thickness) * (0.5 - thickness)
    assert held == pytest.approx(inside, rel=WIDENING)
    assert closed.volume == pytest.approx(1.0, rel=WIDENING)
    assert decked(Hull.from_trimesh(made_hulls.box([1, 1, 1]))) is None
    assert decked(closed) is None


def test_a_flared_boat_is_decked_only_inside():
    """The boat is wider at the top, so a prism below its opening would reach outside its bottom."""

    def tub(bottom, top, floor):
        mesh = made_hulls.box([2.0, 2.0, 1.0])
        is_high = mesh.vertices[:, 2] > 0.0
        wide = np.where(is_high, top, bottom)
        x, y, _ = mesh.vertices.T
        vertices = np.stack([wide * x, wide * y, np.where(is_high, 1.0, floor)], axis=1)
        return made_hulls.made(vertices, mesh.faces)

    outer, inner = tub(0.3, 1.0, 0.0), tub(0.3, 0.95, 0.1)
    boat = trimesh.boolean.difference([outer, inner], engine="manifold")
    closed, held = decked(Hull.from_trimesh(boat))
    lowest_point_of_the_rim = 1e-3
    assert held == pytest.approx(inner.volume, rel=lowest_point_of_the_rim)
    assert closed.volume == pytest.approx(outer.volume, rel=lowest_point_of_the_rim)


def test_overlaps_count_once_and_other_hulls_keep_their_bits():
    one, apart = (
        Hull.from_trimesh(made_hulls.box([1, 1, 1])),
        made_hulls.box([1, 1, 1], [0.5, 0, 0]),
    )
    both, twice = united([one, Hull.from_trimesh(apart)])
    assert both.volume == pytest.approx(1.5, rel=ROUND_OFF)
    assert twice == pytest.approx(0.5, rel=ROUND_OFF)
    assert united([one, Hull.from_trimesh(made_hulls.box([1, 1, 1], [1, 0, 0]))]) is None
    bounds = np.array([[[0, 0, 0], [1, 1, 1]], [[5, 0, 0], [6, 1, 1]], [[0.9, 0, 0], [5.1, 1, 1]],
                       [[9, 0, 0], [10, 1, 1]]], dtype=float)  # fmt: skip
    assert overlapping(bounds) == [[0, 1, 2], [3]]
    bunny = load_mesh("bunny")
    hull, twice, cavities = outer_surface(*arrays(bunny))
    assert (twice, cavities) == (0.0, 0)
    np.testing.assert_array_equal(hull.vertices, Hull.from_trimesh(bunny).vertices)


def test_nested_shells_count_once_and_cavities_stay_dry():
    outer, inner = made_hulls.box([2, 2, 2]), made_hulls.box([1, 1, 1])
    hull, twice, cavities = outer_surface(*arrays(made_hulls.joined(outer, inner)))
    assert (hull.volume, twice, cavities) == (pytest.approx(8.0), pytest.approx(1.0), 0)
    cavity = made_hulls.made(inner.vertices, inner.faces[:, ::-1])
    hull, twice, cavities = outer_surface(*arrays(made_hulls.joined(outer, cavity)))
    assert (hull.volume, twice, cavities) == (pytest.approx(8.0), 0.0, 1)
    with pytest.raises(ValueError, match="1 of 2 closed parts of the surface face inward"):
        outer_surface(*arrays(made_hulls.inside_out()))


def test_a_fine_mesh_is_repaired():
    mesh = load_mesh("bunny").subdivide().subdivide()
    assert len(mesh.faces) > 50_000
    distance = np.linalg.norm(mesh.triangles_center - mesh.vertices[0], axis=1)
    hole_radius = 0.02
    found = repair(np.asarray(mesh.vertices), mesh.faces[distance > hole_radius])
    assert found.done == ("1 rims capped",)
    assert found.faults == ()
    flat_cap = 1e-3
    assert found.hull.volume == pytest.approx(mesh.volume, rel=flat_cap)


def run(*arguments) -> int:
    return check_hull.main([str(a) for a in arguments])


def test_the_script_repairs_and_never_overwrites_its_input(tmp_path, capsys):
    file, out, numbers = (tmp_path / name for name in ("cat.stl", "cat.obj", "cat.json"))
    made_hulls.open_catamaran().export(file)
    before = file.read_bytes()
    assert run(file) == 1
    assert run(file, "--repair", out, "--json", numbers) == 0
    printed = capsys.readouterr().out
    assert "2 rims capped" in printed
    assert "volume m^3" in printed
    hull = Hull(*read_surface(out))
    assert hull.volume == pytest.approx(2 * 4.0 * 0.16 + 0.024, rel=1e-6)
    assert run(out) == 0
    assert json.loads(numbers.read_text())["after"]["parts"] == 3
    (tmp_path / "link.stl").symlink_to(file)
    for target in (file, tmp_path / "link.stl"):
        assert run(file, "--repair", target) == 2
        assert run(file, "--json", target) == 2
    assert file.read_bytes() == before
    assert run(file, "--repair", out, "--json", out) == 2
    assert run(file, "--repair", tmp_path / "cat.step") == 2
    assert run(file, "--repair", tmp_path / "new" / "cat.obj") == 0
    assert run(tmp_path / "none.stl") == 2
    empty = tmp_path / "empty.obj"
    empty.write_text("# nothing\n")
    assert run(empty) == 2


def test_the_script_scales_mirrors_and_decks(tmp_path, capsys):
    file, out = tmp_path / "in.obj", tmp_path / "out.obj"
    made_hulls.in_millimetres().export(file)
    assert run(file, "--scale", "0.001", "--repair", out) == 0
    assert Hull(*read_surface(out)).volume == pytest.approx(
        made_hulls.capsule(0.3, 2).volume, rel=1e-6
    )
    made_hulls.half_hull().export(file)
    assert run(file, "--repair", out, "--mirror") == 0
    assert Hull(*read_surface(out)).volume == pytest.approx(
        made_hulls.capsule(0.3, 2).volume, rel=1e-6
    )
    assert run(out, "--repair", file, "--mirror") == 2  # the hull is whole
    made_hulls.open_boat().export(file)
    assert run(file) == 0
    assert "open boat" in capsys.readouterr().out
    assert run(file, "--repair", out, "--deck") == 0
    assert Hull(*read_surface(out)).volume == pytest.approx(1.0, rel=WIDENING)
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1, 2]])
    sheet.export(file)
    out.unlink()
    assert run(file, "--repair", out) == 2
    assert not out.exists()
    assert "encloses a volume" in capsys.readouterr().err


def test_a_repaired_hull_floats(tmp_path):
    """The refusal of an open mesh names this way."""
    file, out = tmp_path / "in.obj", tmp_path / "out.obj"
    made_hulls.open_catamaran().export(file)
    assert run(file, "--repair", out) == 0
    body = '<body><freejoint/><geom name="g" type="mesh" mesh="m" density="300"/></body>'
    compiled = model(body, ("g",), assets=f'<mesh name="m" inertia="exact" file="{out}"/>')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        buoyancy = Buoyancy.of(compiled)
    assert buoyancy.floats[0].method.hull.volume == pytest.approx(1.304, rel=1e-6)
