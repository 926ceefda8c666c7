"""Kernels: how the package's loops are compiled, and the blocks of tables that they read.

Conventions of all kernels:

- The compiler may contract (fuse a multiplication and an addition), and nothing else. Full fastmath
  would break the range reduction of phases and make isnan(nan) false. Only a `summing_kernel` may
  also reorder sums, because long sums vectorise in no other way.
- No kernel uses Python objects, so all kernels release the interpreter's lock.
- Tables are record arrays with named fields. A row of a table is a pointer and costs nothing. A
  view of an array is reference-counted, so loops with branches index arrays instead.
- Output arguments come last and end in `_out`. A kernel named `add_...` or `subtract_...` adds to
  the values that it finds there.
- A kernel counts references to arrays only if it makes one, or a function that it calls does; names
  in MAKERS show that. No kernel returns an array that it was given.
- A workspace is a table with one row, whose fields are arrays. `workspace` and `scratch` make
  memory on the stack, which lasts until the kernel returns and costs nothing. `np.empty` asks the
  system for memory, and is for sizes that are known only in a call. A row does not keep a table of
  `np.empty` alive, so only a kernel that receives such a table takes its row.
- A kernel is compiled once for each combination of argument types, so callers pass the same types
  everywhere: `row.field[:]` for an array, because a field has its own type, and a NumPy integer for
  a constant, because each Python integer constant has its own type.
- Compiling a kernel compiles all kernels below it again, so there are few levels. Array
  expressions, sorts and assignments of arrays take a second or more to compile; loops do not.
- Compiled code is kept in the user's cache folder, under a stamp of the sources of all kernels.
  numba's own check covers only the file of a kernel, not the files of the kernels that it calls.
"""

import ctypes
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, cached_property
from hashlib import sha256
from math import prod
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numba
import numpy as np
from numba import njit, typeof, types
from numba.core import cgutils, event
from numba.core import config as numba_config
from numba.core.caching import FunctionCache, NullCache
from numba.core.ccallback import CFunc
from numba.extending import intrinsic as typed_intrinsic
from numba.misc.appdirs import user_cache_dir
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

from sim.addresses import BYTE, WORD, array_of

config: Any = numba_config
intrinsic: Any = typed_intrinsic

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

CACHE_LINE = 64
"""Alignment [bytes] of the tables in a block."""

MOST_TABLES = 11
"""Largest number of tables in a block."""

DIRECTORY = 16 * MOST_TABLES
"""Size [bytes] of the directory at the start of a block: begin and end of each table."""


def _stamp_of_sources() -> str:
    """A hash of the sources of all kernels, of their folder and of numba's version. numba keeps the
    code of each folder apart. The room `worlds` has no kernels of numba's."""
    folder = Path(__file__).parent
    digest = sha256(f"{numba.__version__} {folder}".encode())
    for path in sorted(set(folder.rglob("*.py")) - set((folder / "worlds").glob("*.py"))):
        content = path.read_bytes()
        if b"kernel" in content:
            digest.update(content)
    return digest.hexdigest()[:16]


CACHE = Path(config.CACHE_DIR or user_cache_dir()).absolute() / "waterline" / _stamp_of_sources()
"""Folder of the compiled code. Other sources have another folder, so stale code is never loaded."""


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
    """The cache of a function in CACHE. If CACHE cannot be written, nothing is kept, because numba
    would choose another folder without a stamp."""
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


MAKERS = frozenset({"empty", "zeros", "copy"})
"""Names in a text that makes an array in the system's memory."""


def _makes_arrays(function: Callable[..., Any]) -> bool:
    """Whether a function makes an array in the system's memory, or one that it calls does. In all
    others numba need not count references, which takes two calls for each array argument."""
    known = function.__globals__
    return any(
        name in MAKERS or getattr(known.get(name), "makes_arrays", False)
        for name in function.__code__.co_names
    )


def _compiled(function: Kernel, *liberties: str) -> Kernel:
    makes_arrays = _makes_arrays(function)
    options: dict[str, Any] = {
        "error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True, "_nrt": makes_arrays
    }  # fmt: skip
    dispatcher: Any = njit(fastmath=set(liberties), **options)(function)
    dispatcher._cache = _kept_code(function)
    dispatcher.makes_arrays = makes_arrays
    dispatcher.again = lambda other: _compiled(other, *liberties)
    return dispatcher


class CFunction:
    """A kernel with integer arguments that C code may call. It is compiled at its first use.

    call: the ctypes function, which releases the interpreter's lock. address: its address.
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
        options = {
            "fastmath": {"contract"}, "error_model": "numpy",
            "_nrt": _makes_arrays(self._function),
        }  # fmt: skip
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
    """Make a CFunction without a result."""
    return CFunction(function, returns_number=False)


def c_query(function: Callable[..., int]) -> CFunction:
    """Make a CFunction that returns an integer."""
    return CFunction(function, returns_number=True)


def address_of(compiled: Any, *arguments: Any) -> int:
    """The address of a kernel's code for arguments of these types, for `addresses.call_kernel`."""
    signature = tuple(map(typeof, arguments))
    compiled.compile(signature)
    found = compiled.overloads[signature]
    return found.library.get_pointer_to_function(found.fndesc.llvm_func_name)


def kernel(function: Kernel) -> Kernel:
    """Compile a function whose floating-point operations stay in order."""
    return _compiled(function, "contract")


def summing_kernel(function: Kernel) -> Kernel:
    """Compile a function whose sums may be reordered."""
    return _compiled(function, "contract", "reassoc")


def inline(function: Callable[..., Any]) -> Any:
    """Compile a function into each kernel that calls it."""
    dispatcher: Any = njit(inline="always")(function)
    dispatcher.makes_arrays = _makes_arrays(function)
    dispatcher.again = inline
    return dispatcher


@contextmanager
def when_compiling(tell: Callable[[], None]) -> Iterator[None]:
    """A block in which `tell` is called whenever a kernel begins to compile. Loading a kept kernel
    does not count."""
    with event.install_listener("numba:compile", _Listener(tell)):
        yield


def kept_kernels() -> int:
    """The number of compiled kernels in CACHE."""
    return sum(1 for _ in CACHE.rglob("*.nbc"))


class _Listener(event.Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell

    def on_start(self, begun: event.Event) -> None:
        self._tell()

    def on_end(self, ended: event.Event) -> None:
        pass


def record(**fields: Any) -> np.dtype[np.void]:
    """The type of a table's rows. Each field is a scalar type, or a scalar type and a shape. The
    types "real" and "word" are "f8" and "i8" here, and "f4" and "i4" in `precision.single`."""
    return record_of(fields, {"real": "f8", "word": "i8"})


def record_of(fields: dict[str, Any], scalars: dict[str, str]) -> np.dtype[np.void]:
    """The type of a table's rows, as in `record`, with other scalar types by name. The type keeps
    the fields as they were given."""
    rows = []
    for name, given in fields.items():
        kind, *shape = given if isinstance(given, tuple) else (given,)
        rows.append((name, scalars.get(kind, kind) if isinstance(kind, str) else kind, *shape))
    return np.dtype(rows, align=True, metadata={"fields": fields})  # type: ignore[call-overload]


def packed(*tables: NDArray[Any]) -> NDArray[np.uint8]:
    """Pack tables into one read-only block of bytes, which `table` reads. One block is cheaper than
    many arguments: each argument of a kernel costs a tenth of a microsecond."""
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
    """Make an array read-only, and return it. Kernels are compiled anew for writable arrays."""
    array.setflags(write=False)
    return array


@intrinsic
def table(typingctx, block, i, dtype):
    """Table number i of a block, as an array of records of a type."""
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


@intrinsic
def workspace(typingctx, dtype):
    """A table of one row of a type, not set, on the stack."""
    kind = types.Array(dtype.dtype, 1, "C")

    def codegen(context, builder, signature, args):
        return _on_stack(context, builder, kind, (1,))

    return kind(dtype), codegen


@intrinsic(prefer_literal=True)
def workspaces(typingctx, count, dtype):
    """A table of a number of rows of a type, not set, on the stack. The compiler knows the
    number."""
    kind = types.Array(dtype.dtype, 1, "C")

    def codegen(context, builder, signature, args):
        return _on_stack(context, builder, kind, (count.literal_value,))

    return kind(count, dtype), codegen


def stack_array(is_zero: bool = False, is_single: bool = False) -> Any:
    """Make an intrinsic (shape) -> array of numbers on the stack. The shape, an integer or a tuple,
    is known to the compiler."""
    real = types.float32 if is_single else types.float64

    @typed_intrinsic(prefer_literal=True)
    def scratch_array(typingctx, shape):
        sizes: Any = shape if isinstance(shape, types.BaseTuple) else (shape,)
        lengths = [size.literal_value for size in sizes]
        kind = types.Array(real, len(lengths), "C")

        def codegen(context, builder, signature, args):
            return _on_stack(context, builder, kind, lengths, is_zero)

        return kind(shape), codegen

    return scratch_array


scratch = stack_array()
"""An array of doubles, not set, on the stack."""

scratch_zeros = stack_array(is_zero=True)
"""An array of zeros on the stack."""


def _on_stack(
    context: Any, builder: Any, kind: types.Array, lengths: Sequence[int], is_zero: bool = False
) -> Any:
    """LLVM's value of an array on the stack."""
    size = prod(lengths) * context.get_abi_sizeof(context.get_data_type(kind.dtype))
    with builder.goto_entry_block():  # numba's own function would set each byte to 0
        start = builder.alloca(BYTE, WORD(size))
    start.align = CACHE_LINE
    if is_zero:
        cgutils.memset(builder, start, WORD(size), 0)
    return array_of(context, builder, kind, start, [WORD(length) for length in lengths])


@intrinsic
def lowest_bit(typingctx, bits):
    """The number of the lowest bit that is set in an integer, which is not 0."""

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], cgutils.true_bit)

    return types.int64(types.int64), codegen
