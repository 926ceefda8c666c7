"""Scene: an MJCF file as something that can be stepped: model, data and buoyancy."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from sim.coupling.buoyancy import Buoyancy
from sim.coupling.faults import ModelError, say
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
        tolerance: float | None = None,
        timestep: float | None = None,
        threads: int | None = None,
        pressure: str | None = None,
        settings: Iterable[str] = (),
        keyframe: str | None = None,
        densities: Mapping[str, float] | None = None,
    ) -> "Scene":
        """Compile an MJCF file and put it into a keyframe, by its name, or the first one, if it has
        one.

        method, tolerance, timestep [s], threads and pressure overrule what the file says, settings
        its custom fields ("wave_swell=0.2 4 0 0", see `settings`), densities [kg/m^3] those of
        geoms by their names. Raises FileNotFoundError, or ModelError with all that is wrong with
        the file; warns by a Note of what is likely not meant, and of bodies that will not stay as
        they start.
        """
        path = Path(path)
        model = _compiled(path, densities or {})
        try:
            return cls.from_model(
                model, path.stem, method, tolerance, timestep, threads, pressure, settings,
                keyframe, path.parent,
            )  # fmt: skip
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
        tolerance: float | None = None,
        timestep: float | None = None,
        threads: int | None = None,
        pressure: str | None = None,
        settings: Iterable[str] = (),
        keyframe: str | None = None,
        folder: str | Path = "",
    ) -> "Scene":
        """The same for a model that is compiled already; `timestep` is written into it. Files that
        its fields name are looked for in the folder."""
        if timestep is not None:
            if not (np.isfinite(timestep) and timestep > 0):
                raise ValueError(f"the timestep is {timestep} s; it must be finite and above 0")
            model.opt.timestep = timestep
        key = _keyframe(model, keyframe)
        buoyancy = Buoyancy.from_model(
            model, method, tolerance, threads, pressure, settings, folder
        )
        data = mujoco.MjData(model)
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, data, key)
            _check_finite(model, data, key)
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


def _keyframe(model: mujoco.MjModel, name: str | None) -> int:
    """The keyframe of a name, or the first; -1 where there is none. Raises ModelError."""
    if name is None:
        return 0 if model.nkey else -1
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, name)
    if key < 0:
        known = ", ".join(f"'{model.key(i).name}'" for i in range(model.nkey)) or "none"
        raise ModelError([f"there is no keyframe '{name}'; the scene has {known}"])
    return key


def _check_finite(model: mujoco.MjModel, data: mujoco.MjData, key: int) -> None:
    """Refuse a keyframe with numbers that are not finite: MuJoCo would take others."""
    name = model.key(key).name
    for what in ("time", "qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat"):
        if not np.isfinite(getattr(data, what)).all():
            raise ModelError(
                [f"keyframe '{name}': its {what} has a number that is not finite; correct it"]
            )
