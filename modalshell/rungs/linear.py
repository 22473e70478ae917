"""LMA, linear modal analysis: small displacements in the modal basis [choi2007, eq. 6-8]."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.rungs.modal import RIGID_LOAD, ModalModel
from modalshell.rungs.model import Equilibrium, Stopwatch, total_load

Array = NDArray[np.float64]


class LinearModal(ModalModel):
    """LMA: ``u = Phi q`` with independent linear modes. Exact for small displacements, inflates at large ones."""

    name = "LMA"

    def displacement(self, q: Array) -> Array:
        """Displacements ``Phi q`` (n, 3) [m]."""
        return np.asarray(self.basis.modes @ q).reshape(-1, 3)

    def modal_force(self, q: Array, load: Array) -> Array:  # noqa: ARG002 (the same at every q)
        """Modal force ``Phi^T f`` (m,)."""
        return np.asarray(self.basis.modes.T @ load.ravel())

    def equilibrium(
        self,
        *,
        gravity: ArrayLike | None = None,
        force: ArrayLike | None = None,
        start: ArrayLike | None = None,  # noqa: ARG002 (a linear answer does not depend on it)
    ) -> Equilibrium:
        """``q = Lambda^-1 Phi^T f``; not converged if the load pushes a free shell, ``residual`` is then that share."""
        watch = Stopwatch()
        load = total_load(self.shell, gravity, force)
        rigid = self.basis.rigid_modes
        q = np.zeros(self.basis.count)
        q[rigid:] = self.modal_force(q, load)[rigid:] / self.basis.eigenvalues[rigid:]
        residual = self.rigid_load(load)
        held = residual <= RIGID_LOAD
        status = "converged" if held else "no equilibrium: the load pushes a shell that its supports leave free"
        positions = self.shell.rest_positions + self.displacement(q)
        return Equilibrium(positions, held, 1, residual, watch(), status, q)
