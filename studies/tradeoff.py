"""What accuracy costs: every rung on six scenes, its error against DS over what a frame takes.

Flat beam, V-beam with a soft membrane, V-beam with a stiff one that snaps, leaf in a wind, twisted strip, and the
creature of 13,000 vertices. The V-beam that snaps is also followed through its snap by DS on coarse meshes
and by the hybrid.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

import modalshell as ms
from modalshell.compare.candidates import Candidate, candidates, case_factory
from modalshell.compare.case import Case, scene_case
from modalshell.compare.draw import best_sizes
from modalshell.compare.report import markdown_table, percent
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Progress
from modalshell.files.provenance import repository_file
from modalshell.files.study_result import StudyResult
from modalshell.models.registry import MODELS, TRUTH
from modalshell.motion import Motion
from modalshell.motion.recorder import take_steps
from studies.pages import counted, markdown, result_of

FIGURES = ("tradeoff",)

SCENES = {
    "flat_beam": "flat beam, slightly bent",
    "v_beam": "V-beam, soft membrane",
    "v_beam_stiff": "V-beam, stiff membrane: it snaps",
    "leaf_wind": "leaf in a wind, twisted",
    "twisted_strip": "twisted strip",
    "creature_pushed": "creature of 13,000 vertices",
}
QUICK = {"flat_beam": (16, 4), "v_beam_stiff": (20, 4)}
"""Scenes and cells of a quick run."""
AFTER_SNAP = (6.0 / 7.0, 1.0)
"""Shares of the stiff V-beam's load, gravity of 60 and 70 m/s^2, under which it has snapped."""
REPEATS = 3
"""Static answers there, of which the fastest is timed."""
SNAP_TIME, SNAP_DAMPING = 0.5, (2.0, 0.001)
"""Motion through the snap: time [s] and Rayleigh factors."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Measure all scenes; ``quick`` takes two of them, coarser, with fewer modes and loads."""
    options: dict[str, Any] = {"modes": (4,), "loads": (0.5, 1.0)} if quick else {}
    names = list(QUICK if quick else SCENES)
    findings: dict[str, Any] = {"scenes": {}, "titles": {name: SCENES[name] for name in names}}
    arrays: dict[str, np.ndarray] = {}
    for name in counted(names, on_step):
        case = scene(name, QUICK[name] if quick else None)
        found = ms.tradeoff(case, **options)
        findings["scenes"][name] = found.findings()
        for row in best_sizes(findings["scenes"][name]):
            position = next(one.positions for one in found.rows if one.label == row["label"])
            arrays[f"{name}: {row['label']}"] = position
        arrays |= {f"{name}_faces": np.asarray(case.shell.mesh.faces), f"{name}_rest": case.shell.rest_positions}
        if name == "v_beam_stiff":
            findings["snap"] = through_snap(case)
    return result_of("tradeoff", findings, arrays, names=names)


def scene(name: str, cells: tuple[int, int] | None) -> Case:
    """The case of a scene file; on a mesh of other ``cells`` if given, clamped by two rows."""
    declared = ms.load_scene(repository_file(f"studies/scenes/{name}.toml")).require_shell()
    if cells is not None:
        table: Any = declared.mesh
        held: Any = declared.supports
        supports = msgspec.structs.replace(held, clamped=f"x < {1.5 * table.length / cells[0]}")
        declared = replace(declared, mesh=msgspec.structs.replace(table, cells=cells), supports=supports)
    return scene_case(declared)


def through_snap(case: Case) -> list[dict[str, Any]]:
    """DS, coarse DS and the hybrid after the snap: errors, times of a static answer from rest and of a motion."""
    found = [
        candidate for candidate in candidates(case)[0] if candidate.spec.key == TRUTH or candidate.spec.on_coarse_mesh
    ]
    rows = [snap_row(case, candidate) for candidate in reversed(found)]
    truth = rows[0]
    for row in rows:
        row["errors"] = [
            ms.measure.displacement_error(mine, exact, case.shell)
            for mine, exact in zip(row["positions"], truth["positions"], strict=True)
        ]
        row["statics_ratio"] = sum(truth["statics"]) / sum(row["statics"])
        row["motion_ratio"] = truth["motion"] / row["motion"]
        row["motion_error"] = ms.measure.displacement_error(row["last"], truth["last"], case.shell)
    return [{key: value for key, value in row.items() if key not in ("positions", "last")} for row in rows]


def snap_row(case: Case, candidate: Candidate) -> dict[str, Any]:
    """Answers and times of one rung."""
    model, preprocessing = candidate.build(case_factory(case))
    tries = [[model.equilibrium(force=share * case.load) for share in AFTER_SNAP] for _ in range(REPEATS)]
    answers = [min(same, key=lambda answer: answer.seconds) for same in zip(*tries, strict=True)]
    motion = Motion(model, case.shell.loading(force=case.load), dt=case.dt, damping=SNAP_DAMPING)
    steps = round(SNAP_TIME / case.dt)
    watch = Stopwatch()
    for _ in take_steps(motion, steps):
        last = motion.positions()
    return {
        "label": candidate.label,
        "preprocessing": preprocessing,
        "statuses": [answer.status for answer in answers],
        "statics": [answer.seconds for answer in answers],
        "motion": watch() / steps,
        "positions": [answer.positions for answer in answers],
        "last": last,
    }


def table(result: StudyResult) -> str:
    """The findings as Markdown tables, one a scene, and one of the snap."""
    parts = [f"## {SCENES[name]}\n\n{markdown_table(found)}" for name, found in result.findings["scenes"].items()]
    shares = " | ".join(f"error at {share:.2f} of the load" for share in AFTER_SNAP)
    rows = []
    for row in result.findings["snap"]:
        errors = [percent(error) for error in (*row["errors"], row["motion_error"])]
        rows.append({**row, "errors": errors[:-1], "last": errors[-1], "whole": sum(row["statics"])})
    after = markdown(
        f"rung | {shares} | static answers [s] | times cheaper | frame in motion [s] | times cheaper "
        "| error at its end",
        "{label} | {errors} | {whole:.3g} | {statics_ratio:.3g} | {motion:.3g} | {motion_ratio:.3g} | {last}",
        rows,
    )
    return "\n\n".join([*parts, f"## After the snap of the stiff V-beam\n\n{after}"])


def finding(result: StudyResult) -> str:
    """The model of the cheapest frame within 10 % of DS on each scene."""
    told: dict[str, list[str]] = {}
    gains = []
    for name, found in result.findings["scenes"].items():
        right = [row for row in found["rows"] if row["worst_error"] is not None and row["worst_error"] <= 0.1]
        best = min(right, key=lambda row: row["frame_ms"])
        truth = next(row for row in found["rows"] if row["label"] == MODELS[TRUTH].name)
        gains.append(truth["frame_ms"] / best["frame_ms"])
        name_of = re.sub(r" \d[\dx]*$", "", best["label"])  # without its size
        told.setdefault(name_of, []).append(SCENES[name])
    words = "; ".join(f"{rung} ({' and '.join(scenes)})" for rung, scenes in told.items())
    return (
        f"On each of {len(gains)} scenes some model is within 10 % of DS with a frame {min(gains):,.0f} to "
        f"{max(gains):,.0f} times as cheap. Which one is the cheapest depends on the scene: {words}."
    )
