"""Motion: how the water moves below the surface.

A particle moves on the circle of the surface particle above it with the radius times
exp(- k depth). Label and depth are those of the surface right above the point, which is exact at
the surface and off by a relative k a at depth, where little is left of the motion.
"""

import numpy as np

from sim.kernels import kernel, record
from sim.water.gerstner import LABELS, LANES, ROW, decay, set_labels, sine_cosine, solve_labels
from sim.water.head import depth

VELOCITIES = record(x=ROW, y=ROW, z=ROW)
"""Workspace: velocities [m/s] of the water at a chunk's points."""


@kernel
def water_velocities(count, depths, waves, time, labels, velocities_out):
    """VELOCITIES of the water at the depths (N,) [m] below the first `count` LABELS."""
    at, v = labels[0], velocities_out[0]
    for i in range(count):
        v.x[i], v.y[i], v.z[i] = 0.0, 0.0, 0.0
    for w in range(waves.size):
        wave = waves[w]
        turns_x, turns_y = wave.turns_x, wave.turns_y
        turns = wave.turns - wave.frequency * time
        k, dx, dy = wave.wavenumber, wave.direction_x, wave.direction_y
        speed = 2.0 * np.pi * wave.frequency * wave.amplitude
        for i in range(count):
            s, c = sine_cosine(turns_x * at.x[i] + turns_y * at.y[i] + turns)
            swing = speed * decay(k * depths[i])
            v.x[i] += dx * swing * s
            v.y[i] += dy * swing * s
            v.z[i] -= swing * c


@kernel
def motion_below(depth, waves, time, labels, velocities, motion_out):
    """See `water_motion`: its workspaces hold the label and the velocity at the point."""
    at, v = labels[0], velocities[0]
    motion_out[0], motion_out[1], motion_out[2] = v.x[0], v.y[0], v.z[0]
    motion_out[3:] = 0.0
    for w in range(waves.size):
        wave = waves[w]
        s, c = sine_cosine(
            wave.turns_x * at.x[0] + wave.turns_y * at.y[0] + (wave.turns - wave.frequency * time)
        )
        rate = 2.0 * np.pi * wave.frequency
        a = rate * rate * wave.amplitude * decay(wave.wavenumber * depth)
        motion_out[3] -= wave.direction_x * a * c
        motion_out[4] -= wave.direction_y * a * c
        motion_out[5] -= a * s


@kernel
def water_motion(point, waves, water, time, motion_out):
    """Velocity [m/s] and acceleration [m/s^2] (6,) of the water at a point (3,)."""
    guess, labels, velocities = np.empty(1, LABELS), np.empty(1, LABELS), np.empty(1, VELOCITIES)
    height, depths = np.empty(1), np.empty(LANES)
    x, y = point[:1], point[1:2]
    set_labels(x, y, guess)
    solve_labels(x, y, guess, waves, time, water[0].tolerance, 1, height, labels)
    depths[:] = max(depth(height[0], point[2] - water[0].level), 0.0)
    water_velocities(1, depths, waves, time, labels, velocities)
    motion_below(depths[0], waves, time, labels, velocities, motion_out)
