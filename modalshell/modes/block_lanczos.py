"""Largest eigenpairs of a symmetric operator by Lanczos steps of several vectors at once.

A solve with a factor reads it from memory, for several right sides as for one. And a block finds as many copies of a
repeated eigenvalue as it has vectors, where one vector sees a single one [golub1977].
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.core.typing import Array

BLOCK = 4
"""Vectors of a block: the right sides that a register holds, or half of them."""
_TOLERANCE = 1e-13
"""Residual over the eigenvalue at which a pair has converged."""
_MOST = 8
"""Size of the space over the pairs that are wanted, from which they are looked for otherwise."""
_LEAST = 80
"""The same with few pairs."""
_LATER = 8
"""Part of the size of the space by which it grows between looks at its eigenpairs."""


def largest_pairs(operator: Callable[[Array], Array], start: Array, wanted: int) -> tuple[Array, Array] | None:
    """The ``wanted`` eigenvalues of largest size (wanted,) and their orthonormal vectors (N, wanted), or None.

    None where the space would be too large for these, or they do not converge in a space of some times as many.

    Parameters
    ----------
    operator : callable
        Product with a block (N, 4).
    start : ndarray, shape (N, 4)
        Vectors to begin with, at random in the operator's range.
    wanted : int
        Number of pairs.
    """
    size = len(start)
    most = max(_MOST * wanted, _LEAST) // BLOCK * BLOCK
    if size < 2 * most:
        return None
    space, projected = np.empty((size, most), order="F"), np.zeros((most, most))
    space[:, :BLOCK] = np.linalg.qr(start)[0]
    look = wanted
    for known in range(BLOCK, most, BLOCK):
        own, last = space[:, :known], slice(known - BLOCK, known)
        block = operator(space[:, last])
        products = np.zeros((known, BLOCK))
        for _ in range(2):  # the second time takes what rounding left of the first
            parts = own.T @ block
            block -= own @ parts
            products += parts
        projected[:known, last], projected[last, :known] = products, products.T
        further, rest = np.linalg.qr(block)
        if known >= look:
            values, vectors = np.linalg.eigh(projected[:known, :known])
            order = np.argsort(-np.abs(values), kind="stable")[:wanted]
            left = np.linalg.norm(rest @ vectors[last][:, order], axis=0)
            if (left <= _TOLERANCE * np.abs(values[order])).all():
                return values[order], own @ vectors[:, order]
            look = known + known // _LATER
        after = slice(known, known + BLOCK)
        space[:, after] = further
        projected[after, last], projected[last, after] = rest, rest.T
    return None
