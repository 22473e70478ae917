"""Mass-orthonormal extension of a basis."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from modalshell.core.typing import Array

_DEPENDENT = 1e-6
"""Least relative part of a vector orthogonal to the basis for it to be added."""


def orthonormal_extension(leading: Array, further: Array, mass: Array) -> Array:
    """``leading`` (N, m), mass-orthonormal, followed by what is new in ``further`` (N, k), orthonormalised.

    QR with column pivoting on unit columns; a column whose new part is below :data:`_DEPENDENT` gets no vector.
    """
    root = np.sqrt(mass)[:, None]
    known, new = root * leading, root * further
    size = np.linalg.norm(new, axis=0)
    new = new[:, size > 0.0] / size[size > 0.0]
    for _ in range(2):  # once more for the digits that cancellation took
        new -= known @ (known.T @ new)
    orthonormal, triangle, _ = scipy.linalg.qr(new, mode="economic", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diagonal(triangle)) > _DEPENDENT))
    found = orthonormal[:, :rank]
    found, _ = np.linalg.qr(found - known @ (known.T @ found))
    return np.hstack([leading, found / root])
