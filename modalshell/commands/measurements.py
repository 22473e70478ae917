"""Measured positions and frequencies read from files, for fits."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from modalshell.core.checks import shortened, shown
from modalshell.core.errors import FileFormatError
from modalshell.core.typing import Array
from modalshell.files.atomic_io import read_npz
from modalshell.files.regular import read_text

_AXES = ("x", "y", "z")
_KEYS = ("positions", "factors", "frequencies")


def read_measurements(path: Path) -> dict[str, Array]:
    """Arrays ``positions``, ``factors`` and ``frequencies`` of a file, those that it has.

    A CSV file has the column ``frequency`` [Hz], or columns among ``x``, ``y`` and ``z`` [m], a row a load, and
    ``factor``, its share of the scene's load, where there are several; empty cells were not measured. JSON and NPZ
    files have the arrays under their names, null or NaN where nothing was measured. FileFormatError if the file is
    missing, damaged, or holds none of these.
    """
    readers = {".csv": _from_csv, ".json": _from_json, ".npz": _from_npz}
    try:
        if path.suffix.lower() not in readers:
            raise ValueError(f"its name must end in {', '.join(readers)}")
        arrays = readers[path.suffix.lower()](path)
        if not {"positions", "frequencies"} & set(arrays):
            raise ValueError("it has neither positions nor frequencies")
        return arrays
    except Exception as error:  # OS, zip, JSON, text, key and value errors all mean the same to the user
        raise FileFormatError(f"cannot read measurements from {path}: {shortened(str(error))}") from error


def _from_csv(path: Path) -> dict[str, Array]:
    reader = csv.reader(read_text(path).splitlines(), skipinitialspace=True)
    heading, *rows = [[cell.strip() for cell in line] for line in reader if line] or [[]]
    if not rows:
        raise ValueError("it has no rows below its heading")
    names = {name for name in heading if name}
    unknown = names - {"frequency", "factor", *_AXES}
    if unknown:
        raise ValueError(f"column {sorted(unknown)[0]!r} is none of frequency, factor, x, y, z")
    if len(names) < len(heading) - heading.count(""):
        raise ValueError(f"a column is there twice (got {', '.join(heading)})")
    for row in rows:
        if any(row[len(heading) :]):
            raise ValueError(f"the row {shown(','.join(row))} has more cells than the heading: write 0.5, not 0,5")
    table = [dict(zip(heading, row, strict=False)) for row in rows]

    def column(name: str) -> Array:
        cells = [row.get(name, "") for row in table]
        return np.array([float(cell) if cell else np.nan for cell in cells])

    if "frequency" in names:
        if len(names) > 1:
            raise ValueError("frequencies stand alone: leave the other columns out")
        return {"frequencies": column("frequency")}
    if not names & set(_AXES):
        raise ValueError("it has none of the columns frequency, x, y, z")
    arrays = {"positions": np.stack([column(axis) for axis in _AXES], axis=1)}
    if "factor" in names:
        arrays["factors"] = column("factor")
    elif len(rows) == 1:
        arrays["positions"] = arrays["positions"][0]
    else:
        raise ValueError(f"{len(rows)} rows need the column factor: the share of the load of each")
    return arrays


def _from_json(path: Path) -> dict[str, Array]:
    document = json.loads(read_text(path))
    if not isinstance(document, dict):
        raise ValueError("it must be one object")
    return _known(document)


def _from_npz(path: Path) -> dict[str, Array]:
    return _known(dict(read_npz(path)))


def _known(content: dict[str, Any]) -> dict[str, Array]:
    unknown = set(content) - set(_KEYS)
    if unknown:
        raise ValueError(f"{sorted(unknown)[0]!r} is none of {', '.join(_KEYS)}")
    return {name: np.array(value, dtype=np.float64) for name, value in content.items()}
