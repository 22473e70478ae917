"""Which rung does a strip need? Errors of the ladder over fold angle, membrane stiffness and load, against DS.

A strip, folded along its middle by more or less, hangs under growing gravity. For every fold (at one membrane
stiffness) and for every membrane stiffness (at one fold) each rung's equilibrium is compared with DS on the same mesh;
the map shows the cheapest rung that stays within 1, 5 and 20 % of its displacement. The path of equilibria of each
strip is followed through its snap: bifurcation, limit point and the load from which states after the snap are stable
are drawn. Beyond the snap no rung on rest modes is of use, and DS on a coarse mesh takes over.

Gravity is given as Gamma, see :func:`modalshell.measure.gamma_per_gravity`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.path import Marks
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.models import CoarseMesh
from modalshell.models.coarse.coarse_mesh import drawn_to_supports
from modalshell.models.factory import ModelFactory
from modalshell.models.registry import TRUTH
from modalshell.scene.models import model_tables
from studies.pages import counted, markdown, result_of

FIGURES = ("validity_map",)

MOTIONS = 12
"""Motions that a model is trained on, where it is."""
LENGTH, WIDTH = 1.0, 0.2
FLEXURE, DENSITY, MODES = 0.05, 0.2, 8
FOLDS = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0)
"""Angles between the flanges' normals [degrees]; 0 is flat."""
MEMBRANES = (2.0, 10.0, 50.0, 250.0, 1250.0, 6250.0, 31250.0)
"""Stretch and shear stiffness [N/m, N]."""
FIXED = {"fold": 30.0, "membrane": 250.0}
GAMMAS = tuple(np.geomspace(1.0 / 16.0, 64.0, 11))
TOLERANCES = (0.01, 0.05, 0.2)
MARKS = ("bifurcation", "limit", "stable_again")
"""What is marked of the path of equilibria of each strip."""
RUNGS = tuple(spec for spec in ms.models().values() if spec.pictured and spec.bends and spec.key != TRUTH)
"""Records below DS, cheapest first: those with a shape of their own, and with the bending that a flat strip needs.

Those trained on motions are trained at every load.
"""
LADDER = tuple(spec.name for spec in RUNGS)


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Solve both maps; ``quick`` takes fewer cases on a coarser mesh."""
    cells = (16, 4) if quick else (30, 6)
    folds, membranes = (FOLDS[::4], MEMBRANES[1::4]) if quick else (FOLDS, MEMBRANES)
    gammas = np.array(GAMMAS[3::3] if quick else GAMMAS)
    cases = [("fold", fold, fold, FIXED["membrane"]) for fold in folds]
    cases += [("membrane", membrane, FIXED["fold"], membrane) for membrane in membranes]
    found: dict[str, Any] = {name: {"values": [], "rows": []} for name in ("fold", "membrane")}
    for axis, value, fold, membrane in counted(cases, on_step):
        found[axis]["values"].append(value)
        found[axis]["rows"].append(row(cells, fold, membrane, gammas))
    for one in found.values():
        one["cheapest"] = [[cheapest(case, tolerance) for case in one["rows"]] for tolerance in TOLERANCES]
    findings = {"maps": found, "gammas": gammas, "tolerances": TOLERANCES, "ladder": LADDER}
    arrays = {
        f"{axis}_errors": np.array([[case["errors"][rung] for rung in LADDER] for case in found[axis]["rows"]], float)
        for axis in found
    }
    return result_of("validity_map", findings, arrays, cells=cells)


def row(cells: tuple[int, int], fold: float, membrane: float, gammas: np.ndarray) -> dict[str, Any]:
    """Errors of every rung at each load of one strip, and the loads that mark its path of equilibria, None for none."""
    mesh = ms.v_beam(length=LENGTH, width=WIDTH, fold=180.0 - fold, cells=cells)
    material = ms.Material(membrane, membrane, FLEXURE, DENSITY)
    shell = ms.Shell(mesh, material, mesh.vertices[:, 0] < 1.5 * LENGTH / cells[0])
    half = ms.v_beam(length=LENGTH, width=WIDTH, fold=180.0 - fold, cells=(cells[0] // 2, 4 if cells[1] > 4 else 2))
    coarse = CoarseMesh(drawn_to_supports(shell, half), "half the cells")
    gamma_per_gravity = ms.measure.gamma_per_gravity(shell)
    unit = shell.gravity_force((0.0, 0.0, -1.0))
    gravity = 0.0
    factory = ModelFactory(shell, lambda: gravity * unit, coarse=lambda *_: coarse)

    def built(spec: ms.ModelSpec) -> ms.Model:
        if spec.needs == "coarse training":
            with warnings.catch_warnings():  # training warns of the errors that the map shows
                warnings.simplefilter("ignore", ms.ModalShellWarning)
                return factory.build(spec, {"motions": MOTIONS})
        return factory.build(spec, {"modes": MODES} if "modes" in model_tables()[spec.key].__struct_fields__ else {})

    kept = {spec.name: built(spec) for spec in RUNGS if spec.needs != "coarse training"}
    truth, last = ms.DiscreteShell(shell), mesh.vertices
    path = ms.equilibrium_path(shell, force=unit, until=gammas[-1] / gamma_per_gravity, steps=40, branches=1)
    marks = Marks.of(path)
    places = {"snap": marks.snap, **{name: getattr(marks, name) for name in MARKS}}
    scaled = {name: None if place is None else gamma_per_gravity * place for name, place in places.items()}
    errors: dict[str, list[float | None]] = {name: [] for name in LADDER}
    statuses = []
    for gamma in gammas:
        gravity = gamma / gamma_per_gravity
        exact = truth.equilibrium(gravity=(0, 0, -gravity), start=last)
        statuses.append(exact.status)
        for spec in RUNGS:
            try:
                answer = (kept.get(spec.name) or built(spec)).equilibrium(gravity=(0, 0, -gravity))
            except ms.SolverError:  # a motion of the training that its coarse shell cannot follow
                errors[spec.name].append(None)
                continue
            error = ms.measure.displacement_error(answer.positions, exact.positions, shell)
            # Without an equilibrium, or without a truth, there is no error to state.
            errors[spec.name].append(error if answer.converged and exact.converged else None)
        last = exact.positions
    return {"errors": errors, "ds_statuses": statuses, **scaled}


def cheapest(found: dict[str, Any], tolerance: float) -> list[str]:
    """Cheapest rung within ``tolerance`` at each load of one row; DS where none is, "no answer" without a truth."""
    names = []
    for place, status in enumerate(found["ds_statuses"]):
        errors = {name: one[place] for name, one in found["errors"].items()}
        good = [name for name, error in errors.items() if error is not None and error <= tolerance]
        names.append(
            "no answer" if status != ms.Outcome.CONVERGED.value else good[0] if good else ms.DiscreteShell.name
        )
    return names


def reach(case: dict[str, Any], rung: str, tolerance: float, gammas: Sequence[float]) -> float:
    """Largest Gamma up to which a rung stays within a tolerance; 0 where it does not at the smallest."""
    errors = [np.inf if error is None else error for error in case["errors"][rung]]
    within = int(np.cumprod(np.array(errors) <= tolerance).sum())
    return gammas[within - 1] if within else 0.0


def table(result: StudyResult) -> str:
    """Largest Gamma up to which each rung stays within each tolerance, one row per strip."""
    found, rows, ladder = result.findings, [], result.findings["ladder"]
    for axis, words in {"fold": "fold {:g}°", "membrane": "membrane {:g} N/m"}.items():
        for value, case in zip(found["maps"][axis]["values"], found["maps"][axis]["rows"], strict=True):
            reached = [[reach(case, rung, limit, found["gammas"]) for limit in TOLERANCES] for rung in ladder]
            cells = [" / ".join(f"{gamma:.2g}" if gamma else "–" for gamma in one) for one in reached]
            rows.append({**case, "strip": words.format(value), "reached": cells})
    names = " | ".join(f"{rung} within 1 / 5 / 20 %" for rung in ladder)
    strips = markdown(
        f"strip | snap at Γ | bifurcation | limit | stable again | {names}",
        "{strip} | {snap:.3g|no} | {bifurcation:.3g|no} | {limit:.3g|no} | {stable_again:.3g|no} | {reached}",
        rows,
    )
    return f"{strips}\n\nNumbers are the largest Γ of the sweep up to which the rung stays within; – for none."


def finding(result: StudyResult) -> str:
    """Loads up to which models on rest modes, and coarse DS, stay within 5 %."""
    maps, gammas = result.findings["maps"], result.findings["gammas"]

    def within(case: dict[str, Any], rung: str) -> float:
        return reach(case, rung, 0.05, gammas)

    folds = dict(zip(maps["fold"]["values"], maps["fold"]["rows"], strict=True))
    coarse_ones = {spec.name for spec in ms.models().values() if spec.on_coarse_mesh}
    modal = [rung for rung in result.findings["ladder"] if rung not in coarse_ones]
    best = max(within(case, rung) for fold, case in folds.items() if fold >= 20.0 for rung in modal)
    strips = [*folds.values(), *maps["membrane"]["rows"]]
    coarse = sum(within(case, ms.CoarseDiscreteShell.name) >= gammas[-1] for case in strips)
    return (
        f"Flat, {ms.RotationStrain.name} stays within 5 % up to Γ = {within(folds[0.0], ms.RotationStrain.name):.2g}; "
        f"with folds from 20° on no model on rest modes does beyond Γ = {best:.2g}. Coarse DS does up to "
        f"Γ = {gammas[-1]:.2g} on {coarse} of {len(strips)} strips."
    )
