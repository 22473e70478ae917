"""Time integrators of full models, whose unknowns are the vertices."""

from modalshell.integrators.full.base import FullIntegrator
from modalshell.integrators.full.explicit_euler import ExplicitEuler
from modalshell.integrators.full.implicit_euler import ImplicitEuler
from modalshell.integrators.full.linear_implicit_euler import LinearImplicitEuler
from modalshell.integrators.full.verlet import Verlet

__all__ = [
    "ExplicitEuler",
    "FullIntegrator",
    "ImplicitEuler",
    "LinearImplicitEuler",
    "Verlet",
]
