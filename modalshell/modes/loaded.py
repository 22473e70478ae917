"""Small vibrations about a loaded state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.brief import brief
from modalshell.checks import finite_answer
from modalshell.errors import OptionError, SolverError
from modalshell.modes.eigenpairs import canonical_pairs, dense_pairs, lanczos_pairs, mass_scaled
from modalshell.modes.rigid import RigidFreeSolver
from modalshell.sharing import ReadOnlyArrays, read_only
from modalshell.shell import EXACT, Shell
from modalshell.typing import Array

_DENSE_BELOW = 150
"""Unknowns up to which a dense solver finds all eigenpairs."""


class State(Protocol):
    """An equilibrium."""

    @property
    def positions(self) -> Array:
        """Vertex positions (n, 3) [m]."""


@final
@brief
@dataclass(frozen=True)
class LoadedModes(ReadOnlyArrays):
    """Small vibrations of a shell about a stable state under dead loads.

    Attributes
    ----------
    shell : Shell
        The shell.
    positions : ndarray, shape (n, 3)
        The state [m].
    eigenvalues : ndarray, shape (m,)
        Squared angular frequencies [1/s^2], ascending.
    modes : ndarray, shape (3n, m)
        Mass-orthonormal displacements from the state, as supports allow them [1/sqrt(kg)].
    """

    shell: Shell
    positions: Array
    eigenvalues: Array
    modes: Array

    @property
    def frequencies(self) -> Array:
        """Natural frequencies (m,) [Hz]."""
        return np.sqrt(self.eigenvalues) / (2.0 * np.pi)

    @property
    def count(self) -> int:
        """Number of modes m."""
        return int(self.eigenvalues.size)


def loaded_modes(shell: Shell, about: State | ArrayLike, count: int, backend: str | None) -> LoadedModes:
    """The ``count`` lowest vibrations about a state, or positions (n, 3) [m]; see :func:`modalshell.solve_modes`."""
    given: Any = about
    x = shell.checked_positions(getattr(given, "positions", given))
    unknowns = shell.unknowns
    if count > unknowns.count:
        raise OptionError(f"count must be at most {unknowns.count}, the number of free unknowns (got {count})")
    mass = unknowns.masses(shell.mass)
    data = shell.energy_gradient_hessian(x, EXACT)[2]
    if not np.isfinite(data).all():
        raise OptionError("about must be a stable state (got one whose stiffness is not finite)")
    root, none = np.sqrt(mass), np.empty((mass.size, 0))
    wanted = min(count + 1, mass.size)
    unstable = OptionError(
        "about must be a stable state under dead loads, of a shell that its supports hold (got one about which the "
        "stiffness is not positive definite): see its stable and its converged"
    )
    if mass.size <= max(_DENSE_BELOW, 3 * wanted):
        dense = np.asarray(mass_scaled(shell, data) @ np.eye(mass.size))
        dense = 0.5 * (dense + dense.T)
        if np.linalg.eigvalsh(dense)[0] <= 0.0:
            raise unstable
        values, vectors = dense_pairs(dense, none, wanted)
    else:
        try:
            solver = RigidFreeSolver(shell.pattern.free_matrix(data), none, mass, backend)
        except SolverError as error:
            raise unstable from error
        if not solver.factor.is_definite():
            raise unstable
        values, vectors = lanczos_pairs(solver, root, none, wanted)
    values, vectors = canonical_pairs(values, vectors, count)
    modes = np.asarray(unknowns.prolong(vectors / root[:, None]))
    finite_answer("the modes", values, modes)
    return LoadedModes(shell, read_only(x.copy()), read_only(values.copy()), read_only(modes))
