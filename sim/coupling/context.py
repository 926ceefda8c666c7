"""Context: all that the native callback needs of a model and its hulls, in tables at addresses."""

import ctypes
import time
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling import native
from sim.coupling.custom_fields import elements_of, prefixes
from sim.coupling.floats import FloatingGeom, moving_dofs
from sim.coupling.layout import offsets
from sim.kernels import packed
from sim.methods.method import NativePart
from sim.resistance.drag import SURFACE
from sim.resistance.reaction import HULL, hull_row
from sim.water.sea import Sea

Array = NDArray[np.float64]
Table = NDArray[np.void]

CLOCK_MONOTONIC = getattr(time, "CLOCK_MONOTONIC", 0)

PROBED_VERTICES = 4
"""Of each mesh, spread over it: enough for another or a scaled mesh to be noticed."""

_marks = np.zeros(native.MARKS)
"""By which rows that we wrote are known again, of the whole process."""


@cache
def mujoco_library() -> ctypes.CDLL:
    """MuJoCo's library, whose functions kernels call by their addresses."""
    return ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco.*"))))


def function_address(library: ctypes.CDLL, name: str) -> int:
    """Where a library's function is; 0 where there is none."""
    found = getattr(library, name, None)
    return ctypes.cast(found, ctypes.c_void_p).value if found else 0


class Context:
    """One model, its sea and its hulls, as kernels take them; the record is at `address`.

    Nothing in it changes but the counters. parts: the hulls by the kernels of their methods, or
    None where a method has none and `wrenches` are computed elsewhere.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        sea: Sea,
        floats: Sequence[FloatingGeom],
        probes: tuple[Table, NDArray[np.uint8]],
        parts: Sequence[NativePart] | None,
    ) -> None:
        self.hulls, self._bodies = len(floats), len({f.body for f in floats})
        self.is_native = parts is not None
        self._parts = parts or ()
        self._states = np.zeros(native.STATES, dtype=np.int64)
        self._counters = np.zeros((native.SHARDS, native.COUNTERS), dtype=np.int64)
        drags = [f.drag for f in floats]
        surfaces = [drag.surface for drag in drags if drag] or [np.zeros(1, SURFACE)]
        self._block = packed(
            *_float_tables(model, floats), _hull_table(floats), np.concatenate(surfaces),
            sea.components, sea.water, *probes, _part_table(self._parts),
        )  # fmt: skip
        self._record = self._filled(model, sea, any(drags))
        self.address = int(self._record.ctypes.data)

    def _filled(self, model: mujoco.MjModel, sea: Sea, has_resistance: bool) -> Table:
        library, clock = mujoco_library(), function_address(ctypes.CDLL(None), "clock_gettime")
        record = np.zeros(1, native.CONTEXT)
        values = dict(
            model=model._address, signature=np.uint64(model.signature).astype(np.int64),
            bodies=model.nbody, geoms=model.ngeom, freedoms=model.nv, matrix=model.nC,
            hulls=self.hulls, own=record.ctypes.data, block=self._block.ctypes.data,
            block_size=self._block.size, act=native.act_at.address if self.is_native else 0,
            resist=native.resist_at.address if has_resistance else 0,
            make_inertia=function_address(library, "mj_makeM"),
            factor_inertia=function_address(library, "mj_factorM"),
            clock=clock, clock_number=CLOCK_MONOTONIC,
            counters=self._counters.ctypes.data, states=self._states.ctypes.data,
            marks=_marks.ctypes.data, gravity=sea.gravity,
        )  # fmt: skip
        for name, value in values.items():
            record[name] = value
        for name, offset in offsets().items():
            record["layout"][name] = offset
        return record

    def counted(self, number: int) -> int:
        """One of the counters of `native`, of all threads."""
        return int(self._counters[:, number].sum())

    def add(self, number: int, amount: int) -> None:
        """Count as a kernel does."""
        self._counters[0, number] += amount

    def clear(self, *numbers: int) -> None:
        """Begin to count anew."""
        self._counters[:, numbers or slice(None)] = 0

    def refusal(self) -> int:
        """Why a model was refused since this was asked, as `native.find_at` says it; 0 if none
        was."""
        why = -int(self._counters[:, native.REFUSED].max())
        self._counters[:, native.REFUSED] = 0
        return why

    def push(self, model: mujoco.MjModel, data: mujoco.MjData, wrenches_out: Array) -> None:
        """Buoyancy (H, 6) of all hulls about their geoms' places, by the sea's own gravity."""
        native.push_at.call(self.address, model._address, data._address, wrenches_out.ctypes.data)

    def act(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """What the callback does."""
        native.act_at.call(self.address, model._address, data._address)

    def write(self, model: mujoco.MjModel, data: mujoco.MjData, wrenches: Array) -> None:
        """The same with wrenches that were computed elsewhere."""
        native.write_at.call(self.address, model._address, data._address, wrenches.ctypes.data)

    def drags(self, model: mujoco.MjModel, data: mujoco.MjData, wrenches: Array) -> Array:
        """Drag (B, 6) of all bodies, about their centres of mass, from the hulls' wrenches."""
        found = np.zeros((self._bodies, 6))
        if self._record["resist"][0]:
            native.drags(self.address, model._address, data._address, wrenches, found)
        return found


def _float_tables(
    model: mujoco.MjModel, floats: Sequence[FloatingGeom]
) -> tuple[Table, Table, Table]:
    """FLOAT and BODY rows, body by body, and the DOFs of those with drag or added mass."""
    resisted = np.cumsum([f.drag is not None for f in floats]) - 1
    rows, bodies, dofs = [], [], []
    for body in sorted({f.body for f in floats}):
        own = [i for i, f in enumerate(floats) if f.body == body]
        is_resisted = any(floats[i].drag for i in own)
        chain = moving_dofs(model, body) if is_resisted else []
        ends = len(rows), len(rows) + len(own), len(dofs), len(dofs) + len(chain)
        bodies.append((body, model.body_rootid[body], *ends))
        dofs += chain
        rows += [(floats[i].geom, i, resisted[i] if floats[i].drag else -1) for i in own]
    return np.array(rows, native.FLOAT), np.array(bodies, native.BODY), np.array(dofs, native.DOF)


def _hull_table(floats: Sequence[FloatingGeom]) -> Table:
    """HULL rows of those with drag or added mass."""
    volumes: dict[int, float] = {}
    for f in floats:
        if f.drag:
            volumes[f.body] = volumes.get(f.body, 0.0) + f.drag.hull.volume
    drags = [(f.drag, volumes[f.body]) for f in floats if f.drag]
    return np.array([hull_row(i, *drag) for i, drag in enumerate(drags)], HULL)


def _part_table(parts: Sequence[NativePart]) -> Table:
    rows = [
        (p.kernel, p.block.ctypes.data, p.block.size, p.places.ctypes.data, len(p.places),
         p.places.itemsize)
        for p in parts
    ]  # fmt: skip
    return np.array(rows, native.PART)


def probes_of(
    model: mujoco.MjModel, floats: Sequence[FloatingGeom]
) -> tuple[Table, NDArray[np.uint8]]:
    """PROBE rows of a model as it is, and the bytes that they find."""
    places, rows, expected = offsets(), [], []
    for name, start, count in _joined(_probed(model, floats)):
        if name == "structure":
            pointer, content = -1, ctypes.string_at(model._address, count)
        else:
            field = getattr(model, name)
            raw = field if isinstance(field, bytes) else np.ascontiguousarray(field).tobytes()
            pointer, content = places[name], raw[start : start + count]
        rows.append((pointer, start, count, native.FIELDS.index(name)))
        expected.append(np.frombuffer(content, np.uint8))
    return np.array(rows, native.PROBE), np.concatenate(expected)


def _joined(pieces: Iterable[tuple[str, int, int]]) -> list[tuple[str, int, int]]:
    """Pieces of fields, those that adjoin as one."""
    joined: list[tuple[str, int, int]] = []
    for name, start, count in sorted(set(pieces), key=lambda p: (native.FIELDS.index(p[0]), p[1])):
        if joined and joined[-1][0] == name and sum(joined[-1][1:]) == start:
            joined[-1] = name, joined[-1][1], joined[-1][2] + count
        else:
            joined.append((name, start, count))
    return joined


def _probed(
    model: mujoco.MjModel, floats: Sequence[FloatingGeom]
) -> Iterator[tuple[str, int, int]]:
    """Field, first byte and number of bytes of what a context depends on."""
    yield "structure", 0, offsets()["narena"]
    for f in floats:
        for geom in f.geoms:
            yield "geom_size", 24 * geom, 24
            yield "geom_dataid", 4 * geom, 4
        for geom in f.united:
            yield "geom_pos", 24 * geom, 24
            yield "geom_quat", 32 * geom, 32
    meshes = {int(model.geom_dataid[geom]) for f in floats for geom in f.geoms} - {-1}
    for mesh in sorted(meshes):
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        for vertex in np.unique(np.linspace(0, count - 1, PROBED_VERTICES).astype(int)):
            yield "mesh_vert", 12 * (first + int(vertex)), 12
    kinds = mujoco.mjtObj
    for prefix in prefixes(model):
        for i, _ in elements_of(model, kinds.mjOBJ_NUMERIC, prefix):
            yield "numeric_data", 8 * int(model.numeric_adr[i]), 8 * int(model.numeric_size[i])
        for i, _ in elements_of(model, kinds.mjOBJ_TEXT, prefix):
            yield "text_data", int(model.text_adr[i]), int(model.text_size[i])
        for i, _ in elements_of(model, kinds.mjOBJ_TUPLE, prefix):
            yield "tuple_objid", 4 * int(model.tuple_adr[i]), 4 * int(model.tuple_size[i])
