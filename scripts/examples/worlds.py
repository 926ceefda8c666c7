"""Float 1024 boats on seas of their own, on a GPU if there is one: random thrusts, observations."""

from pathlib import Path

import mujoco
import mujoco_warp
import numpy as np
import warp as wp

from sim import Scene, Sea

worlds, steps = (1024, 1000) if wp.get_device().is_cuda else (16, 20)
rng = np.random.default_rng(0)
scene = Scene.load(Path(__file__).resolve().parents[2] / "models" / "catamaran.xml")
model = scene.buoyancy.dry_model
data = mujoco.MjData(model)
data.qpos[:] = scene.data.qpos
m, d = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data, nworld=worlds)
seas = [Sea.jonswap(0.05 + 0.001 * (i % 100), 2.0, waves=8, seed=i) for i in range(worlds)]
water, body = scene.buoyancy.on_warp(m, d, seas), int(scene.buoyancy.bodies[0])
thrusts = np.zeros(d.xfrc_applied.shape + (6,), np.float32)
for _ in range(0, steps, 20):
    thrusts[:, body, :2] = rng.uniform(-100.0, 100.0, (worlds, 2))  # [N]
    d.xfrc_applied.assign(thrusts)
    for _ in range(20):
        mujoco_warp.step(m, d)  # on a GPU, capture this once: wp.ScopedCapture()
    places = d.xipos[:, body : body + 1]
    heights = places.numpy()[:, 0, 2] - water.elevation(places).numpy()[:, 0]
print(f"heights above the water of {worlds} boats: {heights.mean():.3f} +- {heights.std():.3f} m")
