"""Run one scene with several methods at once and say whether they make a difference.

    python scripts/compare.py models/cube.xml --methods linear chord:4

Each method moves a twin of the scene in the same water, all stepped together and drawn side by side
in one recording. What is compared are means over the time after the warm-up: the paths
themselves drift apart in waves from any difference, however small.

Exit status: 0 on success, 2 on unusable input, 3 when a twin diverged, 130 after Ctrl-C
(what was recorded until then is on disk).
"""

import argparse
import json
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from command_line import (
    DIVERGED,
    INTERRUPTED,
    UNUSABLE_INPUT,
    Parser,
    clear_progress,
    compiling_notice,
    positive,
    show_progress,
)
from sim import DivergenceError, Sample, Scene, SideBySideRecorder, simulate
from sim.accuracy import FEWEST_BATCHES, mean_of_correlated
from sim.simulation import observe

QUANTITIES = {"height_m": 1e3, "tilt_deg": 1.0}
"""What is averaged, and what turns its differences into the mm and degrees that are printed."""

MEASURABLE = 3.0
"""Standard errors from zero at which a difference is said to be measured: with some sixteen batches
chance alone does that once in a hundred times."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="compare.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, metavar="SCENE", help="an MJCF file")
    parser.add_argument("--methods", nargs="+", required=True, metavar="METHOD",
                        help="method texts; the others are held against the first")  # fmt: skip
    parser.add_argument("--duration", type=positive, default=60.0, metavar="S",
                        help="simulated seconds (60)")  # fmt: skip
    parser.add_argument("--warm-up", type=positive, default=10.0, metavar="S",
                        help="seconds that the means leave out (10)")  # fmt: skip
    parser.add_argument("--rate", type=positive, default=30.0, metavar="HZ",
                        help="samples a simulated second (30)")  # fmt: skip
    parser.add_argument("--timestep", type=positive, metavar="S",
                        help="overrules the scene's timestep")  # fmt: skip
    record = parser.add_mutually_exclusive_group()
    record.add_argument("--record", type=Path, metavar="FILE.rrd",
                        help="default recordings/<scene>_twins.rrd")  # fmt: skip
    record.add_argument("--no-record", action="store_true", help="write no recording")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the summary there")
    return parser.parse_args(arguments)


def load(options: argparse.Namespace) -> dict[str, Scene]:
    """A twin of the scene for each method, by its label, kernels compiled."""
    samples = (options.duration - options.warm_up) * options.rate
    if samples < FEWEST_BATCHES:
        raise ValueError(
            f"{options.duration:g} s leave {max(samples, 0):.0f} samples after a warm-up of "
            f"{options.warm_up:g} s, and means need {FEWEST_BATCHES}; run longer"
        )
    twins: dict[str, Scene] = {}
    with compiling_notice(quiet=False):
        for text in options.methods:
            scene = Scene.load(options.scene, text, timestep=options.timestep)
            observe(scene)
            same = sum(label.split(" ")[0] == text for label in twins)
            twins[f"{text} ({same + 1})" if same else text] = scene
    return twins


class History:
    """Heights [m] and tilts [deg] of all bodies of all twins, sample after sample."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.last: tuple[Sample, ...] = ()
        self._rows: list[np.ndarray] = []

    def add(self, samples: tuple[Sample, ...]) -> None:
        self.times.append(samples[0].time)
        self.last = samples
        self._rows.append(np.array([[s.centres[:, 2], np.degrees(s.tilts)] for s in samples]))

    def after(self, warm_up: float) -> np.ndarray:
        """(N, twins, quantities, bodies), without the warm-up [s]."""
        return np.array(self._rows)[np.array(self.times) > warm_up - 1e-9]


def run(
    twins: Mapping[str, Scene],
    options: argparse.Namespace,
    recorder: SideBySideRecorder | None,
    history: History,
) -> int:
    """Simulate all twins in lockstep; return the exit status."""
    show = sys.stderr.isatty()
    status, trouble = 0, ""
    runs = [simulate(scene, options.duration, options.rate) for scene in twins.values()]
    try:
        for samples in zip(*runs, strict=True):
            history.add(samples)
            if recorder is not None:
                recorder.log(samples)
            if show:
                show_progress(samples[0].time, options.duration)
    except DivergenceError as error:
        status, trouble = DIVERGED, str(error)
    except KeyboardInterrupt:
        status, trouble = INTERRUPTED, "interrupted"
    if show:
        clear_progress()
    if trouble:
        print(f"compare.py: {trouble}", file=sys.stderr)
    return status


def summarise(
    twins: Mapping[str, Scene], options: argparse.Namespace, history: History
) -> dict[str, Any]:
    """The comparison in numbers, under the keys of --json."""
    labels, first = list(twins), next(iter(twins.values()))
    summary: dict[str, Any] = {
        "scene": first.name,
        "timestep": first.model.opt.timestep,
        "duration": history.times[-1],
        "warm_up": options.warm_up,
        "rate": options.rate,
        "methods": labels,
        "buoyancy_us_per_step": {
            label: 1e6 * sample.buoyancy_seconds / max(sample.step, 1)
            for label, sample in zip(labels, history.last, strict=True)
        },
        "means": {},
        "differences": {},
    }
    values = history.after(options.warm_up)
    if len(values) < FEWEST_BATCHES:  # the run ended early
        return summary
    for b, body in enumerate(first.buoyancy.body_names):
        of_twins = {label: values[:, i, :, b] for i, label in enumerate(labels)}
        summary["means"][body] = {label: _means(v) for label, v in of_twins.items()}
        summary["differences"][body] = {
            label: _means(v - of_twins[labels[0]])
            | {"metres_apart": _apart(history.last[0], history.last[i], b)}
            for i, (label, v) in enumerate(of_twins.items())
            if i > 0
        }
    return summary


def _means(values: np.ndarray) -> dict[str, Any]:
    """Means of the quantities (N, quantities) with all that is known of their errors, and the
    largest value on the way."""
    return {
        name: asdict(mean_of_correlated(values[:, q]))
        | {"largest": float(np.abs(values[:, q]).max())}
        for q, name in enumerate(QUANTITIES)
    }


def _apart(one: Sample, other: Sample, body: int) -> float:
    """Distance [m] between two twins of a body."""
    return float(np.linalg.norm(one.centres[body] - other.centres[body]))


def print_summary(summary: dict[str, Any]) -> None:
    print(
        f"{summary['scene']}: {summary['duration']:g} s at {summary['timestep']:g} s a step, means "
        f"from {summary['warm_up']:g} s on, +- standard errors by batch means\n"
    )
    for label, microseconds in summary["buoyancy_us_per_step"].items():
        print(f"{label}: {microseconds:.1f} us of buoyancy a step")
    width = max(len(label) for label in summary["methods"])
    for body, means in summary["means"].items():
        print(f"\n{body:<{width}}              height m                    tilt deg")
        for label, mean in means.items():
            cells = [f"{m['value']:11.5f} +- {m['error']:.5f}" for m in mean.values()]
            print(f"{label:<{width}}  {cells[0]}     {cells[1]}")
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
        return "undecided: still correlated over the longest batches, run longer"
    sure = abs(difference["value"]) > MEASURABLE * difference["error"]
    return "measured" if sure else "not measurable"


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    recording = None
    if not options.no_record:
        recording = options.record or Path("recordings") / f"{options.scene.stem}_twins.rrd"
    try:
        twins = load(options)
        if options.json is not None:
            options.json.open("a").close()
        recorder = None if recording is None else SideBySideRecorder(recording, twins)
    except (ValueError, OSError) as error:
        print(f"compare.py: {error}", file=sys.stderr)
        return UNUSABLE_INPUT
    history = History()
    started = perf_counter()
    with recorder or nullcontext():
        status = run(twins, options, recorder, history)
    summary = summarise(twins, options, history)
    summary["wall_s"] = perf_counter() - started
    summary["recording"] = None if recording is None else str(recording)
    if options.json is not None:
        options.json.write_text(json.dumps(summary, indent=2) + "\n")
    print_summary(summary)
    if recording is not None:
        print(f"\nrecorded {recording.stat().st_size / 1e6:.1f} MB: {recording}")
    return status


if __name__ == "__main__":
    sys.exit(main())
