"""The potential of a shell with the barrier of its self-contact, every step ending before layers meet."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.layers import Layers
from modalshell.core.typing import Array, Index
from modalshell.modes import Factoriser
from modalshell.shell import Shell
from modalshell.shell.pattern import SparsePattern, block_slots, build_pattern
from modalshell.statics.further import Moved
from modalshell.statics.potential import Potential

_SHORT = 0.02
"""Move, in gaps, after which Hessians of pairs are taken whole."""
_TRIES = 3
"""Shorter warped steps that are tried before a straight one."""


@final
class LayeredEnergy:
    """The barrier energy of layers, and its friction, as a further energy of a potential."""

    def __init__(self, layers: Layers, patterns: Patterns) -> None:
        self.layers, self._patterns = layers, patterns
        self._last = np.inf  # largest move [m] of a vertex in the last step

    def value(self, x: Array) -> float:
        """Energy [J] at x (n, 3)."""
        return self.layers.value(x)

    def gradient(self, x: Array) -> Array:
        """Its derivatives (n, 3) [N]."""
        return self.layers.gradient(x)

    def matrix(self, shell: Shell, data: Array, x: Array, *, exactly: bool) -> sps.csc_array:
        """A shell's Hessian with its second derivatives, semi-definite ones unless ``exactly`` or after a short step.

        The semi-definite part of each pair is of rank one. When layers strike, it needs at most three more iterations
        than the projection of each pair's whole, at an eighth of the cost. Alone it would end by constant factors.
        """
        definite = not exactly and self._last >= _SHORT * self.layers.gap
        return self._patterns.matrix(shell, data, self.layers, x, definite=definite)

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
    """Patterns of Hessians with the blocks of pairs, the last one kept as long as it holds what is needed.

    A new one has the blocks of ``expected`` (p, 4), too: pairs that may come near in the step.
    """

    def __init__(self, backend: str | None) -> None:
        self._backend = backend
        self._whole: SparsePattern | None = None
        self._places = np.empty(0, np.int64)
        self._entries = 0
        self._factoriser: Factoriser | None = None
        self.expected = np.empty((0, 4), np.int64)
        self._last = self.expected, np.empty((0, 4, 4), np.int64)  # pairs and their slots; what rubs stays for a step

    def matrix(self, shell: Shell, data: Array, layers: Layers, x: Array, *, definite: bool) -> sps.csc_array:
        """Hessian of a shell with entries ``data`` on its own pattern, and of its layers at x (n, 3)."""
        stencils = layers.stencils(x)
        if not any(len(stencil) for stencil in stencils):
            return shell.pattern.free_matrix(data)
        whole = self._whole
        slots = None if whole is None else self._slots(whole, stencils)
        if whole is None or slots is None:
            whole, slots = self._grow(shell, [*stencils, layers.near_pairs, self.expected])
        total = np.zeros(whole.size)
        total[self._places] = data[: self._places.size]
        total[whole.block_size :] = data[self._places.size :]
        layers.add_hessian(x, slots, whole.strides, total, definite=definite)
        return whole.free_matrix(total)

    def _slots(self, whole: SparsePattern, stencils: list[Index]) -> list[Index] | None:
        """Where the blocks (p, 4, 4) of pairs begin; None where one has no place."""
        slots, blocks = [], whole.blocks
        for stencil in stencils:
            known, own = self._last
            if stencil is not known:
                own = block_slots(stencil, stencil, blocks, 6, 0, whole.size)
                found = own // 3 - 2 * blocks.indptr[stencil][:, :, None]  # of slots 6 start + 3 place
                if own.min(initial=0) < 0 or (blocks.indices[found] != stencil[:, None, :]).any():
                    return None
            slots.append(own)
        self._last = stencils[-1], slots[-1]
        return slots

    def _grow(self, shell: Shell, stencils: list[Index]) -> tuple[SparsePattern, list[Index]]:
        """A pattern with the blocks of these pairs and the shell's own, and where they begin."""
        own = shell.pattern
        blocks = own.blocks
        rows = np.repeat(np.arange(blocks.shape[0]), np.diff(blocks.indptr))
        couples = np.stack([rows, blocks.indices], axis=1)
        whole, slots = build_pattern(len(own.strides), [couples, *stencils], shell.unknowns, own.internal)
        inside = np.arange(3)
        first = block_slots(rows[:, None], couples[:, 1:], blocks, 6, 0, own.size)
        places = np.empty(own.block_size, np.int64)
        places[first + own.strides[rows][:, None, None] * inside[:, None] + inside] = (
            slots[0][:, :1, 1:] + whole.strides[rows][:, None, None] * inside[:, None] + inside
        )
        self._whole, self._places, self._factoriser = whole, places, Factoriser(self._backend)
        self._entries = whole.free_matrix(np.zeros(whole.size)).nnz
        self._last = stencils[1], slots[2]
        return whole, slots[1:]

    def factoriser_of(self, hessian: sps.csc_array, plain: Factoriser) -> Factoriser:
        """The factoriser of the last pattern with further blocks, or the ``plain`` one for those without."""
        if self._factoriser is not None and hessian.nnz == self._entries:
            return self._factoriser
        return plain
