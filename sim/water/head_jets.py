"""Head jets: the head around a point as a cubic in x, y and z, from one solve.

Under waves whose pressure decays, the head (see `head`) is, with z' = z - level and the height s =
z' - z(alpha) <= 0 above the surface,

    h = F(alpha, s) - z',     F = sum a E sin(theta) - sum (k a^2 / 2) (1 - E)^2,    E = e^(k s),

a function of the label alpha and of z'. At a fixed z' it is a function of the particles, as the
surface's height is. The same chain rule (`jets`) therefore turns its derivatives by label,

    h_a   = F_a - F_s z_a
    h_ab  = F_ab - (F_as z_b + F_bs z_a) + F_ss z_a z_b - F_s z_ab
    h_abc = F_abc - (F_abs z_c + ..) + (F_ass z_b z_c + ..) - F_sss z_a z_b z_c
            - (F_as z_bc + ..) + F_ss (z_a z_bc + ..) - F_s z_abc,

into derivatives by position. The derivatives by z, h_z = F_s - 1, h_zz = F_ss and h_zzz = F_sss,
are also functions of the particles. Directions are unit vectors, so F_ss, F_ass and F_sss are
traces of other derivatives, apart from the contribution of the second sum.

In water of depth H (see `head`), F has C instead of E and (1 - C + S^2 - T S) / T instead of (1 -
E)^2. The derivatives of C and S by s are k S and k C, so those of F by s once have S, and by s
twice have C.

At a point above the surface, the cubic is the extension of the cubic at the surface directly below.
Inside a patch that the water cuts, the head then continues smoothly beyond the surface.
"""

from sim.kernels import inline, kernel, record, scratch, workspace
from sim.water.gerstner import (
    CHUNK,
    LABELS,
    ONE,
    REALS,
    ROW,
    SUMS,
    bed_decays,
    clear_sums,
    decay,
    growth,
    set_labels,
    solve_labels,
    solved,
    take_labels,
)
from sim.water.jets import (
    FIELD,
    FIRST,
    HIGHER_SUMS,
    add_wave_jet,
    clear_higher,
    first_derivatives,
    limit_squeeze,
    second_derivatives,
    set_rests,
    shift_surface,
    third_derivatives,
)

HEAD_JETS = record(
    h=ROW, x=REALS, y=REALS, z=REALS, xx=REALS, xy=REALS, yy=REALS, xz=REALS, yz=REALS, zz=REALS,
    xxx=REALS, xxy=REALS, xyy=REALS, yyy=REALS, xxz=REALS, xyz=REALS, yyz=REALS,
    xzz=REALS, yzz=REALS, zzz=REALS,
)  # fmt: skip
"""The heads [m] at a chunk's points and their derivatives there. Deep down heads are much larger
than their differences over a hull, so they are double."""

DECAYED = record(
    s=REALS, up=REALS, lost=REALS, x=REALS, y=REALS, s_1=REALS, xx=REALS, xy=REALS, yy=REALS,
    xs=REALS, ys=REALS, xxx=REALS, xxy=REALS, xyy=REALS, yyy=REALS, xxs=REALS, xys=REALS, yys=REALS,
    s_2=REALS, s_3=REALS, sine=REALS, cosine=REALS,
)  # fmt: skip
"""Workspace: heights s [m] above the surface, at most 0; `up` from there to the points; the head
[m] lost by the decay there; and derivatives of F. s_1 is all of F_s; s_2 and s_3 are only the
second sum's share of F_ss and F_sss. sine, cosine: of one wave above a bottom, times S."""


@kernel
def set_depths(count, above, heights, decayed_out):
    """Set the heights s of the first `count` points, from the heights (N,) [m] of points and
    surface above the level. It is 0 for points above the surface and for those that fill up the
    LANES."""
    d = decayed_out[0]
    for i in range(above.size):
        d.s[i] = min(above[i] - heights[i], 0.0)
    for i in range(above.size, count):
        d.s[i] = 0.0


@kernel
def set_ups(count, above, sums, decayed_out):
    """Set how far the points (N,) are above the heights s over their particles, and 0 for those
    that fill up the LANES."""
    p, d = sums[0], decayed_out[0]
    for i in range(above.size):
        d.up[i] = above[i] - d.s[i] - p.z[i]  # in this order, in double precision
    for i in range(above.size, count):
        d.up[i] = 0.0


@inline
def clear_decayed(d, count):
    for i in range(count):
        d.lost[i], d.x[i], d.y[i], d.s_1[i], d.xx[i], d.xy[i] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        d.yy[i], d.xs[i], d.ys[i], d.s_2[i], d.s_3[i] = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        d.xxx[i], d.xxy[i], d.xyy[i], d.yyy[i] = 0.0, 0.0, 0.0, 0.0
        d.xxs[i], d.xys[i], d.yys[i] = 0.0, 0.0, 0.0


@inline
def add_firsts(d, i, s, c, e, a, ka, k, dx, dy):
    """Add one wave, with sine s and cosine c of its phase and decay e, to the lost head, to the
    first derivatives, and to the derivatives of the second sum."""
    lost, second = 1.0 - e, ka * ka * e
    d.lost[i] += a * lost * (s + 0.5 * ka * lost)
    d.x[i] += dx * (ka * e * c)
    d.y[i] += dy * (ka * e * c)
    d.s_1[i] += ka * e * s + second * lost
    d.s_2[i] += k * second * (1.0 - 2.0 * e)
    d.s_3[i] += k * k * second * (1.0 - 4.0 * e)


@inline
def add_bed_firsts(d, i, s, c, e, v, a, ka, k, dx, dy, wave):
    """Add one wave above a bottom, as in `add_firsts`; e, v: C and S."""
    tanh = wave.tanh
    lost, second = 1.0 - e, 0.5 * ka * ka * wave.stretch
    d.lost[i] += a * lost * s + 0.5 * a * ka * wave.stretch * (lost + v * (v - tanh))
    d.x[i] += dx * (ka * e * c)
    d.y[i] += dy * (ka * e * c)
    d.s_1[i] += ka * v * s + second * (v - 2.0 * v * e + tanh * e)
    d.s_2[i] += k * second * (e - 2.0 * (e * e + v * v) + tanh * v)
    d.s_3[i] += k * k * second * (v - 8.0 * v * e + tanh * e)


@inline
def add_others(d, i, s, c, up_s, up_c, kka, kkka, dx, dy):
    """Add one wave, with sine s and cosine c times C, and the same times S, to the other
    derivatives. On deep water C is S."""
    xx, xy, yy = dx * dx, dx * dy, dy * dy
    d.xx[i] -= xx * (kka * s)
    d.xy[i] -= xy * (kka * s)
    d.yy[i] -= yy * (kka * s)
    d.xs[i] += dx * (kka * up_c)
    d.ys[i] += dy * (kka * up_c)
    up_s, c = kkka * up_s, kkka * c
    d.xxx[i] -= dx * xx * c
    d.xxy[i] -= dy * xx * c
    d.xyy[i] -= dx * yy * c
    d.yyy[i] -= dy * yy * c
    d.xxs[i] -= xx * up_s
    d.xys[i] -= xy * up_s
    d.yys[i] -= yy * up_s


@kernel
def head_sums(count, waves, time, labels, sums_out, higher_out, decayed_out):
    """Compute SUMS, HIGHER_SUMS and DECAYED at the first `count` LABELS, for the heights s in
    DECAYED."""
    at, p, h, d = labels[0], sums_out[0], higher_out[0], decayed_out[0]
    clear_sums(p, count)
    clear_higher(h, count)
    clear_decayed(d, count)
    for w in range(waves.size):
        wave = waves[w]
        part = growth(wave, time)
        a, ka, kka, kkka = (
            part * wave.amplitude, part * wave.ka, part * wave.kka, part * wave.kkka
        )  # fmt: skip
        k, dx, dy = wave.wavenumber, wave.direction_x, wave.direction_y
        add_wave_jet(at, p, h, count, wave, time)
        if wave.bed == 0.0:
            for i in range(count):
                e, s, c = decay(-k * d.s[i]), p.sine[i], p.cosine[i]
                add_firsts(d, i, s, c, e, a, ka, k, dx, dy)
                p.sine[i], p.cosine[i] = e * s, e * c
            for i in range(count):
                s, c = p.sine[i], p.cosine[i]
                add_others(d, i, s, c, s, c, kka, kkka, dx, dy)
        else:
            for i in range(count):
                e, v = bed_decays(-k * d.s[i], wave.bed, wave.tanh)
                s, c = p.sine[i], p.cosine[i]
                add_bed_firsts(d, i, s, c, e, v, a, ka, k, dx, dy, wave)
                p.sine[i], p.cosine[i], d.sine[i], d.cosine[i] = e * s, e * c, v * s, v * c
            for i in range(count):
                s, c, up_s, up_c = p.sine[i], p.cosine[i], d.sine[i], d.cosine[i]
                add_others(d, i, s, c, up_s, up_c, kka, kkka, dx, dy)


@inline
def vertical(d, i):
    """F_s, F_ss, F_xss, F_yss and F_sss."""
    return (
        d.s_1[i], d.s_2[i] - (d.xx[i] + d.yy[i]), -(d.xxx[i] + d.xyy[i]),
        -(d.xxy[i] + d.yyy[i]), d.s_3[i] - (d.xxs[i] + d.yys[i]),
    )  # fmt: skip


@kernel
def head_by_label(count, sums, higher, decayed, field_out):
    """The head, less the depth - s, and its derivatives by label at a fixed height, as a FIELD."""
    p, h, d, f = sums[0], higher[0], decayed[0], field_out[0]
    for i in range(count):
        s, ss, _, _, _ = vertical(d, i)
        zx, zy = p.z_x[i], p.z_y[i]
        f.z[i] = -d.lost[i]
        f.z_x[i], f.z_y[i] = d.x[i] - s * zx, d.y[i] - s * zy
        f.z_xx[i] = d.xx[i] - 2.0 * d.xs[i] * zx + ss * zx * zx - s * h.z_xx[i]
        f.z_xy[i] = d.xy[i] - (d.xs[i] * zy + d.ys[i] * zx) + ss * zx * zy - s * h.z_xy[i]
        f.z_yy[i] = d.yy[i] - 2.0 * d.ys[i] * zy + ss * zy * zy - s * h.z_yy[i]
    for i in range(count):
        s, ss, xss, yss, sss = vertical(d, i)
        zx, zy, zxx, zxy, zyy = p.z_x[i], p.z_y[i], h.z_xx[i], h.z_xy[i], h.z_yy[i]
        bx, by = ss * zx - d.xs[i], ss * zy - d.ys[i]
        f.z_xxx[i] = (
            d.xxx[i] - 3.0 * d.xxs[i] * zx + (3.0 * xss - sss * zx) * zx * zx
            + 3.0 * bx * zxx - s * h.z_xxx[i]
        )  # fmt: skip
        f.z_xxy[i] = (
            d.xxy[i] - d.xxs[i] * zy - 2.0 * d.xys[i] * zx + (2.0 * xss * zy + yss * zx) * zx
            - sss * zx * zx * zy + by * zxx + 2.0 * bx * zxy - s * h.z_xxy[i]
        )  # fmt: skip
        f.z_xyy[i] = (
            d.xyy[i] - d.yys[i] * zx - 2.0 * d.xys[i] * zy + (2.0 * yss * zx + xss * zy) * zy
            - sss * zx * zy * zy + bx * zyy + 2.0 * by * zxy - s * h.z_xyy[i]
        )  # fmt: skip
        f.z_yyy[i] = (
            d.yyy[i] - 3.0 * d.yys[i] * zy + (3.0 * yss - sss * zy) * zy * zy
            + 3.0 * by * zyy - s * h.z_yyy[i]
        )  # fmt: skip


@kernel
def slope_by_label(count, sums, higher, decayed, field_out):
    """h_z and its first and second derivatives by label, as a FIELD."""
    p, h, d, f = sums[0], higher[0], decayed[0], field_out[0]
    for i in range(count):
        s, ss, xss, yss, sss = vertical(d, i)
        zx, zy = p.z_x[i], p.z_y[i]
        f.z[i] = s - 1.0
        f.z_x[i], f.z_y[i] = d.xs[i] - ss * zx, d.ys[i] - ss * zy
        f.z_xx[i] = d.xxs[i] - 2.0 * xss * zx + sss * zx * zx - ss * h.z_xx[i]
        f.z_xy[i] = d.xys[i] - (xss * zy + yss * zx) + sss * zx * zy - ss * h.z_xy[i]
        f.z_yy[i] = d.yys[i] - 2.0 * yss * zy + sss * zy * zy - ss * h.z_yy[i]


@inline
def bend(p, d, i):
    """h_zz, its derivatives by x and y, and h_zzz."""
    _, ss, xss, yss, sss = vertical(d, i)
    gx, gy = solved(p, i, xss - sss * p.z_x[i], yss - sss * p.z_y[i])
    return ss, gx, gy, sss


@kernel
def shift_heads(count, sums, decayed, head, slope, jets_out):
    """HEAD_JETS at the first `count` points.

    The FIELD of the head, less its depth, is already at these points. The FIELD of h_z and the
    higher derivatives by z are shifted to them. All are then shifted vertically to the points:
    those above the surface, and those whose heights s were taken from an inexact surface.
    """
    p, d, f, g, jet = sums[0], decayed[0], head[0], slope[0], jets_out[0]
    for i in range(count):
        rx, ry, up = p.rest_x[i], p.rest_y[i], d.up[i]
        zz, xzz, yzz, zzz = bend(p, d, i)
        zz += xzz * rx + yzz * ry
        xz = g.z_x[i] + (g.z_xx[i] * rx + g.z_xy[i] * ry)
        yz = g.z_y[i] + (g.z_xy[i] * rx + g.z_yy[i] * ry)
        z = g.z[i] + 0.5 * ((g.z_x[i] + xz) * rx + (g.z_y[i] + yz) * ry)
        d.lost[i] = f.z[i] + up * (z + up * (0.5 * zz + up * zzz / 6.0))
        jet.x[i] = f.z_x[i] + up * (xz + 0.5 * up * xzz)
        jet.y[i] = f.z_y[i] + up * (yz + 0.5 * up * yzz)
        jet.z[i] = z + up * (zz + 0.5 * up * zzz)
        jet.xz[i], jet.yz[i], jet.zz[i] = xz + up * xzz, yz + up * yzz, zz + up * zzz
        jet.xzz[i], jet.yzz[i], jet.zzz[i] = xzz, yzz, zzz
    for i in range(count):
        up = d.up[i]
        jet.xx[i], jet.xy[i] = f.z_xx[i] + up * g.z_xx[i], f.z_xy[i] + up * g.z_xy[i]
        jet.yy[i] = f.z_yy[i] + up * g.z_yy[i]
        jet.xxx[i], jet.xxy[i], jet.xyy[i] = f.z_xxx[i], f.z_xxy[i], f.z_xyy[i]
        jet.yyy[i], jet.xxz[i], jet.xyz[i] = f.z_yyy[i], g.z_xx[i], g.z_xy[i]
        jet.yyz[i] = g.z_yy[i]
    for i in range(count):
        jet.h[i] = d.lost[i]
        jet.h[i] -= d.s[i]


@kernel
def finish_head_jets(count, squeeze, sums, higher, decayed, jets_out):
    """HEAD_JETS at the first `count` points, from the sums at labels near them."""
    first, field, slope = workspace(FIRST), workspace(FIELD), workspace(FIELD)
    at_particles, at_points = workspace(FIELD), workspace(FIELD)
    if squeeze > 0.0:
        limit_squeeze(count, squeeze, sums)
    head_by_label(count, sums, higher, decayed, field)
    first_derivatives(count, sums, higher, field, first)
    third_derivatives(count, sums, higher, field, first, at_particles)
    second_derivatives(count, sums, field, first, at_particles)
    shift_surface(count, sums, at_particles, at_points)
    slope_by_label(count, sums, higher, decayed, field)
    first_derivatives(count, sums, higher, field, first)
    second_derivatives(count, sums, field, first, slope)
    shift_heads(count, sums, decayed, at_points, slope, jets_out)


@kernel
def solve_head_jets(x, y, above, near, waves, time, tolerance, squeeze, jets_out):
    """HEAD_JETS, one for each CHUNK of the points x, y: (N,) [m] with heights `above` the level
    (N,) [m], from particles Near them; tolerance and squeeze as in `jets.solve_jets`."""
    labels, nearer, sums = workspace(LABELS), workspace(LABELS), workspace(SUMS)
    higher, decayed, found = workspace(HIGHER_SUMS), workspace(DECAYED), scratch(CHUNK)
    for chunk in range(jets_out.size):
        start, end = chunk * CHUNK, min((chunk + 1) * CHUNK, x.size)
        px, py, places, heights = x[start:end], y[start:end], above[start:end], found[: end - start]
        filled = set_labels(near.label_x[start:end], near.label_y[start:end], labels)
        set_depths(filled, places, near.height[start:end], decayed)
        head_sums(filled, waves, time, labels, sums, higher, decayed)
        if not set_rests(px, py, filled, labels, sums) <= tolerance * tolerance:
            solve_labels(px, py, labels, waves, time, tolerance, ONE, heights, nearer)
            take_labels(filled, nearer, labels)
            set_depths(filled, places, heights, decayed)
            head_sums(filled, waves, time, labels, sums, higher, decayed)
            set_rests(px, py, filled, labels, sums)
        set_ups(filled, places, sums, decayed)
        finish_head_jets(filled, squeeze, sums, higher, decayed, jets_out[chunk : chunk + 1])
