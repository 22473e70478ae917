"""What a fit compares with measurements: positions under one load or along a load curve, or natural frequencies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.checks import as_array, checked_vectors
from modalshell.errors import LoadError, OptionError, SolverError
from modalshell.loads import Load, Scaled
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.models.equilibrium import Equilibrium
from modalshell.modes import solve_modes
from modalshell.selection import Selection, selected
from modalshell.shell import Isotropic, Material, Shell
from modalshell.typing import Array

_NEAR = 0.1
"""Share of the constants' change up to which equilibria are predicted."""


class Measurements(ABC):
    """Measured numbers, and what a shell says of them."""

    @abstractmethod
    def misfit(self, shell: Shell) -> tuple[Array, Equilibrium | None]:
        """Difference (p,) of the shell's numbers from those measured, and its last equilibrium."""

    @abstractmethod
    def slopes(self, names: list[str]) -> Array:
        """Derivatives (p, k) of the last misfit by constants of the material."""


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

    def misfit(self, shell: Shell) -> tuple[Array, Equilibrium | None]:
        """Shares of the measured frequencies."""
        rigid = solve_modes(shell, 1).rigid_modes if not shell.unknowns.supported.any() else 0
        self._basis = solve_modes(shell, 6 * bool(rigid) + self._values.size)
        return self._elastic(self._basis.frequencies) / self._values[self._seen] - 1.0, None

    def slopes(self, names: list[str]) -> Array:
        """Derivatives of the shares."""
        columns = [self._elastic(self._basis.sensitivity(name).frequencies) for name in names]
        return np.stack(columns, axis=1) / self._values[self._seen, None]

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
            vertices = np.flatnonzero(selected("where", where, shell.mesh.vertices))
        self._rows = np.eye(len(vertices)) if not average else np.full((1, len(vertices)), 1.0 / len(vertices))
        self._vertices = vertices
        levels = np.ones(1) if factors is None else checked_factors(factors)
        shape: tuple[int, ...] = (3,) if average else (len(vertices), 3)
        shape = shape if factors is None else (levels.size, *shape)
        measured = np.array(as_array("observed", observed, "measured positions", OptionError), dtype=float)
        if measured.shape != shape:
            raise OptionError(f"observed must have shape {shape} (got {measured.shape})")
        self._measured = measured.reshape(levels.size, -1, 3)
        self._seen: NDArray[np.bool_] = np.isfinite(self._measured)
        if not self._seen.any():
            raise LoadError("observed must hold at least one measured coordinate (got none that is finite)")
        weight = np.zeros(3) if gravity is None else checked_vectors("gravity", gravity, (3,))
        push = np.zeros_like(shell.rest_positions)
        push = push if force is None else checked_vectors("force", force, push.shape)
        self._levels: list[tuple[Array, Array, list[Load]]] = []
        for level in levels.tolist():
            scaled = [one if factors is None else Scaled(one, ((0.0, 1.0), (level, level))) for one in loads or ()]
            self._levels.append((level * weight, level * push, scaled))
        self._answers: list[Equilibrium] = []
        self._body = DiscreteShell(shell)
        self._moves: tuple[Material | Isotropic, list[str], list[Array]] | None = None

    def misfit(self, shell: Shell) -> tuple[Array, Equilibrium | None]:
        """Differences of coordinates [m], level after level, each begun at the last answers."""
        body, answers = DiscreteShell(shell), list[Equilibrium]()
        body.factoriser = self._body.factoriser  # of one pattern: it is analysed once
        starts = self._starts(shell.material)
        for index, (gravity, force, loads) in enumerate(self._levels):
            start = starts[index] if starts else answers[-1].positions if answers else None
            answer = body.equilibrium(gravity=gravity, force=force, loads=loads, start=start)
            if not answer.converged and start is not None:
                answer = body.equilibrium(gravity=gravity, force=force, loads=loads)
            if not answer.converged:
                raise SolverError(f"no equilibrium was found ({answer.status}): begin nearer to the answer")
            answers.append(answer)
        self._body, self._answers = body, answers
        found = [self._rows @ answer.positions[self._vertices] for answer in answers]
        return (np.stack(found) - self._measured)[self._seen], answers[-1]

    def slopes(self, names: list[str]) -> Array:
        """Derivatives of the differences."""
        moves = [self._body.sensitivity(answer, wrt=names) for answer in self._answers]
        self._moves = self._body.shell.material, names, moves
        return np.stack([np.tensordot(self._rows, move[self._vertices], 1) for move in moves])[self._seen]

    def _starts(self, material: Material | Isotropic) -> list[Array]:
        """Last answers, moved along their derivatives where the constants changed by little."""
        starts = [answer.positions for answer in self._answers]
        if self._moves is None:
            return starts
        before, names, moves = self._moves
        old, new = (np.array([getattr(one, name) for name in names]) for one in (before, material))
        if (np.abs(new - old) > _NEAR * np.maximum(np.abs(old), 1e-3)).any():
            return starts
        steps = new - old
        return [start + move @ steps for start, move in zip(starts, moves, strict=True)]


def checked_factors(factors: ArrayLike) -> Array:
    """Shares of a load (L,), at least one, finite."""
    levels = np.atleast_1d(as_array("factors", factors, "shares of the load", OptionError))
    return np.asarray(checked_vectors("factors", levels, (max(np.size(levels), 1),), OptionError))
