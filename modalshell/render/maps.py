"""Maps of classes over two parameters, in the style of all figures (matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import write_atomically
from modalshell.render.curves import Style, literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Boundary:
    """A line over a map, in pieces: it crosses each row at some column values, or nowhere."""

    at: Sequence[Sequence[float]]
    """For each row, the column values at which it is crossed."""
    label: str
    """For the legend."""
    style: Style = "-"
    color: str = "black"
    """Line style and colour of matplotlib."""


@dataclass(frozen=True)
class MapPanel:
    """One map."""

    x: ArrayLike
    y: ArrayLike
    """Parameter values of the columns (X,) and the rows (Y,)."""
    classes: Sequence[Sequence[str]]
    """Name of the class of each cell, Y rows of X."""
    title: str
    x_label: str
    y_label: str
    """Texts; without an x label the columns have no tick labels, either."""
    x_scale: Literal["linear", "log", "even"] = "linear"
    """Whether columns are spaced by difference, by ratio, or evenly whatever their values."""
    boundaries: Sequence[Boundary] = ()
    """Lines over the map."""
    x_ticks: Mapping[float, str] | None = None
    """The only ticks of the x axis, and their texts."""


def draw_maps(
    panels: Sequence[MapPanel],
    colors: Mapping[str, str],
    path: str | Path,
    *,
    columns: int,
    size: tuple[float, float] = (4.8, 4.0),
    font: float = 10.0,
    dpi: float = 130.0,
) -> Path:
    """Draw maps into a PNG in rows of ``columns``, with one legend of all classes.

    ``colors`` are those of the classes, in the order of the legend, ``size`` is the width and height of a map with its
    texts [inch], ``font`` the size of these [points], ``dpi`` the pixels per inch. OptionError for a class without a
    colour, or classes that do not fit the values.
    """
    for panel in panels:
        shape = (len(np.ravel(panel.y)), len(np.ravel(panel.x)))
        names = np.array(panel.classes, dtype=object)
        if names.shape != shape:
            raise OptionError(f"map {panel.title!r} needs classes of shape {shape} (got {names.shape})")
        if missing := sorted({name for name in names.ravel() if name not in colors}):
            raise OptionError(f"map {panel.title!r} has classes without a colour: {', '.join(missing)}")
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from PIL import Image

    rows = -(-len(panels) // columns)
    with rc_context({"font.size": font, "axes.titlesize": 1.1 * font, "axes.labelsize": font}):
        figure = Figure(figsize=(size[0] * columns, size[1] * rows + 0.05 * font), layout="constrained", dpi=dpi)
        width = 0.1 * font + 1.5
        for place, panel in enumerate(panels, start=1):
            _draw(figure.add_subplot(rows, columns, place), panel, colors, width)
        handles: list[Patch | Line2D] = [Patch(facecolor=color, label=literal(name)) for name, color in colors.items()]
        lines = {line.label: line for panel in panels for line in panel.boundaries if any(map(len, line.at))}
        handles += [
            Line2D([], [], color=line.color, linewidth=width, linestyle=line.style, label=literal(label))
            for label, line in sorted(lines.items())
        ]
        legend_rows = -(-len(handles) // min(4 * columns, 8))
        ncols = -(-len(handles) // legend_rows)
        figure.legend(handles=handles, loc="outside lower center", ncols=ncols, frameon=False)
        drawn = BytesIO()
        figure.savefig(drawn, format="png")
    # Few colours: a palette makes the file three times smaller; with 64, a class of few cells lost its own.
    picture = Image.open(drawn).convert("RGB").quantize(128)
    return write_atomically(path, lambda file: picture.save(file, format="PNG", optimize=True))


def _draw(axes: Axes, panel: MapPanel, colors: Mapping[str, str], width: float) -> None:
    from matplotlib.colors import ListedColormap

    order = list(colors)
    x, y = np.asarray(panel.x, dtype=float), np.asarray(panel.y, dtype=float)
    numbers = np.array([[order.index(name) for name in row] for row in panel.classes])
    if panel.x_scale == "log":
        edges = np.exp(_edges(np.log(x)))
    else:
        edges = _edges(x if panel.x_scale == "linear" else np.arange(len(x), dtype=float))
    # Rows stand at equal distance, whatever their values: they are cases, and every one is to be read.
    axes.pcolormesh(
        edges,
        np.arange(len(y) + 1) - 0.5,
        numbers,
        cmap=ListedColormap([colors[name] for name in order]),
        vmin=-0.5,
        vmax=len(order) - 0.5,
        edgecolors="white",
        linewidth=0.4,
    )
    if panel.x_scale == "log":
        axes.set_xscale("log")
    axes.set_xlim(edges[0], edges[-1])
    for line in panel.boundaries:
        for row, crossed in enumerate(line.at):
            for at in crossed:
                axes.plot([at, at], [row - 0.5, row + 0.5], color=line.color, linewidth=width, linestyle=line.style)
    axes.set_yticks(range(len(y)), [_number(value) for value in y])
    if panel.x_scale == "even":
        axes.set_xticks(range(len(x)), [_number(value) for value in x], rotation=90)
    if panel.x_ticks is not None:
        axes.set_xticks(list(panel.x_ticks), list(map(literal, panel.x_ticks.values())))
        axes.set_xticks([], minor=True)
    axes.set(title=literal(panel.title), xlabel=literal(panel.x_label), ylabel=literal(panel.y_label))
    if not panel.x_label:
        axes.tick_params(labelbottom=False)


def _number(value: float) -> str:
    """A tick label: 1e4 and 1e6 rather than 10000 and 1e+06."""
    short, plain = f"{value:.0e}", f"{value:g}"
    text = short if abs(value) >= 1e4 and float(short) == value else plain
    return text.replace("e+0", "e").replace("e-0", "e-")


def _edges(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of cells around ``centres``."""
    if centres.size == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2.0 * centres[0] - middle[0]], middle, [2.0 * centres[-1] - middle[-1]]])
