"""Poisson fit: displacements whose gradients on the triangles are closest to given ones, with fixed supports."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sps
from numpy.typing import NDArray

from modalshell.core.errors import SupportError
from modalshell.core.typing import Array
from modalshell.linalg.elements import assembled
from modalshell.modes import Factor, Factoriser
from modalshell.shell import Shell


class PoissonFit:
    """Minimises ``sum_t A_t |grad u - D_t|^2`` over the displacements u of the free vertices [huang2011].

    Its equations are ``L u = b`` (theory 9, eq. 4), L the cotangent Laplacian, the same for each axis and factorised
    once. The stiffness of linear elements is definite on any mesh once a vertex of every connected part is fixed: the
    held ones, or, in a part without supports, one vertex for the solve. Such a part is then moved to the prescribed
    centre of mass. ``backend`` is that of :class:`modalshell.modes.Factoriser`.

    Attributes
    ----------
    slots : ndarray of int, shape (T, 3)
        Row of each corner in right sides and solutions (N + 1, 3); fixed vertices share the last one.
    frames : ndarray, shape (T, 3, 3)
        Rows a, b, n of every triangle: a along its first edge, n its normal, b = n x a.
    sides : ndarray, shape (T, 3)
        Height over the first edge, foot of that height from the first corner, and length of the first edge [m].
    coupled : bool
        Whether supports couple the axes.
    floating : list of tuple of ndarray
        Vertices of each part without supports, and their fractions of its mass.
    """

    def __init__(self, shell: Shell, backend: str | None = None) -> None:
        mesh = shell.mesh
        self.count = len(mesh.vertices)
        labels = mesh.components
        fixed = shell.clamped.copy()
        self.floating: list[tuple[NDArray[np.int64], Array]] = []
        for part in np.setdiff1d(labels, labels[shell.clamped]):
            vertices = np.flatnonzero(labels == part)
            if shell.unknowns.supported[vertices].any():
                _refuse_sliding(shell, vertices)
                continue
            fixed[vertices[0]] = True
            self.floating.append((vertices, shell.mass[vertices] / shell.mass[vertices].sum()))
        self._kept = np.flatnonzero(~fixed)
        rows = np.full(self.count, self._kept.size)
        rows[self._kept] = np.arange(self._kept.size)
        self.slots = rows[mesh.faces]

        corners = mesh.vertices[mesh.faces]
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        length = np.linalg.norm(first, axis=1)
        along = first / length[:, None]
        across = np.cross(mesh.face_normals, along)
        self.frames = np.stack([along, across, mesh.face_normals], axis=1)
        height, foot = np.einsum("ti,ti->t", second, across), np.einsum("ti,ti->t", second, along)
        self.sides = np.column_stack([height, foot, length])
        laplacian = self._laplacian()
        self.factor: Factor
        self.coupled = shell.unknowns.matrix is not None
        if shell.unknowns.matrix is None:
            self.factor = Factoriser(backend, use="axes").definite(laplacian)
        else:
            rows_of_kept = (3 * self._kept[:, None] + np.arange(3)).ravel()
            self.factor = _SupportedFactor(laplacian, shell.unknowns.matrix[rows_of_kept], backend)
        self._made_from = shell, backend

    def __reduce__(self) -> tuple[Any, ...]:  # SuperLU cannot be copied: a copy factorises again
        return PoissonFit, self._made_from

    def _laplacian(self) -> sps.csc_array:
        """``L_ij = sum_t A_t grad N_i . grad N_j`` of the rows of :attr:`slots` but the last."""
        height, foot, length = self.sides.T
        zero = np.zeros_like(height)
        two, three = np.stack([height, -foot], axis=1), np.stack([zero, length], axis=1)
        gradients = np.stack([-two - three, two, three], axis=1)  # 2 A_t grad N_i
        blocks = np.einsum("tia,tja->tij", gradients, gradients) / (2.0 * height * length)[:, None, None]
        size = self._kept.size
        whole = assembled(blocks, self.slots, self.slots, (size + 1, size + 1))
        return sps.csc_array(sps.csc_array(whole)[:size, :size])

    @property
    def rows(self) -> int:
        """Rows N + 1 of right sides, the last one standing for the fixed vertices."""
        return int(self._kept.size) + 1

    def displacement(self, right_side: Array, centres: Array) -> Array:
        """Displacements (n, 3) that fit ``right_side`` (N + 1, 3), floating parts with their centres at ``centres``."""
        out = np.zeros((self.count, 3))
        out[self._kept] = self.factor.solve(right_side[:-1])
        for (vertices, share), centre in zip(self.floating, centres, strict=True):
            out[vertices] += centre - share @ out[vertices]
        return out

    def green(self, vertex: int) -> Array:
        """Displacement (N,) of a vertex per unit of each row of a right side; shells with held vertices."""
        unit = np.zeros((self.rows - 1, 1))
        unit[self._kept == vertex] = 1.0
        return np.asarray(self.factor.solve(unit)[:, 0])

    def adjoint(self, load: Array) -> tuple[Array, Array]:
        """Fit (N + 1, 3) to a load (n, 3), and the load on every floating part (parts, 3).

        For displacements u of :meth:`displacement`, ``load . u = fit . right_side + parts . centres``.
        """
        balanced = load.copy()
        parts = np.zeros((len(self.floating), 3))
        for index, (vertices, share) in enumerate(self.floating):
            parts[index] = load[vertices].sum(axis=0)
            balanced[vertices] -= share[:, None] * parts[index]
        fit = np.zeros((self.rows, 3))
        fit[:-1] = self.factor.solve(balanced[self._kept])
        return fit, parts


class _SupportedFactor(Factor):
    """Factor of a Laplacian over vertices whose three displacements are coupled by supports ``u = P y``."""

    def __init__(self, laplacian: sps.csc_array, matrix: sps.csr_array, backend: str | None) -> None:
        self._matrix = sps.csr_array(matrix[:, np.unique(matrix.indices)])
        whole = self._matrix.T @ sps.kron(laplacian, sps.eye_array(3), format="csr") @ self._matrix
        self._factor = Factoriser(backend, use="solve").definite(sps.csc_array(whole))
        self.backend = self._factor.backend

    def _solve(self, right_side: Array) -> Array:
        values = self._factor.solve(self._matrix.T @ right_side.ravel())
        return np.asarray(self._matrix @ values).reshape(right_side.shape)


def _refuse_sliding(shell: Shell, vertices: NDArray[np.int64]) -> None:
    """SupportError for a part that its supports hold, but not against every translation."""
    moved = np.zeros((*shell.rest_positions.shape, 3))
    moved[vertices] = np.eye(3)
    if np.linalg.matrix_rank(shell.unknowns.resisted(moved).reshape(-1, 3), tol=1e-6) < 3:
        raise SupportError(
            f"the rotation-strain fit needs supports that leave no translation free of a part that they hold (got "
            f"one of the part of vertex {vertices[0]}): hold it too, or use DiscreteShell or ModalWarping"
        )
