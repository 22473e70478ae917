"""What a fit compares with measurements, positions or natural frequencies, and equilibria next to a known one."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.sparse as sps
from numpy.typing import ArrayLike

from modalshell.analysis.fit_orders import deeper_minima
from modalshell.core.checks import as_array, checked_vectors
from modalshell.core.errors import LoadError, ModalShellWarning, OptionError, SolverError
from modalshell.core.typing import Array, Mask
from modalshell.loads import Load, Loading, Scaled
from modalshell.mesh.selection import Selection, selected
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.full import FullModel
from modalshell.models.base.model import NO_POTENTIAL
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.modes import Basis, solve_modes
from modalshell.modes.rigid import rigid_motions
from modalshell.shell import EXACT, Shell
from modalshell.shell.energies_of import ANY_SIGN, material_constants, size_of_constant
from modalshell.statics.mixed_newton import ACCEPTED, GOAL
from modalshell.statics.newton import Factored, mixed_newton
from modalshell.statics.potential import Potential

_FRACTION, _LOOSE = 1e-3, 1e-3
"""Residual of an equilibrium over the constants' change since the last one, and at most."""
_ABOVE, _TRIED = 3, 3
"""Modes above the measured ones that may have changed places with them, and orders that are tried."""
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


class Measurements(ABC):
    """Measured numbers, and what a shell says of them."""

    @abstractmethod
    def misfit(self, shell: Shell, names: list[str], *, exact: bool = False) -> tuple[Array, Equilibrium | None]:
        """Difference (p,) of the shell's numbers from those measured, and its last equilibrium.

        With its derivatives by constants of the material. Unless it is to be ``exact`` it may be loose by a small
        fraction of its change since the last one.
        """

    @abstractmethod
    def slopes(self, names: list[str]) -> Array:
        """Derivatives (p, k) of the last misfit by constants of the material."""

    @property
    def exact(self) -> bool:
        """Whether the last misfit is exact."""
        return True

    @property
    @abstractmethod
    def size(self) -> float:
        """Root mean square of what was measured, in the unit of the misfit; displacements are from rest."""

    def deeper(self, shell: Shell, names: list[str], scale: Array) -> list[Array]:
        """Steps of parameters (p,) from the least squares of a shell to others that may be deeper, the deepest first.

        ``names`` are the constants, ``scale`` (p,) the derivative of each by its parameter.
        """
        return []


@final
class MeasuredFrequencies(Measurements):
    """Natural frequencies in ascending order, rigid motions left out; differences are shares of those measured.

    Parameters
    ----------
    frequencies : array_like, shape (m,)
        Frequencies [Hz]; NaN where none was measured.
    """

    def __init__(self, frequencies: ArrayLike) -> None:
        values = np.array(as_array("frequencies", frequencies, "natural frequencies [Hz]", OptionError), dtype=float)
        if values.ndim != 1 or np.isinf(values).any() or (values <= 0.0).any():
            raise OptionError("frequencies must be positive [Hz], in ascending order, with NaN for those not measured")
        self._seen = np.isfinite(values)
        if not self._seen.any():
            raise LoadError("frequencies must hold at least one measured value (got none that is finite)")
        if (np.diff(values[self._seen]) < 0.0).any():
            raise OptionError(f"frequencies must ascend (got {values.tolist()})")
        self._values = values

    def misfit(self, shell: Shell, names: list[str], *, exact: bool = False) -> tuple[Array, Equilibrium | None]:
        """Shares of the measured frequencies."""
        self._basis = solve_modes(shell, rigid_motions(shell).shape[1] + self._values.size)
        return self._elastic(self._basis.frequencies) / self._values[self._seen] - 1.0, None

    def slopes(self, names: list[str]) -> Array:
        """Derivatives of the shares."""
        columns = [self._elastic(self._basis.sensitivity(name).frequencies) for name in names]
        return np.stack(columns, axis=1) / self._values[self._seen, None]

    @property
    def size(self) -> float:
        """Shares are of 1."""
        return 1.0

    def deeper(self, shell: Shell, names: list[str], scale: Array) -> list[Array]:
        """Steps to where modes stand in another order, those above the measured ones counted in."""
        count = min(len(self._basis.frequencies) + _ABOVE, shell.unknowns.count)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModalShellWarning)  # of modes that were not asked for
                logs, slopes = _linearised(solve_modes(shell, count), names)
        except OptionError:  # two of them may share an eigenvalue
            logs, slopes = _linearised(self._basis, names)
        rows = np.flatnonzero(self._seen)
        return deeper_minima(logs, slopes * scale, rows, np.log(self._values[rows]), _TRIED)

    def _elastic(self, values: Array) -> Array:
        rigid = self._basis.rigid_modes
        return np.asarray(values[rigid : rigid + self._values.size][self._seen])


@final
class MeasuredPositions(Measurements):
    """Positions of some vertices, or their mean, under a load or shares of it.

    Parameters
    ----------
    shell : Shell
        The shell.
    observed : array_like, shape (L, k, 3) or (L, 3) of a mean; without L if there are no factors
        Measured positions [m]; NaN where none was measured.
    where, average, factors, gravity, force, loads
        As for :func:`modalshell.fit`.
    """

    def __init__(
        self,
        shell: Shell,
        observed: ArrayLike,
        *,
        where: Selection | None,
        average: bool,
        factors: ArrayLike | None,
        gravity: ArrayLike | None,
        force: ArrayLike | None,
        loads: Sequence[Load] | None,
    ) -> None:
        vertices = np.arange(len(shell.rest_positions))
        if where is not None:
            vertices = np.flatnonzero(selected("where", where, shell.mesh))
        self._rows = np.eye(len(vertices)) if not average else np.full((1, len(vertices)), 1.0 / len(vertices))
        self._vertices = vertices
        levels = np.ones(1) if factors is None else checked_factors(factors)
        shape: tuple[int, ...] = (3,) if average else (len(vertices), 3)
        shape = shape if factors is None else (levels.size, *shape)
        measured = np.array(as_array("observed", observed, "measured positions", OptionError), dtype=float)
        if measured.shape != shape:
            raise OptionError(f"observed must have shape {shape} (got {measured.shape})")
        self._measured = measured.reshape(levels.size, -1, 3)
        if np.isinf(measured).any():
            raise OptionError("observed must be finite [m], with NaN where nothing was measured (got infinity)")
        self._seen: Mask = np.isfinite(self._measured)
        if not self._seen.any():
            raise LoadError("observed must hold at least one measured coordinate (got none that is finite)")
        weight = np.zeros(3) if gravity is None else checked_vectors("gravity", gravity, (3,))
        push = np.zeros_like(shell.rest_positions)
        push = push if force is None else checked_vectors("force", force, push.shape)
        self._levels: list[tuple[Array, Array, list[Load]]] = []
        for level in levels.tolist():
            scaled = [one if factors is None else Scaled(one, ((0.0, 1.0), (level, level))) for one in loads or ()]
            self._levels.append((level * weight, level * push, scaled))
        self._factors = levels
        self._known: list[KnownEquilibrium] = []
        self._body = DiscreteShell(shell)
        self._goal = GOAL

    def misfit(self, shell: Shell, names: list[str], *, exact: bool = False) -> tuple[Array, Equilibrium | None]:
        """Differences of coordinates [m], level after level; while constants change by much a looser balance serves."""
        body, known = DiscreteShell(shell), list[KnownEquilibrium]()
        steps = _steps(names, self._body.shell, shell)
        change = float(np.abs(steps[:, 1]).max())
        self._goal = GOAL if exact or not self._known else min(_LOOSE, max(GOAL, _FRACTION * change))
        for index in range(len(self._levels)):
            near = self._near(body, index, known, names, steps[:, 0])
            known.append(near or self._far(body, index, known, names))
        self._body, self._known = body, known
        seen = [self._rows @ one.state.positions[self._vertices] for one in known]
        return (np.stack(seen) - self._measured)[self._seen], known[-1].state

    def slopes(self, names: list[str]) -> Array:
        """Derivatives of the differences."""
        moves = [one.rates[:, :, : len(names)] for one in self._known]
        return np.stack([np.tensordot(self._rows, move[self._vertices], 1) for move in moves])[self._seen]

    @property
    def size(self) -> float:
        """Root mean square displacement [m] of the measured coordinates."""
        rest = self._rows @ self._body.shell.rest_positions[self._vertices]
        return float(np.sqrt(np.mean((self._measured - rest)[self._seen] ** 2)))

    @property
    def exact(self) -> bool:
        """Whether the last misfit is that of full balance."""
        return self._goal <= GOAL

    def _near(
        self, body: DiscreteShell, index: int, known: list[KnownEquilibrium], names: list[str], steps: Array
    ) -> KnownEquilibrium | None:
        """The equilibrium at a level from the last one there, or at first from that of the level before."""
        gravity, force, loads = self._levels[index]
        if self._known:
            before = self._known[index]
            step = before.rates[:, :, : len(names)] @ steps
        elif known and self._factors[index - 1]:
            before, names = known[-1], [*names, "load"]
            step = (self._factors[index] / self._factors[index - 1] - 1.0) * before.rates[:, :, -1]
        else:
            return None
        return before.near(body, body.shell.loading(gravity, force, loads), gravity, step, names, self._goal)

    def _far(
        self, body: DiscreteShell, index: int, known: list[KnownEquilibrium], names: list[str]
    ) -> KnownEquilibrium:
        """The equilibrium at a level as the model finds it."""
        gravity, force, loads = self._levels[index]
        starts = [one.state.positions for one in (self._known[index : index + 1] or known[-1:])]
        for start in (*starts, None):
            answer = body.equilibrium(gravity=gravity, force=force, loads=loads, start=start)
            if answer.converged:
                return KnownEquilibrium.of(body, answer, names if self._known else [*names, "load"])
        raise SolverError(f"no equilibrium was found ({answer.status}): begin nearer to the answer")


def _linearised(basis: Basis, names: list[str]) -> tuple[Array, Array]:
    """Logarithms (M,) of the frequencies of elastic modes, and their derivatives (M, p) by constants."""
    rigid = basis.rigid_modes
    elastic = basis.frequencies[rigid:]
    columns = [basis.sensitivity(name).frequencies[rigid:] / elastic for name in names]
    return np.log(elastic), np.stack(columns, axis=1)


def _steps(names: list[str], old: Shell, new: Shell) -> Array:
    """Changes of constants (k, 2): to the first order in logarithms, and as shares; of any sign as they are."""
    before, after = (material_constants(shell.material) for shell in (old, new))
    steps = []
    for name in names:
        any_sign = name in ANY_SIGN
        size = size_of_constant(old.material, old.mesh, name) if any_sign else before[name]
        change = (after[name] - before[name]) / size if any_sign else np.log(after[name] / before[name])
        steps.append((size * change, change))
    return np.array(steps)


def checked_factors(factors: ArrayLike) -> Array:
    """Shares of a load (L,), at least one, finite."""
    levels = np.atleast_1d(as_array("factors", factors, "shares of the load", OptionError))
    return np.asarray(checked_vectors("factors", levels, (max(np.size(levels), 1),), OptionError))
