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

Run it alone with ``modalshell reproduce --only stability_atlas``.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult, Table
from modalshell.integrators.modal import ImplicitEuler, ImplicitMidpoint
from modalshell.models.base.full import FullModel
from modalshell.models.base.modal import ModalModel, as_modal
from modalshell.modes import largest_eigenvalue
from modalshell.motion import Motion
from modalshell.motion.recorder import Recorder
from studies import modal_steps
from studies import stability_limits as limits
from studies import stability_models as models
from studies.pages import numbers
from studies.stability_page import page

FIGURES = ("stability_atlas",)

TOLERANCE = 0.1
FEWEST, MOST = 40, 80
"""Steps of a run."""
PATIENCE = 6
"""Steps without convergence after which a run is aborted."""
LEFT = 1.0 / 200.0
AGREES = "agrees with half the step"
OUTCOMES = (
    ms.Outcome.CONVERGED.value,
    AGREES,
    ms.Outcome.INACCURATE.value,
    ms.Outcome.CYCLING.value,
    ms.Outcome.WOUND_UP.value,
    ms.Outcome.STEPS_NOT_CONVERGED.value,
    ms.Outcome.DIVERGED.value,
    ms.Outcome.REFUSED.value,
)
ADDED_DAMPING, FREQUENCY_SHIFT = 0.05, 0.05
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


def classify(trajectory: ms.Trajectory, truth: np.ndarray | None, static: bool = True) -> str:
    """Outcome of a motion whose tip ought to have moved by ``truth`` (3,) [m]; without a truth nothing is accurate.

    ``static`` says whether the truth is the static answer of DS, not the model's own at half the step.
    """
    if trajectory.outcome in (ms.Outcome.DIVERGED, ms.Outcome.RUNS_AWAY):
        return str(ms.Outcome.DIVERGED)
    if trajectory.outcome in (ms.Outcome.WOUND_UP, ms.Outcome.CYCLING):
        return str(trajectory.outcome)
    if trajectory.unconverged_steps >= PATIENCE:
        return str(ms.Outcome.STEPS_NOT_CONVERGED)
    moved = models.tip_displacement(trajectory.positions[-1], trajectory.rest_positions)
    if truth is not None and np.linalg.norm(moved - truth) <= TOLERANCE * np.linalg.norm(truth):
        return str(ms.Outcome.CONVERGED) if static else AGREES
    return str(ms.Outcome.STEPS_NOT_CONVERGED if trajectory.unconverged_steps else ms.Outcome.INACCURATE)


def follow(
    row: models.IntegratedModel, model: ms.Model, scene: models.StripScene, dt: float, count: int
) -> ms.Trajectory:
    """A run of ``count`` steps; aborted once a few steps have not converged. ModalShellError where it is refused."""
    damping = scene.rayleigh
    spins = row.kind == "rigid"
    loading = model.shell.loading(None if spins else scene.gravity)
    motion = Motion(model, loading, dt=dt, damping=(damping.mass_factor, damping.stiffness_factor))
    if spins:
        motion.state.rates[3:] = spin_of(scene)
    recorder = Recorder(motion, count, patience=PATIENCE)
    return recorder.trajectory(np.array([motion.positions() for _ in recorder.frames()]))


def spin_of(scene: models.StripScene) -> np.ndarray:
    """Angular velocity (3,) [rad/s] of the rigid body: ``sqrt(g / L)`` about the axis across the strip."""
    return np.sqrt(scene.gamma * models.RIGIDITY / models.DENSITY) / models.LENGTH**2 * np.array([0.0, 1.0, 0.0])


def outcome(row: models.IntegratedModel, scene: models.StripScene) -> str:
    """Class of one cell."""
    model = models.model_of(row.name, scene.ratio, scene.aspect, scene.fold)
    if isinstance(model, str):
        return str(ms.Outcome.REFUSED)
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
        if not static and classify(run, truth) in (ms.Outcome.INACCURATE, ms.Outcome.STEPS_NOT_CONVERGED):
            finer = follow(row, model, scene, 0.5 * scene.step, 2 * count)
            if finer.outcome.succeeded or finer.outcome is ms.Outcome.DISTORTED:
                truth = models.tip_displacement(finer.positions[-1], finer.rest_positions)
    except ms.ModalShellError:
        return str(ms.Outcome.REFUSED)
    return classify(run, truth, static)


def own_base(row: models.IntegratedModel) -> models.StripScene:
    """The base point, with an explicit row's own step."""
    if row.theory != "explicit":
        return models.BASE
    return replace(models.BASE, step=0.5 * explicit_limit(row, models.BASE))


def explicit_limit(row: models.IntegratedModel, scene: models.StripScene) -> float:
    """Longest stable step [s] at rest, by theory."""
    model = models.model_of(row.name, scene.ratio, scene.aspect, scene.fold)
    return model.stable_step(scene.rayleigh)  # type: ignore[union-attr]


def excess(row: models.IntegratedModel, scene: models.StripScene) -> float | None:
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
    slope = _equilibrium(row.coordinates or row.name, scene.ratio, scene.gamma, scene.aspect, scene.fold)
    if slope is None:
        return 1.0
    load = modal.shell.gravity_force(scene.gravity)  # 1e-3: undamped motion neither grows nor falls, but for rounding
    return float(np.log(modal_steps.step_radius(modal, slope, load, scene.step, scene.rayleigh)) / scene.step - 1e-3)


@cache
def _equilibrium(row: str, ratio: float, gamma: float, aspect: float, fold: float) -> np.ndarray | None:
    model: Any = models.model_of(row, ratio, aspect, fold)
    return limits.at_rest(model, replace(models.BASE, gamma=gamma).gravity)


def crossings(row: models.IntegratedModel, plane: Slice, base: models.StripScene, y: float) -> list[float]:
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


def coloured_step(row: models.IntegratedModel, scene: models.StripScene) -> float | None:
    """Step from which the integrator colours the first mode: numerical damping, or frequency, off by 5 %."""
    omega = models.first_frequency(scene.ratio, scene.fold)
    if not row.bends:
        return None
    if row.theory == "implicit":
        # A damping ratio: about omega h / 2.
        steps = np.geomspace(1e-3, 1.0, 2000) / omega
        ratio = -np.log(ImplicitEuler().amplification(omega**2, 0.0, steps)) / (omega * steps)
        return float(steps[np.searchsorted(ratio, ADDED_DAMPING)])
    if row.theory == "midpoint":
        steps = np.geomspace(1e-3, 10.0, 2000) / omega
        shift = 1.0 - ImplicitMidpoint().frequency(omega**2, 0.0, steps) / omega
        return float(steps[np.searchsorted(shift, FREQUENCY_SHIFT)])
    return None


def maps_of(name: str, slices: dict[str, Slice]) -> dict[str, Any]:
    """All maps of one row, with theory's lines over them."""
    row = next(one for one in models.ROWS if one.name == name)
    base = own_base(row)
    found: dict[str, Any] = {}
    for key, plane in slices.items():
        scenes = [[replace(base, **{plane.y: y, plane.x: x}) for x in plane.x_values] for y in plane.y_values]
        lines = key in ("ratio", "load", "damping") or (key == "needles" and row.theory == "explicit")
        found[key] = {
            "classes": [[outcome(row, scene) for scene in line] for line in scenes],
            "limits": [crossings(row, plane, base, y) if lines else [] for y in plane.y_values],
            "coloured": [coloured_step(row, line[0]) if plane.x == "step" else None for line in scenes],
        }
    return found


def limits_of(name: str, quick: bool) -> list[dict[str, Any]]:
    """Limits of one row that have a theory, measured."""
    row = next(one for one in models.ROWS if one.name == name)
    model = models.model_of(name, models.BASE.ratio, models.BASE.aspect, models.BASE.fold)
    if isinstance(model, str) or row.kind not in _LIMITS or row.coordinates:  # a limit is that of the coordinates
        return []
    return _LIMITS[row.kind](row, model, quick)


def spin_limits(row: models.IntegratedModel, model: ms.RigidShell, quick: bool) -> list[dict[str, Any]]:  # noqa: ARG001
    """The longest step of a spin."""
    return [limits.entry(row.name, "longest step of a spin of 2 rad/s", "s", *limits.spin_step(model, 2.0))]


def linear_limits(row: models.IntegratedModel, model: ms.LinearModal, quick: bool) -> list[dict[str, Any]]:  # noqa: ARG001
    """What a rule does to one mode: its damping or its frequency."""
    omega = models.first_frequency(models.BASE.ratio, models.BASE.fold)
    if row.theory == "implicit":
        theory, measured = limits.numerical_damping(model, models.BASE.step, 0, ms.Damping(0.2 * omega, 0.01))
        return [limits.entry(row.name, "shrinking of mode 1 stepped at 30 Hz", "1", theory, measured)]
    theory, measured = limits.oscillation(model, models.BASE.step, 1, 1000)
    return [limits.entry(row.name, "frequency of mode 2 stepped at 30 Hz", "rad/s", theory, measured)]


def modal_limits(row: models.IntegratedModel, model: ModalModel, quick: bool) -> list[dict[str, Any]]:
    """Longest steps and largest loads of modes under a force that turns with them."""
    name, damping, count = row.name, models.BASE.rayleigh, 300 if quick else 900
    unit = models.BASE.gravity  # Gamma = 1
    found = [
        limits.entry(name, "longest step at Γ = 30", "s", *limits.longest_step(model, 30.0 * unit, damping, count))
    ]
    if quick and row.theory != "implicit":
        return found
    pair = limits.iteration_load(model, unit, (1.0, 60.0))
    if row.theory == "implicit":
        found.append(limits.entry(name, "largest Γ of the iteration q ← Λ⁻¹p(q)", "1", *pair))
    if not model.conservative:  # loses its equilibrium by flutter
        for ratio in (0.7,) if quick else (0.05, 0.2, 0.7):
            light = replace(models.BASE, damping=ratio).rayleigh
            count = 600 if quick else 4000
            pair = limits.largest_load(model, unit, models.BASE.step, light, count, (20.0, 400.0))
            words = f"largest Γ stepped at 30 Hz (damping ratio {ratio:g})"
            found.append(limits.entry(name, words, "1", *pair))
            if not quick:
                settles = partial(settles_from_rest, model, unit, light)
                rest = limits.bisect(settles, 20.0, 400.0)
                # No theory of small motion holds from rest: beside it, not against it.
                found.append(limits.entry(name, words + " let go from rest", "1", None, rest) | {"beside": pair[0]})
    return found


def settles_from_rest(model: ModalModel, unit: np.ndarray, damping: ms.Damping, factor: float) -> bool:
    """Whether motion from rest at the base point's step settles under ``factor`` times a gravity."""
    return limits.settles_from_rest(model, factor * unit, models.BASE.step, damping)


def full_limits(row: models.IntegratedModel, model: FullModel, quick: bool) -> list[dict[str, Any]]:
    """Limits of DS and of springs: the longest steps of explicit rules, what implicit ones do to the stiffest mode."""
    omega = float(np.sqrt(largest_eigenvalue(model.shell)))
    if row.theory == "implicit":
        pair = limits.stiffest_mode(model, 1.0 / omega, ms.Damping(0.1 * omega, 0.2 / omega))
        return [limits.entry(row.name, "shrinking of the stiffest mode at h omega = 1", "1", *pair)]
    cases = {
        "undamped": ms.Damping(),
        "xi = omega_max": ms.Damping(omega, 0.0),
        "zeta omega_max = 1": ms.Damping(0.0, 1.0 / omega),
    }
    return [
        limits.entry(
            row.name, f"longest step at rest ({words})", "s", *limits.explicit_step(model, case, 300 if quick else 900)
        )
        for words, case in cases.items()
    ]


_LIMITS: dict[str, Callable[[models.IntegratedModel, Any, bool], list[dict[str, Any]]]] = {
    "rigid": spin_limits,
    "linear": linear_limits,
    "modal": modal_limits,
    "full": full_limits,
}
"""How the limits of a row are measured, by its kind."""


def grid_limits(quick: bool) -> list[dict[str, Any]]:
    """Limits of the classical grid of springs, whose step is estimated without its supports and edges."""
    found = []
    for name, stiffness in {"alike": (1.0, 1.0), "soft": (0.3, 0.1)}.items():
        for ratio in (0.0, 0.5):
            grid = limits.grid_of(*stiffness, ratio)
            words = f"longest step at rest (shear and flexion {name}; drag = {ratio:g} omega_max)"
            pair = limits.grid_step(grid, 300 if quick else 900)
            found.append(limits.entry("classical grid, Verlet", words, "s", *pair))
    return found


def work(name: str, quick: bool) -> dict[str, Any]:
    """Maps and limits of one row."""
    return {"maps": maps_of(name, chosen_slices(quick)), "limits": limits_of(name, quick)}


def chosen_slices(quick: bool) -> dict[str, Slice]:
    """The slices, or a few cells of each."""
    return {key: thinned(plane) if quick else plane for key, plane in SLICES.items()}


def thinned(plane: Slice) -> Slice:
    """Three columns and a row of a map."""
    x, y = plane.x_values, plane.y_values
    return replace(plane, x_values=(x[0], x[len(x) // 2], x[-1]), y_values=y[1:2])


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """Map every row, two at a time; ``quick`` takes a few cells of each map, and the limits less finely."""
    slices, names = chosen_slices(quick), [row.name for row in models.ROWS]
    done: dict[str, dict[str, Any]] = {}
    if quick:
        for name in names:
            done[name] = work(name, quick)
            if on_step is not None:
                on_step(len(done), len(names))
    else:
        # The dearest first, so that two processes end together.
        order = names[::-1]
        with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
            futures = {name: pool.submit(work, name, quick) for name in order}
            for name in order:
                done[name] = futures[name].result()
                if on_step is not None:
                    on_step(len(done), len(names))
    findings = {
        "rows": {name: done[name]["maps"] for name in names},
        "limits": [limit for name in names for limit in done[name]["limits"]] + grid_limits(quick),
        "slices": {key: asdict(plane) for key, plane in slices.items()},
        "outcomes": OUTCOMES,
        "steps": {row.name: own_base(row).step for row in models.ROWS},
    }
    arrays = {
        key: np.array([[[OUTCOMES.index(c) for c in line] for line in done[n]["maps"][key]["classes"]] for n in names])
        for key in slices
    }
    parameters = {name.lower(): getattr(models, name) for name in ("CELLS", "FLEXURE", "DENSITY", "MODES")}
    parameters |= {"base": asdict(models.BASE)}
    parameters |= {"tolerance": TOLERANCE, "steps": (FEWEST, MOST), "patience": PATIENCE, "left": LEFT}
    return StudyResult("stability_atlas", findings, arrays, run_record(parameters))


def table(result: StudyResult) -> str:
    """Where each row works and what ends it, as text; then every limit that has a theory, with its measurement."""
    return page(result)


def finding(tables: list[Table]) -> str:
    """How near measured limits are to theory."""
    *_, rows = (table for table in tables if "ratio" in table[0])
    ratios = numbers(rows, "ratio")
    return (
        f"{len(ratios)} limits of stable steps and loads have a theory; small motion meets each within "
        f"{100 * max(abs(ratio - 1.0) for ratio in ratios):.1f} %. The page says what to check before choosing a step."
    )
