"""Scene: an MJCF file as something that can be stepped: model, data and buoyancy."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sim.coupling.buoyancy import Buoyancy
from sim.coupling.faults import ModelError, say
from sim.coupling.floats import first_state
from sim.coupling.hydrostatics import notes_about_start


@dataclass(frozen=True)
class Scene:
    """A model, its state and the water's push on it; `name` titles recordings and reports."""

    name: str
    model: mujoco.MjModel
    data: mujoco.MjData
    buoyancy: Buoyancy

    @classmethod
    def load(
        cls,
        path: str | Path,
        method: str | None = None,
        *,
        densities: Mapping[str, float] | None = None,
        **overrulings: Any,
    ) -> "Scene":
        """Compile an MJCF file and put it into a keyframe, by its name, or the first one, if it has
        one.

        What overrules the file: densities [kg/m^3] of geoms by their names, and all that
        `from_model` takes. Raises FileNotFoundError, or ModelError with all that is wrong with the
        file; warns by a Note of what is likely not meant, and of bodies that will not stay as they
        start.
        """
        path = Path(path)
        model = _compiled(path, densities or {})
        try:
            return cls.from_model(model, path.stem, method, folder=path.parent, **overrulings)
        except ModelError as error:
            raise error.located(str(path)) from None
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        name: str = "scene",
        method: str | None = None,
        *,
        timestep: float | None = None,
        keyframe: str | None = None,
        **overrulings: Any,
    ) -> "Scene":
        """The same for a model that is compiled already; `timestep` [s] is written into it. Method
        and others (tolerance, threads, pressure, settings, folder) are those of
        `Buoyancy.from_model`."""
        if timestep is not None:
            if not (np.isfinite(timestep) and timestep > 0):
                raise ValueError(f"the timestep is {timestep} s; it must be finite and above 0")
            model.opt.timestep = timestep
        buoyancy = Buoyancy.from_model(model, method, keyframe=keyframe, **overrulings)
        data = first_state(model, keyframe)
        mujoco.mj_forward(model, data)
        scene = cls(name, model, data, buoyancy)
        say(notes_about_start(scene))
        return scene

    def compile_kernels(self) -> None:
        """Compute the water's wrenches once, on a state of its own: the first call compiles the
        kernels, which would else happen, and count, in the first steps."""
        spare = mujoco.MjData(self.model)
        with self.buoyancy.installed():
            mujoco.mj_forward(self.model, spare)
        self.buoyancy.reset_clock()


def _compiled(path: Path, densities: Mapping[str, float]) -> mujoco.MjModel:
    """The model of an MJCF file, geoms of other densities in it. Raises ValueError, OSError."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no scene file {path}; give the path of an MJCF file")
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise ValueError(f"{path}: MuJoCo opens only names in UTF-8; rename it") from None
    try:
        if not densities:
            return mujoco.MjModel.from_xml_path(str(path))
        spec = mujoco.MjSpec.from_file(str(path))
        _make_dense(spec, densities)
        return spec.compile()
    except ModelError as error:
        raise error.located(str(path)) from None
    except ValueError as error:
        reason = " ".join(str(error).split())  # MuJoCo's message has several lines
        raise ValueError(f"{path}: MuJoCo cannot compile it: {reason}") from None


def _make_dense(spec: mujoco.MjSpec, densities: Mapping[str, float]) -> None:
    """Give geoms other densities [kg/m^3]. Raises ModelError."""
    for name, density in densities.items():
        geom = spec.geom(name)
        if geom is None:
            known = ", ".join(f"'{g.name}'" for g in spec.geoms if g.name)
            raise ModelError([f"density: there is no geom '{name}'; the scene has {known}"])
        if geom.parent.explicitinertial:
            raise ModelError(
                [f"density: the body of geom '{name}' has an <inertial> of its own; take it away"]
            )
        geom.density, geom.mass = density, np.nan  # NaN: by the density
