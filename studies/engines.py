"""Six scenes by several engines and by this package: errors against the truth of each scene, and cost.

A strip hangs under its weight at three loads (truth: the heavy elastica); V-beams with a flange of 10 mm, and of 15 mm
before and after their fold flattens, and a swept plate (finite elements of ``finite_elements.json`` and
``identification_data.json``); a square cloth hangs from two corners (this package's shell theory on a mesh three times
as fine); a square plate vibrates (Ritz's method; finite elements alone answer). Every engine gets the same mesh,
constants, supports and gravity, in a process of its own on one thread, as its adapter in ``modalshell/compare/engines``
converts them. A row counts once the conversion has held on a strip of the same sheet: the mass that moves within 1 %
where the engine tells it, and the small drop within 10 %, by the longest of the steps tried. MuJoCo's flex runs a
second time with its modulus calibrated on that drop, checked then on half the length.

Engines run in the Python that the environment variable ``MODALSHELL_ENGINES`` names, or in this one. What is missing is
named in the table, with the command that installs it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

import modalshell as ms
from modalshell.compare.engines import ENGINES, Engine, answered
from modalshell.compare.engines.case import engine_case
from modalshell.compare.engines.engine import ask
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.identification import swept_mesh
from studies.pages import at_most, counted, markdown, paragraphs, result_of
from studies.plate_frequencies import reference
from studies.shell_theory import displacements_at
from studies.v_beam_truth import RUNGS, SHEET, SNAPPING, beam, references

FIGURES = ("engines",)

STRIP = {"length": 0.3, "width": 0.03, "young": 1e7, "poisson": 0.0, "thickness": 3e-3, "density": 1000.0}
PLATE = {"length": 0.3, "width": 0.3, "young": 1e9, "poisson": 0.3, "thickness": 1e-3, "density": 1000.0}
CLOTH = {"young": 1e6, "poisson": 0.3, "thickness": 1e-3, "density": 300.0}
ELASTICA = {1.0: (0.9912463953, 0.123471402), 3.0: (0.9315112071, 0.3396483923), 10.0: (0.6563537612, 0.7001997155)}
"""Reach and drop of the tip over the length at rho g h L^3 / D: a boundary-value solution, checked by shooting."""
SOFT, STIFF = (1.0, 4.0), (2.0, 2.5)
"""Loads Gamma of the V-beams; the stiff one snaps between 2.2 and 2.3."""
MODES = 6
_RUNG_MODES, _FRAMES = 8, 120
"""Modes of the rungs, and frames that are timed: enough that what a run does once does not count."""


@final
@dataclass(frozen=True)
class Scene:
    """A shell under growing gravity, and how far an answer is off.

    Attributes
    ----------
    name, truth : str
        What it is, and what it is compared with.
    shell : Shell
        The shell.
    gravities : ndarray, shape (L, 3)
        Its loads [m/s^2].
    error : callable
        Relative error of positions (n, 3) [m] at a load by its number.
    """

    name: str
    truth: str
    shell: ms.Shell
    gravities: np.ndarray
    error: Callable[[np.ndarray, int], float]


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All scenes; ``quick`` takes coarser meshes and leaves the others' processes out, and says so in their rows."""
    makers = (strip, lambda coarse: v_beam(0, SOFT, coarse), lambda coarse: v_beam(-1, STIFF, coarse), swept, cloth)
    rows: list[dict[str, Any]] = []
    for make in counted(makers, on_step):
        scene = make(quick)
        for key in RUNGS:
            ours(scene, key)  # compiles
            rows.append({"scene": scene.name, "truth": scene.truth, **ours(scene, key)})
        for engine in ENGINES:
            found = {"engine": engine.name, "outcome": "left out of a quick run"} if quick else foreign(scene, engine)
            rows.append({"scene": scene.name, "truth": scene.truth, **found})
    plates = [our_plate(12 if quick else 32)]
    if not quick:
        plates.append(foreign_plate(ENGINES[0]))
    return result_of("engines", {"rows": rows, "plates": plates}, quick=quick)


def relative(moved: np.ndarray, exact: np.ndarray) -> float:
    """Norm of a difference over that of what is exact."""
    return float(np.linalg.norm(moved - exact) / np.linalg.norm(exact))


def sheet(case: dict[str, Any]) -> ms.Isotropic:
    """The material of a case."""
    return ms.Isotropic(**{key: case[key] for key in ("young", "poisson", "thickness", "density")})


def strip(coarse: bool) -> Scene:
    """A strip of shell theory, clamped at x = 0."""
    length, rigidity = STRIP["length"], STRIP["young"] * STRIP["thickness"] ** 3 / 12.0
    mesh = ms.flat_beam(length=length, width=STRIP["width"], cells=(12, 2) if coarse else (20, 2))
    tip = mesh.vertices[:, 0] > length - 1e-9
    unit = rigidity / (STRIP["density"] * STRIP["thickness"] * length**3)

    def error(positions: np.ndarray, load: int) -> float:
        reach, fall = list(ELASTICA.values())[load]
        return relative((positions - mesh.vertices)[tip].mean(axis=0) / length, np.array([reach - 1.0, 0.0, -fall]))

    gravities = np.outer([unit * load for load in ELASTICA], (0.0, 0.0, -1.0))
    shell = ms.Shell(mesh, sheet(STRIP), mesh.vertices[:, 0] < 1e-9)
    return Scene("elastica strip, Γ 1, 3 and 10", "heavy elastica", shell, gravities, error)


def v_beam(index: int, gammas: Sequence[float], coarse: bool) -> Scene:
    """A V-beam of the references at some of its loads."""
    case = references()[index]
    loads = [load for load in case["loads"] if load["gamma"] in gammas]
    mesh = beam(case, 2 if coarse else 3)
    shell = ms.Shell(mesh, ms.Isotropic(**SHEET), mesh.vertices[:, 0] < 1e-9)
    direction = np.array(case["direction"])

    def error(positions: np.ndarray, load: int) -> float:
        moved = displacements_at(shell, positions, np.array(case["points"]))
        return relative(moved, np.array(loads[load]["displacements"]))

    kind = "stiff V through its snap" if case["name"] == SNAPPING else "soft V"
    told = " and ".join(f"{gamma:g}" for gamma in gammas)
    gravities = np.array([load["gravity"] * direction for load in loads][: 1 if coarse else None])
    return Scene(f"{kind}, Γ {told}", "finite elements", shell, gravities, error)


def swept(coarse: bool) -> Scene:
    """A swept plate, clamped at its root; the corners of its tip are compared."""
    case = json.loads(Path(__file__).with_name("identification_data.json").read_text(encoding="utf-8"))["swept"]
    mesh, corners = swept_mesh(case, 9 if coarse else 36)

    def error(positions: np.ndarray, load: int) -> float:
        seen = np.array(case["positions"][load])
        return relative(positions[corners] - mesh.vertices[corners], seen - np.array(case["corners"]))

    shell = ms.Shell(mesh, sheet(case), mesh.vertices[:, 0] < 1e-9)
    gravities = np.outer(case["gravities"], case["direction"])
    return Scene("swept plate at 4 loads", "finite elements", shell, gravities, error)


def cloth(coarse: bool) -> Scene:
    """A square cloth that hangs from two of its corners, each held by a square of 3 cm."""

    def hung(cells: int) -> ms.Shell:
        mesh = ms.sheet(length=0.3, width=0.3, cells=(cells, cells))
        x, y = mesh.vertices[:, 0], np.abs(mesh.vertices[:, 1] - mesh.vertices[:, 1].mean())
        return ms.Shell(mesh, sheet(CLOTH), (x < 0.0301) & (y > 0.1199))

    cells, times = (10, 2) if coarse else (20, 3)
    shell, fine, gravity = hung(cells), hung(times * cells), np.array([0.0, 0.0, -1.0])
    answer = ms.DiscreteShell(fine).equilibrium(gravity=gravity)
    places = np.linalg.norm(fine.rest_positions[:, None] - shell.rest_positions, axis=2).argmin(axis=0)
    exact = (answer.positions - fine.rest_positions)[places]

    def error(positions: np.ndarray, load: int) -> float:  # noqa: ARG001 (there is one)
        return relative(positions - shell.rest_positions, exact)

    return Scene("cloth hung from two corners", "modalshell DS, finer", shell, gravity[None], error)


def ours(scene: Scene, key: str) -> dict[str, Any]:
    """Row of a model of this package, each load from the last answer of DS or from rest."""
    spec, begin = ms.models()[key], time.process_time()
    basis = ms.solve_modes(scene.shell, _RUNG_MODES)
    begin = time.process_time() if spec.needs == "shell" else begin
    model = spec.builder(scene.shell if spec.needs == "shell" else basis)
    errors, notes, last = list[float | None](), list[str](), None
    for load, gravity in enumerate(scene.gravities):
        answer = model.equilibrium(gravity=gravity, start=last)
        last = answer.positions if key == "ds" else None
        errors.append(scene.error(answer.positions, load) if answer.converged else None)
        notes += [] if answer.outcome is ms.Outcome.CONVERGED else [answer.status]
    seconds = time.process_time() - begin
    step = 1.0 / (30.0 * float(basis.frequencies[0]))
    moving = {"dt": step, "gravity": scene.gravities[0]}
    ms.simulate(model, duration=step, **moving)
    begin = time.process_time()
    ms.simulate(model, duration=_FRAMES * step, **moving)
    frame = 1e3 * (time.process_time() - begin) / _FRAMES
    name = f"modalshell {spec.name}" + (f" {_RUNG_MODES}" if key != "ds" else "")
    told = {"outcome": "counts", "note": "; ".join(dict.fromkeys(notes)), "version": f"modalshell {ms.__version__}"}
    return {"engine": name, **told, "errors": errors, "frame_ms": frame, "step": step, "seconds": seconds}


def foreign(scene: Scene, engine: Engine) -> dict[str, Any]:
    """Row of another engine."""
    found = answered(engine, scene.shell, [(gravity, None) for gravity in scene.gravities])
    row = {key: getattr(found, key) for key in ("outcome", "version", "note", "drop", "frame_ms", "step", "seconds")}
    row["engine"] = engine.name
    if found.counts and found.positions is not None:
        errors: list[float | None] = [scene.error(places, load) for load, places in enumerate(found.positions)]
        row["errors"] = errors + [None] * (len(scene.gravities) - len(errors))
    return row


def our_plate(cells: int) -> dict[str, Any]:
    """Frequencies of the square plate by this package."""
    basis = ms.solve_modes(plate(cells), MODES)
    return plate_row("modalshell, shell theory", basis.frequencies)


def plate(cells: int) -> ms.Shell:
    """The square plate, clamped on one edge."""
    mesh = ms.sheet(length=PLATE["length"], width=PLATE["width"], cells=(cells, cells))
    return ms.Shell(mesh, sheet(PLATE), mesh.vertices[:, 0] < 1e-9)


def foreign_plate(engine: Engine) -> dict[str, Any]:
    """Frequencies of the square plate by finite elements."""
    found = ask(engine, engine_case(engine, plate(24), []) | {"modes": MODES})
    if "outcome" in found:
        return {"engine": engine.name, "outcome": found["outcome"]}
    return plate_row(engine.name, np.array(found["frequencies"]))


def plate_row(words: str, frequencies: np.ndarray) -> dict[str, Any]:
    """Deviations from Ritz's method."""
    rigidity = PLATE["young"] * PLATE["thickness"] ** 3 / (12.0 * (1.0 - PLATE["poisson"] ** 2))
    unit = np.sqrt(rigidity / (PLATE["density"] * PLATE["thickness"])) / PLATE["length"] ** 2 / (2.0 * np.pi)
    exact = np.asarray(reference("CFFF")[0])[:MODES] * unit
    deviations = (np.asarray(frequencies) / exact - 1.0).tolist()
    return {"engine": words, "outcome": "counts", "deviations": deviations}


def table(result: StudyResult) -> str:
    """Errors and cost by scene and engine, and the plate's frequencies, as Markdown tables."""
    modes, rows = " | ".join(f"mode {mode} [%]" for mode in range(1, MODES + 1)), []
    for row in result.findings["rows"]:
        outcome = f"{row['outcome']}: {row['note']}" if row.get("note") else row["outcome"]
        errors = ", ".join("-" if one is None else f"{100.0 * one:.2f}" for one in row.get("errors", ()))
        rows.append({"frame_ms": None, "step": None, "seconds": None, **row, "outcome": outcome, "errors": errors})
    truths = dict.fromkeys((row["scene"], row["truth"]) for row in rows)
    versions = dict.fromkeys(row["version"] for row in rows if row.get("version"))
    return paragraphs(
        markdown(
            "scene | engine | outcome | errors [%] | ms a step | stable step [s] | time to answer [s]",
            "{scene} | {engine} | {outcome} | {errors} | {frame_ms:.2g|} | {step:.2g|} | {seconds:.2g|}",
            rows,
        ),
        "Frequencies of the square plate, deviations from Ritz's method:",
        markdown(
            f"engine | outcome | {modes}",
            "{engine} | {outcome} | {deviations:100*+.2f|}",
            [{"deviations": [None] * MODES} | row for row in result.findings["plates"]],
        ),
        "Truth: " + "; ".join(f"{scene}: {truth}" for scene, truth in truths) + ".",
        f"Times are those of one thread on a processor. Versions: {', '.join(versions)}.",
    )


def finding(result: StudyResult) -> str:
    """The largest errors of each engine that counts, and what did not count."""
    rows = result.findings["rows"]
    worst: dict[str, float] = {}
    unanswered: dict[str, int] = {}
    for row in rows:
        if missing := sum(error is None for error in row.get("errors", ())):
            unanswered[row["engine"]] = unanswered.get(row["engine"], 0) + missing
        errors = [error for error in row.get("errors", ()) if error is not None]
        if errors:
            worst[row["engine"]] = max(worst.get(row["engine"], 0.0), *errors)
    ordered = sorted(worst.items(), key=lambda pair: pair[1])
    without = {engine: f" (no answer to {count} of its loads)" for engine, count in unanswered.items()}
    *others, last = (
        f"{float(at_most(100 * error)):,g} % with {engine}{without.get(engine, '')}" for engine, error in ordered
    )
    told = f"{', '.join(others)} and {last}" if others else last
    left = dict.fromkeys(row["engine"] for row in rows if row["engine"] not in worst)
    off = max(abs(one) for row in result.findings["plates"] for one in row.get("deviations", ()))
    counted = f"Not counted: {', '.join(left)}." if left else "Every engine's conversion held."
    return (
        f"Over five scenes under their weight the largest error is {told}. Plate frequencies are within "
        f"{at_most(100 * off)} % of Ritz's method. {counted}"
    )
