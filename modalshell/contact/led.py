"""Equilibria with contacts of shells whose patches are led to their targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.contact.active_set import ActiveSet, Rest
from modalshell.contact.descent import descend
from modalshell.contact.rotated import Rotated
from modalshell.contact.static_friction import MOST, FrictionStep, Rubbed, arrived, initial_friction, rest_with_friction
from modalshell.contact.touching import INSIDE, Touching, put_out
from modalshell.core.errors import OptionError, SolverError
from modalshell.core.typing import Array, Index
from modalshell.shell import Shell
from modalshell.statics import mixed_newton as method
from modalshell.statics.boundary import FIRST_STEP, places, predicted, unstressed
from modalshell.statics.continuation import Steps
from modalshell.statics.newton import rules_of
from modalshell.statics.potential import Potential
from modalshell.supports.constraints import HeldPatch

_MOST = 40
"""Iterations of a step at most: those of :data:`.mixed_newton.CONTINUED`, and some in which sets change."""


@final
@dataclass(frozen=True)
class Led:
    """A shell with contacts whose patches are led.

    ``problem`` and ``touching`` are those of the shell with the patches' vertices held; in ``shell``, about its
    ``origin`` (3,) [m] in the world, these are free. Targets of patches are in the world.
    """

    problem: Potential
    shell: Shell
    touching: Touching
    patches: Sequence[HeldPatch]
    origin: Array

    def rest(self, start: Array) -> Rest:
        """Minimum outside colliders with the patches at their targets, led there from ``start`` (n, 3) [m] in steps.

        The whole load comes with the first step. Each is predicted along the tangent, on which what touches stays on
        its collider, and solved by Newton's steps with active sets; where that ends at no minimum, or behind a
        collider, the step is shortened, and at last the shell goes downhill from where it is, with the patches at the
        step's end. OptionError for a start inside a collider, or targets there: contacts do not push on patches.
        """
        self._refuse_inside(start)
        rest, steps, iterations = initial_friction(self.touching, start).rest, Steps(FIRST_STEP), 0
        rest = replace(rest, active=ActiveSet(self.problem, self.touching, 1.0).near(start))
        while steps.fraction < 1.0:
            steps.limit()
            target = self._target(start, steps.target)
            led = self._step(rest, target)
            iterations += led.iterations
            if not led.stable:
                if steps.refuse():
                    continue
                led = self._downhill(self._placed(rest.point, target))
                iterations += led.iterations
                if not led.converged:
                    return replace(led, iterations=iterations)
            rest = led
            steps.accept()
        rest = replace(rest, iterations=iterations)
        if rest.limited:
            residual = unstressed(self.problem, rest.point)
            rest = rest if residual is None else replace(rest, residual=residual, limited=False)
        return rest

    def rest_with_friction(self, start: Array, load_steps: int) -> Rubbed:
        """The same with friction: the load grows in ``load_steps`` where the shell is, and then the patches go.

        What moves along a collider in a step's prediction slips at first, or else, tried next, as in the step before.
        Where a step fails that cannot be shortened, as where a shell snaps that is pushed against its friction, there
        is no answer. OptionError as above.
        """
        self._refuse_inside(start)
        reached, steps = rest_with_friction(self.problem, self.touching, start, load_steps), Steps(FIRST_STEP)
        iterations = reached.rest.iterations
        while reached.rest.converged and not reached.message and steps.fraction < 1.0:
            steps.limit(FIRST_STEP)  # friction depends on the way
            target = self._target(start, steps.target)
            found = self._rubbed(reached, target)
            iterations += found.rest.iterations
            if not arrived(self.touching, reached, found):
                if steps.refuse():
                    continue
                message = f"stick and slip did not settle at {steps.target:.3g} of the way of the constraints"
                rest = replace(reached.rest, residual=found.rest.residual, converged=False)
                reached = reached._replace(rest=rest, message=f"{message}: simulate the damped motion")
                break
            reached = found
            steps.accept()
        return reached._replace(rest=replace(reached.rest, iterations=iterations))

    def _refuse_inside(self, start: Array) -> None:
        """Raise OptionError where a start (n, 3), or a patch's target, lies inside a collider."""
        self.touching.refuse_inside(start)
        refuse_led_inside(self.touching, self._vertices, self._target(start, 1.0) + self.origin)

    @property
    def _vertices(self) -> Index:
        return np.concatenate([patch.vertices for patch in self.patches])

    def _target(self, start: Array, fraction: float) -> Array:
        """Where the patches' vertices are (k, 3) at a fraction of their way from a start (n, 3)."""
        return places(self.patches, start[self._vertices], self.origin, fraction)

    def _placed(self, x: Array, target: Array) -> Array:
        """Positions (n, 3) with the patches at a target (k, 3), and what that leaves inside put out."""
        x = x.copy()
        x[self._vertices] = target
        return put_out(self.touching, x, np.ones(len(self.touching.contacts), dtype=bool))

    def _predicted(self, rest: Rest, target: Array) -> tuple[Array, list[Array], float, bool]:
        """Where the tangent leads as the patches go to a target (k, 3); see :func:`.boundary.predicted`."""
        rows, x = np.flatnonzero(rest.active), rest.point

        def direction(gradient: Array, hessian: sps.csc_array) -> Array:
            gaps = self.touching.gaps(x, rows)
            return Rotated(self.problem, self.touching, gradient, hessian, rows, rest.pushes[rows], gaps).solve()[0]

        return predicted(self.problem, self.shell, x, self._vertices, target, direction)

    def _step(self, rest: Rest, target: Array) -> Rest:
        """Where a step leads that takes the patches to a target (k, 3); stable if it found a minimum outside."""
        failed = replace(rest, converged=False, stable=False, iterations=1)
        try:
            guess, stresses, reaction, straight = self._predicted(rest, target)
            if not (straight and np.isfinite(guess).all()):
                return failed
            problem = self.problem
            solver = ActiveSet(problem, self.touching, max(problem.measure(problem.push), reaction))
            rules = rules_of(problem, method.GOAL, _MOST)
            found = solver.settled(solver.iterate(guess, rest.active, rules, stresses))
        except SolverError:
            return failed
        found = replace(found, iterations=1 + found.iterations)
        behind = found.stable and self.touching.crossed(rest.point, found.point)
        return replace(found, stable=False) if behind else found

    def _downhill(self, x: Array) -> Rest:
        """Where the way downhill leads from x (n, 3)."""
        problem = self.problem
        scale = max(problem.measure(problem.push), problem.measure(problem.residual(x)))
        return descend(ActiveSet(problem, self.touching, scale), x, rules_of(problem, method.GOAL, _MOST))

    def _rubbed(self, reached: Rubbed, target: Array) -> Rubbed:
        """Where a step with friction leads that takes the patches to a target (k, 3)."""
        step = FrictionStep(self.problem, self.touching, reached.rest.point)
        failed = reached._replace(rest=replace(reached.rest, stable=False, iterations=1))
        try:
            guess = self._predicted(reached.rest, target)[0]
        except SolverError:
            return failed
        if not np.isfinite(guess).all():
            return failed
        found, tried = step.solve(step.slipping(reached, guess), MOST, first=guess), 1
        if not arrived(self.touching, reached, found):
            tried += found.rest.iterations
            found = step.solve(reached, MOST, first=self._placed(reached.rest.point, target))
        return found._replace(rest=replace(found.rest, iterations=tried + found.rest.iterations))


def refuse_led_inside(touching: Touching, vertices: Index, places: Array) -> None:
    """Raise OptionError where constraints lead ``vertices`` (k,) to ``places`` (k, 3) [m] inside a collider."""
    for index, contact in enumerate(touching.contacts):
        gap = np.asarray(contact.distance(places, touching.time))
        gap = np.where(contact.vertices(touching.shell.mesh)[vertices], gap, np.inf)
        worst = int(np.argmin(gap))
        if gap[worst] < -INSIDE * touching.size:
            kind = type(contact.collider).__name__
            raise OptionError(
                f"a constraint leads vertex {vertices[worst]} to {-gap[worst]:.3g} m inside contact {index} ({kind}): "
                "move its target or the collider, or leave the vertex out of the contact's sel"
            )
