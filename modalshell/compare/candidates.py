"""The rungs at their sizes: which a case allows, and how each is built."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from modalshell.compare.case import Case, CoarseMesh
from modalshell.models import (
    CoarseDiscreteShell,
    DiscreteShell,
    LinearModal,
    ModalDerivatives,
    ModalWarping,
    Model,
    ReducedRotationStrain,
    RigidShell,
    RotationStrain,
    coarse_shell,
)
from modalshell.modes import Basis, solve_modes
from modalshell.timings import Stopwatch

MODES = (4, 8, 16)
"""Mode counts of the rungs on rest modes."""
_DERIVED = (4, 8)
"""Mode counts of MD-ROM: with the derivatives there are up to 14 and 44 coordinates."""

_TRAINING_FACTORS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the load at whose answers reduced RSW is trained."""
_MIXTURES, _MIXED, _ASIDE = 16, 1.5, 0.1
"""Copies of each trained answer, the largest factor of its coordinates, and random ones beside them as a share of its
energy norm: without those, forces would be wrong in modes that the load leaves alone."""


class Workshop:
    """Builds models on one case; modes are found once, and their time is charged to every model that uses them."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self._bases: dict[int, tuple[Basis, float]] = {}
        self._charged = 0.0

    def basis(self, count: int) -> Basis:
        """The lowest ``count`` modes."""
        if count in self._bases:
            self._charged += self._bases[count][1]
        else:
            watch = Stopwatch()
            self._bases[count] = solve_modes(self.case.shell, count), watch()
        return self._bases[count][0]

    def build(self, candidate: Candidate) -> tuple[Model, float]:
        """The candidate's model, and what it would take to build it alone [s]."""
        self._charged = 0.0
        watch = Stopwatch()
        model = candidate.make(self)
        return model, watch() + self._charged


@dataclass(frozen=True)
class Candidate:
    """One rung at one size.

    Attributes
    ----------
    rung : str
        Its name.
    size : str
        Mode count or coarse mesh; empty where there is only one size.
    make : callable
        From a workshop to the model.
    quadratic : bool
        Whether its elastic energy is quadratic in modes about rest, so that it knows no snap.
    """

    rung: str
    size: str
    make: Callable[[Workshop], Model]
    quadratic: bool = False

    @property
    def label(self) -> str:
        """Rung and size."""
        return f"{self.rung} {self.size}".strip()


def candidates(case: Case, modes: Sequence[int] = MODES) -> tuple[list[Candidate], dict[str, str]]:
    """The rungs that ``case`` allows, DS last, and why others are left out."""
    left_out: dict[str, str] = {}
    most = case.shell.free_unknowns.size
    counts = sorted({count for count in modes if count <= most})
    if len(counts) < len(set(modes)):
        left_out["more modes"] = f"the shell has {most} free unknowns"
    found = [Candidate("rigid", "", lambda workshop: RigidShell(workshop.case.shell))]
    found += [
        Candidate(rung, str(count), partial(make, count=count), quadratic=True)
        for rung, make in _ON_REST_MODES.items()
        for count in counts
    ]
    derived = [count for count in counts if count <= max(_DERIVED)] or counts[:1]
    found += [Candidate("MD-ROM", str(count), partial(_derivatives, count=count)) for count in derived]
    found += [Candidate("coarse DS", mesh.name, partial(_coarse, mesh=mesh)) for mesh in case.coarse]
    if not case.coarse:
        left_out["coarse DS"] = "needs coarser meshes of the surface: a shape with more cells, or coarse="
    found.append(Candidate("DS", "", lambda workshop: DiscreteShell(workshop.case.shell)))
    return found, left_out


def _linear(workshop: Workshop, count: int) -> Model:
    return LinearModal(workshop.basis(count))


def _warping(workshop: Workshop, count: int) -> Model:
    return ModalWarping(workshop.basis(count))


def _consistent(workshop: Workshop, count: int) -> Model:
    return ModalWarping(workshop.basis(count), consistent_force=True)


def _strains(workshop: Workshop, count: int) -> Model:
    return RotationStrain(workshop.basis(count))


def _reduced_strains(workshop: Workshop, count: int) -> Model:
    """Trained on static answers over the load range, and on random coordinates about them, as motion makes them."""
    basis = workshop.basis(count)
    full = RotationStrain(basis)
    load = workshop.case.load
    answers = np.array([full.equilibrium(force=factor * load).coordinates for factor in _TRAINING_FACTORS])
    rng = np.random.default_rng(0)
    factors = rng.uniform(-_MIXED, _MIXED, (_MIXTURES, *answers.shape))
    sizes = np.sqrt(answers**2 @ basis.eigenvalues)[:, None] / np.sqrt(basis.eigenvalues)
    aside = _ASIDE * sizes * rng.standard_normal(factors.shape)
    return ReducedRotationStrain(full, np.vstack([answers, (factors * answers + aside).reshape(-1, count)]))


def _derivatives(workshop: Workshop, count: int) -> Model:
    return ModalDerivatives(workshop.case.shell, count)


def _coarse(workshop: Workshop, mesh: CoarseMesh) -> Model:
    shell = workshop.case.shell
    return CoarseDiscreteShell(shell, coarse_shell(shell, mesh.mesh, mesh.material))


_ON_REST_MODES: dict[str, Callable[..., Model]] = {
    "LMA": _linear,
    "MWTS": _warping,
    "MWTS, consistent": _consistent,
    "reduced RSW": _reduced_strains,
    "RSW": _strains,
}
