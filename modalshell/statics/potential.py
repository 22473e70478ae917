"""Potential of discrete shells with all vertices free: warped Newton steps, and descent where Newton fails.

Steps are warped; see :mod:`modalshell.statics.warped`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.errors import SolverError
from modalshell.core.timings import Timings
from modalshell.core.typing import Array
from modalshell.modes import Factor, Factoriser, TangentStiffness, condensed_factor
from modalshell.modes.flutter import oscillates
from modalshell.modes.kept_factor import solution_by_kept_factor, unsymmetric_by_kept_factor
from modalshell.modes.unsymmetric import definite_half, general_factor, symmetric_half
from modalshell.shell import EXACT, Shell
from modalshell.statics import mixed_newton as method
from modalshell.statics.further import Further, Moved
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.newton import Factored, Iterate, Kept, NewtonResult, Problem, is_minimum, mixed_newton, rules_of
from modalshell.statics.warped import descent_length, sized_way, turned_axes, warped_step

_SETTLING = 20
"""Descents under dead loads at most in place of one under loads without a potential."""
EPSILON = float(np.finfo(np.float64).eps)
STILL = 1e-8
"""Newton step, as a share of the shell's size, up to which a residual can be due to rounding."""


@final
@dataclass(frozen=True)
class Potential(Problem[sps.csc_array]):
    """A shell's potential, on the free vertices: x are positions (n, 3) [m], E is the elastic energy.

    The quadratic part has its entries on the shell's pattern.
    """

    shell: Shell
    factoriser: Factoriser
    """Of the Hessians, all of one pattern."""
    costs: Timings
    """Where the seconds of assembly, factorisation and solution are added up."""
    live: LiveLoads | None = None
    """Loads in addition to b that change with x.

    Their stiffness enters the Hessian. Without a potential it is unsymmetric: Newton's steps then take the whole of it,
    in time by a factor near it. Such a state is stable if the lowest eigenvalues of the whole are real and positive;
    see :func:`.without_flutter`.
    """
    inertia: Array | None = field(default=None, kw_only=True)
    """Part (n,) of Q on its diagonal, the same along each axis [N/m], left out of ``quadratic``."""
    kept_within: float = field(default=0.0, kw_only=True)
    """Move, as a share of the shell's size, within which a definite factor serves other Hessians, too.

    For conjugate gradients on them, and to find a state on the way to be a minimum.
    """
    further: Further | None = field(default=None, kw_only=True)
    """A further energy, such as that between layers in self-contact."""

    load_step: ClassVar = 0.8
    path_goal: ClassVar = 1e-3
    snaps: ClassVar = 3

    @property
    def is_step(self) -> bool:
        """Whether there is inertia or damping."""
        return self.inertia is not None or self.quadratic is not None

    @property
    def push(self) -> Array:
        """Load (N,) [N] on the free unknowns."""
        return self.push_at(self.origin)

    @property
    def refinable(self) -> bool:
        """Whether its states can be refined in extended precision: the energies of the shell alone have that."""
        return not self.is_step and self.further is None

    @property
    def is_dead(self) -> bool:
        """Whether the load leaves the Hessian alone."""
        return self.live is None

    def push_at(self, x: Array) -> Array:
        """Load (N,) [N] on the free unknowns at x."""
        return np.asarray(self.shell.unknowns.restrict(self.force(x).ravel()))

    def force(self, x: Array) -> Array:
        """Load (n, 3) [N] at x."""
        return self.load if self.live is None else self.load + self.live.force(x)

    def loaded(self, share: float) -> Self:
        """The same problem under a share of the load."""
        return replace(self, load=share * self.load, live=None if self.live is None else self.live.scaled(share))

    def frozen(self, x: Array) -> Potential:
        """The same potential under dead loads: those that change as they are at x."""
        return replace(self, load=self.force(x), live=None)

    @property
    def weights(self) -> Array:
        """Share of each free unknown in the mass."""
        return self.shell.unknowns.masses(self.shell.mass) / float(self.shell.mass.sum())

    def difference(self, x: Array, y: Array) -> Array:
        """``x - y`` on the free unknowns (N,)."""
        return np.asarray(self.shell.unknowns.values((x - y).ravel()))

    def critical_mode(self, hessian: sps.csc_array) -> tuple[float, Array]:
        """Eigenvalue [1/s^2] nearest to zero, over the mass, and its direction (N,)."""
        return TangentStiffness(self.shell, hessian, self.factoriser).nearest_mode()

    def potential(self, x: Array) -> tuple[float, Array]:
        """Potential [J], and its gradient on the free unknowns (N,) [N]."""
        energy, gradient = self.shell.energy_gradient(x)
        outer, pull = self._outer(x)
        value, total = energy + outer, gradient + pull
        if self.live is not None:
            value += self.live.energy(x)
            total -= self.live.force(x)
        if self.further is not None:
            value += self.further.value(x)
            total += self.further.gradient(x)
        return value, np.asarray(self.shell.unknowns.restrict(total.ravel()))

    def residual(self, x: Array) -> Array:
        """Gradient on the free unknowns (N,) [N]."""
        return self.potential(x)[1]

    def linearise(
        self, x: Array, geometric: int, stresses: list[Array] | None = None, led: Array | None = None
    ) -> tuple[Array, sps.csc_array]:
        """Gradient (N,) on the free unknowns, and Hessian with the energy's internal unknowns after them.

        The gradient holds the held vertices' part of a step ``led`` (n, 3) [m].
        """
        with self.costs.part("assembly"):
            _, gradient, data = self.shell.energy_gradient_hessian(x, geometric, stresses)
            total, matrix = gradient + self._outer(x)[1], self.matrix(x, data, geometric)
            if self.live is not None:
                total -= self.live.force(x)
            if led is not None and led.any():
                total += self.shell.pattern.product(data, led.ravel()).reshape(-1, 3)
            if self.further is not None:
                total += self.further.gradient(x)
            return self.shell.unknowns.restrict(total.ravel()), matrix

    def prepared(
        self, x: Array, geometric: int, stresses: list[Array] | None = None
    ) -> tuple[Array, Callable[[], sps.csc_array]]:
        """Gradient (N,), and what makes the Hessian: the last iterate of a step needs none."""
        if not self.is_step:
            return super().prepared(x, geometric, stresses)
        with self.costs.part("assembly"):
            gradient = self.residual(x)

        def hessian() -> sps.csc_array:
            with self.costs.part("assembly"):
                return self.matrix(x, self.shell.hessian(x, geometric, stresses), geometric)

        return gradient, hessian

    def matrix(self, x: Array, data: Array, geometric: int) -> sps.csc_array:
        """Hessian by the entries ``data`` of the energy's, to which those of all else are added."""
        if self.quadratic is not None:
            data += self.quadratic
        if self.inertia is not None:
            data[self.shell.pattern.diagonal] += np.repeat(self.inertia, 3)
        if self.live is not None:
            self.live.add_stiffness(self.shell.pattern, x, data)
        if self.further is None:
            matrix = self.shell.pattern.free_matrix(data)
        else:
            matrix = self.further.matrix(self.shell, data, x, exactly=geometric == EXACT)
        return sps.csc_array(matrix.T) if self.unsymmetric else matrix  # the transposed arrays are those of CSR

    @property
    def unsymmetric(self) -> bool:
        """Whether the Hessian is unsymmetric, as loads have no potential."""
        return self.live is not None and not self.live.conservative

    def dragged(self, x: Array, drag: float) -> Potential:
        """The same potential with ``drag |y - x|^2 / 2`` added, in the norm of the mass."""
        inertia = drag * self.shell.mass if self.inertia is None else self.inertia + drag * self.shell.mass
        return replace(self, load=-self._outer(x)[1], origin=x, inertia=inertia)

    def factor(self, hessian: sps.csc_array) -> Factor:
        """Factor of a Hessian, definite or not; SolverError if it is singular."""
        with self.costs.part("factorisation"):
            of = self.factoriser_of(hessian)
            return self.condensed(general_factor(hessian, of) if self.unsymmetric else of.symmetric(hessian))

    def factoriser_of(self, hessian: sps.csc_array) -> Factoriser:
        """What factorises a Hessian."""
        return self.factoriser if self.further is None else self.further.factoriser_of(hessian, self.factoriser)

    def definite_factor(self, hessian: sps.csc_array) -> Factor | None:
        """Factor of a Hessian that is positive definite, has such a half, or oscillates; None for any other."""
        with self.costs.part("factorisation"):
            try:
                factor = self.factoriser_of(hessian).definite(symmetric_half(hessian) if self.unsymmetric else hessian)
                if factor.is_definite():
                    return self.condensed(factor)
                if self.unsymmetric:
                    whole = self.condensed(general_factor(hessian, self.factoriser_of(hessian)))
                    if oscillates(whole, self.shell.unknowns.masses(self.shell.mass)):
                        return whole
            except SolverError:
                pass
            return None

    def condensed(self, factor: Factor) -> Factor:
        """A factor for the positions' unknowns: the gradient by internal ones is zero, as the energy is least there."""
        return condensed_factor(factor, self.shell.pattern.internal_count)

    def keeps_factor(self, length: float) -> bool:
        """Whether the factor of a Hessian serves for another, where no vertex differs by ``length`` [m]."""
        return length < self.kept_within * self.shell.size

    def step(self, factor: Factored, gradient: Array) -> Array:
        """Newton direction (N,)."""
        with self.costs.part("solution"):
            return factor.solve(-gradient)

    def direction(
        self, x: Array, hessian: sps.csc_array, gradient: Array, kept: Kept | None, accuracy: float
    ) -> tuple[Factored, Array]:
        """Newton direction (N,), by the kept factor as long as that costs less than a new one; and the factor."""
        if kept is not None and isinstance(kept.factor, Factor):
            found = self._solution(kept.factor, hessian, gradient, accuracy, turned_axes(self.shell, kept.at, x))
            if found is not None:
                return kept.factor, found
        if self.is_step:
            of = self.factoriser_of(hessian)
            with self.costs.part("factorisation"):
                near = definite_half(hessian, of) if self.unsymmetric else of.rough(hessian)
            if near is not None and (found := self._solution(near, hessian, gradient, accuracy)) is not None:
                return self.condensed(near), found
        return super().direction(x, hessian, gradient, kept, accuracy)

    def _solution(
        self, factor: Factor, hessian: sps.csc_array, gradient: Array, accuracy: float, axes: Array | None = None
    ) -> Array | None:
        with self.costs.part("solution"):
            by = unsymmetric_by_kept_factor if self.unsymmetric else solution_by_kept_factor
            return by(factor, hessian, -gradient, accuracy, axes)

    def moved(self, x: Array, direction: Array, reach: float | None = None) -> tuple[Array, list[Array], float]:
        """Positions and stresses after a :func:`warped_step`, and how much of ``direction`` (N,) that is."""
        turn = method.LARGEST_TURN if reach is None else reach

        def move(part: float) -> Moved:
            moved, step, share = warped_step(self.shell, x, direction if part == 1.0 else part * direction, turn)
            return moved, self.shell.predicted_stresses(x, step), part * share

        return move(1.0) if self.further is None else self.further.bounded(move, x)

    def rounding(self, x: Array, hessian: sps.csc_array, length: float) -> float:
        """Residual that the rounding of positions alone leaves: each force by eps times its stiffness times ``|x|``.

        A stiff membrane under a light load (thin sheets with L/h of a thousand) cannot be balanced further in double
        precision; :mod:`modalshell.statics.refine` continues from there.
        """
        if length > STILL * self.shell.size:
            return 0.0
        return EPSILON * float(np.abs(x).max()) * float(np.linalg.norm(hessian.diagonal()))

    def descend(self, start: Array, scale: float) -> NewtonResult:
        """Go downhill to a minimum; see :func:`.mixed_newton.descend`."""
        if self.unsymmetric:
            return self._settle(start, scale)
        state = _Descent(self, start, scale)
        return state.result(method.descend(state, rules_of(self, method.GOAL)))

    def _settle(self, start: Array, scale: float) -> NewtonResult:
        """Descend under dead loads, those of the last answer each time, until Newton's method ends at a minimum."""
        x, iterations = start, 0
        for _ in range(_SETTLING):
            calm = self.frozen(x).descend(x, scale)
            x = calm.point
            result = mixed_newton(self, x, scale, stresses=_present(self.shell, x))
            iterations += calm.iterations + result.iterations
            if is_minimum(self, result):
                return replace(result, iterations=iterations)
        if not result.converged:  # in balance or not, the residual is that of the answer
            result = replace(result, point=x, residual=self.measure(self.residual(x)) / scale)
        return replace(result, iterations=iterations, converged=False)

    def _product(self, u: Array) -> Array:
        product = np.zeros_like(u) if self.inertia is None else self.inertia[:, None] * u
        if self.quadratic is not None:
            product += self.shell.pattern.product(self.quadratic, u.ravel()).reshape(-1, 3)
        return product


@final
class _Descent(Iterate[sps.csc_array]):
    """An iterate of a shell's potential that goes downhill."""

    problem: Potential

    def __init__(self, problem: Potential, start: Array, scale: float, stresses: list[Array] | None = None) -> None:
        super().__init__(problem, start, scale, stresses)
        self._free, self._bare = problem, stresses is None

    def is_minimum(self) -> bool:
        """Whether the exact Hessian is definite, or with inertia in it the last one on the way.

        A kept factor is that of an earlier iterate, since which conjugate gradients have met no direction of negative
        curvature. A first Hessian without its geometric part says nothing of a minimum.
        """
        if not self.problem.is_step or self.factor is None or self.moves < 1 + self._bare:
            self.factor = self.problem.definite_factor(self.problem.linearise(self.x, EXACT)[1])
            self.factored_at = self.x.copy()
        self.stable = self.factor is not None and self.factor.is_definite()
        return self.stable

    def potential(self) -> tuple[float, float]:
        """Potential and residual."""
        value, gradient = self.problem.potential(self.x)
        return value, self.problem.measure(gradient) / self.scale

    def drag(self, factor: float) -> None:
        """Add a drag about START, or leave it out."""
        self.problem = self._free.dragged(self.slots[method.START].copy(), factor) if factor else self._free
        self.stresses = _present(self.problem.shell, self.x)
        self.factor, self.factored_at, self.moves, self._keeping, self._bare = None, None, 0, True, False
        self._sizes = 0.0, 0.0

    def first_drag(self, size: float) -> float:
        """Drag to begin with."""
        shell, length = self.problem.shell, descent_length(self.problem.shell, turns=self._free.is_step)
        return size * self.scale / (float(np.linalg.norm(shell.mass[shell.free])) * method.FIRST_MOVE * length)

    def point_downhill(self) -> float:
        """Find the lowest mode of the exact Hessian."""
        problem, shell = self.problem, self.problem.shell
        try:
            tangent = TangentStiffness(shell, problem.linearise(self.x, EXACT)[1], problem.factoriser)
            lowest, direction = tangent.lowest_mode()
        except SolverError:
            lowest, direction = 0.0, np.zeros(self.problem.push.size)
        self._way = sized_way(shell, direction, turns=self._free.is_step)
        return lowest

    def step_aside(self, fraction: float) -> None:
        """Move along that mode, warped, so that the shell bends."""
        start = self.slots[method.START]
        self.x[:] = warped_step(self.problem.shell, start, fraction * self._way, method.LARGEST_TURN)[0]


def _present(shell: Shell, x: Array) -> list[Array]:
    """Stresses of every element at ``x``: with them the first mixed step has the exact Hessian."""
    return shell.predicted_stresses(x, np.zeros_like(x))


def solve(
    problem: Potential,
    start: Array,
    scale: float,
    goal: float = method.GOAL,
    stresses: list[Array] | None = None,
    near: NewtonResult | None = None,
    begin: Array | None = None,
) -> NewtonResult:
    """One implicit step: mixed Newton, and descent where it fails or ends at no minimum.

    A descent begins at ``begin``, by default at the ``start``. The factor of ``near``, the result of an earlier step of
    the same length, may serve this one, too.
    """
    begin = start if begin is None else begin
    if not problem.unsymmetric:
        state = _Descent(problem, start, scale, stresses)
        state.slots[method.START] = begin
        state.keep(near)
        return state.result(method.solve_step(state, rules_of(problem, goal)))
    result = mixed_newton(problem, start, scale, goal=goal, stresses=stresses, near=near)
    # As in descents: the last Hessian on the way stands for the end's if it has its geometric part.
    if is_minimum(problem, result, exactly=result.iterations < 1 + (stresses is None)):
        return result
    fallback = problem.descend(begin, scale)
    fallback.iterations += result.iterations
    return fallback if fallback.converged or not result.converged else replace(result, iterations=fallback.iterations)
