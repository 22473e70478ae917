"""Compiled: the nearest point of a triangle mesh, where it crosses itself, and what lies inside it."""

import numpy as np

from modalshell.kernels.compiler import njit

_CLEAR = 1e-9
"""Share of a triangle by which what passes through it is away from its plane and its edges."""


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


@njit(fastmath=False)
def _pierces(p, q, a, b, c):  # type: ignore[no-untyped-def]
    """Whether the line from p to q passes through the inner part of a triangle."""
    normal = np.cross(b - a, c - a)
    limit = _CLEAR * np.sqrt(normal @ normal) * np.sqrt((b - a) @ (b - a))
    before, after = normal @ (p - a), normal @ (q - a)
    if not min(before, after) < -limit or not max(before, after) > limit:
        return False
    at = p + before / (before - after) * (q - p)
    least = _CLEAR * (normal @ normal)
    first, second = normal @ np.cross(b - a, at - a), normal @ np.cross(c - b, at - b)
    return first > least and second > least and normal @ np.cross(a - c, at - c) > least


@njit(fastmath=False)
def first_crossing(vertices, faces, centres, radii):  # type: ignore[no-untyped-def]
    """Two triangles of a mesh, an edge of one through the other; -1 and -1 if there are none."""
    for s in range(faces.shape[0]):
        for t in range(s + 1, faces.shape[0]):
            away, reach = centres[s] - centres[t], radii[s] + radii[t]
            if away @ away >= reach * reach:
                continue
            shared = False
            for i in range(3):
                for j in range(3):
                    shared |= faces[s, i] == faces[t, j]
            if shared:
                continue
            for one, other in ((s, t), (t, s)):
                a, b, c = vertices[faces[other, 0]], vertices[faces[other, 1]], vertices[faces[other, 2]]
                for i in range(3):
                    if _pierces(vertices[faces[one, i]], vertices[faces[one, (i + 1) % 3]], a, b, c):
                        return s, t
    return -1, -1


@njit(fastmath=False)
def windings(points, vertices, faces, numbers):  # type: ignore[no-untyped-def]
    """How often the triangles of a mesh go round each point: ``numbers`` (k,), 1 inside a body, 0 outside."""
    for k in range(points.shape[0]):
        p, total = points[k], 0.0
        for t in range(faces.shape[0]):
            a, b, c = vertices[faces[t, 0]] - p, vertices[faces[t, 1]] - p, vertices[faces[t, 2]] - p
            u, v, w = np.sqrt(a @ a), np.sqrt(b @ b), np.sqrt(c @ c)
            total += 2.0 * np.arctan2(a @ np.cross(b, c), u * v * w + (a @ b) * w + (b @ c) * u + (c @ a) * v)
        numbers[k] = total / (4.0 * np.pi)
