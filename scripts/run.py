"""Run scenes headless, record them, and print a summary.

    python scripts/run.py models/bunny.xml

Exit status: 0 on success, 2 on unusable input, 3 if the state diverged, 4 if a file cannot be
written, 130 after Ctrl-C, 143 after SIGTERM. The recording until then is on disk.
"""

import argparse
import shutil
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from time import perf_counter
from typing import Any

from screen import Screen

from command_line import (
    DIVERGED,
    MOST_ROWS,
    UNUSABLE_INPUT,
    UNWRITABLE,
    Parser,
    Progress,
    Stopped,
    add_scene_options,
    at_least,
    check_outputs,
    compile_in_two,
    failure,
    folded,
    notes_said,
    positive,
    print_table,
    run_script,
    scene_options,
    stops_held,
    write_json,
    write_whole,
)
from sim import DivergenceError, Recorder, Sample, Scene, Tally, observe, simulate
from sim.mjcf.files import model_files
from sim.recording.frame import MOST_RESOLUTION
from sim.recording.look import COLOURS
from sim.runs.series import Series
from sim.runs.simulation import check_run
from sim.runs.tables import check_ending, write_columns
from sim.runs.tally import MOTIONS
from sim.water.words import sea_in_words


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument(
        "scenes",
        type=Path,
        nargs="+",
        metavar="SCENE",
        help="MJCF or URDF files, run one after another",
    )
    parser.add_argument(
        "--duration", type=positive, default=10.0, metavar="S", help="simulated seconds (10)"
    )
    parser.add_argument(
        "--rate",
        type=positive,
        default=30.0,
        metavar="HZ",
        help="samples per simulated second (30)",
    )
    parser.add_argument(
        "--warm-up", type=positive, default=0.0, metavar="S",
        help="seconds that the summary ignores (0)",
    )  # fmt: skip
    add_scene_options(parser)
    add_recording_options(parser)
    parser.add_argument("--view", action="store_true", help="show the run in MuJoCo's viewer")
    parser.add_argument(
        "--speed", type=positive, metavar="X", help="speed of the viewer, in real times (1)"
    )
    parser.add_argument(
        "--series", type=Path, metavar="FILE", help="table of all samples: .csv .parquet .npz"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="file for the summary")
    parser.add_argument("--quiet", action="store_true", help="print only errors")
    options = parser.parse_args(arguments)
    for name in ("record", "series", "json") if len(options.scenes) > 1 else ():
        if getattr(options, name) is not None:
            parser.error(f"--{name} names one file, and there are {len(options.scenes)} scenes")
    if options.record_rate is not None and options.record_rate > options.rate:
        parser.error(
            f"--record-rate {options.record_rate:g} is above --rate {options.rate:g}; raise --rate"
        )
    if options.speed is not None and not options.view:
        parser.error("--speed is the speed of the viewer; add --view")
    return options


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the recording."""
    record = parser.add_mutually_exclusive_group()
    record.add_argument(
        "--record", type=Path, metavar="FILE.rrd", help="recording (recordings/<scene>.rrd)"
    )
    record.add_argument("--no-record", action="store_true", help="write no recording")
    parser.add_argument(
        "--record-rate", type=positive, metavar="HZ", help="recorded samples per second (all)"
    )
    parser.add_argument(
        "--water-size",
        type=positive,
        metavar="M",
        help="width of the water that moves in the recording",
    )
    parser.add_argument(
        "--water-resolution",
        type=at_least(2, MOST_RESOLUTION),
        default=48,
        metavar="N",
        help="vertices along its side (48)",
    )
    parser.add_argument(
        "--colour", choices=COLOURS, default=COLOURS[0], help="colouring of the hulls (wet)"
    )


def load(path: Path, options: argparse.Namespace) -> Scene:
    """Load the scene and observe it once, which compiles the kernels."""
    scene = Scene.load(path, settings=options.settings, **scene_options(options))
    check_run(scene, options.duration, options.rate, options.warm_up)
    observe(scene)
    return scene


def open_recorder(
    recording: Path | None, scene: Scene, options: argparse.Namespace
) -> Recorder | None:
    """The recorder of a run; None if it is not recorded."""
    if recording is None:
        return None
    water = options.water_size, options.water_resolution
    return Recorder(recording, scene, options.record_rate, *water, colour=options.colour)


def run(
    scene: Scene,
    options: argparse.Namespace,
    consumers: Sequence[Callable[[Sample], None]],
    screen: Screen | None,
    check: Callable[[], None],
) -> None:
    """Simulate, give each sample to all consumers, and check whether to stop. A closed window ends
    the run."""
    with Progress(options.duration, "s", options.quiet) as bar:
        start = scene.data.time
        for sample in simulate(scene, options.duration, options.rate):
            for consume in consumers:
                consume(sample)
            bar.update(sample.time - start - bar.n)
            check()
            if screen is not None and not screen.show(sample):
                return


def summarise(
    scene: Scene,
    tally: Tally,
    wall_s: float,
    options: argparse.Namespace,
    recording: Path | None,
    recorder: Recorder | None,
) -> dict[str, Any]:
    """The summary of a run, with the keys of --json."""
    last, timestep = tally.last, scene.model.opt.timestep
    steps = last.step
    return {
        "scene": scene.name,
        "sea": sea_in_words(scene.buoyancy.sea),
        "steps": steps,
        "timestep": timestep,
        "duration": steps * timestep,
        "wall_s": wall_s,
        "realtime_factor": steps * timestep / wall_s,
        "buoyancy_us_per_step": 1e6 * last.buoyancy_seconds / max(steps, 1),
        "step_us": 1e6 * (last.step_seconds - last.buoyancy_seconds) / max(steps, 1),
        "logging_ms_per_frame": recorder and 1e3 * recorder.seconds / max(recorder.frames, 1),
        "warm_up": options.warm_up,
        "bodies": tally.bodies(),
        "recording": None if recording is None else str(recording),
    }


def print_summary(summary: dict[str, Any]) -> None:
    logging = summary["logging_ms_per_frame"]
    print(
        f"{summary['scene']}: {summary['steps']} steps of {summary['timestep']:g} s, "
        f"{summary['duration']:.2f} s simulated in {summary['wall_s']:.2f} s "
        f"({summary['realtime_factor']:.1f} x real time)\n"
        f"a step: {summary['buoyancy_us_per_step']:.1f} us in buoyancy, "
        f"{summary['step_us']:.1f} us in MuJoCo"
        + ("" if logging is None else f"; a frame: {logging:.2f} ms in logging")
        + f"\nsea: {summary['sea']}\n"
    )
    rows = [
        (
            name, f"{means['mean_height']:.3f}", f"{means['mean_tilt_deg']:.2f}",
            f"{means['mean_submerged_fraction']:.3f}", f"{means['mean_force_over_weight']:.3f}",
        )
        for name, means in summary["bodies"].items()
    ]  # fmt: skip
    if summary["warm_up"]:
        print(f"from {summary['warm_up']:g} s on:")
    print_table(("mean of", "height m", "tilt deg", "submerged", "force/weight"), folded(rows))
    print_motions(summary["bodies"])
    if summary["recording"] is not None and Path(summary["recording"]).is_file():
        beside_python = Path(sys.executable).with_name("rerun")
        viewer = "rerun" if shutil.which("rerun") else beside_python
        size = Path(summary["recording"]).stat().st_size / 1e6
        print(f"\nrecorded {size:.1f} MB; look at it with: {viewer} {summary['recording']}")


def print_motions(bodies: dict[str, dict[str, Any]]) -> None:
    """Print mean, standard deviation and largest value of each body's motions."""
    rows = []
    for statistic in ("mean", "std", "largest"):
        block = [
            (body, *(f"{values[motion][statistic]:z.3f}" for motion in MOTIONS))
            for body, values in bodies.items()
        ]
        rows += [(f"{statistic:<7}  {name}", *cells) for name, *cells in folded(block)]
    print()
    print_table(("motion", *(motion.replace("_", " ") for motion in MOTIONS)), rows)
    if len(bodies) > MOST_ROWS:
        print(f"{len(bodies)} bodies float; --json FILE writes the numbers of all")


def run_scene(path: Path, options: argparse.Namespace) -> tuple[int, dict[str, Any] | None]:
    """Run one scene. Returns the exit status and the summary, or None if nothing was run."""
    recording = None
    if not options.no_record:
        recording = options.record or Path("recordings") / f"{path.stem}.rrd"
    try:
        check_outputs((recording, options.json, options.series), model_files(path))
        if options.series is not None:
            check_ending(options.series)
        compile_in_two()
        with notes_said(options.quiet):
            scene = load(path, options)
            series = None if options.series is None else Series(scene)
            screen = Screen(scene, options.speed or 1.0) if options.view else None
    except (ValueError, OSError) as error:
        return failure(error), None
    tally, status, recorder = Tally(scene, options.warm_up), 0, None
    started = perf_counter()
    consumers = [tally.add]
    consumers += [] if series is None else [series.add]
    try:
        with stops_held() as check, notes_said(options.quiet):
            recorder = open_recorder(recording, scene, options)  # no stop leaves it open
            consumers += [] if recorder is None else [recorder.log]
            started = perf_counter()
            with screen or nullcontext(), recorder or nullcontext():
                run(scene, options, consumers, screen, check)
    except (DivergenceError, ValueError, OSError, Stopped) as error:
        status = failure(error)
        if tally.last is None:
            return status, None
    wall_s = perf_counter() - started
    summary = summarise(scene, tally, wall_s, options, recording, recorder)
    try:
        if series is not None:
            kind, columns = options.series.suffix, series.columns()
            write_whole(options.series, lambda path: write_columns(path, columns, kind))
        write_json(options.json, summary)
    finally:
        if not options.quiet:
            print_summary(summary)
    return status, summary


OUTCOMES = {0: "done", UNUSABLE_INPUT: "refused", DIVERGED: "diverged", UNWRITABLE: "unwritable"}


def print_runs(runs: Sequence[tuple[Path, int, dict[str, Any] | None]]) -> None:
    """Print a table of several runs (path, status, summary)."""
    cells = []
    for path, status, summary in runs:
        numbers = ("", "", "")
        if summary is not None:
            numbers = (
                f"{summary['duration']:.1f}", f"{summary['realtime_factor']:.1f}",
                f"{summary['buoyancy_us_per_step']:.1f}",
            )  # fmt: skip
        cells.append((str(path), OUTCOMES.get(status, "stopped"), *numbers))
    print()
    print_table(("scene", "end", "s", "x real time", "us in buoyancy"), cells)


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    runs = []
    for path in options.scenes:
        runs.append((path, *run_scene(path, options)))
        if runs[-1][1] > 128:  # a signal stops all runs
            break
    if len(options.scenes) > 1 and not options.quiet:
        print_runs(runs)
    return next((status for _, status, _ in runs if status), 0)


if __name__ == "__main__":
    run_script(main)
