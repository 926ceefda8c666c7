"""Methods: ways to turn (hull, sea, pose, time) into a wrench, one a file, all called alike.

    method = Linear(hull, sea)
    method.wrench(position, rotation, time)     # (6,) force [N], torque [N m], world axes

`METHODS` names those that a scene can ask for.
"""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.hull import Hull
from sim.methods.linear import Linear
from sim.sea import Sea


class Method(Protocol):
    """What every method offers: the hull and sea it was made for and the wrench."""

    hull: Hull
    sea: Sea

    def wrench(
        self, position: ArrayLike, rotation: ArrayLike, time: float
    ) -> NDArray[np.float64]: ...


METHODS: dict[str, type[Method]] = {"linear": Linear}

__all__ = ["METHODS", "Linear", "Method"]
