"""The chord method: its fan of triangles, its bias, its limits."""

import numpy as np
import pytest
import trimesh

from independent import (
    DENSITY,
    GRAVITY,
    ROUND_OFF,
    mean_error,
    meshes,
    random_poses,
    relative_error,
    three_waves,
)
from sim import Chord, Hull, Linear, Reference, Sea, wet_triangles_wrench

CUBE = trimesh.creation.box(extents=[1.0, 1.0, 1.0])


def fan_wrench(hull, sea, samples, crests_only, position, rotation, time):
    """The chord method written out polygon by polygon; every sample is a vertex of the fan."""
    vertices = hull.vertices @ rotation.T + position

    def head_at(point):
        return float(sea.elevation(point[0], point[1], time)) - point[2]

    heads = np.array([head_at(v) for v in vertices])
    triangles, values = [], []
    for face in hull.faces:
        wet = heads[face] > 0.0
        if wet.all():
            triangles.append(vertices[face])
            values.append(heads[face])
        if wet.all() or not wet.any():
            continue
        lone = next(i for i in range(3) if (wet == wet[i]).sum() == 1)
        a, b, c = (face[(lone + i) % 3] for i in range(3))
        p = vertices[a] + heads[a] / (heads[a] - heads[b]) * (vertices[b] - vertices[a])
        q = vertices[a] + heads[a] / (heads[a] - heads[c]) * (vertices[c] - vertices[a])
        first, last = (p, q) if heads[a] > 0.0 else (q, p)
        fan = vertices[a] if heads[a] > 0.0 else vertices[b]
        fan_head = heads[a] if heads[a] > 0.0 else heads[b]
        if heads[a] <= 0.0:
            triangles.append([vertices[b], vertices[c], q])
            values.append([heads[b], heads[c], 0.0])
        chord = [first + s * (last - first) for s in np.linspace(0.0, 1.0, samples + 2)]
        chord_heads = [0.0, *(head_at(point) for point in chord[1:-1]), 0.0]
        if crests_only:
            chord_heads = [max(head, 0.0) for head in chord_heads]
        for i in range(samples + 1):
            triangles.append([fan, chord[i], chord[i + 1]])
            values.append([fan_head, chord_heads[i], chord_heads[i + 1]])
    return wet_triangles_wrench(np.array(triangles), np.array(values), DENSITY, GRAVITY, position)


@pytest.mark.parametrize("samples", [1, 4, 7])
@pytest.mark.parametrize("crests_only", [False, True])
def test_chord_agrees_with_the_fan_written_out(samples, crests_only):
    hull = Hull.from_trimesh(trimesh.creation.icosphere(subdivisions=1, radius=0.5))
    sea = three_waves(0.7)
    for pose in random_poses(10, seed=31):
        found = Chord(hull, sea, samples, crests_only).wrench(*pose)
        expected = fan_wrench(hull, sea, samples, crests_only, *pose)
        assert relative_error(found, expected, hull) < ROUND_OFF


@pytest.mark.parametrize("name", ["icosphere", "torus", "bunny"])
def test_chord_without_samples_is_linear(name):
    hull, sea = Hull.from_trimesh(meshes()[name]), three_waves()
    for pose in random_poses(5, seed=32):
        found = Chord(hull, sea, samples=0).wrench(*pose)
        assert relative_error(found, Linear(hull, sea).wrench(*pose), hull) < ROUND_OFF


def test_crests_only_lifts_more():
    """Ignoring troughs adds water on average over poses; samples of both signs do not. For a
    12-face cube in gentle waves it is about 1e-4 of the weight of the displaced water."""
    hull, sea = Hull.from_trimesh(CUBE), three_waves(0.1)
    methods = [Linear(hull, sea), Chord(hull, sea, 4), Chord(hull, sea, 4, crests_only=True)]
    lifts = np.array([[m.wrench(*p)[2] for m in methods] for p in random_poses(1500, seed=33)])
    straight, symmetric, crests = lifts.T / (DENSITY * GRAVITY * hull.volume)

    def mean_in_uncertainties(difference):
        return difference.mean() / (difference.std() / np.sqrt(len(difference)))

    assert abs(mean_in_uncertainties(symmetric - straight)) < 3.0
    assert mean_in_uncertainties(crests - symmetric) > 4.0
    assert 5e-5 < (crests - symmetric).mean() < 2e-4


def test_every_method_agrees_on_flat_water():
    hull, sea = Hull.from_trimesh(meshes()["bunny"]), Sea()
    for pose in random_poses(5, seed=34):
        expected = Linear(hull, sea).wrench(*pose)
        for method in (Chord(hull, sea), Chord(hull, sea, 4, True), Reference(hull, sea)):
            assert relative_error(method.wrench(*pose), expected, hull) < ROUND_OFF


def test_methods_converge_to_the_reference_as_meshes_refine():
    """Linear elevation over each triangle leaves a second-order error, with or without a chord."""
    mesh, sea = CUBE.subdivide().subdivide(), three_waves(0.3)
    poses = random_poses(20, seed=35)
    truth = Reference(Hull.from_trimesh(CUBE), sea, 1e-7)
    truths, errors = [truth.wrench(*pose) for pose in poses], []
    for _ in range(4):
        hull = Hull.from_trimesh(mesh)
        methods = Linear(hull, sea), Chord(hull, sea)
        wrenches = ([method.wrench(*pose) for pose in poses] for method in methods)
        errors.append([mean_error(found, truths, hull) for found in wrenches])
        mesh = mesh.subdivide()
    slopes = np.log2(np.divide(errors[:-1], errors[1:]))
    assert ((slopes > 1.6) & (slopes < 2.4)).all(), slopes


@pytest.mark.parametrize("samples", [-1, 1.5, 65])
def test_impossible_sample_counts_are_refused(samples):
    with pytest.raises(ValueError, match=r"samples is .*whole number from 0 to"):
        Chord(Hull.from_trimesh(CUBE), Sea(), samples)
