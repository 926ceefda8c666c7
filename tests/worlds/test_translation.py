"""The translated text of the kernels gives what numba's code gives, in double precision."""

from functools import cache

import numpy as np
import pytest
import trimesh

wp = pytest.importorskip("warp")

from independent import REPOSITORY  # noqa: E402
from sim import Hull, Patches, Sea, Wave  # noqa: E402
from sim.geometry import random_rotation  # noqa: E402
from sim.hulls.primitives import box  # noqa: E402
from sim.methods import linear  # noqa: E402
from sim.methods.patches import patches, polynomial, tree  # noqa: E402
from sim.plugin import native  # noqa: E402
from sim.resistance import drag, elements, probes, reaction  # noqa: E402
from sim.water import gerstner, head, head_jets, jets  # noqa: E402
from sim.worlds import programs, threads  # noqa: E402
from sim.worlds.translate import (  # noqa: E402
    Fixed,
    Flavour,
    Named,
    Record,
    TranslationError,
    Translator,
    View,
    name_of,
)

ROUND_OFF = 1e-10
"""Sums are in another order, and contractions differ."""


class Rows(np.ndarray):
    """A table of any length."""


class Row(np.ndarray):
    """A table of one row, whose row is the argument."""


def rows(table) -> Rows:
    return np.atleast_1d(table).copy().view(Rows)


def row(table) -> Row:
    return np.atleast_1d(table).copy().view(Row)


def kind_of(translator, value):
    """The translator's type of an argument."""
    if isinstance(value, tuple):
        fields = ((name, kind_of(translator, v)) for name, v in value._asdict().items())
        return Named(type(value).__name__, tuple(fields))
    if not isinstance(value, np.ndarray):
        return "real" if isinstance(value, float) else "int"
    if value.dtype.names is None:
        return Fixed("real", value.shape)
    record = translator.record(name_of(value.dtype), value.dtype)
    return View(record) if isinstance(value, Rows) else record


def plain(value):
    """An argument as numba's code takes it."""
    if isinstance(value, tuple):
        return type(value)(*map(plain, value))
    if not isinstance(value, np.ndarray):
        return value
    array = np.ndarray(value.shape, value.dtype, value)
    return array[0] if isinstance(value, Row) else array


def copied(value):
    if isinstance(value, tuple):
        return type(value)(*map(copied, value))
    return value.copy() if isinstance(value, np.ndarray) else value


def arrays_of(value):
    if isinstance(value, tuple):
        return [array for each in value for array in arrays_of(each)]
    return [value] if isinstance(value, np.ndarray) else []


def numbers_of(array):
    """All real numbers and integers in an array."""
    if array.dtype.names is None:
        return [np.asarray(array, dtype=float).ravel()]
    return [n for name in array.dtype.names for n in numbers_of(np.asarray(array[name]))]


class Call:
    """A function with arguments, to be called as numba's code and as the translation."""

    def __init__(self, function, *arguments) -> None:
        self.function, self.arguments = function, arguments

    def lines(self, translator, first: int) -> list[str]:
        """C++ that calls the translation. The addresses of arrays start at number `first`."""
        found = translator.add(
            self.function, *(kind_of(translator, each) for each in self.arguments)
        )
        places = iter(range(first, first + len(arrays_of(self.arguments))))

        def code(value) -> str:
            if isinstance(value, tuple):
                kind = translator.ctype(kind_of(translator, value))
                members = [
                    f"&{c}"
                    if isinstance(v, np.ndarray) and isinstance(kind_of(translator, v), Record)
                    else c
                    for v, c in ((v, code(v)) for v in value)
                ]
                return f"Code::{kind}{{{', '.join(members)}}}"
            kind = kind_of(translator, value)
            if not isinstance(value, np.ndarray):
                return repr(float(value)) if kind == "real" else str(int(value))
            place = f"at.data[{next(places)}]"
            if isinstance(kind, View):
                element = translator.ctype(kind.element)
                return (
                    f"Code::{translator.ctype(kind)}{{(Code::{element}*){place}, {len(value)}, 1}}"
                )
            if isinstance(kind, Record):
                return f"(*(Code::{translator.ctype(kind)}*){place})"
            return f"((double*){place})"

        codes = [code(each) for each in self.arguments]
        if found.result is None:
            return [f"Code::{found.name}({', '.join(codes)});"]
        kinds = getattr(found.result, "types", None)
        if kinds is None:
            return [f"results.data[0] = Code::{found.name}({', '.join(codes)});"]
        names = [f"r{i}" for i in range(len(kinds))]
        lines = [f"{translator.ctype(k)} {n};" for k, n in zip(kinds, names, strict=True)]
        lines.append(f"Code::{found.name}({', '.join([*codes, *names])});")
        return lines + [f"results.data[{i}] = {n};" for i, n in enumerate(names)]


def some_waves(depth: float = np.inf, ramp: float = 0.0) -> Sea:
    shape = (0.10, 4.0, 0.3, 0.4), (0.05, 2.4, 1.0, 0.7), (0.02, 1.4, -1.1, 1.9)
    tide = ((0.0, 0.1), (5.0, 0.4))
    waves = [Wave(*numbers) for numbers in shape]
    return Sea(waves, depth=depth, ramp=ramp, current=(0.3, 0.1), tide=tide)


def bunny() -> Hull:
    return Hull.from_trimesh(trimesh.load(REPOSITORY / "models/meshes/bunny_coarse.obj"))


def cases() -> dict[str, Call]:
    """Calls that reach every function that the programs translate."""
    rng, found = np.random.default_rng(3), {}
    rotation, position, time = random_rotation(rng).ravel().copy(), rng.normal(size=3), 2.5
    x, y, z = rng.normal(size=(3, 20)).copy()
    for name, sea in dict(
        deep=some_waves(), bottom=some_waves(1.5), ramp=some_waves(ramp=8.0), calm=Sea()
    ).items():
        waves, water = rows(sea.components), sea.water.copy()
        tolerance = float(water["tolerance"][0]) if sea.waves else 1.0
        zeros = (np.zeros(20) for _ in range(3))
        near = jets.Near(*zeros)
        if sea.waves:
            near = jets.Near(*jets.near_particles(x, y, sea.components, time, 2, tolerance))
        found |= {
            f"heads {name}": Call(head.solve_heads, x, y, z, waves, water, time, np.zeros(20)),
            f"near {name}": Call(
                jets.find_near, x, y, waves, time, np.int64(2), tolerance, copied(near)
            ),
            f"safe near {name}": Call(
                jets.find_near, x, y, waves, time, np.int64(8), 1e-12, copied(near)
            ),
            f"jets {name}": Call(
                jets.solve_jets, x, y, near, waves, time, 0.1, 0.2, rows(np.zeros(20, jets.JET))
            ),
            f"head jets {name}": Call(
                head_jets.solve_head_jets, x, y, z, near, waves, time, 1e-9, 0.2,
                rows(np.zeros(1, head_jets.HEAD_JETS)),
            ),
            f"level {name}": Call(gerstner.level_and_rise, row(water), time),
        }  # fmt: skip
        added, square = rng.uniform(size=(6, 6)), rng.uniform(size=(6, 6))
        hull = box(0.6, 0.4, 0.3)
        made = drag.Drag(
            hull, sea, drag.DragCoefficients(0.3, 0.8, 0.1, 0.2), added_mass=added @ added.T,
            damping=square @ square.T,
        )  # fmt: skip
        table, _, _ = reaction.hull_tables([(made, hull.volume)])
        state = np.zeros(1, reaction.REACTION)
        state["velocity"], state["bias"] = rng.normal(size=(2, 6))
        flow = probes.Flow(waves, water, time)
        for sunk, at in dict(floating=0.0, under=-3.0).items():
            pose = elements.Pose(np.array([0.2, -0.1, at]), rotation)
            found[f"reaction {name} {sunk}"] = Call(
                reaction.hull_reaction,
                row(table),
                rows(made.surface),
                rows(made.probes),
                flow,
                pose,
                0.01,
                0.005,
                state,
            )
    found |= patch_cases(rng, rotation) | linear_cases(rng, rotation, position)
    arm = rng.normal(size=3)
    found["twist"] = Call(native.twist_at, rng.normal(size=6), arm, rotation, np.zeros(6))
    found["growth"] = Call(gerstner.growth, row(some_waves(ramp=8.0).components[:1]), 2.0)
    return found


def patch_cases(rng, rotation) -> dict[str, Call]:
    sea = some_waves()
    method = Patches(bunny(), sea)
    whole = tree.joined([method.tree])
    tables = tree.PatchTree(*map(rows, whole))
    positions = np.array([[0.1, 0.2, 0.05]])
    chosen, found = method._polynomials(positions, rotation.reshape(1, 9), 0.7)
    found = found.astype(polynomial.POLYNOMIAL)
    nearest, deepest = np.abs(found["head"]).argsort()[:3], found["head"].argmax()
    cut, radii = found["head"][nearest], whole.patches["radius"][chosen["patch"]]
    assert (np.abs(cut) < 0.5 * radii[nearest]).all()  # so their leaves are opened
    assert found["head"][deepest] > radii[deepest]  # so its nodes are wet
    nodes = {}
    for i in (*nearest, deepest):
        patch = whole.patches[chosen["patch"][i]]
        nodes[f"nodes of patch {i}"] = Call(
            patches.add_nodes, int(patch["first"]), int(patch["end"]), float(patch["radius"]),
            tables, rows(found[i : i + 1]), 0, np.zeros((1, 6)),
        )  # fmt: skip
    n, rotations = 5, np.array([rotation])
    each = np.zeros(n, patches.CHOSEN)
    head_jet, jet = np.zeros(1, head_jets.HEAD_JETS), np.zeros(n, jets.JET)
    for table in (head_jet, jet):
        for name in table.dtype.names:
            table[name] = rng.normal(size=table[name].shape)
    out = rows(np.zeros(n, polynomial.POLYNOMIAL))
    return {
        "head polynomials": Call(
            polynomial.head_polynomials, rows(jet), rng.normal(size=n), rows(each), rotations, out
        ),
        "decayed polynomials": Call(
            polynomial.decayed_polynomials, rows(head_jet), rows(each), rotations, out
        ),
        "head and slope": Call(polynomial.head_and_slope, rng.normal(size=20), 0.1, 0.2, -0.3),
        **nodes,
    }  # fmt: skip


def linear_cases(rng, rotation, position) -> dict[str, Call]:
    hull = bunny()
    vertices, faces, shape = linear.surface_tables(hull)
    surface = linear.Surface(rows(vertices), rows(faces), shape)
    heads = rng.normal(size=len(vertices))
    sums, numbers = rng.normal(size=6), rng.normal(size=3)
    return {
        "wet vertices": Call(linear.add_wet_vertices, rows(vertices), heads, 0.1, np.zeros(6)),
        "dry faces": Call(linear.subtract_dry_parts, surface, heads, np.zeros(6)),
        "above": Call(linear.is_above, 0.2, shape, position, rotation),
        "turned": Call(linear.write_turned, sums, rotation, 3.0, np.zeros(6)),
        "placed": Call(linear.placed, *map(float, numbers), position, rotation),
        "cross": Call(linear.cross, *map(float, rng.normal(size=6))),
    }


CASES = list(cases())


@cache
def translated() -> tuple[dict[str, Call], Translator, dict[str, object]]:
    """All calls, and their kernels in one module."""
    calls, translator = cases(), Translator(Flavour())
    lines = {name: call.lines(translator, 0) for name, call in calls.items()}
    text = "\n".join(
        f"if (which == {i}) {{ {' '.join(body)} }}" for i, body in enumerate(lines.values())
    )
    module = wp.get_module("test_translation")
    module.options["enable_backward"] = False

    @wp.func_native(programs.INLINE + translator.text + text)
    def run(
        which: int,
        at: wp.array[wp.uint64],
        results: wp.array[wp.float64],
    ): ...

    @wp.kernel(module=module)
    def call(
        which: int,
        at: wp.array[wp.uint64],
        results: wp.array[wp.float64],
    ):
        run(which, at, results)

    return calls, translator, {name: (call, i) for i, name in enumerate(calls)}


@pytest.mark.parametrize("name", CASES)
def test_translation_gives_what_numba_gives(name):
    calls, _, kernels = translated()
    call, (kernel, number) = calls[name], kernels[name]
    theirs, ours = ([copied(each) for each in call.arguments] for _ in range(2))
    expected = call.function(*map(plain, theirs))
    addresses = [a.ctypes.data for each in ours for a in arrays_of(each)]
    results = wp.zeros(16, dtype=wp.float64, device="cpu")
    at = wp.array(addresses or [0], dtype=wp.uint64, device="cpu")
    wp.launch(kernel, dim=1, inputs=[number, at, results], device="cpu")
    found = results.numpy()[: np.size(expected)] if expected is not None else np.zeros(0)
    pairs = [(np.atleast_1d(np.asarray(expected, dtype=float)), found)] if len(found) else []
    for one, other in zip(theirs, ours, strict=True):
        for a, b in zip(arrays_of(one), arrays_of(other), strict=True):
            pairs += zip(numbers_of(a), numbers_of(b), strict=True)
    for a, b in pairs:
        scale = max(1.0, float(np.abs(a[np.isfinite(a)]).max(initial=0.0)))
        np.testing.assert_allclose(b, a, rtol=0.0, atol=ROUND_OFF * scale)


def test_every_translated_function_is_tested():
    programs.programs(1)
    _, translator, _ = translated()
    used = set().union(*(source.translator.sources for source in programs.SOURCES))
    used = {name for name in used if not name.startswith(threads.__name__)}
    assert used
    assert used <= set(translator.sources)


def chained(x):
    return 0.0 < x < 1.0


def unknown(x):
    return np.cbrt(x)


def generic(x):
    return [x]


def not_from_zero(surface, sums_out):
    total = 1.0
    for i in range(elements.ELEMENTS):
        total += surface.x[i]
    sums_out[0] = total


@pytest.mark.parametrize(
    ("function", "kinds", "line"),
    [(chained, ("real",), "a chain"), (unknown, ("real",), "np.cbrt"), (generic, ("real",), "[x]")],
)
def test_refuses_what_it_does_not_understand(function, kinds, line):
    first = function.__code__.co_firstlineno + 1
    with pytest.raises(TranslationError) as refused:
        Translator(Flavour()).add(function, *kinds)
    assert f"{function.__module__}.{function.__name__}, line {first}" in str(refused.value)
    assert line in str(refused.value)


def test_refuses_a_shared_sum_that_does_not_start_at_zero():
    translator = Translator(Flavour(shared="elements.ELEMENTS"))
    surface = translator.record(name_of(elements.SURFACE), elements.SURFACE)
    with pytest.raises(TranslationError, match="total of a shared loop does not start at 0"):
        translator.add(not_from_zero, surface, Fixed("real", (6,)))
