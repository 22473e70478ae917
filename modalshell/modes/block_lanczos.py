"""Largest eigenpairs of a symmetric operator by Lanczos steps of several vectors at once.

A solve with a factor reads it from memory, for several right sides as for one. And a block finds as many copies of a
repeated eigenvalue as it has vectors, where one vector sees a single one [golub1977].
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from modalshell.core.typing import Array

BLOCK = 4
"""Vectors of a block: the right sides that a register holds, or half of them. As many copies are found at once."""
_TOLERANCE = 1e-13
"""Residual over the eigenvalue at which a pair has converged."""
_MOST, _STEPS = 8, 20
"""Largest Krylov space: vectors for each pair that is wanted, and blocks of few pairs."""
_GROWTH = 8
"""The space grows by an eighth of its size between two looks at its Ritz pairs."""


def largest_pairs(operator: Callable[[Array], Array], start: Array, wanted: int) -> tuple[Array, Array] | None:
    """The ``wanted`` eigenvalues of largest size (wanted,) and their orthonormal vectors (N, wanted), or None.

    Ritz pairs of a Krylov space with full reorthogonalisation, without restarts: it takes memory for some 3 to 8
    vectors a pair. None where the largest space would be more than half of all, or they do not converge in it. The
    residuals are those of the recurrence, which hold for a symmetric operator: the caller checks the true ones.
    ``operator`` gives the product with a block (N, b); ``start`` (N, b) is at random in its range.
    """
    size = len(start)
    width = start.shape[1]
    most = max(_MOST * wanted // width, _STEPS) * width
    if size < 2 * most:
        return None
    space, projected = np.empty((size, most), order="F"), np.zeros((most, most))
    space[:, :width] = np.linalg.qr(start)[0]
    look = wanted
    for known in range(width, most, width):
        own, last = space[:, :known], slice(known - width, known)
        block = operator(space[:, last])
        products = np.zeros((known, width))
        # By a symmetric operator the product is orthogonal to all blocks but the last two, which are taken off first;
        # from all of them what rounding has left.
        for begin in (max(known - 2 * width, 0), 0):
            near = own[:, begin:]
            parts = near.T @ block
            block -= near @ parts
            products[begin:] += parts
        projected[:known, last], projected[last, :known] = products, products.T
        further, rest = np.linalg.qr(block)
        if known >= look:
            values, vectors = np.linalg.eigh(projected[:known, :known])
            order = np.argsort(-np.abs(values), kind="stable")[:wanted]
            left = np.linalg.norm(rest @ vectors[last][:, order], axis=0)
            if (left <= _TOLERANCE * np.abs(values[order])).all():
                return values[order], own @ vectors[:, order]
            look = known + known // _GROWTH
        after = slice(known, known + width)
        space[:, after] = further
        projected[after, last], projected[last, after] = rest, rest.T
    return None
