"""Thin shells from modal warping to discrete shells, and what each bit of accuracy costs."""

from modalshell import measure
from modalshell.errors import (
    FileFormatError,
    LoadError,
    MaterialError,
    MeshError,
    ModalShellError,
    ModalShellWarning,
    OptionError,
    SolverError,
    SupportError,
)
from modalshell.mesh import TriangleMesh, cylinder_panel, flat_beam, leaf, load_mesh, save_mesh, sheet, v_beam
from modalshell.modes import Basis, solve_modes
from modalshell.motion import SupportPath, Trajectory, simulate
from modalshell.rungs import (
    DiscreteShell,
    LinearModal,
    ModalWarping,
    OrientationConstraint,
    PositionConstraint,
    RotationStrain,
)
from modalshell.shell import Material, Shell

__version__ = "0.1.0"

__all__ = [
    "Basis",
    "DiscreteShell",
    "FileFormatError",
    "LinearModal",
    "LoadError",
    "Material",
    "MaterialError",
    "MeshError",
    "ModalShellError",
    "ModalShellWarning",
    "ModalWarping",
    "OptionError",
    "OrientationConstraint",
    "PositionConstraint",
    "RotationStrain",
    "Shell",
    "SolverError",
    "SupportError",
    "SupportPath",
    "Trajectory",
    "TriangleMesh",
    "cylinder_panel",
    "flat_beam",
    "leaf",
    "load_mesh",
    "measure",
    "save_mesh",
    "sheet",
    "simulate",
    "solve_modes",
    "v_beam",
]
