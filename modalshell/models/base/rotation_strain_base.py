"""Base of rotation-strain models: potential of a load, its derivatives, and statics [huang2011].

See theory 9, eq. 5 to 8.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np

from modalshell.core.cost import count_read
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal import ModalIntegrator
from modalshell.integrators.modal.base import DeadForce
from modalshell.kernels.frame import TILE
from modalshell.kernels.push import change_by_sample
from modalshell.loads import Loading
from modalshell.models.base.unstretched import UnstretchedModel
from modalshell.models.reduction import rotation_strain_kernels as kernel
from modalshell.models.reduction.load_points import LoadPoints
from modalshell.models.reduction.load_quadrature import LoadQuadrature, ModalPush
from modalshell.models.reduction.sampled_change import LEAST, as_tile, samples_of
from modalshell.modes import Basis

_PATCHES_KEPT = 16
"""Patches of constraints whose modal data are kept between steps."""
_DRAWS, _SHAPES = 32, 4
"""Samples of triangles that one is chosen of, and shapes that it is chosen by."""


@final
@dataclass(frozen=True)
class LoadAdjoint:
    """What the potential of one load needs, whatever q is."""

    load: Array
    """The load [N]; shape (n, 3)."""
    gradients: Array
    """Derivatives of the work in the columns of F_t of every triangle, in its own frame; shape (tiles, 6 * 128)."""
    constant: Array
    """Part of the modal force that is the same at every q; shape (m,)."""


class TurnedTriangles(UnstretchedModel):
    """A modal model whose displacements are linear in q and in ``F_t = exp([w_t(q)]) (I + S_t(q))`` of triangles.

    So is the work of a load, ``f . u(q)``: its adjoint is found once a load, and its derivatives are sums over
    triangles. Statics minimises ``q . Lambda q / 2 - f . u(q)`` in the elastic modes, rigid ones staying at zero;
    ``residual`` is ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``, without a load over the start's
    ``|Lambda q|``. With constraints, the least modal work that meets them. ``modal`` (tiles, m, 6 * 128) are turn and
    strain of the triangles in every mode.
    """

    def __init__(self, basis: Basis, modal: Array, integrator: str | ModalIntegrator) -> None:
        super().__init__(basis, integrator=integrator)
        self._modal = modal
        self._faced: LoadAdjoint | None = None
        self._sample: tuple[LoadAdjoint, tuple[Array, Array] | None] | None = None
        self._patches: dict[bytes, list[LoadAdjoint]] = {}

    @abstractmethod
    def _adjoint(self, load: Array) -> LoadAdjoint:
        """Adjoint of a load (n, 3)."""

    @abstractmethod
    def _modal_push(self, points: LoadPoints) -> ModalPush:
        """How forces at points push on the modes."""

    def load_quadrature(self, loading: Loading) -> LoadQuadrature | None:
        """The loads by points, by the gradient of the work on these."""
        return LoadQuadrature.of(self.basis, loading, self._modal_push)

    def _kept_force(self, force: Array) -> Callable[[Array], Array]:
        """Modal forces (m,) at q (m,) of a force (n, 3) [N] whose adjoint is kept."""
        return partial(self._force_of, self._adjoint(force))

    def dead_force(self, load: Array) -> DeadForce:
        """See :meth:`ModalShape.dead_force`; it tells its change by a sample of the triangles, of many."""
        adjoint = self._face(load)
        change = partial(self._change_of, adjoint) if len(self._modal) * TILE >= LEAST else None
        return DeadForce(partial(self._force_of, adjoint), change, stay=self._stay_under(adjoint))

    def _stay_under(self, adjoint: LoadAdjoint) -> Callable[..., Any] | None:
        """:attr:`DeadForce.stay` of a load; None without one."""
        return None

    def warped_work(self, q: Array, load: Array) -> tuple[float, Array]:
        """Work ``f . u(q)`` [J] of the load (n, 3) and its gradient (m,), the modal force."""
        return self._work_of(self._face(load), q)

    def _change_of(self, adjoint: LoadAdjoint, q: Array, near: Array, known: Array) -> Array | None:
        """Change (m,) of a modal force from q, where it is ``known``, to ``near`` by a sample of triangles; or None."""
        sample = self._sample_of(adjoint)  # chosen where it is asked for first: that takes as long as some frames
        if sample is None:
            return None
        modal, gradients = sample
        count_read(2 * modal.nbytes)
        work, sampled, change = np.empty(kernel.WORK), adjoint.constant.copy(), adjoint.constant.copy()
        kernel.potential(modal, gradients, q, work, sampled)
        kernel.potential(modal, gradients, near, work, change)
        return change if change_by_sample(known, sampled, change) else None

    def _sample_of(self, adjoint: LoadAdjoint) -> tuple[Array, Array] | None:
        """Modal data of some triangles and a load's derivatives there, times what each stands for; None of few; kept.

        Of several samples, that by which shapes turned by a radian feel the load most as by all triangles.
        """
        known = self._sample
        if known is None or known[0] is not adjoint:
            known = self._sample = adjoint, self._best_sample(adjoint)
        return known[1]

    def _best_sample(self, adjoint: LoadAdjoint) -> tuple[Array, Array] | None:
        count, values = len(self._modal) * TILE, self.basis.eigenvalues
        samples, elastic = samples_of(count, _DRAWS), values[self.basis.rigid_modes :]
        if not (len(samples) and elastic.size):
            return None
        ways = np.random.default_rng(0).standard_normal((_SHAPES, values.size))
        ways /= np.sqrt(np.maximum(values, elastic[0]))  # a turn about a hinge has no larger part than the lowest mode
        shapes = [q / max(self.largest_turn(q), 1e-300) for q in ways]
        whole = np.array([self._work_of(adjoint, q)[1] for q in shapes])
        tiles, rows = (part.reshape(-1, *part.shape[1:-1], 6, TILE) for part in (self._modal, adjoint.gradients))
        best, least = None, np.inf
        for triangles in samples:
            at = triangles // TILE, triangles % TILE
            modal, gradients = as_tile(tiles[at[0], :, :, at[1]]), as_tile(rows[at[0], :, at[1]]) * (count / TILE)
            found = np.tile(adjoint.constant, (_SHAPES, 1))
            for q, force in zip(shapes, found, strict=True):
                kernel.potential(modal, gradients, q, np.empty(kernel.WORK), force)
            off = float(np.max(np.sum((found - whole) ** 2, axis=1) / np.maximum(np.sum(whole**2, axis=1), 1e-300)))
            if off < least:
                best, least = (modal, gradients), off
        return best

    def warped_gradient(self, q: Array, weights: Array) -> Array:
        """Derivatives (m,) at q of the displacements, contracted with weights (n, 3)."""
        return self.warped_work(q, weights)[1]

    def warped_curvature(self, q: Array, load: Array) -> Array:
        """Second derivatives (m, m) of the work ``f . u(q)``."""
        gradients = self._face(load).gradients
        hessian = np.zeros((q.size, q.size))
        kernel.add_curvature(self._modal, gradients, q, np.empty(kernel.WORK), np.empty((15, TILE)), hessian)
        return hessian

    def warped_jacobian(self, q: Array, load: Array) -> Array:
        """Derivatives ``dp/dq`` (m, m) of the modal force: those of the work once more."""
        return self.warped_curvature(q, load)

    def warped_patch(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch at q, and its Jacobian (3, m), exactly."""
        key = vertices.tobytes()
        adjoints = self._patches.get(key)
        if adjoints is None:
            if len(self._patches) == _PATCHES_KEPT:
                self._patches.clear()
            load = np.zeros((3, *self.shell.rest_positions.shape))
            load[np.arange(3)[:, None], vertices, np.arange(3)[:, None]] = 1.0 / len(vertices)
            adjoints = self._patches[key] = [self._adjoint(push) for push in load]
        moved, jacobian = zip(*(self._work_of(adjoint, q) for adjoint in adjoints), strict=True)
        return self.shell.rest_positions[vertices].mean(axis=0) + np.array(moved), np.array(jacobian)

    def _work_of(self, adjoint: LoadAdjoint, q: Array) -> tuple[float, Array]:
        count_read(self._modal.nbytes + adjoint.gradients.nbytes)
        force = adjoint.constant.copy()
        work = kernel.potential(self._modal, adjoint.gradients, q, np.empty(kernel.WORK), force)
        return float(work + adjoint.constant @ q), force

    def _force_of(self, adjoint: LoadAdjoint, q: Array) -> Array:
        return self._work_of(adjoint, q)[1]

    def _face(self, load: Array) -> LoadAdjoint:
        adjoint = self._faced  # read once: another thread may face another load meanwhile
        if adjoint is None or not (load == adjoint.load).all():
            adjoint = self._faced = self._adjoint(load)
        return adjoint

    def largest_turn(self, q: Array) -> float:
        """Largest rotation angle of a triangle [rad] at q."""
        return float(kernel.largest_turn(self._modal, q, np.empty(kernel.WORK)))
