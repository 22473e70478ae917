"""Compiled bending of a reduced energy: angles of hinges that are bent at rest, and what couples them.

Vectors over coordinates are rows of a whole number of packed registers, ``width`` long and padded with zeros.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.packed import LANES, dot, load, spread, spread_from, store
from modalshell.shell.kernels.generated.flexure import first_derivatives

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}


@njit(**_options)
def hinge_angles(bending, z, first, strains, slopes):  # type: ignore[no-untyped-def]
    """Write the angles' changes and their slopes, times the roots of their weights, from the ``first`` row on.

    ``z`` (width,) are the coordinates, ``slopes`` rows of that length, flat. Returns the hinges' positions.
    """
    width, modes = z.size, bending.modes.reshape(-1)
    x, local = bending.rest.copy(), np.empty(9)
    for v in range(x.shape[0]):
        for axis in range(3):
            x[v, axis] += dot(modes, (3 * v + axis) * width, z, 0, width)
    for h in range(bending.hinges.shape[0]):
        a, b, c, d = bending.hinges[h]
        angle = first_derivatives(
            x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2],
            x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2],
            x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2], local,
        )  # fmt: skip
        root, row = bending.roots[h], (first + h) * width
        strains[first + h] = root * ((angle - bending.angles[h] + np.pi) % (2.0 * np.pi) - np.pi)
        for i in range(0, width, LANES):
            slope = spread(0.0)
            for axis in range(3):
                p, q, r = root * local[axis], root * local[3 + axis], root * local[6 + axis]
                slope = slope + spread(p) * load(modes, (3 * b + axis) * width + i)
                slope = slope + spread(q) * load(modes, (3 * c + axis) * width + i)
                slope = slope + spread(r) * load(modes, (3 * d + axis) * width + i)
                slope = slope - spread(p + q + r) * load(modes, (3 * a + axis) * width + i)
            store(slopes, row + i, slope)
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
    """Add the gradient of ``pull . normal`` to the ``forces`` (S * 3,) on a hinge's vertices."""
    a, b, c, d = bending.hinges[h]
    along = pull[0] * normal[0] + pull[1] * normal[1] + pull[2] * normal[2]
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        left = (pull[j] - along * normal[j]) / length
        right = (pull[k] - along * normal[k]) / length
        on_edge = way[j] * right - way[k] * left
        on_way = left * (x[b, k] - x[a, k]) - right * (x[b, j] - x[a, j])
        here, there = -on_way * bending.feet[h, 1], on_way * bending.feet[h, 3]
        forces[3 * c + axis] += here
        forces[3 * d + axis] += there
        on_edge -= bending.feet[h, 0] * here + bending.feet[h, 2] * there
        forces[3 * b + axis] += on_edge
        forces[3 * a + axis] -= on_edge + here + there


@njit(**_options)
def couple(bending, z, x, first, strains, slopes, others, gradient):  # type: ignore[no-untyped-def]
    """Add what couples bent hinges to the ``gradient``; write the rows of ``others`` that their slopes are coupled to.

    Returns the energy. The normals' turning is in the gradient alone.
    """
    width, value, across = z.size, 0.0, bending.across.reshape(-1)
    modes, way, normal, pull = bending.modes.reshape(-1), np.empty(3), np.empty(3), np.empty(3)
    forces = np.zeros(x.size)
    for h in range(bending.across.shape[0]):
        bent, row, over = strains[first + h], (first + h) * width, 3 * h * width
        length = _mean_normal(bending, x, h, way, normal)
        for axis in range(3):
            pull[axis] = dot(across, over + axis * width, z, 0, width)
        flat, coupled = pull[0] * normal[0] + pull[1] * normal[1] + pull[2] * normal[2], 0.0
        for axis in range(3):
            pull[axis] *= bent
        _pull_normal(bending, x, h, pull, way, normal, length, forces)
        begin, end = bending.starts[h], bending.starts[h + 1]
        for place in range(begin, end):
            coupled += bending.values[place] * strains[first + bending.others[place]]
        value += bent * (0.5 * coupled + flat)
        for i in range(0, width, LANES):
            turned, other = spread(0.0), spread(0.0)
            for axis in range(3):
                turned = turned + spread_from(normal, axis) * load(across, over + axis * width + i)
            for place in range(begin, end):
                other = other + spread_from(bending.values, place) * load(
                    slopes, (first + bending.others[place]) * width + i
                )
            store(others, h * width + i, turned + spread(0.5) * other)
            force = spread(coupled + flat) * load(slopes, row + i) + spread(bent) * turned
            store(gradient, i, load(gradient, i) + force)
    add_rows(modes, 0, forces, 0, forces.size, gradient)
    return value


@njit(**_options)
def add_rows(rows, begin, factors, first, count, out):  # type: ignore[no-untyped-def]
    """Add ``count`` rows, of the length of ``out`` and from number ``begin`` on, times the factors from ``first`` on."""
    width = out.size
    for i in range(0, width, LANES):
        a, b, at = load(out, i), spread(0.0), begin + i
        for k in range(count // 2):
            a = a + spread_from(factors, first + 2 * k) * load(rows, at)
            b = b + spread_from(factors, first + 2 * k + 1) * load(rows, at + width)
            at += 2 * width
        if count % 2:
            a = a + spread_from(factors, first + count - 1) * load(rows, at)
        store(out, i, a + b)


@njit(**_options)
def add_products(left, begin, right, start, count, width, matrix):  # type: ignore[no-untyped-def]
    """Add products of ``count`` rows, from number ``begin`` of ``left`` and number ``start`` of ``right`` on.

    To the lower triangle of ``matrix`` (width, width), which is flat, and beside it within blocks.
    """
    for i in range(0, width, 4):
        for j in range(0, i + 4, LANES):
            at, other = i * width + j, start * width + j
            a, b = load(matrix, at), load(matrix, at + width)
            c, d = load(matrix, at + 2 * width), load(matrix, at + 3 * width)
            for k in range(begin * width + i, (begin + count) * width + i, width):
                row = load(right, other)
                a = a + spread_from(left, k) * row
                b = b + spread_from(left, k + 1) * row
                c = c + spread_from(left, k + 2) * row
                d = d + spread_from(left, k + 3) * row
                other += width
            store(matrix, at, a)
            store(matrix, at + width, b)
            store(matrix, at + 2 * width, c)
            store(matrix, at + 3 * width, d)
