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
from modalshell.mesh.topology import area_vectors
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
_FIRST_STEP, _FINEST = 0.125, 2.0**-14
"""First step of a load under which creases yield, as a share of it, and the one that is halved no more."""
_ALIKE, _LEAST = 1e-3, 1e-6
"""How far two halves of a step may end from it, as a share of the change of plastic folds, and in any case [rad]."""
_STRAIGHT = 0.01
"""By how much a couple may leave a straight line, as a share of its limit, where a parabola says that none yields."""
_TURN = 0.9
"""Cosine of the angle by which a triangle may turn between two places of the way that are compared."""
_DEPTH = 14
"""Bisections of the way at most, in search of what yields on it."""
_AWAY = 1e-3
"""Distance, as a share of the shell's size, up to which a shell stays at a start."""
_NEARLY = 0.9
"""Share of the limit from which a crease may yield next."""

Solver = Callable[[Potential, Array, list[Array] | None], NewtonResult]
"""What finds the minimum of a potential from positions with the stresses there."""


@final
@dataclass(frozen=True)
class Yielded:
    """Where positions and plastic folds have come to."""

    result: NewtonResult
    """Positions (n, 3), found at these plastic folds."""
    angles: Array
    """Plastic folds [rad]; shape (C,)."""
    settled: bool
    """Whether both conditions are met."""
    iterations: int
    """Iterations of Newton's method in all."""


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
        couples = own.shell.undamped.elastic_energy.fold_couples(result.point, creases.hinges)
        drive, slipped = creases.drive(couples, angles), angles - before
        beyond = creases.yield_residual(drive, slipped)
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
    energy, hinges = problem.shell.undamped.elastic_energy, creases.hinges[chosen]
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


@final
@dataclass(frozen=True)
class _Way:
    """The way of a load from what holds the ``origin`` (n, 3) [m] to all of it, as a share from 0 to 1.

    ``held`` (n, 3) [N] is the load that holds the origin.
    """

    problem: Potential
    origin: Array
    held: Array
    scale: float

    @classmethod
    def of(cls, problem: Potential, start: Array | None) -> _Way:
        """That from a start, or from the shape without load."""
        held = np.zeros_like(problem.load) if start is None else problem.shell.energy_gradient(start)[1]
        origin = problem.shell.rest_positions if start is None else start
        return cls(problem, origin, held, problem.scale_at(start))

    def loaded(self, share: float) -> Potential:
        """The problem under a share of the load."""
        part = self.problem.loaded(share)
        return replace(part, load=part.load + (1.0 - share) * self.held)

    def yielded(self, share: float, before: _Place) -> tuple[_Place, Yielded]:
        """Where a step from a place to a share of the load ends."""

        def solver(own: Potential, point: Array, stresses: list[Array] | None) -> NewtonResult:
            return solve(own, point, self.scale, GOAL, stresses)

        found = yielded(self.loaded(share), before.x, before.angles, solver, None)
        heat = before.heat + _creases(self.problem).heat(before.angles, found.angles)
        return self.place(share, found.result.point, found.angles, heat), found

    def elastic(self, share: float, before: _Place) -> tuple[_Place, NewtonResult]:
        """The same where nothing yields."""
        found = equilibrium(self.loaded(share), before.x)
        return self.place(share, found.point, before.angles, before.heat), found

    def holds(self, start: _Place) -> tuple[bool, int]:
        """Whether the shell stays at a start under the load that balances it there, and the iterations to see."""
        there, found = self.elastic(0.0, start)
        away = float(np.abs(there.x - start.x).max())
        return bool(found.converged and away <= _AWAY * self.problem.shell.size), found.iterations

    def place(self, share: float, x: Array, angles: Array, heat: float) -> _Place:
        """A place on the way."""
        creases = _creases(self.problem)
        couples = self.problem.shell.creased(angles).elastic_energy.fold_couples(x, creases.hinges)
        return _Place(share, x, angles, heat, creases.drive(couples, angles) / creases.limits)

    def even(self, low: _Place, middle: _Place, high: _Place) -> bool:
        """Whether nothing that stays still between three places yields on the way, and the shell turns little."""
        still = (low.angles == middle.angles) & (middle.angles == high.angles)
        bend = middle.drive - 0.5 * (low.drive + high.drive)
        slope = 0.5 * (high.drive - low.drive)
        inside = np.abs(slope) < 2.0 * np.abs(bend)
        rise = np.divide(slope**2, 4.0 * bend, out=np.zeros_like(bend), where=inside)
        largest = np.max(np.abs([low.drive, middle.drive, high.drive, middle.drive + rise]), axis=0)
        fine = (largest + np.abs(bend) <= 1.0) | ((largest <= 1.0 + MET) & (np.abs(bend) <= _STRAIGHT))
        if not fine[still].all():
            return False
        faces = self.problem.shell.mesh.faces
        sides = [area_vectors(place.x, faces) for place in (low, high)]
        least = _TURN * np.prod(np.linalg.norm(sides, axis=2), axis=0)
        return bool((np.sum(sides[0] * sides[1], axis=1) >= least).all())


@final
@dataclass(frozen=True)
class _Place:
    """A place on the way of a load: positions (n, 3), plastic folds (C,), heat, and drive over its limits (C,)."""

    share: float
    x: Array
    angles: Array
    heat: float
    drive: Array

    @property
    def within(self) -> bool:
        """Whether nothing yields here."""
        return float(np.abs(self.drive).max()) <= 1.0 + MET


def _stays_elastic(way: _Way, low: _Place, high: _Place, depth: int = _DEPTH) -> tuple[bool, int]:
    """Whether nothing yields between two places where nothing does, and the iterations that it took to see."""
    middle, found = way.elastic(0.5 * (low.share + high.share), low)
    if not found.converged or not middle.within:
        return False, found.iterations
    if depth == 0 or way.even(low, middle, high):
        return True, found.iterations
    iterations = found.iterations
    for ends in ((low, middle), (middle, high)):
        stays, further = _stays_elastic(way, *ends, depth - 1)
        iterations += further
        if not stays:
            return False, iterations
    return True, iterations


def equilibrium_with_creases(problem: Potential, start: Array | None) -> tuple[NewtonResult, CreaseState]:
    """Equilibrium of a shell whose creases yield as the load grows, and what they have kept then.

    Without a start the load grows from none; with one it goes straight from the load that holds the start, or, where
    creases beyond their limits leave none that could, to where nothing yields under the whole load. A start that
    supports held, which are gone, and no load would, goes to the whole load at once. Where nothing yields on the way,
    which need not be its end, the answer is the one without creases, to the last bit. Otherwise the load goes in steps,
    each of which ends at a minimum by positions and plastic folds. Steps shrink where that is not found, and where two
    halves of a step end elsewhere: a crease that yields and is relieved again.
    """
    shell = problem.shell
    state = shell.crease_state
    assert state is not None
    whole = equilibrium(problem, start)
    way = _Way.of(problem, start)
    result = refine(problem, whole, way.scale)
    iterations = result.iterations
    low = way.place(0.0, way.origin, state.angles, state.dissipated)
    if start is None and (state.angles.any() or shell.stressed):  # the load grows from the shape without it
        low, still = way.yielded(0.0, low)
        iterations += still.iterations
        if not still.settled:
            return replace(still.result, converged=False, iterations=iterations), state
    high = way.place(1.0, result.point, state.angles, state.dissipated)
    unyielded = np.array_equal(low.angles, state.angles)
    if result.converged and unyielded and low.within and high.within:
        stays, further = _stays_elastic(way, low, high)
        iterations += further
        if stays:
            return replace(result, iterations=iterations), state
    if start is not None and low.within:
        held, further = way.holds(low)
        iterations += further
        if not held:  # by supports alone, which are gone: a load in their place would lead it elsewhere
            return _straight(way, low, high, replace(result, iterations=iterations))
    if result.converged and high.within and not low.within and not (at_start := way.yielded(0.0, low)[1]).settled:
        # No load holds the start, as of positions on another mesh: it says where to begin, not how the load came.
        return replace(result, iterations=iterations + at_start.iterations), state
    return _stepped(way, low, iterations)


def _straight(way: _Way, low: _Place, high: _Place, result: NewtonResult) -> tuple[NewtonResult, CreaseState]:
    """The answer under the whole load from a place at once, and what creases have kept; ``high`` is it unyielded."""
    if result.converged and high.within:
        return result, CreaseState(low.angles, low.heat)
    place, found = way.yielded(1.0, low)
    iterations = result.iterations + found.iterations
    if not found.settled:
        return replace(found.result, converged=False, iterations=iterations), CreaseState(low.angles, low.heat)
    return replace(found.result, iterations=iterations), CreaseState(place.angles, place.heat)


def _stepped(way: _Way, low: _Place, iterations: int) -> tuple[NewtonResult, CreaseState]:
    """The answer by steps of the load from a place, and what creases have kept then."""
    steps, known = Steps(_FIRST_STEP), None
    found = NewtonResult(low.x, np.inf, 0, False)
    while steps.fraction < 1.0:
        target = steps.target
        tried, halves, place = known or way.yielded(target, low), [], low
        iterations += 0 if known else tried[1].iterations
        for share in (0.5 * (low.share + target), target) if tried[1].settled else ():
            halves.append(way.yielded(share, place))
            iterations += halves[-1][1].iterations
            if not halves[-1][1].settled:
                break
            place = halves[-1][0]
        known = None
        if place.share < target:
            if steps.refuse(max(low.share, _FINEST)):
                continue
            own = replace(way.problem, shell=way.problem.shell.creased(low.angles))
            missed = own.measure(own.residual(low.x)) / way.scale
            found = replace(found, converged=False, residual=missed, iterations=iterations, stable=None)
            return found, CreaseState(low.angles, low.heat)
        change = float(np.abs(place.angles - low.angles).max())
        apart = float(np.abs(place.angles - tried[0].angles).max())
        if (apart > _ALIKE * change + _LEAST or not way.even(low, halves[0][0], place)) and steps.step > _FINEST:
            steps.limit(halves[0][0].share - low.share)
            known = halves[0]
            continue
        low, found = place, halves[-1][1].result
        steps.accept(target)
    return replace(found, iterations=iterations), CreaseState(low.angles, low.heat)
