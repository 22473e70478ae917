"""Plan of a sweep: every scene of the grid checked, identified by its digest, and prepared."""

from __future__ import annotations

import json
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from modalshell.core.checks import shortened, shown
from modalshell.core.errors import ModalShellWarning, SceneError
from modalshell.core.typing import Progress, unheard
from modalshell.mesh import TriangleMesh
from modalshell.scene import Scene, parse_scene
from modalshell.scene.index_files import numbered
from modalshell.sweep.case import Task, case_digest
from modalshell.sweep.grid import Sweep


@dataclass(frozen=True)
class GridCase:
    """A point of the grid."""

    values: tuple[Any, ...]
    """Values of the axes."""
    digest: str
    """Digest of the scene and its mesh; identical cases share it and are computed once."""
    truth: str | None
    """Digest of the same scene under the reference's model."""
    mesh: TriangleMesh


class Plan:
    """The cases of a sweep and their distinct tasks.

    SceneError at the first scene that is refused: names the case and the key's path. ``on_check`` is called with the
    cases checked and their total.

    Attributes
    ----------
    cases : list of GridCase
        In the order of the grid.
    tasks : dict
        Tasks by digest: those of the cases, and their reference solutions if requested.
    """

    def __init__(self, sweep: Sweep, on_check: Progress = unheard) -> None:
        self.cases: list[GridCase] = []
        self.tasks: dict[str, Task] = {}
        self._meshes: dict[str, tuple[TriangleMesh, bytes, bytes]] = {}
        self._checked: set[str] = set()
        key = ""
        for number, (values, raw) in enumerate(sweep.points(), start=1):
            try:
                digest, mesh = self._add(sweep, raw)
                truth = None if sweep.truth is None else self._add(sweep, raw | {"model": sweep.truth})[0]
            except SceneError as error:
                at = ", ".join(f"{axis.key} = {shown(value)}" for axis, value in zip(sweep.axes, values, strict=True))
                raise SceneError(f"{sweep.file}: case {number} of {sweep.count} ({shortened(at)}): {error}") from error
            self.cases.append(GridCase(values, digest, truth, mesh))
            key = key or numbered(raw)
            on_check(number, sweep.count)
        counts = sorted({len(case.mesh.vertices) for case in self.cases})
        if len(counts) > 1 and key:
            warnings.warn(
                f"{sweep.file}: {key} selects vertices by their numbers, which are at other places of each mesh (got "
                f"meshes of {counts[0]} to {counts[-1]} vertices): select them by place, as 'x < 0.01'",
                ModalShellWarning,
                stacklevel=3,
            )

    def _add(self, sweep: Sweep, raw: dict[str, Any]) -> tuple[str, TriangleMesh]:
        """Check a scene and take it up; return its digest and mesh."""
        scene = parse_scene(sweep.scene_file, raw)
        key = json.dumps([raw["mesh"], raw.get("units")], sort_keys=True)  # USD is converted to the unit of length
        if key not in self._meshes:
            mesh = scene.build_mesh()
            faces = np.ascontiguousarray(mesh.faces, dtype="<i8")
            self._meshes[key] = mesh, mesh.vertices.astype("<f8").tobytes(), faces.tobytes()
        mesh, vertices, corners = self._meshes[key]
        self._check_parts(scene, mesh, key)
        digest = case_digest(scene, mesh)
        if digest not in self.tasks:
            self.tasks[digest] = Task(digest, str(sweep.scene_file), raw, vertices, corners)
        return digest, mesh

    def _check_parts(self, scene: Scene, mesh: TriangleMesh, key: str) -> None:
        """Build all but the model, once for the cases that differ in the model alone."""
        parts = {name: part for name, part in scene.content().items() if name != "model"}
        key += json.dumps(parts, sort_keys=True)
        if key not in self._checked:
            declared = scene.require_shell()
            shell = declared.build_shell(mesh)
            declared.build_loading(shell)
            declared.build_contacts(shell)
            self._checked.add(key)
