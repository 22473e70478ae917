"""Full models, whose unknowns are the vertices: statics by Newton's method, and steps."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from modalshell.checks import checked_kind, checked_number
from modalshell.constraints.constraints import Constraint, held_patches
from modalshell.errors import OptionError, SolverError
from modalshell.integrators.full import FULL_INTEGRATORS, ExplicitEuler, FullIntegrator
from modalshell.integrators.full.base import hold
from modalshell.integrators.state import Damping, MotionState
from modalshell.models.base import Equilibrium, Model, Placement
from modalshell.modes import Factoriser, largest_eigenvalue, lowest_tangent_eigenvalue
from modalshell.shell import EXACT, Shell
from modalshell.statics.boundary import lead
from modalshell.statics.newton import (
    NewtonResult,
    Potential,
    descend,
    is_minimum,
    mixed_newton,
    warped_step,
)
from modalshell.statics.verdict import verdict
from modalshell.timings import Timings
from modalshell.typing import Array, Index

_STEP_TURN = 0.8
"""Turn of a vertex [rad] that one load step may predict."""
_LOAD_STEPS = 200
_LOOSE = 1e-3
_SMALLEST_TRUST = 1.0 / 300.0


class FullModel(Model):
    """A model in which every vertex is an unknown; its energies are those of its shell's elements.

    Statics is Newton's method; ``residual`` is the out-of-balance force over the load, accepted at 1e-7. From a start
    (a cheaper model's answer, say) the whole load is tried at once. Without it, or where that fails, the load is
    applied in steps that grow and shrink with the solver's success; where a step ends at no minimum (the shell snaps)
    the potential is minimised from the last stable state instead. Patches under constraints are led to their targets
    as moving boundaries; ``residual`` there is relative to load and reactions.

    Parameters
    ----------
    shell, integrator, allow_unstable_step, step_tolerance, backend
        As for :class:`modalshell.DiscreteShell`.

    Attributes
    ----------
    costs : dict
        Seconds of assembly, factorisation and solution so far.
    """

    takes_constraints = True

    def __init__(
        self,
        shell: Shell,
        *,
        integrator: str | FullIntegrator = "implicit",
        allow_unstable_step: bool = False,
        step_tolerance: float = 1e-6,
        backend: str | None = None,
    ) -> None:
        self.shell = checked_kind("shell", shell, Shell)
        self.integrator: FullIntegrator = FULL_INTEGRATORS.choose(integrator)
        self.allow_unstable_step = allow_unstable_step
        self._largest_eigenvalue: float | None = None
        self.step_tolerance = checked_number("step_tolerance", step_tolerance, above=0.0, at_most=1e-2)
        self.factoriser = Factoriser(backend)
        self.costs = Timings()

    def _solve(self, load: Array, start: Array | None, constraints: Sequence[Constraint]) -> Equilibrium:
        before = dict(self.costs)
        if constraints:
            patches = held_patches(constraints, self.shell)
            first = self.shell.rest_positions if start is None else hold(self.shell, start)
            # The load comes with the first step: a loose shell may have no rest of its own under it.
            result = lead(self.shell, load, first, patches, Factoriser(self.factoriser.backend), self.costs)
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as not converged
                result = self._free_statics(load, start)
        return Equilibrium(
            result.positions,
            *verdict(result.residual, result.stable, result.converged),
            result.iterations,
            result.residual,
            result.stable,
            costs=self.costs.since(before),
            constraint_residuals=np.zeros(len(constraints)),
        )

    def _free_statics(self, load: Array, start: Array | None) -> NewtonResult:
        """Equilibrium without constraints, the whole load at once from a start or in steps from rest."""
        problem = self._statics(load)
        iterations = 0
        if start is not None:
            first = hold(self.shell, start)
            scale = problem.scale or float(np.linalg.norm(problem.residual(first))) or 1.0
            result = mixed_newton(problem, first, scale)
            if is_minimum(problem, result):
                return result
            iterations = result.iterations
            if problem.scale == 0.0:
                result = descend(problem, first, scale)
                result.iterations += iterations
                return result
        followed = self._follow(load, problem.scale or 1.0)
        followed.iterations += iterations
        return followed

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:  # noqa: ARG002 (dead loads)
        """Lowest eigenvalue [1/s^2] of the tangent stiffness over the mass; 0 where it is singular to the last bit."""
        return self.lowest_eigenvalue(answer.positions)

    def lowest_eigenvalue(self, positions: Array) -> float:
        """Lowest eigenvalue [1/s^2] of the tangent stiffness over the mass at ``positions`` (n, 3) [m]."""
        try:
            return lowest_tangent_eigenvalue(self.shell, positions)
        except SolverError:
            return 0.0

    @abstractmethod
    def holding(self, vertices: Index) -> FullModel:
        """The same model, with further vertices held."""

    def _statics(self, load: Array) -> Potential:
        return Potential(self.shell, load, self.shell.rest_positions, self.factoriser, self.costs)

    def _follow(self, load: Array, scale: float) -> NewtonResult:
        """Load continuation from rest along tangents, each step as long as :data:`_STEP_TURN` allows."""
        shell = self.shell
        x, factor, trust, iterations, steps = shell.rest_positions, 0.0, 1.0, 0, 0
        push = load.ravel()[shell.free_unknowns]
        tangent: Array | None = None
        while True:
            steps += 1
            if steps > _LOAD_STEPS:
                trust = 0.0
            target, guess, stresses = factor, x, None
            try:
                if trust < _SMALLEST_TRUST:
                    raise SolverError("the branch has ended")
                if tangent is None:  # at rest; later the factor that showed a minimum gives it
                    problem = self._statics(load)
                    tangent = problem.step(problem.factor(problem.linearise(x, EXACT)[1]), -push)
                    iterations += 1
                guess, moved, share = warped_step(shell, x, (1.0 - factor) * tangent, trust * _STEP_TURN)
                target = factor + share * (1.0 - factor) if share < 0.999 else 1.0
                stresses = shell.predicted_stresses(x, moved)
            except SolverError:
                trust = 0.0
            last = target == 1.0
            problem = self._statics(target * load)
            if trust >= _SMALLEST_TRUST:
                goal = {} if last else {"goal": _LOOSE}
                result = mixed_newton(problem, guess, scale, limit=25, stresses=stresses, **goal)
                iterations += result.iterations
            if trust < _SMALLEST_TRUST or not is_minimum(problem, result):
                trust *= 0.25
                if trust >= _SMALLEST_TRUST:
                    continue
                # The branch ends here: go downhill to wherever the shell comes to rest under the whole load.
                problem = self._statics(load)
                result = descend(problem, x, scale)
                result.iterations += iterations
                return result
            x, factor, trust = result.positions, target, min(1.0, 2.0 * trust)
            if last:
                return NewtonResult(x, result.residual, iterations, True, stable=True)
            if result.factor is not None:  # a dead load leaves the Hessian alone: the minimum's serves the next step
                tangent = problem.step(result.factor, -push)

    def stable_step(self, damping: Damping | None = None) -> float:
        """Largest stable step [s] of the integrator at the rest shape; of explicit Euler if the integrator is implicit.

        The stiffest mode decides, and is found by Lanczos on ``M^-1 K``. Dashpots add their own largest rate.
        """
        if self._largest_eigenvalue is None:
            self._largest_eigenvalue = largest_eigenvalue(self.shell)
        squared = self._largest_eigenvalue
        damping = damping or Damping()
        viscosity = damping.stiffness_factor * squared
        if self.shell.has_dashpots:
            viscosity += largest_eigenvalue(self.shell, self.shell.damping_matrix(self.shell.rest_positions, 0.0))
        rule = self.integrator if self.integrator.explicit else ExplicitEuler()
        return rule.stable_step(squared, damping.mass_factor, viscosity)

    def check_step(self, dt: float, damping: Damping) -> None:
        """Refuse an explicit step above the stability estimate."""
        if self.integrator.explicit and not self.allow_unstable_step and dt > (stable := self.stable_step(damping)):
            raise OptionError(
                f"{self.integrator.label} needs a step of at most {stable:.3g} s on this shell (got {dt:.3g} s): "
                "shorten the step, use integrator='implicit', or pass allow_unstable_step=True"
            )

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest."""
        x = self.shell.rest_positions if positions is None else self.shell.checked_positions(positions)
        return self.integrator.start(self, hold(self.shell, x))

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m]: the coordinates themselves."""
        return state.coordinates

    def placed(self, state: MotionState, pose: Placement) -> MotionState:
        """``state`` where the supports are put: positions, rates and what the integrator keeps."""
        memory = None if state.memory is None else state.memory.turned(pose.rotation)
        return MotionState(pose.to_world(state.coordinates), state.rates @ pose.rotation.T, memory)

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step of the integrator; for implicit ones, whether the solve converged."""
        return self.integrator.step(self, state, dt, load, damping, held)
