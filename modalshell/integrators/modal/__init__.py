"""Time integrators of modal coordinates."""

from modalshell.integrators.modal.base import ModalIntegrator
from modalshell.integrators.modal.exponential import Exponential
from modalshell.integrators.modal.implicit_euler import ImplicitEuler
from modalshell.integrators.modal.implicit_midpoint import ImplicitMidpoint

__all__ = ["Exponential", "ImplicitEuler", "ImplicitMidpoint", "ModalIntegrator"]
