"""Compiled: the nearest point of a triangle mesh."""

import numpy as np

from modalshell.kernels.compiler import njit


@njit(fastmath=False)
def _nearest_of_triangle(p, a, b, c):  # type: ignore[no-untyped-def]
    """Weights of the corners at the nearest point of a triangle [ericson2005, section 5.1.5], and its feature.

    Features are 0 the face, 1 to 3 the edges opposite to the corners, 4 to 6 the corners.
    """
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab @ ap, ac @ ap
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0, 4
    bp = p - b
    d3, d4 = ab @ bp, ac @ bp
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0, 5
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return 1.0 - v, v, 0.0, 3
    cp = p - c
    d5, d6 = ab @ cp, ac @ cp
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0, 6
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return 1.0 - w, 0.0, w, 2
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - w, w, 1
    total = va + vb + vc
    return va / total, vb / total, vc / total, 0


@njit(fastmath=False)
def nearest_points(points, vertices, faces, centres, radii, found, triangles, features):  # type: ignore[no-untyped-def]
    """Nearest points ``found`` (k, 3) of a mesh to ``points`` (k, 3), their triangles and features (k,).

    ``centres`` (T, 3) and ``radii`` (T,) are balls about the triangles, which pass over most of them. Of a point that
    is not finite the nearest is NaN.
    """
    for k in range(points.shape[0]):
        p, best = points[k], np.inf
        found[k], triangles[k], features[k] = np.nan, 0, 0
        for t in range(faces.shape[0]):
            x, y, z = p[0] - centres[t, 0], p[1] - centres[t, 1], p[2] - centres[t, 2]
            if np.sqrt(x * x + y * y + z * z) - radii[t] >= best:
                continue
            a, b, c = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
            u, v, w, feature = _nearest_of_triangle(p, a, b, c)
            nearest = u * a + v * b + w * c
            away = p - nearest
            distance = np.sqrt(away @ away)
            if distance < best:
                best = distance
                found[k], triangles[k], features[k] = nearest, t, feature
