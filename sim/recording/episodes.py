"""Episodes: the time axis of a recording whose scene may be reset."""

import numpy as np

EPISODE_GAP = 0.5
"""Time [s] between the last sample of an episode and the first of the next."""


class Episodes:
    """Times [s] of a recording. They go on after a gap when the time of the samples goes back.

    starts: the recording's time at which each episode starts.
    """

    def __init__(self) -> None:
        self.starts: list[float] = []
        self._last, self._shift = np.inf, 0.0

    @property
    def time(self) -> float:
        """The recording's time of the last sample."""
        return self._last + self._shift

    def is_new(self, time: float) -> bool:
        """Whether an episode begins with a sample of a time."""
        return time < self._last

    def add(self, time: float) -> float:
        """The recording's time of a sample of a time."""
        if self.is_new(time):
            if self.starts:
                self._shift = self.time + EPISODE_GAP - time
            self.starts.append(time + self._shift)
        self._last = time
        return self.time
