"""Faulty surfaces: surveyed, repaired with all their parts, united, decked."""

import json
import re
import warnings

import check_hull
import made_hulls
import numpy as np
import pytest
import trimesh
from scenes import model

from independent import load_mesh
from sim import Buoyancy, Hull
from sim.hulls.files import read_surface
from sim.hulls.repair import repair
from sim.hulls.solids import overlapping
from sim.hulls.survey import survey
from sim.hulls.union import decked, united

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
    assert "sheets that enclose nothing: 2 faces, 14 % of the area" in found.faults[0]
    assert "(5.5, 0.5, 0)" in found.faults[0]


def test_specks_are_left_out_of_a_repair_with_their_position():
    mesh = made_hulls.SPECKS["a triangle outside"](made_hulls.ship())
    found = repair(*arrays(mesh))
    assert found.faults == ()
    (text,) = found.done
    assert "specks left out: 1 faces, 1.6e-05 % of the area, around (1.001, 2.001, 0)" in text


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
    pair = Hull.from_trimesh(made_hulls.joined(bunny, made_hulls.box([1, 1, 1], [0, 0, 9])))
    assert pair.changes == ()
    vertices = np.unique(bunny.vertices, axis=0)
    np.testing.assert_array_equal(pair.vertices[: len(vertices)], bunny.vertices)


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


def test_the_script_leaves_out_sheets_if_asked(tmp_path, capsys):
    file, out = tmp_path / "in.obj", tmp_path / "out.obj"
    fin = [[0.5, 0, 0], [1.5, 0, 0], [1.5, 0, 1]]
    made_hulls.with_faces(made_hulls.box([1, 1, 1]), fin).export(file)
    assert run(file, "--repair", out) == 2
    error = capsys.readouterr().err
    assert "leave them out with --drop-sheets" in error
    assert f"{out} was not written" in error
    assert run(file, "--repair", out, "--drop-sheets") == 0
    assert "sheets left out: 1 faces" in capsys.readouterr().out
    assert Hull(*read_surface(out)).volume == pytest.approx(1.0, rel=ROUND_OFF)
    with pytest.raises(SystemExit):
        run(file, "--drop-sheets")


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


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A file that was cut, or in which bytes or a number were replaced."""
    at = int(rng.integers(len(content)))
    numbers = [found.span() for found in re.finditer(rb"-?\d+\.?\d*(e-?\d+)?", content)]
    word = rng.choice([b"nan", b"inf", b"-1", b"1e300", b"99999999999999999999", b""])
    first, end = numbers[int(rng.integers(len(numbers)))] if numbers else (at, at)
    wild = [rng.bytes(4), np.float32("nan").tobytes(), np.int32(10_000).tobytes()]
    return [
        content[:at],
        content[:at] + wild[int(rng.integers(3))] + content[at + 4 :],
        content[:first] + word + content[end:],
    ][int(rng.integers(3))]


@pytest.mark.parametrize(
    "kind", ["obj", "stl", "stl_ascii", "ply", "off", "glb", "gdf", "dat", "pnl"]
)
def test_a_damaged_file_is_read_or_refused_in_one_line(kind, tmp_path):
    """Never with another error, and never with indices out of range or numbers that are not
    finite."""
    rng, path = np.random.default_rng(3), tmp_path / f"a.{kind.removesuffix('_ascii')}"
    if kind in PANEL_FILES:
        content = PANEL_FILES[kind].encode()
    else:
        exported = made_hulls.box([1, 1, 1]).export(file_type=kind)
        content = exported if isinstance(exported, bytes) else exported.encode()
    path.write_bytes(content)
    assert read_surface(path)[1].shape[1] == 3
    refusals = []
    for _ in range(60):
        path.write_bytes(damaged(content, rng))
        try:
            vertices, faces = read_surface(path)
        except ValueError as error:
            refusals.append(str(error))
        else:
            assert np.isfinite(vertices[faces]).all()
            assert faces.min() >= 0
    assert refusals
    assert all(text.startswith(f"{path}: ") and "\n" not in text for text in refusals)


@pytest.mark.parametrize("kind", ["ply", "glb"])
def test_a_face_index_out_of_range_is_refused(kind, tmp_path, capsys):
    mesh = made_hulls.box([1, 1, 1])
    mesh.faces[3, 1] = 8
    path = tmp_path / f"a.{kind}"
    path.write_bytes(mesh.export(file_type=kind))
    assert run(path) == 2
    assert "1 face indices lie outside 0..7" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "text", "remedy"),
    [
        ("dae", "missing `pip install pycollada`", "needs pycollada for .dae"),
        ("3mf", "No module named 'networkx'", "pip install '.[meshes]'"),
        ("step", "No module named 'cascadio'", "pip install cascadio"),
        ("obj", "No module named 'charset_normalizer'", "it is no .obj"),
    ],
)
def test_a_missing_package_is_named_with_what_to_install(kind, text, remedy, tmp_path, monkeypatch):
    """With the words of trimesh."""

    def load(*arguments: object, **options: object) -> None:
        raise ImportError(text)

    monkeypatch.setattr(trimesh, "load", load)
    path = tmp_path / f"a.{kind}"
    path.touch()
    with pytest.raises(ValueError, match=re.escape(remedy)):
        read_surface(path)


def test_copies_of_vertices_in_stl_files_have_one_story(tmp_path, capsys):
    """Binary and ASCII. The rims are those of the hull with merged vertices, and the refusal says
    why it is refused nevertheless."""
    corners = made_hulls.capsule(0.3, 2.0).triangles.astype(np.float32)
    corners[5, 1, 0] = np.nextafter(corners[5, 1, 0], np.float32(9))
    mesh = made_hulls.made(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    printed = []
    for kind in ("stl", "stl_ascii"):
        (tmp_path / "a.stl").unlink(missing_ok=True)
        exported = mesh.export(file_type=kind)
        content = exported if isinstance(exported, bytes) else exported.encode()
        (tmp_path / "a.stl").write_bytes(content)
        assert run(tmp_path / "a.stl") == 1
        printed.append(capsys.readouterr().out)
        assert run(tmp_path / "a.stl", "--repair", tmp_path / "out.obj") == 0
        capsys.readouterr()
    assert printed[0] == printed[1]
    assert re.search(r"open rims +0\n", printed[0])
    assert "1 vertices are not quite where others are" in printed[0]


QUARTER = ((0, 0, -1), (0, 2, -1), (4, 2, -1), (4, 0, -1), (4, 2, 0), (4, 0, 0), (0, 2, 0))
QUARTER_PANELS = ((1, 2, 3, 4), (4, 3, 5, 6), (3, 2, 7, 5))
"""The wetted quarter x > 0, y > 0 of a barge of 8 x 4 x 1 m; indices count from 1."""


def _places(numbers) -> str:
    return " ".join(map(str, np.array(QUARTER)[np.array(numbers) - 1].ravel()))


_CORNERS = "".join(f"{i} {x} {y} {z}\n" for i, (x, y, z) in enumerate(QUARTER, 1))
_HALF = np.array(QUARTER) * [-1, 1, 1]
_HALF_CORNERS = "".join(f"{i + 7} {x} {y} {z}\n" for i, (x, y, z) in enumerate(_HALF.tolist(), 1))
_PANELS = [*QUARTER_PANELS, *(tuple(7 + i for i in panel[::-1]) for panel in QUARTER_PANELS)]
PANEL_FILES = {
    "gdf": "a quarter\n1 9.81 ULEN GRAV\n1 1 ISX ISY\n3\n"
    + "".join(_places(panel) + "\n" for panel in QUARTER_PANELS),
    "dat": f"2 1\n{_CORNERS}{_HALF_CORNERS}0 0. 0. 0.\n"
    + "".join(" ".join(map(str, panel)) + "\n" for panel in _PANELS)
    + "0 0 0 0\n",
    "pnl": f"--- Hull Mesh File ---\n# Numbers\n3 7 1 1\n\n# Nodes\n{_CORNERS}# Panels\n"
    + "".join(f"{i} 4 {' '.join(map(str, p))}\n" for i, p in enumerate(QUARTER_PANELS, 1)),
}


@pytest.mark.parametrize("kind", [*PANEL_FILES, "mar"])
def test_a_panel_file_is_a_wetted_surface_that_a_repair_closes_at_the_waterline(kind, tmp_path):
    path = tmp_path / f"a.{kind}"
    path.write_text(PANEL_FILES["dat" if kind == "mar" else kind])
    surface = read_surface(path)
    found = survey(*surface)
    assert found.extents == (8.0, 4.0, 1.0)
    assert found.area == pytest.approx(8 * 4 + 2 * (8 + 4), rel=ROUND_OFF)
    assert found.twisted_edges == 0
    (rim,) = found.rims
    np.testing.assert_allclose(rim.extents, [8.0, 4.0, 0.0], atol=ROUND_OFF)
    assert "not closed" in found.refusal
    assert repair(*surface).hull.volume == pytest.approx(8 * 4 * 1, rel=ROUND_OFF)
