"""Simulate 64 bunnies in one batch on all cores, each starting at a different time of the sea."""

from pathlib import Path
from time import perf_counter

import numpy as np
from mujoco.batch import Batch

from sim import Scene

COUNT, STEPS = 64, 500
scene = Scene.load(Path(__file__).resolve().parents[2] / "models" / "bunny.xml")
batch = Batch(scene.model, nsim=COUNT)
qpos = batch.bind("qpos")
qpos[:] = scene.data.qpos
batch.bind("time")[:] = np.linspace(0.0, 60.0, COUNT)
started = perf_counter()
batch.step(nstep=STEPS)
taken = perf_counter() - started
print(f"{COUNT * STEPS / taken:,.0f} simulations x steps per second on {batch.nthread} threads")
print(f"heights after {STEPS} steps: {qpos[:, 2].mean():.3f} +- {qpos[:, 2].std():.3f} m")
