"""Addresses: arrays, functions and counters at memory addresses, for kernels that C code calls.

An address is an integer. Nothing here is checked: the caller guarantees that the address holds the
expected data and stays valid until the kernel has ended. Arrays made here do not own their memory.
"""

from collections.abc import Callable
from typing import Any

import llvmlite.binding
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic as typed_intrinsic
from numba.np.arrayobj import make_array, populate_array

from sim.platforms import Clock, clock

BYTE, WORD = ir.IntType(8), ir.IntType(64)

intrinsic: Any = typed_intrinsic
"""numba's decorator, whose types take the typing context for an argument of the caller."""


def _pointer(builder: ir.IRBuilder, address: ir.Value, kind: ir.Type) -> Any:
    return builder.inttoptr(address, kind.as_pointer())


def array_of(
    context: Any, builder: ir.IRBuilder, kind: types.Array, start: ir.Value, sizes: list[ir.Value]
) -> ir.Value:
    """LLVM's value of an array of a type in C order, whose elements begin at a pointer."""
    array = make_array(kind)(context, builder)
    data_type = context.get_data_type(kind.dtype)
    itemsize = context.get_constant(types.intp, context.get_abi_sizeof(data_type))
    strides, step = [], itemsize
    for size in sizes[::-1]:
        strides.insert(0, step)
        step = builder.mul(step, size)
    data = builder.bitcast(start, data_type.as_pointer())
    populate_array(array, data, sizes, strides, itemsize, meminfo=None)
    return impl_ret_borrowed(context, builder, kind, array._getvalue())


def _array_at(element: types.Type, readonly: bool) -> Callable[..., Any]:
    """Make an intrinsic (address, shape) -> array of elements of a type, in C order."""

    @intrinsic
    def array_at(typingctx, address, shape):
        kind = types.Array(element, len(shape), "C", readonly=readonly)

        def codegen(context, builder, signature, args):
            sizes = cgutils.unpack_tuple(builder, args[1])
            return array_of(context, builder, kind, _pointer(builder, args[0], BYTE), sizes)

        return kind(types.int64, types.UniTuple(types.int64, len(shape))), codegen

    return array_at


floats_at = _array_at(types.float64, readonly=False)
"""The array of doubles with a shape at an address."""

words_at = _array_at(types.int64, readonly=False)
"""The array of 64-bit integers at an address."""

integers_at = _array_at(types.int32, readonly=True)
"""The read-only array of C ints at an address."""

bytes_at = _array_at(types.uint8, readonly=True)
"""The read-only array of bytes at an address, such as a block (`kernels.packed`)."""


@intrinsic
def rows_at(typingctx, address, count, dtype):
    """So many records of a type at an address, read-only."""
    kind = types.Array(dtype.dtype, 1, "C", readonly=True)

    def codegen(context, builder, signature, args):
        return array_of(context, builder, kind, _pointer(builder, args[0], BYTE), [args[1]])

    return kind(types.int64, types.int64, dtype), codegen


@intrinsic
def word_at(typingctx, address):
    """The 64-bit integer at an address, for example another address or a size."""

    def codegen(context, builder, signature, args):
        return builder.load(_pointer(builder, args[0], WORD))

    return types.int64(types.int64), codegen


@intrinsic
def integer_at(typingctx, address):
    """The C int at an address."""

    def codegen(context, builder, signature, args):
        found = builder.load(_pointer(builder, args[0], ir.IntType(32)))
        return builder.sext(found, WORD)

    return types.int64(types.int64), codegen


def _store(kind: ir.Type, number: types.Type) -> Callable[..., Any]:
    """Make an intrinsic (address, number) that stores a number as a C type at an address."""

    @intrinsic
    def store_at(typingctx, address, value):
        def codegen(context, builder, signature, args):
            narrow = builder.fptrunc if number is types.float64 else builder.trunc
            value = args[1] if kind == WORD else narrow(args[1], kind)
            builder.store(value, _pointer(builder, args[0], kind))
            return context.get_dummy_value()

        return types.none(types.int64, number), codegen

    return store_at


store_word = _store(WORD, types.int64)
"""Store a 64-bit integer at an address."""

store_integer = _store(ir.IntType(32), types.int64)
"""Store a C int at an address."""

store_byte = _store(ir.IntType(8), types.int64)
"""Store a byte at an address."""

store_single = _store(ir.FloatType(), types.float64)
"""Store a C float at an address."""


@intrinsic
def float_at(typingctx, address):
    """The double at an address."""

    def codegen(context, builder, signature, args):
        return builder.load(_pointer(builder, args[0], ir.DoubleType()))

    return types.float64(types.int64), codegen


@intrinsic
def bits_of(typingctx, number):
    """The bits of a double as an integer."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], WORD)

    return types.int64(types.float64), codegen


@intrinsic
def atomic_add(typingctx, address, amount):
    """Add to the integer at an address atomically; return its former value."""

    def codegen(context, builder, signature, args):
        return builder.atomic_rmw("add", _pointer(builder, args[0], WORD), args[1], "seq_cst")

    return types.int64(types.int64, types.int64), codegen


@intrinsic
def call(typingctx, address, arguments):
    """Call the void C function at an address with a tuple of integers."""

    def codegen(context, builder, signature, args):
        kind = ir.FunctionType(ir.VoidType(), [WORD] * len(arguments))
        builder.call(_pointer(builder, args[0], kind), cgutils.unpack_tuple(builder, args[1]))
        return context.get_dummy_value()

    return types.none(types.int64, types.UniTuple(types.int64, len(arguments))), codegen


def reader_of(source: Clock) -> Callable[[], int]:
    """Make an intrinsic that reads a clock [ns]."""
    llvmlite.binding.add_symbol(source.name, source.address)

    @intrinsic
    def nanoseconds(typingctx):
        def codegen(context, builder, signature, args):
            fields = cgutils.alloca_once(builder, WORD, size=2)
            second = builder.gep(fields, [WORD(1)])
            builder.store(WORD(0), second)  # some clocks write only the first
            half, billion, rate = ir.IntType(32), WORD(10**9), WORD(source.rate)
            kinds = [half] * len(source.numbers) + [fields.type]
            read = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(half, kinds), source.name
            )
            builder.call(read, [*map(half, source.numbers), fields])
            ticks, rest = builder.load(fields), builder.load(second)
            seconds, part = builder.udiv(ticks, rate), builder.urem(ticks, rate)
            parts = builder.udiv(builder.mul(part, billion), rate)
            return builder.add(builder.add(builder.mul(seconds, billion), parts), rest)

        return types.int64(), codegen

    return nanoseconds


nanoseconds = reader_of(clock())
"""The time [ns] of a clock that never runs backwards."""


@intrinsic
def call_kernel(typingctx, address, block, items, positions, rotations, time, rows):
    """Call the kernel of a method (see `methods.method.Compiled`) at an address."""
    arguments = (block, items, positions, rotations, types.float64, rows)

    def codegen(context, builder, signature, args):
        kind = context.call_conv.get_function_type(types.none, arguments)
        function = _pointer(builder, args[0], kind)
        context.call_conv.call_function(builder, function, types.none, arguments, args[1:])
        return context.get_dummy_value()

    return types.none(types.int64, *arguments), codegen


@intrinsic
def records_at(typingctx, address, count, size):
    """An array of `count` records of `size` bytes. The kernel of `call_kernel` knows their type."""
    kind = types.Array(types.Record.make_c_struct([("_", types.int64)]), 1, "C", readonly=True)

    def codegen(context, builder, signature, args):
        array = make_array(kind)(context, builder)
        data = _pointer(builder, args[0], context.get_data_type(kind.dtype))
        populate_array(array, data, [args[1]], [args[2]], args[2], meminfo=None)
        return impl_ret_borrowed(context, builder, kind, array._getvalue())

    return kind(types.int64, types.int64, types.int64), codegen


def named_word(name: str, address: int) -> Callable[[], int]:
    """Register an address under a name and make an intrinsic that returns it.

    Kernels that are cached between processes find the address again by its name, so it must be
    registered before such a kernel is loaded.
    """
    llvmlite.binding.add_symbol(name, address)

    @intrinsic
    def symbol_address(typingctx):
        def codegen(context, builder, signature, args):
            symbol = builder.module.globals.get(name)
            if symbol is None:
                symbol = ir.GlobalVariable(builder.module, WORD, name)
                symbol.linkage = "external"
            return builder.ptrtoint(symbol, WORD)

        return types.int64(), codegen

    return symbol_address
