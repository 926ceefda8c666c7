"""Read the time series of a recording into arrays, for plots and sums of one's own.

    python scripts/read_recording.py recordings/bunny.rrd                        # what there is
    python scripts/read_recording.py recordings/bunny.rrd --output bunny.npz     # all of it
    python scripts/read_recording.py recordings/bunny.rrd --mend    # if Rerun refuses to open it

or in Python:

    series = sim.read_series("recordings/bunny.rrd")
    times, heights = series["height/bunny"]          # [s], [m]

Exit status: 0 on success, 2 on unusable input.
"""

import os
import sys
from pathlib import Path

from command_line import UNUSABLE_INPUT, Parser, check_outputs, run_script, write_whole

import numpy as np

from sim import read_series
from sim.drawing.reader import whole_length


def save(path: Path, columns: dict[str, np.ndarray]) -> None:
    with path.open("wb") as file:  # a path would get another ending
        np.savez(file, **columns)


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(prog="read_recording.py", description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, metavar="FILE.rrd", help="written by run.py")
    parser.add_argument(
        "--output", type=Path, metavar="FILE.npz", help="write each series there, (2, N)"
    )
    parser.add_argument(
        "--mend", action="store_true", help="cut off what a killed run left half written"
    )
    options = parser.parse_args(arguments)
    try:
        check_outputs([options.output], [options.recording])
        if options.mend and options.recording.is_file():
            os.truncate(options.recording, whole_length(options.recording))
        series = read_series(options.recording)
        if options.output is not None:
            columns = {name: np.stack(both) for name, both in series.items()}
            write_whole(options.output, lambda beside: save(beside, columns))
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
