"""Drop and reach of a strip under its weight: both bending energies on three mesh families, against the heavy elastica.

A strip with Poisson's ratio 0, clamped along one short edge, is a heavy elastica: its shape depends on the load
``Gamma = (weight per length) L^3 / EI`` alone. The elastica is integrated here by shooting from the tip. Both shells
get Young's modulus, thickness and density as they are; the hinges are calibrated on each mesh by
:meth:`modalshell.Material.from_physical`. Each load starts from the answer to the one before.

This is the cantilever test of Romero et al. (2021, ``romero2021``); no number is theirs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.pages import at_most, markdown, paragraphs, result_of
from studies.shell_theory import ENERGIES, FAMILIES, Sheet, crossed, flat_shell, rows_of

FIGURES = ("cantilever_master_curve",)

LENGTH, WIDTH = 0.3, 0.05
SHEET: Sheet = {"young": 1e9, "poisson": 0.0, "thickness": 1e-3, "density": 1000.0}
GAMMAS = (1e-2, 1e2)
"""Smallest and largest load; those between are spaced evenly on a logarithmic axis."""
ORIGIN = "The cantilever test of Romero et al. (2021). The elastica's values are integrated here; none is of the paper."


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All loads on every mesh with both energies; ``quick`` takes a coarser mesh and fewer loads."""
    count, cells = (5, (16, 3)) if quick else (50, (48, 8))
    loads = np.geomspace(*GAMMAS, count)
    exact = np.array([elastica(load) for load in loads])

    def tips(energy: str, mesh: str) -> dict[str, Any]:
        found, states = tip_path(energy, mesh, cells, loads)
        errors = np.linalg.norm(found - exact, axis=1)
        drop, reach = np.abs(found - exact).max(axis=0)
        return {
            "drop": found[:, 0],
            "reach": found[:, 1],
            "error": errors,
            "largest_error": errors.max(),
            "largest_drop_error": drop,
            "largest_reach_error": reach,
            "worst_gamma": loads[np.argmax(errors)],
            "smallest_load_drop_ratio": found[0, 0] / exact[0, 0],
            "stable_minima": sum(state.converged and state.stable for state in states),
        }

    rows = rows_of(tips, crossed(energy=ENERGIES, mesh=FAMILIES), on_step)
    findings = {"gamma": loads, "drop": exact[:, 0], "reach": exact[:, 1], "rows": rows}
    return result_of("cantilever_master_curve", findings, {"exact": exact}, cells=cells, loads=count)


def elastica(gamma: float) -> tuple[float, float]:
    """Drop and reach [L] of the tip of the heavy elastica, by shooting from the tip.

    ``theta'' = -gamma (1 - s) cos(theta)`` with ``theta(0) = 0`` and ``theta'(1) = 0``; the tip's angle is between 0
    and a right angle, and the larger it is, the larger is the angle at the clamp.
    """

    def to_the_clamp(tip: float) -> np.ndarray:
        """Angle, its slope, and the drop and reach of the tip, after integration from s = 1 to 0."""

        def rate(s: float, y: np.ndarray) -> list[float]:
            return [y[1], -gamma * (1.0 - s) * np.cos(y[0]), -np.sin(y[0]), -np.cos(y[0])]

        path = solve_ivp(rate, (1.0, 0.0), [tip, 0.0, 0.0, 0.0], method="DOP853", rtol=1e-11, atol=1e-13)
        end: np.ndarray = path.y[:, -1]
        return end

    angle = brentq(lambda tip: to_the_clamp(tip)[0], 0.0, 0.5 * np.pi, xtol=1e-13)
    _, _, drop, reach = to_the_clamp(angle)
    return float(drop), float(reach)


def tip_path(
    energy: str, family: str, cells: tuple[int, int], loads: np.ndarray
) -> tuple[np.ndarray, list[ms.Equilibrium]]:
    """Drop and reach [L] of the middle of the tip's edge at every load (k, 2), and the equilibria."""
    mesh = ms.flat_beam(length=LENGTH, width=WIDTH, cells=cells, family=family)
    along = mesh.vertices[:, 0]
    shell = flat_shell(energy, mesh, SHEET, along < 1e-9)
    tip = np.flatnonzero(along > LENGTH - 1e-9)
    model = ms.DiscreteShell(shell)
    unit = SHEET["young"] * SHEET["thickness"] ** 2 / (12.0 * SHEET["density"] * LENGTH**3)
    states: list[ms.Equilibrium] = []
    for load in loads:
        start = states[-1].positions if states else None
        states.append(model.equilibrium(gravity=(0.0, 0.0, -load * unit), start=start))
    middles = np.array([state.positions[tip].mean(axis=0) for state in states]) / LENGTH
    return np.column_stack([-middles[:, 2], middles[:, 0]]), states


def table(result: StudyResult) -> str:
    """The largest errors of each energy and mesh, then the curve itself at some loads, as Markdown tables."""
    found = result.findings
    loads, rows = found["gamma"], found["rows"]
    largest = markdown(
        "energy | mesh | largest error of the tip [% of L] | at Γ | of the drop | of the reach "
        "| drop over the elastica's at the smallest load | stable minima",
        "{energy} | {mesh} | {largest_error:100*.3f} | {worst_gamma:.3g} | {largest_drop_error:100*.3f} "
        f"| {{largest_reach_error:100*.3f}} | {{smallest_load_drop_ratio:.4f}} | {{stable_minima}} of {len(loads)}",
        rows,
    )
    chosen = sorted({*range(0, len(loads), 5 if len(loads) > 10 else 1), len(loads) - 1})
    curve = markdown(
        "Γ | drop [L] | reach [L] | " + " | ".join(f"{row['energy']}, {row['mesh']}" for row in rows),
        "{gamma:.3g} | {drop:.5f} | {reach:.5f} | {errors:100*.3f}",
        [
            {name: found[name][k] for name in ("gamma", "drop", "reach")}
            | {"errors": [row["error"][k] for row in rows]}
            for k in chosen
        ],
    )
    words = "The tip of the heavy elastica, and the error of each shell's tip [% of L], at every fifth load:"
    return paragraphs(ORIGIN, largest, words, curve)


def finding(result: StudyResult) -> str:
    """The largest error of each energy, over the meshes."""
    split, hinges = (
        100 * max(row["largest_error"] for row in result.findings["rows"] if row["energy"] == energy)
        for energy in ENERGIES
    )
    return (
        f"A strip without Poisson effect bends one way, and both energies follow the heavy elastica over four decades "
        f"of load: the tip of Isotropic shells is off by {at_most(split)} % of the length at most, without any "
        f"calibration, that of calibrated hinges by {at_most(hinges)} %."
    )
