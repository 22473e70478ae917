"""Bars of shares: how much of each class a table of cases holds, in the style of all figures (matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import write_atomically


def draw_shares(
    shares: Mapping[str, Sequence[Mapping[str, float]]],
    headings: Sequence[str],
    colors: Mapping[str, str],
    path: str | Path,
) -> Path:
    """Draw a table of bars into a PNG, one row per case, each bar split by the shares of its classes.

    Parameters
    ----------
    shares : mapping
        For each row, by its label, the shares of the classes under each heading; each sums to 1.
    headings : sequence of str
        Of the columns.
    colors : mapping
        Colour of each class, in the order of the bars and of the legend.
    path : path
        Of the PNG.

    Raises
    ------
    OptionError
        For a row that has not one bar per heading, or a class without a colour.
    """
    for label, bars in shares.items():
        if len(bars) != len(headings) or any(name not in colors for bar in bars for name in bar):
            raise OptionError(f"row {label!r} needs {len(headings)} bars of classes with a colour (got {bars!r:.80})")
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(11.0, 7.6), layout="constrained", dpi=130.0)
    columns = figure.subplots(1, len(headings), sharey=True, squeeze=False)[0]
    places = range(len(shares))
    for column, (axes, heading) in enumerate(zip(columns, headings, strict=True)):
        starts = [0.0] * len(shares)
        for name, color in colors.items():
            widths = [bars[column].get(name, 0.0) for bars in shares.values()]
            axes.barh(places, widths, left=starts, height=0.78, color=color)
            starts = [start + width for start, width in zip(starts, widths, strict=True)]
        axes.set_xlim(0.0, 1.0)
        axes.set_xticks([0.0, 0.5, 1.0], ["0", "50 %", "100 %"], fontsize=8)
        axes.set_title(heading, fontsize=10)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="y", length=0)
    columns[0].set_yticks(places, list(shares), fontsize=9)
    columns[0].set_ylim(len(shares) - 0.4, -0.6)
    handles = [Patch(facecolor=color, label=name) for name, color in colors.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return write_atomically(path, lambda file: figure.savefig(file, format="png"))
