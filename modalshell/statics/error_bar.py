"""Error of a static answer against discrete shells, without solving these: two mixed Newton steps and a margin.

From the answer x two steps of mixed Newton are taken, as DS takes them,

    K_1(x) d_0 = -g(x),        x_1 = W(x, d_0),      s_1 = s(x) + ds(x)[d_0],
    K_M(x_1, s_1) d_1 = -g(x_1),   x_2 = W(x_1, d_1),    s_2 in the same way,

with the gradient g of the potential, the first part K_1 of its Hessian, the mixed Hessian K_M with predicted stresses,
and warped steps W (theory 8, eq. 1 to 3; theory 14, eq. 1 to 4). The estimated error is ``|x_2 - x| / |x_2 - rest|`` in
the norm of the mass.
The stability margin is the least ``v . K_M(x_2, s_2) v / v . K_1(x_2) v``, with the predicted stresses: those of x_2
itself hold what is left of the membrane's residual, and say nothing.

Vertices that constraints lead are held where these want them: the first step brings them there from where they are.

Steps alone are blind to branches: past a snap they find the branch that DS has left, and call the answer right. The
margin alone is blind to modes that an answer lacks.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.core.errors import SolverError
from modalshell.core.timings import Stopwatch, Timings
from modalshell.core.typing import Array
from modalshell.core.units import in_percent
from modalshell.modes import Factor, Factoriser, lowest_eigenvalue
from modalshell.shell import GAUSS_NEWTON, MIXED, Shell
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.margin import LITTLE_STEP, Begun, Margin, lowest_ratio, probe
from modalshell.statics.potential import Potential
from modalshell.statics.warped import led_step
from modalshell.supports.constraints import LedVertices

LEAST_MARGIN = 0.3
"""Margin above which a bar holds."""
LARGEST_BAR = 0.3
"""Bar above which two steps tell that the error is large, but not how large."""
QuickCheck = Callable[[Array, Array], tuple[Array, float] | None]
"""Positions (n, 3) [m] after a bar's steps and the margin, from positions and load (n, 3), or None."""
_STEPS = 2
_NOTHING = 1e-14
"""Displacement, in sizes of the shell, that is none."""
_THERE = 1e-6
"""Such a one up to which a led vertex is put in its place before the first step."""
_SLIGHT = 1e-3
"""Third step, as a share of the displacement, that any factor may take."""
_LARGE, _CONTRACTS, _ALIKE = 0.1, 0.9, 0.1
"""Bar from which steps must contract; the second over both, up to which they do; and what a third may change of it."""
_FEEBLE = 0.1
"""What the stresses take of the stiffness up to which no critical load is predicted."""


@final
@dataclass(frozen=True, repr=False)
class ErrorBar:
    """How far an answer is from that of discrete shells on the same mesh, by their own equations.

    It holds where ``valid``: where the stability margin is above 0.3. There it was within 0.95 and 1.1 of the true
    error in all cases measured, as long as it is at most 0.3; a larger one only says so. Elsewhere the answer stands
    near the end of its branch or past it, and the bar is void: :class:`modalshell.DiscreteShell` may be elsewhere
    altogether.

    Attributes
    ----------
    displacement : float
        Estimated error, as of :func:`modalshell.measure.displacement_error`: a share of the displacement. If the
        second step cancels most of the first, and a third one disagrees, it is the sum of their lengths.
    margin : float
        Stability margin: the least ratio of the stiffness under stress to that without; 1 without stress, 0 where the
        branch ends, minus infinity where there is a ``message``.
    critical_load : float
        Factor on the load at which the branch is expected to end. At no further cost that is ``1 / (1 - margin)``:
        infinite where stresses do not soften the shell, 0 where there is a ``message``, and for ends that are near, as
        it grows with the load elsewhere. Where the branch was ``walked``, it is the end found there, infinite above 4.
    valid : bool
        Whether the bar holds.
    corrected : ndarray, shape (n, 3)
        The answer after two steps [m], on the shell that the bar was found on.
    seconds : float
        Wall time.
    message : str
        Why the bar could not be found at all; empty otherwise.
    on : str
        "shell", or "coarse" where it was found on a coarse shell, whose own error is a floor to it.
    walked : bool
        Whether the critical load was found by a walk along the branch.
    """

    displacement: float
    margin: float
    critical_load: float
    valid: bool
    corrected: Array
    seconds: float
    message: str = ""
    on: str = "shell"
    walked: bool = False

    @property
    def beyond(self) -> bool:
        """Whether the error is larger than the bar can measure: beyond 30 %."""
        return not self.displacement <= LARGEST_BAR

    def __repr__(self) -> str:
        return f"ErrorBar({self})"

    def __str__(self) -> str:
        if self.message:
            return f"no error bar: {self.message}"
        text, end = bar_as_text(self.displacement, self.margin), self.critical_load
        if not self.walked:
            return text
        near = f"its branch ends at about {end:.2g} times the load"
        return f"{text}; {near if np.isfinite(end) else 'no end of its branch is near'}"


def bar_as_text(displacement: float, margin: float) -> str:
    """What a bar says, or that it is void."""
    if not margin > LEAST_MARGIN:
        where = "past the end of its branch" if margin <= 0.0 else "near the end of its branch"
        return f"void: the answer is {where} (stability margin {margin:.2f}, must exceed {LEAST_MARGIN:g})"
    error = share_as_text(displacement) if displacement <= LARGEST_BAR else f"beyond {100.0 * LARGEST_BAR:.0f} %"
    taken = 1.0 - margin
    return f"{error} from DS" + (f"; {100.0 * taken:.0f} % of the way to a snap" if taken > _FEEBLE else "")


def share_as_text(error: float) -> str:
    """A share in percent, to two digits."""
    return "less than 0.1 %" if error < 1e-3 else in_percent(error)


class Estimator(ABC):
    """Finds error bars of answers of one shell, one after the other; the order of elimination is found once.

    A subclass takes Newton's steps, and where more is held than the supports hold says what motions are left.

    Parameters
    ----------
    shell : Shell
        A shell that its supports hold.
    led : LedVertices, optional
        Further vertices that constraints lead.

    Attributes
    ----------
    costs : Timings
        Seconds of assembly, factorisation and solution so far.
    last : LastStep or None
        What the last bar has left for bars of quantities.
    """

    def __init__(self, shell: Shell, led: LedVertices | None = None) -> None:
        self._free, self.origin = shell.centred()
        self.shell = self._free if led is None else self._free.holding(led.vertices)
        self._led = led
        self.costs = Timings()
        self.last: LastStep | None = None
        self._factoriser = Factoriser()
        self._way: Array | None = None

    def bar(
        self,
        positions: Array,
        load: Array,
        live: LiveLoads | None = None,
        on: str = "shell",
        time: float = 0.0,
        ahead: Array | None = None,
    ) -> ErrorBar:
        """The bar of an answer at ``positions`` (n, 3) [m] under a dead ``load`` (n, 3) [N] and ``live`` ones.

        Constraints lead vertices to where these are at ``time`` [s]. With ``ahead`` (n, 3) [m] stresses are those at
        ``positions + ahead``, as of a shell that damps its rates of strain; the bar is that of ``positions``.
        """
        watch, shell = Stopwatch(), self.shell
        further = np.zeros_like(positions) if ahead is None else ahead
        x = _allowed(self._free, positions + further - self.origin)
        if (led := self._led) is not None:
            self._way = led.way(x, led.at(time) + further[led.vertices] - self.origin, _THERE * shell.size)
        self.last = None
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                corrected, margin = self._found(x, load, live)
        except SolverError as error:
            return ErrorBar(np.inf, -np.inf, 0.0, False, positions.copy(), watch(), str(error), on)
        moved, off = self.length(corrected - further - shell.rest_positions), self.length(corrected - x)
        tiny = _NOTHING * shell.size * float(np.sqrt(shell.mass.sum()))
        displacement = 0.0 if off <= tiny else off / max(moved, tiny)
        if displacement > _LARGE:
            displacement = max(displacement, self._astray(x, load, live) / max(moved, tiny))
        critical, valid = (1.0 / (1.0 - margin) if margin < 1.0 else np.inf), margin > LEAST_MARGIN
        return ErrorBar(displacement, margin, critical, valid, corrected - further + self.origin, watch(), on=on)

    def _found(self, x: Array, load: Array, live: LiveLoads | None) -> tuple[Array, float]:
        """Positions (n, 3) [m] after Newton's steps from x (n, 3), and the stability margin there."""
        problem = self.problem(load, live)
        corrected, stresses = self._steps(problem, x)
        return corrected, self.margin(problem, corrected, stresses).value

    def problem(self, load: Array, live: LiveLoads | None = None) -> Potential:
        """The shell's potential, about the origin, under a dead load (n, 3) [N] and live ones."""
        live = None if live is None else replace(live, origin=self.origin)
        return Potential(load, self.shell.rest_positions, self.shell, self._factoriser, self.costs, live)

    def _astray(self, x: Array, load: Array, live: LiveLoads | None) -> float:  # noqa: ARG002 (of two steps alone)
        """Length [kg^(1/2) m] of the steps from x (n, 3) where these lead nowhere; else, and of more than two, zero."""
        return 0.0

    @abstractmethod
    def _steps(self, problem: Potential, x: Array) -> tuple[Array, list[Array]]:
        """Positions (n, 3) [m] and predicted stresses after Newton's steps; SolverError where they lead nowhere."""

    def _led_step(self, x: Array, direction: Array, way: Array) -> tuple[Array, list[Array]]:
        """Positions and stresses after a step along a direction (N,) and a way (n, 3) [m] of what is led."""
        assert self._led is not None
        vertices, step = self._led.vertices, way + self.shell.unknowns.prolong(direction).reshape(-1, 3)
        return led_step(self._free, self.shell, x, step, (vertices, (x + way)[vertices]), np.inf)[:2]

    def margin(self, problem: Potential, x: Array, stresses: list[Array]) -> Margin:
        """The stability margin at x (n, 3) with predicted stresses."""
        shell, unknowns, pattern = self.shell, self.shell.unknowns, self.shell.pattern
        stiffness, stressed = shell.hessian(x, GAUSS_NEWTON), shell.hessian(x, MIXED, stresses)
        difference = stressed - stiffness
        if problem.live is not None:
            problem.live.add_stiffness(pattern, x, difference)
        geometric, symmetric = pattern.matrix(difference), problem.live is None or problem.live.conservative
        factor = self._factor(replace(problem, live=None), pattern.free_matrix(stiffness))
        if factor is None:
            raise SolverError("two Newton steps lead to a shape without stiffness: the answer is far from any of DS")

        def softening(values: Array) -> Array:
            along = self._along(values)
            product = geometric @ (moved := unknowns.prolong(along))
            if not symmetric:  # a shell whose symmetric half is stiff does not drift away
                product = 0.5 * (product + geometric.T @ moved)
            return self._across(along, np.asarray(unknowns.restrict(product)))

        start = self._across(np.zeros(unknowns.count), probe(unknowns.count))
        found = lowest_ratio(factor.solve, softening, start)
        self.last = LastStep(problem, x, stressed, found.direction, factor)
        return found

    def _factor(self, problem: Potential, stiffness: sps.csc_array) -> Factor | None:
        """Factor of a stiffness on the motions that are left; None where it is not positive definite."""
        return problem.definite_factor(stiffness)

    def _along(self, values: Array) -> Array:
        """Motion (N,) of values of the motions that are left."""
        return values

    def _across(self, along: Array, force: Array) -> Array:  # noqa: ARG002 (of what is held, and turns with the motion)
        """Force (N,) on the motions that are left, by a motion ``along`` that had a ``force`` (N,)."""
        return force

    def refined(self) -> tuple[Array, list[Array]]:
        """Positions (n, 3) [m] after a third step from the last bar's, and the stresses that it predicts.

        By the factor that its margin has left, where that is short; else by the mixed Hessian there, whose stresses
        may make the shell far stiffer, or softer, than without them, and where that is no little step by a fourth.
        """
        last = self._last()
        problem, moved = last.problem, self.length(last.x - self.shell.rest_positions)
        with np.errstate(over="ignore", invalid="ignore"):
            x, stresses, _ = problem.moved(last.x, problem.step(last.factor, problem.residual(last.x)))
            if not self.length(x - last.x) <= _SLIGHT * moved:
                with contextlib.suppress(SolverError):
                    factor = problem.factor(problem.matrix(last.x, last.stressed.copy(), MIXED))
                    x, stresses, _ = problem.moved(last.x, problem.step(factor, problem.residual(last.x)))
                    if not self.length(x - last.x) <= LITTLE_STEP * moved:
                        gradient, hessian = problem.linearise(x, MIXED, stresses)
                        x, stresses, _ = problem.moved(x, problem.step(problem.factor(hessian), gradient))
            return np.asarray(x + self.origin), stresses

    def lowest_eigenvalue(self, x: Array, stresses: list[Array]) -> float:
        """Lowest squared angular frequency [1/s^2] of DS about what :meth:`refined` found, by these stresses."""
        problem = self._last().problem
        hessian = problem.linearise(x - self.origin, MIXED, stresses)[1]
        return lowest_eigenvalue(self.shell, hessian, self._factoriser, symmetric=not problem.unsymmetric)

    def _last(self) -> LastStep:
        if self.last is None:
            raise SolverError("no bar has been found yet")
        return self.last

    def length(self, displacement: Array) -> float:
        """Of displacements (n, 3) [m], in the norm of the mass [kg^(1/2) m]."""
        return float(np.sqrt(np.sum(self.shell.mass[:, None] * displacement**2)))


@final
class ErrorEstimator(Estimator):
    """That of answers whose supports alone hold the shell: two mixed steps.

    Parameters
    ----------
    shell, led
        As above.
    compiled : callable, optional
        Finds the same, of the shell about the origin under dead loads, by compiled code: positions after the steps and
        the margin, from positions and load (n, 3); None where it finds no margin, and sparse algebra says why. It
        leaves nothing for bars of quantities.
    early : bool
        Whether sparse algebra under dead loads, too, may find the margin before the second step, where this is short,
        by its factor: without a third one, and nothing is left for bars of quantities then.
    """

    def __init__(
        self,
        shell: Shell,
        compiled: QuickCheck | None = None,
        *,
        early: bool = False,
        led: LedVertices | None = None,
    ) -> None:
        super().__init__(shell, led)
        self._compiled, self._early = compiled, early
        self._taken: tuple[Array, list[Array], Begun] | None = None

    def _found(self, x: Array, load: Array, live: LiveLoads | None) -> tuple[Array, float]:
        """By compiled code where that serves."""
        self._taken = None
        serves = self._compiled is not None and live is None and self._way is None
        found = self._compiled(x, load) if self._compiled is not None and serves else None
        if found is None and self._early and live is None:
            problem = self.problem(load)
            corrected, stresses, begun = self._both_steps(problem, x)
            ways = self.length(corrected - begun.x), self.length(corrected - self.shell.rest_positions)
            margin = begun.margin(self.shell, *ways)
            found = corrected, self.margin(problem, corrected, stresses).value if margin is None else margin
        return super()._found(x, load, live) if found is None else found

    def _steps(self, problem: Potential, x: Array) -> tuple[Array, list[Array]]:
        """Positions (n, 3) [m] and predicted stresses after two steps; SolverError where they leave all numbers."""
        return self._both_steps(problem, x)[:2]

    def _both_steps(self, problem: Potential, x: Array) -> tuple[Array, list[Array], Begun]:
        """The same, and where the second step began."""
        stresses: list[Array] | None = None
        begun: Begun | None = None
        for _ in range(_STEPS):
            geometric, way = (GAUSS_NEWTON, self._way) if stresses is None else (MIXED, None)
            gradient, hessian = problem.linearise(x, geometric, stresses, way)
            found = begun.direction(self.shell, x, hessian, gradient) if begun is not None and self._early else None
            if begun is not None and found is not None:
                begun = Begun(x, hessian, begun.factor, unstressed=True)
            else:
                factor = problem.factor(hessian)
                begun, found = Begun(x, hessian, factor), problem.step(factor, gradient)
            x, stresses = problem.moved(x, found)[:2] if way is None else self._led_step(x, found, way)
            if not np.isfinite(x).all():
                raise SolverError("two Newton steps from this answer leave the finite numbers")
        assert stresses is not None
        assert begun is not None
        self._taken = x, stresses, begun
        return self._taken

    def _astray(self, x: Array, load: Array, live: LiveLoads | None) -> float:
        """By the second step and, where that is as long as both, a third one, which must find about the same error."""
        problem = self.problem(load, live)
        end, stresses, begun = self._taken or self._both_steps(problem, x)
        off, first, second = (self.length(way) for way in (end - x, begun.x - x, end - begun.x))
        if second <= _CONTRACTS * off:
            return 0.0
        gradient, hessian = problem.linearise(end, MIXED, stresses)
        further = problem.moved(end, problem.step(problem.factor(hessian), gradient))[0]
        return 0.0 if abs(self.length(further - x) - off) <= _ALIKE * off else first + second


@final
@dataclass(frozen=True, eq=False)
class LastStep:
    """Where the two steps of a bar ended."""

    problem: Potential = field(repr=False)
    """The shell's potential under the load, about the origin."""
    x: Array
    """Corrected positions [m]; shape (n, 3)."""
    stressed: Array
    """Entries of the mixed Hessian there, without that of live loads."""
    direction: Array
    """The shape in which the shell has the least margin; shape (N,)."""
    factor: Factor = field(repr=False)
    """Of the first part of the Hessian there."""


def _allowed(shell: Shell, positions: Array) -> Array:
    """Positions (n, 3) nearest to given ones that the supports allow."""
    moved = positions - shell.rest_positions
    moved[shell.clamped] = 0.0
    return np.asarray(shell.rest_positions + shell.unknowns.project(moved))
