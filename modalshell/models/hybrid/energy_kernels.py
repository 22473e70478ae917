"""Compiled evaluation of a reduced energy with assumed membrane stresses; see :mod:`.assumed_stress`.

Rows over coordinates are as those of :mod:`.dense_kernels`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import COUNTED, UNCOUNTED, njit
from modalshell.kernels.packed import LANES, dot, load, spread, spread_from, store, total, transpose
from modalshell.models.hybrid.bending_kernels import add_bent, fold_rows, hinge_angles, make_room, write_bending
from modalshell.models.hybrid.dense_kernels import add_rows, multiply, width_of, write_products

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True} | UNCOUNTED


@njit(entry=False, **_options)
def quadratic(form, z, strains, slopes, room):  # type: ignore[no-untyped-def]
    """Write the ``d_k`` and their slopes, rows of the length of ``z`` (width,); one pass over the numbers.

    There are rows for a whole number of registers.
    """
    count, modes = form.linear.shape
    linear, pairs, products, width = form.linear.reshape(-1), form.pairs.reshape(-1), room.products, z.size
    for i in range(count * LANES, width * LANES, LANES):
        store(products, i, spread(0.0))
    for k in range(0, modes, LANES):
        _multiply_pairs(pairs, k // LANES * (count * (count + 1) // 2 * LANES), z, count, products)
        values, half = spread(0.0), spread(0.5)
        for i in range(count):
            p, q = load(linear, i * modes + k), load(products, i * LANES)
            values = values + spread_from(z, i) * (p + half * q)
            store(products, i * LANES, p + q)
        store(room.values, 0, values)
        for r in range(min(LANES, form.modes - k)):
            strains[k + r] = room.values[r]
        for i in range(0, width, LANES):
            transpose(products, i * LANES, LANES, slopes, k * width + i, width)


@njit(**_options)
def _multiply_pairs(pairs, first, z, count, products):  # type: ignore[no-untyped-def]
    """Write the products with ``z`` of symmetric matrices, a register of them, whose triangles begin at ``first``.

    Four rows at once: a product is stored once for all.
    """
    whole = count // 4 * 4
    for i in range(0, whole, 4):
        a = first + i * (i + 1) // 2 * LANES
        b = a + (i + 1) * LANES
        c = b + (i + 2) * LANES
        d = c + (i + 3) * LANES
        at_a, at_b, at_c, at_d = spread_from(z, i), spread_from(z, i + 1), spread_from(z, i + 2), spread_from(z, i + 3)
        one, two, three, four = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
        for j in range(i):
            known, at = spread_from(z, j), j * LANES
            p, q, r, s = load(pairs, a + at), load(pairs, b + at), load(pairs, c + at), load(pairs, d + at)
            one, two, three, four = one + p * known, two + q * known, three + r * known, four + s * known
            store(products, at, (load(products, at) + p * at_a + q * at_b) + (r * at_c + s * at_d))
        at = i * LANES
        a, b, c, d = a + at, b + at, c + at, d + at
        p, q, r = load(pairs, b), load(pairs, c), load(pairs, d)
        store(products, at, (one + load(pairs, a) * at_a + p * at_b) + (q * at_c + r * at_d))
        q, r, s = load(pairs, c + LANES), load(pairs, d + LANES), load(pairs, b + LANES)
        store(products, at + LANES, (two + p * at_a + s * at_b) + (q * at_c + r * at_d))
        p, s = load(pairs, c), load(pairs, d + 2 * LANES)
        store(products, at + 2 * LANES, (three + p * at_a + q * at_b) + (load(pairs, c + 2 * LANES) * at_c + s * at_d))
        p, q = load(pairs, d), load(pairs, d + 3 * LANES)
        store(products, at + 3 * LANES, (four + p * at_a + r * at_b) + (s * at_c + q * at_d))
    for i in range(whole, count):
        place, here, one = first + i * (i + 1) // 2 * LANES, spread_from(z, i), spread(0.0)
        for j in range(i):
            p, at = load(pairs, place), j * LANES
            one = one + p * spread_from(z, j)
            store(products, at, load(products, at) + p * here)
            place += LANES
        store(products, i * LANES, one + load(pairs, place) * here)


@njit(**_options)
def _add_stressed(form, stresses, width, hessian):  # type: ignore[no-untyped-def]
    """Add ``sum_k s_k B_k``, stresses in whole registers, to the lower triangle of ``hessian``, which is flat."""
    pairs, (count, modes) = form.pairs.reshape(-1), form.linear.shape
    place, apart = 0, count * (count + 1) // 2 * LANES
    for i in range(count):
        for j in range(0, i - 2, 4):
            a, b, c, d, at = spread(0.0), spread(0.0), spread(0.0), spread(0.0), place
            for k in range(0, modes, LANES):
                stress = load(stresses, k)
                a = a + load(pairs, at) * stress
                b = b + load(pairs, at + LANES) * stress
                c = c + load(pairs, at + 2 * LANES) * stress
                d = d + load(pairs, at + 3 * LANES) * stress
                at += apart
            at = i * width + j
            hessian[at] += total(a)
            hessian[at + 1] += total(b)
            hessian[at + 2] += total(c)
            hessian[at + 3] += total(d)
            place += 4 * LANES
        for j in range((i + 1) // 4 * 4, i + 1):
            a, at = spread(0.0), place
            for k in range(0, modes, LANES):
                a = a + load(pairs, at) * load(stresses, k)
                at += apart
            hessian[i * width + j] += total(a)
            place += LANES


@njit(**_options)
def predict(slopes, step, strains, stresses):  # type: ignore[no-untyped-def]
    """Write the stresses (K,) after ``step`` (width,), by the strains linearised where they are."""
    multiply(slopes, step, stresses)
    for k in range(stresses.size):
        stresses[k] += strains[k]


@njit(entry=False, **_options)
def energy_terms(reduced, z, strains, slopes, gradient, room):  # type: ignore[no-untyped-def]
    """Energy [J] of coordinates ``z`` (width,); writes strains, rows of the membrane's slopes, and the gradient.

    Strains (K' + H,) are ``d_k``, with zeros up to a whole number of registers, and the changes of the hinges' angles,
    scaled: half their squares are the energy, but for the flat hinges' and what couples hinges.
    """
    bending, first, width = reduced.bending, reduced.membrane.linear.shape[1], z.size
    for i in range(width):
        gradient[i] = 0.0
    add_rows(bending.flat.reshape(-1), z, 0, bending.flat.shape[0], gradient)
    energy = 0.5 * dot(gradient, 0, z, 0, width)
    quadratic(reduced.membrane, z, strains, slopes, room)
    hinge_angles(bending, z, first, strains, room)
    energy += 0.5 * dot(strains, 0, strains, 0, strains.size)
    add_rows(slopes, strains, 0, first, gradient)
    return energy + add_bent(bending, z, first, strains, gradient, room)


@njit(**_options)
def write_hessian(known, membrane, stresses, steep, slopes, width, hessian):  # type: ignore[no-untyped-def]
    """Write the lower triangle of the sum of ``known`` and the membrane's Hessian at given ``stresses`` (K',).

    ``steep`` are the slopes times the stiffness of the strains.
    """
    write_products(known, steep, slopes, membrane.linear.shape[1], width, hessian)
    _add_stressed(membrane, stresses, width, hessian)


@njit(**_options | COUNTED)
def evaluate(reduced, z, stresses):  # type: ignore[no-untyped-def]
    """Energy, strains (K + H,), slopes (K, m) of the first, gradient (m,), and the Hessian's lower triangle (m, m).

    Of coordinates z (m,), at given stresses (K,); see :func:`energy_terms` and :func:`write_hessian`.
    """
    membrane, bending = reduced.membrane, reduced.bending
    count, width, modes, rows = z.size, width_of(z.size), membrane.modes, membrane.linear.shape[1]
    padded, slope, own = np.zeros(width), np.empty(width), np.zeros(rows)
    strains, slopes, room = np.zeros(rows + bending.angles.size), np.empty(rows * width), make_room(width, bending)
    for i in range(count):
        padded[i] = z[i]
    for k in range(modes):
        own[k] = stresses[k]
    value = energy_terms(reduced, padded, strains, slopes, slope, room)
    matrix = np.zeros(width * width)
    write_bending(matrix, bending, width, np.empty(fold_rows(bending) * width), room, matrix)
    write_hessian(matrix, membrane, own, slopes, slopes, width, matrix)
    hessian = matrix.reshape(width, width)[:count, :count].copy()
    found = np.empty(modes + bending.angles.size)
    for k in range(found.size):
        found[k] = strains[k if k < modes else k - modes + rows]
    return value, found, slopes.reshape(rows, width)[:modes, :count].copy(), slope[:count].copy(), hessian
