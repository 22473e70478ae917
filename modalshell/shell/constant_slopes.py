"""Derivatives of the split-fold energy's stresses by the constants of its sheet, at fixed measures."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.fold_shares import FoldShares
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.smoothed_membrane import Strained, plane_stress
from modalshell.shell.split_folds import SplitFolds
from modalshell.shell.triangle_pairs import fold_moments

_COMPLEX = 1e-30
"""Imaginary step of Poisson's ratio, whose derivatives have no rounding of differences."""


def rates_by_constant(material: Isotropic, name: str) -> tuple[float, float]:
    """What couples and tensions are multiplied by: they go by the third and first power of the thickness."""
    powers = {"young": (1.0, 1.0), "thickness": (3.0, 1.0), "density": (0.0, 0.0)}[name]
    value = float(getattr(material, name))
    return powers[0] / value, powers[1] / value


@final
class SlopesByPoisson:
    """Derivatives by Poisson's ratio, which follow from the shape at rest and serve every state.

    Parameters
    ----------
    mesh : TriangleMesh
        Rest shape.
    material : Isotropic
        The sheet.
    folds : SplitFolds
        Its split folds.
    strained : list of Strained
        Its membrane elements.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        material: Isotropic,
        folds: SplitFolds,
        strained: list[Strained],
    ) -> None:
        stiffness, rigidity, poisson = material.elasticity(mesh)
        growth = (2.0 * poisson / (1.0 - poisson**2))[:, None, None]
        plain = plane_stress(stiffness, poisson)
        # The tensor is linear in nu apart from the stiffness before it.
        slope = growth * plain + plane_stress(stiffness, poisson + 1.0) - plain
        self._folds = folds
        self._membrane = [(e, e.elastic(slope)) for e in strained]
        moved = poisson + 1j * _COMPLEX
        rigid = rigidity * (1.0 - poisson**2) / (1.0 - moved**2)
        free = (folds.folds < 0) & (folds.share_index < 0)
        self._moments = fold_moments(mesh, folds.faces, folds.corners, rigid, moved, free).imag / _COMPLEX

    def tensions(self, stretches: Array) -> Array:
        """Derivative (E,) of the tensions at half squared lengths ``stretches`` (E,)."""
        tensions = np.zeros_like(stretches)
        for e, elastic in self._membrane:
            np.add.at(tensions, e.edges, e.tensions(elastic, stretches))
        return tensions

    def couples(self, shares: FoldShares, delta: Array) -> Array:
        """Derivative (H,) of the couples at fold angles ``delta`` (H,), shares at their minimum.

        With moments ``K gamma``, ``gamma = P delta + S f``: the shares move by ``-(S^T K S)^-1 S^T K' gamma``.
        """
        folds = self._folds
        gamma = folds.parts_of_folds(delta, -shares.solve(shares.coupling @ delta))
        moments = np.einsum("tkl,tl->tk", self._moments, gamma)
        pushed, couples = np.zeros(folds.share_count + 1), np.zeros(delta.size + 1)
        np.add.at(pushed, folds.share_index, folds.shares * moments)
        np.add.at(couples, folds.folds, moments)
        return np.asarray(couples[:-1] - shares.coupling_transposed @ shares.solve(pushed[:-1]))
