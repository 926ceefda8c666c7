"""MuJoCo's own viewer, with the water drawn as tiles: `python viewer.py my.xml`, on a screen."""

import os
import sys
import time
from pathlib import Path

import mujoco
import mujoco.viewer
import numpy as np

from sim import Scene

TILES, SIDE = 40, 0.35
"""Tiles along a side of the water, and how long each is [m]."""


def draw_water(picture: mujoco.MjvScene, scene: Scene) -> None:
    """Add tiles that lie on the water around the first body to what a picture shows."""
    sea, cell = scene.buoyancy.sea, SIDE * np.arange(-TILES // 2, TILES // 2)
    middle = np.round(scene.data.xpos[scene.buoyancy.bodies[0], :2] / SIDE) * SIDE
    x, y = (grid.ravel() for grid in np.meshgrid(middle[0] + cell, middle[1] + cell))
    surface = sea.surface(x, y, scene.data.time)
    normals = np.column_stack([-surface.gradient, np.ones(x.size)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    tilts = np.cross([0.0, 1.0, 0.0], normals)
    tilts /= np.linalg.norm(tilts, axis=1)[:, None]
    size = [0.55 * SIDE, 0.55 * SIDE, 0.004]
    for i in range(min(x.size, picture.maxgeom - picture.ngeom)):
        turn = np.column_stack([tilts[i], np.cross(normals[i], tilts[i]), normals[i]])
        place, shade = [x[i], y[i], surface.elevation[i]], 0.6 + 0.4 * turn[2, 2] ** 8
        mujoco.mjv_initGeom(
            picture.geoms[picture.ngeom], mujoco.mjtGeom.mjGEOM_BOX, size, place, turn.ravel(),
            np.array([0.1 * shade, 0.35 * shade, 0.6 * shade, 0.6], np.float32),
        )  # fmt: skip
        picture.ngeom += 1


def main(path: str) -> None:
    scene = Scene.load(path)
    with (
        scene.buoyancy.installed(),
        mujoco.viewer.launch_passive(scene.model, scene.data) as viewer,
    ):
        started = time.time() - scene.data.time
        while viewer.is_running():
            while scene.data.time < time.time() - started:
                mujoco.mj_step(scene.model, scene.data)
            with viewer.lock():
                viewer.user_scn.ngeom = 0
                draw_water(viewer.user_scn, scene)
            viewer.sync()
            time.sleep(0.01)


if __name__ == "__main__":
    if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
        sys.exit("viewer.py: there is no screen to show it on; record a run with scripts/run.py")
    here = Path(__file__).resolve().parents[2] / "models" / "bunny.xml"
    main(sys.argv[1] if len(sys.argv) > 1 else str(here))
