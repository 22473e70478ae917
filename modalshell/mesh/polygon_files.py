"""Readers of OBJ, OFF, PLY and STL that keep the file's order and locate faults by line or number.

trimesh reads these formats, too, but resolves relative indices of an OBJ wrongly, takes no binary PLY of unequal
polygons, leaves out what follows a word in an ASCII STL that is no number, and ignores faults or does not locate them.
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from modalshell.core.checks import shortened, shown
from modalshell.core.errors import MeshError
from modalshell.mesh.file_checks import check_stl
from modalshell.mesh.plain_files import read_binary_stl, read_plain_obj
from modalshell.mesh.polygons import Polygons

_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
"""NumPy's names of PLY's types of numbers."""


def read_obj(data: bytes) -> Polygons:
    """Vertices and faces of an OBJ; texture coordinates, normals, groups and materials are passed over."""
    if (plain := read_plain_obj(data)) is not None:
        return plain
    vertices: list[list[float]] = []
    faces: list[tuple[int, list[int]]] = []
    head = ""
    for number, end in enumerate(_lines(data), start=1):
        line = head + end
        if end.endswith("\\"):
            head = line[:-1] + " "
            continue
        head = ""
        if line.startswith(("v ", "v\t", " ", "\t", "f ", "f\t")):
            words = line.split("#", 1)[0].split()
            if words and words[0] == "v":
                index = len(vertices)
                where = f"line {number}: vertex {index} (counted from 0; vertex {index + 1} as an OBJ file counts)"
                vertices.append(_three_numbers(words[1:], where))
            elif words and words[0] == "f":
                faces.append((number, _corners(words[1:], number, len(faces), len(vertices))))
    for at, (number, corners) in enumerate(faces):
        for corner in corners:
            if not 1 <= corner <= len(vertices):
                raise MeshError(
                    f"line {number}: face {at} (counted from 0) names vertex {corner} (counted from 1), out of "
                    f"range: the file has {len(vertices)} vertices; correct the face or remove it"
                )
    if not vertices:
        raise MeshError("the file has no vertices (no lines that start with 'v'); is it an OBJ file?")
    if not faces:
        raise MeshError(
            f"the file has {len(vertices)} vertices and no faces (no lines that start with 'f'); a shell needs "
            "triangles: export the surface, not the points"
        )
    return Polygons.of_lists(vertices, [[corner - 1 for corner in corners] for _, corners in faces])


def read_off(data: bytes) -> Polygons:
    """Vertices and faces of an OFF or COFF; colours are passed over."""
    rows = [line.split("#", 1)[0].split() for line in _lines(data)]
    numbered = [(number, words) for number, words in enumerate(rows, start=1) if words]
    if not numbered or numbered[0][1][0] not in ("OFF", "COFF"):
        raise MeshError("the file does not start with 'OFF' or 'COFF'; is it an OFF file?")
    head = numbered[0][1][1:]
    body = numbered[1:]
    if not head and body:
        head, body = body[0][1], body[1:]
    try:
        vertex_count, face_count = int(head[0]), int(head[1])
    except (IndexError, ValueError) as error:
        raise MeshError(
            f"the OFF header has counts {shown(' '.join(head))}; expected 'vertices faces edges'"
        ) from error
    if face_count < 1:
        raise MeshError(f"the OFF announces {vertex_count} vertices and {face_count} faces; a shell needs triangles")
    if vertex_count < 1 or len(body) < vertex_count + face_count:
        raise MeshError(
            f"the OFF is cut short (truncated): its header announces {vertex_count} vertices and {face_count} faces, "
            f"{len(body)} rows follow; write or download it again"
        )
    vertices = [
        _three_numbers(words, f"line {number}: vertex {index} (counted from 0)")
        for index, (number, words) in enumerate(body[:vertex_count])
    ]
    faces = [
        _off_face(words, f"line {number}: face {index}", vertex_count)
        for index, (number, words) in enumerate(body[vertex_count : vertex_count + face_count])
    ]
    return Polygons.of_lists(vertices, faces)


def read_stl(data: bytes) -> Polygons:
    """Triangles of a binary or ASCII STL, each with vertices of its own; names, normals and colours are passed over."""
    if (plain := read_binary_stl(data)) is not None:
        return plain
    check_stl(data)
    vertices: list[list[float]] = []
    facets = 0
    for number, line in enumerate(_lines(data), start=1):
        words = line.split()
        if words[:1] and words[0].lower() == "vertex":
            vertices.append(_three_numbers(words[1:], f"line {number}: vertex {len(vertices)} (counted from 0)"))
        elif words[:1] and words[0].lower() == "endfacet":
            facets += 1
            if len(vertices) != 3 * facets:
                raise MeshError(
                    f"line {number}: facet {facets - 1} (counted from 0) ends after {len(vertices)} vertices in all; "
                    "three of each facet are expected, each on a line of its own: write the file again"
                )
    whole = data.lower().count(b"endfacet")
    if facets != whole or len(vertices) != 3 * facets:
        raise MeshError(
            f"{facets} of {whole} facets have each vertex and their 'endfacet' on a line of its own, as is expected: "
            "write the file again"
        )
    if not facets:
        raise MeshError("the file has no faces (0 vertices read); a shell needs triangles")
    return Polygons(np.array(vertices), np.arange(3 * facets), np.full(facets, 3))


def read_ply(data: bytes) -> Polygons:
    """Vertices and faces of a PLY, ASCII or binary; further properties and elements are passed over."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise MeshError("the file has no complete PLY header ('ply' to 'end_header'); it is cut short or not a PLY")
    order, elements = _ply_header(data[:end].decode("latin-1"))
    counts = {name: count for name, count, _ in elements}
    announced = f"{counts.get('vertex', 0)} vertices and {counts.get('face', 0)} faces"
    if not counts.get("face"):
        raise MeshError(f"the PLY announces {announced.replace('0 faces', 'no faces')}; a shell needs triangles")
    body = data[data.find(b"\n", end) + 1 or len(data) :]
    try:
        columns = dict(_ply_columns(body, elements, order))
    except (IndexError, struct.error) as error:
        raise MeshError(
            f"the PLY is cut short (truncated): its header announces {announced}, the file ends before; write or "
            "download it again"
        ) from error
    except (ValueError, OverflowError) as error:
        raise MeshError(
            f"the file is damaged or not PLY ({shortened(str(error))}); write or download it again, or convert it "
            "to OBJ"
        ) from error
    polygons: Any = columns["face"].get("vertex_indices", columns["face"].get("vertex_index"))
    whole = isinstance(polygons, tuple) and polygons[0].dtype.kind in "iu"
    points: list[Any] = [columns.get("vertex", {}).get(axis) for axis in "xyz"]
    if not whole or not all(isinstance(values, np.ndarray) for values in points):
        raise MeshError(
            "the PLY has no x, y and z of vertices, or no list vertex_indices of integers of faces; convert it to OBJ"
        )
    vertices = np.column_stack(points).astype(np.float64)
    corners, sizes = (part.astype(np.int64) for part in polygons)
    if (sizes < 3).any():
        index = int(np.argmax(sizes < 3))
        raise MeshError(f"face {index} (counted from 0) has {sizes[index]} corners; expected three or more")
    outside = (corners < 0) | (corners >= len(vertices))
    if outside.any():
        first = int(np.argmax(outside))
        raise MeshError(
            f"face {np.searchsorted(np.cumsum(sizes), first, side='right')} names vertex {corners[first]}, out of "
            f"range (both counted from 0): the file has {len(vertices)} vertices; correct the face or remove it"
        )
    return Polygons(vertices, corners, sizes)


Element = tuple[str, int, list[tuple[str, str, str]]]
"""An element of a PLY: name, count, and of each property its name, type, and type of a list's length or ""."""

Column = Any
"""Values of a property: an array, or of lists all their entries and their lengths as a tuple of two arrays."""


def _ply_header(text: str) -> tuple[str | None, list[Element]]:
    """Byte order of a PLY, None for ASCII, and its elements."""
    order: str | None = "<"
    elements: list[Element] = []
    for line in text.splitlines():
        words = line.split()
        try:
            if words[:1] == ["format"]:
                order = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1][2].append((words[4], _PLY_TYPES[words[3]], _PLY_TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[2], _PLY_TYPES[words[1]], ""))
        except (IndexError, KeyError, ValueError) as error:
            raise MeshError(
                f"the PLY header has a line it should not have: {shown(line)}; write the file again"
            ) from error
    if any(count < 0 for _, count, _ in elements):
        raise MeshError("the PLY header announces a negative count; write the file again")
    for kind, names in (
        ("element", [name for name, _, _ in elements]),
        *((f"property of {name}", [key for key, _, _ in properties]) for name, _, properties in elements),
    ):
        for name in names:
            if names.count(name) > 1:
                raise MeshError(f"the PLY header declares the {kind} {shown(name)} twice; write the file again")
    return order, elements


def _ply_columns(body: bytes, elements: list[Element], order: str | None) -> Iterator[tuple[str, dict[str, Column]]]:
    """Name and columns of each element; IndexError where the file ends before."""
    data: Any = body if order else body.decode("latin-1").split()
    at = 0
    for name, count, properties in elements:
        types = {key: np.dtype((order or "=") + kind) for key, kind, _ in properties}
        entries: dict[str, Any] = {key: bytearray() if order else [] for key in types}
        lengths: dict[str, list[int]] = {key: [] for key in types}
        for _ in range(count if properties else 0):
            for key, _, length in properties:
                size = 1
                if length:
                    counter = struct.Struct((order or "=") + np.dtype(length).char)
                    size = int(counter.unpack_from(body, at)[0] if order else data[at])
                    lengths[key].append(size)
                    at += counter.size if order else 1
                end = at + size * (types[key].itemsize if order else 1)
                if not at <= end <= len(data):
                    raise IndexError(size)
                entries[key] += data[at:end]
                at = end
        values = {
            key: (np.frombuffer if order and entries[key] else np.array)(entries[key], types[key]) for key in types
        }
        yield name, {key: (values[key], np.array(lengths[key])) if lengths[key] else values[key] for key in values}


def _lines(data: bytes) -> list[str]:
    return [line.removesuffix("\n") for line in io.StringIO(data.decode("utf-8", errors="replace"), newline=None)]


def _three_numbers(words: list[str], where: str) -> list[float]:
    try:
        values = [float(word) for word in words[:3]]
    except ValueError as error:
        raise MeshError(f"{where} has coordinates {shown(' '.join(words[:3]))}; expected three numbers") from error
    if len(values) < 3:
        raise MeshError(f"{where} has {len(values)} coordinates; expected three numbers")
    if not all(map(math.isfinite, values)):
        raise MeshError(f"{where} is not finite: {shown(' '.join(words[:3]))} (NaN or infinity); correct or remove it")
    return values


def _corners(words: list[str], number: int, index: int, vertex_count: int) -> list[int]:
    where = f"line {number}: face {index} (counted from 0)"
    try:
        corners = [int(word.split("/", 1)[0]) for word in words]
    except ValueError as error:
        raise MeshError(
            f"{where} reads {shown(' '.join(words))}; expected whole vertex numbers such as 'f 1 2 3'"
        ) from error
    if len(corners) < 3:
        raise MeshError(f"{where} has {len(corners)} corners; expected three or more")
    if 0 in corners:
        raise MeshError(
            f"{where} names vertex 0, out of range: an OBJ file counts from 1; write it with indices from 1"
        )
    return [c if c > 0 else vertex_count + 1 + c for c in corners]


def _off_face(words: list[str], where: str, vertex_count: int) -> list[int]:
    try:
        count = int(words[0])
        corners = [int(word) for word in words[1 : count + 1]]
    except ValueError as error:
        raise MeshError(f"{where} reads {shown(' '.join(words))}; expected whole numbers such as '3 0 1 2'") from error
    if count < 3 or len(corners) < count:
        raise MeshError(f"{where} reads {shown(' '.join(words))}; expected a count of 3 or more and that many vertices")
    for corner in corners:
        if not 0 <= corner < vertex_count:
            raise MeshError(
                f"{where} names vertex {corner}, out of range (both counted from 0): the file has {vertex_count} "
                "vertices; correct the face or remove it"
            )
    return corners
