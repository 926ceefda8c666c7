"""MJCF: what a compiled model says about water and hulls, and every refusal about a model.

A scene is one MJCF file; what concerns the water stands in its `<custom>` element:

    numeric water_density             kg/m^3                           (1025, sea water)
    numeric water_level               m                                (0)
    numeric wave_<name>               amplitude m, wavelength m, heading deg, phase deg
    numeric sea_jonswap               significant height m, peak period s, gamma, heading deg,
                                      spread deg, waves, seed; all after the period may be left
                                      out (see Sea.jonswap)
    text    buoyancy_method           how wrenches are computed        (see sim.methods)
    text    buoyancy_method_<geom>    the same for one geom
    numeric buoyancy_tolerance        m of water height, for methods that take one
    numeric buoyancy_threads          threads that share the hulls   (1)
    numeric chord_samples             points of a chord, for the method chord
    numeric drag                      linear, form, friction                   (see resistance/drag)
    numeric drag_<geom>               the same for one geom
    numeric drag_angular              1/s, decay of the angular momentum
    numeric drag_angular_<geom>       the same for one geom
    numeric added_mass                6 coefficients or a 6 x 6 matrix         (see resistance/drag)
    numeric added_mass_<geom>         the same for one geom
    tuple   buoyant                   the geoms whose surface is a hull

Everything else (mass, inertia, joints, initial keyframe, timestep) is MuJoCo's own business.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.hull import Hull
from sim.methods import Method, Settings, make_method
from sim.resistance.drag import Drag, DragCoefficients
from sim.water.sea import Sea
from sim.water.spectrum import jonswap
from sim.water.wave import Wave

SEA_WATER_DENSITY = 1025.0  # kg/m^3, at 15 degrees C and 35 g/kg of salt

OWN_PREFIXES = ("water", "wave", "sea_", "buoyan", "chord_", "drag_", "added_mass")
"""Custom elements that begin so are ours: one we do not know is a typing error, not ignored."""

IRREGULAR_SEA = "sea_jonswap"

SPHERE_SUBDIVISIONS = 3
"""Of an icosahedron: 1280 faces. The surface lies within 0.3 % of the radius from the true one;
one more divides that by four and makes four times the faces."""

ROUND_SECTIONS = 64
"""Sides of a cylinder and a capsule: within 0.15 % of the radius from the true surface."""

GeomType = mujoco.mjtGeom


DEFAULT_METHOD = "patches"


@dataclass(frozen=True)
class FloatingGeom:
    """A geom that the water pushes: its name, its body's id, the method that knows its wrench, and
    its drag and added mass, if the model asks for them; the hull of both is given in the body's
    inertial frame (xipos, ximat)."""

    name: str
    body: int
    method: Method
    drag: Drag | None = None


def read_model(
    model: mujoco.MjModel, method: str | None = None, tolerance: float | None = None
) -> tuple[Sea, tuple[FloatingGeom, ...]]:
    """The sea and the floating geoms of a compiled model; `method` and `tolerance` overrule what
    it says, for all geoms.

    Raises ValueError that names the element at fault and the remedy.
    """
    _check_physics(model)
    numerics, texts = _own_numerics(model), _own_texts(model)
    sea = _read_sea(model, numerics)
    geom_ids = _buoyant_geoms(model)
    settings = _read_settings(numerics, tolerance)
    _check_geoms_of_methods(model, texts, geom_ids)
    _check_geom_numerics(model, numerics, geom_ids)
    floats = []
    known: dict[tuple[str, bytes, bytes], Method] = {}
    for g in geom_ids:
        name, hull = model.geom(g).name, _geom_hull(model, g)
        source, text = _method_of(name, texts, method)
        same = (text, hull.vertices.tobytes(), hull.faces.tobytes())  # methods have no state
        try:
            made = known.get(same) or make_method(text, hull, sea, settings)
        except ValueError as error:
            raise ValueError(f"{source}: {error}") from None
        known[same] = made
        drag = _read_drag(model, numerics, g, hull, sea)
        floats.append(FloatingGeom(name, int(model.geom_bodyid[g]), made, drag))
    return sea, tuple(floats)


def read_threads(model: mujoco.MjModel) -> float:
    """The number of threads that a model asks for, as it stands there; 1 if it does not."""
    return float(_own_numerics(model).get("buoyancy_threads", [1.0])[0])


def _check_physics(model: mujoco.MjModel) -> None:
    """Refuse options under which the water's push would be wrong or would never happen."""
    option = model.opt
    for name in ("density", "viscosity"):
        value = getattr(option, name)
        if value != 0.0:
            raise ValueError(
                f"option {name} is {value:g}: MuJoCo would add its own fluid forces and the fluid "
                "would count twice; set it to 0 (the water's density is the custom numeric "
                "'water_density')"
            )
    gx, gy, gz = option.gravity
    if gx != 0.0 or gy != 0.0 or not gz < 0.0:
        raise ValueError(
            f"option gravity is ({gx:g}, {gy:g}, {gz:g}); the water's surface needs gravity along "
            "-z, for example (0, 0, -9.81)"
        )
    bits = mujoco.mjtDisableBit
    passive = int(bits.mjDSBL_SPRING) | int(bits.mjDSBL_DAMPER)
    if option.disableflags & passive == passive:
        raise ValueError(
            "option flags spring and damper are both disabled: MuJoCo then never calls "
            "mjcb_passive and nothing would float; enable one of them"
        )


def _names(model: mujoco.MjModel, kind: mujoco.mjtObj, count: int) -> Iterator[tuple[int, str]]:
    """Index and name of the custom elements of one kind that are ours."""
    for i in range(count):
        name = mujoco.mj_id2name(model, kind, i) or ""
        if name.startswith(OWN_PREFIXES) or name == "drag":
            yield i, name


def _refuse_unknown(kind: str, name: str, known: str) -> None:
    raise ValueError(f"custom {kind} '{name}' is unknown; expected {known}: correct or rename it")


@dataclass(frozen=True)
class NumericKind:
    """What a custom numeric of ours holds: how many numbers, what they mean, and whether a geom
    may have its own ('<name>_<geom>')."""

    sizes: tuple[int, ...]
    meaning: str
    per_geom: bool = False


WAVE = NumericKind((4,), "amplitude m, wavelength m, heading deg, phase deg")

NUMERICS = {
    "water_density": NumericKind((1,), "kg/m^3"),
    "water_level": NumericKind((1,), "m"),
    IRREGULAR_SEA: NumericKind(
        (2, 3, 4, 5, 6, 7),
        "significant height m, peak period s, gamma, heading deg, spread deg, waves, seed",
    ),
    "buoyancy_tolerance": NumericKind((1,), "m of water height"),
    "buoyancy_threads": NumericKind((1,), "threads that share the hulls"),
    "chord_samples": NumericKind((1,), "points of a chord"),
    "drag_angular": NumericKind((1,), "1/s", per_geom=True),
    "drag": NumericKind((3,), "linear, form, friction", per_geom=True),
    "added_mass": NumericKind((6, 36), "coefficients, or a matrix row by row", per_geom=True),
}
"""The custom numerics we know, besides the waves; a name that begins another comes before it."""


def _numeric_kind(name: str) -> NumericKind | None:
    if name.startswith("wave_"):
        return WAVE
    base = _base_of(name)
    return None if base is None else NUMERICS[base]


def _base_of(name: str) -> str | None:
    """The known numeric that a name is, or is one geom's own of."""
    for base, kind in NUMERICS.items():
        if name == base or (kind.per_geom and name.startswith(f"{base}_")):
            return base
    return None


def _own_numerics(model: mujoco.MjModel) -> dict[str, NDArray[np.float64]]:
    found = {}
    for i, name in _names(model, mujoco.mjtObj.mjOBJ_NUMERIC, model.nnumeric):
        kind = _numeric_kind(name)
        if kind is None:
            known = [b + "[_<geom>]" * k.per_geom for b, k in NUMERICS.items()]
            _refuse_unknown("numeric", name, f"{', '.join(known)} or wave_<name>")
        values = np.array(model.numeric(i).data)
        if values.size not in kind.sizes:
            several = len(kind.sizes) > 2
            expected = (" to " if several else " or ").join(
                map(str, (kind.sizes[0], kind.sizes[-1]) if several else kind.sizes)
            )
            raise ValueError(
                f"custom numeric '{name}' has {values.size} number{'s' * (values.size != 1)}; "
                f"expected {expected}: {kind.meaning}"
            )
        found[name] = values
    return found


def _check_geom_numerics(
    model: mujoco.MjModel, numerics: dict[str, NDArray[np.float64]], geom_ids: list[int]
) -> None:
    """Refuse a geom's own numeric whose geom does not float."""
    names = [model.geom(g).name for g in geom_ids]
    for numeric in numerics:
        base = _base_of(numeric)
        if base in (None, numeric) or numeric.removeprefix(f"{base}_") in names:
            continue
        raise ValueError(
            f"custom numeric '{numeric}' names no geom of the tuple 'buoyant' "
            f"(which has {', '.join(names)}); correct the name or list the geom"
        )


def _read_drag(
    model: mujoco.MjModel,
    numerics: dict[str, NDArray[np.float64]],
    geom: int,
    hull: Hull,
    sea: Sea,
) -> Drag | None:
    """Drag and added mass of a geom: its own, else the scene's, else none."""
    name = model.geom(geom).name
    sources = {
        base: own if (own := f"{base}_{name}") in numerics else base
        for base in ("drag", "drag_angular", "added_mass")
    }
    values = {base: numerics.get(source) for base, source in sources.items()}
    strengths = np.zeros(4)
    if values["drag"] is not None:
        strengths[:3] = values["drag"]
    if values["drag_angular"] is not None:
        strengths[3] = values["drag_angular"][0]
    added_mass = values["added_mass"]
    if not strengths.any() and (added_mass is None or not added_mass.any()):
        return None
    _check_added_mass_place(model, geom, sources["added_mass"], added_mass)
    try:
        return Drag(hull, sea, DragCoefficients(*strengths), added_mass)
    except ValueError as error:
        asked = " and ".join(f"'{s}'" for s in sources.values() if s in numerics)
        raise ValueError(f"custom numeric {asked}: {error}") from None


def is_free(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body is alone on a free joint."""
    root = int(model.body_rootid[body])
    joint = int(model.body_jntadr[body])
    return (
        root == body
        and joint >= 0
        and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        and np.count_nonzero(model.body_rootid == root) == 1
    )


def _check_added_mass_place(
    model: mujoco.MjModel, geom: int, numeric: str, added_mass: NDArray[np.float64] | None
) -> None:
    body = int(model.geom_bodyid[geom])
    if added_mass is None or not added_mass.any() or is_free(model, body):
        return
    raise ValueError(
        f"custom numeric '{numeric}' gives geom '{model.geom(geom).name}' an added mass, but its "
        f"body '{model.body(body).name}' is not alone on a free joint, and what its joints carry "
        "is not known when the water's push is; give added mass to free bodies only "
        "(added_mass_<geom>), or this geom six zeros"
    )


def _own_texts(model: mujoco.MjModel) -> dict[str, str]:
    found = {}
    for i, name in _names(model, mujoco.mjtObj.mjOBJ_TEXT, model.ntext):
        if name != "buoyancy_method" and not name.startswith("buoyancy_method_"):
            _refuse_unknown("text", name, "buoyancy_method or buoyancy_method_<geom>")
        start = model.text_adr[i]
        raw = bytes(model.text_data[start : start + model.text_size[i]])
        found[name] = raw.split(b"\0")[0].decode().strip()
    return found


def _read_sea(model: mujoco.MjModel, numerics: dict[str, NDArray[np.float64]]) -> Sea:
    waves = []
    for name, values in numerics.items():
        if not name.startswith("wave_"):
            continue
        amplitude, wavelength, heading, phase = values
        try:
            waves.append(Wave(amplitude, wavelength, np.radians(heading), np.radians(phase)))
        except ValueError as error:
            raise ValueError(f"custom numeric '{name}': {error}") from None
    gravity = -float(model.opt.gravity[2])
    if IRREGULAR_SEA in numerics:
        waves += _jonswap_waves(numerics[IRREGULAR_SEA], gravity)
    density = float(numerics.get("water_density", [SEA_WATER_DENSITY])[0])
    level = float(numerics.get("water_level", [0.0])[0])
    return Sea(waves, density, gravity, level)


def _jonswap_waves(numbers: NDArray[np.float64], gravity: float) -> tuple[Wave, ...]:
    values = numbers.copy()
    values[3:5] = np.radians(values[3:5])
    try:
        return jonswap(*values.tolist(), gravity=gravity)
    except ValueError as error:
        raise ValueError(f"custom numeric '{IRREGULAR_SEA}': {error}") from None


def _buoyant_geoms(model: mujoco.MjModel) -> list[int]:
    """Ids of the geoms in the tuple 'buoyant', each on a body that can move."""
    tuples = dict((name, i) for i, name in _names(model, mujoco.mjtObj.mjOBJ_TUPLE, model.ntuple))
    for name in tuples:
        if name != "buoyant":
            _refuse_unknown("tuple", name, "buoyant")
    if "buoyant" not in tuples:
        raise ValueError(
            "nothing floats: there is no custom tuple 'buoyant'; add <tuple name=\"buoyant\">"
            '<element objtype="geom" objname="..."/></tuple> to <custom>'
        )
    elements = model.tuple(tuples["buoyant"])
    ids = []
    for kind, target in zip(elements.objtype, elements.objid, strict=True):
        if kind != mujoco.mjtObj.mjOBJ_GEOM:
            other = mujoco.mj_id2name(model, int(kind), int(target))
            raise ValueError(
                f"tuple 'buoyant' lists '{other}', which is not a geom; hulls are made from geoms: "
                'use objtype="geom"'
            )
        if target in ids:
            raise ValueError(
                f"tuple 'buoyant' lists geom '{model.geom(target).name}' twice; its buoyancy would "
                "count twice: keep one"
            )
        _check_movable(model, int(target))
        ids.append(int(target))
    return ids


def _check_movable(model: mujoco.MjModel, geom: int) -> None:
    name, body = model.geom(geom).name, int(model.geom_bodyid[geom])
    where = f"geom '{name}' belongs to body '{model.body(body).name}'"
    if body == 0:
        where = f"geom '{name}' belongs to the world body"
    if model.body_weldid[body] == 0 or model.body_mocapid[body] >= 0:
        raise ValueError(
            f"{where}, which cannot move, so nothing can float it; give its body a joint "
            "(<freejoint/>) or take it from the tuple 'buoyant'"
        )


METHOD_OF = "buoyancy_method_"


def _check_geoms_of_methods(
    model: mujoco.MjModel, texts: dict[str, str], geom_ids: list[int]
) -> None:
    names = [model.geom(g).name for g in geom_ids]
    for text in texts:
        if text.startswith(METHOD_OF) and text.removeprefix(METHOD_OF) not in names:
            raise ValueError(
                f"custom text '{text}' names no geom of the tuple 'buoyant' "
                f"(which has {', '.join(names)}); correct the name or list the geom"
            )


def _method_of(geom: str, texts: dict[str, str], overruling: str | None) -> tuple[str, str]:
    """Who says which method a geom has, and what: the caller, else the geom's own text, else the
    scene's, else the default."""
    if overruling is not None:
        return "the method asked for", overruling
    for name in (METHOD_OF + geom, "buoyancy_method"):
        if name in texts:
            return f"custom text '{name}'", texts[name]
    return "the default method", DEFAULT_METHOD


def _read_settings(numerics: dict[str, NDArray[np.float64]], tolerance: float | None) -> Settings:
    if tolerance is None and "buoyancy_tolerance" in numerics:
        tolerance = float(numerics["buoyancy_tolerance"][0])
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise ValueError(
            f"the buoyancy tolerance is {tolerance:g} m of water height; it must be finite and "
            "above 0"
        )
    samples = float(numerics.get("chord_samples", [Settings.chord_samples])[0])
    if samples != int(samples) or samples < 0:
        raise ValueError(f"custom numeric 'chord_samples' is {samples:g}; expected 0, 1, 2, ...")
    return Settings(tolerance=tolerance, chord_samples=int(samples))


def _geom_hull(model: mujoco.MjModel, geom: int) -> Hull:
    """Hull of a geom, in its body's inertial frame."""
    kind = GeomType(int(model.geom_type[geom]))
    label = f"geom '{model.geom(geom).name}'"
    if kind == GeomType.mjGEOM_MESH:
        mesh_id = int(model.geom_dataid[geom])
        vertices, faces = _mesh_surface(model, mesh_id)
        label += f" (mesh '{model.mesh(mesh_id).name}')"
    elif kind in PRIMITIVES:
        mesh = PRIMITIVES[kind](np.array(model.geom_size[geom]))
        vertices, faces = mesh.vertices, mesh.faces
    else:
        raise ValueError(
            f"{label} is a {kind.name.removeprefix('mjGEOM_').lower()}, which has no closed "
            "surface; use a mesh, box, sphere, capsule, cylinder or ellipsoid"
        )
    body = int(model.geom_bodyid[geom])
    geom_rotation = _matrix(model.geom_quat[geom])
    inertial_rotation = _matrix(model.body_iquat[body])
    in_body = vertices @ geom_rotation.T + model.geom_pos[geom]
    try:
        return Hull((in_body - model.body_ipos[body]) @ inertial_rotation, faces)
    except ValueError as error:
        raise ValueError(f"{label}: {error}") from None


def _matrix(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _mesh_surface(
    model: mujoco.MjModel, mesh: int
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and faces of a mesh asset in its geom's frame; MuJoCo keeps vertices as float32."""
    first_vertex, first_face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first_vertex : first_vertex + model.mesh_vertnum[mesh]]
    faces = model.mesh_face[first_face : first_face + model.mesh_facenum[mesh]]
    return vertices.astype(float), np.array(faces)


def _box(size: NDArray[np.float64]) -> trimesh.Trimesh:
    return trimesh.creation.box(extents=2.0 * size)


def _ellipsoid(semi_axes: NDArray[np.float64]) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
    true_volume = 4.0 / 3.0 * np.pi
    mesh.apply_scale((true_volume / mesh.volume) ** (1.0 / 3.0))
    mesh.vertices = mesh.vertices * semi_axes
    return mesh


def _sphere(size: NDArray[np.float64]) -> trimesh.Trimesh:
    return _ellipsoid(np.full(3, size[0]))


def _widened(mesh: trimesh.Trimesh, true_volume: float) -> trimesh.Trimesh:
    """Scale across the z axis until the faceted volume is the true one."""
    widening = np.sqrt(true_volume / mesh.volume)
    mesh.vertices = mesh.vertices * [widening, widening, 1.0]
    return mesh


def _cylinder(size: NDArray[np.float64]) -> trimesh.Trimesh:
    radius, half_length = size[:2]
    mesh = trimesh.creation.cylinder(
        radius=radius, height=2.0 * half_length, sections=ROUND_SECTIONS
    )
    return _widened(mesh, 2.0 * np.pi * radius**2 * half_length)


def _capsule(size: NDArray[np.float64]) -> trimesh.Trimesh:
    radius, half_length = size[:2]
    mesh = trimesh.creation.capsule(
        radius=radius, height=2.0 * half_length, count=(ROUND_SECTIONS // 2, ROUND_SECTIONS)
    )
    return _widened(mesh, np.pi * radius**2 * (2.0 * half_length + 4.0 / 3.0 * radius))


# Round primitives get facets whose corners lie slightly outside the true surface and whose middles
# lie inside, so that the volume is exact: a ball then floats as deep as its mass says.
PRIMITIVES: dict[GeomType, Callable[[NDArray[np.float64]], trimesh.Trimesh]] = {
    GeomType.mjGEOM_BOX: _box,
    GeomType.mjGEOM_SPHERE: _sphere,
    GeomType.mjGEOM_ELLIPSOID: _ellipsoid,
    GeomType.mjGEOM_CYLINDER: _cylinder,
    GeomType.mjGEOM_CAPSULE: _capsule,
}
