"""MWTS, modal warping for thin shells [choi2007, eq. 9-17]: linear modes rotated by each vertex's own rotation."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np
import scipy.linalg

from modalshell.integrators.modal import ModalIntegrator
from modalshell.integrators.state import MotionState
from modalshell.kernels import rotations
from modalshell.kernels.frame import WORK, push_frame
from modalshell.loads import Loading
from modalshell.models.modal import ModalModel
from modalshell.modes import Basis
from modalshell.outcome import Outcome
from modalshell.reduction.load_quadrature import LoadQuadrature, ModalPush
from modalshell.reduction.warp_frame import WarpFrame
from modalshell.statics.least_potential import WOUND_UP, Statics, least_potential
from modalshell.typing import Array, Index
from modalshell.work import count_products, count_read

_TOLERANCE = 1e-9
"""Relative residual at which an equilibrium has converged."""
_SMALLEST_LOAD_STEP = 1.0 / 1024.0
"""Smallest load step, relative to the load."""
_NEWTON_LIMIT = 12
"""Newton iterations at one load at most."""
_DERIVATIVES = 600
"""Operations of a vertex's warp with the derivatives of its work."""
_LOAD_TURN = 0.5
"""Largest predicted rotation of a vertex [rad] per load step."""


@final
class ModalWarping(ModalModel):
    """MWTS: ``u_i = Rt(w_i) (Phi q)_i`` with ``w = Psi q``, under the rotated load ``p = Phi^T R(w)^T f``.

    The displacement is the closed form of [choi2007, eq. 16] along a straight path from rest: it depends on q alone, so
    that nothing drifts.

    The paper's modal force ``Phi^T R^T f`` is the gradient of no potential: static equilibria need not exist. Statics
    solves ``Lambda q = Phi^T R(q)^T f`` by Newton along a growing load, from rest or from a start; ``residual`` is
    ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``. Three ways to fail are distinguished: no fixed point (the
    branch ends), wound up (a vertex turned by more than 2 pi) and unstable (a fixed point that even heavily damped
    motion leaves; lightly damped motion may cycle about others). With constraints, the least modal work that meets
    them.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    integrator : str or ModalIntegrator
        See :class:`ModalModel`.
    consistent_force : bool
        Take ``J^T f``, J = du/dq of the closed form, for the modal force instead: the gradient of the load's work.
        Equilibria then are the minima of a potential, and always exist.
    """

    name = "MWTS"

    def __init__(
        self, basis: Basis, *, integrator: str | ModalIntegrator = "implicit_euler", consistent_force: bool = False
    ) -> None:
        super().__init__(basis, integrator=integrator)
        self.consistent_force = self.conservative = consistent_force
        rigid = basis.rigid_modes
        self._elastic = slice(rigid, None)
        self._modes = np.ascontiguousarray(basis.modes[:, rigid:])
        self._rotations = np.ascontiguousarray(basis.rotations[:, rigid:])

    def rotation_vectors(self, q: Array) -> Array:
        """Rotation vectors of the vertices (n, 3) [rad]."""
        count_read(self.basis.rotations.nbytes)
        return np.asarray(self.basis.rotations @ q).reshape(-1, 3)

    def raw_displacement(self, q: Array) -> Array:
        """Warped displacements (n, 3) [m] [choi2007, eq. 17]."""
        count_read(self.basis.modes.nbytes)
        linear = np.asarray(self.basis.modes @ q).reshape(-1, 3)
        out = np.empty_like(linear)
        rotations.warp(self.rotation_vectors(q), linear, 1.0, out)
        return out

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state, in one fused pass."""
        count_read(self._frame.bytes_read)
        return self._frame.positions(state.coordinates)

    @cached_property
    def _frame(self) -> WarpFrame:
        """At first use: it holds a second copy of the modal data."""
        return WarpFrame(self.basis)

    def patch_position(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch at q, and its Jacobian (3, m), by the closed form of the warp."""
        modes = self._patch_rows(self.basis.modes, vertices)
        turns = self._patch_rows(self.basis.rotations, vertices)
        w, linear = turns @ q, modes @ q
        averages, slopes = np.empty((2, len(vertices), 3, 3))
        rotations.averages(w, averages)
        rotations.warp_jacobian(w, linear, slopes)
        value = self.shell.rest_positions[vertices] + np.einsum("vij,vj->vi", averages, linear)
        return value.mean(axis=0), (averages @ modes + slopes @ turns).mean(axis=0)

    def modal_force(self, q: Array, load: Array) -> Array:
        """Modal force ``Phi^T R(q)^T f`` (m,), or ``J(q)^T f`` if it is to be consistent."""
        if self.consistent_force:
            return self.work(q, load)[1]
        count_read(self._frame.bytes_read)
        force = np.empty_like(q)
        push_frame(self._frame.modal_data, load, q, np.empty(WORK), force)
        return force

    def work(self, q: Array, load: Array) -> tuple[float, Array]:
        """Work ``f . u(q)`` [J] of the load (n, 3) and its gradient ``J^T f`` (m,), by the closed form."""
        count_read(2 * self.basis.modes.nbytes + self.basis.rotations.nbytes)
        count_products(_DERIVATIVES * len(load))
        w = self.rotation_vectors(q)
        linear = np.asarray(self.basis.modes @ q).reshape(-1, 3)
        averaged, slope = np.empty_like(load), np.empty_like(load)
        work = rotations.warped_work(w, linear, load, averaged, slope)
        return work, np.asarray(self.basis.modes.T @ averaged.ravel() + self.basis.rotations.T @ slope.ravel())

    def on_basis(self, basis: Basis) -> ModalWarping:
        """The same model on another basis of its shell."""
        return ModalWarping(basis, consistent_force=self.consistent_force)

    def displacement_gradient(self, q: Array, weights: Array) -> Array:
        """Derivatives (m,) at q of the displacements, contracted with weights (n, 3)."""
        return self.work(q, weights)[1]

    def work_curvature(self, q: Array, load: Array) -> Array:
        """Second derivatives (m, m) of the work."""
        w = self.rotation_vectors(q)
        linear = np.asarray(self.basis.modes @ q).reshape(-1, 3)
        mixed, curvature = np.empty((2, *load.shape, 3))
        rotations.warped_work_curvature(w, linear, load, mixed, curvature)
        by_modes = self.basis.modes.T @ self._turned(mixed)
        return by_modes + by_modes.T + self.basis.rotations.T @ self._turned(curvature)

    def modal_force_jacobian(self, q: Array, load: Array) -> Array:
        """Derivatives ``dp/dq`` (m, m) of the modal force; not symmetric unless the force is consistent."""
        if self.consistent_force:
            return self.work_curvature(q, load)
        blocks = np.empty((*load.shape, 3))
        rotations.rotated_load_jacobian(self.rotation_vectors(q), load, blocks)
        return self.basis.modes.T @ self._turned(blocks)

    def _turned(self, blocks: Array) -> Array:
        """Derivatives by w (n, 3, 3) at every vertex as derivatives by q (3n, m)."""
        count_read(self.basis.rotations.nbytes + self.basis.modes.nbytes)
        count_products((3 + self.basis.count) * self.basis.modes.size)
        turns = self.basis.rotations.reshape(-1, 3, self.basis.count)
        return np.asarray(np.einsum("nij,njm->nim", blocks, turns)).reshape(self.basis.modes.shape)

    def largest_turn(self, q: Array) -> float:
        """Largest rotation of a vertex [rad] at q."""
        return float(rotations.largest_angle(self.rotation_vectors(q)))

    def load_quadrature(self, loading: Loading) -> LoadQuadrature | None:
        """The loads by points, and by turned modes there or by the gradient of the work."""
        by_work = self.consistent_force
        return LoadQuadrature.of(
            self.basis, loading, lambda points: ModalPush.by_work(points) if by_work else ModalPush.by_turned_modes()
        )

    def _free_statics(self, load: Array, start: Array | None) -> Statics:
        if self.consistent_force:
            return least_potential(self, load, start)
        if self.basis.count == self.basis.rigid_modes:
            return Statics(np.zeros(self.basis.count), 0.0, 0, stable=True)
        root = np.sqrt(self.basis.eigenvalues[self._elastic])
        scale = float(np.linalg.norm((self._modes.T @ load.ravel()) / root)) or 1.0
        # Unknowns y = sqrt(lambda) q: their squared length is twice the elastic energy.
        if start is not None:
            y, residual, iterations, solved = self._newton(root * start[self._elastic], load, 1.0, root, scale)
        else:
            y, residual, iterations, solved = self._follow(load, root, scale)
        q = np.zeros(self.basis.count)
        q[self._elastic] = y / root
        if not solved:
            message = "the branch from rest ends before this load"
            return Statics(q, residual, iterations, Outcome.NO_FIXED_POINT, message)
        stable = self._stable(y, load, root)
        if self.largest_turn(q) > WOUND_UP:
            message = "a vertex has turned by more than 2 pi"
            return Statics(q, residual, iterations, Outcome.WOUND_UP, message, stable)
        if not stable:
            message = "a fixed point that even heavily damped motion leaves"
            return Statics(q, residual, iterations, Outcome.UNSTABLE, message, stable)
        return Statics(q, residual, iterations, stable=True)

    def _balance(self, y: Array, load: Array, root: Array) -> Array:
        """Out-of-balance ``y - p / sqrt(lambda)``."""
        rotated = np.empty_like(load)
        rotations.rotate((self._rotations @ (y / root)).reshape(-1, 3), load, -1.0, rotated)
        return y - (self._modes.T @ rotated.ravel()) / root

    def _jacobian(self, y: Array, load: Array, root: Array) -> Array:
        """Jacobian of :meth:`_balance` (elastic modes, elastic modes); not symmetric."""
        q = np.zeros(self.basis.count)
        q[self._elastic] = y / root
        slope = self.modal_force_jacobian(q, load)[self._elastic, self._elastic]
        return np.eye(root.size) - slope / root[:, None] / root

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
        """Largest rotation of a vertex [rad] at y."""
        return float(rotations.largest_angle((self._rotations @ (y / root)).reshape(-1, 3)))

    def _follow(self, load: Array, root: Array, scale: float) -> tuple[Array, float, int, bool]:
        """Follow the branch from rest with load steps that halve where Newton fails and double where it does not.

        A step is also refused if it moves farther than twice what the tangent at its beginning says, or turns a vertex
        far: Newton would jump to another branch. The Jacobian is not symmetric, so that neither mixed Newton's minimum
        nor its symmetric factors serve here.
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
                break
        residual = float(np.linalg.norm(self._balance(y, load, root))) / scale
        return y, residual, iterations, factor >= 1.0


def consistent_warping(basis: Basis, *, integrator: str = "implicit_euler") -> ModalWarping:
    """MWTS under the consistent modal force ``J^T f``, a separate entry of the registry."""
    return ModalWarping(basis, integrator=integrator, consistent_force=True)
