"""How far a deformed surface is from that at rest: one pass over its faces, one over pairs of neighbours."""

from __future__ import annotations

import math

from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import FASTMATH


@njit(error_model="numpy", fastmath=FASTMATH)
def surface_changes(x, faces, areas, pairs, factor, cosine, normals):  # type: ignore[no-untyped-def]
    """Area at ``x`` (n, 3), rest area of the ``faces`` (T, 3) that changed by ``factor``, and folded ``pairs`` (P, 2).

    ``areas`` (T,) are those at rest. A pair of faces is folded where the cosine between their normals is below
    ``cosine``. ``normals`` (T, 4) is written to.
    """
    for t in range(faces.shape[0]):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, az = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        bx, by, bz = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        normals[t, 0], normals[t, 1], normals[t, 2] = nx, ny, nz
        normals[t, 3] = math.sqrt(nx * nx + ny * ny + nz * nz)
    area, changed = 0.0, 0.0
    for t in range(faces.shape[0]):
        now, rest = 0.5 * normals[t, 3], areas[t]
        area += now
        changed += rest if now > factor * rest or factor * now < rest else 0.0
    folded = 0
    for p in range(pairs.shape[0]):
        f, s = pairs[p, 0], pairs[p, 1]
        product = normals[f, 0] * normals[s, 0] + normals[f, 1] * normals[s, 1] + normals[f, 2] * normals[s, 2]
        folded += product < cosine * normals[f, 3] * normals[s, 3]
    return area, changed, folded
