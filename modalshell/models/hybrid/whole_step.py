"""A step of BDF2 of a reduced shell under a dead load, with its checks, in one call (theory 12, eq. 7)."""

from __future__ import annotations

from typing import Any

import numpy as np

from modalshell.kernels.compiler import njit
from modalshell.kernels.rotations import largest_turn
from modalshell.models.hybrid.assumed_stress_step import implicit_step
from modalshell.models.hybrid.dense_kernels import multiply
from modalshell.models.hybrid.flat_record import records_of

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}


@njit(**_options)
def _moved(surface, z):  # type: ignore[no-untyped-def]
    """Displacements (k, 3) by coordinates z (m,)."""
    own, moved = np.zeros(surface.columns.shape[1]), np.empty(surface.rest.shape)
    for i in range(z.size):
        own[i] = z[i]
    multiply(surface.columns.reshape(-1), own, moved.reshape(-1))
    return moved


@njit(**_options)
def _positions(surface, z):  # type: ignore[no-untyped-def]
    """Positions (k, 3) [m] at coordinates z (m,)."""
    x = _moved(surface, z)
    for v in range(x.shape[0]):
        for axis in range(3):
            x[v, axis] += surface.rest[v, axis]
    return x


@njit(**_options)
def _membrane(surface, x):  # type: ignore[no-untyped-def]
    """Energy of the membrane [J] at positions (k, 3) [m]."""
    strains, energy = np.empty(surface.edges.shape[0]), 0.0
    for e in range(strains.size):
        a, b = surface.edges[e, 0], surface.edges[e, 1]
        u, v, w = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        strains[e] = 0.5 * (u * u + v * v + w * w) - surface.lengths[e]
    for e in range(strains.size):
        tension = 0.0
        for place in range(surface.starts[e], surface.starts[e + 1]):
            tension += surface.values[place] * strains[surface.others[place]]
        energy += 0.5 * strains[e] * tension
    return energy


@njit(**_options)
def _unseen_energy(surface, z, seen):  # type: ignore[no-untyped-def]
    """Membrane energy [J] at coordinates z (m,) that stresses of the energy ``seen`` [J] do not see."""
    return abs(_membrane(surface, _positions(surface, z)) - seen)


@njit(error_model="numpy", fastmath=False, nogil=True)
def _begin(state, ratio, dt, start, jump):  # type: ignore[no-untyped-def]
    """Write origin, rates and where the step begins into ``start`` (3, m), the next change of move too."""
    x, v, move, gain = state
    ahead = ratio / (1.0 + 2.0 * ratio)
    for k in range(x.size):
        further, faster = ratio * move[k], ratio * gain[k]
        start[0, k] = x[k] + ahead * further
        start[1, k] = v[k] + ahead * faster
        start[2, k] = x[k] + further
        jump[k] = dt * faster


@njit(error_model="numpy", fastmath=False, nogil=True)
def _end(state, ratio, length, z, start, ends):  # type: ignore[no-untyped-def]
    """Write coordinates, rates, their changes and the curvature of rates into ``ends`` (5, m)."""
    x, v, _, gain = state
    for k in range(x.size):
        rate = (z[k] - start[0, k]) / length
        gained = rate - v[k]
        ends[0, k], ends[1, k] = z[k], rate
        ends[2, k], ends[3, k] = z[k] - x[k], gained
        ends[4, k] = 2.0 * ratio / (1.0 + ratio) * (gained - ratio * gain[k])


@njit(**_options)
def whole_step(record, state, force, rule, limits, kept, ends):  # type: ignore[no-untyped-def]
    """Write a step of BDF2, as by :class:`modalshell.integrators.full.BDF2`, into ``ends`` (5, m).

    ``record`` is a :class:`FlatRecord`. ``state`` holds coordinates, rates, and the changes of both in the step before;
    ``rule`` the step and the one before [s], and Rayleigh's factors. ``limits`` are the tolerance of the step's
    residual, the turn [rad] from which it is violent, a small energy [J], and the unseen share of the membrane's. For
    ``kept`` see :func:`implicit_step`.

    Returns
    -------
    taken : bool
        Whether the step is neither violent nor failed, and the stresses see the membrane at its end.
    iterations : int
        Iterations; 0 of a violent step, which was not begun.
    energy, seen : float
        Elastic energy at its end, and its share in the assumed stresses [J].
    """
    (reduced, surface), x, (dt, before, drag, viscosity) = records_of(record), state[0], rule
    ratio = dt / before
    start, jump = np.empty((3, x.size)), np.empty(x.size)
    _begin(state, ratio, dt, start, jump)
    if not largest_turn(_positions(surface, x), _moved(surface, jump), surface.faces) <= limits[1]:
        return False, 0, 0.0, 0.0
    length = dt * (1.0 + ratio) / (1.0 + 2.0 * ratio)
    begin = start[0], start[1], x, start[2], start[2]
    z, solved, energy, seen, iterations = implicit_step(reduced, begin, force, length, drag, viscosity, limits[0], kept)
    taken = solved
    if solved and surface.edges.shape[0] > 0:
        taken = _unseen_energy(surface, z, seen) / (energy + limits[2]) <= limits[3]
    _end(state, ratio, length, z, start, ends)
    return taken, iterations, energy, seen
