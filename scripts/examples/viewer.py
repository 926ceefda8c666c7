"""MuJoCo's own viewer, with the sea in it, on a screen: `python viewer.py [my.xml]`.

Double-click a body and drag it with Ctrl and the right button to push it.
"""

import os
import sys
import time
from pathlib import Path

import mujoco
import mujoco.viewer

import sim  # noqa: F401  the plugin

if sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
    sys.exit("viewer.py: there is no screen to show it on; record a run with scripts/run.py")
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
