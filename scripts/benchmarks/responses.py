"""What memory and diffraction cost: the water's time in a step, and its ratio to that without them.

python scripts/benchmarks/responses.py
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from sim.resistance.hydrodynamics import Hydrodynamics
from sim.scenes.buoyancy import Buoyancy
from sim.scenes.spec import add_water

BARGE = """<mujoco><option timestep="0.005"/><worldbody><body name="barge"><freejoint/><body/>
  <geom name="barge" type="box" size="5 2 0.5" density="512"/></body></worldbody></mujoco>"""

STEPS, ROUNDS = 200, 7
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


def main() -> None:
    drag = {"drag": (0.2, 1.0, 0.005)}
    print("| sea | water alone | + 2 states | + 24 states | + drag | + drag and 24 states |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    with TemporaryDirectory() as folder:
        files = {count: Path(folder) / f"{count}.npz" for count in (1, 12)}
        for count, path in files.items():
            made(path, count)
        few, many = ({"hydrodynamics_barge": str(path)} for path in files.values())
        for waves in (0, 3, 40, 200):
            sea = {"sea_jonswap": (0.5, 6.0, 3.3, 20.0, 25.0, waves, 1.0)} if waves else {}
            alone, *others = (
                microseconds(sea | fields) for fields in ({}, few, many, drag, drag | many)
            )
            cells = " | ".join(f"{t:.1f} us, {t / alone:.2f}" for t in others)
            print(f"| {waves} waves | {alone:.1f} us | {cells} |", flush=True)


if __name__ == "__main__":
    main()
