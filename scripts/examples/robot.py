"""Throw a robot that knows nothing of water into waves, and let it row. Needs only Waterline.

For a robot from a file, give `add_water` the file's path (MJCF or URDF).
"""

import mujoco
import numpy as np

import sim

ROBOT = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 1" euler="40 20 0"><freejoint/>
      <geom type="box" size="0.3 0.15 0.08" density="400"/>
      <body name="left" pos="0 0.17 0"><joint name="left" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0.03 0  0.05 0.03 -0.3" size="0.03"/></body>
      <body name="right" pos="0 -0.17 0"><joint name="right" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 -0.03 0  0.05 -0.03 -0.3" size="0.03"/></body>
    </body>
  </worldbody>
  <actuator><velocity joint="left" kv="1"/><velocity joint="right" kv="1"/></actuator>
</mujoco>"""

spec = mujoco.MjSpec.from_string(ROBOT)
sim.add_water(spec, "trunk", wave_swell=(0.06, 3, 0, 0), drag=(0.1, 1, 0.005))
model = spec.compile()
data = mujoco.MjData(model)
data.qvel[:3] = 2.0, 0.0, 1.0  # m/s
data.ctrl[:] = 4.0  # rad/s
while data.time < 10.0:
    if round(data.time / model.opt.timestep) % 500 == 0:
        up = np.degrees(np.arccos(data.body("trunk").xmat[8]))
        print(f"{data.time:3.0f} s: trunk at {data.qpos[:3].round(2)} m, tilted by {up:.0f} deg")
    mujoco.mj_step(model, data)
