"""Steps of a rule of order two on contacts that stay as they were (theory 13).

Where what touches does not change, contacts are constraints, and a rule keeps its order under them: each of its solves
is the least of a potential on the colliders. Where the set changes something strikes or parts, and speeds jump; there
implicit Euler stands in, as it does where such a step would gain energy, by the rule and by SDIRK2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from modalshell.contact.active_set import ActiveSet
from modalshell.contact.friction import Friction, better_forces
from modalshell.contact.steps import TouchingSteps
from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart, EulerSteps, StepMinimum
from modalshell.integrators.state import GIVEN, MIDDLE_GIVEN, MotionState
from modalshell.statics.newton import rules_of
from modalshell.statics.potential import Potential

_ITERATIONS = 12
"""Iterations of a solve at most: on contacts that stay it takes as few as without them."""
_NO_GAIN, _STILL = 1e-12, 1e-15
"""Energy, as a share of the step's energies, and of the work of the load over the shell's size, that is none."""


@final
class KeptSteps(EulerSteps):
    """Solves of one step of a rule, which fail where the contacts do not stay as they were at its beginning.

    ``make`` makes the shell's steps from what finds their minima. The step of ``dt`` [s] begins at ``begin`` [s] in a
    state with what contacts have given in the step before.
    """

    def __init__(
        self,
        make: Callable[[StepMinimum], EulerSteps],
        steps: TouchingSteps,
        state: MotionState,
        begin: float,
        dt: float,
    ) -> None:
        self._steps, self._state, self._when = steps, state, (begin, dt)
        self._before, self._part, self._pushed = steps.now, 0.0, steps.pushes
        self._forces = np.zeros_like(state.coordinates)
        self._known: list[tuple[MotionState, Array]] = [(state, self._forces)]
        self._euler = make(self._minimum)

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        """State at the end, and whether its equations were solved with the same contacts."""
        self._part = start.dt
        after, solved = self._euler.solve(start)
        earlier = iter([-self._state.memory[GIVEN], -self._state.memory[MIDDLE_GIVEN]])
        impulse = start.dt * self._forces
        for weight, state, _ in start.made_of:
            known = next((one for other, one in self._known if other is state), None)
            impulse = impulse + weight * (next(earlier) if known is None else known)
        self._known.append((after, impulse))
        return after, solved

    def turn(self, coordinates: Array, move: Array) -> float:
        """Largest rotation [rad] of a vertex by a small ``move`` of the coordinates."""
        return self._euler.turn(coordinates, move)

    def _minimum(
        self, problem: Potential, first: Array, scale: float, goal: float, stresses: list[Array], share: float
    ) -> tuple[Array, bool]:
        """Minimum (n, 3) of a step's potential, and whether what touches there is what touched before."""
        steps, (begin, dt) = self._steps, self._when
        end = begin + share * dt
        before, steps.now = steps.now.at(end - self._part), steps.now.at(end, problem.shell.undamped)
        rubs = Friction(before, steps.pushes, problem.origin, self._part, steps.whole) if steps.rubs else None
        solver = ActiveSet(problem, steps.now, scale, rubs)
        was = steps.pushes > 0.0
        rest = solver.iterate(first, was, rules_of(problem, goal, _ITERATIONS), stresses)
        pushes = np.where(rest.active, rest.pushes, 0.0)
        stays = rest.converged and np.array_equal(pushes > 0.0, was)
        if not stays or steps.now.crossed(self._state.coordinates, rest.point):
            return rest.point, False
        if rubs is not None and better_forces(pushes, steps.pushes, settled=False) is not None:
            return rest.point, False
        steps.pushes, self._forces = pushes, steps.now.forces(rest.point, pushes)
        return rest.point, True

    def given(self) -> dict[str, Array]:
        """Impulses (n, 3) [N s] of contacts since the beginning of the step, and since its middle."""
        last = self._known[-1][1]
        return {GIVEN: last, MIDDLE_GIVEN: last - self._known[-2][1]}

    def gains(self, after: MotionState, load: Array) -> bool:
        """Whether the shell has gained more energy to ``after`` than a ``load`` (n, 3) [N] and colliders gave it.

        What moving supports give is not known, so that it may be any there.
        """
        shell, before, touching = self._steps.now.shell, self._state, self._steps.now
        if (after.coordinates[shell.clamped] != before.coordinates[shell.clamped]).any():
            return False
        work = float(np.sum(load * (after.coordinates - before.coordinates))) + self._most_given(after.coordinates)
        energies = [
            value
            for state in (after, before)
            for value in (shell.energy(state.coordinates), 0.5 * float(shell.mass @ np.sum(state.rates**2, axis=1)))
        ]
        gained = energies[0] + energies[1] - energies[2] - energies[3] - work
        least = _STILL * touching.size * float(np.linalg.norm(load, axis=1).sum())
        return not gained <= _NO_GAIN * (sum(map(abs, energies)) + abs(work)) + least

    def _most_given(self, x: Array) -> float:
        """Work [J] that moving colliders give at most in a step to x (n, 3).

        That of forces that change is known but for what the change would do along the way. Friction gives no more than
        Coulomb's limit on the collider's way. Of colliders at rest all of it is nothing.
        """
        pushes, dt = self._steps.pushes, self._when[1]
        rows = np.flatnonzero(pushes)
        touching, own = self._steps.now, pushes[rows]
        vertices = touching.vertices[rows]
        drift = touching.velocities(x, rows)
        # Several colliders share what their vertex was given.
        shares = own / np.bincount(vertices, weights=own, minlength=len(x))[vertices]
        impulses = shares[:, None] * self._known[-1][1][vertices]
        normals = touching.normals(x, rows)
        mean = np.sum(normals * impulses, axis=1) / dt
        unsure = dt * (np.abs(mean - own) + np.abs(mean - self._pushed[rows]))
        unsure = float(unsure @ np.abs(np.sum(drift * normals, axis=1)))
        rubbed = touching.friction[rows] * np.linalg.norm(impulses, axis=1)
        return float(np.sum(impulses * drift)) + unsure + float(rubbed @ np.linalg.norm(drift, axis=1))

    def undo(self, pushes: Array) -> None:
        """Leave the contacts as they were, with the forces (r,) [N] of the step before."""
        self._steps.now, self._steps.pushes = self._before, pushes
