"""Kernels: how the package's loops are compiled, and the blocks of tables that they read.

What holds for every kernel of the package:

- Contraction (fused multiply-add) is the only liberty the compiler gets. Full fastmath would break
  the range reduction of phases and make isnan(nan) false. Only a `summing_kernel` may also add in
  any order, because only so do long sums vectorise.
- No kernel touches Python objects, so all of them release the interpreter's lock.
- Tables are record arrays with named fields. A row of a table is a pointer: it costs nothing. A
  view of an array is counted as a reference, so loops that branch index arrays instead.
- Outputs come last and end in `_out`; a kernel whose name begins with `add_` or `subtract_` adds
  to what is there.
- Workspaces are tables with one row, whose fields are arrays. A row does not keep its table alive,
  so it is taken only by kernels that are given the workspace, not by the one that makes it.
- A kernel is compiled once for each type of its arguments, so it gets the same types everywhere:
  `row.field[:]` for an array, because a field has a type of its own, and a NumPy integer for a
  constant, because each Python integer has one.
- Each kernel compiles everything below it again, so there are few levels. Array expressions, sorts
  and assignments of arrays take a second or more to compile; loops do not.
- Compiled code is kept in the user's cache folder, under a stamp of the sources of all kernels:
  numba by itself looks at the file of a kernel, and not at those of the kernels that it calls.
"""

import ctypes
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numba
import numpy as np
from numba import njit, typeof, types
from numba.core import config as numba_config
from numba.core import event
from numba.core.caching import FunctionCache, NullCache
from numba.core.ccallback import CFunc
from numba.extending import intrinsic as typed_intrinsic
from numba.misc.appdirs import user_cache_dir
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

from sim.addresses import WORD, array_of

config: Any = numba_config
intrinsic: Any = typed_intrinsic

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

CACHE_LINE = 64
"""Bytes. Tables of a block begin at a line, and with them each node and leaf of a tree."""

MOST_TABLES = 10
"""Tables that a block has room for in its directory."""

DIRECTORY = 16 * MOST_TABLES
"""Bytes at the start of a block: where each table begins and where it ends."""


def _stamp_of_sources() -> str:
    """A name for the state of all kernels' sources, and of the compiler."""
    digest = sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        content = path.read_bytes()
        if b"kernel" in content:
            digest.update(content)
    return digest.hexdigest()[:16]


CACHE = Path(config.CACHE_DIR or user_cache_dir()).absolute() / "waterline" / _stamp_of_sources()
"""Compiled code is kept here. Other sources have another folder, so stale code cannot be loaded."""


class _KeptCode(FunctionCache):
    """The compiled code of a function on disk."""

    def load_overload(self, *arguments: Any) -> Any:
        try:
            return super().load_overload(*arguments)
        except Exception as error:  # a damaged pickle may raise anything
            raise RuntimeError(
                f"compiled kernels in {CACHE} are damaged ({error}); remove that folder"
            ) from error

    def save_overload(self, *arguments: Any) -> None:
        try:
            super().save_overload(*arguments)
        except OSError:
            _warn_of_no_cache()


def _kept_code(function: Callable[..., Any]) -> FunctionCache | NullCache:
    """The cache of a function in CACHE. Where that cannot be written numba would choose a folder
    without a stamp, so nothing is kept then."""
    users, config.CACHE_DIR = config.CACHE_DIR, str(CACHE)
    try:
        kept = _KeptCode(function)
        if CACHE in Path(kept.cache_path).parents:
            return kept
    except RuntimeError:  # numba found no folder at all
        pass
    finally:
        config.CACHE_DIR = users
    _warn_of_no_cache()
    return NullCache()


@cache
def _warn_of_no_cache() -> None:
    warnings.warn(
        f"compiled kernels cannot be kept in {CACHE}, so each start compiles them, which takes a "
        "minute; set NUMBA_CACHE_DIR to a folder that can be written",
        UserWarning,
        stacklevel=2,
    )


def _compiled(function: Kernel, *liberties: str) -> Kernel:
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    dispatcher: Any = njit(fastmath=set(liberties), **options)(function)
    dispatcher._cache = _kept_code(function)
    return dispatcher


class CFunction:
    """A kernel of whole numbers that C code may call, compiled when it is first asked for.

    call: it, as a ctypes function, which MuJoCo takes for a callback; address: where it is. Called
    from Python it releases the interpreter's lock.
    """

    def __init__(self, function: Callable[..., Any], returns_number: bool) -> None:
        self._function = function
        self._result = types.int64 if returns_number else types.void
        self._compiling = Lock()

    @property
    def call(self) -> Callable[..., Any]:
        with self._compiling:
            return self._call

    @cached_property
    def _call(self) -> Callable[..., Any]:
        count = self._function.__code__.co_argcount
        signature = self._result(*[types.int64] * count)
        options = {"fastmath": {"contract"}, "error_model": "numpy"}
        whole = signature.args, signature.return_type
        compiled: Any = CFunc(self._function, whole, {}, options)
        compiled._cache = _kept_code(self._function)
        compiled.compile()
        self._compiled = compiled  # its code goes with it
        return compiled.ctypes

    @property
    def address(self) -> int:
        pointer: Any = self.call
        return ctypes.cast(pointer, ctypes.c_void_p).value or 0


def c_function(function: Callable[..., None]) -> CFunction:
    """A kernel with whole numbers as arguments and no result, for C code to call."""
    return CFunction(function, returns_number=False)


def c_query(function: Callable[..., int]) -> CFunction:
    """The same with a whole number as its result."""
    return CFunction(function, returns_number=True)


def address_of(compiled: Any, *arguments: Any) -> int:
    """Where the code of a kernel is that takes such arguments, for `addresses.call_kernel`."""
    signature = tuple(map(typeof, arguments))
    compiled.compile(signature)
    found = compiled.overloads[signature]
    return found.library.get_pointer_to_function(found.fndesc.llvm_func_name)


def kernel(function: Kernel) -> Kernel:
    """Compile a function whose floating-point operations stay in order."""
    return _compiled(function, "contract")


def summing_kernel(function: Kernel) -> Kernel:
    """Compile a function that may add up in any order."""
    return _compiled(function, "contract", "reassoc")


inline: Any = njit(inline="always")
"""Compile a function into each kernel that calls it."""


@contextmanager
def when_compiling(tell: Callable[[], None]) -> Iterator[None]:
    """Call `tell` when the first kernel begins to be compiled in a block; one that is found among
    those that are kept is not."""
    with event.install_listener("numba:compile", _FirstOne(tell)):
        yield


class _FirstOne(event.Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell: Callable[[], None] | None = tell

    def on_start(self, begun: event.Event) -> None:
        tell, self._tell = self._tell, None
        if tell is not None:
            tell()

    def on_end(self, ended: event.Event) -> None:
        pass


def record(**fields: Any) -> np.dtype[np.void]:
    """Type of a table's rows: for each field a scalar type, or such a type and a shape."""
    kinds = (kind if isinstance(kind, tuple) else (kind,) for kind in fields.values())
    return np.dtype([(name, *kind) for name, kind in zip(fields, kinds, strict=True)], align=True)


def packed(*tables: NDArray[Any]) -> NDArray[np.uint8]:
    """A read-only block of bytes with all these tables, for `table` to find them in: each argument
    handed to a kernel costs a tenth of a microsecond."""
    starts, room = [], -(-DIRECTORY // CACHE_LINE) * CACHE_LINE
    for each in tables:
        starts.append(room)
        room += -(-each.nbytes // CACHE_LINE) * CACHE_LINE
    spare = np.zeros(room + CACHE_LINE, dtype=np.uint8)
    first = -spare.ctypes.data % CACHE_LINE
    block = spare[first : first + room]
    directory = block[:DIRECTORY].view(np.int64)
    for i, (start, each) in enumerate(zip(starts, tables, strict=True)):
        end = start + each.nbytes
        directory[2 * i], directory[2 * i + 1] = start, end
        block[start:end] = np.ascontiguousarray(each).reshape(-1).view(np.uint8)
    return read_only(block)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """The array, closed to changes: kernels would else be compiled for both kinds."""
    array.setflags(write=False)
    return array


@intrinsic
def table(typingctx, block, i, dtype):
    """Table number i of a block: an array of records of a type."""
    kind = types.Array(dtype.dtype, 1, "C", readonly=True)

    def codegen(context, builder, signature, args):
        start = make_array(block)(context, builder, args[0]).data
        directory = builder.bitcast(start, WORD.as_pointer())
        place = builder.mul(args[1], WORD(2))
        first = builder.load(builder.gep(directory, [place]))
        end = builder.load(builder.gep(directory, [builder.add(place, WORD(1))]))
        count = builder.sdiv(builder.sub(end, first), WORD(kind.dtype.size))
        return array_of(context, builder, kind, builder.gep(start, [first]), [count])

    return kind(block, types.int64, dtype), codegen
