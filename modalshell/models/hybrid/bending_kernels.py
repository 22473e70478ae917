"""Compiled bending of a reduced energy: angles of hinges that are bent at rest, and what couples them."""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import LANES, dot, load, spread, spread_from, store
from modalshell.shell.kernels.generated.flexure import first_derivatives

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}


@njit(**_options)
def hinge_angles(bending, z, first, strains, slopes):  # type: ignore[no-untyped-def]
    """Write the angles' changes and slopes, times the roots of their weights, from the ``first`` on; positions."""
    count, modes = z.size, bending.modes.reshape(-1)
    x = bending.rest.copy()
    for v in range(x.shape[0]):
        for axis in range(3):
            x[v, axis] += dot(modes, (3 * v + axis) * count, z, 0, count)
    local, row = np.empty(9), np.empty(count)
    for h in range(bending.hinges.shape[0]):
        a, b, c, d = bending.hinges[h]
        angle = first_derivatives(
            x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2],
            x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2],
            x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2], local,
        )  # fmt: skip
        root = bending.roots[h]
        strains[first + h] = root * ((angle - bending.angles[h] + np.pi) % (2.0 * np.pi) - np.pi)
        row[:] = 0.0
        for axis in range(3):
            p, q, r = root * local[axis], root * local[3 + axis], root * local[6 + axis]
            for i in range(count):
                row[i] += p * bending.modes[b, axis, i] + q * bending.modes[c, axis, i] + r * bending.modes[d, axis, i]
                row[i] -= (p + q + r) * bending.modes[a, axis, i]
        slopes[:, first + h] = row
    return x


@njit(**_options)
def _mean_normal(bending, x, h, way, normal):  # type: ignore[no-untyped-def]
    """Write the ``way`` from one side of a hinge to the other, across its edge, and the unit mean normal; its length.

    The way is by feet and heights at rest; with the edge's it spans the plane that halves the fold.
    """
    a, b, c, d = bending.hinges[h]
    for axis in range(3):
        edge = x[b, axis] - x[a, axis]
        here = (x[c, axis] - x[a, axis] - bending.feet[h, 0] * edge) * bending.feet[h, 1]
        there = (x[d, axis] - x[a, axis] - bending.feet[h, 2] * edge) * bending.feet[h, 3]
        way[axis] = there - here
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        normal[axis] = (x[b, j] - x[a, j]) * way[k] - (x[b, k] - x[a, k]) * way[j]
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    for axis in range(3):
        normal[axis] /= length
    return length


@njit(**_options)
def _pull_normal(bending, x, h, pull, way, normal, length, forces):  # type: ignore[no-untyped-def]
    """Add the gradient of ``pull . normal`` to the ``forces`` on a hinge's vertices."""
    a, b, c, d = bending.hinges[h]
    along = pull[0] * normal[0] + pull[1] * normal[1] + pull[2] * normal[2]
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        left = (pull[j] - along * normal[j]) / length
        right = (pull[k] - along * normal[k]) / length
        on_edge = way[j] * right - way[k] * left
        on_way = left * (x[b, k] - x[a, k]) - right * (x[b, j] - x[a, j])
        here, there = -on_way * bending.feet[h, 1], on_way * bending.feet[h, 3]
        forces[c, axis] += here
        forces[d, axis] += there
        on_edge -= bending.feet[h, 0] * here + bending.feet[h, 2] * there
        forces[b, axis] += on_edge
        forces[a, axis] -= on_edge + here + there


@njit(**_options)
def add_couplings(bending, z, x, first, strains, slopes, others, gradient):  # type: ignore[no-untyped-def]
    """Add what couples bent hinges to the gradient, and write the ``others`` (H, m) that their slopes are coupled to.

    Returns the energy. The normals' turning is in the gradient alone.
    """
    count, value, across = z.size, 0.0, bending.across.reshape(-1)
    forces, way, normal, pull = np.zeros_like(x), np.empty(3), np.empty(3), np.empty(3)
    rows = np.ascontiguousarray(slopes[:, first : first + others.shape[0]].T)
    for h in range(bending.hinges.shape[0]):
        bent = strains[first + h]
        length = _mean_normal(bending, x, h, way, normal)
        for axis in range(3):
            pull[axis] = dot(across, (3 * h + axis) * count, z, 0, count)
        flat, coupled = pull[0] * normal[0] + pull[1] * normal[1] + pull[2] * normal[2], 0.0
        for axis in range(3):
            pull[axis] *= bent
        _pull_normal(bending, x, h, pull, way, normal, length, forces)
        others[h] = 0.0
        for place in range(bending.starts[h], bending.starts[h + 1]):
            other, factor = bending.others[place], bending.values[place]
            coupled += factor * strains[first + other]
            for i in range(count):
                others[h, i] += 0.5 * factor * rows[other, i]
        value += bent * (0.5 * coupled + flat)
        n, o, p = normal
        for i in range(count):
            turned = bending.across[h, 0, i] * n + bending.across[h, 1, i] * o + bending.across[h, 2, i] * p
            others[h, i] += turned
            gradient[i] += rows[h, i] * (coupled + flat) + bent * turned
    for v in range(x.shape[0]):
        for axis in range(3):
            for i in range(count):
                gradient[i] += bending.modes[v, axis, i] * forces[v, axis]
    return value


@njit(**_options)
def write_products(left, right, width, lower, made):  # type: ignore[no-untyped-def]
    """Write sums of products of rows of ``left`` and ``right`` of length ``width`` into ``made``, or its lower half."""
    for i in range(0, width, 4):
        for j in range(0, i + 4 if lower else width, LANES):
            a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            for at in range(0, left.size, width):
                row = load(right, at + j)
                a = a + spread_from(left, at + i) * row
                b = b + spread_from(left, at + i + 1) * row
                c = c + spread_from(left, at + i + 2) * row
                d = d + spread_from(left, at + i + 3) * row
            store(made, i * width + j, a)
            store(made, (i + 1) * width + j, b)
            store(made, (i + 2) * width + j, c)
            store(made, (i + 3) * width + j, d)


@njit(**_options)
def add_coupled(slopes, first, others, factor, matrix):  # type: ignore[no-untyped-def]
    """Add ``factor`` times the products of slopes and what they are coupled to, and their transposes."""
    size, count = others.shape
    width = -(-count // LANES) * LANES
    left, right, made = np.zeros(size * width), np.zeros(size * width), np.empty(width * width)
    for i in range(count):
        for h in range(size):
            left[h * width + i] = slopes[i, first + h]
            right[h * width + i] = others[h, i]
    write_products(left, right, width, False, made)
    for i in range(count):
        for j in range(i + 1):
            matrix[i, j] += factor * (made[i * width + j] + made[j * width + i])
