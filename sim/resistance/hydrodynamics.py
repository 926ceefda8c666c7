"""Hydrodynamics: the response of the water to one floating body, from a panel code.

A body that moves makes waves, and these act on it later: the *memory* of the water. A body in waves
scatters them: *diffraction*. Both are linear in the motion and in the waves, and are given for a
body at rest in a *rest frame*: z up, x along the world's x at rest. All (6,) and (6, 6) are over
(translation, rotation), along the axes and about the origin of that frame.

The memory is a sum over columns l (6,), with a0, a1 > 0, of the force - l x1, where

    x1' = - a1 x1 - a0 x2 + l . nu,    x2' = x1,

and nu is the body's velocity. Its energy is (x1^2 + a0 x2^2) / 2, of which a1 x1^2 is lost per
second. So the memory never drives a body, whatever its numbers. In the frequency domain it is

    B + i omega (A - A_inf) = sum of l l^T i omega / (a0 - omega^2 + i a1 omega).

Sources: Cummins 1962 for the memory; Perez and Fossen 2008 for states in place of a convolution.
"""

import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.resistance.added_mass import checked_matrix

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

COLUMN_SIZE = 8
"""Numbers of a column of the memory: a0 [1/s^2], a1 [1/s], l (6)."""

MOST_COLUMNS = 36
"""Largest number of columns of a body. The plugin reserves states for them before it can read the
file. Two or three a degree of freedom are enough."""

ROTATION_ERROR = 1e-6
"""Largest deviation of R^T R from the identity in a file's rotation."""


@dataclass(frozen=True, eq=False)
class Hydrodynamics:
    """Coefficients of one body that floats at rest, e.g. from a panel code.

    position (3,) [m], rotation (3, 3): the rest frame in the body's frame (of MJCF, not the
        inertial one): point_body = position + rotation @ point_rest
    added_mass (6, 6) [kg, kg m, kg m^2]: at infinite frequency, symmetric
    memory (N, 8): rows a0 [1/s^2], a1 [1/s], l (6) [sqrt(kg)/s, m sqrt(kg)/s]
    frequencies (F,) [rad/s], ascending; none: no diffraction
    headings (B,) [rad], ascending: directions in which waves travel, in the rest frame
    diffraction (F, B, 6), complex [N/m, N]: an elevation Re(a e^(-i omega t)) at the origin of the
        rest frame gives the wrench Re(a X e^(-i omega t)), without Froude-Krylov
    density [kg/m^3], gravity [m/s^2], depth [m]: of the water; depth is inf in deep water

    Raises ValueError for invalid numbers.
    """

    position: Array
    rotation: Array
    added_mass: Array
    memory: Array
    frequencies: Array
    headings: Array
    diffraction: Complex
    density: float
    gravity: float
    depth: float = np.inf

    def __post_init__(self) -> None:
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        for name, value in own.items():
            kind = np.complex128 if name == "diffraction" else np.float64
            array = np.array(value, dtype=kind)
            object.__setattr__(self, name, array if array.ndim else float(array))
        count, headings = np.size(self.frequencies), np.size(self.headings)
        for name, shape in (
            ("position", (3,)), ("rotation", (3, 3)), ("added_mass", (6, 6)),
            ("memory", (len(np.atleast_1d(self.memory)), COLUMN_SIZE)), ("frequencies", (count,)),
            ("headings", (headings,)), ("diffraction", (count, headings, 6)), ("density", ()),
            ("gravity", ()), ("depth", ()),
        ):  # fmt: skip
            self._check_array(name, shape)
        self._check_values()

    def _check_array(self, name: str, shape: tuple[int, ...]) -> None:
        """Raise ValueError for an array of another shape, or with a number that is not finite."""
        value = np.asarray(getattr(self, name))
        if value.shape != shape:
            raise ValueError(f"{name} has the shape {value.shape}; expected {shape}")
        if not np.isfinite(value).all() and (name, self.depth) != ("depth", np.inf):
            raise ValueError(f"{name} has a number that is not finite; correct it")

    def _check_values(self) -> None:
        """Raise ValueError for numbers that no body has."""
        error = np.abs(self.rotation.T @ self.rotation - np.eye(3)).max()
        if error > ROTATION_ERROR or np.linalg.det(self.rotation) < 0.0:
            raise ValueError("rotation is no rotation; expected R^T R = 1 and det R = 1")
        object.__setattr__(self, "added_mass", checked_matrix(self.added_mass, "added mass"))
        if len(self.memory) > MOST_COLUMNS:
            raise ValueError(
                f"memory has {len(self.memory)} columns; expected at most {MOST_COLUMNS}: fit fewer"
            )
        check_memory(self.memory)
        for name in ("density", "gravity", "depth"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} is {getattr(self, name):g}; it must be above 0")
        for name, values in (("frequencies", self.frequencies), ("headings", self.headings)):
            if not (np.diff(values) > 0.0).all():
                raise ValueError(f"{name} are not ascending; sort them, each once")
        if len(self.frequencies) and not self.frequencies[0] > 0.0:
            raise ValueError(f"frequencies begin with {self.frequencies[0]:g}; expected above 0")
        if len(self.frequencies) and not len(self.headings):
            raise ValueError("there are frequencies but no headings; give at least one heading")
        if len(self.headings) and np.ptp(self.headings) > 2.0 * np.pi * (1.0 + 1e-9):
            raise ValueError(
                f"headings span {np.ptp(self.headings):.4g} rad; expected at most a full turn"
            )

    def save(self, path: str | Path) -> None:
        """Write an .npz file with an array for each field. The file appears when it is complete."""
        path = Path(path)
        part = path.with_name(path.name + ".part")
        with part.open("wb") as file:
            np.savez(file, **{field.name: getattr(self, field.name) for field in fields(self)})
        part.replace(path)

    @classmethod
    def load(cls, path: str | Path) -> "Hydrodynamics":
        """Read a file that `save` wrote. Raises ValueError for anything else."""
        names = [field.name for field in fields(cls)]
        remedy = "expected a file that scripts/coefficients.py wrote: make it again"
        try:
            with np.load(path, allow_pickle=False) as file:
                found = {name: file[name] for name in names if name in file}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError) as error:
            if not Path(path).is_file():
                raise ValueError(f"there is no file {Path(path).absolute()}; {remedy}") from None
            raise ValueError(f"{path} cannot be read ({error}); {remedy}") from None
        missing = [name for name in names if name not in found]
        if missing:
            raise ValueError(f"{path} lacks {', '.join(missing)}; {remedy}")
        try:
            return cls(**found)  # type: ignore[arg-type]
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: {error}") from None


def check_memory(rows: ArrayLike) -> Array:
    """Rows (N, 8) of a memory as an array. Raises ValueError for a0 or a1 that is not above 0: it
    would drive the body."""
    rows = np.asarray(rows, dtype=float).reshape(-1, COLUMN_SIZE)
    for name, values in (("a0", rows[:, 0]), ("a1", rows[:, 1])):
        if not (values > 0.0).all():
            worst = int(np.argmin(values))
            raise ValueError(
                f"the memory's {name} is {values[worst]:g} in row {worst + 1}; it must be above 0, "
                "or the memory would drive the body"
            )
    return rows
