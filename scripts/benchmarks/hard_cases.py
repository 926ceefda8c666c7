"""Run cases that are hard to simulate with every integrator and timestep, and print which hold.

    python scripts/benchmarks/hard_cases.py [--quick] [--json FILE] [--only WORD]

Each case states its expected result. A timestep holds if the run does not diverge and its error is
within the case's limit. The table shows the largest timestep up to which all hold, and the errors
at 2 ms. Exit status: 0 if all cases hold at 2 ms with every integrator, 1 if one does not, 2 on
unusable input.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import argparse
import warnings
from collections.abc import Iterator
from typing import Any

import mujoco

from benchmarks.cases import CASES, attempts
from command_line import (
    Parser,
    Progress,
    Stopped,
    check_outputs,
    failure,
    print_table,
    run_script,
    write_json,
)
from sim import Scene, simulate

BUNNY = Path(__file__).resolve().parents[2] / "models" / "bunny.xml"

INTEGRATORS = ("Euler", "implicitfast", "RK4")
TIMESTEPS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
QUICK_TIMESTEPS = (0.002, 0.02)
REQUIRED_TIMESTEP = 0.002
"""Timestep [s] of most shipped scenes, at which every case must hold."""


def drag_cost() -> dict[str, float]:
    """Time of buoyancy without and with drag [us] for the shipped bunny afloat, and the ratio."""
    times: dict[str, list[float]] = {"with": [], "without": []}
    scene = Scene.load(BUNNY)
    spec = mujoco.MjSpec.from_file(str(BUNNY))
    spec.delete(next(numeric for numeric in spec.numerics if numeric.name == "drag"))
    plain = Scene.load(spec)
    for _ in simulate(scene, 3.0):
        pass
    plain.data.qpos[:] = scene.data.qpos
    plain.data.time = scene.data.time
    for _ in range(20):
        for name, which in (("with", scene), ("without", plain)):
            before = which.buoyancy.seconds(which.data)
            for _ in range(100):
                mujoco.mj_forward(which.model, which.data)
            taken = which.buoyancy.seconds(which.data) - before
            times[name].append(taken / 100.0)
    with_drag, without = min(times["with"]), min(times["without"])
    return {
        "buoyancy_us": 1e6 * without,
        "with_drag_us": 1e6 * with_drag,
        "drag_over_buoyancy": with_drag / without - 1.0,
    }


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="only implicitfast, at 2 and 20 ms; under a minute"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all errors to this file")
    parser.add_argument(
        "--only", default="", metavar="WORD", help="only cases whose name contains WORD"
    )
    options = parser.parse_args(arguments)
    if not any(options.only in name for name in CASES):
        parser.error(f"no case has '{options.only}' in its name; choose from {', '.join(CASES)}")
    try:
        check_outputs([options.json], [])
    except ValueError as error:
        parser.error(str(error))
    return options


def show(value: float | None, unit: str = "") -> str:
    return "-" if value is None else f"{value:.2g}{unit}"


def run_case(name: str, quick: bool) -> dict[str, Any]:
    """Run a case with all integrators and timesteps; return its entry in the JSON."""
    case = CASES[name]
    line: dict[str, Any] = {"expects": case.expects, "limit": case.limit, "integrators": {}}
    for integrator in INTEGRATORS[1:2] if quick else INTEGRATORS:
        outcome = attempts(case, integrator, QUICK_TIMESTEPS if quick else TIMESTEPS)
        line["integrators"][integrator] = {
            "largest_stable_timestep": outcome.holds_up_to(case.limit),
            "errors": {f"{h:g}": e for h, e in outcome.errors.items()},
            "divergences": outcome.messages,
        }
    return line


def holds(line: dict[str, Any]) -> bool:
    """Whether a case holds at REQUIRED_TIMESTEP with every integrator that was run."""
    errors = [i["errors"][f"{REQUIRED_TIMESTEP:g}"] for i in line["integrators"].values()]
    return all(e is not None and e <= line["limit"] for e in errors)


def run_cases(options: argparse.Namespace, results: dict[str, Any]) -> None:
    """Run the cases one by one and add them to the results."""
    names = [name for name in CASES if options.only in name]
    with Progress(len(names), "cases") as bar:
        for name in names:
            results[name] = run_case(name, options.quick)
            bar.update(1)


def lines(results: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """The lines of the table."""
    for name, line in results.items():
        cells = []
        for integrator in line["integrators"].values():
            largest = integrator["largest_stable_timestep"]
            step = show(largest and 1e3 * largest, " ms")
            cells.append(f"{step} / {show(integrator['errors'][f'{REQUIRED_TIMESTEP:g}'])}")
        verdict = "" if holds(line) else "FAILS"
        yield name, f"{line['limit']:.1g}", *cells, verdict, line["expects"]


def print_cases(options: argparse.Namespace, results: dict[str, Any]) -> None:
    integrators = INTEGRATORS[1:2] if options.quick else INTEGRATORS
    print("largest timestep that holds / error at 2 ms")
    print_table(("case", "limit", *integrators, "", "expects"), [*lines(results)])


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    warnings.simplefilter("ignore")  # a diverging run overflows before it is stopped
    results: dict[str, Any] = {}
    cost, status = None, 0
    try:
        run_cases(options, results)
        cost = drag_cost()
    except Stopped as stop:
        status = failure(stop)
    print_cases(options, results)
    if cost is not None:
        print(
            f"\nbunny in three waves: buoyancy {cost['buoyancy_us']:.1f} us, with drag "
            f"{cost['with_drag_us']:.1f} us: drag costs {cost['drag_over_buoyancy']:.2f} of "
            "buoyancy"
        )
    write_json(options.json, {"cases": results, "drag": cost})
    failed = [name for name, line in results.items() if not holds(line)]
    print(f"{len(results) - len(failed)} of {len(results)} cases hold at 2 ms" + ": " * bool(failed)
          + "; ".join(f"{name} fails" for name in failed))  # fmt: skip
    return status or (1 if failed else 0)


if __name__ == "__main__":
    run_script(main)
