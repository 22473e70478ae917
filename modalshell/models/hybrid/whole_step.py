"""A step of BDF2 of a reduced shell under a dead load, with its checks, in one call (theory 12, eq. 7).

So are its start and what stands in for it where motion is violent: each solve from Python takes as long as its algebra.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.second_order import GAMMA, VIOLENT
from modalshell.kernels.compiler import njit
from modalshell.kernels.rotations import largest_turn
from modalshell.models.hybrid.assumed_stress_step import add_strains, implicit_step
from modalshell.models.hybrid.dense_kernels import multiply
from modalshell.models.hybrid.flat_record import records_of

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}
_exact: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "nogil": True}
"""Of what NumPy does in the rule itself: to the same bits."""
_GAMMA = float(GAMMA)


class Taking(NamedTuple):
    """What every solve of a step takes; see :func:`whole_step`."""

    reduced: Any
    """The energy, a :class:`ReducedStress`."""
    surface: Any
    """What its stresses must see, a :class:`Surface`."""
    force: Array
    kept: Array
    """The load's force, and what solves keep; see :func:`implicit_step`. Shape (m,) and (m + K,)."""
    factors: tuple[float, float]
    """Rayleigh's."""
    limits: tuple[float, float, float]
    """The tolerance, a small energy [J], and the unseen share."""
    result: Array
    """Written: iterations of all, and the energies of the last, as returned. Shape (3,)."""


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


@njit(**_options)
def _is_violent(surface, z, jump):  # type: ignore[no-untyped-def]
    """Whether a small change ``jump`` (m,) of coordinates (m,) turns a vertex far."""
    return not largest_turn(_positions(surface, z), _moved(surface, jump), surface.faces) <= VIOLENT


@njit(**_options)
def _solved(taking, begin, length, z):  # type: ignore[no-untyped-def]
    """Take a step of implicit Euler to ``z`` (m,); whether it is solved, and the stresses see the membrane there.

    ``begin`` is the start of :func:`implicit_step`, and ``length`` its time step [s].
    """
    reduced, surface, result, (tolerance, small, share) = taking.reduced, taking.surface, taking.result, taking.limits
    drag, viscosity = taking.factors
    end, solved, energy, seen, iterations = implicit_step(
        reduced, begin, taking.force, length, drag, viscosity, tolerance, taking.kept
    )
    result[0], result[1], result[2] = result[0] + iterations, energy, seen
    if solved and surface.edges.shape[0] > 0:
        solved = _unseen_energy(surface, end, seen) / (energy + small) <= share
    for k in range(z.size):
        z[k] = end[k]
    return solved


@njit(**_exact)
def _rates(origin, z, length, rates):  # type: ignore[no-untyped-def]
    """Write the rates (m,) of a step of implicit Euler from ``origin`` to ``z``."""
    for k in range(z.size):
        rates[k] = (z[k] - origin[k]) / length


@njit(**_exact)
def _extrapolate(x, rates, length, first):  # type: ignore[no-untyped-def]
    """Write coordinates extrapolated by their rates."""
    for k in range(x.size):
        first[k] = x[k] + length * rates[k]


@njit(**_options)
def _damping_strains(taking, one, weight, other, rest):  # type: ignore[no-untyped-def]
    """Strains (K,) that damping is measured from: of two states (m,), with a ``weight`` and the ``rest`` of 1."""
    begun = np.zeros(taking.reduced.membrane.modes)
    if taking.factors[1] > 0.0:
        add_strains(taking.reduced, one, weight, taking.kept, begun)
        if rest != 0.0:
            add_strains(taking.reduced, other, rest, taking.kept, begun)
    return begun


@njit(**_options)
def _euler(taking, x, v, length, end):  # type: ignore[no-untyped-def]
    """Write coordinates and rates after a step of implicit Euler to ``end`` (2, m); whether it is solved."""
    first = np.empty(x.size)
    _extrapolate(x, v, length, first)
    solved = _solved(taking, (x, v, x, x, first, _damping_strains(taking, x, 1.0, x, 0.0)), length, end[0])
    _rates(x, end[0], length, end[1])
    return solved


@njit(**_exact)
def _begin(state, ratio, dt, start, jump):  # type: ignore[no-untyped-def]
    """Write origin, rates, where the step begins, and the state before into ``start`` (4, m), and the next ``jump``."""
    x, v, move, gain = state
    ahead = ratio / (1.0 + 2.0 * ratio)
    for k in range(x.size):
        further, faster = ratio * move[k], ratio * gain[k]
        start[0, k] = x[k] + ahead * further
        start[1, k] = v[k] + ahead * faster
        start[2, k] = x[k] + further
        start[3, k] = x[k] - move[k]
        jump[k] = dt * faster


@njit(**_options)
def _go_on(taking, state, dt, before, end):  # type: ignore[no-untyped-def]
    """Write the step after another one to ``end`` (2, m); its order, 0 where it failed. See :class:`BDF2`."""
    x, v, ratio = state[0], state[1], dt / before
    start, jump = np.empty((4, x.size)), np.empty(x.size)
    _begin(state, ratio, dt, start, jump)
    if not _is_violent(taking.surface, x, jump):
        length = dt * (1.0 + ratio) / (1.0 + 2.0 * ratio)
        further = ratio / (1.0 + 2.0 * ratio) * ratio
        begun = _damping_strains(taking, x, 1.0 + further, start[3], -further)
        if _solved(taking, (start[0], start[1], x, start[2], start[2], begun), length, end[0]):
            _rates(start[0], end[0], length, end[1])
            return 2
    return 1 if taking.surface.edges.shape[0] > 0 and _euler(taking, x, v, dt, end) else 0


@njit(**_exact)
def _begin_parts(x, v, gain, dt, parts):  # type: ignore[no-untyped-def]
    """Write where the first part of SDIRK2 takes the viscous matrix, and begins, into ``parts`` (2, m)."""
    part = _GAMMA * dt
    for k in range(x.size):
        parts[0, k] = x[k] + part * (v[k] + 0.5 * _GAMMA * gain[k])
        parts[1, k] = x[k] + part * v[k]


@njit(**_exact)
def _next_part(x, v, half, dt, parts):  # type: ignore[no-untyped-def]
    """Write origin, rates, where the viscous matrix is and where it begins of the second part into ``parts`` (4, m)."""
    part, rest = _GAMMA * dt, (1.0 - _GAMMA) * dt
    lead = rest / part
    for k in range(x.size):
        w = half[1, k]
        last = v[k] + (w - v[k]) / _GAMMA
        parts[0, k], parts[1, k] = x[k] + rest * w, v[k] + lead * (w - v[k])
        parts[2, k] = x[k] + 0.5 * dt * (v[k] + last)
        parts[3, k] = parts[0, k] + part * parts[1, k]


@njit(**_options)
def _start(taking, state, dt, end):  # type: ignore[no-untyped-def]
    """Write the first step to ``end`` (2, m); its order, 0 where it failed. See :func:`started`."""
    x, v, part = state[0], state[1], _GAMMA * dt
    half, gain, parts = np.empty((2, x.size)), np.empty(x.size), np.empty((4, x.size))
    if not (_euler(taking, x, v, 0.5 * dt, half) and _euler(taking, half[0], half[1], 0.5 * dt, end)):
        return 0
    for k in range(x.size):
        gain[k] = end[1, k] - v[k]
    _begin_parts(x, v, gain, dt, parts)
    for k in range(x.size):
        gain[k] *= dt
    if _is_violent(taking.surface, x, gain):
        return 1
    if not _solved(taking, (x, v, x, parts[0], parts[1], _damping_strains(taking, x, 1.0, x, 0.0)), part, half[0]):
        return 1
    _rates(x, half[0], part, half[1])
    _next_part(x, v, half, dt, parts)
    last = np.empty(x.size)
    lead = (1.0 - _GAMMA) * dt / part
    begun = _damping_strains(taking, x, 1.0 - lead, half[0], lead)
    if not _solved(taking, (parts[0], parts[1], half[0], parts[2], parts[3], begun), part, last):
        return 1
    for k in range(x.size):
        end[0, k] = last[k]
    _rates(parts[0], last, part, end[1])
    return 2


@njit(**_exact)
def _remember(state, ratio, ends):  # type: ignore[no-untyped-def]
    """Write the changes of a step, and the curvature of rates, after coordinates and rates in ``ends`` (5, m)."""
    x, v, _, gain = state
    for k in range(x.size):
        gained = ends[1, k] - v[k]
        ends[2, k], ends[3, k] = ends[0, k] - x[k], gained
        ends[4, k] = 2.0 * ratio / (1.0 + ratio) * (gained - ratio * gain[k])


@njit(**_options)
def whole_step(record, state, force, rule, limits, kept, ends):  # type: ignore[no-untyped-def]
    """Write a step of BDF2, as by :class:`modalshell.integrators.full.BDF2`, into ``ends`` (5, m).

    ``record`` is a :class:`FlatRecord`. ``state`` holds coordinates, rates, and the changes of both in the step before;
    ``rule`` the step and the one before [s], 0 of none, and Rayleigh's factors. ``limits`` are the tolerance of the
    residual, a small energy [J], and the unseen share of the membrane's. For ``kept`` see :func:`implicit_step`.

    Returns the order of the step, 0 where it failed, or where it takes more than one solve and no edges tell what is
    seen; the iterations of all its solves; and elastic energy at the end of the last of them, and its share in the
    assumed stresses [J].
    """
    (reduced, surface), (dt, before, drag, viscosity) = records_of(record), rule
    result = np.zeros(3)
    taking = Taking(reduced, surface, force, kept, (drag, viscosity), limits, result)
    if before > 0.0:
        order = _go_on(taking, state, dt, before, ends)
    else:
        order = _start(taking, state, dt, ends) if surface.edges.shape[0] > 0 else 0
    _remember(state, dt / before if before > 0.0 else 0.0, ends)
    return order, int(result[0]), result[1], result[2]
