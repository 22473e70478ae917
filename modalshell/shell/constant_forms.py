"""What the split-fold energy is made of, for models that reduce it."""

from __future__ import annotations

from typing import NamedTuple, final

import scipy.sparse as sps

from modalshell.core.typing import Array, Index
from modalshell.shell.fold_shares import FoldShares
from modalshell.shell.smoothed_membrane import MembraneElements
from modalshell.shell.split_folds import SplitFolds


@final
class ConstantForms(NamedTuple):
    """Constant quadratic forms of fold angles and of half squared edge lengths.

    Attributes
    ----------
    points : ndarray, shape (n + g, 3)
        Vertices at rest [m], then ghosts.
    hinges : ndarray of int64, shape (H, 4)
        Hinges of the folds, on the points.
    angles : ndarray, shape (H,)
        Fold angles at rest [rad].
    shares : FoldShares
        Second derivatives by fold angles [N m], and fold shares at the minimum.
    folds : SplitFolds
        Their pairs of triangles.
    edges : ndarray of int64, shape (E, 2)
        Edges of the mesh.
    half_squares : ndarray, shape (E,)
        Half their squared lengths at rest [m^2].
    membrane : list of MembraneElements
        Elements of the membrane.
    tension : csr_array, shape (E, E)
        Their sum [N/m^3].
    factor : float
        Of the energy, in which damping may take part; see :meth:`ElasticEnergy.damped`.
    """

    points: Array
    hinges: Index
    angles: Array
    shares: FoldShares
    folds: SplitFolds
    edges: Index
    half_squares: Array
    membrane: list[MembraneElements]
    tension: sps.csr_array
    factor: float
