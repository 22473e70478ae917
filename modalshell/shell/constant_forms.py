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
    """Constant quadratic forms of fold angles and of half squared edge lengths."""

    points: Array
    """Vertices at rest [m], then ghosts; shape (n + g, 3)."""
    hinges: Index
    """Hinges of the folds, on the points; shape (H, 4)."""
    angles: Array
    """Fold angles at rest [rad]; shape (H,)."""
    shares: FoldShares
    """Second derivatives by fold angles [N m], and fold shares at the minimum."""
    folds: SplitFolds
    """Their pairs of triangles."""
    edges: Index
    """Edges of the mesh; shape (E, 2)."""
    half_squares: Array
    """Half their squared lengths at rest [m^2]; shape (E,)."""
    membrane: list[MembraneElements]
    """Elements of the membrane."""
    tension: sps.csr_array
    """Their sum [N/m^3]; shape (E, E)."""
    factor: float
    """Of the energy, in which damping may take part; see :meth:`ElasticEnergy.damped`."""
