"""Panel code: linear potential theory of a body at rest, by Capytaine (extra `bem`).

Capytaine solves for the waves that a body makes in six motions and for those that it scatters. It
is asked here, or was asked before: `read` reads the netCDF files that it writes.

Source: Ancellin and Dias 2019, Capytaine: a Python-based linear potential flow solver.
"""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.water.wave import shortening

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

MOTIONS = ("Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw")
"""Capytaine's names of the six motions, in the order of the matrices."""

SHALLOWEST_PHASE = 0.15
"""Wavenumber times depth below which Capytaine 3.0 finds no Green's function."""

TOLERANCES = (1e-4, 0.01, 0.03, 0.1, 0.3)
"""Distances between panels and hull, in edges of panels, of which the least that gives about as
many panels as wanted is taken."""

COUNT_RATIO = 1.6
"""Ratio of the numbers of panels found and wanted that is good enough. Time is cheaper than a
coarser hull, which may err by several hundredths."""


@dataclass(frozen=True, eq=False)
class Water:
    """The water around the body: density [kg/m^3], gravity [m/s^2], depth [m], inf if deep."""

    density: float
    gravity: float
    depth: float

    def wavenumbers(self, frequencies: Array) -> Array:
        """k (F,) [rad/m] of frequencies (F,) [rad/s], from omega^2 = g k tanh(k H)."""
        deep = np.asarray(frequencies, dtype=float) ** 2 / self.gravity
        return deep / shortening(deep, self.depth)

    def frequencies(self, wavenumbers: Array) -> Array:
        """omega (F,) [rad/s] of wavenumbers (F,) [rad/m]."""
        k = np.asarray(wavenumbers, dtype=float)
        return np.sqrt(self.gravity * k * np.tanh(k * self.depth))


@dataclass(frozen=True, eq=False)
class Coefficients:
    """What a panel code found for one body.

    frequencies (F,) [rad/s], ascending. added, damping (F, 6, 6), added_inf (6, 6): in the order of
    MOTIONS, along the axes and about the point in which the body's centre of mass lies, z up.
    headings (B,) [rad], ascending. diffraction, incident (F, B, 6): force and torque per metre of
    amplitude [N/m, N], of the scattered waves and of the undisturbed ones (Froude-Krylov): an
    elevation Re(a e^(-i omega t)) at this point gives the wrench Re(a X e^(-i omega t)).
    """

    frequencies: Array
    added: Array
    damping: Array
    added_inf: Array
    headings: Array
    diffraction: Complex
    incident: Complex
    water: Water


def check_installed(*modules: str) -> None:
    """Raise ValueError if a module of the extra `bem` is not installed."""
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ValueError(f"{missing[0]} is not installed; run: pip install '.[bem]'")


def panels(solid: Any, count: int) -> tuple[Array, Indices]:
    """About `count` triangles on the wetted surface of a manifold3d solid, z up, with the still
    water at z = 0: vertices (V, 3) [m] and faces (F, 3). The surface is open at the waterline.

    A hull with more triangles is simplified, one with fewer is divided. Both keep the volume.
    Raises ValueError if nothing is under water.
    """
    wet = solid.trim_by_plane((0.0, 0.0, -1.0), 0.0)
    if wet.is_empty() or not wet.volume() > 0.0:
        raise ValueError("no part of the body is under water where it rests")
    edge = float(np.sqrt(4.0 / np.sqrt(3.0) * _open_area(wet) / count))
    best, closest = None, np.inf
    for tolerance in TOLERANCES:
        smooth = _as_large(wet.simplify(tolerance * edge), wet)
        for share in np.geomspace(0.6, 2.0, 12):
            mesh = _open(smooth.refine_to_length(share * edge))
            ratio = abs(np.log(max(len(mesh[1]), 1) / count))
            if ratio < closest:
                best, closest = mesh, ratio
        if closest < np.log(COUNT_RATIO):
            break
    vertices, faces = best
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def _as_large(solid: Any, wanted: Any) -> Any:
    """A solid widened along x and y to the volume of another."""
    widening = float(np.sqrt(wanted.volume() / solid.volume()))
    low, high = np.reshape(wanted.bounding_box(), (2, 3))
    middle = 0.5 * (low + high) * [1.0, 1.0, 0.0]
    return solid.translate(-middle).scale((widening, widening, 1.0)).translate(middle)


def _open(solid: Any) -> tuple[Array, Indices]:
    """The surface of a solid without its faces in the water's surface."""
    mesh = solid.to_mesh64()
    vertices = np.array(mesh.vert_properties)[:, :3]
    faces = np.array(mesh.tri_verts, dtype=np.int64)
    top = 1e-9 * np.abs(vertices).max()
    return vertices, faces[(vertices[faces][:, :, 2] < -top).any(axis=1)]


def _open_area(solid: Any) -> float:
    """Area [m^2] of this surface."""
    vertices, faces = _open(solid)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def solve(
    vertices: Array, faces: Indices, centre: Sequence[float], water: Water, frequencies: Array,
    headings: Array, advance: Callable[[], object] = lambda: None,
) -> Coefficients:  # fmt: skip
    """Ask Capytaine. vertices (V, 3) [m], faces (F, 3): the wetted surface, z = 0 in the still
    water. centre (3,) [m]: the centre of mass, about which the body turns. A lid on the water
    inside the hull keeps irregular frequencies away. The potential is solved for directly, which
    halves the error of the added mass against sources. advance: is called after each frequency, of
    which the infinite one is one more."""
    import capytaine
    from capytaine.green_functions.abstract_green_function import GreenFunctionEvaluationError

    capytaine.set_logging("ERROR")
    body, solver = _body(vertices, faces, centre), capytaine.BEMSolver(method="direct")
    setting = dict(water_depth=water.depth, rho=water.density, g=water.gravity)
    count = len(frequencies)
    added, damping = np.zeros((2, count + 1, 6, 6))
    scattered, incident = np.zeros((2, count, len(headings), 6), dtype=complex)
    for f, omega in enumerate((*map(float, frequencies), np.inf)):
        try:
            added[f], damping[f] = _radiated(solver, body, omega, setting)
            if f < count:
                scattered[f], incident[f] = _scattered(solver, body, omega, headings, setting)
        except GreenFunctionEvaluationError as error:
            raise ValueError(f"Capytaine cannot solve for {omega:.4g} rad/s: {error}") from None
        advance()
    phases = _phases(water, frequencies, headings, np.asarray(centre))[:, :, None]
    return Coefficients(
        np.asarray(frequencies), added[:-1], damping[:-1], added[-1], np.asarray(headings),
        scattered * phases, incident * phases, water,
    )  # fmt: skip


def _radiated(solver: Any, body: Any, omega: float, setting: dict[str, float]) -> Array:
    """Added mass and damping (2, 6, 6) at a frequency [rad/s], inf for the infinite one."""
    import capytaine

    matrices = np.empty((2, 6, 6))
    for i, motion in enumerate(MOTIONS):
        problem = capytaine.RadiationProblem(
            body=body, radiating_dof=motion, omega=omega, **setting
        )
        found = solver.solve(problem, keep_details=False)
        matrices[0, :, i] = [found.added_masses[m] for m in MOTIONS]
        matrices[1, :, i] = [found.radiation_dampings[m] for m in MOTIONS]
    return matrices


def _scattered(
    solver: Any, body: Any, omega: float, headings: Array, setting: dict[str, float]
) -> Complex:
    """Forces (2, B, 6) of the scattered waves and of the undisturbed ones, for elevations at
    x = y = 0."""
    import capytaine

    forces = np.empty((2, len(headings), 6), dtype=complex)
    for h, heading in enumerate(headings):
        problem = capytaine.DiffractionProblem(
            body=body, wave_direction=float(heading), omega=omega, **setting
        )
        found = solver.solve(problem, keep_details=False).forces
        own = capytaine.bem.airy_waves.froude_krylov_force(problem)
        forces[:, h] = [found[m] for m in MOTIONS], [own[m] for m in MOTIONS]
    return forces


def _body(vertices: Array, faces: Indices, centre: Sequence[float]) -> Any:
    """Capytaine's body."""
    import capytaine

    mesh = capytaine.Mesh(vertices, np.hstack([faces, faces[:, 2:]]))  # it wants four corners
    is_closed = vertices[:, 2].max() < -1e-9 * np.abs(vertices).max()
    lid = None if is_closed else mesh.generate_lid()
    body = capytaine.FloatingBody(mesh=mesh, lid_mesh=lid, center_of_mass=tuple(centre))
    body.add_all_rigid_body_dofs()
    return body


def _phases(water: Water, frequencies: Array, headings: Array, centre: Array) -> Complex:
    """Factors (F, B) on forces per elevation at x = y = 0 for the elevation at a centre."""
    k = water.wavenumbers(np.asarray(frequencies))
    ahead = centre[0] * np.cos(headings) + centre[1] * np.sin(headings)
    return np.exp(-1j * k[:, None] * ahead)


def read(path: Path) -> Coefficients:
    """The coefficients in a netCDF file that Capytaine wrote, of one body. Raises ValueError for a
    file that cannot be read or that lacks a quantity, FileNotFoundError for no file."""
    import xarray

    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        with xarray.open_dataset(path) as dataset:
            return from_dataset(dataset.load())
    except (ValueError, OSError, KeyError) as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())}") from None


def from_dataset(dataset: Any) -> Coefficients:
    """The coefficients in an xarray dataset of Capytaine. Raises ValueError if a quantity is
    missing, if there are several bodies, or if there is more than one sort of water."""
    for name in ("added_mass", "radiation_damping", "diffraction_force"):
        if name not in dataset:
            raise ValueError(f"it has no {name}; expected a dataset of Capytaine with it")
    motions = [str(name) for name in dataset["influenced_dof"].values]
    if sorted(motions) != sorted(MOTIONS):
        raise ValueError(
            f"it has the motions {', '.join(motions)}; expected {', '.join(MOTIONS)} of one body"
        )
    omega = np.atleast_1d(dataset["omega"].values).astype(float)
    if not np.isinf(omega).any():
        raise ValueError(
            "it has no added mass at infinite frequency; add omega = inf to Capytaine's problems"
        )
    order = np.argsort(omega)
    order = order[(omega[order] > 0.0) & np.isfinite(omega[order])]
    added, damping = (
        _ordered(dataset[name], ("omega", "influenced_dof", "radiating_dof"))
        for name in ("added_mass", "radiation_damping")
    )
    headings = np.atleast_1d(dataset["wave_direction"].values).astype(float)
    by_heading = np.argsort(headings)
    forces = [
        _force(dataset, name)[np.ix_(order, by_heading)]
        for name in ("diffraction_force", "Froude_Krylov_force")
    ]
    water = Water(*(_single(dataset, name) for name in ("rho", "g", "water_depth")))
    centre = np.zeros(3)
    if "rotation_center" in dataset.variables:
        centre = np.ravel(dataset["rotation_center"].values).astype(float)[:3]
    frequencies, headings = omega[order], headings[by_heading]
    phases = _phases(water, frequencies, headings, centre)[:, :, None]
    return Coefficients(
        frequencies, added[order], damping[order], added[np.argmax(omega)], headings,
        forces[0] * phases, forces[1] * phases, water,
    )  # fmt: skip


def _force(dataset: Any, name: str) -> Complex:
    """A force (F, B, 6) at all frequencies and headings; NaN if the dataset has none. netCDF files
    hold real and imaginary parts in two layers."""
    dimensions = ("omega", "wave_direction", "influenced_dof")
    if name not in dataset:
        return np.full([*(np.size(dataset[d]) for d in dimensions[:2]), 6], np.nan, dtype=complex)
    force = dataset[name]
    if "complex" in force.dims:
        force = force.sel(complex="re", drop=True) + 1j * force.sel(complex="im", drop=True)
    return _ordered(force, dimensions)


def _ordered(quantity: Any, dimensions: tuple[str, ...]) -> NDArray[Any]:
    """The values of a quantity with these dimensions, its motions in the order of MOTIONS."""
    for name in dimensions:
        if name not in quantity.dims:
            quantity = quantity.expand_dims(name)
    others = [name for name in quantity.dims if name not in dimensions]
    if any(quantity.sizes[name] != 1 for name in others):
        raise ValueError(f"{quantity.name} depends on {', '.join(others)} too; select one of each")
    quantity = quantity.isel(dict.fromkeys(others, 0)).transpose(*dimensions)
    for name in dimensions:
        if name.endswith("_dof"):
            quantity = quantity.sel({name: list(MOTIONS)})
    return quantity.values


def _single(dataset: Any, name: str) -> float:
    """The only value of a quantity."""
    if name not in dataset.variables:
        raise ValueError(f"it has no {name}; expected a dataset of Capytaine with it")
    values = np.unique(np.ravel(dataset[name].values).astype(float))
    if len(values) != 1:
        raise ValueError(f"it has {len(values)} values of {name}; select one")
    return float(values[0])
