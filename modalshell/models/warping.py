"""MWTS, modal warping for thin shells [choi2007, eq. 9-17]: linear modes rotated by each vertex's own rotation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, final

import numpy as np

from modalshell.core.cost import count_products, count_read
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal import ModalIntegrator
from modalshell.integrators.modal.base import DeadForce, ForceChange
from modalshell.kernels import rotations
from modalshell.kernels.push import DERIVATIVES, POWERS, ROWS, load_rows, push_change, push_frame, work_frame
from modalshell.loads import Loading
from modalshell.loads.surface_kernels import TURNED
from modalshell.models.base.shape import contact_shape
from modalshell.models.base.unstretched import UnstretchedModel
from modalshell.models.reduction.load_points import LoadPoints
from modalshell.models.reduction.load_quadrature import LoadQuadrature, ModalPush
from modalshell.models.reduction.sampled_change import as_tile, samples_of
from modalshell.models.reduction.warp_frame import WarpFrame
from modalshell.models.reduction.warp_step_kernels import warp_step, work_step
from modalshell.modes import Basis
from modalshell.statics.least_potential import Statics, least_potential
from modalshell.statics.modal_balance import balance


@final
class ModalWarping(UnstretchedModel):
    """MWTS: ``u_i = Rt(w_i) (Phi q)_i`` with ``w = Psi q``, under the rotated load ``p = Phi^T R(w)^T f``.

    The displacement is the closed form of [choi2007, eq. 16] along a straight path from rest: it depends on q alone, so
    that nothing drifts.

    The paper's modal force ``Phi^T R^T f`` is the gradient of no potential: static equilibria need not exist. Statics
    solves ``Lambda q = Phi^T R(q)^T f`` by Newton along a growing load, from rest or from a start; ``residual`` is
    ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``, without a load over the start's ``|Lambda q|``. Three ways
    to fail are distinguished: no fixed point (the branch ends), wound up (a vertex turned by more than 2 pi) and
    unstable (a fixed point that even heavily damped motion leaves; lightly damped motion may cycle about others). With
    constraints, the least modal work that meets them.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    integrator : str or ModalIntegrator
        See :class:`modalshell.LinearModal`.
    consistent_force : bool
        Take ``J^T f``, J = du/dq of the closed form, for the modal force instead: the gradient of the load's work.
        Equilibria then are the minima of a potential, and always exist.
    """

    name = "MWTS"

    def __init__(
        self, basis: Basis, *, integrator: str | ModalIntegrator = "exponential", consistent_force: bool = False
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

    def warped(self, q: Array) -> Array:
        """Warped displacements (n, 3) [m] [choi2007, eq. 17; theory 2, eq. 6]."""
        count_read(self.basis.modes.nbytes)
        linear = np.asarray(self.basis.modes @ q).reshape(-1, 3)
        out = np.empty_like(linear)
        rotations.warp(self.rotation_vectors(q), linear, 1.0, out)
        return out

    def warped_positions(self, q: Array) -> Array:
        """Vertex positions (n, 3) [m] at q, in one fused pass."""
        count_read(self._frame.bytes_read)
        return self._frame.positions(q)

    def farthest(self, q: Array) -> float:
        """See :meth:`ModalShape.farthest`: averages of rotations lengthen nothing."""
        return float(np.abs(q) @ self.reach)

    @cached_property
    def _frame(self) -> WarpFrame:
        """At first use: it holds a second copy of the modal data."""
        return WarpFrame(self.basis)

    def warped_patch(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch at q, and its Jacobian (3, m), by the closed form of the warp."""
        moved, rows = self._moved_rows(q, vertices)
        return (self.shell.rest_positions[vertices] + moved).mean(axis=0), rows.mean(axis=0)

    @cached_property
    def contact_shape(self) -> tuple[Array, Array, Array]:
        """See :attr:`ModalShape.contact_shape`."""
        return contact_shape(self.basis, turns=True)

    @property
    def contact_tiles(self) -> tuple[Array, Array, Array]:
        """See :attr:`ModalShape.contact_tiles`."""
        return self._frame.modal_data, self._frame.rest_data, np.empty((0, 0))

    def contact_rows(self, q: Array, vertices: Index) -> Array:
        """Derivatives (k, 3, m) of some vertices' positions by the coordinates, by the closed form of the warp."""
        return self._moved_rows(q, vertices)[1]

    def _moved_rows(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Displacements (k, 3) [m] of some vertices, and their derivatives (k, 3, m)."""
        modes = self._patch_rows(self.basis.modes, vertices)
        turns = self._patch_rows(self.basis.rotations, vertices)
        w, linear = turns @ q, modes @ q
        averages, slopes = np.empty((2, len(vertices), 3, 3))
        rotations.averages(w, averages)
        rotations.warp_jacobian(w, linear, slopes)
        return np.einsum("vij,vj->vi", averages, linear), averages @ modes + slopes @ turns

    def warped_force(self, q: Array, load: Array) -> Array:
        """Modal force ``Phi^T R(q)^T f`` (m,), or ``J(q)^T f`` if it is to be consistent."""
        return self.warped_work(q, load)[1] if self.consistent_force else _force_of(self._pushed, self._rows(load), q)

    def dead_force(self, load: Array) -> DeadForce:
        """See :meth:`ModalShape.dead_force`; the paper's tells its change by a sample of vertices, of many."""
        if self.consistent_force:
            return _dead_work(self._pushed, self._rows(load))
        felt, sample = (self._pushed, self._rows(load)), self._sample
        change = None if sample is None else partial(_change_of, sample[1], load_rows(load[sample[0]]))
        return DeadForce(partial(_force_of, *felt), change, partial(_step, *felt, change), push=felt)

    @property
    def _pushed(self) -> Array:
        """Modal data of all vertices in one row."""
        return self._frame.modal_data.reshape(-1)

    @cached_property
    def _sample(self) -> tuple[Index, Array] | None:
        """Numbers (k,) of some vertices, and their modal data as of a frame, in one row; None of few.

        Their displacements are times as many vertices as each stands for.
        """
        count = len(self.shell.rest_positions)
        samples = samples_of(count)
        if not len(samples):
            return None
        vertices = samples[0]
        modes, turns = (self._patch_rows(part, vertices) for part in (self.basis.modes, self.basis.rotations))
        rows = np.concatenate([modes * (count / len(vertices)), turns], axis=1)
        return vertices, as_tile(rows.transpose(0, 2, 1)).reshape(-1)

    def warped_work(self, q: Array, load: Array) -> tuple[float, Array]:
        """Work ``f . u(q)`` [J] of the load (n, 3) and its gradient ``J^T f`` (m,), by the closed form."""
        return _work_of(self._pushed, self._rows(load), q)

    def _rows(self, load: Array) -> Array:
        """The load (n, 3) as kernels read it; OptionError where it is not of the vertices."""
        if load.shape != self.shell.rest_positions.shape:
            raise OptionError(f"load must be of shape {self.shell.rest_positions.shape} (got {load.shape})")
        return load_rows(load)

    def warped_gradient(self, q: Array, weights: Array) -> Array:
        """Derivatives (m,) at q of the displacements, contracted with weights (n, 3)."""
        return self.warped_work(q, weights)[1]

    def warped_curvature(self, q: Array, load: Array) -> Array:
        """Second derivatives (m, m) of the work."""
        w = self.rotation_vectors(q)
        linear = np.asarray(self.basis.modes @ q).reshape(-1, 3)
        mixed, curvature = np.empty((2, *load.shape, 3))
        rotations.warped_work_curvature(w, linear, load, mixed, curvature)
        by_modes = self.basis.modes.T @ self._turned(mixed)
        return by_modes + by_modes.T + self.basis.rotations.T @ self._turned(curvature)

    def warped_jacobian(self, q: Array, load: Array) -> Array:
        """Derivatives ``dp/dq`` (m, m) of the modal force; not symmetric unless the force is consistent."""
        if self.consistent_force:
            return self.warped_curvature(q, load)
        blocks = np.empty((*load.shape, 3))
        rotations.rotated_load_jacobian(self.rotation_vectors(q), load, blocks)
        return self.basis.modes.T @ self._turned(blocks)

    def _turned(self, blocks: Array) -> Array:
        """Derivatives by w (n, 3, 3) at every vertex as derivatives by q (3n, m)."""
        count_read(self.basis.rotations.nbytes + self.basis.modes.nbytes)
        count_products((3 + self.basis.count) * self.basis.modes.size)
        turns = self.basis.rotations.reshape(-1, 3, self.basis.count)
        return np.matmul(blocks, turns).reshape(self.basis.modes.shape)  # an einsum takes five times as long

    def largest_turn(self, q: Array) -> float:
        """Largest rotation of a vertex [rad] at q."""
        return float(rotations.largest_angle(self.rotation_vectors(q)))

    def load_quadrature(self, loading: Loading) -> LoadQuadrature | None:
        """The loads by points, and by turned modes there or by the gradient of the work."""
        way = _dead_work if self.consistent_force else _dead_push

        def of_sum(forces: Sequence[Array]) -> Callable[[Array], DeadForce]:
            rows = np.array([self._rows(force) for force in forces])
            return lambda factors: way(self._pushed, factors @ rows)

        def pushed(points: LoadPoints) -> ModalPush:
            by_work = self.consistent_force
            return ModalPush.by_work(points, of_sum) if by_work else ModalPush(TURNED, of_sum=of_sum)

        return LoadQuadrature.of(self.basis, loading, pushed)

    def _free_statics(self, load: Array, start: Array | None) -> Statics:
        if self.consistent_force:
            return least_potential(self, load, start)
        elastic = self._elastic

        def force(q: Array, share: float) -> Array:
            rotated, pushed = np.empty_like(load), np.zeros_like(q)
            rotations.rotate((self._rotations @ q[elastic]).reshape(-1, 3), share * load, -1.0, rotated)
            pushed[elastic] = self._modes.T @ rotated.ravel()
            return pushed

        def slope(q: Array, share: float) -> Array:
            return self.warped_jacobian(q, share * load)

        return balance(force, slope, self.basis.eigenvalues, self.basis.rigid_modes, self.largest_turn, start)


def _work_of(modal: Array, rows: Array, q: Array) -> tuple[float, Array]:
    """Work [J] of a load in rows, and its gradient (m,); OptionError as below."""
    q = _checked(modal, rows, q)
    count_read(modal.nbytes)
    count_products(DERIVATIVES * rows.size // 3)
    force = np.empty(q.size)
    return work_frame(modal, rows, POWERS, q, np.empty(2 * ROWS), force), force


def _gradient_of(modal: Array, rows: Array, q: Array) -> Array:
    """The same without the work."""
    return _work_of(modal, rows, q)[1]


def _checked(modal: Array, rows: Array, q: Array) -> Array:
    """Coordinates as they lie in a kernel's memory; OptionError where the sizes of these are not of the modes."""
    q = np.ascontiguousarray(q, dtype=np.float64)
    if q.ndim != 1 or 2 * rows.size * q.size != modal.size:
        raise OptionError(
            f"q must have the basis's {modal.size // (2 * rows.size)} coordinates (got the shape {q.shape})"
        )
    return q


def _force_of(modal: Array, rows: Array, q: Array) -> Array:
    """Modal force (m,) of a load in rows, at q; OptionError where the sizes of these are not of the modes."""
    q = _checked(modal, rows, q)
    count_read(modal.nbytes)
    force = np.empty(q.size)
    push_frame(modal, rows, POWERS, q, np.empty(ROWS), force)
    return force


def _change_of(modal: Array, rows: Array, q: Array, near: Array, known: Array) -> Array | None:
    """Change (m,) of a modal force from q, where it is ``known``, to ``near`` by a sample of vertices, or None."""
    count_read(2 * modal.nbytes)
    change, serves = push_change(modal, rows, POWERS, q, near, known)
    return change if serves else None


def _dead_work(modal: Array, rows: Array) -> DeadForce:
    """The gradient of the work of a load in rows."""
    step = partial(_step_by_work, modal, rows)
    return DeadForce(partial(_gradient_of, modal, rows), step=step, push=(modal, rows), by_work=True)


def _dead_push(modal: Array, rows: Array) -> DeadForce:
    """The modal force of a load in rows, without a sample of vertices."""
    return DeadForce(partial(_force_of, modal, rows), step=partial(_step, modal, rows, None))


def _step_by_work(modal: Array, rows: Array, *step: Any) -> None:
    """Take a step of the exponential rule under the gradient of the work of a load in rows; see :class:`DeadForce`."""
    times = 1 + work_step(modal, rows, POWERS, *step)
    count_read(times * modal.nbytes)
    count_products(times * DERIVATIVES * rows.size // 3)


def _step(modal: Array, rows: Array, change: ForceChange | None, *step: Any) -> None:
    """Take a step of the exponential rule under a load in rows; see :class:`DeadForce`."""
    count_read(modal.nbytes)
    if not warp_step(modal, rows, POWERS, change is not None, *step):
        return
    if change is None:
        count_read(modal.nbytes)
        return
    ends = step[-2]
    further = change(ends[5], ends[0], ends[4])
    ends[4] = _force_of(modal, rows, ends[0]) if further is None else ends[4] + further


def consistent_warping(basis: Basis, *, integrator: str = "exponential") -> ModalWarping:
    """MWTS under the consistent modal force ``J^T f``, a separate entry of the registry."""
    return ModalWarping(basis, integrator=integrator, consistent_force=True)
