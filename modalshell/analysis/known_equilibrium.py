"""Equilibria of a full model next to one that is known: predicted to the first order, and solved from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.full import FullModel
from modalshell.models.base.model import NO_POTENTIAL
from modalshell.shell import EXACT
from modalshell.statics.mixed_newton import ACCEPTED, GOAL
from modalshell.statics.newton import Factored, mixed_newton
from modalshell.statics.potential import Potential

_ITERATIONS = 12
"""Newton's at most, before an equilibrium counts as not near."""


@final
@dataclass(frozen=True)
class KnownEquilibrium:
    """A stable equilibrium with its derivatives, from the one factor of its Hessian that also shows it to be stable."""

    state: Equilibrium
    """The model's answer."""
    rates: Array
    """Derivatives of its positions by parameters, as :meth:`FullModel.sensitivity` has them. Shape (n, 3, k)."""
    rounding: float
    """Estimate of the residual that rounding leaves."""

    @classmethod
    def of(cls, body: FullModel, state: Equilibrium, names: Sequence[str]) -> KnownEquilibrium:
        """A converged answer of a model, with its derivatives by ``names``; SolverError where it has none."""
        assert state.loading is not None
        problem, origin = body.problem(state.loading)
        x = state.positions - origin
        hessian = problem.linearise(x, EXACT)[1]
        return cls._of(body, state, names, problem, x, hessian, problem.factor(hessian))

    @classmethod
    def _of(
        cls,
        body: FullModel,
        state: Equilibrium,
        names: Sequence[str],
        problem: Potential,
        x: Array,
        hessian: sps.csc_array,
        factor: Factored,
    ) -> KnownEquilibrium:
        assert state.loading is not None
        tangent = body.tangent(state, state.loading, factor)
        for name in names:
            tangent.check(name, adjoint=False)
        rates = np.concatenate([tangent.forward(name) for name in names], axis=2)
        return cls(state, rates, problem.rounding(x, hessian, 0.0) / problem.scale_at(x))

    def near(
        self,
        body: FullModel,
        loading: Loading,
        gravity: Array | None,
        step: Array,
        names: Sequence[str],
        goal: float = GOAL,
    ) -> KnownEquilibrium | None:
        """The stable equilibrium of ``body`` that lies about ``step`` (n, 3) [m] away; None if none is found.

        The step is warped, and the first Hessian takes the stresses that it predicts. ``goal`` is the residual to aim
        at, where rounding allows it; ``gravity`` (3,) [m/s^2] is that of the load.
        """
        problem, origin = body.problem(loading)
        direction = problem.shell.unknowns.values(step.ravel())
        x, stresses, _ = problem.moved(self.state.positions - origin, direction)
        goal = max(goal, min(self.rounding, ACCEPTED))
        solution = mixed_newton(problem, x, problem.scale_at(x), limit=_ITERATIONS, goal=goal, stresses=stresses)
        if not solution.residual <= max(goal, ACCEPTED):
            return None
        hessian = problem.linearise(solution.point, EXACT)[1]
        factor = problem.definite_factor(hessian)
        if factor is None:
            return None
        state = replace(
            self.state,
            positions=solution.point + origin,
            message="" if loading.conservative else NO_POTENTIAL,
            iterations=solution.iterations,
            residual=solution.residual,
            loading=loading,
            gravity=gravity,
        )
        # Without a potential the factor that shows a minimum may be that of the symmetric half.
        whole = problem.factor(hessian) if problem.unsymmetric else factor
        return self._of(body, state, names, problem, solution.point, hessian, whole)
