"""Many instances of one shell: modal coordinates stepped at once, positions at a level of detail for each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.checks import checked_count, checked_kind, checked_number, checked_vectors, shown
from modalshell.errors import OptionError
from modalshell.kernels import crowd as kernels
from modalshell.kernels.frame import TILE, WORK
from modalshell.modes import Basis
from modalshell.rungs.frame import WarpFrame

Array = NDArray[np.float64]

LEVELS = ("rigid", "LMA", "MWTS")
"""Levels of detail, by the number that stands for each in :attr:`Crowd.levels`."""


class Crowd:
    """B instances of one shell by modal warping, each in a frame of its own that moves [choi2007].

    All instances share the modal data and differ in their coordinates, loads and places. An instance is the same, to
    rounding, in any batch. Its level of detail sets both its positions and its modal force:

    - MWTS: ``rest + Rt(w) Phi q``, driven by ``Phi^T R(w)^T f``: as :class:`modalshell.ModalWarping`.
    - LMA: ``rest + Phi q``, driven by ``Phi^T f``: as :class:`modalshell.LinearModal`.
    - rigid: the rest shape; its coordinates go on as those of LMA, so that it is up to date when it comes near.

    Coordinates are continuous across a switch, positions jump. From MWTS to LMA a vertex jumps by ``|Rt(w) u - u|``, at
    most ``|w| |u| / 2`` with u its linear displacement, and from LMA to rigid by ``|u|``: :meth:`switch_errors`
    measures both, and :meth:`switch_distances` says from where on they are too small to be seen.

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

    Attributes
    ----------
    coordinates, rates : ndarray, shape (B, m)
        Modal coordinates and their rates; zero at the start.
    levels : ndarray of int8, shape (B,)
        Index into :data:`LEVELS`; MWTS at the start.

    Raises
    ------
    OptionError
        If ``count``, ``damping`` or ``dtype`` is none of these.
    """

    def __init__(
        self,
        basis: Basis,
        count: int,
        *,
        damping: tuple[float, float] = (0.0, 0.0),
        dtype: DTypeLike = np.float64,
    ) -> None:
        self.basis = checked_kind("basis", basis, Basis)
        self.count = checked_count("count", count)
        mass_factor, stiffness_factor = checked_vectors("damping", damping, (2,), OptionError)
        if min(mass_factor, stiffness_factor) < 0.0:
            raise OptionError(f"damping must be two factors at least 0 (got {shown(damping)})")
        self._damping = mass_factor + stiffness_factor * basis.eigenvalues
        frame = WarpFrame(basis, dtype=dtype)
        self.dtype, self.vertices = frame.dtype, frame.vertices
        self._modal = frame.modal_data
        double = self.dtype == np.float64
        self._force_modal = self._modal if double else WarpFrame(basis).modal_data
        tiles = len(self._modal)
        padded = np.zeros((tiles * TILE, 4))
        padded[: self.vertices, :3] = basis.shell.rest_positions
        padded[: self.vertices, 3] = basis.shell.mass
        by_row = padded.reshape(tiles, TILE, 4).transpose(0, 2, 1)
        self._rest = np.ascontiguousarray(by_row[:, :3].reshape(tiles, 3 * TILE), dtype=self.dtype)
        self._mass = np.ascontiguousarray(by_row[:, 3])
        self._work = np.zeros(WORK, self.dtype)
        self._force_work = self._work if double else np.zeros(WORK)
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
        force = np.empty_like(self.coordinates)
        kernels.crowd_forces(
            self._force_modal, self._mass, self.coordinates, self.levels, felt, self._force_work, force
        )
        if forcing is not None:
            force += checked_vectors("forcing", forcing, force.shape, OptionError)
        stiffness = self.basis.eigenvalues
        inertia = 1.0 + dt * self._damping + dt**2 * stiffness
        self.rates = (self.rates + dt * (force - stiffness * self.coordinates)) / inertia
        self.coordinates = self.coordinates + dt * self.rates

    def positions(
        self,
        rotations: ArrayLike | None = None,
        translations: ArrayLike = (0.0, 0.0, 0.0),
        out: NDArray[Any] | None = None,
    ) -> NDArray[Any]:
        """Vertex positions (B, n, 3) [m] in the world, each instance at its level of detail.

        Parameters
        ----------
        rotations : array_like, shape (3, 3) or (B, 3, 3), optional
            From the instance's frame to the world's; none without it.
        translations : array_like, shape (3,) or (B, 3)
            Of the frame's origin [m].
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
        turns = self._per_instance("rotations", np.eye(3) if rotations is None else rotations, (3, 3))
        moves = self._per_instance("translations", translations, (3,))
        q, turns, moves = (a.astype(self.dtype, copy=False) for a in (self.coordinates, turns, moves))
        kernels.crowd_positions(self._modal, self._rest, q, self.levels, turns, moves, self._work, out)
        return out

    def set_levels(self, distances: ArrayLike, linear_beyond: float, rigid_beyond: float) -> None:
        """Level of every instance by its distance (B,) [m] from the viewer: MWTS near, LMA, and rigid far off."""
        near = checked_vectors("distances", distances, (self.count,), OptionError)
        linear_beyond = checked_number("linear_beyond", linear_beyond, at_least=0.0, unit="m")
        rigid_beyond = checked_number("rigid_beyond", rigid_beyond, at_least=0.0, unit="m")
        if linear_beyond > rigid_beyond:
            raise OptionError(f"switches must be at 0 <= linear <= rigid (got {linear_beyond:g}, {rigid_beyond:g})")
        levels = np.where(near < rigid_beyond, kernels.LINEAR, kernels.RIGID)
        self.levels = np.where(near < linear_beyond, kernels.WARPED, levels).astype(np.int8)

    def switch_errors(self) -> Array:
        """How far a vertex would jump [m] at the present coordinates, largest over each instance, (B, 2).

        First between LMA and rigid, then between MWTS and LMA.
        """
        errors = np.empty((self.count, 2))
        kernels.switch_errors(self._force_modal, self.coordinates, self.vertices, self._force_work, errors)
        return errors

    def switch_distances(self, angle: float) -> tuple[float, float]:
        """Distances [m] beyond which every instance may be LMA, and may be rigid, for :meth:`set_levels`.

        From there on no vertex of the crowd, as it is now, jumps by more than ``angle`` [rad] in view: a pixel is the
        angle of one over the focal length in pixels. An instance seen rigid has both errors against MWTS, hence the
        second distance is of their sum.
        """
        angle = checked_number("angle", angle, above=0.0, unit="rad")
        errors = self.switch_errors()
        return float(errors[:, 1].max() / angle), float(errors.sum(axis=1).max() / angle)

    def _per_instance(self, name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
        """``values`` for every instance, (B, *shape), from that or from one for all."""
        if np.shape(values) == shape:
            values = np.broadcast_to(np.asarray(values, dtype=np.float64), (self.count, *shape))
        return checked_vectors(name, values, (self.count, *shape), OptionError)
