"""Rules that step modal coordinates."""

from modalshell.integrators.modal.base import MODAL_INTEGRATORS, ModalIntegrator
from modalshell.integrators.modal.implicit_euler import ImplicitEuler
from modalshell.integrators.modal.implicit_midpoint import ImplicitMidpoint

__all__ = ["MODAL_INTEGRATORS", "ImplicitEuler", "ImplicitMidpoint", "ModalIntegrator"]
