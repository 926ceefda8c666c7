"""Panels: files of panel codes for wave forces, which hold the wetted surface of a hull.

    .gdf         WAMIT, with the symmetry flags ISX and ISY
    .dat, .mar   Nemoh, with its flag for a hull that is symmetric about y = 0
    .pnl         HAMS, with the flags X-Symmetry and Y-Symmetry

The panels have three or four corners, and the still water's surface is z = 0. Such a surface is
open at the waterline.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.geometry import distinct_points
from sim.hulls.topology import collapsed, compacted

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Words = list[list[str]]
"""The words of each line of a file that has any."""


class Panels(NamedTuple):
    """Panels: positions of the corners by their names in the file, the names of the corners of each
    panel, counterclockwise seen from the water, and the axes ("x", "y") along which the surface
    must be mirrored at 0."""

    corners: dict[int, list[float]]
    panels: list[list[int]]
    mirrored: str


def read_panels(path: Path) -> tuple[Array, Indices]:
    """Vertices (V, 3) and faces (F, 3) of a panel file, with its mirror images. Raises ValueError,
    OSError."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    code, parse = READERS[path.suffix.lower()]
    try:
        corners, panels, mirrored = parse([line.split() for line in lines if line.split()])
        number = {name: i for i, name in enumerate(corners)}
        fans = [
            (number[first], number[a], number[b])
            for first, *others in panels
            for a, b in pairwise(others)
        ]
        vertices = np.array([*corners.values()], dtype=float).reshape(-1, 3)
    except (ValueError, IndexError, KeyError) as error:
        raise ValueError(f"it is not a panel file of {code} ({error})") from None
    faces = np.array(fans, dtype=np.int64).reshape(-1, 3)
    for axis in mirrored:
        image = np.where(np.arange(3) == "xyz".index(axis), -vertices, vertices)
        faces = np.concatenate([faces, faces[:, ::-1] + len(vertices)])
        vertices = np.concatenate([vertices, image])
    return _joined(vertices, faces)


def _joined(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """The surface with one vertex at each position, without the faces that collapse: panels with
    three corners repeat one of them."""
    if len(faces) == 0 or not np.isfinite(vertices).all():
        return vertices, faces
    first, number = distinct_points(vertices)
    faces = first[number][faces]
    return compacted(vertices, faces[~collapsed(faces)])


def _wamit(lines: Words) -> Panels:
    """A title; length and gravity; ISX, ISY; the number of panels; four corners of each panel."""
    mirrored = _axes(lines[2][:2])
    count = int(lines[3][0])
    numbers = [float(word) for line in lines[4:] for word in line[:12]][: 12 * count]
    points = np.array(numbers).reshape(count, 4, 3).reshape(-1, 3)
    panels = np.arange(len(points)).reshape(-1, 4).tolist()
    return Panels(dict(enumerate(points.tolist())), panels, mirrored)


def _nemoh(lines: Words) -> Panels:
    """The number 2 and the flag; lines of a corner's name and position; lines of four names. Each
    list ends with a line of zeros."""
    two, flag = map(int, lines[0][:2])
    if two != 2:
        raise ValueError(f"it begins with {two}, not with 2")
    ends = [i for i, line in enumerate(lines) if i > 0 and int(line[0]) == 0]
    corners = {int(name): [*map(float, place[:3])] for name, *place in lines[1 : ends[0]]}
    panels = [[int(name) for name in line[:4]] for line in lines[ends[0] + 1 : ends[1]]]
    return Panels(corners, panels, _axes(["0", str(flag)]))


def _hams(lines: Words) -> Panels:
    """Numbers of panels and corners, and two flags; lines of a corner's name and position; lines of
    a panel's name, its number of corners and their names. Other lines are comments."""
    head, *rows = [line for line in lines if line[0][0] not in "#-"]
    panel_count, corner_count = map(int, head[:2])
    corners = {int(name): [*map(float, place[:3])] for name, *place in rows[:corner_count]}
    of_panels = [[*map(int, line)] for line in rows[corner_count : corner_count + panel_count]]
    if len(of_panels) < panel_count:
        raise ValueError(f"it has {len(of_panels)} of {panel_count} panels")
    return Panels(corners, [line[2 : 2 + line[1]] for line in of_panels], _axes(head[2:4]))


def _axes(flags: Sequence[str]) -> str:
    """The axes whose flag is 1. Raises ValueError for flags other than 0 and 1."""
    numbers = [int(flag) for flag in flags]
    if not {*numbers} <= {0, 1}:
        raise ValueError(f"its symmetry flags are {' '.join(flags)}; expected 0 or 1")
    return "".join(axis for axis, flag in zip("xy", numbers, strict=True) if flag)


READERS: dict[str, tuple[str, Callable[[Words], Panels]]] = {
    ".gdf": ("WAMIT", _wamit),
    ".dat": ("Nemoh", _nemoh),
    ".mar": ("Nemoh", _nemoh),
    ".pnl": ("HAMS", _hams),
}
"""The code and the reader of the files, by the ending of their names."""
