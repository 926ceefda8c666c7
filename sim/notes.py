"""Notes: warnings for the author of a scene or a method."""

import re
import sys
import warnings
from collections.abc import Iterable
from pathlib import Path

PACKAGE = str(Path(__file__).parent)
"""The folder of this package."""

NAMES_AND_NUMBERS = re.compile(r"'[^']*'|[-+.\d]+(e[-+]?\d+)?")
"""Names and numbers in notes. Notes that differ only in these are of the same kind."""


class Note(UserWarning):
    """A warning about something that its author probably did not intend."""


def say(notes: Iterable[str]) -> None:
    """Warn of each note. Only the first of several notes of the same kind is shown, with the number
    of the others. The warning points at the caller's line outside this package."""
    alike: dict[str, list[str]] = {}
    for note in dict.fromkeys(notes):
        alike.setdefault(NAMES_AND_NUMBERS.sub("", note), []).append(note)
    for first, *others in alike.values():
        more = f" ({len(others)} more like this)" if others else ""
        warnings.warn(first + more, Note, stacklevel=_distance_of_caller())


def _distance_of_caller() -> int:
    """The `stacklevel` of the first frame outside this package, as seen by the caller."""
    frame, distance = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        frame, distance = frame.f_back, distance + 1
    return distance
