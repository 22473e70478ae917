"""Equilibria of modal coordinates under forces without a potential."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.linalg

from modalshell.core.errors import SolverError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.statics.continuation import Steps
from modalshell.statics.dense import DenseFactor
from modalshell.statics.least_potential import WOUND_UP, Statics
from modalshell.statics.mixed_newton import SHORT
from modalshell.statics.newton import Equations, mixed_newton

_TOLERANCE = 1e-9
"""Relative residual at which an equilibrium has converged."""
_CONDITION = 1e12
"""Condition number from which a Jacobian counts as singular."""
_LOAD_TURN = 0.5
"""Largest predicted rotation [rad] of a part of the shell per load step."""
_DIFFERENCE = 1e-5
"""Turn [rad] over which forces and positions are differenced."""

Force = Callable[[Array, float], Array]
"""Modal force (m,), or its derivatives (m, m), at coordinates (m,) under a fraction of the load."""


@final
@dataclass(frozen=True)
class _ModalBalance(Equations[Array]):
    """``y = p(q) / sqrt(lambda)`` under a fraction of the load, ``y = sqrt(lambda) q``: |y|^2 is twice the energy."""

    force: Force
    slope: Force
    root: Array
    rigid: int
    fraction: float = 1.0

    def coordinates(self, y: Array) -> Array:
        """Q (m,), rigid modes at zero."""
        return np.concatenate([np.zeros(self.rigid), y / self.root])

    def residual(self, x: Array) -> Array:
        """Out-of-balance force."""
        return np.asarray(x - self.force(self.coordinates(x), self.fraction)[self.rigid :] / self.root)

    def linearise(
        self,
        x: Array,
        geometric: int,  # noqa: ARG002 (there are no stresses)
        stresses: list[Array] | None = None,  # noqa: ARG002
    ) -> tuple[Array, Array]:
        """Out-of-balance force, and where the Jacobian is: the last iterate needs none."""
        return self.residual(x), x

    def jacobian(self, x: Array) -> Array:
        """Derivatives of the out-of-balance force, unsymmetric."""
        if not self.fraction:
            return np.eye(x.size)
        elastic = slice(self.rigid, None)
        slope = self.slope(self.coordinates(x), self.fraction)[elastic, elastic]
        return np.asarray(np.eye(x.size) - slope / self.root[:, None] / self.root)

    def factor(self, hessian: Array) -> DenseFactor:
        """Factor of the Jacobian at an iterate; SolverError where it is singular."""
        jacobian = self.jacobian(hessian)
        if not np.linalg.cond(jacobian) <= _CONDITION:
            raise SolverError("the Jacobian of the modal force is singular")
        return DenseFactor(jacobian, np.ones(len(jacobian)))

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:  # noqa: ARG002
        """A straight step."""
        return x + direction, [], 1.0


def balance(
    force: Force,
    slope: Force,
    eigenvalues: Array,
    rigid: int,
    turn: Callable[[Array], float],
    start: Array | None,
    *,
    first_step: float = 0.25,
    retry: bool = False,
) -> Statics:
    """Solve ``Lambda q = p(q)`` for the elastic modes by Newton, from a start or along a load that grows from rest.

    Load steps follow Newton's success. A step is also refused if it moves farther than twice what the tangent at its
    beginning says, or turns a part far: Newton would jump to another branch.

    ``slope`` gives the derivatives of the ``force`` p, ``turn`` the largest rotation [rad] at given coordinates. Of the
    eigenvalues Lambda (m,) the first ``rigid`` modes stay at zero. ``first_step`` is the fraction of the load that is
    tried first; with ``retry`` the load is followed from rest where Newton fails from the ``start`` (m,). The residual
    is ``|Lambda q - p| / |p(0)|`` in the norm of ``Lambda^-1``, without a load over the start's ``|Lambda q|``.
    """
    root = np.sqrt(eigenvalues[rigid:])
    if not root.size:
        return Statics(np.zeros(rigid), 0.0, 0, stable=True)
    whole, rest = _ModalBalance(force, slope, root, rigid), np.zeros(root.size)
    first = rest if start is None else root * start[rigid:]
    scale = whole.measure(whole.residual(rest)) or whole.measure(first) or 1.0
    y, iterations, solved = rest, 0, False
    if start is not None:
        y, iterations, solved = _newton(whole, first, scale)
    if start is None or (retry and not solved):
        y, used, solved = _follow(whole, turn, scale, first_step)
        iterations += used
    q, residual = whole.coordinates(y), whole.measure(whole.residual(y)) / scale
    if not solved:
        message = "the branch from rest ends before this load"
        return Statics(q, residual, iterations, Outcome.NO_FIXED_POINT, message)
    stable = bool(scipy.linalg.eigvals(whole.jacobian(y)).real.min() > 0.0)
    if turn(q) > WOUND_UP:
        message = "a part of the shell has turned by more than 2 pi"
        return Statics(q, residual, iterations, Outcome.WOUND_UP, message, stable)
    if not stable:
        message = "a fixed point that even heavily damped motion leaves"
        return Statics(q, residual, iterations, Outcome.UNSTABLE, message, stable)
    return Statics(q, residual, iterations, stable=True)


def _newton(problem: _ModalBalance, y: Array, scale: float) -> tuple[Array, int, bool]:
    """The fixed point near y, the iterations, and whether it was found."""
    found = mixed_newton(problem, y, scale, limit=SHORT, goal=_TOLERANCE)
    return found.point, found.iterations, found.residual <= _TOLERANCE


def _follow(
    whole: _ModalBalance, turn: Callable[[Array], float], scale: float, first_step: float
) -> tuple[Array, int, bool]:
    """The fixed point under the whole load on the branch from rest, or the last one before the branch's end."""
    y, steps, iterations = np.zeros(whole.root.size), Steps(first_step, fine=True), 0
    first = -whole.residual(y)
    while steps.fraction < 1.0:
        here = replace(whole, fraction=steps.fraction)
        # dy/dfraction = J^-1 p / sqrt(lambda), and p / sqrt(lambda) = y / fraction on the branch.
        push = y / steps.fraction if steps.fraction else first
        tangent = np.asarray(np.linalg.solve(here.jacobian(y), push))
        step = steps.limit(_LOAD_TURN / max(turn(whole.coordinates(tangent)), 1e-300))
        trial, used, solved = _newton(replace(whole, fraction=steps.target), y + step * tangent, scale)
        iterations += used
        near = np.linalg.norm(trial - y - step * tangent) <= step * float(np.linalg.norm(tangent))
        if solved and near and turn(whole.coordinates(trial - y)) <= 2.0 * _LOAD_TURN:
            y = trial
            steps.accept()
        elif not steps.refuse():
            return y, iterations, False
    return y, iterations, True


def differences(function: Callable[[Array], Array], q: Array, rotations: Array) -> Array:
    """Derivatives (..., m) of a function at q (m,) by central differences.

    Each is taken over a small turn of the vertices, whose rotations in the modes are ``rotations`` (3n, m).
    """
    columns = []
    for k, turn in enumerate(np.maximum(np.abs(rotations).max(axis=0), 1e-300)):
        change = np.zeros_like(q)
        change[k] = _DIFFERENCE / turn
        columns.append((function(q + change) - function(q - change)) / (2.0 * change[k]))
    return np.ascontiguousarray(np.stack(columns, axis=-1))
