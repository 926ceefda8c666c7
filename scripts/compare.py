"""Run one scene with several methods and print whether their results differ.

    python scripts/compare.py models/cube.xml --methods linear chord:4

Each method has a twin of the scene in the same water. The twins are stepped together and drawn side
by side in one recording. Means after the warm-up are compared, because in waves paths drift apart
from any difference, however small. If a body has several rests and stays in one for long, one run
is not representative: --starts adds runs at other times.

Exit status: 0 on success, 2 on unusable input, 3 if a twin diverged, 4 if a file cannot be written,
130 after Ctrl-C, 143 after SIGTERM. The recording until then is on disk.
"""

import argparse
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from command_line import (
    Parser,
    Progress,
    Stopped,
    add_averaging_options,
    add_scene_options,
    at_least,
    check_outputs,
    compile_in_two,
    failure,
    notes_said,
    print_table,
    run_script,
    scene_options,
    stops_held,
    write_json,
)
from labels import fields_of
from sim import DivergenceError, Sample, Scene, SideBySideRecorder, simulate
from sim.mjcf.elements import prefixes_of
from sim.mjcf.fields import METHOD
from sim.mjcf.files import model_files
from sim.runs.simulation import check_run
from sim.runs.statistics import (
    FEWEST_BATCHES,
    mean_of_correlated,
    mean_of_runs,
    start_times,
)
from sim.scenes.spec import read_spec

QUANTITIES = {"height_m": 1e3, "tilt_deg": 1.0}
"""The averaged quantities, and the factors that convert their differences to mm and degrees."""

MEASURABLE_ERRORS = 3.0
"""Smallest measured difference, in standard errors. With about sixteen batches chance exceeds it
once in a hundred times."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("scene", type=Path, metavar="SCENE", help="an MJCF file")
    parser.add_argument("--methods", nargs="+", required=True, metavar="METHOD",
                        help="METHOD[:NUMBER][/PRESSURE], for example chord:4 or "
                        "patches:1e-3/hydrostatic; the first is the baseline")  # fmt: skip
    add_averaging_options(parser, rate=30.0)
    parser.add_argument("--starts", type=at_least(1), default=1, metavar="N",
                        help="runs; later runs begin at random times of the sea (1)")  # fmt: skip
    add_scene_options(parser)
    record = parser.add_mutually_exclusive_group()
    record.add_argument("--record", type=Path, metavar="FILE.rrd",
                        help="recording (recordings/<scene>_twins.rrd)")  # fmt: skip
    record.add_argument("--no-record", action="store_true", help="write no recording")
    parser.add_argument("--json", type=Path, metavar="FILE", help="file for the summary")
    return parser.parse_args(arguments)


def load(options: argparse.Namespace) -> dict[str, Scene]:
    """A twin of the scene for each method, by its label."""
    samples = (options.duration - options.warm_up) * options.rate
    if samples < FEWEST_BATCHES:
        raise ValueError(
            f"{options.duration:g} s leave {max(samples, 0):.0f} samples after a warm-up of "
            f"{options.warm_up:g} s, and means need {FEWEST_BATCHES}; run "
            "longer (--duration) or warm up for less time (--warm-up)"
        )
    twins: dict[str, Scene] = {}
    for label in options.methods:
        scene = load_twin(options, label)
        equal = sum(other.split(" ")[0] == label for other in twins)
        twins[f"{label} ({equal + 1})" if equal else label] = scene
    return twins


def load_twin(options: argparse.Namespace, label: str) -> Scene:
    """The scene with the method of a label for all of its hulls."""
    fields = fields_of(label)
    spec = read_spec(options.scene)
    names = [text.name for text in spec.texts if METHOD in text.name]
    prefixes = prefixes_of(listing.name for listing in spec.tuples)
    methods = dict.fromkeys([*names, *(prefix + METHOD for prefix in prefixes)], fields[METHOD])
    settings = [f"{name}={value}" for name, value in (fields | methods).items()]
    return Scene.load(
        options.scene, settings=[*options.settings, *settings], **scene_options(options)
    )


class History:
    """Heights [m] and tilts [deg] of all bodies of all twins in all samples of all runs."""

    def __init__(self, twins: int, timestep: float) -> None:
        self.timestep = timestep
        self.last: tuple[Sample, ...] = ()
        self.steps = 0
        self.buoyancy_seconds = np.zeros(twins)
        self._runs: list[list[np.ndarray]] = []
        self._ages: list[list[float]] = []

    @property
    def duration(self) -> float:
        """Simulated seconds of the last run."""
        return self._ages[-1][-1]

    def begin(self) -> None:
        """Begin the next run."""
        self._runs.append([])
        self._ages.append([])

    def add(self, samples: tuple[Sample, ...]) -> None:
        # from steps, because the round-off of times differs between starts
        self._ages[-1].append(samples[0].step * self.timestep)
        self._runs[-1].append(np.array([[s.centres[:, 2], np.degrees(s.tilts)] for s in samples]))
        self.last = samples

    def end(self) -> None:
        """Add the steps of the run and their wall time to the sums."""
        if self.last:
            self.steps += self.last[0].step
            self.buoyancy_seconds += [s.buoyancy_seconds for s in self.last]

    def after(self, warm_up: float) -> list[np.ndarray]:
        """An array (N, twins, quantities, bodies) for each run, without the warm-up [s] and without
        runs that are too short for means."""
        values = [
            np.array(run)[np.array(ages) > warm_up - 1e-9]
            for run, ages in zip(self._runs, self._ages, strict=True)
            if run
        ]
        return [v for v in values if len(v) >= FEWEST_BATCHES]


def run(
    twins: Mapping[str, Scene],
    options: argparse.Namespace,
    recorder: SideBySideRecorder | None,
    history: History,
    check: Callable[[], None],
) -> None:
    """Simulate all twins in lockstep from each start, and check whether to stop. The first run is
    recorded."""
    with Progress(options.starts * options.duration, "s") as bar:
        for i, time in enumerate(start_times(options.starts)):
            if i > 0:
                with notes_said(quiet=True):
                    twins = load(options)
            for scene in twins.values():
                scene.data.time = time
            runs = [simulate(scene, options.duration, options.rate) for scene in twins.values()]
            history.begin()
            try:
                for samples in zip(*runs, strict=True):
                    history.add(samples)
                    if recorder is not None and i == 0:
                        recorder.log(samples)
                    bar.update(i * options.duration + history.duration - bar.n)
                    check()
            finally:
                history.end()


def summarise(
    twins: Mapping[str, Scene], options: argparse.Namespace, history: History
) -> dict[str, Any]:
    """The summary of the comparison, with the keys of --json."""
    labels, first = list(twins), next(iter(twins.values()))
    microseconds = 1e6 * history.buoyancy_seconds / max(history.steps, 1)
    summary: dict[str, Any] = {
        "scene": first.name,
        "timestep": first.model.opt.timestep,
        "duration": history.duration,
        "starts": options.starts,
        "warm_up": options.warm_up,
        "rate": options.rate,
        "methods": labels,
        "buoyancy_us_per_step": dict(zip(labels, microseconds.tolist(), strict=True)),
        "means": {},
        "differences": {},
    }
    runs = history.after(options.warm_up)
    if len(runs) < options.starts:  # ended early
        return summary
    last = history.last
    for b, body in enumerate(first.buoyancy.body_names):
        of_twins = {label: [v[:, i, :, b] for v in runs] for i, label in enumerate(labels)}
        baseline = of_twins[labels[0]]
        summary["means"][body] = {label: _means(series) for label, series in of_twins.items()}
        summary["differences"][body] = {
            label: _means([v - base for v, base in zip(series, baseline, strict=True)])
            | {"metres_apart": float(np.linalg.norm(last[i].centres[b] - last[0].centres[b]))}
            for i, (label, series) in enumerate(of_twins.items())
            if i > 0
        }
    return summary


def _means(runs: list[np.ndarray]) -> dict[str, Any]:
    """Means of the quantities over all runs, each (N, quantities), with their errors and the
    largest absolute values."""
    means = {}
    for q, name in enumerate(QUANTITIES):
        series = [values[:, q] for values in runs]
        mean = mean_of_correlated(series[0]) if len(series) == 1 else mean_of_runs(series)
        means[name] = asdict(mean) | {"largest": float(np.abs(series).max())}
    return means


def print_summary(summary: dict[str, Any]) -> None:
    print(
        f"{summary['scene']}: {summary['starts']} x {summary['duration']:.5g} s at "
        f"{summary['timestep']:g} s a step, means from {summary['warm_up']:g} s on, +- standard "
        "errors by batch means\n"
    )
    for label, microseconds in summary["buoyancy_us_per_step"].items():
        print(f"{label}: {microseconds:.1f} us of buoyancy a step")
    for body, means in summary["means"].items():
        print()
        rows = [
            (label, *(f"{m['value']:.5f} +- {m['error']:.5f}" for m in mean.values()))
            for label, mean in means.items()
        ]
        print_table((body, "height m", "tilt deg"), rows)
    for body, differences in summary["differences"].items():
        for label, difference in differences.items():
            print(f"\n{body}, {label} minus {summary['methods'][0]}:")
            _print_difference(difference, summary["rate"])


def _print_difference(difference: dict[str, Any], rate: float) -> None:
    for (name, factor), unit in zip(QUANTITIES.items(), ("mm", "deg"), strict=True):
        d = difference[name]
        value, error = factor * d["value"], factor * d["error"]
        print(
            f"  {name.split('_')[0]:<6} {value:+.2g} +- {error:.1g} {unit}, {_verdict(d)}; at most "
            f"{factor * d['largest']:.2g} {unit}; {d['batches']} batches of "
            f"{d['batch'] / rate:.2g} s"
        )
    print(f"  at the end {difference['metres_apart']:.2g} m apart")


def _verdict(difference: dict[str, Any]) -> str:
    if difference["largest"] == 0.0:
        return "identical"
    if not difference["settled"]:
        return (
            "undecided: still correlated over the longest batches; run longer (--duration), or "
            "raise --warm-up if the start still shows"
        )
    is_measured = abs(difference["value"]) > MEASURABLE_ERRORS * difference["error"]
    return "measured" if is_measured else "not measurable"


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    recording = None
    if not options.no_record:
        recording = options.record or Path("recordings") / f"{options.scene.stem}_twins.rrd"
    try:
        check_outputs((recording, options.json), model_files(options.scene))
        compile_in_two()
        with notes_said():
            twins = load(options)
            first = next(iter(twins.values()))
            check_run(first, options.duration, options.rate)
    except (ValueError, OSError) as error:
        return failure(error)
    history, status, started = History(len(twins), first.model.opt.timestep), 0, perf_counter()
    try:
        with stops_held() as check, notes_said():  # no stop leaves the recorder open
            recorder = None if recording is None else SideBySideRecorder(recording, twins)
            started = perf_counter()
            with recorder or nullcontext():
                run(twins, options, recorder, history, check)
    except (DivergenceError, ValueError, OSError, Stopped) as error:
        status = failure(error)
        if not history.last:
            return status
    summary = summarise(twins, options, history)
    summary["wall_s"] = perf_counter() - started
    summary["recording"] = None if recording is None else str(recording)
    try:
        write_json(options.json, summary)
    finally:
        print_summary(summary)
    if recording is not None and recording.is_file():
        print(f"\nrecorded {recording.stat().st_size / 1e6:.1f} MB: {recording}")
    return status


if __name__ == "__main__":
    run_script(main)
