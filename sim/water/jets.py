"""Jets: the surface around a point as a cubic, from one solve.

A jet is the surface's height at a point and all its derivatives up to the third. The surface is
z(alpha) over x(alpha) (see `gerstner`). With J = dx/dalpha, derivatives by label on the right and
derivatives of the surface on the left, the chain rule gives one order after the other:

    G    = J^-1 z_a                                                                  slopes
    H    = J^-1 M J^-1,    M_jk = z_jk - G_i x_i,jk                                  curvatures
    K    = J^-1 J^-1 J^-1 N,                                                         third
           N_jkm = z_jkm - G_i x_i,jkm - (x_i,jk E_im + x_i,jm E_ik + x_i,km E_ij),    E = J^-1 M.

The solve stops early, at a particle near the point, and the cubic is then shifted to the point.
There are two functions, `near_particles` and `solve_jets`, so that a caller can drop points out of
the water's reach in between.

J shrinks particles together at a crest that almost folds, and a cubic with J's exact inverse then
holds only within a millimetre or less. For points that stand for a larger region, J is therefore
kept from being smaller than a given *squeeze* in any direction.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.kernels import inline, kernel, record, scratch, workspace
from sim.precision import real
from sim.water.gerstner import (
    CHUNK,
    LABELS,
    LANES,
    ONE,
    PLAIN_STEPS,
    REALS,
    SUMS,
    add_wave,
    clear_sums,
    growth,
    newton_labels,
    set_labels,
    set_phases,
    sine_cosine,
    solve_labels,
    solve_others,
    solved,
    take_labels,
    wave_sums,
)

JET = record(
    z="f8", z_x="f8", z_y="f8", z_xx="f8", z_xy="f8", z_yy="f8",
    z_xxx="f8", z_xxy="f8", z_xyy="f8", z_yyy="f8", label_x="f8", label_y="f8",
)  # fmt: skip
"""The surface's height z above the level [m] and its derivatives by position at a point, and the
label of the particle there."""

HIGHER_SUMS = record(
    x_xx=REALS, x_xy=REALS, x_yy=REALS, y_yy=REALS, z_xx=REALS, z_xy=REALS, z_yy=REALS,
    z_xxx=REALS, z_xxy=REALS, z_xyy=REALS, z_yyy=REALS,
    x_xxx=REALS, x_xxy=REALS, x_xyy=REALS, x_yyy=REALS, y_yyy=REALS,
)  # fmt: skip
"""Workspace: second and third derivatives of particle positions by label (y_xx is x_xy, y_xy is
x_yy and so on)."""


class Near(NamedTuple):
    """Particles near points (N,): their labels x and y, and the heights of the surface at the
    points above the level, exact to second order in the residual; all (N,) [m]."""

    label_x: NDArray[np.float64]
    label_y: NDArray[np.float64]
    height: NDArray[np.float64]


FIELD = record(
    z=REALS, z_x=REALS, z_y=REALS, z_xx=REALS, z_xy=REALS, z_yy=REALS,
    z_xxx=REALS, z_xxy=REALS, z_xyy=REALS, z_yyy=REALS,
)  # fmt: skip
"""Workspace: a function of the particles, such as the surface's height, and its derivatives by
label or by position."""

FIRST = record(z_x=REALS, z_y=REALS, m_xx=REALS, m_xy=REALS, m_yy=REALS)
"""Workspace: slopes of a function by position, and M of the module's docstring."""


@inline
def clear_higher(h, count):
    """Set the first `count` entries of all higher sums to 0, in loops with few fields each."""
    for i in range(count):
        h.x_xx[i], h.x_xy[i], h.x_yy[i], h.y_yy[i] = 0.0, 0.0, 0.0, 0.0
        h.z_xx[i], h.z_xy[i], h.z_yy[i] = 0.0, 0.0, 0.0
    for i in range(count):
        h.z_xxx[i], h.z_xxy[i], h.z_xyy[i], h.z_yyy[i] = 0.0, 0.0, 0.0, 0.0
        h.x_xxx[i], h.x_xxy[i], h.x_xyy[i], h.x_yyy[i], h.y_yyy[i] = 0.0, 0.0, 0.0, 0.0, 0.0


@inline
def add_second(h, i, s, c, dx, dy, wide_x, wide_y):
    """Add one wave to the second derivatives. s, c: k^2 a times the sine and cosine of its phase;
    wide_x, wide_y: its direction over T."""
    xx, xy, yy = dx * dx, dx * dy, dy * dy
    h.z_xx[i] -= xx * s
    h.z_xy[i] -= xy * s
    h.z_yy[i] -= yy * s
    h.x_xx[i] -= wide_x * xx * c
    h.x_xy[i] -= wide_y * xx * c
    h.x_yy[i] -= wide_x * yy * c
    h.y_yy[i] -= wide_y * yy * c


@inline
def add_third(h, i, s, c, dx, dy, wide_x, wide_y):
    """Add one wave to the third derivatives. s, c: k^3 a times the sine and cosine of its phase;
    wide_x, wide_y: its direction over T."""
    xx, xy, yy = dx * dx, dx * dy, dy * dy
    wide_xx, wide_xy, wide_yy = wide_x * dx, wide_x * dy, wide_y * dy
    h.z_xxx[i] -= dx * xx * c
    h.z_xxy[i] -= dy * xx * c
    h.z_xyy[i] -= dx * yy * c
    h.z_yyy[i] -= dy * yy * c
    h.x_xxx[i] += wide_xx * xx * s
    h.x_xxy[i] += wide_xx * xy * s
    h.x_xyy[i] += wide_xx * yy * s
    h.x_yyy[i] += wide_xy * yy * s
    h.y_yyy[i] += wide_yy * yy * s


@kernel
def add_wave_jet(at, p, h, count, wave, time):
    """Add one wave to the SUMS and HIGHER_SUMS of the first `count` labels, and store its sine and
    cosine. The loops have few fields each, so that the compiler vectorises them."""
    turns_x, turns_y = wave.turns_x, wave.turns_y
    turns = wave.turns - wave.frequency * time
    part, dx, dy = growth(wave, time), wave.direction_x, wave.direction_y
    wide_x, wide_y = wave.stretch * dx, wave.stretch * dy
    a, ka, kka, kkka = (
        part * wave.amplitude, part * wave.ka, part * wave.kka, part * wave.kkka
    )  # fmt: skip
    set_phases(p, count, turns_x, turns_y, turns, at)
    for i in range(count):
        p.sine[i], p.cosine[i] = sine_cosine(p.phase[i])
    for i in range(count):
        add_wave(p, i, p.sine[i], p.cosine[i], a, ka, dx, dy, wide_x, wide_y)
    for i in range(count):
        add_second(h, i, kka * p.sine[i], kka * p.cosine[i], dx, dy, wide_x, wide_y)
    for i in range(count):
        add_third(h, i, kkka * p.sine[i], kkka * p.cosine[i], dx, dy, wide_x, wide_y)


@kernel
def jet_sums(count, waves, time, labels, sums_out, higher_out):
    """Compute the SUMS and HIGHER_SUMS at the first `count` LABELS."""
    at, p, h = labels[0], sums_out[0], higher_out[0]
    clear_sums(p, count)
    clear_higher(h, count)
    for w in range(waves.size):
        add_wave_jet(at, p, h, count, waves[w], time)


@kernel
def limit_squeeze(count, squeeze, sums_out):
    """Raise the smaller eigenvalue of J at the first `count` points to `squeeze`, if it is less, by
    adding a multiple of the unit matrix."""
    p, squeeze = sums_out[0], real(squeeze)
    for i in range(count):
        mean, half = 1.0 + 0.5 * (p.x_x[i] + p.y_y[i]), 0.5 * (p.x_x[i] - p.y_y[i])
        smaller = mean - np.sqrt(half * half + p.x_y[i] * p.x_y[i])
        lack = max(squeeze - smaller, 0.0)
        p.x_x[i] += lack
        p.y_y[i] += lack


@kernel
def copy_heights(count, sums, higher, field_out):
    """The height of the particles as a FIELD by label."""
    p, h, f = sums[0], higher[0], field_out[0]
    for i in range(count):
        f.z[i], f.z_x[i], f.z_y[i] = p.z[i], p.z_x[i], p.z_y[i]
        f.z_xx[i], f.z_xy[i], f.z_yy[i] = h.z_xx[i], h.z_xy[i], h.z_yy[i]
    for i in range(count):
        f.z_xxx[i], f.z_xxy[i] = h.z_xxx[i], h.z_xxy[i]
        f.z_xyy[i], f.z_yyy[i] = h.z_xyy[i], h.z_yyy[i]


@kernel
def first_derivatives(count, sums, higher, field, first_out):
    """Slopes G by position of a FIELD by label, and the matrices M."""
    p, h, z, f = sums[0], higher[0], field[0], first_out[0]
    for i in range(count):
        gx, gy = solved(p, i, z.z_x[i], z.z_y[i])
        f.m_xx[i] = z.z_xx[i] - (gx * h.x_xx[i] + gy * h.x_xy[i])
        f.m_xy[i] = z.z_xy[i] - (gx * h.x_xy[i] + gy * h.x_yy[i])
        f.m_yy[i] = z.z_yy[i] - (gx * h.x_yy[i] + gy * h.y_yy[i])
        f.z_x[i], f.z_y[i] = gx, gy


@inline
def thirds(p, h, z, f, i):
    """N_xxx, N_xxy, N_xyy and N_yyy at point i."""
    gx, gy = f.z_x[i], f.z_y[i]
    exx, eyx = solved(p, i, f.m_xx[i], f.m_xy[i])
    exy, eyy = solved(p, i, f.m_xy[i], f.m_yy[i])
    xxx = z.z_xxx[i] - (gx * h.x_xxx[i] + gy * h.x_xxy[i])
    xxy = z.z_xxy[i] - (gx * h.x_xxy[i] + gy * h.x_xyy[i])
    xyy = z.z_xyy[i] - (gx * h.x_xyy[i] + gy * h.x_yyy[i])
    yyy = z.z_yyy[i] - (gx * h.x_yyy[i] + gy * h.y_yyy[i])
    x_xx, x_xy, x_yy, y_yy = h.x_xx[i], h.x_xy[i], h.x_yy[i], h.y_yy[i]
    return (
        xxx - 3.0 * (x_xx * exx + x_xy * eyx),
        xxy - (x_xx * exy + x_xy * eyy + 2.0 * (x_xy * exx + x_yy * eyx)),
        xyy - (2.0 * (x_xy * exy + x_yy * eyy) + x_yy * exx + y_yy * eyx),
        yyy - 3.0 * (x_yy * exy + y_yy * eyy),
    )


@kernel
def third_derivatives(count, sums, higher, field, first, place_out):
    """Third derivatives by position of a FIELD by label. The loop has as few fields as possible, so
    that it vectorises."""
    p, h, z, f, s = sums[0], higher[0], field[0], first[0], place_out[0]
    for i in range(count):
        xxx, xxy, xyy, yyy = thirds(p, h, z, f, i)
        ax, bx = solved(p, i, xxx, xxy)
        ay, by = solved(p, i, xxy, xyy)
        az, bz = solved(p, i, xyy, yyy)
        xxx, xyx = solved(p, i, ax, ay)
        xxy, xyy = solved(p, i, ay, az)
        yyx = solved(p, i, bx, by)[1]
        yyy = solved(p, i, by, bz)[1]
        s.z_xxx[i], s.z_xxy[i] = solved(p, i, xxx, xxy)
        s.z_xyy[i] = solved(p, i, xyx, xyy)[1]
        s.z_yyy[i] = solved(p, i, yyx, yyy)[1]


@kernel
def second_derivatives(count, sums, field, first, place_out):
    """Value, slopes and second derivatives by position of a FIELD by label."""
    p, z, f, s = sums[0], field[0], first[0], place_out[0]
    for i in range(count):
        px, py = solved(p, i, f.m_xx[i], f.m_xy[i])
        qx, qy = solved(p, i, f.m_xy[i], f.m_yy[i])
        s.z_xx[i], s.z_xy[i] = solved(p, i, px, qx)
        s.z_yy[i] = solved(p, i, py, qy)[1]
        s.z[i], s.z_x[i], s.z_y[i] = z.z[i], f.z_x[i], f.z_y[i]


@kernel
def set_rests(x, y, count, labels, sums_out):
    """Set the residuals of the points x, y: (N,) [m] at the labels that the sums belong to, and
    those up to `count` to 0. Return the largest one, squared [m^2]."""
    at, p, largest = labels[0], sums_out[0], 0.0
    for i in range(x.size):
        rx, ry = x[i] - at.x[i] - p.x[i], y[i] - at.y[i] - p.y[i]
        p.rest_x[i], p.rest_y[i] = rx, ry
        largest = max(largest, rx * rx + ry * ry)
    for i in range(x.size, count):
        p.rest_x[i], p.rest_y[i] = 0.0, 0.0
    return largest


@kernel
def shift_surface(count, sums, surface, surface_out):
    """Shift the surface's derivatives from its particles to the first `count` points. The shift by
    the residual leaves an error of fourth order in the height and of third order in the slopes."""
    p, s, new = sums[0], surface[0], surface_out[0]
    for i in range(count):
        rx, ry = p.rest_x[i], p.rest_y[i]
        turn_xx = s.z_xxx[i] * rx + s.z_xxy[i] * ry
        turn_xy = s.z_xxy[i] * rx + s.z_xyy[i] * ry
        turn_yy = s.z_xyy[i] * rx + s.z_yyy[i] * ry
        bend_xx, bend_xy = s.z_xx[i] + turn_xx / 3.0, s.z_xy[i] + turn_xy / 3.0
        bend_yy = s.z_yy[i] + turn_yy / 3.0
        rise_x = s.z_x[i] + 0.5 * (bend_xx * rx + bend_xy * ry)
        rise_y = s.z_y[i] + 0.5 * (bend_xy * rx + bend_yy * ry)
        new.z[i] = s.z[i] + (rise_x * rx + rise_y * ry)
    for i in range(count):
        rx, ry = p.rest_x[i], p.rest_y[i]
        turn_xx = s.z_xxx[i] * rx + s.z_xxy[i] * ry
        turn_xy = s.z_xxy[i] * rx + s.z_xyy[i] * ry
        turn_yy = s.z_xyy[i] * rx + s.z_yyy[i] * ry
        bend_xx, bend_xy = s.z_xx[i] + 0.5 * turn_xx, s.z_xy[i] + 0.5 * turn_xy
        bend_yy = s.z_yy[i] + 0.5 * turn_yy
        new.z_x[i] = s.z_x[i] + (bend_xx * rx + bend_xy * ry)
        new.z_y[i] = s.z_y[i] + (bend_xy * rx + bend_yy * ry)
        new.z_xx[i], new.z_xy[i] = s.z_xx[i] + turn_xx, s.z_xy[i] + turn_xy
        new.z_yy[i] = s.z_yy[i] + turn_yy
    for i in range(count):
        new.z_xxx[i], new.z_xxy[i] = s.z_xxx[i], s.z_xxy[i]
        new.z_xyy[i], new.z_yyy[i] = s.z_xyy[i], s.z_yyy[i]


@kernel
def gather_jets(surface, labels, sums, jets_out):
    """Collect the jets (N,) of a chunk's points from its workspaces. The labels are shifted from
    the particles to the points to first order."""
    s, at, p = surface[0], labels[0], sums[0]
    for i in range(jets_out.size):
        jet = jets_out[i]
        jet.z, jet.z_x, jet.z_y = s.z[i], s.z_x[i], s.z_y[i]
        jet.z_xx, jet.z_xy, jet.z_yy = s.z_xx[i], s.z_xy[i], s.z_yy[i]
        jet.z_xxx, jet.z_xxy, jet.z_xyy, jet.z_yyy = s.z_xxx[i], s.z_xxy[i], s.z_xyy[i], s.z_yyy[i]
        step_x, step_y = solved(p, i, p.rest_x[i], p.rest_y[i])
        jet.label_x, jet.label_y = at.x[i] + step_x, at.y[i] + step_y


@kernel
def keep_labels(labels, x_out, y_out):
    """Copy the first labels into x_out, y_out: (N,) [m]."""
    at = labels[0]
    for i in range(x_out.size):
        x_out[i], y_out[i] = at.x[i], at.y[i]


@kernel
def find_near(x, y, waves, time, steps, tolerance, near_out):
    """Find the particles Near the points x, y: (N,) [m], after the given number of plain Newton
    steps from the points, at least one. After PLAIN_STEPS, in a sea about to fold, points whose
    residual still exceeds the tolerance [m] are solved with a safeguard."""
    labels, nearer, sums = workspace(LABELS), workspace(LABELS), workspace(SUMS)
    for start in range(0, x.size, CHUNK):
        end = min(start + CHUNK, x.size)
        px, py, heights = x[start:end], y[start:end], near_out.height[start:end]
        filled = set_labels(px, py, labels)
        for _ in range(max(steps, 1)):
            wave_sums(filled, waves, time, labels, sums)
            newton_labels(px, py, labels, sums, heights, nearer)
            take_labels(px.size, nearer, labels)
        if steps >= PLAIN_STEPS:
            solve_others(px, py, labels, waves, time, tolerance, nearer, sums, heights, labels)
        keep_labels(labels, near_out.label_x[start:end], near_out.label_y[start:end])


@kernel
def near_particles(x, y, waves, time, steps, tolerance):
    """The particles Near the points x, y: (N,) [m], see `find_near`."""
    rows = np.empty((3, x.size))
    near = Near(rows[0], rows[1], rows[2])
    find_near(x, y, waves, time, steps, tolerance, near)
    return near


@kernel
def finish_jets(squeeze, labels, sums, higher, jets_out):
    """Jets (N,) of the surface at points, from the sums at labels near them."""
    first, heights = workspace(FIRST), workspace(FIELD)
    at_particles, at_points = workspace(FIELD), workspace(FIELD)
    filled = -(-jets_out.size // LANES) * LANES
    if squeeze > 0.0:
        limit_squeeze(filled, squeeze, sums)
    copy_heights(filled, sums, higher, heights)
    first_derivatives(filled, sums, higher, heights, first)
    third_derivatives(filled, sums, higher, heights, first, at_particles)
    second_derivatives(filled, sums, heights, first, at_particles)
    shift_surface(filled, sums, at_particles, at_points)
    gather_jets(at_points, labels, sums, jets_out)


@kernel
def solve_jets(x, y, near, waves, time, tolerance, squeeze, jets_out):
    """Jets (N,) of the surface at the points x, y: (N,) [m], from particles Near them. squeeze:
    the least that J may shrink a length to, 0 for exact derivatives.

    Where the residual exceeds the tolerance [m], the labels are solved further. As long as the
    steps taken for `near` suffice, jets are smooth functions of the point, however loose the
    tolerance is.
    """
    labels, nearer, sums = workspace(LABELS), workspace(LABELS), workspace(SUMS)
    higher, found = workspace(HIGHER_SUMS), scratch(CHUNK)
    for start in range(0, x.size, CHUNK):
        end = min(start + CHUNK, x.size)
        px, py = x[start:end], y[start:end]
        filled = set_labels(near.label_x[start:end], near.label_y[start:end], labels)
        jet_sums(filled, waves, time, labels, sums, higher)
        if not set_rests(px, py, filled, labels, sums) <= tolerance * tolerance:
            solve_labels(px, py, labels, waves, time, tolerance, ONE, found[: px.size], nearer)
            take_labels(filled, nearer, labels)
            jet_sums(filled, waves, time, labels, sums, higher)
            set_rests(px, py, filled, labels, sums)
        finish_jets(squeeze, labels, sums, higher, jets_out[start:end])
