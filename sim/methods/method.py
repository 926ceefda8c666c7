"""Method: the common interface of all ways to compute a wrench from hull, sea, pose and time."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.hulls.hull import Hull
from sim.kernels import kernel, record
from sim.water.sea import Sea

Array = NDArray[np.float64]
Block = NDArray[np.uint8]
Table = NDArray[np.void]
Kernel = Callable[[Block, Table, Array, Array, float, Array], None]

ROTATION_ERROR = 1e-6
"""Largest error of the products of a rotation's columns; single-precision quaternions leave
less."""


@dataclass(frozen=True)
class Settings:
    """The fields of a scene for its methods. A method ignores fields that it does not use.

    buoyancy_tolerance [m of water height]: None for the method's default. chord_samples: points on
    each chord. reference_tolerance: a share of density * gravity * volume.
    """

    buoyancy_tolerance: float | None = None
    chord_samples: int = 4
    reference_tolerance: float = 1e-9


PLACE = record(pose="i8", row="i8")
"""The rows of a hull in the arrays of poses and of wrenches. No two hulls share a row of
wrenches."""


class Part(NamedTuple):
    """The hulls of one call of a kernel: the kernel, its read-only block of tables
    (`kernels.packed`), and the hulls' places (PLACE records, or records that include its
    fields)."""

    kernel: Kernel
    block: Block
    places: Table


def pose_arrays(position: ArrayLike, rotation: ArrayLike, time: float) -> tuple[Array, Array, bool]:
    """Convert a pose to the arrays that kernels expect, (3,) and (9,), and tell whether the pose
    and the time are finite. Raises ValueError for a wrong shape, or if the rotation is not a
    rotation matrix."""
    position = np.ascontiguousarray(position, dtype=float)
    rotation = np.ascontiguousarray(rotation, dtype=float)
    if position.shape != (3,):
        raise ValueError(f"the position has shape {position.shape}; expected (3,) [m]")
    if rotation.shape not in ((3, 3), (9,)):
        raise ValueError(f"the rotation has shape {rotation.shape}; expected (3, 3) or (9,)")
    rotation = rotation.reshape(9)
    found = pose_state(position, rotation, time)
    if found == DISTORTED:
        raise ValueError(
            "the rotation mirrors, shears or scales; expected a rotation, hull -> world, whose "
            "columns are unit vectors at right angles, right-handed"
        )
    return position, rotation, found == FINE


FINE, UNKNOWN, DISTORTED = range(3)


@kernel
def pose_state(position, rotation, time):
    """FINE, UNKNOWN for a pose (3,), (9,) or time that is not finite, or DISTORTED for a matrix
    that is not a rotation."""
    if not is_known(position, rotation, time):
        return UNKNOWN
    return DISTORTED if is_distorted(rotation) else FINE


@kernel
def is_distorted(r):
    """Whether a matrix (9,) is not a rotation."""
    x = r[0] * r[4] * r[8] + r[1] * r[5] * r[6] + r[2] * r[3] * r[7]
    x -= r[2] * r[4] * r[6] + r[1] * r[3] * r[8] + r[0] * r[5] * r[7]
    worst = abs(x - 1.0)
    for i in range(3):
        for j in range(i + 1):
            dot = r[i] * r[j] + r[3 + i] * r[3 + j] + r[6 + i] * r[6 + j]
            worst = max(worst, abs(dot - (i == j)))
    return worst > ROTATION_ERROR


@kernel
def is_known(position, rotation, time):
    """Whether a pose (3,), (9,) and a time are finite."""
    total = time
    for i in range(3):
        total += abs(position[i])
    for i in range(9):
        total += rotation[i]
    return total - total == 0.0


class Method(ABC):
    """A way to compute the water's wrench on a hull in a sea. A method has no state.

    Your own subclass needs only `wrench`. With an entry in `METHODS`, scenes may name it.

    tolerance [m of water height]: the tolerance that the method keeps; None for a method without
    one. notes: sentences about requests that the method could not follow exactly.
    """

    tolerance: float | None = None
    notes: tuple[str, ...] = ()

    def __init__(self, hull: Hull, sea: Sea) -> None:
        self.hull = hull
        self.sea = sea

    @abstractmethod
    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        """Force [N] and torque [N m] about the position, in world axes: (6,).

        position (3,) [m]: the hull frame's origin in the world. rotation (3, 3) or (9,): hull axes
        to world axes. time [s]. A pose or time that is not finite gives NaN. Raises ValueError for
        a wrong shape, or if the rotation is not a rotation matrix.
        """

    @classmethod
    def from_settings(cls, hull: Hull, sea: Sea, settings: Settings) -> Self:
        """The method with a scene's settings. Raises ValueError."""
        return cls(hull, sea)


class Compiled(Method):
    """A method whose wrenches are computed by a kernel.

    The kernel takes a block, places, positions (P, 3), rotations (P, 9), a time and wrenches_out
    (H, 6), and writes the rows of the places. The poses and the time must be finite.
    """

    @classmethod
    @abstractmethod
    def parts(cls, methods: Sequence[Self], places: Table) -> list[Part]:
        """Parts with all hulls of these methods, which share one sea. places (H,): PLACE
        records."""

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        time = float(time)
        position, rotation, is_finite = pose_arrays(position, rotation, time)
        if not is_finite:
            return np.full(6, np.nan)
        wrenches, (kernel, block, places) = np.empty((1, 6)), self._alone
        kernel(block, places, position.reshape(1, 3), rotation.reshape(1, 9), time, wrenches)
        return wrenches[0]

    def _prepare(self) -> None:
        """Prepare `wrench`. A subclass calls it at the end of its `__init__`."""
        (self._alone,) = self.parts([self], np.zeros(1, PLACE))


def parts_of(methods: Sequence[Method], poses: Sequence[int]) -> list[Part]:
    """Parts with all hulls whose methods are Compiled. Hull i has its pose in row poses[i], and its
    wrench in row i."""
    places = np.array(list(zip(poses, range(len(methods)), strict=True)), PLACE)
    alike: dict[tuple[type[Compiled], int], list[tuple[int, Compiled]]] = {}
    for i, method in enumerate(methods):
        if isinstance(method, Compiled):
            alike.setdefault((type(method), id(method.sea)), []).append((i, method))
    return [
        part
        for (kind, _), members in alike.items()
        for part in kind.parts([method for _, method in members], places[[i for i, _ in members]])
    ]
