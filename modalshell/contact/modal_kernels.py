"""Compiled: what frames of all modal models that touch colliders share (theory 13, eq. 7 and 8).

Shapes that forces press in beyond the modes are kept as they are at rest: ``store[slot, i]`` (3n,) under a unit force
along axis i on the vertex of a slot, and ``blocks[slot, other]`` (3, 3), row i by axis i of the force, at the vertices
of the other slots.
"""

from typing import Any

import numpy as np

from modalshell.contact.gap_kernels import gaps_beyond
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.frame import add_lines
from modalshell.kernels.packed import LANES, load_first, spread, store_first
from modalshell.kernels.rotations import rotate

_NONE = 1e-14
"""Component of a force, as a share of the largest, that rounding explains."""
_PART = 4096
"""Numbers of a shape that are added at a time, for what they are added to to stay near."""
_NO_GAIN = 1e-12
"""Energy that is none, as a share of the energies of a step."""
_SLOWED = 1e-2
"""Share of the kinetic energy up to which a step gives back by slower rates what it has gained."""
LOADED = 1e-9
"""Share of the mean diagonal that is added to it."""

_kernel = njit(error_model="numpy", fastmath=False)
_options: dict[str, Any] = {"error_model": "numpy", "fastmath": False} | UNCOUNTED
_plain = njit(**_options)
_inner = njit(entry=False, **_options)


@njit(error_model="numpy", fastmath=False, forceinline=True)
def turned(a, b, c, second, third, x, y, z):  # type: ignore[no-untyped-def]
    """``v + second w x v + third w x (w x v)``, w = (a, b, c)."""
    p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
    return (
        x + second * p + third * (b * r - c * q),
        y + second * q + third * (c * p - a * r),
        z + second * r + third * (a * q - b * p),
    )


@_inner
def residual_compliance(between, own, out):  # type: ignore[no-untyped-def]
    """Give way ``out`` (k, k) [m/N] along directions ``own`` (3, k), in the axes at rest, under forces along them.

    It is symmetric: what is below the diagonal is not to be read.
    """
    count = own.shape[1]
    blocks, axes, flat, square = between.reshape(-1), own.reshape(-1), out.reshape(-1), count * count
    for a in range(count):
        x, y, z = spread(own[0, a]), spread(own[1, a]), spread(own[2, a])
        for b in range(a // LANES * LANES, count, LANES):
            left, at = min(count - b, LANES), a * count + b
            by_x, by_y = load_first(blocks, at, left), load_first(blocks, 3 * square + at, left)
            given = load_first(axes, b, left) * (x * by_x + y * by_y + z * load_first(blocks, 6 * square + at, left))
            by_x, by_y = load_first(blocks, square + at, left), load_first(blocks, 4 * square + at, left)
            along = x * by_x + y * by_y + z * load_first(blocks, 7 * square + at, left)
            given = given + load_first(axes, count + b, left) * along
            by_x, by_y = load_first(blocks, 2 * square + at, left), load_first(blocks, 5 * square + at, left)
            along = x * by_x + y * by_y + z * load_first(blocks, 8 * square + at, left)
            store_first(flat, at, given + load_first(axes, 2 * count + b, left) * along, left)


@njit(entry=False, error_model="numpy", fastmath=False)
def response(across, compliance, out):  # type: ignore[no-untyped-def]
    """Add ``across^T diag(compliance) across`` (k, k) to ``out``, and to its diagonal what keeps it definite.

    ``across`` are (m, k). What ``out`` has below its diagonal is not read. Also returns what was added to the diagonal
    at last.
    """
    size, count = across.shape
    rows, flat, soft, trace = across.reshape(-1), out.reshape(-1), np.empty(size), 0.0
    for a in range(count):
        for k in range(size):
            soft[k] = across[k, a] * compliance[k]
        for b in range(a // LANES * LANES, count, LANES):
            left, at, k = min(count - b, LANES), a * count + b, 0
            one, two = load_first(flat, at, left), spread(0.0)
            while k + 2 <= size:  # two sums: neither waits for the other
                one = one + spread(soft[k]) * load_first(rows, k * count + b, left)
                two = two + spread(soft[k + 1]) * load_first(rows, (k + 1) * count + b, left)
                k += 2
            if k < size:
                one = one + spread(soft[k]) * load_first(rows, k * count + b, left)
            store_first(flat, at, one + two, left)
        trace += out[a, a]
    loaded = LOADED * trace / max(count, 1)
    for a in range(count):
        for b in range(a):
            out[a, b] = out[b, a]
        out[a, a] += loaded
    return loaded


@njit(**_options | {"fastmath": {"contract"}})
def _add_rows(own, first, store, slots, axis, amounts):  # type: ignore[no-untyped-def]
    """Add a part of some shapes along an axis, from the number ``first`` on, times ``amounts`` (k,), to ``own``."""
    last, k = first + own.size, 0
    # Parts of rows, not of the matrix: the compiler packs what it knows to be one number after the other.
    while k + 4 <= slots.size:
        one, two = store[slots[k], axis, first:last], store[slots[k + 1], axis, first:last]
        three, four = store[slots[k + 2], axis, first:last], store[slots[k + 3], axis, first:last]
        a, b, c, d = amounts[k], amounts[k + 1], amounts[k + 2], amounts[k + 3]
        for j in range(own.size):
            own[j] = (((own[j] + a * one[j]) + b * two[j]) + c * three[j]) + d * four[j]
        k += 4
    while k < slots.size:
        one, a = store[slots[k], axis, first:last], amounts[k]
        for j in range(own.size):
            own[j] += a * one[j]
        k += 1


@_kernel
def local_shape(store, slots, pushes, turns, out):  # type: ignore[no-untyped-def]
    """Displacements ``out`` (n, 3) under ``pushes`` (k, 3) [N] in the axes at rest, turned by vectors (n, 3) [rad].

    ``store`` (s, 3, 3n) are the shapes.
    """
    flat, counts = out.reshape(-1), np.zeros(3, np.int64)
    chosen, amounts = np.empty((3, slots.size), np.int64), np.empty((3, slots.size))
    most = 0.0
    for k in range(slots.size):
        for axis in range(3):
            most = max(most, abs(pushes[k, axis]))
    least = _NONE * most
    for axis in range(3):
        for k in range(slots.size):
            if abs(pushes[k, axis]) > least:
                chosen[axis, counts[axis]], amounts[axis, counts[axis]] = slots[k], pushes[k, axis]
                counts[axis] += 1
    for first in range(0, flat.size, _PART):
        own = flat[first : first + _PART]
        for i in range(own.size):
            own[i] = 0.0
        for axis in range(3):
            _add_rows(own, first, store, chosen[axis, : counts[axis]], axis, amounts[axis])
    if turns.size:
        rotate(turns, out, 1.0, out)


@_kernel
def ended(pushed, spin, q, turns, base, rows_of, bodies, local, gaps):  # type: ignore[no-untyped-def]
    """A :func:`local_shape` into ``local`` (n, 3), and ``gaps`` (r,) of all rows at ``base + local``; the least one.

    ``pushed`` are the stored shapes, slots of these, and forces there. It is turned by ``spin`` (m, 3n) times q, or, if
    there is none, by ``turns`` (n, 3).
    """
    if spin.shape[0]:
        turns = np.empty(base.shape)
        add_lines(spin, q, q[:0], turns.reshape(-1))
    local_shape(pushed[0], pushed[1], pushed[2], turns, local)
    return gaps_beyond(bodies, rows_of[0], rows_of[1], base, local, np.empty(3), gaps)


@_kernel
def implicit_euler(q, rates, force, compliance, eigenvalues, dt, out):  # type: ignore[no-untyped-def]
    """Rows of ``out`` (3, m): coordinates and rates after a step of implicit Euler, by G (m,), and ``q + dt rates``."""
    for k in range(q.size):
        out[0, k] = q[k] + compliance[k] * (rates[k] / dt + force[k] - eigenvalues[k] * q[k])
        out[1, k] = (out[0, k] - q[k]) / dt
        out[2, k] = q[k] + dt * rates[k]


@_kernel
def go_on(q, rates, half, dt, gamma, out):  # type: ignore[no-untyped-def]
    """What a step of SDIRK2 knows at the end ``half`` (m,) of its first part, of implicit Euler over ``gamma dt``.

    Rows of ``out`` (4, m): coordinates and rates at which the second part begins, rates at its end if they change as in
    the first part, and coordinates there by these.
    """
    part = gamma * dt
    for k in range(q.size):
        moved = (half[k] - q[k]) / part
        change = moved - rates[k]
        last = rates[k] + change / gamma
        out[0, k] = q[k] + (dt - part) * moved
        out[1, k] = rates[k] + (1.0 - gamma) / gamma * change
        out[2, k], out[3, k] = last, q[k] + 0.5 * dt * (rates[k] + last)


@_kernel
def arrive(q, rates, half, dt, gamma, begun, eigenvalues, out):  # type: ignore[no-untyped-def]
    """Rates at the end of its second part, out of the row of ``out`` (2, m) that has its coordinates into the other.

    ``begun`` are the rows of :func:`go_on`. Also returns the square of the rates' second derivative, ``dt`` of it, and
    kinetic and elastic energies [J] at the end, and at the beginning of the step.
    """
    part, bent, ended, lost, stored, held = gamma * dt, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(q.size):
        out[1, k] = (out[0, k] - begun[0, k]) / part
        change = (half[k] - q[k]) / part - rates[k]
        bent += ((out[1, k] - begun[1, k] - change) / (part * (1.0 - gamma)) * dt) ** 2
        ended += 0.5 * out[1, k] ** 2
        lost += 0.5 * rates[k] ** 2
        stored += 0.5 * eigenvalues[k] * out[0, k] ** 2
        held += 0.5 * eigenvalues[k] * q[k] ** 2
    return bent, (ended, stored), (lost, held)


@_plain
def given_back(after, before, work):  # type: ignore[no-untyped-def]
    """Factor of the rates at a step's end by which it has gained no more energy than the ``work`` [J] of its load.

    ``after`` and ``before`` are the energies [J] at its end and beginning, kinetic ones first, elastic ones of the
    modes, and beyond these. 0 where it has gained more than little. A rule of order two gains and loses some of that
    order in turn; implicit Euler in the place of every step that gains would damp as nobody has asked for.
    """
    gained = (after[0] + after[1] + after[2]) - (before[0] + before[1] + before[2]) - work
    size = abs(after[0]) + abs(after[1]) + abs(after[2]) + abs(before[0]) + abs(before[1]) + abs(before[2])
    if gained <= _NO_GAIN * (size + abs(work)):
        return 1.0
    return np.sqrt(1.0 - gained / after[0]) if gained <= _SLOWED * after[0] else 0.0


@_kernel
def reach_of(before, after, size):  # type: ignore[no-untyped-def]
    """How far [m] a vertex may go between coordinates (m,), by how far (m,) [m] each of these moves one."""
    reach = 0.0
    for k in range(size.size):
        reach += abs(after[k] - before[k]) * size[k]
    return reach


@_kernel
def between_slots(blocks, slots):  # type: ignore[no-untyped-def]
    """Blocks of some slots (k,) by axes: of the force, of the displacement, and slots of both (3, 3, k, k)."""
    out = np.empty((3, 3, slots.size, slots.size))
    for a in range(slots.size):
        block = blocks[slots[a]]
        for i in range(3):
            for j in range(3):
                row = out[i, j, a]
                for b in range(slots.size):
                    row[b] = block[np.uint64(slots[b]), i, j]
    return out


@_plain
def local_at(between, pushes, local):  # type: ignore[no-untyped-def]
    """Displacements ``local`` (3, k) of candidates under ``pushes`` (k, 3) on them, in the axes at rest."""
    for i in range(3):
        row = local[i]
        for a in range(row.size):
            row[a] = 0.0
        for b in range(pushes.shape[0]):
            x, y, z = pushes[b, 0], pushes[b, 1], pushes[b, 2]
            if x != 0.0 or y != 0.0 or z != 0.0:
                one, two, three = between[0, i, b], between[1, i, b], between[2, i, b]
                for a in range(row.size):
                    row[a] += x * one[a] + y * two[a] + z * three[a]


@_plain
def _nth(values, place):  # type: ignore[no-untyped-def]
    """The one of ``values`` (k,) that sorting would bring to ``place``, by quickselect, which reorders them.

    NumPy's takes eight seconds to compile.
    """
    first, last = 0, values.size - 1
    while first < last:
        pivot, i, j = values[(first + last) // 2], first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < place < i:
            break
        if place <= j:
            last = j
        else:
            first = i
    return values[place]


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
        edge, ties = _nth(inside, most - 1), most
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
