"""Draw heave, tilt and force of runs over time, differences, spectra and transfer functions.

    python scripts/run.py my.xml --duration 300 --series my.parquet
    python scripts/plot.py my.parquet --output my.png
    python scripts/plot.py before.rrd after.rrd             # over one another, and the difference
    python scripts/plot.py my.parquet --over measured.csv   # the same with your own measurement

An input is a series or a recording of run.py. A measurement is a CSV file with the column time and
columns named like those of a series, for example heave or heel_deg; with several bodies
heave/BODY. The script needs the extra 'report'.

Exit status: 0 on success, 2 on unusable input, 4 when the picture cannot be written.
"""

import argparse
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from command_line import Parser, check_drawable, check_outputs, failure, run_script, write_whole
from sim.runs.statistics import spectra
from sim.runs.tables import read_columns
from sim.water.records import read_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Numbers = NDArray[np.float64]
Columns = dict[str, Numbers]

MOST_BODIES = 6
"""Largest number of bodies that are drawn; the first ones are drawn."""

FEWEST_SAMPLES = 128
"""Least number of samples for which spectra are drawn."""

LOWEST_DENSITY_SHARE = 0.02
"""Share of the largest spectral density of the elevation. At frequencies with a lower density, the
transfer function would be noise over noise and is not drawn."""

LABELS = {
    "heave": "heave [m]", "tilt_deg": "tilt [deg]", "fz": "buoyancy [N]",
    "weights": "buoyancy [weights]", "heel_deg": "heel, starboard down [deg]",
    "trim_deg": "trim, bow down [deg]", "water_height": "water [m]",
    "submerged_fraction": "submerged fraction", "x": "x [m]", "y": "y [m]", "z": "z [m]",
}  # fmt: skip
"""The quantities that can be drawn, with their labels."""

USUAL = ("heave", "tilt_deg", "fz", "weights")
"""The quantities that are drawn in any case. The others are drawn if they were measured."""

RECORDED = {
    "heave": "heave/{}", "water_height": "height/{}/water", "tilt_deg": "tilt/{}",
    "heel_deg": "heel/{}", "trim_deg": "trim/{}", "submerged_fraction": "submerged/{}",
    "weights": "force/{}",
}  # fmt: skip
"""The series of a recording, by quantity."""

STYLES, MEASURED = ("-", "--", ":", "-."), "."
"""Line styles of runs, and the style of a measurement."""


class Curve(NamedTuple):
    """What is drawn for a body of a file: its label, its line, and its columns, with time [s]."""

    body: str
    label: str
    colour: str
    style: str
    columns: Columns


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE",
                        help="series or .rrd from run.py")  # fmt: skip
    parser.add_argument("--over", type=Path, metavar="FILE.csv",
                        help="a measurement to compare with: time, heave, ...")  # fmt: skip
    parser.add_argument("--output", type=Path, metavar="FILE.png",
                        help="default: beside the first file, as .png")  # fmt: skip
    options = parser.parse_args(arguments)
    options.output = options.output or options.files[0].with_suffix(".png")
    return options


def read_bodies(path: Path) -> dict[str, Columns]:
    """The columns time and those of LABELS, by body.

    Raises ValueError or OSError if the file cannot be read or has other columns.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if path.suffix == ".rrd":
        return _of_recording(path)
    columns = read_columns(path)
    wanted = ("time", "heave", "water_height", "tilt_deg", "fz")
    if "body" not in columns or any(name not in columns for name in wanted):
        raise ValueError(f"{path} is not a series of run.py; expected body, {', '.join(wanted)}")
    names = list(dict.fromkeys(columns["body"].tolist()))
    kept = [name for name in ("time", *LABELS) if name in columns]
    return {n: {k: columns[k][columns["body"] == n] for k in kept} for n in names}


def _of_recording(path: Path) -> dict[str, Columns]:
    from sim import read_series

    series = read_series(path)
    all_names = (name.removeprefix("height/") for name in series if name.startswith("height/"))
    names = [name for name in all_names if f"heave/{name}/water" in series]
    if not names:
        raise ValueError(f"{path} has no series of bodies; expected a recording of run.py")
    return {
        name: {"time": series[f"heave/{name}"][0]}
        | {
            quantity: series[entity.format(name)][1]
            for quantity, entity in RECORDED.items()
            if entity.format(name) in series
        }
        for name in names
    }


def read_runs(paths: Sequence[Path]) -> dict[str, dict[str, Columns]]:
    """The bodies of each file, by the name of the file. Raises ValueError or OSError."""
    stems = {path.stem for path in paths}
    runs = {p.stem if len(stems) == len(paths) else str(p): read_bodies(p) for p in paths}
    if not set.intersection(*(set(bodies) for bodies in runs.values())):
        lists = "; ".join(f"{name} has {', '.join(bodies)}" for name, bodies in runs.items())
        raise ValueError(f"the files have no body in common: {lists}")
    return runs


def read_measured(path: Path, runs: dict[str, dict[str, Columns]]) -> dict[str, Columns]:
    """The columns of a measurement, by body. Raises ValueError or OSError."""
    bodies = list(next(iter(runs.values())))
    names = {f"{quantity}/{body}": (quantity, body) for quantity in LABELS for body in bodies}
    if len(bodies) == 1:
        names = {quantity: (quantity, bodies[0]) for quantity in LABELS}
    places = {name.lower(): place for name, place in names.items()}
    table = read_table(path, ("time", *places))
    times = table.pop("time", None)
    if times is None or not table or not (np.diff(times) > 0.0).all():
        raise ValueError(
            f"{path}: expected a column time that rises, and a column such as {next(iter(names))}"
        )
    measured: dict[str, Columns] = {}
    for name, values in table.items():
        quantity, body = places[name]
        if not all(quantity in run[body] for run in runs.values() if body in run):
            raise ValueError(f"{path} has the column {name}, which not all runs have; remove it")
        measured.setdefault(body, {"time": times})[quantity] = values
    return measured


def curves_of(runs: dict[str, dict[str, Columns]]) -> list[Curve]:
    """The curves of runs, by the name of the run: the first bodies of each. A body has a colour,
    and a run a line style; with one body, a run has a colour."""
    bodies = list(dict.fromkeys(body for run in runs.values() for body in run))[:MOST_BODIES]
    curves = []
    for (i, (name, run)), (j, body) in product(enumerate(runs.items()), enumerate(bodies)):
        if body in run:
            words = [name] * (len(runs) > 1) + [body] * (len(bodies) > 1 or len(runs) == 1)
            colour, style = (j, STYLES[i % len(STYLES)]) if len(bodies) > 1 else (i, "-")
            curves.append(Curve(body, ", ".join(words), f"C{colour}", style, run[body]))
    return curves


def differences_of(curves: Sequence[Curve], quantity: str) -> Iterator[Curve]:
    """Each curve minus the reference of its body: the last curve if it was measured, or else the
    first. Raises ValueError for curves with no time in common."""
    for body in dict.fromkeys(curve.body for curve in curves):
        first, *others = (curve for curve in curves if curve.body == body)
        if others and others[-1].style == MEASURED:
            first, others = others[-1], [first, *others[:-1]]
        for other in others:
            times, before, after = at_common_times(first, other, quantity)
            rms = float(np.sqrt(np.mean((after - before) ** 2)))
            yield other._replace(
                label=f"{other.label} minus {first.label}: rms {rms:.3g}",
                columns={"time": times, quantity: after - before},
            )


def at_common_times(first: Curve, other: Curve, quantity: str) -> tuple[Numbers, Numbers, Numbers]:
    """Times [s] in the interval that two curves have in common, and the quantity of both there. The
    times are those of the curve with fewer samples; the other one is interpolated linearly."""
    pair = [(curve.columns["time"], curve.columns[quantity]) for curve in (first, other)]
    begin, end = max(t[0] for t, _ in pair), min(t[-1] for t, _ in pair)
    times = min((t[(t >= begin) & (t <= end)] for t, _ in pair), key=len)
    if len(times) == 0:
        spans = [f"{t[0]:g} to {t[-1]:g} s" for t, _ in pair]
        raise ValueError(
            f"'{first.label}' lasts from {spans[0]} and '{other.label}' from {spans[1]}; their "
            "difference needs common times"
        )
    return times, *(np.interp(times, t, values) for t, values in pair)


def panels_of(curves: Sequence[Curve], measured: Sequence[Curve]) -> list[str]:
    """The quantities that are drawn: the usual ones and those that were measured."""
    asked = {quantity for curve in measured for quantity in curve.columns}
    return [
        quantity
        for quantity in LABELS
        if quantity in (*USUAL, *asked) and all(quantity in curve.columns for curve in curves)
    ]


def draw(runs: dict[str, dict[str, Columns]], measured: dict[str, Columns], path: Path) -> None:
    """Draw all panels into a PNG file."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    curves = curves_of(runs)
    points = [Curve(body, "measured", "black", MEASURED, c) for body, c in measured.items()]
    panels = []
    for quantity in panels_of(curves, points):
        shown = [curve for curve in (*curves, *points) if quantity in curve.columns]
        differences = list(differences_of(shown, quantity))
        panels.append((quantity, LABELS[quantity], shown))
        if differences:
            panels.append((quantity, f"difference of\n{LABELS[quantity]}", differences))
    long = [curve for curve in curves if len(curve.columns["time"]) >= FEWEST_SAMPLES]
    count = len(panels) + (2 if long else 0)
    figure, axes = plt.subplots(count, 1, figsize=(9.0, 2.4 * count), layout="constrained")
    for ax, (quantity, label, shown) in zip(axes, panels, strict=False):
        for curve in shown:
            values = curve.columns["time"], curve.columns[quantity]
            ax.plot(*values, curve.style, ms=3.0, lw=1.0, color=curve.colour, label=curve.label)
        ax.set(xlabel="time [s]", ylabel=label)
        ax.grid(alpha=0.3)
        if ax is axes[0] or label != LABELS[quantity]:
            ax.legend(fontsize="small")
    axes[0].set_title(" and ".join([*runs, *(["a measurement"] if points else [])]))
    if long:
        draw_spectra(axes[-2], axes[-1], long)
    figure.savefig(path, dpi=120, format="png")
    plt.close(figure)


def draw_spectra(above: "Axes", below: "Axes", curves: Sequence[Curve]) -> None:
    """Draw spectra of elevation and heave, and below them the ratio of heave to elevation."""
    highest = 0.0
    for curve in curves:
        label, columns, colour = curve.label, curve.columns, curve.colour
        frequencies, (water, heave) = spectra(
            columns["time"], columns["water_height"], columns["heave"]
        )
        is_strong = (water > LOWEST_DENSITY_SHARE * water.max()) & (frequencies > 0.0)
        above.plot(frequencies, water, "--", color=colour, lw=0.7, label=f"{label}: water")
        above.plot(frequencies, heave, curve.style, color=colour, lw=1.0, label=f"{label}: heave")
        ratio = np.sqrt(heave[is_strong] / np.maximum(water[is_strong], 1e-300))
        below.plot(
            frequencies[is_strong], ratio, curve.style, marker=".", color=colour, lw=1.0,
            label=label,
        )  # fmt: skip
        both = (water + heave).cumsum()
        highest = max(highest, float(frequencies[np.searchsorted(both, 0.999 * both[-1])]))
    for ax, label in ((above, "density [m$^2$/Hz]"), (below, "heave over water")):
        ax.set(xlabel="frequency [Hz]", ylabel=label, xlim=(0.0, 1.3 * highest))
        ax.grid(alpha=0.3)
        ax.legend(loc="upper right", fontsize="small")
    below.set_ylim(bottom=0.0)


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        check_outputs([options.output], [*options.files, *filter(None, [options.over])])
        runs = read_runs(options.files)
        measured = read_measured(options.over, runs) if options.over else {}
        check_drawable(options.output)
        write_whole(options.output, lambda beside: draw(runs, measured, beside))
    except (ValueError, OSError) as error:
        return failure(error)
    print(options.output)
    return 0


if __name__ == "__main__":
    run_script(main)
