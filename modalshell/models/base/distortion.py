"""Distortion check: whether a deformed surface is within the range of modal models."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.outcome import Outcome
from modalshell.core.thread_safety import PerThread, read_only, writeable
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.models.base.distortion_kernels import surface_changes
from modalshell.models.reduction.sampled_change import spread_samples

_AREA = 2.0
"""Factor of increase or decrease of the area of the surface or a triangle beyond which it counts as distorted."""
_CRUMPLED = 0.1
"""Fraction of the surface whose triangles may exceed that factor."""
_OVER = -0.5
"""Cosine between the normals of neighbours below which a surface that was not folded has folded over."""
_SHARE = 0.05
"""Fraction of the edges at which it may be folded over."""
_SAMPLE = 1024
"""Pairs of neighbours that are looked at first, on meshes of several times as many."""
_CLEARLY = 0.25
"""Part of each limit within which a sample leaves no doubt: the fractions' limits are ten of its standard deviations
away."""
_WITHIN = 2.0
"""Extent of the positions, in sizes of the mesh, within which a few vertices cannot change the area by much."""
_LIKE = 8.0
"""Largest area of a triangle over their mean up to which a sample of triangles stands for the surface."""


@final
class Distortion:
    """Judges deformed shapes of one mesh.

    A shell bends with little stretch: neither its area nor that of a good part of its triangles doubles or halves, and
    its triangles do not fold over their neighbours.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self._mesh = mesh
        self._normals = PerThread(partial(np.empty, (4, len(mesh.faces))))

    @cached_property
    def _rest(self) -> tuple[tuple[NDArray[np.int64], Array, NDArray[np.int64]], float, int]:
        """Faces, their areas and the pairs of neighbours that are not folded over each other; area; hinges."""
        mesh = self._mesh
        pairs = mesh.hinge_faces
        normals = mesh.face_normals[pairs]
        unfolded = np.ascontiguousarray(pairs[np.einsum("hi,hi->h", normals[:, 0], normals[:, 1]) > 0.0])
        return (mesh.faces, mesh.face_areas, unfolded), mesh.area, len(pairs)

    @cached_property
    def _sample(self) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]] | None:
        """Faces of some pairs, spread evenly, their areas, and these pairs; None where the whole is looked at."""
        faces, areas, pairs = self._rest[0]
        if len(pairs) < max(4 * _SAMPLE, 1.2 * len(faces)) or areas.max() > _LIKE * areas.mean():
            return None
        chosen = pairs[spread_samples(len(pairs), _SAMPLE)[0]].ravel()
        # Read-only, as the whole's arrays are: the kernel is compiled once.
        return read_only(faces[chosen]), read_only(areas[chosen]), np.arange(2 * _SAMPLE).reshape(-1, 2)

    def _clear(self, positions: Array, farthest: Callable[[], float] | None = None) -> bool:
        """Whether a sample of the surface is so far within the limits that the whole is; not where a number is none."""
        if self._sample is None:
            return False
        near = farthest is not None and farthest() <= 0.5 * (_WITHIN - 1.0) * self._mesh.size
        if not (near or self._together(positions)):
            return False
        faces, areas, pairs = self._sample
        limits = _AREA, _OVER, int(_CLEARLY * _SHARE * _SAMPLE)
        area, changed, folded = surface_changes(positions, faces, areas, pairs, *limits, self._normals())
        rest, slightly = areas.sum(), _AREA**_CLEARLY
        return bool(
            1.0 / slightly < area / rest < slightly
            and changed <= _CLEARLY * _CRUMPLED * rest
            and folded <= _CLEARLY * _SHARE * _SAMPLE
        )

    def _together(self, positions: Array) -> bool:
        """Whether all vertices are within twice the mesh's size along each axis; not where one is no number."""
        most = _WITHIN * self._mesh.size

        def fits(along: Array) -> bool:
            return float(along.max()) - float(along.min()) <= most

        # Over all numbers at once it is fastest, and tells of shells that are near the origin.
        return fits(positions) or all(fits(along) for along in positions.T)

    def of(self, positions: Array, farthest: Callable[[], float] | None = None) -> str:
        """Description of a distorted surface at ``positions`` (n, 3); "" if it is within the range of modal models.

        ``farthest`` gives a length [m] that no vertex is beyond from rest; where it is short, no extent is looked at.
        """
        positions = writeable(positions)  # those at rest are read-only: the kernel is compiled once
        if self._clear(positions, farthest):
            return ""
        rest, rest_area, hinges = self._rest
        area, changed, folded = surface_changes(positions, *rest, _AREA, _OVER, int(_SHARE * hinges), self._normals())
        ratio = area / rest_area
        if not 1.0 / _AREA < ratio < _AREA:
            return f"the surface area is {ratio:.3g} of that at rest"
        if changed > _CRUMPLED * rest_area:
            return f"the area doubled or halved on {100.0 * changed / rest_area:.2g} % of the surface"
        if folded > _SHARE * hinges:
            return f"triangles fold over their neighbours at {100.0 * folded / hinges:.2g} % of the edges"
        return ""

    def judged(self, outcome: Outcome, message: str, positions: Array) -> tuple[Outcome, str]:
        """Outcome and message of a static solution, after the check of its ``positions`` (n, 3)."""
        said = self.of(positions)
        if not said:
            return outcome, message
        said = f"beyond what the model can describe: {said}"
        return Outcome.DISTORTED if outcome is Outcome.CONVERGED else outcome, f"{message}; {said}" if message else said
