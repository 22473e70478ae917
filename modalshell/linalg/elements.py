"""Sparse matrices of many small dense ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Index


def assembled(matrices: Any, rows: Index, columns: Index, shape: tuple[int, int]) -> sps.csr_array:
    """Sum, of that shape, of matrices (elements, r, q) at ``rows`` (elements, r) and ``columns``; none at -1."""
    kind: Any = np.int32 if matrices.size < 2**31 else np.int64
    height, width = matrices.shape[1:]
    # Whole lines of the small matrices are sorted by their rows: a list of single entries is several times as long.
    lines = np.flatnonzero(rows >= 0).astype(kind)
    by_row = sps.csr_array((lines, rows.ravel()[lines].astype(kind), [0, lines.size]), shape=(1, shape[0])).tocsc()
    starts, lines = kind(width) * by_row.indptr.astype(kind), by_row.data
    places, values = columns.astype(kind)[lines // height], matrices.reshape(-1, width)[lines]
    if columns.min(initial=0) < 0:
        there = places >= 0
        starts = np.append(kind(0), np.cumsum(there.sum(axis=1, dtype=kind), dtype=kind))[by_row.indptr]
        places, values = places[there], values[there]
    matrix = sps.csr_array((values.ravel(), places.ravel(), starts), shape=shape)
    matrix.sum_duplicates()
    return matrix
