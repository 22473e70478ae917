"""Compiled: steps of RSW in which all that colliders push stays pushed (theory 13, eq. 7 and 8).

As :class:`modalshell.contact.modal_rows.RowFrames` solves the problems of rows that are looked at alone, without a call
by Python between two of a step's solutions.
"""

import numpy as np

from modalshell.contact.complementarity import factorise, substitute
from modalshell.contact.modal_kernels import arrive, go_on, implicit_euler, reach_of
from modalshell.contact.row_kernels import CORRECTIONS, PASSES, row_begin, row_ended, row_reached, row_solved
from modalshell.contact.stay_kernels import OPENS, OTHERS, STAYS
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES, load, load_first, store, total
from modalshell.kernels.packed import spread as spread_number
from modalshell.models.reduction.rotation_strain_kernels import WORK, potential, spread, spread_rows

_kernel = njit(error_model="numpy", fastmath=False)


@njit(error_model="numpy", fastmath=False, **UNCOUNTED)
def _copy(values, out):  # type: ignore[no-untyped-def]
    """Write flat ``values`` to ``out``: the error that a slice may raise takes seconds to compile."""
    for i in range(out.size):
        out[i] = values[i]


@_kernel
def _points(fit, right, points):  # type: ignore[no-untyped-def]
    """Positions (k, 3) [m] of the pushed vertices by the fit's right side (N + 1, 3)."""
    green, rest = fit[5], fit[6]
    rows, flat = green.shape[1], green.reshape(-1)
    turned = np.empty(3 * rows)
    for axis in range(3):
        for row in range(rows):
            turned[axis * rows + row] = right[row, axis]
    for i in range(points.shape[0]):
        x, y, z = spread_number(0.0), spread_number(0.0), spread_number(0.0)
        for row in range(0, rows, LANES):  # what is read of a vertex serves all axes
            left = min(rows - row, LANES)
            by = load_first(flat, i * rows + row, left)
            x = x + by * load_first(turned, row, left)
            y = y + by * load_first(turned, rows + row, left)
            z = z + by * load_first(turned, 2 * rows + row, left)
        points[i, 0], points[i, 1], points[i, 2] = rest[i, 0] + total(x), rest[i, 1] + total(y), rest[i, 2] + total(z)


@_kernel
def _moves(fit, directions, q, moves, further):  # type: ignore[no-untyped-def]
    """Derivatives (k, d, m) of the same along directions (d, 3) at q (m,); ``further`` is as of :func:`spread_rows`."""
    modal, shape, corners, columns, slots, green, _ = fit
    (count, rows), size = green.shape, columns.shape[2]
    width = directions.shape[0] * size
    right = np.empty((rows + 1, directions.shape[0], size))
    spread_rows(modal, shape, columns, slots, q, directions, right, (corners, *further))
    lines, found = right.reshape(-1), np.empty(count * width)
    for first in range(0, count, 4):  # four vertices at a time: a line is read once for all of them
        b, c, d = min(first + 1, count - 1), min(first + 2, count - 1), min(first + 3, count - 1)
        for at in range(0, width, LANES):
            one, two, three, four = spread_number(0.0), spread_number(0.0), spread_number(0.0), spread_number(0.0)
            for row in range(rows):
                line = load(lines, row * width + at)
                one = one + spread_number(green[first, row]) * line
                two = two + spread_number(green[b, row]) * line
                three = three + spread_number(green[c, row]) * line
                four = four + spread_number(green[d, row]) * line
            store(found, first * width + at, one)
            store(found, b * width + at, two)
            store(found, c * width + at, three)
            store(found, d * width + at, four)
    for i in range(count):
        for axis in range(directions.shape[0]):
            for k in range(q.size):
                moves[i, axis, k] = found[i * width + axis * size + k]


@_kernel
def _stay(fit, rows, part, state, derivatives, limits):  # type: ignore[no-untyped-def]
    """End of a part of a step, in place of where it begins in ``state``; energy [J] beyond the modes, whether all stay.

    ``part`` are coordinates without contacts and G, (m,) each. The rest is as of :func:`stay_twice`, but that gaps up
    to the last of the ``limits`` are closed by one more solution, after which no positions are found. Also returned is
    whether it was so, and how often all triangles were read.
    """
    bodies, directions, place, turning = rows
    vertices, contact_of, between = place
    free, compliance = part
    q, forces, local, points, turned, right = state
    at, taken, moves = derivatives
    none, far, nearly = limits
    count, read, energy, closed = vertices.size, 0, 0.0, False
    square, normals = np.empty((2, count, count)), np.empty((3, count))
    problem = square[0], square[1], np.empty((count, q.size)), np.empty(count), normals
    after, expected, reached, pushes = np.empty(q.size), np.empty(count), np.empty(count), np.empty(count)
    factor, shift, before = np.empty((count, count)), np.empty((count, 3)), np.empty((count, 3))
    work = np.empty(WORK)
    for _ in range(PASSES):
        same = True
        for k in range(q.size):
            same = same and at[k] == taken[k]
        if not same:
            _moves(fit, directions, at, moves, (right[:0], right[:0], at))
            _copy(at, taken)
            read += 1
        _copy(points.reshape(-1), before.reshape(-1))
        where = vertices, contact_of, local, between
        row_begin(bodies, where, before, moves, (q, free, forces), turning, compliance, problem)
        _copy(problem[0].reshape(-1), factor.reshape(-1))
        if not factorise(factor):
            return energy, False, closed, read
        for _ in range(CORRECTIONS):
            for i in range(count):
                forces[i] = -problem[3][i]
            substitute(factor, forces)
            for i in range(count):
                if not forces[i] > 0.0:
                    return energy, False, closed, read
            energy = row_solved(problem, forces, free, (after, turned, expected))
            if closed:
                break
            spread(fit[0], fit[1], fit[2], after, work, right)
            _points(fit, right, points)
            off = row_reached(where, points, turned, forces, turning, after, bodies, (reached, shift))
            move = row_ended(points, vertices, before, vertices, forces, pushes)
            read += 1
            if not none < off < np.inf:
                break
            closed = off <= nearly and move <= far
            for i in range(count):
                problem[3][i] += reached[i] - expected[i]
        _copy(after, q)
        _copy(shift.reshape(-1), local.reshape(-1))
        if closed or (off <= none and move <= far):
            return energy, True, closed, read
        _copy(q, at)
    return energy, False, closed, read


@_kernel
def _gathered(chosen, before, state):  # type: ignore[no-untyped-def]
    """Write forces, displacements and positions of ``chosen`` rows to a ``state``; whether these are all pushed ones.

    As of :func:`stay_twice`.
    """
    (rows, vertices), (pushes, shape, base) = chosen, before
    pushing = 0
    for row in range(pushes.size):
        pushing += pushes[row] != 0.0
    same = pushing == rows.size
    for i in range(rows.size):
        same = same and pushes[rows[i]] != 0.0
        state[1][i] = pushes[rows[i]]
        for axis in range(3):
            state[2][i, axis], state[3][i, axis] = shape[vertices[i], axis], base[vertices[i], axis]
    return same


@_kernel
def stay_twice(fit, work, rows, step, before, derivatives, limits, out):  # type: ignore[no-untyped-def]
    """Both parts of a step of SDIRK2 in which all of some vertices stay pushed.

    Returns one of :data:`OTHERS`, :data:`OPENS` and :data:`STAYS`, the elastic energy [J] beyond the modes, how often
    all triangles were read, and what :func:`arrive` returns.

    Parameters
    ----------
    fit : tuple
        Modal data, shapes and corners of the triangles as of :func:`spread`, turns and strains and rows as of
        :func:`spread_rows`; displacements (k, N) of the vertices per unit of each row, and their positions (k, 3) [m]
        at rest.
    work : tuple
        A load's adjoint gradients as of :func:`potential`, and the part (m,) of its force that stays.
    rows : tuple
        Rows (k,) of the pushed and their vertices; colliders, directions (d, 3) of their normals; the numbers 0 to
        k - 1, contacts (k,) and shapes (3, 3, k, k) between the pushed; and their turns, as of :func:`row_begin`.
    step : tuple
        Coordinates and rates (m,), G of a part (m,), stiffness of the modes (m,), how long it is [s], and gamma.
    before : tuple
        Forces (r,) [N] at the beginning, displacements (n, 3) [m] beyond the modes and positions (n, 3) [m] without
        these.
    derivatives : tuple
        Coordinates (m,) near which derivatives serve, those of the derivatives that are known, and these (k, d, m).
    limits : tuple
        Moves [m] within which derivatives are kept, gap that is none, move of a good linearisation, gaps of the first
        part that one more solution closes, and how far (m,) [m] each coordinate may move a vertex.
    out : tuple
        Coordinates and rates (2, m) at the end, the modal force (m,) of the second part, forces (k,) [N], and those
        (k, 3) in the axes at rest; and the fit's right side (N + 1, 3).
    """
    q, rates, compliance, eigenvalues, dt, gamma = step
    ends, force, forces, turned, right = out
    (at, taken, moves), (still, none, far, nearly, reach), count = derivatives, limits, forces.size
    begun, half, parts, read = np.empty((4, q.size)), np.empty(q.size), np.empty((3, q.size)), 0
    state = q.copy(), forces, np.empty((count, 3)), np.empty((count, 3)), turned, right
    nothing, energy, closed = (0.0, (0.0, 0.0), (0.0, 0.0)), 0.0, False
    if not _gathered(rows[0], before, state):
        return OTHERS, energy, read, nothing
    for k in range(q.size):
        begun[0, k], begun[1, k], begun[3, k] = q[k], rates[k], q[k] + gamma * dt * rates[k]
    for turn in range(2):
        _copy(work[1], force)
        near = begun[3]
        if reach_of(at, near, reach) <= still:
            potential(fit[0], work[0], near, np.empty(WORK), force)
            if closed:
                spread(fit[0], fit[1], fit[2], state[0], np.empty(WORK), right)
                _points(fit, right, state[3])
            read += 1 + closed
        else:  # the triangles are read once for all of it
            for k in range(q.size):
                state[0][k] = at[k] = taken[k] = near[k]
            _moves(fit, rows[2], near, moves, (right, work[0], force))
            _points(fit, right, state[3])
            read += 1
        implicit_euler(begun[0], begun[1], force, compliance, eigenvalues, gamma * dt, parts)
        last = none, far, nearly if turn == 0 else 0.0
        energy, stays, closed, times = _stay(fit, rows[1:], (parts[0], compliance), state, derivatives, last)
        read += times
        if not stays:
            return OPENS, energy, read, nothing
        if turn == 0:
            _copy(state[0], half)
            go_on(q, rates, half, dt, gamma, begun)
    _copy(state[0], ends[0])
    return STAYS, energy, read, arrive(q, rates, half, dt, gamma, begun, eigenvalues, ends)
