"""Compiled Newton solver of implicit Euler for small shells: factorisation, warped steps.

The method is that of :mod:`modalshell.statics.mixed_newton`, on the storage of a profile factorisation. What knows the
elastic energy is a record of its own with six operations, those of :mod:`.profile_elasticity`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels import rotations
from modalshell.kernels.by_reference import by_reference
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES
from modalshell.linalg.profile import factorise, solve, substitute_back
from modalshell.models.coarse import profile_elasticity as elasticity
from modalshell.statics import mixed_newton as method
from modalshell.statics.mixed_newton import (
    FIRST_MOVE,
    LARGEST_TURN,
    MOST,
    START,
    STRAIGHT_TURN,
    Rules,
    operation_of,
    solve_step,
    write,
)
from modalshell.statics.potential import EPSILON, STILL

_UNCHECKED: int = np.int64(2)  # type: ignore[assignment]
"""First iterations of a step that do not ask for the residual: a single one is 8 to 21 % off across a snap."""
_FLOOR = 1e-3
"""Share of the inertia of the displacement itself below which a residual is not compared with the load."""
_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True} | UNCOUNTED
"""Options of the operations, too: one is compiled once more for callers of others."""


class Body(NamedTuple):
    """What a step needs of a shell; ``free`` are its free vertices in order of elimination, ``rows`` their blocks.

    Further blocks are internal unknowns of the energy, whose part of a residual is zero.
    """

    rest: Array
    size: float
    faces: Index
    mass: Array
    free: Index
    rows: Index
    first: Index
    starts: Index
    strides: Index
    elastic: Any


class Room(NamedTuple):
    """Arrays that a step writes to: of vertices (n, 3), of the profile, of unknowns (N,), of elements, and numbers."""

    x: Array
    push: Array
    gradient: Array
    step: Array
    turns: Array
    moved: Array
    slots: Array
    values: Array
    second: Array
    own: Array
    pivots: Array
    residual: Array
    way: Array
    elastic: Any
    numbers: Array


def make_room(body: Body) -> Room:
    """Room for the steps of a body; every thread needs its own."""
    count, unknowns = len(body.rest), 3 * body.first.size
    x, push, gradient, step, turns, moved = np.empty((6, count, 3))
    values, second = np.empty((2, int(body.starts[-1])))
    residual, way = np.empty((2, unknowns))
    own, pivots = np.empty((body.first.size, 3)), np.empty(unknowns + LANES)
    return Room(
        x, push, gradient, step, turns, moved, np.empty((2, count, 3)), values, second, own, pivots, residual, way,
        body.elastic.room(), np.zeros(5),
    )  # fmt: skip


class Start(NamedTuple):
    """Where a step begins; see :class:`modalshell.integrators.full.implicit_rule.EulerStart`."""

    origin: Array
    rates: Array
    near: Array


class Step(NamedTuple):
    """A step about ``origin`` (n, 3): the problem of :mod:`modalshell.statics.mixed_newton`."""

    body: Body
    room: Room
    origin: Array
    x: Array
    slots: Array


_SCALE, _INERTIA, _DRAG, _NEGATIVE, _STIFF = range(5)
"""Places in a room's numbers: of forces, of the mass, of a descent, and of the last Hessian the negative pivots, and
the size of its diagonal."""


@njit(entry=False, **_options)
def still(room):  # type: ignore[no-untyped-def]
    """Leave inertia and drag out, and forces as they are."""
    numbers = room.numbers
    numbers[_INERTIA], numbers[_DRAG], numbers[_SCALE] = 0.0, 0.0, 1.0


@njit(entry=False, **_options)
def outer(p):  # type: ignore[no-untyped-def]
    """Residual of the whole step in order of elimination, and the potential without its elastic part."""
    body, room = p.body, p.room  # more names at once make a tuple: to copy records of arrays takes long to compile
    value, x, origin = 0.0, p.x, p.origin
    residual, inertia, drag = room.residual, room.numbers[_INERTIA], room.numbers[_DRAG]
    residual[:] = 0.0
    for k in range(body.free.size):
        v = body.free[k]
        mass = inertia * body.mass[v]
        for axis in range(3):
            u = x[v, axis] - origin[v, axis]
            value += u * (0.5 * mass * u - room.push[v, axis])
            residual[3 * body.rows[k] + axis] += room.gradient[v, axis] + mass * u - room.push[v, axis]
    if drag > 0.0:
        for k in range(body.free.size):
            v = body.free[k]
            for axis in range(3):
                residual[3 * body.rows[k] + axis] += drag * body.mass[v] * (x[v, axis] - p.slots[START, v, axis])
    return value


@operation_of(Step, method.residual, **_options)
def _residual(p):  # type: ignore[no-untyped-def]
    """Size of the out-of-balance force."""
    elasticity.energy(p.body.elastic, p.room, p.x)
    outer(p)
    return _size(p)


@operation_of(Step, method.potential, **_options)
def _potential(p):  # type: ignore[no-untyped-def]
    """Potential, and size of the out-of-balance force."""
    value = elasticity.energy(p.body.elastic, p.room, p.x) + outer(p)
    return value, _size(p)


@njit(**_options)
def _size(p):  # type: ignore[no-untyped-def]
    """Size of the residual over that of the forces."""
    total, room = 0.0, p.room
    for part in room.residual:
        total += part * part
    return np.sqrt(total) / room.numbers[_SCALE]


@operation_of(Step, method.solve, **_options)
def _solve(p, accuracy):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Newton's direction into ``room.step``."""
    body, room = p.body, p.room
    values, inertia = room.values, room.numbers[_INERTIA] + room.numbers[_DRAG]
    elasticity.assemble(body.elastic, body, room, p.x)
    outer(p)
    for k in range(body.free.size):
        row, stride = body.rows[k], body.strides[body.free[k]]
        for axis in range(3):
            place = body.starts[row] + axis * stride + 3 * row - body.first[row] + axis
            values[place] += inertia * body.mass[body.free[k]]
    room.numbers[_STIFF] = _diagonal(body, values)
    negative = factorise(values, body.first, body.starts, room.own, room.pivots)
    room.numbers[_NEGATIVE] = negative
    if negative >= 0:
        solve(values, body.first, body.starts, room.own, room.pivots, room.residual)
        spread(body, room, room.residual, -1.0)
    return negative >= 0


@njit(entry=False, **_options)
def spread(body, room, unknowns, factor):  # type: ignore[no-untyped-def]
    """Write ``factor`` times values of unknowns, in order of elimination, to ``room.step``."""
    room.step[:] = 0.0
    for k in range(body.free.size):
        for axis in range(3):
            room.step[body.free[k], axis] = factor * unknowns[3 * body.rows[k] + axis]


@njit(**_options)
def _warp(body, room, x):  # type: ignore[no-untyped-def]
    """Write ``x`` moved by the warped ``room.step``, shortened to turn no vertex too far, to ``room.moved``."""
    rotations.vertex_rotations(x, room.step, body.faces, room.turns)
    angle = rotations.largest_angle(room.turns)
    if angle > LARGEST_TURN:
        for v in range(x.shape[0]):
            for axis in range(3):
                room.step[v, axis] *= LARGEST_TURN / angle
                room.turns[v, axis] *= LARGEST_TURN / angle
    rotations.warp(room.turns, room.step, 1.0, room.moved)
    for v in range(x.shape[0]):
        for axis in range(3):
            room.moved[v, axis] += x[v, axis]


@njit(entry=False, **_options)
def _diagonal(body, values):  # type: ignore[no-untyped-def]
    """Size of the diagonal of a matrix in the profile, at the free vertices."""
    total = 0.0
    for k in range(body.free.size):
        row, stride = body.rows[k], body.strides[body.free[k]]
        for axis in range(3):
            total += values[body.starts[row] + axis * stride + 3 * row - body.first[row] + axis] ** 2
    return np.sqrt(total)


@operation_of(Step, method.advance, **_options)
def _advance(p):  # type: ignore[no-untyped-def]
    """Move along the warped direction; the residual that rounding explains after a step of nothing, as of statics."""
    body, room = p.body, p.room
    _warp(body, room, p.x)
    elasticity.predict(body.elastic, room, p.x)
    write(room.moved, p.x)
    longest, furthest = 0.0, 0.0
    for v in range(p.x.shape[0]):
        for axis in range(3):
            longest, furthest = max(longest, abs(room.step[v, axis])), max(furthest, abs(p.x[v, axis]))
    if not longest <= STILL * body.size:
        return 0.0
    return EPSILON * furthest * room.numbers[_STIFF] / room.numbers[_SCALE]


@operation_of(Step, method.is_minimum, **_options)
def _is_minimum(p):  # type: ignore[no-untyped-def]
    """Whether the last factor has no negative pivot."""
    return p.room.numbers[_NEGATIVE] == 0.0


@operation_of(Step, method.drag, **_options)
def _drag(p, factor):  # type: ignore[no-untyped-def]
    """Set the drag about START, and the stresses of the iterate."""
    room = p.room
    room.numbers[_DRAG] = factor
    room.step[:] = 0.0
    elasticity.predict(p.body.elastic, room, p.x)


@operation_of(Step, method.first_drag, **_options)
def _first_drag(p, size):  # type: ignore[no-untyped-def]
    """Drag to begin with."""
    total, body = 0.0, p.body
    for k in range(body.free.size):
        total += body.mass[body.free[k]] ** 2
    return size * p.room.numbers[_SCALE] / (np.sqrt(total) * FIRST_MOVE * body.size)


@operation_of(Step, method.point_downhill, **_options)
def _point_downhill(p):  # type: ignore[no-untyped-def]
    """Find a direction in which the potential curves down: that of the smallest pivot of the last factor."""
    body, room, way = p.body, p.room, p.room.way
    least, smallest = 0, np.inf
    for k in range(way.size):
        if 1.0 / room.pivots[k] < smallest:
            least, smallest = k, 1.0 / room.pivots[k]
    way[:] = 0.0
    way[least] = 1.0
    substitute_back(room.values, body.first, body.starts, room.own, way)
    squares, largest = 0.0, 0.0
    for k in range(body.free.size):
        for axis in range(3):
            part = way[3 * body.rows[k] + axis]
            squares += body.mass[body.free[k]] * part**2
            largest = max(largest, abs(part))
    for k in range(way.size):
        way[k] *= body.size / largest
    return smallest / squares


@operation_of(Step, method.step_aside, **_options)
def _step_aside(p, fraction):  # type: ignore[no-untyped-def]
    """Move along that direction, warped."""
    body, room = p.body, p.room
    spread(body, room, room.way, fraction)
    _warp(body, room, p.slots[START])
    write(room.moved, p.x)


@njit(**_options)
def _begin(body, room, start, load, dt):  # type: ignore[no-untyped-def]
    """Write the push of load and inertia, and the first iterate with its stresses; returns the scale of forces."""
    x, push, origin, rates = room.x, room.push, start.origin, start.rates
    forces, displaced = 0.0, 0.0
    for v in range(origin.shape[0]):
        for axis in range(3):
            push[v, axis] = load[v, axis] + body.mass[v] * rates[v, axis] / dt
    write(start.near, room.slots[START])
    write(body.rest, x)
    room.step[:] = 0.0
    for k in range(body.free.size):
        v = body.free[k]
        for axis in range(3):
            x[v, axis] = origin[v, axis] + dt * rates[v, axis]
            room.step[v, axis] = x[v, axis] - start.near[v, axis]
            forces += push[v, axis] ** 2
            displaced += (body.mass[v] * (origin[v, axis] - body.rest[v, axis])) ** 2
    rotations.vertex_rotations(start.near, room.step, body.faces, room.turns)
    if not rotations.largest_angle(room.turns) <= STRAIGHT_TURN:
        write(start.near, x)
    # Stresses predicted along the straight way to a turned place would be a compression (theory 12).
    room.step[:] = 0.0
    elasticity.predict(body.elastic, room, start.near)
    return max(np.sqrt(forces), _FLOOR * np.sqrt(displaced) / (dt * dt))


@njit(**_options)
def implicit_step(body, room, start, load, dt, drag, tolerance):  # type: ignore[no-untyped-def]
    """One step of implicit Euler by mixed Newton [magisano2017], and descent where that fails.

    Body and room are :class:`~modalshell.kernels.by_reference.Placed`, and ``drag`` is damping by the mass [1/s].
    ``room.x`` is left at the positions after the step, or where the solver gave up. Returns the number of
    factorisations, and whether the residual met the tolerance and the last Hessian was positive definite.
    """
    numbers = room.numbers
    numbers[_INERTIA], numbers[_DRAG] = 1.0 / (dt * dt) + drag / dt, 0.0
    scale = _begin(body, room, start, load, dt)
    numbers[_SCALE] = scale if scale > 0.0 else 1.0
    step = by_reference(Step(body, room, start.origin, room.x, room.slots))
    found = solve_step(step, Rules(tolerance, tolerance, 0.0, _UNCHECKED, MOST))
    return found.iterations, found.solved
