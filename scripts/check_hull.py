"""Check whether a mesh file is a usable hull, and repair it.

    python scripts/check_hull.py boat.stl --scale 0.001 --repair boat.obj

The file may have any format that trimesh reads, or be a panel file (.gdf, .dat, .mar, .pnl), whose
surface is open at the waterline. An open boat with a closed, thin shell is a usable hull, but the
water stands as high inside as outside; --deck closes the boat. Exit status: 0 if Waterline accepts
the hull or the repaired hull, 1 if it refuses the hull, 2 on unusable input or if the repair
failed, 4 if a file cannot be written.
"""

import argparse
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import trimesh
from numpy.typing import NDArray

from command_line import (
    UNUSABLE_INPUT,
    Parser,
    check_outputs,
    failure,
    positive,
    print_table,
    run_script,
    say,
    write_json,
    write_whole,
)
from sim import Hull
from sim.hulls.files import read_surface
from sim.hulls.repair import Repaired, repair
from sim.hulls.survey import Survey, survey
from sim.hulls.union import decked

Surface = tuple[NDArray, NDArray]
"""Vertices and faces."""

HULL_REFUSED = 1
"""Exit status if Waterline refuses the hull."""

OPEN_BOAT_SHARE = 0.01
"""Share of a hull's volume. A hull that holds more water than this is called an open boat; less may
be a dent."""

OUTPUT_ENDINGS = (".obj", ".stl", ".ply")
"""Endings of the file formats in which hulls can be written."""

MOST_RIMS = 7
"""Largest number of rims that are listed; the others are only counted."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument("file", type=Path, metavar="FILE", help="a mesh: OBJ, STL, glTF, GDF, ...")
    parser.add_argument("--repair", type=Path, metavar="OUT", help="write the repaired hull to OUT")
    parser.add_argument(
        "--scale", type=positive, default=1.0, metavar="S", help="factor for the file's lengths (1)"
    )
    parser.add_argument("--mirror", action="store_true", help="mirror half a hull to complete it")
    parser.add_argument("--deck", action="store_true", help="close an open boat at its gunwale")
    parser.add_argument(
        "--drop-sheets", action="store_true", help="leave out fins and keels without thickness"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to this file")
    options = parser.parse_args(arguments)
    if (options.mirror or options.deck or options.drop_sheets) and options.repair is None:
        parser.error(
            "--mirror, --deck and --drop-sheets change the hull; name an output file with --repair"
        )
    return options


def check_files(options: argparse.Namespace) -> None:
    """Raise ValueError or OSError if an output is the input, another output, or not writable."""
    check_outputs((options.repair, options.json), [options.file])
    if options.repair is not None and options.repair.suffix.lower() not in OUTPUT_ENDINGS:
        raise ValueError(
            f"{options.repair}: expected a name that ends in {', '.join(OUTPUT_ENDINGS)}"
        )


def lines_of(found: Survey) -> Iterator[tuple[str, str]]:
    """Yield the title and text of each line about a survey."""
    yield "faces", f"{found.faces:,}"
    doubled = f", {found.doubled_vertices:,} of them twice" if found.doubled_vertices else ""
    yield "vertices", f"{found.vertices:,}{doubled}"
    yield "parts", str(found.parts)
    yield "extents", " x ".join(f"{side:.4g}" for side in found.extents) + " m"
    yield "units", found.unit_guess
    yield (
        "volume",
        f"{found.volume:.6g} m^3" + " (as its faces run, holes left open)" * bool(found.rims),
    )
    yield "area", f"{found.area:.6g} m^2"
    yield "open rims", str(len(found.rims))
    for rim in found.rims[:MOST_RIMS]:
        where = "({:.4g}, {:.4g}, {:.4g})".format(*rim.middle)
        size = " x ".join(f"{side:.3g}" for side in rim.extents)
        half = f", half a hull's: --mirror at {rim.symmetry}" if rim.symmetry else ""
        yield "", f"{rim.edges} edges around {where}, {size} m{half}"
    if len(found.rims) > MOST_RIMS:
        yield "", f"and {len(found.rims) - MOST_RIMS} more"
    crowded = ", ".join("({:.4g}, {:.4g}, {:.4g})".format(*p) for p in found.crowded_at[:3])
    yield "crowded edges", f"{found.crowded_edges}" + f", at {crowded}" * bool(crowded)
    yield "edges run along twice", str(found.twisted_edges)
    yield "faces without area", str(found.flat_faces)
    yield "doubled faces", str(found.doubled_faces)
    yield "slivers", str(found.slivers)
    yield "parts that face inward", str(found.inward_parts)
    yield "parts within others", str(found.nested_parts)
    yield "parts that overlap", str(found.overlapping_parts)
    yield "faces through others", str(found.crossing_faces)
    yield "half a hull", f"yes, --mirror at {found.half_hull}" if found.half_hull else "no"
    if found.holds > OPEN_BOAT_SHARE * max(found.volume, 0.0):
        yield (
            "open boat",
            f"holds {found.holds:.4g} m^3 of water, which floods it; --deck keeps it dry",
        )
    for change in found.changes:
        yield "", change
    yield "Waterline", found.refusal or "takes it" + " as it is" * (not found.changes)


def print_repair(before: Survey, repaired: Repaired, after: Survey | None) -> None:
    for line in repaired.done:
        print(f"- {line}")
    if after is not None:
        extents = [" x ".join(f"{side:.4g}" for side in s.extents) for s in (before, after)]
        rows = [
            ("volume m^3", f"{before.volume:.6g}", f"{after.volume:.6g}"),
            ("area m^2", f"{before.area:.6g}", f"{after.area:.6g}"),
            ("extents m", *extents),
            ("parts", str(before.parts), str(after.parts)),
            ("faces", str(before.faces), str(after.faces)),
        ]
        print_table(("mended", "before", "after"), rows)


def mended(surface: Surface, before: Survey, options: argparse.Namespace) -> Repaired:
    """Repair the hull of a surface, and mirror or deck it as the options ask."""
    if options.mirror and not before.half_hull:
        return Repaired(None, (), ("it is not half a hull; leave out --mirror",))
    found = repair(*surface, before.half_hull if options.mirror else "", options.drop_sheets)
    if not options.deck or found.hull is None:
        return found
    closed = decked(found.hull)
    if closed is None:
        return replace(found, done=(*found.done, "nothing to deck: it holds no water"))
    hull, held = closed
    done = (*found.done, f"decked: the {held:.4g} m^3 inside are dry now")
    return replace(found, hull=hull, done=done)


def export(hull: Hull, path: Path) -> None:
    """Write a hull to a file in the format of the file's ending."""
    mesh = trimesh.Trimesh(hull.vertices, hull.faces, process=False)
    digits = {"digits": 10} if path.suffix.lower() == ".obj" else {}
    data = mesh.export(file_type=path.suffix.lower().lstrip("."), **digits)
    content = data.encode() if isinstance(data, str) else data
    write_whole(path, lambda beside: beside.write_bytes(content))


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        check_files(options)
        surface = read_surface(options.file, options.scale)
        before = survey(*surface)
    except (ValueError, OSError) as error:
        return failure(error)
    print(options.file)
    for title, text in lines_of(before):
        print(f"  {title:<24}{text}")
    report, status = {"file": str(options.file), "before": asdict(before)}, 0
    if options.repair is not None:
        status = _repair(surface, before, options, report)
    elif before.refusal:
        status = HULL_REFUSED
    write_json(options.json, report)
    return status


def _repair(
    surface: Surface, before: Survey, options: argparse.Namespace, report: dict[str, object]
) -> int:
    """Repair the hull, write it and extend the report; return the exit status."""
    found = mended(surface, before, options)
    after = survey(found.hull.vertices, found.hull.faces) if found.hull is not None else None
    print()
    print_repair(before, found, after)
    report |= {"done": found.done, "faults": found.faults, "after": after and asdict(after)}
    for fault in found.faults:
        say(f"{options.file}: {fault}")
    if found.faults or found.hull is None:
        say(f"{options.repair} was not written")
        return UNUSABLE_INPUT
    export(found.hull, options.repair)
    print(f"\nwritten: {options.repair}")
    return 0


if __name__ == "__main__":
    run_script(main)
