"""Tables for spreadsheets, as comma-separated values: a row for each vertex and each triangle of every frame."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.core.typing import Progress, unheard
from modalshell.core.units import with_unit
from modalshell.export.frame_arrays import FrameArray, of_triangles, of_vertices
from modalshell.files.atomic_io import write_atomically
from modalshell.files.outputs import TABLE_SIGNATURE, refuse_foreign
from modalshell.motion import Trajectory

_VERTEX, _TRIANGLE = "vertex", "triangle"
"""What a table's rows are of, and the name of its third column."""
_LONGEST_NAMES = 200
"""Characters that are read of a table to find that column."""
_MOST_ROWS = 1_048_575
"""Rows under the header of a spreadsheet."""


def save_csv(run: Trajectory, path: Path, on_frame: Progress = unheard) -> Path:
    """Write ``NAME.csv``, with a row for each vertex and frame, and with fields ``NAME_triangles.csv``.

    Every column is named with its unit. Vertices and triangles are counted from 0; places are those at rest. Numbers
    are as long as it takes to read back the same bits.
    """
    units, rest = run.units, np.asarray(run.rest_positions)
    place = FrameArray("rest", units.of("m"), rest, ("x", "y", "z"))
    rows = len(run.times) * max(len(rest), len(run.faces) if run.fields else 0)
    if rows > _MOST_ROWS:
        warnings.warn(
            f"{path} has {rows} rows, and spreadsheets show {_MOST_ROWS} at most: store fewer frames (store_every in "
            "[motion]) or read the .npz file by a program",
            ModalShellWarning,
            stacklevel=4,
        )
    triangles = path.with_name(f"{path.stem}_triangles.csv")
    _refuse_other(path, _VERTEX)
    if run.fields:
        refuse_foreign(triangles)
        _refuse_other(triangles, _TRIANGLE)
        corners = FrameArray("vertex", "", run.faces, ("0", "1", "2"))
        centre = FrameArray("rest", units.of("m"), rest[run.faces].mean(axis=1), ("x", "y", "z"))
        _write(run, triangles, _TRIANGLE, [corners, centre], of_triangles, unheard)
    else:
        with suppress(OptionError):  # of another run of this name
            refuse_foreign(triangles)
            _refuse_other(triangles, _TRIANGLE)
            triangles.unlink(missing_ok=True)
    return _write(run, path, _VERTEX, [place], of_vertices, on_frame)


def _refuse_other(path: Path, counted: str) -> None:
    """OptionError where a table of the other kind is there: run ``a`` and run ``a_triangles`` have a file in common."""
    other = _TRIANGLE if counted == _VERTEX else _VERTEX
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            found = file.readline(_LONGEST_NAMES).split(",")[2:3]
    except OSError:
        return
    if found == [other]:
        raise OptionError(
            f"{path} is there already, a table of another run, one {other} a row, where one {counted} a row is "
            "expected: it is not replaced; name the run otherwise, or another folder with --out"
        )


def _write(
    run: Trajectory,
    path: Path,
    counted: str,
    still: Sequence[FrameArray],
    moving: Callable[[Trajectory, int], list[FrameArray]],
    on_frame: Progress,
) -> Path:
    """Write a table frame by frame: its number and time, the number of the row, and the columns of the arrays."""

    def write(file: IO[bytes]) -> None:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="\n", write_through=True)
        for frame, time in enumerate(run.times.tolist()):
            arrays = [*still, *moving(run, frame)]
            if frame == 0:
                names = [name for array in arrays for name in _headers(array)]
                text.write(",".join([f"{TABLE_SIGNATURE}{run.units.time}]", counted, *names]) + "\n")
            columns = [column for array in arrays for column in _columns(array.values)]
            head = f"{frame},{time!r}"
            text.writelines(f"{head},{row},{','.join(cells)}\n" for row, cells in enumerate(zip(*columns, strict=True)))
            on_frame(frame + 1, len(run.times))
        text.detach()

    return write_atomically(path, write)


def _headers(array: FrameArray) -> list[str]:
    """Names of an array's columns, with their unit."""
    return [with_unit(f"{array.name} {part}".rstrip(), array.unit) for part in array.components or ("",)]


def _columns(values: NDArray[Any]) -> list[list[str]]:
    """Columns of the values as text."""
    if values.dtype == np.float32:
        return [[f"{number:.9g}" for number in column] for column in np.atleast_2d(values.T).tolist()]
    return [[repr(number) for number in column] for column in np.atleast_2d(values.T).tolist()]
