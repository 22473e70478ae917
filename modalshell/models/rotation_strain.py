"""RSW, the rotation-strain warp [huang2011]: modes as rotations and strains of triangles, joined by a Poisson fit.

See theory 9, eq. 1 to 4.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_kind
from modalshell.core.cost import count_read
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal import ModalIntegrator
from modalshell.kernels.frame import TILE
from modalshell.kernels.packed import LANES
from modalshell.loads.surface_kernels import APART
from modalshell.models.base.rotation_strain_base import LoadAdjoint, TurnedTriangles
from modalshell.models.reduction import rotation_strain_kernels as kernel
from modalshell.models.reduction.load_points import LoadPoints
from modalshell.models.reduction.load_quadrature import ModalPush
from modalshell.models.reduction.patched_work import PatchedWork
from modalshell.models.reduction.poisson import PoissonFit
from modalshell.modes import Basis

_GREEN = 512
"""Vertices whose displacements per right side are kept, at most."""
_Scalar = TypeVar("_Scalar", np.float64, np.int64)


@final
class RotationStrain(TurnedTriangles):
    """RSW: modes prescribe rotation and strain of every triangle, and a least-squares fit joins the triangles.

    With the rotation vector ``w_tk`` and the surface strain ``S_tk`` of triangle t in mode k, coordinates q prescribe
    the deformation gradient ``F_t = exp([sum_k q_k w_tk]) (I + sum_k q_k S_tk)`` on the triangle's tangents. Positions
    minimise ``sum_t A_t |grad x - F_t|^2`` with the held vertices at rest: three right sides of one factorised
    Laplacian per frame. For small q that is ``u = Phi q``, and equal rotations everywhere are an exact rigid rotation.

    The modal force is the exact gradient of the load's potential ``f . u(q)``, so statics minimises
    ``q . Lambda q / 2 - f . u(q)``, which always has a solution.

    A part without supports has the centre of mass of the linear modes.

    Parameters
    ----------
    basis : Basis
        Modes and eigenvalues of the shell.
    integrator : str or ModalIntegrator
        See :class:`modalshell.LinearModal`.
    backend : str, optional
        Factorisation to use; see :class:`modalshell.modes.Factoriser`.
    """

    name = "RSW"

    def __init__(
        self, basis: Basis, *, integrator: str | ModalIntegrator = "exponential", backend: str | None = None
    ) -> None:
        fit = PoissonFit(checked_kind("basis", basis, Basis, "ms.solve_modes(shell, count) makes one").shell, backend)
        modal = tiled(triangle_modes(basis, fit)).reshape(-1, basis.count, 6 * TILE)
        super().__init__(basis, modal, integrator)
        self.backend = fit.factor.backend
        self._fit = fit
        modes = basis.modes.reshape(-1, 3, basis.count)
        centres = [np.tensordot(share, modes[part], 1) for part, share in fit.floating]
        self._green = np.empty((0, fit.rows - 1))
        self._places = np.full(len(basis.shell.rest_positions), -1, np.int64)
        self._spread: tuple[bytes, Array] | None = None
        self._gathered: tuple[bytes, tuple[Array, Array]] | None = None
        self._centres = np.array(centres).reshape(-1, 3, basis.count)
        height, foot, length = fit.sides.T
        shape = np.column_stack([fit.frames.reshape(-1, 9), 0.5 * height, 0.5 * foot, 0.5 * length])
        self._shape = tiled(shape).reshape(-1, 12 * TILE)
        self._corners = tiled(fit.slots, fill=fit.rows - 1)

    def warped(self, q: Array) -> Array:
        """Displacements (n, 3) [m] of the fitted surface."""
        return self._fit.displacement(self._right_side(q), self._centres @ q)

    def _right_side(self, q: Array) -> Array:
        """Right side (N + 1, 3) of the fit at q; the last one is kept."""
        known = self._spread  # read once: another thread may spread another meanwhile
        key = q.tobytes()
        if known is not None and known[0] == key:
            return known[1]
        count_read(self._modal.nbytes + self._shape.nbytes)
        right = np.empty((self._fit.rows, 3))
        kernel.spread(self._modal, self._shape, self._corners, q, np.empty(kernel.WORK), right)
        self._spread = key, right
        return right

    def contact_frame(self, q: Array, vertices: Index, directions: Array | None) -> tuple[Array, Array | None]:
        """Positions (k, 3) [m] of some vertices, and their derivatives; see :meth:`ModalMotion.contact_frame`.

        Without a solve, by what a vertex has of each row of the fit.
        """
        fit, count = self._fit, vertices.size
        if fit.coupled or fit.floating:
            return super().contact_frame(q, vertices, directions)
        green, at_rest = self._green_of(vertices)
        points = at_rest + green @ self._right_side(q)[:-1]
        if directions is None:
            return points, None
        columns, slots = self._by_triangle
        right = np.empty((fit.rows, len(directions), columns.shape[2]))
        none = self._corners, np.empty((0, 3)), np.empty((0, 3)), q
        kernel.spread_rows(self._modal, self._shape, columns, slots, q, directions, right, none)
        moves = (green @ right[:-1].reshape(fit.rows - 1, -1)).reshape(count, *right.shape[1:])
        return points, moves[:, :, : q.size]

    def contact_rows(self, q: Array, vertices: Index) -> Array:
        """Derivatives (k, 3, m) of some vertices' positions by the coordinates; exact where supports hold vertices."""
        if self._fit.coupled or self._fit.floating:
            return super().contact_rows(q, vertices)
        rows = self.contact_frame(q, vertices, np.eye(3))[1]
        assert rows is not None
        return rows

    def _stay_under(self, adjoint: LoadAdjoint) -> Callable[..., Any] | None:
        return None if self._fit.coupled or self._fit.floating else partial(self._stay, adjoint)

    def _stay(self, adjoint: LoadAdjoint, vertices: Index, *given: Any) -> tuple[int, float, Any]:
        """A step in which vertices (k,) stay pushed; see :func:`stay_twice`, whose ``rows`` and on are ``given``."""
        from modalshell.contact.stay_kernels import STAYS  # not without contacts
        from modalshell.models.reduction.rotation_strain_stay import stay_twice

        *before, out = given
        right, work = np.empty((self._fit.rows, 3)), (adjoint.gradients, adjoint.constant)
        fit = self._modal, self._shape, self._corners, *self._by_triangle, *self._green_of(vertices)
        found, energy, read, arrived = stay_twice(fit, work, *before, (*out, right))
        count_read(read * (self._modal.nbytes + self._shape.nbytes) + 2 * work[0].nbytes)
        if found == STAYS:
            self._spread = out[0][0].tobytes(), right
        return found, energy, arrived

    def _green_of(self, vertices: Index) -> tuple[Array, Array]:
        """Displacements (k, N) of some vertices per unit of each row of a right side, and positions (k, 3) [m] at rest.

        Those of the last are kept.
        """
        last, key = self._gathered, vertices.tobytes()
        if last is not None and last[0] == key:
            return last[1]
        places = self._places[vertices]
        if places.size and places.min() < 0:
            missing = np.unique(vertices[places < 0])
            if missing.size + len(self._green) > max(_GREEN, missing.size):
                self._green, self._places[:], missing = self._green[:0], -1, np.unique(vertices)
            self._places[missing] = len(self._green) + np.arange(missing.size)
            self._green = np.concatenate([self._green, [self._fit.green(int(vertex)) for vertex in missing]])
            places = self._places[vertices]
        found = self._green[places], self.shell.rest_positions[vertices]
        self._gathered = key, found
        return found

    @cached_property
    def _by_triangle(self) -> tuple[Array, Index]:
        """Turns and strains (T, 6, M) of all triangles, M modes that fill whole registers, and their rows."""
        columns = self.turns_and_strains(np.arange(len(self.shell.mesh.faces))).transpose(0, 2, 1)
        filled = np.zeros((*columns.shape[:2], -(-self.basis.count // LANES) * LANES))
        filled[:, :, : self.basis.count] = columns
        return filled, np.array(self._fit.slots)

    def turns_and_strains(self, triangles: NDArray[np.int64]) -> Array:
        """Columns of :func:`triangle_modes` (k, m, 6) of some triangles."""
        tiles = self._modal.reshape(-1, self.basis.count, 6, TILE)
        return tiles[triangles // TILE, :, :, triangles % TILE]

    def _adjoint(self, load: Array) -> LoadAdjoint:
        fit, parts = self._fit.adjoint(load)
        gradients = np.empty((len(self._modal), 6 * TILE))
        kernel.adjoint_gradients(fit, self._corners, self._shape, gradients)
        return LoadAdjoint(load.copy(), gradients, np.tensordot(parts, self._centres, 2))

    def _modal_push(self, points: LoadPoints) -> ModalPush:
        """By the work on the fitted surface, its triangles in patches."""
        mesh = self.shell.mesh
        columns = self.turns_and_strains(np.arange(len(mesh.faces)))
        work = PatchedWork(mesh, self._fit, columns, points)
        return ModalPush(APART, work.at_points, self._kept_force)


def triangle_modes(basis: Basis, fit: PoissonFit) -> Array:
    """Rotation vector and surface strain of every triangle and mode, in the triangle's frame (T, m, 6).

    Columns: w_a, w_b, w_n, S_aa, S_bb, S_ab. The turns about a and b are the least-squares ones [choi2007, eq. 11]; the
    turn in the plane is half the curl, so that turn and strain together are the mode's whole gradient.
    """
    corners = basis.modes.reshape(-1, 3, basis.count)[basis.shell.mesh.faces]
    local = np.einsum("tri,tcik->tcrk", fit.frames, corners[:, 1:] - corners[:, :1])
    height, foot, length = (side[:, None, None] for side in fit.sides.T)
    by_a = local[:, 0] / length
    by_b = (local[:, 1] - foot * by_a) / height
    rows = (
        by_b[:, 2],
        -by_a[:, 2],
        0.5 * (by_a[:, 1] - by_b[:, 0]),
        by_a[:, 0],
        by_b[:, 1],
        0.5 * (by_a[:, 1] + by_b[:, 0]),
    )
    return np.stack(rows, axis=2)


def tiled(rows: NDArray[_Scalar], fill: int = 0) -> NDArray[_Scalar]:
    """Values of triangles (T, ...) as tiles (T / 128, ..., 128), the last one filled up."""
    tiles = -(-len(rows) // TILE)
    padded = np.full((tiles * TILE, *rows.shape[1:]), fill, dtype=rows.dtype)
    padded[: len(rows)] = rows
    return np.ascontiguousarray(np.moveaxis(padded.reshape(tiles, TILE, *rows.shape[1:]), 1, -1))
