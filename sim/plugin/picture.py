"""Picture: the sea in the pictures that MuJoCo renders, as triangles among its geoms.

The surface is a grid of cells, which is fine around the bodies and becomes coarser towards the
horizon. Each triangle is a geom whose matrix holds two of its sides, so neighbours share their
corners exactly and no edge is visible.

MuJoCo shades a triangle by its own normal, which makes facets visible. So each cell has a colour
that is computed here and shines by itself: water looks transparent from above and reflects the sky
at grazing angles. MuJoCo moves its camera after it has called the plugins, so the colours are those
for the camera of the picture before.
"""

import numpy as np

from sim.addresses import (
    bytes_at,
    call,
    float_at,
    floats_at,
    integer_at,
    store_byte,
    store_integer,
    store_single,
    word_at,
)
from sim.kernels import c_function, kernel, scratch
from sim.plugin.native import context_at, home_of, model_array, tables_of
from sim.water.gerstner import level_and_rise, solve_heights

MOST_CELLS = 100
"""Largest number of cells along a side of the grid, an even number."""

CORE_LENGTHS = 1.6
"""Distance from the outermost body to the edge of the grid's fine core, in lengths of the longest
hull."""

CORE_SHARE = 0.6
"""Share of the cells along a side that lie in the core."""

SEA_TO_CORE = 90.0
"""Width of the sea over the width of the core. Outside the core, each cell is longer than the one
before by the same factor."""

ROOM_SHARE = 0.75
"""Share of a scene's geoms that the sea may use; MuJoCo adds more geoms of the model later."""

ZENITH, HORIZON = (0.20, 0.45, 0.82), (0.84, 0.91, 0.95)
"""Red, green and blue, 0 to 1, of the reflected sky at the zenith and at the horizon."""

HORIZON_SHARPNESS = 3.2
"""Logarithmic rate at which the sky's colour changes from the horizon upwards, per unit of the sine
of the elevation angle."""

TROUGH, CREST = (0.01, 0.13, 0.24), (0.04, 0.40, 0.46)
"""Red, green and blue, 0 to 1, of the light from inside the water, in troughs and on crests."""

OPACITY = 0.55
"""Opacity of the water that does not reflect, 0 to 1."""

NORMAL_REFLECTANCE = 0.02
"""Share of vertical light that water reflects: ((n - 1) / (n + 1))^2 with n = 1.33."""

CALM_SHARE, HAZE_SHARE = 0.12, 0.5
"""Distances from the eye, as shares of half the sea's width. At the first one the drawn slopes are
1/e of the true ones; at the second one haze hides 1 - 1/e of the water."""

EMISSION, LIT = 8.2, 0.8
"""Emission of a triangle, and the light that a model's lamps add to it approximately, both as
factors of its colour. The colour is divided by their sum, so lamps hardly change the brightness."""

FIRST_EYE = (-1.2, -2.0, 0.9)
"""The eye before the first picture, from the middle of the grid, in half widths of the core."""


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
def axis(half, cells, lines_out):
    """Distances (cells + 1,) [m] of the grid's lines from its middle. half [m]: half the width of
    the core."""
    middle = cells // 2
    core = max(1, int(CORE_SHARE * middle))
    step, outer = half / core, middle - core
    low, high = 1.0, 1.0 + SEA_TO_CORE * core  # bounds of the factor between two steps
    for _ in range(60):
        factor = 0.5 * (low + high)
        length = 0.0
        for _ in range(outer):
            length = factor * (length + step)
        if length < (SEA_TO_CORE - 1.0) * half:
            low = factor
        else:
            high = factor
    lines_out[middle] = 0.0
    for i in range(1, middle + 1):
        step *= low if i > core else 1.0
        lines_out[middle + i] = lines_out[middle + i - 1] + step
        lines_out[middle - i] = -lines_out[middle + i]


@kernel
def grid(context, data, corners_out):
    """Corners (cells + 1, cells + 1, 3) [m] of the grid. Returns half the width of the core and the
    level [m].

    The grid follows the bodies in steps of a whole cell of the core, so its corners do not slide
    over the water.
    """
    tables, time = tables_of(context), float_at(data + context.layout.time)
    waves, water = tables.waves, tables.water
    x, y, reach = extent(context, data, tables.bodies)
    half = reach + CORE_LENGTHS * tables.picture[0].length
    side = corners_out.shape[0]
    lines = np.empty(side)
    axis(half, side - 1, lines)
    step = lines[side // 2 + 1]
    x, y = step * np.round(x / step), step * np.round(y / step)
    xs, ys, heights = np.empty(side * side), np.empty(side * side), np.empty(side * side)
    for i in range(side):
        for j in range(side):
            xs[i * side + j], ys[i * side + j] = x + lines[i], y + lines[j]
    solve_heights(xs, ys, waves, time, water[0].tolerance, heights)
    level, _ = level_and_rise(water[0], time)
    for i in range(side):
        for j in range(side):
            at = i * side + j
            corners_out[i, j, 0], corners_out[i, j, 1] = xs[at], ys[at]
            corners_out[i, j, 2] = level + heights[at]
    return half, level


@kernel
def shade(position, slope_x, slope_y, share, eye, far, colour_out):
    """Red, green, blue and opacity (4,) of the water at a position (3,) [m], seen from an eye (3,)
    [m]. share: 0 in the deepest trough, 1 on the highest crest. far [m]: half the sea's width.

    The reflected share is Schlick's approximation (An inexpensive BRDF model for physically-based
    rendering, 1994). The reflected ray's height gives the colour of the sky.
    """
    x, y, z = eye[0] - position[0], eye[1] - position[1], eye[2] - position[2]
    distance = max(np.sqrt(x * x + y * y + z * z), 1e-9)
    calm = np.exp(-distance / (CALM_SHARE * far))
    slope_x, slope_y = calm * slope_x, calm * slope_y
    up = 1.0 / np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    cosine = min(abs(up * (z - slope_x * x - slope_y * y)) / distance, 1.0)
    mirrored = NORMAL_REFLECTANCE + (1.0 - NORMAL_REFLECTANCE) * (1.0 - cosine) ** 5
    to_zenith = 1.0 - np.exp(-HORIZON_SHARPNESS * abs(2.0 * cosine * up - abs(z) / distance))
    haze = 1.0 - np.exp(-((distance / (HAZE_SHARE * far)) ** 1.5))
    for i in range(3):
        sky = HORIZON[i] + to_zenith * (ZENITH[i] - HORIZON[i])
        inside = TROUGH[i] + share * (CREST[i] - TROUGH[i])
        colour = inside + mirrored * (sky - inside)
        colour_out[i] = (colour + haze * (HORIZON[i] - colour)) / (EMISSION + LIT)
    colour_out[3] = max(OPACITY + (1.0 - OPACITY) * mirrored, haze)


@kernel
def eye_of(picture, scene, corners, half, eye_out):
    """The eye (3,) [m] of a scene's last picture; before the first picture, a place from where one
    would look at the middle of the grid. half [m]: half the width of the core."""
    found, middle = bytes_at(scene + picture.eye, (12,)).view(np.float32), corners.shape[0] // 2
    is_new = found[0] == 0.0 and found[1] == 0.0 and found[2] == 0.0
    for i in range(3):
        eye_out[i] = corners[middle, middle, i] + half * FIRST_EYE[i] if is_new else found[i]


@kernel
def draw_triangle(picture, geom, a, b, c, work):
    """Turn the mjvGeom at an address into a triangle with three corners (3,) [m]. The colour stands
    in `work[15:]`."""
    for i in range(3):
        work[i], work[3 + i] = 1.0, a[i]
        work[6 + 3 * i], work[7 + 3 * i] = b[i] - a[i], c[i] - a[i]
    x = work[9] * work[13] - work[12] * work[10]
    y = work[12] * work[7] - work[6] * work[13]
    z = work[6] * work[10] - work[9] * work[7]
    length = np.sqrt(x * x + y * y + z * z)
    work[8], work[11], work[14] = x / length, y / length, z / length
    start = work.ctypes.data
    call(picture.init_geom, (geom, picture.triangle, start, start + 24, start + 48, start + 120))
    store_integer(geom + picture.category, picture.decoration)
    store_single(geom + picture.emission, EMISSION)
    store_single(geom + picture.specular, 0.0)
    if picture.shadow != 0:
        store_byte(geom + picture.shadow, 0)


@kernel
def shade_cell(a, b, c, d, level, highest, eye, far, middle_out, colour_out):
    """The colour (4,) of a cell with four corners (3,) [m], and its middle (3,) [m]. highest [m]:
    the height of the highest crest above the level."""
    for k in range(3):
        middle_out[k] = 0.25 * (a[k] + b[k] + c[k] + d[k])
    slope_x = 0.5 * (b[2] + c[2] - a[2] - d[2]) / (b[0] - a[0])
    slope_y = 0.5 * (d[2] + c[2] - a[2] - b[2]) / (d[1] - a[1])
    share = 0.5 + 0.5 * (middle_out[2] - level) / max(highest, 1e-9)
    shade(middle_out, slope_x, slope_y, min(max(share, 0.0), 1.0), eye, far, colour_out)


@c_function
def draw_at(model, data, option, scene, instance):
    """Add the sea to a scene that MuJoCo is about to draw, as finely as its capacity allows."""
    home = home_of(model, data, instance)
    if home == 0:
        return
    context = context_at(word_at(home))
    tables = tables_of(context)
    picture = tables.picture[0]
    count = integer_at(scene + picture.count)
    room = int(ROOM_SHARE * integer_at(scene + picture.most)) - count
    cells = min(MOST_CELLS, 2 * int(0.5 * np.sqrt(0.5 * max(room, 0))))
    if picture.length == 0.0 or cells < 2:
        return
    corners, eye, middle = np.empty((cells + 1, cells + 1, 3)), scratch(3), scratch(3)
    work = scratch(17)
    colour = work[15:].view(np.float32)
    half, level = grid(context, data, corners)
    eye_of(picture, scene, corners, half, eye)
    highest, far = tables.water[0].amplitude, SEA_TO_CORE * half
    geom = word_at(scene + picture.geoms) + count * picture.geom_size
    for i in range(cells):
        for j in range(cells):
            a, b = corners[i, j], corners[i + 1, j]
            c, d = corners[i + 1, j + 1], corners[i, j + 1]
            shade_cell(a, b, c, d, level, highest, eye, far, middle, colour)
            draw_triangle(picture, geom, a, b, c, work)
            draw_triangle(picture, geom + picture.geom_size, a, c, d, work)
            geom += 2 * picture.geom_size
    store_integer(scene + picture.count, count + 2 * cells * cells)
