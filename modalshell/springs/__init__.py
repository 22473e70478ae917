"""Sheets of masses and springs, the classical models beside the shells."""

from modalshell.springs.sheet_grid import SheetGrid
from modalshell.springs.springs import Springs

__all__ = ["SheetGrid", "Springs"]
