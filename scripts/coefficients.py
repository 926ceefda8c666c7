"""Compute the waves that a scene's wide bodies make and scatter, with a panel code, for the scene.

    python scripts/coefficients.py models/barge.xml --output barge.npz --figure barge.png
    python scripts/coefficients.py my.xml --file capytaine.nc       # solved elsewhere

Each body is cut at the waterline where it rests (on a hinge: where it starts) and solved for by
itself with Capytaine (pip install '.[bem]'), over frequencies and headings. Memory is fitted to
added mass and damping. The file is named after the scene and the body and lies beside the scene,
whose <custom> names it: <text name="hydrodynamics_BODY" data="FILE.npz"/>.

Exit status: 0 on success, 2 on unusable input, 4 if a file cannot be written.
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from command_line import (
    Parser,
    Progress,
    add_scene_options,
    at_least,
    check_drawable,
    check_outputs,
    failure,
    notes_said,
    print_table,
    run_script,
    say,
    scene_options,
    write_whole,
)
from memory_fit import FREEDOMS, Fit, checked, fit_memory, memory_force
from panel_code import (
    SHALLOWEST_PHASE,
    Coefficients,
    Water,
    check_installed,
    panels,
    read,
    solve,
)
from resting import Freedoms, Resting, resting_bodies
from sim import ModelError, Scene
from sim.mjcf.files import model_files
from sim.resistance.hydrodynamics import Hydrodynamics
from sim.scenes.spec import read_spec

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PREFIX = "hydrodynamics_"

PANELS = 800
"""Default number of panels on a body. Their errors are a few hundredths, and fall with the number;
the time grows with its square."""

FREQUENCIES, HEADINGS = 36, 24
"""Numbers of frequencies and of headings."""

LONGEST_WAVE, SHORTEST_WAVE = 0.05, 15.0
"""k times the body's length, and times the root of its length and breadth, at the lowest and at the
highest frequency."""

SHORTEST_PANELS = 4.0
"""Least length of a wave in panels: shorter waves need smaller panels."""

WATER_SHARE = 0.005
"""Largest relative difference of a file's density, gravity and depth from the scene's."""

DRIFTING = ("surge", "sway", "yaw")
"""Motions of a free body that nothing restores; their responses are not printed."""

NEGLIGIBLE_FORCE = 1e-6
"""Share of the largest force below which a motion is not driven, and not printed."""

SHOWN_RESPONSES = 8
"""Number of frequencies for which responses are printed."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("scene", type=Path, metavar="SCENE", help="an MJCF or URDF file")
    add_scene_options(parser)
    parser.add_argument("--body", metavar="NAME", help="only this body")
    parser.add_argument(
        "--file", type=Path, metavar="FILE.nc",
        help="a netCDF file of Capytaine for this body at rest, about its centre of mass",
    )  # fmt: skip
    parser.add_argument(
        "--panels", type=at_least(50, 20000), default=PANELS, metavar="N",
        help=f"about as many triangles on the body ({PANELS})",
    )  # fmt: skip
    parser.add_argument("--output", type=Path, metavar="FILE.npz", help="default: see above")
    parser.add_argument(
        "--figure", type=Path, metavar="FILE.png", help="draw added mass, damping and the fit"
    )
    return parser.parse_args(arguments)


def load(path: Path, **options: Any) -> Scene:
    """The scene of a file without the coefficients that it may name already. options: of
    `Scene.load`. Raises ValueError, OSError."""
    spec = read_spec(path)
    for text in [text for text in spec.texts if text.name.startswith(PREFIX)]:
        spec.delete(text)
    try:
        return Scene.load(spec, name=path.stem, **options)
    except ModelError as error:
        raise error.located(str(path)) from None


def chosen(scene: Scene, options: argparse.Namespace) -> dict[str, Path]:
    """The file of each body that is asked for. Raises ValueError for an unknown body, or for one
    output of several bodies."""
    names = list(dict.fromkeys(scene.buoyancy.body_names))
    if options.body is not None and options.body not in names:
        raise ValueError(f"no body '{options.body}' floats; the scene has {', '.join(names)}")
    wanted = [options.body] if options.body is not None else names
    if len(wanted) > 1:
        for option in ("output", "file", "figure"):
            if getattr(options, option) is not None:
                raise ValueError(f"--{option} is for one body; add --body NAME: {', '.join(names)}")
        say("note: each body is solved for by itself: waves between the bodies are not modelled")
    files = {name: options.output or default_output(options.scene, name) for name in wanted}
    for path in files.values():
        if options.output is None and path.exists():
            raise ValueError(f"{path} exists; to replace it, give --output {path}")
    return files


def default_output(scene: Path, body: str) -> Path:
    """The file of a body's coefficients beside its scene."""
    word = "".join(c if c.isalnum() or c in "-_" else "_" for c in body)
    return scene.with_name(f"{scene.stem}_{word}.npz")


def frequencies_for(vertices: Array, faces: NDArray[np.int64], water: Water) -> Array:
    """Frequencies (F,) [rad/s] at which a body of these panels is solved."""
    length, breadth = sorted(np.ptp(vertices[:, :2], axis=0).tolist(), reverse=True)
    corners = vertices[faces]
    edge = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    lowest = LONGEST_WAVE / length
    if np.isfinite(water.depth):
        lowest = max(lowest, SHALLOWEST_PHASE / water.depth)
    highest = SHORTEST_WAVE / np.sqrt(length * max(breadth, 0.1 * length))
    highest = max(min(highest, 2.0 * np.pi / (SHORTEST_PANELS * edge)), 4.0 * lowest)
    return water.frequencies(np.geomspace(lowest, highest, FREQUENCIES))


def solved(body: Resting, water: Water, count: int) -> Coefficients:
    """Ask the panel code about a body."""
    vertices, faces = panels(body.solid, count)
    draught = -float(vertices[:, 2].min())
    if draught >= water.depth:
        raise ValueError(
            f"body '{body.name}' reaches {draught:.4g} m down where it rests and the water is "
            f"{water.depth:g} m deep; a panel code needs water below it"
        )
    frequencies = frequencies_for(vertices, faces, water)
    headings = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    print(f"{body.name}: {len(faces)} panels, {FREQUENCIES} frequencies, {HEADINGS} headings")
    with Progress(FREQUENCIES + 1.0, "frequencies") as bar:
        return solve(
            vertices, faces, (0.0, 0.0, body.height), water, frequencies, headings, bar.update
        )


def check_water(found: Water, expected: Water, path: Path) -> None:
    """Raise ValueError if a file's water is not the scene's."""
    for name, unit in (("density", "kg/m^3"), ("gravity", "m/s^2"), ("depth", "m")):
        ours, theirs = getattr(expected, name), getattr(found, name)
        if not math.isclose(theirs, ours, rel_tol=WATER_SHARE):
            raise ValueError(
                f"{path} is for water with a {name} of {theirs:g} {unit}, the scene has {ours:g} "
                f"{unit}; solve for the scene's, or change the scene's field"
            )


def hydrodynamics(body: Resting, found: Coefficients, fit: Fit, added_inf: Array) -> Hydrodynamics:
    return Hydrodynamics(
        position=body.position,
        rotation=body.rotation,
        added_mass=added_inf,
        memory=fit.memory,
        frequencies=found.frequencies,
        headings=found.headings,
        diffraction=found.diffraction,
        density=found.water.density,
        gravity=found.water.gravity,
        depth=found.water.depth,
    )


# What is printed


def print_fit(name: str, found: Coefficients, fit: Fit) -> None:
    """Print how well the fit does."""
    error, entry = fit.worst
    low, high = 2.0 * np.pi / found.frequencies[[-1, 0]]
    print(
        f"{name}: memory of {len(fit.memory)} columns, 2 states each; periods of {low:.3g} to "
        f"{high:.3g} s"
    )
    print(f"worst error of the fit: {error:.1%} of the largest value, in {entry}")
    rows = [
        (FREEDOMS[i], *(f"{100.0 * e:.1f}" if e > 0.0 else "-" for e in fit.errors[i]))
        for i in range(6)
    ]
    print_table(("error [%]", *FREEDOMS), rows)


def responses(freedoms: Freedoms, found: Coefficients, added_inf: Array, K: Complex) -> Complex:
    """Motions (F, B, D) per metre of amplitude, with the water's resistance K (F, 6, 6): see
    `memory_fit`."""
    S, omega = freedoms.motions, found.frequencies[:, None, None]
    mass = freedoms.mass + S.T @ added_inf @ S
    damping = freedoms.damping + S.T @ K.conj() @ S  # panel codes write e^(-i omega t)
    left = freedoms.stiffness - omega**2 * mass - 1j * omega * damping
    force = (found.diffraction + found.incident) @ S
    return np.linalg.solve(left, force.swapaxes(1, 2)).swapaxes(1, 2)


def print_responses(
    freedoms: Freedoms | None, found: Coefficients, fit: Fit, added_inf: Array
) -> None:
    """Print the motions in waves by the fit beside those by the panel code's own numbers."""
    if freedoms is None or np.isnan(found.incident).any():
        return
    omega = found.frequencies[:, None, None]
    own = found.damping + 1j * omega * (found.added - added_inf)
    fitted = memory_force(fit.memory, found.frequencies)
    pair = [np.abs(responses(freedoms, found, added_inf, K)) for K in (fitted, own)]
    force = np.abs((found.diffraction + found.incident) @ freedoms.motions).max(axis=0)
    count = len(found.frequencies)
    shown = np.unique(np.linspace(0.3 * count, count - 1, SHOWN_RESPONSES).astype(int))[::-1]
    titles, ways = ["period [s]"], []
    columns = [[f"{2.0 * np.pi / found.frequencies[f]:.3g}" for f in shown]]
    for d, title in enumerate(freedoms.titles):
        is_driven = force[:, d].max() > NEGLIGIBLE_FORCE * force.max()
        if not is_driven or (len(freedoms.titles) == 6 and title in DRIFTING):
            continue
        h = int(np.argmax(force[:, d]))
        unit = "rad/m" if freedoms.motions[3:, d].any() else "m/m"
        titles += [f"{title} [{unit}]", "panel code"]
        columns += [[f"{r[f, h, d]:.3g}" for f in shown] for r in pair]
        by_fit, by_code = (r[:, h, d] for r in pair)
        apart = np.abs(by_fit - by_code).max() / by_code.max()
        ways.append(f"{title} {np.degrees(found.headings[h]):.0f} deg, {apart:.1%}")
    if ways:
        print("motion per metre of amplitude, by the fit and by the panel code; heading of the")
        print(f"waves, and largest difference over largest motion: {'; '.join(ways)}")
        print_table(titles, list(zip(*columns, strict=True)))


def draw(name: str, found: Coefficients, fit: Fit, added_inf: Array, path: Path) -> None:
    """Draw added mass and damping of each motion, and the fit's."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    omega = found.frequencies
    fine = np.geomspace(omega[0], omega[-1], 400)
    K = memory_force(fit.memory, fine)
    figure, axes = pyplot.subplots(2, 6, figsize=(18.0, 6.0), layout="constrained")
    for i, title in enumerate(FREEDOMS):
        units = ("kg", "N s/m") if i < 3 else ("kg m$^2$", "N m s")
        added = added_inf[i, i] + K[:, i, i].imag / fine
        pairs = ((found.added[:, i, i], added), (found.damping[:, i, i], K[:, i, i].real))
        for ax, what, unit, (dots, curve) in zip(
            axes[:, i], ("added mass", "damping"), units, pairs, strict=True
        ):
            ax.plot(omega, dots, ".", color="black", label="panel code")
            ax.plot(fine, curve, color="#1f5a8a", label="fit")
            ax.set(xscale="log", title=title, xlabel="frequency [rad/s]", ylabel=f"{what} [{unit}]")
            ax.xaxis.set_minor_formatter("")
            ax.grid(alpha=0.3)
        axes[0, i].axhline(added_inf[i, i], color="#888888", lw=0.8, ls=":", label="$A_\\infty$")
    axes[0, 0].legend(fontsize="small")
    figure.suptitle(name)
    figure.savefig(path, dpi=110, format="png")
    pyplot.close(figure)


def work(body: Resting, path: Path, options: argparse.Namespace, water: Water) -> None:
    """Find, fit, write and report one body's coefficients. Raises ValueError, OSError."""
    if options.file is None:
        found = solved(body, water, options.panels)
    else:
        found = read(options.file)
        check_water(found.water, water, options.file)
    bounds = np.reshape(body.solid.bounding_box(), (2, 3))
    length = float(np.ptp(bounds[:, :2], axis=0).max())
    added, damping, added_inf = checked(found.added, found.damping, found.added_inf, length)
    found = replace(found, added=added, damping=damping)
    fit = fit_memory(found.frequencies, added, damping, added_inf, length)
    whole = hydrodynamics(body, found, fit, added_inf)
    write_whole(path, whole.save)
    print_fit(body.name, found, fit)
    print_responses(body.freedoms, found, fit, added_inf)
    print(f'{path}; in the scene: <text name="{PREFIX}{body.name}" data="{path.name}"/>')
    if options.figure is not None:
        write_whole(options.figure, lambda beside: draw(body.name, found, fit, added_inf, beside))


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        check_drawable(options.figure)
        check_installed(
            *(("capytaine",) if options.file is None else ("xarray", "h5netcdf", "h5py"))
        )
        inputs = [*model_files(options.scene), *filter(None, [options.file])]
        inputs = [path for path in inputs if path.suffix != ".npz"]  # coefficients may be replaced
        with notes_said():
            scene = load(options.scene, settings=options.settings, **scene_options(options))
        files = chosen(scene, options)
        check_outputs([*files.values(), options.figure], inputs)
        sea = scene.buoyancy.sea
        water = Water(sea.density, sea.gravity, sea.depth)
        for body in resting_bodies(scene, files):
            work(body, files[body.name], options, water)
    except (ValueError, OSError) as error:
        return failure(error)
    return 0


if __name__ == "__main__":
    run_script(main)
