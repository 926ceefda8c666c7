"""Native: the passive callback as C functions that MuJoCo calls without the interpreter.

Everything that a call needs of a Buoyancy is a *context*, a record with addresses of tables that
nothing changes afterwards; what a call works with is its own. So any number of threads, states,
copies and batches may use a context at once. What a user may change in a model after compiling
it is read from the model at each call:

- poses, through MuJoCo's kinematics: geom_pos, geom_quat, body_ipos, body_iquat
- mass, inertia, timestep
- the strength of gravity: waves keep their lengths and follow it in time, and it scales all
  pressures; a sea under another gravity is the same sea in another measure of time

and what hulls and waves were made from is held against the model at each call (see `FIELDS`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.addresses import (
    ask,
    atomic_add,
    atomic_claim,
    bits_of,
    bytes_at,
    call,
    call_kernel,
    float_at,
    floats_at,
    integers_at,
    named_word,
    nanoseconds,
    records_at,
    word_at,
    words_at,
)
from sim.coupling.layout import LAYOUT
from sim.geometry import cross
from sim.kernels import c_function, c_query, inline, kernel, record, table
from sim.methods.method import is_known
from sim.resistance.drag import SURFACE, Flow, Pose
from sim.resistance.reaction import HULL, REACTION, hull_reaction
from sim.water.gerstner import WATER, WAVE

Array = NDArray[np.float64]

FIELDS = (
    "structure", "geom_size", "geom_dataid", "geom_pos", "geom_quat", "mesh_vert", "numeric_data",
    "text_data", "tuple_objid",
)  # fmt: skip
"""What hulls, waves and settings are made from: a model in which one of these changed is refused.
The structure is all sizes that a model has; places and rotations only those of geoms whose hulls
are one."""

CONTEXT = record(
    model="i8", signature="i8", bodies="i8", geoms="i8", freedoms="i8", matrix="i8", hulls="i8",
    own="i8", block="i8", block_size="i8", act="i8", resist="i8", make_inertia="i8",
    factor_inertia="i8", clock="i8", clock_number="i8", counters="i8", states="i8", marks="i8",
    gravity="f8", layout=LAYOUT,
)  # fmt: skip
"""What a call needs: the model's address, signature and sizes (bodies, geoms, degrees of freedom,
entries of M) and the number of hulls; where itself and its block of tables (FLOAT, BODY, DOF, HULL,
SURFACE, WAVE, WATER, PROBE, bytes, PART) are; functions of ours and of MuJoCo, the C library's
clock, counters, the states that were here, marks of rows that were written; the gravity [m/s^2]
that the sea was made for."""

CONTEXT_SIZE = CONTEXT.itemsize

PART = record(kernel="i8", block="i8", block_size="i8", places="i8", count="i8", size="i8")
"""Hulls of a method: its kernel, its block, and their places, with the size of one."""

FLOAT = record(geom="i8", hull="i8", resisted="i8")
"""A hull: its geom, its row among the wrenches, and its HULL, -1 where there is none. Those of a
body follow one another."""

BODY = record(body="i8", root="i8", first="i8", end="i8", first_dof="i8", end_dof="i8")
"""A body's row, that of the point to which its velocity refers, its FLOATs, and the degrees of
freedom (DOF) that move it, in ascending order; these only where something resists."""

DOF = record(index="i8")

PROBE = record(pointer="i8", start="i8", count="i8", field="i8")
"""Bytes of a model that must be what they were: count of them, from `start` in the array of a
pointer (-1: in the model itself); which of FIELDS they belong to."""

SHARDS = 64
"""Counters are kept that often, so that threads do not wait for one another's."""

CALLS, NANOSECONDS, SEEN, STRANGERS, OVERWRITTEN, REFUSED = range(6)
"""Numbers of a counter: calls and the time they took; states seen and left to a later block; models
of the same structure that are no copies; states with forces of somebody else in our rows; minus
what `find_context` answered where a model was refused."""

COUNTERS = 8  # numbers a shard: a cache line

STATES, WAYS = 1024, 8
"""States that a context keeps apart, and how many of them may share a place."""

MARKS = 4096
"""Marks of rows that were written last, of the whole process."""

NOBODY, AMBIGUOUS, TILTED = -1, -2, -3
"""What `find_context` answers when there is no context: none for this model, several, or a gravity
that is not along -z; below these a number of FIELDS that changed: CHANGED - number."""

CHANGED = -4

IN_USE = np.zeros((SHARDS, COUNTERS), dtype=np.int64)
"""Calls under way, for those who take away what these may be reading."""

CELL = np.zeros(4, dtype=np.int64)
"""Addresses: of the list of contexts (their number, then theirs), of the C function that was the
callback before, of `IN_USE`, and of REFUSAL."""

CONTEXTS, PREVIOUS, USE, REFUSING = range(4)

cell = named_word("waterline_cell", CELL.ctypes.data)


class Tables(NamedTuple):
    """A context's block."""

    floats: NDArray[np.void]
    bodies: NDArray[np.void]
    dofs: NDArray[np.void]
    hulls: NDArray[np.void]
    surfaces: NDArray[np.void]


class State(NamedTuple):
    """MuJoCo's frames of a state: the bodies' inertial ones, and those of the geoms."""

    centres: Array
    axes: Array
    places: Array
    turns: Array


@inline
def context_at(address):
    return bytes_at(address, (CONTEXT_SIZE,)).view(CONTEXT)[0]


@inline
def block_of(context):
    return bytes_at(context.block, (context.block_size,))


@inline
def model_array(model, offset):
    """Address of an array of a model or a state, whose pointer is at an offset."""
    return word_at(model + offset)


@inline
def place_of(address):
    """A number for an address that spreads."""
    return ((address >> 6) * 2654435761) >> 8


@inline
def count(context, data, number, amount):
    """Add to one of the context's counters."""
    shard = place_of(data) % SHARDS
    atomic_add(context.counters + 8 * (COUNTERS * shard + number), amount)


@inline
def rate_of(context, model):
    """How much faster waves run than under the gravity that the sea was made for: 1 under that."""
    gravity = -float_at(model + context.layout.gravity + 16)
    return 1.0 if gravity == context.gravity else np.sqrt(gravity / context.gravity)


# Who is at home: the context of a model


@kernel
def differs(context, model):
    """Why a model is none that this context is made from: 0, TILTED, or CHANGED - a field's
    number."""
    block = block_of(context)
    probes, expected = table(block, 7, PROBE), table(block, 8, np.uint8)
    at = 0
    for p in range(probes.size):
        probe = probes[p]
        if p == 0 and model == context.model:  # its structure
            at += probe.count
            continue
        start = model if probe.pointer < 0 else model_array(model, probe.pointer)
        found = bytes_at(start + probe.start, (probe.count,))
        difference = np.uint8(0)
        for i in range(probe.count):
            difference |= found[i] ^ expected[at + i]
        if difference != 0:
            return CHANGED - probe.field
        at += probe.count
    gravity = floats_at(model + context.layout.gravity, (3,))
    if gravity[0] != 0.0 or gravity[1] != 0.0 or not gravity[2] < 0.0:
        return TILTED
    return 0


@kernel
def find_context(contexts, model, data):
    """Place of a model's context in a list of them, the latest: its own, else the only one that it
    is a copy of; or why there is none, and then the last one that is concerned."""
    length, own, owner = word_at(contexts), NOBODY, 0
    for i in range(length - 1, -1, -1):
        context = context_at(word_at(contexts + 8 + 8 * i))
        if context.model == model:
            if own == NOBODY:
                own = i
            else:
                count(context, data, SEEN, 1)  # an outer block of the same model
    if own != NOBODY:
        return differs(context_at(word_at(contexts + 8 + 8 * own)), model), own
    for i in range(length - 1, -1, -1):
        context = context_at(word_at(contexts + 8 + 8 * i))
        if context.signature != word_at(model + context.layout.signature):
            continue
        if differs(context, model) != 0:
            count(context, data, STRANGERS, 1)
        elif own == NOBODY:
            own, owner = i, context.model
        elif owner == context.model:
            count(context, data, SEEN, 1)
        else:
            return AMBIGUOUS, own
    return (0, own) if own != NOBODY else (NOBODY, NOBODY)


# What a context does


@kernel
def push(context, model, data, wrenches_out):
    """Wrenches (H, 6) of buoyancy of all hulls, about their geoms' places, under the gravity that
    the sea was made for."""
    time = rate_of(context, model) * float_at(data + context.layout.time)
    places = floats_at(model_array(data, context.layout.geom_xpos), (context.geoms, 3))
    turns = floats_at(model_array(data, context.layout.geom_xmat), (context.geoms, 9))
    parts = table(block_of(context), 9, PART)
    for p in range(parts.size):
        part = parts[p]
        block = bytes_at(part.block, (part.block_size,))
        items = records_at(part.places, part.count, part.size)
        call_kernel(part.kernel, block, items, places, turns, time, wrenches_out)
    floats = table(block_of(context), 0, FLOAT)
    for f in range(floats.size):
        if not is_known(places[floats[f].geom], turns[floats[f].geom], time):
            wrenches_out[floats[f].hull] = np.nan


@kernel
def mark_of(bodies, rows):
    """A number that tells the bodies' rows from others; 0 if they are."""
    mark, weight = 0.0, 1.0
    for b in range(bodies.size):
        for j in range(6):
            weight *= 1.0009765625
            mark += weight * rows[bodies[b].body, j]
    return mark


@kernel
def is_first_visit(states, data):
    """Whether a state is here for the first time, of those that can be kept apart."""
    start = WAYS * (place_of(data) % (STATES // WAYS))
    for i in range(start, start + WAYS):
        found = atomic_claim(states + 8 * i, data)
        if found == 0 or found == data:
            return found == 0
    return False


@inline
def slots_of(mark):
    """Two places for a mark, so that what takes one of them does not take the other."""
    bits = bits_of(mark)
    return (bits * 2654435761 >> 20) % MARKS, (bits * 40503 >> 7) % MARKS


@kernel
def are_ours(mark, marks):
    """Whether rows with such a mark are zero or such as we wrote lately: a copied state has them,
    or one that goes from thread to thread in a batch."""
    first, second = slots_of(mark)
    return mark == 0.0 or marks[first] == mark or marks[second] == mark


@kernel
def remember(mark, marks_out):
    first, second = slots_of(mark)
    marks_out[first], marks_out[second] = mark, mark


@kernel
def write_rows(context, model, data, wrenches):
    """Sum up the hulls' wrenches (H, 6) over their bodies, about the centres of mass, into the rows
    of xfrc_applied."""
    block, layout = block_of(context), context.layout
    floats, bodies = table(block, 0, FLOAT), table(block, 1, BODY)
    rows = floats_at(model_array(data, layout.xfrc_applied), (context.bodies, 6))
    centres = floats_at(model_array(data, layout.xipos), (context.bodies, 3))
    places = floats_at(model_array(data, layout.geom_xpos), (context.geoms, 3))
    rate = rate_of(context, model)
    factor = rate * rate
    if is_first_visit(context.states, data):
        marks = floats_at(context.marks, (MARKS,))
        if not are_ours(mark_of(bodies, rows), marks):
            count(context, data, OVERWRITTEN, 1)
    for b in range(bodies.size):
        i = bodies[b].body
        fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for f in range(bodies[b].first, bodies[b].end):
            h, g = floats[f].hull, floats[f].geom
            x, y, z = factor * wrenches[h, 0], factor * wrenches[h, 1], factor * wrenches[h, 2]
            ax, ay, az = cross(
                places[g, 0] - centres[i, 0], places[g, 1] - centres[i, 1],
                places[g, 2] - centres[i, 2], x, y, z,
            )  # fmt: skip
            fx, fy, fz = fx + x, fy + y, fz + z
            tx += factor * wrenches[h, 3] + ax
            ty += factor * wrenches[h, 4] + ay
            tz += factor * wrenches[h, 5] + az
        rows[i, 0], rows[i, 1], rows[i, 2] = fx, fy, fz
        rows[i, 3], rows[i, 4], rows[i, 5] = tx, ty, tz


@kernel
def twist_at(spatial, arm, rotation, scale, twist_out):
    """A motion (6,), angular, then linear at a point, in world axes, as that of a point at an arm
    from there, linear, then angular, in the axes of a rotation (9,), scaled."""
    wx, wy, wz = spatial[0], spatial[1], spatial[2]
    x, y, z = cross(wx, wy, wz, arm[0], arm[1], arm[2])
    x, y, z = spatial[3] + x, spatial[4] + y, spatial[5] + z
    r = rotation
    for i in range(3):
        twist_out[i] = scale * (r[i] * x + r[3 + i] * y + r[6 + i] * z)
        twist_out[3 + i] = scale * (r[i] * wx + r[3 + i] * wy + r[6 + i] * wz)


@kernel
def add_turned(wrench, arm, rotation, total_out):
    """Add a wrench (6,) in the axes of a rotation (9,), at an arm from the centre of mass, to one
    about that, in world axes."""
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
def tables_of(context):
    block = block_of(context)
    return Tables(
        table(block, 0, FLOAT), table(block, 1, BODY), table(block, 2, DOF), table(block, 3, HULL),
        table(block, 4, SURFACE),
    )  # fmt: skip


@inline
def state_of(context, data):
    layout, bodies, geoms = context.layout, context.bodies, context.geoms
    return State(
        floats_at(model_array(data, layout.xipos), (bodies, 3)),
        floats_at(model_array(data, layout.ximat), (bodies, 9)),
        floats_at(model_array(data, layout.geom_xpos), (geoms, 3)),
        floats_at(model_array(data, layout.geom_xmat), (geoms, 9)),
    )


@kernel
def set_motion(context, data, body, pose, rate, reaction_out):
    """How a body's hull moves, for its REACTION, in the measure of time in which gravity is the
    sea's own: `rate` times faster."""
    layout, n, dofs = context.layout, context.freedoms, table(block_of(context), 2, DOF)
    changes = floats_at(model_array(data, layout.cdof_dot), (n, 6))
    speeds = floats_at(model_array(data, layout.qvel), (n,))
    root = floats_at(model_array(data, layout.subtree_com), (context.bodies, 3))[body.root]
    velocity = floats_at(model_array(data, layout.cvel), (context.bodies, 6))[body.body]
    own, arm = np.zeros(6), pose.position - root
    for d in range(body.first_dof, body.end_dof):
        i = dofs[d].index
        for j in range(6):
            own[j] += changes[i, j] * speeds[i]
    twist_at(velocity, arm, pose.rotation, 1.0 / rate, reaction_out[0].velocity)
    twist_at(own, arm, pose.rotation, 1.0 / (rate * rate), reaction_out[0].bias)


@kernel
def scale_reaction(factor, reaction_out):
    """Scale the wrenches."""
    r = reaction_out[0]
    for i in range(6):
        r.drag[i] *= factor
        r.inertia[i] *= factor


@kernel
def react(context, model, data, body, place, reaction_out):
    """What a hull, that of a FLOAT's place, meets besides its buoyancy: its REACTION in the geom's
    frame. Returns the rate [1/s] at which it takes angular momentum."""
    tables, state, block = tables_of(context), state_of(context, data), block_of(context)
    g, rate = tables.floats[place].geom, rate_of(context, model)
    time = rate * float_at(data + context.layout.time)
    factor = rate * float_at(model + context.layout.timestep)
    flow = Flow(table(block, 5, WAVE), table(block, 6, WATER), time)
    pose = Pose(state.places[g], state.turns[g])
    set_motion(context, data, body, pose, rate, reaction_out)
    hull = tables.hulls[tables.floats[place].resisted]
    fraction = hull_reaction(hull, tables.surfaces, flow, pose, factor, reaction_out)
    scale_reaction(rate * rate, reaction_out)
    return fraction * hull.rate


@kernel
def decay_spin(context, model, data, body, decay, reaction_out):
    """The decay of a body's angular momentum at a rate [1/s], as a REACTION in its inertial
    frame."""
    inertia = floats_at(model_array(model, context.layout.body_inertia), (context.bodies, 3))
    spin = floats_at(model_array(data, context.layout.cvel), (context.bodies, 6))[body.body, :3]
    axes = state_of(context, data).axes[body.body]
    timestep, r = float_at(model + context.layout.timestep), reaction_out[0]
    r.drag[:], r.inertia[:], r.matrix[:] = 0.0, 0.0, 0.0
    for k in range(3):
        damping = decay * inertia[body.body, k]
        for i in range(3):
            r.drag[3 + k] -= damping * axes[3 * i + k] * spin[i]
        r.matrix[3 + k, 3 + k] = timestep * damping


@kernel
def add_inertia(context, model, data, body, place, rotation, matrix):
    """Add J^T matrix J to MuJoCo's matrix of inertia: matrix (6, 6), its lower triangle, in the
    frame at a place (3,) with a rotation (9,), of a body.

    A body alone on a joint along its principal axes has a diagonal there and no place for more.
    What is off the diagonal goes into that, in amounts that leave the sum above the matrix: so
    damping holds at any timestep as the whole matrix does. (Added mass has nothing there: see
    `mjcf`.)
    """
    layout, n = context.layout, context.freedoms
    dofs = table(block_of(context), 2, DOF)
    first, size = body.first_dof, body.end_dof - body.first_dof
    axes = floats_at(model_array(data, layout.cdof), (n, 6))
    arm = place - floats_at(model_array(data, layout.subtree_com), (context.bodies, 3))[body.root]
    lengths = integers_at(model_array(model, layout.M_rownnz), (n,))
    starts = integers_at(model_array(model, layout.M_rowadr), (n,))
    entries = floats_at(model_array(data, layout.M), (context.matrix,))
    columns, products = np.empty((size, 6)), np.zeros((size, 6))
    last = np.empty(size, np.int64)  # places of the diagonal
    for a in range(size):
        row = dofs[first + a].index
        last[a] = starts[row] + lengths[row] - 1
        twist_at(axes[row], arm, rotation, 1.0, columns[a])
        for i in range(6):
            for j in range(i):
                products[a, i] += matrix[i, j] * columns[a, j]
                products[a, j] += matrix[i, j] * columns[a, i]
            products[a, i] += matrix[i, i] * columns[a, i]
        for i in range(6):
            entries[last[a]] += products[a, i] * columns[a, i]
    for a in range(size):
        row = dofs[first + a].index
        for b in range(a):
            entry = 0.0
            for j in range(6):
                entry += products[a, j] * columns[b, j]
            if lengths[row] > 1:
                entries[starts[row] + b] += entry
            else:
                share = np.sqrt(entries[last[a]] / entries[last[b]])
                entries[last[a]] += abs(entry) * share
                entries[last[b]] += abs(entry) / share


@kernel
def add_reaction(context, model, data, body, place, rotation, reaction, row_out):
    """Add a REACTION in the frame at a place with a rotation (9,) to a body's row of xfrc_applied
    and to the matrix of inertia."""
    state, r = state_of(context, data), reaction[0]
    arm = place - state.centres[body.body]
    add_turned(r.drag, arm, rotation, row_out)
    add_turned(r.inertia, arm, rotation, row_out)
    add_inertia(context, model, data, body, place, rotation, r.matrix)


@kernel
def resist(context, model, data, wrenches):
    """Add to the rows of xfrc_applied, and to the matrix of inertia, what bodies meet besides the
    buoyancy of their hulls, `push`'s wrenches (H, 6)."""
    tables, state = tables_of(context), state_of(context, data)
    rows = floats_at(model_array(data, context.layout.xfrc_applied), (context.bodies, 6))
    reaction, is_made = np.empty(1, REACTION), False
    for b in range(tables.bodies.size):
        body, decay = tables.bodies[b], 0.0
        i = body.body
        for f in range(body.first, body.end):
            g, lift = tables.floats[f].geom, wrenches[tables.floats[f].hull, 2]
            if tables.floats[f].resisted < 0 or lift == 0.0:  # dry
                continue
            if not is_made:  # where the position stage was skipped, ours would else count twice
                call(context.make_inertia, (model, data))
                is_made = True
            decay += react(context, model, data, body, f, reaction)
            place, turn = state.places[g], state.turns[g]
            add_reaction(context, model, data, body, place, turn, reaction, rows[i])
        if decay > 0.0:
            decay_spin(context, model, data, body, decay, reaction)
            place, turn = state.centres[i], state.axes[i]
            add_reaction(context, model, data, body, place, turn, reaction, rows[i])
    if is_made:
        call(context.factor_inertia, (model, data))


@kernel
def add_drag(reaction, arm, rotation, drag_out):
    """Add the drag of a REACTION in the axes of a rotation (9,), at an arm from the centre of
    mass."""
    add_turned(reaction[0].drag, arm, rotation, drag_out)


@kernel
def drags(context_address, model, data, wrenches, drags_out):
    """Drag alone (B, 6) of all bodies, about their centres of mass, world axes."""
    context = context_at(context_address)
    tables, state = tables_of(context), state_of(context, data)
    reaction = np.empty(1, REACTION)
    drags_out[:] = 0.0
    for b in range(tables.bodies.size):
        body, decay = tables.bodies[b], 0.0
        centre = state.centres[body.body]
        for f in range(body.first, body.end):
            g, lift = tables.floats[f].geom, wrenches[tables.floats[f].hull, 2]
            if tables.floats[f].resisted >= 0 and lift != 0.0:
                decay += react(context, model, data, body, f, reaction)
                add_drag(reaction, state.places[g] - centre, state.turns[g], drags_out[b])
        if decay > 0.0:
            decay_spin(context, model, data, body, decay, reaction)
            add_drag(reaction, centre - centre, state.axes[body.body], drags_out[b])


@kernel
def write(context, model, data, wrenches):
    """From the hulls' wrenches all that the state gets."""
    write_rows(context, model, data, wrenches)
    if context.resist != 0:
        call(context.resist, (context.own, model, data, wrenches.ctypes.data))
    rows = floats_at(model_array(data, context.layout.xfrc_applied), (context.bodies, 6))
    mark = mark_of(table(block_of(context), 1, BODY), rows)
    remember(mark, floats_at(context.marks, (MARKS,)))


# C functions, with addresses as arguments


@c_function
def resist_at(context, model, data, wrenches):
    resist(context_at(context), model, data, floats_at(wrenches, (context_at(context).hulls, 6)))


@c_function
def write_at(context, model, data, wrenches):
    """`write` for wrenches that somebody else has computed."""
    home = context_at(context)
    write(home, model, data, floats_at(wrenches, (home.hulls, 6)))


@c_function
def push_at(context, model, data, wrenches):
    home = context_at(context)
    push(home, model, data, floats_at(wrenches, (home.hulls, 6)))


@c_function
def act_at(context, model, data):
    """All that a context does in a step."""
    home = context_at(context)
    started = nanoseconds(home.clock, home.clock_number)
    wrenches = np.empty((home.hulls, 6))
    push(home, model, data, wrenches)
    write(home, model, data, wrenches)
    count(home, data, CALLS, 1)
    count(home, data, NANOSECONDS, nanoseconds(home.clock, home.clock_number) - started)


@c_query
def find_at(contexts, model, data):
    """The place of a model's context in a list of them, or below 0 why there is none."""
    why, place = find_context(contexts, model, data)
    return place if why == 0 else why


@kernel
def refuse(context, model, data, why, refusal):
    """Have MuJoCo raise why a model is refused, where somebody is there to catch it; else, in the
    threads of a rollout, note it and make the state one that MuJoCo gives up."""
    set_handler = word_at(refusal + 8)
    if set_handler != 0:
        handler = ask(set_handler, (0,))
        if handler != 0:
            ask(set_handler, (handler,))
            call(word_at(refusal), (word_at(refusal - 8 * why),))
    atomic_claim(context.counters + 8 * REFUSED, -why)
    rows = floats_at(model_array(data, context.layout.xfrc_applied), (context.bodies, 6))
    bodies = table(block_of(context), 1, BODY)
    for b in range(bodies.size):
        rows[bodies[b].body] = np.nan


@c_function
def callback_at(model, data):
    """MuJoCo's passive callback."""
    home = words_at(cell(), (4,))
    if home[PREVIOUS] != 0:
        call(home[PREVIOUS], (model, data))
    in_use = home[USE] + 8 * COUNTERS * (place_of(data) % SHARDS)
    atomic_add(in_use, 1)
    contexts = word_at(cell() + 8 * CONTEXTS)
    why, place = find_context(contexts, model, data)
    if place >= 0:
        context = word_at(contexts + 8 + 8 * place)
        if why == 0:
            call(context_at(context).act, (context, model, data))
        else:
            atomic_add(in_use, -1)
            count(context_at(context), data, SEEN, 1)
            refuse(context_at(context), model, data, why, home[REFUSING])
            return
    atomic_add(in_use, -1)
