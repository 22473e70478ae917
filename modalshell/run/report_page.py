"""The report on a run as one printable HTML file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.models.base.model import NO_POTENTIAL
from modalshell.motion import Trajectory
from modalshell.motion.colouring import DISPLACEMENT, Colouring
from modalshell.page.report import (
    document,
    figure,
    listing,
    made_rows,
    paragraph,
    section,
    sentence,
    shell_rows,
    table,
    vector,
)
from modalshell.render import Picture, ShadedSurface, View
from modalshell.render.content import DEFAULT_CAMERA
from modalshell.run.report_numbers import load_arrows
from modalshell.scene import ShellScene
from modalshell.shell import Shell

_MOST_ARROWS = 80
"""Arrows of the load in a picture."""


def report_page(
    scene: ShellScene, shell: Shell, run: Trajectory, record: dict[str, Any], numbers: dict[str, Any]
) -> str:
    """The HTML of a report, from the numbers of :func:`modalshell.run.report_numbers.report_numbers`."""
    of = run.units.of
    stored = record.get("record", {})
    declared = stored.get("parameters", {}) | {"material": scene.material.plain()}
    made = made_rows(numbers["command"], stored, record["identity"])
    parts = [
        paragraph(_headline(scene, numbers, of("s"))),
        _figure(scene, shell, run),
        section("Answer", table(_answer_rows(numbers, of))),
        section("Shell", table(shell_rows(numbers, declared, of))),
    ]
    if "convergence" in numbers:
        parts.append(section("Coarser meshes", _convergence_table(numbers["convergence"], of)))
    parts += [
        section("How it was made", table(made)),
        section("Scene file", listing(scene.file.read_text(encoding="utf-8"))),
    ]
    return document(scene.name, parts)


def _headline(scene: ShellScene, numbers: dict[str, Any], second: str) -> str:
    """What was computed, by which model, and how it ended."""
    kind = "Equilibrium" if scene.motion is None else f"Motion of {numbers['duration']:.4g} {second}"
    remark = "" if numbers["message"] == NO_POTENTIAL else sentence(numbers["message"])
    return f"{kind} by {scene.model.spec.name}: {numbers['outcome']}. {remark}".rstrip()


def _answer_rows(numbers: dict[str, Any], of: Any) -> list[tuple[str, str]]:
    """The lines of the answer."""
    length, moved, stress = of("m"), numbers["displacement"], numbers["stress"]

    def where(one: dict[str, Any]) -> str:
        when = f", at {one['time']:.4g} {of('s')}" if numbers["frames"] > 1 else ""
        return f"at {vector(one['place'])} {length}{when}"

    if stress is None:
        stressed = "none: stresses need a material of shell theory"
    else:
        stressed = f"{_stress(stress['value'], of('Pa'))} {where(stress)}, on the face {stress['side']}"
    rows = [
        ("Largest displacement", f"{moved['value']:.5g} {length} {where(moved)}"),
        ("Largest von Mises stress", stressed),
    ]
    if numbers["bar"] is not None:
        rows.append(("Error bar", f"{numbers['bar']} on the same mesh"))
    if (contact := numbers.get("contact")) is not None:
        rows.append((
            "Contact, in the last frame",
            f"{contact['vertices']} vertices touch, force {vector(contact['force'])} {of('N')}; "
            f"deepest of all frames {contact['deepest']:.2g} {length}",
        ))  # fmt: skip
    if (folds := numbers.get("creases")) is not None:
        rows.append((
            "Creases, in the last frame",
            f"{folds['yielded']} of {folds['edges']} edges have yielded; largest fold that stays "
            f"{math.degrees(folds['largest']):.4g}°, heat {folds['heat']:.4g} {of('J')}",
        ))  # fmt: skip
    if numbers["load"] is not None:
        answer = numbers["reactions"]
        rows += [
            ("Resultant of the load", f"{vector(numbers['load'])} {of('N')}"),
            ("Resultant of the reactions", answer if isinstance(answer, str) else f"{vector(answer)} {of('N')}"),
        ]
        if numbers["balance"] is not None:
            rows.append(("Missing to their balance", f"{100 * numbers['balance']:.2g} % of the load"))
    found = numbers["frequencies"]
    shown = found if isinstance(found, str) else ", ".join(f"{value:.4g}" for value in found) + f" {of('1/s')}"
    rows.append(("Natural frequencies at rest", shown.replace("1/s", "Hz")))
    if numbers["buckling"] is not None:
        factor = numbers["buckling"]
        rows.append(
            ("Buckling, linear theory", factor if isinstance(factor, str) else f"at {factor:.4g} times the load")
        )
    if numbers["warnings"]:
        rows.append(("Warnings", "; ".join(numbers["warnings"])))
    return rows


def _convergence_table(rows: Sequence[dict[str, Any]], of: Any) -> str:
    """Displacement and stress on each mesh, and how much the last step has changed them."""
    lines = [("Cells", f"Largest displacement [{of('m')}]", f"Largest stress [{of('Pa')}]")]
    for row in rows:
        stress = "none" if row["stress"] is None else f"{row['stress']:.5g}"
        lines.append((" x ".join(map(str, row["cells"])), f"{row['displacement']:.5g}", stress))
    last, before = rows[-1], rows[-2]
    changes = [
        f"{100 * abs(last[name] / before[name] - 1):.2g} %" if last[name] and before[name] else "none"
        for name in ("displacement", "stress")
    ]
    return table([*lines, ("Change by the last step", *changes)])


def _figure(scene: ShellScene, shell: Shell, run: Trajectory) -> str:
    """The shell at its end, in colours, over its outline at rest, with supports and loads."""
    x = np.asarray(run.positions[-1], dtype=np.float64)
    color = scene.output.color or ("von_mises" if "von_mises" in run.fields else DISPLACEMENT)
    shown = Colouring.of(run, color)
    size = shell.mesh.size
    surfaces = [
        ShadedSurface(x, run.faces, smooth=True, scalars=shown.values[-1], label=shown.label),
        ShadedSurface(run.rest_positions, run.faces, color="#999999", style="outline"),
    ]
    held = np.flatnonzero(shell.unknowns.supported)
    if len(held):
        surfaces.append(ShadedSurface(*_beads(x[held], 0.008 * size), color="#222222"))
    force = load_arrows(scene, shell, x)
    if (needles := _needles(x, force, 0.12 * size, DEFAULT_CAMERA)) is not None:
        surfaces.append(ShadedSurface(*needles, color="#c8322b"))
    look: dict[str, Any] = {"colormap": shown.colormap, "scalar_range": shown.spread(len(run.times) - 1)}
    picture = Picture.of_views([View(surfaces)], size=(1200, 640), **look)
    words = (
        f"At its end, coloured by {shown.label}, over the outline at rest; black: supports; red: the load's direction."
    )
    return figure(picture.data, f"The shell coloured by {shown.label}", words)


def _beads(points: Array, radius: float) -> tuple[Array, NDArray[np.int64]]:
    """An octahedron at each point."""
    corners = radius * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    sides = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    faces = sides + 6 * np.arange(len(points))[:, None, None]
    return (points[:, None] + corners).reshape(-1, 3), faces.reshape(-1, 3)


def _needles(
    points: Array, force: Array, length: float, camera: Sequence[float]
) -> tuple[Array, NDArray[np.int64]] | None:
    """Slim pyramids along the largest forces; None without a force.

    They end at the points where the forces act, or begin there where the shell would hide them from the ``camera``.
    """
    size = np.linalg.norm(force, axis=1)
    if not size.max() > 0.0:
        return None
    chosen = _spread(points, np.flatnonzero(size > 0.05 * size.max()))
    along = force[chosen] / size[chosen, None]
    helper = np.where(np.abs(along[:, [2]]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(along, helper)
    side /= np.linalg.norm(side, axis=1)[:, None]
    other, reach = np.cross(along, side), length * np.sqrt(size[chosen] / size.max())[:, None]
    thick = 0.09 * reach
    tips = points[chosen] + np.where(along @ np.asarray(camera) > 0.0, 1.0, 0.0)[:, None] * reach * along
    tails = tips - reach * along
    corners = np.stack([tips, tails + thick * side, tails + thick * other, tails - thick * (side + other)], 1)
    sides = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    return corners.reshape(-1, 3), (sides + 4 * np.arange(len(chosen))[:, None, None]).reshape(-1, 3)


def _spread(points: Array, among: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most as many of the points (n, 3) as a picture takes arrows, one per cube of a grid."""
    apart = float(np.ptp(points, axis=0).max()) / _MOST_ARROWS
    while len(among) > _MOST_ARROWS:
        cubes = np.floor((points[among] - points.min(axis=0)) / apart).astype(np.int64)
        among = among[np.sort(np.unique(cubes, axis=0, return_index=True)[1])]
        apart *= 1.2
    return among


def _stress(value: float, unit: str) -> str:
    """A stress in the unit of the scene; pascals by the thousand, million or billion."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if unit == "Pa" and value >= factor:
            return f"{value / factor:.5g} {prefix}Pa"
    return f"{value:.5g} {unit}"
