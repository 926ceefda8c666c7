"""MJCF: what a compiled model says about water and hulls, and every refusal about a model.

A scene is one MJCF file; what concerns the water stands in its `<custom>` element, by the names at
the top of `custom_fields`. Everything else (mass, inertia, joints, initial keyframe, timestep) is
MuJoCo's own business.
"""

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.coupling.custom_fields import (
    IRREGULAR_SEA,
    METHOD,
    PRESSURE,
    check_geoms,
    elements_of,
    numerics_of,
    of_geom,
    refuse_unknown,
    texts_of,
)
from sim.coupling.primitives import frame_rotation, geom_hull, geom_in_inertial_frame
from sim.geometry import moved_matrix
from sim.hull import Hull
from sim.methods import Method, Settings, make_method
from sim.resistance.added_mass import added_mass_matrix, damping_matrix
from sim.resistance.drag import Drag, DragCoefficients
from sim.water.sea import DEFAULT_PRESSURE, Sea
from sim.water.spectrum import jonswap
from sim.water.wave import Wave

Numerics = dict[str, NDArray[np.float64]]

SEA_WATER_DENSITY = 1025.0  # kg/m^3, at 15 degrees C and 35 g/kg of salt

DEFAULT_METHOD = "patches"


@dataclass(frozen=True)
class FloatingGeom:
    """A geom that the water pushes: its name and id, its body's id, the method that knows its
    wrench, and its drag and added mass, if the model asks for them; the hull of both is given in
    the geom's frame (geom_xpos, geom_xmat)."""

    name: str
    geom: int
    body: int
    method: Method
    drag: Drag | None = None


class Floating(NamedTuple):
    """What a model says: the sea, the geoms that float in it, and the number of threads that it
    asks for, as it stands there."""

    sea: Sea
    floats: tuple[FloatingGeom, ...]
    threads: float


def read_model(
    model: mujoco.MjModel,
    method: str | None = None,
    tolerance: float | None = None,
    pressure: str | None = None,
) -> Floating:
    """The sea and the floating geoms of a compiled model; `method`, `tolerance` and `pressure`
    overrule what it says, for all geoms. A method may name a pressure too: "patches/hydrostatic".

    Raises ValueError that names the element at fault and the remedy.
    """
    _check_physics(model)
    if method is not None and "/" in method:
        method, pressure = method.split("/", 1)
        method = method or None
    numerics, texts = numerics_of(model), texts_of(model)
    sea = _read_sea(model, numerics, pressure or texts.get(PRESSURE, DEFAULT_PRESSURE))
    geom_ids = _buoyant_geoms(model)
    settings = _read_settings(numerics, tolerance)
    names = [model.geom(g).name for g in geom_ids]
    check_geoms("text", texts, names)
    check_geoms("numeric", numerics, names)
    hulls = {g: geom_hull(model, g) for g in geom_ids}
    afloat = _shares_afloat(model, hulls, sea)
    floats = []
    known: dict[tuple[str, bytes, bytes], Method] = {}
    for g, name in zip(geom_ids, names, strict=True):
        hull = hulls[g]
        source, text = _method_of(name, texts, method)
        same = (text, hull.vertices.tobytes(), hull.faces.tobytes())  # methods have no state
        try:
            made = known.get(same) or make_method(text, hull, sea, settings)
        except ValueError as error:
            raise ValueError(f"{source}: {error}") from None
        known[same] = made
        drag = _read_drag(model, numerics, g, hull, sea, afloat[g])
        floats.append(FloatingGeom(name, g, int(model.geom_bodyid[g]), made, drag))
    if any(f.drag for f in floats):
        check_solver(model)
    threads = float(numerics.get("buoyancy_threads", [1.0])[0])
    return Floating(sea, tuple(floats), threads)


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


def check_solver(model: mujoco.MjModel) -> None:
    """Refuse solvers whose matrix of contacts is made before drag and added mass are known."""
    found = ""
    if model.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        found = "option solver is PGS"
    elif model.opt.noslip_iterations > 0:
        found = f"option noslip_iterations is {model.opt.noslip_iterations}"
    if found:
        raise ValueError(
            f"{found}: contacts would not feel drag and added mass; set solver to Newton or CG and "
            "noslip_iterations to 0"
        )


def _read_sea(model: mujoco.MjModel, numerics: Numerics, pressure: str) -> Sea:
    gravity = -float(model.opt.gravity[2])
    waves: list[Wave] = []
    for name, values in numerics.items():
        try:
            if name == IRREGULAR_SEA:
                heading_and_spread = np.radians(values[3:5])
                shape = [*values[:3], *heading_and_spread, *values[5:]]
                irregular = jonswap(*map(float, shape), gravity=gravity)
            elif name.startswith("wave_"):
                waves.append(Wave(*values[:2], *np.radians(values[2:])))
        except ValueError as error:
            raise ValueError(f"custom numeric '{name}': {error}") from None
    if IRREGULAR_SEA in numerics:
        waves += irregular
    density = float(numerics.get("water_density", [SEA_WATER_DENSITY])[0])
    level = float(numerics.get("water_level", [0.0])[0])
    return Sea(waves, density, gravity, level, pressure)


def _buoyant_geoms(model: mujoco.MjModel) -> list[int]:
    """Ids of the geoms in the tuple 'buoyant', each on a body that can move."""
    tuples = dict(
        (name, i) for i, name in elements_of(model, mujoco.mjtObj.mjOBJ_TUPLE, model.ntuple)
    )
    for name in tuples:
        if name != "buoyant":
            refuse_unknown("tuple", name, "buoyant")
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


def _method_of(geom: str, texts: dict[str, str], overruling: str | None) -> tuple[str, str]:
    """Who says which method a geom has, and what: the caller, else the geom's own text, else the
    scene's, else the default."""
    if overruling is not None:
        return "the method asked for", overruling
    name = of_geom(METHOD, geom, texts)
    if name in texts:
        return f"custom text '{name}'", texts[name]
    return "the default method", DEFAULT_METHOD


def _read_settings(numerics: Numerics, tolerance: float | None) -> Settings:
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


def _shares_afloat(model: mujoco.MjModel, hulls: dict[int, Hull], sea: Sea) -> dict[int, float]:
    """How much of each geom's hull is submerged when its tree is afloat at rest: 1 if it sinks."""
    displaced: dict[int, float] = {}
    root = {g: int(model.body_rootid[model.geom_bodyid[g]]) for g in hulls}
    for g, hull in hulls.items():
        displaced[root[g]] = displaced.get(root[g], 0.0) + sea.density * hull.volume
    masses = {r: float(model.body_subtreemass[r]) for r in displaced}
    return {g: min(masses[root[g]] / displaced[root[g]], 1.0) for g in hulls}


def _read_drag(
    model: mujoco.MjModel, numerics: Numerics, geom: int, hull: Hull, sea: Sea, afloat: float
) -> Drag | None:
    """Drag, added mass and damping of a geom: its own, else the scene's, else none. Matrices, such
    as a panel code gives, are those of the hull afloat, of which a part is submerged."""
    name = model.geom(geom).name
    bases = ("drag", "drag_angular", "added_mass", "damping")
    sources = {base: of_geom(base, name, numerics) for base in bases}
    values = {base: numerics.get(source) for base, source in sources.items()}
    if not any(value is not None and value.any() for value in values.values()):
        return None
    strengths = np.zeros(4)
    if values["drag"] is not None:
        strengths[:3] = values["drag"]
    if values["drag_angular"] is not None:
        strengths[3] = values["drag_angular"][0]
    matrices = dict.fromkeys(("added_mass", "damping"))
    in_body = geom_in_inertial_frame(model, geom)
    try:
        for base in matrices:
            given = values[base]
            if given is not None:
                share = afloat if given.size == 36 else 1.0
                matrix = _matrix_of(model, geom, hull, sea, base, given)
                matrices[base] = moved_matrix(matrix, *in_body) / share
        return Drag(hull, sea, DragCoefficients(*strengths), **matrices)
    except ValueError as error:
        asked = " and ".join(f"'{s}'" for s in sources.values() if s in numerics)
        raise ValueError(f"custom numeric {asked}: {error}") from None


def _matrix_of(
    model: mujoco.MjModel, geom: int, hull: Hull, sea: Sea, base: str, given: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Added mass or damping (6, 6) along the axes and about the origin of the inertial frame of a
    geom's body."""
    if base == "damping":
        return damping_matrix(given)
    place, turn = geom_in_inertial_frame(model, geom)
    matrix = added_mass_matrix(Hull(hull.vertices @ turn.T + place, hull.faces), sea.density, given)
    _check_room(model, int(model.geom_bodyid[geom]), matrix)
    return matrix


def moving_dofs(model: mujoco.MjModel, body: int) -> list[int]:
    """The degrees of freedom that move a body, in ascending order."""
    while body > 0 and model.body_dofnum[body] == 0:
        body = int(model.body_parentid[body])
    dof, found = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1, []
    while dof >= 0:
        found.insert(0, dof)
        dof = int(model.dof_parentid[dof])
    return found


def _check_room(model: mujoco.MjModel, body: int, matrix: NDArray[np.float64]) -> None:
    """Refuse an added mass (6, 6), in the body's inertial frame, that MuJoCo's matrix of inertia
    has no place for: of a simple body it keeps the diagonal alone."""
    if model.body_simple[body] == 0:
        return
    if model.jnt_type[model.body_jntadr[body]] == mujoco.mjtJoint.mjJNT_FREE:
        allowed = np.diag(np.diag(matrix))  # world axes for the first three, so alike along all
        allowed[:3, :3] = np.mean(np.diag(matrix)[:3]) * np.eye(3)
        rest = matrix - allowed
    else:  # slides
        axes = model.jnt_axis[model.jnt_bodyid == body] @ frame_rotation(model.body_iquat[body])
        rest = axes @ matrix[:3, :3] @ axes.T
        rest -= np.diag(np.diag(rest))
    if np.abs(rest).max() > 1e-9 * np.abs(matrix).max():
        raise ValueError(
            f"MuJoCo keeps only the diagonal of the inertia of body '{model.body(body).name}', and "
            "this added mass is not the same along all axes: put an empty <body/> inside that "
            "body, then the whole matrix has room"
        )
