"""Implicit cloth over its size: seconds a frame and where they go, against a published program.

A square sheet of particles, springs along the edges and across the hinges of its triangles, held along one side, falls
under gravity. A frame of 1/30 s is three steps of implicit Euler, linearised once a step [baraff1998] and solved by ten
iterations of conjugate gradients, as in the published program that this is compared with. Of that program two numbers
are taken: 125 s a frame with 160,000 particles on 4 threads, and up to 95 % of the time for the update of the matrix;
sizes, steps and iterations are its own, its machine and its springs are not known, so its number is a mark, no race.

Ten iterations are a budget, not a solution: the residual that they leave is reported, over the load and momentum of a
step, and how many iterations (and seconds) a residual of 1e-3 takes. The more particles share a sheet, the lighter each
is, and the further ten iterations fall short. A Cholesky factorisation solves the same equations to rounding, on large
sheets in less time than the iterations to 1e-3. An explicit step of the same springs is timed too, times the steps that
its stability asks for in a frame.
"""

from __future__ import annotations

from time import perf_counter, process_time
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.integrators.state import MotionState
from modalshell.springs import TASKS, ImplicitSprings, mesh_springs
from studies.pages import counted, markdown, paragraphs, result_of

FIGURES = ("cloth_scaling",)

SIDES = (50, 100, 150, 300, 350, 400)
"""Particles along a side: the published sizes."""
FRAME, STEPS, ITERATIONS = 1.0 / 30.0, 3, 10
STRUCTURAL, FLEXION, DENSITY, DRAG = 50.0, 5.0, 0.2, 0.5
GRAVITY = (0.0, 0.0, -9.81)
SOLVED, MOST = 1e-3, 20_000
PUBLISHED = {"particles": 160_000, "threads": 4, "frame": 125.0, "matrix_share": 0.95}
"""Particles, threads, seconds a frame, and the matrix update's share of them at most."""
_FALL = 3
"""Frames before the clock starts: the first compile, and the sheet leaves its plane."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All sizes, threads side by side; ``quick`` takes the two smallest and fewer frames."""
    sides, repeats = (SIDES[:2], 3) if quick else (SIDES, 7)
    rows = [measured(side, repeats) for side in counted(sides, on_step)]
    findings = {"rows": rows, "published": PUBLISHED}
    particles = np.array([row["particles"] for row in rows])
    return result_of("cloth_scaling", findings, {"particles": particles}, repeats=repeats)


def cloth(side: int) -> tuple[ms.Shell, Any]:
    """A sheet of 1 m with ``side`` squared particles, held along one side, and its springs."""
    mesh = ms.sheet(cells=(side - 1, side - 1))
    held = mesh.vertices[:, 0] < 1e-9
    return ms.Shell(mesh, ms.Material(0.0, 1.0, 0.0, DENSITY), held), mesh_springs(mesh, STRUCTURAL, FLEXION)


def measured(side: int, repeats: int) -> dict[str, Any]:
    """Times of one size: frames on one thread and on as many as pay take turns; the fastest of each counts."""
    shell, springs = cloth(side)
    steppers = {"one": ImplicitSprings(springs, shell.mass, shell.clamped, threads=1)}
    steppers["free"] = ImplicitSprings(springs, shell.mass, shell.clamped)
    frames: dict[str, list[dict[str, float]]] = {name: [] for name in steppers}
    residual = 0.0
    for stepper in steppers.values():
        stepper.place(shell.rest_positions)
    for repeat in range(_FALL + repeats):
        for name, stepper in steppers.items():
            seconds, residual = frame(stepper)
            if repeat >= _FALL:
                frames[name].append(seconds)
    best = {name: min(found, key=lambda seconds: sum(seconds.values())) for name, found in frames.items()}
    row: dict[str, Any] = {
        "particles": shell.mass.size,
        "springs": len(springs),
        "threads": steppers["free"].threads.most,
    }
    for name, seconds in best.items():
        row[name] = {"frame": sum(seconds.values()), "tasks": seconds}
    row["residual"] = residual
    row["factored"] = factored(shell, springs, steppers["one"])
    row["solved"] = solved(steppers["free"])
    row["explicit"] = explicit(shell, springs)
    return row


def frame(stepper: ImplicitSprings) -> tuple[dict[str, float], float]:
    """Seconds of each task over a frame's steps, and the last residual."""
    seconds = dict.fromkeys(TASKS, 0.0)
    for _ in range(STEPS):
        done = stepper.step(FRAME / STEPS, GRAVITY, drag=DRAG, iterations=ITERATIONS)
        for task, spent in done.seconds.items():
            seconds[task] += float(spent)
    return seconds, done.residual


def solved(stepper: ImplicitSprings) -> dict[str, float]:
    """A step from the same motion, taken to a small residual."""
    begin = perf_counter()
    done = stepper.step(FRAME / STEPS, GRAVITY, drag=DRAG, iterations=MOST, tolerance=SOLVED)
    return {
        "iterations": done.iterations,
        "seconds": perf_counter() - begin,
        "residual": done.residual,
        "converged": done.converged,
    }


def factored(shell: ms.Shell, springs: Any, stepper: ImplicitSprings) -> dict[str, float]:
    """A solved step on one thread, by a factorisation and by iterations from the same motion: CPU seconds."""
    model = ms.SpringSheet(shell, springs, integrator="linear_implicit")
    damping, load = ms.Damping(DRAG), shell.gravity_force(GRAVITY)
    state, seconds = MotionState(stepper.positions, stepper.velocities), []
    for _ in range(2):
        begin = process_time()
        model.step(state, FRAME / STEPS, load, damping)
        seconds.append(process_time() - begin)
    begin = process_time()
    stepper.step(FRAME / STEPS, GRAVITY, drag=DRAG, iterations=MOST, tolerance=SOLVED)
    return {"seconds": seconds[1], "analysis": seconds[0] - seconds[1], "iterations": process_time() - begin}


def explicit(shell: ms.Shell, springs: Any) -> dict[str, float]:
    """An explicit Euler step of the same springs on one thread, and a frame of as many as are stable."""
    model = ms.SpringSheet(shell, springs, integrator="explicit")
    damping, load = ms.Damping(DRAG), shell.gravity_force(GRAVITY)
    dt = model.stable_step(damping)
    state = model.start_motion()
    spent = np.inf
    for _ in range(6):
        begin = perf_counter()
        state, _ = model.step(state, dt, load, damping)
        spent = min(spent, perf_counter() - begin)
    count = int(np.ceil(FRAME / dt))
    return {"stable_step": dt, "step": spent, "steps": count, "frame": count * spent}


def factored_wins(row: dict[str, Any]) -> bool:
    """Whether a factorisation solves a step in no more time than the iterations."""
    return bool(row["factored"]["iterations"] >= row["factored"]["seconds"])


def table(result: StudyResult) -> str:
    """Tables in Markdown: seconds a frame, then the share of each task."""
    published = result.findings["published"]
    mark, rows = f"| {published['particles']:,}, published | ", []
    for row in result.findings["rows"]:
        seconds, solved, factored = row["free"], row["solved"], row["factored"]
        shares = [seconds["tasks"][task] / seconds["frame"] for task in TASKS]
        count = f"{'' if solved['converged'] else 'more than '}{solved['iterations']}"
        choice = "factor" if factored_wins(row) else "cg"
        rows.append({**row, "shares": shares, "count": count, "choice": choice, "once": max(factored["analysis"], 0.0)})
    frames = markdown(
        "particles | springs | one thread [s] | threads at most | [s] | explicit: steps a frame | [s]",
        "{particles:,} | {springs:,} | {one[frame]:.4f} | {threads} | {free[frame]:.4f} | {explicit[steps]} "
        "| {explicit[frame]:.3f}",
        rows,
    )
    tasks = markdown(
        f"particles | {' | '.join(TASKS)} | residual left | iterations to {SOLVED:g} | seconds of that step",
        "{particles:,} | {shares:100*.1f} | {residual:.2g} | {count} | {solved[seconds]:.2f}",
        rows,
    )
    solved = markdown(
        "particles | iterations [s] | factorisation [s] | its analysis, once [s] | to take",
        '{particles:,} | {factored[iterations]:.3f} | {factored[seconds]:.3f} | {once:.2f} | solver="{choice}"',
        rows,
    )
    return paragraphs(
        f"Seconds a frame ({STEPS} steps, {ITERATIONS} iterations each), the fastest of several:",
        f"{frames}\n{mark}| | {published['threads']} | {published['frame']:g} | | |",
        "Share of the tasks [%], and what the linear equations ask for:",
        f"{tasks}\n{mark}| up to {100.0 * published['matrix_share']:g} | | | | | | |",
        f"CPU seconds of one solved step on one thread, iterations to {SOLVED:g} or a factorisation:",
        solved,
    )


def finding(result: StudyResult) -> str:
    """Times of the largest sheet, and what ten iterations leave of its equations."""
    rows, published = result.findings["rows"], result.findings["published"]
    by_factor = [row["particles"] for row in rows if factored_wins(row)]
    choice = f"the factorisation from {by_factor[0]:,} particles on" if by_factor else "the iterations at every size"
    last = rows[-1]
    return (
        f"A frame of {last['particles']:,} particles takes {last['one']['frame']:.2g} s on one thread and "
        f"{last['free']['frame']:.2g} s on {last['threads']}; a published program took {published['frame']:g} s on "
        f"{published['threads']}. Its ten iterations do not solve so large a sheet: they leave a residual of "
        f"{last['residual']:.0f} times the load, and a residual of {SOLVED:g} takes {last['solved']['iterations']} "
        f"iterations and {last['factored']['iterations']:.2g} CPU seconds a step. A factorisation solves it "
        f"to rounding in {last['factored']['seconds']:.2g} CPU seconds. Who wants solved steps takes {choice}."
    )
