"""Patches: the tolerance holds, forces are smooth, awkward triangles work."""

import numpy as np
import pytest
import trimesh

from independent import (
    DENSITY,
    GRAVITY,
    ROUND_OFF,
    clip,
    load_mesh,
    meshes,
    quadrature_wrench,
    random_poses,
    random_rotation,
    relative_error,
    three_waves,
    volume_below,
)
from sim import Hull, Linear, Patches, Reference, Sea, Wave
from sim.methods.method import parts_of
from sim.methods.patches import fit
from sim.methods.patches.fit import (
    CENTRE_SHIFT_RADII,
    fitted_waves,
    head_errors,
    jet_radius,
    jet_waves,
    surface_errors,
)
from sim.methods.patches.patches import add_nodes
from sim.methods.patches.polynomial import MONOMIALS, POLYNOMIAL
from sim.methods.patches.tree import build_tree
from sim.water.samples import sample_places

CUBE = trimesh.creation.box(extents=[1.0, 1.0, 1.0])


def crossing_waves(length: float, steepness: float) -> Sea:
    """Three crossing waves around a length."""
    shares = [0.5, 0.3, 0.2]
    lengths = [length, 0.8 * length, 0.6 * length]
    headings = [0.0, 1.0, -2.0]
    return Sea(
        [
            Wave(steepness * share * each / (2.0 * np.pi), each, heading, heading)
            for share, each, heading in zip(shares, lengths, headings, strict=True)
        ]
    )


def forty_waves(steepness: float = 0.72) -> Sea:
    rng = np.random.default_rng(41)
    lengths = rng.uniform(0.7, 6.0, 40)
    shares = rng.uniform(0.5, 1.5, 40)
    amplitudes = steepness * shares / shares.sum() * lengths / (2.0 * np.pi)
    headings, phases = rng.uniform(-1.0, 1.0, 40), rng.uniform(-np.pi, np.pi, 40)
    return Sea([Wave(*wave) for wave in zip(amplitudes, lengths, headings, phases, strict=True)])


def largest_head_error(method: Patches, position, rotation, time: float) -> float:
    """Largest error [m] of the heads at the vertices of all patches, down to the bottom. Where a
    vertex is dry, only a positive head is an error."""
    points, heads = method.heads_at_vertices(position, rotation, time)
    heads = np.where(np.isnan(heads), 0.0, heads)  # patches that count as out of the water's reach
    truth = method.sea.head(*points.T, time)
    missed = np.where(truth >= 0.0, np.abs(heads - truth), np.maximum(heads, 0.0))
    return float(missed[points[:, 2] >= method.sea.level - method.sea.depth].max())


def decaying(sea: Sea) -> Sea:
    return sea.with_pressure("froude-krylov")


SEAS = {
    f"{length} hulls long, steepness {steepness}": crossing_waves(length, steepness)
    for length in (0.5, 2.0, 10.0, 100.0)
    for steepness in (0.2, 0.8)
}
SEAS["forty waves"] = forty_waves()
for phase, steepness in ((0.5, 0.3), (1.0, 0.5)):
    waves = crossing_waves(10.0, steepness).waves
    SEAS[f"k H {phase}, steepness {steepness}"] = Sea(waves, depth=phase / waves[0].wavenumber)


@pytest.mark.parametrize("pressure", [Sea.hydrostatic.fget, decaying], ids=["still", "decaying"])
@pytest.mark.parametrize("sea", SEAS.values(), ids=SEAS.keys())
@pytest.mark.parametrize("name", ["icosphere", "bunny"])
def test_the_tolerance_holds(name, sea, pressure):
    """At any pose the head in every patch is within the tolerance. So the wrench is within the
    tolerance's pressure on the whole surface."""
    sea = pressure(sea)
    hull = Hull.from_trimesh(meshes()[name])
    tolerance = 0.02 if sea.waves[0].wavelength < 1.0 else 0.004
    method = Patches(hull, sea, tolerance)
    area = np.linalg.norm(hull.area_vectors, axis=1).sum()
    implied = DENSITY * GRAVITY * tolerance * area
    for i, (position, rotation, time) in enumerate(far_poses(4)):
        assert largest_head_error(method, position, rotation, time) < tolerance
        if i == 0:
            wrench = method.wrench(position, rotation, time)
            truth = Reference(hull, sea, 1e-3).wrench(position, rotation, time)
            assert np.linalg.norm(wrench[:3] - truth[:3]) < implied
            assert np.linalg.norm(wrench[3:] - truth[3:]) < implied  # with arms below 1 m


@pytest.mark.parametrize("pressure", ["hydrostatic", "froude-krylov"])
@pytest.mark.parametrize("name", ["forty waves", "10.0 hulls long, steepness 0.8"])
def test_skipped_patches_below_the_highest_crest_are_dry(name, pressure):
    sea = Sea(SEAS[name].waves, pressure=pressure)
    method = Patches(Hull.from_trimesh(meshes()["icosphere"]), sea, 1e-3)
    skipped = 0
    for _, rotation, time in far_poses(20):
        position = [0.0, 0.0, 0.3 * sea.amplitude]
        points, heads = method.heads_at_vertices(position, rotation, time)
        dry = np.isnan(heads) & (points[:, 2] < sea.amplitude)
        skipped += dry.sum()
        assert (sea.head(*points[dry].T, time) < 0.0).all()
    assert skipped > 500


@pytest.mark.parametrize("pressure", [Sea.hydrostatic.fget, decaying], ids=["still", "decaying"])
@pytest.mark.parametrize("steepness", [0.2, 0.8])
def test_the_tolerance_holds_for_waves_of_a_tenth_of_the_hull(steepness, pressure):
    spindle = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    spindle.vertices *= [1.0, 0.15, 0.15]
    sea = pressure(crossing_waves(0.1, steepness))
    method = Patches(Hull.from_trimesh(spindle), sea, tolerance=0.04)
    for pose in far_poses(3):
        assert largest_head_error(method, *pose) < 0.04


def test_the_tolerance_holds_for_a_short_wave_as_high_as_the_tolerance():
    """Such a wave may be ignored over a large patch, but not be halved over a smaller one."""
    sea = Sea([Wave(0.1, 13.0, 0.4), Wave(0.02, 0.4, 0.9, 1.0)])
    for name in ("torus", "icosphere"):
        for tolerance in (0.01, 0.025, 0.035, 0.05):
            method = Patches(Hull.from_trimesh(meshes()[name]), sea, tolerance)
            for pose in far_poses(3):
                assert largest_head_error(method, *pose) < tolerance


@pytest.mark.parametrize("sea", [three_waves(), forty_waves()], ids=["three", "forty"])
def test_fitted_jets_are_more_accurate_than_taylor_series(sea):
    radius = 0.2
    taylor, fitted = (
        surface_errors(sea, waves, radius).max()
        for waves in (sea.components, fitted_waves(sea, radius))
    )
    assert fitted < 0.7 * taylor


def test_jets_hold_at_points_other_than_the_samples(monkeypatch):
    """The radius comes from samples. At four times as many other particles the error stays below
    the tolerance, because the samples have a margin."""
    sea, tolerance = Sea.jonswap(0.3, 3.0, seed=1), 0.004
    labels = np.random.default_rng(54).uniform(-1e4, 1e4, (8192, 2))
    points = tuple(sea.particles(labels, 0.0).T[:2].copy())
    for water, find_error in ((sea.hydrostatic, surface_errors), (decaying(sea), head_errors)):
        radius, _ = jet_radius(water, tolerance, largest=1.0)
        monkeypatch.setattr(fit, "sample_places", lambda _: points)
        reach = (1.0 + CENTRE_SHIFT_RADII) * radius
        error = find_error(water, jet_waves(water, radius), reach).max()
        monkeypatch.undo()
        assert 0.5 * tolerance < error < tolerance


def test_patches_are_round_and_within_the_largest_radius():
    """Discs of the largest radius have less than 2.4 times the area of the ball. (Hexagons would
    have 1.2 times and repeated halves 3 times.)"""
    ball = Hull.from_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=0.5))
    for radius in (0.4, 0.2):
        patches = build_tree(ball, radius, np.inf).patches
        assert (patches["radius"] <= radius).all()
        assert len(patches) * radius**2 < 2.4 * 4.0 * 0.5**2


def far_poses(count: int):
    """Poses within 50 m, near the surface, at times to 100 s."""
    rng = np.random.default_rng(42)
    for _ in range(count):
        position = rng.uniform(-50.0, 50.0, 3) * [1.0, 1.0, 0.004]
        yield position, random_rotation(rng), rng.uniform(0.0, 100.0)


def plate(thickness: float = 0.01, halvings: int = 5) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=[1.0, 1.0, thickness])
    for _ in range(halvings):
        mesh = mesh.subdivide()
    return mesh


def clipped_volume(hull: Hull, method: Patches, position, time: float) -> float:
    """Lifted volume [m^3] of a level hull, from clipping each triangle with the patches' heads."""
    points, heads = method.heads_at_vertices(position, np.eye(3), time)
    known = {tuple(np.round(p, 9)): h for p, h in zip(points, heads, strict=True)}
    vertices = hull.vertices + position
    at = np.array([known[tuple(np.round(v, 9))] for v in vertices])
    corners, wet = clip(vertices[hull.faces], at[hull.faces])
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(-(wet.mean(axis=1) @ area[:, 2]))


def test_no_node_is_wrongly_taken_for_wet_or_dry():
    """Crests and troughs meet the flat bounding boxes of a level plate's nodes. Clipping every
    triangle with the same heads, without nodes, gives the same force up to the curvature of the
    cubic within a triangle."""
    sea = crossing_waves(2.0, 0.2)
    hull = Hull.from_trimesh(plate())
    method = Patches(hull, sea, 0.05)
    edge = 2.0**-5 * np.sqrt(2.0)
    sag = np.abs(sea.surface(*sample_places(sea), 0.0).hessian).max() * edge**2 / 8.0
    for position, _, time in random_poses(4, seed=52):
        position[2] = float(sea.elevation(position[0], position[1], time))
        lifted = method.wrench(position, np.eye(3), time)[2] / (DENSITY * GRAVITY)
        expected = clipped_volume(hull, method, position, time)
        area_near_the_waterline = 0.1  # m^2, of 1 m^2
        assert abs(lifted - expected) < area_near_the_waterline * sag


def test_wrenches_converge_to_the_reference_with_the_tolerance():
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), three_waves()
    poses = random_poses(4, seed=43)
    truths = [Reference(hull, sea, 1e-8).wrench(*pose) for pose in poses]
    errors = []
    for tolerance in (1e-2, 1e-3, 1e-4):
        method = Patches(hull, sea, tolerance)
        found = [method.wrench(*pose) for pose in poses]
        errors.append(max(relative_error(f, t, hull) for f, t in zip(found, truths, strict=True)))
    assert errors[0] < 5e-4
    assert errors[1] < errors[0] / 5.0
    assert errors[2] < errors[1] / 5.0


def test_the_default_is_as_accurate_as_linear_on_the_bunny():
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), three_waves()
    linear, patches = Linear(hull, sea), Patches(hull, sea)
    worst = {"linear": 0.0, "patches": 0.0}
    for pose in random_poses(20, seed=44):
        truth = Reference(hull, sea, 1e-7).wrench(*pose)
        for name, method in (("linear", linear), ("patches", patches)):
            error = relative_error(method.wrench(*pose), truth, hull)
            worst[name] = max(worst[name], error)
    assert worst["patches"] <= worst["linear"]


def test_a_submerged_hull_has_only_the_error_of_the_cubic():
    """The wrench of a fully submerged hull comes from moments alone. In a long wave the cubic is
    nearly exact, so the force and the torque must be, too."""
    sea = Sea([Wave(0.3, 12.0, 0.4)])
    hull = Hull.from_trimesh(meshes()["torus"])
    method = Patches(hull, sea, 1e-5)
    for _, rotation, time in random_poses(4, seed=53):
        found = method.wrench([0.4, -0.3, -1.5], rotation, time)
        truth = Reference(hull, sea, 1e-10).wrench([0.4, -0.3, -1.5], rotation, time)
        moments_in_single_precision = float(np.finfo(np.float32).eps)
        assert relative_error(found, truth, hull) < moments_in_single_precision


@pytest.mark.parametrize("name", ["icosphere", "torus", "bunny"])
def test_flat_water_needs_one_patch_and_is_exact(name):
    mesh = meshes()[name]
    hull = Hull.from_trimesh(mesh)
    method = Patches(hull, Sea())
    assert len(method.tree.patches) == 1
    for position, rotation, _ in random_poses(10, seed=45):
        placed = trimesh.Trimesh(mesh.vertices @ rotation.T + position, mesh.faces, process=False)
        force = method.wrench(position, rotation, 0.0)[:3] / (DENSITY * GRAVITY)
        np.testing.assert_allclose(force, [0, 0, volume_below(placed, 0.0)], atol=ROUND_OFF)
        expected = Linear(hull, Sea()).wrench(position, rotation, 0.0)
        found = method.wrench(position, rotation, 0.0)
        assert relative_error(found, expected, hull) < ROUND_OFF


def test_coarse_triangles_are_split_to_meet_the_tolerance():
    """A 12-face cube in chop becomes as good as a finely meshed one."""
    sea = Sea([Wave(0.02, 0.5, 0.3), Wave(0.01, 0.35, -1.2, 1.0)])
    hull = Hull.from_trimesh(CUBE)
    linear, patches = Linear(hull, sea), Patches(hull, sea, 1e-3)
    assert np.count_nonzero(patches.tree.leaves["triangles"]) > 500
    worst = [0.0, 0.0]
    for pose in random_poses(10, seed=46):
        truth = Reference(hull, sea, 1e-6).wrench(*pose)
        for i, method in enumerate((linear, patches)):
            worst[i] = max(worst[i], relative_error(method.wrench(*pose), truth, hull))
    assert worst[1] < 2e-4
    assert worst[1] < worst[0] / 50.0


def test_dry_and_deep_hulls():
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), three_waves()
    method = Patches(hull, sea, 1e-4)
    assert not method.wrench([0.0, 0.0, 3.0], np.eye(3), 0.0).any()
    rotation = random_rotation(np.random.default_rng(47))
    deep = method.wrench([0.3, 0.2, -50.0], rotation, 1.0)
    truth = Reference(hull, sea).wrench([0.3, 0.2, -50.0], rotation, 1.0)
    assert relative_error(deep, truth, hull) < 1e-5
    assert np.isnan(method.wrench([0.0, 0.0, np.nan], np.eye(3), 0.0)).any()


def sums_of(method: Patches, polynomial: np.ndarray, patch: np.void, bound: float) -> np.ndarray:
    """Sums (6,) over a patch, of force and torque over - density * gravity, from a polynomial whose
    bound decides which nodes are opened."""
    polynomial["bound_2"], sums = bound, np.zeros((1, 6))
    add_nodes(patch["first"], patch["end"], patch["radius"], method.tree, polynomial, 0, sums)
    return sums[0]


NOTHING_OPENED, ALL_OPENED = 0.0, 1e9

MOMENTS_ROUND_OFF = 1e-6  # moments of second and third order are in single precision


def test_an_opened_wet_leaf_adds_what_its_moments_do():
    hull, rng = Hull.from_trimesh(load_mesh("bunny")), np.random.default_rng(3)
    method, polynomial = Patches(hull, three_waves()), np.zeros(1, POLYNOMIAL)
    for patch in method.tree.patches[::6]:
        polynomial["c"] = rng.normal(size=MONOMIALS)
        polynomial["c"][0, 0] = polynomial["head"] = 3.0  # everything is wet
        whole = sums_of(method, polynomial, patch, NOTHING_OPENED)
        parts = sums_of(method, polynomial, patch, ALL_OPENED)
        assert np.abs(parts - whole).max() < MOMENTS_ROUND_OFF * np.abs(whole).max()


@pytest.mark.parametrize("bound", [NOTHING_OPENED, ALL_OPENED])
def test_a_linear_head_is_cut_exactly(bound):
    hull, rng = Hull.from_trimesh(load_mesh("bunny")), np.random.default_rng(4)
    method, polynomial = Patches(hull, three_waves()), np.zeros(1, POLYNOMIAL)
    for slope in random_rotation(rng):
        found = np.zeros(6)
        for patch in method.tree.patches:
            centre = np.array([patch["x"], patch["y"], patch["z"]])
            polynomial["c"][0, 1:4] = slope
            polynomial["c"][0, 0] = polynomial["head"] = (centre - hull.centroid) @ slope
            found += sums_of(method, polynomial, patch, bound)
        heads = (hull.vertices - hull.centroid) @ slope
        wet = clip(hull.vertices[hull.faces], heads[hull.faces])
        expected = quadrature_wrench(*wet, np.zeros(3)) / (-DENSITY * GRAVITY)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=ROUND_OFF * hull.volume)


@pytest.mark.parametrize("step", [1e-5, 1e-6])
def test_forces_do_not_jump(step):
    """Along slow sweeps of height and angle, wrenches change in proportion to the step. A node that
    opens or closes must not cause a jump of even 1e-8 of the weight."""
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), three_waves()
    method = Patches(hull, sea, 0.02)  # jumps would be large with large patches
    scale = DENSITY * GRAVITY * hull.volume
    axis = np.array([0.6, 0.64, 0.48])
    for position, rotation, time in random_poses(3, seed=48):
        for sweep in ("height", "angle"):
            wrenches = []
            for s in step * np.arange(600):
                if sweep == "height":
                    wrenches.append(method.wrench(position + [0.0, 0.0, s], rotation, time))
                else:
                    rotated = trimesh.transformations.rotation_matrix(s, axis)[:3, :3] @ rotation
                    wrenches.append(method.wrench(position, rotated, time))
            differences = np.diff(wrenches, axis=0) / scale
            steady = np.median(differences, axis=0)
            jumps = np.abs(differences - steady).max()
            kinks, round_off = 0.2 * step, 1e-11  # the slope changes where vertices meet the water
            assert jumps < kinks + round_off


def awkward(kind: str) -> trimesh.Trimesh:
    """Boxes with slivers, with tiny triangles, and with faces parallel to flat water."""
    mesh = CUBE.copy()
    if kind == "slivers":
        mesh = mesh.subdivide()
        mesh.vertices[:, 0] = np.where(
            np.abs(mesh.vertices[:, 0]) < 0.25, 0.5 - 1e-6, mesh.vertices[:, 0]
        )
    if kind == "tiny":
        mesh = mesh.subdivide().subdivide()
        mesh.vertices *= 1e-3
    return mesh


@pytest.mark.parametrize("kind", ["slivers", "tiny", "aligned"])
def test_awkward_triangles(kind):
    mesh = awkward(kind)
    hull = Hull.from_trimesh(mesh)
    size = np.ptp(hull.bounds[:, 2])
    sliver_round_off = 1e-9  # corners of slivers are 1e-6 apart
    for height in (0.0, 0.5 * size, -0.5 * size, 0.25 * size):  # faces and vertices on the water
        found = Patches(hull, Sea()).wrench([0.0, 0.0, height], np.eye(3), 0.0)
        displaced = hull.volume * (0.5 - height / size)
        np.testing.assert_allclose(
            found / (DENSITY * GRAVITY * hull.volume),
            [0.0, 0.0, displaced / hull.volume, 0.0, 0.0, 0.0],
            atol=sliver_round_off,
        )


def test_hulls_together_share_trees_and_have_the_wrenches_of_each_alone():
    sea = three_waves()
    ball = Hull.from_trimesh(meshes()["icosphere"])
    shared, other = Patches(ball, sea, 1e-3), Patches(Hull.from_trimesh(CUBE), sea, 1.5e-3)
    assert not np.array_equal(
        shared.levels[0].waves, other.levels[0].waves
    )  # they must not be mixed up
    poses = random_poses(4, seed=49)
    positions = np.array([p for p, _, _ in poses])
    rotations = np.array([r.ravel() for _, r, _ in poses])
    out = np.ones((5, 6))
    methods, which = [shared, other, shared, other], [2, 0, 1, 2]
    ((kernel, block, places),) = parts_of(methods, which)
    kernel(block, places, positions, rotations, 0.6, out)
    np.testing.assert_array_equal(out[4], 1.0)  # a row without a hull
    for row, method in enumerate(methods):
        alone = method.wrench(positions[which[row]], rotations[which[row]], 0.6)
        np.testing.assert_allclose(out[row], alone, rtol=1e-9)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan])
def test_an_impossible_tolerance_is_refused(tolerance):
    with pytest.raises(ValueError, match=r"tolerance is .*above 0"):
        Patches(Hull.from_trimesh(CUBE), Sea(), tolerance)


def test_the_same_input_gives_the_same_bits():
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), three_waves()
    pose = random_poses(1, seed=50)[0]
    first = Patches(hull, sea).wrench(*pose)
    np.testing.assert_array_equal(first, Patches(hull, sea).wrench(*pose))


def test_ripples_far_below_the_tolerance_cost_no_triangles():
    """Ripples of a hundredth of the swell's length and 4 % of the tolerance add no triangles, and
    change the force by less than the tolerance's pressure."""
    hull, tolerance = Hull.from_trimesh(trimesh.creation.box(extents=(10.0, 2.0, 1.0))), 0.02
    swell, ripples = Wave(0.3, 10.0), [Wave(2e-4, 0.1, 0.4), Wave(2e-4, 0.13, -0.9)]
    smooth, rippled = (Patches(hull, Sea([swell, *more]), tolerance) for more in ([], ripples))
    triangles = [int((p.tree.leaves["triangles"] != 0).sum()) for p in (smooth, rippled)]
    assert triangles[1] <= 1.2 * triangles[0]
    assert len(rippled.tree.patches) < 100  # patches as small as ripples would be thousands
    position, rotation = np.array([0.3, 0.1, 0.05]), random_rotation(np.random.default_rng(3))
    truth = Reference(hull, smooth.sea, 1e-4).wrench(position, rotation, 0.7)
    force = rippled.wrench(position, rotation, 0.7) - truth
    assert np.linalg.norm(force[:3]) < tolerance * DENSITY * GRAVITY * 20.0
