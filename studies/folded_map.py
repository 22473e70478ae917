"""A map that is folded along three creases, let go, and keeps its folds, against one without creases.

A sheet of four panels lies flat, its first edge clamped. Its second crease and its last edge are led along the paths
that rigid panels would take, each crease turning by the fold angle, in a motion of one second; then they are let go.
Creases yield on the way, and statics find the shape that is left. Without creases the same sheet springs back flat.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import modalshell as ms
from modalshell.core.typing import Array, Progress
from modalshell.files.study_result import StudyResult
from studies.pages import markdown, result_of
from studies.stiffened_panel import solved

FIGURES = ("folded_map",)
PANELS, PANEL, WIDTH = 4, 0.1, 0.15
"""Number, length and width of the panels [m]."""
PAPER = {"young": 2.5e9, "poisson": 0.3, "thickness": 1e-4, "density": 800.0}
LIMIT, HARDENING = 2e-4, 5e-5
"""Yield moment [N], and hardening [N], of the creases."""
FOLD, SECONDS = 130.0, 1.0
"""Fold to which the map is led [deg], and how long that takes [s]."""
CELLS = (2, 4)
"""Cells along a panel."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Two meshes, with creases and without; ``quick`` takes the coarser one and longer steps."""
    cells, dt = (CELLS[:1], 0.05) if quick else (CELLS, 0.02)
    cases = [(size, limit) for size in cells for limit in (LIMIT, None)]
    rows = []
    for done, (size, limit) in enumerate(cases):
        rows.append(case(size, limit, dt))
        if on_step is not None:
            on_step(done + 1, len(cases))
    return result_of("folded_map", {"rows": rows}, quick=quick)


def folded_sheet(cells: int, limit: float | None) -> ms.Shell:
    """The map, flat, with creases that yield at a moment per length, or without."""
    size = cells * PANELS, max(round(cells * WIDTH / PANEL), 1)
    mesh = ms.flat_beam(length=PANELS * PANEL, width=WIDTH, cells=size)
    creases = [] if limit is None else [ms.Crease(line(mesh, k), limit, HARDENING) for k in range(1, PANELS)]
    return ms.Shell(mesh, ms.Isotropic(**PAPER), clamped=line(mesh, 0), creases=creases)


def line(mesh: ms.TriangleMesh, k: int) -> NDArray[np.bool_]:
    """Vertices (n,) of the k-th fold line, 0 and PANELS being the ends."""
    return np.asarray(np.abs(mesh.vertices[:, 0] - k * PANEL) < 1e-9)


def led_to(time: float, panels: int) -> Array:
    """Where a line is at a time [s], after 2 or 4 ``panels``, every second one turned by the fold angle."""
    share = min(time / SECONDS, 1.0)
    angle = np.radians(FOLD) * share**2 * (3.0 - 2.0 * share)
    return 0.5 * panels * PANEL * np.array([1.0 + np.cos(angle), 0.0, np.sin(angle)])


def case(cells: int, limit: float | None, dt: float) -> dict[str, Any]:
    """Fold and let go: angles [deg], heat [J], and shapes."""
    shell = folded_sheet(cells, limit)
    led = [ms.PositionConstraint(np.flatnonzero(line(shell.mesh, k)), partial(led_to, panels=k)) for k in (2, PANELS)]
    run = ms.simulate(ms.DiscreteShell(shell), duration=1.2 * SECONDS, dt=dt, damping=(5.0, 0.0), constraints=led)
    kept = shell
    if limit is not None:
        kept = shell.creased(ms.CreaseState(run.crease_angles[-1], float(run.crease_heat[-1])))
    released = solved(ms.DiscreteShell(kept).equilibrium(start=run.positions[-1]))
    found = {
        "cells": cells,
        "creases": limit is not None,
        "led": panel_folds(shell.mesh, run.positions[-1]),
        "kept": panel_folds(shell.mesh, released.positions),
        "plastic": [0.0] * (PANELS - 1),
        "heat": 0.0,
        "least step of heat": 0.0,
        "status": run.status,
        "shapes": [run.positions[-1].tolist(), released.positions.tolist()],
        "faces": shell.mesh.faces.tolist(),
    }
    if limit is None:
        return found
    assert shell.creases is not None
    assert released.creases is not None
    middles = shell.mesh.vertices[shell.mesh.edges[shell.mesh.hinge_edges[shell.creases.hinges]]].mean(axis=1)[:, 0]
    angles = np.abs(np.degrees(released.creases.angles))
    plastic = [float(angles[np.abs(middles - k * PANEL) < 1e-9].mean()) for k in range(1, PANELS)]
    return found | {
        "plastic": plastic,
        "heat": released.creases.dissipated,
        "least step of heat": float(np.diff(run.crease_heat).min()),
    }


def panel_folds(mesh: ms.TriangleMesh, x: Array) -> list[float]:
    """Angles [deg] between the panels, by the chords of their middle lines."""
    middles = np.array([x[line(mesh, k)].mean(axis=0) for k in range(PANELS + 1)])
    chords = np.diff(middles, axis=0)
    chords /= np.linalg.norm(chords, axis=1)[:, None]
    cosines = np.clip(np.sum(chords[1:] * chords[:-1], axis=1), -1.0, 1.0)
    return [float(angle) for angle in np.degrees(np.arccos(cosines))]


def table(result: StudyResult) -> str:
    """One row per mesh and sheet, as a Markdown table."""
    rows = []
    for row in result.findings["rows"]:
        texts = {key: ", ".join(f"{angle:.1f}" for angle in row[key]) for key in ("led", "kept", "plastic")}
        rows.append(row | texts | {"sheet": "with creases" if row["creases"] else "without", "mj": 1e3 * row["heat"]})
    return markdown(
        "cells a panel | sheet | folds led to [deg] | folds kept [deg] | plastic folds [deg] | heat [mJ]",
        "{cells} | {sheet} | {led} | {kept} | {plastic} | {mj:.4f}",
        rows,
    )


def finding(result: StudyResult) -> str:
    """What the finest map keeps."""
    rows = result.findings["rows"]
    finest = max(row["cells"] for row in rows)
    own = {row["creases"]: row for row in rows if row["cells"] == finest}
    kept, plain = own[True]["kept"], own[False]["kept"]
    return (
        f"Led to folds of {_span(own[True]['led'])} degrees and let go, the map keeps {_span(kept)}, and has made "
        f"{1e3 * own[True]['heat']:.2f} mJ of heat; without creases {max(plain):.2g} degrees are left."
    )


def _span(angles: list[float]) -> str:
    """The least and the largest angle, or the one that both are."""
    ends = [f"{angle:.0f}" for angle in (min(angles), max(angles))]
    return " to ".join(dict.fromkeys(ends))
