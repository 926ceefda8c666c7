"""Checks: a measured quantity beside the bounds of its expected value, and what they share."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.scenes.scene import Scene

Array = NDArray[np.float64]

DENSITY, GRAVITY = 1025.0, 9.81

CLOSED_FORM, PANEL_CODE = "closed form", "panel code"

LINEAR_METHOD = '<text name="buoyancy_method" data="linear"/>'
"""Patches with the default tolerance, 1/400 of the hull's length, miss waves of a centimetre."""


@dataclass(frozen=True)
class Check:
    """A quantity, its unit, and the source and bounds of its expected value.

    known_gap: why the quantity is known to miss the bounds; empty if it must be within them.
    """

    group: str
    what: str
    unit: str
    source: str
    low: float
    high: float
    measure: Callable[[], float]
    known_gap: str = ""

    def verdict(self, found: float) -> str:
        if self.low <= found <= self.high:
            return "holds"
        off = f"off by {100.0 * self.miss(found):+.1f} %"
        return f"{off}: {self.known_gap}" if self.known_gap else off

    def miss(self, found: float) -> float:
        """Share of the nearer bound by which a value is beyond it; 0 within the bounds."""
        bound = min(max(found, self.low), self.high)
        return found / bound - 1.0 if found != bound else 0.0


class Once:
    """A measurement that runs once and serves several checks."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._work, self._found = work, None

    def __call__(self) -> Any:
        if self._found is None:
            self._found = self._work()
        return self._found


def about(value: float, share: float) -> tuple[float, float]:
    """The band within a share of a value, for sources that give a single number."""
    return tuple(sorted((value * (1.0 - share), value * (1.0 + share))))


def scene_of(
    body: str, custom: str = "", option: str = "", geoms: tuple[str, ...] = ("hull",),
    asset: str = "",
) -> Scene:  # fmt: skip
    """A scene in which geoms float. body, asset: MJCF of the bodies and of their meshes."""
    listed = "".join(f'<element objtype="geom" objname="{name}"/>' for name in geoms)
    return Scene.load(
        mujoco.MjSpec.from_string(
            f'<mujoco><option {option}/><custom>{custom}<tuple name="buoyant">{listed}</tuple>'
            f"</custom><asset>{asset}</asset><worldbody>{body}</worldbody></mujoco>"
        )
    )


def numeric(name: str, *numbers: Any) -> str:
    """The custom element of a field with numbers."""
    values = " ".join(map(str, np.concatenate([np.ravel(n) for n in numbers])))
    return f'<numeric name="{name}" data="{values}"/>'


def amplitudes(track: Array, omega: float) -> Array:
    """Amplitudes (N,) of motions at a frequency [rad/s], besides a mean and a drift. track: rows of
    time [s] and N values."""
    turns = omega * track[:, 0]
    basis = np.stack([np.cos(turns), np.sin(turns), np.ones_like(turns), turns], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, track[:, 1:], rcond=None)
    return np.hypot(*fitted[:2])
