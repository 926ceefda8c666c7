"""Reader: the time series of a recording as arrays."""

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

from sim.recording.output import PROGRAM

Array = NDArray[np.float64]

PLOTS, OTHERS = "/plots/", "/others/"
"""Entity paths of the series of plotted bodies, with an entity for each series, and of the other
bodies, with an entity for each quantity."""

SCALARS, NAMES = "Scalars:scalars", "SeriesLines:names"

HEADER_BYTES, MESSAGE_HEADER = 12, struct.Struct("<QQ")
"""Length of the header of an .rrd file, and the header of a message: kind and length [bytes]."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """The path of a recording, or of a copy without an incomplete last message, which a killed run
    may leave and with which Rerun refuses to open the file."""
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
    """A recording opened for reading, without an incomplete last message, and without Rerun's
    warning that the recording of a killed run has no table of contents."""
    with whole(path) as readable, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        yield RrdReader(readable)


def whole_length(path: Path) -> int:
    """Bytes up to the end of the last whole message of an .rrd file; the size of any other file."""
    size, end = path.stat().st_size, HEADER_BYTES
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
    """Times (N,) [s] and values (N,) of each series of a recording by run.py, by name.

    A name is <quantity>/<body>: 'height/bunny', 'height/bunny/water', 'heave/bunny', 'surge/bunny'
    [m], 'tilt/bunny', 'heel/bunny', 'trim/bunny' [deg], 'submerged/bunny' [of the volume],
    'force/bunny' [weights]. Raises FileNotFoundError, or ValueError for a file without series.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no recording {path}; make one with scripts/run.py")
    chunks: dict[str, list[tuple[Array, Array]]] = {}
    bodies: dict[str, list[str]] = {}
    try:
        with reader(path) as recording:
            programs = {entry.application_id for entry in recording.recordings()}
            if not programs <= {PROGRAM}:
                raise ValueError(
                    f"{path} is a recording by {', '.join(sorted(programs))}, not by Waterline; "
                    "give a recording by scripts/run.py"
                )
            for chunk in recording.stream().filter(content=[f"{PLOTS}**", f"{OTHERS}**"]):
                batch, entity = chunk.to_record_batch(), chunk.entity_path
                if NAMES in batch.schema.names and entity.startswith(OTHERS):
                    (bodies[entity],) = batch.column(NAMES).to_pylist()
                if chunk.is_static or SCALARS not in batch.schema.names:
                    continue
                times = batch.column("time").cast("int64").to_numpy() * 1e-9  # from nanoseconds
                values = np.array(batch.column(SCALARS).to_pylist())
                chunks.setdefault(entity, []).append((times, values))
    except RuntimeError as error:
        raise ValueError(f"{path} is no recording that can be read: {error}") from None
    if not chunks:
        raise ValueError(f"{path} has no series under {PLOTS}; give a recording by scripts/run.py")
    series = {}
    for entity, pieces in sorted(chunks.items()):
        times, values = (np.concatenate(column) for column in zip(*pieces, strict=True))
        order = np.argsort(times, kind="stable")
        times, values = times[order], values[order]
        names = _names(entity, bodies.get(entity, []))
        series |= {name: (times, values[:, i]) for i, name in enumerate(names)}
    return series


def _names(entity: str, bodies: list[str]) -> list[str]:
    """Names of the series of an entity."""
    if entity.startswith(PLOTS):
        return [_unescaped(entity.removeprefix(PLOTS))]
    quantity, *rest = entity.removeprefix(OTHERS).split("/")
    return ["/".join([quantity, body, *rest]) for body in bodies]


def _unescaped(path: str) -> str:
    """An entity path without Rerun's escapes."""
    controls = {"n": "\n", "t": "\t", "r": "\r"}

    def character(match: re.Match[str]) -> str:
        code, letter = match.groups()
        return chr(int(code, 16)) if code else controls.get(letter, letter)

    return re.sub(r"\\(?:u\{([0-9a-fA-F]+)\}|(.))", character, path)
