"""Compiled: frames of modal models that touch colliders, at their candidates alone (theory 13, eq. 7 and 8).

Shapes that forces press in beyond the modes are kept as they are at rest: ``store[slot, i]`` (n, 3) under a unit force
along axis i on the vertex of a slot, and ``blocks[slot, other]`` (3, 3), row i by axis i of the force, at the vertices
of the other slots.
"""

import numpy as np

from modalshell.contact.complementarity import complementary
from modalshell.contact.gap_kernels import gap_at, gaps_of
from modalshell.kernels.compiler import njit
from modalshell.kernels.rotations import coefficients, rotate, slopes

_CORRECTIONS = 8
"""Corrections of a linearisation by the gaps that it leads to, at most."""
_PASSES = 6
"""Linearisations at most."""
_NONE = 1e-14
"""Component of a force, as a share of the largest, that rounding explains."""
_PART = 4096
"""Numbers of a shape that are added at a time, for what they are added to to stay near."""
LOADED = 1e-9
"""Share of the mean diagonal that is added to it."""

_kernel = njit(error_model="numpy", fastmath=False)


@njit(error_model="numpy", fastmath=False, forceinline=True)
def turned(a, b, c, second, third, x, y, z):  # type: ignore[no-untyped-def]
    """``v + second w x v + third w x (w x v)``, w = (a, b, c)."""
    p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
    return (
        x + second * p + third * (b * r - c * q),
        y + second * q + third * (c * p - a * r),
        z + second * r + third * (a * q - b * p),
    )


@_kernel
def _combined(rows, v, q, out):  # type: ignore[no-untyped-def]
    """Three rows (3n, m) of a vertex times q (m,), into ``out`` (3,)."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(q.size):
        x += rows[3 * v, k] * q[k]
        y += rows[3 * v + 1, k] * q[k]
        z += rows[3 * v + 2, k] * q[k]
    out[0], out[1], out[2] = x, y, z


@_kernel
def residual_compliance(blocks, slots, own, out):  # type: ignore[no-untyped-def]
    """Give way ``out`` (k, k) [m/N] along directions ``own`` (k, 3), in the axes at rest, under forces along them."""
    for a in range(slots.size):
        x, y, z = own[a, 0], own[a, 1], own[a, 2]
        s = np.uint64(slots[a])
        for b in range(a, slots.size):
            t = np.uint64(slots[b])
            value = own[b, 0] * (x * blocks[s, t, 0, 0] + y * blocks[s, t, 1, 0] + z * blocks[s, t, 2, 0])
            value += own[b, 1] * (x * blocks[s, t, 0, 1] + y * blocks[s, t, 1, 1] + z * blocks[s, t, 2, 1])
            value += own[b, 2] * (x * blocks[s, t, 0, 2] + y * blocks[s, t, 1, 2] + z * blocks[s, t, 2, 2])
            out[a, b] = out[b, a] = value


@_kernel
def response(along, compliance, out):  # type: ignore[no-untyped-def]
    """Add ``along diag(compliance) along^T`` (k, k) to ``out``, and to its diagonal what keeps it definite."""
    count = along.shape[0]
    across = np.ascontiguousarray(along.T)
    for a in range(count):
        for k in range(compliance.size):
            factor = along[a, k] * compliance[k]
            for b in range(a + 1):
                out[a, b] += factor * across[k, b]
    trace = 0.0
    for a in range(count):
        trace += out[a, a]
        for b in range(a):
            out[b, a] = out[a, b]
    for a in range(count):
        out[a, a] += LOADED * trace / count


@_kernel
def local_shape(store, slots, pushes, turns, out):  # type: ignore[no-untyped-def]
    """Displacements ``out`` (n, 3) under ``pushes`` (k, 3) [N] in the axes at rest, turned by vectors (n, 3) [rad]."""
    flat = out.reshape(-1)
    least = _NONE * np.abs(pushes).max() if pushes.size else 0.0
    for first in range(0, flat.size, _PART):
        own = flat[first : first + _PART]
        own[:] = 0.0
        for k in range(slots.size):
            # Parts of rows, not of the matrix: the compiler packs what it knows to be one number after the other.
            one, two, three = store[slots[k], 0].ravel(), store[slots[k], 1].ravel(), store[slots[k], 2].ravel()
            one, two = one[first : first + _PART], two[first : first + _PART]
            three = three[first : first + _PART]
            a, b, c = pushes[k]
            if min(abs(a), abs(b), abs(c)) > least:
                for j in range(own.size):
                    own[j] += a * one[j] + b * two[j] + c * three[j]
                continue
            for push, shape in ((a, one), (b, two), (c, three)):
                if abs(push) > least:
                    for j in range(own.size):
                        own[j] += push * shape[j]
    if turns.size:
        rotate(turns, out, 1.0, out)


@_kernel
def ended(store, slots, pushes, turns, base, rows_of, bodies, local, gaps):  # type: ignore[no-untyped-def]
    """A :func:`local_shape` into ``local`` (n, 3), and ``gaps`` (r,) of all rows at ``base + local``; the least one."""
    local_shape(store, slots, pushes, turns, local)
    return gaps_of(bodies, rows_of[0], rows_of[1], base + local, gaps)


@_kernel
def implicit_euler(q, rates, force, compliance, eigenvalues, dt, free, ahead):  # type: ignore[no-untyped-def]
    """Coordinates ``free`` (m,) after a step of implicit Euler, by G (m,), and those ``ahead`` by the rates alone."""
    for k in range(q.size):
        free[k] = q[k] + compliance[k] * (rates[k] / dt + force[k] - eigenvalues[k] * q[k])
        ahead[k] = q[k] + dt * rates[k]


@_kernel
def reach_of(before, after, size):  # type: ignore[no-untyped-def]
    """How far [m] a vertex may go between coordinates (m,), by how far (m,) [m] each of these moves one."""
    reach = 0.0
    for k in range(size.size):
        reach += abs(after[k] - before[k]) * size[k]
    return reach


@_kernel
def local_at(blocks, slots, pushes, local):  # type: ignore[no-untyped-def]
    """Displacements ``local`` (k, 3) of candidates under ``pushes`` (k, 3) on them, in the axes at rest."""
    local[:] = 0.0
    for b in range(slots.size):
        x, y, z = pushes[b, 0], pushes[b, 1], pushes[b, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            for a in range(slots.size):
                block = blocks[slots[b], slots[a]]
                for i in range(3):
                    local[a, i] += x * block[0, i] + y * block[1, i] + z * block[2, i]


@_kernel
def candidates(gaps, pushes, near, most, kept):  # type: ignore[no-untyped-def]
    """Rows (k,) whose gaps are below ``near``, the ``most`` nearest of them, and rows that are pushed; sorted.

    Of those inside ``kept`` are taken, if that is more.
    """
    count, inner = 0, 0
    for row in range(gaps.size):
        count += gaps[row] < near
        inner += gaps[row] < 0.0
    most, edge, ties = max(most, min(inner, kept)), near, 0
    if count > most:
        inside, place = np.empty(count), 0
        for row in range(gaps.size):
            if gaps[row] < near:
                inside[place] = gaps[row]
                place += 1
        edge, ties = np.partition(inside, most - 1)[most - 1], most
        for gap in inside:
            ties -= gap < edge
    rows, place = np.empty(gaps.size, np.int64), 0
    for row in range(gaps.size):
        nearest = gaps[row] < edge
        if gaps[row] == edge and ties > 0:
            nearest, ties = True, ties - 1
        if nearest or pushes[row] != 0.0:
            rows[place] = row
            place += 1
    return rows[:place].copy()


@_kernel
def _linearised(shape, near, bodies, q, local, frame):  # type: ignore[no-untyped-def]
    """Gaps and their slopes at q, with displacements ``local`` (k, 3) in the world beyond the modes."""
    rest, modes, rotations, turns = shape
    vertices, contact_of = near
    gap, normals, own, along, at = frame
    w, u, out = np.zeros(3), np.empty(3), np.empty(3)
    for i in range(vertices.size):
        v, n = vertices[i], normals[i]
        _combined(modes, v, q, u)
        x, y, z = u[0], u[1], u[2]
        if turns:
            _combined(rotations, v, q, w)
            c1, c2, c3 = coefficients(w[0], w[1], w[2])
            x, y, z = turned(w[0], w[1], w[2], c2, c3, x, y, z)
        for j, part in enumerate((x, y, z)):
            at[i, j] = rest[v, j] + part + local[i, j]
        gap[i] = gap_at(bodies[0][contact_of[i]], bodies[1][contact_of[i]], at[i, 0], at[i, 1], at[i, 2], n)
        own[i] = n
        a, b, c = n[0], n[1], n[2]
        if turns:
            own[i, 0], own[i, 1], own[i, 2] = turned(w[0], w[1], w[2], -c1, c2, n[0], n[1], n[2])
            a, b, c = turned(w[0], w[1], w[2], -c2, c3, n[0], n[1], n[2])  # Rt(w)^T n
            warp_slope(w, u, n, out)
            for k in range(q.size):
                along[i, k] = out[0] * rotations[3 * v, k] + out[1] * rotations[3 * v + 1, k]
                along[i, k] += out[2] * rotations[3 * v + 2, k]
        else:
            along[i] = 0.0
        for k in range(q.size):
            along[i, k] += a * modes[3 * v, k] + b * modes[3 * v + 1, k] + c * modes[3 * v + 2, k]


@_kernel
def warp_slope(w, u, n, out):  # type: ignore[no-untyped-def]
    """Derivative ``out`` (3,) by w of ``n . Rt(w) u``."""
    c1, c2, c3 = coefficients(w[0], w[1], w[2])
    d2, d3 = slopes(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], c1, c2, c3)
    nw, uw = n[0] * w[0] + n[1] * w[1] + n[2] * w[2], u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
    nu = n[0] * u[0] + n[1] * u[1] + n[2] * u[2]
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    # n . (w x u) = w . (u x n), and n . (w x (w x u)) = (n . w)(u . w) - w^2 (n . u)
    p, q, r = u[1] * n[2] - u[2] * n[1], u[2] * n[0] - u[0] * n[2], u[0] * n[1] - u[1] * n[0]
    radial = d2 * (w[0] * p + w[1] * q + w[2] * r) + d3 * (nw * uw - square * nu)
    for i, cross in enumerate((p, q, r)):
        out[i] = radial * w[i] + c2 * cross + c3 * (n[i] * uw + u[i] * nw - 2.0 * nu * w[i])


@_kernel
def _reached(shape, near, bodies, q, local, begin):  # type: ignore[no-untyped-def]
    """Gaps (k,) at q with displacements (k, 3) in the axes at rest, turned in place; and the move from ``begin``."""
    rest, modes, rotations, turns = shape
    vertices, contact_of = near
    gaps, move = np.empty(vertices.size), 0.0
    w, u, n = np.zeros(3), np.empty(3), np.empty(3)
    for i in range(vertices.size):
        v = vertices[i]
        _combined(modes, v, q, u)
        x, y, z = u[0], u[1], u[2]
        a, b, c = local[i, 0], local[i, 1], local[i, 2]
        if turns:
            _combined(rotations, v, q, w)
            c1, c2, c3 = coefficients(w[0], w[1], w[2])
            x, y, z = turned(w[0], w[1], w[2], c2, c3, x, y, z)
            a, b, c = turned(w[0], w[1], w[2], c1, c2, a, b, c)
        local[i, 0], local[i, 1], local[i, 2] = a, b, c
        x, y, z = rest[v, 0] + x + a, rest[v, 1] + y + b, rest[v, 2] + z + c
        gaps[i] = gap_at(bodies[0][contact_of[i]], bodies[1][contact_of[i]], x, y, z, n)
        move = max(move, abs(x - begin[i, 0]), abs(y - begin[i, 1]), abs(z - begin[i, 2]))
    return gaps, move


@_kernel
def press(shape, rows_of, bodies, step, before, limits):  # type: ignore[no-untyped-def]
    """End of a frame: ``q = free + G J^T f`` with ``0 <= f _|_ gap >= 0`` at the candidates.

    Each linearisation is corrected by the gaps that its end has, and taken again where that is far.

    Parameters
    ----------
    shape : tuple
        Positions at rest (n, 3), modes and modal rotations (3n, m), and whether these turn the modes.
    rows_of : tuple
        Vertices and contacts (r,) of all rows, slots (n,) of vertices, less than 0 for none, and the blocks of slots.
    bodies : tuple
        Packed contacts.
    step : tuple
        Coordinates (m,) without contacts, G (m,), and the coordinates to begin with.
    before : tuple
        Gaps (r,) [m] that choose the candidates, forces (r,) [N] and displacements (n, 3) [m] beyond the modes.
    limits : tuple
        Gap of a candidate, numbers of them and of those inside, gap that is none, move of a good linearisation, and
        accuracy of the small problems [m].

    Returns
    -------
    tuple
        Candidates (k,), their slots, coordinates (m,), forces (r,) along the normals, and those on the candidates in
        the axes at rest (k, 3), their elastic energy [J] beyond the modes, and whether the gaps met their tolerance.
        Coordinates are empty where a candidate has no slot.
    """
    free, compliance, begin = step
    near, most, kept, deep, far, accuracy = limits
    rows = candidates(before[0], before[1], near, most, kept)
    count, blocks = rows.size, rows_of[3]
    vertices, contact_of, slots = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    forces, local, pushes = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    for i in range(count):
        v = rows_of[0][rows[i]]
        vertices[i], contact_of[i], slots[i] = v, rows_of[1][rows[i]], rows_of[2][v]
        forces[i] = before[1][rows[i]]
        for j in range(3):
            local[i, j] = before[2][v, j]
        if slots[i] < 0:
            return rows, slots, np.empty(0), np.empty(0), pushes, 0.0, False
    q, place, solved = begin.copy(), (vertices, contact_of), False
    gap, normals, own = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    along, at, matrix = np.empty((count, q.size)), np.empty((count, 3)), np.empty((count, count))
    offset, expected = np.empty(count), np.empty(count)
    for _ in range(_PASSES):
        _linearised(shape, place, bodies, q, local, (gap, normals, own, along, at))
        residual_compliance(blocks, slots, own, matrix)
        response(along, compliance, matrix)
        for i in range(count):
            offset[i] = gap[i]
            for j in range(3):
                offset[i] -= normals[i, j] * local[i, j]
            for k in range(q.size):
                offset[i] += along[i, k] * (free[k] - q[k])
        move, energy = np.inf, 0.0
        for _ in range(_CORRECTIONS):
            complementary(matrix, offset, forces, accuracy, True)
            q[:], expected[:], pushes[:] = free, offset, 0.0
            for i in range(count):
                if forces[i] > 0.0:
                    for k in range(q.size):
                        q[k] += compliance[k] * along[i, k] * forces[i]
                    for j in range(count):
                        expected[j] += matrix[i, j] * forces[i]
                    for j in range(3):
                        pushes[i, j] = forces[i] * own[i, j]
            local_at(blocks, slots, pushes, local)
            energy = 0.0
            for i in range(count):
                for j in range(3):
                    energy += 0.5 * pushes[i, j] * local[i, j]
            gaps, move = _reached(shape, place, bodies, q, local, at)
            worst = 0.0
            for i in range(count):
                worst = max(worst, abs(gaps[i]) if forces[i] > 0.0 else -gaps[i])
            solved = worst <= deep
            if solved or not worst < np.inf:
                break
            for i in range(count):
                offset[i] += gaps[i] - expected[i]
        if (solved and move <= far) or not move < np.inf:
            break
    pushed = np.zeros(before[1].size)
    for i in range(count):
        pushed[rows[i]] = forces[i]
    return rows, slots, q, pushed, pushes, energy, solved and move <= far
