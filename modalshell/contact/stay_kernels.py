"""Compiled: steps of warps in closed form in which what colliders push stays pushed (theory 13, eq. 7 and 8)."""

import numpy as np

from modalshell.contact.modal_kernels import arrive, given_back, go_on, implicit_euler
from modalshell.contact.warp_kernels import solved, warp_ended
from modalshell.kernels.compiler import njit
from modalshell.kernels.push import ROWS, push_frame, work_frame

OTHERS, OPENS, STAYS = 0, 1, 2
"""What becomes of a step in which what is pushed is to stay so: others are pushed, it does not stay, or it does."""

_kernel = njit(error_model="numpy", fastmath=False)


@_kernel
def stay(kept, bodies, step, found, limits):  # type: ignore[no-untyped-def]
    """End of a step of implicit Euler in which all of some vertices stay pushed, with no look at others.

    Returns the elastic energy [J] beyond the modes, and whether all stay.

    Parameters
    ----------
    kept, bodies : tuple
        As of :func:`press`.
    step : tuple
        Coordinates and rates (m,), modal force (m,), G (m,), stiffness of the modes (m,), and how long it is [s].
    found : tuple
        Coordinates (m,) to begin with, forces (k,), displacements (3, k) [m] beyond the modes and forces (k, 3) in the
        axes at rest at its beginning: they become those at its end.
    limits : tuple
        Gap that is none, move of a good linearisation, and accuracy of the small problems [m].
    """
    return _stay(kept, bodies, step, found, limits)


@_kernel
def _stay(kept, bodies, step, found, limits):  # type: ignore[no-untyped-def]
    """The same for kernels."""
    q, rates, force, compliance, eigenvalues, dt = step
    ends = np.empty((3, q.size))
    implicit_euler(q, rates, force, compliance, eigenvalues, dt, ends)
    steady, count = kept[5], found[1].size
    if not steady[2].size:
        steady = np.empty((count, count)), np.empty((count, count)), steady[2]
    return solved(kept[3], kept[4], bodies, (ends[0], compliance), found, limits, steady)


@_kernel
def stay_whole(kept, bodies, push, step, before, surface, limits, out):  # type: ignore[no-untyped-def]
    """A step of SDIRK2 in which all of some vertices stay pushed, from what a state keeps to all of its end.

    Returns one of :data:`OTHERS`, :data:`OPENS` and :data:`STAYS`, the energy [J] beyond the modes, and the square of
    the rates' second derivative.

    Parameters
    ----------
    kept, bodies : tuple
        As of :func:`press`.
    push : tuple
        Modal data and a load in rows, powers, and whether the force is by the gradient of its work, as of
        :func:`push_frame`; or none, and a modal force (m,) that stays.
    step : tuple
        Coordinates and rates (m,), G of a part (m,), stiffness of the modes (m,), how long it is [s], and gamma.
    before : tuple
        Forces (r,) [N], displacements (n, 3) [m] and energy [J] beyond the modes, positions (n, 3) [m] without these;
        and the load (n, 3) [N], if the step is to gain no more than its work.
    surface : tuple
        As of :func:`warp_ended`: tiles, shapes, vertices and contacts of all rows.
    limits : tuple
        Those of :func:`stay`.
    out : tuple
        Coordinates and rates (2, m) at the end, modal force (m,) of the second part, positions and displacements
        (n, 3) [m], gaps (r,) [m] and forces (r,) [N].
    """
    rows, vertices, slots = kept[0], kept[1], kept[2]
    pushes, shape, stored, base, load = before
    ends, force, x, beyond, gaps, pushed = out
    pushing = 0
    for row in range(pushes.size):
        pushing += pushes[row] != 0.0
    same, count = pushing == rows.size, rows.size
    for i in range(count):
        same = same and pushes[rows[i]] != 0.0
    if not same:
        return OTHERS, 0.0, 0.0
    forces, local, turned_back = np.empty(count), np.empty((3, count)), np.empty((count, 3))
    for i in range(count):
        forces[i] = pushes[rows[i]]
        for axis in range(3):
            local[axis, i] = shape[vertices[i], axis]
    energy, stays, ended = _stay_twice(kept, bodies, push, step, (ends, forces, local, turned_back, force), limits)
    if not stays:
        return OPENS, energy, 0.0
    bent, after, begun = ended
    least = warp_ended(surface[0], ends[0], (surface[1], slots, turned_back), surface[2], bodies, (x, beyond, gaps))
    if not least >= -limits[0]:
        return OPENS, energy, bent
    if load.size:
        done = 0.0
        if push[0].size:
            for v in range(x.shape[0]):
                for axis in range(3):
                    done += load[v, axis] * (x[v, axis] - base[v, axis])
        else:
            for k in range(force.size):
                done += push[1][k] * (ends[0, k] - step[0][k])
        slower = given_back((after[0], after[1], energy), (begun[0], begun[1], stored), done)
        if slower == 0.0:
            return OPENS, energy, bent
        for k in range(force.size):
            ends[1, k] *= slower
    pushed[:] = 0.0
    for i in range(count):
        pushed[rows[i]] = forces[i]
    return STAYS, energy, bent


@_kernel
def _stay_twice(kept, bodies, push, step, found, limits):  # type: ignore[no-untyped-def]
    """Both parts of a :func:`stay_whole`; its energy [J] beyond the modes, whether all stay, and :func:`arrive`.

    ``found`` is as of :func:`stay`, but first the rows of :func:`arrive`; then the modal force (m,) of its second part.
    """
    q, rates, compliance, eigenvalues, dt, gamma = step
    ends, forces, local, turned_back, force = found
    begun, half, work, energy = np.empty((4, q.size)), np.empty(q.size), np.empty(2 * ROWS), 0.0
    for k in range(q.size):
        begun[0, k], begun[1, k], begun[3, k] = q[k], rates[k], q[k] + gamma * dt * rates[k]
    for turn in range(2):  # one call of each long kernel, which is compiled where it is called
        if not push[0].size:
            for k in range(q.size):
                force[k] = push[1][k]
        elif push[3]:
            work_frame(push[0], push[1], push[2], begun[3], work, force)
        else:
            push_frame(push[0], push[1], push[2], begun[3], work, force)
        end = half if turn == 0 else ends[0]
        for k in range(q.size):
            end[k] = begun[3, k]
        part = begun[0], begun[1], force, compliance, eigenvalues, gamma * dt
        energy, stays = _stay(kept, bodies, part, (end, forces, local, turned_back), limits)
        if not stays:
            return energy, False, (0.0, (0.0, 0.0), (0.0, 0.0))
        if turn == 0:
            go_on(q, rates, half, dt, gamma, begun)
    return energy, True, arrive(q, rates, half, dt, gamma, begun, eigenvalues, ends)
