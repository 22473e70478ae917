"""Lateral buckling of strips under their weight: both energies against a closed form and finite elements.

The weight acts in the plane. The strip bends sideways and twists at once, so its critical load asks for both
stiffnesses. Gamma = rho g h L^3 / D; a narrow strip buckles at 12.8538 sqrt(2 (1 - nu) (1 - nu^2)) (Bessel functions).
That beam is held by the twist and the slope of its first section, which is free to warp. Strips with such an end meet
the formula: the positions of its vertices are held, and the mean slope along it is zero. A clamp holds the slope at
every vertex, so it restrains the warping and the Poisson effect over about a width, and the critical load grows with
the width. Clamped strips are compared with solid finite elements (``studies/finite_elements.json``). These twist more
easily than a shell: a rectangle of width w and thickness t has the torsion constant w t^3 / 3 (1 - 0.63 t / w), a shell
w t^3 / 3 (Timoshenko and Goodier), so that its critical load is less by 0.315 t / w. The load is the first bifurcation
on the path of equilibria. This is the lateral buckling test of Romero et al. (2021, ``romero2021``); no number is
theirs.

Run it alone with ``modalshell reproduce --only lateral_buckling``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh
from scipy.optimize import brentq

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult, Table
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
CLAMP, BEAM_END = "clamp", "beam end"
RANGE = (0.8, 1.8)
"""Share of the reference, or of the narrow strip's load, between which the bifurcation is looked for."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All widths, supports, energies and meshes; ``quick`` takes one mesh and one width of either support."""
    text = Path(__file__).with_name("finite_elements.json").read_text(encoding="utf-8")
    solids = json.loads(text)["lateral_buckling"]["cases"]
    families = FAMILIES[:1] if quick else FAMILIES
    strips = [s for nu in (0.0, 0.3) for s in (*narrower(nu), *solids) if s["poisson"] == nu]
    clamped, ended = (solids[2::4], solids[::4]) if quick else (strips, strips)
    cases = [(strip, CLAMP, energy, family) for strip in clamped for energy in ENERGIES for family in families]
    cases += [({**strip, "gamma": None}, BEAM_END, "Isotropic", family) for strip in ended for family in families]
    rows: list[dict[str, Any]] = []
    for strip, support, energy, family in counted(cases, on_step):
        found = critical(strip, energy, family) if support == CLAMP else critical_of_beam_end(strip, family)
        row = {"narrow": narrow(strip["poisson"]), "support": support, "energy": energy, "mesh": family, "found": found}
        rows.append({**strip, **row})
    return StudyResult("lateral_buckling", {"rows": rows}, {}, run_record({"range": RANGE}))


def narrow(poisson: float) -> float:
    """Critical Gamma of a narrow strip."""
    return NARROW * float(np.sqrt(2.0 * (1.0 - poisson) * (1.0 - poisson**2)))


def narrower(poisson: float) -> list[Strip]:
    """Strips that are narrower than those of the finite elements, of the thickness of a thirtieth of their width."""
    return [{"width": w, "poisson": poisson, "thickness": w / 30.0, "gamma": None} for w in NARROWER]


def critical(strip: Strip, energy: str, family: str) -> float | None:
    """Gamma of the first bifurcation of a clamped strip; None if there is none within the range."""
    mesh, sheet, unit = _problem(strip, family)
    shell = flat_shell(energy, mesh, sheet, _first_section(mesh))
    reference = narrow(strip["poisson"]) if strip["gamma"] is None else strip["gamma"]
    low, high = RANGE
    path = ms.equilibrium_path(shell, gravity=(0.0, -unit * reference, 0.0), begin=low, until=high, steps=5)
    found = [factor for kind, _, factor in path.events if kind == "bifurcation"]
    return reference * found[0] if found else None


def critical_of_beam_end(strip: Strip, family: str) -> float:
    """Gamma at which an Isotropic strip, held as a beam is, buckles out of its plane.

    Positions of the first section are held, and the mean slope along it is zero. The mean slope is what a uniform edge
    moment works on, so its gradient is that moment's force. The strip stays in its plane up to the bifurcation, where
    the least eigenvalue of its stiffness out of the plane, under that constraint, is zero.
    """
    mesh, sheet, unit = _problem(strip, family)
    end, everywhere = _first_section(mesh), np.ones(len(mesh.vertices), dtype=bool)
    hinged = flat_shell("Isotropic", mesh, sheet, supports=[ms.Pin(end)])
    plane = ms.DiscreteShell(flat_shell("Isotropic", mesh, sheet, supports=[ms.Pin(end), ms.Fix(everywhere, "z")]))
    slope = ms.EdgeMoment(end, 1.0).applied(mesh, hinged.mass).force(mesh.vertices)[~end, 2]
    unknowns = 3 * np.flatnonzero(~end) + 2
    last = int(np.argmax(np.abs(slope)))  # this unknown follows from the others
    free = np.delete(np.eye(len(unknowns)), last, axis=1)
    free[last] = np.delete(slope, last) / -slope[last]

    def least_eigenvalue(gamma: float) -> float:
        state = plane.equilibrium(gravity=(0.0, -unit * gamma, 0.0))
        if not state.converged:
            raise ms.SolverError(f"a strip in its plane found no equilibrium: {state.message}")
        stiffness = hinged.stiffness(state.positions)[unknowns][:, unknowns]
        return float(eigvalsh(free.T @ (stiffness @ free), subset_by_index=[0, 0])[0])

    low, high = (share * narrow(strip["poisson"]) for share in RANGE)
    return float(brentq(least_eigenvalue, low, high, rtol=1e-6))


def _problem(strip: Strip, family: str) -> tuple[ms.TriangleMesh, Sheet, float]:
    """Mesh and sheet of a strip, and the gravity [m/s^2] for each unit of Gamma."""
    across = 4 if strip["width"] < 0.15 else 8 if strip["width"] < 0.3 else 16
    stretch = 2.0 / np.sqrt(3.0) if family == "equilateral" else 1.0
    cells = (round(across / strip["width"] / stretch), across)
    mesh = ms.flat_beam(length=1.0, width=strip["width"], cells=cells, family=family)
    sheet: Sheet = {"young": 1e9, "poisson": strip["poisson"], "thickness": strip["thickness"], "density": 1000.0}
    rigidity = sheet["young"] * sheet["thickness"] ** 3 / (12.0 * (1.0 - sheet["poisson"] ** 2))
    return mesh, sheet, rigidity / (sheet["density"] * sheet["thickness"])


def _first_section(mesh: ms.TriangleMesh) -> NDArray[np.bool_]:
    return mesh.vertices[:, 0] < 1e-9


def table(result: StudyResult) -> str:
    """One row per strip, energy and mesh, as a Markdown table."""
    lines = [
        "The lateral buckling test of Romero et al. (2021). The narrow strip's values are those of a formula with "
        "Bessel functions, the finite elements' of CalculiX; none is of the paper. Solid strips twist more easily than "
        "shells, by 0.63 t / w of the torsion constant: the last column is without this. A beam end holds a section's "
        "position and mean slope and leaves it free to warp, as the formula has it. Critical Γ of strips of length 1:",
        "",
    ]
    names = ["width", "Poisson's ratio", "support", "energy", "mesh", "found", "narrow strip", "over it [%]"]
    names += ["finite elements", "off [%]", "off if thin [%]"]
    lines += [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for row in result.findings["rows"]:
        found, solid = row["found"], row["gamma"]
        cells = [f"{row['width']:g}", f"{row['poisson']:g}", row["support"], row["energy"], row["mesh"]]
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
    shells = [row for row in rows if row["energy"] == "Isotropic" and row["width"] == "0.05"]
    above = {
        support: max(number(row["over it [%]"]) for row in shells if row["support"] == support)
        for support in (CLAMP, BEAM_END)
    }
    return (
        f"Clamped strips of width 0.05 to 0.4 buckle sideways within {largest['Isotropic', 'off if thin [%]']:.2g} % "
        f"of thin finite elements ({largest['Isotropic', 'off [%]']:.2g} % of solid ones) with Isotropic shells on "
        f"{len(FAMILIES)} mesh families; calibrated hinges are off by up to {largest['hinges', 'off [%]']:.2g} %. At "
        f"width 0.05 shells that are held as a beam is, free to warp, are at most {above[BEAM_END]:.2g} % above the "
        f"closed form of narrow strips, clamped ones {above[CLAMP]:.2g} %."
    )
