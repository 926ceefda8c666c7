"""Read the time series of a recording into arrays.

    python scripts/read_recording.py recordings/bunny.rrd                        # list them
    python scripts/read_recording.py recordings/bunny.rrd --output bunny.npz     # save them
    python scripts/read_recording.py recordings/bunny.rrd --mend    # repair a damaged file

or in Python:

    series = sim.read_series("recordings/bunny.rrd")
    times, heights = series["height/bunny"]          # [s], [m]

Exit status: 0 on success, 2 on unusable input, 4 when a file cannot be written.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np

from command_line import Parser, check_outputs, failure, run_script, write_whole
from sim import read_series

MAGIC = b"RRF2"
"""First bytes of every recording."""


def mend(recording: Path, output: Path) -> None:
    """Write the readable content of a damaged recording to another file, with Rerun's own tool.

    Raises ValueError if the file is not a recording or has no readable content, FileNotFoundError
    if it does not exist.
    """
    if not recording.is_file():
        raise FileNotFoundError(f"there is no recording {recording}")
    with recording.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{recording} is not a recording; it was not changed")
    command = [sys.executable, "-m", "rerun", "rrd", "merge", "--continue-on-error"]

    def merge(beside: Path) -> None:
        done = subprocess.run(
            [*command, "-o", str(beside), str(recording)], capture_output=True, text=True
        )
        if done.returncode != 0 or not beside.is_file():
            reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise ValueError(f"{recording} has no readable content: {reason}")

    write_whole(output, merge)
    kept, of = (path.stat().st_size / 1e6 for path in (output, recording))
    print(f"{output}: {kept:.2f} MB of readable content from {of:.2f} MB")


def save(path: Path, columns: dict[str, np.ndarray]) -> None:
    with path.open("wb") as file:  # np.savez would change the ending of a path
        np.savez(file, **columns)


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(__doc__)
    parser.add_argument("recording", type=Path, metavar="FILE.rrd", help="written by run.py")
    parser.add_argument(
        "--output", type=Path, metavar="FILE.npz", help="write each series to this file, (2, N)"
    )
    parser.add_argument(
        "--mend", action="store_true",
        help="write the readable content of a damaged recording to --output, or beside it",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    if options.mend:
        output = options.output or options.recording.with_stem(f"{options.recording.stem}_mended")
        if options.output is None and output.exists():
            parser.error(f"{output} already exists; choose another file with --output")
        options.output = None
    try:
        if options.mend:
            check_outputs([output], [options.recording])
            mend(options.recording, output)
            options.recording = output
        check_outputs([options.output], [options.recording])
        series = read_series(options.recording)
        if options.output is not None:
            columns = {name: np.stack(both) for name, both in series.items()}
            write_whole(options.output, lambda beside: save(beside, columns))
    except (OSError, ValueError) as error:
        return failure(error)
    for name, (times, values) in series.items():
        print(
            f"{name}: {len(times)} values from {times[0]:.3f} to {times[-1]:.3f} s, mean "
            f"{values.mean():.4g}, from {values.min():.4g} to {values.max():.4g}"
        )
    return 0


if __name__ == "__main__":
    run_script(main)
