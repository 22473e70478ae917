"""Modes about a mesh whose own stresses are in equilibrium, such as those of a prestrain or of a temperature."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.modes.eigenpairs import mass_scaled
from modalshell.modes.factorisation import Factoriser
from modalshell.modes.loaded import UnstableState, loaded_modes
from modalshell.modes.tangent import TangentStiffness
from modalshell.shell import EXACT, Shell

_SETTLED = 1e-6
"""Move of Newton's method, in sizes of the mesh, from which it is in no equilibrium."""
_RELEASED, _EXACT = 1e-10, 1e-11
"""Share of the energy that the move may release, so that stresses are those of the equilibrium to 1e-5; and the move,
in sizes of the mesh, that is rounding: thin sheets buckle by moves hardly larger."""


@final
class SettledModes(NamedTuple):
    """Eigenvalues (m,), modes (3n, m), their residual, the factor's name, and how many are of whole eigenspaces."""

    eigenvalues: Array
    modes: Array
    residual: float
    name: str
    whole: int


def distance_from_balance(shell: Shell, factoriser: Factoriser) -> float | None:
    """Newton's first step [m] from the mesh to an equilibrium of its own stresses; None where it is in one.

    That equilibrium may be many times as far: the first step of a strip that curls is along its normal, or hardly any.
    """
    x, unknowns = shell.rest_positions, shell.unknowns
    energy, whole = shell.energy_gradient(x)
    gradient = np.asarray(unknowns.restrict(whole.ravel()))
    move = np.asarray(unknowns.prolong(TangentStiffness.at(shell, x, factoriser).solve(gradient)))
    off, released = float(np.abs(move).max()), 0.5 * abs(float(move @ whole.ravel()))
    if off <= _EXACT * shell.size or (off <= _SETTLED * shell.size and released <= _RELEASED * energy):
        return None
    return off


def settled_modes(shell: Shell, count: int, backend: str | None) -> SettledModes:
    """The modes of the exact stiffness about the mesh; OptionError where that is in no stable equilibrium."""
    x, unknowns = shell.rest_positions, shell.unknowns
    factoriser = Factoriser(backend)
    if (off := distance_from_balance(shell, factoriser)) is not None:
        raise OptionError(
            "vibration modes about the mesh need a shell without stress there, or in equilibrium (got one of a "
            f"prestrain, rest_curvature, temperature or rest, of which Newton's first step is {off:.3g} m): take DS or "
            "coarse DS; or let it come to rest first, shell.settled(ms.DiscreteShell(shell).equilibrium().positions), "
            "for modes and modal models; modes under a load are those of solve_modes(shell, about=state)"
        )
    try:
        found, whole = loaded_modes(shell, x, count, backend)
    except UnstableState as error:
        raise OptionError(
            "vibration modes about the mesh need a shell that is stable there (got one that is buckled by the stresses "
            "of its prestrain, rest_curvature, temperature or rest): let it come to rest first, "
            "shell.settled(ms.DiscreteShell(shell).equilibrium().positions), for modes and modal models; or take DS or "
            "coarse DS"
        ) from error
    root = np.sqrt(unknowns.masses(shell.mass))[:, None]
    vectors = root * np.asarray(unknowns.values(found.modes))
    operator = mass_scaled(shell, shell.hessian(x, EXACT))
    left = np.linalg.norm(operator @ vectors - vectors * found.eigenvalues, axis=0)
    residual = float((left / found.eigenvalues).max())
    return SettledModes(found.eigenvalues, found.modes, residual, factoriser.backend or "multifrontal", whole)
