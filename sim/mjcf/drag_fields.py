"""Drag fields: the drag, added mass and damping that a model's custom fields give a geom."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix
from sim.hulls.hull import Hull
from sim.mjcf.elements import of_geom
from sim.mjcf.floats import body_label
from sim.mjcf.geoms import frame_rotation, geom_in_inertial_frame
from sim.resistance.added_mass import added_mass_matrix, damping_matrix
from sim.resistance.drag import Drag, DragCoefficients
from sim.water.sea import Sea

Array = NDArray[np.float64]

BASES = ("drag", "drag_angular", "added_mass", "damping")


@dataclass(frozen=True)
class DragFields:
    """What a model says about a geom's resistance: numbers by BASES, and which say it."""

    values: Mapping[str, Array]
    sources: tuple[str, ...]

    @classmethod
    def of(cls, names: Sequence[str], numerics: Mapping[str, Array]) -> "DragFields":
        """A geom's own, else the scene's."""
        sources = {base: of_geom(base, names, numerics) for base in BASES}
        found = {base: source for base, source in sources.items() if source in numerics}
        values = {base: numerics[source] for base, source in found.items()}
        return cls(values, tuple(found.values()))

    @property
    def key(self) -> tuple[tuple[str, bytes], ...]:
        """What tells them from others."""
        return tuple((base, values.tobytes()) for base, values in self.values.items())

    def made(
        self, model: mujoco.MjModel, geom: int, hull: Hull, sea: Sea, afloat: float
    ) -> Drag | None:
        """The Drag of a geom's hull, None where nothing resists. Matrices, such as a panel code
        gives, are those of the hull afloat, of which a part is submerged. Raises ValueError."""
        values = self.values
        if not any(value.any() for value in values.values()):
            return None
        strengths = np.concatenate(
            [values.get("drag", np.zeros(3)), values.get("drag_angular", [0.0])]
        )
        matrices = {}
        in_body = geom_in_inertial_frame(model, geom)
        try:
            for base in ("added_mass", "damping"):
                if base in values:
                    share = afloat if values[base].size == 36 else 1.0
                    matrix = _matrix_of(model, geom, hull, sea, base, values[base])
                    matrices[base] = moved_matrix(matrix, *in_body) / share
            return Drag(hull, sea, DragCoefficients(*strengths), **matrices)
        except ValueError as error:
            asked = " and ".join(f"'{source}'" for source in self.sources)
            raise ValueError(f"custom numeric {asked}: {error}") from None


def _matrix_of(
    model: mujoco.MjModel, geom: int, hull: Hull, sea: Sea, base: str, given: Array
) -> Array:
    """Added mass or damping (6, 6) along the axes and about the origin of the inertial frame of a
    geom's body."""
    if base == "damping":
        return damping_matrix(given)
    place, turn = geom_in_inertial_frame(model, geom)
    matrix = added_mass_matrix(hull.moved(turn, place), sea.density, given)
    _check_room(model, int(model.geom_bodyid[geom]), matrix)
    return matrix


def _check_room(model: mujoco.MjModel, body: int, matrix: Array) -> None:
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
            f"MuJoCo keeps only the diagonal of the inertia of body '{body_label(model, body)}', "
            "and this added mass is not the same along all axes: put an empty <body/> inside that "
            "body, then the whole matrix has room"
        )
