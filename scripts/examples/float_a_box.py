"""Float a box, described by an MJCF string, in two crossing waves."""

import mujoco

from sim import Scene, simulate

BOX = """
<mujoco>
  <custom>
    <numeric name="wave_swell" data="0.10 4.0 0 0"/>   <!-- m, m, deg, deg -->
    <numeric name="wave_cross" data="0.05 2.0 60 0"/>
    <numeric name="drag" data="0.2 1.0 0.005"/>        <!-- waves, eddies, skin -->
    <tuple name="buoyant"><element objtype="geom" objname="box"/></tuple>
  </custom>
  <worldbody>
    <body name="box" pos="0 0 0.5"><freejoint/>
      <geom name="box" type="box" size="1 0.5 0.2" density="600"/></body>
  </worldbody>
</mujoco>"""

scene = Scene.load(mujoco.MjSpec.from_string(BOX))
for sample in simulate(scene, duration=10.0, rate=2.0):
    height, water = sample.centres[0, 2], sample.elevations[0]
    print(f"{sample.time:5.2f} s: box at {height:+.3f} m, water at {water:+.3f} m")
