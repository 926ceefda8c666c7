"""Probes: the water's motion around a hull from a few of its elements."""

import numpy as np
import pytest
import trimesh

from sim import Hull, Sea, Wave
from sim.geometry import random_rotation
from sim.hulls.primitives import box
from sim.resistance.drag import Drag, DragCoefficients
from sim.resistance.elements import ELEMENTS
from sim.resistance.probes import (
    LEAST_PROBES,
    MOST_PROBES,
    NO_PROBES,
    PROBE_ERROR,
    probe_error,
    sampled_motions,
)

COEFFICIENTS = DragCoefficients(0.2, 1.0, 0.005)


def waves(length: float = 2.0, **settings) -> Sea:
    return Sea([Wave(0.02 * length, length, 20.0, 50.0), Wave(0.01 * length, 0.6 * length, -40.0)],
               **settings)  # fmt: skip


def at_every_element(drag: Drag) -> Drag:
    """The drag with the water's motion computed at each of its elements."""
    other = Drag(drag.hull, drag.sea, drag.coefficients)
    other.probes = NO_PROBES
    return other


def wrenches(drag: Drag, sea: Sea, moving: float, size: float) -> np.ndarray:
    """Drag (P, 6) in random poses at the surface, at rest or moving at random."""
    rng, found = np.random.default_rng(4), []
    for _ in range(40):
        place = rng.uniform(-0.5, 0.5, 3) * size
        velocity = moving * rng.normal(size=6)
        found.append(drag.wrench(place, random_rotation(rng), velocity, rng.uniform(0.0, 5.0)))
    return np.array(found)


@pytest.mark.parametrize("settings", [{}, {"depth": 1.0}], ids=["deep", "shallow"])
def test_drag_from_probes_is_that_from_all_elements(settings):
    """Within the errors that PROBE_ERROR leaves, most in the waves' own drag of a hull at rest."""
    sea, hull = waves(**settings), box(0.15, 0.1, 0.06)
    drag = Drag(hull, sea, COEFFICIENTS)
    assert LEAST_PROBES <= len(drag.probes) <= MOST_PROBES
    for moving, share in ((0.0, PROBE_ERROR), (1.0, 0.3 * PROBE_ERROR)):
        found = wrenches(drag, sea, moving, 0.15)
        exact = wrenches(at_every_element(drag), sea, moving, 0.15)
        missed = np.linalg.norm(found - exact) / np.linalg.norm(exact)
        assert 0.0 < missed < share


def test_smaller_hulls_need_fewer_probes_and_large_ones_have_none():
    counts = [len(Drag(ball(r), waves(), COEFFICIENTS).probes) for r in (0.02, 0.2, 2.0)]
    assert counts[0] == LEAST_PROBES < counts[1] <= MOST_PROBES
    assert counts[2] == 0


def ball(radius: float) -> Hull:
    return Hull.from_trimesh(trimesh.creation.icosphere(3, radius=radius))


def test_errors_of_probes_fall_with_their_number():
    """The error of fewer probes than were chosen is above the limit, that of the chosen is not."""
    drag = Drag(box(0.15, 0.1, 0.06), waves(), COEFFICIENTS)
    judged = sampled_motions(drag.surface, drag.strength, drag.sea, seed=2)
    assert probe_error(drag.probes, drag.surface, *judged) < 1.5 * PROBE_ERROR
    one = drag.probes[:1].copy()
    one["share"] = 1.0
    assert probe_error(one, drag.surface, *judged) > 4.0 * PROBE_ERROR


def test_probes_do_not_change_a_uniform_flow():
    """A hull that drifts with the current of still water, or of waves, feels as it does at rest."""
    for sea, moving in (
        (Sea([]), Sea([], current=(0.7, -0.4))),
        (waves(), waves(current=(0.7, -0.4))),
    ):
        rest, drifting = (Drag(box(0.15, 0.1, 0.06), s, COEFFICIENTS) for s in (sea, moving))
        place, turn = np.array([0.1, 0.2, -0.05]), random_rotation(np.random.default_rng(6))
        still = rest.wrench(place, turn, np.zeros(6), 0.0)
        carried = drifting.wrench(place, turn, [0.7, -0.4, 0, 0, 0, 0], 0.0)
        np.testing.assert_allclose(carried, still, atol=1e-9)
        np.testing.assert_allclose(rest.probes["share"].sum(axis=0), 1.0, rtol=1e-12)
        assert rest.probes["share"].shape[1] == ELEMENTS
