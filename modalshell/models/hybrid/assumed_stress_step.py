"""Compiled implicit Euler steps of a reduced energy with assumed membrane stresses; see :mod:`.assumed_stress`.

The method is that of :mod:`modalshell.statics.mixed_newton`, the d_k being its stresses.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import dot
from modalshell.models.hybrid.assumed_stress import ReducedStress
from modalshell.models.hybrid.bending_kernels import Room, fold_rows, make_room, write_bending
from modalshell.models.hybrid.dense_kernels import add_rows, factorise, mirror, solve, width_of
from modalshell.models.hybrid.energy_kernels import energy_terms, predict, quadratic, write_hessian
from modalshell.statics import mixed_newton as method
from modalshell.statics.mixed_newton import ALL_CHECKED, MOST, START, Rules, operation_of, solve_step

STEP_GOAL = 2e-3
"""Tolerance of a step's residual, a correction of the coordinates over their way. BDF2's own error is tens of times as
large at 1/60 s."""

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}, "nogil": True}
_operation = _options | UNCOUNTED


class Step(NamedTuple):
    """A step about ``origin`` (m,), ``outer`` being its quadratic part: the problem of mixed Newton.

    Its residual is the out-of-balance force, and after the first iteration the correction by the last factor: an error
    of the coordinates, where the force itself is mostly a stretch that the next correction takes away. It is relative
    to the way that load and inertia alone would go, or in steps longer than the shell's period to the coordinates.

    ``bending`` is the sum of the quadratic part and of the Hessian of bending. Damping by the stiffness, f over the
    step's length, adds ``f |d - d'|^2 / 2``: stresses are ``(1 + f) d - f d'``. ``offset`` is ``f d'``, ``viscous`` are
    stresses of the damping, ``steep`` are slopes times ``1 + f``.

    Rows, and vectors that products are made with, have zeros beyond the m coordinates; see :mod:`.dense_kernels`.
    """

    reduced: ReducedStress
    origin: Array
    outer: Array
    push: Array
    x: Array
    stresses: Array
    strains: Array
    offset: Array
    viscous: Array
    slopes: Array
    steep: Array
    folds: Array
    gradient: Array
    hessian: Array
    bending: Array
    slots: Array
    way: Array
    correction: Array
    at: Array
    moved: Array
    numbers: Array
    room: Room


_SCALE, _DRAG, _NEGATIVE, _ENERGY, _INERTIA, _FACTORED, _BEGUN, _BENT, _DAMPING = range(9)
"""Places in a step's numbers: of forces, of a descent, negative pivots of the last factor, the elastic energy, what
inertia adds to the diagonal, whether there is a factor of this drag, whether the energy's terms are known at the
iterate already, whether the Hessian of bending is, and the factor of damping by the stiffness over the step."""


@operation_of(Step, method.residual, **_operation)
def _residual(p):  # type: ignore[no-untyped-def]
    """Energy, strains and out-of-balance force; the size of it, or of what it makes of the last factor."""
    size, width = _balance(p), p.at.size
    if p.numbers[_FACTORED] == 0.0:
        return size
    for i in range(width):
        p.correction[i] = p.gradient[i]
    solve(p.hessian, p.correction)
    far = max(dot(p.origin, 0, p.origin, 0, p.origin.size), dot(p.at, 0, p.at, 0, width))
    way = min(p.numbers[_SCALE] / p.numbers[_INERTIA], np.sqrt(far))
    return np.sqrt(dot(p.correction, 0, p.correction, 0, width)) / way if way > 0.0 else size


@njit(**_operation)
def _balance(p):  # type: ignore[no-untyped-def]
    count, width = p.x.size, p.at.size
    for i in range(count):
        p.at[i] = p.x[i]
        p.moved[i] = p.x[i] - p.origin[i]
    if p.numbers[_BEGUN] == 0.0:
        p.numbers[_ENERGY] = energy_terms(p.reduced, p.at, p.strains, p.slopes, p.gradient, p.room)
    p.numbers[_BEGUN] = 0.0
    if p.numbers[_DAMPING] == 0.0:
        for i in range(count):
            p.gradient[i] += p.numbers[_INERTIA] * p.moved[i]
    else:
        add_rows(p.outer, p.moved, 0, count, p.gradient)
        for k in range(p.offset.size):
            p.viscous[k] = p.numbers[_DAMPING] * p.strains[k] - p.offset[k]
        add_rows(p.slopes, p.viscous, 0, p.offset.size, p.gradient)
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
    for k in range(p.offset.size):
        value += (0.5 * p.numbers[_DAMPING] * p.strains[k] - p.offset[k]) * p.strains[k]
    return value, size


@njit(**_operation)
def _stress(p, strains):  # type: ignore[no-untyped-def]
    """Write the stresses of ``strains`` (K',), those of damping with them."""
    factor = 1.0 + p.numbers[_DAMPING]
    for k in range(p.stresses.size):
        p.stresses[k] = factor * strains[k] - p.offset[k]


@njit(**_operation)
def _assemble(p):  # type: ignore[no-untyped-def]
    """Write the Hessian's lower triangle, the inertia's and the damping's with it, where the balance was asked for."""
    width = p.at.size
    if p.numbers[_BENT] == 0.0:
        write_bending(p.outer, p.reduced.bending, width, p.folds, p.room, p.bending)
    p.numbers[_BENT] = 0.0
    if p.numbers[_DAMPING] > 0.0:
        for k in range(p.slopes.size):
            p.steep[k] = (1.0 + p.numbers[_DAMPING]) * p.slopes[k]
    write_hessian(p.bending, p.reduced.membrane, p.stresses, p.steep, p.slopes, width, p.hessian)


@operation_of(Step, method.solve, **_operation)
def _solve(p, accuracy):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Newton's direction, into the array of the gradient."""
    _assemble(p)
    for i in range(p.x.size):
        p.hessian[i * p.at.size + i] += p.numbers[_DRAG]
        p.gradient[i] = -p.gradient[i]
    negative = factorise(p.hessian, p.at.size, p.x.size)
    p.numbers[_NEGATIVE], p.numbers[_FACTORED] = negative, 1.0
    if negative >= 0:
        solve(p.hessian, p.gradient)
    return negative >= 0


@operation_of(Step, method.advance, **_operation)
def _advance(p):  # type: ignore[no-untyped-def]
    """Move along the direction."""
    predict(p.slopes, p.gradient, p.strains, p.stresses)
    if p.numbers[_DAMPING] > 0.0:
        _stress(p, p.stresses)
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
    p.numbers[_DRAG], p.numbers[_FACTORED], p.numbers[_BENT] = factor, 0.0, 0.0
    _balance(p)
    _stress(p, p.strains)


@operation_of(Step, method.first_drag, **_operation)
def _first_drag(p, size):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Drag to begin with: a hundredth of the inertia, as coordinates have no size of their own."""
    return 0.01 * p.outer[0]


@operation_of(Step, method.point_downhill, **_options)
def _point_downhill(p):  # type: ignore[no-untyped-def]
    """Find the direction in which the potential curves down most."""
    _balance(p)
    _assemble(p)
    p.numbers[_FACTORED] = 0.0
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
def _damp(p, at):  # type: ignore[no-untyped-def]
    """Write the viscous matrix of bending ``at`` coordinates (m,) as the quadratic part.

    Where Newton's method begins there, the slopes of bending serve the first iteration, too.
    """
    width, begun = p.at.size, True
    for i in range(p.x.size):
        p.at[i] = at[i]
        begun &= at[i] == p.x[i]
    p.numbers[_ENERGY] = energy_terms(p.reduced, p.at, p.strains, p.slopes, p.gradient, p.room)
    write_bending(p.outer, p.reduced.bending, width, p.folds, p.room, p.bending)
    p.numbers[_BEGUN] = p.numbers[_BENT] = 1.0 if begun else 0.0
    for k in range(p.outer.size):
        p.outer[k] = p.numbers[_DAMPING] * p.bending[k]
    mirror(p.outer, width)


@njit(**_options)
def add_strains(reduced, z, weight, kept, total):  # type: ignore[no-untyped-def]
    """Add ``weight`` times the strains at z (m,) to ``total`` (K,); ``kept`` is that of :func:`implicit_step`."""
    membrane, count, width, known = reduced.membrane, z.size, width_of(z.size), True
    for i in range(count):
        known &= kept[i] == z[i]
    if known:
        for k in range(membrane.modes):
            total[k] += weight * kept[count + k]
        return
    at, rows = np.zeros(width), membrane.linear.shape[1]
    for i in range(count):
        at[i] = z[i]
    strains, slopes = np.zeros(rows), np.empty(rows * width)
    quadratic(membrane, at, strains, slopes, make_room(width, reduced.bending))
    for k in range(membrane.modes):
        total[k] += weight * strains[k]


def reduced_start(reduced: ReducedStress, start: EulerStart, viscosity: float, kept: Array) -> tuple[Array, ...]:
    """What :func:`implicit_step` takes of where a step begins."""
    begun = np.zeros(reduced.membrane.modes)
    if viscosity > 0.0:
        for weight, state, _ in start.made_of:
            add_strains(reduced, state.coordinates, weight, kept, begun)
    return *start.reduced, begun


@njit(**_options)
def implicit_step(reduced, start, force, dt, drag, viscosity, tolerance, kept):  # type: ignore[no-untyped-def]
    """One step of implicit Euler by mixed Newton, and descent where that fails.

    ``start`` holds coordinates and rates, a state without false strains, where the viscous matrix of bending is taken,
    where Newton's method begins, with the stresses of that state, and strains (K,) from which damping counts.
    ``force`` (m,) is the load's; ``drag`` [1/s] and ``viscosity`` [s] are Rayleigh's factors.
    ``kept`` (m + K,) are coordinates and their membrane strains, those of the step before: mostly
    they are the state without false strains. The end's are written there.

    Returns the coordinates (m,) after the step, or where the solver gave up, whether the residual met the tolerance at
    a minimum, elastic energy and its share in the assumed stresses [J], and the number of iterations.
    """
    z, rates, near, viscous_at, begin, begun = start
    count, width, modes, rows = z.size, width_of(z.size), reduced.membrane.modes, reduced.membrane.linear.shape[1]
    size = rows + reduced.bending.angles.size
    outer, at, room = np.zeros(width * width), np.zeros(width), make_room(width, reduced.bending)
    push, first, slots = np.empty(count), np.empty(count), np.empty((2, count))
    known, inertia = True, 1.0 / (dt * dt) + drag / dt
    for i in range(count):
        push[i] = force[i] + rates[i] / dt
        first[i] = begin[i]
        slots[START, i] = at[i] = near[i]
        known &= kept[i] == near[i]
    scale = max(np.sqrt(dot(push, 0, push, 0, count)), 1e-3 * np.sqrt(dot(z, 0, z, 0, count)) / (dt * dt))
    scale = scale if scale > 0.0 else 1.0
    strains, slopes, stresses = np.zeros(size), np.empty(rows * width), np.zeros(rows)
    if not known:
        quadratic(reduced.membrane, at, strains, slopes, room)
    damping, offset = viscosity / dt, np.zeros(rows)
    for k in range(modes):
        offset[k] = damping * begun[k]
        stresses[k] = (1.0 + damping) * (kept[count + k] if known else strains[k]) - offset[k]
    numbers = np.zeros(_DAMPING + 1)
    numbers[_SCALE], numbers[_ENERGY], numbers[_INERTIA], numbers[_DAMPING] = scale, np.inf, inertia, damping
    steep = np.empty(slopes.size) if damping > 0.0 else slopes
    step = Step(
        reduced, z, outer, push, first, stresses, strains, offset, np.empty(rows), slopes, steep,
        np.empty(fold_rows(reduced.bending) * width),
        np.zeros(width), np.empty(width * width), np.empty(width * width), slots, np.empty(count), np.empty(width), at,
        np.zeros(width), numbers, room,
    )  # fmt: skip
    if viscosity > 0.0:
        _damp(step, viscous_at)
    for i in range(count):
        outer[i * width + i] += inertia
    if step.numbers[_BENT] > 0.0:
        for i in range(outer.size):
            step.bending[i] += outer[i]
    found = solve_step(step, Rules(tolerance, tolerance, 0.0, ALL_CHECKED, MOST))
    for i in range(count):
        kept[i] = at[i]
    for k in range(modes):
        kept[count + k] = strains[k]
    return step.x, found.solved, step.numbers[_ENERGY], 0.5 * dot(strains, 0, strains, 0, modes), found.iterations
