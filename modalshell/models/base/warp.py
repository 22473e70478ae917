"""Warps: displacements of a shell as a function of modal coordinates, and the modal forces of loads."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.modes import Basis
from modalshell.shell import Shell
from modalshell.statics.modal_balance import differences


class Warp(ABC):
    """Displacements of a shell as functions of modal coordinates q (m,) of a basis; the name is for messages."""

    name: str
    shell: Shell
    basis: Basis
    conservative: bool = True
    """Whether the modal force is the gradient of the load's work, so that equilibria are the minima of a potential."""

    def displacement(self, q: ArrayLike) -> Array:
        """Vertex displacements (n, 3) [m] at modal coordinates ``q`` (m,); OptionError if these are not finite."""
        return self.raw_displacement(checked_vectors("q", q, (self.basis.count,), OptionError))

    @abstractmethod
    def raw_displacement(self, q: Array) -> Array:
        """Displacements as of :meth:`displacement`, without input checks."""

    def displacement_gradient(self, q: Array, weights: Array) -> Array:
        """Derivatives (m,) at q of the displacements, contracted with weights (n, 3)."""
        raise OptionError(f"{self.name} has no derivatives: take LMA, MWTS or RSW")

    @abstractmethod
    def modal_force(self, q: Array, load: Array) -> Array:
        """Modal force p (m,) of the load (n, 3) at q."""

    def modal_force_jacobian(self, q: Array, load: Array) -> Array:
        """Derivatives ``dp/dq`` (m, m) of the modal force at q; by central differences unless overridden."""
        return differences(lambda q: self.modal_force(q, load), q, self.basis.rotations)

    @property
    def contact_shape(self) -> tuple[Array, Array, Array] | None:
        """Positions at rest (n, 3), modes, and rotations (3n, m) if they turn; None without a closed form."""
        return None

    @abstractmethod
    def on_basis(self, basis: Basis) -> Warp:
        """The same model on another basis of its shell."""


def contact_shape(basis: Basis, *, turns: bool) -> tuple[Array, Array, Array]:
    """What compiled contacts need of a warp in closed form; see :attr:`Warp.contact_shape`."""
    own = [np.array(part, dtype=np.float64, order="C") for part in (basis.shell.rest_positions, basis.modes)]
    rotations = np.array(basis.rotations, dtype=np.float64, order="C") if turns else np.empty((0, basis.count))
    return own[0], own[1], rotations
