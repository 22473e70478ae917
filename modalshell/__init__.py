"""Thin shells: a ladder of models from modal warping to discrete shells, and measures of their error and cost."""

from modalshell.core import interruption as _interruption  # noqa: F401 (first, for it acts while the others load)

# isort: split
from modalshell.kernels import compiler as _compiler  # noqa: F401 (next, for a command may compile while they do)

# isort: split
import importlib
from typing import TYPE_CHECKING, Any

from modalshell.analysis.fit import Fit, fit
from modalshell.analysis.paths import EquilibriumPath, equilibrium_path
from modalshell.core.errors import (
    FileFormatError,
    LoadError,
    MaterialError,
    MeshError,
    ModalShellError,
    ModalShellWarning,
    OptionError,
    SceneError,
    SolverError,
    SupportError,
    WorkerError,
)
from modalshell.core.outcome import Outcome
from modalshell.core.units import UnitSystem
from modalshell.export import load_clip, load_trajectory, save_trajectory
from modalshell.loads import (
    EdgeMoment,
    FollowerForce,
    FrameInertia,
    LineForce,
    PointForce,
    Pressure,
    Scaled,
    SelfWeight,
    Wind,
)
from modalshell.mesh import (
    RepairReport,
    TriangleMesh,
    cylinder_panel,
    flat_beam,
    leaf,
    load_mesh,
    paper_bird,
    remesh,
    repair,
    save_mesh,
    sheet,
    v_beam,
)
from modalshell.models import (
    Auto,
    CoarseDiscreteShell,
    DiscreteShell,
    Equilibrium,
    HybridStress,
    LinearModal,
    ModalDerivatives,
    ModalWarping,
    Model,
    ReducedRotationStrain,
    RigidShell,
    RotationStrain,
    coarse_shell,
)
from modalshell.models.error_bars import error_bar
from modalshell.models.quantity_bars import QuantityBar, quantity_bars
from modalshell.models.reduction.warp_frame import WarpFrame
from modalshell.models.registry import ModelSpec, models
from modalshell.modes import Basis, BasisSensitivity, LoadedModes, solve_modes
from modalshell.motion import SupportPath, Trajectory, simulate
from modalshell.plot import plot
from modalshell.run import RunFollower, SceneResult, run_scene
from modalshell.scene import Scene, load_scene
from modalshell.shell import (
    Crease,
    CreaseState,
    Fabric,
    Isotropic,
    Laminate,
    Material,
    Orthotropic,
    Ply,
    Shell,
    ShellFields,
    Temperature,
    card,
    cards,
    measure,
)
from modalshell.shell.damping import Damping
from modalshell.statics.bifurcation import PathEvent
from modalshell.statics.buckling import Buckling, buckling_factors
from modalshell.statics.dense import EnergyFunction
from modalshell.statics.error_bar import ErrorBar
from modalshell.supports import Clamp, Diaphragm, Fix, Pin, Roller, Symmetry, Tie
from modalshell.supports.constraints import OrientationConstraint, PositionConstraint

if TYPE_CHECKING:
    from modalshell.compare import Advice, QuickAdvice, Tradeoff, advise, quick_advice, tradeoff
    from modalshell.contact import (
        Box,
        Capsule,
        Contact,
        Cylinder,
        HeightField,
        MeshCollider,
        Plane,
        SelfContact,
        Sphere,
    )
    from modalshell.crowd import Crowd, FlightResult, Flock
    from modalshell.springs import SpringSheet
    from modalshell.sweep import SweepResult, run_sweep

__version__ = "0.1.0"

_LATER = {
    "compare": ("Advice", "QuickAdvice", "Tradeoff", "advise", "quick_advice", "tradeoff"),
    "contact": (
        "Box",
        "Capsule",
        "Contact",
        "Cylinder",
        "HeightField",
        "MeshCollider",
        "Plane",
        "SelfContact",
        "Sphere",
    ),
    "crowd": ("Crowd", "FlightResult", "Flock"),
    "springs": ("SpringSheet",),
    "sweep": ("SweepResult", "run_sweep"),
}
"""Subpackages that are imported when they or a name of theirs are first used: nothing else pays for them."""
_HOMES = {name: part for part, names in _LATER.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return importlib.import_module(f"{__name__}.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER, *_HOMES})


__all__ = [
    "Advice",
    "Auto",
    "Basis",
    "BasisSensitivity",
    "Box",
    "Buckling",
    "Capsule",
    "Clamp",
    "CoarseDiscreteShell",
    "Contact",
    "Crease",
    "CreaseState",
    "Crowd",
    "Cylinder",
    "Damping",
    "Diaphragm",
    "DiscreteShell",
    "EdgeMoment",
    "EnergyFunction",
    "Equilibrium",
    "EquilibriumPath",
    "ErrorBar",
    "Fabric",
    "FileFormatError",
    "Fit",
    "Fix",
    "FlightResult",
    "Flock",
    "FollowerForce",
    "FrameInertia",
    "HeightField",
    "HybridStress",
    "Isotropic",
    "Laminate",
    "LineForce",
    "LinearModal",
    "LoadError",
    "LoadedModes",
    "Material",
    "MaterialError",
    "MeshCollider",
    "MeshError",
    "ModalDerivatives",
    "ModalShellError",
    "ModalShellWarning",
    "ModalWarping",
    "Model",
    "ModelSpec",
    "OptionError",
    "OrientationConstraint",
    "Orthotropic",
    "Outcome",
    "PathEvent",
    "Pin",
    "Plane",
    "Ply",
    "PointForce",
    "PositionConstraint",
    "Pressure",
    "QuantityBar",
    "QuickAdvice",
    "ReducedRotationStrain",
    "RepairReport",
    "RigidShell",
    "Roller",
    "RotationStrain",
    "RunFollower",
    "Scaled",
    "Scene",
    "SceneError",
    "SceneResult",
    "SelfContact",
    "SelfWeight",
    "Shell",
    "ShellFields",
    "SolverError",
    "Sphere",
    "SpringSheet",
    "SupportError",
    "SupportPath",
    "SweepResult",
    "Symmetry",
    "Temperature",
    "Tie",
    "Tradeoff",
    "Trajectory",
    "TriangleMesh",
    "UnitSystem",
    "WarpFrame",
    "Wind",
    "WorkerError",
    "advise",
    "buckling_factors",
    "card",
    "cards",
    "coarse_shell",
    "cylinder_panel",
    "equilibrium_path",
    "error_bar",
    "fit",
    "flat_beam",
    "leaf",
    "load_clip",
    "load_mesh",
    "load_scene",
    "load_trajectory",
    "measure",
    "models",
    "paper_bird",
    "plot",
    "quantity_bars",
    "quick_advice",
    "remesh",
    "repair",
    "run_scene",
    "run_sweep",
    "save_mesh",
    "save_trajectory",
    "sheet",
    "simulate",
    "solve_modes",
    "tradeoff",
    "v_beam",
]
