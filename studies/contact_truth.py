"""Truth in contact: shells on planes and cylinders against the elastica, blocks on slopes, and each rung on a table.

The references are elasticas with contact, by shooting to twelve digits: a heavy sheet lifted off a table at its end, a
heavy strip over a cylinder, a ring between two plates, a strip bent back between two plates. Lengths are over
``l_g = (D / w)^(1/3)``, w the weight per area. Discrete shells meet them by exact active sets. Strips that fall, and
slide, say what happens to energy and depth. At last a cantilever comes to rest on a table by discrete shells and by the
modal rungs. Shells that touch themselves or one another are not looked at, nor contacts of other engines.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Array, Progress
from modalshell.files.study_result import StudyResult
from studies.contact_motions import BODIES, FRICTION, GRAVITY, STRIKES, fall, motion_on, on_table, slope, strike
from studies.contact_plates import FLEXURE, RINGS, bent, heavy, pinned, ring, strip
from studies.pages import at_most, counted, markdown, paragraphs, result_of
from studies.shell_theory import FAMILIES, columns

FIGURES = ("contact_truth",)

LIFTED = {
    0.05: (1.047330, 0.524144, 0.001775),
    0.1: (1.247009, 0.625120, 0.005976),
    0.2: (1.488109, 0.749535, 0.020149),
    0.5: (1.902088, 0.979434, 0.101187),
    1.0: (2.362807, 1.286617, 0.347342),
    2.0: (3.231760, 2.043660, 1.168161),
}
"""Free length, force and drawn-in length of a sheet over the height of its end."""
LEVEL = {0.1: (1.639645, 1.093796, 0.004189), 0.5: (2.476280, 1.662805, 0.070479), 1.0: (3.006511, 2.046361, 0.239936)}
"""The same with the end kept level."""
DRAPED = {
    "R 1, L 1": (1.0, 1.0, 0.991246, -0.123471, 0.0),
    "R 1, L 1.5": (1.0, 1.5, 1.375222, -0.558937, 2.28212),
    "R 1, L 2": (1.0, 2.0, 1.534389, -1.176128, 21.92119),
    "R 1, L 3": (1.0, 3.0, 1.450017, -2.352916, 44.78335),
    "R 0.5, L 3": (0.5, 3.0, 1.110389, -2.583820, 11.41305),
    "R 2, L 3": (2.0, 3.0, 2.206587, -1.770580, 47.97141),
}
"""Radius of the cylinder, half the length, where the tip hangs, and the angle [deg] at which it lifts off."""
HELD = {
    "lifted sheet, force, 40 cells": 5e-4,
    "lifted sheet, drawn in, 40 cells": 4e-3,
    "lifted sheet, force, 80 cells": 3e-4,
    "lifted sheet, drawn in, 80 cells": 1e-3,
    "lift-off by forces, 40 cells": 1e-3,
    "lift-off by forces, 80 cells": 1e-3,
    "drape, tip, 60 cells": 5e-5,
    "ring and bend, force, 80 cells": 5e-3,
    "iterations from a coarse answer": 15,
    "depth": 1e-9,
    "energy gained": 1e-9,
    "energy gained, six bodies": 1e-9,
    "sliding strip": 5e-3,
    "RSW on a table": 1e-2,
}
"""What is aimed at."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All tables; ``quick`` takes one mesh family, coarser meshes, shorter falls and fewer of the cases.

    The mesh families are compared at the sheet off a table, at what is off it alone, and at the cylinder.
    """
    families, every, first = (FAMILIES[:1], 3, FAMILIES[0]) if quick else (FAMILIES, 1, FAMILIES[0])
    bodies, strikes = (list(known)[: 1 if quick else None] for known in (BODIES, STRIKES))
    cases: list[tuple[str, Any]] = [("lifted", (mesh, 40, level)) for mesh in families for level in (False, True)]
    cases += [] if quick else [("lifted", (mesh, 80, False)) for mesh in families] + [("lifted", (first, 160, False))]
    cases += [("alone", (mesh, height)) for mesh in families for height in list(LIFTED)[::every]]
    cases += [("draped", (mesh, name)) for mesh in families for name in list(DRAPED)[::every]]
    cases += [("rings", (first, gap)) for gap in list(RINGS)[::every]]
    cases += [("bent", (first, 0.0))]
    thicknesses = (1e-2,) if quick else (1e-2, 1e-3)
    cases += [("falls", ("bdf2", case)) for case in thicknesses]
    cases += [("motions", (body, thick)) for thick in thicknesses for body in bodies]
    cases += [("slopes", share) for share in (0.9, 1.1, 1.3)]
    cases += [("strikes", case) for case in strikes]
    cases += [("table", modes) for modes in ((8,) if quick else (4, 8, 16))]
    findings: dict[str, Any] = {kind: [] for kind, _ in cases}
    fine = 24 if quick else 80
    answers: dict[str, Callable[[Any], list[dict[str, Any]]]] = {
        "lifted": lambda case: lifted(case[0], case[1], case[2], list(LEVEL if case[2] else LIFTED)[::every]),
        "alone": lambda case: [alone(case[0], 40, case[1])],
        "draped": lambda case: [draped(case[0], case[1], 30 if quick else 60)],
        "rings": lambda case: [ring(case[0], case[1], fine)],
        "bent": lambda case: [bent(case[0], fine)],
        "falls": lambda case: [fall(case[0], case[1], 40 if quick else 100)],
        "motions": lambda case: [motion_on(case[0], case[1], 60 if quick else 200)],
        "slopes": lambda case: [slope(case)],
        "strikes": lambda case: [strike(case)],
        "table": lambda case: on_table(case, quick),
    }
    for kind, case in counted(cases, on_step):
        findings[kind] += answers[kind](case)
    findings["held"] = held(findings)
    return result_of("contact_truth", findings, quick=quick)


def lifted(family: str, cells: int, level: bool, heights: list[float]) -> list[dict[str, Any]]:
    """Sheets on a table, one end at each height after the other, from the answer of a coarse shell.

    A level end is the middle of a sheet of twice the length.
    """
    length, width = 4.0, 0.4

    def shell_of(cells: int) -> ms.Shell:
        mesh = strip(family, length, width, cells)
        x = mesh.vertices[:, 0]
        end, far = x > length - 1e-9, x < 1e-9
        held = [ms.Fix(end, "z"), ms.Symmetry(end, (1, 0, 0))] if level else [ms.Fix(end, "z"), ms.Fix(far, "x")]
        return ms.Shell(mesh, heavy(), supports=[*held, pinned(mesh)])

    shell, rows = shell_of(cells), []
    under = ms.CoarseDiscreteShell(shell, shell_of(coarser(cells)))
    x = shell.mesh.vertices[:, 0]
    end, far = x > length - 1e-9, x < 1e-9
    model, weight, before = ms.DiscreteShell(shell), float(shell.mass.sum()) * GRAVITY, None
    for height in heights:
        free, force, drawn = (LEVEL if level else LIFTED)[height]
        if before is None:
            start = shell.mesh.vertices.copy()
            start[:, 2] = height * np.clip((x - length) / free + 1.0, 0.0, 1.0) ** 2 - height
        else:
            start = before[1] * [1.0, 1.0, height / before[0]]
        given: dict[str, Any] = {
            "gravity": (0, 0, -GRAVITY),
            "contacts": [ms.Contact(ms.Plane((0, 0, 1), -height))],
        }
        first = under.equilibrium(start=start, **given)
        state = model.equilibrium(start=first.positions, **given)
        before = height, state.positions
        pushes = state.contact_forces[:, 2]
        found = (weight - pushes.sum()) / width / FLEXURE
        off = length - lift_off(pushes, state.positions[:, 0] - state.positions[far, 0].mean(), weight / length)
        came = state.positions[far, 0].mean() if level else length - state.positions[end, 0].mean()
        rows.append(
            {
                "mesh": family,
                "cells": cells,
                "end": "level" if level else "free",
                "height": height,
                "converged": state.converged,
                "coarse": first.iterations,
                "iterations": state.iterations,
                "force": found / force - 1.0,
                "drawn": float(came / drawn - 1.0),
                "free": length - x[state.in_contact].max() - free,
                "by forces": off - free,
                "deepest": state.deepest / length,
            }
        )
    return rows


def lift_off(pushes: Array, x: Array, weight: float) -> float:
    """Where a sheet lifts off a table, from contact forces [N] at x [m], of a ``weight`` [N/m] along x from 0.

    What lies is borne evenly, and a line force acts where it ends: it has no moment there, and the forces
    ``sum f (c - x) = weight c^2 / 2``. The row that touches last is up to a cell away.
    """
    whole, moment = float(pushes.sum()), float(pushes @ x)
    return (whole - float(np.sqrt(whole**2 - 2.0 * weight * moment))) / weight


def alone(family: str, cells: int, height: float) -> dict[str, Any]:
    """The part of the sheet that is off the table, clamped where it lifts off: the error without a table.

    Its end is pushed up to the height; cells are as large as those of the whole sheet.
    """
    free, force, drawn = LIFTED[height]
    width, count = 0.4, round(cells * free / 4.0)
    mesh = ms.flat_beam(length=free, width=width, cells=(columns(family, count), cells // 10), family=family)
    x = mesh.vertices[:, 0]
    end = x > free - 1e-9
    jack = ms.Contact(ms.Plane((0, 0, 1), height), sel=end, push_out=1.0)
    model = ms.DiscreteShell(ms.Shell(mesh, heavy(), clamped=x < 1e-9))
    state = model.equilibrium(gravity=(0, 0, -GRAVITY), contacts=[jack])
    found = float(state.contact_forces[:, 2].sum()) / width / FLEXURE
    came = free - float(state.positions[end, 0].mean())
    row = {"mesh": family, "cells": cells, "height": height, "converged": state.converged}
    return row | {"force": found / force - 1.0, "drawn": came / drawn - 1.0}


def coarser(cells: int) -> int:
    """Cells along of the coarse shell whose answer begins."""
    return max(15, cells // 4)


def draped(family: str, name: str, cells: int) -> dict[str, Any]:
    """Half a strip over a cylinder."""
    radius, length, tip_x, tip_z, _ = DRAPED[name]

    def shell_of(cells: int) -> ms.Shell:
        mesh = strip(family, length, 0.1 * length, cells)
        ends = [ms.Symmetry(mesh.vertices[:, 0] < 1e-9, (1, 0, 0)), pinned(mesh)]
        return ms.Shell(mesh, heavy(), supports=ends)

    shell = shell_of(cells)
    given: dict[str, Any] = {
        "gravity": (0, 0, -GRAVITY),
        "contacts": [ms.Contact(ms.Cylinder((0, -9, -radius), (0, 9, -radius), radius))],
    }
    first = ms.CoarseDiscreteShell(shell, shell_of(coarser(cells))).equilibrium(**given)
    state = ms.DiscreteShell(shell).equilibrium(start=first.positions, **given)
    x = shell.mesh.vertices[:, 0]
    tip = state.positions[x > length - 1e-9].mean(axis=0)
    return {
        "mesh": family,
        "case": name,
        "cells": cells,
        "converged": state.converged,
        "coarse": first.iterations,
        "iterations": state.iterations,
        "tip": float(np.hypot(tip[0] - tip_x, tip[2] - tip_z)) / length,
        "weight": float(state.contact_forces[:, 2].sum() / (shell.mass.sum() * GRAVITY)) - 1.0,
        "deepest": state.deepest / length,
        "hanging": hanging(family, name, cells),
    }


def hanging(family: str, name: str, cells: int) -> float:
    """Error of the tip, over the half length, of what hangs off the cylinder, clamped where the elastica lifts off."""
    radius, whole, tip_x, tip_z, degrees = DRAPED[name]
    angle = np.deg2rad(degrees)
    length = whole - radius * angle
    mesh = strip(family, length, 0.1 * whole, round(cells * length / whole))
    x = mesh.vertices[:, 0]
    down = GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)])  # in the axes of its end
    state = ms.DiscreteShell(ms.Shell(mesh, heavy(), clamped=x < 1e-9)).equilibrium(gravity=down)
    along, _, up = state.positions[x > length - 1e-9].mean(axis=0)
    away = radius * np.sin(angle) + along * np.cos(angle) + up * np.sin(angle) - tip_x
    return float(
        np.hypot(away, radius * (np.cos(angle) - 1.0) - along * np.sin(angle) + up * np.cos(angle) - tip_z) / whole
    )


def largest(rows: list[dict[str, Any]], key: str, **of: Any) -> float | None:
    """Largest size of a finding over the rows of some case; None without any."""
    chosen = [row for row in rows if all(row[name] == value for name, value in of.items())]
    sizes: Array = np.abs([row[key] for row in chosen])
    return float(sizes.max()) if chosen else None


def held(findings: dict[str, Any]) -> dict[str, float | None]:
    """What was found of each aim."""
    falls, sliding = findings["falls"], [row for row in findings["slopes"] if row["share"] > 1.2]
    plates = findings["rings"] + findings["bent"]
    rested = findings["lifted"] + findings["draped"] + plates + findings["table"] + findings["motions"]
    return {
        "lifted sheet, force, 40 cells": largest(findings["lifted"], "force", cells=40),
        "lifted sheet, drawn in, 40 cells": largest(findings["lifted"], "drawn", cells=40),
        "lifted sheet, force, 80 cells": largest(findings["lifted"], "force", cells=80),
        "lifted sheet, drawn in, 80 cells": largest(findings["lifted"], "drawn", cells=80),
        "lift-off by forces, 40 cells": largest(findings["lifted"], "by forces", cells=40),
        "lift-off by forces, 80 cells": largest(findings["lifted"], "by forces", cells=80),
        "drape, tip, 60 cells": largest(findings["draped"], "tip", cells=60),
        "ring and bend, force, 80 cells": largest(plates, "force", cells=80),
        "iterations from a coarse answer": max(row["iterations"] for row in findings["lifted"] + findings["draped"]),
        "depth": max([row["deepest"] for row in rested] + [row[f"deepest {n}"] for row in falls for n in KINDS]),
        "energy gained": max(row[f"gained {name}"] for row in falls for name in KINDS),
        "energy gained, six bodies": max(row["gained"] for row in findings["motions"]),
        "sliding strip": max(abs(row["speed"] / row["block"] - 1.0) for row in sliding),
        "RSW on a table": largest(findings["table"], "error", model="RSW"),
    }


def aims_missed(found: dict[str, float | None]) -> list[str]:
    """The aims that were looked at and do not hold."""
    return [name for name, value in found.items() if value is not None and value > HELD[name]]


KINDS = ("smooth", "rough")


def table(result: StudyResult) -> str:
    """Every table in Markdown."""
    found = result.findings
    missed = aims_missed(found["held"])
    aims = [
        {"aim": name, "wanted": HELD[name], "found": value}
        | {"holds": None if value is None else "no" if name in missed else "yes"}
        for name, value in found["held"].items()
    ]
    return paragraphs(
        "Errors are relative to the elastica, tips over the strip's half length, depths over lengths of 1 m.",
        markdown("aim | at most | found | holds", "{aim} | {wanted:.2g} | {found:.2g} | {holds}", aims),
        "A sheet lifted off a table at its end, free to turn or level; discrete shells begin at the answer of a coarse "
        f"mesh of a quarter of the cells, at least {coarser(0)}:",
        markdown(
            "mesh | cells | end | height [l_g] | iterations, coarse | fine | force error [%] | drawn-in error [%] | "
            "free length error [l_g], by the last row | by forces",
            "{mesh} | {cells} | {end} | {height:g} | {coarse} | {iterations} | {force:100*.3f} | {drawn:100*.2f} | "
            "{free:.3f} | {by forces:.5f}",
            found["lifted"],
        ),
        "What is off the table alone, clamped where the elastica lifts off, with cells of the size of 40 along the "
        "whole sheet: the errors of the shell without a table.",
        markdown(
            "mesh | height [l_g] | force error [%] | drawn-in error [%]",
            "{mesh} | {height:g} | {force:100*.3f} | {drawn:100*.2f}",
            found["alone"],
        ),
        "Half a strip over a cylinder, and what hangs off it alone, clamped where the elastica lifts off: the error of "
        "the shell without a cylinder, with which a tip's falls and rises from mesh to mesh:",
        markdown(
            "mesh | radius and half length [l_g] | cells | iterations, coarse | fine | tip error | alone | "
            "force over weight, less 1",
            "{mesh} | {case} | {cells} | {coarse} | {iterations} | {tip:.1e} | {hanging:.1e} | {weight:.1e}",
            found["draped"],
        ),
        "Between plates:",
        markdown(
            "mesh | case | cells | iterations | force error [%]",
            "{mesh} | {case} | {cells} | {iterations} | {force:100*.3f}",
            found["rings"] + found["bent"],
        ),
        "A tilted strip of length 1 m falls on a floor, 100 steps of 1/60 s, without friction and with it:",
        markdown(
            "integrator | thickness [m] | energy gained in a step, over the fall's | with friction | steps not solved",
            "{integrator} | {thickness:g} | {gained smooth:.1e} | {gained rough:.1e} | {unsolved smooth}, "
            "{unsolved rough}",
            found["falls"],
        ),
        "A strip falls on a body, 200 steps of 1/60 s by implicit Euler. Forces on curved bodies are those of a "
        "discrete gradient of the gap, which do no work on what slides:",
        markdown(
            "body | thickness [m] | frames that touch | energy gained in a step, over the fall's | steps not solved",
            "{body} | {thickness:g} | {touching} | {gained:.1e} | {unsolved}",
            found["motions"],
        ),
        f"A strip on a slope after half a second, friction {FRICTION:g}; what sticks creeps:",
        markdown(
            "tan(slope) over friction | speed [m/s] | a block's [m/s]",
            "{share:g} | {speed:.6f} | {block:.6f}",
            found["slopes"],
        ),
        "A free shell strikes a body in steps of 1/120 s, by RSW and by discrete shells (DS), and by these in a "
        "quarter of the step. Modes do not stretch where a ball bends a panel two ways, and it gives way the more:",
        markdown(
            "shell, body | RSW from DS [% of the length] | DS from itself in shorter steps | elastic energy of RSW "
            "over that of DS",
            "{case} | {apart:100*.1f} | {by step:100*.1f} | {stored:.2f}",
            found["strikes"],
        ),
        "A cantilever at rest on a table against discrete shells, and a frame of its motion (processor time):",
        markdown(
            "model | modes | iterations | error [%] | force error [%] | frame, free [ms] | with the table [ms]",
            "{model} | {modes} | {iterations} | {error:100*.2f} | {force:100*.1f} | {free:.2f} | {touching:.2f}",
            found["table"],
        ),
    )


def finding(result: StudyResult) -> str:
    """The result in a sentence or two, and which aims it misses."""
    found = result.findings["held"]
    missed, looked_at = aims_missed(found), sum(one is not None for one in found.values())
    cells = 80 if found["lifted sheet, force, 80 cells"] is not None else 40
    return (
        f"At {cells} cells a lifted sheet's force is within "
        f"{at_most(100 * found[f'lifted sheet, force, {cells} cells'])} % of the elastica's. No vertex is deeper than "
        f"{at_most(found['depth'], 1)} m, no step on a floor gains energy, a strip slides as a block does within "
        f"{at_most(100 * found['sliding strip'], 1)} %. On a table RSW is at most "
        f"{at_most(100 * found['RSW on a table'])} % from discrete shells. Of {looked_at} aims "
        f"{f'{len(missed)} are missed: ' + '; '.join(missed) if missed else 'none is missed'}."
    )
