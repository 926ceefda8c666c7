"""Frame: the drawing of a sample: the water's particles, waterlines, wet surfaces, trails."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.recording.display_mesh import DisplayMeshes
from sim.recording.look import COLOURS, MOST_PLOTTED, extent, shades
from sim.recording.waterline_curves import heads, waterlines
from sim.runs.simulation import Sample
from sim.scenes.scene import Scene

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

WATER_RESOLUTION, MOST_RESOLUTION = 48, 1000
"""Default and largest number of vertices along a side of the water's grid. A frame takes 16 bytes
for each vertex of the grid."""

WATER_IN_HULLS, WATER_IN_SPREADS = 6.0, 2.4
"""Side of the water's square, as a sum of lengths of the largest hull and distances between the
bodies."""

MOST_SHADED_VERTICES = 20_000
"""Largest number of vertices of all hulls for which wet surfaces are darker. Their colours take 4
bytes per vertex and frame."""

MOST_WATERLINE_POINTS = 4000
"""Largest number of points of all waterlines in a frame; longer waterlines are thinned. A point
takes 12 bytes."""

FEWEST_CURVE_POINTS = 12
"""Smallest number of points to which a waterline is thinned."""

TRAIL_SECONDS = 3.0
"""Length [s] of the trails."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The drawing of a sample.

    particles: (N, 3) [m], of the water. heights: (N,), their shades from trough to crest. curves:
    the waterlines, each (., 3) [m]. wetness: (V,), shades of the hulls' vertices, or None. trail:
    of each body (., 3) [m].
    """

    sample: Sample
    particles: NDArray[np.float32]
    heights: NDArray[np.uint8]
    curves: list[NDArray[np.float32]]
    wetness: NDArray[np.uint8] | None
    trail: list[NDArray[np.float32]]


class Artist:
    """Draws the frames of one scene.

    water_size [m]: side of the water's square, None to fit the bodies. water_resolution: vertices
    along that side. colour: one of COLOURS. meshes: the hulls' drawn surfaces. is_shaded: whether
    their colours show the wetness or the pressure. water_faces: (F, 3), of the water's particles.
    largest_head [m]: the head of the darkest colour if hulls are coloured by pressure, else None.
    """

    def __init__(
        self,
        scene: Scene,
        meshes: DisplayMeshes,
        water_size: float | None,
        water_resolution: int,
        colour: str = COLOURS[0],
    ) -> None:
        if colour not in COLOURS:
            raise ValueError(f"the colour is '{colour}'; expected {' or '.join(COLOURS)}")
        _check_water(water_size, water_resolution)
        self.meshes = meshes
        self.is_shaded = meshes.vertex_count <= MOST_SHADED_VERTICES
        self.water_faces = _grid_faces(water_resolution)
        self._sea = scene.buoyancy.sea
        side = water_size or extent(scene, WATER_IN_HULLS, WATER_IN_SPREADS)
        self.largest_head: float | None = None
        if colour == "pressure":  # the largest middle extent of a hull
            hulls = [f.method.hull for f in scene.buoyancy.floats]
            self.largest_head = max(float(np.sort(np.ptp(h.bounds, axis=0))[1]) for h in hulls)
        self._steps = 0.5 * side * np.linspace(-1.0, 1.0, water_resolution)
        self._wetness_per_metre = np.empty(meshes.vertex_count)
        for mesh in meshes:  # from dry to wet within half an edge
            self._wetness_per_metre[mesh.vertices] = 2.0 / mesh.edge
        self._trail: deque[tuple[float, NDArray[np.float32]]] = deque()

    def frame(self, sample: Sample) -> Frame:
        """The frame of a sample, which comes after the samples of earlier calls."""
        sea, meshes = self._sea, self.meshes
        particles = self._particles(sample)
        highest = max(min(sea.amplitude, 0.5 * sea.significant_height), 1e-9)
        heights = (particles[:, 2] - sea.level_at(sample.time)) / (2.0 * highest)
        points = meshes.placed(sample)
        if self.largest_head is None:
            depths = heads(sea, points, sample.time)
        else:  # the colours need the pressure of deep points too
            depths = sea.head(points[:, 0], points[:, 1], points[:, 2], sample.time)
        curves = waterlines(sea, sample.time, points, meshes.faces, meshes.across, depths)
        return Frame(
            sample=sample,
            particles=particles.astype(np.float32),
            heights=shades(heights),
            curves=[curve.astype(np.float32) for curve in thinned(curves, MOST_WATERLINE_POINTS)],
            wetness=self._shades(depths) if self.is_shaded else None,
            trail=self._trails(sample),
        )

    def _shades(self, depths: Array) -> NDArray[np.uint8]:
        """Shades (V,) of the vertices by wetness or pressure head, from their depths."""
        if self.largest_head is None:
            return shades(depths * self._wetness_per_metre)
        by_head = np.maximum(shades(2.0 * depths / self.largest_head - 1.0), 1)
        return np.where(depths > 0.0, by_head, 0).astype(np.uint8)

    def forget(self) -> None:
        """Clear the trails, so that the next sample is the first."""
        self._trail.clear()

    def _trails(self, sample: Sample) -> list[NDArray[np.float32]]:
        if len(sample.centres) > MOST_PLOTTED:
            return []
        self._trail.append((sample.time, sample.centres.astype(np.float32)))
        while sample.time - self._trail[0][0] > TRAIL_SECONDS:
            self._trail.popleft()
        return list(np.stack([centres for _, centres in self._trail], axis=1))

    def _particles(self, sample: Sample) -> Array:
        """Positions (N, 3) [m] of the water particles of a grid of labels. The grid follows the
        bodies by whole cells, so that its lines stay on the same particles."""
        cell = self._steps[1] - self._steps[0]
        middle = np.round(sample.centres[:, :2].mean(axis=0) / cell) * cell
        labels = np.stack(np.meshgrid(*(middle[:, None] + self._steps), indexing="ij"), axis=-1)
        return self._sea.particles(labels, sample.time).reshape(-1, 3)


def thinned(curves: list[Array], most: int) -> list[Array]:
    """Closed curves thinned to about `most` points in total."""
    largest_step = -(-sum(map(len, curves)) // most)
    if largest_step < 2:
        return curves
    steps = [max(1, min(largest_step, len(curve) // FEWEST_CURVE_POINTS)) for curve in curves]
    return [
        np.concatenate([curve[:-1:step], curve[:1]])
        for curve, step in zip(curves, steps, strict=True)
    ]


def _grid_faces(resolution: int) -> Indices:
    """Two triangles for each cell of a square grid of vertices, facing up."""
    corner = np.arange(resolution * resolution).reshape(resolution, resolution)
    a, b = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
    c, d = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def _check_water(size: float | None, resolution: int) -> None:
    if size is not None and not (np.isfinite(size) and size > 0.0):
        raise ValueError(f"the size of the water is {size}; it must be finite and above 0")
    if not 2 <= resolution <= MOST_RESOLUTION:
        raise ValueError(
            f"the water's resolution is {resolution} vertices along a side; it must be 2 or more "
            f"and at most {MOST_RESOLUTION}"
        )
