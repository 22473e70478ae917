"""Equilibrium path of a scene."""

from __future__ import annotations

from typing import Any

from modalshell.analysis.paths import EquilibriumPath, equilibrium_path
from modalshell.core.errors import OptionError
from modalshell.core.typing import Progress
from modalshell.scene.read import located
from modalshell.scene.scene import Scene
from modalshell.scene.tables import PathTable


def scene_path(scene: Scene, on_step: Progress | None = None, **changed: Any) -> EquilibriumPath:
    """Follow the equilibria of a scene's model under its load, by its ``[path]`` table with some keys changed.

    Raises
    ------
    SceneError
        Where a table is refused: supports that move or constraints, too, which a path does not know.
    """
    declared = scene.require_shell()
    table = declared.path or PathTable()
    built = declared.build()
    with located(declared.file, "path", table):
        if built.path is not None or built.constraints:
            raise OptionError("a path knows no supports that move and no constraints: leave them out")
        if (table.watch is None) != (table.direction is None):
            raise OptionError("watch needs a direction, and a direction vertices to watch")
        options = {name: getattr(table, name) for name in table.__struct_fields__ if name not in ("watch", "direction")}
        watch = None if table.watch is None else (table.watch, table.direction)
        return equilibrium_path(
            built.model,
            gravity=built.gravity,
            force=built.force,
            watch=watch,  # type: ignore[arg-type]
            contacts=built.contacts,
            on_step=on_step,
            **options | changed,
        )
