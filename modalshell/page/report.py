"""What printable reports share: the HTML document, its tables and pictures, and values of scenes as text."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from modalshell.shell import Shell

Rows = Sequence[Sequence[str]]

_STYLE = """
@page { size: A4; margin: 13mm; }
body { font: 10.5pt/1.4 system-ui, sans-serif; color: #222; background: #fff; }
body { max-width: 52rem; margin: 1rem auto; padding: 0 1rem; }
h1 { font-size: 1.5em; margin: 0.2em 0; } h2 { font-size: 1.1em; margin: 1em 0 0.3em; break-after: avoid; }
img { width: 100%; } figure { margin: 0; break-inside: avoid; } figcaption { color: #555; font-size: 0.9em; }
table { border-collapse: collapse; width: 100%; break-inside: avoid; }
td { border-bottom: 1px solid #ddd; padding: 0.15em 0.4em; vertical-align: top; overflow-wrap: anywhere; }
td:first-child { width: 34%; color: #444; }
.data { overflow-x: auto; } .data table { break-inside: auto; font-size: 0.85em; } .data tr { break-inside: avoid; }
.data td, .data td:first-child { width: auto; color: inherit; overflow-wrap: normal; }
th { border-bottom: 2px solid #999; padding: 0.15em 0.4em; text-align: left; vertical-align: bottom; }
pre { font-size: 8pt; line-height: 1.25; background: #f6f6f6; padding: 0.6em; white-space: pre-wrap; columns: 2; }
@media print { body { margin: 0; padding: 0; max-width: none; } .data { overflow: visible; } }
@media (max-width: 640px) { pre { columns: 1; } }
"""


def document(title: str, parts: Iterable[str]) -> str:
    """One HTML file under a heading, printable on A4, that loads nothing from elsewhere."""
    body = "\n".join(parts)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}: report</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{html.escape(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{html.escape(text)}</p>"


def sentence(text: str) -> str:
    """A message as a sentence of its own; "" without one."""
    return f"{text[0].upper()}{text[1:].rstrip('.')}." if text else ""


def section(heading: str, content: str) -> str:
    """A heading and what stands below it."""
    return f"<h2>{html.escape(heading)}</h2>\n{content}"


def listing(text: str) -> str:
    """The text of a file as it is."""
    return f"<pre>{html.escape(text)}</pre>"


def table(rows: Rows) -> str:
    """Rows of cells, the first of each a name."""
    return f"<table>{_lines(rows)}</table>"


def data_table(heading: Sequence[str], rows: Rows) -> str:
    """Rows of values under a heading, which is printed again on every page; it scrolls where it is too wide."""
    names = "".join(f"<th>{html.escape(name)}</th>" for name in heading)
    return f'<div class="data"><table><thead><tr>{names}</tr></thead>{_lines(rows)}</table></div>'


def _lines(rows: Rows) -> str:
    return "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows)


def figure(png: bytes, alt: str, words: str) -> str:
    """A picture, a PNG file, with a caption."""
    data = base64.b64encode(png).decode("ascii")
    return (
        f'<figure><img alt="{html.escape(alt)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{html.escape(words)}</figcaption></figure>"
    )


def shell_numbers(shell: Shell) -> dict[str, Any]:
    """Mesh and mass of a shell, in the units of its scene."""
    mesh = shell.mesh
    return {
        "mesh": {
            "vertices": len(mesh.vertices),
            "triangles": len(mesh.faces),
            "extent": np.ptp(mesh.vertices, axis=0).tolist(),
            "area": float(mesh.face_areas.sum()),
            "held": int(shell.unknowns.supported.sum()),
        },
        "mass": float(shell.mass.sum()),
    }


def shell_rows(numbers: Mapping[str, Any], scene: Mapping[str, Any], of: Callable[[str], str]) -> Rows:
    """The lines of a shell, from its numbers and its scene's tables; ``of`` gives the unit of a quantity."""
    mesh = numbers["mesh"]
    return [
        ("Mesh", f"{mesh['vertices']:,} vertices, {mesh['triangles']:,} triangles"),
        ("Extent", f"{vector(mesh['extent'])} {of('m')}"),
        ("Area, mass", f"{mesh['area']:.5g} {of('m')}², {numbers['mass']:.5g} {of('kg')}"),
        (
            "Units",
            f"{of('m')}, {of('kg')}, {of('s')}, and so {of('N')}, {of('Pa')}: of the numbers below, as in the scene",
        ),
        ("Material", plain(scene["material"])),
        ("Supports", f"{mesh['held']} vertices: {plain(scene.get('supports'))}"),
        ("Loads", plain(scene.get("loads"))),
        ("Model", plain(scene.get("model"))),
    ]


def made_rows(command: str, record: Mapping[str, Any], digests: Mapping[str, str]) -> Rows:
    """How a result was made: the command, the time and the versions of its record, the digests of scene and mesh."""
    versions = record.get("versions", {})
    return [
        ("Command", command),
        ("Computed", str(record.get("made", "unknown"))),
        ("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        *((f"{name.capitalize()}, SHA-256", digests[name]) for name in ("scene", "mesh")),
    ]


def plain(value: Any) -> str:
    """A table of a scene as text, without what is not set."""
    if value is None:
        return "none"
    if isinstance(value, dict):
        given = {key: one for key, one in value.items() if not (one is None or one is False or one in ([], (), {}))}
        parts = {key: plain(one) for key, one in given.items()}
        return "; ".join(f"{key} {text}" if key != "entries" else text for key, text in parts.items())
    if isinstance(value, list | tuple):
        if all(isinstance(one, int | float) for one in value):
            return vector(value)
        texts = [plain(one) for one in value]
        return "; ".join(text if text.startswith("(") else f"({text})" for text in texts)
    return f"{value:g}" if isinstance(value, float) else str(value)


def vector(values: Iterable[float]) -> str:
    """A few numbers in brackets; what is rounding next to the largest is 0."""
    return f"({', '.join(f'{value:.4g}' for value in near_zero(values))})"


def near_zero(values: Iterable[float]) -> list[float]:
    """The numbers, with 0 for those that are rounding next to the largest."""
    listed = list(values)
    least = 1e-9 * max((abs(value) for value in listed), default=0.0)
    return [value if abs(value) > least else 0.0 for value in listed]
