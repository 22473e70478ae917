"""Distortion measures of a deformed surface, in one pass over its faces and one over pairs of neighbours."""

import math

from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.frame import FASTMATH


@njit(error_model="numpy", fastmath=FASTMATH, **UNCOUNTED)
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
