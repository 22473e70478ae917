"""Models of a shell, from cheap to accurate; all answer the same scene."""

from modalshell.models.auto.auto import Auto
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.model import Model
from modalshell.models.coarse.coarse_shell import CoarseMesh, coarse_shell
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.models.hybrid_stress import HybridStress
from modalshell.models.linear import LinearModal
from modalshell.models.modal_derivatives import ModalDerivatives
from modalshell.models.reduced_rotation_strain import ReducedRotationStrain
from modalshell.models.rigid import RigidShell
from modalshell.models.rotation_strain import RotationStrain
from modalshell.models.warping import ModalWarping

__all__ = [
    "Auto",
    "CoarseDiscreteShell",
    "CoarseMesh",
    "DiscreteShell",
    "Equilibrium",
    "HybridStress",
    "LinearModal",
    "ModalDerivatives",
    "ModalWarping",
    "Model",
    "ReducedRotationStrain",
    "RigidShell",
    "RotationStrain",
    "coarse_shell",
]
