"""Faults of mesh files that trimesh's readers pass over in silence or report without saying where.

Each check names the fault by line or byte count before trimesh reads the file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from modalshell.checks import shown
from modalshell.errors import MeshError

_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16", "float16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}


@dataclass(frozen=True)
class Expected:
    """How many vertices and faces a file's header announces at least; 0 where it says nothing."""

    vertices: int = 0
    faces: int = 0


def clean_obj(data: bytes) -> bytes:
    """Check an OBJ's vertices and faces line by line and return them alone, indices from 1.

    Without texture coordinates, normals, groups and materials trimesh keeps the file's own vertex order; relative
    (negative) indices are resolved, which trimesh does wrongly when vertices follow the face.
    """
    text = data.decode("utf-8", errors="replace")
    vertices: list[str] = []
    faces: list[tuple[int, list[int]]] = []
    head = ""
    for number, end in enumerate(text.splitlines(), start=1):
        line = head + end
        if end.endswith("\\"):
            head = line[:-1] + " "
            continue
        head = ""
        if line.startswith(("v ", "v\t", " ", "\t", "f ", "f\t")):
            words = line.split("#", 1)[0].split()
            if words and words[0] == "v":
                vertices.append(_coordinates(words[1:], number, len(vertices)))
            elif words and words[0] == "f":
                faces.append((number, _corners(words[1:], number, len(faces), len(vertices))))
    for at, (number, corners) in enumerate(faces):
        for corner in corners:
            if not 1 <= corner <= len(vertices):
                raise MeshError(
                    f"line {number}: face {at} (counted from 0) names vertex {corner} (counted from 1), out of "
                    f"range: the file has {len(vertices)} vertices; mend the face or remove it"
                )
    if not vertices:
        raise MeshError("the file has no vertices (no lines that start with 'v'); is it an OBJ file?")
    if not faces:
        raise MeshError(
            f"the file has {len(vertices)} vertices and no faces (no lines that start with 'f'); a shell needs "
            "triangles: export the surface, not the points"
        )
    return "\n".join([*vertices, *("f " + " ".join(map(str, c)) for _, c in faces), ""]).encode()


def _coordinates(words: list[str], number: int, index: int) -> str:
    where = f"line {number}: vertex {index} (counted from 0; vertex {index + 1} as an OBJ file counts)"
    return "v " + " ".join(repr(value) for value in _three_numbers(words, where))


def _three_numbers(words: list[str], where: str) -> list[float]:
    try:
        values = [float(word) for word in words[:3]]
    except ValueError as error:
        raise MeshError(f"{where} has coordinates {shown(' '.join(words[:3]))}; expected three numbers") from error
    if len(values) < 3:
        raise MeshError(f"{where} has {len(values)} coordinates; expected three numbers")
    if not all(map(math.isfinite, values)):
        raise MeshError(f"{where} is not finite: {shown(' '.join(words[:3]))} (NaN or infinity); mend or remove it")
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


def check_ply(data: bytes) -> Expected:
    """Compare a PLY's length with its header."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise MeshError("the file has no complete PLY header ('ply' to 'end_header'); it is cut short or not a PLY")
    size, counts, name, binary = 0, {"vertex": 0, "face": 0}, "", True
    for line in data[:end].decode("latin-1").splitlines():
        words = line.split()
        try:
            if words[:1] == ["format"]:
                binary = words[1] != "ascii"
            elif words[:1] == ["element"]:
                name = words[1]
                counts[name] = int(words[2])
            elif words[:2] == ["property", "list"]:
                # A face's polygon has three corners or more; any other list may be empty.
                corners = 3 if name == "face" and words[-1] in ("vertex_indices", "vertex_index") else 0
                size += counts[name] * (_PLY_BYTES[words[2]] + corners * _PLY_BYTES[words[3]])
            elif words[:1] == ["property"]:
                size += counts[name] * _PLY_BYTES[words[1]]
        except (IndexError, KeyError, ValueError) as error:
            raise MeshError(
                f"the PLY header has a line it should not have: {shown(line)}; write the file again"
            ) from error
    if not counts["face"]:
        raise MeshError(f"the PLY announces {counts['vertex']} vertices and no faces; a shell needs triangles")
    body = len(data) - (data.find(b"\n", end) + 1 or len(data))
    if binary and body < size:
        raise MeshError(
            f"the binary PLY is cut short (truncated): {counts['vertex']} vertices and {counts['face']} faces take at "
            f"least {size} bytes after the header, the file has {body}; write or download it again"
        )
    return Expected(counts["vertex"], counts["face"])


def check_off(data: bytes) -> tuple[bytes, Expected]:
    """Check an OFF's rows and return it as plain OFF with what its header announces."""
    rows = [line.split("#", 1)[0].split() for line in data.decode("utf-8", errors="replace").splitlines()]
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
    for index, (number, words) in enumerate(body[:vertex_count]):
        _three_numbers(words, f"line {number}: vertex {index} (counted from 0)")
    for index, (number, words) in enumerate(body[vertex_count : vertex_count + face_count]):
        _off_face(words, f"line {number}: face {index}", vertex_count)
    lines = [" ".join(words) for _, words in body]
    return "\n".join(["OFF", f"{vertex_count} {face_count} 0", *lines, ""]).encode(), Expected(vertex_count, face_count)


def _off_face(words: list[str], where: str, vertex_count: int) -> None:
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
                "vertices; mend the face or remove it"
            )


def check_stl(data: bytes) -> None:
    """Compare a binary STL's length with its triangle count, and an ASCII one's ends with its starts."""
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count:
        return
    lower = data.lower()
    if lower.lstrip().startswith(b"solid") and b"facet" in lower:
        opened, closed = lower.count(b"facet normal"), lower.count(b"endfacet")
        if opened != closed or b"endsolid" not in lower:
            raise MeshError(
                f"the ASCII STL is cut short (truncated): {opened} facets begin and {closed} end, 'endsolid' "
                f"{'follows' if b'endsolid' in lower else 'is missing'}; write or download it again"
            )
        return
    if count < 0:
        raise MeshError(f"the STL is cut short: {len(data)} bytes, fewer than the 84 of its header")
    raise MeshError(
        f"the binary STL is cut short (truncated) or not an STL: {count} triangles take {84 + 50 * count} bytes, the "
        f"file has {len(data)}; write or download it again"
    )
