"""Vibration modes of a shell: sparse factorisation, eigenpairs, modal rotation, and the basis that holds them."""

from modalshell.modes.basis import Basis, lowest_modes, solve_modes
from modalshell.modes.derivatives import BasisSensitivity
from modalshell.modes.eigenpairs import (
    largest_eigenvalue,
    lowest_tangent_eigenvalue,
    lowest_tangent_mode,
    nearest_tangent_mode,
)
from modalshell.modes.factorisation import BACKENDS, Factor, Factoriser, condensed_factor
from modalshell.modes.loaded import LoadedModes

__all__ = [
    "BACKENDS",
    "Basis",
    "BasisSensitivity",
    "Factor",
    "Factoriser",
    "LoadedModes",
    "condensed_factor",
    "largest_eigenvalue",
    "lowest_modes",
    "lowest_tangent_eigenvalue",
    "lowest_tangent_mode",
    "nearest_tangent_mode",
    "solve_modes",
]
