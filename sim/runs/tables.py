"""Tables: columns of numbers and words in a CSV, Parquet or NumPy file, chosen by its ending."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Column = NDArray[Any]

ENDINGS = (".csv", ".parquet", ".npz")


def check_ending(path: Path) -> None:
    """Raise ValueError if the name of a file does not end in one of ENDINGS."""
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"{path}: expected a name that ends in {', '.join(ENDINGS)}")


def write_columns(path: Path, columns: Mapping[str, Column], ending: str | None = None) -> None:
    """Write columns of equal length as .csv, .parquet or .npz, chosen by `ending`, or by the path's
    suffix. Raises OSError."""
    kind = (ending or path.suffix).lower()
    columns = {name: np.asarray(column) for name, column in columns.items()}
    if kind == ".parquet":
        import pyarrow
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    elif kind == ".npz":
        with path.open("wb") as file:
            arrays: dict[str, Any] = dict(columns)
            np.savez_compressed(file, **arrays)
    else:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*(c.tolist() for c in columns.values()), strict=True))


def read_columns(path: Path) -> dict[str, Column]:
    """Read the columns of a file that `write_columns` wrote. Raises ValueError, OSError."""
    check_ending(path)
    if path.suffix.lower() == ".parquet":
        import pyarrow.parquet

        table = pyarrow.parquet.read_table(path)
        return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
    if path.suffix.lower() == ".npz":
        with np.load(path) as file:
            return dict(file)
    with path.open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    columns = zip(*rows, strict=True)
    return {name: _typed(column) for name, column in zip(names, columns, strict=True)}


def _typed(words: tuple[str, ...]) -> Column:
    try:
        return np.array([float(word) if word else np.nan for word in words])
    except ValueError:
        return np.array(words)
