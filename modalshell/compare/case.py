"""What the rungs are compared on: a shell under a load that grows from nothing, and coarser meshes of it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from modalshell.checks import checked_kind
from modalshell.errors import MeshError, OptionError
from modalshell.mesh import TriangleMesh
from modalshell.models import Damping
from modalshell.models.base import total_load
from modalshell.models.coarse_discrete_shell import closest_points
from modalshell.modes.rigid import rigid_motions
from modalshell.scene import Scene, load_scene
from modalshell.scene.parts import Shape, build_material, build_path
from modalshell.scene.tables import PhysicalSheet
from modalshell.shell import Material, Shell
from modalshell.typing import Array

_FRAME = 1.0 / 60.0
"""Time between frames [s] where the scene declares no motion."""
_COARSENINGS = (2.0, 3.0, 4.0)
"""Factors by which the cells of coarser meshes are larger."""
_FEWEST = (6, 2)
"""Cells along and across below which a coarse mesh is none any more."""


@dataclass(frozen=True)
class CoarseMesh:
    """A coarser mesh of the same surface, its material where that is calibrated on the mesh, and a short name."""

    mesh: TriangleMesh
    name: str
    material: Material | None = None


@dataclass(frozen=True)
class Case:
    """What the rungs are compared on.

    Attributes
    ----------
    name : str
        For titles and files.
    shell : Shell
        The shell, held by its supports.
    load : ndarray, shape (n, 3)
        The whole load [N]; the load range is from none to this.
    dt : float
        Time between frames [s].
    damping : Damping
        Of the motion whose frames are timed.
    coarse : sequence of CoarseMesh
        Coarser meshes to run discrete shells on.
    note : str
        How the load came about, where that has to be said.
    """

    name: str
    shell: Shell
    load: Array = field(repr=False)
    dt: float = _FRAME
    damping: Damping = field(default_factory=Damping)
    coarse: Sequence[CoarseMesh] = ()
    note: str = ""

    def __post_init__(self) -> None:
        if loose := rigid_motions(self.shell).shape[1]:
            raise OptionError(
                f"the supports leave {loose} rigid motions free, so that no equilibrium exists to compare rungs at: "
                "hold more vertices"
            )
        if not self.load[self.shell.free].any():
            raise OptionError(
                f"{self.name!r}: no load moves the shell, so there is nothing to compare: give gravity or forces"
            )


def make_case(
    scene: Scene | Shell | Case | str | os.PathLike[str],
    gravity: ArrayLike | None,
    force: ArrayLike | None,
    coarse: Sequence[TriangleMesh],
) -> Case:
    """The case of a scene or its file, or of a shell under ``gravity`` and ``force`` with ``coarse`` meshes."""
    if isinstance(scene, Case | Scene | str | os.PathLike):
        if gravity is not None or force is not None or len(coarse):
            raise OptionError("a scene brings its own load and meshes: gravity, force and coarse go with a Shell")
        if isinstance(scene, Case):
            return scene
        return scene_case(scene if isinstance(scene, Scene) else load_scene(scene))
    checked_kind("scene", scene, Shell)
    meshes = [CoarseMesh(drawn_to_supports(scene, mesh), f"{len(mesh.faces)} triangles") for mesh in coarse]
    return Case("shell", scene, total_load(scene, gravity, force), coarse=meshes)


def scene_case(scene: Scene) -> Case:
    """The case that a scene asks for; moving supports give the largest inertial load of their path."""
    if scene.constraints:
        raise OptionError(
            f"{scene.file}: constraints: rungs are compared under loads, not under constraints; leave them out, or "
            "give a force in their place"
        )
    shell = scene.build_shell()
    load, note = total_load(shell, scene.loads.gravity if scene.loads else None, scene.build_force(shell.mesh)), ""
    path = build_path(scene.supports) if scene.supports else None
    if path is not None:
        still = np.zeros_like(load)
        times = np.linspace(path.times[0], path.times[-1], 1 + int(np.ceil((path.times[-1] - path.times[0]) * 120.0)))
        felt = [path.at(float(t)).shell_load(load, shell.mass, shell.rest_positions, still) for t in times]
        worst = int(np.argmax([np.sum(one[shell.free] ** 2 / shell.mass[shell.free, None]) for one in felt]))
        load = felt[worst]
        note = f"the load is that of the moving supports when it is largest, at {times[worst]:.3g} s"
    motion = scene.motion
    return Case(
        scene.name,
        shell,
        load,
        motion.dt if motion else _FRAME,
        Damping(*motion.damping) if motion else Damping(),
        coarse_meshes(scene, shell),
        note,
    )


def coarse_meshes(scene: Scene, shell: Shell) -> list[CoarseMesh]:
    """Coarser meshes of a scene whose mesh is a shape with cells; none of a mesh from a file."""
    table = scene.mesh
    if not isinstance(table, Shape):
        return []
    given: Any = table
    made: dict[tuple[int, int], CoarseMesh] = {}
    for factor in _COARSENINGS:
        along, across = (round(count / factor) for count in given.cells)
        across += across % 2  # a fold needs a row of edges
        cells = (max(along, _FEWEST[0]), max(across, _FEWEST[1]))
        if cells in made or cells[0] * cells[1] > 0.5 * given.cells[0] * given.cells[1]:
            continue
        mesh = drawn_to_supports(shell, msgspec.structs.replace(given, cells=cells).build())
        material = build_material(scene.material, mesh) if isinstance(scene.material, PhysicalSheet) else None
        made[cells] = CoarseMesh(mesh, f"{cells[0]}x{cells[1]}", material)
    return list(made.values())


def drawn_to_supports(shell: Shell, mesh: TriangleMesh) -> TriangleMesh:
    """A coarse mesh with a second row of vertices where the held region of ``shell`` ends.

    With one held row it would be hinged where the fine shell is clamped. The neighbours of that row are moved onto the
    held vertices nearest to them.
    """
    nearest, shares, _ = closest_points(shell.mesh, mesh.vertices)
    held = shell.clamped[shell.mesh.faces[nearest, shares.argmax(axis=1)]]
    if not held.any() or held[mesh.faces].all(axis=1).any():
        return mesh
    beside = np.zeros(len(held), dtype=bool)
    beside[mesh.faces[held[mesh.faces].any(axis=1)]] = True
    places = shell.rest_positions[shell.clamped]
    vertices = np.array(mesh.vertices)
    for vertex in np.flatnonzero(beside & ~held):
        vertices[vertex] = places[np.argmin(np.linalg.norm(places - vertices[vertex], axis=1))]
    try:
        moved = TriangleMesh(vertices, mesh.faces)
    except MeshError:  # the fine shell has one held row too
        return mesh
    return moved if moved.face_areas.min() > 0.02 * moved.face_areas.mean() else mesh
