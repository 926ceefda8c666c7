"""Run a scene with many settings, seeds and start times, and write a table with a row per run.

    python scripts/sweep.py models/bunny.xml --set wave_swell.amplitude=0.05,0.1,0.2 --output a.csv
    python scripts/sweep.py my.xml --seeds 20 --jobs -1 --output seeds.parquet

Exit status: 0 on success, 2 on unusable input, 4 if a file cannot be written or a process was
killed, 130 after Ctrl-C, 143 after SIGTERM. Finished rows are kept beside the output; --resume
continues from them.
"""

import argparse
import importlib.util
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter

import numpy as np
from joblib import Parallel, delayed, parallel_config

from command_line import (
    MOST_ROWS,
    Parser,
    Progress,
    Stopped,
    add_averaging_options,
    add_scene_options,
    at_least,
    check_outputs,
    compile_in_two,
    failure,
    json_text,
    notes_said,
    print_table,
    run_script,
    say,
    scene_options,
    stops_held,
    write_whole,
)
from sim.mjcf.files import model_files
from sim.runs.locked import LockedFile
from sim.runs.sweep import Plan, Row, Run, as_columns, check_plan, kept_rows, perform, runs_of
from sim.runs.tables import check_ending, write_columns


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("scene", type=Path, metavar="SCENE", help="an MJCF or URDF file")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE",
                        help="table of the rows: .csv .parquet .npz")  # fmt: skip
    add_scene_options(parser, many=True)
    parser.add_argument("--seeds", type=at_least(0), default=0, metavar="N",
                        help="number of seeds of an irregular sea, from 0")  # fmt: skip
    parser.add_argument("--starts", type=at_least(1), default=1, metavar="N",
                        help="number of start times in the sea (1)")  # fmt: skip
    add_averaging_options(parser, rate=10.0)
    parser.add_argument("--jobs", type=at_least(-1), default=1, metavar="J",
                        help="processes, -1 for all cores (1)")  # fmt: skip
    parser.add_argument("--dask", metavar="ADDRESS",
                        help="dask scheduler; needs the extra 'cluster'")  # fmt: skip
    parser.add_argument("--resume", action="store_true", help="only do the missing runs")
    parser.add_argument("--quiet", action="store_true", help="print only errors")
    return parser.parse_args(arguments)


def check_cluster(address: str | None) -> None:
    """Raise ValueError if there is no dask scheduler at the address or dask is not installed."""
    if address is None:
        return
    if importlib.util.find_spec("distributed") is None:
        raise ValueError(
            "--dask needs dask and distributed, which are not installed; run: "
            "pip install '.[cluster]'"
        )
    from dask.distributed import Client

    try:
        Client(address, timeout="5s").close()
    except (OSError, ValueError, TimeoutError) as error:
        raise ValueError(f"there is no dask scheduler at {address}: {error}") from None


def rows_of(plan: Plan, runs: Sequence[Run], options: argparse.Namespace) -> Iterator[Row]:
    """Yield rows as runs are finished, in this process, in others or on a cluster."""
    if options.dask is None and options.jobs == 1:
        for run in runs:
            yield perform(plan, run)
        return
    with ExitStack() as stack:
        if options.dask is None:
            ignore = signal.SIGINT, signal.SIG_IGN  # only this process handles a Ctrl-C
            config = parallel_config(
                "loky", n_jobs=options.jobs, initializer=signal.signal, initargs=ignore
            )
            stack.enter_context(config)
        else:
            from dask.distributed import Client

            stack.enter_context(Client(options.dask, timeout="10s"))
            stack.enter_context(parallel_config("dask"))
        tasks = (delayed(perform)(plan, run) for run in runs)
        yield from Parallel(return_as="generator_unordered", batch_size=1)(tasks)


def keep(file: LockedFile, row: Row) -> None:
    """Write a row to the disk."""
    file.append(json_text(row).encode() + b"\n")


def resumed_rows(
    file: LockedFile, plan: Plan, runs: Sequence[Run], options: argparse.Namespace
) -> list[Row]:
    """The finished rows in a file, to which rows can be appended then. Raises ValueError."""
    if file.size and not options.resume:
        raise ValueError(f"{file.name} has rows of an interrupted sweep; use --resume or remove it")
    try:
        rows, size = kept_rows(file.path.read_bytes(), plan, runs)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}; remove it or use its options") from None
    file.cut(size)
    return rows


def collect(
    plan: Plan, runs: Sequence[Run], rows: list[Row], options: argparse.Namespace, file: LockedFile
) -> None:
    """Do the missing runs and append their rows to `rows` and to a file. Raises OSError if a worker
    was killed."""
    done = {row["run"] for row in rows}
    missing = [run for run in runs if run.number not in done]
    with (
        notes_said(quiet=True),  # joblib warns of abandoned tasks
        stops_held() as check,
        Progress(len(runs), "runs", options.quiet, len(rows)) as bar,
    ):
        if not file.size:
            keep(file, plan.as_row())
        try:
            for row in rows_of(plan, missing, options):
                keep(file, row)
                rows.append(row)
                bar.update(1)
                check()
        except (BrokenProcessPool, KeyboardInterrupt):
            check()  # a terminal's Ctrl-C also reaches the workers
            raise OSError(
                "a process was killed, perhaps for its memory; try fewer --jobs"
            ) from None


def print_summary(rows: Sequence[Row], wall_s: float, path: Path) -> None:
    held = [row for row in rows if row["status"] == "held"]
    seconds = sum(row["seconds"] for row in rows)
    other_seconds = sum(row["seconds"] - row["stepping_seconds"] for row in rows)
    if held:
        names = [n for n in held[0] if n.endswith((" std", " drift x", " period"))]
        columns = as_columns(held)
        cells = [
            (name, *(f"{f(columns[name]):.4g}" for f in (np.nanmin, np.nanmean, np.nanmax)))
            for name in names
            if np.isfinite(columns[name]).any()
        ]
        print_table(("over the runs", "least", "mean", "most"), cells[:MOST_ROWS])
        if len(cells) > MOST_ROWS:
            print(f"and {len(cells) - MOST_ROWS} more in {path}")
    print(
        f"\n{len(rows)} runs, {len(held)} held, in {path}: {60.0 * len(rows) / wall_s:.0f} runs a "
        f"minute; {seconds / len(rows):.2f} s per run, {other_seconds / len(rows):.2f} s of it not "
        "stepping"
    )
    for row in [row for row in rows if row["status"] != "held"][:5]:
        print(f"run {row['run']}: {row['status']}")


def sweep(plan: Plan, runs: Sequence[Run], options: argparse.Namespace, file: LockedFile) -> int:
    """Do the runs that have no row in a file, write the table, and return the exit status."""
    check_cluster(options.dask)
    compile_in_two()
    with notes_said(options.quiet):
        check_plan(plan, runs[0])
    rows = resumed_rows(file, plan, runs, options)
    started, before = perf_counter(), len(rows)
    try:
        collect(plan, runs, rows, options, file)
    except (OSError, Stopped) as error:
        status = failure(error)
        kept = len(rows) if file.is_open else 0  # a file that was removed is closed
        say(f"{kept} of {len(runs)} runs are saved; --resume does the others")
        return status
    kind, columns = options.output.suffix, as_columns(rows)
    write_whole(options.output, lambda path: write_columns(path, columns, kind))
    file.cut(0)
    if not options.quiet:
        print_summary(rows, (perf_counter() - started) * len(rows) / max(len(rows) - before, 1),
                      options.output)  # fmt: skip
    return 0


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    kept = options.output.with_name(f"{options.output.name}.rows")
    try:
        check_outputs((options.output, kept), model_files(options.scene))
        check_ending(options.output)
        runs = runs_of(options.settings, options.seeds, options.starts)
        shared = scene_options(options)
        shared["densities"] = tuple(shared["densities"].items())
        plan = Plan(
            options.scene.resolve(), options.duration, options.warm_up, options.rate, **shared
        )
        with LockedFile(kept) as file:
            return sweep(plan, runs, options, file)
    except (ValueError, OSError) as error:
        return failure(error)


if __name__ == "__main__":
    run_script(main)
