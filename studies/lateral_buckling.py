"""Lateral buckling of a clamped strip under its weight in its plane: both energies against finite elements.

The strip bends sideways and twists at once, so its critical load asks for both stiffnesses. Gamma = rho g h L^3 / D; a
narrow strip buckles at 12.8538 sqrt(2 (1 - nu) (1 - nu^2)) (Bessel functions), a limit that strips come near to in
proportion to their width, as the clamp holds their twist and their Poisson effect back over about a width. Wider ones
are compared with solid finite elements (``studies/finite_elements.json``). These twist more easily than a shell: a
rectangle of width w and thickness t has the torsion constant w t^3 / 3 (1 - 0.63 t / w), a shell w t^3 / 3 (Timoshenko
and Goodier), so that its critical load is less by 0.315 t / w. The load is the first bifurcation on the path of
equilibria. This is the lateral buckling test of Romero et al. (2021, ``romero2021``); no number is theirs.

Run it alone with ``modalshell reproduce --only lateral_buckling``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

import modalshell as ms
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from modalshell.typing import Progress
from studies.both_energies import ENERGIES, FAMILIES, Sheet, flat_shell
from studies.pages import number
from studies.progress import counted

FIGURES = ("lateral_buckling",)


class Strip(TypedDict):
    """Width and thickness of a strip of length 1, Poisson's ratio, and the critical Gamma of finite elements."""

    width: float
    thickness: float
    poisson: float
    gamma: float | None


NARROW = 12.8538
"""Critical q L^3 / sqrt(EI GJ) of a narrow strip."""
NARROWER = (0.0125, 0.025)
"""Widths without finite elements, which show the limit."""
RANGE = (0.8, 1.8)
"""Share of the reference, or of the narrow strip's load, between which the bifurcation is looked for."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All widths, energies and meshes; ``quick`` takes one wide strip of each Poisson's ratio on one mesh."""
    text = Path(__file__).with_name("finite_elements.json").read_text(encoding="utf-8")
    strips = json.loads(text)["lateral_buckling"]["cases"]
    families = FAMILIES[:1] if quick else FAMILIES
    chosen = (
        strips[2::4]
        if quick
        else [strip for nu in (0.0, 0.3) for strip in (*narrower(nu), *strips) if strip["poisson"] == nu]
    )
    cases = [(strip, energy, family) for strip in chosen for energy in ENERGIES for family in families]
    rows: list[dict[str, Any]] = []
    for strip, energy, family in counted(cases, on_step):
        rows.append(
            {
                **strip,
                "narrow": narrow(strip["poisson"]),
                "energy": energy,
                "mesh": family,
                "found": critical(strip, energy, family),
            }
        )
    return StudyResult("lateral_buckling", {"rows": rows}, {}, run_record({"range": RANGE}))


def narrow(poisson: float) -> float:
    """Critical Gamma of a narrow strip."""
    return NARROW * float(np.sqrt(2.0 * (1.0 - poisson) * (1.0 - poisson**2)))


def narrower(poisson: float) -> list[Strip]:
    """Strips that are narrower than those of the finite elements, of the thickness of a thirtieth of their width."""
    return [{"width": w, "poisson": poisson, "thickness": w / 30.0, "gamma": None} for w in NARROWER]


def critical(strip: Strip, energy: str, family: str) -> float | None:
    """Gamma of the first bifurcation; None if there is none within the range."""
    across = 4 if strip["width"] < 0.15 else 8 if strip["width"] < 0.3 else 16
    stretch = 2.0 / np.sqrt(3.0) if family == "equilateral" else 1.0
    cells = (round(across / strip["width"] / stretch), across)
    mesh = ms.flat_beam(length=1.0, width=strip["width"], cells=cells, family=family)
    sheet: Sheet = {"young": 1e9, "poisson": strip["poisson"], "thickness": strip["thickness"], "density": 1000.0}
    shell = flat_shell(energy, mesh, sheet, mesh.vertices[:, 0] < 1e-9)
    rigidity = sheet["young"] * sheet["thickness"] ** 3 / (12.0 * (1.0 - sheet["poisson"] ** 2))
    reference = narrow(strip["poisson"]) if strip["gamma"] is None else strip["gamma"]
    unit = reference * rigidity / (sheet["density"] * sheet["thickness"])
    low, high = RANGE
    path = ms.equilibrium_path(shell, gravity=(0.0, -unit, 0.0), begin=low, until=high, steps=5)
    found = [factor for kind, _, factor in path.events if kind == "bifurcation"]
    return reference * found[0] if found else None


def table(result: StudyResult) -> str:
    """One row per strip, energy and mesh, as a Markdown table."""
    lines = [
        "The lateral buckling test of Romero et al. (2021). The narrow strip's values are those of a formula with "
        "Bessel functions, the finite elements' of CalculiX; none is of the paper. Solid strips twist more easily than "
        "shells, by 0.63 t / w of the torsion constant: the last column is without this. Critical Γ of strips of "
        "length 1:",
        "",
    ]
    names = ["width", "Poisson's ratio", "energy", "mesh", "found", "narrow strip", "over it [%]"]
    names += ["finite elements", "off [%]", "off if thin [%]"]
    lines += [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for row in result.findings["rows"]:
        found, solid = row["found"], row["gamma"]
        cells = [f"{row['width']:g}", f"{row['poisson']:g}", row["energy"], row["mesh"]]
        cells += ["none" if found is None else f"{found:.3f}", f"{row['narrow']:.3f}", _percent(found, row["narrow"])]
        thin = None if solid is None else solid * (1.0 + 0.315 * row["thickness"] / row["width"])
        cells += ["-" if solid is None else f"{solid:.3f}", _percent(found, solid), _percent(found, thin)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _percent(found: float | None, reference: float | None) -> str:
    return "-" if found is None or reference is None else f"{100.0 * (found / reference - 1.0):+.2f}"


def finding(tables: list[Table]) -> str:
    """Largest difference of both energies from finite elements."""
    (rows,) = tables
    largest = {
        (energy, column): max(
            abs(number(row[column])) for row in rows if row["energy"] == energy and row[column] != "-"
        )
        for energy in ENERGIES
        for column in ("off [%]", "off if thin [%]")
    }
    shells = [row for row in rows if row["energy"] == "Isotropic"]
    above = [max(number(row["over it [%]"]) for row in shells if row["width"] == width) for width in ("0.0125", "0.05")]
    return (
        f"Strips of width 0.05 to 0.4 buckle sideways within {largest['Isotropic', 'off if thin [%]']:.2g} % of thin "
        f"finite elements ({largest['Isotropic', 'off [%]']:.2g} % of solid ones) with Isotropic shells on "
        f"{len(FAMILIES)} mesh families; calibrated hinges are off by up to {largest['hinges', 'off [%]']:.2g} %. The "
        f"formula of narrow strips is a limit: at width 0.0125 shells are up to {above[0]:.2g} % above it, at 0.05 "
        f"{above[1]:.2g} %."
    )
