"""Parameters of sensitivities: names, checks, and the force that a change of each one causes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_vectors, shown
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.shell import Shell
from modalshell.shell.energies_of import material_constants

LOADS = ("gravity", "load", "force")
"""Names of what loads an equilibrium: the acceleration, a factor on the whole load, the force on every vertex."""
SHAPES = ("rest_angles", "supports")
"""Names of what shapes it: rest angles of the hinges, positions of supported vertices."""


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
