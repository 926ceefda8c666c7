"""Words: a sea in one line."""

import numpy as np

from sim.water.sea import DEFAULT_PRESSURE, Sea

MOST_WAVES_NAMED = 4
"""Largest number of waves that are listed one by one."""


def sea_in_words(sea: Sea) -> str:
    """A line about a sea: its waves, one by one if there are few, and what is not a default."""
    return "; ".join([_waves(sea), *_others(sea)])


def _waves(sea: Sea) -> str:
    waves = sea.waves
    if not waves:
        return "still water"
    if len(waves) > MOST_WAVES_NAMED:
        lengths = [wave.wavelength for wave in waves]
        mean = sum(wave.amplitude**2 * np.exp(1j * wave.heading) for wave in waves)
        return (
            f"{len(waves)} waves of {min(lengths):.3g} to {max(lengths):.3g} m, significant height "
            f"{sea.significant_height:.3g} m, mean heading {_degrees(np.angle(mean))} deg, "
            f"steepness {sea.steepness:.2f}"
        )
    amplitudes = ", ".join(f"{wave.amplitude:.3g}" for wave in waves)
    lengths = ", ".join(f"{wave.wavelength:.3g}" for wave in waves)
    headings = ", ".join(_degrees(wave.heading) for wave in waves)
    return (
        f"{len(waves)} wave{'s' * (len(waves) > 1)}, amplitude {amplitudes} m, length {lengths} m, "
        f"heading {headings} deg, steepness {sea.steepness:.2f}"
    )


def _others(sea: Sea) -> list[str]:
    """What distinguishes a sea besides its waves."""
    words, default = [], Sea()
    speed = float(np.linalg.norm(sea.current))
    if speed > 0.0:
        towards = _degrees(np.arctan2(sea.current[1], sea.current[0]))
        words.append(f"current {speed:.3g} m/s towards {towards} deg")
    if sea.tide:
        levels = [level for _, level in sea.tide]
        words.append(f"tide from {min(levels):.3g} to {max(levels):.3g} m")
    elif sea.level != default.level:
        words.append(f"level {sea.level:.3g} m")
    if sea.depth != default.depth:
        words.append(f"depth {sea.depth:.3g} m")
    if sea.ramp > 0.0 and sea.waves:
        words.append(f"the waves grow for {sea.ramp:.3g} s")
    if sea.density != default.density:
        words.append(f"density {sea.density:.4g} kg/m^3")
    if sea.pressure != DEFAULT_PRESSURE:
        words.append(f"{sea.pressure} pressure")
    return words


def _degrees(angle: float) -> str:
    """An angle [rad] in whole degrees."""
    return f"{round(np.degrees(angle)) + 0}"
