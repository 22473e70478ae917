"""One strip and one plate by several engines: errors against the elastica and Ritz's method, after conversion checks.

A clamped strip hangs under its own weight at three loads, against the heavy elastica. Each engine gets the same mesh,
physical constants, supports and gravity, converted as its adapter in ``studies/engine_adapters`` says, in a process of
its own. Before a row counts the conversion must hold on closed forms: the mass that moves within 1 % where the engine
tells it, and the small drop rho g h L^4 / (8 D) within 10 %. MuJoCo's flex runs a second time with its modulus
calibrated on that drop, checked then on a strip of half the length. Finite elements also find the frequencies of a
square plate clamped on one edge, against Ritz's method, Poisson's ratio 0.3.

Engines run in the Python that the environment variable ``MODALSHELL_ENGINES`` names, or in this one. What is missing is
named in the table, with the command that installs it. Run it alone with ``modalshell reproduce --only engines``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

import modalshell as ms
from modalshell.provenance import run_record
from modalshell.study import StudyResult, Table
from studies.pages import number
from studies.plate_frequencies import reference

FIGURES = ("engines",)

ADAPTERS = Path(__file__).with_name("engine_adapters")
STRIP = {"length": 0.3, "width": 0.03, "young": 1e7, "poisson": 0.0, "thickness": 3e-3, "density": 1000.0}
PLATE = {"length": 0.3, "width": 0.3, "young": 1e9, "poisson": 0.3, "thickness": 1e-3, "density": 1000.0}
CELLS = (20, 2)
ELASTICA = {1.0: (0.9912463953, 0.123471402), 3.0: (0.9315112071, 0.3396483923), 10.0: (0.6563537612, 0.7001997155)}
"""Reach and drop of the tip over the length at rho g h L^3 / D: a boundary-value solution, checked by shooting."""
SMALL = 0.05
"""Load of the conversion check, at which linear theory holds within 0.1 %."""
MASS, DROP = 0.01, 0.1
"""Deviations of mass and small drop at which a conversion fails."""
MODES = 6
SECONDS = 600.0
"""Time after which an engine is stopped."""


@final
@dataclass(frozen=True)
class Engine:
    """An engine other than this package.

    Attributes
    ----------
    key : str
        Name of its adapter.
    words : str
        What the table calls it.
    install : str
        How to get it.
    options : dict
        What its adapter takes in addition to the case: the step [s], and the seconds that a load may take.
    """

    key: str
    words: str
    install: str
    options: dict[str, Any]


ENGINES = (
    Engine("calculix", "CalculiX S8R", "apt-get install calculix-ccx", {}),
    Engine("mujoco_flex", "MuJoCo flex", "pip install mujoco", {"step": 2e-3, "duration": 6.0, "limit": 60.0}),
    Engine(
        "newton_vbd",
        "Newton VBD, 20 iterations a step",
        "pip install newton",
        {"step": 1e-2, "duration": 6.0, "limit": 90.0, "iterations": 20},
    ),
)


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """Every engine; ``quick`` leaves the others' processes out, and says so in their rows."""
    rows = [ours("Isotropic"), ours("hinges")]
    plates = [our_plate(12 if quick else 32)]
    for done, engine in enumerate(ENGINES, start=1):
        if quick:
            rows.append({"engine": engine.words, "outcome": "left out of a quick run", "version": ""})
        else:
            rows += foreign(engine)
        if on_step is not None:
            on_step(done, len(ENGINES))
    if not quick:
        plates.append(foreign_plate(ENGINES[0]))
    findings = {"rows": rows, "plates": plates, "elastica": {f"{load:g}": list(tip) for load, tip in ELASTICA.items()}}
    return StudyResult("engines", findings, {}, run_record({"strip": STRIP, "plate": PLATE, "cells": CELLS}))


def rigidity(case: dict[str, float]) -> float:
    """Bending stiffness D [N m]."""
    return case["young"] * case["thickness"] ** 3 / (12.0 * (1.0 - case["poisson"] ** 2))


def gravity_at(load: float, case: dict[str, float]) -> float:
    """Gravity [m/s^2] of a load rho g h L^3 / D."""
    return load * rigidity(case) / (case["density"] * case["thickness"] * case["length"] ** 3)


def strip(case: dict[str, float], energy: str) -> ms.Shell:
    """The strip, clamped at x = 0: calibrated hinges have a row of vertices before it, so that two rows are held."""
    cell = STRIP["length"] / CELLS[0]
    cells = round(case["length"] / cell)
    along, before = (cells, 0.0) if energy == "Isotropic" else (cells + 1, cell)
    flat = ms.flat_beam(length=case["length"] + before, width=case["width"], cells=(along, CELLS[1]))
    mesh = ms.TriangleMesh(flat.vertices - np.array([before, 0.0, 0.0]), flat.faces)
    held = mesh.vertices[:, 0] < 1e-9
    sheet = {key: case[key] for key in ("young", "poisson", "thickness", "density")}
    if energy == "Isotropic":
        return ms.Shell(mesh, ms.Isotropic(**sheet), held)
    return ms.Shell(mesh, ms.Material.from_physical(mesh=mesh, **sheet), held)  # type: ignore[arg-type]


def ours(energy: str) -> dict[str, Any]:
    """Row of the discrete shells of this package."""
    shell = strip(STRIP, energy)
    tip = shell.rest_positions[:, 0] > STRIP["length"] - 1e-9
    body, tips, seconds = ms.DiscreteShell(shell), [], []
    for load in (SMALL, *ELASTICA):
        answer = body.equilibrium(gravity=(0.0, 0.0, -gravity_at(load, STRIP)))
        tips.append(answer.positions[tip].mean(axis=0).tolist())
        seconds.append(answer.seconds)
    words = "modalshell DS, shell theory" if energy == "Isotropic" else "modalshell DS, calibrated hinges"
    return judged(words, {"version": f"modalshell {ms.__version__}", "tips": tips, "seconds": seconds}, STRIP)


def case_of(case: dict[str, float], loads: tuple[float, ...], engine: Engine) -> dict[str, Any]:
    """What an adapter reads: the case, the mesh, lumped masses, hinges, held vertices and loads."""
    shell = strip(case, "hinges")
    hinges = shell.elements[2]
    edges = shell.rest_positions[hinges.stencils[:, 1]] - shell.rest_positions[hinges.stencils[:, 0]]
    weights = 2.0 * hinges.weight / np.linalg.norm(edges, axis=1)
    tip = np.flatnonzero(shell.rest_positions[:, 0] > case["length"] - 1e-9)
    pace = 3.516 * np.sqrt(rigidity(case) / (case["density"] * case["thickness"] * case["length"] ** 4))
    return {
        **case,
        **engine.options,
        "cells": CELLS,
        "vertices": shell.rest_positions.tolist(),
        "faces": shell.mesh.faces.tolist(),
        "held": np.flatnonzero(shell.clamped).tolist(),
        "masses": shell.mass.tolist(),
        "hinges": [
            [*ends, weight] for ends, weight in zip(hinges.stencils[:, :2].tolist(), weights.tolist(), strict=True)
        ],
        "tip": tip.tolist(),
        "damping": 1.4 * pace,
        "gravities": [gravity_at(load, case) for load in loads],
    }


def run(engine: Engine, case: dict[str, Any]) -> dict[str, Any]:
    """An adapter's answer, or ``{"outcome": why there is none}``."""
    python = os.environ.get("MODALSHELL_ENGINES", sys.executable)
    command = [python, str(ADAPTERS / f"{engine.key}.py")]
    try:
        told = subprocess.run(
            command, input=json.dumps(case), capture_output=True, text=True, timeout=SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return {"outcome": f"stopped after {SECONDS:g} s"}
    except OSError as error:
        return {"outcome": f"did not start: {error.strerror}"}
    lines = told.stdout.strip().splitlines()
    if told.returncode == 0 and lines:
        return dict(json.loads(lines[-1]))
    last = (told.stderr.strip().splitlines() or ["no message"])[-1]
    if "No module named" in last or "No program named" in last:
        return {"outcome": f"not installed: {engine.install}"}
    return {"outcome": f"ended with status {told.returncode}: {last[:200]}"}


def foreign(engine: Engine) -> list[dict[str, Any]]:
    """Rows of another engine: as documented and, where a constant of it can be calibrated, calibrated."""
    loads = (SMALL, *ELASTICA)
    case = case_of(STRIP, loads, engine)
    rows = [judged(engine.words, run(engine, case), STRIP, case)]
    if engine.key == "mujoco_flex" and "drop" in rows[0]:
        scale = 1.0 + rows[0]["drop"]
        half = {**STRIP, "length": 0.5 * STRIP["length"]}
        check = case_of(half, (SMALL,), engine) | {"calibration": scale}
        small = judged(engine.words, run(engine, check), half, check)
        found = run(engine, case | {"calibration": scale})
        words = f"{engine.words}, modulus times {scale:.3f}"
        rows.append(judged(words, found, STRIP, case, drop=small.get("drop", float("inf"))))
    return rows


def judged(
    words: str,
    found: dict[str, Any],
    case: dict[str, float],
    given: dict[str, Any] | None = None,
    drop: float | None = None,
) -> dict[str, Any]:
    """A row: its conversion checks, and its errors where these hold."""
    row = {"engine": words, "outcome": found.get("outcome", ""), "version": found.get("version", "")}
    if row["outcome"]:
        return row
    if given is not None and any(count * given["step"] < 0.99 * given["duration"] for count in found["steps"]):
        row["outcome"] = f"not at rest after {given['limit']:g} s a load"
        return row
    row["drop"] = -found["tips"][0][2] / (SMALL / 8.0 * case["length"]) - 1.0
    faults = []
    if given is not None and "mass" in found:
        moving = float(np.delete(np.array(given["masses"]), given["held"]).sum())
        row["mass"] = found["mass"] / moving - 1.0
        faults += [f"mass {100.0 * row['mass']:+.1f} %"] if abs(row["mass"]) > MASS else []
    off = row["drop"] if drop is None else drop
    faults += [] if abs(off) <= DROP else [f"small drop {100.0 * off:+.0f} %"]
    row["outcome"] = f"conversion check failed: {', '.join(faults)}" if faults else "counts"
    if not faults and len(found["tips"]) > 1:
        tips = np.array(found["tips"][1:]) / case["length"]
        exact = np.array([[reach, 0.0, -fall] for reach, fall in ELASTICA.values()])
        moved = np.linalg.norm(exact - [1.0, 0.0, 0.0], axis=1)
        row["errors"] = (np.linalg.norm(tips - exact, axis=1) / moved).tolist()
        row["seconds"] = float(np.sum(found["seconds"]))
    return row


def our_plate(cells: int) -> dict[str, Any]:
    """Frequencies of the square plate by this package."""
    mesh = ms.sheet(length=PLATE["length"], width=PLATE["width"], cells=(cells, cells))
    sheet = {key: PLATE[key] for key in ("young", "poisson", "thickness", "density")}
    basis = ms.solve_modes(ms.Shell(mesh, ms.Isotropic(**sheet), mesh.vertices[:, 0] < 1e-9), MODES)
    return plate_row("modalshell, shell theory", basis.frequencies)


def foreign_plate(engine: Engine) -> dict[str, Any]:
    """Frequencies of the square plate by finite elements."""
    found = run(engine, {**PLATE, "cells": (16, 16), "modes": MODES})
    if "outcome" in found:
        return {"engine": engine.words, "outcome": found["outcome"]}
    return plate_row(engine.words, np.array(found["frequencies"]))


def plate_row(words: str, frequencies: np.ndarray) -> dict[str, Any]:
    """Deviations from Ritz's method."""
    unit = np.sqrt(rigidity(PLATE) / (PLATE["density"] * PLATE["thickness"])) / PLATE["length"] ** 2 / (2.0 * np.pi)
    exact = np.asarray(reference("CFFF")[0])[:MODES] * unit
    deviations = (np.asarray(frequencies) / exact - 1.0).tolist()
    return {"engine": words, "outcome": "counts", "deviations": deviations}


def table(result: StudyResult) -> str:
    """Errors of the strip's tip, and of the plate's frequencies, as Markdown tables."""
    loads = [f"error at {load} [%]" for load in result.findings["elastica"]]
    heads = ["engine", "outcome", "small drop off [%]", *loads, "seconds", "version"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for row in result.findings["rows"]:
        errors = [f"{100.0 * error:.2f}" for error in row["errors"]] if "errors" in row else [""] * len(loads)
        drop = f"{100.0 * row['drop']:+.1f}" if "drop" in row else ""
        time = f"{row['seconds']:.2g}" if "seconds" in row else ""
        lines.append(
            f"| {row['engine']} | {row['outcome']} | {drop} | {' | '.join(errors)} | {time} | {row['version']} |"
        )
    lines += ["", "Frequencies of the square plate, deviations from Ritz's method:", ""]
    heads = ["engine", "outcome", *(f"mode {mode} [%]" for mode in range(1, MODES + 1))]
    lines += ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for row in result.findings["plates"]:
        cells = [f"{100.0 * one:+.2f}" for one in row["deviations"]] if "deviations" in row else [""] * MODES
        lines.append(f"| {row['engine']} | {row['outcome']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """Errors at the largest load of the rows that count, and what did not count."""
    strips, plates = tables
    last = next(head for head in reversed(strips[0]) if head.startswith("error at"))
    counted = [row for row in strips if row["outcome"] == "counts"]
    told = ", ".join(f"{row['engine']} {row[last]} %" for row in counted)
    left = ", ".join(row["engine"] for row in strips if row["outcome"] != "counts")
    worst = max(
        abs(number(row[f"mode {mode} [%]"]))
        for row in plates
        if row["outcome"] == "counts"
        for mode in range(1, MODES + 1)
    )
    return (
        f"At a load of 10 the strip's tip is off by: {told}. Plate frequencies are within {worst:.2g} % of Ritz's "
        "method. " + (f"Not counted: {left}." if left else "Every engine's conversion held.")
    )
