"""Stability: the righting arm of a body that is held at a heel, free to sink and to trim."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sim.geometry import rotation_about
from sim.statics.equilibrium import RigidFloat, rest

Array = NDArray[np.float64]

HEEL_STEP = 5.0
"""Step [deg] between the heels of a curve."""

BISECTIONS = 30
"""Number of times that an interval of heels is halved: 5 degrees become 5e-9."""


def righting_arm(body: RigidFloat, at_rest: Array, heel: float) -> float:
    """Righting arm GZ [m] at a heel [rad] to starboard from the rotation (3, 3) at rest: the moment
    about the world's x axis that turns the body back, over its weight. At rest the bow (the body's
    x axis) lies in the world's plane of x and z."""
    heeled = rotation_about(np.array([heel, 0.0, 0.0])) @ at_rest
    attitude = rest(body, heeled, axes="y")
    return -float(body.pull(body.wetted(attitude))[1]) / body.weight


def righting_arms(body: RigidFloat, at_rest: Array, up_to: float = 90.0) -> Array:
    """Rows (N, 2) of a heel [deg], from 0 in steps of HEEL_STEP, and its righting arm [m]."""
    heels = np.arange(0.0, up_to + 0.5 * HEEL_STEP, HEEL_STEP)
    return np.array([(h, righting_arm(body, at_rest, np.radians(h))) for h in heels])


def vanishing_angle(body: RigidFloat, at_rest: Array, arms: Array) -> float | None:
    """The first heel [deg] at which a positive righting arm falls to 0, from the arms (N, 2) of
    `righting_arms`; None if there is none."""
    for (low, before), (high, after) in pairwise(arms):
        if before > 0.0 >= after:
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                stays = righting_arm(body, at_rest, np.radians(middle)) > 0.0
                low, high = (middle, high) if stays else (low, middle)
            return float(0.5 * (low + high))
    return None
