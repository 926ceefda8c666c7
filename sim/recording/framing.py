"""Framing: from where a recording shows a scene, and how much water is around it."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.scenes.scene import Scene

Array = NDArray[np.float64]

EYE_DIRECTION = np.array([-0.50, -0.82, 0.29]) / np.linalg.norm([-0.50, -0.82, 0.29])
"""Direction of the eye from what it looks at."""

VIEW_SHARE = 0.44
"""Share of the view's width or height within which the bodies are at the start."""

VIEW_ASPECT = 1.8
"""Width of the view over its height."""

VIEW_ANGLE = np.radians(55.0)
"""Angle between the upper and lower edge of Rerun's view."""

SLACK = 0.12
"""Distance from the level to which bodies rise or sink before the camera follows, in distances of
the eye. Waves move the bodies in the picture, and a sinking body stays in it."""

WATER_IN_REACHES, WATER_IN_DISTANCES = 1.25, 0.22
"""Smallest radius of the fine water, over that of the bodies and over the distance of the eye."""


class Framing:
    """Where the bodies of a scene are at the start.

    distance [m]: of the eye from what it looks at. water [m]: radius of the fine water around the
    mean of the floating bodies' centres.
    """

    def __init__(self, scene: Scene) -> None:
        points = corners(scene)
        middle = np.append(
            scene.data.xipos[scene.buoyancy.bodies, :2].mean(axis=0),
            0.5 * (points[:, 2].min() + points[:, 2].max()),
        )
        from_middle = points - middle
        reach = float(np.hypot(*from_middle[:, :2].T).max())
        right = np.cross([0.0, 0.0, 1.0], EYE_DIRECTION)
        right /= np.linalg.norm(right)
        up = np.cross(EYE_DIRECTION, right)
        across, along = np.abs(from_middle @ right) / VIEW_ASPECT, np.abs(from_middle @ up)
        needed = np.maximum(across, along) / (VIEW_SHARE * np.tan(0.5 * VIEW_ANGLE))
        self.distance = float((needed + from_middle @ EYE_DIRECTION).max())
        self.water = max(WATER_IN_REACHES * reach, WATER_IN_DISTANCES * self.distance)

    def focus(self, centres: Array, level: float) -> list[float]:
        """The point (3,) [m] at which the eye looks, for centres (B, 3) [m] of the bodies. It stays
        on the level while their mean is near."""
        x, y, z = centres.mean(axis=0).tolist()
        slack = SLACK * self.distance
        return [x, y, level + float(np.sign(z - level)) * max(abs(z - level) - slack, 0.0)]


def corners(scene: Scene) -> Array:
    """Corners (8 N, 3) [m] of the boxes around all geoms of the floating bodies, and of the bodies
    that are joined to them."""
    model, data = scene.model, scene.data
    mujoco.mj_kinematics(model, data)
    roots = model.body_rootid[scene.buoyancy.bodies]
    geoms = np.flatnonzero(np.isin(model.body_rootid[model.geom_bodyid], roots))
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)
    boxes = model.geom_aabb[geoms].reshape(-1, 2, 3)
    of_geoms = boxes[:, :1] + signs * boxes[:, 1:]
    axes = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return (of_geoms @ np.swapaxes(axes, 1, 2) + data.geom_xpos[geoms, None]).reshape(-1, 3)
