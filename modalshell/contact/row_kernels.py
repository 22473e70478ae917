"""Compiled: small problems of candidates whose derivatives are asked for, as :mod:`.modal_kernels` has them."""

import numpy as np

from modalshell.contact.complementarity import complementary
from modalshell.contact.gap_kernels import gap_and_normal
from modalshell.contact.modal_kernels import LOADED, local_at, residual_compliance, response, turned
from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import add_lines
from modalshell.kernels.rotations import coefficients

PASSES = 12
"""Linearisations of a frame at most."""
CORRECTIONS = 8
"""Corrections of one by the gaps that it leads to, at most."""

_kernel = njit(error_model="numpy", fastmath=False)


@_kernel
def gaps_and_normals(bodies, vertices, contact_of, points, local, gap, normals):  # type: ignore[no-untyped-def]
    """Gaps (k,) [m] and normals (k, 3) of vertices at ``points`` (k, 3) [m] and what is ``local`` (n, 3) [m] there."""
    for i in range(vertices.size):
        v, c = vertices[i], contact_of[i]
        x, y, z = points[i, 0] + local[v, 0], points[i, 1] + local[v, 1], points[i, 2] + local[v, 2]
        gap[i] = gap_and_normal(bodies, c, x, y, z, normals[i])


@_kernel
def _turned_by(turning, q):  # type: ignore[no-untyped-def]
    """Rotation vectors (k, 3) [rad] of candidates at q: by ``turning`` (m, 3k), or given ones (0, 3) or (k, 3)."""
    by_modes, turns = turning
    if by_modes.shape[0] == 0:
        return turns
    found = np.empty((by_modes.shape[1] // 3, 3))
    add_lines(by_modes, q, q[:0], found.reshape(-1))
    return found


@_kernel
def row_begin(bodies, place, points, moves, given, turning, compliance, out):  # type: ignore[no-untyped-def]
    """A :func:`row_problem` of candidates at ``points`` (k, 3) [m] without what is beyond the modes.

    ``place`` are their vertices, contacts, displacements (n, 3) [m] beyond the modes, and the shapes between them.
    ``given`` are the coordinates (m,), those without contacts, and forces (k,) [N] before.
    """
    vertices, contact_of, local, between = place
    q, free, forces = given
    gap, normals = np.empty(vertices.size), np.empty((vertices.size, 3))
    gaps_and_normals(bodies, vertices, contact_of, points, local, gap, normals)
    frame, turns = (gap, normals, vertices, local), _turned_by(turning, q)
    row_problem(moves, frame, (free - q, forces), turns, between, compliance, out)


@_kernel
def row_problem(moves, frame, given, turns, between, compliance, out):  # type: ignore[no-untyped-def]
    """Small problem of candidates whose derivatives are known.

    Parameters
    ----------
    moves : ndarray, shape (k, 1 or 3, m)
        Derivatives of the positions along the normal of all, or along the axes.
    frame : tuple
        Gaps (k,) [m], normals (k, 3), vertices (k,), and displacements (n, 3) [m] beyond the modes.
    given : tuple
        How far the coordinates without contacts are from those of the gaps (m,), and forces (k,) [N] before, about
        which the problem is softened: repeated problems close the gaps.
    turns : ndarray, shape (k, 3)
        Rotation vectors [rad] of the candidates; (0, 3) where they do not turn.
    between : ndarray, shape (3, 3, k, k)
        Shapes beyond the modes at the candidates.
    compliance : ndarray, shape (m,) or (m, m)
        G.
    out : tuple
        Columns (k, k), compliance (k, k) beyond the modes, ``J G`` (k, m) and gaps (k,) [m] without forces; and the
        normals (3, k) in the axes at rest.
    """
    gap, normals, vertices, local = frame
    ahead, forces = given
    count, size = moves.shape[0], moves.shape[2]
    columns, beyond, softened, offset, own = out
    across = np.empty((size, count))
    for i in range(count):
        n, v, value = normals[i], vertices[i], gap[i]
        for k in range(size):
            slope = moves[i, 0, k]
            if moves.shape[1] == 3:
                slope = n[0] * slope + n[1] * moves[i, 1, k] + n[2] * moves[i, 2, k]
            across[k, i] = slope
            if compliance.ndim == 1:
                softened[i, k] = slope * compliance[k]
            value += slope * ahead[k]
        offset[i] = value - (n[0] * local[v, 0] + n[1] * local[v, 1] + n[2] * local[v, 2])
        own[0, i], own[1, i], own[2, i] = n[0], n[1], n[2]
        if turns.size:
            w = turns[i]
            c1, c2, _ = coefficients(w[0], w[1], w[2])
            own[0, i], own[1, i], own[2, i] = turned(w[0], w[1], w[2], -c1, c2, n[0], n[1], n[2])
    residual_compliance(between, own, beyond)
    for j in range(count):
        for i in range(j):
            beyond[j, i] = beyond[i, j]
    for j in range(count):
        for i in range(count):
            columns[j, i] = beyond[j, i]
    if compliance.ndim == 1:
        loaded = response(across, compliance, columns)
    else:
        soft, trace = np.empty(count), 0.0
        for k in range(size):
            soft[:] = 0.0
            for mode in range(size):
                slope, row = compliance[k, mode], across[mode]
                for i in range(count):
                    soft[i] += slope * row[i]
            for i in range(count):
                softened[i, k] = soft[i]
        for j in range(count):
            for k in range(size):
                for i in range(count):
                    columns[j, i] += softened[j, k] * across[k, i]
            trace += columns[j, j]
        loaded = LOADED * trace / max(count, 1)
        for i in range(count):
            columns[i, i] += loaded
    for i in range(count):
        offset[i] -= loaded * forces[i]


@_kernel
def row_end(problem, forces, free, accuracy, symmetric, out):  # type: ignore[no-untyped-def]
    """Solve a :func:`row_problem` from ``forces`` (k,), in place; the elastic energy [J] beyond the modes.

    ``out`` are coordinates (m,), forces (k, 3) in the axes at rest, and the gaps (k,) that the problem expects.
    """
    complementary(problem[0], problem[3], forces, accuracy, symmetric)
    return row_solved(problem, forces, free, out)


@_kernel
def row_solved(problem, forces, free, out):  # type: ignore[no-untyped-def]
    """What :func:`row_end` tells of the forces (k,) that solve a problem."""
    columns, beyond, softened, offset, own = problem
    (q, pushes, expected), energy, given = out, 0.0, np.empty(forces.size)
    for k in range(q.size):
        q[k] = free[k]
    for i in range(expected.size):
        expected[i], given[i] = offset[i], 0.0
    for j in range(forces.size):
        for i in range(3):
            pushes[j, i] = forces[j] * own[i, j]
        if forces[j] > 0.0:
            for k in range(q.size):
                q[k] += softened[j, k] * forces[j]
            for i in range(forces.size):
                expected[i] += columns[j, i] * forces[j]
            for i in range(forces.size):
                given[i] += beyond[j, i] * forces[j]
    for i in range(forces.size):
        energy += 0.5 * forces[i] * given[i]
    return energy


@_kernel
def row_reached(place, points, pushes, forces, turning, q, bodies, out):  # type: ignore[no-untyped-def]
    """Gaps of candidates at ``points`` (k, 3) under ``pushes`` (k, 3) on them; how far [m] they are off.

    ``place`` and ``turning`` are as those of :func:`row_begin`. ``pushes`` [N] are in the axes at rest, in
    which their turns at q turn what these press in. ``out`` are gaps (k,) [m], and displacements (k, 3) [m] pressed in.
    """
    gaps, shift = out
    _, contact_of, _, between = place
    turns = _turned_by(turning, q)
    local, n = np.empty((3, contact_of.size)), np.empty(3)
    local_at(between, pushes, local)
    for i in range(contact_of.size):
        a, b, c = local[0, i], local[1, i], local[2, i]
        if turns.size:
            w = turns[i]
            c1, c2, _ = coefficients(w[0], w[1], w[2])
            a, b, c = turned(w[0], w[1], w[2], c1, c2, a, b, c)
        shift[i, 0], shift[i, 1], shift[i, 2] = a, b, c
        x, y, z = points[i, 0] + a, points[i, 1] + b, points[i, 2] + c
        gaps[i] = gap_and_normal(bodies, contact_of[i], x, y, z, n)
    return row_off(gaps, forces)


@_kernel
def row_ended(end, vertices, points, rows, forces, pushes):  # type: ignore[no-untyped-def]
    """Write forces (k,) to ``pushes`` (r,); how far [m] vertices at ``end`` (n, 3) are from ``points`` (k, 3)."""
    move = 0.0
    for i in range(vertices.size):
        pushes[rows[i]] = forces[i]
        square = 0.0  # a length, not its largest part: that is another one in axes that are turned
        for axis in range(3):
            square += (end[vertices[i], axis] - points[i, axis]) ** 2
        if not square <= move:
            move = square
    return np.sqrt(move)


@_kernel
def row_off(gaps, forces):  # type: ignore[no-untyped-def]
    """How far [m] candidates are off their gaps (k,) [m], by forces (k,) [N] on them."""
    off = 0.0
    for i in range(gaps.size):
        off = max(off, abs(gaps[i]) if forces[i] > 0.0 else -gaps[i])
        if not gaps[i] > -np.inf:
            off = np.inf
    return off
