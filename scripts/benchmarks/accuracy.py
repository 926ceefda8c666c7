"""Accuracy: errors and timings of methods.

Errors are relative: forces to density * gravity * volume, torques to that force times the hull's
longest side. The methods are timed in turns, so that other load on the machine slows all of them
alike.
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
"""Least number of timing rounds for a meaningful minimum and median."""

REPEATS_PER_POSE = 3
"""Times that each pose is computed in succession; the fastest counts. Successive poses of a
simulation are nearly the same too, so the data they need is already in the caches."""

COMPARED_ERRORS = ("horizontal", "vertical", "torque")
"""Names of the errors that are compared with the baseline's."""


def longest_side(hull: Hull) -> float:
    """Longest side [m] of the hull's bounding box."""
    return float(np.ptp(hull.bounds, axis=0).max())


def wrenches(method: Method, poses: Sequence[Pose]) -> Array:
    """Wrenches (N, 6) [N, N m] of a method at N poses."""
    return np.array([method.wrench(*pose) for pose in poses])


@dataclass(frozen=True)
class Errors:
    """Largest and root mean square (rms) errors over poses.

    Errors of the force and of its horizontal and vertical components are shares of density *
    gravity * volume; errors of the torque are shares of that force times the longest side. bias:
    mean error of the vertical force, positive upwards. bias_error: standard error of that mean.
    """

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
    """Errors of a method's wrenches (N, 6) against the true ones (N, 6)."""
    sea, hull = method.sea, method.hull
    force = (found - truth) / (sea.density * sea.gravity * hull.volume)
    vectors = {
        "force": force[:, :3],
        "horizontal": force[:, :2],
        "vertical": force[:, 2:3],
        "torque": force[:, 3:] / longest_side(hull),
    }
    figures = {}
    for name, vector in vectors.items():
        size = np.linalg.norm(vector, axis=1)
        figures[f"{name}_max"] = float(size.max())
        figures[f"{name}_rms"] = float(np.sqrt(np.mean(size**2)))
    vertical = force[:, 2]
    scatter = float(vertical.std(ddof=1) / np.sqrt(len(vertical))) if len(vertical) > 1 else np.nan
    return Errors(**figures, bias=float(vertical.mean()), bias_error=scatter)


def time_in_turns(
    methods: Sequence[Method], poses: Sequence[Pose], seconds: float, most_rounds: int = 50
) -> Array:
    """Seconds per wrench, (rounds, methods, poses).

    In a round each method in turn computes all poses. Rounds repeat for about `seconds`, but at
    least FEWEST_ROUNDS and at most `most_rounds` times. A call before the first round compiles the
    kernels.
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
    """Seconds of the fastest of REPEATS_PER_POSE calls."""
    seconds = []
    for _ in range(REPEATS_PER_POSE):
        started = perf_counter()
        method.wrench(*pose)
        seconds.append(perf_counter() - started)
    return min(seconds)


def speeds_and_errors(
    texts: Sequence[str], hull: Hull, sea: Sea, poses: Sequence[Pose], truth: Array, seconds: float
) -> Iterator[dict[str, Any]]:
    """Yield a row per labelled method: the time per wrench, and its errors against the true
    wrenches (N, 6). The first method is the baseline. All timing together takes about `seconds`."""
    methods, setup = [], []
    for text in texts:
        started = perf_counter()
        methods.append(labelled_method(text, hull, sea))
        setup.append(perf_counter() - started)
    times = time_in_turns(methods, poses, seconds)
    # over the rounds of each pose, then the mean over the poses
    fastest = 1e6 * times.min(axis=0).mean(axis=1)
    median = 1e6 * np.median(times, axis=0).mean(axis=1)
    found = [asdict(errors(wrenches(method, poses), truth, method)) for method in methods]
    for i, text in enumerate(texts):
        changes = {
            f"{name}_change": 100.0 * (found[i][f"{name}_rms"] / found[0][f"{name}_rms"] - 1.0)
            for name in COMPARED_ERRORS
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
