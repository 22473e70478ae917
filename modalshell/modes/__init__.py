"""Vibration modes of a shell: sparse factorisation, eigenpairs, modal rotation, and the basis that holds them."""

from modalshell.modes.basis import Basis, solve_modes
from modalshell.modes.eigenpairs import largest_eigenvalue, lowest_eigenpair, lowest_tangent_eigenvalue, mass_scaled
from modalshell.modes.factorisation import Factor, Factoriser, available_backends

__all__ = [
    "Basis",
    "Factor",
    "Factoriser",
    "available_backends",
    "largest_eigenvalue",
    "lowest_eigenpair",
    "lowest_tangent_eigenvalue",
    "mass_scaled",
    "solve_modes",
]
