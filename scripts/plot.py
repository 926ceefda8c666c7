"""Draw the heave, tilt and force of a run over time, its spectra and its transfer function.

    python scripts/run.py my.xml --duration 300 --series my.parquet
    python scripts/plot.py my.parquet --output my.png

The input is a series or a recording of run.py. The script needs the extra 'report'.

Exit status: 0 on success, 2 on unusable input, 4 when the picture cannot be written.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from command_line import Parser, check_drawable, check_outputs, failure, run_script, write_whole
from sim.runs.statistics import spectra
from sim.runs.tables import read_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Columns = dict[str, NDArray[np.float64]]

MOST_BODIES = 6
"""Largest number of bodies that are drawn; the first ones are drawn."""

FEWEST_SAMPLES = 128
"""Least number of samples for which spectra are drawn."""

LOWEST_DENSITY_SHARE = 0.02
"""Share of the largest spectral density of the elevation. At frequencies with a lower density, the
transfer function would be noise over noise and is not drawn."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("series", type=Path, metavar="FILE", help="a series or .rrd from run.py")
    parser.add_argument(
        "--output", type=Path, metavar="FILE.png", help="default: beside the file, as .png"
    )
    options = parser.parse_args(arguments)
    options.output = options.output or options.series.with_suffix(".png")
    return options


def read_bodies(path: Path) -> dict[str, Columns]:
    """The columns time, heave, water_height, tilt_deg, and fz or weights, by body.

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
    return {n: {w: columns[w][columns["body"] == n] for w in wanted} for n in names}


def _of_recording(path: Path) -> dict[str, Columns]:
    from sim import read_series

    series = read_series(path)
    all_names = (name.removeprefix("height/") for name in series if name.startswith("height/"))
    names = [name for name in all_names if f"heave/{name}/water" in series]
    if not names:
        raise ValueError(f"{path} has no series of bodies; expected a recording of run.py")
    found = {}
    for name in names:
        times, heave = series[f"heave/{name}"]
        found[name] = {
            "time": times,
            "heave": heave,
            "water_height": series[f"height/{name}/water"][1],
            "tilt_deg": series[f"tilt/{name}"][1],
            "weights": series[f"force/{name}"][1],
        }
    return found


def draw(bodies: dict[str, Columns], path: Path, title: str) -> None:
    """Draw all panels into a PNG file."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = dict(list(bodies.items())[:MOST_BODIES])
    long = {n: c for n, c in shown.items() if len(c["time"]) >= FEWEST_SAMPLES}
    figure, axes = plt.subplots(
        5 if long else 3, 1, figsize=(9.0, 12.0 if long else 7.5), layout="constrained"
    )
    labels = {
        "heave": "heave [m]", "tilt_deg": "tilt [deg]", "fz": "buoyancy [N]",
        "weights": "buoyancy [weights]",
    }  # fmt: skip
    there = [name for name in labels if all(name in columns for columns in shown.values())]
    for ax, name in zip(axes, there, strict=False):
        label = labels[name]
        for body, columns in shown.items():
            ax.plot(columns["time"], columns[name], lw=1.0, label=body)
        ax.set(xlabel="time [s]", ylabel=label)
        ax.grid(alpha=0.3)
    axes[0].set_title(title)
    axes[0].legend(loc="upper right", fontsize="small")
    if long:
        draw_spectra(axes[3], axes[4], long)
    figure.savefig(path, dpi=120, format="png")
    plt.close(figure)


def draw_spectra(above: "Axes", below: "Axes", bodies: dict[str, Columns]) -> None:
    """Draw spectra of elevation and heave, and below them the ratio of heave to elevation."""
    highest = 0.0
    for i, (body, columns) in enumerate(bodies.items()):
        names = ("water_height", "heave")
        frequencies, (water, heave) = spectra(columns["time"], *(columns[n] for n in names))
        is_strong = (water > LOWEST_DENSITY_SHARE * water.max()) & (frequencies > 0.0)
        above.plot(frequencies, water, f"C{i}--", lw=1.0, label=f"{body}: water")
        above.plot(frequencies, heave, f"C{i}-", lw=1.0, label=f"{body}: heave")
        ratio = np.sqrt(heave[is_strong] / np.maximum(water[is_strong], 1e-300))
        below.plot(frequencies[is_strong], ratio, f"C{i}.-", lw=1.0, label=body)
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
        check_outputs([options.output], [options.series])
        bodies = read_bodies(options.series)
        check_drawable(options.output)
        write_whole(options.output, lambda beside: draw(bodies, beside, options.series.stem))
    except (ValueError, OSError) as error:
        return failure(error)
    print(options.output)
    return 0


if __name__ == "__main__":
    run_script(main)
