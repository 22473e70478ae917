"""Whole-array readers of plain OBJ and binary STL files; what is not plain is left to readers that go line by line.

They return None unless every line is of the plainest kind and without fault, so that a fault is found and located by
the other readers, in one place.
"""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np

from modalshell.core.typing import Array
from modalshell.mesh.polygons import Polygons

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_binary_stl(data: bytes) -> Polygons | None:
    """Triangles of a binary STL, each with vertices of its own; None for other files, and for empty ones."""
    count = int.from_bytes(data[80:84], "little")
    if count == 0 or len(data) != 84 + _TRIANGLE.itemsize * count:
        return None
    vertices = np.frombuffer(data, _TRIANGLE, offset=84)["corners"].reshape(-1, 3).astype(np.float64)
    return Polygons(vertices, np.arange(3 * count), np.full(count, 3))


def read_plain_obj(data: bytes) -> Polygons | None:
    """Vertices and faces of an OBJ whose lines are ``v x y z`` and ``f a b c``, or others that are passed over."""
    data = data.replace(b"\r\n", b"\n")
    if b"\r" in data or b"\\" in data:  # other ends of lines, and lines that go on
        return None
    lines = data.split(b"\n")
    starts = {line[:2] for line in lines}
    if any(start[:1].isspace() or start in (b"v\t", b"f\t") for start in starts):
        return None
    # After every line comes a number that is in none.
    points = _numbers([line[2:] for line in lines if line.startswith(b"v ")], b"inf", np.float64)
    corners = _numbers([line[2:] for line in lines if line.startswith(b"f ")], b"0", np.int64)
    if points is None or corners is None or points[0].size % 4 or not points[0].size:
        return None
    rows = points[0].reshape(-1, 4)
    ends = np.flatnonzero(corners[0] == 0)
    sizes = np.diff(ends, prepend=-1) - 1
    named = corners[0][corners[0] != 0]
    if not (np.isfinite(rows) == [True, True, True, False]).all() or ends.size != corners[1] or (sizes < 3).any():
        return None
    if ((named < 1) | (named > len(rows))).any():
        return None
    return Polygons(np.ascontiguousarray(rows[:, :3]), named - 1, sizes)


def _numbers(lines: list[bytes], end: bytes, kind: Any) -> tuple[Array, int] | None:
    """Numbers of all lines, with ``end`` after each, and how many lines; None where a word is no number of ``kind``."""
    text = (b" " + end + b" ").join([*lines, b""])
    if b"/" in text:  # texture coordinates and normals
        text = re.sub(rb"(?<=[0-9])/[!-\"$-~]*", b"", text)
    blank = np.frombuffer(text, np.uint8) <= ord(" ")
    words = int(np.count_nonzero(blank[:-1] & ~blank[1:])) + int(not blank[:1].all())
    try:
        with warnings.catch_warnings(action="ignore"):  # it stops at the first word that is no number
            numbers = np.fromstring(text, kind, sep=" ")
    except ValueError:
        return None
    return (numbers, len(lines)) if numbers.size == words > 0 else None
