"""Reader: the time series of a recording as arrays, for plots and sums of one's own."""

import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader

Array = NDArray[np.float64]

PLOTS, OTHERS = "/plots/", "/others/"
"""Where the series of the bodies that are plotted stand, one an entity, and of the others,
all in one."""

SCALARS, NAMES = "Scalars:scalars", "SeriesLines:names"


FILE_HEADER, MESSAGE_HEADER = 12, struct.Struct("<QQ")
"""Bytes at the start of an .rrd file, and kind and length [bytes] at the start of each message."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Path of a recording as far as its messages are whole: its own or that of a copy. A run that
    was killed as it wrote one leaves a part of it, and Rerun refuses to open such a file."""
    length = whole_length(path)
    with TemporaryDirectory() as folder:
        if length < path.stat().st_size:
            copy = Path(folder) / path.name
            with path.open("rb") as source:
                copy.write_bytes(source.read(length))
            path = copy
        yield path


@contextmanager
def reader(path: Path) -> Iterator[RrdReader]:
    """A recording opened for reading, as far as it is whole, and without Rerun's warning that what
    a killed run leaves has no table of contents."""
    with whole(path) as readable, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        yield RrdReader(readable)


def whole_length(path: Path) -> int:
    """Bytes until the end of the last whole message of an .rrd file; all of any other file."""
    size, end = path.stat().st_size, FILE_HEADER
    with path.open("rb") as file:
        if file.read(4) != b"RRF2":
            return size
        while end + MESSAGE_HEADER.size <= size:
            file.seek(end)
            _, length = MESSAGE_HEADER.unpack(file.read(MESSAGE_HEADER.size))
            if end + MESSAGE_HEADER.size + length > size:
                return end
            end += MESSAGE_HEADER.size + length
    return size


def read_series(path: str | Path) -> dict[str, tuple[Array, Array]]:
    """Times (N,) [s] and values (N,) of each series of a recording by run.py, by its name
    <quantity>/<body>, as 'height/bunny', 'height/bunny/water', 'heave/bunny', 'surge/bunny' [m],
    'tilt/bunny', 'heel/bunny', 'trim/bunny' [deg], 'submerged/bunny' [of the volume], 'force/bunny'
    [weights].

    Raises FileNotFoundError, or ValueError for a file that has no series.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no recording {path}; make one with scripts/run.py")
    parts: dict[str, list[tuple[Array, Array]]] = {}
    bodies: dict[str, list[str]] = {}
    try:
        with reader(path) as recording:
            for chunk in recording.stream().filter(content=[f"{PLOTS}**", f"{OTHERS}**"]):
                batch, entity = chunk.to_record_batch(), chunk.entity_path
                if NAMES in batch.schema.names and entity.startswith(OTHERS):
                    (bodies[entity],) = batch.column(NAMES).to_pylist()
                if chunk.is_static or SCALARS not in batch.schema.names:
                    continue
                times = batch.column("time").cast("int64").to_numpy() * 1e-9  # from nanoseconds
                values = np.array(batch.column(SCALARS).to_pylist())
                parts.setdefault(entity, []).append((times, values))
    except RuntimeError as error:
        raise ValueError(f"{path} is no recording that can be read: {error}") from None
    if not parts:
        raise ValueError(f"{path} has no series under {PLOTS}; give a recording by scripts/run.py")
    series = {}
    for entity, chunks in sorted(parts.items()):
        times, values = _in_order(chunks)
        names = _names(entity, bodies.get(entity, []))
        series |= {name: (times, values[:, i]) for i, name in enumerate(names)}
    return series


def _names(entity: str, bodies: list[str]) -> list[str]:
    """Names of the series of an entity, which those of others do not have in their path."""
    if entity.startswith(PLOTS):
        return [_unescaped(entity.removeprefix(PLOTS))]
    quantity, *rest = entity.removeprefix(OTHERS).split("/")
    return ["/".join([quantity, body, *rest]) for body in bodies]


def _unescaped(path: str) -> str:
    """A path of an entity without Rerun's escapes."""
    plain = {"n": "\n", "t": "\t", "r": "\r"}

    def of(match: re.Match[str]) -> str:
        code, letter = match.groups()
        return chr(int(code, 16)) if code else plain.get(letter, letter)

    return re.sub(r"\\(?:u\{([0-9a-fA-F]+)\}|(.))", of, path)


def _in_order(chunks: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    times, values = (np.concatenate(column) for column in zip(*chunks, strict=True))
    order = np.argsort(times, kind="stable")
    return times[order], values[order]
