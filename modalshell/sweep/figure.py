"""Picture of a sweep.

Rule: an axis of numbers, or of vectors that differ only by a factor (represented by their lengths), can be plotted.
Two such axes of four values or more become a map of the sixths that the value falls in, one panel for each combination
of the other axes. Otherwise there are curves along the axis with the most values, one for each combination of the
others; where those are too many, one panel for each value of the first of the others. Cases without the value are left
out of curves and grey in maps; what has not converged is crossed out in curves, and dark in maps.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from modalshell.core.checks import shortened
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.core.units import with_unit
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.render.maps import MapPanel, draw_maps
from modalshell.sweep.grid import Axis
from modalshell.sweep.summary import SummaryRow

Chosen = dict[int, int]
"""Index of a value by the place of its axis."""

_LABELS = {
    "displacement": "largest displacement",
    "peak_displacement": "peak displacement",
    "error": "relative displacement error",
    "area_change": "relative change of area",
    "kinetic_energy": "kinetic energy",
    "elastic_energy": "elastic energy",
    "load_potential": "potential of the load",
    "error_bar": "error bar on the displacement",
    "margin": "stability margin",
}
_COLORS = ("#2b5fc8", "#c8322b", "#2f9e44", "#d98200", "#7b2d8e", "#17a2b8", "#8c564b", "#777777")
_RANGES = ("#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725")
_NONE, _MISSED = "no value", "not converged"
_GREYS = {_NONE: "#cccccc", _MISSED: "#555555"}
_CURVES, _PANELS = len(_COLORS), 12
_TICKS = 8
"""Largest number of axis values that each get a tick."""
_WIDE = 30.0
"""Ratio of largest to smallest from which an axis is logarithmic."""
_LETTERS = 32
"""Letters of a value's text that leave room for others in a legend."""


@dataclass(frozen=True)
class _Summary:
    """A column of a sweep's summary over its axes; ``missed`` are the places of cases that have not converged."""

    axes: Sequence[Axis]
    cells: Mapping[tuple[int, ...], Any]
    missed: frozenset[tuple[int, ...]]
    label: str
    title: str
    units: Mapping[str, str]

    def at(self, chosen: Chosen) -> float | None:
        """The value at the chosen values of all axes."""
        cell = self.cells[self._place(chosen)]
        return None if cell is None else float(cell)

    def is_missed(self, chosen: Chosen) -> bool:
        """Whether the case at the chosen values of all axes has not converged."""
        return self._place(chosen) in self.missed

    def _place(self, chosen: Chosen) -> tuple[int, ...]:
        return tuple(chosen[place] for place in range(len(self.axes)))

    @property
    def known(self) -> list[float]:
        """All values."""
        return [float(cell) for cell in self.cells.values() if cell is not None]

    def choices(self, places: Sequence[int]) -> list[Chosen]:
        """Every choice of one value's index for each of some axes."""
        indices = itertools.product(*(range(len(self.axes[place].values)) for place in places))
        return [dict(zip(places, chosen, strict=True)) for chosen in indices]

    def name(self, chosen: Chosen, between: str = ", ") -> str:
        """The chosen values as text."""
        parts = (f"{self.axes[place].key} = {_short_texts(self.axes[place])[index]}" for place, index in chosen.items())
        return between.join(parts)

    def along(self, place: int) -> str:
        """The name of an axis of numbers, with its unit; of an axis of vectors that of their lengths."""
        axis, unit = self.axes[place], self.units.get(self.axes[place].key, "1")
        name = f"|{axis.key}|" if isinstance(axis.values[0], list) else axis.key
        return with_unit(name, unit)

    def heading(self, chosen: Chosen) -> str:
        """Title of the panel of the chosen values."""
        return self.name(chosen, "\n") or self.title


def draw_summary(
    rows: Sequence[SummaryRow],
    axes: Sequence[Axis],
    value: str,
    path: Path,
    title: str,
    units: Mapping[str, str],
    columns: int = 3,
) -> str:
    """Draw ``value`` over the axes into a PNG, with at most that many ``columns`` of panels.

    Returns "", or why there is no picture.
    """
    places = itertools.product(*(range(len(axis.values)) for axis in axes))
    at = dict(zip(places, rows, strict=True))
    missed = frozenset(place for place, row in at.items() if row.get("converged") is False)
    cells = {place: row[value] for place, row in at.items()}
    summary = _Summary(axes, cells, missed, _label(value, units), title, units)
    if not summary.known:
        return f"no picture: no case has a value of {value!r}"
    numeric = {place: along for place, axis in enumerate(axes) if (along := _numbers(axis)) is not None}
    longest = sorted(numeric, key=lambda place: -len(numeric[place]))  # stable: the first in the file where they tie
    if len(longest) > 1 and len(numeric[longest[1]]) > 3:
        x, y = sorted(longest[:2], key=lambda place: (-len(numeric[place]), place))  # cells may be narrow along x
        return _draw_map(summary, x, y, numeric, path, columns)
    return _draw_curves(summary, longest[0] if longest else len(axes) - 1, numeric, path, columns)


def _draw_curves(summary: _Summary, place: int, numeric: Mapping[int, Array], path: Path, columns: int) -> str:
    """Curves along the axis at ``place``; values that are no numbers stand at equal distance, by their names."""
    axis, named = summary.axes[place], place not in numeric
    along = np.arange(1.0, len(axis.values) + 1.0) if named else numeric[place]
    others = [other for other in range(len(summary.axes)) if other != place]
    count = len(summary.choices(others))
    apart = others[:1] if count > _CURVES else []
    panels, curves_each = summary.choices(apart), summary.choices([other for other in others if other not in apart])
    if len(panels) > _PANELS or len(curves_each) > _CURVES:
        return f"no picture: {count} curves are too many for a picture; plot the table instead"
    drawn = []
    for fixed in panels:
        curves: list[Curve] = []
        crossed: list[tuple[float, float]] = []
        for number, chosen in enumerate(curves_each):
            cases = [fixed | chosen | {place: index} for index in range(len(along))]
            places = [(float(x), case, summary.at(case)) for x, case in zip(along, cases, strict=True)]
            points = [(x, y) for x, _, y in places if y is not None]
            crossed += [(x, y) for x, case, y in places if y is not None and summary.is_missed(case)]
            name = summary.name(chosen) or summary.label
            spec = models().get(name.rpartition("= ")[2])
            color = spec.color if spec else _COLORS[number]
            curves.append(Curve([x for x, _ in points], [y for _, y in points], name, color))
        if crossed:
            at, values = np.transpose(crossed)
            curves.append(Curve(at, values, _MISSED, "black", marker="x", joined=False))
        drawn.append(
            Panel(
                curves,
                summary.heading(fixed),
                axis.key if named else summary.along(place),
                summary.label,
                log=_is_wide(summary.known),
                log_x=not named and _is_geometric(along),
                x_ticks=dict(zip(along, _short_texts(axis), strict=True)) if named else _ticks(along),
            )
        )
    draw_curves(drawn, path, columns=min(columns, len(drawn)), share_y=True)
    return ""


def _draw_map(
    summary: _Summary, x_place: int, y_place: int, numeric: Mapping[int, Array], path: Path, columns: int
) -> str:
    panels = summary.choices([other for other in range(len(summary.axes)) if other not in (x_place, y_place)])
    if len(panels) > _PANELS:
        return f"no picture: {len(panels)} maps are too many for a picture; plot the table instead"
    edges, names = _sixths(np.array(summary.known))
    x, y = numeric[x_place], numeric[y_place]
    x_order, y_order = np.argsort(x), np.argsort(y)

    def named(case: Chosen) -> str:
        value = summary.at(case)
        if value is None or summary.is_missed(case):
            return _NONE if value is None else _MISSED
        return names[int(np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(names) - 1))]

    scale: Literal["log", "linear"] = "log" if _is_geometric(x) else "linear"
    labels = summary.along(x_place), summary.along(y_place)
    drawn = []
    for chosen in panels:
        classes = [[named(chosen | {x_place: int(i), y_place: int(j)}) for i in x_order] for j in y_order]
        title = f"{summary.heading(chosen)}\n{summary.label}"
        drawn.append(MapPanel(x[x_order], y[y_order], classes, title, *labels, x_scale=scale, x_ticks=_ticks(x)))
    picked = np.linspace(0, len(_RANGES) - 1, len(names)).round().astype(int)
    colors = {name: _RANGES[k] for name, k in zip(names, picked, strict=True)}
    found = {name for panel in drawn for row in panel.classes for name in row}
    colors |= {name: grey for name, grey in _GREYS.items() if name in found}
    draw_maps(drawn, colors, path, columns=min(columns, len(drawn)))
    return ""


def _sixths(known: Array) -> tuple[Array, list[str]]:
    """Edges of ranges that hold a sixth of the values each, fewer where values are equal, and their names."""
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, len(_RANGES) + 1)))
    if len(edges) == 1:
        return edges.repeat(2), [f"{edges[0]:.3g}"]
    for digits in range(3, 18):
        names = [f"{low:.{digits}g} to {high:.{digits}g}" for low, high in itertools.pairwise(edges)]
        if len({f"{edge:.{digits}g}" for edge in edges}) == len(edges):
            break
    return edges, names


def _ticks(along: Array) -> dict[float, str] | None:
    """The values themselves where they are few enough to be read."""
    return {float(value): f"{value:.3g}" for value in along} if len(along) <= _TICKS else None


def _numbers(axis: Axis) -> Array | None:
    """Positions of an axis's values on a number line; None if they are not numeric."""
    if any(isinstance(value, bool | str | dict) for value in axis.values):
        return None
    try:
        values = np.array(axis.values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    if values.ndim == 1:
        return values
    if values.ndim != 2:
        return None
    lengths = np.linalg.norm(values, axis=1)
    longest = values[np.argmax(lengths)]
    factors = values @ longest / max(float(longest @ longest), np.finfo(float).tiny)
    parallel = np.allclose(values, factors[:, None] * longest, rtol=0.0, atol=1e-9 * lengths.max())
    return factors * lengths.max() if parallel else None


def axis_text(value: Any) -> str:
    """A value of an axis as text."""
    if isinstance(value, dict):
        return ", ".join(
            axis_text(part) if key == "name" else f"{key} {axis_text(part)}" for key, part in value.items()
        )
    if isinstance(value, list):
        return "(" + ", ".join(map(axis_text, value)) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _short_texts(axis: Axis) -> list[str]:
    """The values of an axis as texts for a legend: tables without what all of them share, numbered where cut alike."""
    values, own = axis.values, axis.values
    if all(isinstance(value, dict) for value in values):
        own = tuple(
            {key: part for key, part in value.items() if any(other.get(key) != part for other in values)}
            for value in values
        )
    whole = (axis_text(part) or axis_text(value) for part, value in zip(own, values, strict=True))
    texts = [shortened(text, _LETTERS) for text in whole]
    alike = len(set(texts)) < len(texts)
    return [f"{text} ({number})" if alike else text for number, text in enumerate(texts, start=1)]


def _label(value: str, units: Mapping[str, str]) -> str:
    return with_unit(_LABELS.get(value, value.replace("_", " ")), units.get(value, "1"))


def _is_wide(values: Any) -> bool:
    least, largest = min(values), max(values)
    return bool(least > 0.0 and largest >= _WIDE * least)


def _is_geometric(along: Array) -> bool:
    """Whether to use a logarithmic axis: values with a large range or with equal ratios."""
    if along.min() <= 0.0 or len(along) < 3:
        return False
    ratios = np.diff(np.log(np.sort(along)))
    return _is_wide(along) or bool(np.allclose(ratios, ratios[0], rtol=1e-3))


def checked_value(value: str | None, truth: bool, columns: Sequence[str], file: Path) -> str:
    """The column to draw: the requested one, else the error if there is a reference, else the displacement."""
    allowed = [*columns, *(["error"] if truth else [])]
    if value is not None and value not in allowed:
        hint = "" if truth else "; 'error' needs a [truth]"
        raise OptionError(f"{file}: output.value: must be one of {', '.join(allowed)} (got {value!r}{hint})")
    return value or ("error" if truth else "displacement")
