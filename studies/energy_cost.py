"""What shell theory costs: forces, Hessians, steps and statics of both energies on the same meshes, and what they buy.

Isotropic shells have a fold share per edge between pairs of triangles as a further unknown, and smooth their membrane
over edges; calibrated hinges have neither. Both are timed on the same meshes in one process, in turns; the least time
of the processor counts.
Steps are of the default rule, from rest under weight, 1/60 s each; statics is the rest under 0.3 of that
weight. Second, a supported plate (:mod:`studies.mesh_bias`): the error of its deflection over the seconds of the static
answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.shell import EXACT
from studies import mesh_bias
from studies.pages import markdown, paragraphs, result_of
from studies.shell_theory import ENERGIES, FAMILIES, Sheet, crossed, flat_shell, rows_of

FIGURES = ("energy_cost",)

SHEET: Sheet = {"young": 1e9, "poisson": 0.3, "thickness": 2e-3, "density": 1000.0}
AIMS = {"gradient": 2.5, "Hessian": 5.0, "implicit step": 4.0, "statics": 4.0}
"""Ratios of the seconds of Isotropic shells to those of hinges that are aimed at."""
REPEATS = {"gradient": 60, "Hessian": 20, "implicit step": 3, "statics": 2}
STEPS, STEP = 6, 1.0 / 60.0


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All mesh families and sizes; ``quick`` takes coarse meshes and few repeats."""
    cells, sizes = (6, (6, 12)) if quick else (50, (8, 12, 16, 24, 32, 48))
    ratios = rows_of(partial(costs, cells=cells, quick=quick), crossed(mesh=FAMILIES))
    errors = rows_of(partial(plate, repeats=1 if quick else 3), crossed(mesh=FAMILIES, cells=sizes), on_step)
    return result_of("energy_cost", {"ratios": ratios, "errors": errors}, cells=cells, sizes=sizes)


def least_seconds(actions: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Least seconds of the processor's time of each action, called in turns."""
    least = [np.inf] * len(actions)
    for _ in range(repeats):
        for place, action in enumerate(actions):
            begin = time.process_time()
            action()
            least[place] = min(least[place], time.process_time() - begin)
    return least


def costs(mesh: str, cells: int, quick: bool) -> list[dict[str, Any]]:
    """Seconds of both energies on a square sheet that is clamped at one edge."""
    square = mesh_bias.square(mesh, cells)
    held = square.vertices[:, 0] < 1e-9
    shells = [flat_shell(energy, square, SHEET, held) for energy in ENERGIES]
    models = [ms.DiscreteShell(shell) for shell in shells]
    bent = []
    for shell in shells:
        x = np.array(shell.rest_positions)
        x[:, 2] += 0.05 * np.sin(4.0 * x[:, 0]) * (1.0 + x[:, 1])
        bent.append(x)

    length, weight = STEPS * STEP, (0.0, 0.0, -9.81)
    actions: dict[str, list[Callable[[], object]]] = {
        "gradient": [partial(s.energy_gradient, x) for s, x in zip(shells, bent, strict=True)],
        "Hessian": [partial(s.energy_gradient_hessian, x, EXACT) for s, x in zip(shells, bent, strict=True)],
        "implicit step": [partial(ms.simulate, model, duration=length, dt=STEP, gravity=weight) for model in models],
        "statics": [partial(model.equilibrium, gravity=(0.0, 0.0, -2.943)) for model in models],
    }
    rows = []
    for name, both in actions.items():
        least_seconds(both, 1)  # compiled, and patterns analysed
        seconds = least_seconds(both, 1 if quick else REPEATS[name])
        if name == "implicit step":
            seconds = [value / STEPS for value in seconds]
        found = dict(zip(ENERGIES, seconds, strict=True))
        rows.append({"vertices": len(held), "work": name, "seconds": found, "aim": AIMS[name]})
    return rows


def plate(mesh: str, cells: int, repeats: int) -> list[dict[str, Any]]:
    """Error of a supported plate's deflection and seconds of the answer, one row per energy."""
    cases = [mesh_bias.loaded(energy, mesh_bias.square(mesh, cells), "supported") for energy in ENERGIES]
    actions = [partial(ms.DiscreteShell(shell).equilibrium, force=load) for shell, load, _ in cases]
    errors = [
        mesh_bias.difference(shell, action().positions, exact)
        for action, (shell, _, exact) in zip(actions, cases, strict=True)
    ]
    found = zip(ENERGIES, errors, least_seconds(actions, repeats), strict=True)
    return [{"energy": energy, "error": error, "seconds": spent} for energy, error, spent in found]


def ratio(row: dict[str, Any]) -> float:
    """Seconds of Isotropic shells over those of hinges."""
    return float(row["seconds"]["Isotropic"] / row["seconds"]["hinges"])


def table(result: StudyResult) -> str:
    """Seconds and ratios, and errors over seconds, as Markdown tables."""
    ratios = markdown(
        "mesh | vertices | work | Isotropic [ms] | hinges [ms] | ratio | aim",
        "{mesh} | {vertices} | {work} | {seconds[Isotropic]:1e3*.3g} | {seconds[hinges]:1e3*.3g} | {ratio:.2f} "
        "| {aim:g}",
        [row | {"ratio": ratio(row)} for row in result.findings["ratios"]],
    )
    errors = markdown(
        "mesh | cells | energy | error of the deflection [%] | seconds",
        "{mesh} | {cells} | {energy} | {error:100*.3g} | {seconds:.3g}",
        result.findings["errors"],
    )
    return paragraphs(ratios, errors)


def finding(result: StudyResult) -> str:
    """The ratios by kind of work, and at how many points of equal cost hinges are the better ones."""
    ratios, errors = result.findings["ratios"], result.findings["errors"]
    least, most = (pick(ratios, key=ratio) for pick in (min, max))
    over = sum(ratio(row) > row["aim"] for row in ratios)
    hinges = [row for row in errors if row["energy"] == "hinges"]
    beaten = sum(
        any(
            (other["mesh"], other["energy"]) == (row["mesh"], "Isotropic")
            and other["seconds"] <= row["seconds"]
            and other["error"] < row["error"]
            for other in errors
        )
        for row in hinges
    )
    words = f"{over} of {len(ratios)} ratios are above the aims" if over else "every ratio is within its aim"
    return (
        f"On the same mesh an Isotropic shell takes {ratio(least):.2g} times ({least['work']}) to {ratio(most):.2g} "
        f"times ({most['work']}) as long as hinges; {words}. That is worth it: for {beaten} of {len(hinges)} meshes "
        "of hinges a mesh of Isotropic shells answers a supported plate in no more time with a smaller error."
    )
