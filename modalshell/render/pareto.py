"""Error over cost: points of several groups and their Pareto front (matplotlib)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import write_atomically
from modalshell.render.curves import literal

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINE = 0.2
"""Height of a line of the legend [inches]."""


@dataclass(frozen=True)
class Mark:
    """One point: cost ``x`` and error ``y``, both positive, its group, a short text, and whether none beats it.

    ``color`` and ``marker`` are the group's.
    """

    x: float
    y: float
    group: str
    text: str
    front: bool = False
    color: str = "0.5"
    marker: str = "h"


@dataclass(frozen=True)
class ParetoPanel:
    """One pair of logarithmic axes."""

    marks: Sequence[Mark]
    """The points."""
    title: str
    x_label: str = "milliseconds per frame"
    y_label: str = "displacement error [%]"
    """Texts."""
    truth: Mark | None = None
    """Cost and name of the truth, whose error is zero: drawn as a line."""


def draw_pareto(panels: Sequence[ParetoPanel], path: str | Path, *, columns: int | None = None) -> Path:
    """Draw panels into a PNG, one legend below all; OptionError for values that are not finite and positive."""
    for panel in panels:
        values = np.array([[mark.x, mark.y] for mark in panel.marks], dtype=float)
        if not values.size or not np.isfinite(values).all() or (values <= 0.0).any():
            raise OptionError(
                f"{panel.title!r} needs points with finite and positive values (got {values.tolist()!r:.80})"
            )
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    across = columns or len(panels)
    rows = -(-len(panels) // across)
    figure = Figure(figsize=(5.6 * across, 4.4 * rows + 0.6), layout="constrained", dpi=150)
    for place, panel in enumerate(panels, start=1):
        _draw_panel(figure.add_subplot(rows, across, place), panel)
    groups = {mark.group: mark for panel in panels for mark in panel.marks}
    entries = [
        Line2D([], [], color=mark.color, marker=mark.marker, ls=":", label=literal(name))
        for name, mark in groups.items()
    ]
    if truth := next((panel.truth for panel in panels if panel.truth), None):
        entries.append(Line2D([], [], color=truth.color, lw=2, label=literal(f"{truth.group}, the truth")))
    entries.append(Line2D([], [], color="0.2", lw=5, alpha=0.25, label="none cheaper is as accurate"))
    _add_legend(figure, entries, {1: 4, 2: 2}.get(across, 1))
    return write_atomically(path, lambda file: figure.savefig(file, format="png"))


def _add_legend(figure: Figure, entries: Sequence[Artist], lines: int) -> None:
    """Name the entries below the panels in the number of lines given; where too wide, in more on a higher figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    for columns in range(-(-len(entries) // lines), 0, -1):
        legend = figure.legend(handles=entries, loc="outside lower center", ncols=columns, frameon=False)
        if columns == 1 or legend.get_window_extent(renderer).width <= figure.bbox.width:
            break
        legend.remove()
    further = max(0, -(-len(entries) // columns) - lines)
    figure.set_figheight(figure.get_figheight() + _LINE * further)


def _draw_panel(axes: Axes, panel: ParetoPanel) -> None:
    axes.set(xscale="log", yscale="log", xlabel=literal(panel.x_label), ylabel=literal(panel.y_label))
    front = sorted((mark for mark in panel.marks if mark.front), key=lambda mark: mark.x)
    if front:
        x, y = ([getattr(mark, name) for mark in front] for name in ("x", "y"))
        if panel.truth:
            x, y = [*x, panel.truth.x], [*y, y[-1]]
        axes.step(x, y, where="post", color="0.2", lw=6, alpha=0.2, zorder=1, solid_capstyle="butt")
    for group in dict.fromkeys(mark.group for mark in panel.marks):
        marks = [mark for mark in panel.marks if mark.group == group]
        axes.plot([m.x for m in marks], [m.y for m in marks], ":", color=marks[0].color, lw=1, zorder=2)
        for mark in marks:
            axes.plot(
                mark.x, mark.y, mark.marker, color=mark.color, ms=7 if mark.front else 5, zorder=3,
                markeredgecolor="k" if mark.front else mark.color, markeredgewidth=0.8,
            )  # fmt: skip
    if panel.truth:
        axes.axvline(panel.truth.x, color=panel.truth.color, lw=2)
    axes.margins(0.1, 0.14)
    axes.grid(alpha=0.3, which="major")
    axes.set_title(literal(panel.title), fontsize=11)
    _write_texts(axes, panel)


def _write_texts(axes: Axes, panel: ParetoPanel) -> None:
    """A label next to every point, at the first of a few places where it covers no other text, point or line."""
    axes.figure.draw_without_rendering()  # type: ignore[union-attr]
    scale = 72.0 / axes.figure.dpi
    points = axes.transData.transform([[mark.x, mark.y] for mark in panel.marks]) * scale
    left, right = (float(edge) * scale for edge in axes.bbox.intervalx)
    line = -np.inf
    if panel.truth:
        line = float(axes.transData.transform((panel.truth.x, panel.marks[0].y))[0]) * scale
    dotted = _along_lines(panel, points)
    taken: list[tuple[float, float, float]] = []  # centre and half a width of the texts so far

    def clear(x: float, y: float, half: float, own: tuple[float, float]) -> bool:
        apart = all(abs(x - a) > half + b or abs(y - c) > 10.0 for a, c, b in taken)
        apart = apart and all(
            abs(x - a) > half + 4.0 or abs(y - c) > 7.5
            for a, c in points
            if max(abs(a - own[0]), abs(c - own[1])) > 0.0
        )
        apart = apart and not ((np.abs(dotted[:, 0] - x) < half + 1.0) & (np.abs(dotted[:, 1] - y) < 5.0)).any()
        return apart and abs(x - line) > half + 2.0 and left + half < x < right - half

    for mark, point in sorted(zip(panel.marks, points, strict=True), key=lambda pair: not pair[0].front):
        half = 1.0 + 2.3 * len(mark.text)
        places = [(0.0, 9.0), (0.0, -10.0), (half + 7.0, 0.0), (-half - 7.0, 0.0), (half, 10.0), (-half, -11.0)]
        places += [(-half - 3.0, 9.0), (half + 3.0, -9.0), (0.0, 18.0), (0.0, -19.0), (half + 14.0, 12.0)]
        places += [(-half - 14.0, 12.0), (half + 14.0, -12.0), (-half - 14.0, -12.0)]
        for shift in places:
            x, y = point[0] + shift[0], point[1] + shift[1]
            if clear(x, y, half, tuple(point)):
                taken.append((x, y, half))
                axes.annotate(
                    literal(mark.text), (mark.x, mark.y), xytext=shift, textcoords="offset points", ha="center",
                    va="center", fontsize=7, color=mark.color, zorder=4,
                )  # fmt: skip
                break


def _along_lines(panel: ParetoPanel, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (k, 2) along the dotted lines that join the points (p, 2) of each group, closer than a text is high."""
    places = [np.empty((0, 2))]
    for group in dict.fromkeys(mark.group for mark in panel.marks):
        own = points[[mark.group == group for mark in panel.marks]]
        for start, end in pairwise(own):
            share = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(end - start) / 3.0))[:, None]
            places.append(start + share * (end - start))
    return np.concatenate(places)
