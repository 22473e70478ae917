"""The coarse surface of a reduced shell, as its steps look at it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array, Index
from modalshell.models.hybrid.assumed_stress import padded
from modalshell.models.hybrid.measures import Measures


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
