"""Sweep: a scene run again and again, with other numbers, seeds and starts, and what came of it.

A row of the result is a run: what was set, how it ended, and for each body statistics of its heave
and tilt. Runs that fail are rows too. Rows are kept in a file as they come, so that whoever goes on
later does only what is missing.
"""

import json
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from hashlib import sha256
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from sim.mjcf.faults import Note
from sim.mjcf.files import model_files
from sim.mjcf.floats import first_state
from sim.runs.divergence import DivergenceError
from sim.runs.series import Series
from sim.runs.simulation import check_run, simulate
from sim.runs.statistics import heights, start_times
from sim.scenes.scene import Scene

Row = dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """What all runs of a sweep have in common.

    scene: the file. duration, warm_up [s]: simulated time, and its part that the statistics leave
    out. rate [Hz]: samples a second.
    """

    scene: Path
    duration: float
    warm_up: float
    rate: float

    def as_row(self) -> Row:
        """What tells it from others, the content of the scene's files among it."""
        digest = sha256()
        for path in sorted(model_files(self.scene)):
            digest.update(path.read_bytes())
        return asdict(self) | {"scene": digest.hexdigest()}


@dataclass(frozen=True)
class Run:
    """One run: its number, its settings by name, and the time [s] of the sea at which it begins."""

    number: int
    settings: tuple[tuple[str, str], ...]
    start: float


def runs_of(settings: Sequence[str], seeds: int, starts: int) -> list[Run]:
    """All runs: the product of the values of each setting, "NAME=VALUE,VALUE,...", times seeds and
    starts. Raises ValueError."""
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
    """The row of a run. Scenes that cannot be and states that diverge are said in it."""
    began = perf_counter()
    row: Row = {"run": run.number, **dict(run.settings), "start": run.start, "status": "held"}
    stepping = 0.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Note)  # said once, of the first run
            scene = _scene(plan, run.settings)
        scene = replace(scene, data=first_state(scene.model))  # others may run in it at once
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
    """Of each body, under '<body> <what>': mean, standard deviation, significant and largest height
    of heave [m] and tilt [deg], the mean time between upcrossings of the heave [s], and the mean
    drift [m/s]."""
    found: Row = {}
    for body in bodies:
        chosen = columns["body"] == body
        times = columns["time"][chosen]
        for name in ("heave", "tilt_deg"):
            values = columns[name][chosen]
            high = heights(times, values)
            found |= {
                f"{body} {name} mean": float(values.mean()),
                f"{body} {name} std": float(values.std()),
                f"{body} {name} significant": high.significant,
                f"{body} {name} largest": high.largest,
            }
            if name == "heave":
                found[f"{body} upcrossing period"] = high.period
        for axis in "xy":
            path = columns[axis][chosen]
            found[f"{body} drift {axis}"] = float((path[-1] - path[0]) / (times[-1] - times[0]))
    return found


@lru_cache(maxsize=4)
def _scene(plan: Plan, settings: tuple[tuple[str, str], ...]) -> Scene:
    """The scene of some settings: runs that differ in their starts share it."""
    return Scene.load(plan.scene, settings=[f"{name}={value}" for name, value in settings])


def check_plan(plan: Plan, run: Run) -> None:
    """Raise the ValueError or OSError that the first run would fail with."""
    if plan.warm_up >= plan.duration:
        raise ValueError(
            f"{plan.duration:g} s leave nothing after a warm-up of {plan.warm_up:g} s; run longer"
        )
    check_run(_scene(plan, run.settings), plan.duration, plan.rate)


def kept_rows(path: Path, plan: Plan, runs: Sequence[Run]) -> list[Row]:
    """The rows that an interrupted sweep of the same runs has left, behind its plan; half a row at
    the end of the file is taken away, so that more can follow. Raises ValueError for rows of
    another one."""
    if not path.exists():
        return []
    head, *rows = list(_whole_lines(path)) or [{}]
    for name, value in plan.as_row().items():
        if head and head.get(name) != value:
            raise ValueError(
                f"{path} has rows of another sweep, whose {name} is not the same; remove it or "
                "give its options"
            )
    for row in rows:
        run = runs[row["run"]] if row["run"] < len(runs) else None
        if run is None or not row.items() >= {**dict(run.settings), "start": run.start}.items():
            raise ValueError(f"{path} has rows of another sweep; remove it or give its options")
    whole = path.read_bytes().rfind(b"\n") + 1
    if whole < path.stat().st_size:
        os.truncate(path, whole)
    return rows


def _whole_lines(path: Path) -> Iterator[Row]:
    """The rows of a file whose last line may have been cut off."""
    for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
        if line.endswith("\n"):
            yield json.loads(line)


def as_columns(rows: Sequence[Row]) -> dict[str, Any]:
    """Rows, in the order of their runs, as columns; NaN or "" for what a row does not have."""
    rows = sorted(rows, key=lambda row: row["run"])
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {}
    for name in names:
        values = [row.get(name) for row in rows]
        is_text = any(isinstance(value, str) for value in values)
        missing = "" if is_text else np.nan
        columns[name] = np.array([missing if v is None else v for v in values])
    return columns
