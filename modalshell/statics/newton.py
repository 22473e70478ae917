"""Newton's method for discrete shells: mixed steps for stiff sheets, line search and projection where they fail.

A nearly inextensible sheet defeats plain Newton: a step along the tangent stretches the membrane by its square, so a
line search lets only tiny steps through. The mixed step [magisano2017] treats the element stresses as unknowns of
their own: after elimination the equations are Newton's, but the geometric part of the Hessian takes each stress from
the last linearised step instead of the (huge) stress of the over-stretched iterate. Steps are moreover warped: every
vertex is carried along the turn of its own triangles, as in modal warping, so that a long step bends the sheet instead
of stretching it. Full steps then converge in a few iterations whatever the membrane stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

from modalshell.errors import SolverError
from modalshell.kernels import rotations
from modalshell.modes import Factor, Factoriser, condensed_factor
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED, PROJECTED, Shell
from modalshell.statics.verdict import ACCEPTED
from modalshell.timings import Timings
from modalshell.typing import Array

_GOAL = 1e-10  # relative residual that is aimed at
_LARGEST_TURN = 1.0  # of a vertex in one step [rad]
_SHIFTS = (1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""Shifts of a singular Hessian, as shares of its mean diagonal entry."""
_STRETCH = 25  # iterations of descent before mixed steps are tried
_STRETCHES = 12
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
    """

    positions: Array
    residual: float
    iterations: int
    converged: bool
    factor: Factor | None = None
    stable: bool | None = None
    limited: bool = False


def _moved(shell: Shell, x: Array, direction: Array, fraction: float = 1.0) -> Array:
    moved = x.copy()
    moved.reshape(-1)[shell.free_unknowns] += fraction * direction
    return moved


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
    step = _full(shell, direction)
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


def _full(shell: Shell, direction: Array) -> Array:
    return _moved(shell, np.zeros_like(shell.rest_positions), direction)


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


def minimise(problem: Potential, start: Array, scale: float, limit: int = 200) -> NewtonResult:
    """Newton with line search on the potential, its Hessian projected element by element where it is indefinite."""
    x = start
    value = problem.value(x)
    residual, still = np.inf, False
    for iteration in range(limit + 1):
        gradient, hessian = problem.linearise(x, EXACT)
        residual = float(np.linalg.norm(gradient)) / scale
        if residual <= _GOAL or iteration == limit or not np.isfinite(residual):
            break
        factor = problem.definite_factor(hessian)
        if factor is None:
            factor = shifted_factor(problem, problem.linearise(x, PROJECTED)[1])
            if factor is None:
                break
        direction = problem.step(factor, gradient)
        still = float(np.abs(direction).max()) <= _STILL * problem.shell.size
        still = still and residual <= rounding_residual(hessian, x, scale)
        slope = float(direction @ gradient)
        fraction = 1.0
        while fraction > 1e-10:
            trial, _, share = warped_step(problem.shell, x, fraction * direction, _LARGEST_TURN)
            trial_value = problem.value(trial)
            if np.isfinite(trial_value) and trial_value <= value + 1e-4 * share * fraction * slope:
                break
            fraction *= 0.5
        else:
            break
        x, value = trial, trial_value
    return NewtonResult(x, residual, iteration, bool(residual <= ACCEPTED or still))


def shifted_factor(problem: Potential, hessian: sps.csc_array) -> Factor | None:
    """Factor of a semi-definite Hessian, shifted by as little as makes it definite; None where nothing does.

    A sheet of springs has no bending stiffness where it is flat: it needs the shift to leave its plane. A shell that
    nothing holds is not shifted, or it would only fly away.
    """
    factor = problem.definite_factor(hessian)
    diagonal = hessian.diagonal()
    for share in _SHIFTS if problem.shell.clamped.any() else ():
        if factor is not None:
            break
        hessian.setdiag(diagonal + share * diagonal.mean())  # keeps the pattern, which a sum may not
        factor = problem.definite_factor(hessian)
    return factor


def is_minimum(problem: Potential, result: NewtonResult) -> bool:
    """Whether a converged result is a minimum: its exact Hessian, whose factor it then keeps, is positive definite."""
    if not result.converged:
        return False
    result.factor = problem.definite_factor(problem.linearise(result.positions, EXACT)[1])
    result.stable = result.factor is not None
    return result.stable


def lowest_curvature(problem: Potential, x: Array) -> tuple[float, Array]:
    """Lowest of the Hessian's eigenvalues next to zero, as a share of its mean diagonal entry, and its direction (N,).

    SolverError or ArpackError where they cannot be found.
    """
    _, hessian = problem.linearise(x, EXACT)
    size = problem.shell.free_unknowns.size
    if size < 30:  # Lanczos needs room
        dense = hessian.toarray()
        inner = dense[size:, :size]
        values, vectors = np.linalg.eigh(dense[:size, :size] - inner.T @ np.linalg.solve(dense[size:, size:], inner))
    else:
        start = np.random.default_rng(0).standard_normal(size)
        factor = problem.factor(hessian)
        inverse = spla.LinearOperator((size, size), matvec=factor.solve, dtype=np.float64)
        # With its inverse at hand, Lanczos asks nothing of the matrix itself but its shape.
        values, vectors = spla.eigsh(inverse, k=3, sigma=0.0, OPinv=inverse, v0=start)
    lowest = int(np.argmin(values))
    return float(values[lowest]) / float(np.abs(hessian.diagonal()).mean()), vectors[:, lowest]


def leave_saddle(problem: Potential, x: Array) -> Array:
    """The lowest of a few moves along the direction in which the potential curves down most, both ways."""
    try:
        _, direction = lowest_curvature(problem, x)
    except (SolverError, spla.ArpackError):
        return x
    direction *= problem.shell.size / float(np.abs(direction).max())
    trials = [_moved(problem.shell, x, direction, sign * size) for size in (3e-2, 1e-2, 1e-3) for sign in (1, -1)]
    return min([x, *trials], key=lambda trial: (not np.isfinite(value := problem.value(trial)), value))


def descend(problem: Potential, start: Array, scale: float) -> NewtonResult:
    """Go downhill to a minimum: stretches of :func:`minimise`, each followed by a try of the faster mixed steps.

    A mixed answer counts if it is a minimum that lies no higher than where the stretch had come to.
    """
    x, iterations = start, 0
    for _ in range(_STRETCHES):
        result = minimise(problem, x, scale, limit=_STRETCH)
        used = result.iterations
        iterations += used
        x, value = result.positions, problem.value(result.positions)
        if not np.isfinite(result.residual):
            break
        if result.residual > _GOAL:
            polished = mixed_newton(problem, x, scale, limit=15)
            iterations += polished.iterations
            if polished.converged and problem.value(polished.positions) <= value + 1e-9 * abs(value):
                result = polished
        if result.converged:
            if is_minimum(problem, result):
                break
            result.converged = False
            x = leave_saddle(problem, result.positions)
        elif used < _STRETCH:
            break
    result.iterations = iterations
    return result


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
