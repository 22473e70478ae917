"""Ways downhill with contacts, for where Newton's steps with active sets lead to no minimum.

A stiff membrane is led in a thick fluid: each of its steps is a minimum, found by mixed Newton, which does not feel the
membrane; the drag falls with success. A limp sheet buckles in such steps, and their sets cycle: it goes by single
steps instead, along the Hessian that each element's own makes definite, each as far as the potential falls. Which of
the two serves shows on the way. Both end by Newton's steps of the potential itself; saddles are left.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.active_set import PULL, WHOLE, ActiveSet, Rest
from modalshell.contact.rotated import Rotated
from modalshell.contact.touching import put_out
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.modes import TangentStiffness
from modalshell.shell import EXACT, PROJECTED
from modalshell.statics import mixed_newton as method
from modalshell.statics.warped import descent_length, sized_way, warped_step

_SUB_STEP = 15
"""Iterations at most of a step in the thick fluid."""
EASY = 7
FALL, RISE = 0.25, 6.0
"""Iterations of such a step up to which the drag falls, and factors on it after a success and a failure."""
FAILURES = 12
"""Failures of steps, one after the other, after which there is no way."""
_MOST = 900
"""Iterations from which no further step is taken."""
_PAUSE, _LONGER = 8, 4
"""Single steps after the first failure in the fluid, and by how many times more after each further one."""
_THICKER = 2
"""Failures off a saddle after which single steps are gone: a way that curves down fails in a fluid that is too thin."""
_BACK = 0.1
"""Share of what the potential has fallen from the last saddle by which a step may rise."""
_ULPS = 1e-15
"""Share of itself by which the potential always may rise."""
_STIFF = 1e-4
"""First drag where vertices are to be pushed out, as a share of the mean stiffness over the mean mass."""
_LEAST = 1e-3
"""Least drag of a single step that has failed, over the first one of the fluid."""
_FALLEN = 1e-4
"""Fall of the potential in a single step, over that of its tangent, at least."""
_SHORTEST, _LONGEST = 1e-3, 256.0
"""Least and largest part of a single step that is tried."""
_LONG = 0.9
"""Share of a step from which the drag of the next one falls."""
_SHORT = 0.2
"""Part of a single step below which the drag of the next one rises."""
_STEEPER = 10.0
"""Factor on that drag after a step in vain."""
_MIX = 0.25
"""Share of the exact Hessian to begin with."""
_LAST = 10
"""Iterations of the potential itself at most, by which a way ends."""
_NEARER = 0.1
"""Residual from which a way tries to end once more, over that of the try before."""


def descend(solver: ActiveSet, start: Array, rules: method.Rules, *, singles: int = 0) -> Rest:
    """Minimum that a way downhill from ``start`` (n, 3) leads to; saddles, in which symmetric ways end, are left.

    It begins by ``singles`` single steps, then goes into the fluid.
    """
    way = _Way(solver, start, singles)
    tried, saddles = np.inf, 0
    while way.failures < FAILURES and way.iterations < _MOST:
        went = way.go()
        if not went or way.residual > method.NEAR or way.residual > _NEARER * tried:
            continue
        tried = way.residual
        if (last := way.end(rules)) is None:
            continue
        if last.stable:
            return replace(last, iterations=way.iterations)
        if saddles == method.SADDLES:
            break
        way.leave(last)
        tried, saddles = np.inf, saddles + 1
    return way.rest()


def first_drag(solver: ActiveSet, x: Array) -> tuple[float, float]:
    """Potential at x (n, 3), infinite where vertices lie inside, and a drag to begin with."""
    shell = solver.problem.shell
    value, gradient = solver.potential(x)
    drag = float(np.linalg.norm(gradient))
    drag /= float(np.linalg.norm(shell.mass[shell.free])) * method.FIRST_MOVE * descent_length(shell, turns=True)
    if solver.is_inside(x):
        value = np.inf
        diagonal = solver.linearise(x, EXACT)[1].diagonal()
        drag = max(drag, _STIFF * float(np.abs(diagonal).mean() / shell.mass.mean()))
    return value, drag


@final
class _Way:
    """A way downhill from ``start`` (n, 3), and where it has come to; ``singles`` is how many single steps begin it.

    Attributes
    ----------
    x, active : ndarray
        Positions (n, 3) [m] and rows in contact there.
    value, residual : float
        Potential there, infinite where vertices lie inside, and residual near there.
    drag, shift : float
        Drags of the next step in the fluid and of the next single one.
    mix : float
        Share of the exact Hessian in that of single steps near the end.
    left : float
        Potential at the saddle that was left last.
    iterations, failures : int
        Newton's, of all steps, and steps in vain since the last one that was not.
    """

    def __init__(self, solver: ActiveSet, start: Array, singles: int) -> None:
        self.solver, self.x, self.active = solver, start, solver.near(start)
        self.value, self.drag = first_drag(solver, start)
        self.least, self.shift, self.mix = _LEAST * self.drag, 0.0, _MIX
        self.residual, self.iterations, self.failures = np.inf, 0, 0
        self._waits, self._pause = singles, _PAUSE
        self.left = -np.inf

    def rest(self) -> Rest:
        """Where it has come to, as an end that is none."""
        return Rest(self.x, self.active, np.zeros(self.active.size), self.residual, self.iterations, False)

    def _stresses(self) -> list[Array]:
        return self.solver.problem.shell.predicted_stresses(self.x, np.zeros_like(self.x))

    def _potential(self, x: Array) -> float:
        """Potential at x (n, 3), infinite where the way there leads through a collider."""
        return np.inf if self.solver.touching.crossed(self.x, x) else self.solver.potential(x)[0]

    def _falls(self, reached: float) -> bool:
        """Whether a potential is no higher than the present one, which is infinite where vertices lie inside."""
        higher = method.HIGHER * abs(self.value)
        if self.left > self.value:  # or what rounding explains would lead back to that saddle
            higher = min(higher, max(_BACK * (self.left - self.value), _ULPS * abs(self.value)))
        return bool(np.isfinite(reached) and reached <= self.value + higher)

    def go(self) -> bool:
        """Go a step in the fluid, or for some time after one that failed single steps; True if the potential fell."""
        if self._waits:
            self._waits -= 1
            if not (went := self._step()):
                self.shift = max(self.shift * _STEEPER, self.least)
        elif not (went := self._flow()):
            self.drag *= RISE
            if not self.left > self.value or self.failures >= _THICKER:
                self._waits, self._pause = self._pause, _LONGER * self._pause
        self.failures = 0 if went else self.failures + 1
        return went

    def _flow(self) -> bool:
        """Go a step in the thick fluid, unless Newton's method fails in it or the potential rises; whether so."""
        fluid = self.solver.dragged(self.x, self.drag)
        loose = method.Rules(method.LOOSE, method.LOOSE, method.GOAL, 0, _SUB_STEP)
        step = fluid.iterate(self.x, self.active, loose, self._stresses())
        self.iterations += step.iterations
        reached = self._potential(step.point) if step.converged else np.inf
        if not self._falls(reached):
            return False
        if step.iterations <= EASY:
            self.drag *= FALL
        self.x, self.active, self.value = step.point, step.active, reached
        self.residual = self.solver.free_residual(step)
        return True

    def _step(self) -> bool:
        """Go a single step, as far as the potential falls; whether it does."""
        solver, x = self.solver, self.x
        if (newton := self._newton()) is None:
            return False
        equations, hessian, gradient, direction, found = newton
        rows, slope = equations.frames.rows, _FALLEN * abs(float(gradient @ direction))

        def tried(part: float) -> _Tried:
            moved, share, *_ = solver.moved(x, hessian, direction, rows, part)
            put = put_out(solver.touching, moved, np.ones(len(solver.touching.contacts), dtype=bool))
            return _Tried(self._potential(put), share, moved, put)

        part, best = 1.0, tried(1.0)
        while not best.value < self.value - slope * best.share:
            part *= 0.5
            if part < _SHORTEST:
                return False
            best = tried(part)
        while part >= 1.0 and best.share > WHOLE * part and part < _LONGEST:
            part *= 2.0
            further = tried(part)
            if not further.value < best.value:
                break
            best = further
        pushes = np.zeros(self.active.size)
        pushes[rows] = found
        # Forces that push out of a collider are no measure of what is out of balance.
        size = float(np.linalg.norm(equations.unbalanced(gradient))) if self.value < np.inf else np.inf
        self.residual = size / solver.scale(pushes)
        self.x, self.value = best.put, best.value
        self.active = solver.next_set(best.moved, pushes, rows, PULL)
        if best.share > _LONG:
            self.shift *= FALL
        elif part < _SHORT:
            self.shift = max(self.shift / FALL, self.least)
        return True

    def _newton(self) -> tuple[Rotated, sps.csc_array, Array, Array, Array] | None:
        """Newton's equations by a Hessian made definite, it, the gradient, and the solution; None without one.

        Near the end as much of the exact Hessian goes into it as leaves it definite: saddles are passed in fewer steps.
        """
        solver, x = self.solver.dragged(self.x, self.shift), self.x
        rows = np.flatnonzero(self.active)
        gradient, hessian = solver.linearise(x, PROJECTED)
        known, near = hessian.data.copy(), self.residual < method.NEAR
        exact = solver.linearise(x, EXACT)[1].data - known if near else known
        for mix in (self.mix, 0.0) if near else (0.0,):
            hessian.data = known + mix * exact if mix else known.copy()
            gaps = solver.touching.gaps(x, rows)
            equations = Rotated(solver.problem, solver.touching, gradient, hessian, rows, np.zeros(rows.size), gaps)
            self.iterations += 1
            try:
                direction, found = equations.solve(definite=mix > 0.0)
            except SolverError:
                self.mix *= 0.5 if mix else 1.0
                continue
            if mix:
                self.mix = min(1.0, 2.0 * mix)
            return (equations, hessian, gradient, direction, found) if np.isfinite(direction).all() else None
        return None

    def end(self, rules: method.Rules) -> Rest | None:
        """The end of the way by Newton's steps of the potential itself, with its verdict; None if there is none."""
        last = self.solver.iterate(self.x, self.active, rules._replace(most=_LAST), self._stresses())
        self.iterations += last.iterations
        reached = self._potential(last.point) if last.converged else np.inf
        return self.solver.settled(last) if self._falls(reached) else None

    def leave(self, rest: Rest) -> None:
        """Leave a saddle along the lowest mode on the motions that keep the gaps.

        Where the potential does not fall, what nearly touches is in the way: it then touches.
        """
        aside, self.left = _Aside(self.solver, rest), self.solver.potential(rest.point)[0]
        self.value, self.drag = method.leave_saddle(aside, self.left)
        self.x, self.active, self.shift = aside.x, rest.active, 0.0
        if not self.value < self.left:
            aside.step_aside(0.5**method.HALVINGS)
            self.x, self.active = aside.x, rest.active | self.solver.near(aside.x)
            self.value = self.solver.potential(self.x)[0]


class _Tried(NamedTuple):
    """Where a part of a single step leads, before and after what lies inside is put out, and its share."""

    value: float
    share: float
    moved: Array
    put: Array


@final
class _Aside:
    """A saddle with contacts: the operations by which :func:`.mixed_newton.leave_saddle` leaves it."""

    def __init__(self, solver: ActiveSet, rest: Rest) -> None:
        self._solver, self._rest, self.x = solver, rest, rest.point.copy()
        self.slots = np.stack([self.x, self.x])
        self._rows = np.flatnonzero(rest.active)
        self._way = np.zeros(solver.problem.push.size)

    def point_downhill(self) -> float:
        """Find the lowest mode."""
        solver, shell = self._solver, self._solver.problem.shell
        equations = solver.equations(self._rest, EXACT)[0]
        try:
            lowest, turned = TangentStiffness(shell, equations.kept(), solver.problem.factoriser).lowest_mode()
        except SolverError:
            return first_drag(solver, self.x)[1]
        way = equations.frames.turned(turned, back=True)
        self._way = sized_way(shell, way)
        return lowest

    def step_aside(self, fraction: float) -> None:
        """Move along that mode, what touches staying on its collider, and what would enter one coming onto it."""
        shell, start = self._solver.problem.shell, self._rest.point
        self.x[:] = warped_step(shell, start, fraction * self._way, method.LARGEST_TURN)[0]
        touching = self._solver.touching
        touching.put_on(self.x, self._rows, np.zeros(self._rows.size))
        self.x[:] = put_out(touching, self.x, np.ones(len(touching.contacts), dtype=bool))

    def potential(self) -> tuple[float, float]:
        """Potential, infinite where something enters a collider or passes through one."""
        passes = self._solver.is_inside(self.x) or self._solver.touching.crossed(self._rest.point, self.x)
        return (np.inf, np.inf) if passes else (self._solver.potential(self.x)[0], 0.0)
