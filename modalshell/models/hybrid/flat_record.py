"""A reduced energy and its surface in three arrays, for one call from Python: numba takes long to look into records.

Of two dozen arrays that took as long as a tenth of a step. Compiled code makes the records of slices.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import njit
from modalshell.kernels.read_only import unwritten
from modalshell.models.hybrid.assumed_stress import Quadratic, ReducedStress, padded
from modalshell.models.hybrid.measures import Bending, Measures

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "nogil": True}


class Surface(NamedTuple):
    """A coarse shell of k vertices, as a reduced step looks at it."""

    rest: Array
    columns: Array
    """Positions at rest [m], and the basis, its rows with zeros up to a whole number of packed registers; shape (k, 3)
    and (3 k, width)."""
    faces: Index
    """Triangles; shape (f, 3)."""
    edges: Index
    lengths: Array
    """Edges, and half their squared lengths at rest [m^2]; none of a membrane that is looked at elsewhere. Shape (E, 2)
    and (E,)."""
    starts: Index
    others: Index
    values: Array
    """The membrane's matrix by rows; shape (E + 1,), (c,) and (c,)."""


def surface_of(measures: Measures, basis: Array) -> Surface:
    """What steps see of the measures' shell; no edges where its membrane is no quadratic form of squared lengths."""
    shell, form = measures.shell, measures.quadratic_membrane
    lengths, matrix = (np.empty(0), sps.csr_array((0, 0))) if form is None else form
    edges = np.array(measures.edges[: len(lengths)], dtype=np.int64)
    starts, others = matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64)
    own = shell.rest_positions.copy(), padded(basis), shell.mesh.faces
    return Surface(*own, edges, lengths.copy(), starts, others, np.array(matrix.data, dtype=np.float64))


class FlatRecord(NamedTuple):
    """A reduced energy and its surface."""

    numbers: Array
    indices: Index
    """What all arrays hold, one after the other; numbers begin where packed registers of memory do."""
    places: Index
    """Where each array, or number, begins, and its shape; shape (p, 4)."""


def flat_record(reduced: ReducedStress, surface: Surface) -> FlatRecord:
    """Copy the records' arrays, in the order of their names."""
    numbers: list[Array] = []
    indices: list[Any] = []
    places, sizes = [], [0, 0]
    for part in _parts((reduced, surface)):
        array = np.asarray(part)
        whole = array.dtype.kind == "i"
        places.append([sizes[whole], *array.shape, *[0] * (3 - array.ndim)])
        flat: Any = array.ravel() if whole else padded(array.ravel())
        (indices if whole else numbers).append(flat)
        sizes[whole] += flat.size
    return FlatRecord(
        padded(np.concatenate(numbers)), np.concatenate(indices).astype(np.int64), np.array(places, dtype=np.int64)
    )


def _parts(record: Any) -> list[Any]:
    """Arrays and numbers of records within records."""
    return [part for whole in record for part in (_parts(whole) if isinstance(whole, tuple) else [whole])]


@njit(**_options)
def _row(values, places, part):  # type: ignore[no-untyped-def]
    begin, size = places[part, 0], places[part, 1]
    return values[begin : begin + size]


@njit(**_options)
def _matrix(values, places, part):  # type: ignore[no-untyped-def]
    begin, rows, columns = places[part, 0], places[part, 1], places[part, 2]
    return values[begin : begin + rows * columns].reshape(rows, columns)


@njit(**_options)
def _block(values, places, part):  # type: ignore[no-untyped-def]
    begin, blocks, rows, columns = places[part, 0], places[part, 1], places[part, 2], places[part, 3]
    return values[begin : begin + blocks * rows * columns].reshape(blocks, rows, columns)


@njit(**_options)
def _quadratic(x, i, at, first):  # type: ignore[no-untyped-def]
    return Quadratic(_matrix(x, at, first), _block(x, at, first + 1), i[at[first + 2, 0]])


@njit(**_options)
def records_of(record):  # type: ignore[no-untyped-def]
    """The reduced energy and the surface."""
    x, i, at = record.numbers, record.indices, record.places
    bending = Bending(
        _matrix(x, at, 3), _matrix(x, at, 4), _block(x, at, 5), _matrix(i, at, 6), _row(x, at, 7), _row(x, at, 8),
        _row(i, at, 9), _row(i, at, 10), _row(x, at, 11), _block(x, at, 12), _matrix(x, at, 13),
    )  # fmt: skip
    surface = Surface(
        _matrix(x, at, 14), _matrix(x, at, 15), unwritten(_matrix(i, at, 16)), _matrix(i, at, 17), _row(x, at, 18),
        _row(i, at, 19), _row(i, at, 20), _row(x, at, 21),
    )  # fmt: skip
    return ReducedStress(_quadratic(x, i, at, 0), bending), surface
