"""Method: what every way to turn (hull, sea, pose, time) into a wrench has in common."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import getpid
from threading import Lock
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.hulls.hull import Hull
from sim.kernels import address_of, kernel, record
from sim.water.sea import Sea

Array = NDArray[np.float64]
Block = NDArray[np.uint8]
Table = NDArray[np.void]
Kernel = Callable[[Block, Table, Array, Array, float, Array], None]

ROTATION_ERROR = 1e-6
"""Of the products of a rotation's columns, as quaternions in single precision leave them."""

PARTS_A_THREAD = 3
"""Parts into which hulls are divided for each thread: the more, the less one waits for another in
the end, but each part costs a few microseconds."""


@dataclass(frozen=True)
class Settings:
    """The fields of a scene that concern its methods, by their names. A method ignores those that
    it has no use for.

    buoyancy_tolerance [m of water height], None for the method's own default; chord_samples: points
    on each chord; reference_tolerance [of density * gravity * volume].
    """

    buoyancy_tolerance: float | None = None
    chord_samples: int = 4
    reference_tolerance: float = 1e-9


@dataclass(frozen=True)
class Place:
    """Where a hull of many finds its pose and leaves its wrench: rows of the arrays of both. No two
    hulls have the same row of the wrenches."""

    pose: int
    row: int


class NativePart(NamedTuple):
    """Hulls of one method for C code: the address of a kernel of `Compiled`, its block, its
    places."""

    kernel: int
    block: Block
    places: Table


class Batch(ABC):
    """Many hulls of methods of one class."""

    def native(self) -> list[NativePart] | None:
        """The same for C code, or None where only the interpreter can do it."""
        return None

    @abstractmethod
    def write_wrenches(
        self, positions: Array, rotations: Array, time: float, wrenches_out: Array
    ) -> None:
        """Write each hull's wrench to its row of wrenches_out (H, 6), for its pose among positions
        (P, 3) [m] and rotations (P, 9)."""


def pose_arrays(position: ArrayLike, rotation: ArrayLike, time: float) -> tuple[Array, Array, bool]:
    """A pose as kernels take it, (3,) and (9,), and whether it and the time are finite. Raises
    ValueError for other shapes and for what is no rotation."""
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
    """Whether a pose (3,), (9,) and a time are FINE, not finite, or the rotation is none."""
    if not is_known(position, rotation, time):
        return UNKNOWN
    return DISTORTED if is_distorted(rotation) else FINE


@kernel
def is_distorted(r):
    """Whether a matrix (9,) is none of a rotation."""
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


@kernel
def forget_unknown(places, positions, rotations, time, wrenches_out):
    """Make the wrenches (H, 6) of poses that are not finite NaN."""
    for p in range(places.size):
        if not is_known(positions[places[p].pose], rotations[places[p].pose], time):
            wrenches_out[places[p].row] = np.nan


class Method(ABC):
    """A way to compute the water's wrench on a hull in a sea; no state changes from call to call.

    A class of one's own needs `wrench`; with an entry in `METHODS` scenes may name it. Where many
    hulls together are cheaper than one after the other, it has a `batch` of its own.

    tolerance [m of water height]: what it keeps, None for a method that has no use for a scene's;
    notes: what could not be done as it was wished, a sentence each.
    """

    tolerance: float | None = None
    notes: tuple[str, ...] = ()

    def __init__(self, hull: Hull, sea: Sea) -> None:
        self.hull = hull
        self.sea = sea

    @abstractmethod
    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        """Force [N] and torque [N m] about the position, world axes: (6,).

        position: (3,) [m], the hull frame's origin in the world; rotation: (3, 3) or (9,),
        hull -> world; time [s]. Raises ValueError for other shapes and for what is no rotation;
        a pose or a time that is not finite gives NaN.
        """

    @classmethod
    def from_settings(cls, hull: Hull, sea: Sea, settings: Settings) -> Self:
        """The method with a scene's settings. Raises ValueError."""
        return cls(hull, sea)

    @classmethod
    def batch(cls, methods: Sequence[Self], places: Sequence[Place], threads: int = 1) -> Batch:
        """Several hulls at once; `threads`: how many, with the caller's own, may share them."""
        return Loop(methods, places)


class Loop(Batch):
    """A batch that takes one hull after the other."""

    def __init__(self, methods: Sequence[Method], places: Sequence[Place]) -> None:
        self._hulls = [(m, p.pose, p.row) for m, p in zip(methods, places, strict=True)]

    def write_wrenches(
        self, positions: Array, rotations: Array, time: float, wrenches_out: Array
    ) -> None:
        for method, pose, row in self._hulls:
            wrenches_out[row] = method.wrench(positions[pose], rotations[pose], time)


PLACE = record(pose="i8", row="i8")
"""A hull's Place, as kernels read it."""


class Part(NamedTuple):
    """A part of a batch: a block of tables (`kernels.packed`), which nothing changes, and the
    hulls' places (PLACE, or records that have those fields too)."""

    block: Block
    places: Table


class Compiled(Method):
    """A method that is a kernel.

    The kernel takes a block, places, positions (P, 3), rotations (P, 9), time and wrenches_out
    (H, 6), and writes the rows that the places name.
    """

    @classmethod
    @abstractmethod
    def kernel(cls) -> Kernel:
        """The compiled function."""

    @classmethod
    @abstractmethod
    def parts(cls, methods: Sequence[Self], places: Sequence[Place], count: int) -> list[Part]:
        """All hulls in about so many parts of like cost, the dearest first."""

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        time = float(time)
        position, rotation, is_finite = pose_arrays(position, rotation, time)
        if not is_finite:
            return np.full(6, np.nan)
        wrenches = np.empty((1, 6))
        self._kernel(*self._alone, position.reshape(1, 3), rotation.reshape(1, 9), time, wrenches)
        return wrenches[0]

    def _prepare(self) -> None:
        """What `wrench` needs, once all that the parts are made of is there."""
        self._kernel = self.kernel()
        (self._alone,) = self.parts([self], [Place(0, 0)], 1)

    @classmethod
    def batch(cls, methods: Sequence[Self], places: Sequence[Place], threads: int = 1) -> Batch:
        count = 1 if threads == 1 else PARTS_A_THREAD * threads
        rows = np.array([(place.pose, place.row) for place in places], PLACE)
        return Shared(cls.kernel(), cls.parts(methods, places, count), threads, rows)


class Shared(Batch):
    """A batch whose parts threads share. The result is the same to the bit. places: all PLACEs, of
    which those without a finite pose get NaN."""

    def __init__(
        self, kernel: Kernel, parts: Sequence[Part], threads: int, places: Table | None = None
    ) -> None:
        self._kernel, self._parts, self._places = kernel, parts, places
        self._helpers = min(threads, len(parts)) - 1
        self._pool: ThreadPoolExecutor | None = None
        self._process = -1
        self._making = Lock()

    def write_wrenches(
        self, positions: Array, rotations: Array, time: float, wrenches_out: Array
    ) -> None:
        if self._helpers == 0:
            for block, places in self._parts:
                self._kernel(block, places, positions, rotations, time, wrenches_out)
            self._forget(positions, rotations, time, wrenches_out)
            return
        left = iter(self._parts)  # gives each part to one thread only

        def work() -> None:
            for block, places in left:
                self._kernel(block, places, positions, rotations, time, wrenches_out)

        helping = [self._executor().submit(work) for _ in range(self._helpers)]
        work()
        for helper in helping:
            if not helper.cancel():  # one that comes too late is not waited for
                helper.result()
        self._forget(positions, rotations, time, wrenches_out)

    def _forget(self, positions: Array, rotations: Array, time: float, wrenches_out: Array) -> None:
        if self._places is not None:
            forget_unknown(self._places, positions, rotations, time, wrenches_out)

    def native(self) -> list[NativePart] | None:
        """Compiles the kernel. Threads are the interpreter's."""
        if self._helpers:
            return None
        positions, rotations, wrenches = np.empty((1, 3)), np.empty((1, 9)), np.empty((1, 6))
        return [
            NativePart(address_of(self._kernel, *part, positions, rotations, 0.0, wrenches), *part)
            for part in self._parts
        ]

    def _executor(self) -> ThreadPoolExecutor:
        """The helpers: in a forked process none of its parent's are alive."""
        with self._making:
            if self._process != getpid():
                self._process = getpid()
                self._pool = ThreadPoolExecutor(self._helpers, thread_name_prefix="waterline")
            return self._pool
