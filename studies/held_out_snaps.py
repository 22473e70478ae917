"""How far is the hybrid model off through a snap? Loads drawn by a seed, none of them in training.

The stiff V-beam of ``v_beam_accuracy``: a coarse shell of it trains :class:`HybridStress` about a gravity that snaps
it. Then loads and damping are drawn as in training, by another seed: half of the loads within 30 degrees of that
gravity, half in any direction, 0.5 to 1.2 of its size, a third with a point force added. Each holds for one second
and is released for half a second. Errors of the hybrid are measured against the coarse shell that trained it and, with
that shell's own, against DS on the fine mesh. What steps of a frame cost is measured, too: the coarse shell against
itself in steps a quarter as long. So are three named motions with either kind of damping, and statics on both sides of
the snap; the last table has the gravity at which each model snaps.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.path import Marks
from modalshell.compare.report import percent
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.models.coarse.coarse_mesh import drawn_to_supports
from modalshell.models.hybrid.training import LOADED, RELEASED, random_damping, random_load
from studies.pages import at_most, counted, markdown, paragraphs, result_of
from studies.snap import v_beam

FIGURES = ("held_out_snaps",)

SEED = 24
LOADS = 24
DT = 1.0 / 30.0
"""Frames [s]."""
GRAVITY = 70.0
"""Gravity [m/s^2] about which the hybrid is trained; the fold flattens below 0.7 of it."""
DAMPINGS = {"by the mass": ms.Damping(2.0), "by the stiffness": ms.Damping(0.5, 1e-3)}
FILMED = "15° aside, damped by the mass"
FILM = (
    "[Film](../paper_figures/held_out_snaps.mp4) of the motion 15° aside, damped by the mass: DS (green), the hybrid "
    "(pink)."
)
STATICS = (20.0, 40.0, 55.0, 70.0)
SNAPPED = 0.3
"""Largest displacement [m] of a motion from which its fold has flattened."""

ERRORS = ("coarse", "fine", "coarse_to_fine")
"""Errors of the hybrid against the coarse shell and DS, and of the coarse shell against DS."""
SHORT = 4
"""Steps in a frame, against which the coarse shell's own is measured."""
SHARES = {"median": 0.5, "75 %": 0.75, "90 %": 0.9, "largest": 1.0}
"""Quantiles of the errors."""

Frames = tuple[np.ndarray, float, int]


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Train, and measure all motions; ``quick`` takes coarser meshes and fewer loads."""
    fine, cells, count, motions = ((32, 8), (16, 4), 4, 16) if quick else ((80, 16), (40, 8), LOADS, 40)
    shell = v_beam(150.0, fine)
    coarse = ms.coarse_shell(shell, drawn_to_supports(shell, v_beam(150.0, cells).mesh))
    began = time.process_time()
    hybrid = ms.HybridStress.trained(shell, gravity=(0, 0, -GRAVITY), coarse=coarse, motions=motions)
    seconds = time.process_time() - began
    models: dict[str, ms.Model] = {
        model.name: model
        for model in (ms.DiscreteShell(shell, step_tolerance=1e-4, integrator="bdf2"), hybrid.coarse, hybrid)
    }
    rng, weight = np.random.default_rng(SEED), np.array(shell.gravity_force((0, 0, -GRAVITY)))
    drawn = [(random_load(shell, weight, rng), random_damping(rng, DT)) for _ in range(count)]
    named = {
        f"{name}, damped {kind}": (load, damping)
        for name, load in named_loads(shell).items()
        for kind, damping in DAMPINGS.items()
    }
    tasks = [*named.items(), *((f"load {place + 1}", task) for place, task in enumerate(drawn))]
    rows = []
    for name, (load, damping) in counted(tasks, on_step):
        rows.append({"motion": name, "drawn": name not in named} | measured(shell, models, load, damping))
    found = {
        "rows": rows,
        "equilibria": [statics(shell, models, gravity) for gravity in STATICS],
        "snaps": snap_loads(models, hybrid),
        "training_seconds": seconds,
        "held_out_error": hybrid.held_out_error,
        "cells": {"fine": "{}x{}".format(*fine), "coarse": "{}x{}".format(*cells)},
    }
    load, damping = named[FILMED]
    film = {
        name: frames_of(model, load, damping)[0].astype(np.float32)
        for name, model in models.items()
        if model is not hybrid.coarse
    }
    arrays = {f"film_{name}": frames for name, frames in film.items()}
    arrays |= {"faces": np.asarray(shell.mesh.faces), "rest": np.asarray(shell.rest_positions)}
    arrays |= {
        "errors": np.array([[row["coarse"], row["fine"], row["coarse_to_fine"]] for row in rows if row["drawn"]])
    }
    return result_of("held_out_snaps", found, arrays, SEED, quick=quick)


def named_loads(shell: ms.Shell) -> dict[str, np.ndarray]:
    """Gravity downwards, tilted aside by 15 degrees, and twice as strong on one edge as on the other."""
    tilt, y = np.radians(15.0), np.array(shell.rest_positions)[:, 1]
    down = np.array(shell.gravity_force((0.0, 0.0, -GRAVITY)))
    aside = np.array(shell.gravity_force((0.0, GRAVITY * np.sin(tilt), -GRAVITY * np.cos(tilt))))
    return {"down": down, "15° aside": aside, "twisted": down * (1.0 + y / (3.0 * np.abs(y).max()))[:, None]}


def frames_of(model: ms.Model, load: np.ndarray, damping: ms.Damping, parts: int = 1) -> Frames:
    """Positions (f, n, 3) of a motion, median processor time of a frame [ms], frames that the coarse shell took.

    A frame is one step, or as many ``parts``.
    """
    state, frames, times, handed = model.start_motion(), [], [], 0
    for frame in range(LOADED + RELEASED):
        began = time.process_time()
        for _ in range(parts):
            state, _ = model.step(state, DT / parts, load if frame < LOADED else np.zeros_like(load), damping)
        frames.append(np.array(model.positions(state)))
        times.append(time.process_time() - began)
        handed += state.coordinates.ndim == 2
    return np.array(frames), 1000.0 * float(np.median(times)), handed


def measured(shell: ms.Shell, models: dict[str, ms.Model], load: np.ndarray, damping: ms.Damping) -> dict[str, Any]:
    """Errors of one motion, over its size, and what its frames took."""
    found = {name: frames_of(model, load, damping) for name, model in models.items()}
    found["short"] = frames_of(models["coarse DS"], load, damping, SHORT)

    def apart(name: str, other: str) -> float:
        exact = found[other][0]
        return float(np.linalg.norm(found[name][0] - exact) / np.linalg.norm(exact - shell.rest_positions))

    def snapped(name: str) -> bool:
        return bool(np.linalg.norm(found[name][0] - shell.rest_positions, axis=2).max() > SNAPPED)

    return {
        "coarse": apart("hybrid", "coarse DS"),
        "fine": apart("hybrid", "DS"),
        "coarse_to_fine": apart("coarse DS", "DS"),
        "steps": apart("coarse DS", "short"),
        "snaps": {name: snapped(name) for name in models},
        "handed": found["hybrid"][2],
        "ms": {name: found[name][1] for name in models},
        "damping": [damping.mass_factor, damping.stiffness_factor],
    }


def statics(shell: ms.Shell, models: dict[str, ms.Model], gravity: float) -> dict[str, Any]:
    """Errors of the equilibria under one gravity, each found from rest."""
    answers = {name: model.equilibrium(gravity=(0, 0, -gravity)).positions for name, model in models.items()}

    def apart(name: str, other: str) -> float:
        return ms.measure.displacement_error(answers[name], answers[other], shell)

    errors = {"coarse": apart("hybrid", "coarse DS"), "fine": apart("hybrid", "DS")}
    return {"gravity": gravity, **errors, "coarse_to_fine": apart("coarse DS", "DS")}


def snap_loads(models: dict[str, ms.Model], hybrid: ms.HybridStress) -> dict[str, float | None]:
    """Gravity at which each snaps: of shells from their paths, of the hybrid where small load steps jump."""
    found: dict[str, float | None] = {}
    for name, model in models.items():
        if model is hybrid:
            continue
        shell = hybrid.coarse.coarse if model is hybrid.coarse else model
        path = ms.equilibrium_path(shell, gravity=(0, 0, -1), until=GRAVITY, branches=1)
        found[name] = Marks.of(path).snap
    found["hybrid"], x = None, hybrid.equilibrium(gravity=(0, 0, -30.0)).positions
    for gravity in np.arange(30.0, GRAVITY, 0.2):
        answer = hybrid.equilibrium(gravity=(0, 0, -gravity), start=x)
        if np.linalg.norm(answer.positions - x, axis=1).max() > 0.5 * SNAPPED:
            found["hybrid"] = float(gravity)
            break
        x = answer.positions
    return found


def quantiles(found: dict[str, Any], share: float) -> dict[str, float]:
    """A quantile of each error over the drawn loads."""
    drawn = [row for row in found["rows"] if row["drawn"]]
    return {key: float(np.quantile([row[key] for row in drawn], share)) for key in (*ERRORS, "steps")}


def table(result: StudyResult) -> str:
    """Errors of every motion, their distribution, statics, and the snap loads."""
    found, rows = result.findings, []
    for row in found["rows"]:
        snaps = sorted({name for name, snapped in row["snaps"].items() if snapped})
        which = "all" if len(snaps) == len(row["snaps"]) else " and ".join(snaps) or "none"
        times = ", ".join(f"{value:.3g}" for value in reversed(row["ms"].values()))
        rows.append({**row, "which": which, "times": times})
    headings = "hybrid against coarse DS | hybrid against DS | coarse DS against DS"
    errors = "{coarse:100*.2f} % | {fine:100*.2f} % | {coarse_to_fine:100*.2f} %"
    drawn = [{"which": name, **quantiles(found, share)} for name, share in SHARES.items()]
    snaps = [{"model": name, "load": load} for name, load in found["snaps"].items()]
    return paragraphs(
        f"DS has {found['cells']['fine']} cells, the coarse shell {found['cells']['coarse']}; the hybrid was "
        f"trained in {found['training_seconds']:.3g} s of processor time and states an error of "
        f"{100 * found['held_out_error']:.2g} %. Errors of its steps are those of coarse DS in one step a frame, "
        f"against {SHORT}: what follows a snap is faster than frames.",
        markdown(
            f"motion | {headings} | its steps | snaps | coarse frames | processor ms a frame: hybrid, coarse DS, DS",
            f"{{motion}} | {errors} | {{steps:100*.2f}} % | {{which}} | {{handed}} | {{times}}",
            rows,
        ),
        markdown(f"drawn loads | {headings} | its steps", f"{{which}} | {errors} | {{steps:100*.2f}} %", drawn),
        markdown(f"gravity, m/s² | {headings}", f"{{gravity:g}} | {errors}", found["equilibria"]),
        markdown("model | snaps at a gravity of", "{model} | {load:.2f|–}", snaps),
        FILM,
    )


def finding(result: StudyResult) -> str:
    """The distribution, the named motions, and what a frame costs."""
    found = result.findings
    named = [row for row in found["rows"] if not row["drawn"]]
    worst = max(row["fine"] for row in named)
    after = max(row["fine"] for row in found["equilibria"] if row["gravity"] > 50.0)
    half, most = (quantiles(found, share) for share in (0.5, 0.9))
    return (
        f"Through the snap of the stiff V-beam the hybrid is {at_most(100 * worst)} % off fine DS at most in "
        f"{len(named)} named motions with either damping, {percent(after, '.2g')} at rest after it. Of "
        f"{len(found['rows']) - len(named)} loads drawn by a seed half are within {at_most(100 * half['coarse'])} % of "
        f"the coarse shell that trained it ({at_most(100 * half['fine'])} % of fine DS), 90 % within "
        f"{at_most(100 * most['coarse'])} % ({at_most(100 * most['fine'])} %); steps of a frame themselves are off by "
        f"{percent(half['steps'], '.2g')} and {percent(most['steps'], '.2g')}."
    )
