"""Lowest eigenvalues of the tangent stiffness over the mass, and solves with it, by one factor."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

from modalshell.core.errors import OptionError, SolverError
from modalshell.core.typing import Array
from modalshell.modes.eigenpairs import scaled_by_mass
from modalshell.modes.factorisation import Factor, Factoriser, condensed_factor
from modalshell.modes.flutter import LOWEST, flutters
from modalshell.modes.loaded import general_pairs
from modalshell.modes.unsymmetric import definite_half
from modalshell.shell import EXACT, Shell

_ROUNDING = 1e-12
"""Shift of a singular matrix, as a share of its largest diagonal entry."""
_LANCZOS_FROM = 30
"""Unknowns from which Lanczos has room."""


def lowest_tangent_eigenvalue(
    shell: Shell, positions: Array, of_load: sps.csr_array | None = None, *, symmetric: bool = True
) -> float:
    """Lowest eigenvalue of the tangent stiffness over the mass at ``positions`` (n, 3) [1/s^2].

    On a stable branch that is the lowest squared frequency about the deformed state; it falls to zero at a snap, and is
    negative where the state is unstable. ``of_load`` (3n, 3n) is the stiffness of a load that follows the shell,
    ``symmetric`` where that has a potential; see :func:`lowest_eigenvalue`.
    """
    matrix = shell.pattern.free_matrix(shell.hessian(positions, EXACT))
    if of_load is not None:
        matrix = with_further(shell, matrix, of_load)
    return lowest_eigenvalue(shell, matrix, Factoriser(), symmetric=symmetric)


def with_further(shell: Shell, matrix: sps.csc_array, further: sps.csr_array) -> sps.csc_array:
    """A stiffness of the free unknowns, internal ones after them, plus a ``further`` one of the positions (3n, 3n)."""
    restrict = shell.unknowns.restrict
    own = sps.csc_array(restrict(sps.csr_array(restrict(further).T)).T)
    if internal := matrix.shape[0] - own.shape[0]:
        own = sps.csc_array(sps.block_diag([own, sps.csc_array((internal, internal))]))
    return sps.csc_array(matrix + own)


def lowest_eigenvalue(shell: Shell, matrix: sps.sparray, factoriser: Factoriser, *, symmetric: bool) -> float:
    """Lowest eigenvalue over the mass [1/s^2] of a stiffness of the free unknowns and of internal ones after them.

    Of one that is not symmetric, as under loads without a potential, 0 where the shell flutters or drifts away.
    """
    matrix = sps.csc_array(matrix)
    if symmetric:
        return TangentStiffness(shell, matrix, factoriser).lowest_mode()[0]
    mass, half = shell.unknowns.masses(shell.mass), definite_half(matrix, factoriser)
    if half is not None and flutters(matrix, condensed_factor(half, matrix.shape[0] - mass.size), mass):
        return 0.0
    try:
        return float(general_pairs(shell, matrix, min(LOWEST, mass.size) if half is None else 1)[0][0])
    except OptionError:
        return 0.0


@final
class TangentStiffness:
    """A symmetric stiffness about a state; one factor, made where it is first needed, serves modes and solves.

    ``matrix`` is that of the free unknowns (N, N), with those of internal unknowns after them; the shell gives the
    masses.
    """

    def __init__(self, shell: Shell, matrix: sps.csc_array, factoriser: Factoriser) -> None:
        self._scaled, self._root = scaled_by_mass(shell, matrix)
        self._factoriser = factoriser

    @classmethod
    def at(cls, shell: Shell, positions: Array, factoriser: Factoriser) -> TangentStiffness:
        """That of a shell under dead loads at ``positions`` (n, 3) [m]."""
        data = shell.hessian(positions, EXACT)
        return cls(shell, shell.pattern.free_matrix(data), factoriser)

    @cached_property
    def _factor(self) -> Factor:
        return self._condensed(self._scaled)

    @cached_property
    def _rounding(self) -> float:
        """Eigenvalues below this [1/s^2] are rounding."""
        return _ROUNDING * float(np.abs(self._scaled.diagonal()).max())

    def solve(self, right_side: Array) -> Array:
        """Displacements (N,) under forces (N,); SolverError where a pivot is exactly zero."""
        return np.asarray(self._factor.solve(right_side / self._root) / self._root)

    def lowest_mode(self) -> tuple[float, Array]:
        """Lowest eigenvalue [1/s^2] over the mass, and its direction (N,) in the free unknowns.

        Lanczos finds the eigenvalues nearest to a shift. For an indefinite matrix those near 0 need not be the lowest:
        the shift is lowered until it has the whole spectrum above it. SolverError if a factorisation fails, or Lanczos
        does not converge.
        """
        if self._root.size < _LANCZOS_FROM:
            values, vectors = self._small_pairs()
            return float(values[0]), vectors[:, 0]
        factor = self._factor
        value, vector = self._nearest(factor)
        if factor.is_definite():
            return value, vector
        shift = max(abs(value), self._rounding)
        while not factor.is_definite():
            shift *= 4.0
            factor = self._condensed(self._shifted(shift))
        return self._nearest(factor, shift)

    def curves_down(self, rounding: float) -> bool:
        """Whether an eigenvalue is below ``-rounding`` [1/s^2]; SolverError if the factorisation fails."""
        return not self._condensed(self._shifted(rounding)).is_definite()

    def nearest_mode(self) -> tuple[float, Array]:
        """As :meth:`lowest_mode`, the eigenvalue nearest to zero and its direction (N,)."""
        if self._root.size < _LANCZOS_FROM:
            values, vectors = self._small_pairs()
            nearest = int(np.abs(values).argmin())
            return float(values[nearest]), vectors[:, nearest]
        try:
            return self._nearest(self._factor)
        except SolverError:  # exactly at a critical point it is singular
            return self._nearest(self._condensed(self._shifted(self._rounding)), self._rounding)

    def _shifted(self, shift: float) -> sps.csc_array:
        """The scaled stiffness with ``shift`` [1/s^2] added to all its eigenvalues."""
        shifted, diagonal = self._scaled.copy(), self._scaled.diagonal()
        shifted.setdiag(diagonal + np.where(np.arange(diagonal.size) < self._root.size, shift, 0.0))
        return shifted

    def _condensed(self, matrix: sps.csc_array) -> Factor:
        """Factor of a symmetric matrix for its first N unknowns."""
        return condensed_factor(self._factoriser.symmetric(matrix), matrix.shape[0] - self._root.size)

    def _small_pairs(self) -> tuple[Array, Array]:
        """All eigenvalues of a small matrix, internal unknowns condensed, and their directions (N, N)."""
        dense, size = self._scaled.toarray(), self._root.size
        inner = dense[size:, :size]
        values, vectors = np.linalg.eigh(dense[:size, :size] - inner.T @ np.linalg.solve(dense[size:, size:], inner))
        return values, np.asarray(vectors / self._root[:, None])

    def _nearest(self, factor: Factor, shift: float = 0.0) -> tuple[float, Array]:
        """The eigenvalue nearest to ``-shift``, from the factor of the matrix so shifted."""
        size = self._root.size
        start = np.random.default_rng(0).standard_normal(size)
        inverse = spla.LinearOperator((size, size), matvec=factor.solve, dtype=np.float64)
        try:  # with its inverse at hand, Lanczos asks nothing of the matrix itself but its shape
            values, vectors = spla.eigsh(inverse, k=1, sigma=-shift, OPinv=inverse, v0=start)
        except spla.ArpackError as error:
            raise SolverError(f"no lowest eigenvalue of a matrix of {size} unknowns: {error}") from error
        return float(values[0]), np.asarray(vectors[:, 0] / self._root)
