"""MWTS, modal warping for thin shells [choi2007, eq. 9-17]: linear modes carried by the vertices' own rotations."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from modalshell.kernels import rotations
from modalshell.modes import Basis
from modalshell.rungs.frame import WarpFrame
from modalshell.rungs.modal import RIGID_LOAD, ModalModel
from modalshell.rungs.model import Equilibrium, MotionState, Stopwatch, total_load

Array = NDArray[np.float64]

WOUND_UP = 2.0 * np.pi
"""Rotation of a vertex [rad] from which a state has left the branch that grows from rest."""

_TOLERANCE = 1e-9
_SMALLEST_LOAD_STEP = 1.0 / 1024.0
_NEWTON_LIMIT = 12
_LOAD_TURN = 0.5
"""Turn of a vertex [rad] that one load step may predict."""


class ModalWarping(ModalModel):
    """MWTS: ``u_i = Rt(w_i) (Phi q)_i`` with ``w = Psi q``, under the rotated load ``p = Phi^T R(w)^T f``.

    The closed form of the warp is used, so a state depends on q alone and nothing drifts. ``Phi^T R^T f`` is the
    gradient of no potential: static equilibria need not exist, and :meth:`equilibrium` says so where it finds none.
    """

    name = "MWTS"

    def __init__(self, basis: Basis) -> None:
        super().__init__(basis)
        rigid = basis.rigid_modes
        self._elastic = slice(rigid, None)
        self._modes = np.ascontiguousarray(basis.modes[:, rigid:])
        self._rotations = np.ascontiguousarray(basis.rotations[:, rigid:])
        self._frame: WarpFrame | None = None

    def rotation_vectors(self, q: Array) -> Array:
        """Rotation vectors of the vertices (n, 3) [rad]."""
        return np.asarray(self.basis.rotations @ q).reshape(-1, 3)

    def displacement(self, q: Array) -> Array:
        """Warped displacements (n, 3) [m] [choi2007, eq. 17]."""
        linear = np.asarray(self.basis.modes @ q).reshape(-1, 3)
        out = np.empty_like(linear)
        rotations.warp(self.rotation_vectors(q), linear, 1.0, out)
        return out

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state, in one fused pass."""
        if self._frame is None:  # at first use: it holds a second copy of the modal data
            self._frame = WarpFrame(self.basis)
        return self._frame.positions(state.coordinates)

    def modal_force(self, q: Array, load: Array) -> Array:
        """Modal force ``Phi^T R(q)^T f`` (m,)."""
        rotated = np.empty_like(load)
        rotations.rotate(self.rotation_vectors(q), load, -1.0, rotated)
        return np.asarray(self.basis.modes.T @ rotated.ravel())

    def equilibrium(
        self, *, gravity: ArrayLike | None = None, force: ArrayLike | None = None, start: ArrayLike | None = None
    ) -> Equilibrium:
        """Solve ``Lambda q = Phi^T R(q)^T f`` by Newton along a growing load, from rest or from ``start``.

        ``residual`` is ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``. Three ways to fail are told apart:
        "no fixed point" (the branch ends), "wound up" (a vertex turned by more than 2 pi) and "unstable" (a fixed
        point that the damped motion leaves).
        """
        watch = Stopwatch()
        load = total_load(self.shell, gravity, force)
        root = np.sqrt(self.basis.eigenvalues[self._elastic])
        scale = float(np.linalg.norm((self._modes.T @ load.ravel()) / root)) or 1.0
        # Unknowns y = sqrt(lambda) q: their squared length is twice the elastic energy.
        y: Array = np.zeros(root.size)
        if start is not None:
            y = root * self.coordinates_of(start)[self._elastic]
            y, residual, iterations, solved = self._newton(y, load, 1.0, root, scale)
        else:
            y, residual, iterations, solved = self._follow(load, root, scale)
        q = np.zeros(self.basis.count)
        q[self._elastic] = y / root
        if (rigid := self.rigid_load(load)) > RIGID_LOAD:
            solved, residual = False, rigid
            status = "no equilibrium: the load pushes a shell that its supports leave free"
        elif not solved:
            status = "no fixed point: the branch from rest ends before this load"
        elif rotations.largest_angle(self.rotation_vectors(q)) > WOUND_UP:
            solved, status = False, "wound up: a vertex has turned by more than 2 pi"
        elif not self._stable(y, load, root):
            solved, status = False, "unstable: a fixed point that damped motion leaves"
        else:
            status = "converged"
        positions = self.shell.rest_positions + self.displacement(q)
        return Equilibrium(positions, solved, iterations, residual, watch(), status, q)

    def _balance(self, y: Array, load: Array, root: Array) -> Array:
        """Out-of-balance ``y - p / sqrt(lambda)``."""
        rotated = np.empty_like(load)
        rotations.rotate((self._rotations @ (y / root)).reshape(-1, 3), load, -1.0, rotated)
        return np.asarray(y - (self._modes.T @ rotated.ravel()) / root)

    def _jacobian(self, y: Array, load: Array, root: Array) -> Array:
        """Jacobian of :meth:`_balance` (elastic modes, elastic modes); not symmetric."""
        blocks = np.empty((load.shape[0], 3, 3))
        rotations.rotated_load_jacobian((self._rotations @ (y / root)).reshape(-1, 3), load, blocks)
        turned = np.einsum("nij,njm->nim", blocks, self._rotations.reshape(-1, 3, root.size))
        coupling = self._modes.T @ turned.reshape(self._modes.shape)
        return np.asarray(np.eye(root.size) - coupling / root[:, None] / root)

    def _stable(self, y: Array, load: Array, root: Array) -> bool:
        """Whether heavily damped motion returns to y: all eigenvalues of the Jacobian have positive real part."""
        return bool(scipy.linalg.eigvals(self._jacobian(y, load, root)).real.min() > 0.0)

    def _newton(
        self, y: Array, load: Array, factor: float, root: Array, scale: float
    ) -> tuple[Array, float, int, bool]:
        """Newton at one load factor; gives up when the residual grows twice in a row."""
        scaled = factor * load
        residual = np.inf
        growths = 0
        for iteration in range(_NEWTON_LIMIT + 1):
            balance = self._balance(y, scaled, root)
            previous, residual = residual, float(np.linalg.norm(balance)) / scale
            if residual <= _TOLERANCE:
                return y, residual, iteration, True
            growths = growths + 1 if residual >= previous else 0
            if iteration == _NEWTON_LIMIT or growths == 2:
                break
            jacobian = self._jacobian(y, scaled, root)
            if np.linalg.cond(jacobian) > 1e12:
                break
            y = y - np.linalg.solve(jacobian, balance)
        return y, residual, iteration, False

    def _turn(self, y: Array, root: Array) -> float:
        """Largest turn of a vertex [rad] at y."""
        return float(rotations.largest_angle((self._rotations @ (y / root)).reshape(-1, 3)))

    def _follow(self, load: Array, root: Array, scale: float) -> tuple[Array, float, int, bool]:
        """Follow the branch from rest with load steps that halve where Newton fails and double where it does not.

        A step is also refused if it moves farther than twice what the tangent at its beginning says, or turns a vertex
        far: Newton would jump to another branch.
        """
        y = np.zeros(root.size)
        factor, step, iterations = 0.0, 0.25, 0
        while factor < 1.0:
            step = min(step, 1.0 - factor)
            # dy/dfactor = J^-1 p / sqrt(lambda), and p / sqrt(lambda) = y / factor on the branch.
            tangent = y / factor if factor > 0 else -self._balance(y, load, root)
            tangent = np.asarray(np.linalg.solve(self._jacobian(y, factor * load, root), tangent))
            step = min(step, _LOAD_TURN / max(self._turn(tangent, root), 1e-300))
            trial, _, used, solved = self._newton(y + step * tangent, load, factor + step, root, scale)
            iterations += used
            reach = step * float(np.linalg.norm(tangent))
            near = np.linalg.norm(trial - y - step * tangent) <= reach
            if solved and near and self._turn(trial - y, root) <= 2.0 * _LOAD_TURN:
                y, factor, step = np.asarray(trial), factor + step, 2.0 * step
                continue
            step *= 0.5
            if step < _SMALLEST_LOAD_STEP:
                residual = float(np.linalg.norm(self._balance(y, load, root))) / scale
                return y, residual, iterations, False
        residual = float(np.linalg.norm(self._balance(y, load, root))) / scale
        return y, residual, iterations, True
