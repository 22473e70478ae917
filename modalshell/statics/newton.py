"""Newton's method for discrete shells: mixed steps for stiff sheets, line search and projection where they fail.

A nearly inextensible sheet defeats plain Newton: a step along the tangent stretches the membrane by its square, so a
line search lets only tiny steps through. The mixed step [magisano2017] treats the element stresses as unknowns of
their own: after elimination the equations are Newton's, but the geometric part of the Hessian takes each stress from
the last linearised step instead of the (huge) stress of the over-stretched iterate. Steps are moreover warped: every
vertex is carried along the turn of its own triangles, as in modal warping, so that a long step bends the sheet instead
of stretching it. Full steps then converge in a few iterations whatever the membrane stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sps

from modalshell.errors import SolverError
from modalshell.kernels import rotations
from modalshell.modes import Factor, Factoriser, condensed_factor, lowest_tangent_mode
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED, PROJECTED, Shell
from modalshell.statics.verdict import ACCEPTED
from modalshell.timings import Timings
from modalshell.typing import Array

_GOAL = 1e-10  # relative residual that is aimed at
_LARGEST_TURN = 1.0  # of a vertex in one step [rad]
_LOOSE = 1e-3  # relative residual of the steps of a descent
_ASIDE = 2.0 ** np.arange(-20.0, 0.0)
"""Steps away from a saddle, in sizes of the shell."""
_FIRST_MOVE = 0.05
"""Move of a free shell under the load, in its sizes, that the first drag of a descent allows."""
_DESCENT = 150
"""Steps of a descent at most."""
_NEAR = 0.3
"""Out-of-balance force, as a share of the load, from which a descent tries to end by Newton's method."""
_SADDLES = 4
_EPSILON = float(np.finfo(np.float64).eps)
_STILL = 1e-8
"""Newton step, as a share of the shell's size, up to which a residual can be due to rounding."""


@dataclass(frozen=True)
class Potential:
    """``E(x) + u.Q u / 2 - b.u`` with ``u = x - origin``, on the free vertices.

    Parameters
    ----------
    shell : Shell
        Gives the elastic energy E.
    load : ndarray, shape (n, 3)
        b [N].
    origin : ndarray, shape (n, 3)
        Where the quadratic part is centred [m].
    factoriser : Factoriser
        Factorises the Hessians, all of one pattern.
    costs : Timings
        Where the seconds of assembly, factorisation and solution are added up.
    quadratic : ndarray, optional
        Entries of Q on the shell's pattern (inertia and damping of an implicit step); statics has none.
    """

    shell: Shell
    load: Array
    origin: Array
    factoriser: Factoriser
    costs: Timings
    quadratic: Array | None = None

    @property
    def scale(self) -> float:
        """Norm of the load on free vertices [N]."""
        return float(np.linalg.norm(self.load[self.shell.free]))

    def _outer(self, x: Array) -> tuple[float, Array]:
        u = x - self.origin
        pull = -self.load
        if self.quadratic is not None:
            pull = self.shell.pattern.product(self.quadratic, u.ravel()).reshape(-1, 3) - self.load
        return 0.5 * float(np.vdot(u, pull - self.load)), pull

    def value(self, x: Array) -> float:
        """Potential [J]."""
        return self.shell.raw_energy(x) + self._outer(x)[0]

    def residual(self, x: Array) -> Array:
        """Gradient on the free unknowns (N,) [N]."""
        return (self.shell.energy_gradient(x)[1] + self._outer(x)[1]).ravel()[self.shell.free_unknowns]

    def linearise(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> tuple[Array, sps.csc_array]:
        """Gradient (N,) on the free unknowns, and Hessian with the energy's internal unknowns after them."""
        with self.costs.part("assembly"):
            _, gradient, data = self.shell.energy_gradient_hessian(x, geometric, stresses)
            if self.quadratic is not None:
                data += self.quadratic
            total = gradient + self._outer(x)[1]
            return total.ravel()[self.shell.free_unknowns], self.shell.pattern.free_matrix(data)

    def linearise_led(self, x: Array, led: Array) -> tuple[Array, sps.csc_array]:
        """As :meth:`linearise`, projected, with the held vertices' part of ``led`` (n, 3) [m] in the gradient."""
        with self.costs.part("assembly"):
            _, gradient, data = self.shell.energy_gradient_hessian(x, PROJECTED)
            if self.quadratic is not None:
                data += self.quadratic
            total = gradient + self._outer(x)[1]
            if led.any():
                total += self.shell.pattern.product(data, led.ravel()).reshape(-1, 3)
            return total.ravel()[self.shell.free_unknowns], self.shell.pattern.free_matrix(data)

    def dragged(self, x: Array, drag: float) -> Potential:
        """The same potential with ``drag |y - x|^2 / 2`` added, in the norm of the mass."""
        outer = np.zeros(self.shell.pattern.size) if self.quadratic is None else self.quadratic.copy()
        outer[self.shell.pattern.diagonal] += drag * np.repeat(self.shell.mass, 3)
        return replace(self, load=-self._outer(x)[1], origin=x, quadratic=outer)

    def factor(self, hessian: sps.csc_array) -> Factor:
        """Factor of a Hessian, definite or not; SolverError if it is singular."""
        with self.costs.part("factorisation"):
            return self._condensed(self.factoriser.symmetric(hessian))

    def definite_factor(self, hessian: sps.csc_array) -> Factor | None:
        """Factor of a positive definite Hessian, None for any other."""
        with self.costs.part("factorisation"):
            try:
                factor = self.factoriser.definite(hessian)
            except SolverError:
                return None
            return self._condensed(factor) if factor.is_definite() else None

    def _condensed(self, factor: Factor) -> Factor:
        """A factor for the positions' unknowns: the gradient by internal ones is zero, as the energy is least there."""
        internal = self.shell.pattern.internal
        return condensed_factor(factor, 0 if internal is None else internal.count)

    def step(self, factor: Factor, gradient: Array) -> Array:
        """Newton direction (N,)."""
        with self.costs.part("solution"):
            return factor.solve(-gradient)


def rounding_residual(hessian: sps.csc_array, x: Array, scale: float) -> float:
    """Residual that the rounding of the positions alone leaves: each force by eps times its stiffness times |x|.

    A stiff membrane under a light load (thin sheets with L/h of a thousand) cannot be balanced any better in double
    precision; :mod:`modalshell.statics.refine` goes on from there.
    """
    return _EPSILON * float(np.abs(x).max()) * float(np.linalg.norm(hessian.diagonal())) / scale


@dataclass
class NewtonResult:
    """Where Newton ended.

    Attributes
    ----------
    positions : ndarray, shape (n, 3)
        Last (or best) iterate.
    residual : float
        Norm of the gradient over the norm of the load.
    iterations : int
        Factorisations used.
    converged : bool
        Whether the residual met :data:`ACCEPTED`, or :func:`rounding_residual` with Newton's steps at their end.
    factor : Factor or None
        Of the last Hessian, a step before the end; of the one at the end where :func:`is_minimum` has found it so.
    stable : bool or None
        Whether the exact Hessian at the end is positive definite; None where that was not found out.
    limited : bool
        Whether rounding keeps the residual above :data:`ACCEPTED`.
    left_saddle : bool
        Whether the way there led over a saddle, left along its unstable mode to the lower of both sides.
    """

    positions: Array
    residual: float
    iterations: int
    converged: bool
    factor: Factor | None = None
    stable: bool | None = None
    limited: bool = False
    left_saddle: bool = False


def warped_step(shell: Shell, x: Array, direction: Array, largest_turn: float) -> tuple[Array, Array, float]:
    """Move along ``direction`` (N,), warped, as far as no vertex turns by more than ``largest_turn`` [rad].

    Returns
    -------
    positions : ndarray, shape (n, 3)
        The new positions.
    step : ndarray, shape (n, 3)
        The straight step that was warped.
    fraction : float
        How much of ``direction`` that is.
    """
    step = np.zeros_like(shell.rest_positions)
    step.reshape(-1)[shell.free_unknowns] = direction
    turns = np.empty_like(x)
    rotations.vertex_rotations(x, step, shell.mesh.faces, turns)
    angle = rotations.largest_angle(turns)
    fraction = 1.0
    if angle > largest_turn:
        fraction = largest_turn / angle
        step *= fraction
        turns *= fraction
    displacement = np.empty_like(x)
    rotations.warp(turns, step, 1.0, displacement)
    return x + displacement, step, fraction


def mixed_newton(
    problem: Potential,
    start: Array,
    scale: float,
    *,
    limit: int = 40,
    goal: float = _GOAL,
    stresses: list[Array] | None = None,
) -> NewtonResult:
    """Full mixed Newton steps from ``start``; gives up when the residual stops falling.

    ``stresses`` are those predicted with ``start``; without them the first step leaves the geometric part out.
    """
    shell = problem.shell
    x = start
    best = NewtonResult(start, np.inf, 0, False)
    stalled, length = 0, np.inf
    for iteration in range(limit + 1):
        gradient, hessian = problem.linearise(x, GAUSS_NEWTON if stresses is None else MIXED, stresses)
        residual = float(np.linalg.norm(gradient)) / scale
        if not np.isfinite(residual):
            break
        if residual < best.residual:
            stalled = stalled + 1 if residual > 0.5 * best.residual else 0
            accepted = max(ACCEPTED, goal)
            if iteration == 0 and problem.quadratic is not None:
                accepted = _GOAL  # a step must be taken, or a small load on a fast shell would never act
            best = NewtonResult(x, residual, iteration, residual <= accepted, best.factor)
        else:
            stalled += 1
        if length <= _STILL * shell.size and best.residual <= rounding_residual(hessian, x, scale):
            best.converged = True
        if (
            (residual <= goal and best.converged)
            or iteration == limit
            or (best.converged and stalled >= 1)
            or stalled >= 8
        ):
            break
        try:
            best.factor = problem.factor(hessian)
        except SolverError:
            break
        direction = problem.step(best.factor, gradient)
        if not np.isfinite(direction).all():
            break
        moved, step, _ = warped_step(shell, x, direction, _LARGEST_TURN)
        stresses = shell.predicted_stresses(x, step)
        length = float(np.abs(moved - x).max())
        x = moved
        best.iterations = iteration + 1
    return best


def is_minimum(problem: Potential, result: NewtonResult) -> bool:
    """Whether a converged result is a minimum: its exact Hessian, whose factor it then keeps, is positive definite."""
    if not result.converged:
        return False
    result.factor = problem.definite_factor(problem.linearise(result.positions, EXACT)[1])
    result.stable = result.factor is not None
    return result.stable


def leave_saddle(problem: Potential, x: Array) -> tuple[Array, float]:
    """The way down along the direction in which the potential curves down most, and a drag that steadies it.

    Both ways are tried. Steps are warped, so that they bend the shell, and double for as long as the potential falls:
    the first valley is looked for, not the deepest one.
    """
    shell = problem.shell
    try:
        lowest, direction = lowest_tangent_mode(shell, problem.linearise(x, EXACT)[1], problem.factoriser)
    except SolverError:
        return x, 0.0
    direction *= shell.size / float(np.abs(direction).max())
    best, least = x, problem.value(x)
    for sign in (1.0, -1.0):
        last = np.inf
        for size in _ASIDE:
            trial = warped_step(shell, x, sign * size * direction, _LARGEST_TURN)[0]
            value = problem.value(trial)
            if not value < last:
                break
            last = value
            if value < least:
                best, least = trial, value
    return best, 2.0 * abs(lowest)


def descend(problem: Potential, start: Array, scale: float) -> NewtonResult:
    """Go downhill to a minimum, as the shell would move in a thick fluid; saddles on the way are left.

    Steps of implicit Euler on ``drag M dx/dt = -grad V``, each solved by mixed Newton, whose number of iterations does
    not feel the membrane; the drag falls with success, down to plain Newton steps, and grows where a step fails.
    """
    shell = problem.shell
    x, value = start, problem.value(start)
    result = NewtonResult(x, np.inf, 0, False)
    iterations, left = 0, 0
    residual = float(np.linalg.norm(problem.residual(x)))
    drag = residual / float(np.linalg.norm(shell.mass[shell.free])) / (_FIRST_MOVE * shell.size)
    for _ in range(_DESCENT):
        step = mixed_newton(problem.dragged(x, drag), x, scale, limit=12, goal=_LOOSE, stresses=_present(shell, x))
        iterations += step.iterations
        reached = problem.value(step.positions) if step.converged else np.inf
        if not reached <= value:
            drag *= 4.0
            if not np.isfinite(drag):
                break
            continue
        x, value = step.positions, reached
        drag *= 0.5 if step.iterations <= 5 else 1.0
        residual = float(np.linalg.norm(problem.residual(x))) / scale
        if residual > _NEAR:
            continue
        iterations += 1
        if problem.definite_factor(problem.linearise(x, EXACT)[1]) is None and residual > _LOOSE:
            continue
        polished = mixed_newton(problem, x, scale, limit=15, stresses=_present(shell, x))
        iterations += polished.iterations
        if not polished.converged or problem.value(polished.positions) > value + 1e-9 * abs(value):
            continue
        result = polished
        if is_minimum(problem, result) or left == _SADDLES:
            break
        left += 1
        x, drag = leave_saddle(problem, result.positions)
        value = problem.value(x)
    else:
        result = NewtonResult(x, residual, iterations, False)
    result.converged = result.converged and bool(result.stable)
    result.iterations, result.left_saddle = iterations, left > 0
    return result


def _present(shell: Shell, x: Array) -> list[Array]:
    """Stresses of every element at ``x``: with them the first mixed step has the exact Hessian."""
    return shell.predicted_stresses(x, np.zeros_like(x))


def solve(
    problem: Potential, start: Array, scale: float, goal: float = _GOAL, stresses: list[Array] | None = None
) -> NewtonResult:
    """One implicit step: mixed Newton, and descent from its start where it fails or ends at no minimum.

    The last Hessian on the way stands for the one at the end: with inertia in it the two agree well enough, and a
    factorisation is saved.
    """
    result = mixed_newton(problem, start, scale, goal=goal, stresses=stresses)
    if result.converged:
        # The first Hessian may have been without its geometric part, and says nothing of a minimum.
        late = result.factor is not None and result.iterations > 1
        if result.factor.is_definite() if late and result.factor is not None else is_minimum(problem, result):
            return result
    fallback = descend(problem, start, scale)
    fallback.iterations += result.iterations
    if fallback.converged or not result.converged:
        return fallback
    result.iterations = fallback.iterations
    return result
