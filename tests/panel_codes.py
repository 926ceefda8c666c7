"""Coefficients of bodies as a panel code gives them, for the tests."""

from pathlib import Path
from typing import Any

import numpy as np

from sim.resistance.hydrodynamics import Hydrodynamics

HEAVE = 2
"""Index of the heave among the six motions."""


def column(a0: float, a1: float, size: float, motion: int = HEAVE) -> list[float]:
    """A column of a memory in one motion; size: its coefficient c = l^2."""
    row = [a0, a1, *np.zeros(6)]
    row[2 + motion] = size**0.5
    return row


def coefficients(**changes: Any) -> Hydrodynamics:
    """Coefficients that are 0 but for the changes."""
    fields: dict[str, Any] = dict(
        position=np.zeros(3), rotation=np.eye(3), added_mass=np.zeros((6, 6)),
        memory=np.zeros((0, 8)), frequencies=[], headings=[], diffraction=np.zeros((0, 0, 6)),
        density=1025.0, gravity=9.81,
    )  # fmt: skip
    return Hydrodynamics(**{**fields, **changes})


def text_of(folder: Path, body: str, **changes: Any) -> str:
    """The custom text that names a file with `coefficients` for a body."""
    path = folder / f"{body}.npz"
    coefficients(**changes).save(path)
    return f'<text name="hydrodynamics_{body}" data="{path}"/>'


def random_matrix(rng: np.random.Generator, size: float) -> np.ndarray:
    """A symmetric, positive definite matrix (6, 6) with eigenvalues about a size."""
    root = rng.normal(size=(6, 6))
    return size * (root @ root.T / 6.0 + np.eye(6))
