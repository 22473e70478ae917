"""The models of the study ``stability_atlas``: every one with every integrator, on a strip that a scene describes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Literal

import numpy as np

import modalshell as ms
from modalshell.integrators.base import Integrator
from modalshell.integrators.full import FullIntegrator, ImplicitRule
from modalshell.integrators.modal import ModalIntegrator
from modalshell.models import CoarseMesh
from modalshell.models.factory import ModelFactory
from modalshell.scene.models import model_tables
from studies.integrator_drift import SummedWarp

LENGTH, CELLS, FLEXURE, DENSITY, MODES = 1.0, (12, 2), 0.05, 0.2, 4
VERTEX_MODELS = ms.DiscreteShell.name, ms.SpringSheet.name
"""Models whose unknowns are the vertices of the shell itself: explicit rules step them too."""
MOTIONS = 12
"""Motions that a model is trained on, where it is."""
RIGIDITY = 5.0 * FLEXURE
"""D [N m] of this mesh family, for Gamma = (mass per area) g L^3 / D."""
THEORY = {
    "exponential": "exact",
    "implicit_midpoint": "midpoint",
    "bdf2": "bdf2",
    "sdirk2": "sdirk2",
    "composite": "composite",
    "explicit": "explicit",
    "verlet": "explicit",
}
"""Theory of the limits of integrators that are not implicit Euler."""


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
    def rayleigh(self) -> ms.Damping:
        """Damping of the mass that gives the first mode of the strip without needles its damping ratio."""
        return ms.Damping(2.0 * self.damping * first_frequency(self.ratio, self.fold), 0.0)


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
    theory : {"implicit", "exact", "midpoint", "bdf2", "sdirk2", "composite", "explicit", "rigid"}
        Which theory its limits have: that of implicit Euler, of the exact flow of each mode, and so on. Explicit rows
        take half their longest stable step at the base point for their own.
    kind : {"rigid", "linear", "modal", "full", "other"}
        What steps: a rigid body, modes by themselves, modes under a force that turns with them, every vertex, or
        something without a theory.
    bends : bool
        Whether the flat strip has bending modes.
    coordinates : str
        Name of the row whose modal coordinates move the same way, if its shape alone differs from that one's.
    """

    name: str
    make: Callable[[ms.Shell], ms.Model]
    theory: str = "implicit"
    kind: Literal["rigid", "linear", "modal", "full", "other"] = "other"
    bends: bool = True
    coordinates: str = ""


def built(spec: ms.ModelSpec, options: dict[str, Any], shell: ms.Shell) -> ms.Model:
    """The model of a record on a strip, allowed to go beyond its stable step.

    It is trained up to Gamma = 30; on motions, which fail on soft strips under such a load, about the base point.
    """
    on_motions = spec.needs == "coarse training"
    load = shell.gravity_force((BASE if on_motions else replace(BASE, gamma=30.0)).gravity)
    factory = ModelFactory(shell, lambda: load, lambda *_: coarse_mesh(shell))
    common = {"motions": MOTIONS} if on_motions else {"modes": MODES, "rank": 12, "allow_unstable_step": True}
    known = model_tables()[spec.key].__struct_fields__
    with warnings.catch_warnings():
        if on_motions:  # training warns of the errors that the maps show
            warnings.simplefilter("ignore", ms.ModalShellWarning)
        return factory.build(spec, {name: value for name, value in common.items() if name in known} | options)


def summed(shell: ms.Shell, integrator: str) -> ms.Model:
    """MWTS with the summed warp, which no scene knows."""
    return SummedWarp(ms.solve_modes(shell, MODES), integrator=integrator)


def coarse_mesh(shell: ms.Shell) -> CoarseMesh:
    """The strip with ten cells along the strip instead of twelve, its rows at the clamp those of ``shell``."""
    x = shell.rest_positions
    side = x[np.argmax(x[:, 1] - x[:, 0])]  # its flange's slope is half of the fold
    fold, along = float(np.degrees(2.0 * np.arctan2(-side[2], side[1]))), 10
    mesh = ms.v_beam(length=LENGTH, cells=(along, CELLS[1]), fold=180.0 - abs(fold))
    vertices, held, cell = np.array(mesh.vertices), LENGTH / CELLS[0], LENGTH / along
    beyond = held + (vertices[:, 0] - cell) * (LENGTH - held) / (LENGTH - cell)
    vertices[:, 0] = np.where(vertices[:, 0] < 0.5 * cell, 0.0, beyond)
    vertices[:, 2] *= 1.0 if fold >= 0.0 else -1.0
    return CoarseMesh(ms.TriangleMesh(vertices, mesh.faces), f"{along}x{CELLS[1]}")


def rules_of(spec: ms.ModelSpec) -> Iterator[type[Integrator]]:
    """The integrators that a model takes, each once whatever its other names."""
    kind = ModalIntegrator if spec.on_modes else FullIntegrator
    for rule in dict.fromkeys(kind.known.values()):
        if spec.on_modes or spec.name in VERTEX_MODELS or issubclass(rule, ImplicitRule):
            yield rule


def integrated_models() -> Iterator[IntegratedModel]:
    """Every registered model with every integrator, and variants that move otherwise."""
    known = {key: spec for key, spec in ms.models().items() if spec.on_ladder}
    for spec in known.values():
        name = spec.name.replace(",", "")
        if spec.response == "rigid":
            yield IntegratedModel(f"{name}, free and spinning", partial(built, spec, {}), "rigid", "rigid")
            continue
        kind: Any = "other"
        if spec.on_modes:
            kind = "linear" if spec.response == "linear" else "modal"
        elif spec.name in VERTEX_MODELS:
            kind = "full"
        for rule in rules_of(spec):
            make, theory = partial(built, spec, {"integrator": rule.key}), THEORY.get(rule.key, "implicit")
            yield IntegratedModel(f"{name}, {rule.name}", make, theory, kind, spec.bends)
    for rule in rules_of(known["mwts"]):
        make, same = partial(summed, integrator=rule.key), f"{known['mwts'].name}, {rule.name}"
        theory = THEORY.get(rule.key, "implicit")
        yield IntegratedModel(f"MWTS sum, {rule.name}", make, theory, "modal", coordinates=same)
    for rule in rules_of(known["md-rom"]):
        options = {"cubature": True, "integrator": rule.key}
        theory = THEORY.get(rule.key, "implicit")
        yield IntegratedModel(f"MD-ROM with cubature, {rule.name}", partial(built, known["md-rom"], options), theory)
    by_iterations = partial(built, known["springs"], {"integrator": "linear_implicit", "solver": "cg"})
    name = "springs, linearised implicit Euler by CG"
    yield IntegratedModel(name, by_iterations, kind="full", bends=known["springs"].bends)


ROWS = {row.name: row for row in integrated_models()}


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


@cache
def first_frequency(ratio: float, fold: float) -> float:
    """Lowest angular frequency [rad/s] of the strip without needles."""
    return float(np.sqrt(ms.solve_modes(shell_of(ratio, 1.0, fold), 2).eigenvalues[0]))


@cache
def model_of(row: str, ratio: float, aspect: float, fold: float) -> ms.Model | str:
    """A row's model of a strip, or the words in which it was refused."""
    try:
        return ROWS[row].make(shell_of(ratio, aspect, fold, held=ROWS[row].theory != "rigid"))
    except ms.ModalShellError as error:
        return str(error)


@cache
def static_tip(ratio: float, gamma: float, fold: float) -> np.ndarray | None:
    """Displacement (3,) [m] of the tip in the static answer of DS; None if there is none."""
    shell = shell_of(ratio, 1.0, fold)
    answer = ms.DiscreteShell(shell).equilibrium(gravity=replace(BASE, gamma=gamma).gravity)
    return tip_displacement(answer.positions, shell.rest_positions) if answer.converged else None


def tip_displacement(positions: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Mean displacement (3,) of the free end."""
    return np.asarray((positions - rest)[rest[:, 0] > LENGTH - 1e-9].mean(axis=0))
