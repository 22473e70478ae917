"""When linear theory has motion leave its equilibrium: the step of a modal model, linearised about it.

What the step does to free motion is the rule's own (:class:`modalshell.integrators.modal.ModalIntegrator`). Modal
forces that depend on q are taken late, from the step before by implicit Euler, from a predicted middle by the midpoint
rule: both can miss an equilibrium that the model has.
"""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.state import Damping
from modalshell.models.base.modal import ModalModel


def step_matrix(model: ModalModel, q: Array, load: Array, dt: float, damping: Damping) -> Array:
    """Matrix (2m, 2m) that takes small deviations of q and its rate from an equilibrium over one step.

    Parameters
    ----------
    model : ModalModel
        The model, with its integrator.
    q : ndarray, shape (m,)
        Coordinates of an equilibrium under ``load``.
    load : ndarray, shape (n, 3)
        Dead load [N].
    dt : array_like
        Step h [s].
    damping : Damping
        Rayleigh factors.
    """
    eigenvalues = model.basis.eigenvalues
    jacobian = model.modal_force_jacobian(q, load)
    return model.integrator.matrix(eigenvalues, damping.of_modes(eigenvalues), dt, jacobian)


def step_radius(model: ModalModel, q: Array, load: Array, dt: float, damping: Damping) -> float:
    """Spectral radius of :func:`step_matrix`: small motion about the equilibrium q grows where it is above one."""
    return float(np.abs(np.linalg.eigvals(step_matrix(model, q, load, dt, damping))).max())


def iteration_radius(model: ModalModel, q: Array, load: Array) -> float:
    """Spectral radius of ``Lambda^-1 dp/dq`` at an equilibrium q of a shell that is held.

    That of the lagged iteration ``q <- Lambda^-1 p(q)``, which implicit Euler becomes at long steps; it finds q where
    the radius is below one.
    """
    jacobian = model.modal_force_jacobian(q, load)
    return float(np.abs(np.linalg.eigvals(jacobian / model.basis.eigenvalues[:, None])).max())
