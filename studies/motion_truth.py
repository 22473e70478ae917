"""Truth in motion: the damping that was asked for, orders, scenes with known answers, and what each rule costs.

Every rung with every rule of time is asked for a damping ratio and watched for what it shows. Then motions are compared
with known answers: a plate under a sudden pressure with the exact modal answer of its own mesh and with Navier's
series; a strip that is held at both ends with frequencies at large amplitudes [woinowsky1950]; LMA with the exponential
of its matrix. Others are compared with fine steps: the V-beam through its snap, supports that spin up and shake. Free
panels keep, or do not keep, their centre and momenta, and six stiff scenes their energy. Work is counted, and given in
seconds of a reference machine. Motions of other engines are not compared.
"""

from __future__ import annotations

from typing import Any

from modalshell.compare.report import percent
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.motion_damping import THIN, damping_findings
from studies.motion_limits import limit_findings
from studies.motion_rungs import DEFAULTS, REFERENCE
from studies.motion_scenes import scene_findings
from studies.pages import markdown, paragraphs, result_of

FIGURES = ("motion_truth",)

HELD = {
    "damping, modal rungs, from 3 steps a period on": 1e-3,
    "damping, DS, from 20 on": 1e-2,
    "damping, rungs of bdf2, from 75 on": 1e-2,
    "order less two": 0.2,
    "LMA, load of straight pieces": 1e-12,
    "plate, DS, 20 steps a period": 4e-2,
    "plate, DS, 100 steps a period": 6e-3,
    "snap, DS, 1/30 s": 1.5e-2,
    "snap, coarse DS, 1/30 s": 4e-2,
    "centre of a free panel": 1e-6,
    "angular momentum of a bent panel that is let go": 1e-6,
    "energy that a stiff swing loses, DS, 120 steps a second": 1e-3,
    "energy of stiff scenes": 1.0,
    "iterations over implicit Euler's": 2.0,
}
"""What is aimed at."""
NAMES = {"composite": "the composite rule", "bdf2": "BDF2", "sdirk2": "SDIRK2", "implicit_euler": "implicit Euler"}
ROUNDING = 1e-9
"""Share by which an energy may exceed its bound."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All parts; ``quick`` takes one energy, fewer steps and coarser references."""
    findings = {
        **damping_findings(quick, on_step),
        **scene_findings(quick, on_step),
        **limit_findings(quick, on_step),
    }
    findings["held"] = held(findings)
    return result_of("motion_truth", findings, quick=quick)


def off(row: dict[str, Any], fewest: int) -> float:
    """Largest error of the damping ratio, relative, from ``fewest`` steps a period on."""
    pairs = zip(row["steps"], row["obtained"], strict=True)
    return max(abs(found / row["asked"] - 1.0) for count, found in pairs if count >= fewest)


def held(found: dict[str, Any]) -> list[dict[str, Any]]:
    """The worst of each kind against what is aimed at."""
    damping, free = found["damping"], found["free"]
    plate = {row["steps"]: row["error"] for row in found["plate"] if row["rule"] == DEFAULTS[REFERENCE]}
    snap = {(row["rung"], row["rule"]): row["error"] for row in found["snap"] if row["divisions"] == 1}
    swing = {row["rule"]: row["lost"] for row in found["swing"] if row["steps"] == 120}
    stiff = [row for row in found["stiff"] if row["rule"] != "implicit_euler"]
    worst = [
        max(off(row, 3) for row in damping if row["rule"] == "exponential"),
        max(off(row, 20) for row in damping if (row["rung"], row["rule"]) == (REFERENCE, DEFAULTS[REFERENCE])),
        max(off(row, 75) for row in damping if row["rule"] == "bdf2" and DEFAULTS[row["rung"]] == "bdf2"),
        max(abs(row["order"] - 2.0) for row in found["orders"] if row["energy"] != THIN),
        max(row["error"] for row in found["linear"]),
        plate[20],
        plate.get(100),
        snap[REFERENCE, DEFAULTS[REFERENCE]],
        snap["coarse DS", "bdf2"],
        max(row["wander"] for row in free),
        max(row["angular_momentum"] for row in free if row["scene"] == free[0]["scene"]),
        swing[DEFAULTS[REFERENCE]],
        max(row["energy"] for row in stiff),
        max(row["over_euler"] for row in stiff),
    ]
    rows = []
    for (what, aim), value in zip(HELD.items(), worst, strict=True):
        kept = "not run" if value is None else "yes" if value <= aim * (1.0 + ROUNDING) else "no"
        rows.append({"what": what, "aim": aim, "value": value, "kept": kept})
    return rows


def damping_table(found: dict[str, Any]) -> str:
    """Ratios obtained where 0.03 was asked, and the largest error of all ratios at 20 and 75 steps a period."""
    wanted = (10, 20, 75, 400)
    rows = []
    for row in found["damping"]:
        if row["asked"] != 0.03:
            continue
        at = dict(zip(row["steps"], row["obtained"], strict=True))
        same = [other for other in found["damping"] if all(other[k] == row[k] for k in ("energy", "rung", "rule"))]
        worst = [max(off(other, count) for other in same) for count in (20, 75)]
        rows.append({**row, "at": [at.get(count) for count in wanted], "worst": worst})
    return markdown(
        "energy | rung | rule | obtained, 0.03 asked: 10 steps a period | 20 | 75 | 400 "
        "| largest error of 0.01, 0.03, 0.1 [%]: from 20 | from 75",
        "{energy} | {rung} | {rule} | {at:.5f} | {worst:100*.3f}",
        rows,
    )


def cost_sentence(found: dict[str, Any]) -> str:
    """What a rule costs and gives, for who passes by."""
    own = [row for row in found["cost"] if row["rung"] == "DS" and row["error"] <= 0.05]
    first: dict[str, dict[str, Any]] = {}
    for row in sorted(own, key=lambda row: row["cost"]):
        first.setdefault(row["rule"], row)
    told = [
        f"{NAMES[rule]} at {row['steps']} steps a period ({1e3 * row['cost']:.0f} ms)" for rule, row in first.items()
    ]
    missed = [name for rule, name in NAMES.items() if rule not in first]
    most = max(row["steps"] for row in found["cost"])
    beyond = f"; {' and '.join(missed)} not with {most}" if missed else ""
    return (
        "A rule of order two costs one or two solutions a step, and its errors fall with the square of the step: to "
        f"follow a falling strip within 5 % of its length DS needs {', '.join(told)} of counted work a period{beyond}."
    )


def table(result: StudyResult) -> str:
    """What holds, and every part, as Markdown tables."""
    found = result.findings
    stiff = (
        "scene | rule | largest energy [start] | energy left | iterations a solution | over implicit Euler's | status"
    )
    rows = [{**row, "divided": f"1/{30 * row['divisions']}"} for row in found["snap"]]
    return paragraphs(
        cost_sentence(found),
        markdown(
            "what is to hold | at most | here | holds", "{what} | {aim:.3g} | {value:.3g} | {kept}", found["held"]
        ),
        "Damping ratios, from the decay of the first mode:",
        damping_table(found),
        "Order, from a falling strip (Γ 5) whose step is halved twice, and the largest "
        "change of a coordinate [L]. A thin strip is so stiff in its plane that its order shows at smaller steps only:",
        markdown(
            "energy | rung | rule | order | first change | second",
            "{energy} | {rung} | {rule} | {order:.2f} | {changes:.1e}",
            found["orders"],
        ),
        "LMA under a load of straight pieces, one step each, against the exponential of its matrix:",
        markdown("energy | steps a period | error", "{energy} | {steps:g} | {error:.0e}", found["linear"]),
        "Plate under a sudden pressure, 3 periods, largest error [largest deflection]:",
        markdown(
            "rule | steps a period | against the same mesh's exact answer | against the series",
            "{rule} | {steps} | {error:100*.2f} % | {against_series:100*.1f} %",
            found["plate"],
        ),
        "V-beam through its snap, tip in the first second [L]:",
        markdown("rung | rule | step [s] | error", "{rung} | {rule} | {divided} | {error:100*.2f} %", rows),
        "Strip held at both ends, frequency over that of small motion:",
        markdown(
            "energy | rule | amplitude [radius of gyration] | found | exact | off",
            "{energy} | {rule} | {amplitude:g} | {ratio:.4f} | {exact:.4f} | {error:100*.2f} %",
            found["strip"],
        ),
        "A stiff panel falls from level about its supported edge for a second. Energy that steps take, over what its "
        "weight puts in, and the largest error [length] against 32 times the steps of BDF2:",
        markdown(
            "rule | steps a second | energy taken | error | estimated by `step_error`",
            "{rule} | {steps} | {lost:100*.2g} % | {error:100*.2g} % | {estimate:100*.2g} %",
            found["swing"],
        ),
        "Supports that move, 30 steps a second, largest error in their frame [largest displacement there]:",
        markdown(
            "scene | rung | rule | against fine DS | against the rung itself at fine steps",
            "{scene} | {rung} | {rule} | {error:100*.2f} % | {own:100*.2f} %",
            found["led"],
        ),
        "Free panels, largest values; the centre over the fall or the panel's size, momenta over sums of sizes:",
        markdown(
            "scene | rung | centre | momentum | angular momentum | energy left | largest energy",
            "{scene} | {rung} | {wander:.1e} | {momentum:.1e} | {angular_momentum:.1e} | {energy_left:.3f|-} "
            "| {largest_energy:.3f|-}",
            found["free"],
        ),
        "Stiff scenes; energies over the start's, of strips over the work of their weight, plus 1:",
        markdown(
            stiff,
            "{scene} | {rule} | {energy:.4f} | {left:.3f} | {iterations:.2f} | {over_euler:.2f} | {status}",
            found["stiff"],
        ),
    )


def finding(result: StudyResult) -> str:
    """What the rules give, and what does not hold."""
    rows = result.findings["held"]
    missed = [f"{row['what']} ({row['value']:.2g}, aim {row['aim']:g})" for row in rows if row["kept"] == "no"]
    asked = [row for row in result.findings["damping"] if row["rung"] == "DS" and row["asked"] == 0.03]
    at = {row["rule"]: dict(zip(row["steps"], row["obtained"], strict=True))[20] for row in asked}
    plate = {row["rule"]: percent(row["error"], ".2g") for row in result.findings["plate"] if row["steps"] == 20}
    lost = {row["rule"]: percent(row["lost"], ".2g") for row in result.findings["swing"] if row["steps"] == 120}
    words = f"these are missed: {'; '.join(missed)}" if missed else "none is missed"
    return (
        f"Asked for a damping ratio of 0.03, DS shows {at['composite']:.4f} by its rule, {at['bdf2']:.4f} by BDF2 and "
        f"{at['implicit_euler']:.3f} by implicit Euler at 20 steps a period; a plate under a sudden pressure is "
        f"{plate['composite']}, {plate['bdf2']} and {plate['implicit_euler']} off. A stiff panel that swings about its "
        f"edge for a second loses {lost['composite']} of its energy, by SDIRK2 {lost['sdirk2']}. "
        f"Of {len(rows)} aims {words}."
    )
