"""Faults and notes: what a model cannot have, all of it at once, and what is worth knowing."""

import re
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

PACKAGE = str(Path(__file__).parents[1])
"""Where the files of this package are."""

NAMES_AND_NUMBERS = re.compile(r"'[^']*'|[-+.\d]+(e[-+]?\d+)?")
"""What notes of one kind differ in."""


class Note(UserWarning):
    """What a user of a scene would want to know before the first step, and is no fault. A class of
    its own, so that `warnings` can silence it or make it an error."""


class ModelError(ValueError):
    """A model that cannot float as it is; faults: what is wrong, a line each; notes: what is likely
    not meant besides, and may tell why."""

    def __init__(self, faults: Iterable[str], notes: Iterable[str] = ()) -> None:
        self.faults, self.notes = tuple(faults), tuple(notes)
        super().__init__("\n".join(self.faults))

    def __reduce__(self) -> tuple[type, tuple[tuple[str, ...]]]:
        return type(self), (self.faults,)

    def located(self, where: str) -> "ModelError":
        """The same with the place before each fault."""
        return ModelError(f"{where}: {fault}" for fault in self.faults)


class Faults:
    """Faults as they are found."""

    def __init__(self) -> None:
        self.found: list[str] = []

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Go on after a block that raises ValueError, which is kept, each only once."""
        try:
            yield
        except ValueError as error:
            for fault in getattr(error, "faults", (str(error),)):
                if fault not in self.found:
                    self.found.append(fault)

    def refuse(self, notes: Iterable[str] = ()) -> None:
        """Raise ModelError, with notes, if there are any."""
        if self.found:
            raise ModelError(self.found, notes)


def say(notes: Iterable[str]) -> None:
    """Warn of each as a Note; of those that differ in names and numbers alone, of the first. The
    warning points at the line outside this package that asked."""
    alike: dict[str, list[str]] = {}
    for note in dict.fromkeys(notes):
        alike.setdefault(NAMES_AND_NUMBERS.sub("", note), []).append(note)
    for first, *others in alike.values():
        more = f" ({len(others)} more like this)" if others else ""
        warnings.warn(first + more, Note, stacklevel=_distance_of_caller())


def _distance_of_caller() -> int:
    """The `stacklevel` of the first frame outside this package, for the function that asks."""
    frame, distance = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        frame, distance = frame.f_back, distance + 1
    return distance
