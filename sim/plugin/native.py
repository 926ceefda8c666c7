"""Native: the plugin's work in a step, as C functions that MuJoCo calls without the interpreter.

All data that a call needs about a model are in a *context*, a record with addresses of tables that
never change. All data that a call keeps about a state are in its *home*, a record that belongs to
one MjData. So any number of threads, states, copies and batches may use a context at once. Masses,
inertias, frames and the timestep, which a user may change in a compiled model, are read at each
call.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.addresses import (
    atomic_add,
    bits_of,
    bytes_at,
    call,
    call_kernel,
    float_at,
    floats_at,
    integer_at,
    integers_at,
    named_word,
    nanoseconds,
    records_at,
    rows_at,
    store_word,
    word_at,
    words_at,
)
from sim.geometry import cross
from sim.kernels import c_function, c_query, inline, kernel, record, scratch, table, workspace
from sim.methods.method import is_known
from sim.plugin.layout import LAYOUT
from sim.precision import single
from sim.resistance.elements import SURFACE, Pose
from sim.resistance.probes import PROBE, Flow
from sim.resistance.reaction import HULL, REACTION, hull_reaction
from sim.water.gerstner import WATER, WAVE

Array = NDArray[np.float64]

SINGLE_HULL, SINGLE_SURFACE, SINGLE_PROBE, SINGLE_WAVE = map(single, (HULL, SURFACE, PROBE, WAVE))
single_hull_reaction = single(hull_reaction)

CONTEXT = record(
    bodies="i8", geoms="i8", freedoms="i8", matrix="i8", hulls="i8", own="i8", block="i8",
    block_size="i8", push="i8", act="i8", resist="i8", make_inertia="i8", factor_inertia="i8",
    release="i8", homes="i8", fields="i8", field_count="i8", respond="i8", responses="i8",
    responses_size="i8", memory_start="i8", memory_size="i8", layout=LAYOUT,
)  # fmt: skip
"""The data that a call needs about a model.

bodies, geoms, freedoms, matrix: numbers of bodies, geoms, degrees of freedom and entries of M.
hulls: number of hulls. own: address of this record. block, block_size: block of the Tables. push,
act, resist: functions that compute the hulls' wrenches, do a step's work and add resistance (0 if
there is none). make_inertia, factor_inertia, release: MuJoCo's functions that make M, factorise M
and free memory. homes: number of homes that use the context. fields, field_count: FIELD rows.
respond: function that adds the responses of bodies (0 if there are none; see `response`).
responses, responses_size: block of their tables. memory_start, memory_size: index and number of
their numbers in the plugin's states. layout: MuJoCo's layout."""

HOME = record(
    context="i8", content="i8", memories="i8", refused="i8", calls="i8", nanoseconds="i8",
    data="i8", states="i8",
)  # fmt: skip
"""The data that belong to one MjData.

context: address of its context. content: content number of the model that the context was made
from. memories: number of rows of HOME_ROW_SIZE numbers that follow this record. refused: whether
the model was refused at the last reset. calls, nanoseconds: number of calls and their time [ns].
data, states: addresses of the MjData and of the plugin's states in it, which identify the home. The
states are as many rows of MEMORY_SIZE numbers, followed by the content number."""

CONTEXT_OF, CONTENT, MEMORIES, REFUSED, CALLS, NANOSECONDS, DATA, OWN_STATES = range(8)
"""Indices of HOME's words."""

SLAB, MOST_SLABS = 1024, 4096
"""Number of homes in a slab, and largest number of slabs (see `homes`)."""

HOMES_OFFSET = dict(CONTEXT.fields or {})["homes"][1]
"""Offset [bytes] of the number of homes in a CONTEXT."""

HOME_SIZE = HOME.itemsize

MEMORY_SIZE = 12
"""Numbers that are remembered about a body's row of xfrc_applied: the 6 that the plugin wrote
there, and the 6 of the user's push in them."""

EARLIER_ROWS = 8
"""Earlier rows that a home also remembers per body: rows of xfrc_applied that were found together
with plugin states from another time. An INTEGRATION state saved at such a moment restores both."""

HOME_ROW_SIZE = MEMORY_SIZE * (1 + EARLIER_ROWS)
"""Numbers that a home keeps per body that can move."""

PART = record(kernel="i8", block="i8", block_size="i8", places="i8", count="i8", size="i8")
"""The hulls of a method: addresses of its kernel, its block and the array of the hulls' places (see
`methods.Place`), with their count and the size [bytes] of one."""

FLOAT = record(geom="i8", hull="i8", resisted="i8")
"""A hull: its geom, its row among the wrenches, and its HULL row, -1 if it has no resistance. The
rows of a body are contiguous."""

BODY = record(body="i8", root="i8", memory="i8", first="i8", end="i8", link="i8")
"""A body: its id, the id of its tree's root, at whose centre of mass cvel is given, its memory row,
the range of its FLOAT rows, and its LINK row, if it has resistance."""

LINK = record(parent="i8", first_dof="i8", end_dof="i8")
"""A body with joints that moves a body with resistance: the LINK row of the next one above it, -1
for none, and the range of its degrees of freedom. Parents come first."""

CARRIED = record(rate=("f8", 6), inertia=("f8", (6, 6)))
"""What a step keeps for a LINK, in world axes about the centre of mass of its tree, angular parts
first.

rate: how joint velocities change its motion, the sum of cdof_dot qvel; inertia: matrix of the
water's inertia and damping that it carries.
"""

PICTURE = record(
    length="f8", init_geom="i8", triangle="i8", decoration="i8", most="i8", count="i8", geoms="i8",
    eye="i8", geom_size="i8", category="i8", emission="i8", specular="i8", shadow="i8",
)  # fmt: skip
"""The data for drawing.

length: length [m] of the longest hull, 0 to draw nothing. init_geom: address of mjv_initGeom.
triangle, decoration: mjGEOM_TRIANGLE and mjCAT_DECOR. most, count, geoms: offsets in an mjvScene of
its capacity, its number of geoms, the pointer to them and the eye of the first camera. geom_size:
bytes of an mjvGeom. category, emission, specular, shadow: offsets in an mjvGeom; shadow is 0 where
there is none."""

FIELD = record(pointer="i8", counter="i8", size="i8", matters="i8")
"""An array of a model that hulls and waves are made from: the offsets of its pointer and of its
number of rows, the size of a row, and for which models it matters: ALWAYS, WITH_MATRICES or
WITH_CUTS. If `counter` is 0, the data are a single row in the mjModel itself."""

ALWAYS, WITH_MATRICES, WITH_CUTS = range(3)
"""All models, those with a numeric of the size of a matrix, and those with a text "cut"."""

SEAM = np.zeros(7, dtype=np.int64)
"""Words that all calls need, at the indices below.

WORDS: offset of plugin_data in an mjData. INSTANCES, SLOTS: offsets of the number of plugin
instances and of their plugin numbers in an mjModel. SLOT: the number of this plugin. SLABS: address
of the table of slabs. FIND, RENEW: Python functions that correct the word of an unpickled state and
that give a home a new context."""

WORDS, INSTANCES, SLOTS, SLOT, SLABS, FIND, RENEW = range(7)

seam = named_word("waterline_seam", SEAM.ctypes.data)


RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
"""The number of the integrator whose stages each take the whole timestep."""

CONTACT_FLAG = 1 << 4
"""mjDSBL_CONTACT, which MuJoCo's compiler sets during its own test step."""

EXACT_MASK = (1 << 52) - 1
"""Mask of the bits of an integer that a double holds exactly."""

MATRIX_SIZES = (6, 36)
"""Sizes of numerics that may be added mass or damping, which depend on masses and frames."""

CUT = tuple(b"cut")
"""The letters of the text that cuts hulls, which depends on how the bodies stand to each other."""

PANEL_CODE = tuple(b"hyd")
"""Letters in the names of texts `hydrodynamics_<body>`, which depend on masses and frames, too."""


class Tables(NamedTuple):
    """Tables of a context's block: FLOAT, BODY, LINK, HULL, SURFACE, WAVE, WATER, PART, PICTURE,
    PROBE. Those of drag, HULL, SURFACE, PROBE and the waves once more, are in single precision."""

    floats: NDArray[np.void]
    bodies: NDArray[np.void]
    links: NDArray[np.void]
    hulls: NDArray[np.void]
    surfaces: NDArray[np.void]
    waves: NDArray[np.void]
    water: NDArray[np.void]
    parts: NDArray[np.void]
    picture: NDArray[np.void]
    probes: NDArray[np.void]
    single_waves: NDArray[np.void]


class State(NamedTuple):
    """Frames of a state: xipos and ximat of the bodies, geom_xpos and geom_xmat."""

    centres: Array
    axes: Array
    places: Array
    turns: Array


class Step(NamedTuple):
    """What resistance is computed from: a context, in a table of one row, the addresses of model
    and data, and CARRIED rows of the links. It is small, because each call of a kernel copies
    it."""

    contexts: NDArray[np.void]
    model: int
    data: int
    carried: NDArray[np.void]


@inline
def context_at(address):
    return rows_at(address, 1, CONTEXT)[0]


@inline
def block_at(address, size):
    return bytes_at(address, (size,))


@inline
def tables_of(context):
    """The tables of a context. Those that the caller does not use are not read."""
    block = block_at(context.block, context.block_size)
    return Tables(
        table(block, 0, FLOAT), table(block, 1, BODY), table(block, 2, LINK),
        table(block, 3, SINGLE_HULL), table(block, 4, SINGLE_SURFACE), table(block, 5, WAVE),
        table(block, 6, WATER), table(block, 7, PART), table(block, 8, PICTURE),
        table(block, 9, SINGLE_PROBE), table(block, 10, SINGLE_WAVE),
    )  # fmt: skip


@inline
def state_of(context, data):
    """The frames of a state."""
    layout, bodies, geoms = context.layout, context.bodies, context.geoms
    return State(
        floats_at(model_array(data, layout.xipos), (bodies, 3)),
        floats_at(model_array(data, layout.ximat), (bodies, 9)),
        floats_at(model_array(data, layout.geom_xpos), (geoms, 3)),
        floats_at(model_array(data, layout.geom_xmat), (geoms, 9)),
    )


@inline
def model_array(model, offset):
    """The address of the array of a model or a state whose pointer is at an offset."""
    return word_at(model + offset)


@inline
def step_of(address, model, data, carried):
    """The Step of a call; carried: address of its CARRIED rows."""
    count = tables_of(context_at(address)).links.size
    rows = rows_at(carried, count, CARRIED)
    return Step(rows_at(address, 1, CONTEXT), model, data, rows)


@inline
def tables_in(step):
    return tables_of(step.contexts[0])


@inline
def state_in(step):
    return state_of(step.contexts[0], step.data)


# The content number: a hash of all data that hulls and waves are made from


@inline
def mixed(sum_, word):
    """Mix another word into a hash, so that each of its bits may change each bit of the hash."""
    sum_ = (sum_ ^ word) * 0x2545F4914F6CDD1D
    return sum_ ^ (sum_ >> 29)


@kernel
def mixed_bytes(start, count, sum_):
    """Mix bytes at an address into a hash, in four independent sums for speed."""
    words = words_at(start, (count // 8,))
    a, b, c, d = sum_, sum_ + 1, sum_ + 2, sum_ + 3
    whole = words.size - words.size % 4
    for i in range(0, whole, 4):
        a, b = mixed(a, words[i]), mixed(b, words[i + 1])
        c, d = mixed(c, words[i + 2]), mixed(d, words[i + 3])
    for i in range(whole, words.size):
        a = mixed(a, words[i])
    rest = bytes_at(start + 8 * words.size, (count % 8,))
    for i in range(rest.size):
        b = mixed(b, np.int64(rest[i]))
    return mixed(mixed(mixed(a, b), c), mixed(d, count))


@kernel
def has_letters(model, pointer, counter, letters):
    """Whether three letters occur in an array of characters."""
    count = integer_at(model + counter)
    text = bytes_at(model_array(model, pointer), (count,))
    for i in range(count - 2):
        if text[i] == letters[0] and text[i + 1] == letters[1] and text[i + 2] == letters[2]:
            return True
    return False


@kernel
def has_matrices(model, layout):
    """Whether a numeric has the size of a matrix of added mass or damping, or of a memory, or a
    name has the letters of a panel code's coefficients."""
    count = integer_at(model + layout.nnumeric)
    sizes = integers_at(model_array(model, layout.numeric_size), (count,))
    for i in range(sizes.size):
        if sizes[i] == MATRIX_SIZES[0] or sizes[i] == MATRIX_SIZES[1] or sizes[i] % 8 == 0:
            return True
    return has_letters(model, layout.names, layout.nnames, PANEL_CODE)


@kernel
def content_of(context, model):
    """The content number of a model, a hash of its FIELD rows that a double holds exactly."""
    fields = rows_at(context.fields, context.field_count, FIELD)
    layout = context.layout
    has_cuts = has_letters(model, layout.text_data, layout.ntextdata, CUT)
    is_kind = True, has_matrices(model, layout), has_cuts
    found = integer_at(model + context.layout.disableflags) & ~CONTACT_FLAG
    for f in range(fields.size):
        field = fields[f]
        if not is_kind[field.matters]:
            continue
        if field.counter == 0:
            found = mixed_bytes(model + field.pointer, field.size, found)
        else:
            size = field.size * integer_at(model + field.counter)
            found = mixed_bytes(model_array(model, field.pointer), size, found)
    return found & EXACT_MASK


# The work of a step


@inline
def add_up(tables, state, wrenches, totals_out):
    """For each body, sum the wrenches (H, 6) of its hulls about its centre of mass: totals_out (B,
    6)."""
    floats, bodies, centres, places = tables.floats, tables.bodies, state.centres, state.places
    for b in range(bodies.size):
        i = bodies[b].body
        fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for f in range(bodies[b].first, bodies[b].end):
            h, g = floats[f].hull, floats[f].geom
            x, y, z = wrenches[h, 0], wrenches[h, 1], wrenches[h, 2]
            ax, ay, az = cross(
                places[g, 0] - centres[i, 0], places[g, 1] - centres[i, 1],
                places[g, 2] - centres[i, 2], x, y, z,
            )  # fmt: skip
            fx, fy, fz = fx + x, fy + y, fz + z
            tx += wrenches[h, 3] + ax
            ty += wrenches[h, 4] + ay
            tz += wrenches[h, 5] + az
        totals_out[b, 0], totals_out[b, 1], totals_out[b, 2] = fx, fy, fz
        totals_out[b, 3], totals_out[b, 4], totals_out[b, 5] = tx, ty, tz


@inline
def own_part(found, memory, state, j):
    """The user's push in the number found in component j of a row of xfrc_applied.

    If the plugin wrote that number, the remembered push; otherwise the number is a new push.
    """
    number = bits_of(found)
    if number == bits_of(memory[j]):
        return memory[6 + j]
    if number == bits_of(state[j]):
        return state[6 + j]
    for k in range(1, 1 + EARLIER_ROWS):
        if number == bits_of(memory[MEMORY_SIZE * k + j]):
            return memory[MEMORY_SIZE * k + 6 + j]
    return found


@kernel
def keep_earlier(row, state, memory_out):
    """Remember a row (6,) that the plugin wrote at another time than its state (MEMORY_SIZE,).

    This happens after a FULLPHYSICS state was set, which contains the state but not the row.
    """
    for j in range(6):
        is_left = bits_of(row[j]) == bits_of(memory_out[j])
        if is_left and bits_of(row[j]) != bits_of(state[j]):
            for k in range(HOME_ROW_SIZE - 1, 2 * MEMORY_SIZE - 1, -1):
                memory_out[k] = memory_out[k - MEMORY_SIZE]
            for k in range(MEMORY_SIZE):
                memory_out[MEMORY_SIZE + k] = memory_out[k]
            return


@kernel
def write_rows(context, data, bodies, totals, memories, states):
    """Write the user's pushes plus the water's wrenches (B, 6) into the rows of xfrc_applied.

    The row and the push are remembered both in the home and in the plugin's state, because MuJoCo's
    saved states contain the latter: FULLPHYSICS without xfrc_applied, INTEGRATION with it.
    """
    rows = floats_at(model_array(data, context.layout.xfrc_applied), (context.bodies, 6))
    for b in range(bodies.size):
        i, m = bodies[b].body, bodies[b].memory
        keep_earlier(rows[i], states[m], memories[m])
        for j in range(6):
            own = own_part(rows[i, j], memories[m], states[m], j)
            rows[i, j] = own + totals[b, j]
            memories[m, j], memories[m, 6 + j] = rows[i, j], own
            states[m, j], states[m, 6 + j] = rows[i, j], own


# Water loads besides buoyancy


@kernel
def twist_at(spatial, arm, rotation, twist_out):
    """Shift a motion by an arm (3,), rotate it and swap its halves.

    spatial (6,): angular, then linear, in world axes. twist_out (6,): linear, then angular, in the
    axes of a rotation (9,).
    """
    wx, wy, wz = spatial[0], spatial[1], spatial[2]
    x, y, z = cross(wx, wy, wz, arm[0], arm[1], arm[2])
    x, y, z = spatial[3] + x, spatial[4] + y, spatial[5] + z
    r = rotation
    for i in range(3):
        twist_out[i] = r[i] * x + r[3 + i] * y + r[6 + i] * z
        twist_out[3 + i] = r[i] * wx + r[3 + i] * wy + r[6 + i] * wz


@kernel
def add_turned(wrench, arm, rotation, total_out):
    """Add a wrench (6,) in the axes of a rotation (9,), at an arm from the centre of mass, to a
    wrench about the centre of mass in world axes."""
    r = rotation
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        force, torque = wrench[i], wrench[3 + i]
        fx, fy, fz = fx + r[i] * force, fy + r[3 + i] * force, fz + r[6 + i] * force
        tx, ty, tz = tx + r[i] * torque, ty + r[3 + i] * torque, tz + r[6 + i] * torque
    mx, my, mz = cross(arm[0], arm[1], arm[2], fx, fy, fz)
    total_out[0] += fx
    total_out[1] += fy
    total_out[2] += fz
    total_out[3] += tx + mx
    total_out[4] += ty + my
    total_out[5] += tz + mz


@inline
def arm_from(point, place):
    """How far a place (3,) is from a point (3,)."""
    return place[0] - point[0], place[1] - point[1], place[2] - point[2]


@kernel
def start_carrying(step):
    """Set the CARRIED rows of the links: their rates, and no inertia."""
    context, data, links = step.contexts[0], step.data, tables_in(step).links
    n = context.freedoms
    changes = floats_at(model_array(data, context.layout.cdof_dot), (n, 6))
    speeds = floats_at(model_array(data, context.layout.qvel), (n,))
    for k in range(links.size):
        link, own = links[k], step.carried[k]
        own.inertia[:] = 0.0
        for j in range(6):
            own.rate[j] = step.carried[link.parent].rate[j] if link.parent >= 0 else 0.0
        for i in range(link.first_dof, link.end_dof):
            for j in range(6):
                own.rate[j] += changes[i, j] * speeds[i]


@kernel
def set_motion(step, body, pose, reaction_out):
    """Set the velocity and the bias acceleration of a hull in its REACTION, in the hull's frame."""
    context, data, r = step.contexts[0], step.data, reaction_out[0]
    roots = floats_at(model_array(data, context.layout.subtree_com), (context.bodies, 3))
    velocities = floats_at(model_array(data, context.layout.cvel), (context.bodies, 6))
    arm = arm_from(roots[body.root], pose.position)
    twist_at(velocities[body.body], arm, pose.rotation, r.velocity[:])
    twist_at(step.carried[body.link].rate[:], arm, pose.rotation, r.bias[:])


@inline
def react(step, body, pose, number, reaction_out):
    """Compute the REACTION of the HULL with a number, in its own frame: all water loads besides
    buoyancy. Returns the rate [1/s] at which the hull loses angular momentum."""
    layout, tables = step.contexts[0].layout, tables_in(step)
    timestep = float_at(step.model + layout.timestep)
    is_rk4 = integer_at(step.model + layout.integrator) == RK4
    ahead = 0.0 if is_rk4 else 0.5 * timestep
    flow = Flow(tables.single_waves, tables.water, float_at(step.data + layout.time))
    set_motion(step, body, pose, reaction_out)
    hull = tables.hulls[number]
    fraction = single_hull_reaction(
        hull, tables.surfaces, tables.probes, flow, pose, timestep, ahead, reaction_out
    )
    return fraction * hull.rate


@kernel
def decay_spin(step, body, axes, decay, reaction_out):
    """Set the REACTION, in a body's inertial frame with axes (9,), to the decay of its spin at a
    rate [1/s]."""
    layout, count, r = step.contexts[0].layout, step.contexts[0].bodies, reaction_out[0]
    inertia = floats_at(model_array(step.model, layout.body_inertia), (count, 3))
    spins = floats_at(model_array(step.data, layout.cvel), (count, 6))
    timestep = float_at(step.model + layout.timestep)
    r.drag[:], r.inertia[:], r.matrix[:] = 0.0, 0.0, 0.0
    for k in range(3):
        damping = decay * inertia[body.body, k]
        for i in range(3):
            r.drag[3 + k] -= damping * axes[3 * i + k] * spins[body.body, i]
        r.matrix[3 + k, 3 + k] = timestep * damping


@kernel
def carry(step, body, pose, matrix):
    """Add a matrix (6, 6), of which the lower triangle is read, to what a body's link carries. It
    takes motions in the frame of a pose, linear parts first, to momenta there."""
    context = step.contexts[0]
    roots = floats_at(model_array(step.data, context.layout.subtree_com), (context.bodies, 3))
    ax, ay, az = arm_from(roots[body.root], pose.position)
    r, inertia, turned = pose.rotation, step.carried[body.link].inertia, scratch((6, 6))
    half = scratch((6, 6))
    for a in range(0, 6, 3):  # the axes: R X R^T for each quarter X
        for i in range(6):
            x, y, z = mirrored(matrix, i, a), mirrored(matrix, i, a + 1), mirrored(matrix, i, a + 2)
            for j in range(3):
                half[i, a + j] = x * r[3 * j] + y * r[3 * j + 1] + z * r[3 * j + 2]
    for a in range(0, 6, 3):
        for j in range(6):
            x, y, z = half[a, j], half[a + 1, j], half[a + 2, j]
            for i in range(3):
                turned[a + i, j] = r[3 * i] * x + r[3 * i + 1] * y + r[3 * i + 2] * z
    for i in range(6):  # the arm: with v at the root, v + w x arm at the pose
        x, y, z = cross(turned[i, 0], turned[i, 1], turned[i, 2], ax, ay, az)
        turned[i, 3], turned[i, 4], turned[i, 5] = (
            turned[i, 3] - x, turned[i, 4] - y, turned[i, 5] - z
        )  # fmt: skip
    for j in range(6):
        x, y, z = cross(ax, ay, az, turned[0, j], turned[1, j], turned[2, j])
        turned[3, j], turned[4, j], turned[5, j] = (
            turned[3, j] + x, turned[4, j] + y, turned[5, j] + z
        )  # fmt: skip
    for i in range(6):
        for j in range(6):
            inertia[i, j] += turned[(i + 3) % 6, (j + 3) % 6]


@inline
def mirrored(matrix, i, j):
    """An entry of a symmetric matrix of which the lower triangle is set."""
    return matrix[i, j] if i >= j else matrix[j, i]


@kernel
def add_inertias(step):
    """Add what the links carry to MuJoCo's inertia matrix M.

    For a lone body whose joint axes are its principal axes, M stores only a diagonal. Off-diagonal
    entries are then replaced by additions to the diagonal that bound the full matrix from above, so
    damping stays stable at any timestep. (Added mass has no such entries then: see `mjcf`.)

    Source: Featherstone 2008, section 6.2, the composite-rigid-body algorithm.
    """
    context, model, links = step.contexts[0], step.model, tables_in(step).links
    layout, n, momentum = context.layout, context.freedoms, scratch(6)
    axes = floats_at(model_array(step.data, layout.cdof), (n, 6))
    lengths = integers_at(model_array(model, layout.M_rownnz), (n,))
    starts = integers_at(model_array(model, layout.M_rowadr), (n,))
    columns = integers_at(model_array(model, layout.M_colind), (context.matrix,))
    entries = floats_at(model_array(step.data, layout.M), (context.matrix,))
    for k in range(links.size - 1, -1, -1):
        link, inertia = links[k], step.carried[k].inertia
        for a in range(link.first_dof, link.end_dof):
            set_momentum(inertia, axes[a], momentum)
            for e in range(starts[a], starts[a] + lengths[a]):
                entries[e] += product_of(momentum, axes[columns[e]])
        for a in range(link.first_dof + 1, link.end_dof):
            if lengths[a] == 1:
                set_momentum(inertia, axes[a], momentum)
                for b in range(link.first_dof, a):
                    entry = abs(product_of(momentum, axes[b]))
                    share = np.sqrt(entries[starts[a]] / entries[starts[b]])
                    entries[starts[a]] += entry * share
                    entries[starts[b]] += entry / share
        if link.parent >= 0:
            above = step.carried[link.parent].inertia
            for i in range(6):
                for j in range(6):
                    above[i, j] += inertia[i, j]


@inline
def set_momentum(inertia, axis, momentum_out):
    """A matrix (6, 6) times a vector."""
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += inertia[i, j] * axis[j]
        momentum_out[i] = total


@inline
def product_of(a, b):
    """The product of two vectors (6,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]


@kernel
def add_reaction(step, body, pose, centre, reaction, only_drag, total_out):
    """Add a REACTION in the frame of a pose to a body's wrench about its centre of mass (3,) and to
    what its link carries. only_drag: add only its drag, and only to the wrench."""
    r, arm = reaction[0], arm_from(centre, pose.position)
    add_turned(r.drag[:], arm, pose.rotation, total_out)
    if not only_drag:
        add_turned(r.inertia[:], arm, pose.rotation, total_out)
        carry(step, body, pose, r.matrix[:])


# C functions, with addresses as arguments


@kernel
def resist(address, model, data, wrenches, totals, states, carried):
    """See `resist_at`. carried: a CARRIED row for each LINK."""
    step = step_of(address, model, data, carried.ctypes.data)
    start_carrying(step)
    context, tables, state = step.contexts[0], tables_in(step), state_in(step)
    lifts = floats_at(wrenches, (context.hulls, 6))
    found = floats_at(totals, (tables.bodies.size, 6))
    only_drag = states == 0
    reaction, is_made = workspace(REACTION), only_drag
    for b in range(tables.bodies.size):
        body, decay = tables.bodies[b], 0.0
        centre, axes = state.centres[body.body], state.axes[body.body]
        for f in range(body.first, body.end):
            row = tables.floats[f]
            if row.resisted < 0 or lifts[row.hull, 2] == 0.0:  # dry
                continue
            if not is_made:  # where the position stage was skipped, ours would else count twice
                call(context.make_inertia, (model, data))
                is_made = True
            pose = Pose(state.places[row.geom], state.turns[row.geom])
            decay += react(step, body, pose, row.resisted, reaction)
            add_reaction(step, body, pose, centre, reaction, only_drag, found[b])
        if decay > 0.0:
            decay_spin(step, body, axes, decay, reaction)
            add_reaction(step, body, Pose(centre, axes), centre, reaction, only_drag, found[b])
    if context.respond != 0 and not only_drag:
        if not is_made:
            call(context.make_inertia, (model, data))
            is_made = True
        rows = carried.ctypes.data
        call(context.respond, (address, model, data, wrenches, totals, states, rows))
    if is_made and not only_drag:
        add_inertias(step)
        call(context.factor_inertia, (model, data))


@c_function
def resist_at(address, model, data, wrenches, totals, states):
    """Add to the bodies' wrenches (B, 6), and to the matrix of inertia, what bodies meet besides
    the buoyancy of their hulls, `push_at`'s wrenches (H, 6). states: the address of the plugin's
    states; 0 to add the drag alone, and that to the wrenches only."""
    carried = np.empty(tables_of(context_at(address)).links.size, CARRIED)
    resist(address, model, data, wrenches, totals, states, carried)


@c_function
def push_at(address, model, data, wrenches):
    """Write the buoyancy of every hull, about its geom's position, into wrenches (H, 6); NaN if the
    pose or the time is not finite."""
    context = context_at(address)
    tables, state = tables_of(context), state_of(context, data)
    time, found = float_at(data + context.layout.time), floats_at(wrenches, (context.hulls, 6))
    for p in range(tables.parts.size):
        part = tables.parts[p]
        block = bytes_at(part.block, (part.block_size,))
        items = records_at(part.places, part.count, part.size)
        call_kernel(part.kernel, block, items, state.places, state.turns, time, found)
    for f in range(tables.floats.size):
        row = tables.floats[f]
        if not is_known(state.places[row.geom], state.turns[row.geom], time):
            found[row.hull] = np.nan


@c_function
def count_at(context, change):
    """Change the number of homes of a context; other threads may do so at the same time."""
    atomic_add(context + HOMES_OFFSET, change)


@kernel
def end_home(home, place):
    """Free a home, whose address is stored at `place`."""
    context = context_at(word_at(home))
    atomic_add(context.own + HOMES_OFFSET, -1)
    store_word(place, 0)
    call(context.release, (home,))


@c_function
def end_at(home, place):
    end_home(home, place)


@c_query
def content_at(context, model):
    return content_of(context_at(context), model)


@c_function
def act_at(home, model, data, states):
    """Do the plugin's work in a step of the state that has this home."""
    context, kept = context_at(word_at(home)), words_at(home, (HOME_SIZE // 8,))
    started = nanoseconds()
    tables = tables_of(context)
    wrenches, totals = np.empty((context.hulls, 6)), np.empty((tables.bodies.size, 6))
    call(context.push, (context.own, model, data, wrenches.ctypes.data))
    add_up(tables, state_of(context, data), wrenches, totals)
    if context.resist != 0:
        to = totals.ctypes.data
        call(context.resist, (context.own, model, data, wrenches.ctypes.data, to, states))
    if kept[REFUSED] != 0:
        totals[:] = np.nan  # MuJoCo warns of such a state and resets it
    memories = floats_at(home + HOME_SIZE, (kept[MEMORIES], HOME_ROW_SIZE))
    before = floats_at(states, (kept[MEMORIES], MEMORY_SIZE))
    write_rows(context, data, tables.bodies, totals, memories, before)
    kept[CALLS] += 1
    kept[NANOSECONDS] += nanoseconds() - started


# The plugin's functions


@inline
def lower_half(word):
    """The C int in a 64-bit register, whose upper half is undefined."""
    return word & 0xFFFFFFFF


@inline
def seam_at(number):
    return word_at(seam() + 8 * number)


@inline
def word_of(data, instance):
    """The address of the plugin's word in a state: the number of its home."""
    return model_array(data, seam_at(WORDS)) + 8 * lower_half(instance)


@kernel
def place_of(number):
    """The address in the slabs at which the home with a number is stored; 0 if there is none."""
    slab, place = (number - 1) // SLAB, (number - 1) % SLAB
    if number < 1 or slab >= MOST_SLABS:
        return 0
    start = word_at(seam_at(SLABS) + 8 * slab)
    return 0 if start == 0 else start + 8 * place


@kernel
def known_home(number, owner, field):
    """The home with a number if its field, DATA or OWN_STATES, is the owner's address; else 0."""
    place = place_of(number)
    home = word_at(place) if place != 0 else 0
    if home != 0 and word_at(home + 8 * field) != owner:
        return 0
    return home


@kernel
def home_of(model, data, instance):
    """The home of a state, 0 if it has none. FIND first repairs the word of an unpickled state."""
    word = word_of(data, instance)
    if word_at(word) == 0:
        return 0
    home = known_home(word_at(word), data, DATA)
    if home == 0:
        call(seam_at(FIND), (model, data, lower_half(instance)))
        home = known_home(word_at(word), data, DATA)
    return home


@kernel
def water_instance(model):
    """The first instance of this plugin in a model, -1 if there is none."""
    count = integer_at(model + seam_at(INSTANCES))
    slots = integers_at(model_array(model, seam_at(SLOTS)), (count,))
    for i in range(slots.size):
        if slots[i] == seam_at(SLOT):
            return i
    return -1


@inline
def content_number(home):
    """The content number of the model at the last reset, as the plugin's states hold it: (1,)."""
    kept = words_at(home, (HOME_SIZE // 8,))
    return floats_at(kept[OWN_STATES] + 8 * MEMORY_SIZE * kept[MEMORIES], (1,))


@kernel
def follow(home, model):
    """If a model's content has changed, have the interpreter give the home a matching context."""
    kept, context = words_at(home, (HOME_SIZE // 8,)), context_at(word_at(home))
    if kept[REFUSED] != 0 or content_of(context, model) != kept[CONTENT]:
        call(seam_at(RENEW), (model, kept[OWN_STATES]))


@kernel
def follow_world(home, model):
    """Follow the model of states that were reset with another content than the home's.

    In a batch an MjData serves many worlds, which may have different hulls and waves. States from
    before a change of the model get the present water.
    """
    wanted = content_number(home)
    if content_of(context_at(word_at(home)), model) == wanted[0]:
        follow(home, model)
    wanted[0] = words_at(home, (HOME_SIZE // 8,))[CONTENT]


@c_function
def compute_at(model, data, instance, capability):
    """Do the plugin's work in the passive stage of a step, of mj_forward and of mj_inverse."""
    home = home_of(model, data, instance)
    if home != 0:
        kept = words_at(home, (HOME_SIZE // 8,))
        if content_number(home)[0] != kept[CONTENT]:
            follow_world(home, model)
        call(context_at(word_at(home)).act, (home, model, data, kept[OWN_STATES]))


@c_function
def advance_at(model, data, instance):
    """Note at the end of a step that the memory of the water is behind by a timestep."""
    home = home_of(model, data, instance)
    if home != 0 and context_at(word_at(home)).memory_size > 0:
        context, kept = context_at(word_at(home)), words_at(home, (HOME_SIZE // 8,))
        due = floats_at(kept[OWN_STATES] + 8 * context.memory_start, (1,))
        due[0] += float_at(model + context.layout.timestep)


@c_function
def reset_at(model, states, number, instance):
    """Forget all pushes, and get a new context if the model's content has changed."""
    if number == 0:
        return
    home = known_home(number, states, OWN_STATES)
    if home == 0:  # from a pickle
        call(seam_at(RENEW), (model, states))
        return
    kept = words_at(home, (HOME_SIZE // 8,))
    floats_at(home + HOME_SIZE, (kept[MEMORIES] * HOME_ROW_SIZE,))[:] = 0.0
    layout = context_at(word_at(home)).layout
    sizes = integers_at(model_array(model, layout.plugin_statenum), (lower_half(instance) + 1,))
    floats_at(states, (sizes[lower_half(instance)],))[:] = 0.0
    follow(home, model)
    content_number(home)[0] = kept[CONTENT]


@c_function
def copy_at(to, model, data, instance):
    """Copy the memory of the rows of xfrc_applied along with a state."""
    source, target = home_of(model, data, instance), home_of(model, to, instance)
    if source != 0 and target != 0:
        count = words_at(source, (HOME_SIZE // 8,))[MEMORIES]
        if words_at(target, (HOME_SIZE // 8,))[MEMORIES] == count:
            remembered = floats_at(source + HOME_SIZE, (count * HOME_ROW_SIZE,))
            copied = floats_at(target + HOME_SIZE, (count * HOME_ROW_SIZE,))
            for i in range(copied.size):
                copied[i] = remembered[i]


@c_function
def destroy_at(data, instance):
    """Free the home of a state that MuJoCo deletes."""
    word = word_of(data, instance)
    home = known_home(word_at(word), data, DATA)
    if home != 0:
        end_home(home, place_of(word_at(word)))
    store_word(word, 0)
