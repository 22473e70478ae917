"""Discrete shells: material, supports, energies over the generated kernels, and their assembly."""

from modalshell.shell.material import Material
from modalshell.shell.shell import EXACT, GAUSS_NEWTON, MIXED, PROJECTED, Shell

__all__ = ["EXACT", "GAUSS_NEWTON", "MIXED", "PROJECTED", "Material", "Shell"]
