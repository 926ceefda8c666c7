"""Customary: the linear method as it is commonly implemented, to measure what that costs in
accuracy."""

from types import SimpleNamespace

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from sim.hulls.hull import Hull
from sim.hulls.triangle import clipped, wet_triangles_wrench
from sim.methods import Method
from sim.water.gerstner import WAVE
from sim.water.head import hydrostatic
from sim.water.sea import Sea

Array = NDArray[np.float64]


class Customary(Method):
    """The linear method with a fixed number of Newton steps per elevation and numbers of `dtype`.

    The steps start with the point itself as the label. The table of error sources uses this method
    with many steps or in double precision to isolate one of the two errors. In single precision,
    positions, heads, phases and elevations are rounded; sums over triangles stay in double
    precision. Pressure is hydrostatic.
    """

    def __init__(
        self, hull: Hull, sea: Sea, newton_steps: int = 2, dtype: DTypeLike = np.float64
    ) -> None:
        super().__init__(hull, sea)
        self.newton_steps = newton_steps
        self.dtype = np.dtype(dtype)
        self._vertices = hull.vertices.astype(self.dtype)
        columns = [(name, sea.components[name].astype(self.dtype)) for name in WAVE.names]
        self._waves = SimpleNamespace(**dict(columns))

    def wrench(self, position: ArrayLike, rotation: ArrayLike, time: float) -> Array:
        """Force [N] and torque [N m] about the position, world axes: (6,)."""
        rotation = np.asarray(rotation, dtype=self.dtype).reshape(3, 3)
        points = self._vertices @ rotation.T + np.asarray(position, dtype=self.dtype)
        level = self.dtype.type(self.sea.level)
        heights = self.heights(points[:, 0], points[:, 1], time)
        heads = hydrostatic(heights, points[:, 2] - level)
        arms = (self._vertices @ rotation.T).astype(float)
        faces, sea = self.hull.faces, self.sea
        corners, wet_heads = clipped(arms[faces], heads.astype(float)[faces])
        return wet_triangles_wrench(corners, wet_heads, sea.density, sea.gravity)

    def heights(self, x: NDArray, y: NDArray, time: float) -> NDArray:
        """Heights (N,) [m] of the surface above the level at points x (N,), y (N,) [m]."""
        wave = self._waves
        dx, dy, a = wave.direction_x, wave.direction_y, wave.amplitude
        label_x, label_y = x.copy(), y.copy()
        for _ in range(self.newton_steps):
            s, c = self._phases(label_x, label_y, time)
            strain = s * (wave.wavenumber * a)
            jxx, jxy, jyy = 1 - strain @ (dx * dx), -strain @ (dx * dy), 1 - strain @ (dy * dy)
            rx, ry = x - label_x - c @ (dx * a), y - label_y - c @ (dy * a)
            scale = 1 / (jxx * jyy - jxy * jxy)
            label_x = label_x + scale * (jyy * rx - jxy * ry)
            label_y = label_y + scale * (jxx * ry - jxy * rx)
        s, _ = self._phases(label_x, label_y, time)
        return s @ a

    def _phases(self, x: NDArray, y: NDArray, time: float) -> tuple[NDArray, NDArray]:
        """Sines and cosines (N, W) of the waves' phases at labels."""
        wave = self._waves
        turns = np.multiply.outer(x, wave.turns_x) + np.multiply.outer(y, wave.turns_y)
        turns += wave.turns - wave.frequency * self.dtype.type(time)
        angle = turns * self.dtype.type(2.0 * np.pi)
        return np.sin(angle), np.cos(angle)
