"""The potential of a shell with the barrier of its self-contact, every step ending before layers meet."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.layers import Layers
from modalshell.core.typing import Array
from modalshell.modes import Factoriser
from modalshell.shell import EXACT
from modalshell.statics.potential import Potential
from modalshell.supports import Unknowns, VertexUnknowns

_SHORT = 0.02
"""Move, in gaps, after which Hessians of pairs are taken whole."""
_TRIES = 3
"""Shorter warped steps that are tried before a straight one."""


@final
@dataclass(frozen=True)
class LayeredPotential(Potential):
    """A potential with the barrier energy of ``layers`` in it, and its friction.

    The barrier's Hessian changes its pattern with the pairs that are near. Blocks that were needed once stay, so that
    one analysis serves many factors.
    """

    layers: Layers = field(kw_only=True)
    patterns: Patterns = field(kw_only=True)
    last_step: Array = field(default_factory=lambda: np.full(1, np.inf), kw_only=True)
    """Largest move (1,) [m] of a vertex in the last step."""

    @classmethod
    def of(cls, problem: Potential, layers: Layers, patterns: Patterns) -> LayeredPotential:
        """A potential with the barrier of ``layers`` in it."""
        own: dict[str, Any] = {part.name: getattr(problem, part.name) for part in fields(problem)}
        return cls(**own, layers=layers, patterns=patterns)

    @property
    def refinable(self) -> bool:
        """False: the barrier has no extended precision."""
        return False

    def potential(self, x: Array) -> tuple[float, Array]:
        """See :meth:`Potential.potential`."""
        value, gradient = super().potential(x)
        return value + self.layers.value(x), gradient + self._restricted(x)

    def linearise(
        self, x: Array, geometric: int, stresses: list[Array] | None = None, led: Array | None = None
    ) -> tuple[Array, sps.csc_array]:
        """See :meth:`Potential.linearise`; each pair's Hessian is projected, but in exact ones and after short steps.

        Projection leaves negative curvature out, so that Newton's method would end by factors of two.
        """
        gradient, matrix = super().linearise(x, geometric, stresses, led)
        with self.costs.part("assembly"):
            exactly = geometric == EXACT or self.last_step[0] < _SHORT * self.layers.gap
            further = self.layers.hessian(x, definite=not exactly)
            return gradient + self._restricted(x), self.patterns.total(matrix, further, self.shell.unknowns)

    def _restricted(self, x: Array) -> Array:
        return np.asarray(self.shell.unknowns.restrict(self.layers.gradient(x).ravel()))

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """See :meth:`Potential.moved`; no pair meets on the straight way."""
        part = 1.0
        for _ in range(_TRIES):
            moved, stresses, share = super().moved(x, part * direction, reach)
            part *= share
            if (free := self.layers.free_part(x, moved)) >= 1.0:
                self.last_step[0] = np.abs(moved - x).max()
                return moved, stresses, part
            part *= free
        self.last_step[0], step = np.inf, free * (moved - x)
        return x + step, self.shell.predicted_stresses(x, step), part

    def factoriser_of(self, hessian: sps.csc_array) -> Factoriser:
        """One for the pattern of this Hessian."""
        return self.patterns.factoriser_of(hessian, self.factoriser)


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
