"""Constants of sheets recovered from measurements: tip curves, corners of a swept plate, natural frequencies.

The measurements are those of finite elements (``studies/identification.json``), so that the constants are known. Each
fit begins at twice the modulus. Tip curves get errors, too: normal ones of 1 % of the largest drop, from 40 seeds; each
interval of 95 % either holds the modulus that was put in or does not.

Run it alone with ``modalshell reproduce --only identification``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult, Table
from studies.pages import number

FIGURES = ("identification",)

DATA = Path(__file__).with_name("identification.json")
NOISE = 0.01
"""Standard deviation of errors, over the largest drop."""


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """All measurements; ``quick`` takes coarser meshes and fewer seeds."""
    data = json.loads(DATA.read_text(encoding="utf-8"))
    seeds = 6 if quick else 40
    share = 2 if quick else 1
    steps = seeds + 4

    def done(count: int) -> None:
        if on_step is not None:
            on_step(count, steps)

    strip, seen, options = strip_curve(data["strip"], 60 // share, 4)
    exact = ms.fit(strip, "young", seen, **options)
    rows = [row("tip curve of a strip", "6 drops", data["strip"], exact)]
    done(1)
    noisy = []
    drop = float(np.nanmax(np.abs(seen)))
    for seed in range(seeds):
        errors = NOISE * drop * np.random.default_rng(seed).standard_normal(seen.shape)
        found = ms.fit(strip, "young", seen + errors, **options)
        low, high = found.intervals["young"]
        noisy.append({"young": found.values["young"], "low": low, "high": high})
        done(2 + seed)
    rows.append(
        row("corners of a swept plate", "24 coordinates", data["swept"], swept_corners(data["swept"], 30 // share))
    )
    done(seeds + 2)
    for index, plate in enumerate(data["plates"]):
        words = f"frequencies of a {plate['length'] / plate['width']:g} : 1 plate"
        rows.append(row(words, "6 frequencies", plate, plate_constants(plate, 48 // share**2)))
        done(seeds + 3 + index)
    curve = {
        "gravities": data["strip"]["gravities"],
        "measured": (-seen[:, 2]).tolist(),
        "fitted": drops(strip, exact, data),
    }
    findings = {"rows": rows, "noisy": noisy, "true": data["strip"]["young"], "curve": curve}
    return StudyResult("identification", findings, {}, run_record({"noise": NOISE, "seeds": seeds}))


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


def table(result: StudyResult) -> str:
    """Constants recovered, and how often intervals hold, as Markdown tables."""
    heads = ("case", "measured", "constant", "true", "found", "interval of 95 %", "deviation [%]", "shells solved")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for found in result.findings["rows"]:
        for name, value in found["values"].items():
            low, high = found["intervals"][name]
            exact = found["exact"][name]
            cells = [found["case"], found["measured"], name, f"{exact:.6g}", f"{value:.6g}", f"{low:.6g} to {high:.6g}"]
            lines.append(
                "| " + " | ".join([*cells, f"{100.0 * (value / exact - 1.0):+.2f}", f"{found['shells']}"]) + " |"
            )
    noisy, exact = result.findings["noisy"], result.findings["true"]
    off = np.array([found["young"] / exact - 1.0 for found in noisy])
    held = sum(found["low"] <= exact <= found["high"] for found in noisy)
    width = np.mean([0.5 * (found["high"] - found["low"]) / exact for found in noisy])
    lines += ["", "Tip curves with errors of 1 % of the largest drop:", ""]
    lines += ["| curves | mean deviation [%] | largest [%] | mean half width of intervals [%] | intervals that hold |"]
    lines += ["|---" * 5 + "|"]
    cells = [
        f"{len(noisy)}",
        f"{100 * off.mean():+.2f}",
        f"{100 * np.abs(off).max():.2f}",
        f"{100 * width:.2f}",
        f"{held}",
    ]
    return "\n".join([*lines, "| " + " | ".join(cells) + " |"])


def finding(tables: list[Table]) -> str:
    """Largest deviations, and how many intervals hold."""
    exact, noisy = tables
    worst = max(abs(number(found["deviation [%]"])) for found in exact if found["constant"] == "young")
    held, curves = noisy[0]["intervals that hold"], noisy[0]["curves"]
    return (
        f"Young's modulus is recovered within {worst:.2g} % from tip curves, corners and frequencies of finite "
        f"elements; from tip curves with errors of 1 % {held} of {curves} intervals of 95 % hold it."
    )
