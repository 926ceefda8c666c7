"""Files: reads a surface of triangles from a mesh file."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from sim.hulls.hull import checked_arrays
from sim.hulls.panels import READERS, read_panels
from sim.hulls.tidying import size_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

EXTRA = ("pycollada", "networkx", "lxml")
"""Packages with which trimesh reads more formats, and which the extra `meshes` installs."""

SMALLEST_SIZE = 1e-9
"""Smallest size [m] of a surface; products of smaller lengths are lost in round-off."""


def read_surface(path: Path, scale: float = 1.0) -> tuple[Array, Indices]:
    """Vertices (V, 3), scaled, and faces (F, 3) of a file in any format that trimesh reads, or of a
    panel file (see `panels`). Raises ValueError for a file without a surface, and
    FileNotFoundError."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        is_panels = path.suffix.lower() in READERS
        vertices, faces = read_panels(path) if is_panels else _read_mesh(path)
        if len(faces) == 0:
            raise ValueError("it has no faces; expected a surface of triangles")
        vertices, faces = checked_arrays(scale * vertices, faces)
        if size_of(vertices[faces].reshape(-1, 3)) < SMALLEST_SIZE:
            raise ValueError("all vertices lie in one point; expected a surface of triangles")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return vertices, faces


def _read_mesh(path: Path) -> tuple[Array, NDArray[Any]]:
    """Vertices and faces of a file in a format that trimesh reads. Raises ValueError."""
    try:
        mesh: Any = trimesh.load(path, process=False, force="mesh")
        return np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    except ImportError as error:
        raise ValueError(_missing(error, path.suffix)) from None
    except Exception as error:  # trimesh's readers raise errors of many kinds
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"trimesh cannot read it: {reason}") from None


def _missing(error: ImportError, ending: str) -> str:
    """What is wrong if trimesh does not find a package."""
    named = re.search(r"pip install (\w+)|No module named '(\w+)'", str(error))
    package = next(filter(None, named.groups()), "") if named else ""
    if package == "charset_normalizer":  # it guesses the encoding of a text that is not in UTF-8
        return f"trimesh cannot read it: it is no {ending or 'file of a known kind'}"
    source = "'.[meshes]'" if package in EXTRA else package
    needed = f"trimesh needs {package or error} for {ending}, which is not installed"
    return f"{needed}; run: pip install {source}"
