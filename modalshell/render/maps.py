"""Maps of named classes over two parameters, in the style that all figures share (matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.errors import OptionError
from modalshell.files import write_atomically


@dataclass(frozen=True)
class MapPanel:
    """One map.

    Attributes
    ----------
    x, y : array_like
        Parameter values of the columns (X,) and the rows (Y,).
    classes : sequence of sequence of str
        Name of the class of each cell, Y rows of X.
    title, x_label, y_label : str
        Texts.
    log_x : bool
        Whether columns are spaced by ratio; their tick labels are the values either way.
    x_ticks : mapping of float to str, optional
        The only ticks of the x axis, and their texts.
    boundary : array_like, shape (Y,), optional
        Column value at which a line crosses each row; NaN where it does not, with ``boundary_label``.
    """

    x: ArrayLike
    y: ArrayLike
    classes: Sequence[Sequence[str]]
    title: str
    x_label: str
    y_label: str
    log_x: bool = False
    x_ticks: Mapping[float, str] | None = None
    boundary: ArrayLike | None = None
    boundary_label: str = ""


def draw_maps(panels: Sequence[MapPanel], colors: Mapping[str, str], path: str | Path, *, columns: int) -> Path:
    """Draw maps into a PNG in rows of ``columns``, with one legend of all classes.

    Parameters
    ----------
    panels : sequence of MapPanel
        The maps.
    colors : mapping
        Colour of each class, in the order of the legend.
    path : path
        Of the PNG.
    columns : int
        Maps in a row.

    Raises
    ------
    OptionError
        For a class without a colour, or classes that do not fit the values.
    """
    for panel in panels:
        shape = (len(np.ravel(panel.y)), len(np.ravel(panel.x)))
        names = np.array(panel.classes, dtype=object)
        if names.shape != shape:
            raise OptionError(f"map {panel.title!r} needs classes of shape {shape} (got {names.shape})")
        if missing := sorted({name for name in names.ravel() if name not in colors}):
            raise OptionError(f"map {panel.title!r} has classes without a colour: {', '.join(missing)}")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    order = list(colors)
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(4.8 * columns, 4.0 * rows + 0.5), layout="constrained", dpi=130)
    FigureCanvasAgg(figure)
    handles: list[Patch | Line2D] = [Patch(facecolor=colors[name], label=name) for name in order]
    for place, panel in enumerate(panels, start=1):
        axes = figure.add_subplot(rows, columns, place)
        x, y = np.asarray(panel.x, dtype=float), np.asarray(panel.y, dtype=float)
        numbers = np.array([[order.index(name) for name in row] for row in panel.classes])
        edges = _edges(np.log(x) if panel.log_x else x)
        # Rows stand at equal distance, whatever their values: they are cases, and every one is to be read.
        axes.pcolormesh(
            np.exp(edges) if panel.log_x else edges,
            np.arange(len(y) + 1) - 0.5,
            numbers,
            cmap=ListedColormap([colors[name] for name in order]),
            vmin=-0.5,
            vmax=len(order) - 0.5,
            edgecolors="white",
            linewidth=0.4,
        )
        if panel.log_x:
            axes.set_xscale("log")
        axes.set_xlim(*np.exp(edges[[0, -1]]) if panel.log_x else edges[[0, -1]])
        if panel.boundary is not None:
            at = np.asarray(panel.boundary, dtype=float)
            for row in np.flatnonzero(np.isfinite(at)):
                axes.plot([at[row], at[row]], [row - 0.5, row + 0.5], color="black", linewidth=2.5)
        if panel.x_ticks is not None:
            axes.set_xticks(list(panel.x_ticks), list(panel.x_ticks.values()))
            axes.set_xticks([], minor=True)
        axes.set_yticks(range(len(y)), [f"{value:g}" for value in y])
        axes.set_title(panel.title, fontsize=11)
        axes.set_xlabel(panel.x_label)
        axes.set_ylabel(panel.y_label)
    if labels := {panel.boundary_label for panel in panels if panel.boundary is not None}:
        handles += [Line2D([], [], color="black", linewidth=2.5, label=label) for label in sorted(labels)]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return write_atomically(path, lambda file: figure.savefig(file, format="png"))


def _edges(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of cells around ``centres``."""
    if centres.size == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2.0 * centres[0] - middle[0]], middle, [2.0 * centres[-1] - middle[-1]]])
