"""A simulation loop with a controller that keeps the bunny in position; the run is recorded.

With --view, Rerun's viewer shows the run at the same time.
"""

import sys
from pathlib import Path

import mujoco

from sim import Recorder, Scene, observe

scene = Scene.load(Path(__file__).resolve().parents[2] / "models" / "bunny.xml")
model, data = scene.model, scene.data
bunny = model.body("bunny").id
with Recorder("recordings/own_loop.rrd", scene, view="--view" in sys.argv) as recorder:
    for frame in range(150):
        recorder.log(observe(scene))
        for _ in range(10):
            data.xfrc_applied[bunny, :2] = -200.0 * data.qpos[:2] - 100.0 * data.qvel[:2]
            mujoco.mj_step(model, data)
        if frame % 30 == 0:
            print(f"{data.time:.2f} s: {data.qpos[:2].round(3)} m from the origin")
