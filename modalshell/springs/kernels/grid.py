"""Verlet steps of a rectangular sheet of springs, in tiles of columns and a sliding window of rows.

A tile is 1024 columns. The rows that are worked on lie in rings that stay near the processor, at distances that the
compiler knows; every inner loop runs along a row and compiles to packed instructions. A row works out its springs to
the right and to the next two rows, and their pulls are kept until the masses at the other ends have their turn. Parts
of the sheet that go to different threads, and neighbouring tiles, work out the springs between them twice, so that no
two threads write to one place and the result does not depend on the threads. Springs beyond the sheet's sides are
multiplied by a gate of 0; those beyond its last row are not computed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange, types
from numba.extending import overload

from modalshell.kernels.compiler import njit
from modalshell.kernels.frame import FASTMATH

TILE = 1024
"""Columns in a tile."""
_PACK = 16
"""Columns that are worked on together at most: widths are padded to a multiple."""
_HALO = 2 * _PACK
_PITCH = TILE + 2 * _HALO
_ROW = 3 * _PITCH
"""Numbers in a row of vectors, its three components one after the other with their halos."""
_STEEP, _GATES = 3 * _ROW, 3 * _ROW + 11 * _ROW
WORK = _GATES + _ROW
"""Length of the buffer of one thread: three rows of places; pulls of eleven rows, below; gates."""
# Pulls are kept for as many rows as they are needed: those of the springs to the next row but one for three rows, of
# the three springs to the next row for two, and of the two along the row for one.
_NEAR, _FAR = 0, _ROW
_RIGHT, _LEFT = _ROW, 2 * _ROW
# Gates of the springs one and two columns to the right, and one to the left.
_GATE_NEAR, _GATE_FAR, _GATE_LEFT = 0, _PITCH, 2 * _PITCH

_kernel = njit(error_model="numpy", fastmath=FASTMATH)


def inverse_root(squared: Any) -> Any:
    """``1 / sqrt(squared)`` to rounding, in the precision of ``squared`` (normal numbers of float32); compiled only."""
    raise NotImplementedError


@overload(inverse_root, jit_options={"fastmath": FASTMATH}, inline="always")
def _inverse_root_by_precision(squared):  # type: ignore[no-untyped-def]
    if squared == types.float32:

        def evaluate(squared):  # type: ignore[no-untyped-def]
            return np.float32(1.0) / np.sqrt(squared)
    else:
        # Division and root in float64 are slow; in float32 they are estimated by one instruction and refined. The step
        # of third order takes an error of 1e-7 to 1e-21.
        def evaluate(squared):  # type: ignore[no-untyped-def]
            y = np.float64(np.float32(1.0) / np.sqrt(np.float32(squared)))
            e = 1.0 - squared * y * y
            return y + y * e * (0.5 + 0.375 * e)

    return evaluate


@_kernel
def _same_row(count, centre, near, near_rest, far, far_rest, tiny, gates, pulls):  # type: ignore[no-untyped-def]
    """Pull of the springs to one and two columns on."""
    for c in range(count):
        px, py, pz = centre[c], centre[_PITCH + c], centre[2 * _PITCH + c]
        dx, dy, dz = centre[c + 1] - px, centre[_PITCH + c + 1] - py, centre[2 * _PITCH + c + 1] - pz
        a = gates[_GATE_NEAR + c] * (near - near_rest * inverse_root(dx * dx + dy * dy + dz * dz + tiny))
        pulls[_NEAR + c] = a * dx
        pulls[_NEAR + _PITCH + c] = a * dy
        pulls[_NEAR + 2 * _PITCH + c] = a * dz
        dx, dy, dz = centre[c + 2] - px, centre[_PITCH + c + 2] - py, centre[2 * _PITCH + c + 2] - pz
        a = gates[_GATE_FAR + c] * (far - far_rest * inverse_root(dx * dx + dy * dy + dz * dz + tiny))
        pulls[_FAR + c] = a * dx
        pulls[_FAR + _PITCH + c] = a * dy
        pulls[_FAR + 2 * _PITCH + c] = a * dz


@_kernel
def _next_row(count, centre, other, near, near_rest, skew, skew_rest, tiny, gates, pulls):  # type: ignore[no-untyped-def]
    """Pull of the springs into the next row; ``other`` begins a column before ``centre``."""
    for c in range(count):
        px, py, pz = centre[c], centre[_PITCH + c], centre[2 * _PITCH + c]
        dx, dy, dz = other[c + 1] - px, other[_PITCH + c + 1] - py, other[2 * _PITCH + c + 1] - pz
        a = near - near_rest * inverse_root(dx * dx + dy * dy + dz * dz + tiny)
        pulls[c] = a * dx
        pulls[_PITCH + c] = a * dy
        pulls[2 * _PITCH + c] = a * dz
        dx, dy, dz = other[c + 2] - px, other[_PITCH + c + 2] - py, other[2 * _PITCH + c + 2] - pz
        a = gates[_GATE_NEAR + c] * (skew - skew_rest * inverse_root(dx * dx + dy * dy + dz * dz + tiny))
        pulls[_RIGHT + c] = a * dx
        pulls[_RIGHT + _PITCH + c] = a * dy
        pulls[_RIGHT + 2 * _PITCH + c] = a * dz
        dx, dy, dz = other[c] - px, other[_PITCH + c] - py, other[2 * _PITCH + c] - pz
        a = gates[_GATE_LEFT + c] * (skew - skew_rest * inverse_root(dx * dx + dy * dy + dz * dz + tiny))
        pulls[_LEFT + c] = a * dx
        pulls[_LEFT + _PITCH + c] = a * dy
        pulls[_LEFT + 2 * _PITCH + c] = a * dz


@_kernel
def _second_row(count, centre, other, far, far_rest, tiny, pulls):  # type: ignore[no-untyped-def]
    """Pull of the spring into the next row but one."""
    for c in range(count):
        dx = other[c] - centre[c]
        dy = other[_PITCH + c] - centre[_PITCH + c]
        dz = other[2 * _PITCH + c] - centre[2 * _PITCH + c]
        a = far - far_rest * inverse_root(dx * dx + dy * dy + dz * dz + tiny)
        pulls[c] = a * dx
        pulls[_PITCH + c] = a * dy
        pulls[2 * _PITCH + c] = a * dz


@_kernel
def _move(width, now, before, keep, weight, along, down, up, far_down, far_up):  # type: ignore[no-untyped-def]
    """One component of a row's Verlet step, into ``before``; the rows of pulls begin two columns before."""
    for c in range(width):
        same = (along[_NEAR + c + 2] - along[_NEAR + c + 1]) + (along[_FAR + c + 2] - along[_FAR + c])
        below = down[c + 2] + (down[_RIGHT + c + 2] + down[_LEFT + c + 2])
        above = up[c + 2] + (up[_RIGHT + c + 1] + up[_LEFT + c + 3])
        pull = same + (below - above) + (far_down[c + 2] - far_up[c + 2])
        here = now[c]
        before[c] = here + keep * (here - before[c]) + (pull + weight)


@_kernel
def _load_row(x, row, first, start, stop, slot):  # type: ignore[no-untyped-def]
    """Copy the columns ``start`` to ``stop`` of a row; beyond the sheet its last columns are repeated."""
    columns = x.shape[2]
    begin, end = max(start, 0), min(stop, columns)
    for axis in range(3):
        base = axis * _PITCH + _HALO - first
        line = x[axis, row]
        for c in range(begin, end):
            slot[base + c] = line[c]
        for c in range(start, begin):
            slot[base + c] = line[0]
        for c in range(end, stop):
            slot[base + c] = line[columns - 1]


@_kernel
def _set_gates(first, columns, stop, gates):  # type: ignore[no-untyped-def]
    """1 where both ends of a spring are on the sheet, else 0."""
    for c in range(stop):
        column = first + c - _HALO
        inside = 0 <= column < columns
        gates[_GATE_NEAR + c] = inside and column + 1 < columns
        gates[_GATE_FAR + c] = inside and column + 2 < columns
        gates[_GATE_LEFT + c] = inside and column >= 1


@_kernel
def _rows(first_row, last_row, x, before, coefficients, gravity, keep, tiny, pin_starts, pin_columns, work):  # type: ignore[no-untyped-def]
    """Write ``x + keep (x - before) + pull + gravity`` of some rows into ``before``."""
    rows, columns = x.shape[1], x.shape[2]
    near, near_rest, skew, skew_rest, far, far_rest = coefficients
    along, gates = work[_GATES - 2 * _ROW : _GATES], work[_GATES:]
    begin = max(first_row - 2, 0)
    for first in range(0, columns, TILE):
        width = min(TILE, columns - first)
        # Springs across a tile's side are worked out in both tiles, a whole pack of them.
        start = _HALO - (_PACK if first > 0 else 0)
        stop = _HALO + ((width + _PACK - 1) // _PACK * _PACK if first + width == columns else width + _PACK)
        count, left, right = stop - start, first + start - _HALO - 1, first + stop - _HALO + 2
        for line in range(_STEEP, _GATES, _PITCH):
            work[line : line + stop + 3] = 0
        _set_gates(first, columns, stop, gates)
        for row in range(begin, min(begin + 2, rows)):
            _load_row(x, row, first, left, right, work[row % 3 * _ROW :])
        for row in range(begin, last_row):
            centre, second = work[row % 3 * _ROW + start :], work[(row + 2) % 3 * _ROW :]
            down, up = work[_STEEP + (3 + 3 * (row % 2)) * _ROW :], work[_STEEP + (6 - 3 * (row % 2)) * _ROW :]
            far_down, far_up = work[_STEEP + row % 3 * _ROW :], work[_STEEP + (row + 1) % 3 * _ROW :]
            _same_row(count, centre, near, near_rest, far, far_rest, tiny, gates[start:], along[start:])
            if row + 1 < rows:
                other = work[(row + 1) % 3 * _ROW + start - 1 :]
                _next_row(count, centre, other, near, near_rest, skew, skew_rest, tiny, gates[start:], down[start:])
            else:
                down[: 3 * _ROW] = 0
            if row + 2 < rows:
                _load_row(x, row + 2, first, left, right, second)
                _second_row(count, centre, second[start:], far, far_rest, tiny, far_down[start:])
            else:
                far_down[:_ROW] = 0
            if row >= first_row:
                for axis in range(3):
                    place = axis * _PITCH + _HALO - 2
                    _move(
                        width,
                        x[axis, row, first:],
                        before[axis, row, first:],
                        keep,
                        gravity[axis],
                        along[place:],
                        down[place:],
                        up[place:],
                        far_down[place:],
                        far_up[place:],
                    )
                for pin in range(pin_starts[row], pin_starts[row + 1]):
                    column = pin_columns[pin]
                    if first <= column < first + width:
                        for axis in range(3):
                            before[axis, row, column] = x[axis, row, column]


@njit(error_model="numpy", fastmath=False, parallel=True)
def verlet_steps(count, x, before, coefficients, gravity, keep, tiny, pin_starts, pin_columns, work):  # type: ignore[no-untyped-def]
    """Take ``count`` Verlet steps on as many parts as ``work`` (parts, WORK) has rows.

    ``x`` and ``before`` (2 of (3, rows, columns)) hold the positions now and a step ago; after an odd count they have
    changed places. ``coefficients`` are stiffness and stiffness times rest length of the structural, shear and flexion
    springs, and ``gravity`` (3,) an acceleration, all times dt^2 over mass and drag; ``keep`` is the share of the last
    step's displacement that goes on, ``tiny`` [m^2] what keeps a spring of no length from dividing by zero.
    ``pin_starts`` (rows + 1,) and ``pin_columns`` list the pinned masses.
    """
    parts, rows = work.shape[0], x.shape[1]
    for step in range(count):
        now, other = (x, before) if step % 2 == 0 else (before, x)
        for part in prange(parts):
            first, last = part * rows // parts, (part + 1) * rows // parts
            _rows(first, last, now, other, coefficients, gravity, keep, tiny, pin_starts, pin_columns, work[part])
