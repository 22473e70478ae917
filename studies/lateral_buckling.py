"""Lateral buckling of a clamped strip under its weight in its plane: both energies against finite elements.

The strip bends sideways and twists at once, so its critical load asks for both stiffnesses. Gamma = rho g h L^3 / D; a
narrow strip buckles at 12.8538 sqrt(2 (1 - nu) (1 - nu^2)) (Bessel functions), wider ones are compared with solid
finite elements (``studies/finite_elements.json``). The load is the first bifurcation on the path of equilibria. This is
the lateral buckling test of Romero et al. (2021, ``romero2021``); no number is theirs.

Run it alone with ``modalshell reproduce --only lateral_buckling``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from modalshell.typing import Progress
from studies.both_energies import ENERGIES, FAMILIES, Sheet, flat_shell
from studies.pages import number
from studies.progress import counted

FIGURES = ("lateral_buckling",)

NARROW = 12.8538
"""Critical q L^3 / sqrt(EI GJ) of a narrow strip."""
RANGE = (0.8, 1.8)
"""Share of the reference between which the bifurcation is looked for."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All widths, energies and meshes; ``quick`` takes one wide strip of each Poisson's ratio on one mesh."""
    text = Path(__file__).with_name("finite_elements.json").read_text(encoding="utf-8")
    strips = json.loads(text)["lateral_buckling"]["cases"]
    families = FAMILIES[:1] if quick else FAMILIES
    chosen = strips[2::4] if quick else strips
    cases = [(strip, energy, family) for strip in chosen for energy in ENERGIES for family in families]
    rows: list[dict[str, Any]] = []
    for strip, energy, family in counted(cases, on_step):
        nu = strip["poisson"]
        rows.append(
            {
                **strip,
                "narrow": NARROW * float(np.sqrt(2.0 * (1.0 - nu) * (1.0 - nu**2))),
                "energy": energy,
                "mesh": family,
                "found": critical(strip, energy, family),
            }
        )
    return StudyResult("lateral_buckling", {"rows": rows}, {}, run_record({"range": RANGE}))


def critical(strip: dict[str, float], energy: str, family: str) -> float | None:
    """Gamma of the first bifurcation; None if there is none within the range."""
    across = 4 if strip["width"] < 0.15 else 8 if strip["width"] < 0.3 else 16
    stretch = 2.0 / np.sqrt(3.0) if family == "equilateral" else 1.0
    cells = (round(across / strip["width"] / stretch), across)
    mesh = ms.flat_beam(length=1.0, width=strip["width"], cells=cells, family=family)
    sheet: Sheet = {"young": 1e9, "poisson": strip["poisson"], "thickness": strip["thickness"], "density": 1000.0}
    shell = flat_shell(energy, mesh, sheet, mesh.vertices[:, 0] < 1e-9)
    rigidity = sheet["young"] * sheet["thickness"] ** 3 / (12.0 * (1.0 - sheet["poisson"] ** 2))
    unit = strip["gamma"] * rigidity / (sheet["density"] * sheet["thickness"])
    low, high = RANGE
    path = ms.equilibrium_path(shell, gravity=(0.0, -unit, 0.0), begin=low, until=high, steps=5)
    found = [factor for kind, _, factor in path.events if kind == "bifurcation"]
    return strip["gamma"] * found[0] if found else None


def table(result: StudyResult) -> str:
    """One row per strip, energy and mesh, as a Markdown table."""
    lines = [
        "The lateral buckling test of Romero et al. (2021). The narrow strip's values are those of a formula with "
        "Bessel functions, the finite elements' of CalculiX; none is of the paper. Critical Γ of strips of length 1:",
        "",
    ]
    lines.append("| width | Poisson's ratio | energy | mesh | found | finite elements | off [%] | narrow strip |")
    lines.append("|---" * 8 + "|")
    for row in result.findings["rows"]:
        found = row["found"]
        told = "none" if found is None else f"{found:.3f}"
        error = "-" if found is None else f"{100.0 * (found / row['gamma'] - 1.0):+.2f}"
        lines.append(
            f"| {row['width']:g} | {row['poisson']:g} | {row['energy']} | {row['mesh']} | {told} | {row['gamma']:.3f} "
            f"| {error} | {row['narrow']:.3f} |"
        )
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """Largest difference of both energies from finite elements."""
    (rows,) = tables
    largest = {
        energy: max(abs(number(row["off [%]"])) for row in rows if row["energy"] == energy and row["off [%]"] != "-")
        for energy in ENERGIES
    }
    return (
        f"Strips of width 0.05 to 0.4 buckle sideways within {largest['Isotropic']:.2g} % of finite elements with "
        f"Isotropic shells on {len(FAMILIES)} mesh families; calibrated hinges are off by up to "
        f"{largest['hinges']:.2g} %."
    )
