"""Sheets of masses and springs, the classical models of cloth."""

from modalshell.springs.implicit import TASKS, ImplicitSprings, ImplicitStep
from modalshell.springs.mesh_springs import REFERENCE_FOLD, mesh_springs, shell_springs
from modalshell.springs.sheet_grid import SheetGrid
from modalshell.springs.spring_sheet import SpringSheet
from modalshell.springs.springs import Springs
from modalshell.springs.verlet import GridVerlet

__all__ = [
    "REFERENCE_FOLD",
    "TASKS",
    "GridVerlet",
    "ImplicitSprings",
    "ImplicitStep",
    "SheetGrid",
    "SpringSheet",
    "Springs",
    "mesh_springs",
    "shell_springs",
]
