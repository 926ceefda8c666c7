"""MJCF: what a compiled model says about water and hulls, and every refusal about a model.

A scene is one MJCF file; what concerns the water stands in its `<custom>` element, by the names at
the top of `custom_fields`. Everything else (mass, inertia, joints, initial keyframe, timestep) is
MuJoCo's own business.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling.checks import check_physics, check_solver
from sim.coupling.custom_fields import METHOD, check_geoms, numerics_of, of_geom, prefixes, texts_of
from sim.coupling.drag_fields import DragFields
from sim.coupling.faults import Faults, say
from sim.coupling.floats import FloatingGeom, Listed, first_state, listed_geoms
from sim.coupling.notes import notes_about, notes_about_sizes
from sim.coupling.numbers import NUMERICS
from sim.coupling.overlaps import Shape, notes_of_overlaps, united_shapes
from sim.coupling.primitives import geom_hull
from sim.coupling.sea_fields import sea_of
from sim.coupling.settings import Overrulings, overrule
from sim.hull import Hull
from sim.methods import Method, Settings, make_method
from sim.water.sea import Sea

Numerics = dict[str, NDArray[np.float64]]

DEFAULT_METHOD = "patches"


class Floating(NamedTuple):
    """What a model says: the sea, the geoms that float in it, and the number of threads that it
    asks for, as it stands there."""

    sea: Sea
    floats: tuple[FloatingGeom, ...]
    threads: float


@dataclass(frozen=True)
class Part:
    """A model, or one that was attached to it: the prefix of its names, its fields, its geoms."""

    prefix: str
    numerics: Numerics
    texts: dict[str, str]
    listed: list[Listed]


def read_model(model: mujoco.MjModel, overrulings: Overrulings) -> Floating:
    """The sea and the floating geoms of a compiled model, but for what is overruled.

    Raises ModelError, with all that is wrong, each with the element at fault and the remedy; warns
    by a Note of what is likely not meant.
    """
    faults, notes, start = Faults(), [], None
    check_physics(model, faults)
    with faults.collected():
        start = first_state(model, overrulings.keyframe)
    parts = list(_parts(model, overrulings.settings, faults))
    says = [(p.prefix, p.numerics, p.texts) for p in parts]
    sea = sea_of(model, says, overrulings.pressure, overrulings.folder, faults)
    method = overrulings.method
    shapes = [shape for part in parts for shape in _shapes(model, part, method, faults, notes)]
    if all(part.numerics.get("buoyancy_union", [1.0])[0] for part in parts):
        shapes, counted = united_shapes(model, shapes)
        notes += counted
    if start is not None:
        notes += notes_of_overlaps(start, shapes)
    floats = []
    if sea is not None:
        made_settings = {}
        for part in parts:
            with faults.collected():
                made_settings[part.prefix] = _read_settings(part.numerics, overrulings.tolerance)
        floats = list(_floats(model, sea, shapes, made_settings, faults))
        if any(f.drag for f in floats):
            with faults.collected():
                check_solver(model)
        notes += notes_about_sizes(sea, [(shape.name, shape.hull) for shape in shapes])
    if faults.found:
        say(notes)  # which may tell why
    faults.refuse()
    say([*notes, *notes_about(model, start, sea, floats)])
    threads = next(
        (p.numerics["buoyancy_threads"] for p in parts if "buoyancy_threads" in p.numerics), [1.0]
    )
    return Floating(sea, tuple(floats), float(threads[0]))


def _parts(model: mujoco.MjModel, settings: Iterable[str], faults: Faults) -> Iterator[Part]:
    """The model itself, with what overrules its fields, and what was attached to it with a tuple of
    its own."""
    parts = []
    for prefix in prefixes(model):
        numerics, texts = numerics_of(model, prefix, faults), texts_of(model, prefix, faults)
        if not prefix:
            overrule(settings, numerics, texts, faults)
        part = Part(prefix, numerics, texts, listed_geoms(model, prefix, faults))
        if part.listed or prefix or numerics or texts:
            parts.append(part)
    if not any(part.listed for part in parts) and not faults.found:
        with faults.collected():
            raise ValueError(
                "nothing floats: there is no custom tuple 'buoyant'; add <tuple name=\"buoyant\">"
                '<element objtype="geom" objname="..."/></tuple> to <custom>'
            )
    yield from parts


def _shapes(
    model: mujoco.MjModel, part: Part, method: str | None, faults: Faults, notes: list[str]
) -> Iterator[Shape]:
    """The hulls of a part's geoms with what its fields say of them."""
    names = [listed.names for listed in part.listed]
    if names:
        check_geoms("text", part.texts, names, faults)
        check_geoms("numeric", part.numerics, names, faults)
    made: dict[tuple[object, ...], Hull] = {}
    for geom, own in part.listed:
        with faults.collected():
            like = int(model.geom_type[geom]), int(model.geom_dataid[geom]), *model.geom_size[geom]
            if like not in made:
                made[like], found = geom_hull(model, geom)
                notes += found
            hull = made[like]
            source, text = _method_of(own, part.texts, method)
            drag = DragFields.of(own, part.numerics)
            yield Shape(
                (geom,),
                own[0],
                hull,
                source,
                text,
                drag,
                _displaced(own, part.numerics),
                part.prefix,
            )


def _method_of(
    names: Sequence[str], texts: Mapping[str, str], overruling: str | None
) -> tuple[str, str]:
    """Who says which method a geom has, and what: the caller, else the geom's own text, else the
    scene's, else the default."""
    if overruling is not None:
        return "the method asked for", overruling
    name = of_geom(METHOD, names, texts)
    if name in texts:
        return f"custom text '{name}'", texts[name]
    return "the default method", DEFAULT_METHOD


def _displaced(names: Sequence[str], numerics: Numerics) -> float:
    """The volume that a geom displaces, over that of its hull."""
    return float(numerics.get(of_geom("displaced", names, numerics), [1.0])[0])


def _read_settings(numerics: Numerics, tolerance: float | None) -> Settings:
    if tolerance is not None:
        NUMERICS["buoyancy_tolerance"].check([tolerance])
    elif "buoyancy_tolerance" in numerics:
        tolerance = float(numerics["buoyancy_tolerance"][0])
    samples = int(numerics.get("chord_samples", [Settings.chord_samples])[0])
    return Settings(tolerance=tolerance, chord_samples=samples)


def _floats(
    model: mujoco.MjModel,
    sea: Sea,
    shapes: Sequence[Shape],
    settings: dict[str, Settings],
    faults: Faults,
) -> Iterator[FloatingGeom]:
    """The shapes with their methods and drag. Equal hulls share a method, which has no state."""
    known: dict[tuple[object, ...], Method] = {}
    seas = {1.0: sea}
    for shape in shapes:  # a denser water pushes as a larger volume does
        if shape.displaced not in seas:
            seas[shape.displaced] = replace(sea, density=shape.displaced * sea.density)
    for shape, afloat in zip(shapes, _shares_afloat(model, shapes, sea), strict=True):
        with faults.collected():
            if shape.prefix not in settings:
                continue
            hull, geom = shape.hull, shape.geoms[0]
            same = (
                shape.method,
                shape.displaced,
                shape.prefix,
                hull.vertices.tobytes(),
                hull.faces.tobytes(),
            )
            if same not in known:
                known[same] = _made(shape, seas[shape.displaced], settings[shape.prefix])
            drag = shape.drag.made(model, geom, hull, sea, afloat)
            body = int(model.geom_bodyid[geom])
            united = shape.geoms if len(shape.geoms) > 1 else ()
            yield FloatingGeom(shape.name, geom, body, known[same], drag, shape.displaced, united)


def _made(shape: Shape, sea: Sea, settings: Settings) -> Method:
    try:
        return make_method(shape.method, shape.hull, sea, settings)
    except ValueError as error:
        raise ValueError(f"{shape.source}: {error}") from None


def _shares_afloat(model: mujoco.MjModel, shapes: Sequence[Shape], sea: Sea) -> list[float]:
    """How much of each hull is submerged when its tree is afloat at rest: 1 if it sinks."""
    roots = [int(model.body_rootid[model.geom_bodyid[shape.geoms[0]]]) for shape in shapes]
    displaced = dict.fromkeys(roots, 0.0)
    for root, shape in zip(roots, shapes, strict=True):
        displaced[root] += sea.density * shape.displaced * shape.hull.volume
    return [min(float(model.body_subtreemass[r]) / displaced[r], 1.0) for r in roots]
