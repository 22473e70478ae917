"""Do error bars tell the truth? Shells drawn by a seed, on which nothing was developed: each bar against DS.

Folds, panels, leaves, plates, strips and tubes of both energies, held and loaded at random, at three loads each. RSW
and MWTS answer, each answer gets its bar, and DS is solved from rest. Next to the bar stand estimators that suggest
themselves and fail: the same two steps without the margin; one step; the residual solved with the stiffness at rest;
the next rung below; more modes.

On other shells, drawn by a seed of their own, the path of equilibria tells where it turns unstable; from RSW's answer
at half of that load its bar foretells it, by its margin alone and by a walk along the branch.
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import modalshell as ms
from modalshell.core.timings import Timings
from modalshell.core.typing import Array, Progress
from modalshell.files.study_result import StudyResult
from modalshell.modes import Factoriser, model_basis
from modalshell.shell import GAUSS_NEWTON
from modalshell.statics.error_bar import LARGEST_BAR
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.potential import Potential
from studies.pages import counted, markdown, paragraphs, result_of

FIGURES = ("blind_bars",)

SEED = 20
SHELLS, QUICK = 200, 8
MODES, MORE_MODES = 8, 24
LOADS = 3
SMALLEST, LARGEST = 0.005, 0.6
"""Displacement of the linear answers, over the shell's size."""
FAR, NEAR, MISSED = 0.25, 0.05, 0.15
"""Errors of another branch, of a good answer, and readings below which another branch is missed."""
KINDS = ("fold", "panel", "arch", "leaf", "plate", "strip", "tube")
ESTIMATORS = {
    "bar": "two mixed steps and the margin",
    "two steps": "two mixed steps alone",
    "one step": "one step",
    "stiffness at rest": "residual by the stiffness at rest",
    "rung below": "MWTS against RSW",
    "more modes": "8 against 24 modes",
}
SNAP_SEED, SNAP_DRAWS, QUICK_DRAWS = 21, 60, 3
WAY = 0.5
"""Share of the snap's load at which it is foretold."""
PATH_STEPS, PATH_POINTS = 20, 100


class Drawn(NamedTuple):
    """A shell with its load."""

    shell: ms.Shell
    loads: list[ms.Pressure] | None
    force: Array
    text: str


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Draw the shells and judge all answers; ``quick`` takes few."""
    rows: list[dict[str, Any]] = []
    for place, _ in counted(list(enumerate(range(QUICK if quick else SHELLS))), on_step):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ms.ModalShellWarning)  # of coarse meshes: DS has the same
            rows += of_shell(place)
    bars = [row for row in rows if row["model"] == "RSW"]
    findings = {"rows": rows, "bars": judged(rows), "estimators": [compared(bars, name) for name in ESTIMATORS]}
    draws = QUICK_DRAWS if quick else SNAP_DRAWS
    findings["snaps"] = forecasts(draws)
    return result_of("blind_bars", findings, {}, SEED, shells=QUICK if quick else SHELLS, draws=draws)


def of_shell(place: int) -> list[dict[str, Any]]:
    """Answers at all loads of one shell."""
    rng = np.random.default_rng([SEED, place])
    drawn = drawn_shell(rng, KINDS[place % len(KINDS)], hinges=bool(place // len(KINDS) % 2))
    shell = drawn.shell
    many = model_basis(shell, min(MORE_MODES, shell.unknowns.count))
    few = model_basis(shell, min(MODES, shell.unknowns.count))
    rungs, more = (
        {model.name: model for model in (ms.RotationStrain(few), ms.ModalWarping(few))},
        ms.RotationStrain(many),
    )
    unit = ms.LinearModal(many).equilibrium(**load_of(drawn, 1.0)).positions - shell.rest_positions
    size = float(np.linalg.norm(unit, axis=1).max()) / shell.size
    shares = np.sort(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST), LOADS)))
    rows, truth = [], ms.DiscreteShell(shell)
    for share in shares:
        load = load_of(drawn, share / size)
        exact = truth.equilibrium(**load)
        answers = {name: model.equilibrium(**load) for name, model in rungs.items()}
        if not exact.converged or not answers["RSW"].converged:
            continue
        finer = more.equilibrium(**load).positions
        for name, answer in answers.items():
            bar = ms.error_bar(shell, answer)
            row = {
                "shell": place,
                "text": drawn.text,
                "model": name,
                "share": share,
                "true": ms.measure.displacement_error(answer.positions, exact.positions, shell),
                "bar": min(bar.displacement, 1e3),
                "margin": max(bar.margin, -1e3),
                "valid": bar.valid,
                "seconds": [bar.seconds, exact.seconds],
            }
            rows.append(row | (others(shell, answers, finer, bar) if name == "RSW" else {}))
    return rows


def load_of(drawn: Drawn, factor: float) -> dict[str, Any]:
    """The load of a shell times a factor."""
    loads = None if drawn.loads is None else [ms.Scaled(load, lambda _: factor) for load in drawn.loads]
    return {"force": factor * drawn.force, "loads": loads}


def drawn_shell(rng: np.random.Generator, kind: str, *, hinges: bool) -> Drawn:
    """A shell of a kind, and its load of no particular size."""
    mesh, held, how = drawn_mesh(rng, kind)
    thickness = mesh.size / 10.0 ** rng.uniform(2.0, 2.7)
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=thickness, density=200.0)
    if hinges:
        material: Any = ms.Material.from_physical(young=1e8, poisson=0.3, thickness=thickness, density=200.0, mesh=mesh)
    else:
        material = sheet
    shell = ms.Shell(mesh, material, supports=[ms.Clamp(held) if how == "Clamp" or hinges else ms.Pin(held)])
    direction = rng.standard_normal(3) + np.array([0.0, 0.0, -1.5])
    direction /= np.linalg.norm(direction)
    choice = rng.choice(["weight", "weight", "force", "pressure"])
    force = np.zeros_like(shell.rest_positions)
    loads: list[ms.Pressure] | None = None
    if choice == "weight":
        force = np.array(shell.gravity_force(direction))
    elif choice == "pressure":
        loads = [ms.Pressure(float(rng.choice([-1.0, 1.0])))]
    else:
        free = np.flatnonzero(~shell.clamped)
        far = mesh.vertices[free] @ rng.standard_normal(3)
        force[free[far > np.quantile(far, 0.95)]] = direction
    energy = "hinges" if hinges else "shell theory"
    text = f"{kind}, {how}, {len(mesh.vertices)} vertices, h/L 1/{mesh.size / thickness:.0f}, {energy}, {choice}"
    return Drawn(shell, loads, force, text)


def drawn_mesh(rng: np.random.Generator, kind: str) -> tuple[ms.TriangleMesh, NDArray[np.bool_], str]:
    """A mesh of a kind, its held vertices, and the name of their support."""
    width, along = float(rng.uniform(0.15, 0.5)), int(rng.integers(14, 25))
    cells = (along, 2 * int(rng.integers(2, 4)))
    if kind == "fold":
        mesh = ms.v_beam(length=1.0, width=width, fold=float(rng.uniform(100.0, 172.0)), cells=cells)
    elif kind in ("panel", "arch", "tube"):
        angle = {"panel": (25.0, 120.0), "arch": (25.0, 80.0), "tube": (200.0, 300.0)}[kind]
        around = (8, 16) if kind == "arch" else (14, 10)
        span = float(rng.uniform(*angle))
        mesh = ms.cylinder_panel(length=1.0, radius=0.5 if kind != "tube" else 0.15, angle=span, cells=around)
    elif kind == "leaf":
        mesh = ms.leaf(length=1.0, width=max(width, 0.25), cells=cells)
    else:
        mesh = ms.flat_beam(length=1.0, width=width if kind == "strip" else 0.8, cells=cells)
    x, y = mesh.vertices[:, 0], np.abs(mesh.vertices[:, 1])
    row = 1.5 * float(np.ptp(x)) / (cells[0] if kind not in ("panel", "tube", "arch") else 14)
    end = x < x.min() + row
    if kind == "arch":
        return mesh, y > y.max() - 1e-9, str(rng.choice(["Clamp", "Pin"]))
    if kind == "plate":
        both = rng.random() < 0.5
        return mesh, (end | (x > x.max() - row)) if both else end & (mesh.vertices[:, 1] > 0.0), "Clamp"
    return mesh, end, "Clamp"


def others(shell: ms.Shell, answers: dict[str, ms.Equilibrium], finer: Array, bar: ms.ErrorBar) -> dict[str, float]:
    """What the estimators read that fail; ``finer`` (n, 3) [m] is the answer with more modes."""
    x, loading = answers["RSW"].positions, answers["RSW"].loading
    assert loading is not None
    live = LiveLoads(loading) if loading.live else None
    problem = Potential(loading.dead, shell.rest_positions, shell, Factoriser(), Timings(), live)
    gradient, first = problem.linearise(x, GAUSS_NEWTON)
    stepped = problem.moved(x, problem.step(problem.factor(first), gradient))[0]
    rest = problem.linearise(shell.rest_positions, GAUSS_NEWTON)[1]
    linear = shell.unknowns.prolong(problem.step(problem.factor(rest), gradient)).reshape(-1, 3)
    readings = {
        "two steps": bar.displacement,
        "one step": apart(shell, x, stepped),
        "stiffness at rest": apart(shell, x, x + linear),
        "rung below": apart(shell, answers["MWTS"].positions, x),
        "more modes": apart(shell, x, finer),
    }
    return {name: float(min(value, 1e3)) for name, value in readings.items()}


def apart(shell: ms.Shell, x: Array, corrected: Array) -> float:
    """Error of x if ``corrected`` were right."""
    mass = shell.mass[:, None]
    return float(np.sqrt(np.sum(mass * (x - corrected) ** 2) / np.sum(mass * (corrected - shell.rest_positions) ** 2)))


def quantiles(values: Any) -> list[float | None]:
    """At 5, 50 and 95 %."""
    return [float(value) for value in np.quantile(values, [0.05, 0.5, 0.95])] if len(values) else [None] * 3


def judged(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """How the bars of all answers, and of each model, do."""
    found = []
    for model in (*dict.fromkeys(row["model"] for row in rows), "both"):
        own = [row for row in rows if model in (row["model"], "both")]
        true, bar, valid = (np.array([row[name] for row in own]) for name in ("true", "bar", "valid"))
        small = valid & (bar <= LARGEST_BAR)
        ratio = bar[small] / np.maximum(true[small], 1e-9)
        void = ~valid
        found.append(
            {
                "model": model,
                "answers": len(own),
                "void": int(void.sum()),
                "small": int(small.sum()),
                "beyond": int((valid & (bar > LARGEST_BAR)).sum()),
                "ratio": quantiles(ratio),
                "under": share(true[small] <= 1.1 * bar[small]),
                "over": share(bar[small] <= 1.3 * true[small]),
                "beyond_right": share(true[valid & (bar > LARGEST_BAR)] > MISSED),
                "missed": int(((true > FAR) & small & (bar < MISSED)).sum()),
                "wrong_valid": int(((true > FAR) & valid & (bar <= LARGEST_BAR)).sum()),
                "void_good": share(true[void] <= NEAR),
            }
        )
    return found


def share(holds: Any) -> float | None:
    """Share of what holds; None of nothing."""
    return float(np.mean(holds)) if len(holds) else None


def compared(rows: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """How an estimator reads RSW's answers, those that DS has left behind among them."""
    read = [row for row in rows if name != "bar" or row["valid"]]
    true, value = (np.array([row[key] for row in read]) for key in ("true", name))
    far = true > FAR
    return {
        "name": ESTIMATORS[name],
        "ratio": quantiles(value[~far] / np.maximum(true[~far], 1e-9)),
        "far": int(far.sum()),
        "missed": int((far & (value < MISSED)).sum()),
    }


def forecasts(draws: int) -> list[dict[str, Any]]:
    """Loads at which shells turn unstable, as the bars of RSW's answers at half of them foretell them."""
    found = []
    for place in range(draws):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ms.ModalShellWarning)
            row = foretold(place)
        if row is not None:
            found.append({"shell": place} | row)
    return found


def foretold(place: int) -> dict[str, Any] | None:
    """Forecasts over the true load of one shell; None where no path turns unstable up to the largest load."""
    rng = np.random.default_rng([SNAP_SEED, place])
    drawn = drawn_shell(rng, KINDS[place % len(KINDS)], hinges=bool(place // len(KINDS) % 2))
    shell = drawn.shell
    if drawn.loads is None:
        force = drawn.force
    else:  # paths are followed under dead loads
        pressure = drawn.loads[0]
        assert isinstance(pressure, ms.Pressure)
        force = shell.loading(None, None, [ms.Pressure(pressure.p, follower=False)]).dead
    basis = model_basis(shell, min(MODES, shell.unknowns.count))
    unit = ms.LinearModal(basis).equilibrium(force=force).positions - shell.rest_positions
    force = force * (LARGEST * shell.size / float(np.linalg.norm(unit, axis=1).max()))
    path = ms.equilibrium_path(shell, force=force, steps=PATH_STEPS, points=PATH_POINTS)
    if not path.events:
        return None
    event = path.events[0]
    answer = ms.RotationStrain(basis).equilibrium(force=WAY * event.factor * force)
    bar, walked = ms.error_bar(shell, answer), ms.error_bar(shell, answer, walk=True)
    return {
        "text": drawn.text,
        "kind": event.kind,
        "share": event.factor * LARGEST,
        "margin": bar.margin,
        "valid": bar.valid,
        "linear": min(WAY * bar.critical_load, 1e3),
        "walked": min(WAY * walked.critical_load, 1e3),
        "seconds": [bar.seconds, walked.seconds],
    }


def table(result: StudyResult) -> str:
    """How bars do, the estimators, the snaps, and every miss with its shell."""
    found = result.findings
    bars = markdown(
        "model | answers | void | void, truly within 5 % | bar up to 30 % | bar over error at 5 % | 50 % | 95 % | "
        "error at most 1.1 bar | bar at most 1.3 errors | beyond 30 % | truly beyond 15 % | missed branches",
        "{model} | {answers} | {void} | {void_good:100*.0f} % | {small} | {ratio:.2f} | {under:100*.0f} % | "
        "{over:100*.0f} % | {beyond} | {beyond_right:100*.0f} % | {missed}",
        found["bars"],
    )
    estimators = markdown(
        "estimator of RSW's error | reading over error at 5 % | 50 % | 95 % | answers more than 25 % off | of these "
        "read as less than 15 % off",
        "{name} | {ratio:.2f} | {far} | {missed}",
        found["estimators"],
    )
    snaps = [
        {
            "name": name,
            "count": len(ratios),
            "ratio": quantiles(ratios),
            "near": share([abs(ratio - 1.0) <= 0.1 for ratio in ratios]),
        }
        for name, ratios in (
            ("margin alone", [row["linear"] for row in found["snaps"] if row["valid"]]),
            ("walk, where the bar holds", [row["walked"] for row in found["snaps"] if row["valid"]]),
            ("walk from rest, where it is void", [row["walked"] for row in found["snaps"] if not row["valid"]]),
        )
        if ratios
    ]
    ends = markdown(
        "load at which the path turns unstable, from half of it, by | shells | foretold over true at 5 % | 50 % | "
        "95 % | within 10 %",
        "{name} | {count} | {ratio:.2f} | {near:100*.0f} %",
        snaps,
    )
    off = markdown(
        "walks that miss it by more than 10 % | event | margin at half | foretold over true",
        "{text} | {kind} | {margin:.2f} | {walked:.2f}",
        [row for row in found["snaps"] if abs(row["walked"] - 1.0) > 0.1],
    )
    wrong = [
        row for row in found["rows"] if row["valid"] and row["bar"] <= LARGEST_BAR and row["true"] > 1.1 * row["bar"]
    ]
    misses = markdown(
        "valid bars exceeded by more than 10 % | model | error | bar | margin",
        "{text} | {model} | {true:100*.2f} % | {bar:100*.2f} % | {margin:.2f}",
        wrong,
    )
    return paragraphs(bars, estimators, ends, off, misses if wrong else "No valid bar is exceeded by more than 10 %.")


def finding(result: StudyResult) -> str:
    """How reliable bars are."""
    both = result.findings["bars"][-1]
    low, middle, high = both["ratio"]
    snaps = [row["walked"] for row in result.findings["snaps"] if row["valid"]]
    near = f"{sum(abs(ratio - 1.0) <= 0.1 for ratio in snaps)} of {len(snaps)}"
    return (
        f"Of {both['answers']} answers of MWTS and RSW on shells drawn by a seed, {both['void']} bars are void; where "
        f"one holds and is at most 30 %, it is {low:.2f} to {high:.2f} times the true error (5 to 95 %, median "
        f"{middle:.2f}), and {both['missed']} answers on another branch than DS pass for good. From half the load at "
        f"which a shell turns unstable, where bars hold, a walk foretells it within 10 % on {near}."
    )
