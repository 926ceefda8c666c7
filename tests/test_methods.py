"""Properties of all methods: names, batches, threads, refusals; and a method from outside."""

import os
import threading

import numpy as np
import pytest
import trimesh
from scenes import CUBE, model

from independent import DENSITY, GRAVITY, load_mesh, meshes, random_poses, three_waves
from labels import labelled_method
from sim import Chord, Hull, Linear, Patches, Reference, Scene, Sea, Wave, simulate
from sim.methods import METHODS, Method, Place
from sim.methods.method import Part, Shared

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


@pytest.mark.parametrize("make", [Linear, Chord, Patches, Reference])
@pytest.mark.parametrize("threads", [1, 3])
def test_a_batch_writes_the_wrenches_of_each_hull_alone(make, threads):
    sea = three_waves()
    ball = Hull.from_trimesh(meshes()["icosphere"])
    one, other = make(BOX, sea), make(ball, sea)
    methods, poses = [one, other, one, other, other], random_poses(5, seed=60)
    if make is Reference:
        methods, poses = [make(BOX, sea, 1e-3)] * 2, poses[:2]
    positions = np.array([p for p, _, _ in poses])
    rotations = np.array([r.ravel() for _, r, _ in poses])
    places = [Place(i, len(poses) - 1 - i) for i in range(len(poses))]
    found = np.full((len(poses), 6), np.nan)
    make.batch(methods, places, threads).write_wrenches(positions, rotations, 0.3, found)
    for method, place in zip(methods, places, strict=True):
        alone = method.wrench(positions[place.pose], rotations[place.pose], 0.3)
        scale = DENSITY * GRAVITY * method.hull.volume
        np.testing.assert_allclose(found[place.row] / scale, alone / scale, atol=1e-15)


def shared_batch(call, parts: int, threads: int) -> Shared:
    """A batch with empty parts that threads share. `call` stands for its kernel."""
    return Shared(call, [Part(np.empty(0), np.array([i])) for i in range(parts)], threads)


def write_nothing(batch: Shared) -> None:
    batch.write_wrenches(np.empty(0), np.empty(0), 0.0, np.empty(0))


def test_helpers_work_in_parallel_with_the_caller():
    """A barrier opens when three threads have reached it."""
    barrier, workers = threading.Barrier(3, timeout=30.0), set()

    def meet(*arguments) -> None:
        workers.add(threading.get_ident())
        barrier.wait()

    write_nothing(shared_batch(meet, parts=3, threads=3))
    assert len(workers) == 3
    assert threading.get_ident() in workers


def test_every_part_is_done_once():
    done: list[int] = []
    batch = shared_batch(lambda block, places, *_: done.append(int(places[0])), 7, threads=4)
    for _ in range(200):
        write_nothing(batch)
    assert sorted(done) == sorted(list(range(7)) * 200)


@pytest.mark.parametrize("caller_fails", [True, False])
def test_an_exception_of_a_part_reaches_the_caller(caller_fails):
    """Each of two threads has one part, and either may fail."""
    barrier, caller = threading.Barrier(2, timeout=30.0), threading.get_ident()

    def call(*arguments) -> None:
        barrier.wait()
        if (threading.get_ident() == caller) == caller_fails:
            raise ArithmeticError("no such wrench")

    with pytest.raises(ArithmeticError, match="no such wrench"):
        write_nothing(shared_batch(call, parts=2, threads=2))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_forked_process_has_its_own_helpers():
    """The helpers of its parent do not exist there. A barrier of two opens only for two threads."""
    barriers = [threading.Barrier(2, timeout=20.0)]
    batch = shared_batch(lambda *_: barriers[0].wait(), parts=2, threads=2)
    write_nothing(batch)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            barriers[0] = threading.Barrier(2, timeout=20.0)
            write_nothing(batch)
            status = 0
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    write_nothing(batch)


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


@pytest.mark.parametrize("threads", [1, 2])
def test_a_pose_that_is_not_finite_affects_only_its_hull(threads):
    methods = [Patches(Hull.from_trimesh(load_mesh("bunny")), three_waves())] * 3
    batch = Patches.batch(methods, [Place(i, i) for i in range(3)], threads)
    positions, rotations = np.zeros((3, 3)), np.tile(np.eye(3).ravel(), (3, 1))
    positions[1, 2], wrenches = np.nan, np.empty((3, 6))
    batch.write_wrenches(positions, rotations, 0.0, wrenches)
    assert np.isnan(wrenches[1]).all()
    assert np.isfinite(wrenches[[0, 2]]).all()
