"""Motions drawn by a seed: errors over time, and errors against costs of all models (reads ``blind_motions``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves

_TOLERANCE, _LEAST, _MOST = 5.0, 0.01, 1000.0
"""The error allowed, and the ends of the axes [%]: what lies beyond is drawn there."""
_GREY, _AUTO = "0.5", "#1f8a4c"


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = [row for row in StudyResult.load(results, "blind_motions").findings["rows"] if row["models"]]
    panels = [_over_time(rows), _against_cost(rows)]
    return draw_curves(panels, folder / "blind_motions.png")


def _over_time(rows: list[dict[str, Any]]) -> Panel:
    """One motion in which the alarm of MWTS comes, ``auto`` holds, and has moved longest by MWTS before."""
    warned = [
        row
        for row in rows
        if None not in (row["models"]["mwts"]["passes"], row["models"]["mwts"]["alarm"])
        and 100.0 * row["models"]["auto"]["worst"] <= _TOLERANCE
    ]
    row = max(warned or rows, key=lambda one: one["models"]["auto"]["levels"].count("MWTS"))
    cheap, auto = row["models"]["mwts"], row["models"]["auto"]
    frames = list(range(len(cheap["errors"])))
    curves = [
        Curve([0, frames[-1]], [_TOLERANCE] * 2, "5 %, asked", _GREY, dashed=True, points=False),
        Curve(frames, _percent(cheap["errors"]), "MWTS", models()["mwts"].color, points=False),
        Curve(frames, _percent(auto["errors"]), "auto", _AUTO, points=False),
    ]
    if cheap["alarm"] is not None:
        curves.append(
            Curve([cheap["alarm"]] * 2, [_LEAST, _MOST], "alarm of the bar on MWTS", "0.2", dashed=True, points=False)
        )
    title = row["text"].split(",")[0].capitalize() + ", one motion"
    return Panel(curves, title, "frame", f"error [%], {_LEAST:g} at least", log=True)


def _against_cost(rows: list[dict[str, Any]]) -> Panel:
    """The worst error of every model in every motion against its cost."""
    curves = [Curve([3e-4, 3.0], [_TOLERANCE] * 2, "5 %, asked", _GREY, dashed=True, points=False)]
    known = models()
    for spec in (known["mwts"], known["rsw"], known["md-rom"], known["auto"]):
        key, color = spec.key, _AUTO if spec.key == "auto" else spec.color
        costs = [row["models"][key]["cost"] / row["models"]["ds"]["cost"] for row in rows]
        errors = _percent([row["models"][key]["worst"] for row in rows])
        curves.append(Curve(costs, errors, spec.name, color, joined=False))
    label = f"largest error [%], {_LEAST:g} at least"
    return Panel(curves, f"{len(rows)} motions", "work over that of DS", label, log=True, log_x=True)


def _percent(errors: list[float]) -> list[float]:
    return [min(max(100.0 * error, _LEAST), _MOST) for error in errors]
