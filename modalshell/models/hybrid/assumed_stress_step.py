"""Compiled implicit Euler steps of a reduced energy with assumed membrane stresses; see :mod:`.assumed_stress`.

The method is that of :mod:`modalshell.statics.mixed_newton`, the d_k being its stresses.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES, dot, load, spread, store, total
from modalshell.models.hybrid.assumed_stress import ReducedStress
from modalshell.models.hybrid.bending_kernels import Room, add_rows, couple, hinge_angles, make_room
from modalshell.models.hybrid.energy_kernels import (
    energy_terms,
    predict,
    quadratic,
    width_of,
    write_hessian,
    write_squares,
)
from modalshell.statics import mixed_newton as method
from modalshell.statics.mixed_newton import ALL_CHECKED, MOST, START, Rules, operation_of, solve_step

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}
_operation = _options | UNCOUNTED


@njit(**_operation)
def _solve_in_place(matrix, vector, count):  # type: ignore[no-untyped-def]
    """Solve for the first ``count`` unknowns by ``L D L^T`` in place, no pivots exchanged.

    Of ``matrix`` (width, width), which is flat, the lower triangle is read; ``vector`` (width,) has zeros beyond the
    unknowns. Returns the number of negative pivots, or -1 where one is zero.
    """
    width, negative = vector.size, 0
    for i in range(count):
        for j in range(i):
            matrix[j * width + i] = matrix[i * width + j]
        for j in range(count, width):
            matrix[i * width + j] = 0.0
    for k in range(count):  # rows of D L^T, from the diagonal on
        row = k * width
        pivot = matrix[row + k]
        if not 0.0 < abs(pivot) < np.inf:
            return -1
        negative += pivot < 0.0
        for i in range(k + 1, count):
            scaled = matrix[row + i] / pivot
            vector[i] -= scaled * vector[k]
            factor = spread(-scaled)
            for j in range(i // LANES * LANES, width, LANES):
                at = i * width + j
                store(matrix, at, load(matrix, at) + factor * load(matrix, row + j))
    for i in range(count - 1, -1, -1):
        pivot, right = matrix[i * width + i], vector[i]
        vector[i] = 0.0
        for j in range(i // LANES * LANES, i):
            matrix[i * width + j] = 0.0
        begin, products = i // LANES * LANES, spread(0.0)
        for j in range(begin, width, LANES):
            products = products + load(matrix, i * width + j) * load(vector, j)
        vector[i] = (right - total(products)) / pivot
    return negative


class Step(NamedTuple):
    """A step about ``origin`` (m,), ``outer`` being its quadratic part: the problem of mixed Newton.

    Rows, and vectors that products are made with, have zeros beyond the m coordinates; see :mod:`.bending_kernels`.
    """

    reduced: ReducedStress
    origin: Array
    outer: Array
    push: Array
    x: Array
    stresses: Array
    strains: Array
    slopes: Array
    others: Array
    gradient: Array
    hessian: Array
    slots: Array
    way: Array
    at: Array
    moved: Array
    numbers: Array
    room: Room


_SCALE, _DRAG, _NEGATIVE, _ENERGY = range(4)
"""Places in a step's numbers: of forces, of a descent, negative pivots of the last factor, the elastic energy."""


@operation_of(Step, method.residual, **_operation)
def _residual(p):  # type: ignore[no-untyped-def]
    """Energy, strains and out-of-balance force; its size."""
    return _balance(p)


@njit(**_operation)
def _balance(p):  # type: ignore[no-untyped-def]
    count, width = p.x.size, p.at.size
    for i in range(count):
        p.at[i] = p.x[i]
        p.moved[i] = p.x[i] - p.origin[i]
    p.numbers[_ENERGY] = energy_terms(p.reduced, p.at, p.strains, p.slopes, p.others, p.gradient, p.room)
    add_rows(p.outer, 0, p.moved, 0, count, p.gradient)
    for i in range(count):
        p.gradient[i] += p.numbers[_DRAG] * (p.x[i] - p.slots[START, i]) - p.push[i]
    return np.sqrt(dot(p.gradient, 0, p.gradient, 0, width)) / p.numbers[_SCALE]


@operation_of(Step, method.potential, **_operation)
def _potential(p):  # type: ignore[no-untyped-def]
    """Potential, and size of the out-of-balance force."""
    size, value, width = _balance(p), p.numbers[_ENERGY], p.at.size
    for i in range(p.x.size):
        move = p.x[i] - p.origin[i]
        for j in range(p.x.size):
            value += 0.5 * move * p.outer[i * width + j] * (p.x[j] - p.origin[j])
        value -= move * p.push[i]
    return value, size


@njit(**_operation)
def _assemble(p):  # type: ignore[no-untyped-def]
    """Write the Hessian's lower triangle, the inertia's and the damping's with it, where the balance was asked for."""
    width = p.at.size
    write_hessian(p.reduced, p.stresses, p.slopes, p.others, width, p.hessian, p.room)
    for i in range(p.outer.size):
        p.hessian[i] += p.outer[i]


@operation_of(Step, method.solve, **_operation)
def _solve(p, accuracy):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Newton's direction, into the array of the gradient."""
    _assemble(p)
    for i in range(p.x.size):
        p.hessian[i * p.at.size + i] += p.numbers[_DRAG]
        p.gradient[i] = -p.gradient[i]
    p.numbers[_NEGATIVE] = _solve_in_place(p.hessian, p.gradient, p.x.size)
    return p.numbers[_NEGATIVE] >= 0.0


@operation_of(Step, method.advance, **_operation)
def _advance(p):  # type: ignore[no-untyped-def]
    """Move along the direction."""
    predict(p.slopes, p.gradient, p.strains, p.stresses)
    for i in range(p.x.size):
        p.x[i] += p.gradient[i]
    return 0.0


@operation_of(Step, method.is_minimum, **_operation)
def _is_minimum(p):  # type: ignore[no-untyped-def]
    """Whether the last factor has no negative pivot."""
    return p.numbers[_NEGATIVE] == 0.0


@operation_of(Step, method.drag, **_operation)
def _drag(p, factor):  # type: ignore[no-untyped-def]
    """Set the drag about START, and the stresses of the iterate."""
    p.numbers[_DRAG] = factor
    _balance(p)
    for k in range(p.stresses.size):
        p.stresses[k] = p.strains[k]


@operation_of(Step, method.first_drag, **_operation)
def _first_drag(p, size):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Drag to begin with: a hundredth of the inertia, as coordinates have no size of their own."""
    return 0.01 * p.outer[0]


@operation_of(Step, method.point_downhill, **_options)
def _point_downhill(p):  # type: ignore[no-untyped-def]
    """Find the direction in which the potential curves down most."""
    _balance(p)
    _assemble(p)
    count, width = p.x.size, p.at.size
    whole = np.empty((count, count))
    for i in range(count):
        for j in range(i + 1):
            whole[i, j] = whole[j, i] = p.hessian[i * width + j]
    curvatures, ways = np.linalg.eigh(whole)
    size = np.sqrt(dot(p.x, 0, p.x, 0, count))
    for i in range(count):
        p.way[i] = size * ways[i, 0]
    return curvatures[0]


@operation_of(Step, method.step_aside, **_operation)
def _step_aside(p, fraction):  # type: ignore[no-untyped-def]
    """Move along that direction."""
    for i in range(p.x.size):
        p.x[i] = p.slots[START, i] + fraction * p.way[i]


@njit(**_options)
def _write_viscous(reduced, at, factor, outer, room):  # type: ignore[no-untyped-def]
    """Write ``factor`` times the viscous matrix at coordinates ``at`` (width,) into ``outer``, flat: that of slopes."""
    bending, width, modes = reduced.bending, at.size, reduced.viscous.modes
    size = modes + bending.angles.size
    slopes, strains, none = np.zeros(size * width), np.empty(size), np.empty(width)
    others = np.empty(bending.across.shape[0] * width)
    quadratic(reduced.viscous, at, strains, slopes, room)
    hinge_angles(bending, at, modes, strains, slopes, room)
    if bending.across.shape[0] > 0:
        couple(bending, at, modes, strains, slopes, others, none, room)
    write_squares(bending, slopes, size, modes, others, width, outer)
    for i in range(width):
        for j in range(i + 1):
            outer[i * width + j] *= factor
            outer[j * width + i] = outer[i * width + j]


@njit(**_options)
def implicit_step(reduced, start, force, dt, drag, viscosity, tolerance, kept):  # type: ignore[no-untyped-def]
    """One step of implicit Euler by mixed Newton, and descent where that fails.

    ``start`` holds coordinates and rates, a state without false strains, and where the viscous matrix is taken.
    Newton's method begins where the rates lead, with the stresses of that state. ``force`` (m,) is the load's; ``drag``
    [1/s] and ``viscosity`` [s] are Rayleigh's factors. The viscous matrix is that of the strains' slopes, as for
    discrete shells. ``kept`` (m + K,) are coordinates and their membrane strains, those of the step before: mostly
    they are the state without false strains. The end's are written there.

    Returns
    -------
    z : ndarray, shape (m,)
        Coordinates after the step, or where the solver gave up.
    solved : bool
        Whether the residual met the tolerance at a minimum.
    energy, seen : float
        Elastic energy, and its share in the assumed stresses [J].
    iterations : int
        Iterations.
    """
    z, rates, near, viscous_at = start
    count, width, modes = z.size, width_of(z.size), reduced.membrane.modes
    size, coupled = modes + reduced.bending.angles.size, reduced.bending.across.shape[0]
    outer, at = np.zeros(width * width), np.zeros(width)
    rows = max(reduced.membrane.linear.shape[1], reduced.viscous.linear.shape[1])
    room = make_room(count, rows, reduced.bending.rest.shape[0], coupled)
    if viscosity > 0.0:
        for i in range(count):
            at[i] = viscous_at[i]
        _write_viscous(reduced, at, viscosity / dt, outer, room)
    push, begin, slots = np.empty(count), np.empty(count), np.empty((2, count))
    known = True
    for i in range(count):
        outer[i * width + i] += 1.0 / (dt * dt) + drag / dt
        push[i] = force[i] + rates[i] / dt
        begin[i] = z[i] + dt * rates[i]
        slots[START, i] = at[i] = near[i]
        known &= kept[i] == near[i]
    scale = max(np.sqrt(dot(push, 0, push, 0, count)), 1e-3 * np.sqrt(dot(z, 0, z, 0, count)) / (dt * dt))
    scale = scale if scale > 0.0 else 1.0
    strains, slopes, stresses = np.empty(size), np.zeros(size * width), np.empty(modes)
    if not known:
        quadratic(reduced.membrane, at, strains, slopes, room)
    for k in range(modes):
        stresses[k] = kept[count + k] if known else strains[k]
    step = Step(
        reduced, z, outer, push, begin, stresses, strains, slopes, np.zeros(coupled * width), np.zeros(width),
        np.empty(width * width), slots, np.empty(count), at, np.empty(width),
        np.array([scale, 0.0, 0.0, np.inf]), room,
    )  # fmt: skip
    found = solve_step(step, Rules(tolerance, tolerance, 0.0, ALL_CHECKED, MOST))
    for i in range(count):
        kept[i] = at[i]
    for k in range(modes):
        kept[count + k] = strains[k]
    return step.x, found.solved, step.numbers[_ENERGY], 0.5 * dot(strains, 0, strains, 0, modes), found.iterations
