"""Layout: byte offsets of the fields of MuJoCo's C structs that the plugin reads.

The offsets follow from MuJoCo's own declarations (`mujoco.introspect`) by the rules of C. Before
they are used, they are checked against a model and a state whose arrays are known.
"""

import ctypes
from copy import copy
from functools import cache
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.introspect import ast_nodes, structs

from sim.kernels import record

OPTION_FIELDS = ("timestep", "integrator", "disableflags")
MODEL_FIELDS = (
    "nbody", "nnumeric", "nplugin", "M_rownnz", "M_rowadr", "M_colind", "body_inertia",
    "body_weldid", "numeric_size", "plugin", "plugin_stateadr", "nsensor", "sensor_plugin",
    "sensor_objid", "sensor_adr", "sensor_objtype", "ntextdata", "text_data", "plugin_statenum",
    "nnames", "names", "nnumericdata", "ntext", "name_numericadr", "name_textadr",
)  # fmt: skip
DATA_FIELDS = (
    "time", "qvel", "xfrc_applied", "xipos", "ximat", "geom_xpos", "geom_xmat", "subtree_com",
    "cvel", "cdof", "cdof_dot", "M", "plugin_data", "plugin_state", "site_xpos", "sensordata",
    "xpos", "xmat",
)  # fmt: skip
"""Fields of mjOption, mjModel and mjData that are read by their offsets."""

LAYOUT = record(**{name: "i8" for name in OPTION_FIELDS + MODEL_FIELDS + DATA_FIELDS})
"""The offsets in bytes; offsets of options are relative to the start of the mjModel."""

CONTENT_FIELDS = (
    "names", "body_parentid", "body_rootid", "body_weldid", "body_mocapid", "body_jntnum",
    "body_dofnum", "body_geomnum", "body_simple", "jnt_type", "jnt_bodyid", "geom_type",
    "geom_contype", "geom_conaffinity", "geom_bodyid", "geom_dataid", "geom_size", "geom_pos",
    "geom_quat", "mesh_vertnum", "mesh_facenum", "mesh_vert", "mesh_face", "numeric_size",
    "numeric_data", "text_size", "text_data", "tuple_size", "tuple_objtype", "tuple_objid",
)  # fmt: skip
"""Arrays of a model from which hulls, waves and settings are made, besides the options."""

MATRIX_FIELDS = ("body_mass", "body_ipos", "body_iquat", "jnt_axis")
"""Further arrays that matter if added mass or damping is given as a matrix."""

CUT_FIELDS = ("body_pos", "body_quat")
"""Further arrays that matter if hulls are cut where they overlap."""

TYPE_SIZES = {
    "int": 4, "float": 4, "char": 1, "mjtNum": 8, "mjtByte": 1, "mjtBool": 1, "mjtSize": 8,
    "size_t": 8, "uint64_t": 8, "int64_t": 8, "uintptr_t": 8, "uint32_t": 4, "unsigned int": 4,
    "unsigned char": 1, "double": 8,
}  # fmt: skip
"""Bytes of the plain C types. All other types without declared fields are enumerations, 4 bytes."""

PROBE_MODEL = """
<mujoco>
  <extension>
    <plugin plugin="waterline"><instance name="w"/></plugin><plugin plugin="waterline.gauge"/>
  </extension>
  <custom>
    <numeric name="n" data="1"/><numeric name="m" data="1 2 3"/>
    <numeric name="l" data="1"/><text name="t" data="t"/>
    <tuple name="u"><element objtype="geom" objname="g" prm="0"/></tuple>
  </custom>
  <asset><mesh name="m" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
  <worldbody>
    <body><freejoint/><geom name="g" type="mesh" mesh="m"/><site name="s"/></body>
  </worldbody>
  <sensor>
    <plugin plugin="waterline.gauge" objtype="site" objname="s"/>
    <plugin plugin="waterline.gauge" objtype="site" objname="s"/>
  </sensor>
</mujoco>"""
"""A model in which none of the fields that are read is empty."""


class Span(NamedTuple):
    """An array of a model: offsets of its pointer and of its number of rows, and bytes per row."""

    pointer: int
    counter: int
    row_size: int


@cache
def offsets() -> dict[str, int]:
    """The offsets of LAYOUT by field. Raises RuntimeError where a field is not where it is
    declared."""
    found = _declared()
    content = [(name, span.pointer) for name, span in content_spans().items()]
    wrong = [name for name, place in (*found.items(), *content) if not _is_there(name, place)]
    if wrong:
        raise RuntimeError(
            f"MuJoCo {mujoco.__version__} keeps {', '.join(wrong)} elsewhere than it declares"
        )
    return found


def declared(name: str) -> int:
    """The declared offset of a field of LAYOUT, unchecked: no model can be compiled yet."""
    return _declared()[name]


@cache
def content_spans() -> dict[str, Span]:
    """The arrays CONTENT_FIELDS, MATRIX_FIELDS and CUT_FIELDS of a model by name."""
    places = _fields("mjModel")
    kinds = {field.name: field for field in structs.STRUCTS["mjModel"].fields}
    found = {}
    for name in CONTENT_FIELDS + MATRIX_FIELDS + CUT_FIELDS:
        counter, *extents = kinds[name].array_extent
        size, _ = _extent(kinds[name].type.inner_type)
        found[name] = Span(places[name], places[counter], size * int(np.prod(extents)))
    return found


@cache
def option_spans() -> list[tuple[int, int]]:
    """(first byte, number of bytes) of the options in a model that hulls and waves depend on.

    These are all options but the timestep and `disableflags`, which `native.content_of` reads.
    """
    places, last = _fields("mjOption"), structs.STRUCTS["mjOption"].fields[-1]
    start, end = _fields("mjModel")["opt"], places[last.name] + _extent(last.type)[0]
    flags = places["disableflags"]
    return [
        (start + first, end - first)
        for first, end in ((places["impratio"], flags), (flags + 4, end))
    ]


@cache
def _declared() -> dict[str, int]:
    model, data = _fields("mjModel"), _fields("mjData")
    options = _fields("mjOption")
    return (
        {name: model["opt"] + options[name] for name in OPTION_FIELDS}
        | {name: model[name] for name in MODEL_FIELDS}
        | {name: data[name] for name in DATA_FIELDS}
    )


def take_over(model: mujoco.MjModel, source: int) -> None:
    """Copy all numbers of the mjModel at an address into a model of the same structure.

    A world of a `mujoco.batch` has some arrays of its own and MuJoCo cannot copy it.
    """
    places, here = _fields("mjModel"), model._address
    options = _extent(ast_nodes.ValueType("mjOption"))[0]
    ctypes.memmove(here + places["opt"], source + places["opt"], options)
    for field in structs.STRUCTS["mjModel"].fields:
        found = getattr(model, field.name, None)
        if field.array_extent is None or found is None:
            continue
        size = len(found) if isinstance(found, bytes) else found.nbytes
        to, start = (
            ctypes.c_int64.from_address(each + places[field.name]).value for each in (here, source)
        )
        if size and isinstance(field.type, ast_nodes.PointerType):
            ctypes.memmove(to, start, size)


def without_plugin(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of a model that has no plugin instances."""
    found = copy(model)
    ctypes.c_int32.from_address(found._address + offsets()["nplugin"]).value = 0
    return found


def picture_offsets() -> dict[str, int]:
    """Offsets in mjvScene and mjvGeom, and the size of an mjvGeom, by field of
    `picture.PICTURE`."""
    scene, geom = _fields("mjvScene"), _fields("mjvGeom")
    eye = scene["camera"] + _fields("mjvGLCamera")["pos"]
    kind = ast_nodes.ValueType("mjvGeom")
    return {
        "most": scene["maxgeom"],
        "count": scene["ngeom"],
        "geoms": scene["geoms"],
        "eye": eye,
        "geom_size": _extent(kind)[0],
        "category": geom["category"],
        "emission": geom["emission"],
        "specular": geom["specular"],
        "shadow": geom.get("castshadow", 0),  # since MuJoCo 4
    }


def _fields(struct: str) -> dict[str, int]:
    """The offset of every field of a struct."""
    places, at = {}, 0
    for field in structs.STRUCTS[struct].fields:
        size, alignment = _extent(field.type)
        at = -(-at // alignment) * alignment
        places[field.name] = at
        at += size
    return places


def _extent(kind: Any) -> tuple[int, int]:
    """Size and alignment of a type in bytes."""
    if isinstance(kind, ast_nodes.PointerType):
        return 8, 8
    if isinstance(kind, ast_nodes.ArrayType):
        size, alignment = _extent(kind.inner_type)
        for count in kind.extents:
            size *= count
        return size, alignment
    if isinstance(kind, ast_nodes.ValueType) and kind.name not in structs.STRUCTS:
        size = TYPE_SIZES.get(kind.name, 4)
        return size, size
    fields = structs.STRUCTS[kind.name].fields if hasattr(kind, "name") else kind.fields
    extents = [_extent(field.type) for field in fields]
    alignment = max(alignment for _, alignment in extents)
    size = 0
    for each, own in extents:
        size = -(-size // own) * own + each
    return -(-size // alignment) * alignment, alignment


@cache
def _example() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(PROBE_MODEL)
    model.opt.timestep, model.opt.integrator, model.opt.disableflags = 0.0123, 3, 1
    data = mujoco.MjData(model)
    data.time = 1234.5
    return model, data


def _is_there(name: str, offset: int) -> bool:
    """Whether a field of the example is at an offset."""
    model, data = _example()
    owner = data if name in DATA_FIELDS else model
    place = owner._address + offset
    value = getattr(model.opt if name in OPTION_FIELDS else owner, name)
    if isinstance(value, float):
        return ctypes.c_double.from_address(place).value == value
    if isinstance(value, int):
        return ctypes.c_int32.from_address(place).value == value
    if isinstance(value, bytes):
        return ctypes.string_at(ctypes.c_int64.from_address(place).value, len(value)) == value
    return ctypes.c_int64.from_address(place).value == value.ctypes.data
