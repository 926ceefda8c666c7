"""Gauge: a sensor of the water at a site, the plugin `waterline.gauge`.

    <extension><plugin plugin="waterline.gauge"/></extension>
    <sensor>
      <plugin name="bow" plugin="waterline.gauge" objtype="site" objname="bow"/>
    </sensor>

Its five numbers in `data.sensordata` are z [m] of the water's surface directly above or below the
site, the head [m] at the site (positive below the surface), and the velocity [m/s] of the water at
the site in world axes. If the site is above the surface, it is the velocity of the surface.
"""

from sim.addresses import float_at, floats_at, integer_at, integers_at, word_at
from sim.kernels import c_function, kernel, scratch, workspace
from sim.plugin.native import (
    context_at,
    home_of,
    lower_half,
    model_array,
    tables_of,
    water_instance,
)
from sim.water.gerstner import LABELS, ONE, level_and_rise, set_labels, solve_labels
from sim.water.head import solve_heads
from sim.water.motion import MOTION, VELOCITY, water_motion

GAUGE_SIZE = 5
"""Number of values that a gauge measures."""


@kernel
def read_motion(motion, velocity_out):
    """Copy the first velocity (3,) [m/s] of a MOTION."""
    water = motion[0]
    velocity_out[0], velocity_out[1], velocity_out[2] = water.x[0], water.y[0], water.z[0]


@kernel
def gauge(context, time, place, readings_out):
    """z of the surface [m], head [m] and velocity [m/s] of the water, (5,), at a point (3,) [m]."""
    tables = tables_of(context)
    waves, water = tables.waves, tables.water
    labels, guess, motion = workspace(LABELS), workspace(LABELS), workspace(MOTION)
    x, y, z = place[:1].copy(), place[1:2].copy(), place[2:3].copy()
    height, level = scratch(1), level_and_rise(water[0], time)[0]
    set_labels(x, y, guess)
    solve_labels(x, y, guess, waves, time, water[0].tolerance, ONE, height, labels)
    readings_out[0] = level + height[0]
    solve_heads(x, y, z, waves, water, time, readings_out[1:2])
    height[0] = max(readings_out[0] - z[0], 0.0)  # the depth
    water_motion(VELOCITY, height, waves, water, time, labels, motion)
    read_motion(motion, readings_out[2:])


@c_function
def gauge_at(model, data, instance, capability):
    """Write the readings of all gauges of an instance; MuJoCo calls this in the position stage."""
    water = water_instance(model)
    home = home_of(model, data, water) if water >= 0 else 0
    if home == 0:
        return
    context = context_at(word_at(home))
    layout, time = context.layout, float_at(data + context.layout.time)
    count = integer_at(model + layout.nsensor)
    instances = integers_at(model_array(model, layout.sensor_plugin), (count,))
    sites = integers_at(model_array(model, layout.sensor_objid), (count,))
    starts = integers_at(model_array(model, layout.sensor_adr), (count,))
    for s in range(count):
        if instances[s] == lower_half(instance):
            place = floats_at(model_array(data, layout.site_xpos) + 24 * sites[s], (3,))
            readings = floats_at(
                model_array(data, layout.sensordata) + 8 * starts[s], (GAUGE_SIZE,)
            )
            gauge(context, time, place, readings)
