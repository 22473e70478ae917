"""What the parts of the study of motion share: a strip with either energy, every rung of it, and its rules."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.cost import counted
from modalshell.models.hybrid.training import Trained, Training, train
from modalshell.models.registry import TRUTH, models

LENGTH, WIDTH, CELLS, MODES = 1.0, 0.2, (12, 2), 8
HINGES = ms.Material(200.0, 200.0, 0.05, 0.2)
SHEET = ms.Isotropic(young=1e6, poisson=0.3, thickness=0.02, density=1000.0)
THIN = ms.Isotropic(young=1e7, poisson=0.3, thickness=4e-3, density=1000.0)
ENERGIES: dict[str, ms.Material | ms.Isotropic] = {"hinges": HINGES, "Isotropic": SHEET, "Isotropic, thin": THIN}
"""Materials of the strip; the thin one's membrane is 25 times as stiff against its bending, 7.5e5 / L^2."""
MOTIONS = 6
"""Motions that the hybrid is trained on."""
MODAL_RULES = ("exponential", "implicit_midpoint", "implicit_euler")
FULL_RULES = ("composite", "bdf2", "sdirk2", "implicit_euler")
DEFAULTS = {
    ms.DiscreteShell.name: "composite",
    ms.CoarseDiscreteShell.name: "bdf2",
    ms.HybridStress.name: "bdf2",
    ms.SpringSheet.name: "bdf2",
    ms.ModalDerivatives.name: "bdf2",
}
"""Rule by which each full rung is judged; modal rungs are judged by the exponential one."""
REFERENCE = models()[TRUTH].name
"""Name of the model that others are compared with."""


@dataclass(frozen=True)
class Rung:
    """A rung on one shell: its name, its rules, and the model of each."""

    name: str
    rules: tuple[str, ...]
    make: Callable[[str], ms.Model]

    @property
    def modal(self) -> bool:
        """Whether its unknowns are those of modes that step by themselves."""
        return self.rules is MODAL_RULES

    @property
    def default(self) -> str:
        """The rule by which it is judged."""
        return "exponential" if self.modal else DEFAULTS[self.name]


@cache
def strip(energy: str) -> ms.Shell:
    """A flat strip of one of the ``ENERGIES``, clamped at one end."""
    mesh = ms.flat_beam(length=LENGTH, width=WIDTH, cells=CELLS)
    x = mesh.vertices[:, 0]
    # Hinges know no slope at a boundary: there two rows are held.
    held = 1.5 * LENGTH / CELLS[0] if energy == "hinges" else 1e-9
    return ms.Shell(mesh, ENERGIES[energy], clamped=x < held)


@cache
def sheet_in_plane() -> ms.Shell:
    """The strip of hinges that moves in its plane alone: springs have no stiffness against bending at rest."""
    mesh = ms.flat_beam(length=LENGTH, width=WIDTH, cells=CELLS)
    free = np.ones(len(mesh.vertices), dtype=bool)
    return ms.Shell(mesh, HINGES, mesh.vertices[:, 0] < 1.5 * LENGTH / CELLS[0], supports=[ms.Fix(free, "z")])


def weight(shell: ms.Shell, gamma: float) -> np.ndarray:
    """Gravity (3,) [m/s^2] of a dimensionless load."""
    return np.array([0.0, 0.0, -gamma / ms.measure.gamma_per_gravity(shell)])


@cache
def trained(shell: ms.Shell, gamma: float) -> Trained:
    """What a hybrid knows of motion about a load."""
    load = shell.gravity_force(weight(shell, gamma))
    return train(shell, load, Training(modes=16, motions=MOTIONS, seed=0, error=None))


def rungs(shell: ms.Shell, gamma: float, *, with_hybrid: bool) -> list[Rung]:
    """Every rung of a shell; those that are trained are trained about a load ``gamma``."""
    basis = ms.solve_modes(shell, MODES)
    load = shell.gravity_force(weight(shell, gamma))
    loads = np.array([share * load for share in (0.2, 0.4, 0.6, 0.8, 1.0)])
    reduced = models()["reduced-rsw"]
    found = [
        Rung(ms.LinearModal.name, MODAL_RULES, lambda rule: ms.LinearModal(basis, integrator=rule)),
        Rung(ms.ModalWarping.name, MODAL_RULES, lambda rule: ms.ModalWarping(basis, integrator=rule)),
        Rung(ms.RotationStrain.name, MODAL_RULES, lambda rule: ms.RotationStrain(basis, integrator=rule)),
        Rung(reduced.name, MODAL_RULES, lambda rule: reduced.builder(basis, loads, integrator=rule)),
        Rung(ms.ModalDerivatives.name, FULL_RULES, lambda rule: ms.ModalDerivatives(shell, MODES, integrator=rule)),
        Rung(
            ms.CoarseDiscreteShell.name, FULL_RULES, lambda rule: ms.CoarseDiscreteShell(shell, shell, integrator=rule)
        ),
        Rung(ms.DiscreteShell.name, FULL_RULES, lambda rule: ms.DiscreteShell(shell, integrator=rule)),
    ]
    if with_hybrid:
        found.insert(
            5,
            Rung(
                ms.HybridStress.name,
                FULL_RULES,
                lambda rule: ms.HybridStress(shell, shell, trained(shell, gamma), integrator=rule),
            ),
        )
    return found


def moved(
    model: ms.Model, steps: int, dt: float, every: int = 1, **motion: Any
) -> tuple[ms.Trajectory, dict[str, Any]]:
    """A motion of ``steps``, each ``every``-th stored, and what it took: counts of solves and reference seconds."""
    with counted() as work, warnings.catch_warnings(action="ignore", category=ms.ModalShellWarning):
        run = ms.simulate(model, duration=steps * dt, dt=dt, store_every=every, **motion)
    took = {"solves": work.solves, "cost": 1e-6 * work.cost, "status": run.status, "unsolved": run.unconverged_steps}
    return run, took


def first_frequency(shell: ms.Shell) -> float:
    """Lowest angular frequency [rad/s]."""
    return float(2.0 * np.pi * ms.solve_modes(shell, 1).frequencies[0])
