"""Stability at the extremes: the outcome of every model and integrator over step, stiffness, load, mesh and damping.

A strip clamped at one end, 12 x 2 cells, is let go under gravity (the rigid one spins, free and without it). Slices
through a named base point are mapped for every model with every integrator, and every cell is one named outcome:

* *converged*: the tip's displacement is within 10 % of the static answer of DS;
* *agrees with half the step*: it is within 10 % of what the same model does with half the step;
* *inaccurate*: neither, though nothing else is wrong;
* *cycling*, *wound up* (|w| beyond 2 pi): the motion's own outcome;
* *steps not converged*: the model's own solver gave up in six steps, or in fewer and the answer is off;
* *diverged*: the motion left the finite numbers, or its energy ran away;
* *refused*: a ModalShellError, from the mesh, the modes, the model or the step.

The static answer (on the mesh without needles) is the truth where the run is long enough to settle: where damping
leaves 1/200 of a motion. Shorter runs, undamped ones, loads at which DS statics finds no answer and the rigid body are
compared with the same model at half the step, twice as many of them: that says nothing of the model, only of the step.

Limits that have a theory are measured by bisection, see ``stability_limits``.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import repeat
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.integrators.modal import ImplicitEuler, ImplicitMidpoint
from modalshell.models.base.modal import as_modal
from modalshell.motion import Motion
from modalshell.motion.recorder import Recorder
from studies import stability_limits as limits
from studies import stability_models as models
from studies.pages import at_most, counted, markdown, paragraphs, result_of
from studies.stability_models import BASE, ROWS, IntegratedModel, StripScene

FIGURES = ("stability_atlas",)

TOLERANCE = 0.1
FEWEST, MOST = 40, 80
"""Steps of a run."""
PATIENCE = 6
"""Steps without convergence after which a run is aborted."""
LEFT = 1.0 / 200.0
CONVERGED, AGREES = ms.Outcome.CONVERGED.value, "agrees with half the step"
INACCURATE, STEPS_NOT_CONVERGED = ms.Outcome.INACCURATE.value, ms.Outcome.STEPS_NOT_CONVERGED.value
DIVERGED, REFUSED = ms.Outcome.DIVERGED.value, ms.Outcome.REFUSED.value
CYCLING, WOUND_UP = ms.Outcome.CYCLING.value, ms.Outcome.WOUND_UP.value
OUTCOMES = (CONVERGED, AGREES, INACCURATE, CYCLING, WOUND_UP, STEPS_NOT_CONVERGED, DIVERGED, REFUSED)
COLOURED = 0.05
"""Numerical damping ratio, and relative shift of frequency, of the first mode from which motion is coloured by it."""


@dataclass(frozen=True)
class Slice:
    """A map: two of the scene's numbers, their values, and their names for a reader."""

    x: str
    x_values: tuple[float, ...]
    y: str
    y_values: tuple[float, ...]


STEPS = tuple(float(f"{step:.3g}") for step in np.geomspace(1e-6, 10.0, 15))
RATIOS = (1.0, 1e2, 1e4, 1e6, 1e8)
GAMMAS = (0.1, 1.0, 10.0, 100.0, 1e3, 1e4)
FOLDS = (-179.99, -179.0, -150.0, -90.0, 0.0, 90.0, 150.0, 179.0, 179.99)
SLICES = {
    "ratio": Slice("step", STEPS, "ratio", RATIOS),
    "load": Slice("step", STEPS, "gamma", GAMMAS),
    "damping": Slice("gamma", (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4), "damping",
                     (0.0, 0.01, 0.1, 1.0, 10.0, 100.0)),
    "needles": Slice("aspect", (1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6), "ratio", RATIOS),
    "fold": Slice("fold", FOLDS, "gamma", GAMMAS),
}  # fmt: skip
AXES = {
    "step [s]": ("ratio", "step", {}),
    "stiffness ratio": ("ratio", "ratio", {}),
    "Γ": ("damping", "gamma", {"damping": 1.0}),
    "damping ratio": ("damping", "damping", {}),
    "needles, aspect": ("needles", "aspect", {}),
    "fold [°]": ("fold", "fold", {}),
}
"""Lines through the base point, by heading: their map, what runs along them, and what is not as at the base point."""
ADVICE = """Before choosing a step:

* Explicit Euler and Verlet: stay below `stable_step(damping)` of `DiscreteShell` or `SpringSheet`{steps}. A stiffer
  membrane and needles shorten it; so do springs across hinges. It is a limit of small motion about rest: under very
  large loads even half of it may fail. The classical grid has its own, `SheetGrid.stable_step()`.
* The exponential rule of modal models, their default, follows every mode exactly while forces do not turn. BDF2 and
  the composite rule, the defaults of models of vertices, are stable at any step as such; they add less than 5 % of
  damping to the first mode, and shift its frequency by less, up to {bdf2} / ω₁ and {composite} / ω₁.
* Implicit Euler is stable at any step as such, but adds less than 5 % of damping to the first mode only below 0.1 / ω₁.
  The midpoint rule shifts that mode's frequency by less than 5 % up to {midpoint} / ω₁, and rings on at long steps.
* Linearised implicit Euler solves once a step, and gives up less often than the Newton of implicit Euler; but nothing
  says that one solution was enough: take half the step and compare.
* MWTS and RSW take their modal force from the step before, or from a predicted middle or end. Long steps lose the
  equilibrium by that, the sooner the larger the load, and by the exponential rule the sooner the stiffer the modes that
  the step does not show: where `studies.stability_limits.step_radius` passes one.
* MWTS loses its equilibrium under large loads at any step, by flutter; damping puts it off. RSW does not.
* Needles of an aspect of 1e5 have modes refused and DS not converged, MD-ROM and springs sooner; no step avoids that, a
  better mesh does.
* A flat sheet of springs has no bending stiffness at small angles and hangs as cloth does: the maps call that
  inaccurate whatever the step, and right only where the load outweighs the bending.
"""


def classify(run: ms.Trajectory, truth: np.ndarray | None, static: bool = True) -> str:
    """Outcome of a motion whose tip ought to have moved by ``truth`` (3,) [m]; without a truth nothing is accurate.

    ``static`` says whether the truth is the static answer of DS, not the model's own at half the step.
    """
    if run.outcome in (ms.Outcome.DIVERGED, ms.Outcome.RUNS_AWAY):
        return DIVERGED
    if run.outcome in (ms.Outcome.WOUND_UP, ms.Outcome.CYCLING):
        return str(run.outcome)
    if run.unconverged_steps >= PATIENCE:
        return STEPS_NOT_CONVERGED
    moved = models.tip_displacement(run.positions[-1], run.rest_positions)
    if truth is not None and np.linalg.norm(moved - truth) <= TOLERANCE * np.linalg.norm(truth):
        return CONVERGED if static else AGREES
    return STEPS_NOT_CONVERGED if run.unconverged_steps else INACCURATE


def follow(row: IntegratedModel, model: ms.Model, scene: StripScene, dt: float, count: int) -> ms.Trajectory:
    """A run of ``count`` steps; aborted once a few steps have not converged. ModalShellError where it is refused."""
    damping, spins = scene.rayleigh, row.kind == "rigid"
    factors = (damping.mass_factor, damping.stiffness_factor)
    loading = model.shell.loading(None if spins else scene.gravity)
    motion = Motion(model, loading, dt=dt, damping=factors)
    if spins:
        motion.state.rates[3:] = spin_of(scene)
    recorder = Recorder(motion, count, patience=PATIENCE)
    return recorder.trajectory(np.array([motion.positions() for _ in recorder.frames()]))


def spin_of(scene: StripScene) -> np.ndarray:
    """Angular velocity (3,) [rad/s] of the rigid body: ``sqrt(g / L)`` about the axis across the strip."""
    return np.sqrt(scene.gamma * models.RIGIDITY / models.DENSITY) / models.LENGTH**2 * np.array([0.0, 1.0, 0.0])


def outcome(row: IntegratedModel, scene: StripScene) -> str:
    """Class of one cell."""
    model = models.model_of(row.name, scene.ratio, scene.aspect, scene.fold)
    if isinstance(model, str):
        return REFUSED
    ratio, omega = scene.damping, models.first_frequency(scene.ratio, scene.fold)
    decay = omega * (ratio if ratio <= 1.0 else ratio - float(np.sqrt(ratio**2 - 1.0)))
    settled = -np.log(LEFT) / decay if decay > 0.0 else np.inf
    count = int(np.clip(np.ceil(min(settled / scene.step, 1e9)), FEWEST, MOST))
    try:
        run = follow(row, model, scene, scene.step, count)
        truth = None
        if count * scene.step >= settled and row.kind != "rigid":
            truth = models.static_tip(scene.ratio, scene.gamma, scene.fold)
        static = truth is not None
        if not static and classify(run, truth) in (INACCURATE, STEPS_NOT_CONVERGED):
            finer = follow(row, model, scene, 0.5 * scene.step, 2 * count)
            if finer.outcome.succeeded or finer.outcome is ms.Outcome.DISTORTED:
                truth = models.tip_displacement(finer.positions[-1], finer.rest_positions)
    except ms.ModalShellError:
        return REFUSED
    return classify(run, truth, static)


def explicit_limit(row: IntegratedModel, scene: StripScene) -> float:
    """Longest stable step [s] at rest, by theory."""
    model: Any = models.model_of(row.name, scene.ratio, scene.aspect, scene.fold)
    return float(model.stable_step(scene.rayleigh))


def excess(row: IntegratedModel, scene: StripScene) -> float | None:
    """Positive where theory calls a scene unstable, negative where stable; None where there is no theory."""
    model = models.model_of(row.name, scene.ratio, scene.aspect, scene.fold)
    if isinstance(model, str):
        return None
    if row.theory == "explicit":
        return float(np.log(scene.step / explicit_limit(row, scene)))
    if row.kind == "rigid":
        slowed = scene.step * np.linalg.norm(spin_of(scene)) / (1.0 + scene.step * scene.rayleigh.mass_factor)
        return float(np.log(slowed))
    if row.kind != "modal" or (modal := as_modal(model)) is None:
        return None
    q = _equilibrium(row.coordinates or row.name, scene.ratio, scene.gamma, scene.aspect, scene.fold)
    if q is None:
        return 1.0
    load = modal.shell.gravity_force(scene.gravity)  # 1e-3: undamped motion neither grows nor falls, but for rounding
    return float(np.log(limits.step_radius(modal, q, load, scene.step, scene.rayleigh)) / scene.step - 1e-3)


@cache
def _equilibrium(row: str, ratio: float, gamma: float, aspect: float, fold: float) -> np.ndarray | None:
    model: Any = models.model_of(row, ratio, aspect, fold)
    return limits.at_rest(model, replace(BASE, gamma=gamma).gravity)


def crossings(row: IntegratedModel, plane: Slice, base: StripScene, y: float) -> list[float]:
    """Values of x at which theory's limit is crossed in one row of a map; the first x where all of it is unstable."""
    grid = np.geomspace(plane.x_values[0], plane.x_values[-1], 3 * len(plane.x_values))
    at = [excess(row, replace(base, **{plane.y: y, plane.x: float(x)})) for x in grid]
    found = [float(grid[0])] if at[0] is not None and at[0] > 0.0 else []
    for left, right, before, after in zip(grid[:-1], grid[1:], at[:-1], at[1:], strict=True):
        if before is None or after is None or (before > 0.0) == (after > 0.0):
            continue
        share = abs(before) / (abs(before) + abs(after)) if np.isfinite([before, after]).all() else 0.5
        found.append(float(left * (right / left) ** share))
    return found


def coloured_step(row: IntegratedModel, scene: StripScene) -> float | None:
    """Step from which the integrator colours the first mode: numerical damping, or frequency, off by 5 %."""
    if not row.bends or row.theory not in ("implicit", "midpoint", "bdf2", "sdirk2", "composite"):
        return None
    return uncoloured(row.theory) / models.first_frequency(scene.ratio, scene.fold)


def uncoloured(theory: str) -> float:
    """Longest step, times a mode's angular frequency, at which a rule is off by less than 5 % in either."""
    turns = np.geomspace(1e-3, 1.0 if theory == "implicit" else 10.0, 2000)
    if theory == "implicit":  # a damping ratio: about omega h / 2
        off = -np.log(ImplicitEuler().amplification(1.0, 0.0, turns)) / turns
    elif theory == "midpoint":
        off = 1.0 - ImplicitMidpoint().frequency(1.0, 0.0, turns)
    else:
        factors = limits.multipliers(theory, 1.0, 0.0, turns)
        off = np.maximum(-np.log(np.abs(factors)), np.abs(turns - np.angle(factors))) / turns
    return float(turns[np.searchsorted(off, COLOURED)])


def work(name: str, quick: bool) -> dict[str, Any]:
    """Maps of one row with theory's lines over them, its limits, and its own step at the base point."""
    row, maps = ROWS[name], {}
    base = BASE if row.theory != "explicit" else replace(BASE, step=0.5 * explicit_limit(row, BASE))
    for key, plane in chosen_slices(quick).items() if name in mapped(quick) else ():
        scenes = [[replace(base, **{plane.y: y, plane.x: x}) for x in plane.x_values] for y in plane.y_values]
        lines = key in ("ratio", "load", "damping") or (key == "needles" and row.theory == "explicit")
        maps[key] = {
            "classes": [[outcome(row, scene) for scene in line] for line in scenes],
            "limits": [crossings(row, plane, base, y) if lines else [] for y in plane.y_values],
            "coloured": [coloured_step(row, line[0]) if plane.x == "step" else None for line in scenes],
        }
    return {"maps": maps, "limits": limits.limits_of(name, quick), "step": base.step}


def mapped(quick: bool) -> list[str]:
    """The rows that are mapped: all, or the first of each kind."""
    return list({row.kind: name for name, row in reversed(ROWS.items())}.values())[::-1] if quick else list(ROWS)


def chosen_slices(quick: bool) -> dict[str, Slice]:
    """The slices, or two columns of a row of each."""
    return {key: thinned(plane) if quick else plane for key, plane in SLICES.items()}


def thinned(plane: Slice) -> Slice:
    """Two columns and a row of a map."""
    x = plane.x_values
    return replace(plane, x_values=(x[len(x) // 2], x[-1]), y_values=plane.y_values[1:2])


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Map every row, two at a time; ``quick`` takes few rows, few cells of each map, and the limits less finely."""
    slices, order = chosen_slices(quick), list(ROWS)[::-1]  # the dearest first, so that two processes end together
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        answers = (map if quick else pool.map)(work, order, repeat(quick))
        done = dict(zip(counted(order, on_step), answers, strict=False))
    findings = {
        "rows": {name: done[name]["maps"] for name in mapped(quick)},
        "limits": [limit for name in ROWS for limit in done[name]["limits"]] + limits.grid_limits(quick),
        "slices": {key: asdict(plane) for key, plane in slices.items()},
        "outcomes": OUTCOMES,
        "steps": {name: done[name]["step"] for name in ROWS},
    }
    arrays = {}
    for key in slices:
        classes = [done[name]["maps"][key]["classes"] for name in mapped(quick)]
        arrays[key] = np.array([[[OUTCOMES.index(c) for c in line] for line in lines] for lines in classes])
    strip = {name.lower(): getattr(models, name) for name in ("CELLS", "FLEXURE", "DENSITY", "MODES")}
    return result_of("stability_atlas", findings, arrays, base=asdict(BASE), **strip)


def table(result: StudyResult) -> str:
    """Where each row works and what ends it, as text; then every limit that has a theory, with its measurement."""
    found, base = result.findings, result.record["parameters"]["base"]
    rows = [
        {"name": name, "step": longest_step(found["limits"], name), "reach": list(reached(found, name, base))}
        for name in found["rows"]
    ]
    shown = [
        {**limit, "unit": "" if limit["unit"] == "1" else f" [{limit['unit']}]", "theory": limit_at(limit, "theory")}
        for limit in found["limits"]
    ]
    explicit = {row["model"]: row for row in found["limits"] if row["rule"] == "Verlet" and "(undamped)" in row["what"]}
    steps = " and ".join(f"{1e3 * explicit[model]['theory']:.2g} ms for {model}" for model in sorted(explicit))
    cells = [c for maps in found["rows"].values() for one in maps.values() for line in one["classes"] for c in line]
    return paragraphs(
        ADVICE.format(
            steps=f" (here, undamped, {steps})",
            **{rule: f"{uncoloured(rule):.2g}" for rule in ("bdf2", "composite", "midpoint")},
        ).rstrip("\n"),
        "[The poster](../paper_figures/stability_atlas_poster.png) shows every map; the summary, the share of each "
        "outcome.",
        f"A strip clamped at one end, {models.CELLS[0]} x {models.CELLS[1]} cells, at the base point: step 1/30 s "
        f"(explicit: half its limit), membrane over bending stiffness {base['ratio']:g}, Γ = {base['gamma']:g}, "
        f"damping ratio {base['damping']:g} of mode 1. Each column leaves it along one line; Γ and the damping "
        "ratio cross at Γ = 1 and a damping ratio of 1. A cell is right if the tip is within "
        f"{100.0 * TOLERANCE:g} % of the truth: DS statics where the run of 40 to 80 "
        "steps settles, else the same model at half the step. So short a run says little of slow growth: there the "
        "theory's lines count; one at the left edge of a map calls all of its row unstable up to the next line.",
        markdown(
            f"model | longest stable step [s]: theory, measured | {' | '.join(AXES)}",
            "{name} | {step} | {reach}",
            rows,
        ),
        "Limits, by theory and by measurement:",
        markdown(
            "model | limit | theory | measured | ratio",
            "{row} | {what}{unit} | {theory} | {measured:.4g|none found} | {ratio:.3f|–}",
            shown,
        ),
        "Cells: " + ", ".join(f"{cells.count(name)} {name}" for name in found["outcomes"]) + ".",
    )


def limit_at(limit: dict[str, Any], key: str) -> str:
    """A limit by "theory" or as "measured"; from rest there is no theory."""
    if key == "theory" and limit["what"].endswith("from rest"):
        return "–"
    return "none found" if limit[key] is None else f"{limit[key]:.4g}"


def longest_step(found: list[dict[str, Any]], name: str) -> str:
    """The first limit of the step of one row, and at what it holds."""
    row = ROWS[name]
    if row.coordinates:
        return f"as {row.coordinates.partition(', ')[0]}: the coordinates are the same"
    for limit in found:
        if limit["row"] == name and limit["what"].startswith("longest step"):
            both = ", ".join(limit_at(limit, key) for key in ("theory", "measured"))
            return f"{both} {limit['what'].removeprefix('longest step ')}"
    return "any" if row.kind == "linear" else "any, about rest"


def reached(found: dict[str, Any], name: str, base: dict[str, float]) -> Iterator[str]:
    """How far a row is right along each of the axes from its base point."""
    for key, along, changed in AXES.values():
        plane, classes = found["slices"][key], found["rows"][name][key]["classes"]
        own, other = ("x", "y") if plane["x"] == along else ("y", "x")
        lines = classes if own == "x" else list(zip(*classes, strict=True))
        at = {**base, "step": found["steps"][name], **changed}
        line = lines[nearest(plane[f"{other}_values"], at[plane[other]])]
        yield reach(plane[f"{own}_values"], line, at[along])


def nearest(values: Sequence[float], wanted: float) -> int:
    """Place of the value nearest ``wanted``, by ratio where both are positive."""
    array = np.array(values)
    away = np.abs(np.log(array / wanted)) if wanted > 0.0 and (array > 0.0).all() else np.abs(array - wanted)
    return int(np.argmin(away))


def reach(values: Sequence[float], classes: Sequence[str], base: float) -> str:
    """The stretch of values that are right about the base point (or nearest to it), and what ends it on either side."""
    right = [name in (CONVERGED, AGREES) for name in classes]
    good = [place for place, name in enumerate(right) if name]
    if not good:
        return "nowhere: " + ", ".join(dict.fromkeys(classes))
    first = last = min(good, key=lambda place: abs(place - nearest(values, base)))
    while first > 0 and right[first - 1]:
        first -= 1
    while last < len(values) - 1 and right[last + 1]:
        last += 1
    if first == 0 and last == len(values) - 1:
        return "all"
    words = f"{values[first]:g} to {values[last]:g}" if first < last else f"{values[first]:g}"
    if first > 0:
        words += f"; below {classes[first - 1]}"
    if last < len(values) - 1:
        words += f"; beyond {classes[last + 1]}"
    return words


def finding(result: StudyResult) -> str:
    """How near measured limits are to theory."""
    ratios = [limit["ratio"] for limit in result.findings["limits"] if limit["ratio"] is not None]
    return (
        f"{len(ratios)} limits of stable steps and loads have a theory; small motion meets each within "
        f"{at_most(100 * max(abs(ratio - 1.0) for ratio in ratios), 1)} %. The page says what to check before choosing "
        "a step."
    )
