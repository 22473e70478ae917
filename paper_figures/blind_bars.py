"""Error bars against true errors of shells drawn by a seed (reads the study ``blind_bars``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves

_LEAST, _MOST = 0.01, 300.0
"""Ends of the axes [%]: values outside are drawn at the ends."""
_TRUE = f"true error [%], values outside {_LEAST:g} to {_MOST:g} at the ends"


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = StudyResult.load(results, "blind_bars").findings["rows"]
    valid, void = [row for row in rows if row["valid"]], [row for row in rows if not row["valid"]]
    exact = Curve([_LEAST, _MOST], [_LEAST, _MOST], "_exact", "0.5", dashed=True, points=False)
    certain = _points(valid, "valid bars", "#2b5fc8")
    panels = [
        Panel([exact, certain], "Valid error bars", _TRUE, "error bar [%]", log=True, log_x=True),
        Panel(
            [exact, certain, _points(void, "void: stability margin failed", "#c8322b")],
            "Two Newton steps without the stability margin",
            _TRUE,
            "estimate by two Newton steps [%]",
            log=True,
            log_x=True,
        ),
    ]
    return draw_curves(panels, folder / "blind_bars.png", share_y=True)


def _points(rows: list[dict[str, Any]], label: str, color: str) -> Curve:
    true, bar = ([min(max(100.0 * row[name], _LEAST), _MOST) for row in rows] for name in ("true", "bar"))
    return Curve(true, bar, label, color, joined=False)
