"""The report on an equilibrium path: its numbers, and the printable page of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from modalshell.analysis.paths import EquilibriumPath
from modalshell.core.units import UnitSystem
from modalshell.files.provenance import run_record
from modalshell.page.report import (
    data_table,
    document,
    figure,
    listing,
    made_rows,
    near_zero,
    paragraph,
    plain,
    section,
    sentence,
    shell_numbers,
    shell_rows,
    table,
)
from modalshell.scene import ShellScene
from modalshell.shell import Shell

_ROWS = 24
"""Points of a path that its printed table names, and those at which something happens; the file has all."""
_DIGITS = ".5g"


def path_numbers(scene: ShellScene, shell: Shell, path: EquilibriumPath) -> dict[str, Any]:
    """All numbers of a report on a path, in the units of the scene.

    Keys: ``mesh``, ``mass``, ``outcome``, ``message``, ``path`` (the declared table), ``paths`` and ``record``. Each of
    ``paths``, the path itself and its branches, has ``name``, ``leaves`` (the point of the first that a branch leaves),
    ``count`` of ``points``, the ``factors``, ``displacements``, ``unstable_directions`` and ``residuals`` of these,
    ``events`` with ``kind``, ``point``, ``factor`` and ``displacement``, and ``parts`` of equal stability, in order.
    """
    followed = [("path", path), *((f"branch {n}", one) for n, one in enumerate(path.branches, start=1))]
    return {
        **shell_numbers(shell),
        "outcome": path.outcome,
        "message": path.message,
        "path": {} if scene.path is None else scene.path.plain(),
        "paths": [_numbers_of(name, one) for name, one in followed],
        "record": run_record(scene.content()) | scene.digests(shell.mesh),
    }


def _numbers_of(name: str, path: EquilibriumPath) -> dict[str, Any]:
    """The numbers of one path."""
    displacements, unstable = path.displacements.tolist(), path.unstable_directions.tolist()
    parts = []
    for count, points in groupby(range(len(unstable)), key=unstable.__getitem__):
        inside = list(points)
        begin, end = float(path.factors[inside[0]]), float(path.factors[inside[-1]])
        parts.append({"unstable_directions": count, "points": len(inside), "from": begin, "to": end})
    return {
        "name": name,
        "leaves": path.parent,
        "count": len(unstable),
        "points": list(range(len(unstable))),
        "factors": path.factors.tolist(),
        "displacements": displacements,
        "unstable_directions": unstable,
        "residuals": path.residuals.tolist(),
        "events": [
            {"kind": kind, "point": point, "factor": float(factor), "displacement": displacements[point]}
            for kind, point, factor in path.events
        ],
        "parts": parts,
    }


def path_page(scene: ShellScene, numbers: Mapping[str, Any], pictures: Sequence[Path], units: UnitSystem) -> str:
    """The HTML of a report on a path, from its numbers and the PNG files of its curve and of its shapes."""
    of, paths, record = units.of, numbers["paths"], numbers["record"]
    words = (
        "Load factor over the watched displacement; stable parts solid, unstable ones dashed.",
        "Shapes at the beginning, where something happens, and at the end, with their load factors.",
    )
    alts = ("The load-deflection curve", "The shell along the path")
    figures = [figure(file.read_bytes(), alt, text) for file, alt, text in zip(pictures, alts, words, strict=False)]
    made = made_rows(numbers["command"], record, record)
    happened = [(one["name"], event) for one in paths for event in one["events"]]
    events = data_table(
        ("", "Event", "Point", "Load factor", f"Displacement [{of('m')}]"),
        [
            (name, event["kind"], str(event["point"]), f"{event['factor']:.6g}", f"{event['displacement']:.6g}")
            for name, event in happened
        ],
    )
    return document(
        f"{scene.name}: equilibrium path",
        [
            paragraph(_headline(scene, numbers)),
            *figures,
            section("Events", events if happened else paragraph("No limit point and no bifurcation.")),
            section("Stability", data_table(("", "Load factors", "Points", "Unstable directions"), _parts(paths))),
            section("Curves", _curves(paths, of("m"))),
            section("Shell", table(shell_rows(numbers, record["parameters"], of))),
            section("How it was made", table([("Path", plain(numbers["path"]) or "by default"), *made])),
            section("Scene file", listing(scene.file.read_text(encoding="utf-8"))),
        ],
    )


def _headline(scene: ShellScene, numbers: Mapping[str, Any]) -> str:
    """What was followed, by which model, and how it ended."""
    first = numbers["paths"][0]
    remark = sentence(numbers["message"])
    branches = len(numbers["paths"]) - 1
    also = f", and {branches} {'branches' if branches > 1 else 'branch'}" if branches else ""
    return (
        f"Equilibria by {scene.model.spec.name} under the load times a factor: {numbers['outcome']}, "
        f"{first['count']} points, factors {min(first['factors']):{_DIGITS}} to "
        f"{max(first['factors']):{_DIGITS}}{also}. {remark}".rstrip()
    )


def _parts(paths: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """A line for each part of equal stability."""
    return [
        (
            one["name"],
            f"{part['from']:{_DIGITS}} to {part['to']:{_DIGITS}}",
            str(part["points"]),
            str(part["unstable_directions"]) if part["unstable_directions"] else "none: stable",
        )
        for one in paths
        for part in one["parts"]
    ]


def _curves(paths: Sequence[Mapping[str, Any]], length: str) -> str:
    """Points of all paths, evenly chosen where there are many, and all at which something happens."""
    rows = []
    for one in paths:
        count, events = one["count"], {event["point"]: event["kind"] for event in one["events"]}
        moved = near_zero(one["displacements"])
        even = np.linspace(0, count - 1, min(count, _ROWS)).round().astype(int).tolist()
        for point in sorted({*even, *events}):
            place = (str(point), f"{one['factors'][point]:{_DIGITS}}", f"{moved[point]:{_DIGITS}}")
            cells = (*place, str(one["unstable_directions"][point]), events.get(point, ""))
            rows.append((one["name"], *cells))
    heading = ("", "Point", "Load factor", f"Displacement [{length}]", "Unstable directions", "")
    return data_table(heading, rows)
