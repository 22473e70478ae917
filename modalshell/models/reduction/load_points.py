"""Quadrature points of the loads on a shell: midpoints of patches of elements, and their weights."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array, Index
from modalshell.loads import AppliedLoad
from modalshell.loads.applied import BodyForm, SurfaceForm, TurningForm
from modalshell.loads.surface_kernels import APART, BODY, SURFACE, TURNING, Points, point_forces
from modalshell.loads.turning import triangle_frames, triangle_shapes
from modalshell.mesh import TriangleMesh
from modalshell.mesh.topology import area_vectors
from modalshell.modes import Basis

_LEAST = 1e-12
"""Area of a collapsed triangle, as a share of the largest."""
_EVEN, _ALIKE = 1e-9, 1e-6
"""Difference of places, in sizes of the mesh, and of extents and areas, as a share, that is laid to rounding."""
_EACH = 256
"""Triangles up to which each is a patch of its own: on a coarse mesh they differ too much to stand for each other."""
_VERTICES, _BODIES = 512, 256
"""Vertices up to which each is a point of a load by mass, which is then exact, and patches of such a load beyond: its
Coriolis forces act on every mode, and 64 patches are up to 2 % of the motion off, these some 0.2 %."""
_GROUPS = 32
"""Groups of elements of a load that rotates with its triangles."""


class _Part(NamedTuple):
    """Points of one load: of a kind, on triangles (k, 3), with sizes (k, 3), and weights (k, n) of the vertices."""

    kind: int
    faces: Index
    sizes: Array
    means: sps.csr_array
    turns: sps.csr_array


@final
class LoadPoints:
    """Loads on a shell by the midpoint rule over patches of its surface.

    The triangles are halved by their centroids along the longest side, by area, into patches, which turn with the mesh;
    on a mesh of at most 256 triangles each is a patch. Loads by mass act on each vertex, of up to 512.
    The triangle nearest a patch's centre stands for it: its force times the ratio of the areas acts on the patch's mean
    displacement, which the patch's mean rotation turns. The error falls as the square of the patches' size.
    The forces are what is added to those on the shell at rest: these are known on every triangle, and where most of
    them cancel over the shell, as of wind that twists it, points would err by more than what is left.

    Parameters
    ----------
    basis : Basis
        Modes and modal rotations.
    loads : tuple of AppliedLoad
        Loads that change, each of a form.
    patches : int
        Number of patches of a load on the surface, a power of two; loads by mass have their own.

    Attributes
    ----------
    means : csr_array, shape (k, n)
        Weights of the vertices' displacements at each point.
    modes, turns : ndarray, shape (k, 3, m)
        Modes and modal rotations there.
    """

    def __init__(self, basis: Basis, loads: tuple[AppliedLoad, ...], patches: int) -> None:
        mesh = basis.shell.mesh
        none = sps.csr_array((0, len(mesh.vertices)))
        nothing = _Part(SURFACE, np.empty((0, 3), dtype=np.int64), np.empty((0, 3)), none, none)
        parts = [_part(mesh, load, patches) for load in loads] or [nothing]
        counts = [len(part.faces) for part in parts]
        ends = np.cumsum([0, *counts])
        self.means = sps.csr_array(sps.vstack([part.means for part in parts]))
        self.modes = self.mean(basis.modes)
        self.turns = _product(sps.csr_array(sps.vstack([part.turns for part in parts])), basis.rotations)
        kinds = np.repeat([part.kind for part in parts], counts)
        faces, sizes = (np.concatenate(of) for of in zip(*((part.faces, part.sizes) for part in parts), strict=True))
        air, bodies = np.zeros((ends[-1], 3)), np.zeros((len(loads), 3, 7))
        self._points = Points(
            np.column_stack([kinds, np.repeat(np.arange(len(parts)), counts)]), faces, sizes, air, bodies,
            np.ones(len(loads)), np.zeros((ends[-1], 3)), np.empty((ends[-1], 3)), self.modes, self.turns,
        )  # fmt: skip
        self._changing = [(index, load) for index, load in enumerate(loads) if load.factor is not None]
        self._fields: list[tuple[slice, SurfaceForm]] = []
        for index, load in enumerate(loads):
            form, own = load.form, slice(ends[index], ends[index + 1])
            if isinstance(form, BodyForm):
                bodies[index] = np.column_stack([form.constant, form.by_position, form.by_velocity])
                air[own] = parts[index].means @ mesh.vertices - mesh.vertices[faces[own]].mean(axis=1)
            elif isinstance(form, SurfaceForm) and callable(form.velocity):
                self._fields.append((own, form))
            elif isinstance(form, SurfaceForm) and form.velocity is not None:
                air[own] = form.velocity
            elif isinstance(form, TurningForm):
                air[own, :2] = triangle_shapes(mesh.vertices[faces[own]])
        # To be written to, as positions in motion are: the kernel is compiled for one kind.
        self._vertices = mesh.vertices.copy()
        self._unused = np.zeros(basis.count), np.zeros((basis.count, basis.count))
        self._stand(0.0)

    @property
    def count(self) -> int:
        """Number of points k."""
        return len(self._points.faces)

    def mean(self, matrix: Array) -> Array:
        """Mean displacements (k, 3, c) at the points of displacements (3n, c)."""
        return _product(self.means, matrix)

    def forces(
        self, q: Array, x: Array, before: Array, rate: float, time: float, way: int, push: Array, drag: Array
    ) -> Array:
        """Forces (k, 3) [N] at the points over those at rest; see :func:`.surface_kernels.point_forces`."""
        points = self._points
        if self._fields:
            self._stand(time)
        for index, load in self._changing:
            points.factors[index] = load.factor_at(time)
        for own, form in self._fields:
            points.air[own] = form.air(x, points.faces[own], time)
        point_forces(points, x, before, rate, q, way, push, drag)
        return points.forces

    def _stand(self, time: float) -> None:
        """Find the forces at rest at a time [s], without their factors."""
        points, x, (push, drag) = self._points, self._vertices, self._unused
        points.rest[:], points.factors[:] = 0.0, 1.0
        for own, form in self._fields:
            points.air[own] = form.air(x, points.faces[own], time)
        point_forces(points, x, x, 0.0, np.zeros_like(push), APART, push, drag)
        points.rest[:] = points.forces


def _product(weights: sps.csr_array, matrix: Array) -> Array:
    """Weighted sums (k, 3, c) of vectors (3n, c) of vertices."""
    columns = matrix.shape[1]
    return np.ascontiguousarray((weights @ matrix.reshape(-1, 3 * columns)).reshape(-1, 3, columns))


def _part(mesh: TriangleMesh, load: AppliedLoad, patches: int) -> _Part:
    form, stencils = load.form, load.stencils
    if isinstance(form, TurningForm):
        return _turning(mesh, stencils, form)
    faces = stencils if isinstance(form, SurfaceForm) else np.asarray(mesh.faces, dtype=np.int64)
    count = len(mesh.vertices)
    if isinstance(form, BodyForm) and count <= _VERTICES:
        each = sps.csr_array(sps.eye_array(count))
        sizes = np.pad(form.mass[:, None], ((0, 0), (0, 2)))
        return _Part(BODY, np.repeat(np.arange(count)[:, None], 3, axis=1), sizes, each, each)
    shares = np.repeat(triangle_areas(mesh, faces)[:, None] / 3.0, 3, axis=1)
    groups, nearest = halved(mesh, faces, patches if isinstance(form, SurfaceForm) else _BODIES)
    areas = shares.sum(axis=1)
    if isinstance(form, SurfaceForm):
        ratios = np.bincount(groups, areas) / areas[nearest]
        means = _rows(groups, faces, shares, count)
        return _Part(SURFACE, faces[nearest], ratios[:, None] * form.sizes, means, means)
    assert isinstance(form, BodyForm)
    around = np.bincount(faces.ravel(), shares.ravel(), count)
    masses = shares * (form.mass / np.where(around > 0.0, around, 1.0))[faces]
    sizes = np.pad(np.bincount(groups, masses.sum(axis=1))[:, None], ((0, 0), (0, 2)))
    means = _rows(groups, faces, masses, count)
    return _Part(BODY, faces[nearest], sizes, means, means)


def _turning(mesh: TriangleMesh, faces: Index, form: TurningForm) -> _Part:
    """Every corner that is pushed is a point by itself: what turns a triangle pushes its corners in opposite ways."""
    groups, nearest = halved(mesh, faces, _GROUPS)
    local = np.tile([0.0, 0.0, 1.0], (len(nearest), 1))
    if form.vector is not None:
        corners = mesh.vertices[faces[nearest]]
        local = np.einsum("eij,i->ej", triangle_frames(corners, triangle_shapes(corners)), form.vector)
    pushed = np.flatnonzero(form.weights.any(axis=0))
    count = len(mesh.vertices)
    means = [_rows(groups, faces[:, [c]], form.weights[:, [c]], count, whole=False) for c in pushed]
    turns = [_rows(groups, faces[:, [c]], np.abs(form.weights[:, [c]]), count) for c in pushed]
    many = pushed.size
    stacked = [sps.csr_array(sps.vstack(rows)) for rows in (means, turns)]
    return _Part(TURNING, np.tile(faces[nearest], (many, 1)), np.tile(local, (many, 1)), *stacked)


def _rows(groups: Index, corners: Index, weights: Array, count: int, whole: bool = True) -> sps.csr_array:
    """Weights (k, n) of the vertices in the sums over groups; ``whole`` makes them sum to one."""
    rows = np.repeat(groups, corners.shape[1])
    matrix = sps.csr_array((weights.ravel(), (rows, corners.ravel())), shape=(int(groups.max()) + 1, count))
    if whole:
        totals: Array = np.asarray(matrix.sum(axis=1))
        matrix = sps.csr_array(sps.diags_array(1.0 / np.where(totals > 0.0, totals, 1.0)) @ matrix)
    return matrix


def triangle_areas(mesh: TriangleMesh, faces: Index) -> Array:
    """Areas (E,) [m^2] at rest, those of collapsed triangles taken for a little more than nothing."""
    areas = 0.5 * np.linalg.norm(area_vectors(mesh.vertices, faces), axis=1)
    return np.asarray(np.maximum(areas, _LEAST * areas.max()))


def halved(mesh: TriangleMesh, faces: Index, patches: int) -> tuple[Index, Index]:
    """Patch (E,) of each triangle, of about equal area, and the triangle nearest each patch's centre (k,).

    Along axes that turn with the mesh, triangles at places that differ by rounding alone in the order of their numbers:
    a turned mesh has the same patches. Of few triangles each is one.
    """
    if len(faces) <= _EACH:
        return np.arange(len(faces)), np.arange(len(faces))
    even, areas = _EVEN * mesh.size, triangle_areas(mesh, faces)
    centres = (mesh.vertices[faces].mean(axis=1) - mesh.vertices.mean(axis=0)) @ mesh.principal_axes.T
    parts = [np.arange(len(areas))]
    while len(parts) < patches:
        parts = [half for part in parts for half in _halves(centres, areas, part, even)]
    parts = [part for part in parts if part.size]
    groups, nearest = np.empty(len(areas), dtype=np.int64), []
    for number, part in enumerate(parts):
        groups[part] = number
        centre = areas[part] @ centres[part] / areas[part].sum()
        apart = np.linalg.norm(centres[part] - centre, axis=1)
        nearest.append(part[apart <= apart.min() + even].min())
    return groups, np.array(nearest)


def _halves(centres: Array, areas: Array, part: Index, even: float) -> tuple[Index, Index]:
    if part.size < 2:
        return part, part[:0]
    sides = np.ptp(centres[part], axis=0)
    along = centres[part, int(np.argmax(sides >= (1.0 - _ALIKE) * sides.max()))]
    order = np.argsort(along)
    places = np.empty(part.size, dtype=np.int64)  # triangles one after the other without a gap share a place
    places[order] = np.cumsum(np.diff(along[order], prepend=along[order[0]]) > even)
    order = part[np.lexsort((part, places))]
    grown = np.cumsum(areas[order])
    middle = int(np.clip(np.searchsorted(grown, (0.5 - _ALIKE) * grown[-1]) + 1, 1, len(order) - 1))
    return order[:middle], order[middle:]
