"""What the fields of the water's resistance and response cost.

    python scripts/benchmarks/responses.py [--quick]

Two tables: a whole step of the bunny with a field, over the step without it; and, in seas of many
waves, the water's time in a step of a barge with memory and diffraction. --quick: the first only.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time

import mujoco
import numpy as np

sys.path[:0] = [str(Path(__file__).parents[level]) for level in (1, 2)]

from benchmarks.steps import without_resistance
from sim.resistance.hydrodynamics import Hydrodynamics
from sim.scenes.buoyancy import Buoyancy
from sim.scenes.spec import add_water

BUNNY = Path(__file__).parents[2] / "models" / "bunny.xml"
BARGE = """<mujoco><option timestep="0.005"/><worldbody><body name="barge"><freejoint/><body/>
  <geom name="barge" type="box" size="5 2 0.5" density="512"/></body></worldbody></mujoco>"""

STEPS, ROUNDS = 200, 7
"""Steps that are timed together, and how often; the fastest counts."""

FIELD_STEPS, FIELD_ROUNDS, SETTLING_STEPS = 100, 150, 1000
"""Steps of the bunny that are timed together, from the same state in turns with and without a
field; how often; and steps before, in which it settles. Time of the thread, which other programs
do not count in; the fastest counts."""

HEADINGS, FREQUENCIES = 12, 30
"""Numbers of headings and frequencies in the file."""

FULL = tuple(0.01 * np.eye(6).ravel())
DRAG: dict[str, object] = {"drag": (0.2, 1.0, 0.005)}


def made(path: Path, columns: int) -> None:
    """Write random coefficients with a number of columns of the memory; they cost what real ones
    cost."""
    rng = np.random.default_rng(0)
    memory = np.hstack([rng.uniform(0.5, 2.0, (columns, 2)), rng.normal(size=(columns, 6))])
    shape = FREQUENCIES, HEADINGS, 6
    Hydrodynamics(
        np.zeros(3), np.eye(3), np.diag([1e3] * 6), memory, np.linspace(0.2, 8.0, FREQUENCIES),
        np.linspace(0.0, 2.0 * np.pi, HEADINGS, endpoint=False),
        rng.normal(size=shape) + 1j * rng.normal(size=shape), 1025.0, 9.81,
    ).save(path)  # fmt: skip


def microseconds(fields: Mapping[str, object]) -> float:
    """Time [us] of the water in a step of the barge, with custom fields."""
    spec = mujoco.MjSpec.from_string(BARGE)
    model = add_water(spec, "barge", **fields).compile()  # type: ignore[arg-type]
    data, water = mujoco.MjData(model), Buoyancy.of(model)
    mujoco.mj_step(model, data, nstep=100)
    times = []
    for _ in range(ROUNDS):
        before = water.seconds(data)
        mujoco.mj_step(model, data, nstep=STEPS)
        times.append(water.seconds(data) - before)
    return 1e6 * min(times) / STEPS


def print_fields(file: Path) -> None:
    """A step of the bunny in three waves with each field, over the step without it. file: with
    coefficients."""
    cases: dict[str, tuple[dict[str, object], dict[str, object]]] = {
        "`drag`": ({}, DRAG),
        "`added_mass`, 6 numbers": ({}, {"added_mass": (0.2, 0.8, 0.8, 0.0, 0.1, 0.1)}),
        "`damping`": ({}, {"damping": (1.0,) * 6}),
        "`added_mass` and `damping`, 36 numbers": ({}, {"added_mass": FULL, "damping": FULL}),
        "`drag`, `added_mass` and `damping`": ({}, DRAG | {"added_mass": FULL, "damping": FULL}),
        "`damping_quadratic`": ({}, {"damping_quadratic": (1.0,) * 6}),
        "`water_depth`": ({}, {"water_depth": 1.0}),
        "`water_depth`, with drag": (DRAG, DRAG | {"water_depth": 1.0}),
        "`water_stokes`, with drag": (DRAG, DRAG | {"water_stokes": 1.0}),
        "`memory_<body>`, 1 row": ({}, {"memory_bunny": (1.0, 1.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)}),
        "`hydrodynamics_<body>`, 12 columns": ({}, {"hydrodynamics_bunny": str(file)}),
    }
    print("| field | step without it | with it | ratio |\n| --- | ---: | ---: | ---: |")
    for name, (without, with_it) in cases.items():
        scenes = [without_resistance(BUNNY, fields) for fields in (without, with_it)]
        mujoco.mj_step(scenes[0].model, scenes[0].data, nstep=SETTLING_STEPS)
        start, times = scenes[0].data, np.full((2, FIELD_ROUNDS), np.inf)
        states = start.time, start.qpos.copy(), start.qvel.copy()
        for turn in range(FIELD_ROUNDS):
            for which, scene in enumerate(scenes):
                data = scene.data
                data.time, data.qpos[:], data.qvel[:] = states
                before = thread_time()
                mujoco.mj_step(scene.model, data, nstep=FIELD_STEPS)
                times[which, turn] = 1e6 * (thread_time() - before) / FIELD_STEPS
        bare, whole = times.min(axis=1)
        print(f"| {name} | {bare:.1f} us | {whole:.1f} us | {whole / bare:.2f} |", flush=True)


def print_seas(few: str, many: str) -> None:
    """The barge in seas of many waves. few, many: files with 1 and 12 columns."""
    print("\n| sea | water alone | + 2 states | + 24 states | + drag | + drag and 24 states |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    few_states, many_states = ({"hydrodynamics_barge": path} for path in (few, many))
    for waves in (0, 3, 40, 200):
        sea = {"sea_jonswap": (0.5, 6.0, 3.3, 20.0, 25.0, waves, 1.0)} if waves else {}
        alone, *others = (
            microseconds(sea | fields)
            for fields in ({}, few_states, many_states, DRAG, DRAG | many_states)
        )
        cells = " | ".join(f"{t:.1f} us, {t / alone:.2f}" for t in others)
        print(f"| {waves} waves | {alone:.1f} us | {cells} |", flush=True)


def main() -> None:
    with TemporaryDirectory() as folder:
        files = {count: Path(folder) / f"{count}.npz" for count in (1, 12)}
        for count, path in files.items():
            made(path, count)
        print_fields(files[12])
        if "--quick" not in sys.argv[1:]:
            print_seas(*map(str, files.values()))


if __name__ == "__main__":
    main()
