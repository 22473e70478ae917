"""What linear theory says of a step: damping and frequency that it adds, and when motion leaves its equilibrium.

For one mode of stiffness lambda and damping ``c = xi + zeta lambda`` a step h of implicit Euler,
``v+ = (v + h (p - lambda q)) / (1 + h c + h^2 lambda)``, ``q+ = q + h v+``, has a matrix of trace
``(2 + h c) / (1 + h c + h^2 lambda)`` and determinant ``1 / (1 + h c + h^2 lambda)``: oscillations shrink by the root
of the latter. The midpoint rule keeps the amplitude of undamped motion, and turns its phase by
``2 arctan(h omega / 2)`` instead of ``h omega``. Modal forces that depend on q are taken from the step before by
implicit Euler, from a predicted middle by the midpoint rule: both can miss an equilibrium that the model has.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from modalshell.models import Damping
from modalshell.models.modal import ModalModel
from modalshell.typing import Array

_DIFFERENCE = 1e-5
"""Turn [rad] over which the modal force is differenced."""


def implicit_euler_amplification(stiffness: ArrayLike, damp: ArrayLike, dt: ArrayLike) -> Array:
    """Factor by which a step of implicit Euler shrinks a mode that oscillates: ``(1 + h c + h^2 lambda)^(-1/2)``.

    Parameters
    ----------
    stiffness : array_like
        Squared angular frequency lambda [1/s^2].
    damp : array_like
        Modal damping c = xi + zeta lambda [1/s], below ``2 sqrt(lambda)``.
    dt : array_like
        Step h [s].
    """
    h = np.asarray(dt)
    return np.asarray(1.0 / np.sqrt(1.0 + h * np.asarray(damp) + h**2 * np.asarray(stiffness)))


def midpoint_frequency(frequency: ArrayLike, dt: ArrayLike) -> Array:
    """Angular frequency [rad/s] of undamped motion by the midpoint rule: ``2 arctan(h omega / 2) / h``."""
    h = np.asarray(dt)
    return np.asarray(2.0 * np.arctan(0.5 * h * np.asarray(frequency)) / h)


def modal_force_slope(model: ModalModel, q: Array, load: Array) -> Array:
    """Derivatives ``dp/dq`` (m, m) of the modal force of a load (n, 3) [N] at q (m,), by central differences."""
    slope = np.empty((q.size, q.size))
    turns = np.maximum(np.abs(model.basis.rotations).max(axis=0), 1e-300)
    for k in range(q.size):
        change = np.zeros_like(q)
        change[k] = _DIFFERENCE / turns[k]
        ahead, behind = (model.modal_force(q + side * change, load) for side in (1.0, -1.0))
        slope[:, k] = (ahead - behind) / (2.0 * change[k])
    return slope


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

    Returns
    -------
    ndarray, shape (2m, 2m)
        With D = diag(1 + h c + h^2 lambda) and P = dp/dq, implicit Euler's new rate is
        ``D^-1 (v + h (P - Lambda) q)``; the midpoint rule's middle is the same with h/2, P acting on the predicted one.
    """
    eigenvalues = model.basis.eigenvalues
    slope, stiffness = modal_force_slope(model, q, load), np.diag(eigenvalues)
    damp = damping.mass_factor + damping.stiffness_factor * eigenvalues
    identity = np.eye(q.size)
    share = dt if model.integrator == "implicit_euler" else 0.5 * dt
    inverse = np.diag(1.0 / (1.0 + share * damp + share**2 * eigenvalues))
    # The new rate, or that of the predicted middle, from q and from v.
    from_q, from_v = inverse @ (share * (slope - stiffness)), inverse
    if model.integrator == "implicit_euler":
        return np.block([[identity + dt * from_q, dt * from_v], [from_q, from_v]])
    # The force in the middle feels q plus half a step of the predicted rate.
    lag = inverse @ (share**2 * slope)
    middle_q, middle_v = from_q + lag @ from_q, from_v + lag @ from_v
    return np.block([[identity + dt * middle_q, dt * middle_v], [2.0 * middle_q, 2.0 * middle_v - identity]])


def step_radius(model: ModalModel, q: Array, load: Array, dt: float, damping: Damping) -> float:
    """Spectral radius of :func:`step_matrix`: small motion about the equilibrium q grows where it is above one."""
    return float(np.abs(np.linalg.eigvals(step_matrix(model, q, load, dt, damping))).max())


def iteration_radius(model: ModalModel, q: Array, load: Array) -> float:
    """Spectral radius of ``Lambda^-1 dp/dq`` at an equilibrium q of a shell that is held.

    That of the lagged iteration ``q <- Lambda^-1 p(q)``, which implicit Euler becomes at long steps; it finds q where
    the radius is below one.
    """
    slope = modal_force_slope(model, q, load)
    return float(np.abs(np.linalg.eigvals(slope / model.basis.eigenvalues[:, None])).max())
