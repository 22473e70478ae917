"""Reading of Gmsh's MSH files, versions 2 and 4, text and binary, through meshio (extra ``msh``)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from modalshell.core.checks import shortened
from modalshell.core.errors import MeshError
from modalshell.mesh.polygons import Polygons

MSH = ".msh"
"""Suffix of Gmsh's files."""
_SIZES = {"triangle": 3, "quad": 4}
"""Corners of the elements that are read."""
_PASSED_OVER = ("vertex", "line")
"""What the names of elements begin with that lie on points and curves, as supports in other programs need them."""
_SURFACES = ("triangle", "quad")


def read_msh(file: Path, data: bytes) -> Polygons:
    """Vertices and polygons of all triangles and quadrangles of a file with these ``data``, in its order.

    MeshError for a file that holds solids or elements with nodes on their sides, or that is none of Gmsh's.
    """
    try:
        from meshio import gmsh
    except ImportError:
        raise MeshError(
            "MSH files need meshio, which is not installed: pip install 'modalshell[msh]', or save the mesh as STL or "
            "PLY in Gmsh (File, Export)"
        ) from None
    try:
        _check_text(data)
        with warnings.catch_warnings(action="ignore"):
            warnings.filterwarnings("error", message="string or file could not be read")  # text that ends too early
            mesh: Any = gmsh.read(file)
        return _polygons(mesh)
    except MeshError:
        raise
    except Exception as error:  # the reader raises whatever its parsing met: ValueError, KeyError, IndexError
        reason = shortened(f"{type(error).__name__}: {error}".splitlines()[0].rstrip(": "), 160)
        raise MeshError(
            f"the file is damaged, cut short or not of Gmsh's MSH 2 or 4 (the reader stopped with {reason}); write it "
            "again, as version 4.1 or 2.2, or convert it to OBJ"
        ) from error


def _polygons(mesh: Any) -> Polygons:
    blocks = [(str(block.type), np.asarray(block.data, dtype=np.int64)) for block in mesh.cells]
    counts: dict[str, int] = {}
    for kind, corners in blocks:
        if not kind.startswith(_PASSED_OVER):
            counts[kind] = counts.get(kind, 0) + len(corners)
    found = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    if not counts:
        raise MeshError(
            "the file has no triangles or quadrangles; a shell needs them: mesh its surfaces (gmsh -2) and let its "
            "physical groups include these, as Gmsh saves no others"
        )
    if any(not kind.startswith(_SURFACES) for kind in counts):
        raise MeshError(
            f"the file holds a solid (elements: {found}), where a shell is expected: save the surfaces in the middle "
            "of its sheets alone, as a physical group of them"
        )
    if any(kind not in _SIZES for kind in counts):
        raise MeshError(
            f"the file has elements with nodes on their sides (elements: {found}), where three or four corners are "
            "expected: set the element order to 1 in Gmsh (gmsh -order 1) and save it again"
        )
    taken = [(_SIZES[kind], corners) for kind, corners in blocks if kind in _SIZES]
    if any((corners < 0).any() for _, corners in taken):
        raise MeshError("an element names a node that the file does not have; write it again")
    points = np.asarray(mesh.points, dtype=np.float64)
    sizes = np.concatenate([np.full(len(corners), size) for size, corners in taken])
    return Polygons(points, np.concatenate([corners.ravel() for _, corners in taken]), sizes)


def _check_text(data: bytes) -> None:
    """MeshError for what the reader does not tell: a file cut short, or nodes counted from 0.

    It would take the last node for node 0.
    """
    if b"$MeshFormat" not in data:
        raise MeshError("no MSH file of Gmsh, of version 2 or 4 (it has no $MeshFormat); write the mesh by Gmsh")
    if b"$EndElements" not in data:
        raise MeshError("the file is cut short (truncated): it has no $EndElements; write or download it again")
    head, _, rest = data.partition(b"$Nodes")
    version, binary = [*head.partition(b"$MeshFormat")[2].split(), b"", b""][:2]
    words = rest[:1000].split()
    place = 2 if version.startswith(b"4") else 1
    if binary == b"0" and len(words) > place and words[place] == b"0":
        raise MeshError("nodes must be counted from 1, as Gmsh does (got node 0); write the file by Gmsh")
