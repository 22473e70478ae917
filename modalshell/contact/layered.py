"""The potential of a shell with the barrier of its self-contact, every step ending before layers meet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.layers import Layers
from modalshell.core.typing import Array
from modalshell.modes import Factoriser
from modalshell.statics.further import Moved
from modalshell.statics.potential import Potential
from modalshell.supports import Unknowns, VertexUnknowns

_SHORT = 0.02
"""Move, in gaps, after which Hessians of pairs are taken whole."""
_TRIES = 3
"""Shorter warped steps that are tried before a straight one."""


@final
class LayeredEnergy:
    """The barrier energy of layers, and its friction, as a further energy of a potential.

    The barrier's Hessian changes its pattern with the pairs that are near. Blocks that were needed once stay, so that
    one analysis serves many factors.
    """

    def __init__(self, layers: Layers, patterns: Patterns) -> None:
        self.layers, self._patterns = layers, patterns
        self._last = np.inf  # largest move [m] of a vertex in the last step

    def value(self, x: Array) -> float:
        """Energy [J] at x (n, 3)."""
        return self.layers.value(x)

    def gradient(self, x: Array) -> Array:
        """Its derivatives (n, 3) [N]."""
        return self.layers.gradient(x)

    def added(self, matrix: sps.csc_array, x: Array, unknowns: Unknowns, *, exactly: bool) -> sps.csc_array:
        """A Hessian with its second derivatives, each pair's projected unless ``exactly`` or after a short step.

        Projection leaves negative curvature out, so that Newton's method would end by factors of two.
        """
        exactly = exactly or self._last < _SHORT * self.layers.gap
        return self._patterns.total(matrix, self.layers.hessian(x, definite=not exactly), unknowns)

    def bounded(self, move: Callable[[float], Moved], x: Array) -> Moved:
        """What ``move`` gives for a part of a direction on whose straight way from x (n, 3) no pair meets."""
        part = 1.0
        for _ in range(_TRIES):
            moved, stresses, part = move(part)
            if (free := self.layers.free_part(x, moved)) >= 1.0:
                self._last = float(np.abs(moved - x).max())
                return moved, stresses, part
            part *= free
        self._last = np.inf
        return x + free * (moved - x), self.layers.shell.predicted_stresses(x, free * (moved - x)), part

    def factoriser_of(self, hessian: sps.csc_array, plain: Factoriser) -> Factoriser:
        """One for the pattern of this Hessian."""
        return self._patterns.factoriser_of(hessian, plain)


def pressure_of(force: Array, problem: Potential) -> float:
    """Mean size of a force (n, 3) [N] over the area [Pa]."""
    return float(np.linalg.norm(force, axis=1).sum() / problem.shell.mesh.area)


@final
class Patterns:
    """Patterns of Hessians with further blocks, the last one kept as long as it holds what is needed."""

    def __init__(self, backend: str | None) -> None:
        self._backend = backend
        self._last: sps.csc_array | None = None
        self._factoriser: Factoriser | None = None

    def total(self, matrix: sps.csc_array, further: sps.csr_array | None, unknowns: Unknowns) -> sps.csc_array:
        """The matrix with the further one (3n, 3n) on the unknowns in it."""
        if further is None:
            return matrix
        own = _on_unknowns(further, unknowns)
        parts = [matrix.tocoo(), own.tocoo()]
        if self._last is not None:
            parts.append(self._last.tocoo())
        rows, columns = (np.concatenate([part.coords[axis] for part in parts]) for axis in range(2))
        data = np.concatenate([parts[0].data, parts[1].data, *(np.zeros(part.nnz) for part in parts[2:])])
        total = sps.csc_array(sps.coo_array((data, (rows, columns)), shape=matrix.shape))
        total.sort_indices()
        if self._last is None or total.nnz != self._last.nnz:
            self._last, self._factoriser = total, Factoriser(self._backend)
        return total

    def factoriser_of(self, hessian: sps.csc_array, plain: Factoriser) -> Factoriser:
        """The factoriser of the last pattern with further blocks, or the ``plain`` one for those without."""
        if self._last is not None and self._factoriser is not None and hessian.nnz == self._last.nnz:
            return self._factoriser
        return plain


def _on_unknowns(matrix: sps.csr_array, unknowns: Unknowns) -> Any:
    if isinstance(unknowns, VertexUnknowns):
        return matrix[unknowns.indices][:, unknowns.indices]
    assert unknowns.matrix is not None
    return unknowns.matrix.T @ matrix @ unknowns.matrix
