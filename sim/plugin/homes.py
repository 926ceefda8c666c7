"""Homes: the plugin's record for each MjData, and its lookup.

MuJoCo keeps one word for the plugin in each MjData, `plugin_data`. A pickle of an MjData carries
that word into another MjData or another process. So the word is not an address but a number of a
home, whose address is in slabs that are never freed. A home contains the address of its MjData, so
a number from a pickle is detected and corrected.
"""

import ctypes

import numpy as np

from sim.plugin import native
from sim.plugin.context import Context
from sim.plugin.memory import WORD, mujoco_library, word_at


class Homes:
    """The homes of this process. The caller holds the lock of the contexts."""

    def __init__(self) -> None:
        self.directory = np.zeros(native.MOST_SLABS, dtype=np.int64)
        self._slabs: list[np.ndarray] = []
        self._free: list[int] = []
        self._numbers: dict[int, int] = {}  # by the address of the MjData
        self._datas: dict[int, int] = {}  # by the address of the plugin's states

    def add(self, data: int, states: int, context: Context, content: int, memories: int) -> int:
        """Make a home for the MjData at an address. Returns its number.

        states: the address of the plugin's states in that MjData. content: the number of the
        model's content. memories: the number of bodies that can move.
        """
        lost = self.home(data)  # of an earlier MjData here, whose word a pickle overwrote
        if lost:
            native.end_at.call(lost, self._word_address(self._numbers[data]))
        if not self._free:
            self._make_room()
        number = self._free.pop()
        size = native.HOME_SIZE + 8 * native.HOME_ROW_SIZE * memories
        allocate = mujoco_library().mju_malloc
        allocate.restype = ctypes.c_void_p
        home = allocate(ctypes.c_size_t(size))
        ctypes.memset(home, 0, size)
        for field, value in (
            (native.MEMORIES, memories), (native.DATA, data), (native.OWN_STATES, states)
        ):  # fmt: skip
            WORD.from_address(home + 8 * field).value = value
        context.join(home, content)
        WORD.from_address(self._word_address(number)).value = home
        self._numbers[data], self._datas[states] = number, data
        return number

    def home(self, data: int) -> int:
        """The address of the home of the MjData at an address; 0 without a home."""
        number = self._numbers.get(data)
        home = word_at(self._word_address(number)) if number else 0
        return home if home and word_at(home + 8 * native.DATA) == data else 0

    def number(self, data: int) -> int:
        """The number of the home of the MjData at an address; 0 without a home."""
        return self._numbers[data] if self.home(data) else 0

    def data_of(self, states: int) -> int:
        """The MjData whose plugin has its states at an address; 0 if there is none."""
        return self._datas.get(states, 0)

    def _word_address(self, number: int) -> int:
        slab, index = divmod(number - 1, native.SLAB)
        return self._slabs[slab].ctypes.data + 8 * index

    def _make_room(self) -> None:
        """Collect the numbers of ended homes, and add a slab if they are few."""
        for i, slab in enumerate(self._slabs):
            self._free += (i * native.SLAB + 1 + np.flatnonzero(slab == 0)).tolist()
        if len(self._free) < native.SLAB // 2:
            if len(self._slabs) == native.MOST_SLABS:
                raise RuntimeError(f"there are more than {native.MOST_SLABS * native.SLAB} MjData")
            first = len(self._slabs) * native.SLAB + 1
            self._slabs.append(np.zeros(native.SLAB, dtype=np.int64))
            self.directory[len(self._slabs) - 1] = self._slabs[-1].ctypes.data
            self._free += range(first, first + native.SLAB)
        self._numbers = {data: n for data, n in self._numbers.items() if self.home(data)}
        self._datas = {s: data for s, data in self._datas.items() if data in self._numbers}
