"""Refusals: models and versions of mujoco_warp with which the water cannot act in worlds."""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from sim.methods import Linear, Patches
from sim.mjcf.faults import ModelError
from sim.mjcf.floats import FloatingGeom

FIELDS_OF_MEMORY = ("memory_", "hydrodynamics_")
"""Prefixes of the custom fields of bodies whose water remembers or diffracts."""


def check(model: mujoco.MjModel, floats: tuple[FloatingGeom, ...], m: Any, d: Any) -> None:
    """Raise ModelError with all reasons why the water cannot act in these worlds."""
    reasons = [*_of_layout(model, m, d), *_of_options(model, m), *_of_hulls(model, floats, m)]
    reasons += _of_forces(floats, d)
    if reasons:
        raise ModelError(reasons)


def _of_layout(model: mujoco.MjModel, m: Any, d: Any) -> Iterator[str]:
    if not hasattr(getattr(m, "callback", None), "passive"):
        yield (
            "this mujoco_warp has no m.callback.passive, through which the water acts; use "
            "mujoco_warp 3.6 or later"
        )
    shape = getattr(getattr(d, "M", None), "shape", None)
    if shape != (getattr(d, "nworld", None), model.nC):
        yield (
            f"d.M of this mujoco_warp has the shape {shape}; expected (nworld, {model.nC}), the "
            "entries of M by rows; use mujoco_warp 4.0"
        )
    elif getattr(m, "nv", None) != model.nv:
        yield f"m has {m.nv} degrees of freedom and the model {model.nv}; use m = put_model(model)"


def _of_forces(floats: tuple[FloatingGeom, ...], d: Any) -> Iterator[str]:
    bodies = sorted({f.body for f in floats})
    if d.xfrc_applied.numpy()[:, bodies].any():
        yield (
            "d.xfrc_applied has forces on bodies that float: put_data copies the water's force of "
            "the MjData, which would count twice; give put_data a state of water.dry_model, and "
            "set your own forces after on_warp"
        )


def _of_options(model: mujoco.MjModel, m: Any) -> Iterator[str]:
    option, integrators = model.opt, mujoco.mjtIntegrator
    if option.integrator == integrators.mjINT_RK4:
        yield (
            "the integrator is RK4, whose stages in mujoco_warp do not move the time of the waves; "
            "use Euler or implicitfast"
        )
    discrete = getattr(integrators, "mjINT_DISCRETE", None)
    if discrete is not None and option.integrator == discrete:
        yield (
            "the integrator is DISCRETE, which uses M before the water adds to it; use Euler or "
            "implicitfast"
        )
    if option.solver == mujoco.mjtSolver.mjSOL_PGS:
        yield "the solver is PGS, which uses M before the water adds to it; use Newton or CG"
    if option.noslip_iterations > 0:
        yield "noslip_iterations uses M before the water adds to it; set it to 0"
    both = mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER
    if option.disableflags & both == both:
        yield (
            "springs and dampers are both disabled, so mujoco_warp calls no passive forces and "
            "the model is dry; enable one of them"
        )


def _of_hulls(model: mujoco.MjModel, floats: tuple[FloatingGeom, ...], m: Any) -> Iterator[str]:
    for f in floats:
        if type(f.method) not in (Patches, Linear):
            yield (
                f"the hull of geom '{f.name}' has the method {type(f.method).__name__}; expected "
                "patches or linear: set buoyancy_method"
            )
    kinds = (mujoco.mjtObj.mjOBJ_TEXT, model.ntext), (mujoco.mjtObj.mjOBJ_NUMERIC, model.nnumeric)
    names = [mujoco.mj_id2name(model, kind, i) for kind, count in kinds for i in range(count)]
    for name in filter(None, names):
        if any(part in name for part in FIELDS_OF_MEMORY):
            yield f"the field '{name}': memory and diffraction do not act in worlds; remove it"
    for name in ("geom_dataid", "geom_size"):
        values = getattr(m, name).numpy()
        if len(values) > 1 and (values != values[:1]).any():
            yield (
                f"the worlds differ in {name}, but a hull is the same in all worlds; give the "
                "worlds one shape"
            )


def check_seas(seas: list[Any], base: Any, count: int | None = None, waves: int = 0) -> None:
    """Raise ValueError for seas that these worlds cannot have. count: their number, if it is fixed;
    waves: the largest number of waves then."""
    if not seas:
        raise ValueError("there is no sea; expected one for each world, or fewer")
    if count is not None and len(seas) != count:
        raise ValueError(
            f"there are {len(seas)} seas; expected {count}, the number that on_warp was given"
        )
    for i, sea in enumerate(seas):
        for name in ("density", "gravity"):
            given, expected = getattr(sea, name), getattr(base, name)
            if not np.isclose(given, expected, rtol=1e-12):
                raise ValueError(f"sea {i} has the {name} {given:g}; the model's is {expected:g}")
        if count is not None and len(sea.waves) > waves:
            raise ValueError(
                f"sea {i} has {len(sea.waves)} waves; there is room for {waves}, the largest "
                "number that on_warp was given"
            )
