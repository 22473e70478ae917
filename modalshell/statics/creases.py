r"""Minima of a potential with creases that yield, by positions and plastic folds together.

At plastic folds :math:`\psi` Newton's method finds the positions. There the couples of the creases change with
:math:`\psi` by :math:`-(S - B^T K^{-1} B)`, S being that at fixed positions, K the Hessian and B the derivative of the
gradient by :math:`\psi`: the next :math:`\psi` meets the conditions of yielding with that constant stiffness, and the
positions follow by :math:`-K^{-1} B \, d\psi`. Both conditions are met to rounding after a few rounds, as they are for
Newton's method on all unknowns (theory 15, eq. 8).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index
from modalshell.shell import EXACT, CreaseState
from modalshell.shell.creases import CreaseSet, is_definite
from modalshell.statics.continuation import Steps, equilibrium
from modalshell.statics.mixed_newton import GOAL, LARGEST_TURN
from modalshell.statics.newton import NewtonResult
from modalshell.statics.potential import Potential, solve
from modalshell.statics.refine import refine
from modalshell.statics.warped import warped_step

MET = 1e-9
"""Couple by which the conditions of yielding may be missed, as a share of the largest limit."""
_ROUNDS = 30
"""Rounds of positions and plastic folds at most."""
_LARGEST_SLIP = 0.5
"""Change of a plastic fold in a round at most [rad]."""
_FIRST_STEP = 0.125
"""First step of a load under which creases yield, as a share of it."""
_NEARLY = 0.9
"""Share of the limit from which a crease may yield next."""

Solver = Callable[[Potential, Array, list[Array] | None], NewtonResult]
"""What finds the minimum of a potential from positions with the stresses there."""


@final
@dataclass(frozen=True)
class Yielded:
    """Where positions and plastic folds have come to.

    Attributes
    ----------
    result : NewtonResult
        Positions (n, 3), found at these plastic folds.
    angles : ndarray, shape (C,)
        Plastic folds [rad].
    settled : bool
        Whether both conditions are met.
    iterations : int
        Iterations of Newton's method in all.
    """

    result: NewtonResult
    angles: Array
    settled: bool
    iterations: int


def yielded(
    problem: Potential, start: Array, before: Array, solver: Solver, stresses: list[Array] | None, met: float = MET
) -> Yielded:
    """Minimum from ``start`` (n, 3) by positions and plastic folds, which were ``before`` (C,) [rad]."""
    creases = _creases(problem)
    angles, point, last, iterations = before, start, 0.0, 0
    result, goal = NewtonResult(start, np.inf, 0, False), met * float(creases.limits.max())
    for _ in range(_ROUNDS):
        own = replace(problem, shell=problem.shell.creased(angles))
        result = solver(own, point, stresses)
        iterations += result.iterations
        if not result.converged:
            return Yielded(result, angles, False, iterations)
        couples = own.shell.elastic_energy.fold_couples(result.point, creases.hinges)
        drive, slipped = creases.drive(couples, angles), angles - before
        beyond = creases.beyond(drive, slipped)
        size = float(beyond.max())
        # Near the goal rounds end where they gain no more digits: they converge by squares.
        if size <= goal or 0.0 < last <= size <= 1e3 * goal:
            return Yielded(result, angles, True, iterations)
        chosen = (beyond > 0.0) | (slipped != 0.0) | (np.abs(drive) > _NEARLY * creases.limits)
        stiffness, moves = _released(own, result, creases, np.flatnonzero(chosen))
        flow = creases.flow(stiffness, drive, slipped, chosen)
        change = flow.change * min(1.0, _LARGEST_SLIP / float(np.abs(flow.change).max(initial=1e-300)))
        moved, step, share = warped_step(own.shell, result.point, moves @ change[chosen], LARGEST_TURN)
        angles = angles + share * change
        point, last = moved, size
        stresses = problem.shell.creased(angles).predicted_stresses(result.point, step)
    return Yielded(result, angles, False, iterations)


def _creases(problem: Potential) -> CreaseSet:
    creases = problem.shell.creases
    assert creases is not None
    return creases


def _released(problem: Potential, result: NewtonResult, creases: CreaseSet, chosen: Index) -> tuple[Array, Array]:
    """Stiffness (c, c) of the ``chosen`` creases against yielding, and the moves (N, c) of the positions with it."""
    energy, hinges = problem.shell.elastic_energy, creases.hinges[chosen]
    fixed = energy.fold_stiffness(hinges)
    pulls = energy.rest_angle_pulls(result.point, hinges)
    sides = np.stack([problem.shell.unknowns.restrict(pull.ravel()) for pull in pulls], axis=1)
    try:
        factor = problem.factor(problem.linearise(result.point, EXACT)[1])
        moves = np.stack([problem.step(factor, side) for side in sides.T], axis=1)
    except SolverError:
        return fixed, np.zeros_like(sides)
    stiffness = fixed + sides.T @ moves
    stiffness = 0.5 * (stiffness + stiffness.T)
    if not is_definite(stiffness + np.diag(creases.hardening[chosen]), fixed):
        return fixed, np.zeros_like(sides)  # that at fixed positions always lowers the potential
    return stiffness, moves


def equilibrium_with_creases(problem: Potential, start: Array | None) -> tuple[NewtonResult, CreaseState]:
    """Equilibrium of a shell whose creases yield as the load grows, and what they have kept then.

    Without a start the load grows from none; with one it goes straight from the load that holds the start. Where
    nothing yields the answer is the one without creases, to the last bit. Otherwise the load goes in steps, each of
    which ends at a minimum by positions and plastic folds; steps shrink where that is not found.
    """
    shell, creases = problem.shell, _creases(problem)
    state = shell.crease_state
    assert state is not None
    whole = equilibrium(problem, start)
    result = refine(problem, whole, problem.scale_at(start))
    couples = shell.elastic_energy.fold_couples(result.point, creases.hinges)
    beyond = creases.beyond(creases.drive(couples, state.angles), np.zeros_like(state.angles))
    if result.converged and float(beyond.max()) <= MET * float(creases.limits.max()):
        return result, state
    scale, iterations = problem.scale_at(start), result.iterations

    def solver(own: Potential, point: Array, stresses: list[Array] | None) -> NewtonResult:
        return solve(own, point, scale, GOAL, stresses)

    x = shell.rest_positions if start is None else start
    angles, heat = state.angles, state.dissipated
    held = np.zeros_like(problem.load) if start is None else shell.energy_gradient(x)[1]

    def loaded(share: float) -> Potential:
        """The problem on the way from the load that holds the start, or from none."""
        part = problem.loaded(share)
        return replace(part, load=part.load + (1.0 - share) * held)

    if start is None and (angles.any() or shell.stressed):  # the load grows from the shape without it
        still = yielded(loaded(0.0), x, angles, solver, None)
        iterations += still.iterations
        if not still.settled:
            return replace(still.result, converged=False, iterations=iterations), state
        heat += creases.heat(angles, still.angles)
        x, angles = still.result.point, still.angles
    steps, found = Steps(_FIRST_STEP), NewtonResult(x, np.inf, 0, False)
    while steps.fraction < 1.0:
        target = steps.target
        tried = yielded(loaded(target), x, angles, solver, None)
        iterations += tried.iterations
        if not tried.settled:
            if steps.refuse():
                continue
            kept = CreaseState(angles, heat)
            return replace(found, converged=False, residual=np.inf, iterations=iterations), kept
        heat += creases.heat(angles, tried.angles)
        x, angles, found = tried.result.point, tried.angles, tried.result
        steps.accept(target)
    return replace(found, iterations=iterations), CreaseState(angles, heat)
