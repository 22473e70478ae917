"""What coordinates along a snap's path buy: statics of one load family, against the models that follow a snap.

The stiff V-beam of ``v_beam_accuracy``. :mod:`path_coordinates` makes a chart of it: points of the path of equilibria
under gravity downwards, modes across the path, and the path's answers to gravity forwards and aside, to a force on the
end and to one on a corner. It then has the stable equilibria of a load as minima of one function of one variable. The
quadratic energy across the path is wrong where the twist that ends the straight branch is soft; so there are also four
charts, of gravities tilted aside, of whose states the least moved answers, alone or as the start of DS. Here they meet
the other models on the same loads, each asked from rest:

* a family like that of its making: gravity within 20 degrees of downwards, 15 to 75 m/s^2, half of the loads with a
  force on the end, a third with one on the corner;
* loads of another kind: gravity within 60 degrees, and a force on a vertex that was never loaded.

The error is that against DS, over the displacement. A model that gives no answer counts with 100 %, one on the other
side of a snap with the distance. From a near state, in place of rest, every iterative model is quicker. The time to
answer is that of the preparation and of 20,000 queries.

Run it alone with ``modalshell reproduce --only path_chart``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult, Table
from modalshell.models.coarse.coarse_shell import drawn_to_supports
from studies.pages import number
from studies.path_coordinates import Atlas, PathChart, make_chart
from studies.progress import counted
from studies.snap import v_beam

FIGURES = ("path_chart",)

SEED = 10
LOADS = 32
QUERIES = 20_000
UNTIL, BACK = 160.0, -15.0
"""Gravity [m/s^2] at the ends of the chart's path."""
TILTS = (-15.0, -5.0, 5.0, 15.0)
"""Turns aside [degrees] of the gravities whose paths the four charts follow."""
FOUR = f"{len(TILTS)} charts"
FAMILY, OTHERS = "family", "other loads"
SWEEP = (30.0, 36.0, 38.0, 40.0, 42.0, 44.0, 46.0, 50.0)
"""Gravities [m/s^2] at which all stable states are looked for."""
CLOSE = 0.05
"""Error up to which a query counts as answered."""

Answer = Callable[[np.ndarray], np.ndarray | None]


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """Make all models, and ask them; ``quick`` takes a coarser mesh and fewer loads."""
    cells, small, count = ((20, 4), (10, 2), 4) if quick else ((40, 8), (20, 4), LOADS)
    shell = v_beam(150.0, cells)
    models, chart, prepared = made(shell, small, quick)
    loads = {FAMILY: family(shell, count), OTHERS: other_loads(shell, count // 2)}
    tasks = [(kind, load) for kind, drawn in loads.items() for load in drawn]
    named = named_loads(shell)
    exact = ms.DiscreteShell(shell)
    rows: dict[str, list[dict[str, Any]]] = {FAMILY: [], OTHERS: []}
    for kind, load in counted(tasks, on_step):
        rows[kind].append(asked(shell, exact, models, load))
    by_name = [{"load": name, "errors": asked(shell, exact, models, load)["errors"]} for name, load in named.items()]
    summary = [summed(name, prepared.get(name, 0.0), rows) for name in (*models, "DS")]
    for where in ("ms", "minutes"):
        for row in summary:
            row[f"front_{where}"] = on_front(row, summary, where)
    found = {
        "rows": summary,
        "named": by_name,
        "states": [both_sides(shell, exact, chart, gravity) for gravity in SWEEP],
        "cells": "{}x{}".format(*cells),
        "coarse": "{}x{}".format(*small),
        "points": len(chart.knots),
        "loads": {kind: len(drawn) for kind, drawn in loads.items()},
    }
    errors = {
        f"{kind}: {name}": np.array([row["errors"][name] for row in rows[kind]]) for kind in rows for name in models
    }
    return StudyResult("path_chart", found, errors, run_record({"quick": quick, "until": UNTIL}, SEED))


def made(shell: ms.Shell, small: tuple[int, int], quick: bool) -> tuple[dict[str, Answer], PathChart, dict[str, float]]:
    """Every model's answer to a load, the one chart, and the seconds that each took to prepare."""
    answers: dict[str, Answer] = {}
    seconds: dict[str, float] = {}

    def timed(name: str, make: Callable[[], Any]) -> Any:
        began = time.perf_counter()
        found = make()
        seconds[name] = time.perf_counter() - began
        return found

    down, *others = trained_loads(shell)
    sideways = [np.copysign(np.pi / 2, tilt) for tilt in TILTS]
    pulls = [tilted(shell, 1.0, np.radians(abs(tilt)), side) for tilt, side in zip(TILTS, sideways, strict=True)]
    one = timed("1 chart", lambda: Atlas([make_chart(shell, down, UNTIL, BACK, others)]))
    four = timed(FOUR, lambda: Atlas([make_chart(shell, pull, UNTIL, BACK, [down, *others]) for pull in pulls]))
    seconds[f"{FOUR}, then DS"] = seconds[FOUR]
    exact = ms.DiscreteShell(shell)

    def first(atlas: Atlas) -> Answer:
        return lambda load: next(iter(atlas.states(load)), None)

    def polished(load: np.ndarray) -> np.ndarray:
        return exact.equilibrium(force=load, start=first(four)(load)).positions

    answers |= {"1 chart": first(one), FOUR: first(four), f"{FOUR}, then DS": polished}
    coarse = ms.coarse_shell(shell, drawn_to_supports(shell, v_beam(150.0, small).mesh))
    motions = 12 if quick else 40
    known = ms.models()
    models = {
        known["hybrid"].name: lambda: ms.HybridStress.trained(
            shell, gravity=(0, 0, -70.0), coarse=coarse, motions=motions
        ),
        known["coarse-ds"].name: lambda: ms.CoarseDiscreteShell(
            shell, ms.coarse_shell(shell, drawn_to_supports(shell, v_beam(150.0, small).mesh))
        ),
        "MD-ROM 8": lambda: ms.ModalDerivatives(shell, 8),
        "RSW 8": lambda: ms.RotationStrain(ms.solve_modes(shell, 8)),
    }
    for name, make in models.items():
        model = timed(name, make)

        def of_model(load: np.ndarray, model: ms.Model = model) -> np.ndarray | None:
            answer = model.equilibrium(force=load)
            return answer.positions if answer.converged else None

        answers[name] = of_model
    for answer in answers.values():
        answer(0.3 * down)  # compiled and loaded
    return answers, one.charts[0], seconds


def trained_loads(shell: ms.Shell) -> list[np.ndarray]:
    """Loads (n, 3) [N] of the chart: gravity of 1 m/s^2 down, aside and forwards; 1 N on the end and on its corner."""
    gravities = [np.array(shell.gravity_force(g)) for g in ((0, 0, -1.0), (0, 1.0, 0), (1.0, 0, 0))]
    return [*gravities, *end_forces(shell)]


def end_forces(shell: ms.Shell) -> list[np.ndarray]:
    """A force of 1 N down, on the end and on its corner (n, 3) [N]."""
    x = np.array(shell.rest_positions)
    end = np.flatnonzero(x[:, 0] > x[:, 0].max() - 1e-9)
    spread, corner = np.zeros_like(x), np.zeros_like(x)
    spread[end, 2] = -1.0 / len(end)
    corner[end[np.argmax(x[end, 1])], 2] = -1.0
    return [spread, corner]


def tilted(shell: ms.Shell, size: float, turn: float, towards: float) -> np.ndarray:
    """Gravity (n, 3) [N] of ``size`` [m/s^2], by ``turn`` [rad] off downwards, ``towards`` [rad] in the plane."""
    flat = np.sin(turn) * np.array([np.cos(towards), np.sin(towards)])
    return np.array(shell.gravity_force((size * flat[0], size * flat[1], -size * np.cos(turn))))


def named_loads(shell: ms.Shell) -> dict[str, np.ndarray]:
    """Loads (n, 3) [N] with names, before the snap and after."""
    spread, corner = end_forces(shell)
    side, turn = np.pi / 2, np.radians
    found = {f"down, {g:g} m/s²": tilted(shell, g, 0.0, 0.0) for g in (30.0, 55.0, 70.0)}
    for name, angle, towards in (("15° aside", 15.0, side), ("20° forwards", 20.0, 0.0), ("20° back", 20.0, np.pi)):
        found |= {f"{name}, {g:g} m/s²": tilted(shell, g, turn(angle), towards) for g in (30.0, 55.0, 70.0)}
    found |= {f"end, {force:g} N": force * spread for force in (0.4, 0.8, 1.2)}
    return found | {f"corner, {force:g} N": force * corner for force in (0.1, 0.3)}


def family(shell: ms.Shell, count: int) -> list[np.ndarray]:
    """Loads (n, 3) [N] of the kinds that the chart is made with, drawn by the seed."""
    rng, found = np.random.default_rng(SEED), []
    spread, corner = end_forces(shell)
    for place in range(count):
        turn = np.radians(20.0) * np.sqrt(rng.random())
        load = tilted(shell, rng.uniform(15.0, 75.0), turn, rng.uniform(0.0, 2.0 * np.pi))
        load += (place % 2 == 0) * rng.uniform(0.0, 0.4) * spread + (place % 3 == 0) * rng.uniform(0.0, 0.15) * corner
        found.append(load)
    return found


def other_loads(shell: ms.Shell, count: int) -> list[np.ndarray]:
    """Loads (n, 3) [N] of another kind: gravity far aside, and a force on one vertex."""
    rng, found = np.random.default_rng(SEED + 1), []
    for _ in range(count):
        turn = np.radians(60.0) * np.sqrt(rng.random())
        load = tilted(shell, rng.uniform(15.0, 75.0), turn, rng.uniform(0.0, 2.0 * np.pi))
        direction = rng.standard_normal(3)
        load[rng.choice(shell.free)] += 0.1 * direction / np.linalg.norm(direction)
        found.append(load)
    return found


def asked(shell: ms.Shell, exact: ms.DiscreteShell, models: dict[str, Answer], load: np.ndarray) -> dict[str, Any]:
    """Errors of every model under a load, and the milliseconds that each took."""
    began = time.perf_counter()
    truth = exact.equilibrium(force=load)
    taken = {"DS": 1000.0 * (time.perf_counter() - began)}
    errors = {}
    for name, answer in models.items():
        began = time.perf_counter()
        positions = answer(load)
        taken[name] = 1000.0 * (time.perf_counter() - began)
        errors[name] = 1.0
        if positions is not None:
            errors[name] = ms.measure.displacement_error(positions, truth.positions, shell)
    return {"errors": errors, "ms": taken, "known": truth.converged and truth.stable is not False}


def summed(name: str, seconds: float, rows: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """What a model costs, and its errors on either kind of load where DS has a stable answer."""
    took = float(np.median([row["ms"][name] for row in rows[FAMILY]]))
    mean = float(np.mean([row["ms"][name] for row in rows[FAMILY]]))
    found: dict[str, Any] = {"model": name, "seconds": seconds, "ms": took, "mean_ms": mean}
    found["minutes"] = (seconds + QUERIES * mean / 1000.0) / 60.0
    for kind, asked_rows in rows.items():
        errors = np.array([0.0 if name == "DS" else row["errors"][name] for row in asked_rows if row["known"]])
        found[kind] = [float(np.quantile(errors, share)) for share in (0.5, 0.9, 1.0)]
        found[f"{kind}, close"] = float(np.mean(errors <= CLOSE))
    return found


def on_front(row: dict[str, Any], rows: list[dict[str, Any]], cost: str) -> bool:
    """Whether no other model is at most as dear and as far off, at the 90th percentile of the family."""
    place = np.array([row[cost], row[FAMILY][1]])
    others = [np.array([other[cost], other[FAMILY][1]]) for other in rows if other is not row]
    return not any((other <= place).all() and (other < place).any() for other in others)


def both_sides(shell: ms.Shell, exact: ms.DiscreteShell, chart: PathChart, gravity: float) -> dict[str, Any]:
    """The stable states of the chart under gravity, and how far DS goes from them until it rests."""
    load = tilted(shell, gravity, 0.0, 0.0)
    places, errors, stable = [], [], []
    for state in chart.states(load):
        positions = chart.positions(state)
        answer = exact.equilibrium(force=load, start=positions)
        places.append(state.q)
        errors.append(ms.measure.displacement_error(positions, answer.positions, shell))
        stable.append(bool(answer.stable))
    return {"gravity": gravity, "places": places, "errors": errors, "stable": stable}


def table(result: StudyResult) -> str:
    """Cost and errors of every model, the named loads, and the states on both sides of the snap."""
    found = result.findings
    loads = found["loads"]
    lines = [
        f"{found['cells']} cells, {found['coarse']} of the coarse shell, which also trains the hybrid; "
        f"{loads[FAMILY]} loads of the family, {loads[OTHERS]} others; {found['points']} points of the path.",
        "",
        "| model | preparation, s | ms a query | family: median | 90 % | largest | within 5 % "
        "| other loads: median | 90 % | within 5 % | 20,000 queries, min | on the front of ms | of minutes |",
        "|" + "---|" * 13,
    ]
    for row in found["rows"]:
        half, most, worst = (f"{100 * value:.2f} %" for value in row[FAMILY])
        other_half, other_most, _ = (f"{100 * value:.2f} %" for value in row[OTHERS])
        close, other_close = (f"{100 * row[f'{kind}, close']:.0f} %" for kind in (FAMILY, OTHERS))
        fronts = " | ".join("yes" if row[f"front_{where}"] else "no" for where in ("ms", "minutes"))
        lines.append(
            f"| {row['model']} | {row['seconds']:.3g} | {row['ms']:.3g} | {half} | {most} | {worst} | {close} "
            f"| {other_half} | {other_most} | {other_close} | {row['minutes']:.3g} | {fronts} |"
        )
    names = list(found["named"][0]["errors"])
    lines += ["", "| load | " + " | ".join(names) + " |", "|" + "---|" * (1 + len(names))]
    for row in found["named"]:
        lines.append(f"| {row['load']} | " + " | ".join(f"{100 * row['errors'][name]:.2f} %" for name in names) + " |")
    lines += ["", "| gravity, m/s² | stable states of the chart, at a mean drop of | DS from there | stable |"]
    lines.append("|" + "---|" * 4)
    for row in found["states"]:
        places = ", ".join(f"{1000 * q:.1f} mm" for q in row["places"]) or "–"
        errors = ", ".join(f"{100 * value:.2f} %" for value in row["errors"]) or "–"
        stable = ", ".join("yes" if value else "no" for value in row["stable"]) or "–"
        lines.append(f"| {row['gravity']:g} | {places} | {errors} | {stable} |")
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """Where the chart stands on both fronts, and where its loads end."""
    rows, _, states = tables
    chart = next(row for row in rows if row["model"] == FOUR)
    polished, exact = (next(row for row in rows if row["model"] == name) for name in (f"{FOUR}, then DS", "DS"))
    best = min((row for row in rows if "chart" not in row["model"] and row["model"] != "DS"),
               key=lambda row: number(row["90 %"]))  # fmt: skip
    two = [row["gravity, m/s²"] for row in states if row["stable"].count("yes") == 2]
    front = "They are" if "yes" in (chart["on the front of ms"], chart["of minutes"]) else "They are not"
    return (
        f"For static loads of the family that they are made with, {FOUR} are within {number(chart['90 %']):.2g} % of "
        f"DS nine times of ten at {number(chart['ms a query']):.2g} ms a query, {best['model']} within "
        f"{number(best['90 %']):.2g} % at {number(best['ms a query']):.0f} ms. {front} on the front, and 20,000 "
        f"queries with their preparation take {number(chart['20,000 queries, min']):.2g} min. Loads of another kind "
        f"are {number(chart['90 % (2)']):.2g} % off at the same percentile. As a start they take DS to an "
        f"answer in {number(polished['ms a query']):.2g} ms in place of {number(exact['ms a query']):,.0f}; "
        f"{number(polished['within 5 %']):.0f} % of the loads end in the same state. One chart finds both stable "
        "states " + (f"at gravities of {two[0]} to {two[-1]} m/s²." if two else "nowhere.")
    )
