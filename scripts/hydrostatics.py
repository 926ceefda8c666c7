"""Print how the bodies of a scene float in still water, in the terms of naval architecture.

    python scripts/hydrostatics.py models/wigley.xml --figure wigley.png

Each tree of bodies counts as one rigid body that starts at the scene's first keyframe. It moves
freely, or by the joints between it and the world, whose limits do not count. A body that does not
come to rest is described wholly under water. Exit status: 0 on success, 2 on unusable input, 4 if a
file cannot be written.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from command_line import (
    Parser,
    add_scene_options,
    check_drawable,
    check_outputs,
    compile_in_two,
    failure,
    notes_said,
    print_table,
    run_script,
    scene_options,
    write_json,
    write_whole,
)
from sim import Hydrostatics, Scene, hydrostatics
from sim.mjcf.files import model_files
from sim.scenes.hydrostatics import trees
from sim.statics.report import Rest

ROWS = (
    ("mass", "kg", "mass_kg"),
    ("volume", "m^3", "volume_m3"),
    ("relative density", "", "relative_density"),
    ("displacement", "m^3", "displacement_m3"),
    ("submerged fraction", "", "submerged_fraction"),
    ("draught", "m", "draught_m"),
    ("heel", "deg", "heel_deg"),
    ("trim", "deg", "trim_deg"),
    ("turned since the start", "deg", "tilt_from_start_deg"),
    ("height of the body's origin", "m", "height_m"),
    ("waterplane length LWL", "m", "lwl_m"),
    ("waterplane breadth BWL", "m", "bwl_m"),
    ("waterplane area", "m^2", "waterplane_m2"),
    ("wetted surface", "m^2", "wetted_m2"),
    ("block coefficient CB", "", "cb"),
    ("waterplane coefficient CWP", "", "cwp"),
    ("centre of buoyancy KB", "m", "kb_m"),
    ("  ahead of the origin LCB", "m", "lcb_m"),
    ("  to port TCB", "m", "tcb_m"),
    ("centre of the waterplane LCF", "m", "lcf_m"),
    ("  to port TCF", "m", "tcf_m"),
    ("centre of mass KG", "m", "kg_m"),
    ("metacentric radius BMt", "m", "bmt_m"),
    ("metacentric radius BMl", "m", "bml_m"),
    ("metacentric height GMt", "m", "gmt_m"),
    ("metacentric height GMl", "m", "gml_m"),
    ("heave period", "s", "heave_period_s"),
    ("roll period", "s", "roll_period_s"),
    ("pitch period", "s", "pitch_period_s"),
    ("largest stable timestep", "s", "largest_timestep_s"),
    ("righting arm vanishes at", "deg", "vanishing_deg"),
)
"""Title, unit and key of `Hydrostatics.flat` of each printed row."""

ARM_STEP = 15.0
"""Step [deg] between the righting arms that are printed; --json writes all."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("scene", type=Path, metavar="SCENE", help="an MJCF or URDF file")
    add_scene_options(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to this file")
    parser.add_argument(
        "--figure", type=Path, metavar="FILE.png", help="draw righting arms and hulls at rest"
    )
    return parser.parse_args(arguments)


def print_report(found: dict[str, Hydrostatics]) -> None:
    """Print a table with one column per body."""
    columns = [h.flat() for h in found.values()]
    rows = [
        (f"{title} [{unit}]" if unit else title, *(text(column.get(key)) for column in columns))
        for title, unit, key in ROWS
    ]
    rows += joint_rows(columns)
    arms = [dict(column.get("gz") or ()) for column in columns]
    for heel in sorted(set().union(*arms)):
        if heel % ARM_STEP == 0.0 and heel > 0.0:
            title = f"righting arm GZ at {heel:.0f} deg [m]"
            rows.append((title, *(text(arm.get(heel)) for arm in arms)))
    print_table(("at rest", *found), rows)
    for h in found.values():
        if h.reason:
            print(f"{h.name} {h.reason}")


def joint_rows(columns: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Rows with the stiffness and the period of each joint that holds a body to the world."""
    rows = []
    for own, column in enumerate(columns):
        for motion in column.get("joints") or ():
            unit = "N m/rad" if motion["is_hinge"] else "N/m"
            for what, key in ((f"stiffness [{unit}]", "stiffness"), ("period [s]", "period_s")):
                cells = ["-"] * len(columns)
                cells[own] = text(motion[key])
                rows.append((f"joint {motion['joint']}: {what}", *cells))
    return rows


def text(value: float | None) -> str:
    """A value with five digits; round-off is shown as 0, no value as "-"."""
    if value is None:
        return "-"
    return "0" if abs(value) < 1e-7 else f"{value:.5g}"


def draw(scene: Scene, found: dict[str, Hydrostatics], path: Path) -> None:
    """Draw the righting arms, and each hull at rest in the water from behind and from the side."""
    import matplotlib

    matplotlib.use("Agg")  # works without a screen
    from matplotlib import pyplot

    bodies = [body for body in trees(scene).values() if body.at_rest is not None]
    rows = max(len(bodies), 1)
    figure, axes = pyplot.subplots(rows, 3, figsize=(12, 3.6 * rows), squeeze=False)
    for (curve, behind, side), body in zip(axes, bodies, strict=False):
        corners = body.placed(body.at_rest)
        if body.joints is None:
            draw_arms(curve, body.name, found[body.name].rest)
        draw_hull(behind, -corners[:, :, 1], corners[:, :, 2], "from behind: to starboard [m]")
        draw_hull(side, corners[:, :, 0], corners[:, :, 2], "from starboard: ahead [m]")
    figure.tight_layout()
    write_whole(path, lambda beside: figure.savefig(beside, dpi=110, format="png"))


def draw_arms(axes: Any, name: str, rest: Rest) -> None:
    heels, arms = np.transpose(rest.gz)
    axes.plot(heels, arms, color="#1f5a8a", label="GZ")
    axes.plot(heels, rest.gmt_m * np.radians(heels), ":", color="#888888", label="GMt x heel")
    axes.axhline(0.0, color="black", linewidth=0.6)
    margin = 0.15 * np.ptp([*arms, 0.0])
    axes.set_ylim(min(arms.min(), 0.0) - margin, max(arms.max(), 0.0) + margin)
    axes.set(xlabel="heel [deg]", ylabel="righting arm [m]", title=name)
    axes.legend()


def draw_hull(axes: Any, across: NDArray, up: NDArray, label: str) -> None:
    """Draw a hull's triangles as seen along an axis; across and up: corners (F, 3) [m]."""
    from matplotlib.collections import PolyCollection

    triangles, colour = np.stack([across, up], axis=2), "#c8a868"
    axes.add_collection(PolyCollection(triangles, facecolors=colour, edgecolors=colour, lw=0.3))
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    margin = 0.15 * max(high - low)
    axes.axhspan(low[1] - margin, 0.0, color="#3f86c0", alpha=0.45, linewidth=0.0, zorder=3)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set(xlabel=label, ylabel="z [m]")


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        check_outputs((options.json, options.figure), model_files(options.scene))
        check_drawable(options.figure)
        compile_in_two()
        with notes_said():
            scene = Scene.load(options.scene, settings=options.settings, **scene_options(options))
        found = hydrostatics(scene)
    except (ValueError, OSError) as error:
        return failure(error)
    print_report(found)
    bodies = {name: h.flat() for name, h in found.items()}
    write_json(options.json, {"scene": scene.name, "bodies": bodies})
    if options.figure is not None:
        draw(scene, found, options.figure)
    return 0


if __name__ == "__main__":
    run_script(main)
