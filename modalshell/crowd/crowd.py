"""Crowds: many instances of one shell, stepped together, each with its own level of detail."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from modalshell.core.checks import checked_count
from modalshell.core.typing import Array
from modalshell.crowd.flock import MOST_THREADS
from modalshell.crowd.kernels import instances as kernels
from modalshell.crowd.kernels.polynomials import powers
from modalshell.crowd.shell_crowd import LEVELS, ShellCrowd
from modalshell.kernels.packed import BYTES
from modalshell.models.reduction.warp_frame import aligned_zeros
from modalshell.modes import Basis


@final
class Crowd(ShellCrowd):
    """B instances of one shell by modal warping, each in its own moving frame [choi2007].

    All instances share the modal data and differ in their coordinates, loads and places. An instance is the same, to
    rounding, in any batch. Its level of detail sets both its positions and its modal force:

    - MWTS: ``rest + Rt(w) Phi q``, driven by ``Phi^T R(w)^T f``: as :class:`modalshell.ModalWarping`.
    - LMA: ``rest + Phi q``, driven by ``Phi^T f``: as :class:`modalshell.LinearModal`.
    - rigid: the rest shape; its coordinates are still stepped, as those of LMA.

    Parts that no support holds fly in frames of their own, as those of the models do: ``felt`` pulls at their centres,
    and ``forcing`` of their rigid modes is force and torque on them.

    Coordinates are continuous across a switch, positions jump, by no more than :meth:`choose_levels` allows.
    Instances near the viewer may be drawn by RSW, blended in without a jump: :meth:`blend_strains`.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    count : int
        Number of instances B.
    damping : (float, float)
        Rayleigh factors xi [1/s] of the mass and zeta [s] of the stiffness.
    dtype : {float64, float32}
        Precision of the positions and of their arithmetic. Coordinates are stepped in float64.
    threads : int
        Parts that the instances are cut into, each on a thread of numba's if there are as many; the results are the
        same, bit by bit.

    Attributes
    ----------
    coordinates, rates : ndarray, shape (B, m)
        Modal coordinates and their rates; zero at the start.
    forces : ndarray, shape (B, m)
        Modal forces at the end of the last step, where the next one begins; NaN if unknown, as at the start.
    levels : ndarray of int8, shape (B,)
        Index into :data:`modalshell.crowd.LEVELS`; MWTS at the start.
    turn_back : ndarray, shape (B, P, 3)
        How fast the frames of P free parts turned back what shapes turn, in the last step [rad/s]; zero at the start.

    Raises
    ------
    OptionError
        If ``count``, ``damping``, ``dtype`` or ``threads`` is invalid.
    """

    def __init__(
        self,
        basis: Basis,
        count: int,
        *,
        damping: tuple[float, float] = (0.0, 0.0),
        dtype: DTypeLike = np.float64,
        threads: int = 1,
    ) -> None:
        super().__init__(basis, count, damping, dtype)
        self.threads = checked_count("threads", threads, at_most=MOST_THREADS)
        shell = basis.shell
        shapes = np.concatenate([a.reshape(-1, 3, basis.count) for a in (basis.modes, basis.rotations)], axis=1)
        self._force_modal, self._force_powers = packs(shapes.transpose(0, 2, 1)), powers(np.float64)
        single = self.dtype == np.float32
        self._modal = packs(shapes.transpose(0, 2, 1).astype(self.dtype)) if single else self._force_modal
        self._powers = powers(self.dtype)
        self._rest, self._mass = packs(shell.rest_positions.astype(self.dtype)), packs(shell.mass)
        self._double_rest = packs(shell.rest_positions) if single and self.free is not None else self._rest
        self._force_work = aligned_zeros((self.threads, kernels.WORK), np.dtype(np.float64))

    def _modal_forces(self, coordinates: Array, felt: Array, levels: NDArray[np.int8]) -> Array:
        warped = np.flatnonzero(levels == kernels.WARPED)
        if felt.ndim == 2:
            force = np.asarray(felt @ self.modal_weights)
        else:
            shell = self.basis.shell
            force = (shell.mass[:, None] * felt).reshape(len(felt), -1) @ self.basis.modes
            felt = packs(felt.transpose(1, 0, 2)).transpose(1, 0, 2, 3).copy()
        force[warped] = 0.0
        given = (warped, self._force_modal, self._mass, coordinates, self._force_powers, felt)
        if self.threads == 1:
            kernels.crowd_forces(0, chunks(warped), *given, self._force_work[0], force)
        else:
            kernels.crowd_forces_parallel(*given, self._force_work, force)
        return force

    def _reconstruct(
        self, coordinates: Array, levels: NDArray[np.int8], poses: tuple[Array, Array] | None, out: NDArray[Any]
    ) -> None:
        kind = out.dtype
        placed = np.zeros((0, 12), kind) if poses is None else np.concatenate(poses, axis=1, dtype=kind)
        q = np.ascontiguousarray(coordinates, dtype=kind)
        data = self._modal, self._rest, self._powers
        if kind != self.dtype:
            data = self._force_modal, self._double_rest, self._force_powers
        for level in range(len(LEVELS)):
            order = np.flatnonzero(levels == level)
            given = (level, order, *data[:2], q, data[2], placed, out)
            if self.threads == 1:
                kernels.crowd_positions(0, chunks(order), *given)
            else:
                kernels.crowd_positions_parallel(self.threads, *given)


def chunks(order: NDArray[np.int64]) -> int:
    """Number of chunks that the kernels take ``order`` in."""
    return -(-order.size // kernels.CHUNK)


def packs(rows: NDArray[Any]) -> NDArray[Any]:
    """Numbers of vertices (n, ...) as packs (ceil(n / lanes), ..., lanes), the last one filled up with zeros."""
    lanes = BYTES // rows.itemsize
    packed = aligned_zeros((-(-len(rows) // lanes), *rows.shape[1:], lanes), rows.dtype)
    for lane in range(lanes):
        own = rows[lane::lanes]
        packed[: len(own), ..., lane] = own
    return packed
