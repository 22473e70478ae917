"""Sparse matrices of many small dense ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Index


def assembled(matrices: Any, rows: Index, columns: Index, shape: tuple[int, int]) -> sps.csr_array:
    """Sum, of that shape, of matrices (elements, r, q) at ``rows`` (elements, r) and ``columns``; none at -1."""
    numbers = rows.astype(np.int32)[:, :, None], columns.astype(np.int32)[:, None, :]
    values, places = matrices.ravel(), [np.broadcast_to(one, matrices.shape).ravel() for one in numbers]
    if min(rows.min(initial=0), columns.min(initial=0)) < 0:
        there = (places[0] >= 0) & (places[1] >= 0)
        values, places = values[there], [one[there] for one in places]
    return sps.csr_array(sps.coo_array((values, tuple(places)), shape=shape))
