"""Kernels in single precision, made from the text of those in double precision."""

import numpy as np
import pytest
import trimesh

from independent import load_mesh, random_rotation, three_waves
from sim import Drag, DragCoefficients, Hull, Patches, Sea
from sim.kernels import inline, kernel, record, scratch, workspace
from sim.methods.patches.patches import single_patches_wrenches
from sim.precision import in_single, real, reals, single
from sim.resistance.elements import SURFACE, Pose
from sim.resistance.probes import PROBE, Flow
from sim.resistance.reaction import HULL, REACTION, hull_reaction, hull_tables
from sim.water.gerstner import WAVE, decay, sine_cosine
from sim.water.many_waves import single_decay, single_sine_cosine

SINGLE_ROUND_OFF = 1e-6
"""Error of sums over a hundred elements in single precision, as a share of their scale."""

POINT = record(x="real", place="f8", number="word")
PAIR = record(point=POINT, values=("real", 2), fixed="f4")
TENTH = 0.1
ALMOST_ONE, TINY, HUGE = 1.0 - 1e-12, 1e-300, 1e300


@inline
def tenth_of(x):
    return x * TENTH


@inline
def digits(x):
    return 16


@in_single(digits)
@inline
def single_digits(x):
    return 7


@kernel
def apply(x, sums_out):
    """Every kind of number that the text of a kernel may have."""
    pair, row, long = workspace(PAIR)[0], reals(3), scratch(3)
    pair.point.place, pair.point.x = x, x
    row[0], long[0] = x, x
    sums_out[0] = 0.3 * tenth_of(pair.point.x)
    sums_out[1] = pair.point.place
    sums_out[2] = row[0]
    sums_out[3] = long[0]
    sums_out[4] = real(x)
    sums_out[5] = digits(x)
    sums_out[6] = ALMOST_ONE < 1.0
    sums_out[7] = TINY > 0.0
    sums_out[8] = pair.point.x < HUGE


def results_of(function, x: float) -> np.ndarray:
    sums = np.empty(9)
    function(x, sums)
    return sums


def test_numbers_of_the_text_are_single_and_doubles_stay():
    x = 1.0 / 3.0
    short = np.float32(x)
    product = np.float32(0.3) * (short * np.float32(TENTH))
    np.testing.assert_array_equal(
        results_of(single(apply), x), [product, x, short, x, short, 7, 1, 1, 1]
    )
    expected = [0.3 * (x * TENTH), x, x, x, x, 16, 1, 1, 1]
    np.testing.assert_array_equal(results_of(apply, x), expected)


def test_records_and_functions_have_one_single_version():
    kind = single(PAIR)
    assert kind["point"]["x"] == kind["values"].base == np.float32
    assert kind["point"]["place"] == np.float64
    assert kind["point"]["number"] == np.int32
    assert kind["fixed"] == np.float32
    assert PAIR["point"]["x"] == np.float64
    assert single(kind) == kind
    assert single(apply) is single(apply) is not apply
    assert single(np.dtype("f8")) == np.float64
    assert single(print) is print


@kernel
def nested(x):
    return sum([0.1 * x for _ in range(3)])


def test_a_function_in_a_text_is_refused():
    with pytest.raises(TypeError, match="nested has a function"):
        single(nested)


@pytest.mark.parametrize(
    "pair",
    [(sine_cosine, single_sine_cosine, -0.5, 0.5), (decay, single_decay, 0.0, 60.0)],
    ids=["sine and cosine", "decay"],
)
def test_the_functions_of_waves_have_their_own_single_versions(pair):
    long, short, start, end = pair
    assert single(long) is short
    x = np.linspace(start, end, 1001).astype(np.float32)
    found = np.array([short(each) for each in x])
    truth = np.array([long(float(each)) for each in x])
    np.testing.assert_allclose(found, truth, atol=3e-7)


@pytest.mark.parametrize("depth", [np.inf, 1.5])
@pytest.mark.parametrize("name", ["bunny", "box"])
def test_the_reaction_of_a_hull_is_that_in_double_precision(name, depth):
    """With drag, added mass and damping; also far away and after a day."""
    mesh = trimesh.creation.box((1.0, 0.6, 0.4)) if name == "box" else load_mesh(name)
    hull, sea = Hull.from_trimesh(mesh), Sea(three_waves().waves, depth=depth)
    numbers = (9.0, 12.0, 15.0, 0.2, 0.3, 0.4)
    drag = Drag(
        hull, sea, DragCoefficients(0.2, 0.8, 0.05, 0.1), added_mass=numbers, damping=numbers,
        damping_quadratic=numbers, follows=True,
    )  # fmt: skip
    tables = hull_tables([(drag, hull.volume)])
    kinds, rng = (HULL, SURFACE, PROBE), np.random.default_rng(8)
    shorter = [table.astype(single(kind)) for table, kind in zip(tables, kinds, strict=True)]
    wet = 0
    for far, time in ((0.0, 3.0), (0.0, 5.0), (1e4, 1e5)):
        position = rng.uniform(-1.0, 1.0, 3) * [1.0, 1.0, 0.2] + [far, 0.0, 0.0]
        pose = Pose(position, random_rotation(rng).ravel())
        found, truth = np.zeros((2, 1), REACTION)
        found["velocity"] = truth["velocity"] = rng.normal(size=6)
        found["bias"] = truth["bias"] = rng.normal(size=6)
        given = pose, 0.01, 0.005
        flow = Flow(sea.components.astype(single(WAVE)), sea.water, time)
        share = single(hull_reaction)(shorter[0][0], *shorter[1:], flow, *given, found)
        flow = Flow(sea.components, sea.water, time)
        true_share = hull_reaction(tables[0][0], *tables[1:], flow, *given, truth)
        wet += 0.1 < true_share < 0.9
        assert abs(share - true_share) + np.abs(found["drag"] - truth["drag"]).max() > 0.0
        assert share == pytest.approx(true_share, abs=SINGLE_ROUND_OFF)
        for field in ("drag", "inertia", "matrix", "water", "pull"):
            scale = SINGLE_ROUND_OFF * np.abs(truth[field]).max()
            np.testing.assert_allclose(found[field], truth[field], atol=5.0 * scale, err_msg=field)
    assert wet > 1


def test_far_below_the_surface_only_the_digits_of_the_rotation_are_lost():
    """Heads are then a thousand times the hull's size, but the buoyancy is the weight of the
    water."""
    hull, sea = Hull.from_trimesh(load_mesh("bunny")), Sea(three_waves().waves)
    method, rng = Patches(hull, sea), np.random.default_rng(9)
    assert method._alone[0] is single_patches_wrenches
    weight = sea.density * sea.gravity * hull.volume
    for depth in (1e2, 1e3, 1e4):
        force = method.wrench([0.3, 0.2, -depth], random_rotation(rng), 2.0)[:3]
        np.testing.assert_allclose(force / weight, [0.0, 0.0, 1.0], atol=2e-7)
