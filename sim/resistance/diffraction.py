"""Diffraction: the force of waves that a body scatters, linear in each wave.

A panel code gives the force X per metre of amplitude for frequencies and headings (see
`hydrodynamics`). It is interpolated linearly in the frequency for each wave of a sea, once, and
linearly in the heading at each step, because a hull may turn. A wave a sin(theta) gives, along the
axes of the rest frame,

    F = a (Re X sin theta + Im X cos theta),

with theta at the origin of that frame. X belongs to the frequency that the water sees, which a
current does not change. Longer waves than the code's have X in proportion to omega^2: a hull
that is small against the wave feels the acceleration of the water. Shorter waves have none.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.kernels import kernel, record
from sim.resistance.hydrodynamics import Hydrodynamics
from sim.water.gerstner import growth, sine_cosine

Array = NDArray[np.float64]
Table = NDArray[np.void]

SCATTERED = record(
    wave="i8", heading="f8", real=("f8", 6), imaginary=("f8", 6)
)  # fmt: skip
"""The force of a wave at one heading: the WAVE's row and heading [rad] in the world, and X, the
force [N/m] and torque [N] over (translation, rotation)."""

ANGLE = record(angle="f8")
"""A heading [rad] relative to the rest frame."""

FULL_TURN_ERROR = 1e-6
"""Largest difference [rad] from a full turn of headings that begin and end in the same one."""


class Scattering(NamedTuple):
    """SCATTERED rows, by wave and then by heading, and the ANGLE rows of the headings. The last
    heading is a full turn after the first."""

    forces: Table
    angles: Table


def scattering(coefficients: Hydrodynamics, waves: Table) -> Scattering:
    """The forces of a sea's WAVE rows. Waves without a force are left out."""
    angles, forces = _closed(coefficients.headings, coefficients.diffraction)
    omega, band = waves["rate"], coefficients.frequencies
    is_felt = (omega <= band[-1]) & (waves["amplitude"] > 0.0) if len(band) else omega < 0.0
    rows = np.zeros((np.count_nonzero(is_felt), len(angles)), SCATTERED)
    if rows.size:
        rows["wave"] = np.flatnonzero(is_felt)[:, None]
        felt = waves[is_felt]
        rows["heading"] = np.arctan2(felt["direction_y"], felt["direction_x"])[:, None]
        found = _at_frequencies(felt["rate"], band, forces)
        rows["real"], rows["imaginary"] = found.real, found.imag
    return Scattering(rows.ravel(), np.array([(angle,) for angle in angles], ANGLE))


def _closed(headings: Array, forces: NDArray[np.complex128]) -> tuple[Array, NDArray]:
    """Headings (B,) and forces (F, B, 6) all around: the first heading again after the last."""
    if len(headings) == 0 or np.ptp(headings) > 2.0 * np.pi - FULL_TURN_ERROR:
        return headings, forces
    angles = np.append(headings, headings[0] + 2.0 * np.pi)
    return angles, np.concatenate([forces, forces[:, :1]], axis=1)


def _at_frequencies(omega: Array, band: Array, forces: NDArray) -> NDArray[np.complex128]:
    """Forces (K, B, 6) at frequencies omega (K,) of forces (F, B, 6) at a band (F,) [rad/s]."""
    right = np.clip(np.searchsorted(band, omega), 1, max(len(band) - 1, 1))
    left, right = right - 1, np.minimum(right, len(band) - 1)
    width = np.maximum(band[right] - band[left], np.finfo(float).tiny)
    share = np.clip((omega - band[left]) / width, 0.0, 1.0)[:, None, None]
    long = np.minimum(omega / band[0], 1.0)[:, None, None] ** 2
    return long * ((1.0 - share) * forces[left] + share * forces[right])


@kernel
def add_diffraction(forces, angles, waves, time, position, yaw, share, wrench_out):
    """Add the diffraction force (6,), in the axes of the rest frame, times a share.

    position: (3,) [m], the origin of the rest frame. yaw: angle [rad] of its x axis from the
    world's x.
    """
    around, count = 2.0 * np.pi, angles.size
    for first in range(0, forces.size, max(count, 1)):
        wave = waves[forces[first].wave]
        turns = wave.turns_x * position[0] + wave.turns_y * position[1] + wave.turns
        s, c = sine_cosine(turns - wave.frequency * time)
        size = share * growth(wave, time) * wave.amplitude
        heading = forces[first].heading - yaw - angles[0].angle
        heading -= around * np.floor(heading / around)
        heading += angles[0].angle
        low, high = 0, count - 1
        while high - low > 1:
            half = (low + high) // 2
            if angles[half].angle <= heading:
                low = half
            else:
                high = half
        width = angles[high].angle - angles[low].angle
        later = min(max((heading - angles[low].angle) / width, 0.0), 1.0)
        a, b = forces[first + low], forces[first + high]
        s, c = size * s, size * c
        for j in range(6):
            real = a.real[j] + later * (b.real[j] - a.real[j])
            imaginary = a.imaginary[j] + later * (b.imaginary[j] - a.imaginary[j])
            wrench_out[j] += s * real + c * imaginary
