"""Faults: errors of a model."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager


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
