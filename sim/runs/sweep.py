"""Sweep: many runs of a scene with different settings, seeds and start times, and their results.

The result has a row per run: its settings, its status, and statistics of each body's heave and
tilt. Failed runs have rows too. Rows are saved as they are finished, so a later sweep can do the
missing runs.
"""

import json
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

TIMES = "seconds", "stepping_seconds"
"""Columns with the wall times [s] of a run, in all and for its steps."""


@dataclass(frozen=True)
class Plan:
    """The settings that all runs of a sweep share.

    scene: an MJCF or URDF file. duration [s]: simulated time. warm_up [s]: the first part of the
    duration, which the statistics ignore. rate [Hz]: samples per second. buoyant, densities,
    timestep, keyframe: as in `Scene.load`.
    """

    scene: Path
    duration: float
    warm_up: float
    rate: float
    buoyant: tuple[str, ...] = ()
    densities: tuple[tuple[str, float], ...] = ()
    timestep: float | None = None
    keyframe: str | None = None

    def as_row(self) -> Row:
        """The plan for comparison with other plans: numbers and texts, with a hash of the scene's
        files as scene."""
        digest = sha256()
        for path in sorted(model_files(self.scene)):
            digest.update(path.read_bytes())
        values = asdict(self) | {"scene": digest.hexdigest()}
        return {name: v if isinstance(v, float) else str(v) for name, v in values.items()}


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
        scene = replace(
            scene, data=first_state(scene.model, plan.keyframe)
        )  # other threads may share the scene
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
    return row | dict(zip(TIMES, (perf_counter() - began, stepping), strict=True))


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
    return Scene.load(
        plan.scene,
        buoyant=plan.buoyant,
        settings=[f"{name}={value}" for name, value in settings],
        densities=dict(plan.densities),
        timestep=plan.timestep,
        keyframe=plan.keyframe,
    )


def check_plan(plan: Plan, run: Run) -> None:
    """Raise the ValueError or OSError with which a run would fail."""
    check_run(_scene(plan, run.settings), plan.duration, plan.rate, plan.warm_up)


def kept_rows(text: bytes, plan: Plan, runs: Sequence[Run]) -> tuple[list[Row], int]:
    """The rows that an interrupted sweep of the same runs saved after its plan, and the number of
    bytes that they take. An incomplete last line is not counted.

    Raises ValueError if the text is something else, or the rows belong to another sweep.
    """
    whole = text.rfind(b"\n") + 1
    head, *rows = [_read_row(line, i) for i, line in enumerate(text[:whole].splitlines(), 1)] or [
        {}
    ]
    for name, value in plan.as_row().items():
        if head and head.get(name) != value:
            raise ValueError(f"it has rows of a sweep with another {name}")
    by_number, found = {run.number: run for run in runs}, set()
    for line, row in enumerate(rows, start=2):
        run = by_number.get(row.get("run", -1))
        if run is None or not row.items() >= {**dict(run.settings), "start": run.start}.items():
            raise ValueError("it has rows of another sweep")
        texts = {"status", *dict(run.settings)}
        is_whole = row.keys() >= {*texts, *TIMES}
        if not is_whole or any(isinstance(row[n], str) != (n in texts) for n in row):
            raise ValueError(f"its line {line} is not the row of a run")
        if run.number in found:
            raise ValueError(f"its line {line} is a second row of run {run.number}")
        found.add(run.number)
    return rows, whole


def _read_row(line: bytes, number: int) -> Row:
    try:
        row = json.loads(line)
    except ValueError:
        row = None
    if not isinstance(row, dict) or not all(isinstance(v, str | float | int) for v in row.values()):
        raise ValueError(f"its line {number} is not the row of a run")
    return row


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
