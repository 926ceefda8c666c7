"""Common functions of the scripts: options, exit statuses, errors and notes in one line, progress,
tables, and atomic writing of files."""

import argparse
import errno
import importlib.util
import json
import math
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from types import FrameType
from typing import Any, NoReturn, Self, TypeVar

os.environ.setdefault("RUST_LOG", "off")  # keeps Rerun from printing errors besides ours

MEASURED_SECONDS, NOTED_SECONDS = 1.0, 60.0
"""Wall time after which the speed of the work is known, and the wall time left that is noted."""

UNUSABLE_INPUT, DIVERGED, UNWRITABLE, BROKEN_PIPE = 2, 3, 4, 141

STOPS = (signal.SIGINT, signal.SIGTERM)

Number = TypeVar("Number", int, float)

LARGEST_NUMBER, LARGEST_COUNT = 1e9, 1_000_000
"""Bounds of numbers and counts on the command line."""


class Stopped(KeyboardInterrupt):
    """A signal of STOPS was received; the argument is its number."""


class Parser(argparse.ArgumentParser):
    """A parser that prints errors in one line. doc: a script's docstring, whose first line
    describes the script; None if Python omits docstrings."""

    def __init__(self, doc: str | None) -> None:
        super().__init__(description=(doc or "").partition("\n")[0])

    def error(self, message: str) -> NoReturn:
        self.exit(UNUSABLE_INPUT, f"{self.prog}: {message} (see --help)\n")


def _number(
    text: str, kind: type[Number], is_valid: Callable[[Number], bool], expected: str
) -> Number:
    """A number from the command line. Always raises argparse's own error, because argparse shows
    the name of the function that raised any other error."""
    try:
        value = kind(text)
        if is_valid(value):
            return value
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text} is not {expected}")


def positive(text: str) -> float:
    """A number above 0 from the command line."""
    expected = f"a number above 0 and at most {LARGEST_NUMBER:g}"
    return _number(text, float, lambda value: 0.0 < value <= LARGEST_NUMBER, expected)


def not_negative(text: str) -> float:
    """A number from 0 on from the command line."""
    expected = f"a number from 0 to {LARGEST_NUMBER:g}"
    return _number(text, float, lambda value: 0.0 <= value <= LARGEST_NUMBER, expected)


def at_least(lowest: int, highest: int = LARGEST_COUNT) -> Callable[[str], int]:
    """A reader of whole numbers from `lowest` to `highest` from the command line."""
    expected = f"a whole number from {lowest} to {highest}"
    return lambda text: _number(text, int, lambda value: lowest <= value <= highest, expected)


def named_number(text: str) -> tuple[str, float]:
    """A name and a number above 0 from the command line, "NAME=NUMBER"."""
    name, _, number = text.rpartition("=")
    if not name:
        raise argparse.ArgumentTypeError(f"'{text}' is not NAME=NUMBER")
    return name, positive(number)


def add_scene_options(parser: argparse.ArgumentParser, many: bool = False) -> None:
    """Add the options that change a scene. many: whether a setting has several values."""
    from sim.mjcf.fields import described

    fields = [f"  {name}: {meaning}\n      {value}\n" for name, value, meaning in described()]
    parser.epilog = f"custom fields of a scene:\n{''.join(fields)}"
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--buoyant", action="append", default=[], metavar="BODY",
        help="a body that floats, with all bodies below it; for MJCF and URDF files without water",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], dest="settings",
        metavar="NAME=VALUE,VALUE,..." if many else "NAME=VALUE",
        help="values of a custom field, or of one number of it: wave_swell.amplitude=0.1,0.2"
        if many else
        'overrides a custom field: "wave_swell=0.2 4 0 0", wave_swell.amplitude=0.2, '
        "buoyancy_method=linear, seed=3",
    )  # fmt: skip
    parser.add_argument(
        "--timestep", type=positive, metavar="S", help="overrides the scene's timestep"
    )
    parser.add_argument(
        "--density", action="append", default=[], type=named_number, dest="densities",
        metavar="NAME=KG/M3", help="overrides the density of a geom, or of all geoms of a body",
    )  # fmt: skip
    parser.add_argument("--keyframe", metavar="NAME", help="start (the first keyframe)")


def add_averaging_options(parser: argparse.ArgumentParser, rate: float) -> None:
    """Add the options of runs whose samples are averaged."""
    parser.add_argument(
        "--duration", type=positive, default=60.0, metavar="S", help="simulated seconds (60)"
    )
    parser.add_argument(
        "--warm-up", type=positive, default=10.0, metavar="S",
        help="seconds that the means ignore (10)",
    )  # fmt: skip
    parser.add_argument(
        "--rate", type=positive, default=rate, metavar="HZ",
        help=f"samples per simulated second ({rate:g})",
    )  # fmt: skip


def scene_options(options: argparse.Namespace) -> dict[str, Any]:
    """The arguments of `Scene.load` for these options, except the settings."""
    return {
        "buoyant": tuple(options.buoyant),
        "densities": dict(options.densities),
        "timestep": options.timestep,
        "keyframe": options.keyframe,
    }


def say(text: object) -> None:
    """Print a line with the script's name to stderr."""
    print(f"{Path(sys.argv[0]).name}: {text}", file=sys.stderr, flush=True)


@contextmanager
def notes_said(quiet: bool = False) -> Iterator[None]:
    """Print the warnings of the block and of MuJoCo at its end, each once and in one line. If the
    block fails, print only the notes about a model with faults, which may explain them."""
    import mujoco

    from sim import Note

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        # otherwise MuJoCo writes a log file into the current folder
        mujoco.set_mju_user_warning(lambda text: warnings.warn(f"MuJoCo: {text}", stacklevel=2))
        try:
            yield
        except Exception as error:
            has_faults = hasattr(error, "faults")
            caught[:] = [w for w in caught if has_faults and issubclass(w.category, Note)]
            raise
        finally:
            mujoco.set_mju_user_warning(None)
            notes = dict.fromkeys(" ".join(str(w.message).split()) for w in caught)
            for note in () if quiet else notes:
                say(f"note: {note}")


def failure(error: BaseException) -> int:
    """Print an error, with a line for each fault of a model, and return the exit status."""
    from sim import DivergenceError

    if isinstance(error, Stopped):
        say(f"stopped by {signal.Signals(error.args[0]).name}")
        return 128 + error.args[0]
    for fault in getattr(error, "faults", (error,)):
        say(" ".join(str(fault).splitlines()))
    # subclasses of OSError (no such file, no permission, ...) and long names are faults of a path
    if type(error) is OSError and error.errno != errno.ENAMETOOLONG:
        return UNWRITABLE
    return DIVERGED if isinstance(error, DivergenceError) else UNUSABLE_INPUT


class Progress:
    """The work that is done, `n`, of a total. On a terminal a bar shows it. Elsewhere, one line
    tells how long the work will take, if that is more than NOTED_SECONDS.

    quiet: print nothing. done: the work that was done before.
    """

    def __init__(self, total: float, unit: str, quiet: bool = False, done: float = 0.0) -> None:
        from tqdm import tqdm

        shape = "{percentage:3.0f} %|{bar}| {n:.4g} of {total:g} {unit}, {remaining} left"
        self.bar: Any = tqdm(
            total=total, initial=done, unit=unit, bar_format=shape, leave=False,
            dynamic_ncols=True, disable=quiet or not sys.stderr.isatty(),
        )  # fmt: skip
        self.n, self._total, self._unit = done, total, unit
        self._before, self._started = done, math.nan
        self._has_said = quiet or not self.bar.disable

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.close()

    def update(self, amount: float = 1.0) -> None:
        """Add an amount of work that was done."""
        self.n += amount
        self.bar.update(amount)
        if math.isnan(self._started):  # what came before the first piece may be compiling
            self._before, self._started = self.n, perf_counter()
            return
        spent = perf_counter() - self._started
        if not self._has_said and spent > MEASURED_SECONDS and self.n > self._before:
            self._has_said = True
            left = spent * (self._total - self.n) / (self.n - self._before)
            if left > NOTED_SECONDS:
                takes = f"{left / 60.0:.0f} minutes" if left < 7200.0 else f"{left / 3600.0:.1f} h"
                say(f"note: {self._total:g} {self._unit}: about {takes} more at this speed")


def print_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows below titles, with the first column aligned left and the others right."""
    widths = [max(map(len, column)) for column in zip(titles, *rows, strict=True)]
    for first, *others in (titles, *rows):
        cells = [f"{cell:>{width}}" for cell, width in zip(others, widths[1:], strict=True)]
        print("  ".join([f"{first:<{widths[0]}}", *cells]).rstrip())


MOST_ROWS, FIRST_ROWS = 12, 3
"""Largest number of rows of a table that is printed whole, and the number of rows that are printed
of a larger one."""


def folded(rows: Sequence[Sequence[str]], keep: int = FIRST_ROWS) -> list[Sequence[str]]:
    """The rows of a table; of more than MOST_ROWS only the first ones, and the least and the most
    of each column of numbers."""
    if len(rows) <= MOST_ROWS:
        return list(rows)
    columns = list(zip(*rows, strict=True))[1:]
    extremes = [
        (f"{name} of {len(rows)}", *(choose(column, key=float) for column in columns))
        for name, choose in (("least", min), ("most", max))
    ]
    return [*rows[:keep], *extremes]


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path]) -> None:
    """Raise ValueError for an output that is no file, is also an input or another output, or cannot
    be written."""
    read, written = {_target(path) for path in inputs}, set()
    for path in filter(None, outputs):
        target = _target(path)
        existing = next(p for p in (target, *target.parents) if p.exists())
        if existing == target and not target.is_file():
            raise ValueError(f"{path} is no file but a folder or a device; give another name")
        if target in read:
            raise ValueError(f"{path} is read and would be written over; give another name")
        if target in written:
            raise ValueError(f"{path} is given for two outputs; give each its own name")
        if not os.access(existing, os.W_OK) or (existing != target and not existing.is_dir()):
            raise ValueError(f"{path} cannot be written because of {existing}; give another name")
        written.add(target)


def _target(path: Path) -> Path:
    """The path with all links followed. Raises ValueError for links in a circle."""
    try:
        return path.resolve()
    except RuntimeError:
        raise ValueError(f"{path} is a link that leads to itself; give another name") from None


def check_drawable(path: Path | None) -> None:
    """Raise ValueError if a figure needs matplotlib and it is not installed."""
    if path is not None and importlib.util.find_spec("matplotlib") is None:
        raise ValueError(
            "a figure needs matplotlib, which is not installed; run: pip install '.[report]'"
        )


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file atomically: `write` writes another file in its folder, which then replaces it. A
    failure leaves the old file. Missing folders are made. Raises OSError with the path."""
    target = path.resolve()  # replaces the target of a link, not the link
    temporary = target.with_name(f".{os.getpid()}.{target.name}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.replace(target)
    except OSError as error:
        from sim.runs.locked import raise_unwritable

        raise_unwritable(path, error)
    finally:
        temporary.unlink(missing_ok=True)


def json_text(report: Any, indent: int | None = None) -> str:
    """A report as JSON, in which numbers that are not finite are null: JSON has no such numbers."""

    def finite(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: finite(each) for key, each in value.items()}
        if isinstance(value, list | tuple):
            return [finite(each) for each in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps(finite(report), indent=indent, allow_nan=False)


def write_json(path: Path | None, report: Any) -> None:
    """Write a report to a file, unless the path is None."""
    if path is not None:
        text = json_text(report, indent=2) + "\n"
        write_whole(path, lambda temporary: temporary.write_text(text))


@contextmanager
def stops_held() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C and SIGTERM back, and give a function that raises Stopped if one was received. A
    run calls it between two samples. An exception at any other point could be lost while MuJoCo
    waits for a method in Python."""
    received: list[int] = []

    def check() -> None:
        if received:
            raise Stopped(received[0])

    handlers = [signal.signal(stop, lambda number, _: received.append(number)) for stop in STOPS]
    try:
        yield check
        check()
    finally:
        for stop, handler in zip(STOPS, handlers, strict=True):
            signal.signal(stop, handler)


LINEAR_BOX = """
import mujoco, sim
box = "<body name='box'><freejoint/><geom type='box' size='1 1 1'/></body>"
spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{box}</worldbody></mujoco>")
fields = {"buoyancy_method": "linear", "wave_one": (0.1, 4, 0, 0), "drag": (0.2, 1, 0.005)}
model = sim.add_water(spec, "box", **fields).compile()
mujoco.mj_step(model, mujoco.MjData(model))
"""
"""A program that needs all kernels but those of patches, half of the kernels of a first run."""


def compile_in_two() -> bool:
    """Let a second process compile half of the kernels, if none is compiled yet. A first run
    is then faster on two cores. Returns whether it started."""
    from sim.kernels import kept_kernels

    if (os.cpu_count() or 1) < 2 or kept_kernels():
        return False
    command = [sys.executable, "-W", "ignore", "-c", LINEAR_BOX]
    _helpers.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
    return True


_helpers: list[subprocess.Popen[bytes]] = []  # Python warns of a process that is forgotten


def run_script(main: Callable[[], int]) -> NoReturn:
    """End the process with the exit status of `main`, also if it is stopped or cannot write."""

    def stop(number: int, frame: FrameType | None) -> NoReturn:
        raise Stopped(number)

    for number in STOPS:
        signal.signal(number, stop)
    try:
        status = main()
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has ended (`| head`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the last flush
        status = BROKEN_PIPE
    except (OSError, Stopped) as error:
        status = failure(error)
    for helper in _helpers:
        helper.kill()
        helper.wait()
    sys.exit(status)
