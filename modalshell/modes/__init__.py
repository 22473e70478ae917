"""Vibration modes of a shell: sparse factorisation, eigenpairs, modal rotation, and the basis that holds them."""

from modalshell.modes.basis import Basis, lowest_modes, model_basis, solve_modes
from modalshell.modes.derivatives import BasisSensitivity
from modalshell.modes.eigenpairs import largest_eigenvalue
from modalshell.modes.factorisation import BACKENDS, Factor, Factoriser, condensed_factor
from modalshell.modes.loaded import LoadedModes
from modalshell.modes.tangent import TangentStiffness, lowest_eigenvalue, lowest_tangent_eigenvalue

__all__ = [
    "BACKENDS",
    "Basis",
    "BasisSensitivity",
    "Factor",
    "Factoriser",
    "LoadedModes",
    "TangentStiffness",
    "condensed_factor",
    "largest_eigenvalue",
    "lowest_eigenvalue",
    "lowest_modes",
    "lowest_tangent_eigenvalue",
    "model_basis",
    "solve_modes",
]
