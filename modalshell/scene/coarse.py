"""Coarse meshes of a scene's surface."""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from modalshell.core.errors import MeshError, ModalShellWarning, OptionError, SupportError
from modalshell.mesh import TriangleMesh
from modalshell.models.coarse.coarse_mesh import drawn_to_supports
from modalshell.models.coarse.coarse_shell import CoarseMesh, remeshed
from modalshell.models.coarse.taken_over import edges_to_keep
from modalshell.scene.parts import Shape, build_material
from modalshell.scene.sheets import MaterialTable, SheetTable
from modalshell.scene.tables import MeshFile, PhysicalSheet
from modalshell.shell import Material, Sheet, Shell

_COARSENINGS = (2.0, 3.0, 4.0)
"""Factors by which the cells of coarser meshes are larger."""
_FEWEST = (6, 2)
"""Least number of cells along and across of a coarse mesh."""


def scene_coarse_mesh(
    table: MeshFile | Shape,
    material: MaterialTable,
    shell: Shell,
    cells: tuple[int, int] | None = None,
    triangles: int | None = None,
) -> CoarseMesh:
    """A coarse mesh of the scene's surface, by default with cells twice as large, or the shell's where those are few.

    A shape is generated with ``cells`` along and across, or with those that give about as many as
    ``triangles``. The mesh of a file is remeshed (extra ``remesh``), and so is a shape in ``triangles`` that must keep
    edges: creases, or bounds of regions.
    """
    if not _transferable(material):
        raise OptionError(
            "coarse meshes take a material of discrete shells of single numbers: values per element belong to one mesh"
        )
    if cells is not None and triangles is not None:
        raise OptionError("cells must be left out with triangles: both say how coarse the mesh is")
    if isinstance(table, Shape) and (triangles is None or not edges_to_keep(shell).size):
        return _generated(table, material, shell, cells, triangles)
    if cells is not None:
        raise OptionError("cells must be left out with a mesh file, which has none: give triangles in their place")
    made = remeshed(shell, triangles or round(len(shell.mesh.faces) / _COARSENINGS[0] ** 2))
    return replace(made, material=_own(material, made.mesh))


def _generated(
    table: Shape,
    material: MaterialTable,
    shell: Shell,
    cells: tuple[int, int] | None,
    triangles: int | None,
) -> CoarseMesh:
    """The shape with ``cells``, or with about ``triangles``."""
    given: Any = table
    options: dict[str, Any] = {} if triangles is None else {"triangles": triangles}
    count = len(shell.mesh.faces)
    if triangles is not None and triangles >= count:
        raise OptionError(f"triangles must be fewer than the {count} of the shell (got {triangles})")
    if cells is not None and cells[0] * cells[1] > count:  # a cell has a triangle or more
        raise OptionError(f"cells must make at most the {count} triangles of the shell (got {cells}, which make more)")
    factor = _COARSENINGS[0] if triangles is None else float(np.sqrt(count / triangles))
    chosen = cells or coarse_cells(given.cells, factor)
    made = msgspec.structs.replace(given, cells=chosen).build()
    if len(made.faces) > count and cells is None and triangles is None:
        chosen, made = given.cells, shell.mesh
    if (found := len(made.faces)) > count:
        if cells is not None:
            raise OptionError(f"cells must make at most the {count} triangles of the shell (got {cells}, {found})")
        raise OptionError(
            f"triangles must be fewer, or left out: the nearest cells, {chosen}, make {found}, more than the {count} "
            f"of the shell (got {triangles})"
        )
    mesh = drawn_to_supports(shell, made)
    return CoarseMesh(mesh, f"{chosen[0]}x{chosen[1]}", _own(material, mesh), options or {"cells": tuple(chosen)})


def _own(material: MaterialTable, mesh: TriangleMesh) -> Material | Sheet | None:
    """The material of shell theory on ``mesh``; None where it is that of the shell, or a field of it."""
    physical = isinstance(material, PhysicalSheet | SheetTable) and _uniform(material)
    return build_material(material, mesh, Path()) if physical else None


def scene_coarse_meshes(table: MeshFile | Shape, material: MaterialTable, shell: Shell) -> list[CoarseMesh]:
    """Coarse meshes at most half as fine; none for stiffnesses that vary, or a file where MeshLab cannot remesh it."""
    if not _transferable(material):
        return []
    if isinstance(table, Shape):
        given: Any = table
        sizes = dict.fromkeys(coarse_cells(given.cells, factor) for factor in _COARSENINGS)
        kept = [cells for cells in sizes if cells[0] * cells[1] <= 0.5 * given.cells[0] * given.cells[1]]
        return [scene_coarse_mesh(table, material, shell, cells) for cells in kept]
    meshes = []
    # Nobody asked for this number of triangles, so that another one needs no warning.
    with warnings.catch_warnings(action="ignore", category=ModalShellWarning):
        for factor in _COARSENINGS:
            with suppress(MeshError, OptionError, SupportError):
                size = round(len(shell.mesh.faces) / factor**2)
                meshes.append(scene_coarse_mesh(table, material, shell, triangles=size))
    return meshes


def _transferable(material: MaterialTable) -> bool:
    """Whether a coarse shell can take it over: numbers, or fields of a sheet."""
    return _uniform(material) or (isinstance(material, PhysicalSheet) and not material.calibrated)


def _uniform(material: MaterialTable) -> bool:
    """Whether it is of single numbers."""
    if isinstance(material, SheetTable):
        return True
    return all(isinstance(value, float | int) for value in material.plain().values())


def coarse_cells(cells: tuple[int, int], factor: float) -> tuple[int, int]:
    """Cells along and across after coarsening by ``factor``."""
    along, across = (round(count / factor) for count in cells)
    across += across % 2  # a fold needs a row of edges
    return max(along, _FEWEST[0]), max(across, _FEWEST[1])
