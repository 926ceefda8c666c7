"""What the scripts' command lines have in common: exit statuses, one-line errors, progress, and
ends in good order.

A script that imports it ends at once when it is interrupted. One that has something to put in
order or to keep says for how long: with `stop_signals`, or with `interruptible`.
"""

import os
import signal
import sys


def stopped_by(number: int) -> tuple[int, str]:
    """Exit status and message of a run that a signal has stopped."""
    return 128 + number, "interrupted" if number == signal.SIGINT else "terminated"


def _end_at_once(number: int, frame: object) -> None:
    """Handler of a signal that leaves nothing to be put in order."""
    stderr = sys.stderr.fileno() if sys.stderr is not None else 2
    os.write(stderr, f"{os.path.basename(sys.argv[0])}: {stopped_by(number)[1]}\n".encode())
    os._exit(128 + number)


IS_SCRIPT = os.path.realpath(sys.argv[0]).startswith(os.path.dirname(os.path.realpath(__file__)))
"""Whether one of the scripts is what runs, and not a test."""

if IS_SCRIPT and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end_at_once)  # KeyboardInterrupt is swallowed by some imports

import argparse
import errno
import importlib.util
import json
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from time import monotonic
from types import FrameType, MappingProxyType
from typing import Any, NoReturn

UNUSABLE_INPUT, DIVERGED, UNWRITABLE, INTERRUPTED, BROKEN_PIPE = 2, 3, 4, 130, 141

SAME_SIGNAL = 0.5
"""Seconds within which a second signal belongs to the first: `timeout` sends each one twice."""

NO_WIDTHS: Mapping[str, int] = MappingProxyType({})

LARGEST, MOST = 1e9, 1_000_000
"""Numbers and counts on the command line are no larger."""

LONGEST_NOTE = 200
"""Characters of a note that is a library's: some have forty lines."""

LOADING_NOTICE_AFTER = 2.0
"""Seconds of compiling, and of loading at all, after which it is worth a line."""


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the command line in one line. doc: a script's docstring, of which the
    first line describes it; None where Python leaves them out."""

    def __init__(self, prog: str, doc: str | None) -> None:
        super().__init__(prog=prog, description=(doc or "").partition("\n")[0])

    def error(self, message: str) -> NoReturn:
        self.exit(UNUSABLE_INPUT, f"{self.prog}: {message} (see --help)\n")


def positive(text: str) -> float:
    """A number above 0 from the command line."""
    value = float(text)
    if not 0.0 < value <= LARGEST:
        raise argparse.ArgumentTypeError(f"{text} is not a number above 0, and at most {LARGEST:g}")
    return value


def at_least(lowest: int, highest: int = MOST) -> Callable[[str], int]:
    """A reader of whole numbers from the command line that are not below `lowest`, nor so many that
    no machine has room for them."""

    def read(text: str) -> int:
        value = int(text)
        if not lowest <= value <= highest:
            raise argparse.ArgumentTypeError(f"{value} is not from {lowest} to {highest}")
        return value

    read.__name__ = "whole number"  # argparse's word for it when int() fails
    return read


def named_number(text: str) -> tuple[str, float]:
    """A name and a number above 0 from the command line, "NAME=NUMBER"."""
    name, equals, number = text.rpartition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"'{text}': expected NAME=NUMBER")
    return name, positive(number)


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Options that change a scene."""
    from sim.mjcf.fields import described

    fields = [f"  {name}: {meaning}\n      {value}\n" for name, value, meaning in described()]
    parser.epilog = f"custom fields of a scene:\n{''.join(fields)}"
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="NAME=VALUE",
        help='overrides a custom field: "wave_swell=0.2 4 0 0", wave_swell.amplitude=0.2, '
        "buoyancy_method=linear, seed=3",
    )  # fmt: skip
    parser.add_argument(
        "--timestep", type=positive, metavar="S", help="overrides the scene's timestep"
    )
    parser.add_argument(
        "--density", action="append", default=[], type=named_number, dest="densities",
        metavar="GEOM=KG/M3", help="overrides the density of a geom",
    )  # fmt: skip
    parser.add_argument("--keyframe", metavar="NAME", help="where to start (the first keyframe)")


def add_averaging_options(parser: argparse.ArgumentParser, rate: float) -> None:
    """How long runs are of which means are taken."""
    parser.add_argument(
        "--duration", type=positive, default=60.0, metavar="S", help="simulated seconds (60)"
    )
    parser.add_argument(
        "--warm-up", type=positive, default=10.0, metavar="S",
        help="seconds that the means leave out (10)",
    )  # fmt: skip
    parser.add_argument(
        "--rate", type=positive, default=rate, metavar="HZ",
        help=f"samples a simulated second ({rate:g})",
    )  # fmt: skip


def scene_options(options: argparse.Namespace) -> dict[str, Any]:
    """The arguments of `Scene.load` for these options, besides the settings."""
    return {
        "timestep": options.timestep,
        "keyframe": options.keyframe,
        "densities": dict(options.densities),
    }


@contextmanager
def loading_notice(quiet: bool) -> Iterator[None]:
    """Say on a terminal how long the block takes, when it takes long."""

    def tick() -> None:
        started = monotonic()
        while not done.wait(LOADING_NOTICE_AFTER):
            print(
                f"\rloading ... {monotonic() - started:.0f} s", end="", file=sys.stderr, flush=True
            )
        if monotonic() - started > LOADING_NOTICE_AFTER:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)  # clears the line

    done = threading.Event()
    ticker = threading.Thread(target=tick)
    try:
        if not quiet and sys.stderr.isatty():
            ticker.start()
        yield
    finally:
        done.set()
        if ticker.is_alive():
            ticker.join()


@contextmanager
def notes_said(prog: str, quiet: bool = False) -> Iterator[None]:
    """Say what the block warned of at its end, in one line each on stderr, the same only once; not
    if the block fails, unless by the faults of a model, which notes may explain. The same of what
    MuJoCo and its libraries say, not if the block fails."""
    with warnings.catch_warnings(record=True) as caught, native_lines() as native:
        warnings.simplefilter("default")
        warnings.filterwarnings("always", category=UserWarning)
        is_worth_it, is_done = not quiet, False
        try:
            yield
            is_done = True
        except Exception as error:
            is_worth_it = is_worth_it and hasattr(error, "faults")
            raise
        finally:
            said = [str(w.message) for w in caught] + (native() if is_done else [])
            notes = dict.fromkeys(" ".join(text.split()) for text in said)
            for note in notes if is_worth_it else ():
                print(f"{prog}: note: {note}", file=sys.stderr, flush=True)


@contextmanager
def native_lines() -> Iterator[Callable[[], list[str]]]:
    """Keep what libraries in C print on stderr, and MuJoCo's warnings, which would go to a log file
    in the current folder too. Gives what tells them so far, each cut to a line."""
    import mujoco

    warned: list[str] = []
    python_stderr, stderr = sys.stderr, os.dup(2)
    with tempfile.TemporaryFile() as kept:
        os.dup2(kept.fileno(), 2)
        try:
            is_native = python_stderr.fileno() == 2
        except (OSError, ValueError):
            is_native = False
        if is_native:  # what Python itself says goes where it went
            sys.stderr = os.fdopen(os.dup(stderr), "w", buffering=1)

        def told() -> list[str]:
            kept.seek(0)
            printed = " ".join(kept.read().decode(errors="replace").split())
            return [f"MuJoCo says: {text[:LONGEST_NOTE]}" for text in (*warned, printed) if text]

        mujoco.set_mju_user_warning(warned.append)
        try:
            yield told
        finally:
            mujoco.set_mju_user_warning(None)
            sys.stderr = python_stderr
            os.dup2(stderr, 2)
            os.close(stderr)


def say_errors(prog: str, error: Exception) -> None:
    """An error on stderr, a line for each of its faults."""
    for fault in getattr(error, "faults", (error,)):
        print(f"{prog}: {fault}", file=sys.stderr)


def refusal(prog: str, error: Exception) -> int:
    """Say why nothing was done, and return the exit status."""
    say_errors(prog, error)
    is_full = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT)
    return UNWRITABLE if is_full else UNUSABLE_INPUT


def progress(total: float, unit: str, quiet: bool = False) -> Any:
    """A bar on the terminal, and nothing where nobody looks on; `.update(amount)` moves it."""
    from tqdm import tqdm

    shape = "{percentage:3.0f} %|{bar}| {n:.4g} of {total:g} {unit}, {remaining} left"
    return tqdm(
        total=total, unit=unit, bar_format=shape, leave=False, dynamic_ncols=True,
        disable=quiet or not sys.stderr.isatty(),
    )  # fmt: skip


def print_table(
    titles: Sequence[str], rows: Iterable[Sequence[str]], widths: Mapping[str, int] = NO_WIDTHS
) -> None:
    """Print rows as they come below their titles: the first column to the left, the others to the
    right, each as wide as its title, as its cells where all rows are there, or as `widths` says."""
    known = rows if isinstance(rows, Sequence) else ()
    columns = list(zip(titles, *known, strict=True))
    wide = [max(widths.get(column[0], 0), *map(len, column)) for column in columns]
    for cells in chain([titles], rows):
        first, *others = zip(cells, wide, strict=True)
        line = [f"{first[0]:<{first[1]}}", *(f"{cell:>{width}}" for cell, width in others)]
        print("  ".join(line).rstrip(), flush=True)


def write_json(path: Path | None, report: Any) -> None:
    """Write a report to the file that was asked for, if one was."""
    if path is not None:
        text = json.dumps(report, indent=2) + "\n"
        write_whole(path, lambda beside: beside.write_text(text))


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` write a file beside a path, and move it there when it is whole, so that what
    fails leaves the old one. What is no file, such as a device, is written itself."""
    if path.exists() and not path.is_file():
        write(path)
        return
    target = path.resolve()  # of a link, not the link itself
    beside = target.with_name(f".{os.getpid()}.{target.name}")
    try:
        write(beside)
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)


def check_writable(path: Path | None) -> None:
    """Find out before the work whether its file can be written, and leave none. Raises OSError."""
    if path is None:
        return
    is_new = not path.exists()
    path.open("a").close()
    if is_new:
        path.unlink()


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path]) -> None:
    """Refuse an output that is one of the inputs, by whatever name, or another output. Raises
    ValueError."""
    read = [path for path in inputs if path.exists()]
    written: list[Path] = []
    for path in outputs:
        if path is not None and path.is_dir():
            raise ValueError(f"{path} is a folder; give the name of a file")
        if path is None or (path.exists() and not path.is_file()):
            continue
        for other in read:
            if path.exists() and path.samefile(other):
                raise ValueError(f"{path} is read and would be written over; give another name")
        for other in written:
            same = path.exists() and other.exists() and path.samefile(other)
            if same or path.resolve() == other.resolve():
                raise ValueError(f"{path} is given for two outputs; give each its own name")
        written.append(path)


def check_drawable(path: Path | None) -> None:
    """The same for a figure. Raises ValueError where matplotlib is missing."""
    if path is not None and importlib.util.find_spec("matplotlib") is None:
        raise ValueError(
            "a figure needs matplotlib, which is not installed; run: pip install '.[report]'"
        )
    check_writable(path)


def run_to_the_end(work: Callable[[], None], received: list[int]) -> int:
    """Do a simulation's work, say what stopped it in one line, and return the exit status. Work
    that a signal received stops raises KeyboardInterrupt."""
    import mujoco

    from sim import DivergenceError

    warned: list[str] = []
    mujoco.set_mju_user_warning(warned.append)  # else in a log file in the current folder
    status, trouble = 0, ""
    try:
        work()
    except DivergenceError as error:
        status, trouble = DIVERGED, str(error)
    except OSError as error:
        status, trouble = UNWRITABLE, str(error)
    except KeyboardInterrupt:
        status, trouble = stopped_by(received[0])
    finally:
        mujoco.set_mju_user_warning(None)
    prog = Path(sys.argv[0]).name
    for warning in dict.fromkeys(warned) if status != DIVERGED else ():
        print(f"{prog}: note: MuJoCo says: {warning}", file=sys.stderr)
    if trouble:
        print(f"{prog}: {trouble}", file=sys.stderr)
    return status


def run_script(main: Callable[[], int]) -> NoReturn:
    """End the process with the status of `main`; after Ctrl-C and for a reader of the output that
    went away (`| head`) without a traceback."""
    try:
        try:
            status = main()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the last flush
        status = BROKEN_PIPE
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        with suppress(OSError):  # it may be the one that is full
            print(f"{Path(sys.argv[0]).name}: output: {error.strerror}", file=sys.stderr)
        status = UNWRITABLE
    except KeyboardInterrupt:
        print(f"{Path(sys.argv[0]).name}: interrupted", file=sys.stderr)
        status = INTERRUPTED
    if status == UNWRITABLE:  # a dead writer would hold up Python's orderly end for ever
        with suppress(OSError):
            sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


@contextmanager
def stop_signals(same: float = SAME_SIGNAL) -> Iterator[list[int]]:
    """Note SIGINT and SIGTERM in a list instead of being interrupted anywhere, so that a run stops
    between two samples with nothing half done. Whoever insists, by a signal that comes more than
    `same` seconds after the first, ends the process at once."""
    received: list[int] = []
    at: list[float] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)
        at.append(monotonic())
        if at[-1] - at[0] > same:
            _end_at_once(number, frame)

    heard = [s for s in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(s) != signal.SIG_IGN]
    previous = {s: signal.signal(s, note) for s in heard}
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C raise KeyboardInterrupt, as Python does by itself. Libraries may swallow it, so it
    is for blocks that a second one may have to end."""
    previous = signal.getsignal(signal.SIGINT)
    if previous is _end_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def _open_streams() -> None:
    """Give what was closed a place to go, before a file gets the number of one of them and C
    libraries write into it; names that are no UTF-8 are printed with escapes."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")


def _warn_in_a_line(message: Warning | str, *_: Any) -> None:
    text = " ".join(str(message).split())
    print(f"{Path(sys.argv[0]).name}: note: {text}", file=sys.stderr)


if IS_SCRIPT:
    _open_streams()
    warnings.showwarning = _warn_in_a_line
