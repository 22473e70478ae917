"""Triangulation of polygons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import final

import numpy as np

from modalshell.core.errors import MeshError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Index

_FLAT = 1e-6
"""Height of a triangle, as a share of its longest side, that counts as none."""
_BACK = -0.5
"""Cosine between normals of triangles of one polygon below which it is folded back on itself."""
_SMALL = 1e-3
"""Area of a triangle, over that of the largest one of its polygon, below which it may be turned by rounding."""


@final
@short_repr
@dataclass(frozen=True)
class Polygons:
    """Vertices and polygons as a file or a user gives them."""

    vertices: Array
    """Positions; shape (n, 3)."""
    corners: Index
    """Corners of all polygons, one polygon after the other, counted from 0; all of them vertices of the file."""
    sizes: Index
    """Number of corners of each polygon, three or more."""

    @classmethod
    def of_lists(cls, vertices: Sequence[Sequence[float]] | Array, polygons: Sequence[Sequence[int]]) -> Polygons:
        """The same from lists of points and of polygons."""
        flat, sizes = list(chain.from_iterable(polygons)), [len(polygon) for polygon in polygons]
        return cls(np.array(vertices), np.array(flat, dtype=np.int64), np.array(sizes, dtype=np.int64))

    def triangles(self) -> Index:
        """Triangles (T, 3), in the order of the polygons.

        Each larger polygon becomes a fan about its first corner, or where that would fold over or have a triangle
        without area, as in polygons that are not convex or have corners on a straight side, the triangles of ear
        clipping.
        """
        first = np.cumsum(self.sizes) - self.sizes
        owner = np.repeat(np.arange(len(self.sizes)), self.sizes - 2)
        step = np.arange(len(owner)) - np.repeat(np.cumsum(self.sizes - 2) - (self.sizes - 2), self.sizes - 2)
        triangles = self.corners[np.stack([first[owner], first[owner] + step + 1, first[owner] + step + 2], axis=1)]
        if not (self.sizes > 3).any():
            return triangles
        with np.errstate(invalid="ignore", over="ignore"):  # vertices are checked by those who build a mesh
            points = self.vertices[triangles]
            areas = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
            normals = np.zeros((len(self.sizes), 3))
            np.add.at(normals, owner, areas)
            sides = points[:, [1, 2, 0]] - points
            longest = np.einsum("tki,tki->tk", sides, sides).max(axis=1)
            flat = np.linalg.norm(areas, axis=1) <= _FLAT * longest
            folded = np.unique(
                owner[(flat & (self.sizes[owner] > 3)) | (np.einsum("ti,ti->t", areas, normals[owner]) < 0.0)]
            )
        for polygon in folded:
            corners = self.corners[first[polygon] : first[polygon] + self.sizes[polygon]]
            triangles[owner == polygon] = corners[_clip_ears(self.vertices[corners], normals[polygon])]
        return triangles

    def refuse_crossed(self, triangles: Index) -> None:
        """MeshError for a polygon that crosses itself: some of its :meth:`triangles` lie back on the others."""
        if not (self.sizes > 3).any():
            return
        owner = np.repeat(np.arange(len(self.sizes)), self.sizes - 2)
        points = self.vertices[triangles]
        areas = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        sizes = np.linalg.norm(areas, axis=1)
        order = np.lexsort((sizes, owner))
        largest = order[np.cumsum(self.sizes - 2) - 1][owner]
        back = np.sum(areas * areas[largest], axis=1) < _BACK * sizes * sizes[largest]
        crossed = np.unique(owner[back & (sizes > _SMALL * sizes[largest])])
        if crossed.size:
            first = int(crossed[0])
            start = int(self.sizes[:first].sum())
            corners = self.corners[start : start + self.sizes[first]].tolist()
            more = "" if crossed.size == 1 else f"; {crossed.size} such polygons in all"
            raise MeshError(
                f"polygon {first} crosses itself (got corners {corners}; both counted from 0{more}): name the corners "
                "of every polygon in order around it, which those of VTK's pixels, for one, are not"
            )


def _clip_ears(points: Array, normal: Array) -> Index:
    """Triangles (k - 2, 3) of a plane polygon (k, 3) seen along ``normal``; a fan of the rest if it has no ears."""
    drop = int(np.abs(normal).argmax())
    plane = np.delete(points, drop, axis=1) * ([1.0, 1.0] if (normal[drop] > 0) == (drop != 1) else [-1.0, 1.0])
    remaining = list(range(len(points)))
    triangles = []
    while len(remaining) > 3:
        ear = next((at for at in range(len(remaining)) if _is_ear(plane[remaining], at)), None)
        if ear is None:
            break
        triangles.append([remaining[ear - 1], remaining[ear], remaining[(ear + 1) % len(remaining)]])
        del remaining[ear]
    triangles += [[remaining[0], remaining[k], remaining[k + 1]] for k in range(1, len(remaining) - 1)]
    return np.array(triangles, dtype=np.int64)


def _is_ear(plane: Array, at: int) -> bool:
    """Whether corner ``at`` of a counter-clockwise polygon (k, 2) sticks out and its triangle holds no other corner."""
    corners = plane[[at - 1, at, (at + 1) % len(plane)]]
    sides = corners[[1, 2, 0]] - corners
    twice_area = sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]
    if twice_area <= _FLAT * np.einsum("ki,ki->k", sides, sides).max():
        return False
    others = plane[~(plane[:, None] == corners).all(axis=2).any(axis=1)]
    apart = others[:, None] - corners
    return not bool((sides[:, 0] * apart[..., 1] - sides[:, 1] * apart[..., 0] >= 0.0).all(axis=1).any())
