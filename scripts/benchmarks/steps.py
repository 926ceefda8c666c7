"""Steps: what a whole `mj_step` costs with the water, in bare ones of the same model.

A bare step is that of the same model in a state without water, its bodies falling in the air. All
of a row is measured in turns, and minima of the turns count, so ratios hold on a busy machine.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from sim.plugin.refusals import reading
from sim.scenes.scene import Scene

TURNS = 12

STEPS = 500
"""Steps in one call."""

BATCH = 64
"""Simulations of a batch; each turn takes BATCH_STEPS of each."""

BATCH_STEPS = 40

SETTLED = 1500
"""Steps after which a body floats as it will."""

LINKS = 20

RESISTANCES = {
    "": "",
    ", added mass": '<numeric name="added_mass" data="0.2 0.8 0.8 0 0.1 0.1"/>',
    ", drag": '<numeric name="drag" data="0.2 1 0.005"/>',
}

Row = dict[str, Any]


def step_costs(scenes: Sequence[Path], crowd: Path) -> Iterator[Row]:
    """Rows of the table: a body's step with and without what its scene asks for, a chain of links,
    batches of the first scene's body, and two batches of a crowded scene."""
    for path in scenes:
        yield _of_scene(path.stem, _without_resistance(path))
        yield _of_scene(f"{path.stem}, drag", Scene.load(path))
    for kind, resistance in RESISTANCES.items():
        yield _of_scene(f"chain of {LINKS} links{kind}", _chain(resistance))
    for path, count in ((scenes[0], BATCH), (crowd, 2)):
        yield from _of_batches(path, count)


def _without_resistance(path: Path) -> Scene:
    spec = mujoco.MjSpec.from_file(str(path))
    for numeric in [n for n in spec.numerics if n.name.startswith(("drag", "added_mass"))]:
        spec.delete(numeric)
    return Scene.load(spec, name=path.stem)


def _chain(resistance: str) -> Scene:
    """Boxes on hinges, one behind the other, the first on a free joint."""
    bodies, ends = "", ""
    for i in range(LINKS):
        joint = '<joint axis="0 1 0" pos="-0.15 0 0" damping="3"/>' if i else "<freejoint/>"
        bodies += f"""<body pos="{0.3 * bool(i)} 0 0">{joint}
            <geom name="g{i}" type="box" size="0.14 0.1 0.05" density="500" contype="0"/>"""
        ends += "</body>"
    listed = "".join(f'<element objtype="geom" objname="g{i}" prm="0"/>' for i in range(LINKS))
    return Scene.load(
        mujoco.MjSpec.from_string(f"""
        <mujoco><option solver="CG"/><custom>{resistance}
          <numeric name="wave_a" data="0.1 4 0 0"/><numeric name="wave_b" data="0.05 2.4 50 40"/>
          <tuple name="buoyant">{listed}</tuple></custom>
          <worldbody>{bodies}{ends}</worldbody></mujoco>""")
    )


def _seconds_of(*calls: Callable[[], Any]) -> list[float]:
    """The shortest time of each call, taken in turns."""
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(TURNS):
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
        mujoco.mj_step(model, air, STEPS)

    def floating() -> None:
        mujoco.mj_step(model, data, STEPS)

    mujoco.mj_step(model, data, SETTLED)
    with_water, without = (1e6 * seconds / STEPS for seconds in _seconds_of(floating, bare))
    return {"what": name, "us": with_water, "bare_us": without, "ratio": with_water / without}


def _of_batches(path: Path, count: int) -> Iterator[Row]:
    """A scene's simulations, one by one and in a batch on one and on two threads, a step of each;
    all begin as the scene floats, each at its own time of the sea."""
    from mujoco.batch import Batch  # MuJoCo 3 has another

    scene = Scene.load(path)
    data = scene.data
    mujoco.mj_step(scene.model, data, SETTLED)
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
