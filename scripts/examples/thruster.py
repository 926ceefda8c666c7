"""Steer a boat with two thrusters on a course through waves. Needs only Waterline."""

import mujoco
import numpy as np

import sim

BOAT = """
<mujoco>
  <worldbody>
    <body name="boat"><freejoint/>
      <geom type="box" size="1.2 0.4 0.2" density="300"/>
      <site name="stern" pos="-1.2 0 -0.1"/>
    </body>
  </worldbody>
  <actuator>
    <general name="ahead" site="stern" gear="1 0 0 0 0 0" ctrllimited="true" ctrlrange="-300 300"/>
    <general name="aside" site="stern" gear="0 1 0 0 0 0" ctrllimited="true" ctrlrange="-60 60"/>
  </actuator>
</mujoco>"""

COURSE, SPEED = np.radians(40.0), 1.0  # rad, m/s

spec = mujoco.MjSpec.from_string(BOAT)
sim.add_water(spec, "boat", wave_swell=(0.08, 5, 0, 0), drag=(0.2, 1, 0.005))
model = spec.compile()
data = mujoco.MjData(model)
while data.time < 30.0:
    forward = data.body("boat").xmat.reshape(3, 3)[:, 0]
    error = COURSE - np.arctan2(forward[1], forward[0])
    error = np.arctan2(np.sin(error), np.cos(error))  # from -pi to pi
    yaw_rate, speed = data.qvel[5], data.qvel[:3] @ forward
    data.ctrl[0] = 1000.0 * (SPEED - speed)  # N
    data.ctrl[1] = -80.0 * error + 60.0 * yaw_rate  # N at the stern: to port turns the bow away
    if round(data.time / model.opt.timestep) % 1500 == 0:
        print(f"{data.time:4.0f} s: course {40.0 - np.degrees(error):6.1f} deg, {speed:.2f} m/s")
    mujoco.mj_step(model, data)
