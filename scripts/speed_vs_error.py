"""Measure what methods cost and how wrong they are: hulls x seas x methods and their settings.

    python scripts/speed_vs_error.py --json errors.json --figure errors.png
    python scripts/speed_vs_error.py --quick
    python scripts/speed_vs_error.py --sources

Exit status: 0 on success, 2 on unusable input, 130 after Ctrl-C, with the rows until then printed.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

from command_line import (
    INTERRUPTED,
    UNUSABLE_INPUT,
    Parser,
    at_least,
    clear_progress,
    interruptible,
    positive,
    run_script,
    show_progress,
)

import numpy as np
import trimesh
from error_sources import error_sources, print_sources

from sim import Hull, Reference, Sea
from sim.measure.accuracy import SEAS, Pose, errors, time_in_turns, waterline_poses, wrenches
from sim.methods import make_method

MESHES = Path(__file__).resolve().parents[1] / "models" / "meshes"

HULLS = ("cube", "bunny_coarse", "bunny", "dragon", "bunny_fine")
"""The cube has 12 faces, bunny_fine those of the bunny split into 16 each: the same surface."""

METHODS = (
    "linear", "chord:1", "chord:4", "chord:16", "chord:4:crests",
    "patches:3e-2", "patches:1.5e-2", "patches:1e-2", "patches:6e-3", "patches",
    "patches:2e-3", "patches:8e-4",
)  # fmt: skip
"""Method texts of a run; the first one is what the others' speed is compared with."""

GOOD_ENOUGH = 1e-5
"""Force error, of density * gravity * volume, that is as good as the baseline's even where that is
still smaller."""

QUICK = {"hulls": ["cube", "bunny"], "seas": ["three", "chop"], "poses": 10, "seconds": 0.3}

CHANGES = ("horizontal", "vertical", "torque")
"""Errors whose change against the baseline's is stated."""

MARKERS = "osv^Dx"

TRUTH = 1e-7
"""Tolerance of the reference, of density * gravity * volume; the best method leaves 1e-6."""

SAME_SURFACE = {"bunny_fine": "bunny"}
"""Hulls whose true wrench is that of another one, which the reference is faster on."""

FIGURE_NEEDS = "--figure needs matplotlib, which is not installed; run: pip install '.[report]'"


def make_hull(name: str) -> Hull:
    """One of HULLS, 1 m long, about its centre of volume."""
    if name == "cube":
        return Hull.from_trimesh(trimesh.creation.box(extents=(1.0, 1.0, 1.0)))
    if name == "bunny_fine":
        return Hull.from_trimesh(_load("bunny").subdivide().subdivide())
    return Hull.from_trimesh(_load(name))


def _load(name: str) -> trimesh.Trimesh:
    return trimesh.load_mesh(MESHES / f"{name}.obj", process=False)


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="speed_vs_error.py", description=__doc__.splitlines()[0])
    parser.add_argument("--hulls", nargs="+", choices=HULLS, default=list(HULLS), metavar="HULL",
                        help=f"any of: {' '.join(HULLS)} (all)")  # fmt: skip
    parser.add_argument("--seas", nargs="+", choices=SEAS, default=list(SEAS), metavar="SEA",
                        help=f"any of: {' '.join(SEAS)} (all)")  # fmt: skip
    parser.add_argument("--methods", nargs="+", default=list(METHODS), metavar="METHOD",
                        help=f"method texts, the baseline first ({' '.join(METHODS)})")  # fmt: skip
    parser.add_argument("--poses", type=at_least(2), default=50, metavar="N",
                        help="random poses at the waterline (50)")  # fmt: skip
    parser.add_argument("--seed", type=at_least(0), default=0, metavar="N", help="of the poses (0)")
    parser.add_argument("--seconds", type=positive, default=3.0, metavar="S",
                        help="of timing for a hull in a sea, all methods (3)")  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("--figure", type=Path, metavar="FILE.png",
                        help="draw error against time; needs the extra 'report'")  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="less of everything: within a minute")
    parser.add_argument("--sources", action="store_true",
                        help="measure other sources of error instead")  # fmt: skip
    options = parser.parse_args(arguments)
    if options.quick:
        for name, value in QUICK.items():
            if getattr(options, name) == parser.get_default(name):
                setattr(options, name, value)
    return options


def measure(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """The rows of the report, hull after hull and sea after sea."""
    truths: dict[tuple[str, str], np.ndarray] = {}
    for name, sea_name in product(options.hulls, options.seas):
        hull, sea = make_hull(name), SEAS[sea_name]
        surface = SAME_SURFACE.get(name, name)
        true_hull = hull if surface == name else make_hull(surface)
        poses = waterline_poses(true_hull, sea, options.poses, options.seed)
        if (surface, sea_name) not in truths:
            truths[surface, sea_name] = wrenches(Reference(true_hull, sea, TRUTH), poses)
        case = {
            "hull": name,
            "faces": len(hull.faces),
            "sea": sea_name,
            "waves": len(sea.waves),
        }
        for row in measure_case(options, hull, sea, poses, truths[surface, sea_name]):
            yield case | row


def measure_case(
    options: argparse.Namespace, hull: Hull, sea: Sea, poses: Sequence[Pose], truth: np.ndarray
) -> Iterator[dict[str, Any]]:
    """The methods' rows for one hull in one sea; the first method is the baseline."""
    methods, setup = [], []
    for text in options.methods:
        started = perf_counter()
        methods.append(make_method(text, hull, sea))
        setup.append(perf_counter() - started)
    seconds = time_in_turns(methods, poses, options.seconds)
    # of each pose's repeats, then the mean over poses
    fastest = 1e6 * seconds.min(axis=0).mean(axis=1)
    median = 1e6 * np.median(seconds, axis=0).mean(axis=1)
    found = [asdict(errors(wrenches(method, poses), truth, method)) for method in methods]
    for i, text in enumerate(options.methods):
        changes = {
            f"{part}_change": 100.0 * (found[i][f"{part}_rms"] / found[0][f"{part}_rms"] - 1.0)
            for part in CHANGES
        }
        yield {
            "method": text,
            "baseline": i == 0,
            "setup_ms": 1e3 * setup[i],
            "us_median": float(median[i]),
            "us_min": float(fastest[i]),
            "speed_up": float(fastest[0] / fastest[i]),
            **found[i],
            **changes,
        }


def print_rows(rows: Sequence[dict[str, Any]]) -> None:
    """The rows as tables, one for each hull in each sea."""
    width = max(map(len, ["method", *(row["method"] for row in rows)]))
    for row in rows:
        if row["baseline"]:
            print(
                f"\n{row['hull']}, {row['faces']} faces, in {row['sea']}: {row['waves']} "
                f"wave{'s' * (row['waves'] != 1)}\n"
                f"{'':<{width}}     us a wrench          force error        torque error     "
                f"vertical bias      rms against {row['method']}, %\n"
                f"{'method':<{width}}  minimum  median  ratio      max      rms      max      rms"
                "      mean       +-   horiz.   vert.  torque"
            )
        print(
            f"{row['method']:<{width}} {row['us_min']:8.1f}{row['us_median']:8.1f}"
            f"{row['speed_up']:7.2f}  {row['force_max']:.1e}  {row['force_rms']:.1e}  "
            f"{row['torque_max']:.1e}  {row['torque_rms']:.1e}  {row['bias']:+.1e}  "
            f"{row['bias_error']:.0e}  " + _changes(row)
        )


def print_fastest(rows: Sequence[dict[str, Any]]) -> None:
    """For each hull in each sea the fastest setting of patches that is as good as the baseline, and
    how the time grows with the faces of the same surface."""
    cases: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        cases.setdefault((row["hull"], row["sea"]), []).append(row)
    print("\nfastest patches with a force error no larger than the first method's, or 1e-5:")
    for (hull, sea), (baseline, *others) in cases.items():
        good = max(baseline["force_max"], GOOD_ENOUGH)
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


def _changes(row: dict[str, Any]) -> str:
    """Change in per cent of the rms errors against the baseline's."""
    if row["baseline"]:
        return ""
    return "".join(f"{row[f'{part}_change']:+8.1f}" for part in CHANGES)


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Error against time, log-log: a panel a hull, a colour a sea, a marker a family of methods."""
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
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_line(panel: Any, rows: Sequence[dict[str, Any]], **style: Any) -> None:
    """The settings of one method for a hull in a sea, in the order they were given in."""
    times, sizes = [r["us_min"] for r in rows], [r["force_max"] for r in rows]
    panel.loglog(times, sizes, linewidth=1.0, alpha=0.8, **style)
    panel.set_xlabel("microseconds a wrench (one thread)")
    panel.set_ylabel("largest force error / (rho g V)")
    panel.tick_params(labelbottom=True, labelleft=True)
    panel.grid(True, which="major", alpha=0.3)


def family(row: dict[str, Any]) -> str:
    """The method without its settings; the biased variant of chord is one of its own."""
    name, *settings = row["method"].split(":")
    return f"{name}, crests only" if "crests" in settings else name


def check_outputs(options: argparse.Namespace) -> None:
    """Find out before the work whether its results can be written and its methods made."""
    if options.figure is not None and find_spec("matplotlib") is None:
        raise ValueError(FIGURE_NEEDS)
    cube = make_hull("cube")
    for text in options.methods:
        make_method(text, cube, SEAS["swell"])
    for path in (options.json, options.figure):
        if path is not None:
            path.open("a").close()


def collect(options: argparse.Namespace, rows: list[dict[str, Any]]) -> None:
    """Measure all rows and add them, with a progress bar where someone may be looking."""
    show = sys.stderr.isatty()
    total = len(options.hulls) * len(options.seas) * len(options.methods)
    try:
        for row in measure(options):
            rows.append(row)
            if show:
                show_progress(len(rows), total, "rows")
    finally:
        if show:
            clear_progress()


def write_report(options: argparse.Namespace, report: dict[str, Any]) -> None:
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=2) + "\n")


def report_rows(options: argparse.Namespace) -> int:
    """Measure, print, draw and write; after Ctrl-C what there is. Return the exit status."""
    rows: list[dict[str, Any]] = []
    status = 0
    try:
        with interruptible():
            collect(options, rows)
    except KeyboardInterrupt:
        print("speed_vs_error.py: interrupted", file=sys.stderr)
        status = INTERRUPTED
    report = {"poses": options.poses, "seed": options.seed, "truth": TRUTH, "rows": rows}
    write_report(options, report)
    print_rows(rows)
    print_fastest(rows)
    if options.figure is not None and not status:
        draw(rows, options.figure)
    return status


def report_sources(options: argparse.Namespace) -> int:
    """The same for the other sources of error, which come all at once."""
    report = error_sources(make_hull, options.poses, options.seed)
    write_report(options, report)
    print_sources(report)
    return 0


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        check_outputs(options)
        return report_sources(options) if options.sources else report_rows(options)
    except BrokenPipeError:
        raise
    except (ValueError, OSError) as error:
        print(f"speed_vs_error.py: {error}", file=sys.stderr)
        return UNUSABLE_INPUT


if __name__ == "__main__":
    run_script(main)
