"""Layout: where MuJoCo's C structs keep what the water reads, as offsets in bytes.

They follow from the declarations that MuJoCo gives of itself, by the rules of C, and are
held against a model and a state whose arrays are known before anything relies on them.
"""

import ctypes
from functools import cache

import mujoco
from mujoco.introspect import ast_nodes, structs

from sim.kernels import record

OPTIONS = ("timestep", "gravity")
MODEL = (
    "narena", "signature", "M_rownnz", "M_rowadr", "body_inertia", "geom_size", "geom_dataid",
    "geom_pos", "geom_quat", "mesh_vert", "numeric_data", "text_data", "tuple_objid",
)  # fmt: skip
DATA = (
    "time", "qvel", "xfrc_applied", "xipos", "ximat", "geom_xpos", "geom_xmat", "subtree_com",
    "cvel", "cdof", "cdof_dot", "M",
)  # fmt: skip
"""The fields that kernels read, of mjOption, mjModel and mjData."""

LAYOUT = record(**{name: "i8" for name in OPTIONS + MODEL + DATA})
"""The offsets in bytes; those of options count from where the model begins."""

SIZES = {
    "int": 4, "float": 4, "char": 1, "mjtNum": 8, "mjtByte": 1, "mjtBool": 1, "mjtSize": 8,
    "size_t": 8, "uint64_t": 8, "int64_t": 8, "uintptr_t": 8, "uint32_t": 4, "unsigned int": 4,
    "unsigned char": 1, "double": 8,
}  # fmt: skip
"""Bytes of the plain types; enumerations are ints."""

PROBE = """
<mujoco>
  <custom>
    <numeric name="n" data="1"/><text name="t" data="t"/>
    <tuple name="u"><element objtype="geom" objname="g" prm="0"/></tuple>
  </custom>
  <asset><mesh name="m" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
  <worldbody><body><freejoint/><geom name="g" type="mesh" mesh="m"/></body></worldbody>
</mujoco>"""
"""A model in which no field that we read is empty."""


def offsets() -> dict[str, int]:
    """The offset of each of our fields, whose places are as declared. Raises RuntimeError where
    they are not."""
    found = _declared()
    wrong = [name for name in found if not _is_there(name, found[name])]
    if wrong:
        raise RuntimeError(
            f"MuJoCo {mujoco.__version__} keeps {', '.join(wrong)} elsewhere than it declares"
        )
    return found


@cache
def _declared() -> dict[str, int]:
    model, data = _fields("mjModel"), _fields("mjData")
    options = _fields("mjOption")
    return (
        {name: model["opt"] + options[name] for name in OPTIONS}
        | {name: model[name] for name in MODEL}
        | {name: data[name] for name in DATA}
    )


def _fields(struct: str) -> dict[str, int]:
    """Offset of every field of a struct."""
    places, at = {}, 0
    for field in structs.STRUCTS[struct].fields:
        size, alignment = _extent(field.type)
        at = -(-at // alignment) * alignment
        places[field.name] = at
        at += size
    return places


def _extent(kind: object) -> tuple[int, int]:
    """Size and alignment of a type."""
    if isinstance(kind, ast_nodes.PointerType):
        return 8, 8
    if isinstance(kind, ast_nodes.ArrayType):
        size, alignment = _extent(kind.inner_type)
        for count in kind.extents:
            size *= count
        return size, alignment
    if isinstance(kind, ast_nodes.ValueType) and kind.name not in structs.STRUCTS:
        size = SIZES.get(kind.name, 4)
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
    model = mujoco.MjModel.from_xml_string(PROBE)
    model.opt.timestep, model.opt.gravity[:] = 0.0123, (0.25, 0.5, -7.75)
    data = mujoco.MjData(model)
    data.time = 1234.5
    return model, data


def _is_there(name: str, offset: int) -> bool:
    """Whether a field of the example is where it should be."""
    model, data = _example()
    owner = data if name in DATA else model
    place = (data if name in DATA else model)._address + offset
    value = getattr(model.opt if name in OPTIONS else owner, name)
    if name == "gravity":
        return ctypes.string_at(place, 24) == value.tobytes()
    if name in ("signature", "narena"):
        return ctypes.c_uint64.from_address(place).value == value % 2**64
    if isinstance(value, float):
        return ctypes.c_double.from_address(place).value == value
    if isinstance(value, bytes):
        return ctypes.string_at(ctypes.c_int64.from_address(place).value, len(value)) == value
    return ctypes.c_int64.from_address(place).value == value.ctypes.data
