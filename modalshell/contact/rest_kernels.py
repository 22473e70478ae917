"""Compiled: frames of a modal shell at rest on colliders, by changes from one frame (theory 13, eq. 7 and 8)."""

import numpy as np

from modalshell.contact.complementarity import complementary
from modalshell.contact.modal_kernels import implicit_euler
from modalshell.kernels.compiler import njit

_kernel = njit(error_model="numpy", fastmath=False)


@_kernel
def _same_set(kept, opened, accuracy, forces):  # type: ignore[no-untyped-def]
    """Forces (k,) where gaps have ``opened`` by (k,) and the same rows are pushed as before; whether these are.

    Others are looked at only where there are any.
    """
    columns, left, taken, chosen, inverse = kept
    change = np.zeros(taken.size)
    for a in range(chosen.size):
        value, row = 0.0, inverse[a]
        for b in range(chosen.size):
            value -= row[b] * opened[chosen[b]]
        change[chosen[a]] = value
        forces[chosen[a]] = taken[chosen[a]] + value
        if not forces[chosen[a]] > 0.0:
            return False
    for i in range(taken.size if chosen.size < taken.size else 0):
        if taken[i] > 0.0:
            continue
        gap, row = left[i] + opened[i], columns[i]
        for a in range(chosen.size):
            gap += row[chosen[a]] * change[chosen[a]]
        forces[i] = 0.0
        if not gap >= -accuracy:
            return False
    return True


@_kernel
def rest_frame(kept, taken_at, step, before, force, dt, limits, out):  # type: ignore[no-untyped-def]
    """End of a frame in a problem that is kept; whether it is near enough to where that was taken.

    Parameters
    ----------
    kept : tuple
        Columns (k, k) of the problem, gaps (k,) [m] where it was taken, forces (k,) [N] there, which of these push, and
        the inverse of their columns.
    taken_at : tuple
        Coordinates (m,) there, and what forces had changed them by (m,); slopes (k, m) of the gaps, these times G, and
        the energy [J] beyond the modes there, and its slopes (k,) by forces.
    step : tuple
        G, stiffness of the modes, how far [m] each coordinate, and each force, may move a vertex, and the rows (k,).
    before : tuple
        Coordinates and rates (m,).
    force, dt : ndarray, shape (m,), and float
        Modal force, and the step [s].
    limits : tuple
        How far [m] a vertex may be moved, accuracy [m], and what is on the columns' diagonal to keep them definite.
    out : tuple
        Coordinates and rates without contacts, and with these (4, m), forces (r,), and the energy (1,) beyond modes.
    """
    columns, left, taken, _, _ = kept
    at, pulled, across, softened, stored, by_forces = taken_at
    compliance, eigenvalues, by_coordinate, by_force, rows = step
    ends, pushes, energy = out
    count, size = rows.size, at.size
    implicit_euler(before[0], before[1], force, compliance, eigenvalues, dt, ends)
    way, opened, forces = ends[2], np.empty(count), np.empty(count)
    for k in range(size):
        way[k] = (ends[0, k] - at[k]) + pulled[k]
    for i in range(count):
        value, row = 0.0, across[i]
        for k in range(size):
            value += row[k] * way[k]
        opened[i] = value
    same = _same_set(kept, opened, limits[1], forces)
    if not same:
        offset = np.empty(count)
        for i in range(count):
            offset[i], forces[i] = left[i] + opened[i], taken[i]
        for j in range(count):
            for i in range(count):
                offset[i] -= columns[j, i] * taken[j]
        if not complementary(columns, offset, forces, limits[1], True):
            return False
    move, work = 0.0, stored
    by_modes = np.zeros(size)
    for j in range(count):
        change, row = forces[j] - taken[j], softened[j]
        if change != 0.0:
            move += abs(change) * by_force[j]
            work += by_forces[j] * change
            for k in range(size):
                by_modes[k] += row[k] * change
    # The square of the change by what is not of the modes. Where the set stays, the columns times it close the gaps.
    for j in range(count):
        change = forces[j] - taken[j]
        if change != 0.0:
            value, row = -limits[2] * change, across[j]
            if same:
                value -= opened[j]
            else:
                for i in range(count):
                    value += columns[j, i] * (forces[i] - taken[i])
            for k in range(size):
                value -= row[k] * by_modes[k]
            work += 0.5 * change * value
    for k in range(size):
        moved = way[k] + by_modes[k]
        move += abs(moved) * by_coordinate[k]
        ends[2, k] = at[k] + moved
        ends[3, k] = (ends[2, k] - before[0][k]) / dt
    if not move <= limits[0]:
        return False
    pushes[:] = 0.0
    for i in range(count):
        pushes[rows[i]] = forces[i]
    energy[0] = work
    return True
