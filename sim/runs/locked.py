"""Locked: a file that one process at a time writes, and that is never left empty."""

import os
from pathlib import Path
from typing import NoReturn, Self

from sim.platforms import lock, remove_open


class LockedFile:
    """A file that is open for appending, and locked until it is closed; a context manager.

    Missing folders are made. The file keeps the content that it had. It is removed if it is empty
    when it is closed. Raises OSError if it cannot be opened or is locked by another process.

    name: the path that was given. path: the same with links followed. is_open: whether it is not
    closed yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.path.exists() and not self.path.is_file():  # opening a pipe would wait for a reader
            raise OSError(f"{path} is no file but a folder or a device; give another name")
        self.name = path
        self._file = self.path.open("ab", buffering=0)
        if not lock(self._file):
            self._file.close()
            raise OSError(f"{path} is being written by another run; give another name")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        return not self._file.closed

    @property
    def size(self) -> int:
        """Size [bytes], of which all is on the disk or in the system's buffers."""
        return os.fstat(self._file.fileno()).st_size

    @property
    def is_removed(self) -> bool:
        """Whether another process has removed the file."""
        return os.fstat(self._file.fileno()).st_nlink == 0

    def check(self) -> None:
        """Close the file and raise OSError if it was removed."""
        if self.is_removed:
            self.close()
            raise OSError(f"{self.name} was removed while it was written; run again")

    def append(self, content: bytes) -> None:
        """Write bytes to the disk, or nothing. Raises OSError."""
        before = self.size
        try:
            while content:
                content = content[self._file.write(content) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            self.cut(before)
            raise_unwritable(self.name, error)
        self.check()

    def check_room(self, size: int) -> None:
        """Close the file and raise OSError if that many more bytes do not fit on the disk."""
        before = self.size
        try:
            self.append(bytes(size))
        except OSError:
            self.close()
            raise
        self.cut(before)

    def cut(self, size: int) -> None:
        """Remove the content after a size [bytes]."""
        self._file.truncate(size)

    def close(self) -> None:
        """Close the file. Further calls do nothing."""
        if not self.is_open:
            return
        if self.size == 0 and not self.is_removed:
            remove_open(self._file, self.path)
        self._file.close()


def raise_unwritable(path: Path, error: Exception) -> NoReturn:
    """Raise OSError about a file that cannot be written because of an error."""
    reason = " ".join(str(getattr(error, "strerror", None) or error).split())
    raise OSError(
        f"{path} cannot be written ({reason}); make room on the disk or write elsewhere"
    ) from None
