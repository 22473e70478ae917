"""Drape tests of four measured fabrics against the drape coefficients that the same authors measured.

Bending stiffness and hysteresis, weight, drape coefficient and number of folds are those of Matsudaira, Masuda, Wada
and Yokura, J. Textile Eng. 61 (2015), 69-73, tables 1 and 2 [matsudaira2015]; they are taken from a transcription of
the tables, which has neither the fabrics' shear stiffness nor the size of the discs. So the cloth is elastic, alike in
all directions, and does not stretch, and both usual sizes are run: those of Cusick (BS 5058) and of JIS L 1096. Each
cloth is reached from stiffer ones, as the page's drapes are, and once more from flat.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Array, Progress
from modalshell.files.study_result import StudyResult
from modalshell.shell.cards import GRAVITY, bending_length
from studies.drape_family import annulus, cloth, coefficient, hung
from studies.pages import at_most, counted, markdown, paragraphs, result_of

FIGURES = ("fabric_drape",)
FABRICS = {
    "cotton broad": (0.118, 0.124, 12.38, 82.9, 2),
    "polyester tropical": (0.077, 0.029, 11.65, 50.7, 5),
    "wool tropical": (0.067, 0.033, 16.29, 49.8, 5),
    "polyester faille": (0.019, 0.007, 10.43, 28.3, 7),
}
"""Bending stiffness [gf cm^2/cm], its hysteresis 2HB [gf cm/cm], weight [mg/cm^2], drape coefficient [%], folds."""
GRAM_FORCE = 9.80665e-3
"""Newtons of a gram-force."""
SIZES = {"Cusick": (0.15, 0.09), "JIS": (0.127, 0.0635)}
"""Radius of the cloth, and of the discs that hold it [m]."""
EDGES = (12e-3, 9e-3)
"""Lengths of edges [m]."""
STIFFER = (0.04, 0.032, 0.026)
"""Bending lengths [m] from which the fabrics' are reached."""
DEEP = 0.1
"""Share of the largest bulge or hollow of the rim that counts as one."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Cusick's discs on two meshes, the others on the finer one; ``quick`` takes Cusick's on a coarser one."""
    cases = [("Cusick", 2.0 * EDGES[0])] if quick else [("Cusick", EDGES[0]), *((size, EDGES[-1]) for size in SIZES)]
    arrays: dict[str, Any] = {}
    rows = [row for size, edge in counted(cases, on_step) for row in drapes(size, edge, arrays)]
    findings = {"fabrics": [measured(name) for name in FABRICS], "rows": rows}
    return result_of("fabric_drape", findings, arrays, quick=quick)


def measured(name: str) -> dict[str, Any]:
    """What was measured, in SI units.

    The friction is that of bending, ``HB``, over the moment by which a strip as long as Cusick's overhang hangs on its
    clamp: below it a strip would stay as it is.
    """
    stiffness, hysteresis, weight, drape, folds = FABRICS[name]
    bending, density = GRAM_FORCE * 1e-2 * stiffness, 1e-2 * weight
    radius, disc = SIZES["Cusick"]
    return {
        "fabric": name,
        "bending": bending,
        "weight": density,
        "length": bending_length(bending, density),
        "friction": 0.5 * GRAM_FORCE * hysteresis / (0.5 * density * GRAVITY * (radius - disc) ** 2),
        "drape": 1e-2 * drape,
        "folds": folds,
    }


def drapes(size: str, edge: float, shapes: dict[str, Any]) -> list[dict[str, Any]]:
    """Every fabric on discs of a size; ``shapes`` takes the triangles and the vertices (n, 3) [m]."""
    radius, disc = SIZES[size]
    mesh = annulus(edge, radius, disc)
    key = f"{size}_{1e3 * edge:g}"
    shapes[f"faces_{key}"] = mesh.faces
    flat = np.array(mesh.vertices)
    fabrics = {record["length"]: record for record in map(measured, FABRICS)}
    rows, start = [], flat
    for length in sorted([*STIFFER, *fabrics], reverse=True):
        state = rested(mesh, length, disc, start)
        start = state.positions
        if length not in fabrics:
            continue
        name = fabrics[length]["fabric"]
        shapes[f"{name}_{key}"] = start
        share = coefficient(start, mesh.faces, radius, disc)
        at_once = rested(mesh, length, disc, flat)
        rows.append(
            {
                "discs": size,
                "edge": edge,
                "vertices": len(flat),
                "fabric": name,
                "drape": share,
                "off": share - fabrics[length]["drape"],
                "from flat": coefficient(at_once.positions, mesh.faces, radius, disc),
                **rim(flat, start, radius),
            }
        )
    return rows


def rested(mesh: ms.TriangleMesh, length: float, disc: float, start: Array) -> ms.Equilibrium:
    """The cloth at rest; SolverError without convergence."""
    state = hung(cloth(mesh, length, disc), start)
    if not state.converged:
        raise ms.SolverError(f"the cloth of a bending length of {length:.4g} m: {state.status}, {state.message}")
    return state


def rim(flat: Array, x: Array, radius: float) -> dict[str, Any]:
    """Folds of a cloth by the bulges of its rim seen from above, and whether the rim lies over itself there."""
    edge = np.flatnonzero(np.hypot(*flat[:, :2].T) > (1.0 - 1e-9) * radius)
    edge = edge[np.argsort(np.arctan2(flat[edge, 1], flat[edge, 0]))]
    bulge = np.hypot(*x[edge, :2].T)
    bulge = bulge - bulge.mean()
    high = np.sign(bulge[np.abs(bulge) > DEEP * np.abs(bulge).max()])
    turned = np.diff(np.unwrap(np.arctan2(x[edge, 1], x[edge, 0])))
    return {"folds": int(np.count_nonzero(high != np.roll(high, 1))) // 2, "overlaps": bool((turned < 0.0).any())}


def table(result: StudyResult) -> str:
    """What was measured and what is found, as Markdown tables."""
    fabrics = [row | {"micro": 1e6 * row["bending"], "mm": 1e3 * row["length"]} for row in result.findings["fabrics"]]
    by_name = {row["fabric"]: row for row in fabrics}
    rows = [
        row | {"mm": 1e3 * row["edge"], "wanted": by_name[row["fabric"]]["drape"], "wants": by_name[row["fabric"]]}
        for row in result.findings["rows"]
    ]
    rows = [row | {"wants": row["wants"]["folds"], "over": "yes" if row["overlaps"] else "no"} for row in rows]
    return paragraphs(
        "Measured [matsudaira2015], by a transcription of the paper's tables, which has neither shear nor the discs' "
        "size; the friction is that of bending over the moment of a strip's weight at its clamp:",
        markdown(
            "fabric | bending [µN m] | weight [kg/m²] | bending length [mm] | friction [%] | drape coefficient [%] | "
            "folds",
            "{fabric} | {micro:.2f} | {weight:.4f} | {mm:.1f} | {friction:100*.0f} | {drape:100*.1f} | {folds}",
            fabrics,
        ),
        "Found; the last run begins at the flat cloth and may fold otherwise:",
        markdown(
            "discs | edge [mm] | vertices | fabric | drape coefficient [%] | measured [%] | off [points] | folds | "
            "measured | rim lies over itself | from flat [%]",
            "{discs} | {mm:g} | {vertices} | {fabric} | {drape:100*.1f} | {wanted:100*.1f} | {off:100*+.1f} | {folds} "
            "| {wants} | {over} | {from flat:100*.1f}",
            rows,
        ),
    )


def finding(result: StudyResult) -> str:
    """How far each fabric is from its measurement, and what is left out."""
    edge = min(row["edge"] for row in result.findings["rows"])
    rows = [row for row in result.findings["rows"] if row["edge"] == edge and row["discs"] == "Cusick"]
    off = ", ".join(f"{row['fabric']} {100.0 * row['off']:+.0f}" for row in rows)
    seen = {row["fabric"]: row["folds"] for row in result.findings["fabrics"]}
    found, wanted = (
        ", ".join(map(str, own)) for own in zip(*((r["folds"], seen[r["fabric"]]) for r in rows), strict=True)
    )
    friction = sorted((row["friction"], row["fabric"]) for row in result.findings["fabrics"])
    (most, stuck), others = friction[-1], friction[-2][0]
    return (
        f"By bending stiffness and weight alone, with nothing fitted, the drape coefficients are off by {off} points, "
        f"and there are {found} folds where {wanted} were measured. The friction of bending, which is left out, is "
        f"{100.0 * most:.0f} % of a strip's moment in {stuck} and at most {at_most(100.0 * others, 1)} % in the others."
    )
