# %% [markdown]
# # A run in a notebook
#
# VS Code opens this file as a notebook, and so does Jupyter with Jupytext. It also runs as a
# program. It needs `pip install '.[report,notebook]'` for the plot and Rerun's viewer and, for the
# picture, a graphics driver: on a machine without a screen, set `MUJOCO_GL=osmesa` (Debian's
# libosmesa6) or `MUJOCO_GL=egl` before Python starts.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from PIL import Image

from sim import Recorder, Scene, simulate

here = Path(__file__).parent if "__file__" in globals() else Path.cwd()
scene = Scene.load(here.resolve().parents[1] / "models" / "bunny.xml")

# %% [markdown]
# Run it for ten seconds and record it. The cell shows the recording in Rerun's viewer.

# %%
samples = []
with Recorder("bunny.rrd", scene) as recorder:
    for sample in simulate(scene, duration=10.0):
        recorder.log(sample)
        samples.append(sample)
recorder  # noqa: B018  the notebook shows it

# %%
times = np.array([sample.time for sample in samples])
heights = np.array([[sample.centres[0, 2], sample.elevations[0]] for sample in samples])
tilts = np.degrees([sample.tilts[0] for sample in samples])
print(f"mean tilt {tilts.mean():.1f} deg, largest {tilts.max():.1f} deg")

# %%
figure, (upper, lower) = plt.subplots(2, sharex=True, figsize=(8, 4))
upper.plot(times, heights, label=["centre of mass", "water"])
upper.set_ylabel("height [m]")
upper.legend()
lower.plot(times, tilts)
lower.set(xlabel="time [s]", ylabel="tilt [deg]")

# %% [markdown]
# The last state, drawn by MuJoCo. `python scripts/video.py models/bunny.xml` makes a video.

# %%
picture = None
try:
    with mujoco.Renderer(scene.model, height=360, width=640) as renderer:
        renderer.update_scene(scene.data)
        picture = Image.fromarray(renderer.render())
except Exception as error:  # each driver has its own errors
    print(f"no picture: {error}")
picture  # noqa: B018
