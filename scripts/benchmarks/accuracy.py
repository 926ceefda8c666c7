"""Accuracy: errors and timings of methods.

Errors are taken against `Reference`, forces relative to density * gravity * volume and torques to
that times the hull's longest side, over seeded poses in which the water cuts the hull. Times are of
methods taken in turns, so that whatever else the machine does slows all of them alike.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.seas import Pose
from labels import labelled_method
from sim.hulls.hull import Hull
from sim.methods import Method
from sim.water.sea import Sea

Array = NDArray[np.float64]

FEWEST_ROUNDS = 3
"""Rounds of timing below which a minimum and a median mean nothing."""

IN_A_ROW = 3
"""Times that a pose is computed at once, the fastest of which counts: a simulation's next pose is
nearly the same too, so what the last one needed is still in the caches."""

CHANGES = ("horizontal", "vertical", "torque")
"""Errors whose change against the baseline's is stated."""


def longest_side(hull: Hull) -> float:
    """Longest side [m] of the hull's box."""
    return float(np.ptp(hull.bounds, axis=0).max())


def wrenches(method: Method, poses: Sequence[Pose]) -> Array:
    """Wrenches (N, 6) [N, N m] of a method at poses."""
    return np.array([method.wrench(*pose) for pose in poses])


@dataclass(frozen=True)
class Errors:
    """Errors over poses: largest and root mean square of the force, of its horizontal and vertical
    parts (of density * gravity * volume) and of the torque (of that times the longest side);
    bias: mean error of the vertical force, upwards, and the standard error of that mean."""

    force_max: float
    force_rms: float
    horizontal_max: float
    horizontal_rms: float
    vertical_max: float
    vertical_rms: float
    torque_max: float
    torque_rms: float
    bias: float
    bias_error: float


def errors(found: Array, truth: Array, method: Method) -> Errors:
    """Errors of wrenches (N, 6) of a method against the true ones."""
    sea, hull = method.sea, method.hull
    force = (found - truth) / (sea.density * sea.gravity * hull.volume)
    parts = {
        "force": force[:, :3],
        "horizontal": force[:, :2],
        "vertical": force[:, 2:3],
        "torque": force[:, 3:] / longest_side(hull),
    }
    figures = {}
    for name, part in parts.items():
        size = np.linalg.norm(part, axis=1)
        figures[f"{name}_max"] = float(size.max())
        figures[f"{name}_rms"] = float(np.sqrt(np.mean(size**2)))
    vertical = force[:, 2]
    scatter = float(vertical.std(ddof=1) / np.sqrt(len(vertical))) if len(vertical) > 1 else np.nan
    return Errors(**figures, bias=float(vertical.mean()), bias_error=scatter)


def time_in_turns(
    methods: Sequence[Method], poses: Sequence[Pose], seconds: float, most_rounds: int = 50
) -> Array:
    """Seconds a wrench, (rounds, methods, poses).

    A round takes every method over all poses, IN_A_ROW times each, one method after the other;
    rounds go on for about so many seconds, at least FEWEST_ROUNDS of them. A first call compiles
    the kernels.
    """
    for method in methods:
        method.wrench(*poses[0])
    rounds: list[list[list[float]]] = []
    begin = perf_counter()
    while len(rounds) < FEWEST_ROUNDS or (
        len(rounds) < most_rounds and perf_counter() - begin < seconds
    ):
        rounds.append([])
        for method in methods:
            rounds[-1].append([_fastest(method, pose) for pose in poses])
    return np.array(rounds)


def _fastest(method: Method, pose: Pose) -> float:
    """Seconds of the fastest of IN_A_ROW calls."""
    seconds = []
    for _ in range(IN_A_ROW):
        started = perf_counter()
        method.wrench(*pose)
        seconds.append(perf_counter() - started)
    return min(seconds)


def speeds_and_errors(
    texts: Sequence[str], hull: Hull, sea: Sea, poses: Sequence[Pose], truth: Array, seconds: float
) -> Iterator[dict[str, Any]]:
    """A row for each labelled method: what a wrench costs, and its errors against the true wrenches
    (N, 6). The first method is the baseline. All timing together takes `seconds`."""
    methods, setup = [], []
    for text in texts:
        started = perf_counter()
        methods.append(labelled_method(text, hull, sea))
        setup.append(perf_counter() - started)
    times = time_in_turns(methods, poses, seconds)
    # of each pose's repeats, then the mean over poses
    fastest = 1e6 * times.min(axis=0).mean(axis=1)
    median = 1e6 * np.median(times, axis=0).mean(axis=1)
    found = [asdict(errors(wrenches(method, poses), truth, method)) for method in methods]
    for i, text in enumerate(texts):
        changes = {
            f"{part}_change": 100.0 * (found[i][f"{part}_rms"] / found[0][f"{part}_rms"] - 1.0)
            for part in CHANGES
        }
        yield {
            "method": text,
            "baseline": i == 0,
            "setup_ms": 1e3 * setup[i],
            "us_median": float(median[i]),
            "us_min": float(fastest[i]),
            "speed_up": float(fastest[0] / fastest[i]),
            **found[i],
            **changes,
        }
