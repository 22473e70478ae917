"""Linear equations in which gaps are prescribed: unknowns of touching vertices in axes along their normals."""

from __future__ import annotations

from typing import Any, final

import numpy as np
import scipy.sparse as sps

from modalshell.contact import kernels
from modalshell.contact.touching import Touching
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index
from modalshell.modes import Factor
from modalshell.modes.factorisation import CondensedFactor
from modalshell.statics.potential import Potential

_APART = 1e-4
"""Sine of the angle between normals of one vertex from which they count as two."""


@final
class Frames:
    """Orthogonal frames of the unknowns of touching vertices, the first axes of each along its normals.

    With a vertex's normals as rows of M, ``M^T = Q R``: the first coordinates y of ``d = Q y`` have ``M d = R^T y``.

    Parameters
    ----------
    touching : Touching
        The contacts.
    rows : ndarray of int, shape (a,)
        Rows that touch; further ones of a vertex whose normals it has already are left out.
    normals : ndarray, shape (a, 3)
        Their normals in the world.
    gaps : ndarray, shape (a,)
        Their gaps [m]: of rows whose normals depend on one another the deepest are kept.

    Attributes
    ----------
    rows : ndarray of int
        Rows that are kept.
    starts, sizes : ndarray of int, shape (v,)
        First unknown, and number of unknowns, of each touching vertex.
    frames : ndarray, shape (v, 3, 3)
        Q.
    """

    def __init__(self, touching: Touching, rows: Index, normals: Array, gaps: Array) -> None:
        along = touching.along(rows, normals)
        vertices, group, counts = np.unique(touching.vertices[rows], return_inverse=True, return_counts=True)
        order = np.argsort(group, kind="stable")
        heads = np.cumsum(counts) - counts
        single = order[heads]
        self.frames, triangle = _reflections(along[single])
        self._triangles = np.zeros((vertices.size, 3, 3))
        self._triangles[:, 0, 0] = triangle
        self.starts, self.sizes = touching.starts(rows[single])
        place = np.zeros(rows.size, np.int64)
        kept = np.zeros(rows.size, dtype=bool)
        kept[single] = True
        for vertex in np.flatnonzero(counts > 1):
            own = order[heads[vertex] : heads[vertex] + counts[vertex]]
            chosen = _independent(along[own], int(self.sizes[vertex]))
            if len(chosen) < len(own):  # of normals that are the same the deepest row binds
                own = own[np.argsort(gaps[own], kind="stable")]
                chosen = _independent(along[own], int(self.sizes[vertex]))
            kept[own] = False
            kept[own[chosen]], place[own[chosen]] = True, np.arange(len(chosen))
            size = int(self.sizes[vertex])
            turned, triangle = np.linalg.qr(along[own[chosen]][:, :size].T, mode="complete")
            self.frames[vertex] = np.eye(3)
            self.frames[vertex, :size, :size] = turned
            self._triangles[vertex, : len(chosen), : len(chosen)] = triangle[: len(chosen)]
        for axis in range(3):  # an identity where a vertex has fewer normals
            unused = self._triangles[:, axis, axis] == 0.0
            self._triangles[unused, axis, axis] = 1.0
        self.rows, self._group, self._place = rows[kept], group[kept], place[kept]
        self._slots = self.starts[:, None] + np.minimum(np.arange(3), self.sizes[:, None] - 1)
        self._used = np.arange(3) < self.sizes[:, None]

    @property
    def unknowns(self) -> Index:
        """Turned unknowns (a,) that the normals prescribe."""
        return np.asarray(self.starts[self._group] + self._place)

    def coordinates(self, moves: Array) -> Array:
        """Values (a,) of those unknowns for moves (a,) along the normals."""
        wanted = np.zeros((self.starts.size, 3))
        wanted[self._group, self._place] = moves
        solved = np.linalg.solve(self._triangles.transpose(0, 2, 1), wanted[:, :, None])[:, :, 0]
        return np.asarray(solved[self._group, self._place])

    def pushes(self, force: Array) -> Array:
        """Forces (a,) along the normals that add up to a ``force`` (N,) on the unknowns, as far as these do."""
        turned = np.einsum("vij,vi->vj", self.frames, self._of(force))
        solved = np.linalg.solve(self._triangles, turned[:, :, None])[:, :, 0]
        return np.asarray(solved[self._group, self._place])

    def _of(self, vector: Any) -> Any:
        return np.where(self._used, vector[self._slots], 0.0)

    def turned(self, vector: Any, *, back: bool = False) -> Any:
        """``Q^T`` times a vector (N,), or ``Q`` times it."""
        result, own = vector.copy(), self._of(vector)
        spun = np.einsum("vij,vj->vi" if back else "vji,vj->vi", self.frames, own)
        result[self._slots[self._used]] = spun[self._used]
        return result


def _reflections(along: Array) -> tuple[Array, Array]:
    """Householder's reflections (v, 3, 3) whose first axes are along vectors (v, 3), and these by those axes (v,)."""
    length = np.linalg.norm(along, axis=1)
    unit = along / np.maximum(length, 1e-300)[:, None]
    sign = np.where(unit[:, 0] < 0.0, -1.0, 1.0)
    mirror = unit.copy()
    mirror[:, 0] += sign
    square = np.sum(mirror**2, axis=1)
    frames = np.eye(3) - 2.0 / square[:, None, None] * mirror[:, :, None] * mirror[:, None, :]
    return frames, -sign * length


def _independent(along: Array, most: int) -> list[int]:
    """Which of some vectors (k, 3) are independent of those before, at most as many as there are unknowns."""
    chosen: list[int] = []
    basis = np.empty((0, 3))
    for index, vector in enumerate(along):
        rest = vector - basis.T @ (basis @ vector)
        length = float(np.linalg.norm(rest))
        if len(chosen) < most and length > _APART * float(np.linalg.norm(vector)):
            chosen.append(index)
            basis = np.vstack([basis, rest / length])
    return chosen


@final
class Rotated:
    """Newton's equations at an iterate, with the gaps of some rows prescribed.

    The Hessian has internal unknowns after the others, and is changed. ``rows`` (a,) touch; the turning of the forces
    ``pushes`` (a,) [N] with the normals stiffens or softens the shell. ``gaps`` has their gaps, normals and curvatures.
    """

    def __init__(
        self,
        problem: Potential,
        touching: Touching,
        gradient: Array,
        hessian: sps.csc_array,
        rows: Index,
        pushes: Array,
        gaps: tuple[Array, Array, Array],
    ) -> None:
        self._problem, self._gradient, self._hessian = problem, gradient, hessian
        gap, normals, curvatures = gaps
        self.frames = frames = Frames(touching, rows, normals, gap)
        kept = np.isin(rows, frames.rows)
        self._moves = -gap[kept]
        if curvatures[kept].any():
            starts, sizes = touching.starts(frames.rows)
            blocks = -pushes[kept, None, None] * touching.across(frames.rows, curvatures[kept])
            kernels.add_blocks(hessian.indptr, hessian.indices, hessian.data, starts, sizes, blocks)

    def matrix(self, right_side: Array) -> sps.csc_array:
        """The Hessian in turned axes, the prescribed unknowns left out of it and of a ``right_side``, in place."""
        frames, hessian = self.frames, self._hessian
        data = hessian.data.copy()
        structure = hessian.indptr, hessian.indices, data
        diagonal = float(np.abs(hessian.diagonal()).mean())
        kernels.turn(*structure, frames.starts, frames.sizes, frames.frames)
        kernels.prescribe(*structure, frames.unknowns, frames.coordinates(self._moves), diagonal, right_side)
        return sps.csc_array((data, hessian.indices, hessian.indptr), shape=hessian.shape)

    def solve(self, *, definite: bool = False) -> tuple[Array, Array]:
        """Newton's direction (N,), and the forces [N] on the rows at its end; SolverError if it is singular.

        SolverError, too, where it is to be ``definite`` and is not.
        """
        size, count = self._hessian.shape[0], self._gradient.size
        right = np.zeros(size)
        right[:count] = self.frames.turned(-self._gradient)
        matrix = self.matrix(right)
        found = self._problem.definite_factor(matrix) if definite else self._problem.factor(matrix)
        if found is None:
            raise SolverError("the Hessian is not positive definite")
        factor = whole_factor(found)
        with self._problem.costs.part("solution"):
            turned = factor.solve(right)
        direction = self.frames.turned(turned, back=True)
        force = (self._hessian @ direction)[:count] + self._gradient
        return direction[:count], self.frames.pushes(force)

    def unbalanced(self, gradient: Array) -> Array:
        """What the touching rows do not bear of a gradient (N,), in turned axes."""
        turned = self.frames.turned(gradient)
        turned[self.frames.unknowns] = 0.0
        return turned

    def kept(self) -> sps.csc_array:
        """The Hessian, in turned axes, on the motions that keep the gaps."""
        return self.matrix(np.zeros(self._hessian.shape[0]))

    def factor(self) -> Factor:
        """Its factor; SolverError if it is singular."""
        return self._problem.factor(self.kept())

    def definite_factor(self) -> Factor | None:
        """Its factor; None unless it is definite."""
        return self._problem.definite_factor(self.kept())


def whole_factor(factor: Factor) -> Factor:
    """The factor with the internal unknowns, of one that leaves them out."""
    return factor.whole if isinstance(factor, CondensedFactor) else factor
