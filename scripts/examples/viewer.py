"""Show a scene with the sea in MuJoCo's interactive viewer: `python viewer.py [my.xml]`.

To push a body, double-click it and drag it with Ctrl and the right mouse button.
"""

import sys
import time
from pathlib import Path

import mujoco
import mujoco.viewer

import sim  # noqa: F401  registers the plugin
from sim.platforms import has_screen

if not has_screen():
    sys.exit("viewer.py: found no screen; record a run with scripts/run.py instead")
here = Path(__file__).resolve().parents[2] / "models" / "bunny.xml"
model = mujoco.MjModel.from_xml_path(sys.argv[1] if len(sys.argv) > 1 else str(here))
data = mujoco.MjData(model)
if model.nkey:
    mujoco.mj_resetDataKeyframe(model, data, 0)
with mujoco.viewer.launch_passive(model, data) as viewer:
    started = time.time()
    while viewer.is_running():
        while data.time < time.time() - started:
            mujoco.mj_step(model, data)
        viewer.sync()
        time.sleep(0.01)
