"""Picture: the sea in the pictures that MuJoCo renders, as triangles among its geoms.

Around the bodies the surface is a grid of cells. A flat border extends outwards from the grid. Each
triangle is a geom whose matrix holds two of its sides, so neighbours share their corners exactly
and no edge is visible.
"""

import numpy as np

from sim.addresses import (
    call,
    float_at,
    floats_at,
    integer_at,
    store_byte,
    store_integer,
    store_single,
    word_at,
)
from sim.kernels import c_function, kernel
from sim.plugin.native import context_at, home_of, model_array, tables_of
from sim.water.gerstner import level_and_rise, solve_heights

MOST_CELLS = 56
"""Largest number of cells along a side of the grid."""

GRID_REACH_LENGTHS = 3.0
"""Distance from the outermost body to the edge of the grid, in lengths of the longest hull."""

BORDER_TO_GRID = 12.0
"""Half the width of the flat border over half the width of the grid."""

ROOM_SHARE = 0.75
"""Share of a scene's geoms that the sea may use; MuJoCo adds more geoms of the model later."""

COLOUR = (0.08, 0.32, 0.5, 0.6)
"""Red, green, blue and opacity of the sea, 0 to 1."""

SPECULAR, SHININESS, EMISSION = 0.4, 0.6, 0.3
"""Strength and sharpness of highlights, and share of the colour that shows without light, 0 to 1. A
stronger highlight would make the flat facets visible."""


@kernel
def extent(context, data, bodies):
    """The mean x and y [m] of all floating bodies, and the largest distance [m] of a body from
    there."""
    centres = floats_at(model_array(data, context.layout.xipos), (context.bodies, 3))
    x, y, reach = 0.0, 0.0, 0.0
    for b in range(bodies.size):
        x += centres[bodies[b].body, 0] / bodies.size
        y += centres[bodies[b].body, 1] / bodies.size
    for b in range(bodies.size):
        i = bodies[b].body
        reach = max(reach, np.hypot(centres[i, 0] - x, centres[i, 1] - y))
    return x, y, reach


@kernel
def grid(context, data, cells, border, corners_out):
    """Corners (cells + 3, cells + 3, 3) [m] of the grid; the outermost ones belong to the border.

    The grid follows the bodies in steps of a whole cell, so its corners do not slide over the
    water.
    """
    tables, time = tables_of(context), float_at(data + context.layout.time)
    waves, water = tables.waves, tables.water
    x, y, reach = extent(context, data, tables.bodies)
    half = reach + GRID_REACH_LENGTHS * tables.picture[0].length
    step = 2.0 * half / cells
    x, y = step * np.round(x / step), step * np.round(y / step)
    side = cells + 3
    xs, ys, heights = np.empty(side * side), np.empty(side * side), np.empty(side * side)
    for i in range(side):
        for j in range(side):
            xs[i * side + j] = x - half + step * min(max(i - 1, 0), cells)
            ys[i * side + j] = y - half + step * min(max(j - 1, 0), cells)
    solve_heights(xs, ys, waves, time, water[0].tolerance, heights)
    level, _ = level_and_rise(water[0], time)
    for i in range(side):
        for j in range(side):
            at = i * side + j
            is_border = i == 0 or j == 0 or i == side - 1 or j == side - 1
            factor = border if is_border else 1.0
            corners_out[i, j, 0] = x + factor * (xs[at] - x)
            corners_out[i, j, 1] = y + factor * (ys[at] - y)
            corners_out[i, j, 2] = level + (0.0 if is_border else heights[at])


@kernel
def draw_triangle(picture, geom, a, b, c, work):
    """Turn the mjvGeom at an address into a triangle with three corners (3,) [m]."""
    for i in range(3):
        work[i], work[3 + i] = 1.0, a[i]
        work[6 + 3 * i], work[7 + 3 * i] = b[i] - a[i], c[i] - a[i]
    x = work[9] * work[13] - work[12] * work[10]
    y = work[12] * work[7] - work[6] * work[13]
    z = work[6] * work[10] - work[9] * work[7]
    length = max(np.sqrt(x * x + y * y + z * z), 1e-12)  # some border triangles have no area
    work[8], work[11], work[14] = x / length, y / length, z / length
    start = work.ctypes.data
    call(picture.init_geom, (geom, picture.triangle, start, start + 24, start + 48, start + 120))
    store_integer(geom + picture.category, picture.decoration)
    store_single(geom + picture.emission, EMISSION)
    store_single(geom + picture.specular, SPECULAR)
    store_single(geom + picture.shininess, SHININESS)
    if picture.shadow != 0:
        store_byte(geom + picture.shadow, 0)


@c_function
def draw_at(model, data, option, scene, instance):
    """Add the sea to a scene that MuJoCo is about to draw, as finely as its capacity allows."""
    home = home_of(model, data, instance)
    if home == 0:
        return
    context = context_at(word_at(home))
    picture = tables_of(context).picture[0]
    count = integer_at(scene + picture.count)
    room = int(ROOM_SHARE * integer_at(scene + picture.most)) - count
    cells = min(MOST_CELLS, int(np.sqrt(0.5 * max(room, 0))) - 2)
    if picture.length == 0.0 or cells < 1:
        return
    corners, work = np.empty((cells + 3, cells + 3, 3)), np.empty(17)
    colour = work[15:].view(np.float32)
    colour[0], colour[1], colour[2], colour[3] = COLOUR
    grid(context, data, cells, BORDER_TO_GRID, corners)
    geom = word_at(scene + picture.geoms) + count * picture.geom_size
    for i in range(cells + 2):
        for j in range(cells + 2):
            a, b = corners[i, j], corners[i + 1, j]
            c, d = corners[i + 1, j + 1], corners[i, j + 1]
            draw_triangle(picture, geom, a, b, c, work)
            draw_triangle(picture, geom + picture.geom_size, a, c, d, work)
            geom += 2 * picture.geom_size
    store_integer(scene + picture.count, count + 2 * (cells + 2) * (cells + 2))
