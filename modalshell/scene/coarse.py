"""Coarse meshes of a scene's surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from modalshell.errors import OptionError
from modalshell.mesh import TriangleMesh
from modalshell.models.coarse_shell import CoarseMesh, drawn_to_supports
from modalshell.scene.parts import Shape, build_material
from modalshell.scene.tables import MeshFile, PhysicalSheet, Stiffnesses
from modalshell.shell import Shell

_COARSENINGS = (2.0, 3.0, 4.0)
"""Factors by which the cells of coarser meshes are larger."""
_FEWEST = (6, 2)
"""Least number of cells along and across of a coarse mesh."""


def scene_coarse_mesh(
    table: MeshFile | Shape,
    material: Stiffnesses | PhysicalSheet,
    shell: Shell,
    cells: tuple[int, int] | None = None,
) -> CoarseMesh:
    """The scene's shape with ``cells`` along and across, by default half as many; OptionError for mesh files."""
    given: Any = table
    if not isinstance(table, Shape):
        raise OptionError("coarse meshes are made of shapes with cells: name a [mesh] shape in place of a file")
    if not _uniform(material):
        raise OptionError("coarse meshes take a material of single numbers: values per triangle belong to one mesh")
    cells = cells or coarse_cells(given.cells, _COARSENINGS[0])
    mesh: TriangleMesh = drawn_to_supports(shell, msgspec.structs.replace(given, cells=cells).build())
    own = build_material(material, mesh, Path()) if isinstance(material, PhysicalSheet) else None
    return CoarseMesh(mesh, f"{cells[0]}x{cells[1]}", own, cells)


def scene_coarse_meshes(
    table: MeshFile | Shape, material: Stiffnesses | PhysicalSheet, shell: Shell
) -> list[CoarseMesh]:
    """Coarse meshes of a shape, at most half as fine; none for a mesh file or a material that varies."""
    if not isinstance(table, Shape) or not _uniform(material):
        return []
    given: Any = table
    sizes = dict.fromkeys(coarse_cells(given.cells, factor) for factor in _COARSENINGS)
    kept = [cells for cells in sizes if cells[0] * cells[1] <= 0.5 * given.cells[0] * given.cells[1]]
    return [scene_coarse_mesh(table, material, shell, cells) for cells in kept]


def _uniform(material: Stiffnesses | PhysicalSheet) -> bool:
    """Whether it is of single numbers."""
    return all(isinstance(value, float | int) for value in material.plain().values())


def coarse_cells(cells: tuple[int, int], factor: float) -> tuple[int, int]:
    """Cells along and across after coarsening by ``factor``."""
    along, across = (round(count / factor) for count in cells)
    across += across % 2  # a fold needs a row of edges
    return max(along, _FEWEST[0]), max(across, _FEWEST[1])
