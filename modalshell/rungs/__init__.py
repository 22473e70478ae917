"""The ladder: models that answer the same scene, cheapest first."""

from modalshell.rungs.discrete_shell import DiscreteShell
from modalshell.rungs.linear import LinearModal
from modalshell.rungs.model import Damping, Equilibrium, Model, MotionState
from modalshell.rungs.warping import ModalWarping

__all__ = ["Damping", "DiscreteShell", "Equilibrium", "LinearModal", "ModalWarping", "Model", "MotionState"]
