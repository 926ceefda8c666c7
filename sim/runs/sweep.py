"""Sweep: many runs of a scene with different settings, seeds and start times, and their results.

The result has a row per run: its settings, its status, and statistics of each body's heave and
tilt. Failed runs have rows too. Rows are saved as they are finished, so a later sweep can do the
missing runs.
"""

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from hashlib import sha256
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from sim.mjcf.files import model_files
from sim.mjcf.floats import first_state
from sim.notes import Note
from sim.runs.divergence import DivergenceError
from sim.runs.series import Series
from sim.runs.simulation import check_run, simulate
from sim.runs.statistics import heights, start_times
from sim.scenes.scene import Scene

Row = dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """The settings that all runs of a sweep share.

    scene: an MJCF file. duration [s]: simulated time. warm_up [s]: the first part of the duration,
    which the statistics ignore. rate [Hz]: samples per second.
    """

    scene: Path
    duration: float
    warm_up: float
    rate: float

    def as_row(self) -> Row:
        """The plan for comparison with other plans, with a hash of the scene's files as scene."""
        digest = sha256()
        for path in sorted(model_files(self.scene)):
            digest.update(path.read_bytes())
        return asdict(self) | {"scene": digest.hexdigest()}


@dataclass(frozen=True)
class Run:
    """A run: its number, its (name, value) settings, and the time [s] of the sea at its start."""

    number: int
    settings: tuple[tuple[str, str], ...]
    start: float


def runs_of(settings: Sequence[str], seeds: int, starts: int) -> list[Run]:
    """All runs: every combination of the settings' values, seeds and start times.

    settings: strings "NAME=VALUE,VALUE,...". seeds: the number of seeds, 0 to keep the scene's
    seed. starts: the number of start times. Raises ValueError for other strings.
    """
    axes: list[list[tuple[str, str]]] = []
    for setting in settings:
        name, equals, values = setting.partition("=")
        if not equals or not name.strip() or not all(v.strip() for v in values.split(",")):
            raise ValueError(f"setting '{setting}': expected NAME=VALUE,VALUE,...")
        axes.append([(name.strip(), value.strip()) for value in values.split(",")])
    if seeds:
        axes.append([("seed", str(seed)) for seed in range(seeds)])
    combinations = product(product(*axes), start_times(starts))
    return [Run(number, chosen, start) for number, (chosen, start) in enumerate(combinations)]


def perform(plan: Plan, run: Run) -> Row:
    """Execute a run and return its row; its status begins with held, diverged or refused."""
    began = perf_counter()
    row: Row = {"run": run.number, **dict(run.settings), "start": run.start, "status": "held"}
    stepping = 0.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Note)  # check_plan shows the notes
            scene = _scene(plan, run.settings)
        scene = replace(scene, data=first_state(scene.model))  # other threads may share the scene
        scene.data.time += run.start
        series = Series(scene)
        for sample in simulate(scene, plan.duration, plan.rate):
            stepping = sample.step_seconds
            if sample.time - run.start >= plan.warm_up:
                series.add(sample)
        row |= statistics_of(series.columns(), scene.buoyancy.body_names)
    except DivergenceError as error:
        row["status"] = f"diverged: {error}"
    except ValueError as error:
        row["status"] = f"refused: {' '.join(str(error).split())}"
    return row | {"seconds": perf_counter() - began, "stepping_seconds": stepping}


def statistics_of(columns: Mapping[str, Any], bodies: Sequence[str]) -> Row:
    """Statistics of each body, under names that begin with the body's name.

    They are the mean, standard deviation, significant and largest height of heave [m] and tilt
    [deg], the mean time [s] between upcrossings of the heave, and the mean drift [m/s].
    """
    row: Row = {}
    for body in bodies:
        of_body = columns["body"] == body
        times = columns["time"][of_body]
        for name in ("heave", "tilt_deg"):
            values = columns[name][of_body]
            high = heights(times, values)
            row |= {
                f"{body} {name} mean": float(values.mean()),
                f"{body} {name} std": float(values.std()),
                f"{body} {name} significant": high.significant,
                f"{body} {name} largest": high.largest,
            }
            if name == "heave":
                row[f"{body} upcrossing period"] = high.period
        for axis in "xy":
            path = columns[axis][of_body]
            row[f"{body} drift {axis}"] = float((path[-1] - path[0]) / (times[-1] - times[0]))
    return row


@lru_cache(maxsize=4)
def _scene(plan: Plan, settings: tuple[tuple[str, str], ...]) -> Scene:
    """The scene with some settings. Runs that differ only in their start times share it."""
    return Scene.load(plan.scene, settings=[f"{name}={value}" for name, value in settings])


def check_plan(plan: Plan, run: Run) -> None:
    """Raise the ValueError or OSError with which a run would fail."""
    if plan.warm_up >= plan.duration:
        raise ValueError(
            f"a run of {plan.duration:g} s has nothing left after a warm-up of {plan.warm_up:g} s; "
            "run longer"
        )
    check_run(_scene(plan, run.settings), plan.duration, plan.rate)


def kept_rows(path: Path, plan: Plan, runs: Sequence[Run]) -> list[Row]:
    """The rows that an interrupted sweep of the same runs saved in a file, after its plan.

    An incomplete last line is cut off, so that rows can be appended. Raises ValueError if the rows
    belong to another sweep.
    """
    if not path.exists():
        return []
    text = path.read_bytes()
    whole = text.rfind(b"\n") + 1
    head, *rows = [json.loads(line) for line in text[:whole].splitlines()] or [{}]
    for name, value in plan.as_row().items():
        if head and head.get(name) != value:
            raise ValueError(
                f"{path} has rows of a sweep with another {name}; remove it or use its options"
            )
    for row in rows:
        run = runs[row["run"]] if row["run"] < len(runs) else None
        if run is None or not row.items() >= {**dict(run.settings), "start": run.start}.items():
            raise ValueError(f"{path} has rows of another sweep; remove it or use its options")
    os.truncate(path, whole)
    return rows


def as_columns(rows: Sequence[Row]) -> dict[str, Any]:
    """Rows as columns, in the order of the runs; NaN or "" where a row lacks a value."""
    rows = sorted(rows, key=lambda row: row["run"])
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {}
    for name in names:
        values = [row.get(name) for row in rows]
        is_text = any(isinstance(value, str) for value in values)
        missing = "" if is_text else np.nan
        columns[name] = np.array([missing if v is None else v for v in values])
    return columns
