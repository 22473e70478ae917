"""Compiled evaluation of a reduced energy with assumed membrane stresses; see :mod:`.assumed_stress`.

Vectors over coordinates are rows of a whole number of packed registers, ``width`` long and padded with zeros.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import COUNTED, UNCOUNTED, njit
from modalshell.kernels.packed import LANES, dot, load, spread, spread_from, store, total
from modalshell.models.hybrid.bending_kernels import (
    FIRST,
    add_products,
    add_rows,
    couple,
    hinge_angles,
    make_room,
    multiply,
)

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True} | UNCOUNTED


@njit(**_options)
def width_of(count):  # type: ignore[no-untyped-def]
    """Length of a row of ``count`` numbers: a whole number of packed registers."""
    return -(-count // LANES) * LANES


@njit(**_options)
def quadratic(form, z, strains, slopes, room):  # type: ignore[no-untyped-def]
    """Write the ``d_k`` and their slopes, rows of the length of ``z`` (width,); one pass over the numbers."""
    count, width = form.linear.shape
    linear, pairs = form.linear.reshape(-1), form.pairs.reshape(-1)
    products, values, half = room.products, room.values, spread(0.5)
    for k in range(0, width, 2 * LANES):  # whole lines of memory
        for i in range(0, count - 1, 2):  # two rows at once: a product is stored once for both
            place, at = i * (i + 1) // 2 * width + k, k
            below, here, there = place + (i + 1) * width, spread_from(z, i), spread_from(z, i + 1)
            a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            for j in range(i):
                known, p, q = spread_from(z, j), load(pairs, place), load(pairs, place + LANES)
                r, s = load(pairs, below), load(pairs, below + LANES)
                a, b, c, d = a + p * known, b + q * known, c + r * known, d + s * known
                store(products, at, load(products, at) + p * here + r * there)
                store(products, at + LANES, load(products, at + LANES) + q * here + s * there)
                place, below, at = place + width, below + width, at + width
            p, q = load(pairs, place), load(pairs, place + LANES)
            r, s = load(pairs, below), load(pairs, below + LANES)
            store(products, at, a + p * here + r * there)
            store(products, at + LANES, b + q * here + s * there)
            p, q, at = load(pairs, below + width), load(pairs, below + width + LANES), at + width
            store(products, at, c + r * here + p * there)
            store(products, at + LANES, d + s * here + q * there)
        for i in range(count // 2 * 2, count):
            place, at, here, a, b = i * (i + 1) // 2 * width + k, k, spread_from(z, i), spread(0.0), spread(0.0)
            for j in range(i):
                known, p, q = spread_from(z, j), load(pairs, place), load(pairs, place + LANES)
                a, b = a + p * known, b + q * known
                store(products, at, load(products, at) + p * here)
                store(products, at + LANES, load(products, at + LANES) + q * here)
                place, at = place + width, at + width
            store(products, at, a + load(pairs, place) * here)
            store(products, at + LANES, b + load(pairs, place + LANES) * here)
        a, b = spread(0.0), spread(0.0)
        for i in range(count):
            at, here = i * width + k, spread_from(z, i)
            p, q, r, s = load(linear, at), load(linear, at + LANES), load(products, at), load(products, at + LANES)
            a, b = a + here * (p + half * r), b + here * (q + half * s)
            store(products, at, p + r)
            store(products, at + LANES, q + s)
        store(values, k, a)
        store(values, k + LANES, b)
    for k in range(form.modes):
        strains[k] = values[k]
        for i in range(count):
            slopes[k * z.size + i] = products[i * width + k]


@njit(**_options)
def _add_stressed(form, stresses, width, hessian, room):  # type: ignore[no-untyped-def]
    """Add ``sum_k s_k B_k`` to the lower triangle of ``hessian`` (width, width), which is flat."""
    pairs, known, place = form.pairs.reshape(-1), room.values, 0
    count, modes = form.linear.shape
    for k in range(modes):
        known[k] = stresses[k] if k < form.modes else 0.0
    for i in range(count):
        for j in range(0, i - 2, 4):
            a, b, c, d, at = spread(0.0), spread(0.0), spread(0.0), spread(0.0), i * width + j
            for k in range(0, modes, LANES):
                stress = load(known, k)
                a = a + load(pairs, place + k) * stress
                b = b + load(pairs, place + modes + k) * stress
                c = c + load(pairs, place + 2 * modes + k) * stress
                d = d + load(pairs, place + 3 * modes + k) * stress
            hessian[at] += total(a)
            hessian[at + 1] += total(b)
            hessian[at + 2] += total(c)
            hessian[at + 3] += total(d)
            place += 4 * modes
        for j in range((i + 1) // 4 * 4, i + 1):
            a = spread(0.0)
            for k in range(0, modes, LANES):
                a = a + load(pairs, place + k) * load(known, k)
            hessian[i * width + j] += total(a)
            place += modes


@njit(**_options)
def predict(slopes, step, strains, stresses):  # type: ignore[no-untyped-def]
    """Write the stresses (K,) after ``step`` (width,), by the strains linearised where they are."""
    multiply(slopes, step, stresses)
    for k in range(stresses.size):
        stresses[k] += strains[k]


@njit(entry=False, **_options)
def energy_terms(reduced, z, strains, slopes, others, gradient, room):  # type: ignore[no-untyped-def]
    """Energy [J] of coordinates ``z`` (width,); writes strains (K + H,), rows of their slopes, and the gradient.

    Strains are ``d_k`` and the changes of the hinges' angles, scaled: half their squares are the energy, but for the
    flat hinges' and what couples hinges, with the rows of ``others``.
    """
    bending, first, width, energy = reduced.bending, reduced.membrane.modes, z.size, 0.0
    for i in range(width):
        gradient[i] = 0.0
    add_rows(bending.flat.reshape(-1), 0, z, 0, bending.flat.shape[0], gradient)
    energy += 0.5 * dot(gradient, 0, z, 0, width)
    quadratic(reduced.membrane, z, strains, slopes, room)
    hinge_angles(bending, z, first, strains, slopes, room)
    energy += 0.5 * dot(strains, 0, strains, 0, strains.size)
    add_rows(slopes, 0, strains, 0, strains.size, gradient)
    if bending.across.shape[0] > 0:
        energy += couple(bending, z, first, strains, slopes, others, gradient, room)
    return energy


@njit(entry=False, **_options)
def write_bending(bending, slopes, first, others, width, matrix):  # type: ignore[no-untyped-def]
    """Write the lower triangle of the Hessian of bending, whose rows of slopes begin with the ``first``.

    The second derivatives of the angles and of the normals are left out.
    """
    flat, coupled = bending.flat.reshape(-1), bending.across.shape[0]
    for i in range(flat.size):
        matrix[i] = flat[i]
    for i in range(flat.size, matrix.size):
        matrix[i] = 0.0
    add_products(slopes, first, slopes, first, bending.angles.size, width, matrix)
    add_products(slopes, first, others, FIRST, coupled, width, matrix)
    add_products(others, FIRST, slopes, first, coupled, width, matrix)


@njit(**_options)
def add_membrane(membrane, stresses, slopes, width, hessian, room):  # type: ignore[no-untyped-def]
    """Add the Hessian of the membrane, with ``sum_k s_k B_k`` by the ``stresses`` (K,) given, to the lower triangle."""
    add_products(slopes, FIRST, slopes, FIRST, membrane.modes, width, hessian)
    _add_stressed(membrane, stresses, width, hessian, room)


@njit(entry=False, **_options)
def write_hessian(reduced, stresses, slopes, others, width, hessian, room):  # type: ignore[no-untyped-def]
    """Write the lower triangle of the energy's Hessian at given stresses, by what :func:`energy_terms` has written."""
    write_bending(reduced.bending, slopes, reduced.membrane.modes, others, width, hessian)
    add_membrane(reduced.membrane, stresses, slopes, width, hessian, room)


@njit(**_options | COUNTED)
def evaluate(reduced, z, stresses):  # type: ignore[no-untyped-def]
    """Energy, strains (K + H,), their slopes (K + H, m), gradient (m,), and the lower triangle of the Hessian (m, m).

    Of coordinates z (m,); see :func:`energy_terms` and :func:`write_hessian`.
    """
    count, width, size = z.size, width_of(z.size), reduced.membrane.modes + reduced.bending.angles.size
    coupled = reduced.bending.across.shape[0]
    padded, slope, rows = np.zeros(width), np.empty(width), np.zeros(size * width)
    strains, others, matrix = np.empty(size), np.zeros(coupled * width), np.empty(width * width)
    for i in range(count):
        padded[i] = z[i]
    room = make_room(count, reduced.membrane.linear.shape[1], reduced.bending.rest.shape[0], coupled)
    value = energy_terms(reduced, padded, strains, rows, others, slope, room)
    write_hessian(reduced, stresses, rows, others, width, matrix, room)
    slopes, gradient, hessian = np.empty((size, count)), np.empty(count), np.empty((count, count))
    for i in range(count):
        gradient[i] = slope[i]
        for j in range(count):
            hessian[i, j] = matrix[i * width + j]
        for k in range(size):
            slopes[k, i] = rows[k * width + i]
    return value, strains, slopes, gradient, hessian
