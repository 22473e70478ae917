"""Candidate models of a comparison, with their mode counts and coarse meshes."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

from modalshell.compare.case import Case
from modalshell.core.checks import shown
from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.models import CoarseMesh, Model
from modalshell.models.factory import ModelFactory
from modalshell.models.registry import TRUTH, ModelSpec, models
from modalshell.scene.models import model_tables

MODES = (4, 8, 16)
"""Mode counts of the rungs on modes."""


@final
@dataclass(frozen=True)
class Candidate:
    """One rung at one size."""

    spec: ModelSpec
    size: str = ""
    """Mode count or coarse mesh; empty where there is only one size."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Keys of the ``[model]`` table that make it."""
    coarse: CoarseMesh | None = None
    """The coarse mesh, of a model that needs one."""

    @property
    def label(self) -> str:
        """Rung and size."""
        return f"{self.spec.name} {self.size}".strip()

    @property
    def model_table(self) -> dict[str, Any] | None:
        """The ``[model]`` table that runs it; None on a coarse mesh that no scene can name."""
        if self.coarse is not None and not self.coarse.options:
            return None
        return {"name": self.spec.key, **self.options}

    def build(self, factory: ModelFactory) -> tuple[Model, float]:
        """The model, and the time to build it alone [s]."""
        with warnings.catch_warnings():  # the comparison states the errors itself
            warnings.filterwarnings("ignore", "no basis of up to", ModalShellWarning)
            return factory.timed(self.spec, self.options, self.coarse)


def case_factory(case: Case) -> ModelFactory:
    """What builds models on the shell of ``case``."""
    return ModelFactory(case.shell, lambda: case.load)


def candidates(case: Case, modes: Sequence[int] = MODES) -> tuple[list[Candidate], dict[str, str]]:
    """The rungs that ``case`` allows, simplest first, and why others are left out."""
    left_out: dict[str, str] = {}
    most = case.shell.unknowns.count
    counts = sorted({count for count in modes if count <= most})
    if not counts and tuple(modes) == MODES:  # nobody asked for these
        counts = [most]
    if not counts:
        raise OptionError(
            f"modes must have a count of at most {most}, the free unknowns of the shell (got {shown(modes)})"
        )
    if len(counts) < len(set(modes)):
        left_out["more modes"] = f"the shell has {most} free unknowns"
    chosen: list[Candidate] = []
    for key, spec in models().items():
        if not spec.on_ladder:
            continue
        keys = model_tables()[key].__struct_fields__
        if spec.on_coarse_mesh:
            for mesh in case.coarse[:1] if spec.needs == "coarse training" else case.coarse:
                chosen.append(Candidate(spec, mesh.name, mesh.options, mesh))
            if not case.coarse:
                left_out[spec.name] = (
                    "needs coarser meshes of the surface: a shape with more cells, coarse=, or of a mesh file "
                    "pip install 'modalshell[remesh]'"
                )
        elif "modes" in keys:
            kept = {"integrator": case.integrator} if case.integrator and spec.on_modes and "integrator" in keys else {}
            own = [count for count in counts if spec.most_modes is None or count <= spec.most_modes] or counts[:1]
            chosen += [Candidate(spec, str(count), {"modes": count} | kept) for count in own]
        else:
            chosen.append(Candidate(spec))
    return chosen, left_out


def quick_candidates(
    chosen: Sequence[Candidate], left_out: Mapping[str, str]
) -> tuple[list[Candidate], dict[str, str]]:
    """Those of the ``chosen`` that a quick comparison runs, and why others are left out.

    It runs what is ready in a second: no training, no search by motion, and no implicit steps of whole shells, whose
    kernels take most of a first comparison to compile.
    """
    kept, reasons = list[Candidate](), dict(left_out)
    for one in chosen:
        spec = one.spec
        if spec.key == TRUTH:
            reasons[spec.name] = "quick comparisons take its answers from error bars where these hold"
        elif spec.on_coarse_mesh or spec.needs == "training" or not spec.bends:
            reasons[spec.name] = "quick comparisons leave out what is trained, found by motion or on a coarse shell"
        else:
            kept.append(one)
    return kept, reasons
