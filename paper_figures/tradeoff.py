"""Pareto fronts of the rungs on each scene, and the shapes they find (reads the study ``tradeoff``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.compare.draw import draw_fronts, draw_shapes
from modalshell.files.study_result import StudyResult

SHOWN = ("v_beam", "v_beam_stiff", "leaf_wind", "twisted_strip")
"""Scenes whose shapes are drawn, of those that were run."""


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw from the result in ``results`` into ``folder``; return the PNGs' paths."""
    result = StudyResult.load(results, "tradeoff")
    found, titles = result.findings["scenes"], result.findings["titles"]
    fronts = draw_fronts(list(found.values()), folder / "tradeoff.png", [titles[name] for name in found])
    shown = []
    names = [name for name in SHOWN if name in found]
    for name in names:
        prefix = f"{name}: "
        shapes = {key.removeprefix(prefix): value for key, value in result.arrays.items() if key.startswith(prefix)}
        shown.append((found[name], shapes, result.arrays[f"{name}_faces"]))
    return [fronts, draw_shapes(shown, folder / "tradeoff_shapes.png", [titles[name] for name in names])]
