"""Response: the plugin's part for bodies with memory or with a panel code's coefficients.

Its tables are a block of their own, so that models without such bodies neither have nor read them.
The states of the memory are in the plugin's state, behind those of `native`:

    due, time, then for each body its scaled velocity (6,) and x1, x2 of each column.

MuJoCo calls `advance` once at the end of a step, which adds the timestep to `due` [s]. The next
passive stage is at the new position and velocity. It advances the states by that time and keeps
them. `time` is the data's time then. Other calls keep no states: stages of RK4, which are later
than `time`, predict them, and all others take them as they are.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.addresses import float_at, floats_at, integer_at
from sim.kernels import c_function, kernel, packed, scratch, scratch_zeros, table, workspace
from sim.mjcf.floats import FloatingGeom
from sim.plugin.native import (
    RK4,
    add_reaction,
    arm_from,
    block_at,
    model_array,
    set_motion,
    state_in,
    step_of,
    tables_in,
    twist_at,
)
from sim.resistance.diffraction import ANGLE, SCATTERED, add_diffraction
from sim.resistance.drag import Drag
from sim.resistance.elements import SURFACE, Pose
from sim.resistance.memory import COLUMN, remember
from sim.resistance.probes import PROBE, Flow
from sim.resistance.reaction import REACTION, add_added_mass
from sim.resistance.response import (
    RESPONSE,
    SAFE_LIFT_SHARE,
    WETNESS,
    WETTED,
    Response,
    add_own_damping,
    hull_wetness,
)
from sim.water.sea import Sea

Table = NDArray[np.void]

DUE, TIME, FIRST_STATE = 0, 1, 2
"""Indices in the memory's numbers."""

KEPT, STAGE, ANCHOR = np.int64(0), np.int64(1), np.int64(2)
"""Kinds of a call: the first after a step, a later stage of a step, and any other, which only takes
the velocity and the time anew."""

TIME_ROUND_OFF = 1e-6
"""Round-off of a time, as a share of the timestep."""


class Responses(NamedTuple):
    """The tables of the block: RESPONSE, WETTED, SURFACE, COLUMN, SCATTERED, ANGLE, PROBE."""

    bodies: Table
    hulls: Table
    surfaces: Table
    columns: Table
    forces: Table
    angles: Table
    probes: Table


def response_block(
    sea: Sea, responses: tuple[Response, ...], floats: tuple[FloatingGeom, ...], bodies: Table
) -> tuple[NDArray[np.uint8], int]:
    """The block of the tables, and the number of the memory's numbers. bodies: BODY rows."""
    rows, wetted, surfaces, columns, forces, angles, probes = ([] for _ in range(7))
    state = FIRST_STATE
    for response in responses:
        own = response.coefficients
        ends = [len(wetted), 0, len(columns), 0, len(forces), 0, len(angles), 0]
        for f in (f for f in floats if f.body == response.body):
            drag = f.drag or Drag(f.method.hull, sea)
            volume = f.displaced * f.method.hull.volume
            first = len(probes)
            probes += list(drag.probes)
            wetted.append((f.geom, len(surfaces), first, len(probes), volume, drag.strength[0]))
            surfaces.append(drag.surface)
        columns += [(a0, a1, column) for a0, a1, *column in own.memory.tolist()]
        forces += list(response.scattering.forces)
        angles += list(response.scattering.angles)
        ends[1::2] = len(wetted), len(columns), len(forces), len(angles)
        row = np.flatnonzero(bodies["body"] == response.body)[0]
        lift = SAFE_LIFT_SHARE * response.volume * sea.density * sea.gravity
        rows.append((
            row, *ends, state, own.added_mass.any(), response.damping.any(), response.is_relative,
            own.position, own.rotation.ravel(), own.added_mass, response.damping,
            response.volume / WETNESS, lift,
        ))  # fmt: skip
        state += 6 + 2 * len(own.memory)
    block = packed(
        np.array(rows, RESPONSE), np.array(wetted, WETTED), np.concatenate(surfaces),
        np.array(columns, COLUMN), np.array(forces, SCATTERED), np.array(angles, ANGLE),
        np.array(probes, PROBE),
    )  # fmt: skip
    return block, state


@kernel
def responses_of(context):
    block = block_at(context.responses, context.responses_size)
    return Responses(
        table(block, 0, RESPONSE), table(block, 1, WETTED), table(block, 2, SURFACE),
        table(block, 3, COLUMN), table(block, 4, SCATTERED), table(block, 5, ANGLE),
        table(block, 6, PROBE),
    )  # fmt: skip


@kernel
def rest_pose(step, body, response, position_out, rotation_out):
    """Position (3,) [m] and rotation (9,) of a body's rest frame in the world."""
    context = step.contexts[0]
    layout, count, i, p = context.layout, context.bodies, body.body, response.position
    places = floats_at(model_array(step.data, layout.xpos), (count, 3))
    turns = floats_at(model_array(step.data, layout.xmat), (count, 9))
    for row in range(3):
        position_out[row] = places[i, row]
        for k in range(3):
            position_out[row] += turns[i, 3 * row + k] * p[k]
        for column in range(3):
            total = 0.0
            for k in range(3):
                total += turns[i, 3 * row + k] * response.rotation[3 * k + column]
            rotation_out[3 * row + column] = total


@kernel
def add_water_velocity(fit, weight, hull_pose, pose, water_out):
    """Add a rigid motion (6,) in the frame of a hull, times a weight, in another frame."""
    r, spatial = hull_pose.rotation, scratch(6)
    for i in range(3):
        spatial[i] = r[3 * i] * fit[3] + r[3 * i + 1] * fit[4] + r[3 * i + 2] * fit[5]
        spatial[3 + i] = r[3 * i] * fit[0] + r[3 * i + 1] * fit[1] + r[3 * i + 2] * fit[2]
    moved = scratch(6)
    twist_at(spatial, arm_from(hull_pose.position, pose.position), pose.rotation, moved)
    for i in range(6):
        water_out[i] += weight * moved[i]


@kernel
def wetness(step, tables, body, response, pose, lift, flow, reaction_out):
    """The share with which a body's response acts, and its rate [1/s]. Set the velocity of the
    water in its REACTION: 0 unless the response is relative to it."""
    r, state = reaction_out[0], state_in(step)
    r.water[:], r.pull[:] = 0.0, 0.0
    is_relative = response.is_relative != 0
    if lift >= response.lift and not is_relative:
        return 1.0, 0.0
    wet, rate, fit, water = 0.0, 0.0, scratch(6), scratch_zeros(6)
    for h in range(response.first_hull, response.end_hull):
        hull = tables.hulls[h]
        own = Pose(state.places[hull.geom], state.turns[hull.geom])
        set_motion(step, body, own, reaction_out)
        fraction, growth = hull_wetness(
            hull, tables.surfaces, tables.probes, flow, own, r.velocity[:], is_relative, fit
        )
        wet += fraction * hull.volume
        rate += growth * hull.volume
        add_water_velocity(fit, fraction * hull.volume, own, pose, water)
    if wet > 0.0:
        for i in range(6):
            r.water[i] = water[i] / wet
    share = wet / response.volume
    return (1.0, 0.0) if share >= 1.0 else (share, rate / response.volume)


@kernel
def react(step, tables, response, body, pose, lift, kind, span, memory, reaction):
    """Compute the REACTION of a response in its rest frame, which has a pose. kind, span [s]: how
    the memory is advanced."""
    r, layout = reaction[0], step.contexts[0].layout
    timestep = float_at(step.model + layout.timestep)
    sea = tables_in(step)
    flow = Flow(sea.waves, sea.water, float_at(step.data + layout.time))
    share, rate = wetness(step, tables, body, response, pose, lift, flow, reaction)
    set_motion(step, body, pose, reaction)
    r.drag[:], r.inertia[:], r.matrix[:] = 0.0, 0.0, 0.0
    velocity = scratch(6)
    for i in range(6):
        velocity[i] = r.velocity[i] - r.water[i]
    columns = tables.columns[response.first_column : response.end_column]
    states = memory[response.state : response.state + 6 + 2 * columns.size]
    is_rk4 = integer_at(step.model + layout.integrator) == RK4
    remember(columns, span, share, kind != STAGE, is_rk4, velocity, states, r.drag[:])
    if share == 0.0:
        return
    if response.has_added_mass != 0:
        ahead, matrix = 0.0 if is_rk4 else 0.5 * timestep, response.added_mass[:]
        add_added_mass(share, rate, ahead, matrix, matrix, reaction)
    if response.has_damping != 0:
        add_own_damping(share, timestep, response, reaction)
    forces = tables.forces[response.first_force : response.end_force]
    angles = tables.angles[response.first_angle : response.end_angle]
    yaw = np.arctan2(pose.rotation[3], pose.rotation[0])
    add_diffraction(forces, angles, flow.waves, flow.time, pose.position, yaw, share, r.drag[:])


@kernel
def respond(step, tables, number, kind, span, lifts, memory, reaction, totals_out):
    """Add the response with a number to its body's wrench and to what its link carries."""
    response = tables.bodies[number]
    body, lift = tables_in(step).bodies[response.body], 0.0
    for f in range(body.first, body.end):
        lift += lifts[tables_in(step).floats[f].hull, 2]
    pose = Pose(scratch(3), scratch(9))
    rest_pose(step, body, response, pose.position, pose.rotation)
    react(step, tables, response, body, pose, lift, kind, span, memory, reaction)
    centre = state_in(step).centres[body.body]
    add_reaction(step, body, pose, centre, reaction, False, totals_out[response.body])


@kernel
def kind_of_call(memory, time, timestep):
    """The kind of a call, and the time [s] by which it advances the memory."""
    late = time - memory[TIME]
    if memory[DUE] > 0.0:
        return KEPT, memory[DUE]
    if 0.0 < late <= timestep * (1.0 + TIME_ROUND_OFF):
        return STAGE, late
    return ANCHOR, 0.0


@c_function
def respond_at(address, model, data, wrenches, totals, states, carried):
    """Add to the bodies' wrenches (B, 6), and to their links' CARRIED rows, the responses of
    bodies, given the buoyancy (H, 6) of all hulls and the address of the plugin's states."""
    step = step_of(address, model, data, carried)
    context, tables = step.contexts[0], responses_of(step.contexts[0])
    lifts = floats_at(wrenches, (context.hulls, 6))
    found = floats_at(totals, (tables_in(step).bodies.size, 6))
    memory = floats_at(states + 8 * context.memory_start, (context.memory_size,))
    time = float_at(data + context.layout.time)
    kind, span = kind_of_call(memory, time, float_at(model + context.layout.timestep))
    reaction = workspace(REACTION)
    for number in range(tables.bodies.size):
        respond(step, tables, number, kind, span, lifts, memory, reaction, found)
    if kind != STAGE:
        memory[DUE], memory[TIME] = 0.0, time
