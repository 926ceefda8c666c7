"""Faults and notes: errors of a model, and warnings for its author."""

import re
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

PACKAGE = str(Path(__file__).parents[1])
"""The folder of this package."""

NAMES_AND_NUMBERS = re.compile(r"'[^']*'|[-+.\d]+(e[-+]?\d+)?")
"""Names and numbers in notes. Notes that differ only in these are of the same kind."""


class Note(UserWarning):
    """A warning about something that the author of a scene probably did not intend."""


class ModelError(ValueError):
    """A model that cannot float. faults: one line each. notes: likely mistakes, which may explain
    the faults."""

    def __init__(self, faults: Iterable[str], notes: Iterable[str] = ()) -> None:
        self.faults, self.notes = tuple(faults), tuple(notes)
        super().__init__("\n".join(self.faults))

    def __reduce__(self) -> tuple[type, tuple[tuple[str, ...]]]:
        return type(self), (self.faults,)

    def located(self, where: str) -> "ModelError":
        """The same error with a location before each fault."""
        return ModelError(f"{where}: {fault}" for fault in self.faults)


class Faults:
    """The faults that have been found so far."""

    def __init__(self) -> None:
        self.found: list[str] = []

    @contextmanager
    def collected(self) -> Iterator[None]:
        """A block whose ValueError is collected, once, instead of being raised."""
        try:
            yield
        except ValueError as error:
            for fault in getattr(error, "faults", (str(error),)):
                if fault not in self.found:
                    self.found.append(fault)

    def refuse(self, notes: Iterable[str] = ()) -> None:
        """Raise ModelError if there are faults."""
        if self.found:
            raise ModelError(self.found, notes)


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
