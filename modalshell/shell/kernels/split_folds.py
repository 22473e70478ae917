"""Kernels of the split-fold energy: fold angles and their derivatives from the generated hinge kernel.

Both parts of the energy are quadratic forms with constant matrices, of fold angles and of half squared edge lengths.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.shell.kernels.elements import (
    OPTIONS,
    add_block,
    add_change,
    add_forces,
    fill_block,
    pack_products,
    principal,
)
from modalshell.shell.kernels.generated.flexure import (
    PRODUCTS,
    UNKNOWNS,
    VERTICES,
    convex_rows,
    first_derivatives,
    relative,
    second_derivatives,
)

EDGES = (0, 1), (0, 2), (1, 2), (0, 3), (1, 3)
"""Edges of two triangles in the order of a hinge's vertices; the first three are the left one's."""
_EDGES, _WIDTH = len(EDGES), 12
_COLUMNS = 24
"""Unknowns of the eight vertices about a pair of triangles."""
_FIRST, _SECOND = tuple(zip(*EDGES, strict=True))
_PLAIN = OPTIONS | UNCOUNTED
"""Options of kernels that make no array."""


@njit(**_PLAIN)
def colour_triangles(neighbours: Any, colours: Any) -> None:
    """Colour cells 0 and 1 so that few neighbours (T, k; -1 for none) share theirs; colours start at -1.

    In order of the list each takes the colour that fewer of its neighbours have; then cells change theirs as long as
    that parts more neighbours than it joins.
    """
    for _ in range(50):
        changed = False
        for cell in range(colours.size):
            balance = 0
            for k in range(neighbours.shape[1]):
                other = neighbours[cell, k]
                if other >= 0 and colours[other] >= 0:
                    balance += 1 if colours[other] == 1 else -1
            best = 0 if balance > 0 else 1
            if colours[cell] < 0 or (balance != 0 and best != colours[cell]):
                colours[cell] = best
                changed = True
        if not changed:
            break


@njit(**_PLAIN)
def match_triangles(edges: Any, begins: Any, edge_faces: Any, wanted: Any, over: Any) -> None:
    """Pair triangles over the ``edges`` in their order: ``over`` (T,) of -1 takes the common edge of each pair.

    Of the edges from one of ``begins`` to the next none comes before another: two that want one triangle both lose it.
    ``wanted`` (T,) are zeros.
    """
    for group in range(begins.size - 1):
        for turn in range(3):
            for place in range(begins[group], begins[group + 1]):
                edge = edges[place]
                first, second = edge_faces[edge, 0], edge_faces[edge, 1]
                if turn == 0 and over[first] < 0 and over[second] < 0 and first != second:
                    wanted[first] += 1
                    wanted[second] += 1
                elif turn == 1 and wanted[first] == 1 and wanted[second] == 1:
                    over[first] = over[second] = edge
                elif turn == 2:
                    wanted[first] = wanted[second] = 0


@njit(fastmath=False)
def quadratic_forms(maps: Any, forms: Any, out: Any) -> None:
    """Write ``sum_s B^T C B`` into ``out`` (elements, k, k) of B (s, elements, 3, k) and C (s, elements, 3, 3)."""
    for element in range(out.shape[0]):
        for p in range(out.shape[1]):
            for q in range(out.shape[2]):
                out[element, p, q] = 0.0
                for side in range(maps.shape[0]):
                    for i in range(3):
                        for j in range(3):
                            left = maps[side, element, i, p] * forms[side, element, i, j]
                            out[element, p, q] += left * maps[side, element, j, q]


@njit(**_PLAIN)
def fold_angles(x: Any, hinges: Any, rest: Any, change: Any, slopes: Any) -> None:
    """Write theta - theta0 in (-pi, pi] into ``change`` (H,) and d theta / d x_1, x_2, x_3 into ``slopes`` (H, 9)."""
    for hinge in range(hinges.shape[0]):
        change[hinge] = principal(first_derivatives(*relative(x, hinges, hinge), slopes[hinge]) - rest[hinge])


@njit(**_PLAIN)
def add_fold_forces(hinges: Any, slopes: Any, couples: Any, gradient: Any) -> None:
    """Add ``sum couple grad theta`` to ``gradient``."""
    for hinge in range(hinges.shape[0]):
        add_forces(hinges, hinge, VERTICES, couples[hinge], slopes[hinge], gradient)


@njit(**_PLAIN)
def fold_rates(step: Any, hinges: Any, slopes: Any, rates: Any) -> None:
    """Write ``grad theta . step`` into ``rates`` (H,)."""
    for hinge in range(hinges.shape[0]):
        rates[hinge] = add_change(hinges, hinge, VERTICES, 0.0, slopes[hinge], step)


@njit(**OPTIONS)
def add_fold_curvatures(x: Any, hinges: Any, couples: Any, slots: Any, strides: Any, data: Any) -> None:
    """Add ``sum couple Hess theta`` to the CSR values ``data``."""
    local = np.empty(UNKNOWNS)
    packed = np.empty(UNKNOWNS * (UNKNOWNS + 1) // 2)
    block = np.empty((3 * VERTICES, 3 * VERTICES))
    for hinge in range(hinges.shape[0]):
        couple = couples[hinge]
        if couple == 0.0:
            continue
        second_derivatives(*relative(x, hinges, hinge), local, packed)
        fill_block(VERTICES, 0.0, local, couple, packed, block)
        add_block(hinges, hinge, VERTICES, block, slots, strides, data)


@njit(**OPTIONS)
def add_convex_fold_curvatures(x: Any, hinges: Any, couples: Any, slots: Any, strides: Any, data: Any) -> None:
    """Add the positive semi-definite part of ``sum couple Hess theta`` to the CSR values ``data``.

    A kernel of its own, as many scenes need only the other and each takes a second to compile.
    """
    packed = np.empty(UNKNOWNS * (UNKNOWNS + 1) // 2)
    block = np.empty((3 * VERTICES, 3 * VERTICES))
    factors, squares = np.empty(0), np.empty((0, UNKNOWNS))
    firsts, seconds, rows = (
        np.empty((PRODUCTS, UNKNOWNS)),
        np.empty((PRODUCTS, UNKNOWNS)),
        np.empty((PRODUCTS, UNKNOWNS)),
    )
    for hinge in range(hinges.shape[0]):
        couple = couples[hinge]
        if couple == 0.0:
            continue
        sign = 1.0 if couple > 0.0 else -1.0
        convex_rows(*relative(x, hinges, hinge), sign, factors, squares, firsts, seconds, rows)
        pack_products(rows, PRODUCTS, UNKNOWNS, packed)
        fill_block(VERTICES, 0.0, rows[0], abs(couple), packed, block)
        add_block(hinges, hinge, VERTICES, block, slots, strides, data)


@njit(**OPTIONS)
def add_bending(
    slopes: Any,
    stencils: Any,
    folds: Any,
    places: Any,
    shares: Any,
    moments: Any,
    slots: Any,
    share_slots: Any,
    strides: Any,
    data: Any,
) -> None:
    """Add ``sum J^T K J`` over pairs of triangles, and its coupling to the fold shares, to ``data``.

    ``stencils`` (B, 8) holds the vertices of the pair and those across each edge but the common one, ``folds`` (B, 5)
    the hinge at each edge (or -1), ``places`` (B, 5, 4) where its vertices stand among the eight, ``shares`` (B, 5) the
    factors of the fold shares, ``moments`` (B, 5, 5) is K. Pairs without hinges are passed over.
    """
    rows, stressed, products = np.empty((5, _COLUMNS)), np.empty((5, _COLUMNS)), np.empty((3, _COLUMNS))
    for pair in range(stencils.shape[0]):
        count = 0
        for k in range(5):
            for column in range(_COLUMNS):
                rows[k, column] = 0.0
            hinge = folds[pair, k]
            if hinge < 0:
                continue
            count += 1
            for axis in range(3):
                g1, g2, g3 = slopes[hinge, axis], slopes[hinge, 3 + axis], slopes[hinge, 6 + axis]
                rows[k, 3 * places[pair, k, 0] + axis] = -(g1 + g2 + g3)
                rows[k, 3 * places[pair, k, 1] + axis] = g1
                rows[k, 3 * places[pair, k, 2] + axis] = g2
                rows[k, 3 * places[pair, k, 3] + axis] = g3
        if count == 0:
            continue
        for k in range(5):
            m0, m1, m2 = moments[pair, k, 0], moments[pair, k, 1], moments[pair, k, 2]
            m3, m4 = moments[pair, k, 3], moments[pair, k, 4]
            for c in range(_COLUMNS):
                stressed[k, c] = m0 * rows[0, c] + m1 * rows[1, c] + m2 * rows[2, c] + m3 * rows[3, c] + m4 * rows[4, c]
        for first in range(8):
            if slots[pair, first, first] < 0:  # a ghost has no rows
                continue
            for axis in range(3):
                row = 3 * first + axis
                a0, a1, a2, a3, a4 = rows[0, row], rows[1, row], rows[2, row], rows[3, row], rows[4, row]
                for c in range(_COLUMNS):
                    products[axis, c] = (
                        a0 * stressed[0, c] + a1 * stressed[1, c] + a2 * stressed[2, c]
                        + a3 * stressed[3, c] + a4 * stressed[4, c]
                    )  # fmt: skip
            stride = strides[stencils[pair, first]]
            for second in range(8):
                slot = slots[pair, first, second]
                if slot < 0:
                    continue
                for axis in range(3):
                    for column in range(3):
                        data[slot + axis * stride + column] += products[axis, 3 * second + column]
        for k in range(5):
            share = shares[pair, k]
            if share == 0.0:
                continue
            for vertex in range(8):
                slot = share_slots[pair, k, vertex]
                if slot >= 0:
                    for axis in range(3):
                        data[slot + axis] += share * stressed[k, 3 * vertex + axis]


@njit(**_PLAIN)
def half_squares(x: Any, edges: Any, rest: Any, out: Any) -> None:
    """Write ``l^2 / 2 - rest`` of every edge into ``out`` (E,)."""
    for edge in range(edges.shape[0]):
        total = 0.0
        for axis in range(3):
            d = x[edges[edge, 1], axis] - x[edges[edge, 0], axis]
            total += d * d
        out[edge] = 0.5 * total - rest[edge]


@njit(**_PLAIN)
def half_square_rates(x: Any, step: Any, edges: Any, rates: Any) -> None:
    """Write the derivative of ``l^2 / 2`` along ``step`` into ``rates`` (E,)."""
    for edge in range(edges.shape[0]):
        a, b = edges[edge, 0], edges[edge, 1]
        total = 0.0
        for axis in range(3):
            total += (x[b, axis] - x[a, axis]) * (step[b, axis] - step[a, axis])
        rates[edge] = total


@njit(**_PLAIN)
def add_edge_forces(x: Any, edges: Any, tensions: Any, gradient: Any) -> None:
    """Add ``sum tension grad (l^2 / 2)`` to ``gradient``."""
    for edge in range(edges.shape[0]):
        a, b = edges[edge, 0], edges[edge, 1]
        for axis in range(3):
            force = tensions[edge] * (x[b, axis] - x[a, axis])
            gradient[a, axis] -= force
            gradient[b, axis] += force


@njit(**_PLAIN)
def add_edge_curvatures(edges: Any, tensions: Any, positive: Any, slots: Any, strides: Any, data: Any) -> None:
    """Add ``sum tension Hess (l^2 / 2)`` to ``data``; of edges in tension alone if ``positive``."""
    for edge in range(edges.shape[0]):
        tension = tensions[edge]
        if positive and tension < 0.0:
            continue
        for first in range(2):
            stride = strides[edges[edge, first]] + 1
            for second in range(2):
                value = tension if first == second else -tension
                for axis in range(3):
                    data[slots[edge, first, second] + axis * stride] += value


@njit(**OPTIONS)
def add_membrane(x: Any, stencils: Any, matrices: Any, slots: Any, strides: Any, data: Any) -> None:
    """Add ``sum J^T Q J`` to ``data``, J the derivatives of half squared lengths of the edges of pairs of triangles.

    ``stencils`` (elements, 4) holds their vertices, ``matrices`` (elements, 5, 5) is Q on the :data:`EDGES`.
    All bounds are constants: the inner loops are along the columns of the element's matrix, twice as fast.
    """
    edge, stressed, block = np.empty((_EDGES, 3)), np.empty((_EDGES, _WIDTH)), np.empty((_WIDTH, _WIDTH))
    for element in range(stencils.shape[0]):
        for p in range(_EDGES):
            a, b = stencils[element, _FIRST[p]], stencils[element, _SECOND[p]]
            for axis in range(3):
                edge[p, axis] = x[b, axis] - x[a, axis]
        for p in range(_EDGES):
            for column in range(_WIDTH):
                stressed[p, column] = 0.0
            for q in range(_EDGES):
                factor = matrices[element, p, q]
                for axis in range(3):
                    entry = factor * edge[q, axis]
                    stressed[p, 3 * _FIRST[q] + axis] -= entry
                    stressed[p, 3 * _SECOND[q] + axis] += entry
        for row in range(_WIDTH):
            for column in range(_WIDTH):
                block[row, column] = 0.0
        for p in range(_EDGES):
            for axis in range(3):
                own, first, second = edge[p, axis], 3 * _FIRST[p] + axis, 3 * _SECOND[p] + axis
                for column in range(_WIDTH):
                    entry = own * stressed[p, column]
                    block[first, column] -= entry
                    block[second, column] += entry
        add_block(stencils, element, 4, block, slots, strides, data)
