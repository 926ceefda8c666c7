"""Frame: the drawing of a sample: the water, waterlines, wet surfaces, poses and arrows."""

from collections import deque
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.recording.colours import shades
from sim.recording.display_mesh import DisplayMeshes
from sim.recording.framing import Framing
from sim.recording.look import COLOURS, MOST_PLOTTED
from sim.recording.parts import GROUND_REACH, contact_forces, parts_of, shown_tendons, tendon_points
from sim.recording.sea_surface import SeaSurface, Water
from sim.recording.waterline_curves import heads, waterlines
from sim.runs.simulation import Sample
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

WATER_RESOLUTION, MOST_RESOLUTION = 48, 1000
"""Default and largest square root of the number of the water's vertices. A frame takes 16 bytes for
each of them."""

WATER_GROWTH = 12.0
"""Radius of the moving water over that of its fine middle."""

MOST_SHADED_VERTICES = 20_000
"""Largest number of vertices of all hulls for which wet surfaces are darker. Their colours take 4
bytes per vertex and frame."""

MOST_WATERLINE_POINTS = 4000
"""Largest number of points of all waterlines in a frame; longer waterlines are thinned. A point
takes 12 bytes."""

FEWEST_CURVE_POINTS = 12
"""Smallest number of points to which a waterline is thinned."""

LINE_IN_DISTANCES, LINE_IN_HULLS = 0.0016, 0.012
"""Largest radius of the waterline, over the distance of the eye (about 1.3 pixels of a view that is
900 pixels high) and over the diagonal of the smallest hull."""

TRAIL_SECONDS = 3.0
"""Length [s] of the trails."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The drawing of a sample.

    time [s]: on the recording's axis. curves: the waterlines, each (., 3) [m]. wetness: (V,),
    shades of the hulls' vertices, or None. trail: of each body (., 3) [m]. upward: (B, 3) [m],
    centres of buoyancy. focus: (3,) [m], where the eye looks. positions, quaternions: (K, 3) [m]
    and (K, 4), of the frames of all moving bodies that are drawn. tendons: their lines, each
    (., 3) [m]. contacts: points (C, 3) [m] and forces (C, 3) [N].
    """

    time: float
    sample: Sample
    water: Water
    curves: list[NDArray[np.float32]]
    wetness: NDArray[np.uint8] | None
    trail: list[NDArray[np.float32]]
    upward: Array
    focus: list[float]
    positions: Array
    quaternions: Array
    tendons: list[list[NDArray[np.float32]]]
    contacts: tuple[Array, Array]


class Artist:
    """Draws the frames of one scene.

    water_size [m]: width of the moving water, None to fit the bodies. water_resolution: square root
    of about the number of its vertices. colour: one of COLOURS. meshes: the hulls' surfaces. parts:
    all other geoms and sites. moving: ids of the drawn bodies that can move. tendons: names by id.
    is_shaded: whether the hulls' colours show the wetness or the pressure. surface: the water.
    line_radius [m]: of the waterline. largest_head [m]: the head of the darkest colour if hulls are
    coloured by pressure, else None.
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
        self._scene, self._sea = scene, scene.buoyancy.sea
        self.framing = Framing(scene)
        smallest = min(mesh.size for mesh in meshes)
        self.line_radius = min(LINE_IN_DISTANCES * self.framing.distance, LINE_IN_HULLS * smallest)
        inner = self.framing.water
        radius = WATER_GROWTH * inner if water_size is None else 0.5 * water_size
        self.surface = SeaSurface(self._sea, min(inner, 0.5 * radius), radius, water_resolution)
        hulls = {g for f in scene.buoyancy.floats for g in f.geoms}
        self.parts = list(parts_of(scene.model, hulls, GROUND_REACH * radius, self._sea.level))
        self.tendons = shown_tendons(scene.model)
        drawn = {part.body for part in self.parts} | set(scene.buoyancy.bodies.tolist())
        model = scene.model
        self.moving = [
            b for b in sorted(drawn) if model.body_weldid[b] or model.body_mocapid[b] >= 0
        ]
        self.largest_head: float | None = None
        if colour == "pressure":  # the largest middle extent of a hull
            hulls = [f.method.hull for f in scene.buoyancy.floats]
            self.largest_head = max(float(np.sort(np.ptp(h.bounds, axis=0))[1]) for h in hulls)
        self._wetness_per_metre = np.empty(meshes.vertex_count)
        for mesh in meshes:  # from dry to wet within half an edge
            self._wetness_per_metre[mesh.vertices] = 2.0 / mesh.edge
        self._trail: deque[tuple[float, NDArray[np.float32]]] = deque()

    def frame(self, sample: Sample, time: float) -> Frame:
        """The frame of a sample of the scene's present state, at a time [s] of the recording. It
        comes after the samples of earlier calls. Raises ValueError for a sample of another time."""
        data = self._scene.data
        if sample.time != data.time:
            raise ValueError(
                f"the sample is of {sample.time:g} s and the scene's state of {data.time:g} s; log "
                "each sample before the next step"
            )
        sea, meshes = self._sea, self.meshes
        points, areas = meshes.placed(sample)
        if self.largest_head is None:
            depths = heads(sea, points, sample.time)
        else:  # the colours need the pressure of deep points too
            depths = sea.head(points[:, 0], points[:, 1], points[:, 2], sample.time)
        curves = waterlines(
            sea, sample.time, points, areas, meshes.faces, meshes.across, depths, self.line_radius
        )
        focus = self.framing.focus(sample.centres, float(sea.level_at(sample.time)))
        return Frame(
            time=time,
            sample=sample,
            water=self.surface.at(np.array(focus[:2]), sample.time),
            curves=[curve.astype(np.float32) for curve in thinned(curves, MOST_WATERLINE_POINTS)],
            wetness=self._shades(depths) if self.is_shaded else None,
            trail=self._trails(sample),
            upward=self._centres_of_buoyancy(sample, depths, areas),
            focus=focus,
            positions=data.xpos[self.moving],
            quaternions=data.xquat[self.moving],
            tendons=self._tendon_lines(),
            contacts=contact_forces(self._scene.model, data),
        )

    def _shades(self, depths: Array) -> NDArray[np.uint8]:
        """Shades (V,) of the vertices by wetness or pressure head, from their depths."""
        if self.largest_head is None:
            return shades(depths * self._wetness_per_metre)
        by_head = np.maximum(shades(2.0 * depths / self.largest_head - 1.0), 1)
        return np.where(depths > 0.0, by_head, 0).astype(np.uint8)

    def _centres_of_buoyancy(self, sample: Sample, depths: Array, areas: Array) -> Array:
        """A point (B, 3) [m] of each body on the line along which buoyancy acts, at the depth of
        the centre of the submerged volume; the centre of mass of a dry body.

        The depths are those of the drawn vertices, so the depth is good enough for a picture only.
        It is the integral of depth^2 / 2 over that of depth, both over the level area.
        """
        wet = np.maximum(depths, 0.0)
        columns = -wet * areas[:, 2]
        hulls, starts = self._scene.buoyancy.float_bodies, self.meshes.hull_starts
        volumes = np.bincount(hulls, np.add.reduceat(columns, starts))
        moments = np.bincount(hulls, np.add.reduceat(0.5 * wet * columns, starts))
        is_wet = (sample.submerged_fractions > 0.0) & (volumes > 0.0) & (moments > 0.0)
        depth = moments / np.where(is_wet, volumes, 1.0)
        force, torque = sample.body_wrenches[:, :3], sample.body_wrenches[:, 3:]
        is_wet &= force[:, 2] > 0.0
        lift, arms = np.where(is_wet, force[:, 2], 1.0), np.zeros_like(force)
        arms[:, 2] = sample.elevations - depth - sample.centres[:, 2]
        arms[:, 0] = (arms[:, 2] * force[:, 0] - torque[:, 1]) / lift
        arms[:, 1] = (arms[:, 2] * force[:, 1] + torque[:, 0]) / lift
        return sample.centres + np.where(is_wet[:, None], arms, 0.0)

    def _tendon_lines(self) -> list[list[NDArray[np.float32]]]:
        """The lines of each tendon."""
        model, data = self._scene.model, self._scene.data
        if self.tendons:
            mujoco.mj_tendon(model, data)
        return [tendon_points(model, data, tendon) for tendon in self.tendons]

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


def _check_water(size: float | None, resolution: int) -> None:
    if size is not None and not (np.isfinite(size) and size > 0.0):
        raise ValueError(f"the size of the water is {size}; it must be finite and above 0")
    if not 2 <= resolution <= MOST_RESOLUTION:
        raise ValueError(
            f"the water's resolution is {resolution}, the square root of its number of vertices; "
            f"it must be 2 or more and at most {MOST_RESOLUTION}"
        )
