"""Hyper-reduction of surface loads: their modal forces from a few weighted triangles."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.kernels.surface_loads import surface_push
from modalshell.loads import AppliedLoad, Loading
from modalshell.loads.applied import SurfaceForm
from modalshell.mesh import TriangleMesh
from modalshell.modes import Basis
from modalshell.typing import Array, Index

_PATCHES = 128
"""Patches of the surface."""
_WORTH = 8
"""Triangles of a patch from which the quadrature is taken; smaller meshes sum over all triangles."""


@final
class LoadQuadrature:
    """Pressure and wind on a shell by the midpoint rule over patches of its surface.

    The triangles are halved by their centroids along the longest side, by area, into 128 patches. The triangle nearest
    a patch's centre stands for it: its force times the ratio of the areas acts on the patch's mean modes, which the
    patch's mean rotation turns. The error falls as the square of the patches' size.

    Parameters
    ----------
    basis : Basis
        Modes and modal rotations.
    loads : sequence of AppliedLoad
        The loads.
    turned : bool
        Whether modes turn with the patches.
    """

    def __init__(self, basis: Basis, loads: tuple[AppliedLoad, ...], turned: bool) -> None:
        self._turned, self._count = turned, basis.count
        self._parts = [_Part(basis, load) for load in loads if load.surface is not None]
        self._constant = [(load, basis.modes.T @ load.constant.ravel()) for load in loads if load.constant is not None]

    @classmethod
    def of(cls, basis: Basis, loading: Loading, turned: bool) -> LoadQuadrature | None:
        """The quadrature of the loads that change; None where one cannot be summed so, or the mesh is small.

        Where nothing turns, forces that change by a factor alone are summed exactly, too.
        """
        for load in loading.live:
            many = load.surface is not None and len(load.stencils) >= _WORTH * _PATCHES
            if not (many or (load.constant is not None and not turned)):
                return None
        if not loading.live:
            return None
        return cls(basis, loading.live, turned)

    def push(self, q: Array, x: Array, before: Array, rate: float, time: float) -> tuple[Array, Array]:
        """Modal forces (m,) at coordinates q and positions (n, 3), and minus their derivatives by the rates (m, m).

        Velocities are ``rate (x - before)``.
        """
        push, drag = np.zeros(self._count), np.zeros((self._count, self._count))
        for part in self._parts:
            part.add(q, x, before, rate, time, self._turned, push, drag)
        for load, force in self._constant:
            push += load.factor_at(time) * force
        return push, drag


@final
class _Part:
    """The patches of one load."""

    def __init__(self, basis: Basis, load: AppliedLoad) -> None:
        assert load.surface is not None
        mesh: TriangleMesh = basis.shell.mesh
        corners = mesh.vertices[load.stencils]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        centres = corners.mean(axis=1)
        patches = _halved(centres, areas, np.arange(len(areas)), _PATCHES)
        self.faces = np.array([load.stencils[_nearest(centres, areas, patch)] for patch in patches])
        ratios = np.array([areas[patch].sum() / areas[_nearest(centres, areas, patch)] for patch in patches])
        form: SurfaceForm = load.surface
        self._sizes = ratios[:, None] * form.sizes
        self._load, self._form = load, form
        self._air = np.zeros((len(patches), 3))
        if form.velocity is not None and not callable(form.velocity):
            self._air[:] = form.velocity
        self.modes, self.turns = (
            _means(rows, load.stencils, areas, patches) for rows in (basis.modes, basis.rotations)
        )

    def add(
        self, q: Array, x: Array, before: Array, rate: float, time: float, turned: bool, push: Array, drag: Array
    ) -> None:
        sizes, air = self._sizes, self._air
        if self._load.factor is not None:
            sizes = sizes * self._load.factor(time)
        if callable(self._form.velocity):
            air = self._form.air(x, self.faces, time)
        surface_push(x, before, rate, self.faces, sizes, air, self.modes, self.turns, q, turned, push, drag)


def _halved(centres: Array, areas: Array, chosen: Index, parts: int) -> list[Index]:
    """Triangles ``chosen`` in ``parts`` patches, a power of two, of about equal area."""
    if parts == 1:
        return [chosen]
    axis = int(np.argmax(np.ptp(centres[chosen], axis=0)))
    order = chosen[np.argsort(centres[chosen, axis], kind="stable")]
    grown = np.cumsum(areas[order])
    middle = int(np.clip(np.searchsorted(grown, 0.5 * grown[-1]) + 1, 1, len(order) - 1))
    return [patch for half in (order[:middle], order[middle:]) for patch in _halved(centres, areas, half, parts // 2)]


def _nearest(centres: Array, areas: Array, patch: Index) -> int:
    """The triangle of a patch nearest to its centre."""
    centre = areas[patch] @ centres[patch] / areas[patch].sum()
    return int(patch[np.argmin(np.sum((centres[patch] - centre) ** 2, axis=1))])


def _means(rows: Array, stencils: Index, areas: Array, patches: list[Index]) -> Array:
    """Means over patches (k, 3, m), by area, of the rows (3n, m) at the corners of triangles."""
    corners = rows.reshape(-1, 3, rows.shape[1])
    return np.stack(
        [np.tensordot(areas[patch] / areas[patch].sum(), corners[stencils[patch]].mean(axis=1), 1) for patch in patches]
    )
