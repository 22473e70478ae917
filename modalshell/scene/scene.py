"""A scene: what its file declares, and the shell, model and motion that are built from it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.errors import SceneError
from modalshell.motion import Motion, SupportPath
from modalshell.rungs import Constraint, DiscreteShell, Equilibrium, Model
from modalshell.rungs.constraints import checked_constraints
from modalshell.rungs.modal import ModalModel
from modalshell.rungs.model import total_load
from modalshell.scene import tables
from modalshell.scene.models import MODELS, ModelTable
from modalshell.scene.parts import (
    SHAPES,
    Shape,
    build_constraint,
    build_material,
    build_mesh,
    build_path,
    select,
    spread_force,
)
from modalshell.scene.read import checked_table, chosen, located, read_toml, refuse_unknown_keys
from modalshell.shell import Shell
from modalshell.shell.supports import held_vertices

Array = NDArray[np.float64]

_NAME = "[A-Za-z0-9][A-Za-z0-9_-]{0,99}"
_REQUIRED = ("mesh", "material", "model")
_TABLES = ("name", *_REQUIRED, "supports", "loads", "constraints", "motion", "output")


@dataclass(frozen=True)
class Scene:
    """What a scene file declares; :meth:`build` makes it real.

    Attributes
    ----------
    name : str
        Name of the results' files: ``name`` in the file, or the file's own.
    file : Path
        Where it was read from.
    mesh, material, model, supports, loads, constraints, motion, output
        The tables; see :mod:`modalshell.scene.tables`. None or empty where not declared. Without ``motion`` the scene
        asks for an equilibrium.
    """

    name: str
    file: Path
    mesh: tables.MeshFile | Shape
    material: tables.Stiffnesses | tables.PhysicalSheet
    model: ModelTable
    supports: tables.Supports | None = None
    loads: tables.Loads | None = None
    constraints: tuple[tables.Constrained, ...] = ()
    motion: tables.Motion | None = None
    output: tables.Output = field(default_factory=tables.Output)

    def content(self) -> dict[str, Any]:
        """All that decides the results beside the mesh's own vertices and faces, as plain dicts and lists."""
        declared = {name: getattr(self, name) for name in ("material", "model", "supports", "loads", "motion")}
        content = {name: table.plain() for name, table in declared.items() if table is not None}
        content["constraints"] = [table.plain() for table in self.constraints]
        return content | {"positions": self.output.positions}

    def build_shell(self) -> Shell:
        """The shell with its mesh, material and supports; SceneError where one of them is refused."""
        with located(self.file, "mesh", self.mesh):
            mesh = build_mesh(self.mesh, self.file.parent)
        with located(self.file, "material", self.material):
            material = build_material(self.material, mesh)
        held = None
        if self.supports is not None:
            with located(self.file, "supports", self.supports):
                held = held_vertices(select("clamped", self.supports.clamped, mesh), len(mesh.vertices))
        with located(self.file, "material", self.material):
            return Shell(mesh, material, held)

    def build(self, shell: Shell | None = None) -> BuiltScene:
        """Everything that the scene declares, on ``shell`` if that is built already.

        Raises
        ------
        SceneError
            Where a table is refused, naming its key.
        SolverError
            Where the modes cannot be found.
        """
        shell = shell or self.build_shell()
        path, force, constraints = None, None, []
        if self.supports is not None:
            with located(self.file, "supports", self.supports):
                path = build_path(self.supports)
        if path is not None and self.motion is None:
            raise SceneError(f"{self.file}: supports.times: supports that move need a [motion] table")
        for index, load in enumerate(self.loads.forces if self.loads else ()):
            with located(self.file, f"loads.forces[{index}]", load):
                spread = spread_force(load, shell.mesh)
                force = spread if force is None else force + spread
        for index, table in enumerate(self.constraints):
            with located(self.file, f"constraints[{index}]", table):
                constraint = build_constraint(table, shell.mesh, self.motion is not None)
                constraints += checked_constraints([constraint], shell)
        with located(self.file, "model", self.model):
            model = self.model.build(shell)
        if constraints and not isinstance(model, ModalModel | DiscreteShell):
            raise SceneError(f"{self.file}: constraints: {model.name} takes none; use a modal model or ds")
        return BuiltScene(self, shell, model, force, path, constraints)


@dataclass(frozen=True)
class BuiltScene:
    """A scene's parts.

    Attributes
    ----------
    scene : Scene
        What was declared.
    shell : Shell
        The shell.
    model : Model
        The model on it.
    force : ndarray, shape (n, 3), or None
        Forces on the vertices beside gravity [N].
    path : SupportPath or None
        How the supports move.
    constraints : sequence of Constraint
        On patches of vertices.
    """

    scene: Scene
    shell: Shell
    model: Model
    force: Array | None
    path: SupportPath | None
    constraints: Sequence[Constraint]

    @property
    def gravity(self) -> tables.Vector | None:
        """Acceleration on every vertex [m/s^2]."""
        return self.scene.loads.gravity if self.scene.loads else None

    def start_motion(self) -> Motion:
        """The motion, at rest at time 0; SceneError if the scene declares none or one that the model cannot make."""
        table = self.scene.motion
        if table is None:
            raise SceneError(f"{self.scene.file}: motion: missing; without it the scene asks for an equilibrium")
        with located(self.scene.file, "motion", table):
            return Motion(
                self.model,
                dt=table.dt,
                gravity=self.gravity,
                force=self.force,
                damping=table.damping,
                supports=self.path,
                constraints=self.constraints,
            )

    def load(self) -> Array:
        """All loads (n, 3) [N]."""
        return total_load(self.shell, self.gravity, self.force)

    def equilibrium(self) -> Equilibrium:
        """The static answer."""
        options: dict[str, Any] = {"constraints": self.constraints} if self.constraints else {}
        with located(self.scene.file, "model", self.scene.model):
            return self.model.equilibrium(gravity=self.gravity, force=self.force, **options)


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : path
        A TOML file with the tables of :mod:`modalshell.scene.tables`.

    Raises
    ------
    SceneError
        For a file that cannot be read, unknown keys, wrong types and values out of range: names the file and the
        key's path, what was got and what is allowed. Values that depend on the mesh are checked by
        :meth:`Scene.build`.
    """
    file = Path(path)
    raw = read_toml(file)
    refuse_unknown_keys(file, "", raw, _TABLES)
    for name in _REQUIRED:
        if name not in raw:
            raise SceneError(f"{file}: {name}: missing; every scene needs the tables {', '.join(_REQUIRED)}")
    name = raw.get("name", file.stem)
    if not isinstance(name, str) or not re.fullmatch(_NAME, name):
        allowed = "1 to 100 letters, digits, _ and -, a letter or digit first: it names the results' files"
        raise SceneError(f"{file}: name: must be {allowed} (got {name!r:.60})")
    entries = raw.get("constraints", [])
    if not isinstance(entries, list):
        raise SceneError(f"{file}: constraints: must be a list of tables, [[constraints]] (got {entries!r:.60})")
    optional: dict[str, Any] = {
        key: checked_table(file, key, raw[key], kind)
        for key, kind in (
            ("supports", tables.Supports),
            ("loads", tables.Loads),
            ("motion", tables.Motion),
            ("output", tables.Output),
        )
        if key in raw
    }
    motion = optional.get("motion")
    if motion is not None and motion.duration < motion.dt:
        raise SceneError(
            f"{file}: motion.duration: must be at least one step of {motion.dt:g} s (got {motion.duration:g})"
        )
    return Scene(
        name,
        file,
        _mesh_table(file, raw["mesh"]),
        _material_table(file, raw["material"]),
        checked_table(file, "model", raw["model"], chosen(file, "model", raw["model"], "name", MODELS)),
        constraints=tuple(
            checked_table(file, f"constraints[{index}]", entry, tables.Constrained)
            for index, entry in enumerate(entries)
        ),
        **optional,
    )


def _mesh_table(file: Path, raw: Any) -> tables.MeshFile | Shape:
    if isinstance(raw, dict) and ("file" in raw) == ("shape" in raw):
        raise SceneError(f"{file}: mesh: must have either file or shape ({', '.join(SHAPES)}), and not both")
    if isinstance(raw, dict) and "file" in raw:
        return checked_table(file, "mesh", raw, tables.MeshFile)
    return checked_table(file, "mesh", raw, chosen(file, "mesh", raw, "shape", SHAPES))


def _material_table(file: Path, raw: Any) -> tables.Stiffnesses | tables.PhysicalSheet:
    if isinstance(raw, dict) and not {"young", "poisson", "thickness"}.isdisjoint(raw):
        return checked_table(file, "material", raw, tables.PhysicalSheet)
    return checked_table(file, "material", raw, tables.Stiffnesses)
