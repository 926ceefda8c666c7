"""The numbers of validation.py that a panel code computed, computed again with Capytaine."""

from pathlib import Path

import make_scenes
import manifold3d
import numpy as np
from numpy.typing import NDArray

import coefficients
from benchmarks import validation
from memory_fit import fit_memory
from panel_code import Coefficients, Water, panels, solve
from resting import resting_bodies
from sim import Hull
from sim.hulls.solids import solid_of

Array = NDArray[np.float64]

BARGE = Path(make_scenes.__file__).resolve().parents[1] / "models" / "barge.xml"

PANELS = 1600
"""Number of panels on a hull, twice as many as usual."""

HEAVE_AND_PITCH = [2, 4]
"""Indices of these among the six motions."""


def print_all(wigley: Hull) -> None:
    """Print all numbers, given the Wigley hull with its waterline at z = 0."""
    with np.printoptions(precision=5, suppress=True):
        print_wigley(wigley)
        print_hemisphere()
        print_barge()


def print_wigley(hull: Hull) -> None:
    """The hull's responses in head waves, and added mass and damping in a wave of its length."""
    g, rho = validation.GRAVITY, validation.DENSITY
    length = float(np.ptp(hull.bounds[:, 0]))
    ratios = sorted(validation.WIGLEY_RESPONSES, reverse=True)
    wavenumbers = 2.0 * np.pi / (np.array(ratios) * length)
    water = Water(rho, g, np.inf)
    surface = panels(solid_of((hull.vertices, hull.faces)), PANELS)
    found = solve(
        *surface, validation.WIGLEY_CENTRE, water, water.frequencies(wavenumbers), np.array([np.pi])
    )
    own, plane = ratios.index(1.0), np.ix_([0, 2, 4], [0, 2, 4])
    for title, matrices in (
        ("added mass in surge, heave and pitch [kg, kg m, kg m^2]", found.added),
        ("damping [N s/m, N s, N m s]", found.damping),
    ):
        print(f"Wigley: {title}\n{0.5 * (matrices[own] + matrices[own].T)[plane]}")
    mass = np.diag([validation.WIGLEY_MASS, validation.WIGLEY_INERTIA[1]])
    moved = response(found, HEAVE_AND_PITCH, mass, validation.wigley_stiffness(hull))
    print("Wigley: wavelength over length, heave [m/m], pitch [rad/ka]")
    for ratio, k, (heave, pitch) in zip(ratios, wavenumbers, moved, strict=True):
        print(f"{ratio:g}  {heave:.3f}  {pitch / k:.3f}")


def response(found: Coefficients, motions: list[int], mass: Array, stiffness: Array) -> Array:
    """Amplitudes (F, D) per metre of a body that is free in D motions only, in the first heading.
    mass, stiffness: (D, D)."""
    plane = np.ix_(motions, motions)
    amplitudes = []
    for omega, added, damping, force in zip(
        found.frequencies,
        found.added,
        found.damping,
        (found.diffraction + found.incident)[:, 0, motions],
        strict=True,
    ):
        left = stiffness - omega**2 * (mass + added[plane]) - 1j * omega * damping[plane]
        amplitudes.append(np.abs(np.linalg.solve(left, force)))
    return np.array(amplitudes)


def print_hemisphere() -> None:
    """Added mass and damping of the heaving hemisphere of Hulme 1982, the memory that fits them,
    and its heave in waves of three diameters."""
    g, rho, radius = validation.GRAVITY, validation.DENSITY, 5.0
    ball = manifold3d.Manifold.sphere(radius, 64)
    volume = 4.0 / 3.0 * np.pi * radius**3
    ball = ball.scale([(volume / ball.volume()) ** (1.0 / 3.0)] * 3)
    mass, (vertices, faces) = 0.5 * rho * volume, panels(ball, PANELS // 2)
    water, three = Water(rho, g, np.inf), np.pi / 3.0  # k a in waves of three diameters
    table = np.array(validation.HULME)
    given = np.sort(np.append(np.geomspace(0.05, 8.0, 24), [*table[:, 0], three]))
    found = solve(
        vertices, faces, (0.0, 0.0, -2.0), water, water.frequencies(given / radius), np.array([0.0])
    )
    print("hemisphere: k a, added mass and damping over omega [displaced masses]: Hulme, ours")
    for ka, *published in table:
        f = int(np.argmin(np.abs(given - ka)))
        pair = found.added[f, 2, 2] / mass, found.damping[f, 2, 2] / mass / found.frequencies[f]
        print(f"{ka:g}  {published[0]:.4f} {pair[0]:.4f}  {published[1]:.4f} {pair[1]:.4f}")
    fit = fit_memory(found.frequencies, found.added, found.damping, found.added_inf, 2.0 * radius)
    print(f"A_inf {found.added_inf[2, 2] / mass:.4f}; worst error of the fit {fit.worst[0]:.1%}")
    rows = fit.memory[np.abs(fit.memory[:, 4]) > 0.0]
    rows = np.column_stack([rows[:, :2], rows[:, 4] ** 2 / mass])
    print(f"columns in heave: a0 [1/s^2], a1 [1/s], l^2 over mass\n{rows}")
    f = int(np.argmin(np.abs(given - three)))
    stiffness = np.array([[rho * g * np.pi * radius**2]])
    heave = response(found, [2], np.array([[mass]]), stiffness)[f, 0]
    force = found.diffraction[f, 0, 2] / stiffness[0, 0]
    print(f"in waves of three diameters: heave {heave:.3f} m/m, diffraction {force:.4f} rho g A")


def print_barge() -> None:
    """The barge over 3 m of water: Froude-Krylov forces, and its motions in waves of 8 s."""
    scene = coefficients.load(BARGE, settings={"water_depth": validation.SHALLOW})
    body = next(resting_bodies(scene, ("barge",)))
    sea = scene.buoyancy.sea
    water = Water(sea.density, sea.gravity, sea.depth)
    omega = [
        *water.frequencies(np.array(validation.SHALLOW_PHASES) / sea.depth),
        2.0 * np.pi / validation.BARGE_PERIOD,
    ]
    order = np.argsort(omega)
    found = solve(
        *panels(body.solid, PANELS // 2), (0.0, 0.0, body.height), water, np.array(omega)[order],
        np.array([0.0]),
    )  # fmt: skip
    print("barge over 3 m: period [s], Froude-Krylov in surge [N/m], heave [N/m], pitch [N m/m]")
    for w, force in zip(found.frequencies, np.abs(found.incident[:, 0, [0, 2, 4]]), strict=True):
        print(f"{2.0 * np.pi / w:.3f}  {force}")
    f = int(np.argmin(np.abs(found.frequencies - omega[-1])))
    K = found.damping + 1j * found.frequencies[:, None, None] * (found.added - found.added_inf)
    moved = np.abs(coefficients.responses(body.freedoms, found, found.added_inf, K))[f, 0]
    print(f"in waves of 8 s: surge {moved[0]:.4f} m/m, heave {moved[2]:.4f} m/m, "
          f"pitch {moved[4]:.4f} rad/m")  # fmt: skip
    plane = np.ix_([0, 2, 4], [0, 2, 4])
    for title, matrix in (("added mass", found.added[f]), ("damping", found.damping[f])):
        print(f"{title} in surge, heave and pitch\n{0.5 * (matrix + matrix.T)[plane]}")
