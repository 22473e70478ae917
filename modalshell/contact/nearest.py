"""Compiled: the nearest point of a triangle mesh, where it crosses itself, and what lies inside it."""

import numpy as np

from modalshell.kernels.compiler import njit

_CLEAR = 1e-9
"""Share of a triangle by which what passes through it is away from its plane and its edges."""


@njit(fastmath=False)
def _between(end, begin):  # type: ignore[no-untyped-def]
    """The way between two points, in three numbers, which compile sooner than arrays."""
    return end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]


@njit(fastmath=False)
def _dot(u, v):  # type: ignore[no-untyped-def]
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@njit(fastmath=False)
def _nearest_of_triangle(p, a, b, c):  # type: ignore[no-untyped-def]
    """Weights of the corners at the nearest point of a triangle [ericson2005, section 5.1.5], and its feature.

    Features are 0 the face, 1 to 3 the edges opposite to the corners, 4 to 6 the corners.
    """
    ab, ac, ap = _between(b, a), _between(c, a), _between(p, a)
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0, 4
    bp = _between(p, b)
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0, 5
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return 1.0 - v, v, 0.0, 3
    cp = _between(p, c)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
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
            x, y, z = (
                u * a[0] + v * b[0] + w * c[0],
                u * a[1] + v * b[1] + w * c[1],
                u * a[2] + v * b[2] + w * c[2],
            )
            distance = _length((p[0] - x, p[1] - y, p[2] - z))
            if distance < best:
                best = distance
                found[k, 0], found[k, 1], found[k, 2] = x, y, z
                triangles[k], features[k] = t, feature


@njit(fastmath=False)
def _product(u, v, w):  # type: ignore[no-untyped-def]
    """Triple product ``u . (v x w)``."""
    x, y, z = v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0]
    return u[0] * x + u[1] * y + u[2] * z


@njit(fastmath=False)
def _length(u):  # type: ignore[no-untyped-def]
    return np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])


@njit(fastmath=False)
def _pierces(vertices, ends, face):  # type: ignore[no-untyped-def]
    """Whether the line between two vertices passes through the inner part of a triangle."""
    p = vertices[ends[0]]
    along, a = _between(vertices[ends[1]], p), _between(vertices[face[0]], p)
    b, c = _between(vertices[face[1]], p), _between(vertices[face[2]], p)
    before = -_product(a, b, c)  # six times the volume of the triangle and each end
    first, second, third = _product(along, a, b), _product(along, b, c), _product(along, c, a)
    slope = first + second + third
    side = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    other = (c[0] - a[0], c[1] - a[1], c[2] - a[2])
    limit = _CLEAR * _length(side) * _length(side) * _length(other)
    if not min(before, before + slope) < -limit or not max(before, before + slope) > limit:
        return False
    return min(first / slope, second / slope, third / slope) > _CLEAR


@njit(fastmath=False)
def first_crossing(vertices, faces, centres, radii, order):  # type: ignore[no-untyped-def]
    """Two triangles of a mesh, an edge of one through the other; -1 and -1 if there are none.

    ``order`` sorts the triangles by where their balls begin along the first axis.
    """
    for k in range(order.size):
        s = order[k]
        for m in range(k + 1, order.size):
            t = order[m]
            reach, away = radii[s] + radii[t], centres[t, 0] - centres[s, 0]
            if away > reach:
                break  # so do all that begin further along the first axis
            square = away * away + (centres[t, 1] - centres[s, 1]) ** 2 + (centres[t, 2] - centres[s, 2]) ** 2
            if square >= reach * reach:
                continue
            shared = False
            for i in range(3):
                for j in range(3):
                    shared |= faces[s, i] == faces[t, j]
            if shared:
                continue
            for i in range(3):
                j = (i + 1) % 3
                if _pierces(vertices, (faces[s, i], faces[s, j]), (faces[t, 0], faces[t, 1], faces[t, 2])):
                    return s, t
                if _pierces(vertices, (faces[t, i], faces[t, j]), (faces[s, 0], faces[s, 1], faces[s, 2])):
                    return s, t
    return -1, -1


@njit(fastmath=False)
def windings(points, vertices, faces, numbers):  # type: ignore[no-untyped-def]
    """How often the triangles of a mesh go round each point: ``numbers`` (k,), 1 inside a body, 0 outside."""
    for k in range(points.shape[0]):
        total = 0.0
        for t in range(faces.shape[0]):
            a = _between(vertices[faces[t, 0]], points[k])
            b = _between(vertices[faces[t, 1]], points[k])
            c = _between(vertices[faces[t, 2]], points[k])
            u, v, w = _length(a), _length(b), _length(c)
            ab, bc, ca = _dot(a, b), _dot(b, c), _dot(c, a)
            total += 2.0 * np.arctan2(_product(a, b, c), u * v * w + ab * w + bc * u + ca * v)
        numbers[k] = total / (4.0 * np.pi)
