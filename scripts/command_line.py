"""What the scripts' command lines have in common: exit statuses, one-line errors, progress."""

import argparse
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

UNUSABLE_INPUT, DIVERGED, UNWRITABLE, INTERRUPTED = 2, 3, 4, 130

COMPILING_NOTICE_AFTER = 1.0
"""Seconds after which loading a scene can only mean that kernels are being compiled."""


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the command line in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(UNUSABLE_INPUT, f"{self.prog}: {message} (see --help)\n")


def positive(text: str) -> float:
    """A number above 0 from the command line."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number above 0")
    return value


def at_least(lowest: int) -> Callable[[str], int]:
    """A reader of whole numbers from the command line that are not below `lowest`."""

    def read(text: str) -> int:
        value = int(text)
        if value < lowest:
            raise argparse.ArgumentTypeError(f"{value} is below {lowest}")
        return value

    read.__name__ = "whole number"  # argparse's word for it when int() fails
    return read


@contextmanager
def compiling_notice(quiet: bool) -> Iterator[None]:
    """Say that kernels are being compiled if what happens in the block takes long enough for it."""

    def say() -> None:
        print("compiling the kernels; this is done once and kept ...", file=sys.stderr, flush=True)

    timer = threading.Timer(COMPILING_NOTICE_AFTER, say)
    if not quiet:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


def show_progress(done: float, total: float, unit: str = "s") -> None:
    """Draw a bar on the terminal's current line."""
    width = 40
    filled = min(width, round(width * done / total))
    bar = "#" * filled + "." * (width - filled)
    print(f"\r[{bar}] {done:.4g} of {total:g} {unit}", end="", file=sys.stderr, flush=True)


def clear_progress() -> None:
    """Take the bar off the terminal."""
    print("\r\033[K", end="", file=sys.stderr, flush=True)
