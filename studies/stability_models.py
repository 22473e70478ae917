"""The models of the study ``stability_atlas``: every one with every integrator, on a strip that a scene describes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np

import modalshell as ms
from modalshell.errors import ModalShellError
from modalshell.models import CoarseMesh, Damping, Model
from studies.integrator_drift import SummedWarp

AnyModel = TypeVar("AnyModel", bound=Model)

LENGTH, CELLS, FLEXURE, DENSITY, MODES = 1.0, (12, 2), 0.05, 0.2, 4
RIGIDITY = 5.0 * FLEXURE
"""D [N m] of this mesh family, for Gamma = (mass per area) g L^3 / D."""


@dataclass(frozen=True)
class StripScene:
    """One point: step [s], membrane over bending stiffness, Gamma, damping ratio of mode 1, aspect, rest fold [deg]."""

    step: float = 1.0 / 30.0
    ratio: float = 1e2
    gamma: float = 1.0
    damping: float = 0.7
    aspect: float = 1.0
    fold: float = 0.0

    @property
    def gravity(self) -> np.ndarray:
        """Gravity (3,) [m/s^2]."""
        return np.array([0.0, 0.0, -self.gamma * RIGIDITY / (DENSITY * LENGTH**3)])

    @property
    def rayleigh(self) -> Damping:
        """Damping of the mass that gives the first mode of the strip without needles its damping ratio."""
        return Damping(2.0 * self.damping * first_frequency(self.ratio, self.fold), 0.0)


BASE = StripScene()


@dataclass(frozen=True)
class IntegratedModel:
    """A model with its integrator.

    Attributes
    ----------
    name : str
        For readers.
    make : callable
        The model of a shell.
    theory : {"implicit", "midpoint", "explicit", "rigid"}
        Which theory its limits have. Explicit rows take half their longest stable step at the base point for their own.
    """

    name: str
    make: Callable[[ms.Shell], Model]
    theory: str = "implicit"


def modal(kind: Callable[..., AnyModel], shell: ms.Shell, **options: Any) -> AnyModel:
    """A model on the modes of a shell."""
    return kind(ms.solve_modes(shell, MODES), **options)


def reduced(shell: ms.Shell, integrator: str) -> Model:
    """Reduced RSW, trained on gravity up to Gamma = 30."""
    loads = [replace(BASE, gamma=gamma).gravity for gamma in (0.3, 1.0, 3.0, 10.0, 30.0)]
    return ms.ReducedRotationStrain.trained(modal(ms.RotationStrain, shell, integrator=integrator), loads, rank=12)


def coarse_mesh(shell: ms.Shell) -> CoarseMesh:
    """The strip with ten cells along the strip instead of twelve, its rows at the clamp those of ``shell``."""
    fold, along = fold_of(shell), 10
    mesh = ms.v_beam(length=LENGTH, cells=(along, CELLS[1]), fold=180.0 - abs(fold))
    vertices, held, cell = np.array(mesh.vertices), LENGTH / CELLS[0], LENGTH / along
    beyond = held + (vertices[:, 0] - cell) * (LENGTH - held) / (LENGTH - cell)
    vertices[:, 0] = np.where(vertices[:, 0] < 0.5 * cell, 0.0, beyond)
    vertices[:, 2] *= 1.0 if fold >= 0.0 else -1.0
    return CoarseMesh(ms.TriangleMesh(vertices, mesh.faces), f"{along}x{CELLS[1]}")


def coarse(shell: ms.Shell) -> Model:
    """DS on such a mesh."""
    return ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, coarse_mesh(shell).mesh))


MODAL = (("implicit_euler", "implicit Euler", "implicit"), ("implicit_midpoint", "midpoint", "midpoint"))
"""Integrators of the models on modes: the name, in words, and the theory of their limits."""
FULL = {
    "implicit": ("implicit Euler", "implicit"),
    "linear_implicit": ("linearised implicit Euler", "implicit"),
    "explicit": ("explicit Euler", "explicit"),
    "verlet": ("Verlet", "explicit"),
}
"""The same of DS and the sheet of springs."""


def full(name: str, kind: Callable[..., Model]) -> list[IntegratedModel]:
    """The rows of a model in which every vertex is an unknown, allowed to go beyond its stable step."""
    return [
        IntegratedModel(f"{name}, {words}", partial(kind, integrator=integrator, allow_unstable_step=True), theory)
        for integrator, (words, theory) in FULL.items()
    ]


ON_MODES: dict[str, Callable[..., Model]] = {
    "LMA": partial(modal, ms.LinearModal),
    "MWTS": partial(modal, ms.ModalWarping),
    "MWTS sum": partial(modal, SummedWarp),
    "MWTS consistent": partial(modal, ms.ModalWarping, consistent_force=True),
    "RSW": partial(modal, ms.RotationStrain),
    "reduced RSW": reduced,
}
ROWS = (
    *(
        IntegratedModel(f"{name}, {words}", partial(make, integrator=integrator), theory)
        for name, make in ON_MODES.items()
        for integrator, words, theory in MODAL
    ),
    IntegratedModel("MD-ROM, implicit Euler", partial(ms.ModalDerivatives, count=MODES)),
    IntegratedModel("MD-ROM with cubature, implicit Euler", partial(ms.ModalDerivatives, count=MODES, cubature=True)),
    IntegratedModel("rigid, free and spinning", ms.RigidShell, "rigid"),
    IntegratedModel("coarse DS, implicit Euler", coarse),
    *full("springs", ms.SpringSheet),
    IntegratedModel(
        "springs, linearised implicit Euler by CG", partial(ms.SpringSheet, integrator="linear_implicit", solver="cg")
    ),
    *full("DS", ms.DiscreteShell),
)
"""Every model with every integrator; a further one is one more line."""


@cache
def shell_of(ratio: float, aspect: float, fold: float, held: bool = True) -> ms.Shell:
    """The strip, folded along its middle, one column of its cells squeezed to needles of ``aspect``."""
    mesh = ms.v_beam(length=LENGTH, cells=CELLS, fold=180.0 - abs(fold))
    vertices, cell = np.array(mesh.vertices), LENGTH / CELLS[0]
    vertices[:, 2] *= 1.0 if fold >= 0.0 else -1.0
    column = np.isclose(vertices[:, 0], 0.5 * LENGTH)
    vertices[column, 0] = 0.5 * LENGTH + cell * (1.0 - 1.0 / aspect)
    material = ms.Material(ratio * FLEXURE, ratio * FLEXURE, FLEXURE, DENSITY)
    return ms.Shell(ms.TriangleMesh(vertices, mesh.faces), material, vertices[:, 0] < 1.5 * cell if held else None)


def fold_of(shell: ms.Shell) -> float:
    """Rest fold [degrees] of a shell of :func:`shell_of`, from the slope of a flange."""
    x = shell.rest_positions
    side = x[np.argmax(x[:, 1] - x[:, 0])]
    return float(np.degrees(2.0 * np.arctan2(-side[2], side[1])))


@cache
def first_frequency(ratio: float, fold: float) -> float:
    """Lowest angular frequency [rad/s] of the strip without needles."""
    return float(np.sqrt(ms.solve_modes(shell_of(ratio, 1.0, fold), 2).eigenvalues[0]))


@cache
def static_tip(ratio: float, gamma: float, fold: float) -> np.ndarray | None:
    """Displacement (3,) [m] of the tip in the static answer of DS; None where there is none."""
    shell = shell_of(ratio, 1.0, fold)
    answer = ms.DiscreteShell(shell).equilibrium(gravity=replace(BASE, gamma=gamma).gravity)
    return tip_displacement(answer.positions, shell.rest_positions) if answer.converged else None


@cache
def model_of(row: str, ratio: float, aspect: float, fold: float) -> Model | str:
    """A row's model of a strip, or the words in which it was refused."""
    row_of = next(one for one in ROWS if one.name == row)
    try:
        return row_of.make(shell_of(ratio, aspect, fold, held=row_of.theory != "rigid"))
    except ModalShellError as error:
        return str(error)


def tip_displacement(positions: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Mean displacement (3,) of the free end."""
    return np.asarray((positions - rest)[rest[:, 0] > LENGTH - 1e-9].mean(axis=0))
