"""Derivatives of the split-fold energy's stresses by the constants of its sheet, at fixed measures."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.fold_shares import FoldShares
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.sheet import IMAGINARY, Sheet
from modalshell.shell.smoothed_membrane import Strained, plane_stress, turned_elasticity
from modalshell.shell.split_folds import SplitFolds
from modalshell.shell.triangle_pairs import fold_moments


class _Slopes(NamedTuple):
    """Membrane elements of one kind, and the slopes of their elasticity."""

    edges: Index
    strain: Array
    elastic: Array

    def tensions(self, stretches: Array) -> Array:
        """Slopes (elements, edges) of the derivatives of the energy by half squared lengths (E,)."""
        strains = np.einsum("eiq,eq->ei", self.strain, stretches[self.edges])
        return np.asarray(np.einsum("eip,ei->ep", self.strain, np.einsum("eij,ej->ei", self.elastic, strains)))


def _slopes_of(e: Strained, elastic: Array) -> _Slopes:
    return _Slopes(e.edges, e.strain_of(e.stencils, e.areas), elastic)


@final
class ConstantSlopes:
    """Derivatives of the stresses of a sheet by its constants; they follow from the shape at rest, for every state.

    ``folds`` are its split folds; ``strained`` makes its membrane elements, of the matrix ``tension`` (E, E).
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        sheet: Sheet,
        folds: SplitFolds,
        strained: Callable[[], list[Strained]],
        tension: sps.csr_array,
    ) -> None:
        self._mesh, self._sheet, self._folds, self._strained, self._tension = mesh, sheet, folds, strained, tension
        self._slopes: dict[str, tuple[list[_Slopes], Array]] = {}

    def stresses(self, name: str, shares: FoldShares, folds: Array, stretches: Array) -> tuple[Array, Array]:
        """Derivatives of couples (H,) and tensions (E,), at fold angles (H,) and half squared lengths (E,)."""
        if name == "density":
            return np.zeros_like(folds), np.zeros_like(stretches)
        powers = {"young": (1.0, 1.0), "thickness": (3.0, 1.0)}.get(name)
        if isinstance(self._sheet, Isotropic) and powers is not None:
            # Couples go by the third power of the thickness, tensions by the first, and both by the modulus.
            bending, stretching = (power / float(getattr(self._sheet, name)) for power in powers)
            return bending * shares.couples(folds), stretching * (self._tension @ stretches)
        if name not in self._slopes:
            self._slopes[name] = self._by_poisson() if isinstance(self._sheet, Isotropic) else self._by(name)
        membrane, moments = self._slopes[name]
        tensions = np.zeros_like(stretches)
        for e in membrane:
            np.add.at(tensions, e.edges, e.tensions(stretches))
        return self._couples(moments, shares, folds), tensions

    def _by_poisson(self) -> tuple[list[_Slopes], Array]:
        """Slopes of elements and moments of an isotropic sheet by Poisson's ratio."""
        mesh, folds = self._mesh, self._folds
        stiffness, rigidity, poisson = self._sheet.elasticity(mesh)
        growth = (2.0 * poisson / (1.0 - poisson**2))[:, None, None]
        plain = plane_stress(stiffness, poisson)
        # The tensor is linear in nu apart from the stiffness before it.
        slope = growth * plain + plane_stress(stiffness, poisson + 1.0) - plain
        moved = poisson + 1j * IMAGINARY
        rigid = rigidity * (1.0 - poisson**2) / (1.0 - moved**2)
        moments = fold_moments(mesh, folds.faces, folds.corners, rigid, moved, self._free).imag / IMAGINARY
        return [_slopes_of(e, e.elastic(slope)) for e in self._strained()], moments

    def _by(self, name: str) -> tuple[list[_Slopes], Array]:
        """Slopes of elements and moments of any sheet by a constant."""
        mesh, folds, strained = self._mesh, self._folds, self._strained()
        directed = self._sheet.directed(mesh, name)
        assert directed is not None
        membrane, bending = directed
        turned = (table.imag / IMAGINARY for table in turned_elasticity(mesh, strained, membrane))
        slopes = [_slopes_of(e, e.in_tables().elastic(table)) for e, table in zip(strained, turned, strict=True)]
        unused = np.empty(0)
        moments = fold_moments(mesh, folds.faces, folds.corners, unused, unused, self._free, bending)
        return slopes, moments.imag / IMAGINARY

    @property
    def _free(self) -> Mask:
        return np.asarray((self._folds.folds < 0) & (self._folds.share_index < 0))

    def _couples(self, slopes: Array, shares: FoldShares, delta: Array) -> Array:
        """Derivative (H,) of the couples at fold angles ``delta`` (H,), shares at their minimum.

        With moments ``K gamma``, ``gamma = P delta + S f``: the shares move by ``-(S^T K S)^-1 S^T K' gamma``.
        """
        folds = self._folds
        gamma = folds.parts_of_folds(delta, -shares.solve(shares.coupling @ delta))
        moments = np.einsum("tkl,tl->tk", slopes, gamma)
        pushed, couples = np.zeros(folds.share_count + 1), np.zeros(delta.size + 1)
        np.add.at(pushed, folds.share_index, folds.shares * moments)
        np.add.at(couples, folds.folds, moments)
        return np.asarray(couples[:-1] - shares.coupling_transposed @ shares.solve(pushed[:-1]))
