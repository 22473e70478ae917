"""The report on a run as one printable HTML file."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.models.base.model import NO_POTENTIAL
from modalshell.motion import Trajectory
from modalshell.render import Picture, ShadedSurface, View
from modalshell.run.report_numbers import load_arrows
from modalshell.run.results import DISPLACEMENT, Colouring
from modalshell.scene import ShellScene
from modalshell.shell import Shell

_MOST_ARROWS = 80
"""Arrows of the load in a picture."""
_STYLE = """
@page { size: A4; margin: 13mm; }
body { font: 10.5pt/1.4 system-ui, sans-serif; color: #222; background: #fff; }
body { max-width: 52rem; margin: 1rem auto; padding: 0 1rem; }
h1 { font-size: 1.5em; margin: 0.2em 0; } h2 { font-size: 1.1em; margin: 1em 0 0.3em; }
img { width: 100%; } figure { margin: 0; break-inside: avoid; } figcaption { color: #555; font-size: 0.9em; }
table { border-collapse: collapse; width: 100%; break-inside: avoid; }
td { border-bottom: 1px solid #ddd; padding: 0.15em 0.4em; vertical-align: top; overflow-wrap: anywhere; }
td:first-child { width: 34%; color: #444; }
pre { font-size: 8pt; line-height: 1.25; background: #f6f6f6; padding: 0.6em; white-space: pre-wrap; columns: 2; }
@media print { body { margin: 0; padding: 0; max-width: none; } }
@media (max-width: 640px) { pre { columns: 1; } }
"""


def report_page(
    scene: ShellScene, shell: Shell, run: Trajectory, record: dict[str, Any], numbers: dict[str, Any]
) -> str:
    """The HTML of a report, from the numbers of :func:`modalshell.run.report_numbers.report_numbers`."""
    of = run.units.of
    rows = _answer_rows(numbers, of)
    versions = record.get("record", {}).get("versions", {})
    material = scene.material.plain()
    parts = [
        f"<h1>{html.escape(scene.name)}</h1>",
        f"<p>{html.escape(_headline(scene, numbers, of('s')))}</p>",
        _figure(scene, shell, run),
        "<h2>Answer</h2>",
        _table(rows),
        "<h2>Shell</h2>",
        _table(
            [
                ("Mesh", f"{numbers['mesh']['vertices']:,} vertices, {numbers['mesh']['triangles']:,} triangles"),
                ("Extent", f"{_vector(numbers['mesh']['extent'])} {of('m')}"),
                ("Area, mass", f"{numbers['mesh']['area']:.5g} {_squared(of('m'))}, {numbers['mass']:.5g} {of('kg')}"),
                ("Material", _plain(material)),
                ("Supports", f"{numbers['mesh']['held']} vertices: {_plain(record_part(record, 'supports'))}"),
                ("Loads", _plain(record_part(record, "loads"))),
                ("Model", _plain(record_part(record, "model"))),
            ]
        ),
    ]
    if "convergence" in numbers:
        parts += ["<h2>Coarser meshes</h2>", _convergence_table(numbers["convergence"], of)]
    parts += [
        "<h2>How it was made</h2>",
        _table(
            [
                ("Command", numbers["command"]),
                ("Computed", str(record.get("record", {}).get("made", "unknown"))),
                ("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
                ("Scene, SHA-256", record["identity"]["scene"]),
                ("Mesh, SHA-256", record["identity"]["mesh"]),
            ]
        ),
        "<h2>Scene file</h2>",
        f"<pre>{html.escape(scene.file.read_text(encoding='utf-8'))}</pre>",
    ]
    body = "\n".join(parts)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(scene.name)}: report</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n{body}\n"
        "</body>\n</html>\n"
    )


def _headline(scene: ShellScene, numbers: dict[str, Any], second: str) -> str:
    """What was computed, by which model, and how it ended."""
    kind = "Equilibrium" if scene.motion is None else f"Motion of {numbers['duration']:.4g} {second}"
    remark = (
        f" {numbers['message'][0].upper()}{numbers['message'][1:]}."
        if numbers["message"] not in ("", NO_POTENTIAL)
        else ""
    )
    return f"{kind} by {scene.model.spec.name}: {numbers['outcome']}.{remark}"


def _answer_rows(numbers: dict[str, Any], of: Any) -> list[tuple[str, str]]:
    """The lines of the answer."""
    length, moved, stress = of("m"), numbers["displacement"], numbers["stress"]

    def where(one: dict[str, Any]) -> str:
        when = f", at {one['time']:.4g} {of('s')}" if numbers["frames"] > 1 else ""
        return f"at {_vector(one['place'])} {length}{when}"

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
            f"{contact['vertices']} vertices touch, force {_vector(contact['force'])} {of('N')}; "
            f"deepest of all frames {contact['deepest']:.2g} {length}",
        ))  # fmt: skip
    if numbers["load"] is not None:
        rows += [
            ("Resultant of the load", f"{_vector(numbers['load'])} {of('N')}"),
            ("Resultant of the reactions", f"{_vector(numbers['reactions'])} {of('N')}"),
            ("Missing to their balance", f"{100 * numbers['balance']:.2g} % of the load"),
        ]
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
    return _table([*lines, ("Change by the last step", *changes)])


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
    if (needles := _needles(x, force, 0.12 * size)) is not None:
        surfaces.append(ShadedSurface(*needles, color="#c8322b"))
    look: dict[str, Any] = {"colormap": shown.colormap, "scalar_range": shown.spread(len(run.times) - 1)}
    picture = Picture.of_views([View(surfaces)], size=(1200, 640), **look)
    words = (
        f"At its end, coloured by {shown.label}, over the outline at rest; black: supports; red: the load's direction."
    )
    alt = f"The shell coloured by {shown.label}"
    return (
        f'<figure><img alt="{html.escape(alt)}" src="data:image/png;base64,{picture.base64}">'
        f"<figcaption>{html.escape(words)}</figcaption></figure>"
    )


def _beads(points: Array, radius: float) -> tuple[Array, NDArray[np.int64]]:
    """An octahedron at each point."""
    corners = radius * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    sides = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    faces = sides + 6 * np.arange(len(points))[:, None, None]
    return (points[:, None] + corners).reshape(-1, 3), faces.reshape(-1, 3)


def _needles(points: Array, force: Array, length: float) -> tuple[Array, NDArray[np.int64]] | None:
    """Slim pyramids that end at the points where the largest forces act; None without a force."""
    size = np.linalg.norm(force, axis=1)
    if not size.max() > 0.0:
        return None
    chosen = np.flatnonzero(size > 0.05 * size.max())
    chosen = chosen[:: -(-len(chosen) // _MOST_ARROWS)]
    along = force[chosen] / size[chosen, None]
    helper = np.where(np.abs(along[:, [2]]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(along, helper)
    side /= np.linalg.norm(side, axis=1)[:, None]
    other, reach = np.cross(along, side), length * np.sqrt(size[chosen] / size.max())[:, None]
    tails, thick = points[chosen] - reach * along, 0.09 * reach
    corners = np.stack([points[chosen], tails + thick * side, tails + thick * other, tails - thick * (side + other)], 1)
    sides = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    return corners.reshape(-1, 3), (sides + 4 * np.arange(len(chosen))[:, None, None]).reshape(-1, 3)


def record_part(record: dict[str, Any], name: str) -> Any:
    """A table of the scene as the run's record keeps it."""
    return record.get("record", {}).get("parameters", {}).get(name)


def _plain(value: Any) -> str:
    """A table of a scene as text, without what is not set."""
    if value is None:
        return "none"
    if isinstance(value, dict):
        parts = {key: _plain(inner) for key, inner in value.items() if inner not in (None, [], {}, False)}
        return "; ".join(f"{key} {text}" if key != "entries" else text for key, text in parts.items())
    if isinstance(value, list):
        if all(isinstance(one, int | float) for one in value):
            return _vector(value)
        return "; ".join(f"({_plain(one)})" for one in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _squared(unit: str) -> str:
    """A unit of area."""
    return f"{unit}²"


def _vector(values: Iterable[float]) -> str:
    """A few numbers in brackets; what is rounding next to the largest is 0."""
    listed = list(values)
    least = 1e-9 * max((abs(value) for value in listed), default=0.0)
    return f"({', '.join(f'{value:.4g}' if abs(value) > least else '0' for value in listed)})"


def _stress(value: float, unit: str) -> str:
    """A stress in the unit of the scene; pascals by the thousand, million or billion."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if unit == "Pa" and value >= factor:
            return f"{value / factor:.5g} {prefix}Pa"
    return f"{value:.5g} {unit}"


def _table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells."""
    lines = ("".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in rows)
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"
