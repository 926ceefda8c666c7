"""Fit of the water's memory: added mass and damping over frequency as a sum of damped oscillators.

Of a panel code's added mass A and damping B at frequencies omega, with A_inf at infinite frequency,

    K = B + i omega (A - A_inf)  is fitted by  sum of l l^T h,
    h = i omega / (a0 - omega^2 + i a1 omega),   a0, a1 > 0.

Each column l (6,) is a pair of states of `sim.resistance.hydrodynamics`. Such a sum takes energy
from the body at every frequency, whatever its numbers are. Least squares by Levenberg and Marquardt
over log a0, log a1 and l; columns are added until the error is small or stops falling.

Sources: Perez and Fossen 2008 for states in place of a convolution; Nocedal and Wright 2006, 10.3.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement, product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FREEDOMS = ("surge", "sway", "heave", "roll", "pitch", "yaw")

NOISE_SHARE = 0.02
"""Share of the largest values of two freedoms: a smaller entry is the noise of a panel code."""

ASYMMETRY_SHARE = 0.1
"""Share of the largest values of two freedoms by which a panel code's A and B may be asymmetric.
Panels of finite size make a few hundredths."""

NEGLIGIBLE_SHARE = 1e-3
"""Share of the largest value of all freedoms, in one unit: a freedom with a smaller one makes no
waves, for example the yaw of a sphere."""

GOOD_ERROR = 0.05
"""Error of a fit below which no column is added."""

LEAST_GAIN = 0.9
"""Ratio of the root mean square errors with and without another column above which the column is
not worth its states."""

MOST_COLUMNS = 6
"""Largest number of columns per freedom."""

NARROWEST_PEAK = 2.0
"""Least width a1 of a fitted peak, in distances between frequencies. Nothing is known of a narrower
peak, which would ring in the time domain."""

WIDEST_BAND = 3.0
"""Factor beyond the lowest and the highest frequency up to which the root of a0 may lie."""

MOST_STEPS, TRIAL_STEPS, SMALLEST_DROP = 150, 30, 1e-9
"""Steps of least squares, and of those among several starts; the relative drop of the sum of
squares that ends them earlier."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted memory.

    memory: (N, 8), rows a0 [1/s^2], a1 [1/s], l (6). errors: (6, 6), the largest error of each
    entry of K over the frequencies, over the root of the product of the largest |K| of its two
    freedoms; 0 for freedoms that make no waves.
    """

    memory: Array
    errors: Array

    @property
    def worst(self) -> tuple[float, str]:
        """The largest error and the name of its entry."""
        i, j = np.unravel_index(np.argmax(self.errors), (6, 6))
        names = dict.fromkeys((FREEDOMS[i], FREEDOMS[j]))
        return float(self.errors[i, j]), "-".join(names)


def memory_force(memory: Array, frequencies: Array) -> Complex:
    """K (F, 6, 6) of a memory (N, 8) at frequencies (F,) [rad/s]."""
    return _model(memory[:, :2], memory[:, 2:], frequencies)


def fit_memory(
    frequencies: Array, added: Array, damping: Array, added_inf: Array, length: float
) -> Fit:
    """The memory of a body.

    frequencies: (F,) [rad/s], above 0. added: (F, 6, 6), added_inf: (6, 6) [kg, kg m, kg m^2].
    damping: (F, 6, 6) [N s/m, N s, N m s]. length [m]: of the body, to compare rotations with
    translations. Raises ValueError for coefficients that no body has.
    """
    added, damping, added_inf = checked(added, damping, added_inf, length)
    omega = np.asarray(frequencies, dtype=float)
    K = damping + 1j * omega[:, None, None] * (added - added_inf)
    scales = scales_of(K, length)
    rows = [np.empty((0, 8))]
    for block in _blocks(K, scales):
        unit, time = scales[block], float(np.exp(np.log(omega).mean()))
        scaled = K[:, block][:, :, block] / np.outer(unit, unit)
        poles, columns = _fit_block(omega / time, scaled)
        whole = np.zeros((len(poles), 8))
        whole[:, 0], whole[:, 1] = poles[:, 0] * time**2, poles[:, 1] * time
        whole[:, 2 + block] = columns * unit * np.sqrt(time)
        rows.append(whole)
    memory = np.concatenate(rows)
    memory = memory[np.argsort(memory[:, 0], kind="stable")]
    errors = np.abs(K - memory_force(memory, omega)).max(axis=0)
    makes_waves = scales > 0.0
    share = np.outer(scales, scales)
    errors = np.where(np.outer(makes_waves, makes_waves), errors / np.maximum(share, 1e-300), 0.0)
    return Fit(memory, errors)


def checked(
    added: Array, damping: Array, added_inf: Array, length: float
) -> tuple[Array, Array, Array]:
    """The symmetric parts of A, B (F, 6, 6) and A_inf (6, 6). Raises ValueError if a matrix is far
    from symmetric, if A_inf is not positive, or if B adds energy."""
    units = np.array([1.0] * 3 + [length] * 3)
    found = []
    for name, matrix in (("added mass", added), ("damping", damping), ("A_inf", added_inf)):
        matrix = np.asarray(matrix, dtype=float)
        if not np.isfinite(matrix).all():
            raise ValueError(
                f"the {name} has a number that is not finite; correct the panel code's"
            )
        scaled = (matrix / np.outer(units, units)).reshape(-1, 6, 6)
        largest = np.abs(scaled).max()
        off = np.abs(scaled - scaled.transpose(0, 2, 1)).max()
        if off > ASYMMETRY_SHARE * largest:
            raise ValueError(
                f"the {name} is not symmetric: two opposite entries differ by {off / largest:.0%} "
                "of the largest; expected the six motions about one point, or finer panels"
            )
        lowest = np.linalg.eigvalsh(0.5 * (scaled + scaled.transpose(0, 2, 1))).min()
        if name != "added mass" and lowest < -NOISE_SHARE * largest:
            raise ValueError(
                f"the {name} has a negative eigenvalue, {lowest / largest:.0%} of its largest entry"
                ", which would add energy to a moving body; expected none: use finer panels, or a "
                "lid against irregular frequencies"
            )
        found.append(0.5 * (matrix + np.swapaxes(matrix, -1, -2)))
    values, vectors = np.linalg.eigh(found[2] / np.outer(units, units))
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(units, units)
    return found[0], found[1], positive


def scales_of(K: Complex, length: float) -> Array:
    """The root (6,) of the largest |K| of each freedom; 0 of a freedom that makes no waves."""
    peaks = np.abs(np.diagonal(K, axis1=1, axis2=2)).max(axis=0)
    in_one_unit = peaks / np.array([1.0] * 3 + [length**2] * 3)
    makes_waves = (in_one_unit > NEGLIGIBLE_SHARE * in_one_unit.max()) & (peaks > 0.0)
    return np.where(makes_waves, np.sqrt(peaks), 0.0)


def _blocks(K: Complex, scales: Array) -> list[NDArray[np.int64]]:
    """The groups of freedoms that waves couple, as indices."""
    makes_waves = scales > 0.0
    share = np.where(makes_waves, scales, np.inf)
    is_coupled = np.abs(K).max(axis=0) > NOISE_SHARE * np.outer(share, share)
    reach = np.linalg.matrix_power((is_coupled | np.eye(6, dtype=bool)).astype(int), 6) > 0
    left, blocks = set(np.flatnonzero(makes_waves).tolist()), []
    while left:
        block = np.flatnonzero(reach[min(left)] & makes_waves)
        blocks.append(block)
        left -= set(block.tolist())
    return blocks


def _fit_block(omega: Array, K: Complex) -> tuple[Array, Array]:
    """Poles (N, 2) and columns (N, n) for K (F, n, n), whose diagonal has the largest value 1."""
    size = K.shape[1]
    poles, columns = np.empty((0, 2)), np.empty((0, size))
    for i in range(size):  # one for each freedom: the peak of B, and a wide one
        top = float(omega[np.argmax(K[:, i, i].real)])
        poles = np.vstack([poles, [top**2, top]])
        columns = np.vstack([columns, np.sqrt(top) * np.eye(size)[i]])
    poles, columns = _improved(omega, K, poles, columns)
    while len(poles) < MOST_COLUMNS * size:
        errors = _errors(omega, K, poles, columns)
        if np.abs(errors).max() < GOOD_ERROR:
            break
        more = _with_another(omega, K, poles, columns)
        if np.linalg.norm(_errors(omega, K, *more)) > LEAST_GAIN * np.linalg.norm(errors):
            break
        poles, columns = more
    return poles, columns


def _with_another(omega: Array, K: Complex, poles: Array, columns: Array) -> tuple[Array, Array]:
    """A fit with another column: the one that, begun at one of several frequencies with one of two
    widths, takes most of the errors away."""
    missing = -_errors(omega, K, poles, columns)
    found = []
    for share, width in product((0.2, 0.4, 0.6, 0.8, 1.0), (0.5, 1.5)):
        at = int(share * (len(omega) - 1))
        values, vectors = np.linalg.eigh(missing[at].real)
        column = vectors[:, -1] * np.sqrt(max(values[-1], 0.01) * width * omega[at])
        pole = [omega[at] ** 2, width * omega[at]]
        found.append(_improved(omega, missing, np.array([pole]), column[None], TRIAL_STEPS))
    best = min(found, key=lambda fit: float(np.linalg.norm(_errors(omega, missing, *fit))))
    return _improved(omega, K, np.vstack([poles, best[0]]), np.vstack([columns, best[1]]))


def _errors(omega: Array, K: Complex, poles: Array, columns: Array) -> Complex:
    """Errors (F, n, n) of a fit."""
    return _model(poles, columns, omega) - K


def _model(poles: Array, columns: Array, omega: Array) -> Complex:
    """K (F, n, n) of poles (N, 2) and columns (N, n)."""
    return np.einsum("fp,pi,pj->fij", _oscillators(poles, omega)[0], columns, columns)


def _oscillators(poles: Array, omega: Array) -> tuple[Complex, Complex, Complex]:
    """h (F, N) and its derivatives to log a0 and log a1."""
    (a0, a1), w = poles.T, omega[:, None]
    below = a0 - w**2 + 1j * a1 * w
    h = 1j * w / below
    return h, -h * a0 / below, -h * 1j * a1 * w / below


def _improved(
    omega: Array, K: Complex, poles: Array, columns: Array, steps: int = MOST_STEPS
) -> tuple[Array, Array]:
    """Poles and columns with a least sum of squared errors, nearest downhill."""
    x, caution = _bounded(omega, np.concatenate([np.log(poles), columns], axis=1)), 1e-2
    residual, slopes = _residual(omega, K, x)
    for _ in range(steps):
        square = slopes.T @ slopes
        damped = square + caution * np.diag(np.diag(square) + 1e-12)
        step = np.linalg.solve(damped, -slopes.T @ residual).reshape(x.shape)
        step *= min(1.0, 1.0 / max(np.abs(step[:, :2]).max(), 1e-300))
        moved = _bounded(omega, x + step)
        tried, tried_slopes = _residual(omega, K, moved)
        before, after = residual @ residual, tried @ tried
        if after < before:
            x, residual, slopes = moved, tried, tried_slopes
            caution = max(0.2 * caution, 1e-12)
            if before - after < SMALLEST_DROP * before:
                break
        else:
            caution *= 5.0
            if caution > 1e8:
                break
    return np.exp(x[:, :2]), x[:, 2:]


def _bounded(omega: Array, x: Array) -> Array:
    """log a0, log a1, l (N, 2 + n) within what frequencies can tell."""
    x, logs = x.copy(), np.log(omega)
    low, high = logs.min() - np.log(WIDEST_BAND), logs.max() + np.log(WIDEST_BAND)
    x[:, 0] = np.clip(x[:, 0], 2.0 * low, 2.0 * high)
    spacing = NARROWEST_PEAK * float(np.median(np.diff(logs)))
    x[:, 1] = np.clip(x[:, 1], 0.5 * x[:, 0] + np.log(spacing), high + 2.0)
    return x


def _residual(omega: Array, K: Complex, x: Array) -> tuple[Array, Array]:
    """Errors (R,) of the real and imaginary parts of the entries, and their derivatives (R, ...)
    to x (N, 2 + n): log a0, log a1, l."""
    h, by_a0, by_a1 = _oscillators(np.exp(x[:, :2]), omega)
    columns, (count, size) = x[:, 2:], x[:, 2:].shape
    pairs = list(combinations_with_replacement(range(size), 2))
    errors = np.empty((len(pairs), len(omega)), dtype=complex)
    slopes = np.zeros((len(pairs), len(omega), count, 2 + size), dtype=complex)
    for p, (i, j) in enumerate(pairs):
        weight = 1.0 if i == j else np.sqrt(2.0)
        both = columns[:, i] * columns[:, j]
        errors[p] = weight * (h @ both - K[:, i, j])
        slopes[p, :, :, 0], slopes[p, :, :, 1] = weight * by_a0 * both, weight * by_a1 * both
        slopes[p, :, :, 2 + i] += weight * h * columns[:, j]
        slopes[p, :, :, 2 + j] += weight * h * columns[:, i]
    errors, slopes = errors.ravel(), slopes.reshape(errors.size, -1)
    return np.concatenate([errors.real, errors.imag]), np.concatenate([slopes.real, slopes.imag])
