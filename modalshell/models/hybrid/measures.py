"""What the hybrid rung asks of a coarse shell's energy: stresses of its membrane, and bending on a basis.

Flat hinges bend by a constant matrix: there the fold angle is the length of ``j``, the sum over both sides of the
opposite vertex's offset from its foot on the edge, over its height at rest. Hinges with an angle at rest are evaluated
as they are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sps

from modalshell.core.typing import Array, Index
from modalshell.shell import Shell

FLAT = 1e-6
"""Rest angle [rad] up to which a hinge is flat."""
NONE_TURNED: Index = np.empty(0, dtype=np.int64)
RESISTED = 0.9
"""Largest share of a membrane mode's energy that flat hinges take where stresses take the rest."""


class Bending(NamedTuple):
    """Bending energy of coordinates z (m,): H hinges that are bent at rest, on S vertices, and all flat ones together.

    With the changes ``s`` of the bent hinges' angles times ``roots``, it is ``z . flat z / 2 + s . s / 2``, and where
    hinges are coupled, with ``s . C s / 2`` and ``sum_h s_h n_h . (P_h z)``, n_h being the mean of both normals.

    In a reduced energy all rows of the basis have zeros up to a whole number of packed registers.
    """

    flat: Array
    """Stiffness of the flat hinges; shape (m, m)."""
    rest: Array
    modes: Array
    """The bent hinges' vertices at rest [m], and their rows of the basis; shape (S, 3) and (S, 3, m)."""
    hinges: Index
    """Stencils of these hinges in their vertices; shape (H, 4)."""
    angles: Array
    roots: Array
    """Angles at rest [rad], and roots of the stiffness by the angle; shape (H,)."""
    starts: Index
    others: Index
    values: Array
    """C by rows, without a diagonal: the other hinges, and what couples them. Shape (H + 1,), (c,) and (c,)."""
    across: Array
    """P_h; of no hinge where none is coupled. Shape (H, 3, m)."""
    feet: Array
    """Place of each side's foot along the edge, over its length, and one over the height at rest [1/m]; shape
    (H, 4)."""


class Measures(ABC):
    """Strains and stresses of a coarse shell's membrane, and its bending on a basis.

    States of the membrane are vectors (e,), linear in its strains; so are modes of its stresses. Their energy is half
    the square of their scaled form.
    """

    vectors: ClassVar[tuple[int, ...]] = (32,)
    """Vectors of a basis where neither their number nor an error is wanted: the first that err little in training."""
    motions: ClassVar = 40
    """Motions of a training where no number is wanted."""

    def __init__(self, shell: Shell) -> None:
        self.shell = shell

    @property
    @abstractmethod
    def edges(self) -> Index:
        """Edges (E, 2) whose half squared lengths are the strains."""

    @property
    @abstractmethod
    def state_size(self) -> int:
        """Size e of a state."""

    @property
    @abstractmethod
    def evaluated(self) -> int:
        """Elements that the membrane's energy evaluates."""

    @abstractmethod
    def state(self, x: Array, step: Array) -> Array:
        """State (e,) after ``step`` (n, 3) from ``x`` (n, 3), by the strains linearised there."""

    @abstractmethod
    def scaled(self, states: Array) -> Array:
        """States (e, k) in the form whose square is twice the energy."""

    @abstractmethod
    def unscaled(self, modes: Array) -> Array:
        """States (e, k) of that form."""

    @abstractmethod
    def energy(self, x: Array) -> float:
        """Energy of the membrane [J]."""

    @property
    def quadratic_membrane(self) -> tuple[Array, sps.csr_array] | None:
        """Half squared lengths (E,) [m^2] at rest, and the matrix (E, E) of their changes, where that is the energy."""
        return None

    @abstractmethod
    def elastic_tensions(self, modes: Array, factors: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Array:
        """Stresses (E, k) of modes (e, k), by the half squared lengths of the edges, less what flat hinges resist.

        They are turned so that half the sum of squares of their work is the energy.
        The bending of flat hinges by ``j`` is meant for isometric motions. Strains of the two triangles enter ``j`` by
        the jumps of E_nn and 2 E_tn across the edge: that energy is left to the hinges, and taken from the stresses.
        Modes of whose energy the hinges take more than :data:`RESISTED` are left to the hinges altogether.
        ``factors`` are those of the energy's parts, the last of the bending.
        """

    def far_turned(self, frames: Array) -> Index:
        """Folds, flat at rest, that frames (f, k, 3) [m] turn so far that they are to be evaluated."""
        return NONE_TURNED

    @abstractmethod
    def bending(self, columns: Array) -> Bending:
        """Bending on displacements ``columns`` (n, 3, m)."""


def remaining(tensions: Array, resisted: Array, hinges: Array, energies: Array) -> Array:
    """Tensions (E, k) less the ``resisted`` ones, of modes whose energies (k, k) the ``hinges`` (k, k) take partly."""
    fractions, turned = scipy.linalg.eigh(hinges, energies)
    kept = fractions < RESISTED
    return np.asarray((tensions - resisted) @ (turned[:, kept] / np.sqrt(1.0 - fractions[kept])))


def feet_of(vertices: Array, hinges: Index) -> Array:
    """Place of each side's foot along the edge, over its length, and one over its height (H, 4)."""
    first = vertices[hinges[:, 0]]
    edge = vertices[hinges[:, 1]] - first
    length = np.sum(edge**2, axis=1)
    found = np.empty((len(hinges), 4))
    for side in (0, 1):
        arm = vertices[hinges[:, 2 + side]] - first
        along = np.sum(arm * edge, axis=1) / length
        found[:, 2 * side] = along
        found[:, 2 * side + 1] = 1.0 / np.linalg.norm(arm - along[:, None] * edge, axis=1)
    return found


def offsets(feet: Array, columns: Array, hinges: Index) -> Array:
    """``j`` (H, 3, m) of displacements (n, 3, m)."""
    total = np.zeros((len(hinges), *columns.shape[1:]))
    for side in (0, 1):
        along, height = feet[:, 2 * side, None, None], feet[:, 2 * side + 1, None, None]
        foot = (1.0 - along) * columns[hinges[:, 0]] + along * columns[hinges[:, 1]]
        total += (columns[hinges[:, 2 + side]] - foot) * height
    return total
