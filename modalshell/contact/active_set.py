"""Exact contact: a primal-dual active set inside the mixed Newton [hintermueller2002]; theory 13, eq. 1 to 4.

Of the rows that touch, the gaps are prescribed in each of Newton's steps, and what the step leaves out of balance
along their normals are the forces; rows that pull are let go, and rows that entered are taken in. There is no gap left,
and no stiffness to choose. Where the sets cycle, or leave a mechanism, :mod:`.descent` leads the shell downhill.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.friction import Friction
from modalshell.contact.rotated import Rotated
from modalshell.contact.touching import EXACT_GAP, Touching
from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index, Mask
from modalshell.modes import Factor
from modalshell.shell import EXACT, GAUSS_NEWTON, MIXED
from modalshell.statics import mixed_newton as method
from modalshell.statics.potential import Potential
from modalshell.statics.refine import refined

PULL = 1e-9
"""Pull, as a share of the scale of forces, that rounding explains: a row that lies on its collider without force."""
DIRECT = 60
"""Iterations at most from a start; sets change by a few rows an iteration."""
_CUT = 8
"""Steps at most, of one solve, that are cut short, mostly as they would turn a vertex too far: where that goes on, it
ends at nothing."""
_REVISITS = 4
"""Times that one set may come back before sets are taken to cycle."""

WHOLE = 0.999
"""Share of a step from which it counts as whole."""


@final
@dataclass(frozen=True)
class Rest:
    """Where a solve with contacts ended."""

    point: Array
    """Positions [m]; shape (n, 3)."""
    active: Mask
    """Rows that touch; shape (r,)."""
    pushes: Array
    """Forces [N] along the normals; shape (r,)."""
    residual: float
    """Out-of-balance force over the larger of load and contact forces, without either over the forces at the start."""
    iterations: int
    """Newton's."""
    converged: bool
    """Whether the residual met its goal, with sets that repeat."""
    stable: bool | None = None
    """Whether the exact Hessian is positive definite on the motions that keep the gaps."""
    limited: bool = False
    """Whether rounding keeps the residual up."""


@final
class ActiveSet:
    """Solves for the minimum of a potential outside colliders, with the friction of a step in time if there is one.

    ``scale`` is the size of the load [N]; contact forces count where they are larger. Without either, residuals are
    over the forces ``at_start`` [N].
    """

    def __init__(
        self,
        problem: Potential,
        touching: Touching,
        scale: float,
        friction: Friction | None = None,
        *,
        at_start: float = 1.0,
    ) -> None:
        self.problem, self.touching, self._load, self._friction = problem, touching, scale, friction
        self._at_start, self._deep = at_start, EXACT_GAP * touching.size

    @classmethod
    def at_rest(cls, problem: Potential, touching: Touching, start: Array) -> ActiveSet:
        """Those of statics under the problem's own load, from ``start`` (n, 3) [m]."""
        return cls(problem, touching, problem.measure(problem.push), at_start=problem.scale_at(start))

    def near(self, x: Array) -> Mask:
        """Rows (r,) that touch at positions x (n, 3)."""
        return self._movable(x, self.touching.distances(x) <= self._deep)

    def _movable(self, x: Array, chosen: Mask) -> Mask:
        """Those of the chosen rows whose vertices supports let move along their normals."""
        rows = np.flatnonzero(chosen)
        if rows.size:
            chosen = np.zeros_like(chosen)
            chosen[self.touching.movable(x, rows)] = True
        return chosen

    def linearise(
        self, x: Array, geometric: int, stresses: list[Array] | None = None, led: Array | None = None
    ) -> tuple[Array, sps.csc_array]:
        """Gradient (N,) and Hessian of the potential, that of friction with it; see :meth:`Potential.linearise`."""
        gradient, hessian = self.problem.linearise(x, geometric, stresses, led)
        return (gradient if self._friction is None else self._friction.add(x, gradient, hessian)), hessian

    def potential(self, x: Array) -> tuple[float, Array]:
        """Potential [J] and its gradient (N,), those of friction with them."""
        value, gradient = self.problem.potential(x)
        if self._friction is not None:
            value += self._friction.value(x)
            gradient = gradient + self.problem.shell.unknowns.restrict(self._friction.forces(x).ravel())
        return value, gradient

    def scale(self, pushes: Array) -> float:
        """Size of the forces that residuals are relative to [N]."""
        return max(self._load, float(np.linalg.norm(pushes))) or self._at_start

    def iterate(self, start: Array, active: Mask, rules: method.Rules, stresses: list[Array] | None = None) -> Rest:
        """Full mixed Newton steps with active sets from ``start`` (n, 3) and the ``stresses`` predicted there."""
        x = start.copy()
        pushes = np.zeros(active.size)
        best, stalled, allowed, repeated = np.inf, 0, 0.0, False
        seen: dict[bytes, int] = {}
        size, solved, cut = np.inf, False, 0
        for iteration in range(rules.most + 1):
            geometric = GAUSS_NEWTON if stresses is None else MIXED
            gradient, hessian = self.linearise(x, geometric, stresses)
            equations = self._equations_at(x, active, pushes, gradient, hessian)
            size = float(np.linalg.norm(equations.unbalanced(gradient))) / self.scale(pushes)
            if not np.isfinite(size):
                break
            if repeated:
                stalled = 0 if size <= 0.5 * best else stalled + 1
                best = min(best, size)
                solved = size <= max(rules.accepted, allowed)
                if (solved and (size <= rules.goal or stalled > 0)) or stalled == method.STALLED:
                    break
            else:
                best, stalled, solved = np.inf, 0, False
            if iteration == rules.most or cut > _CUT:
                break
            try:
                direction, found = equations.solve()
            except SolverError:
                break
            if not np.isfinite(direction).all():
                break
            x, share, allowed, stresses = self.moved(x, hessian, direction, equations.frames.rows)
            cut += share < WHOLE
            pushes = np.zeros(active.size)
            pushes[equations.frames.rows] = found
            allowed /= self.scale(pushes)
            last, active = active, self.next_set(x, pushes, equations.frames.rows, max(PULL, allowed))
            repeated = bool(share > WHOLE and np.array_equal(last, active))
            if not repeated and active.size:
                key = np.packbits(active).tobytes()
                seen[key] = seen.get(key, 0) + 1
                if seen[key] > _REVISITS:
                    break
        return Rest(x, active, np.where(active, pushes, 0.0), size, iteration, solved, limited=size > rules.accepted)

    def correct(
        self, x: Array, least: int, most: int, way: Array | None, lead: Callable[..., tuple[Array, list[Array]]]
    ) -> tuple[Rest, list[Array]]:
        """At ``least`` so often a step from x (n, 3), until the set repeats, and ``most``; the stresses predicted too.

        The first step goes a ``way`` (n, 3) [m] of held vertices, if there is one: ``lead`` takes it, from positions,
        Newton's direction (N,), and that way. Converged says whether the set repeats. SolverError where the steps leave
        the finite numbers, or that way leads through a collider.
        """
        active, stresses = self.near(x), None
        pushes, repeated, count = np.zeros(active.size), False, 0
        while count < least or not (repeated or count == most):
            gradient, hessian = self.linearise(x, GAUSS_NEWTON if stresses is None else MIXED, stresses, way)
            equations = self._equations_at(x, active, pushes, gradient, hessian)
            direction, found = equations.solve()
            if way is None:
                x, share, _, stresses = self.moved(x, hessian, direction, equations.frames.rows)
            else:
                before, share = x, 1.0
                x, stresses = lead(x, direction, way)
                if self.touching.crossed(before, x):
                    raise SolverError("the way of the constraints from this answer leads through a collider")
                self.touching.put_on(x, equations.frames.rows, np.zeros(equations.frames.rows.size))
                way = None
            count += 1
            if not np.isfinite(x).all():
                raise SolverError("Newton steps from this answer leave the finite numbers")
            pushes = np.zeros(active.size)
            pushes[equations.frames.rows] = found
            last, active = active, self.next_set(x, pushes, equations.frames.rows, PULL)
            repeated = bool(share > WHOLE and np.array_equal(last, active))
        assert stresses is not None
        return Rest(x, active, np.where(active, pushes, 0.0), np.inf, count, repeated), stresses

    def moved(
        self, x: Array, hessian: sps.csc_array, direction: Array, rows: Index, wanted: float = 1.0
    ) -> tuple[Array, float, float, list[Array]]:
        """Where the ``wanted`` part of a step from x (n, 3) leads, with ``rows`` put onto their colliders.

        Also returns the part of it that was taken, the residual that rounding allows there [N], and the stresses.
        """
        moved, stresses, share = self.problem.moved(x, wanted * direction)
        if (part := self.touching.safe_part(x, moved)) < 1.0:
            moved, stresses, within = self.problem.moved(x, part * wanted * direction)
            share = min(share, part * within)
        share *= wanted
        left = max(0.0, 1.0 - share) * self.touching.gaps(x, rows)[0]
        self.touching.put_on(moved, rows, left)
        length = float(np.abs(moved - x).max(initial=0.0))
        return moved, share, self.problem.rounding(moved, hessian, length), stresses

    def next_set(self, x: Array, pushes: Array, kept: Index, pull: float) -> Mask:
        """The next set: rows that do not ``pull``, as a share of the scale, stay, and rows that entered come in."""
        stays = np.zeros(pushes.size, dtype=bool)
        stays[kept] = pushes[kept] > -pull * self.scale(pushes)
        was = np.zeros(pushes.size, dtype=bool)
        was[kept] = True
        return stays | self.entered(x, was)

    def entered(self, x: Array, was: Mask) -> Mask:
        """Rows (r,), those that were in the set left out, that lie inside at positions x (n, 3)."""
        inside = self._movable(x, ~was & (self.touching.distances(x) < -self._deep))
        entered = np.zeros_like(inside)
        entered[self.touching.binding(x, np.flatnonzero(inside))] = True
        return entered

    def equations(self, rest: Rest, geometric: int) -> tuple[Rotated, Array]:
        """Newton's equations at an end, and the gradient there."""
        gradient, hessian = self.linearise(rest.point, geometric)
        return self._equations_at(rest.point, rest.active, rest.pushes, gradient, hessian), gradient

    def _equations_at(self, x: Array, active: Mask, pushes: Array, gradient: Array, hessian: sps.csc_array) -> Rotated:
        """The same at x (n, 3), the gaps of ``active`` rows prescribed, on which forces ``pushes`` (r,) [N] act."""
        rows = np.flatnonzero(active)
        gaps = self.touching.gaps(x, rows)
        return Rotated(self.problem, self.touching, gradient, hessian, rows, pushes[rows], gaps)

    def settled(self, rest: Rest) -> Rest:
        """The end with its verdict, and the forces that balance the shell exactly where it is.

        It is stable where the exact Hessian is positive definite on the motions that keep the gaps. What rounding
        leaves of the balance of a stiff membrane goes with displacements in extended precision.
        """
        if not rest.converged:
            return rest
        equations, gradient = self.equations(rest, EXACT)
        factor = equations.definite_factor()
        if factor is not None and rest.residual > method.ACCEPTED and self.problem.refinable:
            rest, gradient = self._refined(rest, equations, factor)
        pushes = np.zeros(rest.pushes.size)
        pushes[equations.frames.rows] = np.maximum(equations.frames.pushes(gradient), 0.0)
        return replace(rest, pushes=pushes, stable=factor is not None)

    def negative_eigenvalues(self, rest: Rest) -> int:
        """Number of negative eigenvalues of the exact Hessian on the motions that keep the gaps."""
        return self.equations(rest, EXACT)[0].factor().negative_eigenvalues()

    def _refined(self, rest: Rest, equations: Rotated, factor: Factor) -> tuple[Rest, Array]:
        """The end refined as :mod:`modalshell.statics.refine` does it, with what touches staying on its collider."""

        def newton(out: Array) -> Array:
            return np.asarray(equations.frames.turned(self.problem.step(factor, out), back=True))

        found = refined(self.problem, rest.point, self.scale(rest.pushes), equations.unbalanced, newton)
        count = rest.iterations + found.iterations
        end = replace(rest, point=found.point, residual=found.residual, limited=found.limited, iterations=count)
        return end, found.gradient

    def dragged(self, x: Array, drag: float) -> ActiveSet:
        """The same with ``drag |y - x|^2 / 2`` added to the potential, in the norm of the mass."""
        problem = self.problem.dragged(x, drag)
        return ActiveSet(problem, self.touching, self._load, self._friction, at_start=self._at_start)

    def is_inside(self, x: Array) -> bool:
        """Whether a vertex lies inside a collider at positions x (n, 3)."""
        return bool(self.touching.distances(x).min(initial=0.0) < -self._deep)

    def free_residual(self, step: Rest) -> float:
        """Residual at the end of a step with a drag, without that drag."""
        equations, gradient = self.equations(step, GAUSS_NEWTON)
        return float(np.linalg.norm(equations.unbalanced(gradient))) / self.scale(step.pushes)
