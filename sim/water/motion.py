"""Motion: how the water moves below the surface.

A particle moves on the circle of the surface particle above it, with the radius times exp(- k
depth). Label and depth refer to the surface directly above the point. This is exact at the surface.
At depth it has a relative error of k a, where little of the motion is left. In water of depth H the
circles are ellipses: the velocities are omega (a / T) C along the wave and omega (a / T) S upwards
(see `head`), so no water crosses the bottom.

These orbits close, but real ones do not. The mean velocity of their particles, the Stokes drift, is
of second order in the waves' amplitudes. A sea may have it, too: along each wave's heading

    omega k a^2 e^(-2 k d),

and in water of depth H

    omega k a^2 cosh(2 k (H - d)) / (2 sinh^2(k H)).

Above the surface, where interpolation needs a motion, it is reflected: that at the surface, plus
what it loses from there to the same distance below. So it is smooth at the surface, and bounded.

Source: Stokes 1847; Phillips 1977, 3.3, for finite depth.
"""

import numpy as np

from sim.kernels import inline, kernel, record
from sim.water.gerstner import (
    REALS,
    bed_decays,
    decay,
    growth,
    level_and_rise,
    set_phases,
    sine_cosine,
)

MOTION = record(x=REALS, y=REALS, z=REALS, phase=REALS)
"""Workspace: velocities [m/s] or accelerations [m/s^2] of the water at a chunk's points; phase:
of one wave, as in SUMS."""

VELOCITY, ACCELERATION = np.int64(0), np.int64(1)
"""Orders of a motion. NumPy integers, because each Python integer would compile `water_motion`
again."""


@inline
def add_swing(v, i, dx, dy, along, up, s, c):
    """Add one wave, with sine s and cosine c of its phase, to the motion at point i. along, up: the
    radii of its motion."""
    v.x[i] += dx * along * s
    v.y[i] += dy * along * s
    v.z[i] -= up * c


@inline
def reflected(at_surface, below, depth):
    """A value that decays with depth, at a depth [m] that may be negative. below: at its
    magnitude."""
    return below if depth >= 0.0 else 2.0 * at_surface - below


@inline
def drift_decay(phase, bed):
    """cosh(2 k (H - d)) / (2 sinh^2(k H)) at a depth d in water of depth H, from phase = k d >= 0
    and bed = 2 k H; e^(-2 k d) on deep water, where bed is 0."""
    if bed == 0.0:
        return decay(2.0 * phase)
    down, up = decay(2.0 * phase), decay(max(2.0 * (bed - phase), 0.0))
    below = 1.0 - decay(bed)
    return (down + up) / (below * below)


@kernel
def add_drift(depths, wave, time, motion_out):
    """Add the Stokes drift of a wave at depths (N,) [m] to the velocities of the water."""
    v, k = motion_out[0], wave.wavenumber
    amplitude = growth(wave, time) * wave.amplitude
    speed = wave.rate * k * amplitude * amplitude
    x, y = speed * wave.direction_x, speed * wave.direction_y
    for i in range(depths.size):
        share = drift_decay(k * max(depths[i], 0.0), wave.bed)
        v.x[i] += x * share
        v.y[i] += y * share


@kernel
def water_motion(order, depths, waves, water, time, labels, motion_out):
    """Velocities or accelerations of the water at the depths (N,) [m] below the first N LABELS.
    Depths may be negative.

    An acceleration is - omega times the velocity a quarter of a turn later. The growth of the waves
    is neglected: it takes many periods. A velocity includes the Stokes drift of a sea that has it.
    """
    at, v, count = labels[0], motion_out[0], depths.size
    x, y, z = 0.0, 0.0, 0.0
    if order == VELOCITY:
        _, rise = level_and_rise(water[0], time)
        x, y, z = water[0].current[0], water[0].current[1], water[0].current[2] + rise
    for i in range(count):
        v.x[i], v.y[i], v.z[i] = x, y, z
    for w in range(waves.size):
        wave = waves[w]
        turns_x, turns_y = wave.turns_x, wave.turns_y
        turns = wave.turns - wave.frequency * time + 0.25 * order
        k, dx, dy = wave.wavenumber, wave.direction_x, wave.direction_y
        speed = growth(wave, time) * wave.rate * wave.amplitude
        if order == ACCELERATION:
            speed *= -wave.rate
        set_phases(v, count, turns_x, turns_y, turns, at)
        if wave.bed == 0.0:
            for i in range(count):
                s, c = sine_cosine(v.phase[i])
                below = decay(k * abs(depths[i]))
                swing = speed * reflected(1.0, below, depths[i])
                add_swing(v, i, dx, dy, swing, swing, s, c)
        else:
            speed *= wave.stretch
            for i in range(count):
                s, c = sine_cosine(v.phase[i])
                along, up = bed_decays(k * abs(depths[i]), wave.bed, wave.tanh)
                along = speed * reflected(1.0, along, depths[i])
                up = speed * reflected(wave.tanh, up, depths[i])
                add_swing(v, i, dx, dy, along, up, s, c)
        if order == VELOCITY and water[0].drifts:
            add_drift(depths, wave, time, motion_out)
