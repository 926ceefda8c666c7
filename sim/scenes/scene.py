"""Scene: an MJCF file as something that can be stepped: model, data and buoyancy."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.mjcf.faults import ModelError, say
from sim.mjcf.floats import first_state
from sim.mjcf.notes import notes_about_places
from sim.scenes.buoyancy import Buoyancy
from sim.scenes.hydrostatics import hydrostatics, notes_about_start
from sim.scenes.spec import compiled, override, read_spec, with_plugin


@dataclass(frozen=True)
class Scene:
    """A model, its state and the water's push on it; `name` titles recordings and reports."""

    name: str
    model: mujoco.MjModel
    data: mujoco.MjData
    buoyancy: Buoyancy

    @cached_property
    def rest_heights(self) -> NDArray[np.float64]:
        """Heights (B,) [m] above the still level at which the origins of the floating bodies rest,
        found from the state in which they are first asked for. A body that sinks, or that hangs on
        another, keeps the height that it has in that state."""
        found = hydrostatics(self, with_gz=False)
        heights = self.data.xpos[self.buoyancy.bodies, 2].copy()
        for i, name in enumerate(self.buoyancy.body_names):
            if name in found and found[name].height_m is not None:
                heights[i] = found[name].height_m
        return heights - self.buoyancy.sea.level

    @classmethod
    def load(
        cls,
        source: str | Path | mujoco.MjSpec,
        method: str | None = None,
        *,
        name: str | None = None,
        densities: Mapping[str, float] | None = None,
        timestep: float | None = None,
        keyframe: str | None = None,
        **overriding: Any,
    ) -> "Scene":
        """Compile an MJCF file, or an MjSpec, and put it into a keyframe, by its name, or the first
        one, if it has one. A model without the plugin gets it; the file stays as it is.

        What overrides the model: densities [kg/m^3] of geoms by their names, the timestep [s], and
        the fields that `spec.override` takes. Raises FileNotFoundError, or ModelError with all that
        is wrong with the model; warns by a Note of what is likely not meant, and of bodies that
        will not stay as they start.
        """
        is_file = not isinstance(source, mujoco.MjSpec)
        spec = read_spec(Path(source)) if is_file else source
        name = name or (Path(source).stem if is_file else "scene")
        try:
            _make_dense(spec, densities or {})
            if timestep is not None:
                if not (np.isfinite(timestep) and timestep > 0):
                    raise ValueError(f"the timestep is {timestep} s; it must be finite and above 0")
                spec.option.timestep = timestep
            override(spec, method, **overriding)
            return cls.from_model(compiled(with_plugin(spec)), name, keyframe)
        except ModelError as error:
            raise (error.located(str(source)) if is_file else error) from None
        except ValueError as error:
            raise ValueError(f"{source}: {error}" if is_file else str(error)) from None

    @classmethod
    def from_model(
        cls, model: mujoco.MjModel, name: str = "scene", keyframe: str | None = None
    ) -> "Scene":
        """The same for a model that is compiled already. Raises ModelError for one without the
        plugin."""
        buoyancy = Buoyancy.of(model)
        data = first_state(model, keyframe)
        mujoco.mj_forward(model, data)
        scene = cls(name, model, data, buoyancy)
        notes = notes_about_start(scene)
        if keyframe is not None:  # the plugin has looked at the first one
            notes = [*notes_about_places(model, data, buoyancy.sea, buoyancy.floats), *notes]
        say(notes)
        return scene


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
