"""Threads: the work of one thread on a GPU, in the text that `translate` understands.

A sea is seen from the origin of a hull, at this instant: positions are relative to the origin, the
phases of the waves are those at the origin now (see `anchored`), the level is that above the
origin, and the time of the text is 0. All of that is small, so single precision is enough.

No formula of waves, heads, jets, clips or drag is written here. These functions say which of the
package's functions a thread calls, on which hull, patch, leaf or vertex.
"""

import numpy as np

from sim.geometry import cross, placed
from sim.methods.linear import (
    Surface,
    add_wet_vertices,
    is_above,
    subtract_dry_parts,
    write_turned,
)
from sim.methods.patches.patches import CHOSEN
from sim.methods.patches.polynomial import decayed_polynomials, head_polynomials
from sim.plugin.native import twist_at
from sim.resistance.elements import Pose
from sim.resistance.probes import Flow, probe_water
from sim.resistance.reaction import reaction_in
from sim.water.gerstner import LABELS, ONE, WATER, growth, level_and_rise, set_labels, solve_labels
from sim.water.head import solve_heads
from sim.water.head_jets import HEAD_JETS, solve_head_jets
from sim.water.jets import JET, Near, find_near, solve_jets


def anchored(wave, x, y, time):
    """The phase of a wave at a position and a time, in turns between -1/2 and 1/2, in double."""
    turns = wave.turns_x * x + wave.turns_y * y + wave.turns - wave.frequency * time
    return turns - np.floor(turns + 0.5)


def still_water(waves, water, z, time):
    """The still level above a height z [m], its rate [m/s], and the waves' share of growth."""
    level, rise = level_and_rise(water[0], time)
    share = growth(waves[0], time) if waves.size > 0 else 1.0
    return level - z, rise, share


def set_water(sea, level, rise, water_out):
    """The WATER of a sea now: without a tide, and rising by its current."""
    w, s = water_out[0], sea[0]
    w.level, w.amplitude, w.tolerance, w.scale = level, s.amplitude, s.tolerance, s.scale
    w.decays, w.drifts, w.tides = s.decays, s.drifts, 0
    w.current[0], w.current[1], w.current[2] = s.current[0], s.current[1], s.current[2] + rise


def surface_height(waves, sea):
    """Height [m] of the surface above the level at the origin."""
    x, y, heights = np.zeros(1), np.zeros(1), np.empty(1)
    guess, labels = np.empty(1, LABELS), np.empty(1, LABELS)
    set_labels(x, y, guess)
    solve_labels(x, y, guess, waves, 0.0, sea[0].tolerance, ONE, heights, labels)
    return heights[0]


def patch_polynomial(patch, solve, waves, sea, level, rotations, polynomial_out):
    """The POLYNOMIAL of the head around a patch's centre. Return whether the water could reach the
    patch."""
    x, y, above, position = np.empty(1), np.empty(1), np.empty(1), np.zeros(3)
    label_x, label_y, height = np.empty(1), np.empty(1), np.empty(1)
    chosen, jets, head_jets = np.empty(1, CHOSEN), np.empty(1, JET), np.empty(1, HEAD_JETS)
    chosen[0].pose = 0
    x[0], y[0], z = placed(patch.x, patch.y, patch.z, position, rotations[0])
    above[0] = z - level
    if above[0] > sea[0].amplitude + patch.radius:
        return False
    particle = Near(label_x, label_y, height)
    find_near(x, y, waves, 0.0, solve.steps, solve.residual, particle)
    if above[0] - height[0] > solve.reach * patch.radius:
        return False
    residual, squeeze = solve.residual, solve.squeeze
    if sea[0].decays and waves.size > 0:
        solve_head_jets(x, y, above, particle, waves, 0.0, residual, squeeze, head_jets)
        decayed_polynomials(head_jets, chosen, rotations, polynomial_out)
    else:
        solve_jets(x, y, particle, waves, 0.0, residual, squeeze, jets)
        head_polynomials(jets, above, chosen, rotations, polynomial_out)
    return True


def vertex_head(vertex, shape, waves, sea, level, rise, rotation):
    """Head [m] of a vertex, as in `linear.heads_at_vertices`."""
    x, y, z, heads, water = np.empty(1), np.empty(1), np.empty(1), np.empty(1), np.empty(1, WATER)
    position = np.zeros(3)
    crest = level + sea[0].amplitude
    x[0], y[0], z[0] = placed(vertex.x, vertex.y, vertex.z, position, rotation)
    dry = crest - z[0]
    if is_above(crest, shape, position, rotation):
        return -1.0
    if dry < -shape[0].reach:
        return dry
    set_water(sea, level, rise, water)
    solve_heads(x, y, z, waves, water, 0.0, heads)
    return heads[0]


def count_wet(heads):
    """The number of wet vertices."""
    wet = 0
    for v in range(heads.size):
        wet += not heads[v] <= 0.0
    return wet


def piece_sums(surface, heads, first, end, first_face, end_face, wet, sums_out):
    """Sums (6,) over some vertices and faces of a hull with heads (V,), as in `linear.wet_sums`.
    wet: number of wet vertices of the whole hull."""
    datum = heads[0] if wet == heads.size else 0.0
    sums_out[:] = 0.0
    add_wet_vertices(surface.vertices[first:end], heads[first:end], datum, sums_out)
    if wet > 0 and wet < heads.size:
        faces = surface.faces[first_face:end_face]
        subtract_dry_parts(Surface(surface.vertices, faces, surface.shape), heads, sums_out)


def lift(sums, rotation, scale, wrench_out):
    """The wrench (6,) of sums (6,) in the body frame, in world axes."""
    write_turned(sums, rotation, scale, wrench_out)


def probe(place, hull, waves, sea, level, rise, rotation, is_reflected, probed_out):
    """The water at a place (3,) [m] of a hull: its numbers (QUANTITIES, 1), see `probes`."""
    water, position = np.empty(1, WATER), np.zeros(3)
    x, y, z = np.empty(1), np.empty(1), np.empty(1)
    set_water(sea, level, rise, water)
    x[0], y[0], z[0] = placed(place[0], place[1], place[2], position, rotation)
    flow, has_added_mass = Flow(waves, water, 0.0), hull.has_added_mass != 0
    probe_water(x, y, z, hull.strength, flow, is_reflected, has_added_mass, probed_out)


def resist(
    hull, surface, probes, probed, level, rotation, arm, velocity, bias, timestep, reaction_out
):
    """The REACTION of a hull, from the water at its probes. arm (3,) [m]: from the centre of mass
    of its tree to its origin; velocity, bias (6,): of its body, angular, then linear, there, in
    world axes. Return the rate [1/s] at which it loses angular momentum."""
    position, r, ahead = np.zeros(3), reaction_out[0], 0.5 * timestep
    twist_at(velocity, arm, rotation, r.velocity[:])
    twist_at(bias, arm, rotation, r.bias[:])
    pose = Pose(position, rotation)
    fraction = reaction_in(
        probed, probes, level, hull, surface, pose, timestep, ahead, reaction_out
    )
    return fraction * hull.rate


def add_lift(wrench, arm, load_out):
    """Add a wrench (6,) at an arm (3,) to a load (6,): torque, then force."""
    fx, fy, fz = wrench[0], wrench[1], wrench[2]
    mx, my, mz = cross(arm[0], arm[1], arm[2], fx, fy, fz)
    load_out[0] += wrench[3] + mx
    load_out[1] += wrench[4] + my
    load_out[2] += wrench[5] + mz
    load_out[3] += fx
    load_out[4] += fy
    load_out[5] += fz


def add_reaction(force, matrix, arm, rotation, load_out, inertia_out):
    """Add a force (6,) and a matrix (6, 6), of which the lower triangle is read, in the axes of a
    rotation (9,) at an arm (3,), to a load (6,) and an inertia (6, 6) in world axes, where the
    angular components come first. Only the lower triangle of the inertia is written."""
    unit, columns, product = np.empty(6), np.empty((6, 6)), np.empty(6)
    for k in range(6):
        for j in range(6):
            unit[j] = 1.0 if j == k else 0.0
        twist_at(unit, arm, rotation, columns[k])
    for k in range(6):
        for i in range(6):
            load_out[k] += force[i] * columns[k, i]
            product[i] = 0.0
            for j in range(6):
                entry = matrix[i, j] if j <= i else matrix[j, i]
                product[i] += entry * columns[k, j]
        for j in range(k + 1):
            for i in range(6):
                inertia_out[k, j] += product[i] * columns[j, i]


def add_spin_decay(decay, timestep, inertia, spin, axes, arm, load_out, inertia_out):
    """Add the decay of a body's spin (3,) at a rate [1/s], as in `native.decay_spin`. inertia (3,):
    about its principal axes (9,); arm (3,): to its centre of mass."""
    force, matrix = np.zeros(6), np.zeros((6, 6))
    for k in range(3):
        damping = decay * inertia[k]
        for i in range(3):
            force[3 + k] -= damping * axes[3 * i + k] * spin[i]
        matrix[3 + k, 3 + k] = timestep * damping
    add_reaction(force, matrix, arm, axes, load_out, inertia_out)


def product_of(a, inertia, b):
    """a^T S b for motions a, b (6,) and the lower triangle of a matrix S (6, 6)."""
    total = 0.0
    for i in range(6):
        for j in range(6):
            entry = inertia[i, j] if j <= i else inertia[j, i]
            total += a[i] * entry * b[j]
    return total
