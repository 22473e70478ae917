"""What holds a shell: supports, constraints on patches, and the affine map from free unknowns to vertex positions."""

from modalshell.supports.base import SUPPORTS, Support
from modalshell.supports.kinds import Clamp, Diaphragm, Fix, Pin, Roller, Symmetry, Tie
from modalshell.supports.path import Pose, SupportPath
from modalshell.supports.unknowns import Unknowns, VertexUnknowns, supported_unknowns

__all__ = [
    "SUPPORTS",
    "Clamp",
    "Diaphragm",
    "Fix",
    "Pin",
    "Pose",
    "Roller",
    "Support",
    "SupportPath",
    "Symmetry",
    "Tie",
    "Unknowns",
    "VertexUnknowns",
    "supported_unknowns",
]
