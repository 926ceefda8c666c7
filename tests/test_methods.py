"""Properties of all methods: names, hulls together, refusals; and a method from outside."""

import numpy as np
import pytest
import trimesh
from scenes import CUBE, model

from independent import DENSITY, GRAVITY, load_mesh, meshes, random_poses, three_waves
from labels import labelled_method
from sim import Chord, Hull, Linear, Patches, Reference, Scene, Sea, Wave, simulate
from sim.methods import METHODS, Method
from sim.methods.method import parts_of

BOX = Hull.from_trimesh(trimesh.creation.box(extents=[1.0, 1.0, 1.0]))


class PointMethod(Method):
    """A toy method that lifts the hull by its whole volume if its position is under water."""

    def wrench(self, position, rotation, time):
        lift = DENSITY * GRAVITY * self.hull.volume if position[2] < self.sea.level else 0.0
        return np.array([0.0, 0.0, lift, 0.0, 0.0, 0.0])


def test_a_method_from_outside_is_one_class_and_one_entry(monkeypatch):
    """Scenes may name it, its hulls float beside others, and it only defines `wrench`."""
    monkeypatch.setitem(METHODS, "point", PointMethod)
    other = CUBE.replace('"cube"', '"other"').replace("0 0 0", "3 0 -2")
    custom = '<text name="buoyancy_method_cube" data="point"/>'
    scene = Scene.from_model(model(CUBE + other, ("cube", "other"), custom))
    assert isinstance(scene.buoyancy.floats[0].method, PointMethod)
    wrenches = scene.buoyancy.wrenches(scene.data)
    np.testing.assert_allclose(wrenches[:, 2], [0.0, DENSITY * GRAVITY])  # at and below the level
    lifts = {float(sample.wrenches[0, 2]) for sample in simulate(scene, 0.5)}
    assert lifts == {0.0, DENSITY * GRAVITY}


@pytest.mark.parametrize(
    ("label", "made"),
    [
        ("linear", (Linear, None, "froude-krylov")),
        ("chord:2", (Chord, ("samples", 2), "froude-krylov")),
        ("patches:0.01", (Patches, ("tolerance", 0.01), "froude-krylov")),
        ("reference:1e-6/hydrostatic", (Reference, ("_tolerance", 1e-6), "hydrostatic")),
        ("chord:3:crests", (Chord, ("crests_only", True), "froude-krylov")),
    ],
)
def test_labels_name_a_method_a_setting_and_a_pressure(label, made):
    kind, setting, pressure = made
    method = labelled_method(label, BOX, Sea([Wave(0.1, 4.0, 0.0, 0.0)]))
    assert type(method) is kind
    assert method.sea.pressure == pressure
    if setting is not None:
        assert getattr(method, setting[0]) == setting[1]


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("guess", "'guess' is not a method; expected one of: linear, chord, patches, reference"),
        ("linear:4", "'linear:4': linear takes no number"),
        ("chord:x", "invalid literal"),
        ("patches:0", r"method 'patches': the tolerance is 0.0"),
        ("linear/static", "water pressure is 'static'"),
    ],
)
def test_labels_without_a_method_are_refused(label, message):
    with pytest.raises(ValueError, match=message):
        labelled_method(label, BOX, Sea())


@pytest.mark.parametrize("make", [Linear, Chord, Patches])
def test_hulls_together_have_the_wrenches_of_each_alone(make):
    seas = three_waves(), three_waves(0.2)
    ball = Hull.from_trimesh(meshes()["icosphere"])
    one, other, elsewhere = make(BOX, seas[0]), make(ball, seas[0]), make(ball, seas[1])
    methods, poses = [one, other, one, elsewhere, other, other], random_poses(5, seed=60)
    positions = np.array([p for p, _, _ in poses])
    rotations = np.array([r.ravel() for _, r, _ in poses])
    which, found = [4, 0, 3, 3, 1, 2], np.full((6, 6), np.nan)
    parts = parts_of(methods, which)
    for kernel, block, places in parts:
        kernel(block, places, positions, rotations, 0.3, found)
    assert len(parts) == (2 if make is Patches else 3)  # one per sea, or one per method
    for i, method in enumerate(methods):
        alone = method.wrench(positions[which[i]], rotations[which[i]], 0.3)
        scale = DENSITY * GRAVITY * method.hull.volume
        np.testing.assert_allclose(found[i] / scale, alone / scale, atol=1e-15)


def test_methods_without_a_kernel_are_in_no_part():
    methods = [Reference(BOX, Sea()), Linear(BOX, Sea()), PointMethod(BOX, Sea())]
    (part,) = parts_of(methods, [7, 8, 9])
    assert part.places.tolist() == [(8, 1)]


EVERY = [lambda h, s: Linear(h, s), lambda h, s: Chord(h, s), lambda h, s: Patches(h, s),
         lambda h, s: Reference(h, s, 1e-5)]  # fmt: skip


@pytest.mark.parametrize("make", EVERY, ids=["linear", "chord", "patches", "reference"])
@pytest.mark.parametrize("sea", [Sea(), three_waves()], ids=["calm", "waves"])
def test_all_methods_refuse_the_same_poses(make, sea):
    method, level = make(Hull.from_trimesh(load_mesh("bunny")), sea), np.eye(3)
    assert np.isfinite(method.wrench([0, 0, 0], level.ravel(), 0.0)).all()
    for position in ([0, 0], [0, 0, 0, 0], [0.1], [[0, 0, 0]], 1.0):
        with pytest.raises(ValueError, match=r"position has shape .*expected \(3,\)"):
            method.wrench(position, level, 0.0)
    with pytest.raises(ValueError, match=r"rotation has shape .*expected \(3, 3\) or \(9,\)"):
        method.wrench([0, 0, 0], [1.0, 0.0, 0.0, 0.0], 0.0)
    sheared = level + [[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]]
    for rotation in (np.diag([1.0, 1.0, -1.0]), 1.001 * level, sheared, np.zeros((3, 3))):
        with pytest.raises(ValueError, match="rotation mirrors, shears or scales"):
            method.wrench([0, 0, 0], rotation, 0.0)
    for bad in (np.nan, np.inf, -np.inf):
        assert np.isnan(method.wrench([0, 0, bad], level, 0.0)).all()
        assert np.isnan(method.wrench([bad, 0, 0], level, 0.0)).all()
        assert np.isnan(method.wrench([0, 0, 0], level, bad)).all()
    assert np.isnan(method.wrench([0, 0, 0], np.full((3, 3), np.nan), 0.0)).all()
