"""The numbers of validation.py that a panel code computed, computed again with Capytaine."""

from collections.abc import Sequence
from pathlib import Path

import make_scenes
import manifold3d
import numpy as np
from numpy.typing import NDArray

import coefficients
from benchmarks import validation, wide_bodies
from benchmarks.checks import DENSITY, GRAVITY
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
        print_float()
        print_flap()


def print_wigley(hull: Hull) -> None:
    """The hull's responses in head waves, and added mass and damping in a wave of its length."""
    g, rho = GRAVITY, DENSITY
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
    g, rho, radius = GRAVITY, DENSITY, 5.0
    ball = manifold3d.Manifold.sphere(radius, 64)
    volume = 4.0 / 3.0 * np.pi * radius**3
    ball = ball.scale([(volume / ball.volume()) ** (1.0 / 3.0)] * 3)
    mass, (vertices, faces) = 0.5 * rho * volume, panels(ball, PANELS // 2)
    water, three = Water(rho, g, np.inf), np.pi / 3.0  # k a in waves of three diameters
    table = np.array(wide_bodies.HULME)
    waves = 4.0 * np.pi**2 / np.array(list(wide_bodies.OES_WAVES)) ** 2 / g * radius
    given = np.sort([*np.geomspace(0.05, 8.0, 24), *table[:, 0], *waves, three])
    found = solve(
        vertices, faces, (0.0, 0.0, -2.0), water, water.frequencies(given / radius), np.array([0.0])
    )
    print("hemisphere: k a, added mass and damping over omega [displaced masses]: Hulme, ours")
    for ka, *published in table:
        f = int(np.argmin(np.abs(given - ka)))
        pair = found.added[f, 2, 2] / mass, found.damping[f, 2, 2] / mass / found.frequencies[f]
        print(f"{ka:g}  {published[0]:.4f} {pair[0]:.4f}  {published[1]:.4f} {pair[1]:.4f}")
    own = ~np.isin(given, waves)  # the pinned memory was fitted without these
    fit = fit_memory(
        found.frequencies[own], found.added[own], found.damping[own], found.added_inf, 2.0 * radius
    )
    print(f"A_inf {found.added_inf[2, 2] / mass:.4f}; worst error of the fit {fit.worst[0]:.1%}")
    rows = fit.memory[np.abs(fit.memory[:, 4]) > 0.0]
    rows = np.column_stack([rows[:, :2], rows[:, 4] ** 2 / mass])
    print(f"columns in heave: a0 [1/s^2], a1 [1/s], l^2 over mass\n{rows}")
    f = int(np.argmin(np.abs(given - three)))
    stiffness = np.array([[rho * g * np.pi * radius**2]])
    heave = response(found, [2], np.array([[mass]]), stiffness)[f, 0]
    force = found.diffraction[f, 0, 2] / stiffness[0, 0]
    print(f"in waves of three diameters: heave {heave:.3f} m/m, diffraction {force:.4f} rho g A")
    print("in waves of a period [s]: diffraction [rho g A]")
    for ka in waves:
        f = int(np.argmin(np.abs(given - ka)))
        force = found.diffraction[f, 0, 2] / stiffness[0, 0]
        print(f"{2.0 * np.pi / found.frequencies[f]:.1f}  {force:.4f}")


def print_barge() -> None:
    """The barge over 3 m of water: Froude-Krylov forces, and its motions in waves of 8 s."""
    scene = coefficients.load(BARGE, settings={"water_depth": wide_bodies.SHALLOW})
    body = next(resting_bodies(scene, ("barge",)))
    sea = scene.buoyancy.sea
    water = Water(sea.density, sea.gravity, sea.depth)
    omega = [
        *water.frequencies(np.array(wide_bodies.SHALLOW_PHASES) / sea.depth),
        2.0 * np.pi / wide_bodies.BARGE_PERIOD,
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


Columns = Sequence[Sequence[float]]


def print_float() -> None:
    """Added mass and damping in heave of the float of RM3, beside those of its memory. The spar
    below it is at rest."""
    profile = [(10.0, 0.0), (10.0, -2.0), (5.0, -3.0), (3.0, -3.0), (3.0, -28.9), (15.0, -28.9)]
    profile += [(15.0, -29.0), (0.3, -29.0)]
    counts, around = (4, 5, 2, 12, 6, 1, 6), 32
    radius, z = np.vstack([_along(profile, counts), profile[-1]]).T
    angles = 2.0 * np.pi * np.arange(around) / around
    radius = radius / np.sqrt(np.sinc(2.0 / around))  # the area of the circle
    turned = np.column_stack([np.cos(angles), np.sin(angles)])
    vertices = np.array(
        [np.column_stack([r * turned, np.full(around, h)]) for r, h in zip(radius, z, strict=True)]
    )
    panels_of_float = around * sum(counts[:3])
    motion = np.zeros((around * sum(counts), 3))
    motion[:panels_of_float, 2] = 1.0
    print("RM3's float: omega [rad/s], added mass [kg] and damping [N s/m]: ours, of the memory")
    frequencies = np.linspace(0.4, 1.8, 8)  # 2.3 rad/s is an irregular frequency
    _print_motion(
        _quads(vertices), motion, frequencies, np.inf,
        wide_bodies.FLOAT_ADDED_MASS_INF, wide_bodies.FLOAT_MEMORY,
    )  # fmt: skip


def print_flap() -> None:
    """Added mass and damping of the flap of OSWEC about its hinge, beside those of its memory. It
    stands on a base of its own breadth, 1.5 m high, that is at rest."""
    depth = wide_bodies.FLAP_DEPTH
    corners = ((0.9, -9.0), (0.9, 9.0), (-0.9, 9.0), (-0.9, -9.0), (0.9, -9.0))
    counts = (24, 2, 24, 2)
    ring, levels = _along(corners, counts), np.linspace(0.0, -depth, 17)
    vertices = np.array([np.column_stack([ring, np.full(len(ring), z)]) for z in levels])
    mesh = _quads(vertices)
    centres = mesh[0][mesh[1]].mean(axis=1)
    motion = np.stack([centres[:, 2] + 8.9, 0.0 * centres[:, 0], -centres[:, 0]], axis=1)
    motion[centres[:, 2] < -9.4] = 0.0
    print(
        "OSWEC's flap: omega [rad/s], added mass [kg m^2] and damping [N m s]: ours, of the memory"
    )
    _print_motion(
        mesh, motion, np.geomspace(0.15, 2.6, 12), depth, wide_bodies.FLAP_ADDED_MASS_INF,
        wide_bodies.FLAP_MEMORY,
    )  # fmt: skip


def _along(corners: Columns, counts: Sequence[int]) -> Array:
    """Points (N, 2) on a line through corners, with a number of equal parts between each two,
    without the end of the line."""
    parts = zip(corners[:-1], corners[1:], counts, strict=True)
    return np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in parts])


def _quads(rings: Array) -> tuple[Array, Array]:
    """Vertices (V, 3) and quadrangles (F, 4) between rings (R, N, 3) from the water downwards,
    seen from outside counterclockwise."""
    levels, around = rings.shape[:2]
    corners = np.arange(levels * around).reshape(levels, around)
    beside = np.roll(corners, -1, axis=1)
    faces = np.stack([corners[:-1], corners[1:], beside[1:], beside[:-1]], axis=-1)
    return rings.reshape(-1, 3), faces.reshape(-1, 4)


def _print_motion(
    mesh: tuple[Array, Array], motion: Array, frequencies: Array, depth: float, added_inf: float,
    memory: Columns,
) -> None:  # fmt: skip
    """One motion of a body, given by the velocity (F, 3) of its panels, in water of 1000 kg/m^3."""
    import capytaine

    surface = capytaine.Mesh(*mesh)
    body = capytaine.FloatingBody(mesh=surface, lid_mesh=surface.generate_lid())
    body.dofs["Motion"] = motion
    solver = capytaine.BEMSolver(method="direct")
    for omega in map(float, [*frequencies, np.inf]):
        found = solver.solve(
            capytaine.RadiationProblem(
                body=body, radiating_dof="Motion", omega=omega, rho=1000.0, g=GRAVITY,
                water_depth=depth,
            ),
            keep_details=False,
        )  # fmt: skip
        added, damping = found.added_masses["Motion"], found.radiation_dampings["Motion"]
        K = sum(c * 1j * omega / (a0 - omega**2 + 1j * a1 * omega) for a0, a1, c in memory)
        pair = (added_inf + K.imag / omega, K.real) if np.isfinite(omega) else (added_inf, 0.0)
        print(f"{omega:.3f}  {added:.4g} {pair[0]:.4g}  {damping:.4g} {pair[1]:.4g}")
