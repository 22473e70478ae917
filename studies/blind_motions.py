"""Do error bars warn in time, and does ``auto`` keep its promise? Motions drawn by a seed, on which nothing was tuned.

Shells of :mod:`studies.blind_bars`, drawn by another seed, under loads that come at once, grow, come and go, or swing.
MWTS and RSW move with a bar every few frames: does the alarm, a bar above the tolerance or a void one, come before the
true error passes it? And ``auto``, with that tolerance, moves against every fixed rung: what does it cost, in counted
work, over the cheapest of those that hold the tolerance on all frames? DS with the same step is the truth; errors are
distances from it over the largest displacement of its motion.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

import modalshell as ms
from modalshell.core.cost import counted as work_of
from modalshell.core.outcome import Outcome
from modalshell.core.typing import Array, Progress
from modalshell.files.study_result import StudyResult
from modalshell.models import Model
from modalshell.modes import model_basis
from studies.blind_bars import KINDS, Drawn, drawn_shell, quantiles
from studies.pages import counted, markdown, paragraphs, result_of

FIGURES = ("blind_motions",)

SEED = 22
MOTIONS, QUICK = 32, 3
TOLERANCE = 0.05
MODES = 8
FRAMES, A_PERIOD = 60, 30
"""Frames, and those in the period of the lowest mode."""
DAMPING = 0.1
"""Damping ratio of the lowest mode, by the mass."""
EVERY = 3
"""Frames from one bar to the next."""
SMALLEST, LARGEST = 0.005, 0.4
"""Displacement of the linear answer to the largest load at rest, over the shell's size."""
COURSES = ("at once", "grows", "comes and goes", "swings")
BARRED = tuple(spec.key for spec in (ms.models()["mwts"], ms.models()["rsw"]))
"""Models whose motions have bars."""
AUTO = ms.models()["auto"].key


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Move all shells; ``quick`` takes few."""
    rows = []
    for place in counted(list(range(QUICK if quick else MOTIONS)), on_step):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ms.ModalShellWarning)  # of coarse meshes and steps: DS has the same
            rows.append(of_motion(place))
    known = [row for row in rows if row["models"]]
    findings = {"rows": rows, "alarms": [alarms(known, key) for key in BARRED], "auto": against_rungs(known)}
    return result_of("blind_motions", findings, {}, SEED, motions=len(rows))


def of_motion(place: int) -> dict[str, Any]:
    """All models in one motion; none where DS itself does not complete it."""
    rng = np.random.default_rng([SEED, place])
    drawn = drawn_shell(rng, KINDS[place % len(KINDS)], hinges=bool(place // len(KINDS) % 2))
    shell, basis = drawn.shell, model_basis(drawn.shell, MODES)
    omega = float(np.sqrt(basis.eigenvalues[0]))
    dt = 2.0 * np.pi / omega / A_PERIOD
    course = str(rng.choice(COURSES))
    share = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
    still = ms.LinearModal(basis).equilibrium(force=drawn.force, loads=drawn.loads).positions
    most = share * shell.size / float(np.linalg.norm(still - shell.rest_positions, axis=1).max())
    times = dt * np.arange(FRAMES + 2)
    load = ms.Scaled(load_of(drawn), (times.tolist(), (most * factors(course)).tolist()))
    setting: dict[str, Any] = {
        "duration": FRAMES * dt,
        "dt": dt,
        "loads": [load],
        "damping": (2.0 * DAMPING * omega, 0.0),
    }
    with work_of() as work:
        exact = ms.simulate(ms.DiscreteShell(shell), **setting)
    row = {"motion": place, "text": f"{drawn.text}, {course}", "share": share, "models": {}}
    if exact.outcome is not Outcome.COMPLETED:
        return row
    found: dict[str, Any] = {"ds": {"worst": 0.0, "cost": work.cost}}
    for key, model in rungs(shell, basis).items():
        with work_of() as work:
            run = ms.simulate(model, **setting)
        errors = errors_of(shell, run.positions, exact.positions)
        found[key] = {"worst": min(float(errors.max()), 1e3), "cost": work.cost, "message": run.message}
        if key in BARRED:
            barred = ms.simulate(model, **setting, bars=EVERY).bars
            found[key] |= warned(errors, barred, dt) | {"errors": np.minimum(errors, 1e3).tolist()}
        if key == "auto":
            found[key] |= {"levels": run.levels, "errors": errors.tolist()}
    return row | {"models": found}


def rungs(shell: ms.Shell, basis: ms.Basis) -> dict[str, Model]:
    """The fixed rungs, and ``auto``."""
    known = ms.models()
    found = (
        (known["lma"], ms.LinearModal(basis)),
        (known["mwts"], ms.ModalWarping(basis)),
        (known["rsw"], ms.RotationStrain(basis)),
        (known["md-rom"], ms.ModalDerivatives(shell, count=MODES)),
        (known["auto"], ms.Auto(shell, MODES, error=TOLERANCE)),
    )
    return {spec.key: model for spec, model in found}


def load_of(drawn: Drawn) -> Any:
    """The load of a shell as an object, which may be scaled in time."""
    if drawn.loads is not None:
        return drawn.loads[0]
    pushed = np.flatnonzero(np.abs(drawn.force).max(axis=1))
    if "weight" in drawn.text:
        first = pushed[0]
        return ms.SelfWeight(tuple(drawn.force[first] / drawn.shell.mass[first]))
    return ms.PointForce(pushed, tuple(drawn.force[pushed[0]]))


def factors(course: str) -> Array:
    """Factors on the load at every frame, and one beyond."""
    t = np.arange(FRAMES + 2) / FRAMES
    if course == "at once":
        return np.ones_like(t)
    if course == "grows":
        return np.minimum(2.0 * t, 1.0)
    if course == "comes and goes":
        return np.maximum(1.0 - np.abs(2.0 * t - 1.0), 0.0)
    return np.asarray(np.sin(2.0 * np.pi * FRAMES / (1.3 * A_PERIOD) * t))


def errors_of(shell: ms.Shell, positions: NDArray[Any], exact: NDArray[Any]) -> Array:
    """Distance of every frame from that of DS, over the largest displacement of that, in the norm of the mass.

    1000 for frames that a motion has not come to.
    """
    mass, gaps = shell.mass[:, None], (positions - exact[: len(positions)], exact - shell.rest_positions)
    with np.errstate(over="ignore"):
        off, moved = (np.sqrt(np.sum(mass * part**2, axis=(1, 2))) for part in gaps)
    errors = np.full(len(exact), 1e3)
    errors[: len(off)] = np.nan_to_num(off / moved.max(), nan=1e3, posinf=1e3)
    return errors


def warned(errors: Array, bars: Any, dt: float) -> dict[str, Any]:
    """The frame at which the error passes the tolerance, and that of the first alarm; None without one."""
    passes = np.flatnonzero(errors > TOLERANCE)
    alarmed: NDArray[np.bool_] = ~bars.valid | (bars.displacement > TOLERANCE)
    first = np.flatnonzero(alarmed)
    return {
        "passes": int(passes[0]) if passes.size else None,
        "alarm": round(float(bars.times[first[0]]) / dt) if first.size else None,
    }


def alarms(rows: list[dict[str, Any]], key: str) -> dict[str, Any]:
    """How the alarms of a model come: before the error passes the tolerance, after it, never, or for nothing."""
    own = [row["models"][key] for row in rows]
    wrong = [one for one in own if one["passes"] is not None]
    alarmed = [one for one in wrong if one["alarm"] is not None]
    right = [one for one in own if one["passes"] is None]
    return {
        "key": key,
        "motions": len(own),
        "wrong": len(wrong),
        "before": sum(one["alarm"] <= one["passes"] for one in alarmed),
        "soon": sum(one["passes"] < one["alarm"] <= one["passes"] + EVERY + 1 for one in alarmed),
        "late": sum(one["alarm"] > one["passes"] + EVERY + 1 for one in alarmed),
        "never": len(wrong) - len(alarmed),
        "right": len(right),
        "false": sum(one["alarm"] is not None for one in right),
    }


def against_rungs(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """How often ``auto`` holds the tolerance, and its cost over the cheapest fixed rung that does, and over DS."""
    ratios: list[float] = []
    of_ds: list[float] = []
    holds: dict[str, int] = {}
    cheap: list[float] = []
    for row in rows:
        models = row["models"]
        for key, one in models.items():
            holds[key] = holds.get(key, 0) + (one["worst"] <= TOLERANCE)
        fixed = {key: one["cost"] for key, one in models.items() if key != "auto" and one["worst"] <= TOLERANCE}
        best = min(fixed, key=lambda key: fixed[key])
        row["best"], row["ratio"] = best, models["auto"]["cost"] / fixed[best]
        ratios.append(row["ratio"])
        of_ds.append(models["auto"]["cost"] / models["ds"]["cost"])
        cheap += [row["ratio"]] if best != "ds" else []
    return {
        "motions": len(rows),
        "holds": holds,
        "worst": max((row["models"]["auto"]["worst"] for row in rows), default=None),
        "ratio": quantiles(ratios),
        "ratio_where_cheap": quantiles(cheap),
        "cheap": len(cheap),
        "ds_ratio": quantiles(of_ds),
    }


def table(result: StudyResult) -> str:
    """Alarms, the models on all motions, and every miss with its shell."""
    found = result.findings
    known = [row for row in found["rows"] if row["models"]]
    warnings_ = markdown(
        f"model | motions | error passes {100 * TOLERANCE:g} % | alarm before | at the next check | later | never | "
        "error stays below | of these alarmed",
        "{key} | {motions} | {wrong} | {before} | {soon} | {late} | {never} | {right} | {false}",
        found["alarms"],
    )
    keys = list(known[0]["models"])
    models = markdown(
        f"model | holds {100 * TOLERANCE:g} % on all frames, of {len(known)} motions | median of its worst errors | "
        "largest | counted cost over DS, median",
        "{key} | {holds} | {median:100*.2g} % | {largest:100*.2g} % | {cost:.3f}",
        [
            {
                "key": key,
                "holds": found["auto"]["holds"][key],
                "median": float(np.median([row["models"][key]["worst"] for row in known])),
                "largest": max(row["models"][key]["worst"] for row in known),
                "cost": float(np.median([row["models"][key]["cost"] / row["models"]["ds"]["cost"] for row in known])),
            }
            for key in keys
        ],
    )
    motions = markdown(
        "motion | error of MWTS | of RSW | of auto | what auto did | cheapest fixed rung that holds | cost of auto "
        "over that",
        "{text}, to {share:.2f} of the size | {mwts:100*.2g} % | {rsw:100*.2g} % | {auto:100*.2g} % | {did} | {best} | "
        "{ratio:.2f}",
        [
            {key: row["models"][key]["worst"] for key in (*BARRED, AUTO)}
            | {"did": shares_of(row["models"][AUTO]["levels"][1:])}
            | {name: row[name] for name in ("text", "share", "best", "ratio")}
            for row in known
        ],
    )
    lost = [row["text"] for row in found["rows"] if not row["models"]]
    return paragraphs(warnings_, models, motions, f"DS did not complete: {'; '.join(lost)}." if lost else "")


def shares_of(levels: list[str]) -> str:
    """Shares of the frames by each level, as text."""
    shares = {name: levels.count(name) / len(levels) for name in dict.fromkeys(levels)}
    return "frames by " + ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items())


def finding(result: StudyResult) -> str:
    """Whether alarms come in time, and what ``auto`` costs."""
    auto, first = result.findings["auto"], result.findings["alarms"][0]
    low, middle, high = auto["ratio"]
    holding, most = auto["holds"]["auto"], f"{100 * TOLERANCE:g} %"
    return (
        f"Of {first['motions']} motions drawn by a seed MWTS errs by more than {most} in {first['wrong']}; bars give "
        f"the alarm before in {first['before']}, at the next check in {first['soon']}, later in {first['late']}, never "
        f"in {first['never']}. auto holds {most} in {holding} (largest error {100 * auto['worst']:.2g} %), at "
        f"{low:.2g} to {high:.2g} times the counted cost of the cheapest fixed model that holds it (5 to 95 %, median "
        f"{middle:.2g})."
    )
