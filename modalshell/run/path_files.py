"""Files of an equilibrium path: numbers, load-deflection curve, and pictures at marked points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from modalshell.analysis.paths import EquilibriumPath, equilibrium_path
from modalshell.core.errors import OptionError
from modalshell.core.typing import Progress, unheard
from modalshell.core.units import SI, UnitSystem
from modalshell.files.atomic_io import write_npz
from modalshell.loads import Scaled
from modalshell.render import ShadedSurface, View, draw_views
from modalshell.render.curves import MARKERS, Curve, Panel, draw_curves, path_curves
from modalshell.scene.read import located
from modalshell.scene.scene import Scene
from modalshell.scene.tables import PathTable

_COLORS = ("#2b5fc8", "#d98200", "#7b2d8e", "#2f9e44", "#c8322b")
_MOST = 11
"""Marked points that are pictured at most, the beginning and the end not counted."""


def write_path(path: EquilibriumPath, folder: Path, name: str, units: UnitSystem = SI) -> list[Path]:
    """Write ``NAME_path.npz``, ``NAME_path.png`` and ``NAME_path_shapes.png`` into ``folder``; return the paths."""
    arrays = {}
    for number, one in enumerate([path, *path.branches]):
        begin = "" if one is path else f"branch_{number}_"
        for key in ("factors", "displacements", "stable", "unstable_directions", "positions", "residuals"):
            arrays[f"{begin}{key}"] = getattr(one, key)
        arrays[f"{begin}event_kinds"] = np.array([event.kind for event in one.events], dtype="U16")
        arrays[f"{begin}event_points"] = np.array([event[1] for event in one.events], dtype=np.int64)
    quantities = {"displacements": "m", "positions": "m"}
    labels = units.array({key: quantities.get(key.rsplit("_", 1)[-1], "") for key in arrays})
    written = [write_npz(folder / f"{name}_path.npz", units=labels, **arrays)]
    curves: list[Curve] = []
    for number, one in enumerate([path, *path.branches]):
        label = "path" if one is path else f"branch {number}"
        color = _COLORS[number % len(_COLORS)]
        curves += path_curves(one.displacements, one.factors, one.stable, one.events, label, color)
    seen = {event.kind for one in [path, *path.branches] for event in one.events}
    for kind, marker in MARKERS.items():  # to be named in the legend
        if kind in seen:
            first = next((one, e[1]) for one in [path, *path.branches] for e in one.events if e.kind == kind)
            x, y = first[0].displacements[first[1]], first[0].factors[first[1]]
            curves.append(Curve([x], [y], kind, "black", marker=marker))
    panel = Panel(
        curves, f"{name}: stable parts solid, unstable ones dashed", f"displacement [{units.of('m')}]", "load factor"
    )
    written.append(draw_curves([panel], folder / f"{name}_path.png"))
    if path.mesh is not None:
        written.append(_draw_shapes(path, folder / f"{name}_path_shapes.png"))
    return written


def _draw_shapes(path: EquilibriumPath, file: Path) -> Path:
    """The shapes at the beginning, at the marked points, and at the end."""
    assert path.mesh is not None
    marked = [(event.kind, event[1]) for event in path.events][:_MOST]
    views = []
    for text, index in [("beginning", 0), *marked, ("end", len(path.factors) - 1)]:
        state = "stable" if path.stable[index] else f"{path.unstable_directions[index]} unstable"
        surface = ShadedSurface(path.positions[index], path.mesh.faces, smooth=True)
        views.append(View([surface], title=f"{text}, {path.factors[index]:.4g}", subtitle=state))
    columns = min(3, len(views))
    rows = -(-len(views) // columns)
    return draw_views(views, file, columns=columns, size=(400 * columns, 330 * rows), legend=False)


def scene_path(scene: Scene, on_step: Progress = unheard, **changed: Any) -> EquilibriumPath:
    """Follow the equilibria of a scene's model under its load, by its ``[path]`` table with some keys changed.

    SceneError where a table is refused: constraints, supports that move or loads that change in time, too.
    """
    declared = scene.require_shell()
    table = declared.path or PathTable()
    built = declared.build()
    with located(declared.file, "path", table), declared.unit_system.said():
        if built.path is not None or built.constraints:
            raise OptionError("a path knows no supports that move and no constraints: leave them out")
        if any(isinstance(load, Scaled) for load in built.loads):
            raise OptionError("a path knows no time: leave times and factors of loads out")
        if (table.watch is None) != (table.direction is None):
            raise OptionError("watch needs a direction, and a direction needs vertices to watch")
        options = {name: getattr(table, name) for name in table.__struct_fields__ if name not in ("watch", "direction")}
        watch = None if table.watch is None else (table.watch, table.direction)
        return equilibrium_path(
            built.model,
            gravity=built.gravity,
            force=built.force,
            loads=built.loads,
            watch=watch,  # type: ignore[arg-type]
            contacts=built.contacts,
            on_step=on_step,
            **options | changed,
        )
