"""Time integrators of full models, whose unknowns are the vertices."""

from modalshell.integrators.full.base import FullIntegrator
from modalshell.integrators.full.bdf2 import BDF2
from modalshell.integrators.full.composite import Composite
from modalshell.integrators.full.explicit_euler import ExplicitEuler
from modalshell.integrators.full.implicit_euler import ImplicitEuler
from modalshell.integrators.full.implicit_rule import ImplicitRule
from modalshell.integrators.full.linear_implicit_euler import LinearImplicitEuler
from modalshell.integrators.full.sdirk2 import SDIRK2
from modalshell.integrators.full.verlet import Verlet

__all__ = [
    "BDF2",
    "SDIRK2",
    "Composite",
    "ExplicitEuler",
    "FullIntegrator",
    "ImplicitEuler",
    "ImplicitRule",
    "LinearImplicitEuler",
    "Verlet",
]
