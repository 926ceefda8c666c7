"""Colours: those of a model as MuJoCo's viewer shows it, palettes, and Rerun's packed format."""

import colorsys

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHOWN_GROUPS = 3
"""Number of groups that are drawn, from 0, as in MuJoCo's viewer."""

DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
"""The colour of a geom that has none of its own. The colour of its material then counts."""

SHADES = 256
"""Number of colours of a palette."""

LEAST_SATURATION, LEAST_VALUE = 0.55, 0.75
"""Saturation and value of colours whose hue is shifted, so that greys get a hue too."""

HUE_STEP = 0.618
"""Difference in hue between successive twins or bodies, in turns. The golden ratio keeps all hues
apart."""

LIKENESS = 40.0
"""Distance between two colours below which they count as alike."""


def colour_of(model: mujoco.MjModel, rgba: NDArray[np.float32], material: int) -> Array:
    """The colour (4,), 0 to 1, of a geom or site with a colour and a material (-1 for none)."""
    is_own = material < 0 or not np.array_equal(rgba, DEFAULT_RGBA)
    return (rgba if is_own else model.mat_rgba[material]).astype(float)


def is_shown(model: mujoco.MjModel, geom: int) -> bool:
    """Whether MuJoCo's viewer draws a geom."""
    opacity = colour_of(model, model.geom_rgba[geom], int(model.geom_matid[geom]))[3]
    return bool(model.geom_group[geom] < SHOWN_GROUPS and opacity > 0.0)


def rounded(colour: Array) -> NDArray[np.uint8]:
    return np.round(colour).astype(np.uint8)


def shades(values: Array) -> NDArray[np.uint8]:
    """Indices into a palette of values from -1/2 to 1/2; other values are clipped."""
    return np.clip(SHADES * (values + 0.5), 0.0, SHADES - 1.0).astype(np.uint8)


def packed(colours: Array) -> NDArray[np.uint32]:
    """Opaque colours (3, N), 0 to 255, in Rerun's format 0xRRGGBBAA."""
    r, g, b = (colours + 0.5).astype(np.uint32)
    return (r << 24) | (g << 16) | (b << 8) | 255


def palette(first: Array, last: Array) -> NDArray[np.uint32]:
    """SHADES opaque colours between two colours (3,), packed."""
    share = np.linspace(0.0, 1.0, SHADES)
    return packed(first[:, None] + share * (last - first)[:, None])


def with_hue_shifted(rgba: Array, turns: float) -> Array:
    """A colour (4,), 0 to 1, with its hue shifted by turns of the colour circle; itself for 0."""
    if turns == 0.0:
        return rgba
    hue, saturation, value = colorsys.rgb_to_hsv(*rgba[:3].tolist())
    saturation, value = max(saturation, LEAST_SATURATION), max(value, LEAST_VALUE)
    return np.array([*colorsys.hsv_to_rgb(hue + turns, saturation, value), rgba[3]])


def told_apart(colours: list[Array]) -> list[Array]:
    """Colours (3,), 0 to 255, of which those like an earlier one have another hue."""
    found: list[Array] = []
    for i, colour in enumerate(colours):
        if any(np.abs(colour - other).max() < LIKENESS for other in found):
            colour = 255.0 * with_hue_shifted(np.array([*colour / 255.0, 1.0]), i * HUE_STEP)[:3]
        found.append(colour)
    return found
