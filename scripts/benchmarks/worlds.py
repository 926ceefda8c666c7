"""Worlds: steps per second of many worlds through mujoco_warp, and their error against the CPU.

    python scripts/benchmarks/worlds.py [--worlds 64 8192] [--steps 200] [--quick] [--json FILE]

For each scene, sea and number of worlds it prints the world-steps per second of mujoco_warp with
the water and without it (the bodies then fall), the time of the water, and the largest difference
of the buoyancy from that of the plugin, as a share of density * gravity * volume. `mujoco.batch` on
this machine's cores is the comparison. On a GPU the step is captured in a graph. Without CUDA the
figures are those of Warp's CPU device, which has one thread.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import argparse
import os
import re
from collections.abc import Iterator, Sequence
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import mujoco
import mujoco_warp
import numpy as np
import warp as wp
from mujoco.batch import Batch

from command_line import at_least, check_outputs, failure, run_script, write_json
from sim import Scene, Sea
from sim.worlds.programs import GPU_LANES, programs

MODELS = Path(__file__).resolve().parents[2] / "models"
GPU_WORLDS, CPU_WORLDS = (64, 512, 2048, 8192, 16384), (16, 64)
LINKS = 10
JUDGED_WORLDS = 16
"""Number of worlds in which the buoyancy is compared."""

BATCH_WORLDS, BATCH_STEPS = 256, 40

CHAIN = """
<mujoco model="chain">
  <option timestep="0.002" integrator="implicitfast"/>
  <extension><plugin plugin="waterline"><instance name="water"/></plugin></extension>
  <custom>
    <numeric name="wave_swell" data="0.10 4.0 0 0"/>
    <numeric name="wave_cross" data="0.06 2.4 55 40"/>
    <numeric name="wave_chop" data="0.03 1.4 -65 110"/><numeric name="drag" data="0.2 0.94 0.0047"/>
    <tuple name="buoyant"><element objtype="body" objname="link0" prm="0"/></tuple>
  </custom>
  <worldbody>{links}</worldbody>
</mujoco>"""

LINK = """<body name="link{i}" pos="{x} 0 0">{joint}
<geom name="link{i}" type="capsule" fromto="0 0 0 0.3 0 0" size="0.06" density="600"/>
{rest}</body>"""


def chain(count: int) -> mujoco.MjSpec:
    """A swimming chain of links on hinges with vertical and horizontal axes in turns."""
    links = ""
    for i in reversed(range(count)):
        axis = "0 0 1" if i % 2 else "0 1 0"
        joint = f'<joint axis="{axis}" damping="0.1"/>' if i else "<freejoint/>"
        links = LINK.format(i=i, x=0.45 if i else 0, joint=joint, rest=links)
    return mujoco.MjSpec.from_string(CHAIN.format(links=links))


def scenes() -> Iterator[tuple[str, Scene]]:
    """The scenes in their own three waves, or two, and in forty."""
    forty = Sea.jonswap(0.3, 2.5, waves=40, seed=1)
    for name in ("bunny", "wigley", f"chain of {LINKS} links"):
        for sea in (None, forty):
            source = chain(LINKS) if name.startswith("chain") else MODELS / f"{name}.xml"
            scene = Scene.load(source, sea=sea)
            yield f"{name}, {len(scene.buoyancy.sea.waves)} waves", scene


def started(scene: Scene, worlds: int) -> tuple[Any, Any, Any]:
    """mujoco_warp's model and data, and the water, of worlds that start a little apart."""
    model, rng = scene.buoyancy.dry_model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    data.qpos[:] = scene.data.qpos
    mujoco.mj_forward(model, data)
    m, d = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data, nworld=worlds)
    water = scene.buoyancy.on_warp(m, d)
    qpos = np.tile(scene.data.qpos, (worlds, 1))
    qpos[:, :2] += rng.uniform(-10.0, 10.0, (worlds, 2))
    qpos[:, 2] += rng.uniform(-0.05, 0.05, worlds)
    d.qpos.assign(qpos.astype(np.float32))
    return m, d, water


def rate(m: Any, d: Any, steps: int) -> float:
    """World-steps per second."""
    mujoco_warp.step(m, d)
    launch = lambda: mujoco_warp.step(m, d)  # noqa: E731
    if d.time.device.is_cuda:
        with wp.ScopedCapture() as capture:
            mujoco_warp.step(m, d)
        launch = lambda: wp.capture_launch(capture.graph)  # noqa: E731
    for _ in range(3):
        launch()
    wp.synchronize()
    begun = perf_counter()
    for _ in range(steps):
        launch()
    wp.synchronize()
    return steps * d.nworld / (perf_counter() - begun)


def water_time(water: Any, m: Any, d: Any, steps: int) -> float:
    """Time [s] of the water in one step of all worlds."""
    launch = lambda: water.act(m, d)  # noqa: E731
    launch()
    if d.time.device.is_cuda:
        with wp.ScopedCapture() as capture:
            water.act(m, d)
        launch = lambda: wp.capture_launch(capture.graph)  # noqa: E731
    wp.synchronize()
    begun = perf_counter()
    for _ in range(steps):
        launch()
    wp.synchronize()
    return (perf_counter() - begun) / steps


def error_of(scene: Scene, m: Any, d: Any, water: Any) -> float:
    """Largest difference of the buoyancy's force from the plugin's, over density gravity volume, in
    the present state."""
    mujoco_warp.forward(m, d)
    found, times = water.wrenches().numpy()[:JUDGED_WORLDS], water.clock.numpy()
    places, turns = d.geom_xpos.numpy(), d.geom_xmat.numpy()
    b, state, worst = scene.buoyancy, mujoco.MjData(scene.model), 0.0
    weights = np.array([f.method.hull.volume for f in b.floats]) * b.sea.density * b.sea.gravity
    for i, wrenches in enumerate(found):
        state.geom_xpos[:], state.geom_xmat[:] = places[i], turns[i].reshape(-1, 9)
        state.time = times[i]
        missed = np.linalg.norm(wrenches[:, :3] - b.push(state)[:, :3], axis=1)
        worst = max(worst, float((missed / weights).max()))
    return worst


def batch_rate(scene: Scene) -> float:
    """World-steps per second of MuJoCo's batch on all cores of this machine."""
    batch = Batch(scene.model, nsim=BATCH_WORLDS)
    batch.bind("qpos")[:] = scene.data.qpos
    batch.step(nstep=2)
    begun = perf_counter()
    batch.step(nstep=BATCH_STEPS)
    return BATCH_WORLDS * BATCH_STEPS / (perf_counter() - begun)


def measured(counts: list[int], steps: int) -> Iterator[dict[str, Any]]:
    """One row for each scene, sea and number of worlds."""
    for name, scene in scenes():
        batch = batch_rate(scene)
        for count in counts:
            m, d, water = started(scene, count)
            row: dict[str, Any] = {"scene": name, "worlds": count, "steps_per_s": rate(m, d, steps)}
            row["error"] = error_of(scene, m, d, water)
            row["water_us"] = 1e6 * water_time(water, m, d, steps)
            water.uninstall()
            row["dry_steps_per_s"] = rate(m, d, steps)
            row["batch_steps_per_s"] = batch
            yield row


def instruction_counts() -> dict[str, int]:
    """The instructions of each kernel in PTX, compiled for sm_90 without a GPU."""
    counts = {}
    with TemporaryDirectory() as folder:
        module = programs(GPU_LANES).module
        (compiled,) = wp.compile_aot_module(module, arch=90, use_ptx=True, module_dir=folder)
        for kernel in Path(compiled).read_text().split(".entry ")[1:]:
            name = re.sub(
                r"^_add_\w+?__locals__|_[0-9a-f]{8}_\w*$", "", kernel[: kernel.index("(")]
            )
            lines = kernel[kernel.index("{") :].split("\n}")[0].splitlines()
            counts[name] = sum(bool(re.match(r"\s+(@|[a-z])", line)) for line in lines)
    return counts


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=at_least(1), nargs="+", help="numbers of worlds")
    parser.add_argument("--steps", type=at_least(1), default=200, help="steps that are timed")
    parser.add_argument("--quick", action="store_true", help="few worlds and steps")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to this file")
    options = parser.parse_args(arguments)
    try:
        check_outputs([options.json], [])
    except ValueError as error:
        return failure(error)
    wp.config.quiet = True
    wp.init()
    device = wp.get_device()
    if not device.is_cuda:
        print("no CUDA device was found; these are the figures of Warp's CPU device")
    print(f"device: {device.name}; {os.cpu_count()} cores; Warp {wp.__version__}, "
          f"mujoco_warp {mujoco_warp.__version__}, MuJoCo {mujoco.__version__}")  # fmt: skip
    counts = options.worlds or list(GPU_WORLDS if device.is_cuda else CPU_WORLDS)
    steps = options.steps
    if options.quick:
        counts, steps = counts[:1], min(steps, 5)
    print(
        f"{'scene':28}{'worlds':>8}{'steps/s':>14}{'dry':>14}{'water us':>10}{'batch':>10}  error"
    )
    rows = []
    for row in measured(counts, steps):
        rows.append(row)
        print(
            f"{row['scene']:28}{row['worlds']:8}{row['steps_per_s']:14,.0f}"
            f"{row['dry_steps_per_s']:14,.0f}{row['water_us']:10.0f}"
            f"{row['batch_steps_per_s']:10,.0f}  {row['error']:.1e}",
            flush=True,
        )
        about = {"device": device.name, "warp": wp.__version__, "cores": os.cpu_count()}
        write_json(options.json, {"about": about, "rows": rows})
    if not device.is_cuda:
        print("instructions of the kernels for a GPU (sm_90), before the driver's own assembler:")
        for name, count in instruction_counts().items():
            print(f"{name:28}{count:8,}")
    return 0


if __name__ == "__main__":
    run_script(main)
