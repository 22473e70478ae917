"""Is the advice right? Random scenes, and loads at which nothing was measured for it.

Shapes, materials, loads, and the error asked for are drawn from a seed; ten more shells, folded strips and shallow
panels, are loaded beyond the load at which they snap; twelve further ones, of edge springs and hinges or of shell
theory, were drawn after the advice was made, and one on which it was once 74 % off is the last. For each scene
``advise`` names a rung; it is right if at loads between its own, some of them 0.1, 1 and 5 % away from a snap, the rung
meets the asked error against DS solved again from rest, and no rung with a cheaper frame (by more than a near tie)
does. Loads next to a snap for which the advice says itself that the rung does not serve are left out, if they are at
most 1 % of the load. Where it names none, none must meet both demands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.advice_text import NEAR_TIE, RATE_MARGIN
from modalshell.compare.advise import choose
from modalshell.compare.case import Case
from modalshell.compare.path import Marks
from modalshell.compare.report import percent
from modalshell.compare.runs import answer_error
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.models import CoarseMesh
from modalshell.models.coarse.coarse_mesh import drawn_to_supports
from modalshell.models.registry import TRUTH, models
from studies.pages import counted, markdown, paragraphs, result_of

FIGURES = ("held_out_advice",)

SEED = 7
SCENES, SNAPPING = 20, 10
FURTHER, FURTHER_SEED, ONCE_WRONG = 12, 33, 8
"""Further shells that snap, their seed, and the place of one more of the first seed, on which advice was once wrong."""
FRAMES_PER_SECOND, OF_THEORY = 60.0, 6.0
"""Frame rates asked for [1/s]: of edge springs and hinges, and of shell theory, whose steps are dearer."""
ERRORS = (0.02, 0.05, 0.1)
"""Asked errors, one of which is drawn for each scene."""
HELD_OUT = (0.31, 0.6, 0.87, 0.97)
"""Shares of the load at which the advice is checked."""
AROUND_SNAP = (0.95, 0.99, 0.999, 1.001, 1.01, 1.05)
"""Further ones, over the load of the snap."""
Draw = tuple[int, int, Callable[[np.random.Generator, str], tuple[Case, float, tuple[float, ...]]]]
"""Seed, place and kind of a scene."""
WIDEST = 0.01
"""Share of the load, next to snaps, up to which an advised rung may not serve."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Check the advice on all scenes; ``quick`` takes the first."""
    draws = DRAWS[:1] if quick else DRAWS
    rows: list[dict[str, Any]] = []
    for place, draw in counted(list(enumerate(draws, 1)), on_step):
        case, error, loads = drawn(draw, f"scene {place}")
        rows += checked(case, (error,), loads)
    return result_of("held_out_advice", {"rows": rows}, {"held_out": np.array(HELD_OUT)}, SEED, scenes=len(draws))


def drawn(draw: Draw, name: str) -> tuple[Case, float, tuple[float, ...]]:
    """A scene, the error asked for it, and held-out shares of its load."""
    seed, place, kind = draw
    return kind(np.random.default_rng([seed, place]), name)


def random_case(rng: np.random.Generator, name: str) -> tuple[Case, float, tuple[float, ...]]:
    """A clamped shape under a load whose linear answer moves it by a random share of its length; an error; loads."""
    kind = str(rng.choice(["flat_beam", "v_beam", "leaf", "cylinder_panel"]))
    along, across = int(rng.integers(24, 33)), 2 * int(rng.integers(3, 5))
    width = float(rng.uniform(0.15, 0.4))
    shape: dict[str, Any] = {"length": 1.0}
    if kind == "cylinder_panel":
        shape |= {"radius": 0.5, "angle": float(np.degrees(width / 0.5))}
    else:
        shape["width"] = width
    if kind == "v_beam":
        shape["fold"] = float(rng.uniform(140.0, 175.0))
    make = getattr(ms, kind)

    def mesh(cells: tuple[int, int]) -> ms.TriangleMesh:
        return make(**shape, cells=cells)

    membrane = 10.0 ** rng.uniform(1.3, 3.0)
    fine = mesh((along, across))
    shell = ms.Shell(fine, ms.Material(membrane, membrane, 0.05, 0.2), fine.vertices[:, 0] < 1.5 / along)
    x, y = fine.vertices[:, 0], fine.vertices[:, 1]
    if rng.random() < 0.4:  # a couple on the free end, with a pull
        far = x > x.max() - 0.1
        force = np.where(far[:, None], np.column_stack([0.0 * y, np.full_like(y, rng.uniform(-0.05, 0.05)), y]), 0.0)
    else:
        force = shell.gravity_force((0.0, rng.uniform(-0.5, 0.5), rng.choice([-1.0, 1.0])))
    linear = ms.LinearModal(ms.solve_modes(shell, 16)).equilibrium(force=force).positions
    size = 10.0 ** rng.uniform(-1.7, -0.1)
    load = force * size / float(np.linalg.norm(linear - fine.vertices, axis=1).max())
    coarse = [
        CoarseMesh(drawn_to_supports(shell, mesh(cells)), f"{cells[0]}x{cells[1]}")
        for cells in ((along // 2, 4), (along // 3, 2))
    ]
    details = f"{kind}, {len(x)} vertices, membrane {membrane:.0f}, linear answer {size:.2f} L"
    case = Case(name, shell, load, damping=ms.Damping(0.5, 0.001), coarse=coarse, note=details)
    return case, float(rng.choice(ERRORS)), HELD_OUT


def further_case(rng: np.random.Generator, name: str) -> tuple[Case, float, tuple[float, ...]]:
    """A :func:`snapping_case` of shell theory."""
    return snapping_case(rng, name, theory=True)


def snapping_case(
    rng: np.random.Generator, name: str, *, theory: bool = False
) -> tuple[Case, float, tuple[float, ...]]:
    """A folded strip or a shallow panel under its weight, beyond the load at which it snaps; an error; loads.

    By default of edge springs and hinges; with ``theory`` of shell theory, as stiff in bending.
    """
    folded = rng.random() < 0.6
    along, across = (2 * int(rng.integers(12, 17)), 6) if folded else (2 * int(rng.integers(5, 8)), 16)
    membrane = 10.0 ** (rng.uniform(3.0, 3.5) if folded else rng.uniform(2.0, 2.5))
    shape: dict[str, Any] = {"fold": float(rng.uniform(145.0, 165.0)), "width": 0.2}
    if not folded:
        shape = {"angle": float(rng.uniform(30.0, 45.0))}

    def mesh(cells: tuple[int, int]) -> ms.TriangleMesh:
        return ms.v_beam(length=1.0, cells=cells, **shape) if folded else ms.cylinder_panel(cells=cells, **shape)

    fine = mesh((along, across))
    x, y = fine.vertices[:, 0], np.abs(fine.vertices[:, 1])
    held = x < 1.5 / along if folded else y > y.max() - 1e-9
    material: ms.Material | ms.Isotropic = ms.Material(membrane, membrane, 0.05, 0.2)
    if theory:
        thickness = 10.0 ** rng.uniform(-2.2, -1.8)
        young = 12.0 * 0.91 * 0.05 / thickness**3
        material = ms.Isotropic(young=young, poisson=0.3, thickness=thickness, density=0.2 / thickness)
    shell = ms.Shell(fine, material, held)
    path = ms.equilibrium_path(shell, gravity=(0, 0, -1), until=3000.0, steps=60, branches=1)
    snap = Marks.of(path).snap
    if snap is None:  # drawn again
        return snapping_case(rng, name, theory=theory)
    most = snap * rng.uniform(1.15, 1.7)
    load, around = shell.gravity_force((0.0, 0.0, -most)), tuple(share * snap / most for share in AROUND_SNAP)
    sizes = ((along // 2, 4), (along // 3, 2)) if folded else ((along // 2, 8),)
    coarse = [CoarseMesh(drawn_to_supports(shell, mesh(cells)), f"{cells[0]}x{cells[1]}") for cells in sizes]
    kind = f"v_beam of {shape['fold']:.0f}°" if folded else f"cylinder_panel of {shape['angle']:.0f}°"
    stiffness = f"shell theory, h {thickness:.2g}" if theory else f"membrane {membrane:.0f}"
    details = f"{kind}, {len(x)} vertices, {stiffness}, snaps at a gravity of {snap:.3g}"
    case = Case(name, shell, load, damping=ms.Damping(0.5, 0.001), coarse=coarse, note=details)
    return case, float(rng.choice(ERRORS)), (*HELD_OUT, *around)


DRAWS: list[Draw] = [
    *((SEED, place, random_case) for place in range(SCENES)),
    *((SEED, place, snapping_case) for place in range(SCENES, SCENES + SNAPPING)),
    # Every fourth of shell theory, whose models train longer.
    *((FURTHER_SEED, place, further_case if place % 4 == 3 else snapping_case) for place in range(FURTHER)),
    (SEED, ONCE_WRONG, snapping_case),
]
"""All scenes."""


def checked(case: Case, errors: Sequence[float], shares: tuple[float, ...]) -> list[dict[str, Any]]:
    """The advice on one scene for each asked error, and whether it is right at held-out shares of the load."""
    fps = FRAMES_PER_SECOND if isinstance(case.shell.material, ms.Material) else OF_THEORY
    measured, truth = ms.tradeoff(case), ms.DiscreteShell(case.shell)
    answers = {share: truth.equilibrium(force=share * case.load) for share in shares}
    exact = {share: answer for share, answer in answers.items() if answer.converged}

    @cache
    def error_of(label: str, share: float) -> float:
        """Error of a rung at a held-out share, infinite where it has no answer."""
        row = next(row for row in measured.rows if row.label == label)
        if row.is_truth:
            return 0.0
        assert row.model is not None
        apart = answer_error(row.model.equilibrium(force=share * case.load), exact[share], case.shell)
        return np.inf if apart is None else apart

    common = {"held_out_loads": shares, "truths": len(exact)}
    return [common | judged(choose(measured, error, fps), list(exact), error_of) for error in errors]


def judged(advice: ms.Advice, shares: Sequence[float], error_of: Callable[[str, float], float]) -> dict[str, Any]:
    """An advice, and what is true of it, by the errors of rungs at held-out shares of the load."""
    chosen = advice.chosen
    found = {} if chosen is None else {share: error_of(chosen.label, share) for share in shares}
    missed = {at: apart for at, apart in found.items() if any(low < at < high for low, high in advice.missed_loads)}
    held_out = [apart for at, apart in found.items() if at not in missed]
    width = float(sum(high - low for low, high in advice.missed_loads))
    meets = not held_out or (max(held_out) <= advice.error and width <= WIDEST)
    fast = [row for row in advice.rows if row.frames_per_second >= RATE_MARGIN * advice.frames_per_second]
    cheaper = [row.label for row in fast if chosen is None or NEAR_TIE * row.cost < chosen.cost]
    # Until the first miss: springs, which are far off at most loads, take longest to answer them.
    also = [label for label in cheaper if all(error_of(label, share) <= advice.error for share in shares)]
    return {
        "scene": advice.measured.case.note,
        "error": advice.error,
        "snap": None if advice.snap is None else str(advice.snap),
        "chosen": None if chosen is None else chosen.label,
        "measured_error": None if chosen is None else chosen.worst_error,
        "measured_errors": {row.label: row.worst_error for row in advice.rows},
        "held_out_error": max(held_out, default=None),
        "missed_loads": advice.missed_loads,
        "missed_error": max(missed.values(), default=None),
        "missed_width": width,
        "frames_per_second": None if chosen is None else chosen.frames_per_second,
        "meets": meets,
        "cheaper_that_meet": also,
        "right": meets and not also,
    }


def table(result: StudyResult) -> str:
    """One row per scene, the count, and the loads that the advice itself leaves out."""
    rows = []
    for row in result.findings["rows"]:
        errors = [percent(row[key]) for key in ("measured_error", "held_out_error")]
        cheaper = ", ".join(row["cheaper_that_meet"]) or None
        rows.append({**row, "errors": errors, "snaps": "yes" if row["snap"] else "no", "cheaper": cheaper})
    scenes = markdown(
        "scene | asked | advice | measured | held-out loads | snaps | cheaper rungs that meet it",
        "{scene} | {error:100*g} % | {chosen:|none} | {errors} | {snaps} | {cheaper:|none}",
        rows,
    )
    met, right = sum(row["meets"] for row in rows), sum(row["right"] for row in rows)
    words = f"The rung meets the asked error on {met} of {len(rows)} scenes; on {right} of these no cheaper one does."
    left_out = [
        row
        | {"between": ", ".join(f"{low:.4f} to {high:.4f}" for low, high in row["missed_loads"])}
        | {"there": percent(row["missed_error"])}
        for row in rows
        if row.get("missed_loads")  # runs before advice left out loads have none
    ]
    excluded = markdown(
        "scene | advice | shares of the load that it leaves out next to the snap | error at held-out loads there",
        "{scene} | {chosen} | {between} | {there}",
        left_out,
    )
    return paragraphs(scenes, words, *([excluded] if left_out else []))


def finding(result: StudyResult) -> str:
    """How often the advice is right, and how often it is the truth itself."""
    rows = result.findings["rows"]
    truth = models()[TRUTH].name
    whole = sum(row["chosen"] == truth for row in rows)
    met, right = sum(row["meets"] for row in rows), sum(row["right"] for row in rows)
    return (
        f"At loads that were not measured for it, the advised model meets the asked error on {met} of {len(rows)} "
        f"random scenes; on {right} of these no cheaper model does. On {whole} the advice is {truth} itself."
    )
