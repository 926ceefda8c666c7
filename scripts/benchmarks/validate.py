"""Compare the package with published results and with closed forms.

    python scripts/benchmarks/validate.py [--quick] [--panel-code] [--markdown FILE] [--json FILE]

Exit status: 0 if all rows hold, apart from known gaps, 1 if another row does not hold, 2 on
unusable input, 4 if a file cannot be written.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import argparse
from collections.abc import Iterator
from typing import Any

import make_scenes

from benchmarks import validation
from command_line import (
    Parser,
    check_outputs,
    failure,
    notes_said,
    print_table,
    run_script,
    write_json,
    write_whole,
)
from panel_code import check_installed
from sim import Hull

TITLES = ("published", "ours", "unit", "source", "verdict")
"""Titles of the columns after the first, whose title is the name of the group."""


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="fewer heights, periods and wavelengths: half a minute"
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE.md", help="write the tables to it")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to this file")
    parser.add_argument(
        "--panel-code", action="store_true",
        help="compute the panel code's numbers with Capytaine (pip install '.[bem]')",
    )  # fmt: skip
    return parser.parse_args(arguments)


def rows(hull: Hull, quick: bool) -> Iterator[dict[str, Any]]:
    """Measure all checks and yield them under the keys of --json."""
    for check in validation.checks(hull, quick):
        found = check.measure()
        yield {
            "group": check.group, "what": check.what, "low": check.low, "high": check.high,
            "ours": found, "unit": check.unit, "source": check.source,
            "verdict": check.verdict(found), "miss": check.miss(found),
            "is_known_gap": bool(check.known_gap),
        }  # fmt: skip


def tables(found: list[dict[str, Any]]) -> Iterator[tuple[tuple[str, ...], list[tuple[str, ...]]]]:
    """Yield the titles and rows of each group's table."""
    for group in dict.fromkeys(row["group"] for row in found):
        yield (group, *TITLES), [cells(row) for row in found if row["group"] == group]


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """The printed cells of a row."""
    band = f"{row['low']:.5g} to {row['high']:.5g}"
    return row["what"], band, f"{row['ours']:.4g}", row["unit"], row["source"], row["verdict"]


def summary(found: list[dict[str, Any]]) -> str:
    """How many rows hold, and the row that is furthest from its bounds, with the reason."""
    off = [row for row in found if row["verdict"] != "holds"]
    text = f"{len(found) - len(off)} of {len(found)} rows hold."
    if off:
        worst = max(off, key=lambda row: abs(row["miss"]))
        text += f" The furthest off is '{worst['what']}' ({worst['group']}): {worst['verdict']}."
    return text


def markdown(found: list[dict[str, Any]]) -> str:
    """The tables as a Markdown page."""
    text = "# Validation\n\n"
    for titles, table in tables(found):
        lines = [titles, ("---",) * len(titles), *table]
        text += "".join(f"| {' | '.join(line)} |\n" for line in lines) + "\n"
    return text + summary(found) + "\n"


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        if options.panel_code:
            check_installed("capytaine")
        check_outputs((options.markdown, options.json), [])
    except ValueError as error:
        return failure(error)
    hull = Hull(*make_scenes.wigley())
    if options.panel_code:
        from benchmarks import panel_numbers

        panel_numbers.print_all(hull)
        return 0
    with notes_said(quiet=True):  # the bars turn over
        found = list(rows(hull, options.quick))
    for titles, table in tables(found):
        print_table(titles, table)
        print()
    print(summary(found))
    if options.markdown is not None:
        text = markdown(found)
        write_whole(options.markdown, lambda beside: beside.write_text(text))
    write_json(options.json, found)
    return int(any(r["verdict"] != "holds" and not r["is_known_gap"] for r in found))


if __name__ == "__main__":
    run_script(main)
