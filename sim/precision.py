"""Precision: kernels in single precision, from the same text as those in double precision.

A processor takes twice as many single numbers as double ones at once. Where a formula's own error
is far above 1e-7, `single` makes the kernel for them. Its text is that of the double one. Numbers
in the text, constants, and the fields "real" of records become single, and all kernels that it
calls are made in the same way.

In such a text, what needs more digits stays double, in fields "f8" and in `scratch`: positions,
times, phases of waves until whole turns are taken off, heads far below the surface, and the sums of
forces over hulls. Since a product of a single and a double number is double, `real` turns the few
double numbers that enter a loop into single ones.
"""

from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any

import numpy as np

from sim.kernels import inline, record_of, stack_array

SMALLEST_SINGLE = 1e-37
"""Replaces smaller numbers of a text above 0, which would be 0 in single precision."""

SINGLE_BELOW_ONE = 1.0 - 1e-5
"""Replaces numbers of a text below 1 that would be 1 in single precision. They are limits of sums
over elements, which are as exact as this."""

IS_SINGLE = False
"""Whether the text is compiled in single precision."""

_IN_SINGLE: dict[Any, Any] = {}
"""The single version of each function that has one."""


def in_single(function: Any) -> Callable[[Any], Any]:
    """Let the decorated function stand for another one in single precision."""

    def register(instead: Any) -> Any:
        _IN_SINGLE[function] = instead
        return instead

    return register


@inline
def real(x):
    """A number in the precision of the text."""
    return x


@in_single(real)
@inline
def _single_real(x):
    return np.float32(x)


@inline
def word(n):
    """An integer of the size that goes with the precision of the text, so that a processor takes as
    many of them at once as of its numbers."""
    return n


@in_single(word)
@inline
def _single_word(n):
    return np.int32(n)


reals = stack_array()
"""Like `kernels.scratch`, in the precision of the text."""

in_single(reals)(stack_array(is_single=True))


def single(of: Any) -> Any:
    """A kernel, an inline function, a record, a number or a tuple of such things in single
    precision. Anything else is returned as it is."""
    if isinstance(of, np.dtype):
        return _single_record(of)
    if isinstance(of, float):
        return _single_number(of)
    if type(of) is tuple:
        return tuple(map(single, of))
    if hasattr(of, "again") and of not in _IN_SINGLE:
        _IN_SINGLE[of] = of.again(_single_function(of.py_func))
    return _IN_SINGLE.get(of, of) if callable(of) else of


def _single_record(kind: np.dtype[Any]) -> np.dtype[Any]:
    given = dict(kind.metadata or {}).get("fields")
    if given is None:
        return kind
    fields = {
        name: single(field) if isinstance(field, np.dtype) else field
        for name, field in given.items()
    }
    return record_of(fields, {"real": "f4", "word": "i4"})


def _single_number(number: float) -> np.float32:
    if 0.0 < abs(number) < SMALLEST_SINGLE:
        number = float(np.copysign(SMALLEST_SINGLE, number))
    if number < 1.0 and np.float32(number) == 1.0:
        number = SINGLE_BELOW_ONE
    with np.errstate(over="ignore"):  # limits that nothing reaches become infinite
        return np.float32(number)


def _single_function(function: Callable[..., Any]) -> FunctionType:
    """The text of a function with its constants in single precision, and with the single versions
    of the functions and records that it names. Its own name keeps its compiled code apart from that
    of the double one. Raises TypeError for a text with functions in it, which would stay double."""
    code, known, name = function.__code__, function.__globals__, f"single_{function.__name__}"
    if code.co_freevars or any(isinstance(constant, CodeType) for constant in code.co_consts):
        raise TypeError(f"{function.__name__} has a function or a comprehension in it; take it out")
    code = code.replace(co_consts=single(code.co_consts), co_name=name, co_qualname=name)
    found = {each: single(known[each]) for each in code.co_names if each in known}
    names = known | found | {"IS_SINGLE": True}
    return FunctionType(code, names, name, function.__defaults__, function.__closure__)
