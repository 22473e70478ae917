"""Sensitivities of equilibria: names of parameters, checks, and the tangent of a full model with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_vectors, shown
from modalshell.core.errors import OptionError
from modalshell.core.memory import demand_memory
from modalshell.core.outcome import Outcome
from modalshell.core.slope import slope
from modalshell.core.typing import Array
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.shell import EXACT, Shell
from modalshell.shell.energies_of import material_constants
from modalshell.statics.newton import Factored
from modalshell.statics.potential import Potential

LOADS = ("gravity", "load", "force")
"""Names of what loads an equilibrium: the acceleration, a factor on the whole load, the force on every vertex."""
SHAPES = ("rest_angles", "supports")
"""Names of what shapes it: rest angles of the hinges, positions of supported vertices."""
_ASIDE = 2e-3
"""Change of an edge, as a share of its length, over which forces on supports are differenced."""


def checked_names(wrt: str | Sequence[str]) -> list[str]:
    """``wrt`` as a list of names."""
    if isinstance(wrt, str):
        return [wrt]
    if not isinstance(wrt, list | tuple) or not wrt or not all(isinstance(name, str) for name in wrt):
        raise OptionError(f"wrt must be a name or a list of names, such as 'young' (got {shown(wrt)})")
    return list(wrt)


def checked_state(state: Equilibrium) -> Equilibrium:
    """A state that has converged, was found by ``equilibrium()`` and is under neither constraints nor contacts."""
    checked_kind("state", state, Equilibrium)
    if state.outcome is not Outcome.CONVERGED:
        raise OptionError(f"state must be a converged equilibrium (got {state.status}): solve it first")
    if state.loading is None or state.constraint_residuals.size or state.contact_forces.size:
        raise OptionError("state must be what equilibrium() gave of this model, without constraints or contacts")
    return state


def checked_weights(of: ArrayLike | None, shell: Shell) -> Array | None:
    """``of`` as an array (n, 3)."""
    return None if of is None else checked_vectors("of", of, shell.rest_positions.shape, OptionError)


def checked_constant(shell: Shell, name: str, others: Sequence[str]) -> None:
    """OptionError for a name that is neither a constant of the shell's material nor among ``others``."""
    known = material_constants(shell.material)
    if name not in known:
        names = ", ".join([*known, *others])
        raise OptionError(f"wrt must be one of {names}; constants are one number for the whole mesh (got {name!r})")


def load_rates(shell: Shell, state: Equilibrium, name: str) -> Array:
    """Derivative (n, 3, k) of the load by "gravity", "load", or what a constant does to the weight."""
    assert state.loading is not None
    if name == "gravity":
        return np.asarray(shell.mass[:, None, None] * np.eye(3))
    if name == "load":
        return state.loading.force(state.positions)[:, :, None]
    rate = np.zeros((*shell.rest_positions.shape, 1))
    if name in ("density", "thickness"):  # the mass is proportional to both
        if state.gravity is not None:
            rate[:, :, 0] += shell.gravity_force(state.gravity)
        for load in state.loading.loads:
            ahead, behind = (load.applied(shell.mesh, factor * shell.mass) for factor in (1.5, 0.5))
            if ahead is not None and behind is not None:
                rate[:, :, 0] += ahead.force(state.positions) - behind.force(state.positions)
        rate /= getattr(shell.material, name)
    return rate


@final
class Tangent:
    """The exact tangent stiffness at an equilibrium ``state`` of a ``problem``, factorised once.

    ``of_material`` says whether the model's energies are those of the shell's material; ``factor`` is that of the exact
    Hessian at the state, where it is known.
    """

    def __init__(
        self, problem: Potential, state: Equilibrium, *, of_material: bool, factor: Factored | None = None
    ) -> None:
        self._problem, self._state, self._of_material = problem, state, of_material
        self._shell, self._x = problem.shell, state.positions
        self._known = factor

    @cached_property
    def _factor(self) -> Factored:
        return self._known or self._problem.factor(self._problem.linearise(self._x, EXACT)[1])

    def check(self, name: str, *, adjoint: bool) -> None:
        """OptionError for a name that is no parameter, or where its derivative is not to be had."""
        if name not in (*LOADS, *SHAPES):
            checked_constant(self._shell, name, (*LOADS, *SHAPES))
            if not self._of_material and name != "density":
                raise OptionError(f"springs have stiffnesses of their own, which {name} does not change (got {name!r})")
        if not self._problem.unsymmetric:
            return
        if adjoint:
            raise OptionError("of needs loads with a potential: leave it out and contract the sensitivity instead")
        if name == "supports":
            raise OptionError("the derivative by supports needs loads with a potential (got loads without)")

    def solve(self, forces: Array) -> Array:
        """Displacements (n, 3) under forces (n, 3)."""
        unknowns = self._shell.unknowns
        return np.asarray(unknowns.prolong(self._factor.solve(unknowns.restrict(forces.ravel())))).reshape(-1, 3)

    def adjoint(self, name: str, solved: Array, weights: Array) -> Array:
        """Derivatives (k,) of a scalar by a parameter.

        From the scalar's derivatives by the positions (n, 3), and the answer (n, 3) of the tangent to these.
        """
        if name == "force":
            return solved.ravel().copy()
        if name in SHAPES:
            return self._by_shape(name, solved, weights)
        return np.asarray(np.einsum("ni,nik->k", solved, self._force_rates(name)))

    def forward(self, name: str) -> Array:
        """Derivatives (n, 3, k) of the positions."""
        x, size = self._x, self._x.size
        if name not in ("force", *SHAPES):
            return np.stack([self.solve(rate) for rate in np.moveaxis(self._force_rates(name), 2, 0)], axis=2)
        columns = {"force": size, "supports": size, "rest_angles": len(self._shell.mesh.hinges)}[name]
        demand_memory(f"derivatives of {size} coordinates", 8.0 * size * (size + columns), "ask for those of= a scalar")
        rows, unit = [], np.zeros(size)
        for index in range(size):
            unit[index] = 1.0
            field = unit.reshape(-1, 3)
            rows.append(self.adjoint(name, self.solve(field), field))
            unit[index] = 0.0
        return np.stack(rows).reshape(*x.shape, -1)

    def _force_rates(self, name: str) -> Array:
        """Derivatives (n, 3, k) of the force on the vertices where they are."""
        rates = load_rates(self._shell, self._state, name)
        if name not in LOADS and self._of_material:
            rates[:, :, 0] -= self._shell.rates_by_constant(name, self._x)
        return rates

    def _by_shape(self, name: str, solved: Array, weights: Array) -> Array:
        shell, x = self._shell, self._x
        if name == "rest_angles":
            return -shell.elastic_energy.pulled_by_rest_angles(x, solved)
        ends = shell.mesh.edges
        change = np.linalg.norm(solved[ends[:, 1]] - solved[ends[:, 0]], axis=1) / shell.mesh.edge_lengths

        def gradient(nearby: Array) -> Array:
            held = shell.elastic_energy.support_gradient(nearby)
            return held if self._problem.live is None else held - self._problem.live.force(nearby)

        rate = slope(gradient, x, solved, _ASIDE / max(float(change.max()), 1e-300))
        return np.asarray(shell.unknowns.resisted((weights - rate)[:, :, None]).ravel())
