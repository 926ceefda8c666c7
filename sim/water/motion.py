"""Motion: how the water moves below the surface.

A particle moves on the circle of the surface particle above it, with the radius times exp(- k
depth). Label and depth refer to the surface directly above the point. This is exact at the surface.
At depth it has a relative error of k a, where little of the motion is left.
"""

import numpy as np

from sim.kernels import kernel, record
from sim.water.gerstner import ROW, decay, growth, level_and_rise, sine_cosine

MOTION = record(x=ROW, y=ROW, z=ROW)
"""Workspace: velocities [m/s] or accelerations [m/s^2] of the water at a chunk's points."""

VELOCITY, ACCELERATION = np.int64(0), np.int64(1)
"""Orders of a motion. NumPy integers, because each Python integer would compile `water_motion`
again."""


@kernel
def water_motion(order, depths, waves, water, time, labels, motion_out):
    """Velocities or accelerations of the water at the depths (N,) [m] below the first N LABELS.

    An acceleration is - omega times the velocity a quarter of a turn later. The growth of the waves
    is neglected: it takes many periods.
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
        for i in range(count):
            s, c = sine_cosine(turns_x * at.x[i] + turns_y * at.y[i] + turns)
            swing = speed * decay(k * depths[i])
            v.x[i] += dx * swing * s
            v.y[i] += dy * swing * s
            v.z[i] -= swing * c
