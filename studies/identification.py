"""Constants of sheets recovered from measurements: tip curves, corners of a swept plate, natural frequencies.

The measurements are those of finite elements (``studies/identification_data.json``), so that the constants are known.
Each fit begins at twice the modulus. Tip curves get errors, too: normal ones of 1 % of the largest drop, from 40 seeds;
each interval of 95 % either holds the modulus that was put in or does not.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.pages import at_most, counted, markdown, result_of

FIGURES = ("identification",)

DATA = Path(__file__).with_name("identification_data.json")
NOISE = 0.01
"""Standard deviation of errors, over the largest drop."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All measurements; ``quick`` takes coarser meshes and fewer seeds."""
    data = json.loads(DATA.read_text(encoding="utf-8"))
    seeds, share = (6, 2) if quick else (40, 1)
    strip, seen, options = strip_curve(data["strip"], 60 // share, 4)
    exact, noisy = ms.fit(strip, "young", seen, **options), []
    for seed in counted(range(seeds), on_step):
        errors = NOISE * float(np.nanmax(np.abs(seen))) * np.random.default_rng(seed).standard_normal(seen.shape)
        found = ms.fit(strip, "young", seen + errors, **options)
        low, high = found.intervals["young"]
        noisy.append({"young": found.values["young"], "low": low, "high": high})
    corners = swept_corners(data["swept"], 30 // share)
    rows = [row("tip curve of a strip", "6 drops", data["strip"], exact)]
    rows.append(row("corners of a swept plate", "24 coordinates", data["swept"], corners))
    for plate in data["plates"]:
        words = f"frequencies of a {plate['length'] / plate['width']:g} : 1 plate"
        rows.append(row(words, "6 frequencies", plate, plate_constants(plate, 48 // share**2)))
    curve = {
        "gravities": data["strip"]["gravities"],
        "measured": (-seen[:, 2]).tolist(),
        "fitted": drops(strip, exact, data),
    }
    findings = {"rows": rows, "noisy": noisy, "true": data["strip"]["young"], "curve": curve}
    return result_of("identification", findings, seeds=seeds)


def sheet(case: dict[str, Any]) -> ms.Isotropic:
    """The sheet of a case, its modulus twice what it is, to begin from."""
    return ms.Isotropic(2.0 * case["young"], case["poisson"], case["thickness"], case["density"])


def strip_curve(case: dict[str, Any], along: int, across: int) -> tuple[ms.Shell, np.ndarray, dict[str, Any]]:
    """The strip, the measured heights of its tip (L, 3), and how a fit takes them."""
    mesh = ms.flat_beam(length=case["length"], width=case["width"], cells=(along, across))
    x = mesh.vertices[:, 0]
    seen = np.array(case["tip"])
    seen[:, :2] = np.nan
    options = {"where": x > case["length"] - 1e-9, "average": True, "factors": case["gravities"]}
    return ms.Shell(mesh, sheet(case), x < 1e-9), seen, {**options, "gravity": case["direction"]}


def drops(strip: ms.Shell, found: ms.Fit, data: dict[str, Any]) -> list[float]:
    """Drops [m] of the strip's tip with the constants that were found."""
    body = ms.DiscreteShell(strip.with_material(found.material))
    tip = strip.rest_positions[:, 0] > data["strip"]["length"] - 1e-9
    pulls = np.outer(data["strip"]["gravities"], data["strip"]["direction"])
    return [-float(body.equilibrium(gravity=pull).positions[tip, 2].mean()) for pull in pulls]


def swept_mesh(case: dict[str, Any], along: int) -> tuple[ms.TriangleMesh, list[int]]:
    """The swept plate, and the corners of its tip."""
    flat = ms.sheet(length=case["length"], width=case["chord"], cells=(along, along // 3))
    vertices = np.array(flat.vertices)
    first, second = np.array(case["corners"])
    vertices[:, 1] += 0.5 * (first[1] + second[1]) / case["length"] * vertices[:, 0] - flat.vertices[:, 1].mean()
    near = [int(np.linalg.norm(vertices - corner, axis=1).argmin()) for corner in (first, second)]
    return ms.TriangleMesh(vertices, flat.faces), near


def swept_corners(case: dict[str, Any], along: int) -> ms.Fit:
    """The modulus of a swept plate from where the corners of its tip go."""
    mesh, near = swept_mesh(case, along)
    order = np.argsort(near)
    seen = np.array(case["positions"])[:, order]
    shell = ms.Shell(mesh, sheet(case), mesh.vertices[:, 0] < 1e-9)
    return ms.fit(
        shell, "young", seen, where=sorted(near), factors=case["gravities"], gravity=case["direction"]
    )  # fmt: skip


def plate_constants(case: dict[str, Any], along: int) -> ms.Fit:
    """Modulus and Poisson's ratio of a plate from its frequencies."""
    across = max(4, round(along * case["width"] / case["length"]))
    mesh = ms.sheet(length=case["length"], width=case["width"], cells=(along, across))
    material = replace(sheet(case), poisson=0.1)
    shell = ms.Shell(mesh, material, mesh.vertices[:, 0] < 1e-9)
    return ms.fit(shell, ["young", "poisson"], frequencies=case["frequencies"])


def row(words: str, measured: str, case: dict[str, Any], found: ms.Fit) -> dict[str, Any]:
    """What a fit has found, and what it should."""
    exact = {name: case[name] for name in found.values}
    told = {"values": found.values, "intervals": {name: list(ends) for name, ends in found.intervals.items()}}
    return {"case": words, "measured": measured, "exact": exact, **told, "shells": found.evaluations}


def held(found: dict[str, Any]) -> int:
    """Number of intervals that hold the modulus."""
    return sum(row["low"] <= found["true"] <= row["high"] for row in found["noisy"])


def missed(findings: dict[str, Any]) -> str:
    """How many intervals miss a constant where the errors are those of the mesh, which are not independent."""
    rows = [(row["intervals"][name], true) for row in findings["rows"] for name, true in row["exact"].items()]
    beyond = sum(not low <= true <= high for (low, high), true in rows)
    return (
        f"intervals account for independent errors of measurement alone: of exact data {beyond} of {len(rows)} miss "
        "the true constant, by the error of the mesh."
    )


def table(result: StudyResult) -> str:
    """Constants recovered, and how often intervals hold, as Markdown tables."""
    found = result.findings
    rows = [
        row | {"name": name, "true": row["exact"][name], "value": value, "interval": row["intervals"][name]}
        for row in found["rows"]
        for name, value in row["values"].items()
    ]
    constants = markdown(
        "case | measured | constant | true | found | interval of 95 % | deviation [%] | shells solved",
        "{case} | {measured} | {name} | {true:.6g} | {value:.6g} | {interval[0]:.6g} to {interval[1]:.6g} "
        "| {off:100*+.2f} | {shells}",
        [row | {"off": row["value"] / row["true"] - 1.0} for row in rows],
    )
    off = np.array([row["young"] / found["true"] - 1.0 for row in found["noisy"]])
    width = np.mean([0.5 * (row["high"] - row["low"]) / found["true"] for row in found["noisy"]])
    curves = markdown(
        "curves | mean deviation [%] | largest [%] | mean half width of intervals [%] | intervals that hold",
        "{curves} | {mean:100*+.2f} | {largest:100*.2f} | {width:100*.2f} | {held}",
        [{"curves": off.size, "mean": off.mean(), "largest": abs(off).max(), "width": width, "held": held(found)}],
    )
    return f"{constants}\n\nHere {missed(found)}\n\nTip curves with errors of 1 % of the largest drop:\n\n{curves}"


def finding(result: StudyResult) -> str:
    """Largest deviations, and how many intervals hold."""
    found = result.findings
    worst = max(abs(row["values"]["young"] / row["exact"]["young"] - 1.0) for row in found["rows"])
    return (
        f"Young's modulus is recovered within {at_most(100 * worst)} % from tip curves, corners and frequencies of "
        f"finite elements; from tip curves with errors of 1 % {held(found)} of {len(found['noisy'])} intervals of 95 % "
        f"hold it; {missed(found)}"
    )
