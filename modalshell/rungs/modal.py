"""What the models on a modal basis share: coordinates, the rigid-mode balance, implicit Euler mode by mode."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.modes import Basis
from modalshell.modes.rigid import rigid_motions
from modalshell.rungs.model import Damping, Model, MotionState

Array = NDArray[np.float64]

RIGID_LOAD = 1e-9
"""Share of the load's norm that may act on rigid modes before a free shell counts as having no equilibrium."""


class ModalModel(Model):
    """A model whose unknowns are the m modal coordinates q.

    Parameters
    ----------
    basis : Basis
        Modes, eigenvalues and modal rotations of the shell.
    """

    in_shell_frame = True

    def __init__(self, basis: Basis) -> None:
        self.basis = basis
        self.shell = basis.shell
        self._mass = np.repeat(self.shell.mass, 3)

    @abstractmethod
    def displacement(self, q: Array) -> Array:
        """Vertex displacements (n, 3) [m] at modal coordinates q (m,)."""

    @abstractmethod
    def modal_force(self, q: Array, load: Array) -> Array:
        """Modal force p (m,) of the load (n, 3) at q."""

    def coordinates_of(self, positions: ArrayLike) -> Array:
        """Modal coordinates (m,) of the mass-weighted projection of ``positions`` (n, 3)."""
        displacement = (self.shell.checked_positions(positions) - self.shell.rest_positions).ravel()
        return np.asarray(self.basis.modes.T @ (self._mass * displacement))

    def rigid_load(self, load: Array) -> float:
        """Share of the load, in the modes' norm, that pushes on rigid modes: nothing holds it in statics."""
        if self.basis.rigid_modes == 0 or not load.any():
            return 0.0
        # All of them: the basis may have been asked for fewer modes.
        free = self.shell.free_unknowns
        pushed = rigid_motions(self.shell).T @ load.ravel()[free]
        return float(np.linalg.norm(pushed) / np.sqrt(np.sum(load.ravel()[free] ** 2 / self._mass[free])))

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """Modal state at rest."""
        q = np.zeros(self.basis.count) if positions is None else self.coordinates_of(positions)
        return MotionState(q, np.zeros_like(q))

    def step(
        self,
        state: MotionState,
        dt: float,
        load: Array,
        damping: Damping,
        held: Array | None = None,  # noqa: ARG002 (its supports rest in its own frame)
    ) -> tuple[MotionState, bool]:
        """Implicit Euler for every mode by itself, with the modal force of the step before."""
        stiffness = self.basis.eigenvalues
        p = self.modal_force(state.coordinates, load)
        damp = damping.mass_factor + damping.stiffness_factor * stiffness
        rates = (state.rates + dt * (p - stiffness * state.coordinates)) / (1.0 + dt * damp + dt**2 * stiffness)
        return MotionState(state.coordinates + dt * rates, rates), True

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m] of a state."""
        return np.asarray(self.shell.rest_positions + self.displacement(state.coordinates))
