"""Drag fields: from a model's custom fields to the drag, added mass and damping of a geom."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix, moved_motion
from sim.hulls.hull import Hull
from sim.mjcf.elements import of_geom
from sim.mjcf.floats import body_label
from sim.mjcf.geoms import frame_rotation, geom_in_inertial_frame
from sim.resistance.added_mass import added_mass_matrix, damping_matrix
from sim.resistance.drag import Drag, DragCoefficients
from sim.water.sea import Sea

Array = NDArray[np.float64]

RESISTANCE_FIELDS = ("drag", "drag_angular", "added_mass", "damping", "damping_quadratic")

LEAST_SHARE_AFLOAT = 0.1
"""Submerged share at rest below which coefficients of added mass do not follow the wet part: little
water moves with a lighter hull, and its tumbling would need shorter timesteps."""


@dataclass(frozen=True)
class DragFields:
    """The fields of a geom's resistance.

    values: the numbers of the RESISTANCE_FIELDS that the model has. sources: the full names of
    these fields.
    """

    values: Mapping[str, Array]
    sources: Mapping[str, str]

    @classmethod
    def of(cls, names: Sequence[str], numerics: Mapping[str, Array]) -> "DragFields":
        """The fields that apply to a geom (see `of_geom`)."""
        sources = {base: of_geom(base, names, numerics) for base in RESISTANCE_FIELDS}
        sources = {base: source for base, source in sources.items() if source in numerics}
        values = {base: numerics[source] for base, source in sources.items()}
        return cls(values, sources)

    def without_damping(self) -> "DragFields":
        """The other fields, for a body whose own motion is damped (see `response_fields`)."""
        others = {base: values for base, values in self.values.items() if base != "damping"}
        return DragFields(others, {base: self.sources[base] for base in others})

    @property
    def key(self) -> tuple[tuple[str, bytes], ...]:
        """A key that is equal for equal values."""
        return tuple((base, values.tobytes()) for base, values in self.values.items())

    def made(
        self, model: mujoco.MjModel, geom: int, hull: Hull, sea: Sea, afloat: float
    ) -> Drag | None:
        """The Drag of a geom's hull; None without resistance. afloat: the submerged share of the
        hull at rest. A 6 x 6 matrix, for example from a panel code, describes the hull at rest, so
        it is divided by that share. Six coefficients of added mass follow the wet part, but not on
        a simple body, of whose inertia MuJoCo keeps only the diagonal, and not on a light one.
        Raises ValueError."""
        values = self.values
        if not any(numbers.any() for numbers in values.values()):
            return None
        coefficients = np.concatenate(
            [values.get("drag", np.zeros(3)), values.get("drag_angular", [0.0])]
        )
        matrices, body = {}, int(model.geom_bodyid[geom])
        position, rotation = geom_in_inertial_frame(model, geom)
        try:
            if "added_mass" in values:
                hull_of_body = hull.moved(rotation, position)
                matrix = added_mass_matrix(hull_of_body, sea.density, values["added_mass"])
                check_diagonal(model, body, matrix)
                matrices["added_mass"] = matrix
            if "damping" in values:
                matrices["damping"] = damping_matrix(values["damping"])
            for base, matrix in matrices.items():
                matrices[base] = moved_matrix(matrix, position, rotation)
            if "damping_quadratic" in values:
                matrices["damping_quadratic"] = damping_matrix(values["damping_quadratic"])
                matrices["frame"] = moved_motion(position, rotation)
            for base in matrices.keys() & values.keys():
                if values[base].size == 36:
                    matrices[base] = matrices[base] / afloat
            is_six = "added_mass" in values and values["added_mass"].size == 6
            is_full = model.body_simple[body] == 0
            follows = is_six and is_full and afloat >= LEAST_SHARE_AFLOAT
            return Drag(hull, sea, DragCoefficients(*coefficients), **matrices, follows=follows)
        except ValueError as error:
            names = " and ".join(f"'{source}'" for source in self.sources.values())
            raise ValueError(f"custom numeric {names}: {error}") from None


def check_diagonal(model: mujoco.MjModel, body: int, matrix: Array) -> None:
    """Refuse an added mass (6, 6), in the body's inertial frame, that is not diagonal in the
    joint's axes, for a simple body: MuJoCo keeps only the diagonal of its inertia matrix."""
    if model.body_simple[body] == 0:
        return
    if model.jnt_type[model.body_jntadr[body]] == mujoco.mjtJoint.mjJNT_FREE:
        kept = np.diag(np.diag(matrix))  # the first three are world axes, so they must be equal
        kept[:3, :3] = np.mean(np.diag(matrix)[:3]) * np.eye(3)
        lost = matrix - kept
    else:  # slide joints
        axes = model.jnt_axis[model.jnt_bodyid == body] @ frame_rotation(model.body_iquat[body])
        lost = axes @ matrix[:3, :3] @ axes.T
        lost -= np.diag(np.diag(lost))
    if np.abs(lost).max() > 1e-9 * np.abs(matrix).max():
        raise ValueError(
            f"MuJoCo keeps only the diagonal of the inertia of body '{body_label(model, body)}', "
            "and this added mass is not the same along all axes: put an empty <body/> inside that "
            "body, then MuJoCo keeps the whole matrix"
        )
