"""Scene: a model with its state and its water, ready to be stepped."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.mjcf.faults import ModelError
from sim.mjcf.floats import first_state
from sim.mjcf.notes import notes_about_positions
from sim.notes import say
from sim.scenes.buoyancy import Buoyancy
from sim.scenes.hydrostatics import hydrostatics, notes_about_start
from sim.scenes.settings import Settings, override, set_sea
from sim.scenes.spec import add_water, compiled, read_spec
from sim.scenes.timestep import notes_about_timestep
from sim.water.sea import Sea


@dataclass(frozen=True)
class Scene:
    """A model, its state and its water. name: the title of recordings and reports."""

    name: str
    model: mujoco.MjModel
    data: mujoco.MjData
    buoyancy: Buoyancy

    @cached_property
    def rest_heights(self) -> NDArray[np.float64]:
        """Heights (B,) [m] above the still level at which the origins of the floating bodies rest.
        They are computed once, from the state at the first access. A body without a rest, or with a
        parent, keeps its height in that state."""
        reports = hydrostatics(self, with_gz=False)
        heights = self.data.xpos[self.buoyancy.bodies, 2].copy()
        for i, name in enumerate(self.buoyancy.body_names):
            rest = reports[name].rest if name in reports else None
            if rest is not None:
                heights[i] = rest.height_m
        return heights - self.buoyancy.sea.level

    @classmethod
    def load(
        cls,
        source: str | Path | mujoco.MjSpec,
        *,
        name: str | None = None,
        buoyant: Sequence[str] = (),
        settings: Settings = (),
        sea: Sea | None = None,
        densities: Mapping[str, float] | None = None,
        timestep: float | None = None,
        keyframe: str | None = None,
    ) -> "Scene":
        """Compile an MJCF or URDF file or an MjSpec, and put it into a keyframe.

        buoyant: names of bodies that float besides those of the file (see `add_water`). settings:
        custom fields that override the file's, as a mapping of names to numbers or texts, or as
        "NAME=VALUE" strings (see `settings`). sea: replaces the file's sea. densities [kg/m^3]: by
        the name of a geom, or of a body for its geoms that would float. timestep [s]: overrides the
        file's. keyframe: the name of the start; by default the first keyframe, if there is one.

        The file is not changed. A model without the plugin gets it. Raises FileNotFoundError, or
        ModelError with all faults. Notes warn of likely mistakes, of bodies that will not stay
        where they start, and of a timestep that is too long.
        """
        is_file = not isinstance(source, mujoco.MjSpec)
        spec = read_spec(Path(source)) if is_file else source
        name = name or (Path(source).stem if is_file else "scene")
        try:
            add_water(spec, *buoyant)
            _set_densities(spec, densities or {})
            if timestep is not None:
                if not (np.isfinite(timestep) and timestep > 0):
                    raise ValueError(f"the timestep is {timestep} s; it must be finite and above 0")
                spec.option.timestep = timestep
            if sea is not None:
                set_sea(spec, sea)
            override(spec, settings)
            return cls.from_model(compiled(spec), name, keyframe)
        except ModelError as error:
            raise (error.located(str(source)) if is_file else error) from None
        except ValueError as error:
            raise ValueError(f"{source}: {error}" if is_file else str(error)) from None

    @classmethod
    def from_model(
        cls, model: mujoco.MjModel, name: str = "scene", keyframe: str | None = None
    ) -> "Scene":
        """A scene of a compiled model. Raises ModelError for a model without the plugin."""
        buoyancy = Buoyancy.of(model)
        data = first_state(model, keyframe)
        mujoco.mj_forward(model, data)
        scene = cls(name, model, data, buoyancy)
        notes = [*notes_about_start(scene), *notes_about_timestep(scene)]
        if keyframe is not None:  # the plugin has checked the first keyframe
            notes = [*notes_about_positions(model, data, buoyancy.sea, buoyancy.floats), *notes]
        say(notes)
        return scene


def _set_densities(spec: mujoco.MjSpec, densities: Mapping[str, float]) -> None:
    """Set the densities [kg/m^3] of geoms and bodies. Raises ModelError."""
    for name, density in densities.items():
        for geom in _dense_geoms(spec, name):
            if geom.parent.explicitinertial:
                owner = f"the body '{geom.parent.name}'"
                raise ModelError([f"density: {owner} has an <inertial> of its own; remove it"])
            geom.density, geom.mass = density, np.nan  # NaN: computed from the density


def _dense_geoms(spec: mujoco.MjSpec, name: str) -> list[mujoco.MjsGeom]:
    """The geom with a name, or else the geoms of the body with that name: those of its subtree that
    collide, or all of them if none collides, as in the tuple `buoyant`."""
    geom, body = spec.geom(name), spec.body(name)
    if geom is not None:
        return [geom]
    if body is None:
        known = ", ".join(
            dict.fromkeys(f"'{e.name}'" for e in [*spec.geoms, *spec.bodies[1:]] if e.name)
        )
        raise ModelError([f"density: there is no geom or body '{name}'; the scene has {known}"])
    below = body.find_all("geom")
    return [g for g in below if g.contype or g.conaffinity] or below
