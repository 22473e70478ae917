"""Repair of meshes: faults that prevent a shell are corrected, and every correction is listed."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, cast, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import as_array, checked_switch, shown
from modalshell.core.errors import MeshError, ModalShellWarning
from modalshell.core.typing import Array, Index
from modalshell.mesh import validation
from modalshell.mesh.parts import Component, chosen_part
from modalshell.mesh.polygons import Polygons
from modalshell.mesh.sheets import cut_into_sheets, touching_apart
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.welding import drop_unused, weld_arrays, without_flat_faces, without_needles

THIN = 1e-4
"""Height over length of a triangle from which the stiffness is too ill-conditioned for modes."""
_MESSAGES = {
    "recentred": "moved the mesh to the origin, from which it was {} of its lengths away",
    "triangulated": "split {} larger polygons into triangles",
    "invalid_faces": "dropped {} faces with vertices that are missing or not finite",
    "merged_vertices": "merged {} coincident vertices into others",
    "collapsed_faces": "dropped {} faces that named a vertex twice",
    "flat_faces": "took away {} faces of zero area, and split neighbours at their corners",
    "thin_faces": f"took away {{}} faces less than {THIN:g} times as high as long",
    "repeated_faces": "dropped {} faces that were there already",
    "split_edges": "split {} edges of three or more faces into separate sheets, which hold one another no longer",
    "split_vertices": "added {} vertices where sheets were split",
    "cut_edges": "cut one-sided surfaces open along {} edges",
    "flipped_faces": "flipped {} faces to make the winding consistent",
    "unused_vertices": "dropped {} vertices in no face",
    "dropped_parts": "left out {} parts",
}
_PASSES = 4
"""Times at most that thin triangles are looked for."""


@final
@dataclass(frozen=True, kw_only=True)
class RepairReport:
    """Counts of what :func:`repair` did; ``str()`` lists them line by line.

    Attributes
    ----------
    recentred : int
        Distance from the origin over the mesh's length, if the mesh was so far away that it was moved there; else 0.
    triangulated : int
        Polygons of more than three corners.
    invalid_faces : int
        Dropped faces with vertices that are missing or not finite.
    merged_vertices : int
        Vertices merged into others that coincide with them.
    collapsed_faces : int
        Dropped faces that named a vertex twice, before merging or after.
    flat_faces : int
        Faces of zero area that were taken away.
    thin_faces : int
        Faces less than 1e-4 times as high as long that were taken away, which moves the surface by no more than that.
    repeated_faces : int
        Dropped copies of faces, on either side.
    split_edges : int
        Edges of three or more faces that were split into sheets.
    split_vertices : int
        Vertices added where sheets were split or cut.
    cut_edges : int
        Edges along which one-sided surfaces were cut open.
    flipped_faces : int
        Faces flipped for a consistent winding.
    unused_vertices : int
        Dropped vertices in no face.
    dropped_parts : int
        Connected parts that were not chosen.
    parts : int
        Connected parts that the mesh has now.
    open_edges : int
        Boundary edges of the repaired mesh: holes are not filled.
    """

    recentred: int = 0
    triangulated: int = 0
    invalid_faces: int = 0
    merged_vertices: int = 0
    collapsed_faces: int = 0
    flat_faces: int = 0
    thin_faces: int = 0
    repeated_faces: int = 0
    split_edges: int = 0
    split_vertices: int = 0
    cut_edges: int = 0
    flipped_faces: int = 0
    unused_vertices: int = 0
    dropped_parts: int = 0
    parts: int = 1
    open_edges: int = 0

    @property
    def counts(self) -> dict[str, int]:
        """All counts by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def changed(self) -> bool:
        """Whether anything was done."""
        return any(self.counts[name] for name in _MESSAGES)

    @property
    def messages(self) -> list[str]:
        """What was done, one line each; empty where the mesh was a shell already."""
        return [text.format(f"{self.counts[name]:,}") for name, text in _MESSAGES.items() if self.counts[name]]

    def __str__(self) -> str:
        parts = f"{self.parts} parts" if self.parts > 1 else "one part"
        return "\n".join([*(self.messages or ["nothing to repair"]), f"now {parts}, {self.open_edges:,} open edges"])


def repair(
    vertices: ArrayLike,
    faces: ArrayLike | Sequence[Sequence[int]] | Polygons,
    *,
    tolerance: float | None = None,
    component: Component | None = None,
    split: bool = False,
) -> tuple[TriangleMesh, RepairReport]:
    """Repair vertices and polygons into a mesh that can be a shell.

    In this order: faces with vertices that are missing or not finite are dropped; polygons are split into triangles;
    coincident vertices are merged; faces without area, and those less than 1e-4 times as high as long, are taken away,
    their neighbours split at their corners or their short edges drawn to a point, so that no crack opens; copies of
    faces are dropped; vertices at which sheets touch are split; faces are wound alike within each sheet; vertices in no
    face are dropped. Edges of three or more faces are junctions and stay, as do one-sided surfaces, unless ``split``
    cuts them into separate two-sided sheets, those faces staying together that are wound alike and lie flattest. Holes
    are not filled. A mesh that is a shell already comes back as it is.

    Parameters
    ----------
    vertices : (n, 3) float
        Positions [m].
    faces : (T, k) int, or a list of lists
        Corners of each polygon, three or more.
    tolerance : float, optional
        Distance [m] up to which vertices are merged; by default 1e-8 of the bounding box's diagonal.
    component : "largest", "all" or int, optional
        Which connected part is kept: that of the largest area, or the N-th in order of decreasing area; by default all.
    split : bool
        Cut the sheets apart where three or more faces meet at an edge, after which a rib no longer holds the plate on
        which it stands, and cut one-sided surfaces open along a line.

    Returns
    -------
    TriangleMesh
        The mesh, of one part or several.
    RepairReport
        What was done.

    Raises
    ------
    MeshError
        If nothing remains that could be a shell: no face with area, coordinates out of range; or where two sheets of a
        junction lie on each other, without ``split``.
    """
    checked_switch("split", split)
    count: dict[str, int] = {}
    points = as_array("vertices", vertices, "an array (n, 3) of real numbers [m]", MeshError).astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        points = validation.as_vertices(points)  # which says what is wrong
    polygons, count["invalid_faces"] = _usable(points, _as_polygons(points, faces))
    count["triangulated"] = int((polygons.sizes > 3).sum())
    triangles = polygons.triangles()
    used = np.zeros(len(points), dtype=np.bool_)
    used[triangles] = True
    count["unused_vertices"] = int((~used).sum())
    points, triangles = drop_unused(points, triangles)
    size, away = float(np.ptp(points, axis=0).max()), float(np.abs(points).max())
    if size > 0.0 and away > validation.FARTHEST * size:
        count["recentred"] = int(away / size)
        points = points - points.mean(axis=0)
    points = validation.as_vertices(points)

    before = len(points)
    points, triangles, count["collapsed_faces"] = weld_arrays(points, triangles, tolerance)
    count["merged_vertices"] = before - len(points)
    points, triangles = _into_sheets(points, triangles, split, count)
    with warnings.catch_warnings(action="ignore", category=ModalShellWarning):  # of seams: there sheets were split
        whole = TriangleMesh(points, triangles)
        mesh = chosen_part(whole, component)
    parts = int(mesh.components.max()) + 1
    count["dropped_parts"] = int(whole.components.max()) + 1 - parts
    return mesh, RepairReport(**count, parts=parts, open_edges=int((mesh.edge_faces[:, 1] < 0).sum()))


def _into_sheets(points: Array, triangles: Index, split: bool, count: dict[str, int]) -> tuple[Array, Index]:
    """Vertices and triangles of sheets without flat, thin or repeated faces; what was done is added to ``count``."""
    # A thin triangle on an edge of three faces can be taken away once that edge is split.
    for _ in range(_PASSES):
        triangles, flat, thin = _with_area(points, triangles)
        triangles, repeated = _once_each(triangles)
        sheets = (cut_into_sheets if split else touching_apart)(points, triangles)
        points, triangles = drop_unused(sheets.vertices, sheets.faces)
        done = {"flat_faces": flat, "thin_faces": thin, "repeated_faces": repeated, "flipped_faces": sheets.flipped}
        done |= {name: getattr(sheets, name) for name in ("split_edges", "split_vertices", "cut_edges")}
        count.update({name: count.get(name, 0) + number for name, number in done.items()})
        if not validation.degenerate(points, triangles, THIN).any():
            break
    return points, triangles


def _as_polygons(points: Any, faces: ArrayLike | Sequence[Sequence[int]] | Polygons) -> Polygons:
    """Faces in whatever form as polygons; MeshError where they are no lists of three or more whole numbers."""
    if isinstance(faces, Polygons):
        return faces
    if (
        isinstance(faces, np.ndarray)
        and faces.ndim == 2
        and len(faces)
        and faces.shape[1] > 2
        and faces.dtype.kind in "iu"
    ):
        sizes = np.full(len(faces), faces.shape[1], dtype=np.int64)
        return Polygons(points, np.ravel(faces).astype(np.int64), sizes)
    rows: list[Any]
    try:
        rows = [list(row) for row in (faces.tolist() if isinstance(faces, np.ndarray) else cast("Any", faces))]
    except TypeError as error:
        raise MeshError(f"faces must be lists of vertex indices (got {shown(faces)})") from error
    if not rows:
        raise MeshError("the mesh has vertices and no faces (got 0 faces); give lists of three or more vertex indices")
    for at, row in enumerate(rows):
        if len(row) < 3:
            raise MeshError(f"face {at} (counted from 0) has {len(row)} corners; expected three or more")
        if not all(map(_is_whole, row)):
            raise MeshError(f"face {at} (counted from 0) holds {shown(row)}; faces must hold whole numbers")
    return Polygons.of_lists(points, [[int(corner) for corner in row] for row in rows])


def _is_whole(value: Any) -> bool:
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    number = float(value)
    return abs(number) < 2.0**53 and number.is_integer()


def _usable(points: Any, polygons: Polygons) -> tuple[Polygons, int]:
    """The polygons whose corners are vertices at finite positions, and how many others there were."""
    first = np.cumsum(polygons.sizes) - polygons.sizes
    inside = (polygons.corners >= 0) & (polygons.corners < len(points))
    good = inside.copy()
    good[inside] = np.isfinite(points[polygons.corners[inside]]).all(axis=1)
    whole = np.logical_and.reduceat(good, first)
    if not whole.any():
        raise MeshError(f"none of the {len(whole)} faces has all its corners at finite positions; write the mesh again")
    kept = Polygons(points, polygons.corners[np.repeat(whole, polygons.sizes)], polygons.sizes[whole])
    return kept, int((~whole).sum())


def _with_area(points: Any, triangles: Index) -> tuple[Index, int, int]:
    """Triangles without those of no area and the thin ones; how many were flat, and how many thin."""
    flat = validation.degenerate(points, triangles)
    thin = validation.degenerate(points, triangles, THIN)
    if not thin.any():
        return triangles, 0, 0
    kept = without_needles(points, without_flat_faces(points, triangles), THIN)
    kept = kept[~validation.degenerate(points, kept)]
    if not len(kept):
        raise MeshError(f"all {len(triangles)} faces have zero area: a shell needs a surface; write the mesh again")
    return kept, int(flat.sum()), int((thin & ~flat).sum())


def _once_each(triangles: Index) -> tuple[Index, int]:
    """The first of the triangles with the same three corners, in order; and how many copies there were."""
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return triangles[np.sort(first)], len(triangles) - len(first)
