"""Read the time series of a recording into arrays, for plots and sums of one's own.

    python scripts/read_recording.py recordings/bunny.rrd                        # what there is
    python scripts/read_recording.py recordings/bunny.rrd --output bunny.npz     # all of it

or in Python, with this folder on the path:

    series = read_series("recordings/bunny.rrd")
    times, heights = series["height/bunny"]          # [s], [m]

Exit status: 0 on success, 2 on unusable input.
"""

import sys
import warnings
from pathlib import Path

from command_line import UNUSABLE_INPUT, Parser, run_script

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

Array = NDArray[np.float64]

PLOTS, OTHERS = "/plots/", "/others/"
"""Where the series of the bodies that are plotted stand, one an entity, and of the others,
all in one."""

SCALARS, NAMES = "Scalars:scalars", "SeriesLines:names"


def read_series(path: str | Path) -> dict[str, tuple[Array, Array]]:
    """Times (N,) [s] and values (N,) of each series of a recording by run.py, by its name
    <quantity>/<body>, as 'height/bunny' and 'height/bunny/water' [m], 'tilt/bunny' [deg],
    'submerged/bunny' [of the volume], 'force/bunny' [weights].

    Raises FileNotFoundError, or ValueError for a file that has no series.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no recording {path}; make one with scripts/run.py")
    parts: dict[str, list[tuple[Array, Array]]] = {}
    bodies: dict[str, list[str]] = {}
    try:
        with warnings.catch_warnings():
            # A run that was killed leaves no table of contents; what it recorded is all there.
            warnings.filterwarnings("ignore", message="RRD file has no footer")
            for chunk in RrdReader(path).stream().filter(content=[f"{PLOTS}**", f"{OTHERS}**"]):
                batch, entity = chunk.to_record_batch(), chunk.entity_path
                if NAMES in batch.schema.names and entity.startswith(OTHERS):
                    (bodies[entity],) = batch.column(NAMES).to_pylist()
                if chunk.is_static or SCALARS not in batch.schema.names:
                    continue
                times = batch.column("time").cast("int64").to_numpy() * 1e-9  # from nanoseconds
                values = np.array(batch.column(SCALARS).to_pylist())
                parts.setdefault(entity, []).append((times, values))
    except RuntimeError as error:
        raise ValueError(f"{path} is no recording that can be read: {error}") from None
    if not parts:
        raise ValueError(f"{path} has no series under {PLOTS}; give a recording by scripts/run.py")
    series = {}
    for entity, chunks in sorted(parts.items()):
        times, values = _in_order(chunks)
        names = _names(entity, bodies.get(entity, []))
        series |= {name: (times, values[:, i]) for i, name in enumerate(names)}
    return series


def _names(entity: str, bodies: list[str]) -> list[str]:
    """Names of the series of an entity, which those of others do not have in their path."""
    if entity.startswith(PLOTS):
        return [entity.removeprefix(PLOTS)]
    quantity, *rest = entity.removeprefix(OTHERS).split("/")
    return ["/".join([quantity, rr.escape_entity_path_part(body), *rest]) for body in bodies]


def _in_order(chunks: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    times, values = (np.concatenate(column) for column in zip(*chunks, strict=True))
    order = np.argsort(times, kind="stable")
    return times[order], values[order]


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(prog="read_recording.py", description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, metavar="FILE.rrd", help="written by run.py")
    parser.add_argument(
        "--output", type=Path, metavar="FILE.npz", help="write each series there, (2, N)"
    )
    options = parser.parse_args(arguments)
    try:
        series = read_series(options.recording)
        if options.output is not None:
            with options.output.open("wb") as file:
                np.savez(file, **{name: np.stack(columns) for name, columns in series.items()})
    except (OSError, ValueError) as error:
        print(f"read_recording.py: {str(error).splitlines()[0]}", file=sys.stderr)
        return UNUSABLE_INPUT
    for name, (times, values) in series.items():
        print(
            f"{name}: {len(times)} values from {times[0]:.3f} to {times[-1]:.3f} s, mean "
            f"{values.mean():.4g}, from {values.min():.4g} to {values.max():.4g}"
        )
    return 0


if __name__ == "__main__":
    run_script(main)
