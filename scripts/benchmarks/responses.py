"""What memory and diffraction cost: the time of a step, and its ratio to that without them.

python scripts/benchmarks/responses.py
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from sim.resistance.hydrodynamics import Hydrodynamics
from sim.scenes.spec import add_water

BARGE = """<mujoco><option timestep="0.005"/><worldbody><body name="barge"><freejoint/><body/>
  <geom name="barge" type="box" size="5 2 0.5" density="512"/></body></worldbody></mujoco>"""

STEPS, ROUNDS = 100, 15
"""Steps that are timed together, and how often; the fastest counts."""

HEADINGS, FREQUENCIES = 12, 30
"""Numbers of headings and frequencies in the file."""


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


def model_of(fields: Mapping[str, object]) -> mujoco.MjModel:
    """The barge with custom fields."""
    spec = mujoco.MjSpec.from_string(BARGE)
    return add_water(spec, "barge", **fields).compile()  # type: ignore[arg-type]


def microseconds(models: Sequence[mujoco.MjModel]) -> list[float]:
    """Processor time [us] of a step of each model, from the same state, measured in turns."""
    times = np.full((ROUNDS, len(models)), np.inf)
    datas = [mujoco.MjData(model) for model in models]
    for row in times:
        for i, (model, data) in enumerate(zip(models, datas, strict=True)):
            mujoco.mj_resetData(model, data)
            data.time = 20.0
            mujoco.mj_step(model, data, nstep=STEPS // 10)
            begun = thread_time()
            mujoco.mj_step(model, data, nstep=STEPS)
            row[i] = thread_time() - begun
    return (1e6 * times.min(axis=0) / STEPS).tolist()


def main() -> None:
    drag = {"drag": (0.0, 1.0, 0.005)}
    print("| sea | without | + 2 states | + 24 states | + drag | + drag and 24 states |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    with TemporaryDirectory() as folder:
        files = {count: Path(folder) / f"{count}.npz" for count in (1, 12)}
        for count, path in files.items():
            made(path, count)
        few, many = ({"hydrodynamics_barge": str(path)} for path in files.values())
        for waves in (0, 3, 40, 200):
            sea = {"sea_jonswap": (0.5, 6.0, 3.3, 20.0, 25.0, waves, 1.0)} if waves else {}
            variants = ({}, few, many, drag, drag | many)
            alone, *others = microseconds([model_of(sea | fields) for fields in variants])
            cells = " | ".join(f"{t:.1f} us, {t / alone:.2f}" for t in others)
            print(f"| {waves} waves | {alone:.1f} us | {cells} |", flush=True)


if __name__ == "__main__":
    main()
