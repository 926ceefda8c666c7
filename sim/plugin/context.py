"""Context: the water and hulls of a model, in tables that compiled code reads.

Models with the same content share a context, for example a model and its copies, with all states.
"""

import ctypes
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from threading import RLock

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.kernels import address_of, packed
from sim.methods import METHODS
from sim.methods.method import Compiled, Part, parts_of
from sim.mjcf.floats import FloatingGeom, bodies_above, drags_of
from sim.mjcf.reading import Floating, stamp_of
from sim.plugin import native
from sim.plugin.layout import (
    CUT_FIELDS,
    MATRIX_FIELDS,
    content_spans,
    offsets,
    option_spans,
    picture_offsets,
)
from sim.plugin.memory import (
    WORD,
    callback_address,
    floats_at,
    function_address,
    mujoco_library,
    word_at,
)
from sim.plugin.response import respond_at, response_block
from sim.resistance.reaction import hull_tables

Array = NDArray[np.float64]
Table = NDArray[np.void]

MOST_UNUSED_CONTEXTS = 16
"""Largest number of contexts that are kept while no state uses them. A model is compiled before its
first state is made, and other models may be compiled in between."""


class Context:
    """A sea and the hulls in it, in the form that kernels read; its record is at `address`.

    Nothing in a context changes except its number of users.

    sea: the water. floats: the H hulls. bodies (B,): ids of their bodies. float_bodies (H,): index
    into `bodies` per hull. notes: remarks on hulls and waves. model: the model it was made from.
    """

    def __init__(self, model: mujoco.MjModel, what: Floating) -> None:
        self.model = model  # a copy that belongs to this context
        self.sea, self.floats, self.notes = what.sea, what.floats, what.notes
        self._files = what.files
        sea, floats = self.sea, self.floats
        self.bodies, self.float_bodies = np.unique(
            [f.body for f in self.floats], return_inverse=True
        )
        self.responses = what.responses
        hulls, surfaces, probes = hull_tables(drags_of(floats))
        self.has_resistance = len(hulls) > 0
        self._parts = parts_of([f.method for f in floats], [f.geom for f in floats])
        self._push = self._push_with_python()
        responding = {response.body for response in self.responses}
        float_tables = _float_tables(model, floats, responding)
        self._block = packed(
            *float_tables, hulls.astype(native.SINGLE_HULL), surfaces.astype(native.SINGLE_SURFACE),
            sea.components, sea.water, _part_table(self._parts), _picture_table(what),
            probes.astype(native.SINGLE_PROBE), sea.components.astype(native.SINGLE_WAVE),
        )  # fmt: skip
        self._responses, self._memory_size = np.empty(0, np.uint8), 0
        if self.responses:
            self._responses, self._memory_size = response_block(
                sea, self.responses, floats, float_tables[1]
            )
        self._record = self._filled(model)
        self.address = int(self._record.ctypes.data)

    def _push_with_python(self) -> Callable[..., None] | None:
        """A function for `native.push_at` and the hulls whose methods have no kernel; None if there
        are no such hulls."""
        others = [i for i, f in enumerate(self.floats) if not isinstance(f.method, Compiled)]
        if not others:
            return None

        @ctypes.CFUNCTYPE(None, WORD, WORD, WORD, WORD)
        def push(context: int, model: int, data: int, wrenches: int) -> None:
            native.push_at.call(context, model, data, wrenches)
            found = floats_at(wrenches, (len(self.floats), 6))
            found[others] = np.nan  # remains if a method raises an error
            places, rotations = (
                floats_at(word_at(data + offsets()[name]), (self._geoms, size))
                for name, size in (("geom_xpos", 3), ("geom_xmat", 9))
            )
            now = ctypes.c_double.from_address(data + offsets()["time"]).value
            for i in others:
                geom, method = self.floats[i].geom, self.floats[i].method
                found[i] = method.wrench(places[geom], rotations[geom], now)

        return push

    def _filled(self, model: mujoco.MjModel) -> Table:
        library = mujoco_library()
        self._geoms = model.ngeom
        record = blank()
        push = callback_address(self._push) if self._push else 0
        values = dict(
            bodies=model.nbody, geoms=model.ngeom, freedoms=model.nv, matrix=model.nC,
            hulls=len(self.floats), own=record.ctypes.data, block=self._block.ctypes.data,
            block_size=self._block.size, push=push or native.push_at.address,
            act=native.act_at.address,
            resist=native.resist_at.address if self.has_resistance or self.responses else 0,
            make_inertia=function_address(library, "mj_makeM"),
            factor_inertia=function_address(library, "mj_factorM"),
            release=function_address(library, "mju_free"),
            respond=respond_at.address if self.responses else 0,
            responses=self._responses.ctypes.data, responses_size=self._responses.size,
            memory_start=native.MEMORY_SIZE * np.count_nonzero(model.body_weldid) + 1,
            memory_size=self._memory_size,
        )  # fmt: skip
        for name, value in values.items():
            record[name] = value
        return record

    @property
    def state_size(self) -> int:
        """The number of the plugin's states, up to the end of the memory."""
        return int(self._record["memory_start"][0] + self._record["memory_size"][0])

    @property
    def users(self) -> int:
        """The number of states that use the context."""
        return int(self._record["homes"][0])

    def is_current(self) -> bool:
        """Whether the files that the hulls were read from are unchanged."""
        return all(stamp == stamp_of(name) for name, stamp in self._files.items())

    def join(self, home: int, content: int) -> None:
        """Let the home at an address, for a model with a content number, use this context."""
        for field, value in (
            (native.CONTEXT_OF, self.address), (native.CONTENT, content), (native.REFUSED, 0)
        ):  # fmt: skip
            WORD.from_address(home + 8 * field).value = value
        native.count_at.call(self.address, 1)

    def adopt(self, home: int, content: int) -> None:
        """Let a home that uses another context use this one instead."""
        native.count_at.call(word_at(home), -1)
        self.join(home, content)

    def push(self, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
        """Buoyancy wrenches (H, 6) of all hulls about their geoms' positions."""
        wrenches = np.empty((len(self.floats), 6))
        function = self._push or native.push_at.call
        function(self.address, model._address, data._address, wrenches.ctypes.data)
        return wrenches

    def drags(self, model: mujoco.MjModel, data: mujoco.MjData, wrenches: Array) -> Array:
        """Drag wrenches (B, 6) of all bodies about their centres of mass, given `push`'s
        wrenches."""
        found = np.zeros((len(self.bodies), 6))
        if self.has_resistance:
            places = wrenches.ctypes.data, found.ctypes.data
            native.resist_at.call(self.address, model._address, data._address, *places, 0)
        return found


@cache
def _field_table() -> Table:
    """FIELD rows of all data that hulls and waves are made from."""
    matters = {name: native.WITH_MATRICES for name in MATRIX_FIELDS}
    matters |= {name: native.WITH_CUTS for name in CUT_FIELDS}
    rows = [(start, 0, size, native.ALWAYS) for start, size in option_spans()]
    rows += [(*span, matters.get(name, native.ALWAYS)) for name, span in content_spans().items()]
    return np.array(rows, native.FIELD)


def blank() -> Table:
    """A CONTEXT with MuJoCo's layout and the FIELD rows, but without a model."""
    record = np.zeros(1, native.CONTEXT)
    record["fields"], record["field_count"] = _field_table().ctypes.data, _field_table().size
    for name, offset in offsets().items():
        record["layout"][name] = offset
    return record


_blank = cache(blank)


def content_of(model: int) -> int:
    """The content number of the model at an address: a hash of all that hulls and waves depend
    on."""
    return native.content_at.call(int(_blank().ctypes.data), model)


class Contexts:
    """All contexts of the process."""

    def __init__(self) -> None:
        self.lock = RLock()
        self._found: dict[tuple[object, ...], Context] = {}
        self._replaced: list[Context] = []  # replaced, but states still use them

    def __iter__(self) -> Iterator[Context]:
        return iter((*self._found.values(), *self._replaced))

    def at(self, address: int) -> Context:
        """The context with a record at an address."""
        return next(context for context in self if context.address == address)

    def of(self, model: int, make: Callable[[], Context]) -> tuple[Context, int]:
        """The context of the model at an address, made if necessary, and its content number.

        The caller must hold the lock until a state uses the context.
        """
        content = content_of(model)
        key = content, *METHODS.items()
        context = self._found.get(key)
        if context is None or not context.is_current():
            made = make()
            if context is not None:
                del self._found[key]
            self._replaced = [c for c in (*self._replaced, context) if c and c.users]
            context = self._found[key] = made
            unused = [k for k, found in self._found.items() if not found.users]
            for old in unused[:-MOST_UNUSED_CONTEXTS]:
                del self._found[old]
        return context, content


def _float_tables(
    model: mujoco.MjModel, floats: Sequence[FloatingGeom], responding: set[int]
) -> tuple[Table, Table, Table]:
    """FLOAT and BODY rows, ordered by body, and LINK rows of bodies with drag or added mass.
    responding: ids of further bodies that need LINK rows."""
    resisted = np.cumsum([f.drag is not None for f in floats]) - 1
    memories = np.cumsum(model.body_weldid != 0) - 1
    moved = responding | {f.body for f in floats if f.drag}
    links, link_of = _link_rows(model, moved)
    rows, bodies = [], []
    for body in sorted({f.body for f in floats}):
        own = [i for i, f in enumerate(floats) if f.body == body]
        ends = len(rows), len(rows) + len(own)
        link = link_of.get(int(model.body_weldid[body]), -1)
        bodies.append((body, model.body_rootid[body], memories[body], *ends, link))
        rows += [(floats[i].geom, i, resisted[i] if floats[i].drag else -1) for i in own]
    return np.array(rows, native.FLOAT), np.array(bodies, native.BODY), links


def _link_rows(model: mujoco.MjModel, bodies: set[int]) -> tuple[Table, dict[int, int]]:
    """LINK rows of the bodies with joints that move some bodies, and their numbers by id."""
    numbers, rows = {}, []
    for body in sorted(bodies_above(model, np.array(sorted(bodies), int))):
        if model.body_dofnum[body] > 0:
            first, parent = model.body_dofadr[body], model.body_parentid[body]
            numbers[body] = len(rows)
            above = numbers.get(int(model.body_weldid[parent]), -1)
            rows.append((above, first, first + model.body_dofnum[body]))
    return np.array(rows, native.LINK), numbers


def _picture_table(what: Floating) -> Table:
    row = np.zeros(1, native.PICTURE)
    if what.is_drawn:
        row["length"] = max(f.method.hull.length for f in what.floats)
    row["init_geom"] = function_address(mujoco_library(), "mjv_initGeom")
    row["triangle"] = int(mujoco.mjtGeom.mjGEOM_TRIANGLE)
    row["decoration"] = int(mujoco.mjtCatBit.mjCAT_DECOR)
    for name, offset in picture_offsets().items():
        row[name] = offset
    return row


def _part_table(parts: Sequence[Part]) -> Table:
    """PART rows. Compiles the kernels."""
    poses = np.empty((1, 3)), np.empty((1, 9)), 0.0, np.empty((1, 6))
    rows = [
        (address_of(*part, *poses), part.block.ctypes.data, part.block.size,
         part.places.ctypes.data, len(part.places), part.places.itemsize)
        for part in parts
    ]  # fmt: skip
    return np.array(rows, native.PART)
