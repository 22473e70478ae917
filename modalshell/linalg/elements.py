"""Sparse matrices of many small dense ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array, Index

_ROWS = 20_000
"""Rows that are summed at a time: what is listed for them stays in the processor's cache."""


def assembled(
    matrices: Any,
    rows: Index,
    columns: Index,
    shape: tuple[int, int],
    row_factors: Array | None = None,
    column_factors: Array | None = None,
) -> sps.csr_array:
    """Sum, of that shape, of matrices (elements, r, q) at ``rows`` (elements, r) and ``columns``; none at -1.

    They are multiplied by the factors of their rows (elements, r) and of their columns (elements, q).
    """
    kind: Any = np.int32 if matrices.size < 2**31 else np.int64
    height, width = matrices.shape[1:]
    # Whole lines of the small matrices are sorted by their rows: a list of single entries is several times as long.
    lines = np.flatnonzero(rows >= 0).astype(kind)
    by_row = sps.csr_array((lines, rows.ravel()[lines].astype(kind), [0, lines.size]), shape=(1, shape[0])).tocsc()
    columns, matrices, partial = columns.astype(kind), matrices.reshape(-1, width), columns.min(initial=0) < 0
    parts = []
    for first in range(0, max(shape[0], 1), _ROWS):
        ends = by_row.indptr[first : first + _ROWS + 1].astype(kind)
        lines = by_row.data[ends[0] : ends[-1]]
        elements = lines // height
        starts, places, values = kind(width) * (ends - ends[0]), columns[elements], matrices[lines]
        if row_factors is not None:
            values = row_factors.ravel()[lines, None] * values
        if column_factors is not None:
            values *= column_factors[elements]
        if partial:
            there = places >= 0
            starts = np.append(kind(0), np.cumsum(there.sum(axis=1, dtype=kind), dtype=kind))[ends - ends[0]]
            places, values = places[there], values[there]
        part = sps.csr_array((values.ravel(), places.ravel(), starts), shape=(len(ends) - 1, shape[1]))
        part.sum_duplicates()
        parts.append(part)
    return parts[0] if len(parts) == 1 else sps.csr_array(sps.vstack(parts, format="csr"))
