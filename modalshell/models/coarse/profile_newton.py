"""Compiled Newton solver of implicit Euler for small discrete shells: assembly, factorisation, line search.

The algorithms are those of :mod:`modalshell.statics`, on the storage of a profile factorisation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels import rotations
from modalshell.kernels.compiler import njit
from modalshell.linalg.profile import LANES, add_product, factorise, solve, substitute_back
from modalshell.shell import GAUSS_NEWTON, MIXED
from modalshell.shell.kernels.generated import flexure, shear, stretch

_LEAST, _ONCE = np.int64(2), np.int64(1)
"""Mixed iterations that a step, and one of a descent, takes at least: a single one is 8 to 21 % off across a snap."""
_MOST, _SHORT = np.int64(40), np.int64(12)
"""And at most."""
_STALLED = 6
"""Iterations without halving the residual after which mixed Newton is aborted."""
_TURN = 1.0
"""Largest turn of a vertex in an iteration [rad]."""
_DESCENT, _EASY = 150, 5
"""Steps of a descent at most, and iterations in one up to which the drag falls."""
_SADDLES = 4
"""Saddles that a descent leaves."""
_LOOSE, _NEAR = 1e-3, 0.3
"""Relative residuals of a descent's steps, and from which it tries to end by mixed Newton."""
_FIRST_MOVE = 0.05
"""Move of a free shell, in its sizes, that the first drag of a descent allows."""
_FLOOR = 1e-3
"""Share of the inertia of the displacement itself below which a residual is not compared with the load."""
_STRETCHING, _LINEARISED = np.int64(GAUSS_NEWTON), np.int64(MIXED)  # a plain integer is compiled in as a constant

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}


class Elements(NamedTuple):
    """Element sets as the kernels take them, and where their blocks go in the profile."""

    stencils: Index
    rest: Array
    weight: Array
    slots: Index


class Body(NamedTuple):
    """What a step needs of a shell; ``free`` are its free vertices in order of elimination."""

    rest: Array
    faces: Index
    mass: Array
    free: Index
    first: Index
    starts: Index
    strides: Index
    triangles: Elements
    edges: Elements
    hinges: Elements


class Room(NamedTuple):
    """Arrays that a step writes to: of vertices (n, 3), of the profile, of unknowns (N,), and of elements."""

    push: Array
    pull: Array
    trial: Array
    gradient: Array
    step: Array
    turns: Array
    moved: Array
    values: Array
    viscous: Array
    own: Array
    pivots: Array
    residual: Array
    displacement: Array
    way: Array
    stresses: tuple[Array, Array, Array]


def make_room(body: Body) -> Room:
    """Room for the steps of a body; every thread needs its own."""
    count, unknowns = len(body.rest), 3 * body.first.size
    push, pull, trial, gradient, step, turns, moved = np.empty((7, count, 3))
    values, viscous = np.empty((2, int(body.starts[-1])))
    residual, displacement, way = np.empty((3, unknowns))
    own, pivots = np.empty((body.first.size, 3)), np.empty(unknowns + LANES)
    stresses = np.empty(body.triangles.rest.size), np.empty(body.edges.rest.size), np.empty(body.hinges.rest.size)
    vertices = (push, pull, trial, gradient, step, turns, moved)
    return Room(*vertices, values, viscous, own, pivots, residual, displacement, way, stresses)


@njit(**_options)
def _assemble(body, room, x):  # type: ignore[no-untyped-def]
    """Write the elastic gradient and Hessian at ``x``, its geometric part with the stresses in ``room``."""
    strides, stresses, values, gradient = body.strides, room.stresses, room.values, room.gradient
    values[:] = 0.0
    gradient[:] = 0.0
    t, e, h = body.triangles, body.edges, body.hinges
    stretch.add_stiffness(x, t.stencils, t.rest, t.weight, stresses[0], _LINEARISED, t.slots, strides, values, gradient)
    shear.add_stiffness(x, e.stencils, e.rest, e.weight, stresses[1], _LINEARISED, e.slots, strides, values, gradient)
    flexure.add_stiffness(x, h.stencils, h.rest, h.weight, stresses[2], _LINEARISED, h.slots, strides, values, gradient)


@njit(**_options)
def _add_viscosity(body, room, x, resistances):  # type: ignore[no-untyped-def]
    """Write the viscous matrix at ``x``: the first part of the Hessian, ``resistances`` being its weights."""
    strides, none, values, gradient = body.strides, room.residual[:0], room.viscous, room.gradient
    values[:] = 0.0
    t, e, h, w = body.triangles, body.edges, body.hinges, resistances
    stretch.add_stiffness(x, t.stencils, t.rest, w[0], none, _STRETCHING, t.slots, strides, values, gradient)
    shear.add_stiffness(x, e.stencils, e.rest, w[1], none, _STRETCHING, e.slots, strides, values, gradient)
    flexure.add_stiffness(x, h.stencils, h.rest, w[2], none, _STRETCHING, h.slots, strides, values, gradient)


@njit(**_options)
def _gradient(body, room, x):  # type: ignore[no-untyped-def]
    """Elastic energy; its gradient goes to ``room``."""
    gradient = room.gradient
    gradient[:] = 0.0
    t, e, h = body.triangles, body.edges, body.hinges
    return (
        stretch.add_gradient(x, t.stencils, t.rest, t.weight, gradient)
        + shear.add_gradient(x, e.stencils, e.rest, e.weight, gradient)
        + flexure.add_gradient(x, h.stencils, h.rest, h.weight, gradient)
    )


@njit(**_options)
def _predict(body, room, x):  # type: ignore[no-untyped-def]
    """Write the stresses after ``room.step``, by the measures linearised at ``x``."""
    t, e, h, step, stresses = body.triangles, body.edges, body.hinges, room.step, room.stresses
    stretch.linear_stress(x, step, t.stencils, t.rest, t.weight, stresses[0])
    shear.linear_stress(x, step, e.stencils, e.rest, e.weight, stresses[1])
    flexure.linear_stress(x, step, h.stencils, h.rest, h.weight, stresses[2])


@njit(**_options)
def _outer(body, room, x, origin, inertia, push, viscous):  # type: ignore[no-untyped-def]
    """Residual of the whole step in order of elimination, and the potential without its elastic part."""
    value = 0.0
    displacement, residual = room.displacement, room.residual
    residual[:] = 0.0
    if viscous.size:
        for k in range(body.free.size):
            for axis in range(3):
                displacement[3 * k + axis] = x[body.free[k], axis] - origin[body.free[k], axis]
        add_product(viscous, body.first, body.starts, displacement, residual)
        for k in range(residual.size):
            value += 0.5 * displacement[k] * residual[k]
    for k in range(body.free.size):
        v = body.free[k]
        mass = inertia * body.mass[v]
        for axis in range(3):
            u = x[v, axis] - origin[v, axis]
            value += u * (0.5 * mass * u - push[v, axis])
            residual[3 * k + axis] += room.gradient[v, axis] + mass * u - push[v, axis]
    return value


@njit(**_options)
def _size(vector):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(vector.size):
        total += vector[k] * vector[k]
    return np.sqrt(total)


@njit(**_options)
def _direction(body, room, inertia, viscous):  # type: ignore[no-untyped-def]
    """Newton's direction into ``room.step``, minus sign included; returns what :func:`factorise` does."""
    values = room.values
    for k in range(body.free.size):
        begin, stride = body.starts[k], body.strides[body.free[k]]
        for axis in range(3):
            place = begin + axis * stride + 3 * k - body.first[k] + axis
            values[place] += inertia * body.mass[body.free[k]]
    for k in range(viscous.size):
        values[k] += viscous[k]
    negative = factorise(values, body.first, body.starts, room.own, room.pivots)
    if negative >= 0:
        solve(values, body.first, body.starts, room.own, room.pivots, room.residual)
        room.step[:] = 0.0
        for k in range(body.free.size):
            for axis in range(3):
                room.step[body.free[k], axis] = -room.residual[3 * k + axis]
    return negative


@njit(**_options)
def _warped(body, room, x):  # type: ignore[no-untyped-def]
    """Write ``x`` moved by the warped ``room.step``, shortened to turn no vertex too far, to ``room.moved``."""
    rotations.vertex_rotations(x, room.step, body.faces, room.turns)
    angle = rotations.largest_angle(room.turns)
    if angle > _TURN:
        room.step[:] *= _TURN / angle
        room.turns[:] *= _TURN / angle
    rotations.warp(room.turns, room.step, 1.0, room.moved)
    room.moved[:] += x


@njit(**_options)
def _mixed(body, room, x, origin, inertia, push, viscous, goal, least, most):  # type: ignore[no-untyped-def]
    """Mixed Newton from ``x``, which it moves; returns its iterations, and whether it has found a minimum.

    ``room.stresses`` are those predicted with ``x``. The first ``least`` iterations do not ask for the residual.
    """
    best, stalled, negative = np.inf, 0, 0
    for iteration in range(most + 1):
        if iteration >= least:
            _gradient(body, room, x)
            _outer(body, room, x, origin, inertia, push, viscous)
            size = _size(room.residual)
            if size <= goal:
                return iteration, negative == 0
            stalled = 0 if size < 0.5 * best else stalled + 1
            best = min(best, size)
            if stalled > _STALLED or iteration == most or not np.isfinite(size):
                break
        _assemble(body, room, x)
        _outer(body, room, x, origin, inertia, push, viscous)
        negative = _direction(body, room, inertia, viscous)
        if negative < 0:
            room.residual[:] = np.inf
            break
        _warped(body, room, x)
        _predict(body, room, x)
        x[:] = room.moved
    return iteration, False


@njit(**_options)
def _value(body, room, x, origin, inertia, push, viscous):  # type: ignore[no-untyped-def]
    """Potential of the step; its residual stays in ``room``."""
    return _gradient(body, room, x) + _outer(body, room, x, origin, inertia, push, viscous)


@njit(**_options)
def _leave_saddle(body, room, x, origin, inertia, push, viscous, size):  # type: ignore[no-untyped-def]
    """Move ``x`` off a saddle, along a direction in which the potential curves down; returns the potential there.

    The factor of the last Hessian gives the direction, that of its smallest pivot. Steps double for as long as the
    potential falls: the first valley is looked for, on either side.
    """
    way, best = room.way, room.pull
    way[:] = 0.0
    way[np.argmin(1.0 / room.pivots[: way.size])] = 1.0
    substitute_back(room.values, body.first, body.starts, room.own, way)
    way /= np.abs(way).max()
    best[:] = x
    least = _value(body, room, x, origin, inertia, push, viscous)
    for sign in (-1.0, 1.0):
        last, length = np.inf, sign * size * 2.0**-20
        while abs(length) < size:
            room.step[:] = 0.0
            for k in range(body.free.size):
                for axis in range(3):
                    room.step[body.free[k], axis] = length * way[3 * k + axis]
            _warped(body, room, x)
            value = _value(body, room, room.moved, origin, inertia, push, viscous)
            if not value < last:
                break
            last = value
            length *= 2.0
            if value < least:
                best[:] = room.moved
                least = value
    x[:] = best
    return least


@njit(**_options)
def _descend(body, room, x, origin, inertia, push, viscous, scale, tolerance):  # type: ignore[no-untyped-def]
    """Go downhill from ``x``, which it moves, as in a thick fluid; returns as :func:`_mixed` does.

    Steps of implicit Euler on ``drag M dx/dt = -grad V``, each by mixed Newton; the drag falls with success and grows
    where a step fails.
    """
    value = _value(body, room, x, origin, inertia, push, viscous)
    size, total = 0.0, 0.0
    for axis in range(3):
        size = max(size, body.rest[:, axis].max() - body.rest[:, axis].min())
    for k in range(body.free.size):
        total += body.mass[body.free[k]] ** 2
    drag = _size(room.residual) / np.sqrt(total) / (_FIRST_MOVE * size)
    trial, pull = room.trial, room.pull
    iterations, left = 0, 0
    for _ in range(_DESCENT):
        trial[:] = x
        for polishing in (False, True):
            added = 0.0 if polishing else drag
            goal = (tolerance if polishing else _LOOSE) * scale
            for v in range(x.shape[0]):
                for axis in range(3):
                    pull[v, axis] = push[v, axis] + added * body.mass[v] * (x[v, axis] - origin[v, axis])
            room.step[:] = 0.0
            _predict(body, room, x)
            taken, minimum = _mixed(body, room, trial, origin, inertia + added, pull, viscous, goal, _ONCE, _SHORT)
            iterations += taken
            solved = _size(room.residual) <= goal
            reached = _value(body, room, trial, origin, inertia, push, viscous) if solved else np.inf
            if polishing or not reached <= value:
                break
            x[:] = trial
            value = reached
            if taken <= _EASY:
                drag *= 0.5
            if _size(room.residual) > _NEAR * scale:
                break
        if not polishing:
            if not reached <= value:
                drag *= 4.0
                if not np.isfinite(drag):
                    break
        elif reached <= value + 1e-9 * abs(value):
            x[:] = trial
            if minimum or left == _SADDLES:
                return iterations, minimum
            left += 1
            value = _leave_saddle(body, room, x, origin, inertia, push, viscous, size)
    return iterations, False


@njit(**_options)
def implicit_step(body, room, origin, rates, load, dt, drag, resistances, tolerance):  # type: ignore[no-untyped-def]
    """One step of implicit Euler by mixed Newton [magisano2017], and descent where that fails.

    ``drag`` is damping by the mass [1/s]; ``resistances`` are the weights of that by the elements' rates, empty if
    there is none.

    Returns
    -------
    x : ndarray, shape (n, 3)
        Positions after the step, or where the solver gave up.
    iterations : int
        Factorisations.
    solved : bool
        Whether the residual met the tolerance and the last Hessian was positive definite.
    """
    x, push, viscous = body.rest.copy(), room.push, room.viscous[:0]
    inertia = 1.0 / (dt * dt) + drag / dt
    if resistances[0].size:
        viscous = room.viscous
        _add_viscosity(body, room, origin, resistances)
        viscous /= dt
    forces, displaced = 0.0, 0.0
    for v in range(origin.shape[0]):
        for axis in range(3):
            push[v, axis] = load[v, axis] + body.mass[v] * rates[v, axis] / dt
    for k in range(body.free.size):
        v = body.free[k]
        for axis in range(3):
            x[v, axis] = origin[v, axis] + dt * rates[v, axis]
            forces += push[v, axis] ** 2
            displaced += (body.mass[v] * (origin[v, axis] - body.rest[v, axis])) ** 2
    scale = max(np.sqrt(forces), _FLOOR * np.sqrt(displaced) / (dt * dt))
    room.step[:] = x
    room.step[:] -= origin
    _predict(body, room, origin)
    goal = tolerance * scale
    iterations, solved = _mixed(body, room, x, origin, inertia, push, viscous, goal, _LEAST, _MOST)
    if not solved:
        x[:] = origin
        further, solved = _descend(body, room, x, origin, inertia, push, viscous, scale, tolerance)
        iterations += further
    return x, iterations, solved
