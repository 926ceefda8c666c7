"""The OpenGL driver with which MuJoCo draws. Import this module before mujoco, which reads the
environment variable MUJOCO_GL when it is imported."""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager
from ctypes.util import find_library
from pathlib import Path

LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
"""Libraries of the drivers that need no screen, by their name in MUJOCO_GL."""

SMALL_SIZE = (64, 64)
"""Width and height [pixels] of the picture that tries the driver."""

ADVICE = (
    "on a machine without a screen, install Debian's libosmesa6, which needs no graphics card, and "
    "set MUJOCO_GL=osmesa; or install the graphics card's driver with libegl1 and set MUJOCO_GL=egl"
)


def choose_driver() -> str | None:
    """Set MUJOCO_GL where it is not set and there is no screen: to a driver that is installed,
    software unless there is a graphics card. Returns why MuJoCo cannot draw, or None.

    MuJoCo cannot be imported if MUJOCO_GL names a driver that is missing, so it is set to disable.
    """
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    if sys.platform != "linux" or (not chosen and any(os.environ.get(name) for name in screens)):
        return None
    has_card = Path("/dev/nvidia0").exists() or any(Path("/dev").glob("dri/render*"))
    order = ("egl", "osmesa") if has_card else ("osmesa", "egl")
    wanted = (chosen,) if chosen else order
    found = [name for name in wanted if name not in LIBRARIES or find_library(LIBRARIES[name])]
    os.environ["MUJOCO_GL"] = found[0] if found else "disable"
    if found:
        return None
    return f"MuJoCo cannot draw: there is no library of {' or '.join(wanted)}; {ADVICE}"


problem = choose_driver()
"""Why MuJoCo cannot draw, or None."""

import mujoco  # noqa: E402


@contextmanager
def renderer(
    model: mujoco.MjModel, width: int, height: int, most_geoms: int
) -> Iterator[mujoco.Renderer]:
    """MuJoCo's renderer for pictures of a size [pixels]. Raises ValueError, with what to install,
    if there is no driver."""
    global problem  # MuJoCo aborts the process if it tries again after a failure
    if problem is not None:
        raise ValueError(problem)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    try:
        with warnings.catch_warnings(action="ignore"):  # the error says all
            made = mujoco.Renderer(model, height, width, most_geoms)
    except Exception as error:  # each driver has its own errors
        driver = os.environ.get("MUJOCO_GL") or "a screen"
        reason = " ".join(str(error).split())
        problem = f"MuJoCo cannot draw with {driver} ({reason}); {ADVICE}"
        raise ValueError(problem) from error
    with closing(made):
        yield made


def check_driver() -> None:
    """Raise ValueError, with what to install, if MuJoCo cannot draw."""
    with renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), *SMALL_SIZE, most_geoms=1):
        pass
