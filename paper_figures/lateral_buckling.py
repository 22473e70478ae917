"""Critical loads of strips over their width, one panel a Poisson's ratio (reads the study ``lateral_buckling``)."""

from __future__ import annotations

from pathlib import Path

from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from paper_figures.energy_colors import COLORS


def draw(results: Path, folder: Path) -> Path:
    """Draw from the result in ``results`` into ``folder``; return the PNG's path."""
    rows = [row for row in StudyResult.load(results, "lateral_buckling").findings["rows"] if row["found"] is not None]
    panels = []
    for poisson in dict.fromkeys(row["poisson"] for row in rows):
        curves = []
        for energy, families in COLORS.items():
            for family, color in families.items():
                wanted = (poisson, "clamp", energy, family)
                own = [r for r in rows if (r["poisson"], r["support"], r["energy"], r["mesh"]) == wanted]
                if own:
                    label = f"{energy}, {family}"
                    curves.append(Curve([r["width"] for r in own], [r["found"] for r in own], label, color))
        ended = [r for r in rows if (r["poisson"], r["support"]) == (poisson, "beam end")]
        ended = [r for r in ended if r["mesh"] == ended[0]["mesh"]]
        label = f"Isotropic, beam end, {ended[0]['mesh']}"
        curves.append(Curve([r["width"] for r in ended], [r["found"] for r in ended], label, "#2f9e6b"))
        first = [r for r in rows if r["poisson"] == poisson]
        widths = list(dict.fromkeys(r["width"] for r in first if r["gamma"] is not None))
        exact = [next(r["gamma"] for r in first if r["width"] == width) for width in widths]
        curves.append(Curve(widths, exact, "finite elements", "black", dashed=True))
        ends = [min(r["width"] for r in first), max(widths)]
        curves.append(Curve(ends, [first[0]["narrow"]] * 2, "narrow strip", "0.5", dashed=True, points=False))
        panels.append(Panel(curves, f"Poisson's ratio {poisson:g}", "width [L]", "critical gravity Γ"))
    return draw_curves(panels, folder / "lateral_buckling.png")
