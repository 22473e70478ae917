"""The ladder: models that answer the same scene, cheapest first."""

from modalshell.rungs.coarse import CoarseDiscreteShell, coarse_shell
from modalshell.rungs.constraints import Constraint, OrientationConstraint, PositionConstraint
from modalshell.rungs.discrete_shell import DiscreteShell
from modalshell.rungs.linear import LinearModal
from modalshell.rungs.modal_derivatives import ModalDerivatives
from modalshell.rungs.model import Damping, Equilibrium, Model, MotionState
from modalshell.rungs.reduced_rotation_strain import ReducedRotationStrain
from modalshell.rungs.rigid import RigidShell
from modalshell.rungs.rotation_strain import RotationStrain
from modalshell.rungs.spring_sheet import SpringSheet
from modalshell.rungs.warping import ModalWarping

__all__ = [
    "CoarseDiscreteShell",
    "Constraint",
    "Damping",
    "DiscreteShell",
    "Equilibrium",
    "LinearModal",
    "ModalDerivatives",
    "ModalWarping",
    "Model",
    "MotionState",
    "OrientationConstraint",
    "PositionConstraint",
    "ReducedRotationStrain",
    "RigidShell",
    "RotationStrain",
    "SpringSheet",
    "coarse_shell",
]
