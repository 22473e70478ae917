"""Reduced energy with assumed membrane stresses (Hellinger-Reissner), on a basis that would lock otherwise.

Small errors of the basis cause large membrane strains. The membrane energy is therefore that of
stresses in the span of a few trained ones, ``E_m = max_s (s . d - sum_e s_e^2 / (4 w_e))`` [hellinger1914;
reissner1950]: with stress modes that are orthonormal in the complementary energy it is ``sum_k d_k^2 / 2``, each
``d_k = b_k . z + z . B_k z / 2`` a quadratic form of the coordinates z, so no element is evaluated. Flat hinges bend by
a constant matrix, which resists some strains, too: the stresses leave that energy to it. Hinges with an angle at rest
are evaluated as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, final

import numpy as np
import scipy.linalg

from modalshell.core.typing import Array, Index
from modalshell.kernels.packed import BYTES, LANES
from modalshell.models.hybrid.energy_kernels import evaluate
from modalshell.models.hybrid.hinge_measures import HingeMeasures
from modalshell.models.hybrid.measures import NONE_TURNED, Bending, Measures
from modalshell.models.hybrid.split_fold_measures import SplitFoldMeasures
from modalshell.shell import EXACT, Shell
from modalshell.shell.split_fold_energy import SplitFoldEnergy
from modalshell.statics.dense import DenseProblem


class Quadratic(NamedTuple):
    """Quadratic forms ``b_k . z + z . B_k z / 2`` of coordinates (m,)."""

    linear: Array
    """``b_k``, and zeros up to a whole number of packed registers; shape (m, K')."""
    pairs: Array
    """Lower triangles of the ``B_k``, row by row, of one register after the other; shape (r, m (m + 1) / 2, K' / r)."""
    modes: int
    """K."""


class ReducedStress(NamedTuple):
    """Energy of coordinates z (m,), of K stress modes and bending."""

    membrane: Quadratic
    """``d_k``."""
    bending: Bending
    """Flat hinges as a constant matrix, others as they are."""


def measures_of(shell: Shell, turned: Index = NONE_TURNED) -> Measures:
    """Measures of a shell without further energies; ``turned`` folds (t,) of shell theory count as bent ones."""
    folded = isinstance(shell.elastic_energy, SplitFoldEnergy)
    return SplitFoldMeasures(shell, turned) if folded else HingeMeasures(shell)


def reduce_energy(measures: Measures, basis: Array, stresses: Array) -> ReducedStress:
    """Reduced energy of a coarse shell in a ``basis`` V (3n, m) of displacements.

    ``stresses`` (e, K) are its modes of stresses; see :func:`stress_modes`.
    """
    columns = basis.reshape(-1, 3, basis.shape[1])
    return ReducedStress(
        _strain_measures(measures, columns, measures.elastic_tensions(stresses)),
        _padded_bending(measures.bending(columns)),
    )


def padded(columns: Array) -> Array:
    """An array (..., k) with zeros up to a whole number of packed registers, which begin where those of memory do."""
    *rows, count = columns.shape
    width = count + -count % LANES
    room = np.zeros(int(np.prod(rows)) * width + LANES)
    first = -room.ctypes.data % BYTES // room.itemsize
    whole = room[first : room.size - LANES + first].reshape(*rows, width)
    whole[..., :count] = columns
    return whole


def _padded_bending(bending: Bending) -> Bending:
    flat, modes, across = (padded(part) for part in (bending.flat, bending.modes, bending.across))
    return bending._replace(flat=flat, modes=modes, across=across)


def _strain_measures(measures: Measures, columns: Array, tensions: Array) -> Quadratic:
    """Work of every mode of edge tensions (E, K) on the half squared lengths of the edges."""
    vertices, edges = measures.shell.rest_positions, measures.edges
    across = columns[edges[:, 1]] - columns[edges[:, 0]]
    arms = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    linear = np.einsum("exm,ek->mk", across * arms[:, :, None], tensions, optimize=True)
    rows = np.tril_indices(columns.shape[2])[0]
    pairs = np.empty((len(rows), tensions.shape[1]))
    for row in range(columns.shape[2]):  # products of all pairs at once would be large
        products = np.einsum("ex,exj->ej", across[:, :, row], across[:, :, : row + 1])
        pairs[rows == row] = products.T @ tensions
    registers = padded(pairs).reshape(len(rows), -1, LANES)
    return Quadratic(padded(linear), padded(registers.transpose(1, 0, 2)), tensions.shape[1])


def stress_modes(measures: Measures, leading: Array, snapshots: Array, count: int) -> Array:
    """Stress modes (e, K), whose scaled form is orthonormal: of ``leading`` states, then by POD.

    ``leading`` (e, l) and ``snapshots`` (e, s) are states of the membrane.
    """
    first = scipy.linalg.orth(measures.scaled(leading), rcond=1e-8)[:, :count]
    return measures.unscaled(_extended(first, measures.scaled(snapshots), count))


def _extended(first: Array, snapshots: Array, count: int) -> Array:
    """``count`` orthonormal columns: ``first``, then the leading left singular vectors of what snapshots add."""
    remainder = snapshots - first @ (first.T @ snapshots)
    vectors, sizes, _ = np.linalg.svd(remainder, full_matrices=False)
    further = min(count - first.shape[1], int(np.sum(sizes > 1e-9 * sizes[0])))
    return np.concatenate([first, vectors[:, :further]], axis=1)


def position_modes(shell: Shell, leading: Array, snapshots: Array, count: int, stiffness: Any) -> Array:
    """Basis V (3n, m), mass-orthonormal, ``V^T K V`` diagonal: ``leading`` modes, then POD of the remainder.

    ``leading`` (3n, l) and ``snapshots`` (3n, s) are displacements, ``stiffness`` (3n, 3n) is that at rest.
    """
    root = np.sqrt(np.repeat(shell.mass, 3))[:, None]
    first = scipy.linalg.orth(root * leading, rcond=1e-10)[:, :count]
    basis = _extended(first, root * snapshots, count) / root
    _, turned = np.linalg.eigh(basis.T @ (stiffness @ basis))
    return np.asarray(basis @ turned)


@final
@dataclass(frozen=True)
class StressPotential(DenseProblem):
    """The potential ``E(z) - p . z`` of coordinates z (m,) of unit mass, with p the load; the origin is rest: zeros."""

    reduced: ReducedStress
    """E. Its Hessian leaves out the second derivatives of the angles of hinges that are bent at rest."""
    scaling: Array
    """Square root (m,) of the stiffness of each coordinate at rest."""
    change: Callable[[Array], float]
    """Largest relative change of an edge vector by a step in z."""
    count: Callable[[int], None]
    """Counts a number of evaluations of the energy."""

    load_step: ClassVar = 0.5
    path_goal: ClassVar = 1e-4
    snaps: ClassVar = 3

    def potential(self, x: Array) -> tuple[float, Array]:
        """The whole potential [J] and its gradient (m,)."""
        value, _, _, gradient, _ = self._evaluated(x, None)
        return value - float(self.load @ x), gradient - self.load

    def linearise(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> tuple[Array, Array]:
        """Gradient (m,) and Hessian (m, m)."""
        present = self._evaluated(x, None)[1][: self._modes] if geometric == EXACT else None
        _, _, _, gradient, lower = self._evaluated(x, stresses[0] if stresses else present)
        return gradient - self.load, np.tril(lower) + np.tril(lower, -1).T

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """A straight step, cut where an edge would change by more than ``reach`` of its length."""
        fraction = 1.0 if reach is None else min(1.0, reach / max(self.change(direction), 1e-300))
        step = fraction * direction
        _, strains, slopes, _, _ = self._evaluated(x, None)
        return x + step, [strains[: self._modes] + slopes[: self._modes] @ step], fraction

    @property
    def _modes(self) -> int:
        return self.reduced.membrane.modes

    def _evaluated(self, z: Array, stresses: Array | None) -> tuple[float, Array, Array, Array, Array]:
        self.count(1)
        return evaluate(self.reduced, z, np.zeros(self._modes) if stresses is None else stresses)
