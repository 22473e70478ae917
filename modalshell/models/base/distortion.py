"""Distortion check: whether a deformed surface is within the range of modal models."""

from __future__ import annotations

import math
from functools import cached_property, partial
from typing import final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.outcome import Outcome
from modalshell.core.thread_safety import PerThread
from modalshell.core.typing import Array
from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import FASTMATH
from modalshell.mesh import TriangleMesh

_AREA = 2.0
"""Factor of increase or decrease of the area of the surface or a triangle beyond which it counts as distorted."""
_CRUMPLED = 0.1
"""Fraction of the surface whose triangles may exceed that factor."""
_OVER = -0.5
"""Cosine between the normals of neighbours below which a surface that was not folded has folded over."""
_SHARE = 0.05
"""Fraction of the edges at which it may be folded over."""


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

    def of(self, positions: Array) -> str:
        """Description of a distorted surface at ``positions`` (n, 3); "" if it is within the range of modal models."""
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


@njit(error_model="numpy", fastmath=FASTMATH)
def surface_changes(x, faces, areas, pairs, factor, cosine, ignored, normals):  # type: ignore[no-untyped-def]
    """Area at ``x`` (n, 3), rest area of the ``faces`` (T, 3) that changed by ``factor``, and folded ``pairs`` (P, 2).

    ``areas`` (T,) are those at rest. A pair of faces is folded where the cosine between their normals is below
    ``cosine``; pairs are counted unless at most ``ignored`` can be folded. ``normals`` (4, T) is written to.
    """
    for t in range(faces.shape[0]):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, az = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        bx, by, bz = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
        normals[0, t], normals[1, t], normals[2, t] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    area, changed = 0.0, 0.0
    sx, sy, sz = 0.0, 0.0, 0.0
    for t in range(faces.shape[0]):
        nx, ny, nz = normals[0, t], normals[1, t], normals[2, t]
        length, rest = math.sqrt(nx * nx + ny * ny + nz * nz), areas[t]
        normals[3, t] = length
        sx, sy, sz = sx + nx, sy + ny, sz + nz
        now = 0.5 * length
        area += now
        changed += rest if (now > factor * rest) | (factor * now < rest) else 0.0
    # Of a folded pair one normal at least is half the angle or more from any direction, that of the sum for one; a face
    # is in three pairs.
    bound = math.sqrt(0.5 + 0.5 * cosine) * math.sqrt(sx * sx + sy * sy + sz * sz)
    aside, folded = 0, 0
    for t in range(faces.shape[0]):
        aside += normals[0, t] * sx + normals[1, t] * sy + normals[2, t] * sz <= bound * normals[3, t]
    if 3 * aside > ignored:
        for p in range(pairs.shape[0]):
            f, s = pairs[p, 0], pairs[p, 1]
            product = normals[0, f] * normals[0, s] + normals[1, f] * normals[1, s] + normals[2, f] * normals[2, s]
            folded += product < cosine * normals[3, f] * normals[3, s]
    return area, changed, folded
