"""The hull: its volume, centroid and bounds, and all refusals."""

import copy
import pickle
import re

import made_hulls
import numpy as np
import pytest
import trimesh

from independent import ROUND_OFF, load_mesh, meshes
from sim import Hull
from sim.hulls.repair import repair
from sim.hulls.union import united

joined, inverted = made_hulls.joined, made_hulls.inverted


def cube(size: float, x: float = 0.0, y: float = 0.0):
    return made_hulls.box([size] * 3, [x, y, 0.0])


BOX = trimesh.creation.box(extents=[2.0, 1.0, 0.5])


def test_volume_centroid_and_bounds_of_a_box():
    hull = Hull(BOX.vertices + [1.0, 2.0, 3.0], BOX.faces)
    assert hull.volume == pytest.approx(1.0, rel=ROUND_OFF)
    np.testing.assert_allclose(hull.centroid, [1.0, 2.0, 3.0], rtol=ROUND_OFF)
    np.testing.assert_array_equal(hull.bounds, [[0.0, 1.5, 2.75], [2.0, 2.5, 3.25]])


@pytest.mark.parametrize("name", ["icosphere", "torus", "bunny"])
def test_volume_centroid_and_area_agree_with_trimesh(name):
    mesh = meshes()[name]
    hull = Hull.from_trimesh(mesh)
    assert hull.volume == pytest.approx(mesh.volume, rel=ROUND_OFF)
    np.testing.assert_allclose(hull.centroid, mesh.center_mass, atol=ROUND_OFF)
    np.testing.assert_allclose(np.linalg.norm(hull.area_vectors, axis=1).sum(), mesh.area)
    np.testing.assert_allclose(hull.area_vectors.sum(axis=0), 0.0, atol=ROUND_OFF)


def test_volume_keeps_its_precision_far_from_the_origin():
    hull = Hull(BOX.vertices + 1e5, BOX.faces)
    corner_round_off = 1e-9
    assert hull.volume == pytest.approx(1.0, rel=corner_round_off)
    np.testing.assert_allclose(hull.centroid, 1e5, rtol=1e-14)


def test_shipped_meshes_are_hulls():
    for name, faces in (("bunny", 3674), ("dragon", 10000)):
        hull = Hull.from_trimesh(load_mesh(name))
        assert len(hull.faces) == faces
        obj_decimals = 1e-6
        assert np.ptp(hull.bounds, axis=0).max() == pytest.approx(1.0, abs=obj_decimals)
        np.testing.assert_allclose(hull.centroid, 0.0, atol=obj_decimals)


def test_coincident_vertices_are_merged():
    soup = BOX.vertices[BOX.faces].reshape(-1, 3)
    hull = Hull(soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(hull.vertices) == 8
    assert hull.volume == pytest.approx(1.0, rel=ROUND_OFF)


def test_collapsed_faces_and_unused_vertices_are_dropped():
    vertices = np.vstack([BOX.vertices, BOX.vertices[0], [9.0, 9.0, 9.0]])
    faces = np.vstack([BOX.faces, [0, 8, 1]])  # vertex 8 lies on vertex 0
    hull = Hull(vertices, faces)
    assert (len(hull.vertices), len(hull.faces)) == (8, 12)
    assert hull.bounds.max() < 9.0


def test_an_inward_surface_is_turned_outward_with_a_warning():
    with pytest.warns(UserWarning, match="faced inward.*turned outward"):
        hull = Hull(BOX.vertices, BOX.faces[:, ::-1])
    assert hull.volume == pytest.approx(1.0, rel=ROUND_OFF)


def test_separate_parts_are_accepted():
    pair = trimesh.util.concatenate([BOX, BOX.copy().apply_translation([0.0, 3.0, 0.0])])
    assert Hull.from_trimesh(pair).volume == pytest.approx(2.0, rel=ROUND_OFF)


NESTED = {
    "one in another": (joined(cube(2), cube(1)), 8.0, "12 % of its volume twice"),
    "a cavity": (joined(cube(2), inverted(cube(1))), 8.0, "1 cavity stays dry: 1 m"),
    "four, in turns": (
        joined(cube(4), inverted(cube(3)), cube(2), inverted(cube(1))), 64.0, "2 cavities.* 27 m",
    ),
    "cavities that touch at an edge": (
        joined(cube(4), inverted(cube(1, 0.5, 0.5)), inverted(cube(1, -0.5, -0.5))), 64.0,
        "2 cavities stay dry: 2 m",
    ),
    "a cavity that touches the outside": (
        joined(cube(2), inverted(cube(1, 0.5, 0.5))), 8.0, "1 cavity stays dry",
    ),
    "a cavity in two that overlap": (
        joined(cube(2, 0.5), cube(2, -0.5), inverted(cube(1))), 12.0, "1 cavity stays dry: 1 m",
    ),
}  # fmt: skip
"""Shells that lie in others, the volume [m^3] of their outside, and what is said about it."""


@pytest.mark.parametrize("name", NESTED)
def test_a_hull_is_the_outside_of_its_shells(name):
    mesh, volume, change = NESTED[name]
    hull = Hull.from_trimesh(mesh)
    assert hull.volume == pytest.approx(volume, rel=ROUND_OFF)
    np.testing.assert_allclose(hull.area_vectors.sum(axis=0), 0.0, atol=ROUND_OFF)
    assert re.search(change, " ".join(hull.changes))
    with pytest.warns(UserWarning, match="turned outward"):
        assert Hull.from_trimesh(inverted(mesh)).volume == pytest.approx(volume, rel=ROUND_OFF)


def test_plates_around_a_void_are_a_hull_with_a_dry_cavity():
    thickness = 0.04
    plates = [Hull.from_trimesh(plate) for plate in made_hulls.plates(thickness=thickness)]
    tank, _ = united(plates)
    assert tank.volume == pytest.approx(1.0, rel=ROUND_OFF)
    np.testing.assert_allclose(tank.centroid, 0.0, atol=ROUND_OFF)
    assert "1 cavity stays dry: 0.779 m^3" in tank.changes[0]
    without_a_lid, _ = united(plates[:5])
    inside = (1 - 2 * thickness) ** 2 * (1 - thickness)
    assert without_a_lid.volume == pytest.approx(1.0 - inside, rel=ROUND_OFF)
    assert without_a_lid.changes == ()


@pytest.mark.parametrize("name", made_hulls.SPECKS)
def test_specks_are_left_out_of_a_hull(name):
    ship = made_hulls.ship()
    hull, whole = Hull.from_trimesh(made_hulls.SPECKS[name](ship)), Hull.from_trimesh(ship)
    np.testing.assert_array_equal(hull.vertices[hull.faces], whole.vertices[whole.faces])
    assert re.search(r"left out: \d+ faces, .* % of the area, around \(", hull.changes[0])


@pytest.mark.parametrize("name", made_hulls.SHEETS)
def test_sheets_are_refused_or_left_out_of_a_repair(name):
    mesh = made_hulls.SHEETS[name](made_hulls.ship())
    with pytest.raises(ValueError, match="the surface is not closed"):
        Hull.from_trimesh(mesh)
    assert "sheets that enclose nothing" in repair(mesh.vertices, mesh.faces).faults[0]
    found = repair(mesh.vertices, mesh.faces, drop_sheets=True)
    assert found.faults == ()
    assert "sheets left out" in found.done[-1]
    merged_vertices = 1e-9
    assert found.hull.volume == pytest.approx(made_hulls.ship().volume, rel=merged_vertices)


def test_a_hull_is_immutable_and_independent_of_the_callers_arrays():
    vertices = np.array(BOX.vertices)
    hull = Hull(vertices, BOX.faces)
    vertices[:] = 0.0
    assert hull.bounds[1, 0] == 1.0
    for array in (hull.vertices, hull.faces, hull.area_vectors, hull.centroid, hull.bounds):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(AttributeError):
        hull.volume = 2.0


def _one_part_inward():
    other = trimesh.creation.box(extents=[0.2, 0.2, 0.2])
    other.invert()
    other.apply_translation([0.0, 3.0, 0.0])
    both = trimesh.util.concatenate([BOX, other])
    return both.vertices, both.faces


def _one_face_reversed():
    faces = np.array(BOX.faces)
    faces[3] = faces[3, ::-1]
    return BOX.vertices, faces


def _touching_along_an_edge():
    other = BOX.copy().apply_translation([2.0, 1.0, 0.0])
    both = trimesh.util.concatenate([BOX, other])
    return both.vertices, both.faces


NOT_FINITE = np.array(BOX.vertices)
NOT_FINITE[2, 1] = np.nan
FLAT = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ((BOX.vertices, BOX.faces[1:]), "not closed: 3 of 18 edges.*repair"),
        (_touching_along_an_edge(), "1 of 35 edges have more than two"),
        (_one_face_reversed(), "winding is inconsistent: 3 of 18"),
        (_one_part_inward(), "1 of 2 closed parts.*inward.*turn them outward"),
        ((NOT_FINITE, BOX.faces), "1 of 8 vertices are not finite"),
        ((BOX.vertices, BOX.faces + 1), "indices lie outside 0..7"),
        ((BOX.vertices, BOX.faces - 1), "indices lie outside 0..7"),
        ((FLAT, [[0, 1, 2], [0, 2, 1]]), "1 of 1 closed parts.*no volume"),
        (([], []), "found 0 vertices and 0 faces"),
        ((BOX.vertices, []), "found 8 vertices and 0 faces"),
        ((BOX.vertices[:, :2], BOX.faces), r"vertices have shape \(8, 2\)"),
        ((BOX.vertices, np.zeros((4, 4), int)), r"faces have shape \(4, 4\)"),
        ((BOX.vertices, BOX.faces * 1.0), "faces are float64"),
        ((np.zeros((3, 3)), [[0, 1, 2]]), "no face is left"),
    ],
)
def test_refusals_count_and_name_the_remedy(arrays, message):
    with pytest.raises(ValueError, match=message):
        Hull(*arrays)


@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda h: pickle.loads(pickle.dumps(h))]
)
def test_copies_are_equal_and_immutable(again):
    hull = again(Hull.from_trimesh(BOX))
    assert hull.volume == pytest.approx(Hull.from_trimesh(BOX).volume)
    for array in (hull.vertices, hull.faces, hull.area_vectors, hull.centroid, hull.bounds):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


def test_a_hull_too_large_for_double_precision_is_refused():
    with pytest.raises(ValueError, match=r"reaches 1e\+200 m from.*check the units"):
        Hull(2e200 * BOX.vertices / np.ptp(BOX.vertices, axis=0).max(), BOX.faces)
