"""Measure the speed and the error of methods and settings, for several hulls in several seas.

    python scripts/benchmarks/speed_vs_error.py --json errors.json --figure errors.png
    python scripts/benchmarks/speed_vs_error.py --quick
    python scripts/benchmarks/speed_vs_error.py --sources
    python scripts/benchmarks/speed_vs_error.py --steps
    python scripts/benchmarks/speed_vs_error.py --loading
    python scripts/benchmarks/speed_vs_error.py --ship
    python scripts/benchmarks/speed_vs_error.py --random 1000

Exit status: 0 on success, 2 on unusable input, 130 after Ctrl-C (finished rows are printed).
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import groupby, product
from statistics import median
from typing import Any

import numpy as np
import trimesh

from benchmarks.accuracy import COMPARED_ERRORS, speeds_and_errors, wrenches
from benchmarks.loading import loading_times
from benchmarks.random_cases import RandomCase, random_cases
from benchmarks.seas import SEAS, waterline_poses
from benchmarks.ship import ship, ship_costs, tall_hulls
from benchmarks.sources import DURATION, FALL_TIME, error_sources
from benchmarks.steps import step_costs
from command_line import (
    Parser,
    Progress,
    Stopped,
    at_least,
    check_drawable,
    check_outputs,
    failure,
    notes_said,
    positive,
    print_table,
    run_script,
    write_json,
    write_whole,
)
from labels import labelled_method
from sim import Hull, Reference
from sim.water.head import PRESSURES
from sim.water.sea import DEFAULT_PRESSURE

MODELS = Path(__file__).resolve().parents[2] / "models"

HULLS = ("cube", "bunny_coarse", "bunny", "dragon", "bunny_fine")
"""The cube has 12 faces. bunny_fine is the bunny with each face divided into 16."""

STEPPED_SCENES = ("bunny", "cube", "trio")
"""Scenes whose steps --steps measures."""

SHIP_WAVES, SHIP_HEIGHTS = (40, 200, 500), (2.4, 4.0)
"""Counts of waves and significant heights [m] of the seas of --ship. Hulls that reach far down are
measured in the second count and the second height."""

TALL_TOLERANCES = (None, 2.0)
"""Tolerances [m] of these hulls: the default, and one with an error near that of `linear`."""

METHODS = (
    "linear", "chord:1", "chord:4", "chord:16", "chord:4:crests",
    "patches:3e-2", "patches:1.5e-2", "patches:1e-2", "patches:6e-3", "patches",
    "patches:2e-3", "patches:8e-4",
)  # fmt: skip
"""Labels of the default methods; the first is the baseline."""

NEGLIGIBLE_ERROR = 1e-5
"""Force error, a share of density * gravity * volume, that is small enough even where the
baseline's is smaller."""

QUICK_OPTIONS = {"hulls": ["cube", "bunny"], "seas": ["three", "chop"], "poses": 10, "seconds": 0.3}

MARKERS = "osv^Dx"

REFERENCE_TOLERANCE = 1e-7
"""Tolerance of the reference, a share of density * gravity * volume; methods reach 1e-6."""

SAME_SURFACE = {"bunny_fine": "bunny"}
"""Hulls with the same surface as a coarser hull, for which the reference is faster."""


def make_hull(name: str) -> Hull:
    """One of HULLS, 1 m long, with the origin at its centre of volume."""
    if name == "cube":
        return Hull.from_trimesh(trimesh.creation.box(extents=(1.0, 1.0, 1.0)))
    if name == "bunny_fine":
        return Hull.from_trimesh(_load("bunny").subdivide().subdivide())
    return Hull.from_trimesh(_load(name))


def _load(name: str) -> trimesh.Trimesh:
    return trimesh.load_mesh(MODELS / "meshes" / f"{name}.obj", process=False)


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("--hulls", nargs="+", choices=HULLS, default=list(HULLS), metavar="HULL",
                        help=f"any of: {' '.join(HULLS)} (all)")  # fmt: skip
    parser.add_argument("--seas", nargs="+", choices=SEAS, default=list(SEAS), metavar="SEA",
                        help=f"any of: {' '.join(SEAS)} (all)")  # fmt: skip
    parser.add_argument("--methods", nargs="+", default=list(METHODS), metavar="METHOD",
                        help=f"method labels, baseline first ({' '.join(METHODS)})")  # fmt: skip
    parser.add_argument("--pressure", choices=PRESSURES, default=DEFAULT_PRESSURE,
                        help=f"pressure of the water ({DEFAULT_PRESSURE})")  # fmt: skip
    parser.add_argument("--poses", type=at_least(2), default=50, metavar="N",
                        help="random poses at the waterline (50)")  # fmt: skip
    parser.add_argument("--seed", type=at_least(0), default=0, metavar="N", help="of the poses (0)")
    parser.add_argument("--seconds", type=positive, default=3.0, metavar="S",
                        help="seconds of timing per hull and sea (3)")  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to this file")
    parser.add_argument("--figure", type=Path, metavar="FILE.png",
                        help="draw error against time; needs the extra 'report'")  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="fewer hulls and seas: one minute")
    parser.add_argument("--sources", action="store_true",
                        help="measure other sources of error instead")  # fmt: skip
    parser.add_argument("--steps", action="store_true",
                        help="measure whole mj_steps and batches instead")  # fmt: skip
    parser.add_argument("--loading", action="store_true",
                        help="measure how long it takes to load hulls instead")  # fmt: skip
    parser.add_argument("--ship", action="store_true",
                        help="measure large hulls in seas of up to 500 waves instead")  # fmt: skip
    parser.add_argument("--random", type=at_least(1), metavar="N",
                        help="try the default tolerance in N random cases instead")  # fmt: skip
    options = parser.parse_args(arguments)
    if options.quick:
        for name, value in QUICK_OPTIONS.items():
            if getattr(options, name) == parser.get_default(name):
                setattr(options, name, value)
    return options


def measure(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the rows of the report by hull and sea."""
    truths: dict[tuple[str, str], np.ndarray] = {}
    for name, sea_name in product(options.hulls, options.seas):
        hull, sea = make_hull(name), SEAS[sea_name].with_pressure(options.pressure)
        surface = SAME_SURFACE.get(name, name)
        true_hull = hull if surface == name else make_hull(surface)
        poses = waterline_poses(true_hull, sea, options.poses, options.seed)
        if (surface, sea_name) not in truths:
            reference = Reference(true_hull, sea, REFERENCE_TOLERANCE)
            truths[surface, sea_name] = wrenches(reference, poses)
        case = {
            "hull": name,
            "faces": len(hull.faces),
            "sea": sea_name,
            "waves": len(sea.waves),
        }
        truth = truths[surface, sea_name]
        of_methods = speeds_and_errors(options.methods, hull, sea, poses, truth, options.seconds)
        yield from (case | row for row in of_methods)


COLUMNS = (
    "method", "us min", "median", "ratio", "force max", "rms", "torque max", "rms",
    "lift bias", "+-", *(f"{e} %" for e in COMPARED_ERRORS),
)  # fmt: skip
"""The last columns are changes of the rms errors relative to the baseline."""


def print_rows(rows: Sequence[dict[str, Any]]) -> None:
    """Print a table per hull and sea."""
    for _, case in groupby(rows, key=lambda row: (row["hull"], row["sea"])):
        of_methods = list(case)
        first = of_methods[0]
        print(
            f"\n{first['hull']}, {first['faces']} faces, in {first['sea']}: {first['waves']} "
            f"wave{'s' * (first['waves'] != 1)}"
        )
        print_table(COLUMNS, [_cells(row) for row in of_methods])


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    changes = ("" if row["baseline"] else f"{row[f'{e}_change']:+.1f}" for e in COMPARED_ERRORS)
    return (
        row["method"], f"{row['us_min']:.1f}", f"{row['us_median']:.1f}", f"{row['speed_up']:.2f}",
        f"{row['force_max']:.1e}", f"{row['force_rms']:.1e}", f"{row['torque_max']:.1e}",
        f"{row['torque_rms']:.1e}", f"{row['bias']:+.1e}", f"{row['bias_error']:.0e}", *changes,
    )  # fmt: skip


def print_fastest(rows: Sequence[dict[str, Any]]) -> None:
    """Print the fastest setting of patches that is as accurate as the baseline, per hull and sea,
    and how the time grows with the number of faces of the same surface."""
    cases: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        cases.setdefault((row["hull"], row["sea"]), []).append(row)
    print("\nfastest patches with a force error no larger than the first method's, or 1e-5:")
    for (hull, sea), (baseline, *others) in cases.items():
        good = max(baseline["force_max"], NEGLIGIBLE_ERROR)
        found = [r for r in others if family(r) == "patches" and r["force_max"] <= good]
        if found:
            best = max(found, key=lambda row: row["speed_up"])
            print(
                f"{hull:<13} {sea:<6} {best['method']:<13} {best['us_min']:8.1f} us "
                f"{best['force_max']:.1e}, {baseline['method']} {baseline['us_min']:8.1f} us "
                f"{baseline['force_max']:.1e}: {best['speed_up']:.1f} x"
            )
    for (hull, sea), case in cases.items():
        of_surface = cases.get((SAME_SURFACE.get(hull), sea), ())
        for row, coarse in product(case, of_surface):
            if row["method"] == coarse["method"] == "patches":
                print(
                    f"{hull} in {sea}: {row['faces'] / coarse['faces']:.0f} x the faces of "
                    f"{coarse['hull']} take {row['us_min'] / coarse['us_min']:.1f} x its time"
                )


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw error against time, log-log: a panel per hull, a colour per sea, a marker per method."""
    import matplotlib

    matplotlib.use("Agg")  # needs no screen
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D

    hulls, seas, families = (
        list(dict.fromkeys(values))
        for values in zip(*((r["hull"], r["sea"], family(r)) for r in rows), strict=True)
    )
    columns = min(3, len(hulls) + 1)
    grid = -(-(len(hulls) + 1) // columns), columns
    size = (4.2 * columns, 3.6 * grid[0])
    figure, axes = plt.subplots(*grid, figsize=size, squeeze=False, sharex=True, sharey=True)
    panels = list(axes.flat)
    for panel, name in zip(panels, hulls, strict=False):
        for (i, sea), (j, kind) in product(enumerate(seas), enumerate(families)):
            _draw_line(
                panel,
                [r for r in rows if (r["hull"], r["sea"], family(r)) == (name, sea, kind)],
                color=f"C{i}",
                marker=MARKERS[j % len(MARKERS)],
            )
        faces = next(r["faces"] for r in rows if r["hull"] == name)
        panel.set_title(f"{name.replace('_', ', ')}: {faces:,} faces", fontsize=10)
    legend = [Line2D([], [], color=f"C{i}", label=f"sea: {sea}") for i, sea in enumerate(seas)]
    legend += [
        Line2D([], [], color="0.3", marker=MARKERS[j % len(MARKERS)], label=kind, linewidth=0)
        for j, kind in enumerate(families)
    ]
    for spare in panels[len(hulls) :]:
        spare.axis("off")
    panels[len(hulls)].legend(handles=legend, loc="center", frameon=False)
    figure.tight_layout()
    write_whole(path, lambda beside: figure.savefig(beside, dpi=110, format="png"))
    plt.close(figure)


def _draw_line(panel: Any, rows: Sequence[dict[str, Any]], **style: Any) -> None:
    """Draw the settings of one method for a hull in a sea, in the order of the command line."""
    times, sizes = [r["us_min"] for r in rows], [r["force_max"] for r in rows]
    panel.loglog(times, sizes, linewidth=1.0, alpha=0.8, **style)
    panel.set_xlabel("microseconds a wrench (one thread)")
    panel.set_ylabel("largest force error / (rho g V)")
    panel.tick_params(labelbottom=True, labelleft=True)
    panel.grid(True, which="major", alpha=0.3)


def family(row: dict[str, Any]) -> str:
    """The method without its settings; the biased variant of chord counts as another method."""
    name, *settings = row["method"].split(":")
    return f"{name}, crests only" if "crests" in settings else name


def print_sources(report: dict[str, list[dict[str, Any]]]) -> None:
    """Print the two tables of other sources of error: relative wrench errors, and path errors."""
    for _, of_sea in groupby(report["wrench"], key=lambda row: row["sea"]):
        rows = list(of_sea)
        print(f"\nbunny in {rows[0]['waves']} waves, sum of k a {rows[0]['steepness']:.2f}")
        names = ("force_max", "force_rms", "torque_max", "torque_rms")
        cells = [(row["source"], *(f"{row[name]:.1e}" for name in names)) for row in rows]
        titles = ("error of the wrench from", "force max", "rms", "torque max", "rms")
        print_table(titles, cells)
    print(
        f"\nbunny dropped into its scene, largest error in the first {FALL_TIME:g} s, then until "
        f"{DURATION:g} s"
    )
    names = ("fall_height_mm", "fall_tilt_deg", "height_mm", "tilt_deg")
    cells = [(row["source"], *(f"{row[name]:.2g}" for name in names)) for row in report["path"]]
    titles = ("error of the path from", "height mm", "tilt deg", "height mm", "tilt deg")
    print_table(titles, cells)


def check_files(options: argparse.Namespace) -> None:
    """Check before the work whether results can be written and methods made."""
    check_outputs((options.json, options.figure), [])
    check_drawable(options.figure)
    cube = make_hull("cube")
    for text in options.methods:
        labelled_method(text, cube, SEAS["swell"])


def collect(options: argparse.Namespace, rows: list[dict[str, Any]]) -> None:
    """Measure all rows and append them to `rows`."""
    total = len(options.hulls) * len(options.seas) * len(options.methods)
    with Progress(total, "rows") as bar:
        for row in measure(options):
            rows.append(row)
            bar.update()


def report_rows(options: argparse.Namespace) -> int:
    """Measure, write, print and draw rows (after Ctrl-C the finished ones); return the status."""
    rows: list[dict[str, Any]] = []
    status = 0
    try:
        collect(options, rows)
    except Stopped as stop:
        status = failure(stop)
    report = {
        "pressure": options.pressure,
        "poses": options.poses,
        "seed": options.seed,
        "truth": REFERENCE_TOLERANCE,
        "rows": rows,
    }
    write_json(options.json, report)
    print_rows(rows)
    print_fastest(rows)
    if options.figure is not None and not status:
        draw(rows, options.figure)
    return status


def report_sources(options: argparse.Namespace) -> int:
    """Measure, write and print the other sources of error."""
    report = error_sources(make_hull("bunny"), MODELS / "bunny.xml", options.poses, options.seed)
    write_json(options.json, report)
    print_sources(report)
    return 0


def report_steps(options: argparse.Namespace) -> int:
    """Measure, write and print the time of whole steps, in units of bare steps, and of batches."""
    scenes = [MODELS / f"{name}.xml" for name in STEPPED_SCENES]
    rows = list(step_costs(scenes[:1] if options.quick else scenes, MODELS / "spheres.xml"))
    write_json(options.json, {"steps": rows})
    singles = [row for row in rows if "ratio" in row]
    names = ("us", "bare_us", "ratio")
    cells = [(row["what"], *(f"{row[name]:.2f}" for name in names)) for row in singles]
    print_table(("mj_step of", "us with water", "us bare", "ratio"), cells)
    print()
    names = ("us", "single_us", "throughput")
    batches = [row for row in rows if "throughput" in row]
    cells = [(row["what"], *(f"{row[name]:.2f}" for name in names)) for row in batches]
    print_table(("a step of one of", "us", "us by itself", "throughput"), cells)
    return 0


def report_loading(options: argparse.Namespace) -> int:
    """Measure, write and print the time and memory to load the bunny at several finenesses."""
    sea = SEAS["three"].with_pressure(options.pressure)
    rows = list(loading_times(_load("bunny"), sea, 2 if options.quick else 4))
    write_json(options.json, {"loading": rows})
    names = ("hull_s", "patches_s", "finer_s")
    cells = [
        (f"{row['faces']:,}", *(f"{row[n]:.2f}" for n in names), f"{row['memory_mb']:.0f}")
        for row in rows
    ]
    print_table(("faces", "hull s", "patches s", "a tenth s", "memory MB"), cells)
    return 0


def report_ship(options: argparse.Namespace) -> int:
    """Measure, write and print the cost of large hulls in irregular seas of many waves."""
    counts = SHIP_WAVES[:1] if options.quick else SHIP_WAVES
    costs = ship_costs(ship(_load("wigley")), counts, SHIP_HEIGHTS, options.seconds)
    rows = [{"hull": "ship", **row} for row in costs]
    if not options.quick:
        for name, hull in tall_hulls(_load("bunny")).items():
            costs = ship_costs(
                hull, SHIP_WAVES[1:2], SHIP_HEIGHTS[1:], options.seconds, TALL_TOLERANCES
            )
            rows += [{"hull": name, **row} for row in costs]
    write_json(options.json, {"ship": rows})
    cells = [
        (
            f"{row['hull']}, {row['waves']} waves, {row['height']:g} m", f"{row['ready_s']:.1f}",
            str(row["patches"]), f"{row['tolerance']:.2g}", f"{row['us']:.0f}",
            f"{row['linear_us']:.0f}", f"{row['force_max']:.1e}",
            f"{row['linear_force_max']:.1e}",
        )
        for row in rows
    ]  # fmt: skip
    titles = ("sea", "ready s", "patches", "tolerance m", "us", "linear us", "force max", "linear")
    print_table(titles, cells)
    return 0


def report_random(options: argparse.Namespace) -> int:
    """Measure, write and print the errors and the cost of random cases."""
    cases: list[RandomCase] = []
    status = 0
    try:
        with Progress(options.random, "cases") as bar:
            for case in random_cases(options.random, options.seed):
                cases.append(case)
                bar.update(1)
    except Stopped as stop:
        status = failure(stop)
    tried = len(cases)
    write_json(options.json, {"cases": [asdict(case) for case in cases]})
    cases = [c for c in cases if c.error == c.error]  # NaN: there is no reference
    kept = [c for c in cases if not c.is_coarse]
    cells = [
        (
            what, str(len(some)), f"{max(c.error for c in some):.1e}",
            f"{median(c.error for c in some):.1e}", f"{max(c.seconds for c in some):.1f}",
            str(max(c.patches for c in some)), max(some, key=lambda c: c.error).name,
        )
        for what, some in (
            ("default tolerance kept", kept), ("coarsened", [c for c in cases if c.is_coarse])
        ) if some
    ]  # fmt: skip
    titles = ("", "cases", "largest error", "median", "longest s", "most patches", "largest of")
    print_table(titles, cells)
    if len(cases) < tried:
        print(f"{tried - len(cases)} cases in which the reference does not converge")
    return status


REPORTS = {
    "sources": report_sources, "steps": report_steps, "loading": report_loading,
    "ship": report_ship, "random": report_random,
}  # fmt: skip
"""Report by command-line option; without any of them `report_rows` runs."""


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    report = next((r for name, r in REPORTS.items() if getattr(options, name)), report_rows)
    try:
        check_files(options)
    except ValueError as error:
        return failure(error)
    with notes_said(quiet=True):  # the scenes are known
        return report(options)


if __name__ == "__main__":
    run_script(main)
