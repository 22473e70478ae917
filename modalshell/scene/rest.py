"""``[rest]`` and ``[[creases]]`` of a scene: a shape without stress that is not the mesh, and edges that yield."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from modalshell.core.checks import as_array
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.scene import tables
from modalshell.scene.parts import build_mesh, file_numbers
from modalshell.scene.read import located
from modalshell.shell import Crease, Temperature

_Chosen = str | Annotated[list[tables.Vertex | bool | list[tables.Vertex]], Meta(min_length=1)]
"""Vertices as elsewhere, or edges as pairs of them."""
_Numbers = float | list[float] | Annotated[str, Meta(min_length=1)]
"""One number, one per triangle, or a file of these."""
_Tensor = float | list[float | list[float]] | Annotated[str, Meta(min_length=1)]
"""A number for all directions, one per triangle or a file of these, or a tensor in space by its rows."""


class RestTable(tables.Table, frozen=True):
    """``[rest]``: the shape without stress, where that is not the mesh; see :class:`modalshell.Shell`.

    ``file``: another mesh with the same triangles, found as that of ``[mesh]`` and with the same axis ``up``.
    ``prestrain`` and ``rest_curvature`` [1/m]: a number, one per triangle, a file of these, or a tensor in space by its
    rows. A change of temperature: ``change`` [K] and ``through`` the thickness [K] by the ``expansion`` [1/K].
    """

    file: Annotated[str, Meta(min_length=1)] | None = None
    prestrain: _Tensor | None = None
    rest_curvature: _Tensor | None = None
    change: _Numbers = 0.0
    through: _Numbers = 0.0
    expansion: float | None = None

    @property
    def files(self) -> list[str]:
        """Files that it names."""
        named = (self.file, self.prestrain, self.rest_curvature, self.change, self.through)
        return [value for value in named if isinstance(value, str)]


class CreaseTable(tables.Table, frozen=True):
    """``[[creases]]``: edges that yield; see :class:`modalshell.Crease`. ``sel`` may be pairs of vertices."""

    sel: _Chosen
    yield_moment: float
    hardening: float = 0.0
    angle: float | None = None

    def build(self) -> Crease:
        """The crease."""
        return Crease(self.sel, self.yield_moment, self.hardening, self.angle)  # type: ignore[arg-type]  # its own check is the same


def rest_options(file: Path, table: RestTable | None, up: Any, metres: float) -> dict[str, Any]:
    """Parameters of a shell's rest shape; SceneError where one is refused. ``metres`` is the unit of length [m]."""
    if table is None:
        return {}
    with located(file, "rest", table):
        options: dict[str, Any] = {}
        for name in ("prestrain", "rest_curvature"):
            if (value := getattr(table, name)) is not None:
                options[name] = _values(name, value, file.parent)
        warm = [_values(name, getattr(table, name), file.parent) for name in ("change", "through")]
        if table.expansion is not None:
            options["temperature"] = Temperature(warm[0], table.expansion, warm[1])
        elif any(np.any(value) for value in warm):
            raise OptionError("expansion must be given with a change of temperature [1/K]")
        if table.file is not None:
            options["rest"] = build_mesh(tables.MeshFile(file=table.file, up=up), file.parent, metres)
        if not options:
            raise OptionError(
                "the table must have file, prestrain, rest_curvature, or expansion with change or through"
            )
        return options


def build_creases(
    file: Path, entries: Sequence[CreaseTable], mesh: TriangleMesh, rest: TriangleMesh | None
) -> list[Crease]:
    """The creases; SceneError where one is refused."""
    made = []
    at_rest = rest if rest is not None and np.array_equal(rest.faces, mesh.faces) else mesh  # others a shell refuses
    for index, table in enumerate(entries):
        with located(file, f"creases[{index}]", table):
            made.append(table.build())
            made[-1].hinges(mesh, at_rest)
    return made


def rest_content(file: Path, table: RestTable, up: Any) -> dict[str, Any]:
    """The table as plain values, with digests of the mesh, which its file may take from others, and of numbers."""
    content: dict[str, Any] = msgspec.to_builtins(table)
    with located(file, "rest", table):
        if table.file is not None:
            vertices = build_mesh(tables.MeshFile(file=table.file, up=up), file.parent).vertices
            content[f"digest of {table.file}"] = hashlib.sha256(vertices.tobytes()).hexdigest()
        for key in ("prestrain", "rest_curvature", "change", "through"):
            if isinstance(name := getattr(table, key), str):
                numbers = file_numbers(key, name, file.parent)
                content[f"digest of {name}"] = hashlib.sha256(numbers.tobytes()).hexdigest()
    return content


def _values(name: str, value: Any, folder: Path) -> float | Array:
    if isinstance(value, float | int):
        return value
    if isinstance(value, str):
        return file_numbers(name, value, folder)
    return as_array(name, value, "a number, one per triangle, or a readable file of these", OptionError).astype(
        np.float64
    )
