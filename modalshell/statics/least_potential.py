"""Statics of modal models whose load has a potential, by minimisation; always solvable."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.modes import Basis
from modalshell.statics.trust_region import minimise

WOUND_UP = 2.0 * np.pi
"""Rotation of a vertex or triangle [rad] from which a state has left the branch that grows from rest."""

_TOLERANCE = 1e-9
"""Relative residual that is aimed at."""
_FAINT = 1e-3
"""Modal force at rest, as a share of the most that the load's size allows, below which it is no measure of the load."""
_FIRST_TURN = 0.5
"""Largest predicted rotation [rad] of the first step towards an equilibrium."""


class Statics(NamedTuple):
    """A static answer in modal coordinates q (m,)."""

    q: Array
    residual: float
    iterations: int
    outcome: Outcome = Outcome.CONVERGED
    message: str = ""
    stable: bool | None = None


class Workable(Protocol):
    """A model that knows the work ``f . u(q)`` of a dead load f and its derivatives."""

    basis: Basis

    def work(self, q: Array, load: Array) -> tuple[float, Array]:
        """Work [J] and its gradient (m,), the modal force."""

    def work_curvature(self, q: Array, load: Array) -> Array:
        """Second derivatives (m, m) of the work."""

    def largest_turn(self, q: Array) -> float:
        """Largest rotation [rad] at q."""


def least_potential(model: Workable, load: Array, start: Array | None) -> Statics:
    """Minimise ``q . Lambda q / 2 - f . u(q)`` over the elastic modes, rigid ones staying at zero.

    f is the dead ``load`` (n, 3) [N]; the search begins at ``start`` (m,) or at rest. The answer's residual is
    ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``, unless p(0) is far less than the load's size lets it be;
    without a load it is over the start's ``|Lambda q|``. A minimum that has wound up is no answer that the model can
    hold, and says so.
    """
    basis = model.basis
    elastic = slice(basis.rigid_modes, None)
    root = np.sqrt(basis.eigenvalues[elastic])
    q = np.zeros(basis.count)
    if not root.size:
        return Statics(q, 0.0, 0, stable=True)

    # Unknowns y = sqrt(lambda) q: their squared length is twice the elastic energy.
    def value_gradient(y: Array) -> tuple[float, Array]:
        q[elastic] = y / root
        work, push = model.work(q, load)
        return 0.5 * float(y @ y) - work, y - push[elastic] / root

    def hessian(y: Array) -> Array:
        q[elastic] = y / root
        return np.eye(root.size) - model.work_curvature(q, load)[elastic, elastic] / root[:, None] / root

    push = model.work(q, load)[1][elastic] / root
    # A load that no mode feels at rest may buckle the shell all the same: it needs a scale that is not rounding.
    shell = basis.shell
    most = float(np.sqrt(np.sum(load[shell.free] ** 2 / shell.mass[shell.free, None]))) / root.min()
    first = np.zeros_like(root) if start is None else root * start[elastic]
    scale = max(float(np.linalg.norm(push)), _FAINT * most) or float(np.linalg.norm(first)) or 1.0
    q[elastic] = push / root
    radius = scale * min(1.0, _FIRST_TURN / max(model.largest_turn(q), 1e-300))
    found = minimise(value_gradient, hessian, first, _TOLERANCE, scale=scale, radius=radius)
    q[elastic] = found.point / root
    if not found.converged:
        message = f"residual {found.residual:.1e} of {_TOLERANCE:.0e}"
        return Statics(q, found.residual, found.iterations, Outcome.NOT_CONVERGED, message)
    if model.largest_turn(q) > WOUND_UP:
        message = "a part of the shell has turned by more than 2 pi"
        return Statics(q, found.residual, found.iterations, Outcome.WOUND_UP, message, True)
    return Statics(q, found.residual, found.iterations, stable=True)
