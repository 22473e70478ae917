"""Many instances of one shell: modal coordinates stepped at once, positions at a level of detail for each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.checks import checked_count, checked_kind, checked_number, checked_vectors, shown
from modalshell.crowd.flock import MOST, MOST_THREADS
from modalshell.errors import OptionError
from modalshell.integrators.modal import ImplicitEuler
from modalshell.kernels import crowd as kernels
from modalshell.kernels.frame import TILE
from modalshell.models import RotationStrain
from modalshell.modes import Basis
from modalshell.reduction.warp_frame import WarpFrame
from modalshell.typing import Array

LEVELS = ("rigid", "LMA", "MWTS")
"""Levels of detail, by the number that stands for each in :attr:`Crowd.levels`."""

_BATCH = 256
"""Instances whose shapes are held at once while their errors are found."""
_RULE = ImplicitEuler()


class Crowd:
    """B instances of one shell by modal warping, each in a frame of its own that moves [choi2007].

    All instances share the modal data and differ in their coordinates, loads and places. An instance is the same, to
    rounding, in any batch. Its level of detail sets both its positions and its modal force:

    - MWTS: ``rest + Rt(w) Phi q``, driven by ``Phi^T R(w)^T f``: as :class:`modalshell.ModalWarping`.
    - LMA: ``rest + Phi q``, driven by ``Phi^T f``: as :class:`modalshell.LinearModal`.
    - rigid: the rest shape; its coordinates go on as those of LMA, so that it is up to date when it comes near.

    Coordinates are continuous across a switch, positions jump, by no more than :meth:`choose_levels` allows.
    Instances near the viewer may be drawn by RSW besides, blended in without a jump: :meth:`blend_strains`.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    count : int
        Number of instances B.
    damping : (float, float)
        Rayleigh factors xi [1/s] of the mass and zeta [s] of the stiffness.
    dtype : {float64, float32}
        Precision of the positions and of the arithmetic that makes them. Coordinates are stepped in float64.
    threads : int
        Parts that the instances are cut into, each on a thread of numba's if there are as many; the results are the
        same, bit by bit.

    Attributes
    ----------
    coordinates, rates : ndarray, shape (B, m)
        Modal coordinates and their rates; zero at the start.
    levels : ndarray of int8, shape (B,)
        Index into :data:`LEVELS`; MWTS at the start.

    Raises
    ------
    OptionError
        If ``count``, ``damping``, ``dtype`` or ``threads`` is none of these.
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
        self.basis = checked_kind("basis", basis, Basis)
        self.count = checked_count("count", count, at_most=MOST)
        self.threads = checked_count("threads", threads, at_most=MOST_THREADS)
        mass_factor, stiffness_factor = checked_vectors("damping", damping, (2,), OptionError)
        if min(mass_factor, stiffness_factor) < 0.0:
            raise OptionError(f"damping must be two factors at least 0 (got {shown(damping)})")
        self._damping = mass_factor + stiffness_factor * basis.eigenvalues
        frame = WarpFrame(basis, dtype=dtype)
        self.dtype, self.vertices = frame.dtype, frame.vertices
        double = self.dtype == np.float64
        self._modal, self._powers = frame.modal_data, kernels.powers(self.dtype)
        self._force_modal = self._modal if double else WarpFrame(basis).modal_data
        self._force_powers = kernels.powers(np.float64)
        tiles = len(self._modal)
        padded = np.zeros((tiles * TILE, 4))
        padded[: self.vertices, :3] = basis.shell.rest_positions
        padded[: self.vertices, 3] = basis.shell.mass
        by_row = padded.reshape(tiles, TILE, 4).transpose(0, 2, 1)
        self._rest = np.ascontiguousarray(by_row[:, :3].reshape(tiles, 3 * TILE), dtype=self.dtype)
        self._mass = np.ascontiguousarray(by_row[:, 3])
        self._work = np.zeros((self.threads, kernels.work_size(self.dtype)), self.dtype)
        self._force_work = self._work if double else np.zeros((self.threads, kernels.work_size(np.float64)))
        # Modal force of LMA for a unit acceleration along each axis, and the largest motion and turn of each mode.
        modes, turns = (a.reshape(-1, 3, basis.count) for a in (basis.modes, basis.rotations))
        self._weights = np.einsum("n,nik->ik", basis.shell.mass, modes)
        self._reach, self._turn = (np.linalg.norm(a, axis=1).max(axis=0) for a in (modes, turns))
        self.coordinates = np.zeros((self.count, basis.count))
        self.rates = np.zeros_like(self.coordinates)
        self.levels = np.full(self.count, kernels.WARPED, np.int8)

    def step(self, dt: float, *, felt: ArrayLike = (0.0, 0.0, 0.0), forcing: ArrayLike | None = None) -> None:
        """One step of implicit Euler for every mode of every instance, under the forces at its beginning.

        Parameters
        ----------
        dt : float
            Step [s].
        felt : array_like, shape (3,) or (B, 3)
            Gravity less the acceleration of the instance's frame, in that frame, the same for all its vertices
            [m/s^2]. What a turning frame adds (Euler, centrifugal and Coriolis forces) is left out: for a boid it is
            smaller than this by the shell's size over the radius of the turn.
        forcing : array_like, shape (B, m), optional
            Further modal forces, such as those of :class:`modalshell.crowd.Flap`.
        """
        dt = checked_number("dt", dt, above=0.0, unit="s")
        felt = self._per_instance("felt", felt, (3,))
        force = self._modal_forces(felt)
        if forcing is not None:
            force += checked_vectors("forcing", forcing, force.shape, OptionError)
        self.coordinates, self.rates = _RULE.step(
            self.coordinates, self.rates, lambda _: force, self.basis.eigenvalues, self._damping, dt
        )

    def positions(
        self,
        rotations: ArrayLike | None = None,
        translations: ArrayLike | None = None,
        out: NDArray[Any] | None = None,
    ) -> NDArray[Any]:
        """Vertex positions (B, n, 3) [m] in the world, each instance at its level of detail.

        Parameters
        ----------
        rotations : array_like, shape (3, 3) or (B, 3, 3), optional
            From the instance's frame to the world's; none without it.
        translations : array_like, shape (3,) or (B, 3), optional
            Of the frame's origin [m]; none without it.
        out : ndarray, shape (B, n, 3), optional
            C-ordered array of the crowd's precision to write into.
        """
        shape = (self.count, self.vertices, 3)
        if out is None:
            out = np.empty(shape, self.dtype)
        elif out.shape != shape or out.dtype != self.dtype or not (out.flags.c_contiguous and out.flags.writeable):
            raise OptionError(
                f"out must be a writable C-ordered {self.dtype} array of shape {shape} (got {out.dtype} {out.shape})"
            )
        poses = None
        if rotations is not None or translations is not None:
            poses = self._poses(rotations, translations)
        self._reconstruct(self.coordinates, self.levels, poses, out)
        return out

    def blend_strains(
        self,
        model: RotationStrain,
        shares: ArrayLike,
        out: NDArray[Any],
        rotations: ArrayLike | None = None,
        translations: ArrayLike | None = None,
    ) -> Array:
        """Move positions towards those of RSW, as much as each instance's share says.

        Shares that change smoothly with the distance from the viewer show no jump. Forces stay those of the levels.

        Parameters
        ----------
        model : RotationStrain
            RSW on the crowd's basis.
        shares : array_like, shape (B,)
            From 0, as it is, to 1, RSW.
        out : ndarray, shape (B, n, 3)
            What :meth:`positions` gave with the same ``rotations`` and ``translations``; changed in place [m].

        Returns
        -------
        ndarray, shape (B,)
            Largest distance [m] of a vertex by RSW from where it was; zero without a share.
        """
        if model.basis is not self.basis:
            raise OptionError("the model must stand on the crowd's own basis")
        share = checked_vectors("shares", shares, (self.count,), OptionError)
        turns, moves = self._poses(rotations, translations)
        gaps = np.zeros(self.count)
        for b in np.flatnonzero(share):
            shape = self.basis.shell.rest_positions + model.displacement(self.coordinates[b])
            gap = shape @ turns[b].reshape(3, 3).T + moves[b] - out[b]
            gaps[b] = np.linalg.norm(gap, axis=1).max()
            out[b] += share[b] * gap
        return gaps

    def choose_levels(self, distances: ArrayLike, angle: float) -> None:
        """Give every instance the cheapest level that is not seen to be one.

        No vertex is farther from its place by MWTS than ``angle`` in view, so that none jumps by more at a switch. With
        ``|u|`` and ``|w|`` at most ``sum_k |q_k|`` times the largest motion and turn of mode k, rigid is off by at most
        ``|u|`` and LMA by at most ``|w| |u| / 2``.

        Parameters
        ----------
        distances : array_like, shape (B,)
            From the viewer to the nearest vertex of each instance [m].
        angle : float
            Largest angle allowed [rad]; a pixel is one over the focal length in pixels.
        """
        angle = checked_number("angle", angle, above=0.0, unit="rad")
        seen = angle * checked_vectors("distances", distances, (self.count,), OptionError)
        amounts = np.abs(self.coordinates)
        length, turn = amounts @ self._reach, amounts @ self._turn
        levels = np.where(0.5 * turn * length <= seen, kernels.LINEAR, kernels.WARPED)
        self.levels = np.where(length <= seen, kernels.RIGID, levels).astype(np.int8)

    def level_errors(self) -> Array:
        """How far a vertex is from its place by MWTS at the present coordinates and levels, largest of each, (B,) [m].

        It is what a switch between that level and MWTS would show.
        """
        errors = np.zeros(self.count)
        less = np.flatnonzero(self.levels != kernels.WARPED)
        for part in np.array_split(less, -(-less.size // _BATCH)) if less.size else ():
            shapes = np.empty((2, part.size, self.vertices, 3), self.dtype)
            warped = np.full(part.size, kernels.WARPED, np.int8)
            for shape, levels in zip(shapes, (self.levels[part], warped), strict=True):
                self._reconstruct(self.coordinates[part], levels, None, shape)
            errors[part] = np.linalg.norm(shapes[1] - shapes[0], axis=2).max(axis=1)
        return errors

    def _modal_forces(self, felt: Array) -> Array:
        """Modal forces (B, m) at the present coordinates and levels, of accelerations (B, 3)."""
        force = np.asarray(felt @ self._weights)
        warped = np.flatnonzero(self.levels == kernels.WARPED)
        force[warped] = 0.0
        given = (warped, self._force_modal, self._mass, self.coordinates, self._force_powers, felt)
        if self.threads == 1:
            kernels.crowd_forces(0, chunks(warped), *given, self._force_work[0], force)
        else:
            kernels.crowd_forces_parallel(*given, self._force_work, force)
        return force

    def _reconstruct(
        self, coordinates: Array, levels: NDArray[np.int8], poses: tuple[Array, Array] | None, out: NDArray[Any]
    ) -> None:
        """Write the positions of some instances into ``out``, where they are or at the poses of :meth:`_poses`."""
        placed = np.zeros((0, 12), self.dtype) if poses is None else np.concatenate(poses, axis=1, dtype=self.dtype)
        q = np.ascontiguousarray(coordinates, dtype=self.dtype)
        for level in range(len(LEVELS)):
            order = np.flatnonzero(levels == level)
            given = (level, order, self._modal, self._rest, q, self._powers, placed)
            if self.threads == 1:
                kernels.crowd_positions(0, chunks(order), *given, self._work[0], out)
            else:
                kernels.crowd_positions_parallel(*given, self._work, out)

    def _poses(self, rotations: ArrayLike | None, translations: ArrayLike | None) -> tuple[Array, Array]:
        """Rotations (B, 9) and translations (B, 3) of all instances."""
        turns = self._per_instance("rotations", np.eye(3) if rotations is None else rotations, (3, 3))
        moves = self._per_instance("translations", np.zeros(3) if translations is None else translations, (3,))
        return turns.reshape(-1, 9), moves

    def _per_instance(self, name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
        """``values`` for every instance, (B, *shape), from that or from one for all."""
        if np.shape(values) == shape:
            values = np.broadcast_to(np.asarray(values, dtype=np.float64), (self.count, *shape))
        return checked_vectors(name, values, (self.count, *shape), OptionError)


def chunks(order: NDArray[np.int64]) -> int:
    """Number of chunks that the kernels take ``order`` in."""
    return -(-order.size // kernels.CHUNK)
