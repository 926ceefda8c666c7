"""Homes: what the plugin keeps of each MjData, and how a call finds it.

MuJoCo has one word for it, `plugin_data`, and its pickles carry that word along to another MjData
or another process. So the word is no address but a number, by which a home is found in slabs that
are never given back, and a home says whose it is. What a pickle has brought is noticed without
looking where nothing is, and put right.
"""

import ctypes

import numpy as np

from sim.plugin import native
from sim.plugin.context import WORD, Context, mujoco_library


class Homes:
    """The homes of the process. Whoever calls holds the lock of the contexts."""

    def __init__(self) -> None:
        self.directory = np.zeros(native.MOST_SLABS, dtype=np.int64)
        self._slabs: list[np.ndarray] = []
        self._free: list[int] = []
        self._numbers: dict[int, int] = {}  # by MjData
        self._datas: dict[int, int] = {}  # by the plugin's states

    def add(self, data: int, states: int, context: Context, content: int, memories: int) -> int:
        """Make a home for the MjData at an address, whose plugin has its states at another; returns
        its number. content: that of the model; memories: the number of bodies that can move."""
        self._end_lost(data)
        if not self._free:
            self._make_room()
        number = self._free.pop()
        size = native.HOME_SIZE + 8 * native.KEPT * memories
        allocate = mujoco_library().mju_malloc
        allocate.restype = ctypes.c_void_p
        home = allocate(ctypes.c_size_t(size))
        ctypes.memset(home, 0, size)
        for field, value in (
            (native.MEMORIES, memories), (native.DATA, data), (native.OWN_STATES, states)
        ):  # fmt: skip
            WORD.from_address(home + 8 * field).value = value
        context.join(home, content)
        slab, place = divmod(number - 1, native.SLAB)
        self._slabs[slab][place] = home
        self._numbers[data], self._datas[states] = number, data
        return number

    def home(self, data: int, number: int) -> int:
        """The address of the home of a number, if it is that of the MjData at an address; else
        0."""
        slab, place = divmod(number - 1, native.SLAB)
        home = int(self._slabs[slab][place]) if 0 <= slab < len(self._slabs) else 0
        return home if home and WORD.from_address(home + 8 * native.DATA).value == data else 0

    def recover(self, data: int) -> int:
        """The number of the home of the MjData at an address, 0 if it has none."""
        number = self._numbers.get(data, 0)
        return number if self.home(data, number) else 0

    def data_of(self, states: int) -> int:
        """The MjData whose plugin has its states at an address, 0 if there is none."""
        return self._datas.get(states, 0)

    def _end_lost(self, data: int) -> None:
        """An MjData that was pickled into and never used has ended without its home."""
        home = self.home(data, self._numbers.get(data, 0))
        if home:
            native.end_at.call(home, self._place(self._numbers[data]))

    def _place(self, number: int) -> int:
        slab, place = divmod(number - 1, native.SLAB)
        return self._slabs[slab].ctypes.data + 8 * place

    def _make_room(self) -> None:
        """Find the numbers of homes that have ended, and make a new slab if these are few."""
        for i, slab in enumerate(self._slabs):
            self._free += (i * native.SLAB + 1 + np.flatnonzero(slab == 0)).tolist()
        if len(self._free) < native.SLAB // 2:
            if len(self._slabs) == native.MOST_SLABS:
                raise RuntimeError(f"there are more than {native.MOST_SLABS * native.SLAB} MjData")
            first = len(self._slabs) * native.SLAB + 1
            self._slabs.append(np.zeros(native.SLAB, dtype=np.int64))
            self.directory[len(self._slabs) - 1] = self._slabs[-1].ctypes.data
            self._free += range(first, first + native.SLAB)
        alive = {d: n for d, n in self._numbers.items() if self.home(d, n)}
        self._numbers = alive
        self._datas = {s: d for s, d in self._datas.items() if d in alive}
