"""Flutter under loads without a potential: complex eigenvalues of the stiffness over the mass [beck1952].

Such a stiffness is K = S + A, A its odd half. Where S is positive definite nothing drifts away; but A couples
vibrations, and where two of them have nearly one frequency even a small A makes of these a pair ``a + ib, a - ib``:
one part of the motion then grows, unless damping holds it (theory 16, eq. 6).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.modes.block_lanczos import BLOCK, largest_pairs
from modalshell.modes.factorisation import Factor

LOWEST = 8
"""Eigenvalues that are looked at: damping holds what is higher, and the mesh resolves little of it."""
_FURTHER = 4
"""Pairs of the symmetric half that are sought beyond these, as the odd half couples to them."""
_SMALL = 200
"""Unknowns up to which a dense solver finds all eigenvalues."""
_HELD = 1e-3
"""Imaginary part, as a share of an eigenvalue, that is none: damping of half that ratio, 5e-4, holds such a pair.

Sheets have more, in the air and at their supports. And of vibrations with one frequency, as a round tube has, whatever
is odd makes pairs: a light wind some of 1e-6 to 1e-4, because triangles tell left from right.
"""
_BLOCKS = 6
"""Times that the space is widened at most."""
_NEAR = 1e-4
"""Change of an eigenvalue by that up to which it has settled."""
_NONE = 1e-9
"""Share of a direction's length up to which it is rounding of the others."""


def complex_among(values: NDArray[Any]) -> bool:
    """Whether any of these eigenvalues is complex beyond what little damping holds."""
    return bool((np.abs(values.imag) > _HELD * np.abs(values)).any())


def flutters(matrix: sps.csc_array, half: Factor, mass: Array) -> bool:
    """Whether any of the lowest eigenvalues of a stiffness over the mass (N,) [kg] is complex; see ``_HELD``.

    ``half`` is the factor (N, N) of the stiffness's symmetric half, positive definite. The lowest vibrations V of that
    half, and ``S^-1 A V``, by which A changes them, span a space that holds the eigenvectors of K and of its transpose
    to the second order of A: the eigenvalues of K projected onto it are right to the fourth. Where A is strong that is
    not enough: the space is widened by what A makes of it until they settle. In it A is exactly odd, and S exactly
    symmetric, so that rounding of S makes no pair of vibrations complex that A does not couple.
    """
    root = np.sqrt(mass)
    odd = _odd_half(matrix, root)
    if not odd.count_nonzero():
        return False

    def solve(block: Array) -> Array:
        return np.asarray(root[:, None] * half.solve(root[:, None] * block))

    count = min(LOWEST + _FURTHER, mass.size)
    found = None
    if mass.size > _SMALL:
        start = np.random.default_rng(0).standard_normal((mass.size, BLOCK))
        found = largest_pairs(solve, start, count)
    if found is None:
        inverse = solve(np.eye(mass.size))
        values, vectors = scipy.linalg.eigh(0.5 * (inverse + inverse.T))
        found = values[::-1][:count], vectors[:, ::-1][:, :count]
    order = np.argsort(-found[0], kind="stable")
    values, vectors = 1.0 / found[0][order], found[1][:, order]
    space, stiff, newest = vectors, vectors * values, vectors
    before: NDArray[Any] | None = None
    for _ in range(_BLOCKS):
        pushed = odd @ newest
        changed = solve(pushed)
        size = float(np.linalg.norm(changed))
        within = space.T @ changed
        again = space.T @ (changed - space @ within)  # rounding leaves some of it at first
        within += again
        further, sizes, turned = np.linalg.svd(changed - space @ within, full_matrices=False)
        kept = sizes > _NONE * size
        newest = further[:, kept]
        resisted = (pushed - stiff @ within) @ (turned[kept].T / sizes[kept])
        space, stiff = np.hstack([space, newest]), np.hstack([stiff, resisted])
        lowest = _lowest(space, stiff, odd)
        if not newest.size or (before is not None and _settled(lowest, before)):
            break
        before = lowest
    return complex_among(lowest)


def _lowest(space: Array, stiff: Array, odd: sps.csr_array) -> NDArray[Any]:
    """Lowest eigenvalues of a stiffness within a space (N, k), which its symmetric half makes ``stiff``."""
    symmetric, skew = space.T @ stiff, space.T @ (odd @ space)
    found = scipy.linalg.eigvals(0.5 * (symmetric + symmetric.T) + 0.5 * (skew - skew.T))
    return np.asarray(found[np.argsort(np.abs(found))][:LOWEST])


def _settled(values: NDArray[Any], before: NDArray[Any]) -> bool:
    """Whether eigenvalues are about those of a smaller space, real or complex as these."""
    near = np.abs(np.abs(values) - np.abs(before)) <= _NEAR * np.abs(values)
    return bool(near.all()) and complex_among(values) == complex_among(before)


def oscillates(factor: Factor, mass: Array) -> bool:
    """Whether the lowest eigenvalues of a factorised matrix over the mass (N,) [kg] are real and positive."""
    count = min(LOWEST, mass.size - 2)
    if count < 1:
        return False
    inverse = spla.LinearOperator(
        (mass.size, mass.size), matvec=lambda y: factor.solve(mass * y.ravel()), dtype=np.float64
    )
    start = np.random.default_rng(0).standard_normal(mass.size)
    try:
        found = spla.eigs(inverse, count, which="LM", return_eigenvectors=False, v0=start)
    except spla.ArpackError:
        return False
    return bool((found.real > 0.0).all()) and not complex_among(found)


def _odd_half(matrix: sps.csc_array, root: Array) -> sps.csr_array:
    """Half the difference of a stiffness and its transpose, of the positions' unknowns, over the mass."""
    size = root.size
    own = sps.csr_array(matrix)[:size, :size]
    odd = sps.csr_array(0.5 * (own - own.T)).tocoo()
    return sps.csr_array((odd.data / (root[odd.row] * root[odd.col]), (odd.row, odd.col)), shape=odd.shape)
