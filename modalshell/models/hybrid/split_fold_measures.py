r"""Measures of shell theory's energy for the hybrid rung.

The membrane is a quadratic form of half squared lengths, whose matrix is a sum over elements: the roots of their
matrices scale a state. The bending :math:`\delta^T H \delta / 2` couples folds. A fold that is flat at rest enters by
the vector ``j``, whose length is its angle, a bent one by the change of its angle times the mean n of both normals:
normals of neighbours are nearly parallel, so products of such vectors stand for those of the angles,

.. math:: W_b \approx \tfrac12 \sum_c v_c^T H v_c, \qquad v_e = j_e \text{ or } \delta_e n_e,

and what the flat folds add is one constant matrix (theory 11, eq. 7). Normals of neighbours are not nearly parallel
where folds turn far: flat folds that training turns by more than :data:`_TURNED` count as bent ones.
"""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array, Index
from modalshell.linalg.elements import assembled
from modalshell.models.hybrid.measures import FLAT, Bending, Measures, feet_of, offsets, remaining
from modalshell.shell import Shell
from modalshell.shell.constant_forms import ConstantForms
from modalshell.shell.kernels.split_folds import fold_angles, half_squares
from modalshell.shell.smoothed_membrane import MembraneElements
from modalshell.shell.split_fold_energy import SplitFoldEnergy

_COUPLED = 1e-2
"""Coupling of two bent folds, over the root of both stiffnesses, below which it is left out: it falls off with the
distance, to a tenth in two cells."""
_TURNED = 0.5
"""Turn [rad] of a fold, flat at rest, from which vectors miss too much of its bending."""
_COLUMNS = 256
"""Bent folds whose couplings are found at once."""
_SLACK = 1e-10
"""Stiffness of a strain, over the largest, below which it counts as zero."""


@final
class SplitFoldMeasures(Measures):
    """Of an :class:`Isotropic` shell: strains of its edges, and folds that are coupled.

    The folds ``turned`` (t,) count as bent, whatever their angle at rest.
    """

    vectors: ClassVar[tuple[int, ...]] = (44, 64)
    motions: ClassVar = 120

    def __init__(self, shell: Shell, turned: Index) -> None:
        super().__init__(shell)
        assert isinstance(shell.elastic_energy, SplitFoldEnergy)
        self._forms: ConstantForms = shell.elastic_energy.constant_forms()
        self._flat = np.abs(self._forms.angles) <= FLAT
        self._flat[turned] = False

    @property
    def edges(self) -> Index:
        """The mesh's."""
        return self._forms.edges

    @property
    def state_size(self) -> int:
        """Edges."""
        return len(self._forms.edges)

    @property
    def evaluated(self) -> int:
        """Edges."""
        return len(self._forms.edges)

    def state(self, x: Array, step: Array) -> Array:
        """Changes of half squared lengths."""
        first, second = self._forms.edges.T
        arms = x[second] - x[first]
        changes = 0.5 * np.sum(arms**2, axis=1) - self._forms.half_squares
        return np.asarray(changes + np.sum(arms * (step[second] - step[first]), axis=1))

    @cached_property
    def _root(self) -> sps.csr_array:
        """Matrix (r, E) whose square is the membrane's."""
        size = len(self._forms.edges)
        return sps.csr_array(sps.vstack([_root_of(elements, size) for elements in self._forms.membrane]))

    def scaled(self, states: Array) -> Array:
        """By the roots of the elements' matrices."""
        return np.asarray(self._root @ states)

    def unscaled(self, modes: Array) -> Array:
        """The least strains."""
        stiffness = self._forms.tension.toarray()
        return np.asarray(np.linalg.lstsq(stiffness, self._root.T @ modes, rcond=_SLACK)[0])

    def energy(self, x: Array) -> float:
        """Of half squared lengths."""
        strains = np.empty(len(self._forms.edges))
        half_squares(x, self._forms.edges, self._forms.half_squares, strains)
        return 0.5 * float(strains @ (self._forms.tension @ strains))

    @property
    def quadratic_membrane(self) -> tuple[Array, sps.csr_array]:
        """See :class:`Measures`."""
        return self._forms.half_squares, sps.csr_array(self._forms.tension)

    def far_turned(self, frames: Array) -> Index:
        """Folds that frames (f, k, 3) [m] turn by more than :data:`_TURNED`."""
        forms, points = self._forms, self._forms.points.copy()
        turned, slopes = np.zeros((2, len(forms.hinges))), np.empty((len(forms.hinges), 9))
        for x in frames:
            points[: len(x)] = x
            fold_angles(points, forms.hinges, forms.angles, turned[1], slopes)
            np.maximum(turned[0], np.abs(turned[1]), out=turned[0])
        return np.flatnonzero(turned[0] > _TURNED)

    def elastic_tensions(self, modes: Array, factors: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Array:
        """See :class:`Measures`; factors of the membrane, twice, and of the bending."""
        tensions = factors[0] * np.asarray(self._forms.tension @ modes)
        jumps = np.zeros((3 * len(self._forms.hinges), modes.shape[1]))
        flat = np.repeat(self._flat, 3)
        jumps[flat] = (self._jumps @ modes)[flat]
        couples = factors[2] * self._coupled(jumps.reshape(len(self._forms.hinges), 3, modes.shape[1])).reshape(
            jumps.shape
        )
        couples[~flat] = 0.0
        return remaining(tensions, self._jumps.T @ couples, jumps.T @ couples, modes.T @ tensions)

    @cached_property
    def _jumps(self) -> sps.csr_array:
        """Matrix (3 H, E) from half squared lengths to the part of ``j`` in the plane of each flat hinge.

        A ghost and its edge stay, so only the vertex across that edge moves.
        """
        forms = self._forms
        chosen = np.flatnonzero(self._flat)
        feet = feet_of(forms.points, forms.hinges)
        count = len(self.shell.rest_positions)
        rows, columns, values = [], [], []
        number = {(int(a), int(b)): k for k, (a, b) in enumerate(forms.edges)}
        for hinge in chosen:
            stencil = forms.hinges[hinge]
            x = forms.points[stencil]
            along = (x[1] - x[0]) / np.linalg.norm(x[1] - x[0])
            arm = x[2] - x[0]
            across = arm - (arm @ along) * along
            plane = np.stack([along, across / np.linalg.norm(across)])
            ghost = stencil[3] >= count
            pairs = [(0, 2), (1, 2)] if ghost else [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3)]
            lengths = np.zeros((len(pairs), 4, 2))
            for row, (a, b) in enumerate(pairs):
                flat_edge = plane @ (x[b] - x[a])
                lengths[row, b], lengths[row, a] = flat_edge, -flat_edge
            j = np.zeros((2, 4, 2))
            for axis in range(2):
                for side in (0, 1):
                    t, height = feet[hinge, 2 * side], feet[hinge, 2 * side + 1]
                    j[axis, 2 + side, axis] += height
                    j[axis, 0, axis] -= (1.0 - t) * height
                    j[axis, 1, axis] -= t * height
            moving = [2] if ghost else [0, 1, 2, 3]
            of = np.linalg.pinv(lengths[:, moving].reshape(len(pairs), -1), rcond=1e-9)
            jump = plane.T @ (j[:, moving].reshape(2, -1) @ of)  # (3, pairs)
            for column, (a, b) in enumerate(pairs):
                ends = sorted((int(stencil[a]), int(stencil[b])))
                for axis in range(3):
                    rows.append(3 * hinge + axis)
                    columns.append(number[ends[0], ends[1]])
                    values.append(jump[axis, column])
        shape = 3 * len(forms.hinges), len(forms.edges)
        return sps.csr_array(sps.coo_array((values, (rows, columns)), shape=shape))

    def _coupled(self, vectors: Array) -> Array:
        """H times vectors (H, 3, k), component by component."""
        tall = vectors.reshape(len(vectors), 3 * vectors.shape[2])
        return self._forms.shares.couples(tall).reshape(vectors.shape)

    def bending(self, columns: Array) -> Bending:
        """See the head of this file; ghosts rest."""
        forms = self._forms
        points, hinges = forms.points, forms.hinges
        moved = np.concatenate([columns, np.zeros((len(points) - len(columns), *columns.shape[1:]))])
        bent = np.flatnonzero(~self._flat)
        j = np.zeros((len(hinges), 3, columns.shape[2]))
        flat = np.flatnonzero(self._flat)
        j[flat] = offsets(feet_of(points, hinges[flat]), moved, hinges[flat])
        couples = self._coupled(j)
        tall = j.reshape(-1, j.shape[2])
        constant = tall.T @ couples.reshape(tall.shape)
        used, stencils = np.unique(hinges[bent], return_inverse=True)
        roots, coupling = self._couplings(bent)
        return Bending(
            0.5 * (constant + constant.T),
            np.ascontiguousarray(points[used]),
            np.ascontiguousarray(moved[used]),
            np.ascontiguousarray(stencils.reshape(-1, 4), dtype=np.int64),
            forms.angles[bent].copy(),
            roots,
            coupling.indptr.astype(np.int64),
            coupling.indices.astype(np.int64),
            coupling.data.copy(),
            np.ascontiguousarray(couples[bent] / roots[:, None, None]),
            feet_of(points, hinges[bent]),
        )

    def _couplings(self, bent: Index) -> tuple[Array, sps.csr_array]:
        """Roots of the stiffnesses of bent folds, and C without a diagonal."""
        parts: list[Array] = []
        diagonal = np.empty(len(bent))
        for begin in range(0, len(bent), _COLUMNS):
            chosen = bent[begin : begin + _COLUMNS]
            units = np.zeros((len(self._forms.hinges), len(chosen)))
            units[chosen, np.arange(len(chosen))] = 1.0
            block: Array = self._forms.shares.couples(units)[bent].T
            rows = np.arange(len(chosen))
            diagonal[begin : begin + len(chosen)] = block[rows, begin + rows]
            block[rows, begin + rows] = 0.0
            parts.append(block)
        if not parts:
            return diagonal, sps.csr_array((0, 0))
        roots = np.sqrt(diagonal)
        scaled: Array = np.concatenate(parts) / (roots[:, None] * roots)
        scaled[np.abs(scaled) < _COUPLED] = 0.0
        return roots, sps.csr_array(0.5 * (scaled + scaled.T))


def _root_of(elements: MembraneElements, edge_count: int) -> sps.csr_array:
    """Roots (elements times edges, E) of the elements' matrices."""
    values, vectors = np.linalg.eigh(elements.matrices)
    roots = np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.transpose(0, 2, 1)
    rows = np.arange(elements.edges.size).reshape(elements.edges.shape)
    return assembled(roots, rows, elements.edges, (rows.size, edge_count))
