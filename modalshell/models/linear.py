"""LMA, linear modal analysis: small displacements in the modal basis [choi2007, eq. 6-8; theory 2, eq. 1]."""

from __future__ import annotations

from functools import cached_property, partial
from typing import final

import numpy as np

from modalshell.core.cost import count_read
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal.base import DeadForce
from modalshell.kernels.frame import add_lines
from modalshell.loads import Loading
from modalshell.models.base.modal import ModalModel
from modalshell.models.base.model import FrameModel
from modalshell.models.base.shape import contact_shape
from modalshell.models.reduction.load_quadrature import LoadQuadrature, ModalPush
from modalshell.statics.least_potential import Statics
from modalshell.statics.path import Followable


@final
class LinearModal(ModalModel):
    """LMA: ``u = Phi q`` with independent linear modes. Exact for small displacements, inflates at large ones.

    The static answer is ``q = Lambda^-1 Phi^T f``; with constraints, the modal forces of least work are added that meet
    them, or come nearest.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    integrator : str or ModalIntegrator
        "exponential" (second order, exact where the modal forces do not turn), "implicit_euler" (first order, loses
        energy; that of the paper), "implicit_midpoint" (second order, keeps the energy of linear motion), the key of
        any other :class:`modalshell.integrators.modal.ModalIntegrator`, or a rule itself.
    """

    name = "LMA"
    straight = True

    def warped(self, q: Array) -> Array:
        """Displacements ``Phi q`` (n, 3) [m]."""
        count_read(self.basis.modes.nbytes)
        return np.asarray(self.basis.modes @ q).reshape(-1, 3)

    def warped_positions(self, q: Array) -> Array:
        """Vertex positions (n, 3) [m] at q, in one pass."""
        count_read(self.basis.modes.nbytes)
        _, rest, lines = self.contact_tiles
        positions = np.empty_like(rest)
        add_lines(lines, q, rest.reshape(-1), positions.reshape(-1))
        return positions

    def farthest(self, q: Array) -> float:
        """See :meth:`ModalShape.farthest`."""
        return float(np.abs(q) @ self.reach)

    def warped_force(self, q: Array, load: Array) -> Array:
        """Modal force ``Phi^T f`` (m,)."""
        count_read(self.basis.modes.nbytes)
        return self.basis.modes.T @ load.ravel()

    def dead_force(self, load: Array) -> DeadForce:
        """:meth:`warped_force`, the same at every q."""
        force = self.warped_force(np.zeros(self.basis.count), load)
        return DeadForce(partial(_same, force), work=partial(_along, force), push=(np.empty(0), force))

    def warped_work(self, q: Array, load: Array) -> tuple[float, Array]:
        """Work ``f . Phi q`` [J] and its gradient (m,)."""
        force = self.warped_force(q, load)
        return float(force @ q), force

    def warped_curvature(self, q: Array, load: Array) -> Array:
        """Zero (m, m)."""
        return self.warped_jacobian(q, load)

    def followable(self, load: Array) -> Followable:
        """OptionError: its answer is linear."""
        return FrameModel.followable(self, load)

    def warped_jacobian(self, q: Array, load: Array) -> Array:
        """Zero (m, m): the force is the same at every q."""
        return np.zeros((q.size, q.size))

    def warped_gradient(self, q: Array, weights: Array) -> Array:
        """``Phi^T g`` (m,)."""
        return np.asarray(self.basis.modes.T @ weights.ravel())

    def warped_patch(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch at q, and its Jacobian (3, m)."""
        rows = self._patch_rows(self.basis.modes, vertices).mean(axis=0)
        return self.shell.rest_positions[vertices].mean(axis=0) + rows @ q, rows

    def warped_rows(self, q: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) of the modes at some vertices."""
        return self._patch_rows(self.basis.modes, vertices)

    @cached_property
    def contact_shape(self) -> tuple[Array, Array, Array]:
        """See :attr:`ModalShape.contact_shape`."""
        return contact_shape(self.basis, turns=False)

    @cached_property
    def contact_tiles(self) -> tuple[Array, Array, Array]:
        """See :attr:`ModalShape.contact_tiles`."""
        return np.empty((0, 0, 0)), self.shell.rest_positions.copy(), np.ascontiguousarray(self.basis.modes.T)

    def contact_rows(self, q: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) of the modes at some vertices."""
        return self.warped_rows(q, vertices)

    def load_quadrature(self, loading: Loading) -> LoadQuadrature | None:
        """The loads by points, and by the modes there."""
        return LoadQuadrature.of(self.basis, loading, lambda _: ModalPush.by_modes(self.basis))

    def _free_statics(self, load: Array, start: Array | None) -> Statics:
        rigid = self.basis.rigid_modes
        q = np.zeros(self.basis.count)
        q[rigid:] = self.modal_force(q, load)[rigid:] / self.basis.eigenvalues[rigid:]
        return Statics(q, 0.0, 1, stable=True)


def _same(force: Array, q: Array) -> Array:  # noqa: ARG001 (as other models' forces)
    return force.copy()


def _along(force: Array, q: Array) -> float:
    return float(force @ q)
