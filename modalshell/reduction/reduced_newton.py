"""Statics and implicit steps in a reduced basis: mixed Newton along a growing load, and descent where it fails.

As for the full shell (:mod:`modalshell.statics.newton`) a stiff membrane defeats plain Newton, and taking the element
stresses from the last linearised step [magisano2017] mends it: some 10 iterations instead of some 200.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from modalshell.reduction.reduced_energy import ReducedEnergy
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED
from modalshell.statics.trust_region import minimise
from modalshell.statics.verdict import ACCEPTED
from modalshell.typing import Array

_GOAL = 1e-10
"""Relative residual that is aimed at."""
_NEWTON_LIMIT = 25
"""Mixed Newton iterations at one load at most."""
_LARGEST_STEP = 0.5
"""Largest change of an edge over its length that one load step may predict: about a turn [rad]."""
_SMALLEST_TRUST = 1.0 / 300.0
"""Trust below which the load path is given up."""
_LOAD_STEPS = 200
"""Load steps at most."""


@dataclass(frozen=True)
class ReducedPotential:
    """``V(z) = E(z) + d.Q d / 2 - p.d`` with ``d = z - origin``.

    Parameters
    ----------
    energy : ReducedEnergy
        E.
    push : ndarray, shape (r,)
        p, the reduced load.
    origin : ndarray, shape (r,)
        Where the quadratic part is centred.
    scaling : ndarray, shape (r,)
        Square root of the stiffness of each coordinate about ``origin``: forces are measured by ``|f / scaling|``, the
        root of twice the energy that they store.
    quadratic : ndarray, shape (r, r), optional
        Q, inertia and damping of an implicit step; statics has none.
    """

    energy: ReducedEnergy
    push: Array
    origin: Array
    scaling: Array
    quadratic: Array | None = None

    @property
    def load_size(self) -> float:
        """Measure of the load; one if there is none."""
        return self.measure(self.push) or 1.0

    def measure(self, force: Array) -> float:
        """Size of a reduced force [sqrt(J)]."""
        return float(np.linalg.norm(force / self.scaling))

    def value_gradient(self, z: Array) -> tuple[float, Array]:
        """V and its gradient; V is infinite where either is not finite."""
        value, gradient = self.energy.gradient(z)
        value, gradient = self._with_outer(z, value, gradient)
        return (value, gradient) if np.isfinite(value) and np.isfinite(gradient).all() else (np.inf, gradient)

    def linearise(self, z: Array, geometric: int = EXACT, stresses: list[Array] | None = None) -> tuple[Array, Array]:
        """Gradient (r,) and Hessian (r, r)."""
        _, gradient, hessian = self.energy.hessian(z, geometric, stresses)
        if self.quadratic is not None:
            hessian += self.quadratic
        return self._with_outer(z, 0.0, gradient)[1], hessian

    def is_minimum(self, z: Array) -> bool:
        """Whether the exact Hessian is positive definite."""
        return definite_factor(self.linearise(z)[1]) is not None

    def _with_outer(self, z: Array, value: float, gradient: Array) -> tuple[float, Array]:
        moved = z - self.origin
        pull = -self.push if self.quadratic is None else self.quadratic @ moved - self.push
        return value + 0.5 * float(moved @ (pull - self.push)), gradient + pull


@dataclass
class ReducedAnswer:
    """Where a reduced solver ended; ``path`` holds the load factors and coordinates of the states on the way."""

    z: Array
    residual: float
    iterations: int
    converged: bool
    path: list[tuple[float, Array]]
    stable: bool | None = None


def definite_factor(hessian: Array) -> tuple[Array, bool] | None:
    """Cholesky factor of a positive definite matrix, None for any other."""
    try:
        factor, lower = scipy.linalg.cho_factor(hessian)
    except (np.linalg.LinAlgError, ValueError):  # indefinite, or not finite
        return None
    return np.asarray(factor), bool(lower)


def mixed_newton(
    problem: ReducedPotential, start: Array, scale: float, goal: float, stresses: list[Array] | None
) -> ReducedAnswer:
    """Full mixed Newton steps from ``start``, reached with ``stresses``; ends where the residual stops falling."""
    z, scaling = start, problem.scaling
    best = ReducedAnswer(start, np.inf, 0, False, [])
    stalled = 0
    for iteration in range(_NEWTON_LIMIT + 1):
        gradient, hessian = problem.linearise(z, GAUSS_NEWTON if stresses is None else MIXED, stresses)
        residual = problem.measure(gradient) / scale
        if not np.isfinite(residual):
            break
        if residual < best.residual:
            stalled = stalled + 1 if residual > 0.5 * best.residual else 0
            # A first step is always taken, or a small load on a fast shell would never act.
            accepted = max(goal, ACCEPTED) if iteration else _GOAL
            best = ReducedAnswer(z, residual, iteration, residual <= accepted, [])
        else:
            stalled += 1
        if (residual <= goal and best.converged) or (best.converged and stalled >= 1) or stalled >= 8:
            break
        try:
            step = np.linalg.solve(hessian / scaling[:, None] / scaling, -gradient / scaling) / scaling
        except np.linalg.LinAlgError:
            break
        stresses = problem.energy.predicted_stresses(z, step)
        z = z + step
    best.iterations = iteration
    return best


def descend(problem: ReducedPotential, start: Array, scale: float) -> ReducedAnswer:
    """Trust-region descent to a minimum, in coordinates scaled to unit stiffness."""
    scaling = problem.scaling

    def value_gradient(y: Array) -> tuple[float, Array]:
        value, gradient = problem.value_gradient(y / scaling)
        return value, gradient / scaling

    def hessian(y: Array) -> Array:
        matrix = problem.linearise(y / scaling)[1] / scaling[:, None] / scaling
        return matrix if np.isfinite(matrix).all() else np.eye(scaling.size)  # at a collapsed element: plain descent

    found = minimise(value_gradient, hessian, start * scaling, _GOAL, scale=scale, radius=scale)
    z = found.point / scaling
    stable = found.converged or problem.is_minimum(z)
    balanced = found.residual <= ACCEPTED
    return ReducedAnswer(z, found.residual, found.iterations, balanced and stable, [], stable)


def follow(
    problem: ReducedPotential, edge_change: Callable[[Array], float], start: Array | None = None
) -> ReducedAnswer:
    """Static equilibrium: the whole load at once from ``start``, or in load steps from rest.

    ``edge_change`` gives the largest relative change of an edge vector that a step in z makes. Where a load step ends
    at no minimum, even when short, the potential is minimised from the last stable state instead.
    """
    scale = problem.load_size
    iterations = 0
    if start is not None:
        answer = mixed_newton(problem, start, scale, _GOAL, None)
        answer.stable = problem.is_minimum(answer.z)
        if not (answer.converged and answer.stable):
            iterations = answer.iterations
            answer = descend(problem, start, scale)
            answer.iterations += iterations
        answer.path = [(1.0, answer.z)]
        return answer
    z, factor, trust = np.zeros_like(problem.push), 0.0, 1.0
    path: list[tuple[float, Array]] = []
    tangent_factor = definite_factor(problem.linearise(z)[1])
    for _ in range(_LOAD_STEPS):
        if tangent_factor is None or trust < _SMALLEST_TRUST:
            break
        tangent = (1.0 - factor) * np.asarray(scipy.linalg.cho_solve(tangent_factor, problem.push))
        share = min(1.0, trust * _LARGEST_STEP / max(edge_change(tangent), 1e-300))
        target = 1.0 if share == 1.0 else factor + share * (1.0 - factor)
        step = share * tangent
        part = ReducedPotential(problem.energy, target * problem.push, problem.origin, problem.scaling)
        guess = z + step
        stresses = problem.energy.predicted_stresses(z, step)
        answer = mixed_newton(part, guess, scale, _GOAL if target == 1.0 else 1e-4, stresses)
        iterations += answer.iterations
        found = definite_factor(part.linearise(answer.z)[1]) if answer.residual <= 1e-4 else None
        if found is None or (target == 1.0 and not answer.converged):
            trust *= 0.25
            continue
        z, factor, trust, tangent_factor = answer.z, target, min(1.0, 2.0 * trust), found
        path.append((factor, z))
        if target == 1.0:
            return ReducedAnswer(z, answer.residual, iterations, True, path, True)
    answer = descend(problem, z, scale)
    answer.iterations += iterations
    answer.path = [*path, (1.0, answer.z)]
    return answer
