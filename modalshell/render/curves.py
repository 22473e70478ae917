"""Curves over a load axis, in the style of all figures (matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

_SPREAD = 0.6
"""Width over which dots of one category are spread, as a share of the distance between categories."""
_INSIDE = 5
"""Curves whose legend finds room between them; more are named below the axes."""
_SHORT = 34
"""Letters of a name below the axes that leave room for a second column."""
_SHAPES = "os^DvPX"
"""Markers of the colours of a legend, in turn: red and green look alike to many readers."""
_FEW_DECADES, _EVEN_DECADES = 2.0, 0.7
"""Decades of a logarithmic axis up to which its ticks are plain numbers, and up to which they are evenly apart."""
_SMALL, _LARGE = 1e-3, 1e6
"""Numbers between which plain ones are read at a glance."""


@dataclass(frozen=True)
class Curve:
    """One line of a panel: values ``y`` over ``x`` with a label and a colour; a guide has no points.

    A label that begins with an underscore is not in the legend. Points that are not ``joined`` stand for themselves; of
    categories, which are panels with ticks of their own, each stands next to those of the other curves at its place.
    With ``low`` and ``high`` every one has a bar between them. Without a ``marker`` its points have that of its colour.
    """

    x: ArrayLike
    y: ArrayLike
    label: str
    color: str
    dashed: bool = False
    points: bool = True
    marker: str | None = None
    joined: bool = True
    low: ArrayLike | None = None
    high: ArrayLike | None = None


Style = Literal["-", ":", "--"]
"""Line styles of matplotlib."""


@dataclass(frozen=True)
class Line:
    """A vertical line at ``x``, with a label."""

    x: float
    label: str
    style: Style = "-"


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    curves: Sequence[Curve]
    """What is drawn."""
    title: str
    x_label: str
    y_label: str
    """Texts."""
    log: bool = False
    log_x: bool = False
    """Whether the y axis, or the x axis, is logarithmic."""
    band: tuple[float, float] | None = None
    """Stretch of the x axis to shade from its middle to the right end, with ``band_label`` (where models break)."""
    band_label: str = ""
    x_ticks: Mapping[float, str] | None = None
    """The only ticks of the x axis, and their texts."""
    lines: Sequence[Line] = ()
    """Vertical lines."""
    legend_inside: bool | None = None
    """Whether the legend stands within the axes; by default where there are few curves."""


def literal(text: str) -> str:
    """A text that matplotlib shows as it is: what stands between two dollar signs in a name is no formula."""
    return text.replace("$", r"\$")


def draw_curves(
    panels: Sequence[Panel],
    path: str | Path,
    *,
    columns: int | None = None,
    share_y: bool = False,
    one_legend: bool = False,
    title: str = "",
) -> Path:
    """Draw panels into a PNG, side by side or in rows of ``columns``, with one range of y for all if ``share_y``.

    With ``one_legend`` what the panels have in common is named once, below all of them; ``title`` stands above them.

    OptionError for values not finite, or <= 0 on a logarithmic axis.
    """
    _check_values(panels)
    from matplotlib.figure import Figure

    panels = _marked(panels) if one_legend else [_marked([panel])[0] for panel in panels]
    across = columns or len(panels)
    rows = -(-len(panels) // across)
    figure = Figure(figsize=(6.4 * across, 4.6 * rows), layout="constrained", dpi=150)
    for place, panel in enumerate(panels, start=1):
        axes = figure.add_subplot(rows, across, place, sharey=figure.axes[0] if share_y and figure.axes else None)
        _add_curves(axes, panel)
        if panel.log:
            axes.set_yscale("log")
        if panel.log_x:
            axes.set_xscale("log")
        if panel.x_ticks is not None:
            axes.set_xticks(list(panel.x_ticks), list(map(literal, panel.x_ticks.values())))
            axes.set_xticks([], minor=True)
        if panel.band is not None:
            right = max(float(np.max(curve.x)) for curve in panel.curves)
            axes.axvspan(0.5 * sum(panel.band), right, color="0.85", zorder=0, label=literal(panel.band_label))
        for line in panel.lines:
            axes.axvline(line.x, color="0.25", linestyle=line.style, linewidth=1.2, label=literal(line.label))
        axes.set_title(literal(panel.title), fontsize=11)
        axes.set(xlabel=literal(panel.x_label), ylabel=literal(panel.y_label))
        axes.grid(alpha=0.3)
        if not one_legend:
            _add_legend(axes, panel)
    for axes, panel in zip(figure.axes, panels, strict=True):  # their ranges are known now
        for axis in (axes.yaxis, *(() if panel.x_ticks is not None else (axes.xaxis,))):
            _label_few_decades(axis)
    if title:
        figure.suptitle(literal(title), fontsize=11)
    if one_legend:
        named = {
            label: handle
            for axes in figure.axes
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(
            named.values(), named.keys(), loc="outside lower center", ncols=min(len(named), 2 * across), frameon=False
        )
    return write_atomically(path, lambda file: figure.savefig(file, format="png"))


def _check_values(panels: Sequence[Panel]) -> None:
    """OptionError for values not finite, or <= 0 on a logarithmic axis."""
    for panel in panels:
        for curve in panel.curves:
            values = np.concatenate([np.ravel(curve.x), np.ravel(curve.y)]).astype(float)
            if not np.isfinite(values).all():
                raise OptionError(f"curve {curve.label!r} of {panel.title!r} has values that are not finite")
            if panel.log and (np.asarray(curve.y) <= 0).any():
                raise OptionError(f"curve {curve.label!r} of {panel.title!r} has values <= 0 on a logarithmic axis")


def _marked(panels: Sequence[Panel]) -> list[Panel]:
    """The panels of one legend with a marker for every curve, one a colour."""
    colors = dict.fromkeys(
        curve.color for panel in panels for curve in panel.curves if curve.points and curve.marker is None
    )
    shapes = dict(zip(colors, cycle(_SHAPES), strict=False))
    return [
        replace(panel, curves=[replace(one, marker=one.marker or shapes.get(one.color)) for one in panel.curves])
        for panel in panels
    ]


def _label_few_decades(axis: Axis) -> None:
    """Plain numbers at the ticks of a logarithmic axis over a few decades: 600, not 6 times a power of ten."""
    if axis.get_scale() != "log":
        return
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    low, high = axis.get_view_interval()
    decades = float(np.log10(high / low))
    if decades > _FEW_DECADES or low < _SMALL or high > _LARGE:
        return
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)) if decades > _EVEN_DECADES else MaxNLocator(6))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))


def _add_curves(axes: Axes, panel: Panel) -> None:
    """Lines with their points; dots of categories side by side, with their bars."""
    count, shown = sum(not curve.joined for curve in panel.curves), 0
    for curve in panel.curves:
        size = 4 if curve.marker == "o" else 5
        if curve.joined:
            style, marker = "--" if curve.dashed else "-", curve.marker if curve.points else None
            axes.plot(curve.x, curve.y, style, marker=marker, ms=size, color=curve.color, label=literal(curve.label))
            continue
        spread = _SPREAD * (shown - 0.5 * (count - 1)) / count if panel.x_ticks is not None else 0.0
        place = np.asarray(curve.x, float) + spread
        shown += 1
        if curve.low is not None and curve.high is not None:
            axes.vlines(place, np.asarray(curve.low), np.asarray(curve.high), color=curve.color, alpha=0.45, lw=2)
        axes.plot(
            place, curve.y, ls="", marker=curve.marker, ms=11 if curve.marker == "_" else size + 1.5,
            mew=2 if curve.marker == "_" else 1, color=curve.color, label=literal(curve.label),
            markerfacecolor="none" if curve.dashed else curve.color,
        )  # fmt: skip


def _add_legend(axes: Axes, panel: Panel) -> None:
    """The legend of one panel, within its axes or below them."""
    inside = panel.legend_inside
    if inside is None:
        inside = len(panel.curves) + len(panel.lines) <= _INSIDE
    if inside:
        axes.legend(frameon=False, fontsize=9)
    else:
        longest = max(map(len, axes.get_legend_handles_labels()[1]), default=0)
        columns = 2 if longest <= _SHORT else 1
        axes.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=columns)


MARKERS = {"limit": "^", "bifurcation": "s"}
"""Markers of the kinds of events."""


def path_curves(
    displacements: ArrayLike,
    factors: ArrayLike,
    stable: ArrayLike,
    events: Sequence[tuple[str, int, float]],
    label: str,
    color: str,
    *,
    marks: bool = True,
) -> list[Curve]:
    """Curves of one path, factors (k,) over displacements (k,); only its first part and marks are named in a legend."""
    x, y, good = np.asarray(displacements, float), np.asarray(factors, float), np.asarray(stable, bool)
    # A piece between two points is stable where both its ends are; at events one end may be either.
    at = {index for _, index, _ in events}
    pieces = [
        bool(good[k] and good[k + 1]) or (k in at and bool(good[k + 1])) or (k + 1 in at and bool(good[k]))
        for k in range(len(x) - 1)
    ]
    curves: list[Curve] = []
    first = 0
    for k in range(1, len(pieces) + 1):
        if k == len(pieces) or pieces[k] != pieces[first]:
            name = label if not curves else f"_{label}"
            curves.append(Curve(x[first : k + 1], y[first : k + 1], name, color, not pieces[first], points=False))
            first = k
    for kind, marker in MARKERS.items() if marks else ():
        chosen = [index for what, index, _ in events if what == kind]
        curves += [Curve([x[index]], [y[index]], f"_{kind}", color, marker=marker) for index in chosen]
    return curves
