"""Motion: how the water moves below the surface.

A particle moves on the circle of the surface particle above it with the radius times
exp(- k depth). Label and depth are those of the surface right above the point, which is exact at
the surface and off by a relative k a at depth, where little is left of the motion.
"""

import numpy as np

from sim.kernels import kernel, record
from sim.water.gerstner import ROW, decay, sine_cosine

MOTION = record(x=ROW, y=ROW, z=ROW)
"""Workspace: velocities [m/s] or accelerations [m/s^2] of the water at a chunk's points."""

VELOCITY, ACCELERATION = 0, 1
"""Orders of a motion."""


@kernel
def water_motion(order, depths, waves, time, labels, motion_out):
    """Velocities or accelerations of the water at the depths (N,) [m] below the first N LABELS.

    An acceleration is - omega times the velocity a quarter of a turn later.
    """
    at, v, count = labels[0], motion_out[0], depths.size
    for i in range(count):
        v.x[i], v.y[i], v.z[i] = 0.0, 0.0, 0.0
    for w in range(waves.size):
        wave = waves[w]
        turns_x, turns_y = wave.turns_x, wave.turns_y
        turns = wave.turns - wave.frequency * time + 0.25 * order
        k, dx, dy = wave.wavenumber, wave.direction_x, wave.direction_y
        rate = 2.0 * np.pi * wave.frequency
        speed = rate * wave.amplitude * (-rate if order == ACCELERATION else 1.0)
        for i in range(count):
            s, c = sine_cosine(turns_x * at.x[i] + turns_y * at.y[i] + turns)
            swing = speed * decay(k * depths[i])
            v.x[i] += dx * swing * s
            v.y[i] += dy * swing * s
            v.z[i] -= swing * c
