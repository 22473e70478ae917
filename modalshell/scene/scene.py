"""Scenes: the declaration in a file, and the shell, model and motion built from it."""

from __future__ import annotations

import hashlib
import json
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_vectors
from modalshell.core.errors import ModalShellWarning, OptionError, SceneError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.loads import Load, Loading, Scaled
from modalshell.mesh import TriangleMesh
from modalshell.mesh.parts import refuse_loose_parts
from modalshell.mesh.selection import held_vertices, selected
from modalshell.models import Equilibrium, Model
from modalshell.models.base.bars import check_bar
from modalshell.models.base.setup import given_contacts
from modalshell.models.factory import ModelFactory, SolveModes
from modalshell.motion import Motion, SupportPath, Trajectory
from modalshell.motion.motion_check import wanted_bars, with_bars
from modalshell.scene import tables
from modalshell.scene.coarse import scene_coarse_mesh
from modalshell.scene.models import ModelTable
from modalshell.scene.parts import (
    Shape,
    build_constraint,
    build_damping,
    build_material,
    build_mesh,
    build_path,
    build_tolerance,
    material_values,
    mesh_digest,
    spread_force,
)
from modalshell.scene.read import located
from modalshell.scene.remarks import hinged_clamp_remark, sliver_remark
from modalshell.scene.rest import CreaseTable, RestTable, build_creases, rest_content, rest_options
from modalshell.scene.sheets import CardTable, MaterialTable, SheetTable, odd_values
from modalshell.scene.signatures import energy_entries, load_entries
from modalshell.shell import Shell
from modalshell.shell.demands import demand_shell
from modalshell.statics.buckling import ADVICE, buckles
from modalshell.supports import Clamp, Support, Unknowns, supported_unknowns
from modalshell.supports.constraints import Constraint, checked_constraints

BARS_EVERY = 15
"""Frames from one error bar of a scene in motion to the next."""
_LOOKS = 256
"""Times of a path of which that of the largest load is taken."""


@dataclass(frozen=True, kw_only=True)
class Scene(ABC):
    """Declaration of a scene file: a :class:`ShellScene` of one shell, or a :class:`FlockScene` of many.

    Attributes
    ----------
    name : str
        Name of the results' files: ``name`` in the file, or the file's own.
    file : Path
        Where it was read from.
    mesh, material, model, supports, energies, loads, motion, output, units, rest, creases
        The tables; see :mod:`modalshell.scene.tables` and :mod:`modalshell.scene.rest`. None where not declared.
    """

    name: str
    file: Path
    mesh: tables.MeshFile | Shape
    material: MaterialTable
    model: ModelTable
    supports: tables.Supports | tables.SupportList | None = None
    energies: tables.Table | None = None
    loads: tables.Loads | None = None
    motion: tables.MotionTable | None = None
    output: tables.Output = field(default_factory=tables.Output)
    units: tables.Units | None = None
    rest: RestTable | None = None
    creases: tuple[CreaseTable, ...] = ()

    @abstractmethod
    def require_shell(self) -> ShellScene:
        """The scene itself if it is about one shell; SceneError if it is about a flock."""

    def own_page(self) -> Any:
        """The web page of a kind of scene that makes its own; None of one shell's."""
        return None

    def content(self) -> dict[str, Any]:
        """All input except the mesh's vertices and faces, as plain dicts and lists."""
        names = "material", "model", "supports", "energies", "loads", "motion", "units"
        content = {name: table.plain() for name in names if (table := getattr(self, name)) is not None}
        if isinstance(self.material, tables.PhysicalSheet):
            with located(self.file, "material", self.material):
                values = material_values(self.material, self.file.parent)
            content["material"] |= {name: np.asarray(value).tolist() for name, value in values.items()}
        # Results of scenes without these tables keep their digests.
        if self.rest is not None:
            content["rest"] = rest_content(self.file, self.rest, getattr(self.mesh, "up", None))
        content |= {"creases": [table.plain() for table in self.creases]} if self.creases else {}
        return content | {"positions": self.output.positions}

    def digests(self, mesh: TriangleMesh) -> dict[str, str]:
        """SHA-256 of the declaration and of the mesh's vertices and faces: together they determine the results."""
        content = json.dumps(self.content(), sort_keys=True).encode()
        return {"scene": hashlib.sha256(content).hexdigest(), "mesh": mesh_digest(mesh)}

    @property
    def unit_system(self) -> UnitSystem:
        """Units of the scene's numbers, and of its results."""
        return SI if self.units is None else self.units.system

    @property
    def _of_theory(self) -> bool:
        """Whether the shell is one of shell theory, with fold shares."""
        return isinstance(self.material, SheetTable) or not getattr(self.material, "calibrated", True)

    def build_mesh(self) -> TriangleMesh:
        """The mesh, generated or read from its file; SceneError where it is refused."""
        with located(self.file, "mesh", self.mesh):
            cells: Sequence[int] = getattr(self.mesh, "cells", ())
            if len(cells) == 2 and min(cells) > 0:  # before the mesh is made, which takes a while
                demand_shell((cells[0] + 1) * (cells[1] + 1), split=self._of_theory)
            return build_mesh(self.mesh, self.file.parent, self.unit_system.metres)

    def build_shell(self, mesh: TriangleMesh | None = None) -> Shell:
        """The shell with its mesh (``mesh`` if that is built already), material and supports.

        SceneError where one of them is refused.
        """
        mesh = mesh or self.build_mesh()
        remarks = odd_values(self.material, self.units or tables.Units(), mesh.size)
        with located(self.file, "material", self.material):
            if isinstance(self.material, CardTable) and (self.units or tables.Units()) != tables.Units():
                raise OptionError(f"name {self.material.name!r} is a card in m, kg and s: leave out [units]")
            material = build_material(self.material, mesh, self.file.parent)
        supports, unknowns = self._build_supports(mesh)
        remarks += filter(None, [sliver_remark(mesh) if self._of_theory else hinged_clamp_remark(mesh, supports)])
        for remark in remarks:
            warnings.warn(f"{self.file}: {remark}", ModalShellWarning, stacklevel=2)
        all_parts = isinstance(self.mesh, tables.MeshFile) and self.mesh.component == "all"
        if isinstance(self.mesh, tables.MeshFile) and not all_parts:
            with located(self.file, "supports", self.mesh):
                refuse_loose_parts(mesh, unknowns.supported)
        energies = []
        for path, entry in energy_entries(self.energies):
            with located(self.file, path, entry):
                energies.append(entry.build())
        options = rest_options(self.file, self.rest, getattr(self.mesh, "up", None), self.unit_system.metres)
        if self.creases:
            options["creases"] = build_creases(self.file, self.creases, mesh, options.get("rest"))
        place = ("rest", self.rest) if self.rest is not None else ("material", self.material)
        with located(self.file, *place):
            return Shell(mesh, material, supports=supports, energies=energies, loose_parts=all_parts, **options)

    def _build_supports(self, mesh: TriangleMesh) -> tuple[list[Support], Unknowns]:
        """The supports on ``mesh``, and what they leave free; SceneError where one is refused."""
        supports: list[Support] = []
        if isinstance(self.supports, tables.Supports):
            with located(self.file, "supports", self.supports):
                held = held_vertices(selected("clamped", self.supports.clamped, mesh), len(mesh.vertices))
                supports.append(Clamp(held))
        elif self.supports is not None:
            for index, entry in enumerate(self.supports.entries):
                if isinstance(entry, tables.Path):
                    continue
                with located(self.file, f"supports[{index}]", entry):
                    supports.append(entry.build())
                    supports[-1].vertices(mesh)
        with located(self.file, "supports", self.output):
            return supports, supported_unknowns(supports, mesh)


@final
@short_repr
@dataclass(frozen=True, kw_only=True)
class ShellScene(Scene):
    """A scene of one shell; :meth:`build` makes its objects. Without ``motion`` it asks for an equilibrium.

    Attributes
    ----------
    name, file, mesh, material, model, supports, energies, loads, motion, output
        See :class:`Scene`.
    constraints : tuple of Constrained
        Prescribed positions and orientations of patches.
    contacts : tuple of ContactTable
        Colliders; see :mod:`modalshell.scene.contacts`.
    path : PathTable or None
        How its path of equilibria is followed.
    bar : bool
        Whether its equilibrium, or some frames of its motion, get error bars against DS.
    """

    constraints: tuple[tables.Constrained, ...] = ()
    contacts: tuple[Any, ...] = ()
    path: tables.PathTable | None = None
    bar: bool = False

    def require_shell(self) -> ShellScene:
        """The scene itself."""
        return self

    def content(self) -> dict[str, Any]:
        """All input except the mesh's vertices and faces, as plain dicts and lists."""
        content = super().content() | {"constraints": [table.plain() for table in self.constraints]}
        # Results of scenes without contacts keep their digests.
        content |= {"contacts": [table.content(self.file.parent) for table in self.contacts]} if self.contacts else {}
        return content | ({"bar": True} if self.bar else {})

    def build(self, shell: Shell | None = None, solve: SolveModes | None = None) -> BuiltScene:
        """Everything that the scene declares, on ``shell`` if that is built already, with modes by ``solve``.

        SceneError where a table is refused, naming its key. SolverError if the modes cannot be computed.
        """
        shell = shell or self.build_shell()
        path, force, loads, constraints = self.build_loading(shell)
        if constraints and not self.model.spec.constraints:
            raise SceneError(f"{self.file}: constraints: {self.model.spec.name} takes none; use a modal model or ds")
        with located(self.file, "model", self.model):
            model = self.model.build(self.model_factory(shell, solve))
        contacts = self.build_contacts(shell)
        if self.bar:
            try:
                check_bar(shell, constraints=constraints, contacts=contacts)
                if self.motion is not None:
                    wanted_bars(BARS_EVERY, model, contacts, self.motion.dt, path, constraints)
            except OptionError as error:
                raise SceneError(f"{self.file}: bar: {error}") from error
        return BuiltScene(self, shell, model, force, loads, path, constraints, contacts)

    def build_contacts(self, shell: Shell | None = None) -> list[Any]:
        """The contacts; SceneError where a table is refused, or selects no vertex of a shell that can move."""
        contacts = []
        for index, table in enumerate(self.contacts):
            with located(self.file, f"contacts[{index}]", table):
                if table.path is not None and self.motion is None:
                    raise OptionError("path needs a [motion] table: statics knows no time")
                contacts.append(contact := table.contact(self.file.parent, self.unit_system.metres))
                if shell is not None:
                    given_contacts([contact], shell)
        return contacts

    @property
    def gravity(self) -> tables.Vector | None:
        """Acceleration on every vertex [m/s^2]."""
        return self.loads.gravity if self.loads else None

    def model_factory(self, shell: Shell, solve: SolveModes | None = None) -> ModelFactory:
        """What builds models on ``shell``, with modes by ``solve``, the loads and the coarser meshes of this scene."""
        coarse = partial(scene_coarse_mesh, self.mesh, self.material, shell)
        return ModelFactory(shell, lambda: self.largest_load(shell)[0], coarse, solve)

    def largest_load(self, shell: Shell) -> tuple[Array, str]:
        """All loads (n, 3) [N], with the largest inertial load of moving supports, and notes about it, in sentences."""
        force, loads = self.build_forces(shell)
        loading = shell.loading(self.gravity, force, loads)
        load, note = loading.dead, ""
        if loading.live:
            load = load + loading.largest_force()
            note = "Loads that change are taken as they are at rest, at their largest."
        path = build_path(self.supports)
        if path is None:
            return load, note
        still, times, unit = np.zeros_like(load), path.samples(_LOOKS).tolist(), self.unit_system.time
        poses = ((path.at(time, "before" if time == times[-1] else "after"), time) for time in times)
        felt = ((pose.shell_load(load, shell.mass, shell.rest_positions, still), time) for pose, time in poses)
        worst, at = max(felt, key=lambda one: np.sum(one[0][shell.free] ** 2 / shell.mass[shell.free, None]))
        moved = f"The load is that of the moving supports when it is largest, at {at:.3g} {unit}."
        return worst, " ".join(filter(None, (moved, note)))

    def build_loading(self, shell: Shell) -> tuple[SupportPath | None, Array | None, list[Load], list[Constraint]]:
        """Build path of the supports, dead forces (n, 3) [N] without gravity, loads and constraints on ``shell``.

        SceneError where a table is refused, naming its key.
        """
        path, constraints = None, list[Constraint]()
        force, loads = self.build_forces(shell)
        if self.supports is not None:
            place, declared = "supports", cast(tables.Table, self.supports)
            if isinstance(self.supports, tables.SupportList) and (moved := self.supports.path) is not None:
                place, declared = f"supports[{self.supports.entries.index(moved)}]", moved
            with located(self.file, place, declared):
                path = build_path(self.supports)
        if path is not None and self.motion is None:
            raise SceneError(f"{self.file}: supports.times: supports that move need a [motion] table")
        for index, table in enumerate(self.constraints):
            with located(self.file, f"constraints[{index}]", table):
                constraint = build_constraint(table, shell.mesh, self.motion is not None)
                constraints += checked_constraints([constraint], shell.unknowns)
        return path, force, loads, constraints

    def build_forces(self, shell: Shell) -> tuple[Array | None, list[Load]]:
        """The dead forces (n, 3) [N] in addition to gravity, or None, and the other loads.

        SceneError where a table is refused.
        """
        mesh, forces, loads = shell.mesh, [], list[Load]()
        for index, table in enumerate(self.loads.forces if self.loads else ()):
            with located(self.file, f"loads.forces[{index}]", table):
                forces.append(spread_force(table, mesh))
        for path, entry in load_entries(self.loads):
            with located(self.file, path, entry):
                load = entry.load()
                if isinstance(load, Scaled) and self.motion is None:
                    raise OptionError("times and factors need a [motion] table: statics knows no time")
                if load.applied(mesh, shell.mass) is None:
                    forces.append(checked_vectors("force", load.force(mesh), mesh.vertices.shape))
                else:
                    loads.append(load)
        return sum(forces[1:], forces[0]) if forces else None, loads


@final
@short_repr
@dataclass(frozen=True)
class BuiltScene:
    """A scene's parts."""

    scene: ShellScene
    shell: Shell
    model: Model
    force: Array | None
    """Dead forces on the vertices, without gravity [N]; shape (n, 3)."""
    loads: Sequence[Load]
    path: SupportPath | None
    constraints: Sequence[Constraint]
    """On patches of vertices."""
    contacts: Sequence[Any] = ()

    @property
    def gravity(self) -> tables.Vector | None:
        """Acceleration on every vertex [m/s^2]."""
        return self.scene.gravity

    def start_motion(self) -> Motion:
        """The motion, at rest at time 0; SceneError if the scene declares none or one that the model cannot make."""
        table = self.scene.motion
        if table is None:
            raise SceneError(f"{self.scene.file}: motion: missing; without it the scene asks for an equilibrium")
        with located(self.scene.file, "motion", table, self.contacts):
            return self.motion_of(self.model, self.gravity, table)

    def motion_of(self, model: Model, gravity: ArrayLike | None, table: tables.MotionTable) -> Motion:
        """The motion of a ``model`` from rest under a gravity (3,) and the other loads of the scene, by a table."""
        return Motion(
            model,
            model.shell.loading(gravity, self.force, self.loads),
            dt=table.dt,
            damping=build_damping(table),
            supports=self.path,
            constraints=self.constraints,
            contacts=self.contacts,
            tolerance=build_tolerance(table),
        )

    def judged(self, run: Trajectory) -> Trajectory:
        """A motion of the scene with error bars, where it asks for them, and a remark if its load buckles the shell.

        Of an equilibrium the model has said so itself.
        """
        if (table := self.scene.motion) is None:
            return run
        if self.scene.model.spec.quadratic and buckles(self.shell, self.loading().force(self.shell.rest_positions)):
            run = run.with_remark(ADVICE)
        if not self.scene.bar:
            return run
        wanted = wanted_bars(BARS_EVERY, self.model, self.contacts, table.dt, self.path, self.constraints)
        return with_bars(run, self.model, self.loading(), wanted, damping=build_damping(table), supports=self.path)

    def loading(self) -> Loading:
        """All loads together."""
        return self.shell.loading(self.gravity, self.force, self.loads)

    def equilibrium(self) -> Equilibrium:
        """The static answer."""
        options: dict[str, Any] = {"constraints": self.constraints, "bar": self.scene.bar, "contacts": self.contacts}
        options = {name: given for name, given in options.items() if given}
        with located(self.scene.file, "model", self.scene.model, self.contacts):
            return self.model.equilibrium(gravity=self.gravity, force=self.force, loads=self.loads, **options)
