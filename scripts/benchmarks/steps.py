"""Steps: the time of a whole `mj_step` with the water, relative to a bare step of the same model.

In a bare step the same bodies fall in air, in a state without water. All calls of a row are timed
in turns and the shortest times count, so ratios hold on a busy machine.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from sim.plugin.refusals import reading
from sim.scenes.scene import Scene

ROUNDS = 12
"""Times that each call is timed; the shortest counts."""

STEPS_PER_CALL = 500
"""Steps per timed call."""

BATCH_SIZE = 64
"""Simulations in a batch."""

BATCH_STEPS = 40
"""Steps of each simulation per timed call."""

SETTLING_STEPS = 1500
"""Steps after which a body has settled in the waves."""

LINK_COUNT = 20

RESISTANCES = {
    "": "",
    ", added mass": '<numeric name="added_mass" data="0.2 0.8 0.8 0 0.1 0.1"/>',
    ", drag": '<numeric name="drag" data="0.2 1 0.005"/>',
}

Row = dict[str, Any]


def step_costs(scenes: Sequence[Path], crowd: Path) -> Iterator[Row]:
    """Yield the rows of the table: each scene without and with its drag and added mass, a chain of
    links, batches of the first scene, and batches of a crowded scene."""
    for path in scenes:
        yield _of_scene(path.stem, without_resistance(path))
        yield _of_scene(f"{path.stem}, drag", Scene.load(path))
    for kind, resistance in RESISTANCES.items():
        yield _of_scene(f"chain of {LINK_COUNT} links{kind}", _chain(resistance))
    for path, count in ((scenes[0], BATCH_SIZE), (crowd, 2)):
        yield from _of_batches(path, count)


def without_resistance(path: Path, settings: Mapping[str, Any] | None = None) -> Scene:
    """A scene without its drag and added mass, and with settings."""
    spec = mujoco.MjSpec.from_file(str(path))
    for numeric in [n for n in spec.numerics if n.name.startswith(("drag", "added_mass"))]:
        spec.delete(numeric)
    return Scene.load(spec, name=path.stem, settings=settings or {})


def _chain(resistance: str) -> Scene:
    """A row of boxes joined by hinges; the first has a free joint."""
    bodies, ends = "", ""
    for i in range(LINK_COUNT):
        joint = '<joint axis="0 1 0" pos="-0.15 0 0" damping="3"/>' if i else "<freejoint/>"
        bodies += f"""<body pos="{0.3 * bool(i)} 0 0">{joint}
            <geom name="g{i}" type="box" size="0.14 0.1 0.05" density="500" contype="0"/>"""
        ends += "</body>"
    listed = "".join(f'<element objtype="geom" objname="g{i}" prm="0"/>' for i in range(LINK_COUNT))
    return Scene.load(
        mujoco.MjSpec.from_string(f"""
        <mujoco><option solver="CG"/><custom>{resistance}
          <numeric name="wave_a" data="0.1 4 0 0"/><numeric name="wave_b" data="0.05 2.4 50 40"/>
          <tuple name="buoyant">{listed}</tuple></custom>
          <worldbody>{bodies}{ends}</worldbody></mujoco>""")
    )


def _seconds_of(*calls: Callable[[], Any]) -> list[float]:
    """The shortest time [s] of each call over ROUNDS rounds, in each of which every call runs
    once."""
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(ROUNDS):
        for call, taken in zip(calls, times, strict=True):
            started = perf_counter()
            call()
            taken.append(perf_counter() - started)
    return [min(taken) for taken in times]


def _of_scene(name: str, scene: Scene) -> Row:
    model, data = scene.model, scene.data
    with reading():  # a state without water
        air = mujoco.MjData(model)

    def bare() -> None:
        mujoco.mj_step(model, air, STEPS_PER_CALL)

    def floating() -> None:
        mujoco.mj_step(model, data, STEPS_PER_CALL)

    mujoco.mj_step(model, data, SETTLING_STEPS)
    with_water, without = (
        1e6 * seconds / STEPS_PER_CALL for seconds in _seconds_of(floating, bare)
    )
    return {"what": name, "us": with_water, "bare_us": without, "ratio": with_water / without}


def _of_batches(path: Path, count: int) -> Iterator[Row]:
    """Yield the time of a scene's simulations one by one and in a batch, with one and two threads.
    All start from the settled scene, each at another time of the sea."""
    from mujoco.batch import Batch  # MuJoCo 3 has a different one

    scene = Scene.load(path)
    data = scene.data
    mujoco.mj_step(scene.model, data, SETTLING_STEPS)
    batches = [Batch(scene.model, nsim=count, nthread=n) for n in (1, 2)]
    for batch in batches:
        for field in ("qpos", "qvel"):
            batch.bind(field)[:] = getattr(data, field)
        batch.bind("time")[:] = data.time + 0.37 * np.arange(count)
    states = [_state_of(scene, data.time + 0.37 * i) for i in range(count)]

    def single() -> None:
        for state in states:
            mujoco.mj_step(scene.model, state, BATCH_STEPS)

    calls = [lambda b=b: b.step(nstep=BATCH_STEPS) for b in batches]
    one_by_one, *of_batches = _seconds_of(single, *calls)
    for threads, seconds in zip((1, 2), of_batches, strict=True):
        yield {
            "what": f"{count} {path.stem} in a batch, {threads} thread{'s' * (threads > 1)}",
            "us": 1e6 * seconds / (count * BATCH_STEPS),
            "single_us": 1e6 * one_by_one / (count * BATCH_STEPS),
            "throughput": one_by_one / seconds,
        }


def _state_of(scene: Scene, time: float) -> mujoco.MjData:
    state = mujoco.MjData(scene.model)
    state.qpos[:], state.qvel[:], state.time = scene.data.qpos, scene.data.qvel, time
    return state
