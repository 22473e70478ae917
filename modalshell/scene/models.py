"""The models that scenes and the command line know by name, with their options."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Literal

from msgspec import Meta

from modalshell.models import (
    DiscreteShell,
    LinearModal,
    ModalDerivatives,
    ModalWarping,
    Model,
    RigidShell,
    RotationStrain,
    SpringSheet,
)
from modalshell.modes import Basis, solve_modes
from modalshell.scene.tables import Count, Table
from modalshell.shell import Shell
from modalshell.springs import REFERENCE_FOLD, shell_springs


class ModelTable(Table, frozen=True, tag_field="name"):
    """``[model]``: its name and options."""

    @abstractmethod
    def build(self, shell: Shell) -> Model:
        """The model on ``shell``, with all that it precomputes."""


class _Modal(ModelTable, frozen=True):
    modes: Count = 8
    integrator: str = "implicit_euler"

    def basis(self, shell: Shell) -> Basis:
        return solve_modes(shell, self.modes)


class Linear(_Modal, frozen=True, tag="lma"):
    """LMA."""

    def build(self, shell: Shell) -> Model:
        """The model on ``shell``, with its modes."""
        return LinearModal(self.basis(shell), integrator=self.integrator)


class Warping(_Modal, frozen=True, tag="mwts"):
    """MWTS."""

    consistent_force: bool = False

    def build(self, shell: Shell) -> Model:
        """The model on ``shell``, with its modes."""
        return ModalWarping(
            self.basis(shell),
            integrator=self.integrator,
            consistent_force=self.consistent_force,
        )


class Strains(_Modal, frozen=True, tag="rsw"):
    """RSW."""

    def build(self, shell: Shell) -> Model:
        """The model on ``shell``, with its modes."""
        return RotationStrain(self.basis(shell), integrator=self.integrator)


class Rigid(ModelTable, frozen=True, tag="rigid"):
    """The shell as a rigid body."""

    def build(self, shell: Shell) -> Model:
        """The model on ``shell``."""
        return RigidShell(shell)


class Derivatives(ModelTable, frozen=True, tag="md-rom"):
    """MD-ROM; ``cubature`` sums over few trained elements, at most this many."""

    modes: Count = 8
    cubature: bool | Count = False

    def build(self, shell: Shell) -> Model:
        """The model on ``shell``, with its modes, their derivatives, and cubature if asked for."""
        return ModalDerivatives(shell, self.modes, cubature=self.cubature)


class _Full(ModelTable, frozen=True):
    integrator: str = "implicit"
    allow_unstable_step: bool = False
    step_tolerance: Annotated[float, Meta(gt=0.0, le=1e-2)] = 1e-6


class Discrete(_Full, frozen=True, tag="ds"):
    """DS."""

    def build(self, shell: Shell) -> Model:
        """The model on ``shell``."""
        return DiscreteShell(
            shell,
            integrator=self.integrator,
            allow_unstable_step=self.allow_unstable_step,
            step_tolerance=self.step_tolerance,
        )


class Sheet(_Full, frozen=True, tag="springs"):
    """Springs along edges and across hinges, which hold the hinges' energy at ``reference_fold`` [rad]."""

    solver: Literal["factor", "cg"] = "factor"
    reference_fold: Annotated[float, Meta(gt=0.0, le=1.57)] = REFERENCE_FOLD

    def build(self, shell: Shell) -> Model:
        """The model on ``shell``, its springs from the shell's stiffnesses."""
        return SpringSheet(
            shell,
            shell_springs(shell, self.reference_fold),
            integrator=self.integrator,
            solver=self.solver,
            allow_unstable_step=self.allow_unstable_step,
            step_tolerance=self.step_tolerance,
        )


MODELS: dict[str, type[ModelTable]] = {
    str(kind.__struct_config__.tag): kind for kind in (Rigid, Linear, Warping, Strains, Derivatives, Sheet, Discrete)
}
"""Every model by its name."""
