"""Kernels of the split-fold energy on the storage of a profile factorisation: blocks below the diagonal alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.linalg.columns import solve_rows

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}


@njit(**_options)
def couples_of(folds, bending, right, shares, couples):  # type: ignore[no-untyped-def]
    """Write the derivatives of the bending energy by fold angles, shares at their minimum, into ``couples`` (H,).

    ``folds`` (H,) are changes of the angles, linear as they may be rates; ``right`` and ``shares`` (1, m) are written.
    """
    own, index, factors, moments = bending.folds, bending.share_index, bending.shares, bending.moments
    gamma = np.empty(5)
    right[:] = 0.0
    couples[:] = 0.0
    for pair in range(own.shape[0]):
        for k in range(5):
            gamma[k] = folds[own[pair, k]] if own[pair, k] >= 0 else 0.0
        for k in range(5):
            if index[pair, k] >= 0:
                moment = 0.0
                for other in range(5):
                    moment += moments[pair, k, other] * gamma[other]
                right[0, index[pair, k]] -= factors[pair, k] * moment
    if right.size:
        f = bending.factor
        solve_rows(f.starts, f.rows, f.values, f.pivots, f.order, right, shares)
    for pair in range(own.shape[0]):
        for k in range(5):
            gamma[k] = folds[own[pair, k]] if own[pair, k] >= 0 else 0.0
            if index[pair, k] >= 0:
                gamma[k] += factors[pair, k] * shares[0, index[pair, k]]
        for k in range(5):
            if own[pair, k] >= 0:
                for other in range(5):
                    couples[own[pair, k]] += moments[pair, k, other] * gamma[other]


@njit(**_options)
def tensions_of(stretches, membrane, tensions):  # type: ignore[no-untyped-def]
    """Write the derivatives of the membrane's energy by half squared lengths into ``tensions`` (E,)."""
    for edge in range(tensions.size):
        total = 0.0
        for place in range(membrane.starts[edge], membrane.starts[edge + 1]):
            total += membrane.values[place] * stretches[membrane.columns[place]]
        tensions[edge] = total


@njit(**_options)
def add_bending(slopes, bending, strides, values):  # type: ignore[no-untyped-def]
    """Add ``sum J^T K J`` over pairs of triangles, and its coupling to the fold shares, to the profile ``values``.

    See :func:`modalshell.shell.kernels.split_folds.add_bending`. A coupling stands in the row of what is eliminated
    last, its entries ``share_steps`` apart.
    """
    stencils, folds, places, slots = bending.stencils, bending.folds, bending.places, bending.slots
    rows, stressed, products = np.empty((5, 24)), np.empty((5, 24)), np.empty(24)
    for pair in range(stencils.shape[0]):
        rows[:] = 0.0
        for k in range(5):
            hinge = folds[pair, k]
            if hinge < 0:
                continue
            for axis in range(3):
                g1, g2, g3 = slopes[hinge, axis], slopes[hinge, 3 + axis], slopes[hinge, 6 + axis]
                rows[k, 3 * places[pair, k, 0] + axis] = -(g1 + g2 + g3)
                rows[k, 3 * places[pair, k, 1] + axis] = g1
                rows[k, 3 * places[pair, k, 2] + axis] = g2
                rows[k, 3 * places[pair, k, 3] + axis] = g3
        for k in range(5):
            m0, m1, m2 = bending.moments[pair, k, 0], bending.moments[pair, k, 1], bending.moments[pair, k, 2]
            m3, m4 = bending.moments[pair, k, 3], bending.moments[pair, k, 4]
            for c in range(24):
                stressed[k, c] = m0 * rows[0, c] + m1 * rows[1, c] + m2 * rows[2, c] + m3 * rows[3, c] + m4 * rows[4, c]
        for first in range(8):
            if slots[pair, first, first] < 0:  # held vertices and ghosts have no rows
                continue
            stride = strides[stencils[pair, first]]
            for axis in range(3):
                row = 3 * first + axis
                a0, a1, a2, a3, a4 = rows[0, row], rows[1, row], rows[2, row], rows[3, row], rows[4, row]
                for c in range(24):
                    products[c] = (
                        a0 * stressed[0, c] + a1 * stressed[1, c] + a2 * stressed[2, c]
                        + a3 * stressed[3, c] + a4 * stressed[4, c]
                    )  # fmt: skip
                for second in range(8):
                    slot = slots[pair, first, second]
                    if slot >= 0:
                        slot += axis * stride
                        values[slot] += products[3 * second]
                        values[slot + 1] += products[3 * second + 1]
                        values[slot + 2] += products[3 * second + 2]
        for k in range(5):
            share = bending.shares[pair, k]
            if share == 0.0:
                continue
            for vertex in range(8):
                slot, step = bending.share_slots[pair, k, vertex], bending.share_steps[pair, k, vertex]
                if slot >= 0:
                    for axis in range(3):
                        values[slot + axis * step] += share * stressed[k, 3 * vertex + axis]


@njit(**_options)
def add_membrane(points, membrane, vectors, values):  # type: ignore[no-untyped-def]
    """Add ``sum J^T Q J`` of half squared lengths to ``values``: each block is a sum of ``d_p d_q^T`` of edges."""
    edges, blocks = membrane.edges, membrane.blocks
    for edge in range(edges.shape[0]):
        for axis in range(3):
            vectors[edge, axis] = points[edges[edge, 1], axis] - points[edges[edge, 0], axis]
    for block in range(blocks.slots.size):
        s00, s01, s02, s10, s11, s12, s20, s21, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for entry in range(blocks.starts[block], blocks.starts[block + 1]):
            p, q, factor = blocks.rows[entry], blocks.columns[entry], blocks.factors[entry]
            a, b, c = factor * vectors[p, 0], factor * vectors[p, 1], factor * vectors[p, 2]
            x, y, z = vectors[q, 0], vectors[q, 1], vectors[q, 2]
            s00, s01, s02 = s00 + a * x, s01 + a * y, s02 + a * z
            s10, s11, s12 = s10 + b * x, s11 + b * y, s12 + b * z
            s20, s21, s22 = s20 + c * x, s21 + c * y, s22 + c * z
        slot, stride = blocks.slots[block], blocks.strides[block]
        values[slot] += s00
        values[slot + 1] += s01
        values[slot + 2] += s02
        values[slot + stride] += s10
        values[slot + stride + 1] += s11
        values[slot + stride + 2] += s12
        values[slot + 2 * stride] += s20
        values[slot + 2 * stride + 1] += s21
        values[slot + 2 * stride + 2] += s22


@njit(**_options)
def add_tensions(tensions, membrane, strides, values):  # type: ignore[no-untyped-def]
    """Add ``sum tension Hess (l^2 / 2)`` to ``values``."""
    edges, slots = membrane.edges, membrane.slots
    for edge in range(edges.shape[0]):
        for first in range(2):
            for second in range(2):
                slot = slots[edge, first, second]
                if slot >= 0:
                    step = strides[edges[edge, first]] + 1
                    value = tensions[edge] if first == second else -tensions[edge]
                    values[slot] += value
                    values[slot + step] += value
                    values[slot + 2 * step] += value
