"""Reading: makes the sea and the floats of a compiled model, and collects all faults.

The custom elements of the model describe the water (see `fields`). Mass, inertia, joints, keyframes
and the timestep are MuJoCo's.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.methods import Method, Settings, make_method
from sim.mjcf.checks import check_physics, check_solver
from sim.mjcf.drag_fields import DragFields
from sim.mjcf.elements import (
    check_geoms,
    custom_names,
    notes_about_names,
    numbers_of,
    numerics_of,
    of_geom,
    prefixes_of,
    texts_of,
)
from sim.mjcf.faults import Faults
from sim.mjcf.fields import (
    CONVEX,
    CUT,
    HULL,
    METHOD,
    OVERLAP,
    TOLERANCE,
    names_file,
)
from sim.mjcf.floats import FloatingGeom, Listed, first_state, listed_geoms
from sim.mjcf.geoms import geom_hull
from sim.mjcf.notes import notes_about_matrices, notes_about_sizes
from sim.mjcf.overlaps import Shape, cut_shapes, united_shapes
from sim.mjcf.response_fields import (
    Size,
    bodies_with_responses,
    check_response,
    file_response,
    memory_response,
    notes_about_response,
)
from sim.mjcf.sea_fields import sea_of
from sim.resistance.response import Response
from sim.water.sea import Sea

Numerics = dict[str, NDArray[np.float64]]

DEFAULT_METHOD = "patches"

Stamp = tuple[str, int, int] | None


class Floating(NamedTuple):
    """The content of a model: the sea, the floats, the responses of bodies, whether MuJoCo's
    pictures show the water, notes about hulls and waves, and the stamps of the files that were
    read, by name."""

    sea: Sea
    floats: tuple[FloatingGeom, ...]
    responses: tuple[Response, ...]
    is_drawn: bool
    notes: tuple[str, ...]
    files: Mapping[str, Stamp]


@dataclass(frozen=True)
class Section:
    """The model itself or an attached model: the prefix of its names, its fields, and the geoms of
    its tuple `buoyant`."""

    prefix: str
    numerics: Numerics
    texts: dict[str, str]
    listed: list[Listed]


def stamp_of(name: str) -> Stamp:
    """Path, time of writing and size of a file, which identify its content; None without a file."""
    path = Path(name).absolute()
    try:
        status = path.stat()
    except OSError:
        return None
    return str(path), status.st_mtime_ns, status.st_size


def read_model(model: mujoco.MjModel) -> Floating:
    """The sea and the floating geoms of a compiled model. Raises ModelError with all faults, each
    with its element and its remedy."""
    faults, notes = Faults(), [*notes_about_names(model)]
    check_physics(model, faults)
    with faults.collected():
        first_state(model)
    sections = list(_sections(model, faults))
    files = {
        content: stamp_of(content)
        for section in sections
        for name, content in section.texts.items()
        if names_file(name)
    }
    sea = sea_of(
        model, [(section.prefix, section.numerics, section.texts) for section in sections], faults
    )
    shapes = [shape for section in sections for shape in _shapes(model, section, faults, notes)]
    if all(numbers_of("buoyancy_union", section.numerics)[0] for section in sections):
        shapes, union_notes = united_shapes(model, shapes)
        notes += union_notes
    shapes, cut_notes = cut_shapes(model, shapes)
    notes += cut_notes
    floats, responses = [], []
    if sea is not None:
        responses, response_notes = _responses(model, sea, sections, shapes, faults)
        notes += response_notes
        filed = _bodies_with_files(responses)
        free = [shape for shape in shapes if model.geom_bodyid[shape.geoms[0]] not in filed]
        notes += notes_about_matrices(model, free)
        floats = list(_floats(model, sea, shapes, responses, faults))
        if responses or any(f.drag for f in floats):
            with faults.collected():
                check_solver(model)
        notes += notes_about_sizes(sea, [(shape.name, shape.hull) for shape in shapes])
        notes += [f"geom '{f.name}': {note}" for f in floats for note in f.method.notes]
    faults.refuse(notes)
    assert sea is not None  # without a sea there is a fault
    is_drawn = all(numbers_of("water_drawn", section.numerics)[0] for section in sections)
    return Floating(sea, tuple(floats), tuple(responses), is_drawn, tuple(notes), files)


def _sections(model: mujoco.MjModel, faults: Faults) -> Iterator[Section]:
    """The sections of a model."""
    sections = []
    for prefix in prefixes_of(custom_names(model, mujoco.mjtObj.mjOBJ_TUPLE)):
        numerics, texts = numerics_of(model, prefix, faults), texts_of(model, prefix, faults)
        section = Section(prefix, numerics, texts, listed_geoms(model, prefix, faults))
        if section.listed or prefix or numerics or texts:
            sections.append(section)
    if not any(section.listed for section in sections) and not faults.found:
        with faults.collected():
            raise ValueError(
                "nothing floats: there is no custom tuple 'buoyant'; add <tuple name=\"buoyant\">"
                '<element objtype="geom" objname="..."/></tuple> to <custom>, or name a body: '
                "--buoyant BODY, or in Python add_water or Scene.load(buoyant=...)"
            )
    yield from sections


def _shapes(
    model: mujoco.MjModel, section: Section, faults: Faults, notes: list[str]
) -> Iterator[Shape]:
    """The hulls of a section's geoms, with the fields that apply to them."""
    if section.listed:
        all_names = [listed.names for listed in section.listed]
        check_geoms("text", section.texts, all_names, faults)
        check_geoms("numeric", section.numerics, all_names, faults)
    hulls: dict[tuple[object, ...], Hull] = {}
    for geom, names in section.listed:
        with faults.collected():
            texts = section.texts
            is_convex = texts.get(of_geom(HULL, names, texts)) == CONVEX
            kind, mesh = int(model.geom_type[geom]), int(model.geom_dataid[geom])
            key = kind, mesh, is_convex, *model.geom_size[geom]
            if key not in hulls:
                hulls[key], hull_notes = geom_hull(model, geom, is_convex)
                notes += hull_notes
            yield Shape(
                (geom,),
                names[0],
                hulls[key],
                *_method_of(names, texts),
                _settings_of(names, section.numerics),
                DragFields.of(names, section.numerics),
                *numbers_of("displaced", section.numerics, names),
                is_cut=texts.get(of_geom(OVERLAP, names, texts)) == CUT,
            )


def _method_of(names: Sequence[str], texts: Mapping[str, str]) -> tuple[str, str]:
    """The element that names a geom's method, and the name of the method."""
    name = of_geom(METHOD, names, texts)
    if name in texts:
        return f"custom text '{name}'", texts[name]
    return "the default method", DEFAULT_METHOD


def _settings_of(names: Sequence[str], numerics: Numerics) -> Settings:
    """The settings of a geom's method."""
    tolerance = numerics.get(of_geom(TOLERANCE, names, numerics))
    (samples,) = numbers_of("chord_samples", numerics)
    (reference_tolerance,) = numbers_of("reference_tolerance", numerics)
    return Settings(
        None if tolerance is None else float(tolerance[0]), int(samples), reference_tolerance
    )


def _responses(
    model: mujoco.MjModel, sea: Sea, sections: Sequence[Section], shapes: Sequence[Shape],
    faults: Faults,
) -> tuple[list[Response], list[str]]:  # fmt: skip
    """The responses of bodies that have a memory or a file of coefficients, and notes about
    them."""
    responses, notes = [], []
    shares = _shares_afloat(model, shapes, sea)
    bodies = [int(model.geom_bodyid[shape.geoms[0]]) for shape in shapes]
    hulls = list(zip(bodies, (shape.drag for shape in shapes), strict=True))
    for section in sections:
        fields = section.numerics, section.texts
        for body, memory, file in bodies_with_responses(model, section.prefix, *fields):
            with faults.collected():
                check_response(model, body, memory, file, hulls)
                own = [i for i, b in enumerate(bodies) if b == body]
                volumes = [shapes[i].displaced * shapes[i].hull.volume for i in own]
                afloat = sum(v * shares[i] for v, i in zip(volumes, own, strict=True))
                size = Size(sum(volumes), afloat, max(shapes[i].hull.length for i in own))
                drag = shapes[own[0]].drag
                if memory:
                    rows = section.numerics[memory]
                    made = memory_response(model, body, memory, rows, sea, size)
                else:
                    made = file_response(model, body, file, section.texts[file], drag, sea, size)
                responses.append(made)
                notes += notes_about_response(model, made, drag, sea)
    return responses, notes


def _bodies_with_files(responses: Sequence[Response]) -> set[int]:
    """The bodies whose matrices belong with a file of coefficients."""
    return {response.body for response in responses if not response.is_relative}


def _floats(
    model: mujoco.MjModel, sea: Sea, shapes: Sequence[Shape], responses: Sequence[Response],
    faults: Faults,
) -> Iterator[FloatingGeom]:  # fmt: skip
    """The shapes with their methods and drag. Equal hulls share one method, because methods have no
    state."""
    undamped = _bodies_with_files(responses)
    methods: dict[tuple[object, ...], Method] = {}
    seas = {1.0: sea}
    for shape in shapes:  # denser water has the effect of a larger volume
        if shape.displaced not in seas:
            seas[shape.displaced] = replace(sea, density=shape.displaced * sea.density)
    for shape, afloat in zip(shapes, _shares_afloat(model, shapes, sea), strict=True):
        with faults.collected():
            hull, geom = shape.hull, shape.geoms[0]
            surface = hull.vertices.tobytes(), hull.faces.tobytes()
            key = shape.method, shape.settings, shape.displaced, *surface
            if key not in methods:
                methods[key] = _made(shape, seas[shape.displaced])
            body = int(model.geom_bodyid[geom])
            fields = shape.drag.without_damping() if body in undamped else shape.drag
            drag = fields.made(model, geom, hull, sea, afloat)
            united = shape.geoms if len(shape.geoms) > 1 else ()
            yield FloatingGeom(
                shape.name, geom, body, methods[key], drag, shape.displaced, united, shape.is_cut
            )


def _made(shape: Shape, sea: Sea) -> Method:
    try:
        return make_method(shape.method, shape.hull, sea, shape.settings)
    except ValueError as error:
        raise ValueError(f"{shape.source}: {error}") from None


def _shares_afloat(model: mujoco.MjModel, shapes: Sequence[Shape], sea: Sea) -> list[float]:
    """The submerged share of each hull when its tree floats at rest; 1 if the tree sinks."""
    roots = [int(model.body_rootid[model.geom_bodyid[shape.geoms[0]]]) for shape in shapes]
    displaced = dict.fromkeys(roots, 0.0)
    for root, shape in zip(roots, shapes, strict=True):
        displaced[root] += sea.density * shape.displaced * shape.hull.volume
    return [min(float(model.body_subtreemass[r]) / displaced[r], 1.0) for r in roots]
