"""The file of a body's coefficients."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from sim.resistance.hydrodynamics import Hydrodynamics


def made() -> Hydrodynamics:
    """Coefficients with a different number everywhere."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return Hydrodynamics(
        position=rng.normal(size=3),
        rotation=turn * np.linalg.det(turn),
        added_mass=root @ root.T,
        memory=rng.uniform(0.1, 2.0, size=(3, 8)),
        frequencies=np.array([0.5, 1.0]),
        headings=np.array([0.0, 1.0, 2.0]),
        diffraction=rng.normal(size=(2, 3, 6)) + 1j * rng.normal(size=(2, 3, 6)),
        density=1025.0,
        gravity=9.81,
    )


def test_file_keeps_every_bit(tmp_path: Path) -> None:
    written = made()
    written.save(tmp_path / "a.npz")
    read = Hydrodynamics.load(tmp_path / "a.npz")
    for field in fields(Hydrodynamics):
        assert np.array_equal(getattr(read, field.name), getattr(written, field.name)), field.name
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"position": np.zeros(2)}, "position has the shape"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "no rotation"),
        ({"added_mass": np.diag([1.0, 1, 1, 1, 1, -1])}, "negative eigenvalue"),
        ({"memory": np.array([[-1.0, 1, 0, 0, 1, 0, 0, 0]])}, "a0 is -1 in row 1"),
        ({"memory": np.array([[1.0, 0, 0, 0, 1, 0, 0, 0]])}, "a1 is 0 in row 1"),
        ({"memory": np.zeros((2, 7))}, "memory has the shape"),
        ({"frequencies": np.array([1.0, 0.5])}, "not ascending"),
        ({"frequencies": np.array([0.0, 0.5])}, "begin with 0"),
        ({"headings": np.array([0.0, 3.0, 7.0])}, "at most a full turn"),
        ({"diffraction": np.full((2, 3, 6), np.nan)}, "not finite"),
        ({"diffraction": np.zeros((3, 2, 6))}, "diffraction has the shape"),
        ({"density": 0.0}, "density is 0"),
        ({"depth": np.nan}, "depth has a number that is not finite"),
    ],
)
def test_wrong_numbers_are_refused(change: dict[str, np.ndarray], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(made(), **change)  # type: ignore[arg-type]


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no file"):
        Hydrodynamics.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="cannot be read"):
        Hydrodynamics.load(tmp_path / "text.npz")
    np.savez(tmp_path / "less.npz", position=np.zeros(3))
    with pytest.raises(ValueError, match="lacks rotation"):
        Hydrodynamics.load(tmp_path / "less.npz")
