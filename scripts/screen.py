"""Screen: shows a run at real time in MuJoCo's interactive viewer."""

import threading
import time
import warnings
from types import TracebackType

from sim import Sample, Scene
from sim.platforms import has_screen

CLOSING_SECONDS = 5.0
"""Longest time [s] that a closed window may take to end."""


class Screen:
    """A window that shows a scene. speed: simulated seconds per second of wall time. Raises
    ValueError if no window can be opened. A `with` block closes the window."""

    def __init__(self, scene: Scene, speed: float) -> None:
        import glfw  # libraries of windows are loaded only for a window
        import mujoco.viewer

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GLFW's warning says less than the error below
            found = has_screen() and glfw.init()
        if not found:  # MuJoCo would end the process
            raise ValueError(
                "--view found no screen; leave it out and open the recording where there is one, "
                "or give a virtual one: xvfb-run python scripts/run.py ..."
            )
        before = set(threading.enumerate())
        try:
            self._viewer = mujoco.viewer.launch_passive(
                scene.model, scene.data, show_left_ui=False, show_right_ui=False
            )
        except RuntimeError as error:  # on macOS, if the script does not run under mjpython
            raise ValueError(f"--view: {' '.join(str(error).split())}") from None
        self._threads = set(threading.enumerate()) - before
        self._speed, self._begin = speed, scene.data.time
        self._opened = time.perf_counter()

    def __enter__(self) -> "Screen":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._viewer.close()
        for thread in self._threads:  # a process that ends while they draw crashes
            thread.join(CLOSING_SECONDS)

    def show(self, sample: Sample) -> bool:
        """Show the present state of the scene when its time has come. Returns whether the window is
        still open."""
        due = self._opened + (sample.time - self._begin) / self._speed
        time.sleep(max(due - time.perf_counter(), 0.0))
        self._viewer.sync()
        return self._viewer.is_running()
