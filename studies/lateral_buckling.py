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
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh
from scipy.optimize import brentq

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.pages import at_most, markdown, result_of
from studies.shell_theory import ENERGIES, FAMILIES, Sheet, columns, crossed, finite_elements, flat_shell, rows_of

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
WORDS = (
    "The lateral buckling test of Romero et al. (2021). The narrow strip's values are those of a formula with "
    "Bessel functions, the finite elements' of CalculiX; none is of the paper. Solid strips twist more easily than "
    "shells, by 0.63 t / w of the torsion constant: the last column is without this. A beam end holds a section's "
    "position and mean slope and leaves it free to warp, as the formula has it. Critical Γ of strips of length 1:\n\n"
)
RANGE = (0.8, 1.8)
"""Share of the reference, or of the narrow strip's load, between which the bifurcation is looked for."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All widths, supports, energies and meshes; ``quick`` takes one mesh and one width of either support."""
    solids, families = finite_elements("lateral_buckling"), FAMILIES[:1] if quick else FAMILIES
    strips = [s for nu in (0.0, 0.3) for s in (*narrower(nu), *solids) if s["poisson"] == nu]
    clamped, ended = (solids[2::4], solids[::4]) if quick else (strips, strips)

    def found(strip: Strip, support: str, energy: str, mesh: str) -> dict[str, Any]:
        gamma = critical(strip, energy, mesh) if support == CLAMP else critical_of_beam_end(strip, mesh)
        return {**strip, "narrow": narrow(strip["poisson"]), "found": gamma}

    cases = crossed(strip=clamped, support=[CLAMP], energy=ENERGIES, mesh=families)
    free = [{**strip, "gamma": None} for strip in ended]
    cases += crossed(strip=free, support=[BEAM_END], energy=ENERGIES[:1], mesh=families)
    rows = rows_of(found, cases, on_step)
    for row in rows:
        del row["strip"]
    return result_of("lateral_buckling", {"rows": rows}, quick=quick)


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
    cells = (columns(family, across / strip["width"]), across)
    mesh = ms.flat_beam(length=1.0, width=strip["width"], cells=cells, family=family)
    sheet: Sheet = {"young": 1e9, "poisson": strip["poisson"], "thickness": strip["thickness"], "density": 1000.0}
    rigidity = sheet["young"] * sheet["thickness"] ** 3 / (12.0 * (1.0 - sheet["poisson"] ** 2))
    return mesh, sheet, rigidity / (sheet["density"] * sheet["thickness"])


def _first_section(mesh: ms.TriangleMesh) -> NDArray[np.bool_]:
    return mesh.vertices[:, 0] < 1e-9


def solid_gamma(row: dict[str, Any]) -> float | None:
    """Critical Gamma of solid finite elements."""
    return row["gamma"]


def thin(row: dict[str, Any]) -> float | None:
    """That of finite elements as thin as a shell."""
    return None if row["gamma"] is None else row["gamma"] * (1.0 + 0.315 * row["thickness"] / row["width"])


def off(row: dict[str, Any], reference: float | None) -> float | None:
    """Error of what was found; None where one of both is missing."""
    return None if row["found"] is None or reference is None else row["found"] / reference - 1.0


def table(result: StudyResult) -> str:
    """One row per strip, energy and mesh, as a Markdown table."""
    rows = []
    for row in result.findings["rows"]:
        over, solid, thinned = (off(row, reference) for reference in (row["narrow"], row["gamma"], thin(row)))
        rows.append({**row, "over": over, "solid": solid, "thinned": thinned})
    return WORDS + markdown(
        "width | Poisson's ratio | support | energy | mesh | found | narrow strip | over it [%] | finite elements "
        "| off [%] | off if thin [%]",
        "{width:g} | {poisson:g} | {support} | {energy} | {mesh} | {found:.3f|none} | {narrow:.3f} | {over:100*+.2f} "
        "| {gamma:.3f} | {solid:100*+.2f} | {thinned:100*+.2f}",
        rows,
    )


def finding(result: StudyResult) -> str:
    """Largest difference of both energies from finite elements."""
    rows = result.findings["rows"]
    solid, beam = [row for row in rows if row["gamma"] is not None], [row for row in rows if row["width"] == 0.05]

    def largest(energy: str, reference: Callable[[dict[str, Any]], float | None]) -> str:
        return (
            f"{at_most(100 * max(abs(off(row, reference(row)) or 0.0) for row in solid if row['energy'] == energy))} %"
        )

    def above(support: str) -> str:
        own = [off(row, row["narrow"]) for row in beam if (row["energy"], row["support"]) == ("Isotropic", support)]
        known = [one for one in own if one is not None]
        return f"{at_most(100 * max(known))} %" if known else "-"

    return (
        f"Clamped strips of width 0.05 to 0.4 buckle sideways within {largest('Isotropic', thin)} of thin finite "
        f"elements ({largest('Isotropic', solid_gamma)} of solid ones) with Isotropic shells on {len(FAMILIES)} mesh "
        f"families; calibrated hinges are off by up to {largest('hinges', solid_gamma)}. At width 0.05 shells that are "
        f"held as a beam is, free to warp, are at most {above(BEAM_END)} above the closed form of narrow strips, "
        f"clamped ones {above(CLAMP)}."
    )
