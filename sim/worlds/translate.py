"""Translation: the text of the package's compiled functions as C++ for Warp.

The formulas of waves, heads, jets, clips and drag are written once, as Python functions that numba
compiles (see `sim.kernels`). This module translates the same text, with the types of its arguments,
to C++ that Warp compiles for a GPU or for the CPU: `Translator.add` translates a function and all
functions that it calls, `Translator.text` is the result, a struct of static functions. Whatever is
not understood is refused with the function's name and the line, and nothing is guessed.

A `Flavour` says what changes on the way: the precision, the integers, and the sizes of the
workspaces, whose loops then run over the few points of one thread instead of a chunk. Loops over
the elements of a hull's surface are shared by the threads of a block: each runs over its own
elements, and the sums are added up over the block after the loop.

Types of values: "real", "int", "bool"; Record, a row of a table or a table of one row; Fixed, an
array of a known shape; View, an array of records, numbers or Fixed arrays of any length; Named, a
NamedTuple; Tuple, the results of a function; Opaque, a C++ class of the caller's.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from math import inf, prod
from types import ModuleType
from typing import Any

import numpy as np

from sim.precision import SINGLE_BELOW_ONE, SMALLEST_SINGLE

FUNCTIONS = {"min": "wp::min", "max": "wp::max", "abs": "wp::abs"}
INTRINSICS = {"lowest_bit": "lowest_bit"}
MATHEMATICS = {"sqrt": "wp::sqrt", "floor": "wp::floor", "abs": "wp::abs"}
CONSTANTS = {"inf": "INFINITY", "nan": "NAN", "pi": repr(np.pi)}
OPERATORS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.LShift: "<<", ast.RShift: ">>",
    ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^", ast.FloorDiv: "//", ast.Mod: "%",
    ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
    ast.And: "&&", ast.Or: "||", ast.USub: "-", ast.UAdd: "+", ast.Not: "!", ast.Invert: "~",
}  # fmt: skip


@dataclass(frozen=True)
class Record:
    name: str


@dataclass(frozen=True)
class Fixed:
    element: Any
    shape: tuple[int, ...]


@dataclass(frozen=True)
class View:
    element: Any


@dataclass(frozen=True)
class Named:
    name: str
    fields: tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Tuple:
    types: tuple[Any, ...]


@dataclass(frozen=True)
class Opaque:
    """A C++ class with `size` and with rows of a type, which are values."""

    name: str
    element: Any


@dataclass(frozen=True)
class Flavour:
    """What a translation changes.

    real, integer: C++ types. lengths: sizes of array dimensions that change, such as the number of
    points in a workspace. constants: values of module constants by name. shared: name of the
    constant whose loops the threads of a block share.
    """

    real: str = "double"
    integer: str = "long long"
    lengths: Mapping[int, int] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    shared: str | None = None


RESERVED = {"new", "delete", "class", "this", "auto", "union", "register", "signed", "far", "near"}
"""Names in the text that mean something else in C++."""

SCALARS = ("real", "int", "bool")


class TranslationError(Exception):
    """A function's text has something that is not understood."""


@dataclass
class _Translated:
    name: str
    result: Any
    outs: int


class Translator:
    """C++ of functions and of all that they call, for one flavour. classes: C++ of the caller's own
    classes (see Opaque)."""

    def __init__(self, flavour: Flavour, name: str = "Code", classes: str = "") -> None:
        self.flavour, self.name, self.classes = flavour, name, classes
        self.dtypes: dict[str, np.dtype[Any]] = {}
        self._functions: dict[Any, _Translated] = {}
        self._records: list[str] = []
        self._structs: dict[Any, str] = {}
        self._bodies: list[str] = []
        self.sources: dict[str, int] = {}

    def add(self, function: Callable[..., Any], *arguments: Any) -> _Translated:
        """Translate a function for arguments of these types."""
        function = getattr(function, "py_func", function)
        key = function, arguments
        if key not in self._functions:
            made = _Function(self, function, arguments)
            self._functions[key] = made.translated
            made.translate()
            self._bodies.append(made.text)
            self.sources[f"{function.__module__}.{function.__qualname__}"] = made.line_count
        return self._functions[key]

    @property
    def text(self) -> str:
        """The struct of all structs and functions."""
        parts = [*self._records, self.classes, *self._structs.values(), *self._bodies]
        body = textwrap.indent("\n".join(parts), "  ")
        return f"struct {self.name} {{\n{HELPERS[self.flavour.real]}{body}\n}};\n"

    def record(self, name: str, dtype: np.dtype[Any]) -> Record:
        """The type of the rows of a table."""
        known = self.dtypes.get(name)
        if known is None:
            self.dtypes[name] = dtype
            fields = [
                f"{self.ctype(kind)} {label}{self.extent(kind)};"
                for label, kind in self.fields(dtype).items()
            ]
            self._records.append(f"struct {name} {{ {' '.join(fields)} }};")
        return Record(name)

    def fields(self, dtype: np.dtype[Any]) -> dict[str, Any]:
        """The type of every field of a record."""
        found = {}
        for name, (kind, *_) in (dtype.fields or {}).items():
            base, shape = kind.subdtype or (kind, ())
            if base.names:
                element: Any = self.record(name_of(base), base)
            else:
                element = "real" if base.kind == "f" else "int"
                if base.itemsize == 4:  # in the tables of the text: single where that is enough
                    element = {"f": "single", "i": "short"}[base.kind]
            lengths = self.flavour.lengths
            shape = tuple(lengths.get(int(n), int(n)) for n in shape)
            found[name] = Fixed(element, shape) if shape else element
        return found

    def ctype(self, kind: Any) -> str:
        """The C++ type of a value, of the elements of an array."""
        if isinstance(kind, Fixed):
            return self.ctype(kind.element)
        if isinstance(kind, Record | Opaque):
            return kind.name
        if isinstance(kind, View):
            element = self.ctype(kind.element)
            width = prod(kind.element.shape) if isinstance(kind.element, Fixed) else 1
            mark = f"{element}_{width}".replace(" ", "_")
            if kind not in self._structs:
                at = f"p + {width} * (i * step)"
                one = f"{element}* at(int i) const {{ return {at}; }}"
                if width == 1:
                    one = f"{element}& at(int i) const {{ return p[i * step]; }}"
                self._structs[kind] = (
                    f"struct View_{mark} {{ {element}* p; int size; int step; "
                    f"CUDA_CALLABLE {one} CUDA_CALLABLE View_{mark} slice(int from, int to) const "
                    f"{{ return {{p + {width} * from * step, to - from, step}}; }} }};"
                )
            return f"View_{mark}"
        if isinstance(kind, Named):
            if kind not in self._structs:
                mark = f"{kind.name}_{len(self._structs)}"
                members = [f"{self.declared(n, k)};" for n, k in kind.fields]
                self._structs[kind] = f"struct {mark} {{ {' '.join(members)} }};"
            return self._structs[kind].split()[1]
        return {
            "real": self.flavour.real, "int": self.flavour.integer, "bool": "bool",
            "single": "float", "short": "int",
        }[kind]  # fmt: skip

    def declared(self, name: str, kind: Any) -> str:
        """The declaration of a member or an argument."""
        if isinstance(kind, Fixed):
            return f"{self.ctype(kind)}* {name}"
        if isinstance(kind, Record):
            return f"{self.ctype(kind)}* {name}"
        return f"{self.ctype(kind)} {name}"

    @staticmethod
    def extent(kind: Any) -> str:
        return f"[{prod(kind.shape)}]" if isinstance(kind, Fixed) else ""


HELPERS = {
    real: f"""  // begin helpers
  typedef {real} real;
  static CUDA_CALLABLE inline long long floor_div(long long a, long long b) {{
    long long q = a / b; return (a % b != 0 && (a < 0) != (b < 0)) ? q - 1 : q;
  }}
  static CUDA_CALLABLE inline int lowest_bit(long long bits) {{
#if defined(__CUDA_ARCH__)
    return __ffsll(bits) - 1;
#else
    return __builtin_ctzll(bits);
#endif
  }}
  static CUDA_CALLABLE inline real block_sum(real x) {{
#if defined(__CUDA_ARCH__)
    __shared__ real parts[32];
    for (int k = 16; k > 0; k >>= 1) x += __shfl_xor_sync(0xffffffffu, x, k);
    __syncthreads();
    if ((threadIdx.x & 31) == 0) parts[threadIdx.x >> 5] = x;
    __syncthreads();
    x = 0;
    for (int k = 0; k < (blockDim.x >> 5); k++) x += parts[k];
#endif
    return x;
  }}
"""
    for real in ("float", "double")
}


def name_of(dtype: np.dtype[Any]) -> str:
    """The name of a record type. Kinds of rows with equal fields share one."""
    return f"R{sha256(str(dtype).encode()).hexdigest()[:10]}"


class _Function:
    """One function on its way to C++."""

    def __init__(self, owner: Translator, function: Any, arguments: tuple[Any, ...]) -> None:
        self.owner, self.function, self.arguments = owner, function, arguments
        self.globals = function.__globals__ | inspect.getclosurevars(function).nonlocals
        lines, self.first_line = inspect.getsourcelines(function)
        (self.tree,) = ast.parse(textwrap.dedent("".join(lines))).body
        assert isinstance(self.tree, ast.FunctionDef)
        for node in ast.walk(self.tree):
            if isinstance(node, ast.arg) and node.arg in RESERVED:
                node.arg += "_"
            elif isinstance(node, ast.Name) and node.id in RESERVED:
                node.id += "_"
        self.line_count = len(lines)
        number = len(owner._functions)
        self.translated = _Translated(f"{function.__name__}_{number}", None, 0)
        self.types: dict[str, Any] = {}
        self.forced: dict[str, Any] = {}
        self.text = ""

    def refuse(self, node: ast.AST, what: str) -> TranslationError:
        line = self.first_line + getattr(node, "lineno", 1) - 1
        name = f"{self.function.__module__}.{self.function.__name__}"
        return TranslationError(f"{name}, line {line}: {what}")

    def translate(self) -> None:
        """Translate until the types of all variables hold: a variable that is an integer first and
        a real number later is a real number."""
        tree: Any = self.tree
        names = [argument.arg for argument in tree.args.args]
        if len(names) != len(self.arguments):
            raise self.refuse(tree, f"takes {len(names)} arguments, got {len(self.arguments)}")
        for _ in range(4):
            self.types = dict(zip(names, self.arguments, strict=True))
            self.own: set[str] = set()
            self.hoisted: dict[str, str] = {}
            self.out: list[str] = []
            self.indent, self.temporaries, self.changed = 2, 0, False
            self.zeros: set[str] = set()
            self.slices: dict[str, ast.Slice] = {}
            self.translated.result = None
            self.block(tree.body)
            if not self.changed:
                break
        self.text = self.assembled(names)

    def assembled(self, names: list[str]) -> str:
        result = self.translated.result
        parameters = [
            f"{self.owner.ctype(kind)}& {name}"
            if isinstance(kind, Record)
            else self.owner.declared(name, kind)
            for name, kind in zip(names, self.arguments, strict=True)
        ]
        returned = "void" if result is None else self.owner.ctype(result) if not isinstance(
            result, Tuple
        ) else "void"  # fmt: skip
        if isinstance(result, Tuple):
            parameters += [f"{self.owner.ctype(k)}& out{i}" for i, k in enumerate(result.types)]
        head = f"static CUDA_CALLABLE WORLDS_INLINE {returned} {self.translated.name}"
        declarations = [f"    {text}" for text in self.hoisted.values()]
        body = "\n".join([*declarations, *self.out])
        return f"{head}({', '.join(parameters)}) {{\n{body}\n}}"

    # Statements

    def write(self, text: str) -> None:
        self.out.append("  " * self.indent + text)

    def block(self, statements: Iterable[ast.stmt]) -> None:
        for statement in statements:
            method = getattr(self, f"do_{type(statement).__name__.lower()}", None)
            if method is None:
                raise self.refuse(statement, f"a statement {type(statement).__name__}")
            method(statement)

    def do_pass(self, node: ast.Pass) -> None:
        pass

    def do_expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant):
            return  # a docstring
        if not isinstance(node.value, ast.Call):
            raise self.refuse(node, "an expression without effect")
        code, _ = self.call(node.value, as_statement=True)
        if code:
            self.write(f"{code};")

    def do_return(self, node: ast.Return) -> None:
        if node.value is None:
            self.write("return;")
            return
        if isinstance(node.value, ast.Tuple):
            values = [self.expression(e) for e in node.value.elts]
        else:
            code, kind = self.expression(node.value)
            if not isinstance(kind, Tuple):
                self.returns(node, kind)
                self.write(f"return {code};")
                return
            values = list(zip(code.split(","), kind.types, strict=True))
        self.returns(node, Tuple(tuple(number_type(kind) for _, kind in values)))
        for i, (code, _) in enumerate(values):
            self.write(f"out{i} = {code};")
        self.write("return;")

    def returns(self, node: ast.AST, kind: Any) -> None:
        kind, known = number_type(kind), self.translated.result
        if isinstance(kind, Record | Fixed):
            raise self.refuse(node, "returns a row or an array")
        if known is None:
            self.translated.result = kind
        elif known != kind:
            pairs = [(known, kind)]
            if isinstance(known, Tuple) and isinstance(kind, Tuple):
                pairs = list(zip(known.types, kind.types, strict=True))
            merged = [self.merged(node, a, b) for a, b in pairs]
            self.translated.result = Tuple(tuple(merged)) if isinstance(kind, Tuple) else merged[0]

    def merged(self, node: ast.AST, a: Any, b: Any) -> Any:
        a, b = number_type(a), number_type(b)
        if a == b:
            return a
        if a in SCALARS and b in SCALARS:
            return SCALARS[min(SCALARS.index(a), SCALARS.index(b))]
        raise self.refuse(node, f"a value of types {a} and {b}")

    def do_assign(self, node: ast.Assign) -> None:
        if len(node.targets) != 1:
            raise self.refuse(node, "several targets")
        target, value = node.targets[0], node.value
        if not isinstance(target, ast.Tuple):
            self.assign_one(target, value)
            return
        if isinstance(value, ast.Tuple):
            self.assign_each(node, target.elts, value.elts)
            return
        code, kind = self.expression(value)
        if isinstance(kind, Tuple):
            codes, kinds = code.split(","), kind.types
        elif isinstance(kind, Fixed) and kind.shape == (len(target.elts),):
            codes, kinds = [f"{code}[{i}]" for i in range(kind.shape[0])], [kind.element] * 99
        else:
            raise self.refuse(node, f"unpacks {kind}")
        if len(codes) != len(target.elts):
            raise self.refuse(node, f"unpacks {len(codes)} values into {len(target.elts)}")
        for each, code, kind in zip(target.elts, codes, kinds, strict=False):
            if not (isinstance(each, ast.Name) and each.id == "_"):
                self.store(each, code, kind)

    def assign_each(self, node: ast.AST, targets: list[ast.expr], values: list[ast.expr]) -> None:
        if len(targets) != len(values):
            raise self.refuse(node, f"unpacks {len(values)} values into {len(targets)}")
        waiting = []
        for target, value in zip(targets, values, strict=True):
            made = self.made_array(target, value)
            if made:
                continue
            code, kind = self.expression(value)
            if number_type(kind) in SCALARS:
                name = self.temporary(number_type(kind))
                self.write(f"{name} = {code};")
                code = name
            elif isinstance(kind, Record) and self.is_owned(target):
                name = self.temporary(kind)
                self.write(f"{name} = {code};")
                code = name
            waiting.append((target, value, code, kind))
        for target, value, code, kind in waiting:
            self.store(target, code, kind)
            self.note_zero(target, value)

    def is_owned(self, target: ast.expr) -> bool:
        return isinstance(target, ast.Name) and target.id in self.own

    def assign_one(self, target: ast.expr, value: ast.expr) -> None:
        if self.made_array(target, value):
            return
        if isinstance(value, ast.Tuple):
            if not isinstance(target, ast.Name):
                raise self.refuse(target, "a tuple stored elsewhere than in a variable")
            parts = [self.expression(e) for e in value.elts]
            kind: Any = parts[0][1]
            for _, other in parts[1:]:
                kind = self.merged(target, kind, other)
            self.own_array(target, Fixed(number_type(kind), (len(parts),)))
            for i, (code, _) in enumerate(parts):
                self.write(f"{target.id}[{i}] = {code};")
            return
        if isinstance(value, ast.Call) and ast.unparse(value.func) == "slice":
            self.keep_slice(target, value)
            return
        self.store(target, *self.expression(value))
        self.note_zero(target, value)

    def note_zero(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name) and isinstance(value, ast.Constant) and value.value == 0.0:
            self.zeros.add(target.id)

    def keep_slice(self, target: ast.expr, value: ast.Call) -> None:
        if not isinstance(target, ast.Name) or len(value.args) != 2:
            raise self.refuse(target, "a slice")
        bounds = []
        for each in value.args:
            name = self.temporary("int")
            self.write(f"{name} = {self.expression(each)[0]};")
            self.types[name] = "int"
            bounds.append(ast.Name(name, ast.Load()))
        self.slices[target.id] = ast.Slice(*bounds)

    def made_array(self, target: ast.expr, value: ast.expr) -> bool:
        """Whether a value is a new array, of np.empty or np.zeros or on the stack, which is then
        declared."""
        if not isinstance(value, ast.Call):
            return False
        maker = ast.unparse(value.func).removeprefix("np.")
        if maker not in ("empty", "zeros", "workspace", "scratch", "scratch_zeros", "reals"):
            return False
        kind: Any = "real"
        if maker == "workspace" or len(value.args) > 1:
            given = self.constant(value.args[-1])
            if isinstance(given, np.dtype):
                kind = self.owner.record(name_of(given), given)
            elif given is np.int64:
                kind = "int"
            else:
                raise self.refuse(value, "an array of another type")
        size = value.args[0]
        sizes = size.elts if isinstance(size, ast.Tuple) else [size]
        shape = (1,) if maker == "workspace" else tuple(self.length(each) for each in sizes)
        if isinstance(kind, Record) and shape == (1,):
            self.own_record(target, kind)
        else:
            self.own_array(target, Fixed(kind, shape))
        if maker.endswith("zeros"):
            self.fill(ast.unparse(target), Fixed(kind, shape), "0")
        return True

    def length(self, node: ast.expr) -> int:
        """The length of a new array: a constant, or room for a chunk of points."""
        known = self.constant(node)
        if isinstance(known, int | np.integer):
            return int(known)
        chunk = self.owner.flavour.constants.get("CHUNK")
        text = ast.unparse(node)
        if chunk is not None and (text.endswith(".size") or text == "count"):
            return int(chunk)
        raise self.refuse(node, f"an array of the length {text}, which is not a constant")

    def own_record(self, target: ast.expr, kind: Record) -> None:
        if not isinstance(target, ast.Name):
            raise self.refuse(target, "a new table stored elsewhere than in a variable")
        self.own.add(target.id)
        self.types[target.id] = kind
        self.hoisted[target.id] = f"{self.owner.ctype(kind)} {target.id};"

    def own_array(self, target: ast.expr, kind: Fixed) -> None:
        if not isinstance(target, ast.Name):
            raise self.refuse(target, "a new array stored elsewhere than in a variable")
        if target.id in self.types and target.id not in self.own:
            raise self.refuse(target, f"{target.id} becomes a new array")
        self.own.add(target.id)
        self.types[target.id] = kind
        self.hoisted[target.id] = f"{self.owner.ctype(kind)} {target.id}[{prod(kind.shape)}];"

    def fill(self, code: str, kind: Fixed, value: str) -> None:
        self.write(f"for (int k_ = 0; k_ < {prod(kind.shape)}; k_++) {code}[k_] = {value};")

    def temporary(self, kind: Any) -> str:
        name = f"t{self.temporaries}_"
        self.temporaries += 1
        self.hoisted[name] = f"{self.owner.ctype(kind)} {name};"
        return name

    def store(self, target: ast.expr, code: str, kind: Any) -> None:
        if isinstance(target, ast.Name):
            self.store_name(target, code, kind)
            return
        if isinstance(target, ast.Subscript) and isinstance(target.slice, ast.Slice):
            place, found = self.expression(target)
            if not isinstance(found, Fixed | View) or number_type(kind) not in SCALARS:
                raise self.refuse(target, "a part of an array that is set to an array")
            if isinstance(found, Fixed):
                self.fill(place, found, code)
            else:
                self.write(f"for (int k_ = 0; k_ < {place}.size; k_++) {place}.at(k_) = {code};")
            return
        place, found = self.expression(target)
        scalars = number_type(found) in SCALARS and number_type(kind) in SCALARS
        if not scalars and found != kind:
            raise self.refuse(target, f"a value of type {kind} for {found}")
        self.write(f"{place} = {code};")

    def store_name(self, target: ast.Name, code: str, kind: Any) -> None:
        name, kind = target.id, number_type(kind)
        self.zeros.discard(name)
        known = self.forced.get(name) or self.types.get(name)
        if kind in SCALARS:
            if known is not None and known != kind:
                merged = self.merged(target, known, kind)
                if merged != known:
                    self.forced[name], self.changed = merged, True
                kind = merged
            self.types[name] = kind
            parameters = [a.arg for a in self.tree.args.args]  # type: ignore[attr-defined]
            if name not in parameters:
                self.hoisted[name] = f"{self.owner.ctype(kind)} {name};"
            self.write(f"{name} = {code};")
        elif isinstance(kind, Record) and name in self.own:
            self.write(f"{name} = {code};")
        elif isinstance(kind, Record | Fixed):
            if known is not None and known != kind:
                raise self.refuse(target, f"{name} is {known} and {kind}")
            self.types[name] = kind
            sign = "&" if isinstance(kind, Record) else "*"
            self.write(f"{self.owner.ctype(kind)}{sign} {name} = {code};")
        elif isinstance(kind, View | Named):
            self.types[name] = kind
            self.hoisted[name] = f"{self.owner.ctype(kind)} {name};"
            self.write(f"{name} = {code};")
        else:
            raise self.refuse(target, f"a variable of type {kind}")

    def do_augassign(self, node: ast.AugAssign) -> None:
        value, kind = self.expression(node.value)
        place, found = self.expression(node.target)
        sign = OPERATORS[type(node.op)]
        if sign in ("//", "%") or number_type(found) not in SCALARS:
            raise self.refuse(node, f"{ast.unparse(node)}")
        merged = self.merged(node, found, kind)
        if isinstance(node.target, ast.Name) and merged != number_type(found):
            self.store_name(node.target, place, merged)
        if kind == "bool":
            value = f"({self.flavour_int})({value})"
        self.write(f"{place} {sign}= {value};")
        if isinstance(node.target, ast.Name):
            self.zeros.discard(node.target.id)

    @property
    def flavour_int(self) -> str:
        return self.owner.flavour.integer

    def do_if(self, node: ast.If) -> None:
        test, _ = self.expression(node.test)
        self.write(f"if (bool({test})) {{")
        self.indented(node.body)
        if node.orelse:
            self.write("} else {")
            self.indented(node.orelse)
        self.write("}")

    def indented(self, statements: Iterable[ast.stmt]) -> None:
        self.indent += 1
        self.block(statements)
        self.indent -= 1

    def do_while(self, node: ast.While) -> None:
        if node.orelse:
            raise self.refuse(node, "a loop with else")
        self.write("while (true) {")
        self.indent += 1
        test, _ = self.expression(node.test)
        self.write(f"if (!bool({test})) break;")
        self.block(node.body)
        self.indent -= 1
        self.write("}")

    def do_break(self, node: ast.Break) -> None:
        self.write("break;")

    def do_continue(self, node: ast.Continue) -> None:
        self.write("continue;")

    def do_for(self, node: ast.For) -> None:
        call = node.iter
        is_range = isinstance(call, ast.Call) and ast.unparse(call.func) == "range"
        if not is_range or node.orelse or not isinstance(node.target, ast.Name):
            raise self.refuse(node, "a loop over something else than a range")
        assert isinstance(call, ast.Call)
        bounds = [self.expression(each)[0] for each in call.args]
        start, end, step = (["0", *bounds, "1"] if len(bounds) == 1 else [*bounds, "1"])[:3]
        name, order = node.target.id, "<"
        if len(bounds) == 3:
            known = self.constant(call.args[2])
            if not isinstance(known, int | np.integer):
                raise self.refuse(node, "a loop with a step that is not a constant")
            order = "<" if known > 0 else ">"
        if name == "_":
            name = self.temporary("int")
        self.types[name] = "int"
        self.hoisted.setdefault(name, f"{self.flavour_int} {name};")
        is_shared = len(call.args) == 1 and ast.unparse(call.args[0]) == self.owner.flavour.shared
        sums = self.accumulators(node) if is_shared else []
        self.write(f"for ({name} = {start}; {name} {order} {end}; {name} += {step}) {{")
        self.indented(node.body)
        self.write("}")
        for each in sums:
            self.write(f"{each} = block_sum({each});")

    def accumulators(self, node: ast.For) -> list[str]:
        """Variables that a shared loop changes and that were set before it. They must start at 0,
        because each thread of the block sums its own share."""
        stored = [n.id for n in ast.walk(node) if isinstance(n, ast.Name)
                  and isinstance(n.ctx, ast.Store)]  # fmt: skip
        found = [name for name in dict.fromkeys(stored) if name in self.types]
        found = [name for name in found if self.types[name] == "real"]
        for name in found:
            if name not in self.zeros:
                raise self.refuse(node, f"the sum {name} of a shared loop does not start at 0")
        return found

    # Expressions

    def module(self, node: ast.expr) -> ModuleType | None:
        found = self.globals.get(node.id) if isinstance(node, ast.Name) else None
        return found if isinstance(found, ModuleType) else None

    def constant(self, node: ast.expr) -> Any:
        """The value of an expression of constants; None if it is none."""
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name) and node.id not in self.types:
            overridden = self.owner.flavour.constants
            return overridden.get(node.id, self.globals.get(node.id))
        if isinstance(node, ast.Attribute) and self.module(node.value) is not None:
            return getattr(self.module(node.value), node.attr)
        if isinstance(node, ast.BinOp | ast.UnaryOp):
            parts = [node.left, node.right] if isinstance(node, ast.BinOp) else [node.operand]
            if all(isinstance(self.constant(p), int | float | np.number) for p in parts):
                names = {f"v{i}": self.constant(p) for i, p in enumerate(parts)}
                operator = OPERATORS[type(node.op)]
                text = f"v0 {operator} v1" if len(parts) == 2 else f"{operator} v0"
                return eval(text, {}, names)
        if isinstance(node, ast.Subscript):
            base, index = self.constant(node.value), self.constant(node.slice)
            if isinstance(base, tuple) and isinstance(index, int):
                return base[index]
        return None

    def literal(self, node: ast.AST, value: Any) -> tuple[str, Any]:
        if isinstance(value, bool | np.bool_):
            return ("true" if value else "false"), "bool"
        if isinstance(value, int | np.integer):
            return str(int(value)), "int"
        if not isinstance(value, float | np.floating):
            raise self.refuse(node, f"the constant {value!r}")
        number = float(value)
        if number != number:
            return "real(NAN)", "real"
        if number in (inf, -inf):
            return f"real({'-' if number < 0 else ''}INFINITY)", "real"
        if self.owner.flavour.real == "float" and 0.0 < abs(number) < SMALLEST_SINGLE:
            number = float(np.copysign(SMALLEST_SINGLE, number))
        elif self.owner.flavour.real == "float" and number < 1.0 and np.float32(number) == 1.0:
            number = SINGLE_BELOW_ONE
        return f"real({number!r})", "real"

    def expression(self, node: ast.expr) -> tuple[str, Any]:
        """The C++ of an expression, and its type. A Tuple's code is its values, with commas."""
        value = self.constant(node)
        if isinstance(value, int | float | np.number | np.bool_):
            return self.literal(node, value)
        method = getattr(self, f"of_{type(node).__name__.lower()}", None)
        if method is None:
            raise self.refuse(node, f"the expression {ast.unparse(node)}")
        return method(node)

    def of_name(self, node: ast.Name) -> tuple[str, Any]:
        if node.id not in self.types:
            raise self.refuse(node, f"the name {node.id}, which is no variable and no constant")
        return node.id, self.types[node.id]

    def of_attribute(self, node: ast.Attribute) -> tuple[str, Any]:
        code, kind = self.expression(node.value)
        if node.attr == "size":
            if isinstance(kind, Fixed):
                return str(prod(kind.shape)), "int"
            if isinstance(kind, Record):
                return "1", "int"  # a table of one row
            if isinstance(kind, View | Opaque):
                return f"{code}.size", "int"
        if isinstance(kind, Record):
            fields = self.owner.fields(self.owner.dtypes[kind.name])
        elif isinstance(kind, Named):
            fields = dict(kind.fields)
        else:
            fields = {}
        if node.attr not in fields:
            raise self.refuse(node, f"the field {node.attr} of {ast.unparse(node.value)}, {kind}")
        found = fields[node.attr]
        if isinstance(kind, Named) and isinstance(found, Record):
            return f"(*{code}.{node.attr})", found
        return f"{code}.{node.attr}", found

    def of_subscript(self, node: ast.Subscript) -> tuple[str, Any]:
        if isinstance(node.slice, ast.Slice):
            return self.sliced(node, node.slice)
        if isinstance(node.slice, ast.Name) and node.slice.id in self.slices:
            return self.sliced(node, self.slices[node.slice.id])
        base, kind = self.expression(node.value)
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if isinstance(kind, Tuple):
            index = self.constant(node.slice)
            return base.split(",")[index], kind.types[index]
        places = []
        for each in parts:
            if isinstance(each, ast.Slice):
                return self.sliced(node, each)
            code, found = self.expression(each)
            if number_type(found) not in SCALARS[1:]:
                raise self.refuse(node, f"the index {ast.unparse(each)} of type {found}")
            places.append(code)
        if isinstance(kind, Record):
            return base, kind  # a table of one row
        if isinstance(kind, Opaque):
            name = self.temporary(kind.element)
            self.write(f"{name} = {base}.at({places[0]});")
            return name, kind.element
        if isinstance(kind, View):
            code, kind = f"{base}.at({places[0]})", kind.element
            if len(places) == 1:
                return code, kind
            base, places = code, places[1:]
        if not isinstance(kind, Fixed) or len(places) > len(kind.shape):
            raise self.refuse(node, f"an element of {ast.unparse(node.value)}, {kind}")
        rest = kind.shape[len(places) :]
        strides = [prod(kind.shape[i + 1 :]) for i in range(len(places))]
        at = " + ".join(
            f"({place}) * {stride}" if stride > 1 else f"({place})"
            for place, stride in zip(places, strides, strict=True)
        )
        if rest:
            return f"({base} + {at})", Fixed(kind.element, rest)
        return f"{base}[{at}]", kind.element

    def sliced(self, node: ast.Subscript, part: ast.Slice) -> tuple[str, Any]:
        base, kind = self.expression(node.value)
        if part.step is not None or not isinstance(kind, Fixed | View | Record):
            raise self.refuse(node, f"the slice {ast.unparse(node)} of {kind}")
        if isinstance(node.slice, ast.Tuple) or (part.lower is None and part.upper is None):
            if isinstance(node.slice, ast.Tuple):
                raise self.refuse(node, f"the slice {ast.unparse(node)}")
            return base, kind
        first = self.constant(part.lower) if part.lower else 0
        if isinstance(kind, Fixed) and len(kind.shape) == 1:
            last = self.constant(part.upper) if part.upper else kind.shape[0]
            if isinstance(first, int | np.integer) and isinstance(last, int | np.integer):
                return f"({base} + {first})", Fixed(kind.element, (int(last) - int(first),))
            start = self.expression(part.lower)[0] if part.lower else "0"
            end = self.expression(part.upper)[0] if part.upper else str(kind.shape[0])
            view = View(kind.element)
            whole = f"{self.owner.ctype(view)}{{{base}, {kind.shape[0]}, 1}}"
            return f"({whole}.slice({start}, {end}))", view
        if isinstance(kind, View):
            start = self.expression(part.lower)[0] if part.lower else "0"
            end = self.expression(part.upper)[0] if part.upper else f"{base}.size"
            return f"{base}.slice({start}, {end})", kind
        if isinstance(kind, Record):  # a table of one row
            view = View(kind)
            start = self.expression(part.lower)[0] if part.lower else "0"
            end = self.expression(part.upper)[0] if part.upper else "1"
            return f"({self.owner.ctype(view)}{{&{base}, 1, 1}}.slice({start}, {end}))", view
        raise self.refuse(node, f"the slice {ast.unparse(node)} of {kind}")

    def of_binop(self, node: ast.BinOp) -> tuple[str, Any]:
        a, first = self.expression(node.left)
        b, second = self.expression(node.right)
        sign = OPERATORS.get(type(node.op))
        kinds = number_type(first), number_type(second)
        if sign is None or any(kind not in SCALARS for kind in kinds):
            raise self.refuse(node, f"the operation {ast.unparse(node)} of {first} and {second}")
        kind = "real" if "real" in kinds else "int"
        if sign == "//":
            if kind == "real":
                raise self.refuse(node, "a floor division of real numbers")
            return f"({self.flavour_int})floor_div({a}, {b})", "int"
        if sign == "%" and kind == "real":
            raise self.refuse(node, "a remainder of real numbers")
        if sign == "/" and kind != "real":
            a, kind = f"real({a})", "real"
        return f"({a} {sign} {b})", kind

    def of_unaryop(self, node: ast.UnaryOp) -> tuple[str, Any]:
        code, kind = self.expression(node.operand)
        sign = OPERATORS[type(node.op)]
        kind = number_type(kind)
        if kind not in SCALARS:
            raise self.refuse(node, f"the operation {ast.unparse(node)}")
        return f"({sign}{code})", "bool" if sign == "!" else "int" if kind == "bool" else kind

    def of_boolop(self, node: ast.BoolOp) -> tuple[str, Any]:
        codes = []
        for value in node.values:
            code, kind = self.without_statements(value)
            if number_type(kind) not in SCALARS:
                raise self.refuse(node, f"{ast.unparse(value)} as a condition")
            codes.append(f"bool({code})")
        return "(" + f" {OPERATORS[type(node.op)]} ".join(codes) + ")", "bool"

    def without_statements(self, node: ast.expr) -> tuple[str, Any]:
        """An expression that may not be evaluated, and so must not need statements before it."""
        before = len(self.out)
        found = self.expression(node)
        if len(self.out) != before:
            raise self.refuse(node, "a function with several results in a condition")
        return found

    def of_compare(self, node: ast.Compare) -> tuple[str, Any]:
        if len(node.ops) != 1:
            raise self.refuse(node, "a chain of comparisons")
        a, first = self.expression(node.left)
        b, second = self.expression(node.comparators[0])
        sign = OPERATORS.get(type(node.ops[0]))
        if sign is None or any(number_type(k) not in SCALARS for k in (first, second)):
            raise self.refuse(node, f"the comparison {ast.unparse(node)}")
        return f"({a} {sign} {b})", "bool"

    def of_ifexp(self, node: ast.IfExp) -> tuple[str, Any]:
        test, _ = self.expression(node.test)
        a, first = self.without_statements(node.body)
        b, second = self.without_statements(node.orelse)
        kind = self.merged(node, first, second)
        if kind not in SCALARS:
            raise self.refuse(node, f"a choice of {first} and {second}")
        ctype = self.owner.ctype(kind)
        return f"({test} ? ({ctype})({a}) : ({ctype})({b}))", kind

    def of_call(self, node: ast.Call) -> tuple[str, Any]:
        return self.call(node, as_statement=False)

    def call(self, node: ast.Call, as_statement: bool) -> tuple[str, Any]:
        if node.keywords:
            raise self.refuse(node, "a call with keywords")
        name = ast.unparse(node.func)
        if isinstance(node.func, ast.Attribute) and self.module(node.func.value) is np:
            return self.numpy_call(node, node.func.attr)
        if name in FUNCTIONS and name not in self.globals:
            return self.plain_call(node, FUNCTIONS[name])
        if name in INTRINSICS:
            return self.plain_call(node, INTRINSICS[name])
        if name in ("int", "float", "bool") and name not in self.globals:
            code, _ = self.expression(node.args[0])
            kind = {"int": "int", "float": "real", "bool": "bool"}[name]
            return f"({self.owner.ctype(kind)})({code})", kind
        function = self.globals.get(name)
        if isinstance(function, type) and issubclass(function, tuple):
            return self.named(node, function)
        plain = getattr(function, "py_func", function)
        if not inspect.isfunction(plain):
            raise self.refuse(node, f"a call of {name}, which is no function of the package")
        return self.function_call(node, plain, as_statement)

    def function_call(self, node: ast.Call, function: Any, as_statement: bool) -> tuple[str, Any]:
        arguments = [self.expression(each) for each in node.args]
        kinds = tuple(number_type(kind) for _, kind in arguments)
        codes = [code for code, _ in arguments]
        found = self.owner.add(function, *kinds)
        if isinstance(found.result, Tuple):
            names = [self.temporary(kind) for kind in found.result.types]
            self.write(f"{found.name}({', '.join([*codes, *names])});")
            return ("" if as_statement else ",".join(names)), found.result
        return f"{found.name}({', '.join(codes)})", found.result

    def named(self, node: ast.Call, cls: Any) -> tuple[str, Any]:
        values = [self.expression(each) for each in node.args]
        fields = tuple(
            (name, number_type(kind)) for name, (_, kind) in zip(cls._fields, values, strict=True)
        )
        kind = Named(cls.__name__, fields)
        codes = [f"&{code}" if isinstance(k, Record) else code for code, k in values]
        return f"({self.owner.ctype(kind)}{{{', '.join(codes)}}})", kind

    def plain_call(self, node: ast.Call, name: str) -> tuple[str, Any]:
        """A call of a function whose arguments and result have one type."""
        arguments = [self.expression(each) for each in node.args]
        kind = number_type(arguments[0][1])
        for _, other in arguments[1:]:
            kind = self.merged(node, kind, other)
        if kind not in SCALARS:
            raise self.refuse(node, f"{name} of {kind}")
        kind = "int" if kind == "bool" else kind
        codes = ", ".join(f"({self.owner.ctype(kind)})({code})" for code, _ in arguments)
        return f"{name}({codes})", kind

    def numpy_call(self, node: ast.Call, name: str) -> tuple[str, Any]:
        if name in MATHEMATICS:
            return self.plain_call(node, MATHEMATICS[name])
        if name == "int64":
            return f"({self.flavour_int})({self.expression(node.args[0])[0]})", "int"
        raise self.refuse(node, f"a call of np.{name}")


def number_type(kind: Any) -> Any:
    """The type of a value that is read from a table in another precision."""
    return {"single": "real", "short": "int"}.get(kind, kind) if isinstance(kind, str) else kind
