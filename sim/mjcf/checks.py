"""Checks: refuses options of a model with which the water's forces would be wrong or missing."""

from collections.abc import Iterator

import mujoco
import numpy as np

from sim.mjcf.faults import Faults

AIR_BOUNDS = {"density": 2.0, "viscosity": 1e-4}
"""Density [kg/m^3] and viscosity [Pa s] below which MuJoCo's own fluid counts as air."""


def check_physics(model: mujoco.MjModel, faults: Faults) -> None:
    """Collect a fault for each wrong option of a model."""
    for fault in _wrong_options(model):
        with faults.collected():
            raise ValueError(fault)


def _wrong_options(model: mujoco.MjModel) -> Iterator[str]:
    option, bits = model.opt, mujoco.mjtDisableBit
    for name, bound in AIR_BOUNDS.items():
        value = getattr(option, name)
        if not 0.0 <= value < bound:
            yield (
                f"option {name} is {value:g}: MuJoCo would add its own fluid forces, and the fluid "
                "would count twice; set it to 0 (the custom numeric 'water_density' is the water's)"
            )
    for name, expected in (
        ("timestep", "above 0"),
        ("impratio", "above 0"),
        ("tolerance", "0 or more"),
    ):
        value = getattr(option, name)
        if not np.isfinite(value) or value < 0.0 or (value == 0.0 and expected == "above 0"):
            yield f"option {name} is {value:g}; it must be finite and {expected}: correct it"
    checked = {*AIR_BOUNDS, "timestep", "impratio", "tolerance", "gravity"}
    for name in (n for n in dir(option) if n not in checked and not n.startswith("_")):
        value = getattr(option, name)
        if isinstance(value, float | np.ndarray) and not np.isfinite(value).all():
            yield f"option {name} is {value}; it must be finite: correct it"
    gx, gy, gz = option.gravity
    if gx != 0.0 or gy != 0.0 or not gz < 0.0:
        yield (
            f"option gravity is ({gx:g}, {gy:g}, {gz:g}); the water's surface needs gravity along "
            "-z, for example (0, 0, -9.81)"
        )
    if option.disableflags & int(bits.mjDSBL_GRAVITY):
        yield (
            "option flag gravity is disabled: bodies would have no weight, and the water would "
            "still push them up; enable it"
        )
    passive = int(bits.mjDSBL_SPRING) | int(bits.mjDSBL_DAMPER)
    if option.disableflags & passive == passive:
        yield (
            "option flags spring and damper are both disabled: MuJoCo then computes no passive "
            "forces, and nothing would float; enable one of them"
        )


def check_solver(model: mujoco.MjModel) -> None:
    """Refuse solvers that use the inertia matrix without drag and added mass."""
    fault = ""
    if model.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        fault = "option solver is PGS"
    elif model.opt.noslip_iterations > 0:
        fault = f"option noslip_iterations is {model.opt.noslip_iterations}"
    if fault:
        raise ValueError(
            f"{fault}: contacts would not feel drag and added mass; set solver to Newton or CG and "
            "noslip_iterations to 0"
        )
